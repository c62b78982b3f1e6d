# SPDX-License-Identifier: Apache-2.0
"""Several activations of one module at once (XModule::in_flight): the same results in the same order as one at a time, in one
process and in several, whatever becomes of one of them; and the Driving Case sustained at a period that one at a time cannot.
Results are compared with those of a lockstep run, plans are made here, the trace is read by pftrace.py."""
import collections
import json
import pathlib
import re
import unittest

import pftrace
from common import BIN, QUEUES, SOURCE, activations, xauto
from isolate_test import Case

FOR_EVER_MS = 3_600_000
THREE = ("room", 3)


class SameResults(Case):
    def assert_as_one_at_a_time(self, run, got, releases=200):
        self.assertEqual(run["lost_activations"], 0, run)
        for topic in "cd":
            self.assertEqual(list(got[topic]), [str(k) for k in range(releases)], "in order, each once")
        self.assert_true_results(got)

    def test_in_one_process_and_in_several(self):
        for flags in ([], ["--isolate"]):
            # Each stage sleeps 4 ms on its XPU or core where a release comes every 2 ms.
            run, got = self.run_app(*flags, *self.deploy(**QUEUES), more=THREE, fault=("slow", "A", 0, 4))
            self.assert_as_one_at_a_time(run, got)

    def test_who_fails_takes_nobody_along(self):
        for flags in ([], ["--isolate"]):
            run, got = self.run_app(*flags, *self.deploy(**QUEUES), more=THREE, fault=("throw", "A", 7), status=1)
            self.assertEqual(run["lost_activations"], 1)
            self.assertEqual(list(got["c"]), [str(k) for k in range(200) if k != 7])
            self.assertEqual(len(got["d"]), 200)
            self.assert_counts_add_up(run, 200)
            self.assert_true_results(got)

    def test_who_hangs_takes_its_own_room(self):
        flags = self.deploy(**QUEUES, modules={"D": {"hang_us": 300_000, "on_hang": "drop"}})
        run, got = self.run_app(*flags, more=THREE, fault=("hang", "D", 50, 2000), status=1)
        self.assertEqual(list(got["d"]), [str(k) for k in range(200) if k != 50])
        self.assertEqual(len(got["c"]), 200)
        self.assert_counts_add_up(run, 200)
        self.assertIn("ran past its hang limit of 300 ms in activation 50", " ".join(run["notes"]))

    def test_a_crashed_module_is_started_again(self):
        run, got = self.run_until(lambda tool: activations(tool).get("C", 0) > 60, "--isolate", "--restarts", 1,
                                  *self.deploy(**QUEUES), more=THREE, fault=("crash", "B", 50), status=1)
        self.assert_counts_add_up(run, run["activations"] + run["lost_activations"])
        self.assert_true_results(got)
        numbers = list(map(int, got["c"]))
        self.assertEqual(numbers, sorted(numbers))
        # Up to two others were under way in B, and results on their way to C.
        self.assertGreater(numbers[47], 46)
        self.assertGreater(numbers[50], 50)
        self.assertIn("was started again", " ".join(run["notes"]))


