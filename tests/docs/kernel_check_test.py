# SPDX-License-Identifier: Apache-2.0
"""What kernel-check.sh hands to the guest, in a repository whose kernels, modules and machine are stand-ins."""
import os
import pathlib
import shutil
import subprocess
import tempfile
import unittest

SOURCE = pathlib.Path(__file__).resolve().parents[2]
STAND_INS = {
    "fetch-kernel.sh": 'echo kernel',
    "build-kmod.sh": 'true',
    "mk-initrd.sh": 'true',
    "install-kselftest.sh": 'true',
    "run-vm.sh": 'printf "TAP version 13\\n1..1\\nok 1 it ran\\n# given: $VM_APPEND\\n" > "$3"',
}


class KernelCheck(unittest.TestCase):
    def given(self, lane, **environment):
        """The kernel parameters that a lane's guest is given, in their order."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        root = pathlib.Path(folder.name)
        (root / "scripts/vm").mkdir(parents=True)
        shutil.copy(SOURCE / "scripts/kernel-check.sh", root / "scripts")
        for name, line in STAND_INS.items():
            (root / "scripts/vm" / name).write_text(f"#!/bin/sh\n{line}\n")
            (root / "scripts/vm" / name).chmod(0o755)
        kept = {name: value for name, value in os.environ.items() if name not in ("VM_APPEND", "XAUTO_FULL")}
        done = subprocess.run(["scripts/kernel-check.sh", "build", lane], cwd=root, capture_output=True, text=True,
                              env={**kept, **environment})
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        logs = "".join(log.read_text() for log in (root / "build/vm").glob("*.log"))
        return logs.split("# given:")[1].split()

    def test_what_is_asked_for_reaches_each_lane(self):
        for lane in ("kmod-7.x", "scx-7.x", "at-once-7.x", "machine-7.x", "keys-7.x"):
            with self.subTest(lane=lane):
                self.assertEqual(self.given(lane, VM_APPEND="XAUTO_FUZZ=7 a=b")[-2:], ["XAUTO_FUZZ=7", "a=b"])

    def test_it_comes_after_the_lanes_own_so_that_it_counts(self):
        given = self.given("kmod-7.x", VM_APPEND="XAUTO_FUZZ=7", XAUTO_FULL="1")
        self.assertEqual([each for each in given if each.startswith("XAUTO_FUZZ")], ["XAUTO_FUZZ=20000", "XAUTO_FUZZ=7"])

    def test_by_itself_a_lane_asks_for_nothing(self):
        self.assertEqual(self.given("kmod-7.x"), [])


if __name__ == "__main__":
    unittest.main()
