#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A run is told what its machine did instead of it, and what its own program did beside its XNodes."""
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

from common import HOG, TESTAPP, testapp_files, wait_for, xauto

REPORT = "please report this run"


class Machine(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def run_app(self, *app, seconds=2, before=()):
        """The run of report.json, and what was printed."""
        out = os.path.join(self.folder, "report.json")
        run = ["run", *testapp_files(self.folder), "--duration", f"{seconds}s", "--out", out, "--", TESTAPP,
               os.path.join(self.folder, "result"), *app, "period", 5000]
        done = xauto(*run) if not before else subprocess.run(
            [*before, *map(str, [os.environ["XAUTO_BIN"] + "/xauto", *run])], capture_output=True, text=True, timeout=100)
        with open(out) as f:
            return json.load(f)["runs"][0], done.stdout

    def taken(self, run, words):
        return max((t["us"] for t in run["claims"]["time_taken"] if words in t["what"]), default=0)

    def test_somebody_else_had_the_core(self):
        if os.geteuid() != 0:
            self.skipTest("only root may take a core from a run")
        hog = subprocess.Popen([sys.executable, "-c", HOG, str(min(os.sched_getaffinity(0)))],
                               stdout=subprocess.PIPE, text=True)
        self.addCleanup(hog.stdout.close)
        self.addCleanup(hog.wait)
        self.addCleanup(hog.kill)
        self.assertEqual(hog.stdout.readline(), "there\n")
        run, out = self.run_app()
        # By the kernel's count: some job waited for a tenth of such a time at least.
        self.assertGreater(self.taken(run, "the kernel ran neither it nor another XNode there"), 4_000, run["claims"]["time_taken"])
        self.assertNotIn(REPORT, out)
        # With that time some job was longer than the claim takes for granted; and it says who was there.
        self.assertGreater(self.count(run, "core_taken"), 0, run["claims"])
        words = " ".join(run["claims"]["broken"])
        if "does not serve this app alone" not in words:  # else another test's threads may have been seen there
            self.assertIn(f"python3 (pid {hog.pid}, SCHED_FIFO 98)", words)

    def count(self, run, kind):
        return next((a["count"] for a in run["claims"]["assumptions"] if a["kind"] == kind), 0)

    def test_another_run_has_the_same_cores(self):
        """Two apps, each with claims of its own: neither stands, whoever came first. Emulated XPUs are nobody else's."""
        second = os.path.join(self.folder, "second")
        os.mkdir(second)
        other = subprocess.Popen([os.environ["XAUTO_BIN"] + "/xauto", "run", *map(str, testapp_files(second)), "--duration", "6s", "--out",
                                  second + "/report.json", "--", str(TESTAPP), second + "/result", "period", "5000"],
                                 stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        self.addCleanup(other.kill)
        wait_for("its mark", lambda: f"xauto/{other.pid}-0/" in (held := pathlib.Path("/proc/net/unix").read_text()) and "/real:core" in held, other)
        self.assertRegex(" ".join(xauto("doctor").stdout.split()), rf"degraded in use .*run {other.pid}-0 of uid \d+ has core\d")
        run, out = self.run_app()
        self.assertGreater(self.count(run, "xpu_shared"), 0, run["claims"])
        self.assertRegex(" ".join(run["claims"]["broken"]),
                         r"cpu0 does not serve this app alone: run \d+-0 of uid \d+ has it, too")  # or one of another test that runs beside
        self.assertIn(run["claims"]["verdict"], ("not claimed", "exceeded, not claimed"))
        self.assertNotIn(REPORT, out)
        _, said = other.communicate(timeout=60)
        self.assertEqual(other.returncode, 0, said)
        theirs = json.loads(pathlib.Path(second, "report.json").read_text())["runs"][0]
        self.assertGreater(self.count(theirs, "xpu_shared"), 0, theirs["claims"])
        # Whoever else is named is there: other tests may run beside this one.
        words = " ".join(self.run_app()[0]["claims"]["broken"])
        self.assertNotIn(f"run {other.pid}-0", words)

    def test_an_exec_changes_how_its_thread_is_scheduled(self):
        run, out = self.run_app("batch", "A", 3)
        self.assertRegex(" ".join(run["claims"]["broken"]), "the thread that runs XNode 'a1' of XModule 'A' was given other "
                         "CPUs or another scheduling policy")
        self.assertIn("not claimed here:", out)
        run, _ = self.run_app()
        self.assertNotIn("scheduling policy than", " ".join(run["claims"]["broken"]))

    def test_an_exec_leaves_something_behind(self):
        for kind, words in ("thread", "threads of the program beside"), ("child", "child processes of the program"):
            run, out = self.run_app(kind, "D", 3, 300, seconds=3)
            self.assertGreaterEqual(self.taken(run, words), 250_000, run["claims"]["time_taken"])  # of 300 ms; a look may be early
            self.assertNotIn(REPORT, out)


if __name__ == "__main__":
    unittest.main()
