# SPDX-License-Identifier: Apache-2.0
"""Nothing lost, nothing invented: whatever the overload policy, the period and the isolation, a run's table, the
messages that an observer with a clock of its own saw, and the trace, read by code that is not ours, say the same. And
an app of several rates with a policy that has run-time order: no stage waits for another sensor's release."""
import itertools
import json
import os
import pathlib
import tempfile
import unittest

import pftrace
from common import BIN, xauto

RATESAPP = str(BIN / "ratesapp")


class Case:
    """An app of independent sensors: {name: (period_us, [stage])}, a stage being {type: us}."""

    def __init__(self, folder, sensors, deadline_us=None):
        self.folder, self.sensors = folder, sensors
        self.host = {}  # XNode -> "+US" that it spends without its XPU
        xnodes, edges = [], []
        for name, (_, stages) in sensors.items():
            for i, stage in enumerate(stages):
                xnodes.append({"name": f"{name}.{i}", "module": name, "wcet_us": stage})
                if i:
                    edges.append([f"{name}.{i - 1}", f"{name}.{i}"])
        app = {"schema": "xauto.app", "version": 1, "name": "ratesapp", "xnodes": xnodes, "edges": edges}
        if deadline_us:
            app["deadline_us"] = deadline_us
        pathlib.Path(self.path("app.json")).write_text(json.dumps(app))

    def path(self, name):
        return os.path.join(self.folder, name)

    def command(self):
        def work(name, i, stage):
            return "/".join(f"{xpu}={us}{self.host.get(f'{name}.{i}', '')}" for xpu, us in stage.items())
        return ["--", RATESAPP, self.path("seen")] + [
            f"{name}:{period}:" + ",".join(work(name, i, stage) for i, stage in enumerate(stages))
            for name, (period, stages) in self.sensors.items()]

    def solve(self):
        done = xauto("solve", "--app", self.path("app.json"), "--platform", "small", "--time-limit-s", 1,
                     "--out", self.path("policy.json"))
        assert done.returncode == 0, done.stderr
        return json.loads(pathlib.Path(self.path("policy.json")).read_text())

    def run(self, *flags):
        done = xauto("run", "--app", self.path("app.json"), "--policy", self.path("policy.json"), "--platform", "small",
                     "--emulate", "--json", *flags, *self.command())
        assert done.stdout, done.stderr
        seen = {}
        for line in pathlib.Path(self.path("seen")).read_text().splitlines():
            name, messages, longest, _ = line.split()
            seen[name] = (int(messages), int(longest))
        return json.loads(done.stdout)["runs"][0], seen, done


class OneRate(unittest.TestCase):
    SENSORS = {"cam": [{"cpu": 2000}, {"gpu": 5000}, {"cpu": 1000}], "lid": [{"gpu": 2000, "cpu": 4000}]}
    RELEASES, DEADLINE_US = 40, 12_000

    def check(self, period, overload, isolate):
        with tempfile.TemporaryDirectory() as folder:
            case = Case(folder, {name: (period, stages) for name, stages in self.SENSORS.items()}, self.DEADLINE_US)
            case.solve()
            trace = case.path("t.pftrace")
            run, seen, _ = case.run("--activations", self.RELEASES, "--overload", overload, "--trace-out", trace,
                                    *(["--isolate"] if isolate else []))
            skips = overload == "skip"  # what all modules skip, as they were told, is neither a result nor lost
            (self.assertLessEqual if skips else self.assertEqual)(run["activations"] + run["lost_activations"], self.RELEASES)
            for module in run["modules"]:
                self.assertEqual(module["activations"] + module["failed"] + module["dropped"] + module.get("skipped", 0), self.RELEASES)
                self.assertEqual(module["activations"], seen[module["name"]][0], "what an observer saw")
            # A release is a result where every module has one, but for those that skipped it.
            of_each = [messages for messages, _ in seen.values()]
            self.assertLessEqual(run["activations"], sum(of_each) if skips else min(of_each))

            slices = pftrace.Trace(pathlib.Path(trace).read_bytes()).on("releases", "release")
            took = [s.args["latency_us"] for s in slices if "latency_us" in s.args]
            self.assertEqual(len(slices), self.RELEASES)
            self.assertEqual(len(took), run["activations"])
            self.assertEqual([s.args.get("result") for s in slices].count("dropped"), run["lost_activations"])
            late = sum(us > self.DEADLINE_US for us in took)
            self.assertEqual(run["deadline_misses"], late + run["lost_activations"])
            # A worst case says of what, and what of that this run did not keep: cam takes 8 ms, so releases overlap.
            self.assertIn("a release that meets no other", run["worst_case_of"])
            overlaps = any("while an earlier one was in flight" in why for why in run["worst_case_broken"])
            self.assertTrue(overlaps if period < 8_000 else run["worst_case_broken"] or run.get("time_taken") or not run["worst_case_exceeded"], run)
            if not took:
                return
            self.assertEqual(run["max_us"], max(took))
            # The observer looks after the module's end, so what it saw is no shorter.
            self.assertLessEqual(run["max_us"], max(longest for _, longest in seen.values()) + 1)
            explained = json.loads(xauto("explain", "--trace", trace, "--json").stdout)
            self.assertEqual(explained["latency_us"], run["max_us"])

    def test_results_and_losses_are_all_releases(self):
        # 6 ms: cam takes 8, so every other release is lost or late; 30 ms: none.
        for period, overload, isolate in itertools.product(
                (6_000, 30_000), ("newest", "queue:2", "skip"), (False, True)):
            if period == 30_000 and isolate and overload != "newest":
                continue  # nothing is lost there: the policy says nothing
            with self.subTest(period=period, overload=overload, isolate=isolate):
                self.check(period, overload, isolate)


