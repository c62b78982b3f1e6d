#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Emulated XPUs under a script. What a job took is compared with what the emulator's own words make of it, and only from
below: this machine may make anything longer, and nothing shorter."""
import collections
import json
import pathlib
import statistics
import subprocess
import tempfile
import unittest

import pftrace
from common import APP, DRIVING, QUEUES, SOURCE, XAUTO, activations, wait_for, xauto

SCENARIOS = [{"name": "nominal"}, {"name": "GPU at half", "wcet_scale_pct": {"gpu": 200}}]


class Throttle(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "driving", **QUEUES})
        self.app = json.loads(pathlib.Path(APP).read_text())
        self.app.pop("deadline_us", None)

    def write(self, name, value):
        (self.folder / name).write_text(json.dumps(value))

    def script(self, *steps, **keys):
        self.write("script.json", {"schema": "xauto.emulation", "version": 1, "steps": list(steps), **keys})

    def run_app(self, *flags, app=APP, status=0):
        done = xauto("run", "--app", app, "--platform", "small", "--emulate", "--policy", "policy.json", "--deployment",
                     "deployment.json", "--lockstep", "--emulate-script", "script.json", "--json", "--trace-out", "t.pftrace",
                     *flags, "--", DRIVING, cwd=self.folder)
        self.assertEqual(done.returncode, status, done.stderr)
        return json.loads(done.stdout)["runs"][0] if status == 0 else done.stderr

    def solve(self, *flags, app=APP):
        done = xauto("solve", "--app", app, "--platform", "small", "--out", "policy.json", *flags, cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)

    def usual(self):
        """XNode -> (XPU, the median time in ns that its jobs had it, of those that nobody suspended). A suspended one still works
        for a moment, and a slice is cut where the one before it was told late to have ended."""
        trace = pftrace.Trace((self.folder / "t.pftrace").read_bytes())
        took, where = collections.defaultdict(list), {}
        for s in trace.slices:
            if s.category == "run":
                name = s.name.split(" ")[0]
                took[name, s.args["release"]].append(s.end - s.begin)
                where[name] = s.track.split("/")[1]
        whole = [(name, parts[0]) for (name, _), parts in took.items() if len(parts) == 1]
        return {name: (xpu, statistics.median(ns for x, ns in whole if x == name)) for name, xpu in where.items()
                if name in dict(whole)}

    def test_work_takes_as_long_as_the_clock_says(self):
        self.solve("--method", "heft")
        wcet = {x["name"]: x["wcet_us"] for x in self.app["xnodes"]}
        factor = {"gpu": 2, "dla": 4, "cpu": 0.5}
        self.script({"at_us": 0, "speed_pct": {"gpu": 50, "dla": 25, "cpu": 200}})
        report = self.run_app("--activations", 8)
        self.assertIn("emulated under script.json", str(report["notes"]))
        seen = collections.Counter()
        for name, (xpu, ns) in self.usual().items():
            kind = xpu.rstrip("0123456789")
            least = wcet[name][kind] * 1000 * factor[kind]
            if least > 2_000_000:  # shorter ones are mostly what is around them
                seen[kind] += 1
                self.assertGreater(ns, least - 500_000, (name, xpu))
        self.assertTrue(seen["gpu"] and seen["dla"], seen)

    def test_a_throttled_gpu_is_met_by_its_table(self):
        """The app's times are twice the truth, so at half of the clock jobs take what is said, and at a quarter twice that."""
        for xnode in self.app["xnodes"]:
            xnode["wcet_us"] = {kind: us * (2 if kind == "gpu" else 4) for kind, us in xnode["wcet_us"].items()}
        self.write("app.json", self.app)
        self.write("scenarios.json", {"schema": "xauto.scenarios", "version": 1, "app": "driving", "scenarios": SCENARIOS})
        self.solve("--scenarios", "scenarios.json", "--tables", 2, "--time-limit", "4s", app="app.json")
        self.script({"at_us": 1_000_000, "speed_pct": {"gpu": 25}})
        report = self.run_app("--activations", 40, app="app.json")
        self.assertEqual(report["lost_activations"], 0)
        self.assertIn("GPU at half", [s["to"] for s in report["switches"]])
        self.assertIn("XNode", next(s for s in report["switches"] if s["why"] in ("overrun", "outside"))["detail"])

    def test_a_dla_that_stops_for_good_is_lost_and_its_table_does_without(self):
        for xnode in self.app["xnodes"]:
            xnode["wcet_us"] = {kind: us * 4 for kind, us in xnode["wcet_us"].items()}
        self.write("app.json", self.app)
        self.write("scenarios.json", {"schema": "xauto.scenarios", "version": 1, "app": "driving",
                                      "scenarios": [{"name": "nominal"}, {"name": "no DLA", "lost": ["dla0"]}]})
        self.solve("--scenarios", "scenarios.json", "--tables", 2, "--time-limit", "4s", app="app.json")
        tables = json.loads((self.folder / "policy.json").read_text())
        on_dla = [x["name"] for x in tables["tables"][0]["xnodes"] if x["xpu"] == "dla0"]
        self.assertTrue(on_dla, "so this tests nothing")
        self.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "driving",
                                       "defaults": {**QUEUES["defaults"], "isolate": True, "hang_us": 500_000,
                                                    "on_hang": "restart", "restarts": 5}})
        self.script({"at_us": 1_000_000, "stop": ["dla0"]})
        with open(self.folder / "err", "w") as err:
            tool = subprocess.Popen(
                [XAUTO, "run", "--app", "app.json", "--platform", "small", "--emulate", "--policy", "policy.json",
                 "--deployment", "deployment.json", "--activations", "0", "--period", "100ms", "--emulate-script",
                 "script.json", "--json", "--", DRIVING], cwd=self.folder, stdout=subprocess.PIPE, stderr=err, text=True)
        self.addCleanup(lambda: (tool.kill(), tool.wait()))
        self.addCleanup(lambda: tool.stdout.close())

        def now():
            done = xauto("param", "--run", f"{tool.pid}-0", "--wait", "10s", "--json")
            self.assertEqual(done.returncode, 0, done.stderr + (self.folder / "err").read_text())
            return json.loads(done.stdout)["now"]

        def results():
            return activations(tool)
        wait_for("the table without the DLA", lambda: now() == "no DLA", tool)
        wait_for("results", lambda: results(), tool)
        before = results()
        wait_for("results of all modules", lambda: all(n > before[m] + 5 for m, n in results().items()), tool)
        tool.terminate()
        report = json.loads(tool.communicate(timeout=60)[0])["runs"][0]
        lost = next((s for s in report["switches"] if s["why"] == "lost"), None)
        self.assertTrue(lost, f"{report['switches']}\n{(self.folder / 'err').read_text()}")
        self.assertEqual(lost["to"], "no DLA")
        self.assertRegex(lost["detail"], f"^XNode '({'|'.join(on_dla)})' did not return from dla0 within its hang limit$")
        self.assertNotIn("back", [s["why"] for s in report["switches"][report["switches"].index(lost):]])

    def test_a_stopped_dla_is_seen_by_the_hang_limit(self):
        self.solve("--pin", "fcd.infer=dla0", "--pin", "td.infer=dla0")
        self.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "driving", **QUEUES,
                                       "modules": {"FCD": {"overload": "newest", "hang_us": 200_000, "on_hang": "drop"},
                                                   "TD": {"overload": "newest", "hang_us": 200_000, "on_hang": "drop"}}})
        self.script({"at_us": 500_000, "stop": ["dla0"]}, {"at_us": 1_500_000, "start": ["dla0"]})
        with open(self.folder / "err", "w") as err:
            tool = subprocess.Popen(
                [XAUTO, "run", "--app", APP, "--platform", "small", "--emulate", "--policy", "policy.json", "--deployment",
                 "deployment.json", "--activations", "0", "--emulate-script", "script.json", "--json", "--", DRIVING],
                cwd=self.folder, stdout=subprocess.PIPE, stderr=err, text=True)
        self.addCleanup(lambda: (tool.kill(), tool.wait()))
        self.addCleanup(lambda: tool.stdout.close())
        said = self.folder / "err"
        wait_for("a hang", lambda: "ran past its hang limit" in said.read_text(), tool)

        def results():
            return activations(tool)
        before = results()
        wait_for("results after the DLA goes on", lambda: results()["FCD"] > before["FCD"] + 2, tool)
        tool.terminate()
        report = json.loads(tool.communicate(timeout=60)[0])["runs"][0]
        hangs = {x["name"]: x.get("hangs", 0) for x in report["limited_xnodes"]}
        self.assertGreater(sum(hangs.values()), 0, hangs)

    def test_what_the_script_cannot_tell_of_is_refused(self):
        self.solve("--method", "heft")
        for keys, said in (({"at_us": 0, "speed_pct": {"npu": 50}}, "npu"), ({"at_us": 0}, "/steps/0")):
            self.script(keys)
            self.assertIn(said, self.run_app("--activations", 1, status=2))
        self.script({"at_us": 0, "speed_pct": {"gpu": 50}})
        done = xauto("run", "--app", APP, "--platform", "small", "--real", "--policy", "policy.json", "--emulate-script",
                     "script.json", "--", DRIVING, cwd=self.folder)
        self.assertEqual(done.returncode, 2)

    def test_the_example_is_one(self):
        self.solve("--method", "heft")
        (self.folder / "script.json").write_text((SOURCE / "examples/driving/throttle.json").read_text())
        self.run_app("--activations", 2)


if __name__ == "__main__":
    unittest.main()
