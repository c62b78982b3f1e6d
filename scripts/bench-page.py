#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the benchmarks one after the other and writes a page of their results. Called by scripts/bench.sh.

All is measured, on this machine. Of several runs the median is shown, and how far they lie apart."""
import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import textwrap
import time

from machine import ROOT, machine

# Rows that are not XAuto's: what the kernel needs for the same at least, and other people's libraries.
OTHERS = ("futex", "bare futex", "own-", "call", "tbb", "cyclone", "iceoryx", "starpu")
SHARE = "The share of a CPU is that of three coordinators, their start-up left out."


class Failed(Exception):
    pass


class Bench:
    def __init__(self, arguments):
        self.quick, self.out = arguments.quick, arguments.out
        self.bin, self.work = arguments.bin.resolve(), arguments.bin.resolve() / "bench" / "work"
        self.page, self.loads = [], []
        self.out.mkdir(parents=True, exist_ok=True)
        self.work.mkdir(parents=True, exist_ok=True)

    def run(self, *command):
        command = [str(c) for c in command]
        self.loads.append(os.getloadavg()[0])
        print("bench:", " ".join(command), flush=True)
        result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        self.loads.append(os.getloadavg()[0])
        if result.returncode != 0:
            raise Failed(f"{pathlib.Path(command[0]).name} ended with status {result.returncode}: "
                         f"{result.stderr.strip()[-300:]}")
        return result.stdout

    def section(self, title, what):
        self.page += [f"## {title}", "", *textwrap.wrap(f"*Measured on this machine.* {what}", 120, break_long_words=False, break_on_hyphens=False), ""]

    def table(self, head, rows):
        self.page += ["| " + " | ".join(head) + " |", "| --- |" + " --: |" * (len(head) - 1)]
        self.page += ["| " + " | ".join(map(str, row)) + " |" for row in rows] + [""]

    def text(self, name, text):
        """A program's own table, whole, beside the page."""
        (self.out / name).write_text(text if text.endswith("\n") else text + "\n")
        self.page += [f"All of it: [`{name}`]({name}).", ""]

    # ---- the benchmarks

    def runtime(self):
        runs, rounds, seconds = (2, 40, 1) if self.quick else (3, 500, 3)
        rows = {}
        for number in range(runs):
            file = self.work / f"runtime-{number}.json"
            text = self.run(self.bin / "bench/bench_runtime", "--fifo", "--rounds", rounds, "--duration", f"{seconds}s", "--json", file)
            for row in json.loads(file.read_text())["rows"]:
                rows.setdefault((row["section"], row["case"], row["program"]), []).append((row["p50"], row["p99"]))
        self.section("The runtime beside its floors and peers", f"{runs} runs of {rounds} samples a row; microseconds unless the row says %, "
                     "medians over the runs, in brackets the least and the greatest p50.")
        table = {}
        for (_, case, program), values in rows.items():
            p50, p99 = zip(*values)
            middle, share = statistics.median(p50), program.endswith("%")
            digits = 2 if middle >= 0.1 else 3
            other = program.startswith(OTHERS)
            name = "" if program == "xauto" else program.removeprefix("xauto, ") + " "
            text = f"{name}{middle:.{digits}f}"
            if not other:
                text += f" ({min(p50):.{digits}f}–{max(p50):.{digits}f})" + ("" if share else f", {statistics.median(p99):.{digits}f}")
            table.setdefault(case, ([], []))[other].append(text)
        self.table(["case", "XAuto: p50 (least–greatest), p99", "beside it: p50"], [[case, *map("; ".join, both)] for case, both in table.items()])
        self.page += textwrap.wrap(SHARE, 120, break_on_hyphens=False) + [""]
        self.text("runtime.txt", "\n".join(line for line in text.splitlines() if not line.startswith("R\t")))

    def cpu_priority(self):
        runs = 2 if self.quick else 5
        answers = [json.loads(self.run(self.bin / "bench/bench_cpu_priority", "--json")) for _ in range(runs)]
        self.section("Changing the priority of the next job", f"{runs} runs, medians; what a worker pays before each job. The store went to "
                     f"{'a mapped BPF map' if answers[0]['mapped'] else 'ordinary memory (no BPF map without root)'}.")
        middle = lambda key: statistics.median(a[key] for a in answers)
        self.table(["way", "ns"], [["store into the map that sched_ext reads", f"{middle('store_ns'):.1f}"],
                                   ["sched_setattr(2), for SCHED_FIFO", f"{middle('sched_setattr_ns'):.1f}"]])

    def tracing(self):
        pairs, activations = (1, 60) if self.quick else (5, 100)
        text = self.run("bench/tracing/overhead.sh", self.bin, pairs, activations)
        self.section("What `top --record` costs", f"{pairs} pair{'s' * (pairs > 1)} of emulated runs with and without it, {activations} activations each.")
        self.page += ["```", text.strip(), "```", ""]

    ALL = ("runtime", "cpu_priority", "tracing")

    def write(self, names):
        began, failures = time.monotonic(), []
        for name in names:
            mark = len(self.page)
            try:
                getattr(self, name)()
            except (Failed, OSError, ValueError, KeyError) as error:
                del self.page[mark:]
                failures.append(f"{name}: {error}")
                self.page += [f"## {name}", "", f"**Not measured here**: {str(error).splitlines()[0]}", ""]
                print(f"bench: {name}: {error}", file=sys.stderr)
        took = time.monotonic() - began
        took = f"{took:.0f} seconds" if took < 120 else f"{took / 60:.0f} minutes"
        loads = sorted(self.loads) or [os.getloadavg()[0]]
        note = (f"Load average while it ran: median {statistics.median(loads):.1f}, from {loads[0]:.1f} to {loads[-1]:.1f}; "
                f"{os.cpu_count()} cores.")
        busy = statistics.median(loads) > 2 * os.cpu_count()
        head = ["# Benchmarks", "", "Written by `make bench`" + (" with `QUICK=1`: **a few repetitions, to see that it works; no result**" if self.quick else "") +
                f", in {took}. Nothing here was measured on a Jetson.", ""]
        head += ["| machine | |", "| --- | --- |"] + [f"| {k} | {v} |" for k, v in machine()] + ["", note]
        head += ["**The machine was busy with other things: compare rows of one table only.**"] if busy else []
        (self.out / "README.md").write_text("\n".join([*head, "", *self.page]).rstrip() + "\n")
        print(self.out / "README.md")
        return 1 if failures else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build", help="the build folder")
    parser.add_argument("--quick", action="store_true", help="a minute instead of eight")
    parser.add_argument("--only", default=",".join(Bench.ALL), help="some of: %(default)s")
    parser.add_argument("--out", type=pathlib.Path, help="default: docs/results, with --quick build/bench/quick")
    arguments = parser.parse_args()
    names = arguments.only.split(",")
    if unknown := set(names) - set(Bench.ALL):
        parser.error(f"--only: no benchmark {', '.join(sorted(unknown))}; there are {', '.join(Bench.ALL)}")
    arguments.out = (arguments.out or (arguments.bin / "bench/quick" if arguments.quick else ROOT / "docs/results")).resolve()
    sys.exit(Bench(arguments).write(names))


if __name__ == "__main__":
    main()
