# SPDX-License-Identifier: Apache-2.0
"""Whatever is killed at whatever moment, nothing is left: no process, no socket, no file, no hung call."""
import os
import pathlib
import random
import signal
import subprocess
import tempfile
import time
import unittest

from common import APP, DRIVING, XAUTO, alive, children_of, xauto

ROUNDS = int(os.environ.get("XAUTO_KILL_ROUNDS", "6"))


class Kill(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.policy = os.path.join(cls.folder.name, "policy.json")
        done = xauto("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", cls.policy)
        assert done.returncode == 0, done.stderr

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def start(self):
        before = set(os.listdir("/dev/shm"))
        # With queues, a machine that cannot keep up loses nothing either: what is lost, a death has lost.
        tool = subprocess.Popen([XAUTO, "run", "--app", APP, "--policy", self.policy, "--platform", "small", "--emulate",
                                 "--overload", "queue:64", "--activations", "100000", "--period-us", "120000", "--", DRIVING],
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline:  # until all of them are there: 6 coordinators, emud, the app
            family = children_of(tool.pid)
            if len(family) == 8 and "driving" in family.values():
                return tool, family, before
            time.sleep(0.01)
        tool.kill()
        self.fail("the run did not start: " + tool.communicate()[1])

    def assert_nothing_left(self, tool, family, before):
        deadline = time.monotonic() + 5
        while any(alive(pid) for pid in family) and time.monotonic() < deadline:
            time.sleep(0.01)
        self.assertEqual([f"{pid} {name}" for pid, name in family.items() if alive(pid)], [])
        sockets = pathlib.Path("/proc/net/unix").read_text()
        self.assertNotIn(f"@xauto/{tool.pid}-", sockets)
        self.assertEqual(set(os.listdir("/dev/shm")) - before, set())

    def wait_until_it_runs(self):
        deadline = time.monotonic() + 20
        while '"state": "running"' not in xauto("status", "--json").stdout:
            self.assertLess(time.monotonic(), deadline, "no job runs")

    def kill_one(self, name, signum, seed, running=False):
        """At a random moment, start-up included unless `running`."""
        tool, family, before = self.start()
        rng = random.Random(seed)
        if running:
            self.wait_until_it_runs()
        time.sleep(rng.uniform(0, 0.4))
        victims = [pid for pid, n in family.items() if n.startswith(name)] if name else [tool.pid]
        self.assertTrue(victims)
        os.kill(rng.choice(victims), signum)
        return tool, family, before

    def test_coordinator(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.kill_one("xauto-coordinat", signal.SIGKILL, seed, running=True)
                time.sleep(0.5)
                self.assertIsNone(tool.poll(), "the app goes on")
                self.assertEqual(len(children_of(tool.pid)), 8, "it was started again")
                tool.send_signal(signal.SIGTERM)  # drains: what is in flight ends
                out, err = tool.communicate(timeout=30)
                self.assertIn("and was started again", out + err)
                self.assertNotIn("unscheduled", out + err)
                self.assertNotIn("activations were lost", out)
                self.assertNotIn("was killed", out)
                self.assert_nothing_left(tool, family, before)

    def test_emulator(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                running = seed % 2 == 0
                tool, family, before = self.kill_one("xauto-emud", signal.SIGKILL, seed, running)
                out, err = tool.communicate(timeout=40)
                self.assertEqual(tool.returncode, 1, err)
                if running:
                    self.assertIn("the emulated XPUs are gone", out + err)
                self.assert_nothing_left(tool, family, before)

    def test_app(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.kill_one("driving", signal.SIGKILL, seed)
                _, err = tool.communicate(timeout=30)
                self.assertEqual(tool.returncode, 1, err)
                self.assertIn("ended without an answer (signal SIGKILL)", err)
                self.assert_nothing_left(tool, family, before)

    def test_tool(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.kill_one(None, signal.SIGKILL, seed)
                tool.communicate(timeout=30)
                self.assert_nothing_left(tool, family, before)

    def test_coordinator_during_start_up(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.kill_one("xauto-coordinat", signal.SIGKILL, seed)
                tool.send_signal(signal.SIGTERM)
                tool.communicate(timeout=30)  # started or not: it ends
                self.assertIn(tool.returncode, (0, 1))
                self.assert_nothing_left(tool, family, before)

    def test_interrupt_drains_and_reports(self):
        for running in (False, True):
            tool, family, before = self.kill_one(None, signal.SIGINT, 1, running)
            out, err = tool.communicate(timeout=12)  # less than the time after which it would be killed
            self.assertIn("stopped by the user", out + err)
            if running:
                self.assertIn("end-to-end latency in ms", out)
            self.assert_nothing_left(tool, family, before)


if __name__ == "__main__":
    unittest.main()
