#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`xauto monitor`: what it exports is what the run's report and the certificate say. Prometheus's text is read by prometheus_text.py, written
from the format's specification; by Prometheus's own Python client; and by promtool, where it is installed. /diagnostics is read by a program
with Cyclone's own types."""
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest

import pftrace
from common import APP, BIN, DRIVING, QUEUES, SOURCE, TESTAPP, XAUTO, activations, testapp_files, wait_for, xauto
from dds_test import DOMAIN, LOOPBACK, PLUGIN
from prometheus_text import parse, value_of

sys.path.append("/usr/lib/python3/dist-packages")  # where Debian's package is; this Python may be another one
try:
    from prometheus_client.parser import text_string_to_metric_families
except ImportError:  # scripts/setup.sh check installs it
    text_string_to_metric_families = None

PEER = BIN / "diagnostics_peer"
PAGE = SOURCE / "docs/monitoring.md"
GRAFANA = SOURCE / "packaging/grafana/xauto.json"
RATES = SOURCE / "examples/driving/rates.json"


class Monitored(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def start(self, command, **keywords):
        tool = subprocess.Popen([str(word) for word in command], stderr=subprocess.PIPE, text=True, **{"stdout": subprocess.DEVNULL, **keywords})
        self.addCleanup(self.end, tool)
        return tool

    def run_tool(self, *flags, program):
        return self.start([XAUTO, "run", *flags, "--activations", 0, "--out", self.folder / "report.json", "--", *program])

    def start_testapp(self, *app, deployment=QUEUES, more=(), **of_app):
        return self.run_tool(*testapp_files(str(self.folder), deployment, **of_app), *more, program=[TESTAPP, self.folder / "result", *app])

    @staticmethod
    def end(tool):
        if tool.poll() is None:
            tool.terminate()
        return tool.communicate(timeout=60)

    def report(self, tool):
        _, err = self.end(tool)
        self.assertIn(tool.returncode, (0, 1), err)
        return json.loads((self.folder / "report.json").read_text())["runs"][0]

    def monitor(self, *flags, **keywords):
        return self.start([XAUTO, "monitor", "--interval", "50ms", *flags], **keywords)

    def once(self, tool, *flags):
        done = xauto("monitor", "--run", f"{tool.pid}-0", "--wait", "30s", "--interval", "100ms", *flags)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def metrics(self, tool):
        text = self.once(tool)
        self.check(text)
        return parse(text)

    def check(self, text):
        """By those who wrote the format."""
        ours = parse(text)
        if text_string_to_metric_families is not None:
            theirs = {family.name: family for family in text_string_to_metric_families(text)}
            self.assertEqual({name.removesuffix("_total") for name in ours}, {name.removesuffix("_total") for name in theirs})
            for name, metric in ours.items():
                family = theirs.get(name) or theirs[name.removesuffix("_total")]
                self.assertEqual((family.type, family.documentation), (metric.type, metric.help))
                self.assertEqual([(s.name, s.labels, s.value) for s in family.samples], metric.samples)
        if shutil.which("promtool"):
            done = subprocess.run(["promtool", "check", "metrics"], input=text, capture_output=True, text=True, timeout=60)
            self.assertEqual((done.returncode, done.stdout, done.stderr), (0, "", ""))


class Prometheus(Monitored):
    def test_counts_are_those_of_the_report(self):
        tool = self.start_testapp("throw", "A", 5, period_us=20_000, deadline_us=1)
        wait_for("the activation that fails", lambda: activations(tool).get("C", 0) > 8, tool)
        seen = self.metrics(tool)
        report = self.report(tool)
        run = {"app": "testapp", "run": f"{tool.pid}-0"}
        self.assertEqual(value_of(seen, "xauto_run_info", platform="test", scheduling="xauto", **run), 1)
        self.assertEqual(value_of(seen, "xauto_module_failures_total", module="A"), 1)
        self.assertEqual(value_of(seen, "xauto_module_failures_total", module="B"), 0)
        for chain in report["chains"]:
            labels = {"chain": chain["name"], **run}
            results = value_of(seen, "xauto_chain_latency_seconds_count", **labels)
            self.assertGreater(results, 8 if chain["name"] == "src -> c1" else 0)
            longest = value_of(seen, "xauto_chain_longest_latency_seconds", **labels)
            self.assertLessEqual(longest, chain["latency_us"]["max"] / 1e6)
            self.assertGreater(longest, 0)
            # All are later than 1 us. (They are counted one by one, while they grow.)
            self.assertAlmostEqual(value_of(seen, "xauto_chain_deadline_misses_total", **labels), results, delta=2)
            self.assertEqual(value_of(seen, "xauto_chain_deadline_seconds", **labels), 1e-6)
            sum_s = value_of(seen, "xauto_chain_latency_seconds_sum", **labels)
            self.assertTrue(longest <= sum_s <= results * longest + 1, (longest, sum_s, results))
        self.assertEqual(value_of(seen, "xauto_release_lost_total"), 1)
        # A's, and C's of that release.
        self.assertEqual(value_of(seen, "xauto_assumption_violations_total", kind="lost_activation"), 2)

    def test_releases_one_at_a_time_have_a_worst_case_of_each_chain_until_a_job_is_too_long(self):
        tool = self.start_testapp("period", 200000)
        policy = json.loads((self.folder / "policy.json").read_text())
        claims = {c["name"]: c["worst_case_us"] for c in policy["chains"]}
        self.assertEqual(set(claims), {"src -> c1", "src -> d1"})
        wait_for("results", lambda: min(activations(tool).get(m, 0) for m in "CD") > 1, tool)
        seen = self.metrics(tool)
        if value_of(seen, "xauto_claim_stands") == 1:  # nobody stopped this machine for a job's time
            for name, us in claims.items():
                self.assertEqual(value_of(seen, "xauto_chain_worst_case_seconds", chain=name), us / 1e6)
                longest = value_of(seen, "xauto_chain_longest_latency_seconds", chain=name)
                slack = value_of(seen, "xauto_chain_slack_seconds", chain=name)
                self.assertAlmostEqual(slack, us / 1e6 - longest, places=6)
        self.end(tool)
        tool = self.start_testapp("period", 100000, "hang", "B", 5, 400)
        too_long = lambda: value_of(self.metrics(tool), "xauto_assumption_violations_total", kind="wcet_overrun")
        wait_for("a job that is too long", too_long, tool)
        seen = self.metrics(tool)
        self.assertEqual(value_of(seen, "xauto_claim_stands"), 0)
        self.assertNotIn("xauto_chain_worst_case_seconds", seen)
        self.assertNotIn("xauto_chain_slack_seconds", seen)
        self.assertRegex(self.once(tool, "--json"), "jobs outran their WCET|has not ended; its WCET is 1.00 ms")

    def test_nobody_schedules_so_nothing_is_claimed(self):
        tool = self.start_testapp(period_us=50_000, more=["--scheduling", "timeshare"])
        wait_for("results", lambda: activations(tool).get("C", 0) > 1, tool)
        seen = self.metrics(tool)
        self.assertNotIn("xauto_claim_stands", seen)
        self.assertNotIn("xauto_chain_worst_case_seconds", seen)
        self.assertNotIn("xauto_coordinator_decisions_total", seen)

    def test_modules_in_processes_and_one_that_dies(self):
        tool = self.start_testapp(period_us=20_000, more=["--isolate"])
        wait_for("counts of every module", lambda: all(activations(tool).get(m, 0) > 0 for m in "ABCD"), tool)
        seen = self.metrics(tool)
        self.assertGreater(value_of(seen, "xauto_xpu_busy_seconds_total", xpu="npu0"), 0)  # by a process that is not the hub
        self.assertEqual(value_of(seen, "xauto_assumption_violations_total", kind="process_death"), 0)
        member = next(pid for pid in self.children(tool) if b"XAUTO_PROCESS=" in pathlib.Path(f"/proc/{pid}/environ").read_bytes())
        os.kill(member, signal.SIGKILL)
        wait_for("its death", lambda: value_of(self.metrics(tool), "xauto_assumption_violations_total", kind="process_death"), tool)

    def test_a_coordinator_and_an_emulator_that_are_started_again_are_deaths_too(self):
        tool = self.start_testapp("emulated", 1000, period_us=50_000, more=["--emulate"])
        wait_for("results", lambda: activations(tool).get("C", 0) > 1, tool)
        deaths = lambda: value_of(self.metrics(tool), "xauto_assumption_violations_total", kind="daemon_death")
        self.assertEqual(deaths(), 0)
        for n, name in enumerate(("xauto-emud", "xauto-coordinat")):
            child = next(p for p in self.children(tool) if pathlib.Path(f"/proc/{p}/comm").read_text().strip() == name)
            os.kill(child, signal.SIGKILL)
            wait_for("its death", lambda: deaths() == n + 1, tool)
        self.assertEqual(value_of(self.metrics(tool), "xauto_claim_stands"), 0)
        broken = self.report(tool)["claims"]["broken"]
        self.assertIn("xauto-emud died and was restarted", broken)
        self.assertRegex(" ".join(broken), r"xauto-coordinator of (cpu0|npu0) died and was restarted")

    @staticmethod
    def children(tool):
        return [int(pid) for pid in pathlib.Path(f"/proc/{tool.pid}/task/{tool.pid}/children").read_text().split()]

    def test_busy_time_and_suspensions_are_those_of_the_xpu(self):
        # Each XNode works for 3 ms on an emulated XPU: that is the least it has it, however long the machine stands still.
        began = time.monotonic()
        tool = self.start_testapp("emulated", 3000, period_us=100_000, more=["--emulate"])
        wait_for("results", lambda: activations(tool).get("C", 0) > 3, tool)
        seen = self.metrics(tool)
        done = {m: value_of(seen, "xauto_module_activations_total", module=m) for m in "ABCD"}
        jobs = {"cpu0": done["A"] + done["C"] + done["D"], "npu0": done["A"] + done["B"]}
        for xpu, count in jobs.items():
            self.assertGreater(count, 6)
            # Of each module one activation may be counted, and its job's time not yet.
            busy = value_of(seen, "xauto_xpu_busy_seconds_total", xpu=xpu)
            self.assertGreaterEqual(busy, 0.003 * (count - 3))
            self.assertLess(busy, time.monotonic() - began)  # it has one job at a time
        self.end(tool)
        tool = self.run_tool("--app", APP, "--platform", "small", "--emulate", "--policy",
                             self.driving_policy("--method", "heft"), "--trace-out", self.folder / "t.pftrace",
                             program=[DRIVING])
        wait_for("a suspension", lambda: self.suspensions(self.metrics(tool)), tool)
        seen = self.suspensions(self.metrics(tool))
        self.report(tool)
        # The trace goes back 30 s, which is all of this run unless the machine stood still.
        trace = pftrace.Trace((self.folder / "t.pftrace").read_bytes())
        told = sum((s.category, s.name) == ("state", "suspended") for s in trace.slices)
        self.assertLessEqual(seen, told)

    @staticmethod
    def suspensions(seen):
        return sum(value for _, _, value in seen["xauto_xpu_suspensions_total"].samples)

    def driving_policy(self, *how):
        path = self.folder / "driving.json"
        done = xauto("solve", "--app", APP, "--platform", "small", *how, "--out", path)
        self.assertEqual(done.returncode, 0, done.stderr)
        return path

    def test_chains_of_a_policy_of_keys(self):
        done = xauto("solve", "--app", RATES, "--platform", "small", "--max-evaluations", 3000, "--threads", 1, "--time-limit", "60s",
                     "--out", self.folder / "policy.json")
        self.assertEqual(done.returncode, 0, done.stderr)
        claims = {c["name"]: c for c in json.loads((self.folder / "policy.json").read_text())["chains"]}
        (self.folder / "queues.json").write_text(json.dumps({"schema": "xauto.deployment", "version": 1, "app": "driving-rates", **QUEUES}))
        tool = self.run_tool("--app", RATES, "--platform", "small", "--emulate", "--policy", self.folder / "policy.json", "--deployment",
                             self.folder / "queues.json", program=[BIN / "driving-rates"])

        def chains_seen():
            seen = self.metrics(tool)
            counts = [value_of(seen, "xauto_chain_latency_seconds_count", chain=name) for name in claims]
            return all(counts) and seen
        seen = wait_for("a result of every chain", chains_seen, tool)
        statuses = {s["name"]: s for s in json.loads(self.once(tool, "--json"))["status"]}
        for name, claim in claims.items():
            self.assertIsNotNone(value_of(seen, "xauto_chain_over_worst_case_total", chain=name))
            values = statuses[f"xauto/driving-rates: chain {name}"]["values"]
            if values["claim"] == "stands":
                self.assertEqual(float(values["worst_case_ms"]), claim["worst_case_us"] / 1000)
            else:
                self.assertEqual(values["worst_case_ms"], "n/a")
            if value_of(seen, "xauto_claim_stands"):
                self.assertEqual(value_of(seen, "xauto_chain_worst_case_seconds", chain=name), claim["worst_case_us"] / 1e6)

    def test_scenarios_of_a_run_with_tables_and_the_boards_queries(self):
        app = json.loads(pathlib.Path(APP).read_text())
        for xnode in app["xnodes"]:  # with room: a busy machine makes jobs longer
            xnode["wcet_us"] = {kind: 4 * us for kind, us in xnode["wcet_us"].items()}
        scenarios = [{"name": "nominal"}, {"name": "GPU at half", "wcet_scale_pct": {"gpu": 200}}]
        (self.folder / "app.json").write_text(json.dumps(app))
        (self.folder / "scenarios.json").write_text(json.dumps({"schema": "xauto.scenarios", "version": 1, "app": "driving", "scenarios": scenarios}))
        done = xauto("solve", "--app", "app.json", "--platform", "small", "--scenarios", "scenarios.json", "--tables", 2, "--time-limit", "4s",
                     "--out", "tables.json", cwd=self.folder)
        self.assertIn(done.returncode, (0, 1), done.stderr)
        tables = json.loads((self.folder / "tables.json").read_text())
        tool = self.run_tool("--app", self.folder / "app.json", "--platform", "small", "--emulate", "--policy", self.folder / "tables.json",
                             program=[DRIVING])
        wait_for("releases", lambda: (value_of(self.metrics(tool), "xauto_releases_total") or 0) > 5, tool)
        done = xauto("param", "scenario", "--run", f"{tool.pid}-0", "GPU at half")
        self.assertEqual(done.returncode, 0, done.stderr)
        wait_for("the scenario", lambda: value_of(self.metrics(tool), "xauto_scenario_active", scenario="GPU at half") == 1, tool)
        seen = self.metrics(tool)
        self.assertEqual(value_of(seen, "xauto_scenario_active", scenario="nominal"), 0)
        for chain in (c["name"] for c in tables["tables"][0]["chains"]):
            claims = [c["worst_case_us"] for of in tables["tables"] + tables.get("handovers", []) for c in of["chains"]
                      if c["name"] == chain and "worst_case_us" in c]
            if value_of(seen, "xauto_claim_stands"):
                self.assertEqual(value_of(seen, "xauto_chain_worst_case_seconds", chain=chain), max(claims) / 1e6)
        other = self.run_tool("--app", APP, "--platform", "small", "--emulate", "--policy",
                              self.driving_policy("--max-evaluations", 500, "--time-limit", "60s"), program=[DRIVING])
        wait_for("releases of another app", lambda: (value_of(self.metrics(other), "xauto_releases_total") or 0) > 5, other)
        self.board_asks_for_what_there_is(seen, self.metrics(other))
        page = set(re.findall(r"`(xauto_\w+)`", PAGE.read_text()))
        exported = {re.sub("^xauto_release_(?!s_total)", "xauto_chain_", name) for name in {*seen, *self.metrics(other)}}
        self.assertLessEqual(exported, page, "not in docs/monitoring.md")

    def test_a_job_that_is_too_long_for_its_scenario_by_less_than_is_told_breaks_the_claim(self):
        # A stage takes 3 ms of 2.6: past the emulator's part (2 % and 0.1 ms), and less than 1 ms past it.
        arguments = testapp_files(str(self.folder), QUEUES)
        app = json.loads((self.folder / "app.json").read_text())
        for xnode in app["xnodes"]:
            xnode["wcet_us"] = {kind: 2600 for kind in xnode["wcet_us"]}
        (self.folder / "app.json").write_text(json.dumps(app))
        scenarios = {"schema": "xauto.scenarios", "version": 1, "app": "testapp", "scenarios": [{"name": "nominal"}]}
        (self.folder / "scenarios.json").write_text(json.dumps(scenarios))
        done = xauto("solve", "--app", "app.json", "--platform", "platform.json", "--scenarios", "scenarios.json", "--tables", 1,
                     "--time-limit", "2s", "--out", "policy.json", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        tool = self.run_tool(*arguments, "--emulate", program=[TESTAPP, self.folder / "result", "period", "100000", "emulated", "3000"])
        wait_for("overruns", lambda: value_of(self.metrics(tool), "xauto_assumption_violations_total", kind="wcet_overrun"), tool)
        self.assertEqual(value_of(self.metrics(tool), "xauto_claim_stands"), 0)
        self.assertIn("jobs outran the WCET of their scenario", self.once(tool, "--json"))
        report = self.report(tool)
        self.assertRegex(" ".join(report["claims"]["broken"]), r"[1-9]\d* of \d+ jobs outran the WCET of their scenario, \w+ by \d+\.\d{3} ms")
        over = sum(x["over_wcet"] for x in report["limited_xnodes"])
        self.assertIn(f"{over} of ", " ".join(report["claims"]["broken"]))

    def board_asks_for_what_there_is(self, *exported):
        """Each metric and label in the Grafana board's queries is in what these runs export."""
        board = json.loads(GRAFANA.read_text())
        queries = [t["expr"] for p in board["panels"] for t in p["targets"]]
        self.assertGreater(len(queries), 15)
        claimed = {"worst_case_seconds", "slack_seconds"}  # absent where nothing is claimed of this run
        labels_of = {}
        for metric in (metric for seen in exported for metric in seen.values()):
            for name, labels, _ in metric.samples:
                labels_of.setdefault(name, set()).update(labels)
        for panel in board["panels"]:
            for target in panel["targets"]:
                for metric in re.findall(r"\bxauto_\w+", target["expr"]):
                    if any(metric.endswith(end) for end in claimed) and metric not in labels_of:
                        self.assertTrue(self.declared(metric), metric)
                        continue
                    self.assertIn(metric, labels_of, target["expr"])
                    words = re.findall(r"\{\{(\w+)\}\}", target["legendFormat"]) + re.findall(r"(\w+)=~", target["expr"])
                    for group in re.findall(r"by \(([^)]*)\)", target["expr"]):
                        words += group.split(", ")
                    self.assertLessEqual(set(words), labels_of[metric], target)
        if shutil.which("promtool"):
            rules = [{"record": f"board:query_{i}", "expr": q.replace("$__rate_interval", "1m").replace("$__range", "1h")} for i, q in enumerate(queries)]
            alerts = re.findall(r"^    (\S.*xauto_.* > 0.*|xauto_\w+ == 0)$", PAGE.read_text(), re.M)
            self.assertEqual(len(alerts), 3)
            rules += [{"alert": f"page_{i}", "expr": alert} for i, alert in enumerate(alerts)]
            path = self.folder / "rules.yml"  # YAML has JSON
            path.write_text(json.dumps({"groups": [{"name": "board", "rules": rules}]}))
            done = subprocess.run(["promtool", "check", "rules", path], capture_output=True, text=True, timeout=60)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)

    @staticmethod
    def declared(metric):
        """Whether the exporter knows the name: prefix and ending are put together there."""
        text = (SOURCE / "tools/xauto/metrics.cc").read_text()
        return metric in text or re.sub("^xauto_(chain|release)", "", metric) in text


class Outputs(Monitored):
    def test_a_file_is_whole_at_any_time_and_goes_with_the_monitor(self):
        path = self.folder / "xauto.prom"
        monitor = self.monitor("--metrics-file", path)
        wait_for("the file", path.exists, monitor)
        parse(path.read_text())
        tool = self.start_testapp(period_us=20_000)
        mine = f"{tool.pid}-0"
        wait_for("the run in it", lambda: value_of(parse(path.read_text()), "xauto_run_info", run=mine), monitor)
        for _ in range(300):
            parse(path.read_text())
        self.check(path.read_text())
        self.assertEqual([p.name for p in self.folder.glob("xauto.prom*")], ["xauto.prom"])
        self.end(tool)
        wait_for("its end", lambda: value_of(parse(path.read_text()), "xauto_run_info", run=mine) is None, monitor)
        self.end(monitor)
        self.assertEqual(monitor.returncode, 0)
        self.assertEqual(list(self.folder.glob("*xauto.prom*")), [])

    def test_a_file_that_cannot_be_written(self):
        done = xauto("monitor", "--metrics-file", self.folder / "no/xauto.prom")
        self.assertEqual(done.returncode, 1)
        self.assertIn("cannot be written: No such file or directory", done.stderr)
        self.assertIn(f"--metrics-file {self.folder}/no/xauto.prom", done.stderr)

    def test_a_monitor_that_is_stopped_or_killed_disturbs_no_run(self):
        monitor = self.monitor("--metrics-file", self.folder / "m.prom")
        tool = self.start_testapp(period_us=20_000)
        wait_for("the run", lambda: (self.folder / "m.prom").exists() and f'run="{tool.pid}-0"' in (self.folder / "m.prom").read_text(), monitor)
        os.kill(monitor.pid, signal.SIGSTOP)
        count = activations(tool)["C"]
        wait_for("more results", lambda: activations(tool)["C"] > count, tool)
        report = self.report(tool)
        self.assertTrue(report["complete"])
        os.kill(monitor.pid, signal.SIGCONT)
        monitor.kill()

    def test_a_monitor_of_one_run_ends_with_it(self):
        tool = self.start_testapp(period_us=20_000)
        monitor = self.monitor("--run", f"{tool.pid}-0", "--wait", "30s", "--metrics-file", self.folder / "one.prom")
        wait_for("the file", (self.folder / "one.prom").exists, monitor)
        self.end(tool)
        self.assertEqual(monitor.wait(timeout=60), 0)
        done = xauto("monitor", "--run", "1-99", "--wait", "0s")
        self.assertEqual(done.returncode, 2)
        self.assertIn("no run '1-99' is going on", done.stderr)


@unittest.skipUnless(PLUGIN.exists() and PEER.exists(), "no Cyclone DDS here: scripts/setup.sh transport")
class Diagnostics(Monitored):
    def setUp(self):
        super().setUp()
        os.environ["CYCLONEDDS_URI"], os.environ["ROS_DOMAIN_ID"] = LOOPBACK, DOMAIN
        self.peer = subprocess.Popen([PEER], stdout=subprocess.PIPE, text=True)
        self.addCleanup(lambda: (self.peer.kill(), self.peer.communicate()))
        self.arrays = []
        threading.Thread(target=self.listen, daemon=True).start()

    def listen(self):
        for line in self.peer.stdout:
            self.arrays.append(json.loads(line))

    def status(self, name):
        """Of the last message that has it."""
        for array in reversed(self.arrays):
            for status in array["status"] if array != "ready" else ():
                if status["name"] == name:
                    return status
        return {"level": None, "values": {}}

    def test_a_reader_of_ros_2s_type_sees_each_chain_and_the_end_of_the_run(self):
        tool = self.start_testapp(period_us=200_000, deadline_us=3_600_000_000)
        monitor = self.monitor("--diagnostics", "--run", f"{tool.pid}-0", "--wait", "30s")  # other tests have runs, too
        chain, claims = "xauto/testapp: chain src -> c1", "xauto/testapp: worst cases"
        wait_for("a result", lambda: self.status(chain)["level"] == 0, monitor)
        array = next(a for a in reversed(self.arrays) if a != "ready")
        self.assertLess(abs(array["stamp"] - time.time()), 60)
        status = self.status(chain)
        self.assertEqual(list(status["values"])[:4], ["is_processing_time_ms_in_expected_range", "processing_time_ms",
                                                      "is_consecutive_processing_delay_in_range", "consecutive_processing_delay_ms"])
        self.assertGreater(float(status["values"]["processing_time_ms"]), 0)
        self.assertEqual(status["hardware_id"], "test")
        names = {s["name"] for s in array["status"]}
        self.assertLessEqual({"xauto/testapp: releases", claims, "xauto/testapp: module A", "xauto/testapp: XPU npu0"}, names)
        self.end(tool)
        wait_for("its end", lambda: self.status(chain)["message"] == "the run has ended")
        self.assertEqual({(s["level"], s["message"]) for s in self.arrays[-1]["status"]}, {(3, "the run has ended")})

    def test_deadlines_are_errors_and_a_monitor_that_ends_says_so(self):
        tool = self.start_testapp(period_us=50_000, deadline_us=1)
        monitor = self.monitor("--diagnostics", "--run", f"{tool.pid}-0", "--wait", "30s")
        chain = "xauto/testapp: chain src -> c1"
        late = "later than the deadline of 0.001 ms"

        def missed():
            return [s for array in self.arrays if array != "ready" for s in array["status"] if s["name"] == chain and late in s["message"]]
        for status in wait_for("misses", missed, monitor):
            self.assertEqual(status["level"], 2)
            self.assertEqual(status["values"]["is_processing_time_ms_in_expected_range"], "False")
        wait_for("a delay that goes on", lambda: self.status(chain)["values"].get("is_consecutive_processing_delay_in_range") == "False", monitor)
        self.end(monitor)
        wait_for("the last word", lambda: self.status(chain)["message"] == "xauto monitor has ended")
        self.assertEqual(self.status(chain)["level"], 3)

    def test_a_domain_that_is_none_is_refused(self):
        done = subprocess.run([XAUTO, "monitor", "--diagnostics"], env={**os.environ, "ROS_DOMAIN_ID": "x"}, capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, 2)
        self.assertIn("ROS_DOMAIN_ID is 'x'", done.stderr)


if __name__ == "__main__":
    unittest.main()
