# SPDX-License-Identifier: Apache-2.0
"""Many releases, isolated: none is lost, the counts add up, and nothing grows. XAUTO_SOAK_RELEASES says how many."""
import json
import os
import pathlib
import subprocess
import time
import unittest

from common import BIN, FULL, children_of
from isolate_test import Case

RELEASES = int(os.environ.get("XAUTO_SOAK_RELEASES", "20000" if FULL else "4000"))
SANITIZED = any(name in (BIN / "testapp").read_bytes() for name in (b"__asan_init", b"__tsan_init"))
PROCESSES = 7  # 2 coordinators, the hub, 4 modules
GROWTH_KB = 4 * 1024  # accounts of the last 65536 releases, and what malloc keeps


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
            family = []
            while len(family) < PROCESSES and tool.poll() is None:
                family = list(children_of(tool.pid))
            seen = []  # while all are there: {pid: measurement}
            while tool.poll() is None:
                sample = {pid: measure(pid) for pid in family}
                if all(sample.values()):
                    seen.append(sample)
                time.sleep(0.02)
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
        """What is there in the second half of the run was there in the first."""
        self.assertGreater(len(seen), 8)
        half = len(seen) // 2
        for pid in seen[0]:
            before, after = ([sample[pid] for sample in part] for part in (seen[:half], seen[half:]))
            for what in (1, 2):
                self.assertLessEqual(max(x[what] for x in after), max(x[what] for x in before), (before, after))
            if not SANITIZED:  # their allocators keep what was freed
                running = after[:len(after) // 2]  # the report is written at the end
                self.assertLess(max(x[0] for x in running) - max(x[0] for x in before), GROWTH_KB, (before, after))


del Case

if __name__ == "__main__":
    unittest.main()