class SeveralRates(unittest.TestCase):
    SENSORS = {"camera": (10_000, [{"gpu": 4000}]),
               "radar": (50_000, [{"gpu": 6000}, {"cpu": 20_000}]),
               "lidar": (100_000, [{"gpu": 40_000}, {"cpu": 10_000}])}

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.case = Case(folder.name, self.SENSORS)

    def test_order_does_not_stall_another_sensors_releases(self):
        policy = self.case.solve()
        # Release k of the camera shall come after release k of the lidar, which is ten times rarer: kept by number, the
        # camera would fall behind by 90 ms in each period of the lidar: by 1.8 s in all.
        rank = {"camera.0": 3, "radar.0": 2, "lidar.0": 1}
        for xnode in policy["xnodes"]:
            if xnode["name"] in rank:
                xnode["priority"] = rank[xnode["name"]]
        policy["order"] = [["lidar.0", "camera.0"], ["radar.0", "camera.0"], ["lidar.0", "radar.0"]]
        pathlib.Path(self.case.path("policy.json")).write_text(json.dumps(policy))
        run, seen, done = self.case.run("--activations", 20)
        self.assertIn("order constraints are not enforced", done.stderr + " ".join(run["notes"]))
        self.assertTrue(any("several periods" in why for why in run["worst_case_broken"]), run)
        for name, (messages, longest) in seen.items():
            self.assertGreater(messages, 0, name)
            self.assertLess(longest, 1_200_000, name)

    def test_no_source_falls_silent_before_the_slowest(self):
        self.case.solve()
        for flags, lidars in ((("--activations", 4), 4), (("--seconds", "0.3"), 3)):
            with self.subTest(flags):
                run, seen, _ = self.case.run(*flags)
                for module in run["modules"]:
                    released = module["activations"] + module["failed"] + module["dropped"]
                    # In 400 ms: 40 of the camera, 8 of the radar, 4 of the lidar.
                    self.assertEqual(released, lidars * 100_000 // self.SENSORS[module["name"]][0], module)
                    self.assertEqual(module["activations"], seen[module["name"]][0])

    def test_each_message_has_its_own_sensors_number(self):
        self.case.solve()
        run, _, _ = self.case.run("--activations", 3)
        latest = {line.split()[0]: int(line.split()[3])
                  for line in pathlib.Path(self.case.path("seen")).read_text().splitlines()}
        # The last release of the camera, at 290 ms, is its 29th; those at 0, 100, 200 ms coincide with the lidar's.
        self.assertIn(latest["camera"], (28, 29))
        self.assertEqual(latest["lidar"], 2)


class Trace(unittest.TestCase):
    def test_who_is_resumed_is_who_was_suspended(self):
        """low.0 is suspended while it is busy without the GPU, and is through before it is resumed: what is resumed then
        is its queue, not low.1, which waits for the GPU all the time."""
        with tempfile.TemporaryDirectory() as folder:
            # low.0 is busy for 0.4 s after its GPU work; within that time high.1 comes, however the machine stalls.
            case = Case(folder, {"low": (1_200_000, [{"gpu": 100}, {"gpu": 100}]),
                                 "high": (1_200_000, [{"cpu": 3000}, {"gpu": 700_000}])})
            case.host = {"low.0": "+400000"}
            policy = case.solve()
            rank = {"high.1": 9, "high.0": 4, "low.0": 3, "low.1": 2}
            for xnode in policy["xnodes"]:
                xnode["priority"] = rank[xnode["name"]]
                xnode["xpu"] = "cpu0" if xnode["name"] == "high.0" else "gpu0"
            policy.pop("order", None)
            pathlib.Path(case.path("policy.json")).write_text(json.dumps(policy))
            trace = case.path("t.pftrace")
            run, _, _ = case.run("--activations", 3, "--trace-out", trace)
            self.assertEqual(run["activations"], 3)
            pieces = pftrace.Trace(pathlib.Path(trace).read_bytes()).on("run/gpu0")
            switches = {s.args["release"]: s for s in pieces if s.category == "switch" and "low.0" in s.name}
            self.assertEqual(len(switches), 3, "low.0 is suspended in each release")
            for s in pieces:
                if s.name == "low.1" and s.category == "run":
                    high = next(h for h in pieces if h.name == "high.1" and h.category == "run" and
                                h.args["release"] == s.args["release"])
                    self.assertGreaterEqual(s.begin, high.end, "low.1 runs when high.1 has finished")
            self.assertFalse([s for s in pieces if s.category == "switch" and "low.1" in s.name])


if __name__ == "__main__":
    unittest.main()
