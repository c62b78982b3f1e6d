# SPDX-License-Identifier: Apache-2.0
"""Many releases, isolated: none is lost that is not counted, and nothing grows. XAUTO_SOAK_RELEASES says how many."""
import json
import os
import pathlib
import subprocess
import time
import unittest

from common import BIN, FULL, XAUTO, children_of, xauto
from isolate_test import TESTAPP, Case

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
    def watched(self, command, processes):
        """Its report, and what its processes were measured at while all of them were there: [{pid: measurement}]."""
        with open(self.path("report"), "w") as report, open(self.path("errors"), "w") as errors:
            tool = subprocess.Popen(command, stdout=report, stderr=errors)
            family = []
            while len(family) < processes and tool.poll() is None:
                family = list(children_of(tool.pid))
            seen = []
            while tool.poll() is None:
                sample = {pid: measure(pid) for pid in family}
                if all(sample.values()):
                    seen.append(sample)
                time.sleep(0.02)
        self.assertEqual(tool.returncode, 0, pathlib.Path(self.path("errors")).read_text())
        return json.loads(pathlib.Path(self.path("report")).read_text())["runs"][0], seen

    def test_nothing_is_lost_and_nothing_grows(self):
        command = self.command("--isolate", "--lockstep", activations=RELEASES) + ["tally"]
        run, seen = self.watched(command, PROCESSES)
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

    def test_three_rates_by_keys(self):
        """Three sensors, each on its own grid. The observers in the hub count for themselves."""
        rates = {"fast": 1000, "middle": 2000, "slow": 5000}
        slowest = int(RELEASES / sum(rates["slow"] / us for us in rates.values()))
        write = lambda name, value: pathlib.Path(self.path(name)).write_text(json.dumps(value))
        write("rates.json", {
            "schema": "xauto.app", "version": 2, "name": "ratesapp",
            "sources": [{"name": f"in/{n}", "period_us": us, "jitter_us": 100} for n, us in rates.items()],
            "edges": [],
            "xnodes": [{"name": f"{n}.0", "module": n, "wcet_us": {"gpu": 100}, "source": f"in/{n}"} for n in rates]})
        write("rates-deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "ratesapp", "queue_depth": 256,
                                        "keep": 256})
        solved = xauto("solve", "--app", self.path("rates.json"), "--platform", "small", "--max-evaluations", 500,
                       "--time-limit-s", 60, "--out", self.path("keys.json"))
        self.assertEqual(solved.returncode, 0, solved.stderr)
        run, seen = self.watched(
            [XAUTO, "run", "--app", self.path("rates.json"), "--policy", self.path("keys.json"), "--platform", "small",
             "--deployment", self.path("rates-deployment.json"), "--emulate", "--isolate", "--json", "--activations",
             str(slowest), "--", TESTAPP.replace("testapp", "ratesapp"), self.path("result"),
             *(f"{n}:{us}:gpu=20" for n, us in rates.items())], processes=5)  # a coordinator, the hub, 3 modules
        observed = {}
        for line in pathlib.Path(self.path("result")).read_text().splitlines():
            name, messages, _, latest = line.split()
            observed[name] = (int(messages), int(latest))
        released = 0
        for module in run["modules"]:
            name = module["name"]
            # Each release of a sensor is a result, or counted as lost.
            of_this = module["activations"] + module["failed"] + module["dropped"]
            self.assertEqual(of_this, -(-slowest * rates["slow"] // rates[name]))
            self.assertEqual((observed[name][0], module["failed"]), (module["activations"], 0))
            self.assertLess(observed[name][1], of_this)
            released += of_this
        self.assertEqual(released, run["activations"] + run["lost_activations"])
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
