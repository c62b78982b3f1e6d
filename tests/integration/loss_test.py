#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Variants and optional modules: from the program (apps/lossapp.cc) by profile, solve and check to a run in which every
release has what its table says. What ran is told by the app itself, a line per activation."""
import collections
import json
import pathlib
import subprocess
import tempfile
import unittest

import pftrace
from common import BIN, QUEUES, XAUTO, top, wait_for, xauto

LOSSAPP = str(BIN / "lossapp")
SCENARIOS = [{"name": "nominal"},
             {"name": "slow", "wcet_scale_pct": {"gpu": 150}, "degraded": True},
             {"name": "slower", "wcet_scale_pct": {"gpu": 300}, "degraded": True},
             {"name": "slowest", "wcet_scale_pct": {"gpu": 500}, "degraded": True}]
MS = {"see.infer": 15, "act.go": 2, "steer.go": 2, "show.draw": 14, "log.write": 12, "small": 6, "tiny": 3}  # WCETs, above what jobs take
RELEASE_MS = 60  # the period
QUALITY = {"full": 100, "small": 60, "tiny": 30}


def with_round_times(app):
    """With room: a machine that stands still meanwhile, also while it is profiled, changes no loss."""
    for source in app["sources"]:
        source["jitter_us"] = 2000
    for xnode in app["xnodes"]:
        for of in [xnode, *xnode.get("variants", [])]:
            of["wcet_us"] = {kind: 1000 * MS[of["name"]] for kind in of["wcet_us"]}
            of.pop("typical_us", None)


def least_loss(gpu):
    """Of all that can be left out, with the GPU so many times as slow. see, then show and log, beside act."""
    fits = []
    for variant, quality in QUALITY.items():
        see = gpu * MS[{"full": "see.infer"}.get(variant, variant)]
        for off, rest in (0, gpu * MS["show.draw"] + MS["log.write"]), (1, gpu * MS["show.draw"]), (2, 0):
            if see + max(MS["act.go"], rest) <= RELEASE_MS:
                fits.append(100 * off + 100 - quality)
    return min(fits)


# What the machine says in the tests of `when`: each scenario holds from a clock on, as `profile --merge` writes it.
CLOCKS = {"nominal": 1000, "slow": 666, "slower": 333, "slowest": 200}


class ByTheMachine:
    """What counts at full clock, and outside of every scenario. `args`: the program's."""
    args = ()

    @classmethod
    def write(cls, name, value):
        (cls.folder / name).write_text(json.dumps(value))

    def run_at(self, clock, *flags, script=None):
        """The report, and stderr; with `when` unless the clock is None."""
        file = self.folder / "clock"
        tables = json.loads(json.dumps(self.tables))
        if clock is not None:
            file.write_text(f"{clock}\n")
            for scenario in tables["scenarios"]:
                scenario["when"] = [{"file": str(file), "at_least": CLOCKS[scenario["name"]]}]
        self.write("when.json", tables)
        if script:
            self.write("script.json", {"schema": "xauto.emulation", "version": 1, "steps": script})
            flags += ("--emulate-script", "script.json")
        done = xauto("run", "--app", "app.json", "--platform", "small", "--emulate", "--policy", "when.json", "--deployment",
                     "deployment.json", "--json", *flags, "--", LOSSAPP, "/dev/null", *self.args,
                     cwd=self.folder)
        self.assertIn(done.returncode, (0, 1), done.stderr)
        return json.loads(done.stdout)["runs"][0], done.stderr

    def off(self, report):
        return {m["name"]: m.get("off", 0) for m in report["modules"]}

    def test_at_full_clock_all_hold_and_nothing_is_off(self):
        report, _ = self.run_at(1000, "--duration", "2s")
        # Others may count for jobs that this machine makes longer.
        self.assertEqual([s for s in report["switches"] if s["why"] == "machine"], [])
        if report["switches"] == []:
            self.assertEqual(set(self.off(report).values()), {0})
        report, _ = self.run_at(250, "--duration", "1s")
        self.assertEqual([s["to"] for s in report["switches"] if s["why"] == "machine"], ["slowest"])

    def test_a_clock_below_all_is_named_with_the_limit_and_loses_most(self):
        report, err = self.run_at(100, "--duration", "1s")
        self.assertEqual([s["to"] for s in report["switches"] if s["why"] == "machine"], ["slowest"])
        self.assertGreater(self.off(report)["log"], 0)
        self.assertGreater(self.off(report)["show"], 0)
        words = f"those of no scenario: {self.folder}/clock is 100, every scenario needs at least 200; 'slowest' is the least that"
        self.assertIn(words, err)
        self.assertIn(words, str(report["claims"]["broken"]))

    def test_a_job_outside_of_every_scenario_loses_most(self):
        report, err = self.run_at(None, "--duration", "3s", script=[{"at_us": 600_000, "speed_pct": {"cpu": 4}}])
        outside = [s["to"] for s in report["switches"] if s["why"] == "outside"]
        self.assertEqual(set(outside), {"slowest"}, report["switches"])
        self.assertGreater(self.off(report)["log"], 0)
        self.assertGreater(self.off(report)["show"], 0)
        self.assertIn("outside of every scenario: XNode", err)


