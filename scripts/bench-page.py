#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the benchmarks one after the other and writes a page of their results. Called by scripts/bench.sh.

Every section says what kind of number it holds: `model` (computed), `emulated` (the real runtime, stages that sleep), or
`measured` (this machine). Of several runs the median is shown, and how far they lie apart."""
import argparse
import datetime
import html
import json
import os
import pathlib
import platform
import shutil
import statistics
import subprocess
import sys
import textwrap
import time

ROOT = pathlib.Path(__file__).resolve().parents[1]
KINDS = {"model": "Model figures: computed, nothing ran.",
         "emulated": "Emulated: the real runtime, with stages that sleep for as long as they are said to take.",
         "measured": "Measured on this machine."}
# Rows that are not XAuto's: what the kernel needs for the same at least, and other people's libraries.
OTHERS = ("futex", "bare futex", "own-", "call", "tbb", "cyclone", "iceoryx", "starpu")
SHARE = ("The share of a CPU is that of three coordinators, their start-up left out. The follower of an order pair asks before its leader "
         "has ended. What wakes a coordinator is a preemption within a preemption; these jobs hardly ever meet one.")


def text_of(*command):
    try:
        return subprocess.run(command, capture_output=True, text=True, cwd=ROOT).stdout.strip()
    except OSError:
        return ""


def machine():
    info = pathlib.Path("/proc/cpuinfo").read_text()
    model = next((line.split(":", 1)[1].strip() for line in info.splitlines() if line.startswith("model name")),
                 platform.machine())
    virtual = text_of("systemd-detect-virt", "--vm").replace("none", "") or ("yes" if "hypervisor" in info else "none seen")
    memory = int(pathlib.Path("/proc/meminfo").read_text().split()[1]) // 1024
    changed = text_of("git", "status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs/results")
    return [("CPU", f"{model}, {os.cpu_count()} cores"), ("memory", f"{memory} MiB"), ("virtual machine", virtual),
            ("kernel", platform.release()), ("compiler", text_of("c++", "--version").split("\n")[0]),
            ("revision", (text_of("git", "rev-parse", "--short", "HEAD") or "unknown") + (", with changes" if changed else "")),
            ("date", datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%d %H:%M UTC"))]


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

    def section(self, title, kind, what):
        self.page += [f"## {title}", "", *textwrap.wrap(f"*{KINDS[kind]}* {what}", 120, break_long_words=False, break_on_hyphens=False), ""]

    def table(self, head, rows):
        self.page += ["| " + " | ".join(head) + " |", "| --- |" + " --: |" * (len(head) - 1)]
        self.page += ["| " + " | ".join(map(str, row)) + " |" for row in rows] + [""]

    def text(self, name, text):
        """A program's own table, whole, beside the page."""
        (self.out / name).write_text(text if text.endswith("\n") else text + "\n")
        self.page += [f"All of it: [`{name}`]({name}).", ""]

    def plot(self, name, title, unit, bars):
        """Horizontal bars with the range of the runs: [(label, value, least, greatest)]."""
        most = max(b[3] for b in bars) * 1.15 or 1
        x = lambda v: 190 + 520 * v / most
        height = 52 + 30 * len(bars)
        svg = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 800 {height}" font-family="system-ui, sans-serif" font-size="13" '
               f'role="img" aria-label="{html.escape(title)}">', "<!-- SPDX-License-Identifier: Apache-2.0; by scripts/bench-page.py -->",
               "<style>text{fill:#1c1f24}.bar{fill:#0b62c4}.range{stroke:#1c1f24;stroke-width:1.5}"
               "@media (prefers-color-scheme: dark){text{fill:#e7e9ed}.bar{fill:#6cb2ff}.range{stroke:#e7e9ed}}</style>",
               f'<text x="8" y="22" font-weight="650">{html.escape(title)}</text>']
        for i, (label, value, least, greatest) in enumerate(bars):
            y = 40 + 30 * i
            svg += [f'<text x="180" y="{y + 15}" text-anchor="end">{html.escape(label)}</text>',
                    f'<rect class="bar" x="190" y="{y}" width="{x(value) - 190:.1f}" height="20" rx="3" opacity="0.85"/>',
                    f'<path class="range" d="M{x(least):.1f} {y + 10}H{x(greatest):.1f}"/>',
                    f'<text x="{x(max(value, greatest)) + 8:.1f}" y="{y + 15}">{value:.2f} {html.escape(unit)}</text>']
        (self.out / name).write_text("\n".join(svg + ["</svg>"]) + "\n")
        self.page += [f"![{title}]({name})", ""]

    # ---- the benchmarks

    def driving(self):
        runs, activations = (2, 40) if self.quick else (5, 220)
        os.environ["DRIVING_TIMES"] = "worst"  # as published
        reports = []
        for number in range(runs):
            out = self.work / f"driving-{number}"
            self.run(self.bin / "bin/xauto", "compare", "--app", "examples/driving/app.json", "--platform", "small", "--emulate",
                     "--activations", activations, "--out", out, "--", self.bin / "bin/driving")
            reports.append(json.loads((out / "report.json").read_text())["runs"])
        self.section("The Driving Case", "emulated", f"{runs} runs of {activations} activations a policy; end-to-end latency in ms, the medians "
                     "over the runs, in brackets the least and the greatest. The stage times are a "
                     f"reconstruction ([how]({os.path.relpath(ROOT / 'docs/driving-case.md', self.out)})).")
        rows, bars = [], []
        for policy in zip(*reports):
            def over(key):
                values = [r[key] / 1000 for r in policy]
                return statistics.median(values), min(values), max(values)
            cells = [policy[0]["policy"]]
            cells += ["{:.2f} ({:.2f}–{:.2f})".format(*over(k)) for k in ("p50_us", "p99_us", "max_us")]
            cells.append(sum(r["lost_activations"] for r in policy))
            rows.append(cells)
            bars.append((policy[0]["policy"], *over("p99_us")))
        self.table(["policy", "p50", "p99", "max", "lost"], rows)
        self.plot("driving.svg", "Driving Case, emulated: p99 of the end-to-end latency", "ms", bars)

    def runtime(self):
        runs, rounds, seconds = (2, 40, 1) if self.quick else (3, 500, 3)
        rows = {}
        for number in range(runs):
            file = self.work / f"runtime-{number}.json"
            text = self.run(self.bin / "bench/bench_runtime", "--fifo", "--rounds", rounds, "--duration", f"{seconds}s", "--json", file)
            for row in json.loads(file.read_text())["rows"]:
                rows.setdefault((row["section"], row["case"], row["program"]), []).append((row["p50"], row["p99"]))
        self.section("The runtime beside its floors and peers", "measured", f"{runs} runs of {rounds} samples a row; microseconds unless the row says %, "
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

    def synthetic(self):
        dags, limit = (1, 0.2) if self.quick else (50, 10)
        out = self.work / "synthetic"
        shutil.rmtree(out, ignore_errors=True)  # it would go on from what is there
        text = self.run(self.bin / "bench/bench_synthetic", "--dags", dags, "--time-limit", f"{limit}s", "--out", out)
        self.section("The synthetic workload", "model", f"{dags} DAGs a group, solver's limit {limit} s a DAG: speed-ups over ROS 2's way and HEFT, ablations, "
                     f"gaps to the proven bound ([what it is]({os.path.relpath(ROOT / 'docs/synthetic.md', self.out)})).")
        for plot in sorted(out.glob("*.svg")):
            shutil.copy(plot, self.out / plot.name)
            self.page += [f"![{plot.stem}]({plot.name})"]
        self.page.append("")
        self.text("synthetic.txt", text)

    def worst_case(self):
        policies, executions = (24, 500) if self.quick else (504, 20_000)
        text = self.run(self.bin / "bench/bench_worst_case", "--policies", policies, "--executions", executions)
        self.section("Attacks on the certified worst case", "model", f"{policies} policies, {executions} executions each, chosen to break "
                     "`worst_case_us`. One above it ends the benchmark with an error.")
        self.page += ["```", text.strip(), "```", ""]

    def cpu_priority(self):
        runs = 2 if self.quick else 5
        answers = [json.loads(self.run(self.bin / "bench/bench_cpu_priority", "--json")) for _ in range(runs)]
        self.section("Changing the priority of the next job", "measured", f"{runs} runs, medians; what a worker pays before each job. The store went to "
                     f"{'a mapped BPF map' if answers[0]['mapped'] else 'ordinary memory (no BPF map without root)'}.")
        middle = lambda key: statistics.median(a[key] for a in answers)
        self.table(["way", "ns"], [["store into the map that sched_ext reads", f"{middle('store_ns'):.1f}"],
                                   ["sched_setattr(2), for SCHED_FIFO", f"{middle('sched_setattr_ns'):.1f}"]])

    def tracing(self):
        pairs, activations = (1, 60) if self.quick else (5, 100)
        text = self.run("bench/tracing/overhead.sh", self.bin, pairs, activations)
        self.section("What `top --record` costs", "measured", f"{pairs} pair{'s' * (pairs > 1)} of emulated runs with and without it, {activations} activations each.")
        self.page += ["```", text.strip(), "```", ""]

    ALL = ("driving", "runtime", "cpu_priority", "tracing", "worst_case", "synthetic")

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
        note = (f"Load average while it ran: median {statistics.median(loads):.1f}, from {loads[0]:.1f} to {loads[-1]:.1f}, of which the "
                f"benchmarks' own threads are a part; {os.cpu_count()} cores.")
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
    parser.add_argument("--quick", action="store_true", help="minutes instead of hours")
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
