#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""bench/nvidia/run.sh as somebody with a GPU calls it, for the Driving Case: over a CUDA that is acted out (tests/nvidia),
with RM's nodes. Nothing is measured here. Suspended contexts are left out: this CUDA makes no channels."""
import json
import os
import pathlib
import subprocess
import tempfile
import unittest

from common import BIN, SOURCE

NVCC = """#!/bin/sh
while [ "$1" != -o ]; do shift; done
echo "// acted out" >"$2"
"""


class Bench(unittest.TestCase):
    def test_the_driving_case_runs_in_one_command(self):
        with tempfile.TemporaryDirectory() as folder:
            cuda, out = pathlib.Path(folder) / "cuda", pathlib.Path(folder) / "out"
            libraries = cuda / "lib64/stubs"
            libraries.mkdir(parents=True)
            (cuda / "include").mkdir()
            (cuda / "include/cuda.h").symlink_to(SOURCE / "tests/nvidia/cuda.h")
            for name in "libcuda.so", "libcuda.so.1":
                (libraries / name).symlink_to(BIN.parent / "tests/libstand_in_cuda.so")
            (cuda / "bin").mkdir()
            (cuda / "bin/nvcc").write_text(NVCC)
            (cuda / "bin/nvcc").chmod(0o755)
            done = subprocess.run(
                [BIN / "on_devices", "rm", f"{folder}/state", "bash", SOURCE / "bench/nvidia/run.sh", out, BIN.parent, "driving"],
                env=os.environ | {"PATH": f"{cuda}/bin:{os.environ['PATH']}", "LD_LIBRARY_PATH": str(libraries), "LONG_S": "2",
                                  "SHORT_S": "2", "REPETITIONS": "4", "SOLVE_S": "2", "BLOCK_US": "500"},
                capture_output=True, text=True, timeout=270)
            if done.returncode == 77:
                self.skipTest(done.stderr)
            said = done.stdout + done.stderr
            self.assertEqual(done.returncode, 0, said)
            told = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{"run"')]
            for run in "levels", "by-hand", "by-nobody", "slices":
                chains = {x["chain"]: x for x in told if x["run"] == f"driving-{run}"}
                self.assertGreater(chains["tick -> ctl.act"]["results"], 0, said)
                self.assertEqual(chains["tick -> ctl.act"]["worst_case_us"] is not None, run == "levels", said)
            placed = {x["xpu"] for x in json.loads((out / "driving-levels.policy.json").read_text())["xnodes"]}
            self.assertIn("gpu0", placed)
            report = json.loads((out / "driving-levels.report.json").read_text())
            self.assertIn("gpu0", report["real_xpus"])
            self.assertNotIn("dla0", report["real_xpus"])


if __name__ == "__main__":
    unittest.main()
