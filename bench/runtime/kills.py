#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How much a chain notices when other processes of its app are killed.

One isolated run of tests/integration/apps/testapp.cc, its time cut into pairs of windows: in the first nothing is
done, in the second one process is killed (and started again by the tool). So both kinds of windows see the same
machine. Judged is the latency of module D, which shares nothing with the victims but the CPUs.

    bench/runtime/kills.py [--bin build/bin] [--kills 500] [--window-ms 300]
"""
import argparse
import json
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
PERIOD_US = 2000
COORDINATOR_KILLS = 90  # of each: after 100 the tool gives one up


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", default=str(SOURCE / "build/bin"))
    parser.add_argument("--kills", type=int, default=500)
    parser.add_argument("--window-ms", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()


def quantile(values, q):
    values = sorted(values)
    return values[min(len(values) - 1, int(q * len(values)))]


def main():
    options = parse()
    os.environ["XAUTO_BIN"] = options.bin
    from common import children_of
    import isolate_test

    isolate_test.Case.setUpClass()
    case = isolate_test.Case()
    window = options.window_ms / 1000
    releases = int((2 * options.kills * window + 20) * 1e6 / PERIOD_US)
    tool = subprocess.Popen(case.command("--isolate", "--restarts", 1_000_000, period=PERIOD_US, activations=releases)
                            + ["times"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    while len(children_of(tool.pid)) < 7:  # 2 coordinators, the hub, 4 modules
        time.sleep(0.01)
    time.sleep(2)
    rng = random.Random(options.seed)
    kills, left = [], {}  # (kind, start of the quiet window, of the other, its end), all monotonic in us
    now = lambda: int(time.monotonic() * 1e6)
    for _ in range(options.kills):
        start = now()
        time.sleep(window)
        middle = now()
        family = children_of(tool.pid)
        victims = [(pid, name) for pid, name in family.items()
                   if name in ("m:A", "m:B", "m:C") or (name.startswith("xauto-coordinat") and
                                                         left.get(name, 0) < COORDINATOR_KILLS)]
        if not victims:
            break
        pid, name = rng.choice(victims)
        left[name] = left.get(name, 0) + 1
        time.sleep(rng.uniform(0, window / 3))
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
        time.sleep(max(0, window - (now() - middle) / 1e6))
        kills.append((name, start, middle, now()))
    tool.send_signal(signal.SIGTERM)
    run = json.loads(tool.communicate(timeout=60)[0])["runs"][0]

    times = []  # (release, latency), us
    numbers = {}  # of D's results -> release
    for line in pathlib.Path(case.path("result")).read_text().splitlines():
        topic, number, value = line.split()
        if topic == "d":
            times.append((int(value) >> 24, int(value) & ((1 << 24) - 1)))
            numbers[int(number)] = times[-1][0]
    times.sort()
    result = judge(kills, times)
    result["missing"] = missing(kills, numbers)
    result["d"] = next(m for m in run["modules"] if m["name"] == "D")
    counts = {m["activations"] + m["failed"] + m["dropped"] for m in run["modules"]}
    result["counts_add_up"] = len(counts) == 1
    if options.json:
        print(json.dumps(result, indent=2))
        return
    print(f"{'victim':<18}{'kills':>6}{'p50 quiet':>11}{'p50 kill':>10}{'ratio':>7}{'p99 quiet':>11}{'p99 kill':>10}"
          f"{'ratio':>7}{'pairs':>8}   us, latency of D; pairs: median over pairs of p50 kill / p50 quiet")
    for row in result["rows"]:
        print(f"{row['victim']:<18}{row['kills']:>6}{row['p50_quiet']:>11}{row['p50_kill']:>10}"
              f"{row['p50_kill'] / row['p50_quiet']:>7.3f}{row['p99_quiet']:>11}{row['p99_kill']:>10}"
              f"{row['p99_kill'] / row['p99_quiet']:>7.2f}{row['pairs']:>8.3f}")
    print(f"D: {result['d']['activations']} done, {result['d']['failed']} failed, {result['d']['dropped']} dropped; "
          f"counts of all modules {'add up' if result['counts_add_up'] else 'DO NOT ADD UP'}; of D's results "
          f"{result['missing'][0]} are missing in quiet windows and {result['missing'][1]} in those with a kill")


def missing(kills, numbers):
    """Results that did not come, in quiet windows and in those with a kill; releases are on a grid of time."""
    first = min(numbers)
    found = [0, 0]
    for number in range(first, max(numbers) + 1):
        if number in numbers:
            continue
        stamp = numbers[first] + (number - first) * PERIOD_US
        for _, start, middle, end in kills:
            if start <= stamp < end:
                found[stamp >= middle] += 1
    return found


def judge(kills, times):
    from bisect import bisect_left
    stamps = [stamp for stamp, _ in times]

    def between(start, end):
        return [latency for _, latency in times[bisect_left(stamps, start):bisect_left(stamps, end)]]

    rows = []
    for victim in ["all"] + sorted({name for name, *_ in kills}):
        quiet, other, ratios, count = [], [], [], 0
        for name, start, middle, end in kills:
            if victim not in ("all", name):
                continue
            before, after = between(start, middle), between(middle, end)
            if not before or not after:
                continue
            count += 1
            quiet += before
            other += after
            ratios.append(statistics.median(after) / statistics.median(before))
        rows.append({"victim": victim, "kills": count, "p50_quiet": quantile(quiet, 0.5),
                     "p50_kill": quantile(other, 0.5), "p99_quiet": quantile(quiet, 0.99),
                     "p99_kill": quantile(other, 0.99), "pairs": statistics.median(ratios)})
    return {"rows": rows}


if __name__ == "__main__":
    main()