def of_one_release(app):
    """The same with sources that have no rate: they release together, one release at a time."""
    return {**{key: value for key, value in app.items() if key not in ("chains", "samples", "clocks")},
            "sources": [{"name": source["name"]} for source in app["sources"]]}


class Loss(ByTheMachine, unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        done = xauto("profile", "--platform", "small", "--emulate", "--repetitions", 3, "--warmup", 0, "--out", "profile.json",
                     "--app-out", "measured.json", "--", LOSSAPP, "profiled", cwd=cls.folder)
        assert done.returncode == 0, done.stderr
        cls.table = done.stdout
        cls.app = json.loads((cls.folder / "measured.json").read_text())
        with_round_times(cls.app)
        cls.write("app.json", {**of_one_release(cls.app), "deadline_us": 1000 * RELEASE_MS})
        cls.write("scenarios.json", {"schema": "xauto.scenarios", "version": 1, "app": "lossapp", "scenarios": SCENARIOS})
        cls.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "lossapp", **QUEUES})
        cls.solved = xauto("solve", "--app", "app.json", "--platform", "small", "--scenarios", "scenarios.json", "--tables", 4,
                           "--time-limit", "4s", "--out", "tables.json", cwd=cls.folder)
        cls.tables = json.loads((cls.folder / "tables.json").read_text())
        cls.serves = {s["scenario"]: next(t for t in cls.tables["tables"] if t["name"] == s["table"]) for s in cls.tables["serves"]}

    def check(self, tables):
        self.write("other.json", tables)
        return xauto("check", "--app", "app.json", "--platform", "small", "--policy", "other.json", "--json", cwd=self.folder)

    def test_profile_measures_each_variant_and_app_json_has_it(self):
        told = collections.Counter(line.split(" ")[0] + "".join(line.split(" ")[2:])
                                   for line in (self.folder / "profiled").read_text().splitlines())
        self.assertEqual(told["seesmall"], 3)
        self.assertEqual(told["seetiny"], 3)
        see = json.loads((self.folder / "profile.json").read_text())["xnodes"][0]
        self.assertEqual([(v["name"], v["quality_pct"], v["on"]["gpu0"]["count"]) for v in see["variants"]],
                         [("small", 60, 3), ("tiny", 30, 3)])
        self.assertLess(see["variants"][0]["on"]["gpu0"]["min_us"], see["on"]["gpu0"]["min_us"])
        self.assertIn("small", self.table)
        self.assertEqual([m["name"] for m in self.app["modules"] if m["optional"]], ["show", "log"])

    def test_the_least_loss_that_keeps_the_deadline(self):
        losses = []
        for scenario in SCENARIOS:
            table = self.serves[scenario["name"]]
            losses.append(100 * len(table.get("off", [])) + sum(100 - QUALITY[v] for v in table.get("variants", {}).values()))
            self.assertEqual(losses[-1], least_loss(scenario.get("wcet_scale_pct", {}).get("gpu", 100) / 100), (scenario, table))
        self.assertEqual(losses, sorted(losses))
        self.assertEqual(len(set(losses)), 3, losses)
        self.assertEqual(self.serves["slower"]["off"], ["log"])  # what fires it ends the release then
        self.assertIn(f"loses {losses[-1]} %", self.solved.stdout)
        # Changes miss the deadline: the release before is of a scenario in which nothing was lost.
        self.assertEqual(self.solved.returncode, 1)
        answer = json.loads(xauto("check", "--app", "app.json", "--platform", "small", "--policy", "tables.json", "--json",
                                  cwd=self.folder).stdout)
        self.assertEqual(answer["lies"], [])

    def test_what_a_table_may_not_lose_is_refused(self):
        broken = json.loads(json.dumps(self.tables))
        broken["scenarios"][2]["degraded"] = False
        self.assertIn("scenario 'slower' is not degraded", self.check(broken).stderr)
        broken = json.loads(json.dumps(self.tables))
        table = next(t for t in broken["tables"] if t["name"] == self.serves["slowest"]["name"])
        def without(*modules):
            """All of the others are somewhere, so that this alone is wrong."""
            table["off"] = list(modules)
            for xnode in table["xnodes"]:
                xnode.pop("xpu", None)
                if xnode["name"].split(".")[0] not in modules:
                    xnode["xpu"] = "gpu0" if xnode["name"] in ("see.infer", "show.draw") else "cpu0"
            return self.check(broken).stderr
        self.assertIn("module 'show' is off, and module 'log', which waits for it, is not", without("show"))
        self.assertIn("a module on the way of chain 'camera -> act.go' is off", without("act"))
        without("log", "show")
        table["variants"] = {"see.infer": "huge"}
        self.assertIn("XNode 'see.infer' has no variant 'huge'", self.check(broken).stderr)

    def test_the_program_has_to_have_the_variant(self):
        app = json.loads((self.folder / "app.json").read_text())
        for variant in app["xnodes"][0]["variants"]:
            variant["name"] = "no_" + variant["name"]
        self.write("renamed.json", app)
        done = xauto("solve", "--app", "renamed.json", "--platform", "small", "--scenarios", "scenarios.json", "--tables", 4,
                     "--time-limit", "2s", "--out", "renamed_tables.json", cwd=self.folder)
        self.assertEqual(done.returncode, 1, done.stderr)
        done = xauto("run", "--app", "renamed.json", "--platform", "small", "--emulate", "--policy", "renamed_tables.json",
                     "--activations", 5, "--", LOSSAPP, cwd=self.folder)
        self.assertEqual(done.returncode, 2)
        self.assertIn("has no implementation for 'gpu' in variant 'no_", done.stderr)

    def switch_about(self, *flags):
        (self.folder / "ran").unlink(missing_ok=True)
        with open(self.folder / "out", "w") as out, open(self.folder / "err", "w") as err:
            tool = subprocess.Popen(
                [XAUTO, "run", "--app", "app.json", "--platform", "small", "--emulate", "--policy", "tables.json",
                 "--activations", "0", "--deployment", "deployment.json", "--json", "--trace-out", "t.pftrace", *flags, "--",
                 LOSSAPP, str(self.folder / "ran")], cwd=self.folder, stdout=out, stderr=err)
        self.addCleanup(lambda: (tool.kill(), tool.wait()))
        run = f"{tool.pid}-0"

        def released():
            return top(tool).get("releases", 0)
        wait_for("releases", lambda: released() > 2, tool)
        for name in ["slower", "slowest", "nominal", "slowest", "slower", "slow", "slower"]:
            self.assertEqual(xauto("param", "scenario", "--run", run, name).returncode, 0)
            at = released()
            wait_for("a release after the wish", lambda: released() > at + 2, tool)
        tool.terminate()
        self.assertEqual(tool.wait(timeout=60), 0, (self.folder / "err").read_text())
        return json.loads((self.folder / "out").read_text())["runs"][0]

    def judge(self, report):
        """Each release ran what its table has, no more and no less, in the variant that it has there."""
        ran = collections.defaultdict(dict)
        for line in (self.folder / "ran").read_text().splitlines():
            module, number, *variant = line.split(" ")
            self.assertNotIn(module, ran[int(number)], "twice")
            ran[int(number)][module] = variant
        modules = {m["name"]: m for m in report["modules"]}
        # Releases that come much too late are left out: on a machine that stands still, and else none.
        lost = modules["act"]["dropped"]
        if lost == 0:
            self.assertEqual(sorted(ran), list(range(modules["act"]["activations"])))
        by_name, off = {t["name"]: t for t in self.tables["tables"]}, collections.Counter()
        table, of_table = self.serves["nominal"], collections.Counter()
        changes = {s["release"]: by_name[s["table"]] for s in report["switches"]}
        for n in range(max(ran) + 1):
            table = changes.get(n, table)
            if n not in ran:
                continue
            of_table[table["name"]] += 1
            off.update(table.get("off", []))
            self.assertEqual(set(ran[n]), {"see", "act", "show", "log"} - set(table.get("off", [])), n)
            self.assertEqual(ran[n]["see"], [table.get("variants", {}).get("see.infer", "full")], n)
        # All three, but where jobs that this machine makes longer ask for more.
        self.assertGreater(len(of_table), 1, of_table)
        for name, module in modules.items():
            self.assertEqual(module["activations"], sum(name in modules_of for modules_of in ran.values()), name)
            self.assertEqual(module["failed"], 0, name)
            self.assertEqual(module["activations"] + module["dropped"] + module.get("off", 0), len(ran) + lost, name)
            self.assertLessEqual(abs(module.get("off", 0) - off[name]), lost, name)
        claims = report["claims"]
        if claims["exceeded"] and not claims["broken"]:  # our fault, but where what others took is as long (docs/claims.md)
            over = [chain["exceeded_by"] for chain in report["chains"] if chain["exceeded"]]
            longest = max(one["latency_us"] - one["worst_case_us"] for one in over)
            taken = sum(one["us"] for one in claims["time_taken"] if not one["what"].endswith("in all") and "in all (" not in one["what"])
            self.assertGreaterEqual(taken, longest, (claims, over))

    def test_each_release_runs_what_its_table_has(self):
        self.judge(self.switch_about())

    def test_in_processes_of_their_own(self):
        self.judge(self.switch_about("--isolate"))


