#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`xauto run --fail-on`: each word trips on what it names, and on nothing else."""
import json
import os
import signal
import subprocess
import tempfile
import time
import unittest

from common import TESTAPP, XAUTO, children_of, testapp_files, xauto


class Gate(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def run_app(self, words, *app, deployment=None, activations=40, **of_app):
        files = testapp_files(self.folder, deployment, **of_app)
        fail_on = ["--fail-on", words] if words else []
        done = xauto("run", *files, "--activations", activations, "--json", *fail_on, "--", TESTAPP,
                     os.path.join(self.folder, "result"), "period", 20000, *app)
        return done, json.loads(done.stdout)["runs"][0] if done.stdout else None

    def test_a_missed_deadline(self):
        # Every job of B takes 30 ms; queued, so that none is lost.
        slow = ["slow", "B", 0, 30, "period", 50000]
        done, run = self.run_app("", *slow, deadline_us=20_000)
        self.assertEqual((done.returncode, run["lost_activations"]), (0, 0), done.stderr)
        self.assertNotIn("fail_on", run)
        done, run = self.run_app("lost,miss", *slow, deadline_us=20_000)
        self.assertEqual(done.returncode, 1)
        late = run["activations"]  # all of them: 30 ms are more than 20
        self.assertEqual(run["fail_on"], {"miss": late, "lost": 0})
        self.assertIn(f"--fail-on miss: {late} ", done.stderr)
        self.assertNotIn("--fail-on lost", done.stderr)
        done, run = self.run_app("miss", deadline_us=5_000_000)
        self.assertEqual((done.returncode, run["fail_on"]), (0, {"miss": 0}), done.stderr)

    def test_a_lost_activation(self):
        done, run = self.run_app("lost", "throw", "A", 3)
        self.assertEqual((done.returncode, run["fail_on"]), (1, {"lost": run["lost_activations"]}), done.stderr)
        self.assertGreaterEqual(run["lost_activations"], 1)
        self.assertIn("--fail-on lost: ", done.stderr)

    def test_a_hang(self):
        limit = {"modules": {"D": {"hang_us": 10_000, "on_hang": "log", "overload": "queue:8"}}}
        done, run = self.run_app("hang", "hang", "D", 3, 60, deployment=limit)
        self.assertEqual((done.returncode, run["fail_on"]), (1, {"hang": 1}), done.stderr)
        self.assertIn("--fail-on hang: 1 ", done.stderr)

    def test_a_coordinator_that_was_started_again(self):
        files = testapp_files(self.folder)
        for words, status in ([], 0), (["--fail-on", "restart,lost"], 1):  # what queues meanwhile is not lost
            tool = subprocess.Popen([XAUTO, "run", *files, "--activations", "150", "--overload", "queue:16", "--json",
                                     *words, "--", TESTAPP, os.path.join(self.folder, "result"), "period", "20000"],
                                    stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            coordinators, deadline = [], time.monotonic() + 30
            while len(coordinators) < 2 and time.monotonic() < deadline:
                time.sleep(0.05)
                coordinators = [pid for pid, name in children_of(tool.pid).items() if name == "xauto-coordinat"]
            time.sleep(0.5)
            os.kill(coordinators[0], signal.SIGKILL)
            out, err = tool.communicate(timeout=60)
            self.assertEqual(tool.returncode, status, err)
            if words:
                counts = json.loads(out)["runs"][0]["fail_on"]
                self.assertEqual(counts["restart"], 1)
                self.assertEqual(counts["lost"], 0)
                self.assertIn("--fail-on restart: 1 ", err)

    def test_what_cannot_be_is_refused(self):
        done, _ = self.run_app("miss,late")
        self.assertEqual(done.returncode, 2)
        for word in ("late", "miss", "lost", "hang", "restart"):
            self.assertIn(word, done.stderr)
        for word in ("miss", "hang"):  # it could not fail, whatever happens
            done, _ = self.run_app(word)
            self.assertEqual(done.returncode, 2)
            self.assertIn(f"--fail-on {word}", done.stderr)


if __name__ == "__main__":
    unittest.main()
