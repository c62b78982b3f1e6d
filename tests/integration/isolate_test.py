# SPDX-License-Identifier: Apache-2.0
"""An app in one process and in several: the same results; a module's process that dies takes nothing with it."""
import collections
import json
import os
import pathlib
import subprocess
import tempfile
import unittest

from common import BIN, QUEUES, XAUTO, activations, sourced, wait_for, xauto

TESTAPP = str(BIN / "testapp")
PLATFORM = {"schema": "xauto.platform", "version": 1, "name": "test", "xpus": [
    {"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 0},
    {"id": "npu0", "type": "npu", "preemptive": False, "preempt_us": 0}]}
XNODES = [("a1", "A", "cpu"), ("a2", "A", "npu"), ("b1", "B", "npu"), ("c1", "C", "cpu"), ("d1", "D", "cpu")]


class Case(unittest.TestCase):
    of_1000 = None

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        pathlib.Path(cls.path("platform.json")).write_text(json.dumps(PLATFORM))
        cls.made = {}

    @classmethod
    def files(cls, period, more=()):
        """The app at this period, and a policy of priorities for it. With `room` modules may have
        several activations at once."""
        room = int(more[list(more).index("room") + 1]) if "room" in more else 1
        key = (period, room)
        if key not in cls.made:
            app, policy = cls.path(f"app-{period}-{room}.json"), cls.path(f"policy-{period}-{room}.json")
            pathlib.Path(app).write_text(json.dumps(sourced({
                "name": "testapp", "modules": [{"name": m, "max_in_flight": room} for m in "ABCD"],
                "xnodes": [{"name": n, "module": m, "wcet_us": {x: 200}} for n, m, x in XNODES],
                "edges": [["a1", "a2"], ["a2", "c1"], ["b1", "c1"]]}, "src", period)))
            done = xauto("solve", "--app", app, "--platform", cls.path("platform.json"), "--max-evaluations", 200,
                         "--time-limit", "2s", "--out", policy)
            assert os.path.exists(policy), done.stderr
            # By priorities: nobody waits for another module's job but for its message.
            made = json.loads(pathlib.Path(policy).read_text())
            made["xnodes"] = [{"name": x["name"], "xpu": x["xpu"], "priority": 9 - k} for k, x in enumerate(made["xnodes"])]
            made["certified"] = False
            made.pop("order", None)
            made.pop("chains", None)
            pathlib.Path(policy).write_text(json.dumps(made))
            cls.made[key] = ["--app", app, "--policy", policy]
        return cls.made[key]

    @classmethod
    def path(cls, name):
        return os.path.join(cls.folder.name, name)

    def deploy(self, **content):
        pathlib.Path(self.path("deployment.json")).write_text(json.dumps(
            {"schema": "xauto.deployment", "version": 1, "app": "testapp", **content}))
        return ["--deployment", self.path("deployment.json")]

    @classmethod
    def command(cls, *flags, fault=(), period=2000, activations=200, more=()):
        return [XAUTO, "run", *cls.files(period, more), "--platform", cls.path("platform.json"), "--real", "--json", "--activations", str(activations), *map(str, flags),
                "--", TESTAPP, cls.path("result"), *map(str, fault), "period", str(period), *map(str, more)]

    def run_app(self, *flags, status=0, **keywords):
        """The run's report and what came out, by topic: {number: value}."""
        done = subprocess.run(self.command(*flags, **keywords), capture_output=True, text=True, timeout=100)
        self.assertEqual(done.returncode, status, done.stderr)
        return json.loads(done.stdout)["runs"][0], self.results()

    def run_until(self, probe, *flags, status=0, **keywords):
        """The same of a run without an end, which is told to stop as soon as probe(tool) says so."""
        command = self.command(*flags, activations=0, **keywords)
        with open(self.path("out"), "w+") as out, open(self.path("err"), "w+") as err:
            tool = subprocess.Popen(command, stdout=out, stderr=err)
            try:
                wait_for("what the run is for", lambda: probe(tool), tool)
            finally:
                tool.terminate()
                tool.wait(timeout=60)
            out.seek(0)
            err.seek(0)
            self.err = err.read()
            self.assertEqual(tool.returncode, status, self.err)
            return json.loads(out.read())["runs"][0], self.results()

    @classmethod
    def expected(cls):
        """What the app publishes for the first 1000 releases, by topic: {number: value}."""
        if cls.of_1000 is None:
            done = subprocess.run(cls.command("--lockstep", activations=1000), capture_output=True, text=True, timeout=100)
            assert done.returncode == 0, done.stderr
            cls.of_1000 = cls.results()
        return cls.of_1000

    def assert_true_results(self, got, topics="cd"):
        """None that is not what the app publishes for that release."""
        for topic in topics:
            known = {number: value for number, value in got[topic].items() if int(number) < 1000}
            self.assertTrue(known, topic)
            self.assertLessEqual(known.items(), self.expected()[topic].items())

    @classmethod
    def results(cls):
        topics = collections.defaultdict(dict)
        for line in pathlib.Path(cls.path("result")).read_text().splitlines():
            topic, number, value = line.split()
            assert number not in topics[topic], line
            topics[topic][number] = value
        return topics

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
        run, got = self.run_app("--isolate", *self.deploy(**QUEUES), fault=("crash", "B", 50), status=1)
        self.assert_counts_add_up(run, 200)
        self.assertEqual(sorted(map(int, got["d"])), list(range(200)))
        self.assertEqual(sorted(map(int, got["c"])), list(range(50)))
        self.assert_true_results(got)
        self.assertIn("the process of B died (signal SIGABRT)", " ".join(run["notes"]))

    def test_a_crashed_module_is_started_again(self):
        run, got = self.run_until(lambda tool: activations(tool).get("C", 0) > 60, "--isolate", "--restarts", 1,
                                  *self.deploy(**QUEUES), fault=("crash", "B", 50), status=1)
        self.assert_counts_add_up(run, run["activations"] + run["lost_activations"])
        self.assert_true_results(got)
        numbers = sorted(map(int, got["c"]))
        self.assertEqual(numbers[:50], list(range(50)))
        self.assertGreater(numbers[50], 50)
        self.assertIn("was started again", " ".join(run["notes"]))

    def test_a_slow_module_loses_its_own_and_holds_up_nobody(self):
        # B takes 50 ms where a message comes every 2 ms: it would need 10 s for all of them.
        flags = self.deploy(**QUEUES, modules={"B": {"overload": "newest"}})
        run, got = self.run_app("--isolate", *flags, fault=("slow", "B", 0, 50), status=1)
        self.assert_counts_add_up(run, 200)
        self.assertEqual(len(got["d"]), 200)
        lost = {m["name"]: m["dropped"] for m in run["modules"]}
        self.assertGreater(lost["B"], 0)
        self.assertEqual((lost["A"], lost["D"], lost["C"]), (0, 0, 200 - len(got["c"])))
        self.assertEqual(run["lost_activations"], 200 - len(got["c"]))

    def test_a_process_that_ends_before_it_is_ready_ends_the_run(self):
        done = subprocess.run(self.command("--isolate", fault=("exit", "B", 0)), capture_output=True, text=True,
                              timeout=60)
        self.assertEqual(done.returncode, 1)
        self.assertIn("ended before it was ready", done.stderr)


if __name__ == "__main__":
    unittest.main()
