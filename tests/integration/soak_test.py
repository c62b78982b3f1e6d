# SPDX-License-Identifier: Apache-2.0
"""Many releases, isolated: none is lost, the counts add up, and nothing grows. XAUTO_SOAK_RELEASES for more."""
import json
import os
import pathlib
import subprocess
import time
import unittest

from common import BIN, children_of
from isolate_test import Case

RELEASES = int(os.environ.get("XAUTO_SOAK_RELEASES", "12000"))
SANITIZED = any(name in (BIN / "testapp").read_bytes() for name in (b"__asan_init", b"__tsan_init"))
GROWTH_KB = 6 * 1024  # accounts of the last 65536 releases, and what malloc keeps


def measure(pid):
    """(anonymous memory in kB, descriptors, mappings of shared memory)"""
    folder = pathlib.Path(f"/proc/{pid}")
    try:
        anonymous = next(int(line.split()[1]) for line in (folder / "status").read_text().splitlines()
                         if line.startswith("RssAnon"))
        shared = sum("memfd:" in line for line in (folder / "maps").read_text().splitlines())
        return anonymous, len(os.listdir(folder / "fd")), shared
    except (OSError, StopIteration):
        return None  # it has ended


class Soak(Case):
    def test_nothing_is_lost_and_nothing_grows(self):
        command = self.command("--isolate", "--lockstep", activations=RELEASES) + ["tally"]
        with open(self.path("report"), "w") as report, open(self.path("errors"), "w") as errors:
            tool = subprocess.Popen(command, stdout=report, stderr=errors)
            seen = {}  # pid -> measurements
            while tool.poll() is None:
                for pid in children_of(tool.pid):
                    if sample := measure(pid):
                        seen.setdefault(pid, []).append(sample)
                time.sleep(0.1)
        self.assertEqual(tool.returncode, 0, pathlib.Path(self.path("errors")).read_text())
        run = json.loads(pathlib.Path(self.path("report")).read_text())["runs"][0]
        self.assertEqual((run["activations"], run["lost_activations"], run["complete"]), (RELEASES, 0, True))
        self.assertEqual(run["notes"], [])
        for module in run["modules"]:
            self.assertEqual((module["activations"], module["failed"], module["dropped"]), (RELEASES, 0, 0))
        for chain in run["chains"]:
            self.assertEqual((chain["results"], chain["lost"]), (RELEASES, 0))
        tallies = {}
        for line in pathlib.Path(self.path("result")).read_text().splitlines():
            topic, messages, first, last, disorder, _ = line.split()
            tallies[topic] = tuple(map(int, (messages, first, last, disorder)))
        whole = (RELEASES, 0, RELEASES - 1, 0)
        self.assertEqual(tallies, {"c": whole, "d": whole})
        self.assert_flat(seen)

    def assert_flat(self, seen):
        judged = 0
        for samples in seen.values():
            settled = samples[len(samples) // 3:-2]  # not while it starts or ends
            if len(settled) < 2:
                continue
            judged += 1
            self.assertEqual(len({fds for _, fds, _ in settled}), 1, samples)
            self.assertEqual(len({shared for _, _, shared in settled}), 1, samples)
            if not SANITIZED:  # their allocators keep what was freed
                self.assertLess(max(kb for kb, _, _ in settled) - settled[0][0], GROWTH_KB, samples)
        self.assertGreaterEqual(judged, 7, "2 coordinators, the hub, 4 modules")


del Case

if __name__ == "__main__":
    unittest.main()
