#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`make paper`: section 6 of the XAuto paper (arXiv 2508.09503), figure by figure, its numbers beside ours.

    scripts/paper.py [--quick | --full] [--again PART,...] [--bin build] [--out build/paper] [--docs docs/paper.md]

Writes OUT/paper.json (everything that was computed, run and measured) and, by paper_page.py, OUT/index.html and OUT/paper.md.
--docs: the latter there, too. --render: only the pages, from the paper.json that is there. --again: the same, after some
parts of it were made anew, e.g. those that ran when the machine had become quiet."""
import argparse
import concurrent.futures
import json
import os
import pathlib
import re
import shutil
import statistics
import subprocess
import sys
import threading
import time

import paper_page
from machine import ROOT, machine

GROUPS = (10, 15, 20, 25, 30, 35, 40)
# The paper's Intel platform has 4 CPUs in its small configuration; the built-in one has the chip's 6.
CORE_ULTRA_4 = {"schema": "xauto.platform", "version": 1, "name": "core-ultra-4", "xpus": [
    *({"id": f"cpu{i}", "type": "cpu"} for i in range(4)),
    {"id": "gpu0", "type": "gpu", "preempt_us": 275, "timeslice_us": 1000, "levels": 3},
    {"id": "npu0", "type": "npu", "preemptive": False, "timeslice_us": 1000}]}


class Sizes:
    """How much of each; QUICK only shows that all of it works."""

    def __init__(self, kind):
        quick, full = kind == "quick", kind == "full"
        self.groups = (10, 15) if quick else GROUPS
        self.dags = 1 if quick else 50
        self.solver_s = 0.1 if quick else 10 if full else 1
        self.run_groups = (10,) if quick else GROUPS
        self.run_dags = 1 if quick else 350 if full else 50
        self.releases = 2 if quick else 10 if full else 3
        self.columns = 2 if quick else 64
        self.brute_nodes = (6, 7) if quick else (6, 8, 10, 12, 14, 15, 16, 18, 20)
        self.brute_dags = 1 if quick else 10 if full else 5
        self.brute_s = 2 if quick else 600 if full else 10
        self.ilp_nodes = (6,) if quick else (6, 8, 10, 12, 14, 15, 20)
        self.ilp_dags = 1 if quick else 10 if full else 4
        self.ilp_s = 1 if quick else 60 if full else 10
        self.rounds = 20 if quick else 500
        self.load_s = 1 if quick else 3
        self.driving = 20 if quick else 200


class Stalls(threading.Thread):
    """How long this machine keeps a thread waiting that sleeps 1 ms at a time: the longest, in ms, since take()."""

    def __init__(self):
        super().__init__(daemon=True)
        self.longest = 0.0

    def run(self):
        while True:
            before = time.monotonic()
            time.sleep(0.001)
            self.longest = max(self.longest, (time.monotonic() - before - 0.001) * 1000)

    def take(self):
        longest, self.longest = self.longest, 0.0
        return round(longest, 2)


class Paper:
    def __init__(self, options):
        self.kind = "quick" if options.quick else "full" if options.full else "usual"
        self.sizes, self.bin, self.out = Sizes(self.kind), options.bin.resolve(), options.out.resolve()
        self.work = self.out / "work"
        shutil.rmtree(self.work, ignore_errors=True)
        self.work.mkdir(parents=True)
        self.xauto = self.bin / "bin/xauto"
        (self.work / "core-ultra-4.json").write_text(json.dumps(CORE_ULTRA_4))
        self.platforms = {"small": "small", "large": "large", "core-ultra-4": str(self.work / "core-ultra-4.json")}
        self.stalls, self.loads = Stalls(), {}
        self.stalls.start()

    def call(self, *command, may_fail=False, timeout=None):
        done = subprocess.run([str(c) for c in command], cwd=ROOT, capture_output=True, text=True, timeout=timeout)
        if done.returncode and not may_fail:
            sys.exit(f"paper: {' '.join(map(str, command))} ended with status {done.returncode}:\n{done.stderr[-2000:]}")
        return done

    def asked(self, *words):
        """Of bench_paper."""
        return json.loads(self.call(self.bin / "bench/bench_paper", *words).stdout)

    # ---- computed

    def workload(self, name):
        """Figures 8, 9 and 10, the ablation and the solving time: a line per DAG."""
        s, out = self.sizes, self.work / ("workload-" + name)
        self.call(self.bin / "bench/bench_synthetic", "--dags", s.dags, "--groups", ",".join(map(str, s.groups)), "--platforms",
                  self.platforms[name], "--time-limit", f"{s.solver_s}s", "--out", out)
        return [json.loads(line) for line in (out / "workload.jsonl").read_text().splitlines()]

    def brute(self):
        """Until a size takes longer than the limit on every DAG."""
        s, rows = self.sizes, []
        for nodes in s.brute_nodes:
            for seed in range(1, s.brute_dags + 1):
                try:
                    done = self.call(self.bin / "bench/bench_paper", "brute-force", "--nodes", nodes, "--seed", seed,
                                     "--time-limit", "100ms", timeout=s.brute_s + 1)
                    rows.append(json.loads(done.stdout))
                except subprocess.TimeoutExpired:
                    rows.append({"nodes": nodes, "seed": seed, "brute_s": None, "limit_s": s.brute_s})
        return rows

    def ilp(self):
        s, rows, app = self.sizes, [], self.work / "ilp.json"
        for nodes in s.ilp_nodes:
            for seed in range(1, s.ilp_dags + 1):
                self.call(self.xauto, "generate", "--nodes", nodes, "--seed", seed * 1000 + nodes, "--max-depth", 4, "--out", app)
                row = {"nodes": nodes, "seed": seed, "limit_s": s.ilp_s}
                for method in ("ilp", "auto"):
                    began = time.monotonic()
                    done = self.call(self.xauto, "solve", "--app", app, "--platform", "small", "--method", method, "--threads", 1,
                                     "--time-limit", f"{s.ilp_s}s", "--json", may_fail=True)
                    row[method + "_s"] = time.monotonic() - began
                    if not done.stdout:
                        row[method] = "refused"
                        continue
                    chains = json.loads(done.stdout)["chains"]
                    row[method] = "optimal" if all(c["optimal"] for c in chains) else "not proven"
                    row[method + "_us"] = max(c["worst_case_us"] for c in chains)
                rows.append(row)
        return rows

    # ---- run on the emulated platform, through workers and coordinators

    def compared(self, app, platform, releases, limit_s, *words, policies="ros2,xauto"):
        """The runs of the report, or why there are none."""
        self.stalls.take()
        done = self.call(self.xauto, "compare", "--app", app, "--platform", platform, "--emulate", "--policies", policies,
                         "--time-limit", f"{limit_s}s", "--activations", releases, "--json", "--out", self.work / "compare", "--",
                         "xauto-standin", app, *words, may_fail=True)
        if done.stdout.startswith("{"):
            return json.loads(done.stdout)["runs"]
        return done.stderr.strip().splitlines()[-1][:200] if done.stderr.strip() else f"status {done.returncode}"

    def compare(self, app, *arguments):
        runs = self.compared(app, *arguments)
        if isinstance(runs, str):
            return {"failed": runs}
        ros2, ours = runs
        # A way through x XNodes: what each adds to the plan is the runtime's and the emulator's.
        text = json.loads(app.read_text())
        deep, waits = {}, {}
        for u, v in text.get("edges", []):
            waits.setdefault(v, []).append(u)

        def depth(x):
            if x not in deep:
                deep[x] = 1 + max(map(depth, waits.get(x, [])), default=0)
            return deep[x]
        return {"claim_us": max(c["worst_case_us"] for c in ours["chains"]), "xauto_p50_us": ours["p50_us"],
                "xauto_max_us": ours["max_us"], "ros2_p50_us": ros2["p50_us"], "releases": ours["activations"],
                "lost": ours["lost_activations"] + ros2["lost_activations"], "coordinators_in_run_pct": ours["coordinators_cpu_pct"],
                "depth": max(map(depth, (x["name"] for x in text["xnodes"]))),
                "verdict": ours["claims"]["verdict"], "stall_ms": self.stalls.take(), "load": os.getloadavg()[0]}

    def kept(self, app, platform, *arguments):
        """XAuto alone, with a claim that stands: each job leaves the emulator 0.3 ms of its WCET to wake up in."""
        runs = self.compared(app, platform, *arguments, "--worst", "--slack", "300us", policies="xauto")
        if isinstance(runs, str):
            return {"failed": runs}
        return {"claim_us": max(c["worst_case_us"] for c in runs[0]["chains"]), "xauto_max_us": runs[0]["max_us"],
                "releases": runs[0]["activations"], "lost": runs[0]["lost_activations"], "stall_ms": self.stalls.take()}

    def runs(self, row_of):
        s, rows, app = self.sizes, [], self.work / "app.json"
        for name, platform in self.platforms.items():
            cases = [(n, seed) for seed in range(1, s.dags + 1) for n in s.run_groups][:s.run_dags]
            for number, (nodes, seed) in enumerate(cases):
                self.call(self.xauto, "generate", "--nodes", nodes, "--seed", seed * 1000 + nodes, "--max-depth", 4, "--out", app)
                if name == "core-ultra-4":  # what runs on a DLA runs on its NPU
                    app.write_text(app.read_text().replace('"dla"', '"npu"'))
                row = row_of(app, platform, s.releases, s.solver_s)
                rows.append({"platform": name, "nodes": nodes, "seed": seed, **row})
                print(f"\rpaper: ran {number + 1} of {len(cases)} on {name}   ", end="", file=sys.stderr)
        print(file=sys.stderr)
        return rows

    def columns(self, assignments):
        """Some or all of the 64 assignments of figure 11, run."""
        rows, app = [], self.work / "driving.json"
        whole = json.loads((ROOT / "examples/driving/app.json").read_text())
        for row in assignments[-self.sizes.columns:]:
            one = json.loads(json.dumps(whole))
            for x in one["xnodes"]:
                if {"gpu", "dla"} <= set(x["wcet_us"]):
                    x["wcet_us"] = {t: us for t, us in x["wcet_us"].items() if t == ("dla" if x["name"] in row["dla"] else "gpu")}
            app.write_text(json.dumps(one))
            rows.append({"dla": row["dla"], **self.compare(app, "small", 2 * self.sizes.releases, 1, "--worst")})
        return rows

    def driving(self):
        """The Driving Case as it is, on an ordinary day and at its worst."""
        rows = []
        for words in ((), ("--worst",)):
            runs = self.compared(ROOT / "examples/driving/app.json", "small", self.sizes.driving, 2, *words,
                                 policies="ros2,heft,xauto,xauto-unscheduled")
            if isinstance(runs, str):
                sys.exit(f"paper: the Driving Case did not run: {runs}")
            stall = self.stalls.take()
            rows += [{"times": "WCET" if words else "60 to 95 % of it", "policy": r["policy"], "releases": r["activations"],
                      "lost": r["lost_activations"], "p50_us": r["p50_us"], "p99_us": r["p99_us"], "max_us": r["max_us"],
                      "claim_us": max((c.get("worst_case_us") or 0 for c in r["chains"]), default=0), "verdict": r["claims"]["verdict"],
                      "coordinators_in_run_pct": r["coordinators_cpu_pct"], "stall_ms": stall} for r in runs]
        return rows

    def runtime(self):
        """Medians of three runs; one if quick."""
        s, found = self.sizes, {}
        for _ in range(1 if self.kind == "quick" else 3):
            for only in ("suspend", "coordinator", "decision"):
                file = self.work / "runtime.json"
                self.call(self.bin / "bench/bench_runtime", "--fifo", "--only", only, "--rounds", s.rounds, "--duration",
                          f"{s.load_s}s", "--json", file)
                for row in json.loads(file.read_text())["rows"]:
                    found.setdefault((row["case"], row["program"]), []).append((row["p50"], row["p99"]))
        return [{"case": case, "program": program, "p50": statistics.median(v[0] for v in values),
                 "p99": statistics.median(v[1] for v in values), "times": len(values)} for (case, program), values in found.items()]

    # ----

    def parts(self, data):
        """In this order: what is computed uses both cores, what runs has them for itself."""
        def beside(*work):
            with concurrent.futures.ThreadPoolExecutor(2) as pool:
                return [f.result() for f in [pool.submit(w) for w in work]]
        return {"timelines": lambda: self.asked("timelines"),
                "all_on_gpu": lambda: self.asked("all-on-gpu"),
                "assignments": lambda: self.asked("assignments", "--time-limit", "1s"),
                "workload": lambda: sum(beside(*(lambda n=n: self.workload(n) for n in self.platforms)), []),
                "optimum": lambda: dict(zip(("brute", "ilp"), beside(self.brute, self.ilp))),
                "runs": lambda: self.runs(lambda *which: self.compare(*which, "--worst")),
                "kept": lambda: self.runs(self.kept), "columns": lambda: self.columns(data["assignments"]), "driving": self.driving,
                "runtime": self.runtime}

    def collect(self, data=None, again=()):
        began = time.monotonic()
        data = data or {"schema": "xauto.paper", "version": 1, "kind": self.kind, "machine": machine(), "took_s": 0, "parts": {}}
        if data["kind"] != self.kind:
            sys.exit(f"paper: what is there was made otherwise ({data['kind']}): its parts cannot be mixed with these ({self.kind})")
        data["sizes"] = {k: list(v) if isinstance(v, range) else v for k, v in vars(self.sizes).items()}
        for name, work in self.parts(data).items():
            if again and name not in again:
                continue
            print(f"paper: {name}", flush=True)
            at, before, said = time.monotonic(), os.getloadavg()[0], dict(machine())
            data[name] = work()
            data["parts"][name] = {"revision": said["revision"], "date": said["date"], "seconds": round(time.monotonic() - at, 1),
                                   "load": [round(before, 1), round(os.getloadavg()[0], 1)]}
        data["took_s"] = round(sum(part["seconds"] for part in data["parts"].values()) if again else time.monotonic() - began)
        return data


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--quick", action="store_true", help="a minute: to see that all of it works")
    which.add_argument("--full", action="store_true", help="hours: every DAG run, long limits")
    which.add_argument("--render", action="store_true", help="the pages alone, from OUT/paper.json")
    parser.add_argument("--again", default="", metavar="PART,...", help="these parts of OUT/paper.json anew")
    parser.add_argument("--bin", type=pathlib.Path, default=ROOT / "build", help="the build folder")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "build/paper")
    parser.add_argument("--docs", type=pathlib.Path, help="the text, here too; paper.json in results/ and pictures in img/ beside it")
    options = parser.parse_args()
    file = options.out / "paper.json"
    if not options.render:
        known = json.loads(file.read_text()) if options.again else None
        again = [part for part in options.again.split(",") if part]
        paper = Paper(options)
        if unknown := set(again) - set(paper.parts({})):
            parser.error(f"--again: no part {', '.join(sorted(unknown))}; there are {', '.join(paper.parts({}))}")
        data = paper.collect(known, again)
        text = json.dumps(data, indent=None, separators=(",", ":"))
        file.write_text(re.sub(r"(\[\{|\},)(?=\{|\")", lambda m: m.group(0) + "\n", text) + "\n")  # a line a row
    data = json.loads(file.read_text())
    page, text = paper_page.page(data), paper_page.markdown(data)
    (options.out / "index.html").write_text(page)
    (options.out / "paper.md").write_text(text)
    if options.docs:
        options.docs.write_text(text)
        shutil.copy(file, options.docs.parent / "results" / "paper.json")
        for name, picture in paper_page.drawings(data).items():
            (options.docs.parent / "img" / f"paper-{name}.svg").write_text(picture)
    print(options.out / "index.html")


if __name__ == "__main__":
    main()
