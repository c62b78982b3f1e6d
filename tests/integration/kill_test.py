# SPDX-License-Identifier: Apache-2.0
"""Whatever is killed at whatever moment, nothing is left: no process, no socket, no file, no hung call."""
import functools
import json
import os
import pathlib
import random
import shutil
import signal
import subprocess
import tempfile
import time
import unittest

from common import APP, BIN, DRIVING, FULL, XAUTO, activations, alive, children_of, sourced, wait_for, xauto

TESTAPP = str(BIN / "testapp")

ROUNDS = int(os.environ.get("XAUTO_KILL_ROUNDS", "6" if FULL else "2"))


def shared_memory():
    """Files of ours that a run could leave: whoever else is on this machine makes some, too."""
    return {name for name in os.listdir("/dev/shm") if "xauto" in name}


def emulated_testapp(folder, *flags, period_us=15000, work_us=3000):
    """The command of a run whose work is all on the emulator, with preemption on the npu."""
    path = functools.partial(os.path.join, folder)
    xnodes = [("a1", "A", "cpu"), ("a2", "A", "npu"), ("b1", "B", "npu"), ("c1", "C", "cpu"), ("d1", "D", "cpu")]
    pathlib.Path(path("platform.json")).write_text(json.dumps({
        "schema": "xauto.platform", "version": 1, "name": "test", "xpus": [
            {"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 0},
            {"id": "npu0", "type": "npu", "preemptive": True, "preempt_us": 100, "timeslice_us": 500}]}))
    pathlib.Path(path("app.json")).write_text(json.dumps(sourced({
        "name": "testapp",
        "xnodes": [{"name": n, "module": m, "wcet_us": {x: 3000}} for n, m, x in xnodes],
        "edges": [["a1", "a2"], ["a2", "c1"], ["b1", "c1"]]}, "src", period_us)))
    # What waits between processes while the emulator is dead is not lost either.
    pathlib.Path(path("deployment.json")).write_text(json.dumps({
        "schema": "xauto.deployment", "version": 1, "app": "testapp", "queue_depth": 256, "keep": 256}))
    done = xauto("solve", "--app", path("app.json"), "--platform", path("platform.json"), "--max-evaluations", 200,
                 "--out", path("policy.json"))
    assert done.returncode == 0, done.stderr
    return [XAUTO, "run", "--deployment", path("deployment.json"), "--app", path("app.json"), "--policy", path("policy.json"), "--platform",
            path("platform.json"), "--emulate", *map(str, flags), "--", TESTAPP, path("result"), "period",
            str(period_us), "emulated", str(work_us)]


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

    def start(self, program=XAUTO):
        before = shared_memory()
        # In lockstep a machine that cannot keep up loses nothing either: what is lost, a death has lost.
        tool = subprocess.Popen([program, "run", "--app", APP, "--policy", self.policy, "--platform", "small", "--emulate",
                                 "--lockstep", "--activations", "0", "--", DRIVING],
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:  # until all of them are there: 6 coordinators, emud, the app
            family = children_of(tool.pid)
            if len(family) == 8 and "driving" in family.values():
                return tool, family, before
            time.sleep(0.01)
        tool.kill()
        self.fail("the run did not start: " + tool.communicate()[1])

    def assert_nothing_left(self, tool, family, before):
        deadline = time.monotonic() + 30
        while any(alive(pid) for pid in family) and time.monotonic() < deadline:
            time.sleep(0.01)
        self.assertEqual([f"{pid} {name}" for pid, name in family.items() if alive(pid)], [])
        def theirs():
            return [line for line in pathlib.Path("/proc/net/unix").read_text().splitlines() if f"@xauto/{tool.pid}-" in line]
        while theirs() and time.monotonic() < deadline:  # of whoever was started since `family` was looked at
            time.sleep(0.01)
        self.assertEqual(theirs(), [])
        self.assertEqual(shared_memory() - before, set())

    def wait_until_it_runs(self, tool, more=3):
        """Until each module has done a few more activations than by now."""
        of = lambda: min(activations(tool).values(), default=0)
        now = of()
        wait_for("activations", lambda: of() >= now + more, tool)

    def end(self, tool):
        """What it says at its end. It drains: what is in flight ends, and nothing is lost."""
        tool.terminate()
        out, err = tool.communicate(timeout=60)
        self.assertEqual(tool.returncode, 0, out + err)
        return out, err

    def kill_one(self, name, signum, seed, running=False):
        """At a random moment, start-up included unless `running`."""
        tool, family, before = self.start()
        rng = random.Random(seed)
        if running:
            self.wait_until_it_runs(tool)
        time.sleep(rng.uniform(0, 0.4))
        victims = [pid for pid, n in family.items() if n.startswith(name)] if name else [tool.pid]
        self.assertTrue(victims)
        os.kill(rng.choice(victims), signum)
        return tool, family, before

    def wait_for_others(self, tool, victims):
        """Until nobody of them is left, and the family is whole again."""
        wait_for("others in their place", lambda: (now := children_of(tool.pid)) and len(now) == 8 and
                 not set(victims) & set(now), tool)

    def test_coordinator(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.kill_one("xauto-coordinat", signal.SIGKILL, seed, running=True)
                self.wait_for_others(tool, [pid for pid in family if not alive(pid)])
                self.wait_until_it_runs(tool)
                out, err = self.end(tool)
                self.assertIn("and was started again", out + err)
                self.assertNotIn("unscheduled", out + err)
                self.assertNotIn("was killed", out)
                self.assert_nothing_left(tool, family, before)

    def hang(self, name):
        """Stopped, it answers nobody: the tool kills it, and the next one goes on."""
        tool, family, before = self.start()
        self.wait_until_it_runs(tool)
        victims = [pid for pid, n in family.items() if n.startswith(name)]
        for pid in victims:
            os.kill(pid, signal.SIGSTOP)
        # A coordinator is seldom needed, and one that nobody needs is not missed: so somebody asks.
        asks = subprocess.Popen([XAUTO, "top", "--once"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.wait_for_others(tool, victims)
        asks.wait(timeout=60)
        self.wait_until_it_runs(tool)
        out, err = self.end(tool)
        self.assertIn("has hung for 2 s and is killed", err)
        self.assertIn("and was started again", out)
        self.assert_nothing_left(tool, family, before)

    def test_coordinators_that_hang(self):
        self.hang("xauto-coordinat")

    def test_emulator_that_hangs(self):
        self.hang("xauto-emud")

    @staticmethod
    def serves(pid):
        """It waits for events, which is the last thing that a daemon prepares."""
        try:
            return any(os.readlink(fd) == "anon_inode:[eventpoll]" for fd in pathlib.Path(f"/proc/{pid}/fd").iterdir())
        except OSError:
            return False  # something of it has just ended

    def kill_emulator(self, tool):
        """And wait until there is another one."""
        of = lambda: [pid for pid, name in children_of(tool.pid).items() if name == "xauto-emud"]
        victim, = of()
        os.kill(victim, signal.SIGKILL)
        since = time.monotonic()
        while not [pid for pid in of() if pid != victim and self.serves(pid)]:
            self.assertLess(time.monotonic(), since + 60, "it was not started again")
            self.assertIsNone(tool.poll(), "the run has ended")
            time.sleep(0.005)

    def run_testapp(self, folder, *flags, kills=0, seed=0, work_us=3000):
        """Its results {(topic, number): value}; none is missing."""
        path = functools.partial(os.path.join, folder)
        tool = subprocess.Popen(emulated_testapp(folder, "--lockstep", "--activations", "0", *flags,
                                                 work_us=work_us),
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        before = shared_memory()
        rng = random.Random(seed)
        self.wait_until_it_runs(tool, 20)
        family = children_of(tool.pid)
        for _ in range(kills):
            time.sleep(rng.uniform(0, 0.3))
            self.kill_emulator(tool)
        self.wait_until_it_runs(tool)
        out, err = self.end(tool)
        if kills:
            # One that dies before it serves is one more attempt, no death of its own.
            self.assertRegex(out, r"xauto-emud died \(signal SIGKILL\) and was started again, ([2-9]|10) times")
        self.assert_nothing_left(tool, family, before)
        results = {}
        for line in pathlib.Path(path("result")).read_text().splitlines():
            topic, number, value = line.split()
            results[topic, int(number)] = value
        self.assertEqual(set(results), {(topic, k) for topic in "cd" for k in range(len(results) // 2)})
        return results

    def test_emulator(self):
        """Killed again and again in one run: every call goes on at the next one; the results are the same."""
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run(emulated_testapp(folder, "--lockstep", "--activations", "1000", work_us=10),
                                  capture_output=True, text=True, timeout=100)
            self.assertEqual(done.returncode, 0, done.stderr)
            expected = dict(((t, int(k)), v) for t, k, v in map(
                str.split, pathlib.Path(folder, "result").read_text().splitlines()))
            for flags in ([], ["--isolate"]):
                with self.subTest(flags=flags):
                    results = self.run_testapp(folder, *flags, kills=10, seed=1)
                    self.assertLessEqual({k: v for k, v in results.items() if k[1] < 1000}.items(), expected.items())

    def test_emulator_at_random_moments(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.start()
                self.wait_until_it_runs(tool)
                rng = random.Random(seed)
                for _ in range(5):
                    time.sleep(rng.uniform(0, 0.2))
                    self.kill_emulator(tool)
                self.wait_until_it_runs(tool)
                out, err = self.end(tool)  # complete, and nothing was lost
                self.assertIn("xauto-emud died (signal SIGKILL) and was started again", out)  # or more often, see run_testapp
                self.assertNotIn("dropped", out + err)  # no error has reached an exec
                self.assert_nothing_left(tool, family, before)

    def test_emulator_and_a_coordinator(self):
        """Both at once: neither is rebuilt from the other."""
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.start()
                self.wait_until_it_runs(tool)
                rng = random.Random(seed)
                time.sleep(rng.uniform(0, 0.4))
                coordinator = rng.choice([pid for pid, n in family.items() if n.startswith("xauto-coordinat")])
                if rng.random() < 0.5:
                    os.kill(coordinator, signal.SIGKILL)
                    self.kill_emulator(tool)
                else:
                    self.kill_emulator(tool)
                    os.kill(coordinator, signal.SIGKILL)
                self.wait_for_others(tool, [coordinator])
                self.wait_until_it_runs(tool)
                out, err = self.end(tool)
                self.assertEqual(out.count("and was started again"), 2, out)
                self.assert_nothing_left(tool, family, before)

    def test_emulator_during_start_up(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.kill_one("xauto-emud", signal.SIGKILL, seed)
                time.sleep(0.3)
                tool.send_signal(signal.SIGTERM)
                tool.communicate(timeout=60)  # started or not: it ends
                self.assertIn(tool.returncode, (0, 1))
                self.assert_nothing_left(tool, family, before)

    def test_emulator_that_cannot_be_started_again(self):
        """Then its XPUs are gone: every call returns an error, the app is stopped."""
        with tempfile.TemporaryDirectory() as folder:
            for name in ("xauto", "xauto-coordinator", "xauto-emud"):
                shutil.copy(os.path.join(os.path.dirname(XAUTO), name), folder)
            tool, family, before = self.start(os.path.join(folder, "xauto"))
            self.wait_until_it_runs(tool)
            os.unlink(os.path.join(folder, "xauto-emud"))
            os.kill(next(pid for pid, name in family.items() if name == "xauto-emud"), signal.SIGKILL)
            out, err = tool.communicate(timeout=60)
            self.assertEqual(tool.returncode, 1, err)
            self.assertIn("the emulated XPUs are gone", out + err)
            self.assert_nothing_left(tool, family, before)

    def test_app(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.kill_one("driving", signal.SIGKILL, seed)
                _, err = tool.communicate(timeout=60)
                self.assertEqual(tool.returncode, 1, err)
                self.assertIn("ended without an answer (signal SIGKILL)", err)
                self.assert_nothing_left(tool, family, before)

    def test_tool(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.kill_one(None, signal.SIGKILL, seed)
                tool.communicate(timeout=60)
                self.assert_nothing_left(tool, family, before)

    def test_coordinator_during_start_up(self):
        for seed in range(ROUNDS):
            with self.subTest(seed=seed):
                tool, family, before = self.kill_one("xauto-coordinat", signal.SIGKILL, seed)
                tool.send_signal(signal.SIGTERM)
                tool.communicate(timeout=60)  # started or not: it ends
                self.assertIn(tool.returncode, (0, 1))
                self.assert_nothing_left(tool, family, before)

    def test_interrupt_drains_and_reports(self):
        for running in (False, True):
            tool, family, before = self.kill_one(None, signal.SIGINT, 1, running)
            out, err = tool.communicate(timeout=60)
            self.assertIn("stopped by the user", out + err)
            self.assertNotIn("was killed", out + err)
            if running:
                self.assertIn("end-to-end latency in ms", out)
            self.assert_nothing_left(tool, family, before)

    def test_two_signals_at_once_are_one_wish(self):
        """timeout(1) sends one to the tool and one to its group."""
        tool, family, before = self.start()
        self.wait_until_it_runs(tool)
        tool.terminate()
        time.sleep(0.02)
        out, err = self.end(tool)
        self.assertIn("stopped by the user", out + err)
        self.assert_nothing_left(tool, family, before)

    def test_a_later_one_ends_it_at_once(self):
        tool, family, before = self.start()
        self.wait_until_it_runs(tool)
        os.kill(next(pid for pid, name in family.items() if name == "driving"), signal.SIGSTOP)  # so it cannot drain
        tool.terminate()
        time.sleep(0.7)
        tool.terminate()
        tool.communicate(timeout=60)
        self.assertEqual(tool.returncode, -signal.SIGTERM)
        self.assert_nothing_left(tool, family, before)


if __name__ == "__main__":
    unittest.main()
