# SPDX-License-Identifier: Apache-2.0
"""Many releases, isolated: none is lost that is not counted, and nothing grows. XAUTO_SOAK_RELEASES says how many,
XAUTO_SOAK_KILLS how many processes die meanwhile."""
import collections
import json
import os
import pathlib
import random
import signal
import statistics
import subprocess
import time
import unittest

from common import BIN, FULL, XAUTO, children_of, xauto
from isolate_test import TESTAPP, Case

RELEASES = int(os.environ.get("XAUTO_SOAK_RELEASES", "20000" if FULL else "4000"))
KILLS = int(os.environ.get("XAUTO_SOAK_KILLS", "20" if FULL else "5"))
KILL_EVERY_S = 0.4
SANITIZED = any(name in (BIN / "testapp").read_bytes() for name in (b"__asan_init", b"__tsan_init"))
PROCESSES = 7  # 2 coordinators, the hub, 4 modules
GROWTH_KB = 4 * 1024  # accounts of the last 65536 releases, and what malloc keeps


def measure(pid):
    """(anonymous memory in kB, descriptors and threads, mappings of shared memory, the names of the former two). A thread
    opens its own schedstat once, with the first job that it does itself: that may be late. The run's watch has it open, too."""
    folder = pathlib.Path(f"/proc/{pid}")
    try:
        anonymous = next(int(line.split()[1]) for line in (folder / "status").read_text().splitlines()
                         if line.startswith("RssAnon"))
        shared = sum("memfd:" in line for line in (folder / "maps").read_text().splitlines())
        of = [os.readlink(folder / "fd" / fd) for fd in os.listdir(folder / "fd")]
        names = collections.Counter(of) - collections.Counter({name: 2 for name in of if name.endswith("/schedstat")})
        names.update((task / "comm").read_text().strip() for task in (folder / "task").iterdir())
        return anonymous, sum(names.values()), shared, names
    except (OSError, StopIteration):
        return None  # it has ended


def releases(pid):
    """Its sources have been started: what a process needs for a run is there by then."""
    try:
        tasks = os.listdir(f"/proc/{pid}/task")
        return any(pathlib.Path(f"/proc/{pid}/task/{task}/comm").read_text() == "xauto/sources\n" for task in tasks)
    except OSError:
        return False


