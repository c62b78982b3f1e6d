#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What never ends, and what is never suspended, is named: in the report and while the run goes on. No claim stands beside it.

No test here depends on time: what is asked for happens for certain, or never."""
import json
import os
import pathlib
import re
import signal
import subprocess
import tempfile
import unittest

from common import BIN, TESTAPP, XAUTO, activations, children_of, testapp_files, top, wait_for, xauto

FAULTY = str(BIN / "faulty")
HUNG = r"XNode 'slow\.b' of XModule 'Slow' has run for \d+\.\d\d ms and has not ended; its WCET is 37\.78 ms"
FOR_EVER_MS = 100_000_000


class Unended(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = folder.name

        def write(name, value):
            path = os.path.join(cls.folder, name)
            pathlib.Path(path).write_text(json.dumps(value))
            return path
        cls.write = staticmethod(write)
        platform = write("npu.json", {"schema": "xauto.platform", "version": 1, "name": "npu", "xpus": [
            {"id": "npu0", "type": "npu", "preemptive": True, "preempt_us": 1000}]})
        # Every machine releases in time for such jitters, or the run says that it did not.
        app = write("app.json", {
            "schema": "xauto.app", "version": 3, "name": "faulty",
            "sources": [{"name": "fast", "period_us": 20000, "jitter_us": 2000},
                        {"name": "slow", "period_us": 120000, "jitter_us": 2000}],
            "modules": [{"name": "Fast", "max_in_flight": 1}, {"name": "Slow", "max_in_flight": 1}],
            "xnodes": [{"name": "fast.a", "module": "Fast", "source": "fast", "wcet_us": {"npu": 3894}, "real_on": ["npu"]},
                       {"name": "slow.b", "module": "Slow", "source": "slow", "wcet_us": {"npu": 37778}, "real_on": ["npu"]}],
            "edges": [], "chains": [{"name": "fast", "from": "fast", "to": "fast.a", "deadline_us": 12000},
                                    {"name": "slow", "from": "slow", "to": "slow.b", "deadline_us": 110000}]})
        policy = os.path.join(cls.folder, "policy.json")
        done = xauto("solve", "--app", app, "--platform", platform, "--time-limit", "1s", "--out", policy)
        assert done.returncode == 0, done.stderr
        cls.flags = ["--app", app, "--platform", platform, "--policy", policy, "--real"]

    def start(self, fault, *flags):
        """A run of `faulty`; its report comes by `report`."""
        tool = subprocess.Popen([XAUTO, "run", *self.flags, "--json", *map(str, flags), "--", FAULTY, fault],
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addCleanup(self.end, tool)
        return tool

    @staticmethod
    def end(tool):
        if tool.poll() is None:
            tool.kill()
        tool.communicate()

    def report(self, tool, status=1):
        out, err = tool.communicate(timeout=120)
        self.assertEqual(tool.returncode, status, err)
        return json.loads(out)["runs"][0], err

    def run_app(self, fault, *flags, status=1):
        return self.report(self.start(fault, "--duration", "1s", *flags), status)

    def live(self, pattern, tool):
        """What `xauto top --once` says of the claims of this run, once it is so."""
        def look():
            runs = json.loads(xauto("top", "--once", "--json", "--interval", "50ms").stdout)["runs"]
            found = [line for run in runs if run["run"] == f"{tool.pid}-0" and "claims" in run
                     for line in run["claims"]["broken"] if re.search(pattern, line)]
            return found[0] if found else None
        return wait_for(pattern, look, tool)

    def assert_broken(self, run, pattern):
        self.assertRegex("\n".join(run["claims"]["broken"]), pattern)

    def test_a_job_that_never_ends_is_named_and_what_has_no_result_is_counted(self):
        deployment = self.write("hang.json", {"schema": "xauto.deployment", "version": 1, "app": "faulty",
                                              "defaults": {"hang_us": 200_000, "on_hang": "log"}})
        run, err = self.run_app("exec", "--deployment", deployment)
        self.assertFalse(run["complete"])
        self.assert_broken(run, HUNG)
        self.assert_broken(run, "1 job of XNode 'slow.b' of XModule 'Slow' ran past its hang limit")
        # Slow had 5 results. All others of its releases have none, and their deadlines have passed.
        slow = {m["name"]: m for m in run["modules"]}["Slow"]
        chain = {c["name"]: c for c in run["chains"]}["slow"]
        self.assertEqual((slow["activations"], slow["failed"], slow["dropped"]), (5, 0, 0))
        released = 5 + slow["unended"]
        self.assertIn(released, (8, 9))
        self.assert_broken(run, fr"the run is not complete: .*{slow['unended']} of {released} activations of XModule 'Slow'.* did not end")
        self.assertEqual((chain["results"], chain["lost"], chain["deadline_misses"]), (5, slow["unended"], slow["unended"]))
        self.assertGreaterEqual(run["deadline_misses"], slow["unended"])
        self.assertGreaterEqual(run["lost_activations"], slow["unended"])
        of_b = {x["name"]: x for x in run["limited_xnodes"]}["slow.b"]
        self.assertEqual((of_b["jobs"], of_b["unended"]), (5, 1))
        self.assertGreater(of_b["unended_us"], 9_000_000)
        self.assertRegex(err, r"is not complete: .* of XModule 'Slow'")

    def test_it_is_named_while_the_run_goes_on(self):
        tool = self.start("exec", "--duration", "3600s")
        self.live(HUNG, tool)  # before it, a machine that is slow has others that outran their WCET
        self.assertRegex("\n".join(top(tool)["claims"]["broken"]), HUNG)
        self.assertRegex(xauto("top", "--once").stdout, "not claimed here: .*" + HUNG)

    def test_a_suspend_that_fails_is_counted_and_told_once(self):
        for fault, why in (("suspend-fails", "told to"), ("suspend-throws", "suspend threw: told to")):
            run, err = self.run_app(fault, status=0)
            seen = {a["kind"]: a["count"] for a in run["claims"]["assumptions"]}
            self.assertNotIn("failed_resumption", seen)
            self.assertGreater(seen["failed_suspension"], 2)
            self.assert_broken(run, f"preemption failed {seen['failed_suspension']} times on npu0: the work of XNode 'slow.b' was not suspended")
            self.assertEqual(err.count("was not suspended for a more urgent job on npu0"), 1, err)
            self.assertIn(why, err)

    def test_a_resume_that_fails_is_named_at_once(self):
        tool = self.start("resume-fails", "--duration", "3600s")
        self.live(r"preemption failed \d+ times? on npu0: the work of XNode 'slow\.b' was not resumed", tool)
        self.live(HUNG, tool)  # it stands still
        tool.terminate()
        run, err = self.report(tool)
        seen = {a["kind"]: a["count"] for a in run["claims"]["assumptions"]}
        self.assertNotIn("failed_suspension", seen)
        self.assertGreaterEqual(seen["failed_resumption"], 1)
        self.assertEqual(err.count("the work of XNode 'slow.b' was not resumed on npu0"), 1, err)

    def test_a_call_that_never_returns_ends_the_run_with_its_report(self):
        for call in ("suspend", "resume"):
            tool = self.start(f"{call}-hangs", "--duration", "3s")
            self.live(f"preemption failed 1 time on npu0: the work of XNode 'slow.b' was not {call}e?d", tool)
            run, err = self.report(tool)
            self.assertFalse(run["complete"])
            self.assertIn(f"the {call} of XNode 'slow.b' on npu0 never returned; its thread was left behind",
                          " ".join(run["notes"]))
            self.assert_broken(run, f"the run is not complete: .*the {call} of XNode 'slow.b' on npu0 never returned")
            self.assertIn("on npu0: it has not returned for a second", err)

    def test_an_app_of_one_rate_counts_what_was_released(self):
        """By testapp, whose D hangs in release 10."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        flags = testapp_files(folder.name, period_us=10_000, deadline_us=400_000)
        done = xauto("run", *flags, "--overload", "queue:256", "--activations", 50, "--json", "--", TESTAPP,
                     os.path.join(folder.name, "result"), "hang", "D", 10, FOR_EVER_MS)
        self.assertEqual(done.returncode, 1, done.stderr)
        run = json.loads(done.stdout)["runs"][0]
        self.assertEqual((run["activations"], run["lost_activations"]), (10, 40))
        self.assertGreaterEqual(run["deadline_misses"], 40)
        self.assert_broken(run, "the run is not complete: .*40 of 50 activations of XModule 'D' did not end")
        self.assert_broken(run, r"XNode 'd1' of XModule 'D' has run for \d+\.\d\d ms and has not ended; "
                           r"its WCET is 1\.00 ms")
        self.assertIn("40 of 50 activations of XModule 'D' did not end", done.stderr)
        self.assertEqual({m["name"]: m.get("unended", 0) for m in run["modules"]}["D"], 40)

    def test_without_a_rate_nothing_is_released_behind_it(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        done = xauto("run", *testapp_files(folder.name), "--activations", 50, "--json", "--", TESTAPP,
                     os.path.join(folder.name, "result"), "hang", "D", 10, FOR_EVER_MS)
        self.assertEqual(done.returncode, 1, done.stderr)
        run = json.loads(done.stdout)["runs"][0]
        self.assertEqual((run["activations"], run["lost_activations"], run["complete"]), (10, 1, False))
        self.assertEqual({m["name"]: m.get("unended", 0) for m in run["modules"]}["D"], 1)
        self.assert_broken(run, "the run is not complete: .*1 of 11 activations of XModule 'D' did not end")
        self.assert_broken(run, r"XNode 'd1' of XModule 'D' has run for \d+\.\d\d ms and has not ended; "
                           r"its WCET is 1\.00 ms")
        self.assertIn("1 of 11 activations of XModule 'D' did not end", done.stderr)

    def test_a_run_that_was_told_to_stop_says_so_and_claims_nothing(self):
        tool = self.start("", "--duration", "3600s")
        wait_for("results", lambda: sum(activations(tool).values()) > 3, tool)
        for pid in app_of(tool.pid):
            os.kill(pid, signal.SIGTERM)
        run, err = self.report(tool)
        self.assert_broken(run, "the run is not complete: it was told to stop before its end")
        self.assertIn("is not complete: it was told to stop before its end", err)


def app_of(tool):
    """The tool's children that are `faulty`."""
    return [pid for pid, name in children_of(tool).items() if name == "faulty"]


if __name__ == "__main__":
    unittest.main()
