#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tables of keys: an app of three rates, solved, checked, and run while people ask for other scenarios. Which table an
activation had is read off the XPUs of its jobs in the trace, and tables.json; nothing of ours says it."""
import collections
import copy
import json
import pathlib
import re
import subprocess
import tempfile
import unittest

import pftrace
from common import BIN, QUEUES, XAUTO, deployed, top, wait_for, xauto

RATES = pathlib.Path(__file__).parents[2] / "examples" / "driving" / "rates.json"
SCENARIOS = [{"name": "nominal"}, {"name": "GPU at half", "wcet_scale_pct": {"gpu": 200}},
             {"name": "CPUs slow", "wcet_scale_pct": {"cpu": 130}}]


class KeyTables(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        cls.app = json.loads(RATES.read_text())
        del cls.app["clocks"]
        for source in cls.app["sources"]:  # all by one clock, so that changes are certified
            source.pop("clock", None)
        cls.write("app.json", cls.app)
        cls.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": cls.app["name"], **QUEUES})
        cls.write("scenarios.json", {"schema": "xauto.scenarios", "version": 1, "app": cls.app["name"], "scenarios": SCENARIOS})
        done = xauto("solve", "--app", "app.json", "--platform", "small", "--scenarios", "scenarios.json", "--tables", 2,
                     "--time-limit", "3s", "--out", "tables.json", "--json", cwd=cls.folder)
        assert done.returncode in (0, 1), done.stdout + done.stderr  # 1: a change may miss a deadline
        cls.tables = json.loads((cls.folder / "tables.json").read_text())
        cls.xpus = [{x["name"]: x["xpu"] for x in t["xnodes"]} for t in cls.tables["tables"]]

    @classmethod
    def write(cls, name, value):
        (cls.folder / name).write_text(json.dumps(value))

    def check(self, tables):
        self.write("claims.json", tables)
        done = xauto("check", "--app", "app.json", "--platform", "small", "--policy", "claims.json", "--json", cwd=self.folder)
        return json.loads(done.stdout)

    def test_every_claim_is_derived_again(self):
        self.assertEqual(len(self.tables["tables"]), 2)
        told = self.check(self.tables)
        self.assertEqual(told["lies"], [])
        self.assertIn("8 chains while one table takes the place of another", " ".join(told["shown"]))
        less = copy.deepcopy(self.tables)
        less["handovers"][0]["chains"][0]["worst_case_us"] //= 2
        self.assertRegex(self.check(less)["lies"][0], "^from 'table 0' to 'table 1': chain 'lane' is said to take ")
        less = copy.deepcopy(self.tables)
        less["tables"][1]["chains"][0]["worst_case_us"] -= 1
        self.assertRegex(self.check(less)["lies"][0], "^table 'table 1': ")

    def run_about(self, *flags, policy="tables.json"):
        with open(self.folder / "out", "w") as out, open(self.folder / "err", "w") as err:
            tool = subprocess.Popen([XAUTO, "run", "--app", "app.json", "--platform", "small", "--emulate", "--policy",
                                     policy, "--activations", "0", "--deployment", "deployment.json", "--json", "--trace-out",
                                     "t.pftrace", *flags, "--",
                                     str(BIN / "driving-rates")], cwd=self.folder, stdout=out, stderr=err)
        self.addCleanup(lambda: (tool.kill(), tool.wait()))
        run = ("--run", f"{tool.pid}-0", "--wait", "10s", "--json")
        released = lambda: top(tool).get("releases", 0)
        wait_for("releases", lambda: released() > 20, tool)
        for name in ["GPU at half", "CPUs slow", "nominal", "GPU at half", "nominal"]:
            self.assertEqual(xauto("param", "scenario", *run, name).returncode, 0)
            at = released()
            wait_for("releases after the wish", lambda: released() > at + 60, tool)
            self.judge_deployed(tool)
        self.live = top(tool)["scenario"]
        tool.terminate()
        self.assertEqual(tool.wait(timeout=60), 0, (self.folder / "err").read_text())
        report = json.loads((self.folder / "out").read_text())["runs"][0]
        self.assertEqual(report["lost_activations"], 0)
        self.assertIn("by the policy's keys", report["claims"]["of"])
        self.trace = pftrace.Trace((self.folder / "t.pftrace").read_bytes())
        self.judge(report)
        return report

    def judge_deployed(self, tool):
        """The BPF map has the table of the scenario that is in force, and no row else; where this user may see it."""
        if deployed(tool) is None:
            return
        serves = {s["scenario"]: s["table"] for s in self.tables["serves"]}

        def agree():
            now = serves[top(tool)["scenario"]["name"]]
            number = [t["name"] for t in self.tables["tables"]].index(now)
            return deployed(tool) == [
                {"xnode": x["name"], "xpu": x["xpu"], "by": "key_us", "keys": len(x["key_us"]), "value": x["key_us"][0],
                 "xpu_index": row["xpu_index"], "table": number}
                for x, row in zip(self.tables["tables"][number]["xnodes"], deployed(tool))]
        wait_for("the table in force in the map", agree, tool)

    def judge_changes(self, report):
        """Where a change took another table, a result met it. What is claimed of that is of the two tables and its chain."""
        serves = {s["scenario"]: s["table"] for s in self.tables["serves"]}
        claims = {(h["from"], h["to"], c["name"]): c["worst_case_us"]
                  for h in self.tables["handovers"] for c in h["chains"] if "worst_case_us" in c}
        met = [s for s in report["switches"] if s["spanned_us"] is not None]
        for s in met:
            self.assertEqual(s["worst_case_us"], claims[serves[s["from"]], serves[s["to"]], s["chain"]])
        for s in report["switches"]:
            if serves[s["from"]] == serves[s["to"]]:
                self.assertIsNone(s["spanned_us"], "no release has another table")
        if not re.search("have no worst case", str(report["claims"]["broken"])):
            self.assertTrue(met)
        events = [e for e in self.trace.slices if e.category == "table"]
        self.assertEqual([(e.args.get("chain"), e.args.get("spanned_us"), e.args.get("worst_case_us")) for e in events],
                         [(s.get("chain"), s["spanned_us"], s.get("worst_case_us")) for s in report["switches"]])
        if met and self.live["spanned"]:
            live = self.live["spanned"]
            share = max(s["spanned_us"] / s["worst_case_us"] for s in met)
            self.assertLessEqual(live["us"] / live["worst_case_us"], share)
            self.assertIn((live["from"], live["to"]), [(s["from"], s["to"]) for s in met])
            self.assertIn(live["chain"], {c["name"] for c in self.app["chains"]})

    def judge(self, report):
        """All XNodes of an activation have one table; from one activation to the next it changes as often as the report
        says, at most, and in all components alike."""
        home = {x["name"]: x["name"] for x in self.app["xnodes"]}  # by edges
        ends = [e if isinstance(e, list) else (e["from"], e["to"]) for e in self.app["edges"]]
        for _ in home:
            for u, v in ends:
                home[u] = home[v] = min(home[u], home[v])
        may = collections.defaultdict(lambda: {0, 1})  # (component, activation) -> tables
        for s in self.trace.slices:
            if s.category != "run":
                continue
            name = s.name.split(" ")[0]
            may[home[name], s.args["release"]] &= {t for t in (0, 1) if "run/" + self.xpus[t][name] == s.track}
        self.assertTrue(may)
        names = [t["name"] for t in self.tables["tables"]]
        serves = {s["scenario"]: names.index(s["table"]) for s in self.tables["serves"]}
        # What the scenarios that were in force have as tables, in this order.
        said = [serves["nominal"]] + [names.index(s["table"]) for s in report["switches"]]
        said = [t for i, t in enumerate(said) if i == 0 or said[i - 1] != t]
        for component in {c for c, _ in may}:
            had = []
            for (_, n), tables in sorted(item for item in may.items() if item[0][0] == component):
                self.assertTrue(tables, f"activation {n} of {component} is of both tables")
                if len(tables) == 1 and (not had or had[-1] not in tables):
                    had.append(*tables)
            rest = iter(said)
            self.assertTrue(all(any(t == s for s in rest) for t in had), f"{component} had {had}, said were {said}")
        self.assertGreater(len(said), 1)

    def test_every_job_of_an_activation_has_its_table(self):
        self.judge_changes(self.run_about())

    def test_so_it_is_in_processes_of_their_own(self):
        self.judge_changes(self.run_about("--isolate"))

    def test_a_change_of_which_nothing_is_claimed_drains(self):
        tables = copy.deepcopy(self.tables)
        for handover in tables["handovers"]:
            handover["not_claimed"] = ["for a test"]
            for chain in handover["chains"]:
                chain.pop("worst_case_us", None)
        self.assertEqual(self.check(tables)["lies"], [])
        self.write("drains.json", tables)
        serves = {s["scenario"]: s["table"] for s in tables["serves"]}
        for isolate in ([], ["--isolate"]):
            report = self.run_about(*isolate, policy="drains.json")
            held = {bool(s["held_us"]) for s in report["switches"] if serves[s["from"]] != serves[s["to"]]}
            self.assertEqual(held, {True})
            self.assertEqual({s["spanned_us"] for s in report["switches"]}, {None})
            for module in report["modules"]:  # none is lost: run_about() has looked
                self.assertGreater(module["skipped"], 0, module)
            self.assertNotRegex(str(report["claims"]["broken"]), "have no worst case")


if __name__ == "__main__":
    unittest.main()