class Soak(Case):
    def watched(self, command, processes):
        """Its report, and what its processes were measured at while releases went on: [{pid: measurement}]. Where the machine
        stood still meanwhile, so that hardly anything was seen, that of another run."""
        for _ in range(3):
            report, seen = self.watched_once(command, processes)
            if len(seen) > 4:
                break
        return report, seen

    def watched_once(self, command, processes):
        with open(self.path("report"), "w") as report, open(self.path("errors"), "w") as errors:
            tool = subprocess.Popen(command, stdout=report, stderr=errors)
            family = []
            while not any(map(releases, family)) and tool.poll() is None:
                time.sleep(0.005)
                family = list(children_of(tool.pid))
            self.assertGreaterEqual(len(family), processes)
            seen = []
            while tool.poll() is None:
                sample = {pid: measure(pid) for pid in family}
                if all(sample.values()):
                    seen.append(sample)
                time.sleep(0.005)
        self.assertEqual(tool.returncode, 0, pathlib.Path(self.path("errors")).read_text())
        return json.loads(pathlib.Path(self.path("report")).read_text())["runs"][0], seen

    def test_nothing_is_lost_and_nothing_grows(self):
        command = self.command("--isolate", "--lockstep", activations=RELEASES) + ["tally"]
        run, seen = self.watched(command, PROCESSES)
        self.assertEqual((run["activations"], run["lost_activations"], run["complete"]), (RELEASES, 0, True))
        self.assertEqual(run["notes"], ["time between releases means nothing in lockstep: no age is measured"])
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

    RATES = {"fast": 1000, "middle": 2000, "slow": 5000}

    def three_rates(self, slowest, *flags):
        """The command of a run by keys of three sensors, each on its own grid; `slowest`: releases of the slow one."""
        write = lambda name, value: pathlib.Path(self.path(name)).write_text(json.dumps(value))
        write("rates.json", {
            "schema": "xauto.app", "version": 3, "name": "ratesapp",
            "sources": [{"name": f"in/{n}", "period_us": us, "jitter_us": 100} for n, us in self.RATES.items()],
            "edges": [],
            "xnodes": [{"name": f"{n}.0", "module": n, "wcet_us": {"gpu": 100}, "source": f"in/{n}"}
                       for n in self.RATES]})
        write("rates-deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "ratesapp", "queue_depth": 256,
                                        "keep": 256})
        solved = xauto("solve", "--app", self.path("rates.json"), "--platform", "small", "--max-evaluations", 500,
                       "--time-limit", "60s", "--out", self.path("keys.json"))
        self.assertEqual(solved.returncode, 0, solved.stderr)
        return [XAUTO, "run", "--app", self.path("rates.json"), "--policy", self.path("keys.json"), "--platform",
                "small", "--deployment", self.path("rates-deployment.json"), "--emulate", "--isolate", "--json",
                "--activations", str(slowest), *map(str, flags), "--", TESTAPP.replace("testapp", "ratesapp"),
                self.path("result"), *(f"{n}:{us}:gpu=20" for n, us in self.RATES.items())]

    def assert_counted(self, run, slowest, observed_all=True):
        """Each release of a sensor is a result, or counted as lost; the observers in the hub count for themselves."""
        observed = {}
        for line in pathlib.Path(self.path("result")).read_text().splitlines():
            name, messages, _, latest = line.split()
            observed[name] = (int(messages), int(latest))
        released = 0
        for module in run["modules"]:
            name = module["name"]
            of_this = module["activations"] + module["failed"] + module["dropped"]
            self.assertEqual(of_this, -(-slowest * self.RATES["slow"] // self.RATES[name]), run["modules"])
            self.assertEqual(module["failed"], 0)
            if observed_all:
                self.assertEqual(observed[name][0], module["activations"])
            else:  # who dies between its count and its message has told the count only
                self.assertLessEqual(observed[name][0], module["activations"])
                self.assertLessEqual(module["activations"] - observed[name][0], KILLS)
            self.assertLess(observed[name][1], of_this)
            released += of_this
        self.assertEqual(released, run["activations"] + run["lost_activations"])

    def test_three_rates_by_keys(self):
        slowest = int(RELEASES / sum(self.RATES["slow"] / us for us in self.RATES.values()))
        run, seen = self.watched(self.three_rates(slowest), processes=5)  # a coordinator, the hub, 3 modules
        self.assert_counted(run, slowest)
        self.assert_flat(seen)

    def test_three_rates_by_keys_with_deaths(self):
        """Modules and the coordinator are killed at random: what is lost by that is counted, and the rest goes on."""
        slowest = int((KILLS * KILL_EVERY_S + 2) * 1e6 / self.RATES["slow"])
        command = self.three_rates(slowest, "--restarts", 1_000_000)
        with open(self.path("report"), "w") as report, open(self.path("errors"), "w") as errors:
            tool = subprocess.Popen(command, stdout=report, stderr=errors)
            while len(children_of(tool.pid)) < 5:
                self.assertIsNone(tool.poll(), pathlib.Path(self.path("errors")).read_text())
                time.sleep(0.01)
            time.sleep(1)
            rng = random.Random(KILLS)
            coordinators, kills = 90, 0  # of these the tool gives one up after 100
            while kills < KILLS and tool.poll() is None:
                time.sleep(rng.uniform(0, KILL_EVERY_S))
                family = children_of(tool.pid)
                coordinator = coordinators > 0 and rng.random() < 0.2
                victims = [pid for pid, name in family.items()
                           if name.startswith("xauto-coordinat" if coordinator else "m:")]
                if not victims:
                    continue
                try:
                    os.kill(rng.choice(sorted(victims)), signal.SIGKILL)
                except ProcessLookupError:
                    continue
                kills += 1
                coordinators -= coordinator
            tool.wait()
        errors = pathlib.Path(self.path("errors")).read_text()
        self.assertEqual(kills, KILLS, errors)
        self.assertEqual(tool.returncode, 0, errors)
        run = json.loads(pathlib.Path(self.path("report")).read_text())["runs"][0]
        self.assertTrue(run["complete"])
        self.assert_counted(run, slowest, observed_all=False)

    def assert_flat(self, seen):
        """What stays there in the second half of the run was there in the first. A file that is open for a moment is in
        one look or two: what is lost at each release, or now and then, is in all that follow."""
        self.assertGreater(len(seen), 4)
        half = len(seen) // 2
        for pid in seen[0]:
            before, after = ([sample[pid] for sample in part] for part in (seen[:half], seen[half:]))
            for what in (1, 2):
                most = max(after, key=lambda x: x[what])
                self.assertLessEqual(statistics.median(x[what] for x in after), max(x[what] for x in before),
                                     (f"new in {pid}: {most[3] - before[-1][3]}", [x[:3] for x in before + after]))
            if not SANITIZED:  # their allocators keep what was freed
                running = after[:len(after) // 2]  # the report is written at the end
                self.assertLess(max(x[0] for x in running) - max(x[0] for x in before), GROWTH_KB,
                                [x[:3] for x in before + after])


del Case

if __name__ == "__main__":
    unittest.main()
