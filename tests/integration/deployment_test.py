# SPDX-License-Identifier: Apache-2.0
"""deployment.json at work: processes, budgets, what is done about an XNode that hangs, chains with deadlines.
Nothing here depends on how fast the machine is: limits are either exceeded for certain or never."""
import json
import os
import pathlib
import signal
import subprocess
import time
import unittest

from common import QUEUES, activations, alive, children_of
from isolate_test import Case

FOR_EVER_MS = 100_000_000


class Deployment(Case):
    def limited(self, run, name):
        return {x["name"]: x for x in run["limited_xnodes"]}[name]

    def test_modules_of_one_process_name_share_one(self):
        _, expected = self.run_app("--lockstep")
        flags = self.deploy(defaults={"isolate": True}, modules={
            "A": {"process": "left"}, "B": {"process": "left"}, "D": {"isolate": False}})
        run, got = self.run_app("--lockstep", *flags)
        self.assertEqual(run["lost_activations"], 0)
        self.assertEqual(got, expected)

    def test_jobs_over_their_budget_are_counted_and_go_on(self):
        flags = self.deploy(budgets_us={"b1": 2000, "d1": 1_000_000_000})
        run, got = self.run_app("--lockstep", *flags, fault=("slow", "B", 0, 3), activations=40)
        self.assertEqual(run["lost_activations"], 0)
        b1, d1 = self.limited(run, "b1"), self.limited(run, "d1")
        self.assertEqual((b1["jobs"], b1["overruns"]), (40, 40))
        self.assertGreaterEqual(b1["longest_us"], 3000)
        self.assertEqual((d1["jobs"], d1["overruns"]), (40, 0))
        self.assertEqual(len(got["c"]), 40)

    def test_a_hang_that_is_only_logged_loses_nothing(self):
        flags = self.deploy(modules={"B": {"hang_us": 1_000_000}})
        run, got = self.run_app("--lockstep", *flags, fault=("hang", "B", 5, 2000), activations=20)
        self.assertEqual(run["lost_activations"], 0)
        self.assertGreaterEqual(self.limited(run, "b1")["hangs"], 1)
        self.assertIn("XNode 'b1' on npu0 ran past its hang limit of 1000 ms in activation 5", " ".join(run["notes"]))
        self.assertEqual(len(got["c"]), 20)

    def test_in_one_process_a_hung_module_is_given_up_and_the_run_ends_with_its_report(self):
        flags = self.deploy(modules={"C": {"hang_us": 1_000_000, "on_hang": "drop"}})
        run, got = self.run_app("--lockstep", *flags, fault=("hang", "C", 50, FOR_EVER_MS), status=1)
        self.assert_counts_add_up(run, 200)
        self.assertTrue(run["complete"])
        self.assertEqual(len(got["d"]), 200)  # the others never noticed
        self.assertEqual(max(map(int, got["c"])), 49)
        notes = " ".join(run["notes"])
        self.assertIn("XNode 'c1' on cpu0 ran past its hang limit of 1000 ms in activation 50", notes)
        self.assertIn("an exec of C@cpu0 never returned; its thread was left behind", notes)

    def test_a_run_ends_even_if_nobody_said_what_to_do_about_hangs(self):
        run, got = self.run_app("--overload", "queue:256", fault=("hang", "D", 50, FOR_EVER_MS), status=1)
        self.assertFalse(run["complete"])
        self.assertEqual(max(map(int, got["d"])), 49)
        self.assertIn("never returned", " ".join(run["notes"]))

    RESTART = {**QUEUES, "modules": {"B": {"isolate": True, "restarts": 1, "hang_us": 1_000_000, "on_hang": "restart"}}}

    def assert_b_came_back(self, run, got):
        self.assert_counts_add_up(run, run["activations"] + run["lost_activations"])
        self.assert_true_results(got)
        lost = {m["name"]: m["failed"] + m["dropped"] for m in run["modules"]}
        self.assertEqual((lost["A"], lost["D"], lost["B"]), (0, 0, run["lost_activations"]), "nobody else lost anything")
        self.assertIn("the process of B died (signal SIGKILL) and was started again", " ".join(run["notes"]))

    def test_a_hung_process_is_killed_and_started_again(self):
        run, got = self.run_until(lambda tool: activations(tool).get("C", 0) > 60, *self.deploy(**self.RESTART),
                                  fault=("hang", "B", 50, FOR_EVER_MS), status=1, period=5_000)
        self.assert_b_came_back(run, got)
        numbers = sorted(map(int, got["c"]))
        self.assertEqual(numbers[:50], list(range(50)))
        self.assertNotIn(50, numbers)
        self.assertGreaterEqual(self.limited(run, "b1")["hangs"], 1)

    def test_a_stopped_process_is_killed_and_started_again(self):
        stopped_at = []

        def stop_and_wait(tool):
            done = activations(tool).get("C", 0)
            if not stopped_at:
                victim = [pid for pid, name in children_of(tool.pid).items() if name == "m:B"]
                if done > 10 and victim:
                    os.kill(victim[0], signal.SIGSTOP)
                    stopped_at.append(victim[0])
                return False
            # A few were under way when it was stopped; more than the queues hold are of the next process.
            stopped_at.append(done)
            return not alive(stopped_at[0]) and done > stopped_at[1] + 300

        run, got = self.run_until(stop_and_wait, *self.deploy(**self.RESTART), status=1, period=5_000)
        self.assert_b_came_back(run, got)
        self.assertIn("has not looked after itself", self.err)

    def test_chains_have_latencies_ages_and_deadlines(self):
        flags = self.deploy(**QUEUES, chains=[
            {"name": "late", "from": "src", "to": "C", "deadline_us": 5_000, "max_age_us": 1},
            {"name": "early", "from": "src", "to": "D", "deadline_us": 3_600_000_000}])
        for isolate in ([], ["--isolate"]):
            run, _ = self.run_app(*flags, *isolate, fault=("slow", "B", 0, 6), activations=30, period=10_000)
            chains = {chain["name"]: chain for chain in run["chains"]}
            late, early = chains["late"], chains["early"]
            self.assertEqual((late["results"], late["deadline_misses"], late["age_misses"], late["lost"]),
                             (30, 30, 29, 0))
            self.assertGreaterEqual(late["latency_us"]["p50"], 6_000)
            self.assertGreaterEqual(late["age_us"]["p50"], late["latency_us"]["p50"])
            self.assertEqual((early["results"], early["deadline_misses"]), (30, 0))

    def test_a_lost_release_misses_its_deadline(self):
        flags = self.deploy(chains=[{"name": "x", "from": "src", "to": "C", "deadline_us": 3_600_000_000}])
        run, _ = self.run_app("--lockstep", *flags, fault=("throw", "A", 7), status=1)
        chain = {chain["name"]: chain for chain in run["chains"]}["x"]
        self.assertEqual((chain["results"], chain["lost"], chain["deadline_misses"]), (199, 1, 1))

    def test_what_does_not_fit_is_refused(self):
        cases = [
            ({"modules": {"Z": {}}}, "/modules/Z: XModule 'Z' is not in the app"),
            ({"defaults": {"hang_us": 1, "on_hang": "restart"}}, "has no process of its own to restart"),
            ({"chains": [{"name": "x", "from": "nowhere", "to": "C"}]},
             "chain 'x': 'nowhere' is not the topic of a source"),
            ({"chains": [{"name": "x", "from": "src"}]}, "/chains/0: key \"to\" is missing"),
            ({"app": "another"}, "/app: is for app 'another', not for 'testapp'"),
        ]
        for content, message in cases:
            done = subprocess.run(self.command(*self.deploy(**content)), capture_output=True, text=True, timeout=60)
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertIn(message, done.stderr)
        done = subprocess.run(self.command("--overload", "Z=skip"), capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, 2)
        self.assertIn("--overload: XModule 'Z' is not in the app", done.stderr)

    def test_the_death_of_the_hub_ends_all(self):
        for moment in (0, 0.1, 0.4):
            before = {name for name in os.listdir("/dev/shm") if "xauto" in name}
            tool = subprocess.Popen(self.command("--isolate", "--restarts", 3, activations=100_000),
                                    stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            deadline = time.monotonic() + 60
            family = {}
            while len(family) < 7 and time.monotonic() < deadline:  # 2 coordinators, the hub, 4 modules
                family = children_of(tool.pid)
                time.sleep(0.01)
            time.sleep(moment)
            hub = [pid for pid, name in family.items() if name == "testapp"]
            os.kill(min(hub), signal.SIGKILL)  # started before its members
            _, err = tool.communicate(timeout=60)
            self.assertEqual(tool.returncode, 1, err)
            self.assertIn("ended without an answer (signal SIGKILL)", err)
            deadline = time.monotonic() + 20
            while any(alive(pid) for pid in family) and time.monotonic() < deadline:
                time.sleep(0.01)
            self.assertEqual([pid for pid in family if alive(pid)], [])
            self.assertNotIn(f"@xauto/{tool.pid}-", pathlib.Path("/proc/net/unix").read_text())
            self.assertEqual({name for name in os.listdir("/dev/shm") if "xauto" in name} - before, set())


del Case  # its tests are not ours

if __name__ == "__main__":
    unittest.main()
