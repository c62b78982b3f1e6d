#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What a death of the emulator costs: xauto-emud is killed at random moments of runs whose work is all on it.

The time of a run is cut into pairs of windows: in the first nothing is done, in the second the emulator is killed once
(and started again by the tool). Judged is module D of tests/integration/apps/testapp.cc, 3 ms of work every 15 ms: the
slowest of a window with a kill against the slowest of the quiet one before. Its results must be complete.

    bench/runtime/emulator_kills.py [--bin build/bin] [--runs 4] [--kills 25] [--window-ms 500]
"""
import argparse
import os
import pathlib
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time

SOURCE = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(SOURCE / "tests/integration"))
PERIOD_US = 15_000


def emulator_of(children):
    return next((pid for pid, name in children.items() if name == "xauto-emud"), None)


def one_run(options, rng):
    """Per kill: the slowest of the quiet window and of the other, and how long there was no emulator process; in us."""
    import common
    from kill_test import emulated_testapp

    window = options.window_ms / 1000
    releases = int((2 * options.kills * window + 5) * 1e6 / PERIOD_US)
    now = lambda: time.monotonic_ns() // 1000
    with tempfile.TemporaryDirectory() as folder:
        tool = subprocess.Popen(emulated_testapp(folder, "--overload", "queue:256", "--activations", releases,
                                                 period_us=PERIOD_US) + ["times"],
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        time.sleep(2)
        moments = []
        for _ in range(options.kills):
            start = now()
            time.sleep(window)
            middle = now()
            time.sleep(rng.uniform(0, window / 2))
            victim = emulator_of(common.children_of(tool.pid))
            killed = now()
            os.kill(victim, signal.SIGKILL)
            while emulator_of(common.children_of(tool.pid)) in (None, victim):
                time.sleep(0.001)
            moments.append((start, middle, now() - killed))
            time.sleep(max(0, window - (now() - middle) / 1e6))
        out, err = tool.communicate(timeout=120)
        if tool.returncode != 0 or f"again, {options.kills} times" not in out:
            sys.exit(f"the run ended with status {tool.returncode}:\n{out}{err}")
        times = []
        for line in pathlib.Path(folder, "result").read_text().splitlines():
            topic, _, value = line.split()
            if topic == "d":
                times.append((int(value) >> 24, int(value) & ((1 << 24) - 1)))
        if len(times) != releases:
            sys.exit(f"{releases - len(times)} of {releases} results are missing")
        slowest = lambda a, b: max(latency for stamp, latency in times if a <= stamp < b)
        return [(slowest(start, middle), slowest(middle, middle + int(window * 1e6)), down)
                for start, middle, down in moments]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", default=str(SOURCE / "build/bin"))
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--kills", type=int, default=25)
    parser.add_argument("--window-ms", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    os.environ["XAUTO_BIN"] = options.bin
    rng = random.Random(options.seed)
    rows = [row for _ in range(options.runs) for row in one_run(options, rng)]
    print(f"{options.runs} runs of {options.kills} kills; nothing hung, every result is there. ms:")
    for name, values in [("slowest of a quiet window", [row[0] for row in rows]),
                         ("slowest of a window with a kill", [row[1] for row in rows]),
                         ("the difference, per kill", [row[1] - row[0] for row in rows]),
                         ("until there is another process", [row[2] for row in rows])]:
        values.sort()
        print(f"  {name:<34} p50 {statistics.median(values) / 1000:8.2f}   p90 {values[len(values) * 9 // 10] / 1000:8.2f}"
              f"   max {values[-1] / 1000:8.2f}")


if __name__ == "__main__":
    main()
