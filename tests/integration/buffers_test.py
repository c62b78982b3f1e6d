#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Frames in buffers (apps/framesapp.cc), in one process and in several: the memory that a reader sees is the camera's, by its
inode; a process that dies takes none of it with it; a recording has the frames' bytes."""
import collections
import json
import pathlib
import subprocess
import tempfile
import unittest

from common import BIN, QUEUES, XAUTO, sourced, wait_for, xauto

FRAMESAPP = str(BIN / "framesapp")
BUFFERS = 6
PLATFORM = {"schema": "xauto.platform", "version": 1, "name": "test",
            "xpus": [{"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 0}]}
APP = sourced({"name": "framesapp",
               "xnodes": [{"name": name + ".x", "module": name, "wcet_us": {"cpu": 1000}} for name in ("look", "crop", "end")],
               "edges": [["crop.x", "end.x"]]}, "frames", 5000)


class Buffers(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        for name, value in (("platform.json", PLATFORM), ("app.json", APP), ("deployment.json", {
                "schema": "xauto.deployment", "version": 1, "app": "framesapp", **QUEUES})):
            (self.folder / name).write_text(json.dumps(value))
        done = xauto("solve", "--app", "app.json", "--platform", "platform.json", "--max-evaluations", 100, "--out", "policy.json",
                     cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)

    def command(self, *flags, file="told", fault=()):
        return [XAUTO, "run", "--app", "app.json", "--policy", "policy.json", "--platform", "platform.json", "--deployment",
                "deployment.json", "--real", "--json", *map(str, flags), "--", FRAMESAPP, file, *map(str, fault)]

    def run_app(self, *flags, status=0, **keywords):
        done = subprocess.run(self.command(*flags, **keywords), cwd=self.folder, capture_output=True, text=True, timeout=120)
        self.assertEqual(done.returncode, status, done.stderr)
        return json.loads(done.stdout)["runs"][0]

    def told(self, file="told"):
        """{module: {release: [inode, descriptors, ok]}}; each release is told once."""
        told = collections.defaultdict(dict)
        for line in (self.folder / file).read_text().splitlines():
            who, release, *what = line.split()
            self.assertNotIn(int(release), told[who], line)
            told[who][int(release)] = what
        return told

    def check_whole(self, told):
        for who in ("look", "crop", "end"):
            for release, (_, _, good) in told[who].items():
                self.assertEqual(good, "ok", f"{who} {release}")

    def test_readers_in_other_processes_see_the_cameras_memory(self):
        for flags in [], ["--isolate"]:
            with self.subTest(flags=flags):
                (self.folder / "told").unlink(missing_ok=True)
                run = self.run_app("--lockstep", "--activations", 300, *flags)
                self.assertEqual(run["lost_activations"], 0)
                told = self.told()
                self.check_whole(told)
                camera = {release: what[0] for release, what in told["camera"].items()}
                self.assertNotIn("none", camera.values(), "in lockstep a buffer is free")
                self.assertLessEqual(len(set(camera.values())), BUFFERS)
                for who in ("look", "crop", "end"):
                    self.assertEqual({release: what[0] for release, what in told[who].items()}, camera, who)
                    descriptors = [int(told[who][release][1]) for release in range(300)]
                    # A process has one or two more for a moment; in 250 releases they would be many.
                    self.assertLessEqual(max(descriptors[50:]), max(descriptors[:50]) + 4, f"{who}: descriptors pile up")

    def test_a_process_that_dies_takes_no_buffer_with_it(self):
        for victim in ("look", "crop", "end"):
            with self.subTest(victim=victim):
                file = "told_" + victim
                tool = subprocess.Popen(self.command("--isolate", "--restarts", 1, "--activations", 0, file=file,
                                                     fault=("crash", victim, 40)), cwd=self.folder,
                                        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
                # Releases whose frame was there.
                told = lambda: {who: {n for n, what in lines.items() if what[0] != "none"} for who, lines in self.told(file).items()}
                try:
                    wait_for("the crash", lambda: (self.folder / (file + ".crashed")).exists(), tool)
                    begin = max(told()["camera"])
                    # Each has frames again, and more of them than there are buffers.
                    wait_for("frames after it", lambda: all(sum(n > begin for n in told().get(who, ())) > 3 * BUFFERS
                                                            for who in ("look", "crop", "end")), tool)
                finally:
                    tool.terminate()
                    out, err = tool.communicate(timeout=60)
                self.assertEqual(tool.returncode, 1, err)
                self.assertIn(f"the process of {victim} died (signal SIGABRT)", " ".join(json.loads(out)["runs"][0]["notes"]))
                self.check_whole(self.told(file))

    def test_a_recording_has_the_bytes_and_feeds_the_app(self):
        for flags in [], ["--isolate"]:
            with self.subTest(flags=flags):
                for file in ("told", "again", "drive.mcap"):
                    (self.folder / file).unlink(missing_ok=True)
                self.run_app("--lockstep", "--activations", 8, "--record", "drive.mcap", *flags)
                info = xauto("recording", "info", "drive.mcap", "--json", cwd=self.folder)
                self.assertEqual(info.returncode, 0, info.stderr)
                self.run_app("--lockstep", "--activations", 8, "--input", "drive.mcap", *flags, file="again")
                told = self.told("again")
                self.assertNotIn("camera", told)
                self.check_whole(told)
                for who in ("look", "crop", "end"):
                    self.assertEqual(sorted(told[who]), list(range(8)))
                    self.assertNotIn("none", [what[0] for what in told[who].values()])


if __name__ == "__main__":
    unittest.main()
