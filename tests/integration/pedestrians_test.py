# SPDX-License-Identifier: Apache-2.0
"""The pedestrians example on its real video, on this machine's real cores, under two policies: the tracks are
the golden ones whatever the schedule, and whichever of the two implementations runs."""
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

from common import BIN, SOURCE, xauto

VIDEO = SOURCE / "build/pedestrians/vtest.avi"
PLATFORM = SOURCE / "examples/pedestrians/platform.json"


class Pedestrians(unittest.TestCase):
    def setUp(self):
        self.assertTrue(VIDEO.is_file(), f"{VIDEO} is missing: run scripts/fetch-video.sh")
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)

    def test_tracks_are_the_golden_ones(self):
        path = lambda name: os.path.join(self.folder.name, name)
        command = [BIN / "pedestrians", VIDEO, self.folder.name]
        done = xauto("profile", "--real", "--platform", PLATFORM, "--warmup", 1, "--repetitions", 4,
                     "--app-out", path("app.json"), "--", *command)
        self.assertEqual(done.returncode, 0, done.stderr)
        for faster in ("cpu", "opencl"):
            app = json.loads(pathlib.Path(path("app.json")).read_text())
            for xnode in app["xnodes"]:  # make the solver prefer one, then the other
                if len(xnode["wcet_us"]) == 2:
                    xnode["wcet_us"][faster] = 1
            pathlib.Path(path("one.json")).write_text(json.dumps(app))
            for step in (["solve", "--time-limit", "1s", "--out", path("policy.json")],
                         ["run", "--real", "--lockstep", "--activations", 60, "--policy", path("policy.json")]):
                tail = ["--", *command] if step[0] == "run" else []
                done = xauto(step[0], "--app", path("one.json"), "--platform", PLATFORM, *step[1:], *tail)
                self.assertEqual(done.returncode, 0, done.stderr + done.stdout)
            placed = {x["name"]: x["xpu"] for x in json.loads(pathlib.Path(path("policy.json")).read_text())["xnodes"]}
            self.assertEqual(placed["in.grey"].rstrip("01"), faster)
            check = subprocess.run([sys.executable, SOURCE / "examples/pedestrians/check.py", path("detections.json"),
                                    SOURCE / "tests/golden/pedestrians.json"], capture_output=True, text=True)
            self.assertEqual(check.returncode, 0, check.stdout + check.stderr)
            self.assertGreater(os.path.getsize(path("annotated.png")), 100_000)


if __name__ == "__main__":
    unittest.main()