class LossByKeys(ByTheMachine, unittest.TestCase):
    """The same with a loop of another rate beside it: tables of keys, and no release waits for a change."""
    args = ("rates",)
    SLOWER = {"nominal": 100, "slow": 150, "slower": 290, "slowest": 500}

    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        done = xauto("profile", "--platform", "small", "--emulate", "--repetitions", 3, "--warmup", 0, "--out", "profile.json",
                     "--app-out", "app.json", "--", LOSSAPP, "profiled", "rates", cwd=cls.folder)
        assert done.returncode == 0, done.stderr
        app = json.loads((cls.folder / "app.json").read_text())
        with_round_times(app)
        app["chains"] = [{"name": "act", "from": "camera", "to": "act.go", "deadline_us": 1000 * RELEASE_MS},
                         {"name": "log", "from": "camera", "to": "log.write", "deadline_us": 1000 * RELEASE_MS},
                         {"name": "steer", "from": "camera", "to": "steer.go"}]
        cls.write("app.json", app)
        cls.write("scenarios.json", {"schema": "xauto.scenarios", "version": 1, "app": "lossapp", "scenarios": [
            {"name": name, "wcet_scale_pct": {"gpu": pct}, **({"degraded": True} if pct > 100 else {})}
            for name, pct in cls.SLOWER.items()]})
        cls.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "lossapp", **QUEUES})
        cls.solved = xauto("solve", "--app", "app.json", "--platform", "small", "--scenarios", "scenarios.json", "--tables", 4,
                           "--time-limit", "6s", "--out", "tables.json", cwd=cls.folder)
        assert cls.solved.returncode in (0, 1), cls.solved.stderr  # 1: a change may miss a deadline
        cls.tables = json.loads((cls.folder / "tables.json").read_text())
        cls.serves = {s["scenario"]: next(t for t in cls.tables["tables"] if t["name"] == s["table"]) for s in cls.tables["serves"]}

    def test_the_least_loss_that_keeps_the_deadlines(self):
        for name, pct in self.SLOWER.items():
            table = self.serves[name]
            lost = 100 * len(table.get("off", [])) + sum(100 - QUALITY[v] for v in table.get("variants", {}).values())
            self.assertEqual(lost, least_loss(pct / 100), (name, table))
            chains = [c["name"] for c in table["chains"]]
            self.assertEqual(chains, [c for c in ("act", "log", "steer") if c != "log" or "log" not in table.get("off", [])])
        self.assertEqual(self.serves["slower"]["off"], ["log"])
        self.assertEqual(self.serves["slowest"]["off"], ["log", "show"])
        self.assertIn("loses 240 %", self.solved.stdout)
        answer = json.loads(xauto("check", "--app", "app.json", "--platform", "small", "--policy", "tables.json", "--json",
                                  cwd=self.folder).stdout)
        self.assertEqual(answer["lies"], [])

    def switch_about(self, *flags):
        (self.folder / "ran").unlink(missing_ok=True)
        with open(self.folder / "out", "w") as out, open(self.folder / "err", "w") as err:
            tool = subprocess.Popen(
                [XAUTO, "run", "--app", "app.json", "--platform", "small", "--emulate", "--policy", "tables.json",
                 "--activations", "0", "--deployment", "deployment.json", "--json", *flags, "--", LOSSAPP,
                 str(self.folder / "ran"), "rates"], cwd=self.folder, stdout=out, stderr=err)
        self.addCleanup(lambda: (tool.kill(), tool.wait()))
        run = ("--run", f"{tool.pid}-0", "--wait", "10s", "--json")
        released = lambda: top(tool).get("releases", 0)
        wait_for("releases", lambda: released() > 10, tool)
        asked = ["slower", "slowest", "nominal", "slowest", "slow", "slower"]
        for name in asked:
            self.assertEqual(xauto("param", "scenario", *run, name).returncode, 0)
            at = released()
            wait_for("releases after the wish", lambda: released() > at + 20, tool)
        tool.terminate()
        self.assertEqual(tool.wait(timeout=60), 0, (self.folder / "err").read_text())
        report = json.loads((self.folder / "out").read_text())["runs"][0]
        ran = collections.defaultdict(dict)
        for line in (self.folder / "ran").read_text().splitlines():
            module, number, *variant = line.split(" ")
            if module != "steer":
                ran[int(number)][module] = variant
        # An activation is of one table in all of its modules; and tables come in the order of the wishes. (Of two that
        # lose the same nothing here can tell which it was.)
        loses = {t["name"]: (frozenset(t.get("off", [])), t.get("variants", {}).get("see.infer", "full"))
                 for t in self.tables["tables"]}
        had = [(frozenset({"see", "act", "show", "log"} - set(modules)), modules["see"][0]) for _, modules in sorted(ran.items())]
        self.assertLessEqual(set(had), set(loses.values()))
        changes = [t for i, t in enumerate(had) if i == 0 or had[i - 1] != t]
        rest = iter([loses[self.serves["nominal"]["name"]]] + [loses[s["table"]] for s in report["switches"]])
        self.assertTrue(all(any(t == s for s in rest) for t in changes), (changes, report["switches"]))
        # Seven. Where jobs that this machine makes longer have asked for more, it stays there.
        as_asked = all(s["why"] == "asked" for s in report["switches"])
        self.assertGreater(len(changes), 3 if as_asked else 1, report["switches"])
        # What is off is no loss.
        modules = {m["name"]: m for m in report["modules"]}
        off = collections.Counter(m for without, _ in had for m in without)
        for name in "see", "act", "show", "log":
            module = modules[name]
            self.assertEqual((module["dropped"], module["failed"]), (0, 0), name)
            self.assertEqual((module["activations"], module.get("off", 0)), (len(had) - off[name], off[name]), name)
        (self.assertGreater if as_asked else self.assertGreaterEqual)(off["log"], off["show"])
        self.assertGreater(off["show"], 0)
        # While it is off nobody waits for the chain: what came has a latency, and nothing else.
        log = next(c for c in report["chains"] if c["name"] == "log")
        self.assertLessEqual(log["results"], modules["log"]["activations"])
        self.assertGreaterEqual(log["results"], modules["log"]["activations"] - len(changes))
        self.assertEqual(report["lost_activations"], 0)
        self.assertNotIn("crashed after the run", " ".join(report["notes"]))
        self.assertNotIn("no worst case for some chains", " ".join(report["claims"]["broken"]))

    def test_each_activation_runs_what_its_table_has(self):
        self.switch_about()

    def test_so_it_is_in_processes_of_their_own(self):
        self.switch_about("--isolate")


if __name__ == "__main__":
    unittest.main()
