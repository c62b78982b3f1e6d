# SPDX-License-Identifier: Apache-2.0
"""An ordinary node of ROS 2 behind gates (examples/gate, with the stand-in of rclcpp in tests/ros2/), from profile to trace: its
callbacks are XNodes like any other. No time is judged. The trace is read by pftrace.py."""
import json
import pathlib
import re
import tempfile
import unittest

import pftrace
from common import BIN, xauto

GATE = str(BIN / "gate")


class Ros2(unittest.TestCase):
    def test_callbacks_are_profiled_planned_run_and_traced(self):
        with tempfile.TemporaryDirectory() as folder:
            def tool(*arguments):
                done = xauto(*arguments, cwd=folder)
                self.assertEqual(done.returncode, 0, done.stderr)
                return done

            folder = pathlib.Path(folder)
            (folder / "platform.json").write_text(json.dumps(
                {"schema": "xauto.platform", "version": 1, "name": "one",
                 "xpus": [{"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 100}]}))
            tool("profile", "--platform", "platform.json", "--repetitions", "5", "--app-out", "app.json", "--",
                 GATE)
            app = json.loads((folder / "app.json").read_text())
            self.assertEqual({(x["name"], x["module"], x["source"]) for x in app["xnodes"]},
                             {("detect.callback", "detect", "detect/ready"),
                              ("statistics.callback", "statistics", "statistics/ready")})
            self.assertEqual({s["name"]: s["period_us"] for s in app["sources"]},
                             {"detect/ready": 9000, "statistics/ready": 90000})
            tool("solve", "--app", "app.json", "--platform", "platform.json", "--time-limit", "1s", "--out", "policy.json")
            done = tool("run", "--app", "app.json", "--platform", "platform.json", "--policy", "policy.json", "--cpu-sched",
                        "other", "--activations", "10", "--trace-out", "t.pftrace", "--json", "--", GATE)
            run = json.loads(done.stdout)["runs"][0]
            modules = {m["name"]: m["activations"] for m in run["modules"]}
            self.assertEqual(set(modules), {"detect", "statistics"})
            self.assertGreater(modules["statistics"], 0)
            # Lost is only what was released as the run ended: a gate has one callback with the app at a time. Releases that a
            # machine that stands still leaves out of the grid had no callback.
            left_out = sum(int(n) for line in run["claims"]["broken"] for n in re.findall(r"left out (\d+) of", line))
            self.assertLessEqual(run["lost_activations"] - left_out, 2)
            jobs = [s.name.split(" ")[0] for s in pftrace.Trace((folder / "t.pftrace").read_bytes()).on("run", "run")]
            self.assertGreaterEqual(jobs.count("detect.callback"), 1)
            self.assertGreaterEqual(jobs.count("statistics.callback"), 1)


if __name__ == "__main__":
    unittest.main()