class Pipelined(Case):
    PERIOD_US, ROOM = 24_000, 3

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        app = json.loads((SOURCE / "examples/driving/app.json").read_text())
        fed = {"la.pre": "camera/front", "td.pre": "camera/front", "fcd.pre": "camera/front", "rcd.pre": "camera/rear",
               "ld.pre": "lidar/top"}
        for xnode in app["xnodes"]:
            xnode.pop("source", None)
            if xnode["name"] in fed:
                xnode["source"] = fed[xnode["name"]]
        app.update(version=3, name="driving-pipelined",
                   sources=[{"name": n, "period_us": cls.PERIOD_US, "jitter_us": 200} for n in sorted(set(fed.values()))],
                   modules=[{"name": m, "max_in_flight": cls.ROOM} for m in sorted({x["module"] for x in app["xnodes"]})])
        app.pop("deadline_us", None)
        cls.app = app
        pathlib.Path(cls.path("pipelined.json")).write_text(json.dumps(app))
        done = cls.solve()
        assert done.returncode == 0, done.stdout + done.stderr

    @classmethod
    def solve(cls):
        return xauto("solve", "--app", cls.path("pipelined.json"), "--platform", "small", "--max-evaluations", 3000,
                     "--threads", 1, "--time-limit", "60s", "--out", cls.path("pipelined.policy.json"))

    def run_pipelined(self, *flags, status=0, room=ROOM):
        done = xauto("run", "--app", self.path("pipelined.json"), "--platform", "small", "--policy",
                     self.path("pipelined.policy.json"), "--emulate", "--json", *flags, "--", BIN / "pipelined",
                     self.PERIOD_US, room)
        self.assertEqual(done.returncode, status, done.stderr)
        return json.loads(done.stdout)["runs"][0] if status == 0 else done.stderr

    def test_releases_overlap_in_a_module_and_none_is_lost(self):
        deploy = self.path("pipelined.deployment.json")
        pathlib.Path(deploy).write_text(json.dumps({"schema": "xauto.deployment", "version": 1, "app": "driving-pipelined", **QUEUES}))
        for flags in ([], ["--isolate"]):
            run = self.run_pipelined("--duration", "3s", "--deployment", deploy, "--trace-out", self.path("t.pftrace"), *flags)
            self.assertEqual([m["dropped"] + m["failed"] for m in run["modules"]], [0] * 8)
            trace = pftrace.Trace(pathlib.Path(self.path("t.pftrace")).read_bytes())
            module_of = {x["name"]: x["module"] for x in self.app["xnodes"]}
            span, ends = {}, collections.defaultdict(list)
            for s in trace.slices:
                if s.category != "run":
                    continue
                name, n = s.name.split(" ")[0], s.args["release"]
                key = (module_of[name], n)
                begin, end = span.get(key, (s.begin, s.end))
                span[key] = (min(begin, s.begin), max(end, s.end))
                ends[name].append((s.begin, n))
            for name, began in ends.items():
                order = [n for _, n in sorted(began)]
                self.assertEqual([n for i, n in enumerate(order) if i == 0 or order[i - 1] != n].count(0), 1, name)
                first = list(dict.fromkeys(order))
                self.assertEqual(first, sorted(first), f"{name} takes activations in order")
            for (module, n), (begin, _) in span.items():
                inside = sum((module, m) in span and span[module, m][1] > begin for m in range(max(0, n - 6), n + 1))
                self.assertLessEqual(inside, self.ROOM, f"{module} {n}")
            whole = {}  # of a release, whatever modules it is in: a module is too short to meet itself in each run
            for (_, n), (begin, end) in span.items():
                was = whole.get(n, (begin, end))
                whole[n] = (min(was[0], begin), max(was[1], end))
            self.assertTrue(any(n - 1 in whole and whole[n - 1][1] > begin for n, (begin, _) in whole.items()), "nothing overlapped")

    def run_pushed(self, *driver):
        deploy = self.path("pipelined.deployment.json")
        pathlib.Path(deploy).write_text(json.dumps({"schema": "xauto.deployment", "version": 1, "app": "driving-pipelined", **QUEUES}))
        done = xauto("run", "--app", self.path("pipelined.json"), "--platform", "small", "--policy",
                     self.path("pipelined.policy.json"), "--deployment", deploy, "--emulate", "--json", "--duration", "4s", "--",
                     BIN / "pipelined", self.PERIOD_US, self.ROOM, "pushed", *driver)
        return json.loads(done.stdout)["runs"][0]

    def left_out(self, run):
        """By source; where the machine stands still, the driver leaves out releases that it was not told to."""
        said = " ".join(run["claims"]["broken"])
        return {s: int((re.findall(f"source '{s}' left out ([0-9]+) of", said) or [0])[0])
                for s in ("camera/front", "camera/rear", "lidar/top")}

    def assert_what_is_left_out_is_lost_and_nothing_else(self, run):
        left_out, lost = self.left_out(run), {m["name"]: m["dropped"] for m in run["modules"]}
        self.assertEqual([m["failed"] for m in run["modules"]], [0] * 8)
        for module, source in {"LA": "front", "TD": "front", "TC": "front", "FCD": "front", "RCD": "rear"}.items():
            self.assertEqual(lost[module], left_out["camera/" + source], module)
        self.assertEqual(lost["LD"], left_out["lidar/top"])
        self.assertLessEqual(max(left_out.values()), lost["TR"])
        self.assertLessEqual(lost["TR"], sum(left_out.values()))

    def test_sensors_that_publish_by_themselves_have_a_grid(self):
        """The run chooses instants for their releases; then the policy's claims are about them, as about any."""
        run = self.run_pushed(self.PERIOD_US)
        self.assertGreater(run["activations"] + run["lost_activations"], 50)
        self.assert_what_is_left_out_is_lost_and_nothing_else(run)
        self.assertNotIn("taken as they come", " ".join(run["claims"]["broken"]))

    def test_a_frame_that_is_left_out_is_lost_and_nothing_else(self):
        run = self.run_pushed(self.PERIOD_US, 40)
        self.assertGreaterEqual(self.left_out(run)["camera/front"], 1)
        self.assert_what_is_left_out_is_lost_and_nothing_else(run)

    def test_another_period_than_stated_is_told(self):
        run = self.run_pushed(self.PERIOD_US + 1000)
        self.assertRegex(" ".join(run["claims"]["broken"]), "source 'camera/front' was up to [0-9]+ us off its grid")

    def test_a_program_with_less_room_is_refused(self):
        text = self.run_pipelined("--duration", "1s", status=2, room=2)
        self.assertIn("has max_in_flight 3; the program allows 2", text)
        self.assertIn("XModule::in_flight(3)", text)

    def test_one_at_a_time_cannot_keep_up(self):
        app = json.loads(json.dumps(self.app))
        for module in app["modules"]:
            module["max_in_flight"] = 1
        for source in app["sources"]:
            source["period_us"] = 10_000  # LD takes 11.6 ms at least
        pathlib.Path(self.path("narrow.json")).write_text(json.dumps(app))
        done = xauto("solve", "--app", self.path("narrow.json"), "--platform", "small", "--out", self.path("none.json"))
        self.assertEqual(done.returncode, 1, done.stdout)

    def test_profile_says_what_the_program_allows(self):
        done = xauto("profile", "--platform", "small", "--warmup", 1, "--repetitions", 2, "--app-out",
                     self.path("profiled.json"), "--out", self.path("profile.json"), "--", BIN / "pipelined",
                     self.PERIOD_US, 2)
        self.assertEqual(done.returncode, 0, done.stderr)
        profiled = json.loads(pathlib.Path(self.path("profiled.json")).read_text())
        self.assertEqual(profiled["version"], 3)
        self.assertEqual({m["max_in_flight"] for m in profiled["modules"]}, {2})


if __name__ == "__main__":
    unittest.main()
