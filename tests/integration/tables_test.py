#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A run with tables: what ran, in its trace, is compared with tables.json and with the switches that the report tells.
Which table a release has is computed here, out of these two; the trace is read by pftrace.py."""
import collections
import json
import pathlib
import random
import re
import subprocess
import tempfile
import unittest

import pftrace
from report_test import Page
from common import APP, DRIVING, QUEUES, TESTAPP, XAUTO, testapp_files, top, wait_for, xauto

SCENARIOS = [{"name": "nominal"}, {"name": "GPU at 60 %", "wcet_scale_pct": {"gpu": 167}},
             {"name": "GPU at half", "wcet_scale_pct": {"gpu": 200}}, {"name": "no DLA", "lost": ["dla0"]}]
PATIENCE_NS = 5_000_000  # between a decision and what the trace says of it


class Tables(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        app = json.loads(pathlib.Path(APP).read_text())
        for xnode in app["xnodes"]:  # with room: what a busy machine makes longer is no overrun
            xnode["wcet_us"] = {kind: 4 * us for kind, us in xnode["wcet_us"].items()}
        app.pop("deadline_us", None)
        cls.write("app.json", app)
        cls.solve("app.json", "tables.json", SCENARIOS)
        cls.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "driving", **QUEUES})

    @classmethod
    def write(cls, name, value):
        (cls.folder / name).write_text(json.dumps(value))

    @classmethod
    def solve(cls, app, out, scenarios):
        cls.write("scenarios.json", {"schema": "xauto.scenarios", "version": 1, "app": "driving", "scenarios": scenarios})
        done = xauto("solve", "--app", app, "--platform", "small", "--scenarios", "scenarios.json", "--tables", 3,
                     "--time-limit", "4s", "--out", out, cwd=cls.folder)
        assert done.returncode == 0, done.stdout + done.stderr

    def start(self, *flags, app="app.json", tables="tables.json"):
        with open(self.folder / "out", "w") as out, open(self.folder / "err", "w") as err:
            tool = subprocess.Popen(
                [XAUTO, "run", "--app", app, "--platform", "small", "--emulate", "--policy", tables, "--activations", "0",
                 "--deployment", "deployment.json", "--json", "--trace-out", "t.pftrace", *flags, "--", DRIVING],
                cwd=self.folder, stdout=out, stderr=err)
        self.addCleanup(lambda: (tool.kill(), tool.wait()))
        self.tool, self.run_id = tool, f"{tool.pid}-0"
        wait_for("releases", lambda: self.released() > 2, tool)
        return tool

    def mode(self, *words, status=0):
        done = xauto("param", "scenario" if words else "list", "--run", self.run_id, "--wait", "10s", "--json", *words)
        self.assertEqual(done.returncode, status, done.stderr)
        return json.loads(done.stdout) if status == 0 else done.stderr

    def released(self):
        return top(self.tool).get("releases", 0)

    def end(self):
        self.tool.terminate()
        self.assertEqual(self.tool.wait(timeout=60), 0, (self.folder / "err").read_text())
        return json.loads((self.folder / "out").read_text())["runs"][0]

    def judge(self, report, tables="tables.json"):
        """Each job ran where the table of its release has it, and in its order; releases of two tables did not meet. Returns
        {release: {XNode: (begin, end)}}, and when each release came."""
        self.assertEqual(report["lost_activations"], 0)
        tables = json.loads((self.folder / tables).read_text())
        serves = {s["scenario"]: s["table"] for s in tables["serves"]}
        by_name = {t["name"]: t for t in tables["tables"]}
        trace = pftrace.Trace((self.folder / "t.pftrace").read_bytes())
        jobs, came = collections.defaultdict(dict), {}
        self.switch_events = [s for s in trace.slices if s.category == "table"]
        for s in trace.slices:
            if s.category == "release":
                came[s.args["release"]] = s.begin
            if s.category != "run":
                continue
            name, n = s.name.split(" ")[0], s.args["release"]
            begin, end = jobs[n].get(name, (s.begin, s.end))
            jobs[n][name] = (min(begin, s.begin), max(end, s.end))
            self.assertEqual(s.track, "run/" + self.row(by_name[self.table_at(n, report, serves, tables)], name)["xpu"], n)
        previous = None
        for n in sorted(jobs):
            table = by_name[self.table_at(n, report, serves, tables)]
            for u, v in table.get("order", []):
                if u in jobs[n] and v in jobs[n]:
                    self.assertLess(jobs[n][u][1], jobs[n][v][0] + PATIENCE_NS, f"release {n}: {v} before {u}")
            if previous is not None and previous[1] != table["name"]:
                self.assertLess(previous[0], min(b for b, _ in jobs[n].values()) + PATIENCE_NS, f"release {n} met another table")
            end = max(e for _, e in jobs[n].values())
            previous = (max(end, previous[0]) if previous else end, table["name"])
        for switch in report["switches"]:
            self.assertEqual(switch["table"], serves[switch["to"]])
        return jobs, came

    @staticmethod
    def row(table, xnode):
        return next(x for x in table["xnodes"] if x["name"] == xnode)

    @staticmethod
    def table_at(release, report, serves, tables):
        table = tables["serves"][0]["table"]
        for switch in report["switches"]:
            if switch["release"] <= release:
                table = switch["table"]
        return table

    def switch_about(self, *flags):
        self.start("--period", "45ms", *flags)
        draw = random.Random(5)
        names = [s["name"] for s in SCENARIOS]
        covering = {"nominal": names, "GPU at 60 %": names[1:3], "GPU at half": names[2:3], "no DLA": names[3:]}
        for _ in range(12):
            name = draw.choice(names)
            self.mode(name)
            at = self.released()
            wait_for("a release after the wish", lambda: self.released() > at + 1, self.tool)
            # Jobs that this machine makes longer may ask for more, never for less.
            self.assertIn(self.mode()["now"], covering[name])
        self.assertEqual(self.mode("--none")["was"], name)
        worst = self.worst_so_far()
        for shown in (xauto("top", "--once").stdout, xauto("param", "--run", self.run_id).stdout,
                      xauto("top", "--run", self.run_id, "--interval", "50ms", "--once").stdout):
            self.assertRegex(shown, r"of what met a change the nearest to its worst case, a result of '[^']+', took [\d.]+ ms of \*?[\d.]+ ms")
        report = self.end()
        self.assertIn((worst["from"], worst["to"], worst["us"], worst["worst_case_us"]),
                      [(s["from"], s["to"], s["spanned_us"], s.get("worst_case_us")) for s in report["switches"]])
        nearest = self.nearest(report)
        self.assertLessEqual(worst["us"] / worst["worst_case_us"], nearest["spanned_us"] / nearest["worst_case_us"])
        self.judge(report)
        # "outside": this machine stood still, and no scenario covers that; what is asked for counts all the same.
        self.assertLessEqual({s["why"] for s in report["switches"]}, {"asked", "overrun", "back", "outside"})
        self.assertEqual(report["num_switches"], len(report["switches"]))
        self.assertGreater(len({s["table"] for s in report["switches"]}), 1)
        return report

    def test_each_release_keeps_the_table_that_it_was_stamped_with(self):
        report = self.switch_about()
        shown = self.switch_events
        self.assertEqual([s.args["release"] for s in shown], [s["release"] for s in report["switches"]])
        for event, switch in zip(shown, report["switches"]):
            self.assertIn(switch["to"], event.name)
            for key in ("from", "to", "table"):
                self.assertEqual(event.args[key], switch[key])
            self.assertEqual(event.args["why"].split(":")[0], switch["why"])
            self.assertEqual(event.args.get("spanned_us"), switch["spanned_us"])
            self.assertEqual(event.args.get("worst_case_us"), switch.get("worst_case_us"))
        self.page_tells(report)

    def page_tells(self, report):
        done = xauto("report", "t.pftrace", "--out", "t.html", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        page = Page((self.folder / "t.html").read_text())
        ms = lambda us: "-" if us is None else f"{us / 1000:.2f}"
        self.assertEqual(page.rows("scenario"), [[s["name"], s["table"], str(s["releases"])] for s in report["scenarios"]])
        rows = page.rows("from release")
        self.assertEqual([[r[0], *r[2:5], r[5].split(":")[0], *r[6:]] for r in rows],
                         [[str(s["release"]), s["from"], s["to"], s["table"], s["why"],
                           ms(s["spanned_us"]) + (f" of {s['chain']}" if "chain" in s else ""), ms(s.get("worst_case_us"))] for s in report["switches"]])

    @staticmethod
    def nearest(report):
        """Of the releases that met a change and of which something is claimed."""
        met = [s for s in report["switches"] if s.get("worst_case_us") and s["spanned_us"] is not None]
        return max(met, key=lambda s: s["spanned_us"] / s["worst_case_us"])

    def worst_so_far(self):
        """As `param` and `top`, of this run and of all, have it, which look one after the other; the last one."""
        seen = [self.mode()["spanned"], top(self.tool)["scenario"]["spanned"]]
        runs = json.loads(xauto("top", "--once", "--json").stdout)["runs"]
        seen += [run["scenario"]["spanned"] for run in runs if run["run"] == self.run_id]
        self.assertEqual(len(seen), 3)
        shares = [s["us"] / s["worst_case_us"] for s in seen]
        self.assertEqual(shares, sorted(shares))
        return seen[-1]

    def test_so_do_modules_in_processes_of_their_own(self):
        self.switch_about("--isolate")

    def test_a_job_past_its_wcet_decides_for_the_next_release(self):
        """The app says half of what its GPU stages take, so the first release is already outside of 'nominal'."""
        app = json.loads(pathlib.Path(APP).read_text())
        for xnode in app["xnodes"]:
            for kind in xnode["wcet_us"]:
                times = 1 if kind == "gpu" else 4  # what else this machine's stalls make longer is no overrun
                xnode["wcet_us"][kind] = xnode["wcet_us"][kind] // 2 if times == 1 else xnode["wcet_us"][kind] * times
        app.pop("deadline_us", None)
        self.write("half.json", app)
        self.solve("half.json", "half-tables.json", [{"name": "as said"}, {"name": "as it is", "wcet_scale_pct": {"gpu": 400}}])
        for flags in ((), ("--isolate",)):
            with self.subTest(flags):
                self.start("--period", "60ms", *flags, app="half.json", tables="half-tables.json")
                wait_for("the switch", lambda: self.mode()["now"] == "as it is", self.tool)
                at = self.released()
                wait_for("more releases", lambda: self.released() > at + 5, self.tool)
                report = self.end()
                first = report["switches"][0]
                self.assertEqual((first["from"], first["to"], first["why"]), ("as said", "as it is", "overrun"))
                self.assertRegex(first["detail"], r"^XNode '\w+\.\w+' had its XPU for ")
                if report["num_switches"] == 1:  # releases are numbered from 0 on
                    under = {s["name"]: s["releases"] for s in report["scenarios"]}
                    self.assertEqual(under["as said"], first["release"])
                jobs, came = self.judge(report, "half-tables.json")
                # The first release after the first job that was too long, and had its XPU from its begin to its end.
                wcet = {x["name"]: x["wcet_us"] for x in app["xnodes"]}
                tables = json.loads((self.folder / "half-tables.json").read_text())
                table = next(t for t in tables["tables"] if t["name"] == tables["serves"][0]["table"])
                over = min(end for n in jobs if n < first["release"] for x, (begin, end) in jobs[n].items()
                           if self.row(table, x)["xpu"] == "gpu0" and end - begin > wcet[x]["gpu"] * 1000 * 1.5)
                late = [n for n, at in came.items() if over < at and n < first["release"]]
                self.assertLessEqual(len(late), 1, "releases went on by the old table")

    def test_a_job_counts_before_it_ends(self):
        """One goes on for more than two periods. Had it to end first, the third release after it would be the first to know."""
        period, begins = 400, 3  # ms; its activation
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        files = testapp_files(folder.name, QUEUES, period_us=period * 1000)
        self.write("scenarios.json", {"schema": "xauto.scenarios", "version": 1, "app": "testapp", "scenarios": [
            {"name": "nominal"}, {"name": "stuck", "wcet_scale_pct": {"npu": 5000}}]})
        done = xauto("solve", *files[:4], "--scenarios", "scenarios.json", "--tables", 2, "--time-limit", "2s", "--out",
                     "stuck.json", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        files[files.index("--policy") + 1] = self.folder / "stuck.json"
        for flags in ((), ("--isolate",)):
            with self.subTest(flags):
                done = xauto("run", *files, "--activations", 10, "--json", *flags, "--", TESTAPP, self.folder / "result",
                             "hang", "B", begins, 5 * period // 2)
                self.assertEqual(done.returncode, 0, done.stderr)
                switches = [s for s in json.loads(done.stdout)["runs"][0]["switches"] if s["release"] > begins]
                self.assertLessEqual(switches[0]["release"], begins + 2, switches)
                self.assertRegex(switches[0]["detail"], "^XNode 'b1' had its XPU for ")

    def test_the_machine_says_in_which_scenario_it_is(self):
        clock = self.folder / "cur_freq"
        clock.write_text("918000000\n")
        self.solve("app.json", "clocks.json", [
            {"name": "fast", "when": [{"file": str(clock), "at_least": 900_000_000}]},
            {"name": "slow", "wcet_scale_pct": {"gpu": 200}, "when": [{"file": str(clock), "at_least": 450_000_000}]}])
        self.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "driving", **QUEUES,
                                       "tables": {"dwell_us": 1000}})
        self.start(tables="clocks.json")
        wait_for("fast", lambda: self.mode()["now"] == "fast", self.tool)
        clock.write_text("460000000\n")
        wait_for("slow", lambda: self.mode()["now"] == "slow", self.tool)
        clock.write_text("918000000\n")
        wait_for("fast again", lambda: self.mode()["now"] == "fast", self.tool)
        clock.write_text("100000000\n")
        wait_for("slow, for want of anything slower", lambda: self.mode()["now"] == "slow", self.tool)
        report = self.end()
        self.assertIn(f"those of no scenario: {clock} is 100000000, every scenario needs at least 450000000; 'slow'", str(report["claims"]["broken"]))

    def test_a_wrong_assumption_after_another_one_is_said_too_and_one_that_comes_anew(self):
        """The GPU falls below every scenario and recovers, then the DLA does, then the GPU once more."""
        app = json.loads(pathlib.Path(APP).read_text())
        for xnode in app["xnodes"]:  # room where this machine's stalls would be the first that is said
            xnode["wcet_us"] = {kind: us * (20 if kind == "cpu" else 3) // 2 for kind, us in xnode["wcet_us"].items()}
        app.pop("deadline_us", None)
        self.write("roomy.json", app)
        self.solve("roomy.json", "roomy-tables.json", [{"name": "fast"}, {"name": "slow", "wcet_scale_pct": {"gpu": 150}}])
        self.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "driving", **QUEUES,
                                       "tables": {"dwell_us": 300000}})
        low = lambda kind, pct, at: [{"at_us": at, "speed_pct": {kind: pct}}, {"at_us": at + 400_000, "speed_pct": {kind: 100}}]
        self.write("falls.json", {"schema": "xauto.emulation", "version": 1, "steps":
                                  [*low("gpu", 30, 700_000), *low("dla", 20, 3_500_000), *low("gpu", 30, 6_300_000)]})
        self.start("--period", "66ms", "--emulate-script", "falls.json", app="roomy.json", tables="roomy-tables.json")
        tables = json.loads((self.folder / "roomy-tables.json").read_text())
        on = {kind: {x["name"] for t in tables["tables"] for x in t["xnodes"] if x["xpu"].startswith(kind)} for kind in ("gpu", "dla")}

        def said():
            return re.findall(r"outside of every scenario: XNode '([\w.]+)'", (self.folder / "err").read_text())
        wait_for("the GPU", lambda: on["gpu"] & set(said()), self.tool)
        wait_for("the DLA", lambda: on["dla"] & set(said()), self.tool)
        third = 6_300_000 // 66_000
        wait_for("the third fall", lambda: self.released() > third - 5, self.tool)
        told = len(said())
        wait_for("the GPU again, and releases that get a scenario", lambda: self.released() > third + 15, self.tool)
        report = self.end()
        broken = str(report["claims"]["broken"])
        for name in said():
            self.assertIn(f"outside of every scenario: XNode '{name}'", broken)
        # At most five lines a minute say it meanwhile. Where a stall of this machine was outside, too, it may not have gone back.
        changes = report["switches"]
        before = [s for s in changes if s["release"] < third]
        self.assertGreaterEqual(sum(s["why"] == "outside" for s in before), 2, changes)
        if before[-1]["why"] != "outside":
            self.assertGreaterEqual(sum(s["why"] == "outside" for s in changes), 3, changes)
            self.assertIn("outside", [s["why"] for s in changes if s["release"] >= third], changes)
            if told < 5:
                self.assertTrue(on["gpu"] & set(said()[told:]), said())

    def test_what_cannot_be_is_refused(self):
        run = ("run", "--app", self.folder / "app.json", "--platform", "small", "--emulate", "--policy", self.folder / "tables.json")
        done = xauto(*run, "--scheduling", "timeshare", "--", DRIVING)
        self.assertEqual(done.returncode, 2)
        self.assertIn("tables are scheduled", done.stderr)
        self.start()
        self.assertIn("there is no scenario 'highway'", self.mode("highway", status=2))
        self.end()
        with tempfile.TemporaryDirectory() as folder:
            tool = subprocess.Popen([XAUTO, "run", *testapp_files(folder), "--activations", "0", "--", TESTAPP],
                                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            self.addCleanup(lambda: (tool.kill(), tool.wait()))
            self.run_id = f"{tool.pid}-0"
            wait_for("the run", lambda: top(tool), tool)
            self.assertNotIn("scenarios", self.mode())
            self.assertIn("has one policy, so there are no scenarios", self.mode("x", status=1))


if __name__ == "__main__":
    unittest.main()
