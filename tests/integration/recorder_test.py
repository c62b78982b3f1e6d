#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The trace is a flight recorder: the newest is kept, what was dropped is told, misses and hangs are written at once.
Trace files are read without any code of ours (pftrace.py)."""
import json
import os
import pathlib
import subprocess
import tempfile
import unittest

import pftrace
from common import TESTAPP, XAUTO, testapp_files, wait_for, xauto


def releases(trace):
    return sorted(s.args["release"] for s in trace.on("releases") if "release" in s.args)


class Recorder(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def path(self, name):
        return os.path.join(self.folder, name)

    def test_the_newest_is_kept_and_what_was_dropped_is_told(self):
        files = testapp_files(self.folder)
        run = ["run", *files, "--activations", 800, "--trace-out", self.path("t.pftrace"), "--out", self.path("r.json")]
        app = ["--", TESTAPP, self.path("result"), "period", 4000]
        done = xauto(*run, "--trace-keep", "200ms", *app)
        report = json.loads(pathlib.Path(self.path("r.json")).read_text())["runs"][0]
        dropped = report["trace_events_overwritten"]
        self.assertGreater(dropped, 0, done.stderr)
        self.assertLess(report["trace_us"], 3_000_000)
        self.assertRegex(done.stdout, rf"holds the last \d+\.\d s of \d+\.\d s; {dropped} older events were dropped")
        trace = pftrace.Trace(pathlib.Path(self.path("t.pftrace")).read_bytes())
        kept = releases(trace)
        self.assertEqual(kept[-1], 799)
        self.assertGreater(kept[0], 100)
        self.assertEqual(kept, list(range(kept[0], 800)))
        self.assertEqual(trace.counters["counters/older trace events dropped"][-1][1], dropped)
        explained = xauto("explain", "--trace", self.path("t.pftrace"))
        self.assertIn(f"{dropped} older events were dropped", explained.stdout, explained.stderr)
        self.assertEqual(json.loads(xauto("explain", "--trace", self.path("t.pftrace"), "--json").stdout)
                         ["events_dropped_before"], dropped)
        page = self.path("page.html")
        self.assertEqual(xauto("report", self.path("t.pftrace"), "--out", page).returncode, 0)
        self.assertIn(f"{dropped} older events were dropped", pathlib.Path(page).read_text())

        whole = xauto(*run, "--trace-keep", "1min", *app)
        self.assertNotIn("older events", whole.stdout)
        self.assertEqual(releases(pftrace.Trace(pathlib.Path(self.path("t.pftrace")).read_bytes())), list(range(800)))

    def until_there(self, tool, name):
        wait_for(name, lambda: os.path.exists(self.path(name)), tool)
        return pftrace.Trace(pathlib.Path(self.path(name)).read_bytes())

    def test_a_miss_is_written_while_the_run_goes_on(self):
        files = testapp_files(self.folder, period_us=50_000, deadline_us=1_000_000)
        tool = subprocess.Popen([XAUTO, "run", *files, "--activations", "0", "--overload", "queue:64", "--trace-out",
                                 self.path("t.pftrace"), "--", TESTAPP, self.path("result"), "hang", "B", "20", "1500"],
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            trace = self.until_there(tool, "t.miss-1.pftrace")
        finally:
            tool.terminate()
            _, err = tool.communicate(timeout=60)
        # B slept for 1.5 s in activation 20: in the dump are its release and its job.
        self.assertIn(20, releases(trace))
        slept = [s for s in trace.on("run") if s.name == "b1" and s.args.get("release") == 20]
        self.assertGreater(sum(s.end - s.begin for s in slept), 1_400_000_000)
        told = [s for s in trace.slices if s.category == "incident"]
        self.assertIn("release 20 missed its deadline", " ".join(s.name for s in told))
        self.assertIn("t.miss-1.pftrace", err)
        self.assertLessEqual(len([n for n in os.listdir(self.folder) if ".miss-" in n]), 3)

    def test_a_hang_is_written_while_it_hangs(self):
        files = testapp_files(self.folder, {"modules": {"D": {"hang_us": 100_000, "on_hang": "log"}}}, period_us=50_000)
        tool = subprocess.Popen([XAUTO, "run", *files, "--activations", "0", "--overload", "queue:64", "--trace-out",
                                 self.path("t"), "--",
                                 TESTAPP, self.path("result"), "hang", "D", "10", "4000"],
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            trace = self.until_there(tool, "t.hang-1.pftrace")
        finally:
            tool.terminate()
            _, err = tool.communicate(timeout=60)
        told = [s for s in trace.slices if s.category == "incident"]
        self.assertEqual([s.name for s in told], ["d1 ran past its hang limit of 100 ms"])
        self.assertIn("d1 ran past its hang limit", err)
        self.assertFalse([n for n in os.listdir(self.folder) if ".miss-" in n])


if __name__ == "__main__":
    unittest.main()
