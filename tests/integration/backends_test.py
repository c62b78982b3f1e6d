#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""GPUs without xauto.ko: a whole run whose processes suspend their own queues, or put them on levels of the
hardware, over drivers of user space (tests/devices). Nothing is left suspended, whoever is killed, and who suspends
is said."""
import json
import os
import pathlib
import signal
import subprocess
import tempfile
import unittest

from common import BIN, XAUTO, alive, children_of, wait_for, xauto

DRIVERS = ("nvgpu", "rm", "kfd", "i915")
APP = {
    "schema": "xauto.app", "version": 3, "name": "queues", "clocks": [],
    "sources": [{"name": "quick", "rate_hz": 50, "jitter_us": 1000}, {"name": "slow", "rate_hz": 5, "offset_us": 5000, "jitter_us": 1000}],
    "modules": [{"name": m, "max_in_flight": 1, "optional": False} for m in ("quickM", "slowM")],
    "xnodes": [{"name": "quick.run", "module": "quickM", "source": "quick", "wcet_us": {"gpu": 1000}},
               {"name": "slow.run", "module": "slowM", "source": "slow", "wcet_us": {"gpu": 60000}}],
    "edges": [], "samples": [],
    "chains": [{"name": "quick", "from": "quick", "to": "quick.run", "deadline_us": 20000},
               {"name": "slow", "from": "slow", "to": "slow.run", "deadline_us": 200000}]}
GPU = {"id": "gpu0", "type": "gpu", "preemptive": True, "preempt_us": 100, "timeslice_us": 1000}


def platform(levels):
    return {"schema": "xauto.platform", "version": 1, "name": "test", "xpus": [GPU | ({"levels": 2} if levels else {})]}


class Backends(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name
        pathlib.Path(self.path("app.json")).write_text(json.dumps(APP))
        for way in ("levels", "suspended"):
            pathlib.Path(self.path(f"{way}.json")).write_text(json.dumps(platform(way == "levels")))
            done = xauto("solve", "--app", self.path("app.json"), "--platform", self.path(f"{way}.json"), "--max-evaluations", 100,
                         "--threads", 1, "--out", self.path(f"{way}.policy.json"))
            self.assertEqual(done.returncode, 0, done.stderr)

    def path(self, name):
        return os.path.join(self.folder, name)

    def start(self, driver, *flags):
        pathlib.Path(self.path("state")).write_text("")  # another run's
        way = "levels" if driver == "i915" else "suspended"
        tool = subprocess.Popen([str(BIN / "on_devices"), driver, self.path("state"), XAUTO, "run", "--app", self.path("app.json"),
                                 "--platform", self.path(f"{way}.json"), "--policy", self.path(f"{way}.policy.json"), "--activations", "0",
                                 "--overload", "newest", "--json", *flags, "--", str(BIN / "queuesapp"), driver, self.path("hold")],
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
        self.addCleanup(self.kill_all, tool)
        return tool

    @staticmethod
    def kill_all(tool):
        """With the run below it, which would go on having the GPU."""
        try:
            os.killpg(tool.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass

    def state(self):
        """What the driver knows; {} before it does."""
        try:
            return json.loads(pathlib.Path(self.path("state")).read_text())
        except (OSError, ValueError):
            return {}

    def until(self, tool, what, said):
        wait_for(what, lambda: (now := self.state()) and said(now), tool)

    def child(self, tool, name):
        return next((pid for pid, n in children_of(tool.pid).items() if n == name), None)

    def end(self, tool):
        """What the run says; nothing is suspended then, and nothing is open."""
        os.kill(self.child(tool, "xauto"), signal.SIGTERM)
        out, err = tool.communicate(timeout=60)
        self.assertEqual(tool.returncode, 0, out + err)
        self.assertEqual((self.state()["queues"], self.state()["suspended"]), (0, 0))
        return json.loads(out)["runs"][0], err

    def hold(self, tool):
        """Until slow is suspended, and stays so: its context is two queues."""
        self.until(tool, "suspensions", lambda now: now["suspensions"] > 4)
        pathlib.Path(self.path("hold")).write_text("")
        self.until(tool, "slow is suspended", lambda now: now["suspended"] == 2)

    def test_each_driver(self):
        for driver in DRIVERS:
            with self.subTest(driver=driver):
                tool = self.start(driver)
                if tool.poll() == 77:
                    self.skipTest(tool.communicate()[1])
                self.until(tool, "suspensions", lambda now: now["suspensions"] > 8)
                run, err = self.end(tool)
                who = "put on priority levels" if driver == "i915" else "suspended"
                self.assertIn(f"work on gpu0 is {who} by each process itself", " ".join(run["notes"]), err)
                if driver != "i915":  # suspends nothing
                    cost, = run["preemptions"]
                    self.assertEqual((cost["xpu"], cost["preempt_us"]), ("gpu0", 100))
                    # The driver counts queues, two of a context; the last suspension may have none that resumes it.
                    self.assertGreaterEqual(cost["suspensions"], 4)
                    self.assertEqual(any("preempt_us" in line for line in run["claims"]["broken"]),
                                     cost["suspend_us"] + cost["resume_us"] > 100)
                seen = {a["kind"] for a in run["claims"]["assumptions"]}
                self.assertFalse(seen & {"unclaimed_queue", "assumed_context", "shared_context", "gated_context",
                                         "held_up_job", "misplaced_job"})

    def test_the_coordinator_is_killed_while_work_is_suspended(self):
        for driver in DRIVERS:
            with self.subTest(driver=driver):
                tool = self.start(driver)
                self.hold(tool)
                victim = self.child(tool, "xauto-coordinat")
                os.kill(victim, signal.SIGKILL)
                wait_for("another one", lambda: self.child(tool, "xauto-coordinat") not in (None, victim), tool)
                before = self.state()["suspensions"]
                os.unlink(self.path("hold"))
                self.until(tool, "suspensions after that", lambda now: now["suspensions"] > before + 8)
                self.end(tool)

    def test_the_app_is_killed_while_its_work_is_suspended(self):
        for driver in DRIVERS:
            with self.subTest(driver=driver):
                tool = self.start(driver)
                self.hold(tool)
                victim = self.child(tool, "queuesapp")
                os.kill(victim, signal.SIGKILL)
                tool.communicate(timeout=60)
                self.assertFalse(alive(victim))
                self.assertEqual((self.state()["queues"], self.state()["suspended"]), (0, 0))
                os.unlink(self.path("hold"))


if __name__ == "__main__":
    unittest.main()
