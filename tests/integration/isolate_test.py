# SPDX-License-Identifier: Apache-2.0
"""An app in one process and in several: the same results; a module's process that dies takes nothing with it."""
import collections
import json
import os
import pathlib
import signal
import subprocess
import tempfile
import time
import unittest

from common import BIN, XAUTO, alive, children_of, xauto

TESTAPP = str(BIN / "testapp")
PLATFORM = {"schema": "xauto.platform", "version": 1, "name": "test", "xpus": [
    {"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 0},
    {"id": "npu0", "type": "npu", "preemptive": False, "preempt_us": 0}]}
XNODES = [("a1", "A", "cpu"), ("a2", "A", "npu"), ("b1", "B", "npu"), ("c1", "C", "cpu"), ("d1", "D", "cpu")]


class Case(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        path = cls.path
        pathlib.Path(path("platform.json")).write_text(json.dumps(PLATFORM))
        pathlib.Path(path("app.json")).write_text(json.dumps({
            "schema": "xauto.app", "version": 1, "name": "testapp",
            "xnodes": [{"name": n, "module": m, "wcet_us": {x: 200}} for n, m, x in XNODES],
            "edges": [["a1", "a2"], ["a2", "c1"], ["b1", "c1"]]}))
        done = xauto("solve", "--app", path("app.json"), "--platform", path("platform.json"), "--method", "heft",
                     "--out", path("policy.json"))
        assert done.returncode == 0, done.stderr

    @classmethod
    def path(cls, name):
        return os.path.join(cls.folder.name, name)

    def command(self, *flags, fault=(), period=2000, activations=200, more=()):
        return [XAUTO, "run", "--app", self.path("app.json"), "--policy", self.path("policy.json"), "--platform",
                self.path("platform.json"), "--real", "--json", "--activations", str(activations), *map(str, flags),
                "--", TESTAPP, self.path("result"), *map(str, fault), "period", str(period), *map(str, more)]

    def run_app(self, *flags, status=0, **keywords):
        """The run's report and what came out, by topic: {number: value}."""
        done = subprocess.run(self.command(*flags, **keywords), capture_output=True, text=True, timeout=100)
        self.assertEqual(done.returncode, status, done.stderr)
        return json.loads(done.stdout)["runs"][0], self.results()

    def results(self):
        topics = collections.defaultdict(dict)
        for line in pathlib.Path(self.path("result")).read_text().splitlines():
            topic, number, value = line.split()
            self.assertNotIn(number, topics[topic])
            topics[topic][number] = value
        return topics

    def assert_unaffected(self, results, releases):
        """Not in lockstep, so a machine that stalls costs it overruns of its own. A module whose process died at a
        quarter of the run has at most that quarter."""
        self.assertGreaterEqual(len(results), releases * 6 // 10)

    def assert_counts_add_up(self, run, releases):
        for module in run["modules"]:
            self.assertEqual(module["activations"] + module["failed"] + module["dropped"], releases, module)


class Isolate(Case):
    def test_same_results_in_one_process_and_isolated(self):
        one, expected = self.run_app("--lockstep")
        several, got = self.run_app("--lockstep", "--isolate")
        self.assertEqual((one["activations"], one["lost_activations"]), (200, 0))
        self.assertEqual((several["activations"], several["lost_activations"]), (200, 0))
        self.assertEqual(len(expected["c"]), 200)
        self.assertEqual(got, expected)
        self.assertEqual(several["trace_events_lost"], 0)

    def test_a_failure_of_one_activation_is_the_same(self):
        for flags in ([], ["--isolate"]):
            run, got = self.run_app("--lockstep", *flags, fault=("throw", "A", 7), status=1)
            self.assertEqual(run["lost_activations"], 1)
            self.assertNotIn("7", got["c"])
            self.assertEqual(len(got["c"]), 199)
            self.assertEqual(len(got["d"]), 200)
            self.assertIn("exec of XNode 'a1' on cpu0: threw: told to", " ".join(run["notes"]))
            self.assert_counts_add_up(run, 200)

    def test_a_crash_loses_the_modules_activations_and_nothing_else(self):
        _, expected = self.run_app("--lockstep")
        run, got = self.run_app("--isolate", fault=("crash", "B", 50), status=1)
        self.assert_counts_add_up(run, 200)
        self.assert_unaffected(got["d"], 200)
        for number, value in got["d"].items():
            self.assertEqual(value, expected["d"][number])
        self.assertTrue(30 < len(got["c"]) <= 50, len(got["c"]))
        for number, value in got["c"].items():
            self.assertEqual(value, expected["c"][number])
        self.assertIn("the process of B died (signal SIGABRT)", " ".join(run["notes"]))

    def test_a_crashed_module_is_started_again(self):
        run, got = self.run_app("--isolate", "--restarts", 1, fault=("crash", "B", 50), status=1, activations=600)
        self.assert_counts_add_up(run, 600)
        self.assert_unaffected(got["d"], 600)
        self.assertGreater(len(got["c"]), 200)
        self.assertGreater(max(map(int, got["c"])), 550)
        self.assertIn("was started again", " ".join(run["notes"]))

    def test_a_slow_module_loses_its_own_and_holds_up_nobody(self):
        run, got = self.run_app("--isolate", fault=("slow", "B", 0, 10), status=1)
        self.assert_counts_add_up(run, 200)
        self.assert_unaffected(got["d"], 200)
        self.assertLess(len(got["c"]), 100)

    def test_a_process_that_ends_before_it_is_ready_ends_the_run(self):
        done = subprocess.run(self.command("--isolate", fault=("exit", "B", 0)), capture_output=True, text=True,
                              timeout=60)
        self.assertEqual(done.returncode, 1)
        self.assertIn("ended before it was ready", done.stderr)


if __name__ == "__main__":
    unittest.main()
