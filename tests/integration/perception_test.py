# SPDX-License-Identifier: Apache-2.0
"""The perception example, on this machine's real cores: what its nets find is what ONNX Runtime's package for node finds
in the same frames, with scaling and decoding of its own; and the check of that can fail."""
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

from common import BIN, SOURCE, xauto

ONNX = SOURCE / "build/onnx"
VIDEO = SOURCE / "build/pedestrians/vtest.avi"
PLATFORM = SOURCE / "examples/perception/platform.json"


class Perception(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)

    def path(self, name):
        return os.path.join(self.folder.name, name)

    def check(self):
        return subprocess.run(["node", SOURCE / "examples/perception/check.js", ONNX, self.folder.name], capture_output=True, text=True)

    def run_nets(self, faces, lines):
        command = [BIN / "perception", VIDEO, ONNX / "nets", self.folder.name, faces, lines]
        tail = ["--platform", PLATFORM]
        for step in (["profile", "--real", *tail, "--warmup", 1, "--repetitions", 2, "--app-out", self.path("app.json"), "--", *command],
                     ["solve", "--app", self.path("app.json"), *tail, "--time-limit", "1s", "--out", self.path("policy.json")],
                     ["run", "--real", "--lockstep", "--activations", 26, "--app", self.path("app.json"), *tail,
                      "--policy", self.path("policy.json"), "--", *command]):
            done = xauto(*step)
            self.assertEqual(done.returncode, 0, done.stderr + done.stdout)

    def test_nets_find_what_the_reference_finds(self):
        for variant in (("128", "tiny-320"), ("256", "tiny-512")):
            with self.subTest(variant):
                self.run_nets(*variant)
                done = self.check()
                self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
                self.assertGreater(os.path.getsize(self.path("frame-12.png")), 100_000)

        whole = pathlib.Path(self.path("scenes.json")).read_text()
        for change in (lambda f: f["faces"].clear(), lambda f: f["faces"].append([0.9, 1, 1, 9, 9]), lambda f: f["lines"].__delitem__(slice(0, 9)),
                       lambda f: [line.__setitem__(1, line[1] + 9) for line in f["lines"][:9]]):
            scenes = json.loads(whole)
            for frame in scenes["frames"]:
                change(frame)
            pathlib.Path(self.path("scenes.json")).write_text(json.dumps(scenes))
            self.assertEqual(self.check().returncode, 1)

    def test_a_file_that_is_another_net_is_refused(self):
        nets = self.path("nets")
        shutil.copytree(ONNX / "nets", nets)
        shutil.copy(f"{nets}/mlsd_512x512_tiny.onnx", f"{nets}/mlsd_320x320_tiny.onnx")
        done = xauto("profile", "--real", "--platform", PLATFORM, "--repetitions", 1, "--", BIN / "perception", VIDEO, nets, self.folder.name)
        self.assertNotEqual(done.returncode, 0)
        self.assertIn('"input_image_with_alpha:0" is float32 1x512x512x4 in the model, and the app counts on float32 1x320x320x4', done.stderr)


if __name__ == "__main__":
    for there, how in ((ONNX / "whole", "scripts/fetch-onnx.sh, which needs npm's registry"), (VIDEO, "scripts/fetch-video.sh"),
                       (BIN / "perception", "scripts/setup.sh pedestrians, then cmake and ninja")):
        if not there.exists():
            print(f"{there} is not there: {how}")
            sys.exit(77)
    if not shutil.which("node"):
        print("node is not there: scripts/setup.sh node")
        sys.exit(77)
    unittest.main()
