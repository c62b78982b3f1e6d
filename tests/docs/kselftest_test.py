# SPDX-License-Identifier: Apache-2.0
"""tests/kselftest/ in a kernel's tree: that tree's make installs it, its runner runs it, and the guests' stream of it is flat."""
import os
import pathlib
import shutil
import subprocess
import tempfile
import unittest

SOURCE = pathlib.Path(__file__).resolve().parents[2]
CACHE = pathlib.Path(os.environ.get("XAUTO_CACHE") or pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache") / "xauto")
MISSING = [name for name in ("rsync", "make", "gcc") if shutil.which(name) is None]


@unittest.skipIf(MISSING, f"not installed: {MISSING}")
@unittest.skipUnless((CACHE / "linux-source").exists(), "scripts/vm/fetch-source.sh fetches the kernel's part of it")
class Kselftest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        programs = pathlib.Path(folder.name, "bin")
        programs.mkdir()
        stand_ins = {"kmod_fuzz_test": 'echo "TAP version 13"; echo 1..2; echo "ok 1 a"; echo "# why"; echo "not ok 2 b"; exit 1',
                     "kmod_control_test": "kill -9 $$", "scx_test": 'echo "TAP version 13"; echo 1..1; echo "ok 1 given: $*"'}
        for name, line in stand_ins.items():
            (programs / name).write_text(f"#!/bin/sh\n{line}\n")
            (programs / name).chmod(0o755)
        cls.installed = pathlib.Path(folder.name, "installed")
        subprocess.run([SOURCE / "scripts/vm/install-kselftest.sh", programs, cls.installed], check=True, timeout=120)

    def run_in_guest(self, *names, **environment):
        done = subprocess.run([SOURCE / "tests/vm/kselftest", *names], capture_output=True, text=True, timeout=120,
                              env={**os.environ, "KSELFTEST": str(self.installed), **environment})
        return done.returncode, [line for line in done.stdout.splitlines() if not line.startswith("#")]

    def test_the_list_has_what_there_is(self):
        listed = set((self.installed / "kselftest-list.txt").read_text().split())
        scripts = {"contexts.sh", "policy.sh", "tools.sh", "keys.sh"}
        self.assertEqual(listed, {f"xauto:{n}" for n in {"abi_test", "kmod_fuzz_test", "kmod_control_test", "scx_test", *scripts}})
        self.assertIn("timeout=", (self.installed / "xauto/settings").read_text())

    @unittest.skipIf(pathlib.Path("/sys/module/xauto").exists(), "xauto.ko is loaded")
    def test_without_the_module_the_client_of_its_header_is_skipped(self):
        done = subprocess.run([self.installed / "run_kselftest.sh", "-t", "xauto:abi_test"], capture_output=True, text=True, timeout=120)
        self.assertIn("ok 1 selftests: xauto: abi_test # SKIP", done.stdout)

    def test_the_results_come_out_flat_and_in_full(self):
        self.assertEqual(self.run_in_guest("kmod_fuzz_test", "scx_test", KSELFTEST_SCX_TEST_ARGS="turns 2"),
                         (1, ["TAP version 13", "1..2", "ok 1 a", "not ok 2 b", "TAP version 13", "1..1", "ok 1 given: turns 2"]))
        self.assertEqual(self.run_in_guest("scx_test")[0], 0)

    def test_who_is_killed_or_not_there_has_failed(self):
        status, lines = self.run_in_guest("kmod_control_test")
        self.assertEqual((status, len(lines)), (1, 3), lines)
        self.assertRegex(lines[2], "^not ok 1 selftests: xauto: kmod_control_test # exit=")
        status, lines = self.run_in_guest("kmod_gone_test")
        self.assertEqual(status, 1)
        self.assertIn("Bail out! 0 of 1 selftests were run", lines)


if __name__ == "__main__":
    unittest.main()
