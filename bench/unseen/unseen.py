#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Apps that nothing was tuned on, run on emulated XPUs: is any chain longer than its certified worst case?

Apps of several rates, of several clocks, and of both with activations in flight (bench_steady, from a seed of their own).
Each is solved and run twice by `xauto compare`: under version 1's fixed priorities, and under keys. XNodes take random
times, the same in both runs (bench_standin). The certificate allows each XNode SLACK us more than what it draws, and each
source JITTER us: that is what dispatch and the emulator's timers take here, as a WCET that was measured here would hold
it. Periods and times are those of the cases times SLOWER.

What is told of a run: chains whose longest latency is above their worst case, and above it by more than 2 %. Next to it
whether the run itself says that its assumptions were broken (a machine that stands still): then nothing is claimed. Fixed
priorities claim nothing for such apps; theirs are held against the keys' worst cases.

    bench/unseen/unseen.py [--build build] [--apps 50] [--seconds 60] [--at-once 2] [--slower 2] [--real-time] [--json FILE]
"""
import argparse
import concurrent.futures
import json
import os
import pathlib
import subprocess
import sys
import tempfile

SOURCE = pathlib.Path(__file__).resolve().parents[2]
KINDS = ("rates", "clocks", "mixed")


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", default=str(SOURCE / "build"))
    parser.add_argument("--apps", type=int, default=50)
    parser.add_argument("--first", type=int, default=101, help="seed of the first case of each kind")
    parser.add_argument("--seconds", type=float, default=60, help="of each run")
    parser.add_argument("--solve-s", type=float, default=5)
    parser.add_argument("--slower", type=int, default=2)
    parser.add_argument("--slack-us", type=int, default=400)
    parser.add_argument("--jitter-us", type=int, default=500)
    parser.add_argument("--at-once", type=int, default=2, help="how many apps run side by side")
    parser.add_argument("--real-time", action="store_true", help="all of it under SCHED_FIFO, for a machine with other work")
    parser.add_argument("--json", help="write what was measured here")
    return parser.parse_args()


def runnable(app, options):
    """The app as a program can have it: edges and samples from a module's last XNode to another's first, no transfers."""
    module = {x["name"]: x["module"] for x in app["xnodes"]}
    app["edges"] = [e if isinstance(e, list) else [e["from"], e["to"]] for e in app["edges"]]
    inner = [e for e in app["edges"] if module[e[0]] == module[e[1]]]
    first = {module[x]: x for x in set(module) - {v for _, v in inner}}
    last = {module[x]: x for x in set(module) - {u for u, _ in inner}}
    app["samples"] = [list(s) for s in sorted({(last[module[u]], first[module[v]]) for u, v in app.get("samples", [])})]
    app.pop("chains", None)  # all that there are
    for source in app["sources"]:
        for key in ("period_us", "offset_us", "jitter_us"):
            if key in source:
                source[key] *= options.slower
        if "rate_hz" in source:
            source["rate_hz"] /= options.slower
        source["jitter_us"] = source.get("jitter_us", 0) + options.jitter_us
    for xnode in app["xnodes"]:
        xnode["wcet_us"] = {t: us * options.slower + options.slack_us for t, us in xnode["wcet_us"].items()}
    return app


def one(folder, name, number, options):
    made = json.loads(pathlib.Path(folder, name + ".app.json").read_text())
    app = os.path.join(folder, name + ".run.json")
    pathlib.Path(app).write_text(json.dumps(runnable(made, options)))
    done = subprocess.run(
        ["chrt", "-f", "50"] * options.real_time + [os.path.join(options.build, "bin/xauto"), "compare", "--app", app, "--platform",
         os.path.join(folder, name + ".platform.json"), "--seconds", str(options.seconds), "--policies", "fixed,keys",
         "--emulate", "--time-limit-s", str(options.solve_s), "--json", "--out", os.path.join(folder, name), "--",
         os.path.join(options.build, "bench/bench_standin"), app, str(number), str(options.slack_us)],
        capture_output=True, text=True)
    row = {"app": name, "xnodes": len(made["xnodes"])}
    if not done.stdout.startswith("{"):
        row["why"] = " ".join(done.stderr.strip().splitlines()[-2:])
        return row
    runs = {run["policy"]: run for run in json.loads(done.stdout)["runs"]}
    worst = {c["name"]: c["worst_case_us"] for c in runs["keys"]["chains"]}
    for policy, run in runs.items():
        seen = [c["latency_us"]["max"] / worst[c["name"]] for c in run["chains"] if c["latency_us"]["max"] is not None]
        row[policy] = {"releases": run["activations"] + run["lost_activations"], "lost": run["lost_activations"],
                       "chains": len(run["chains"]), "measured": len(seen), "above": sum(s > 1 for s in seen),
                       "above_by_2_pct": sum(s > 1.02 for s in seen), "longest_to_worst_case": max(seen, default=None)}
    row["assumptions_broken"] = runs["keys"]["worst_case_broken"]
    return row


def line(row):
    if "keys" not in row:
        return f"{row['app']:<14}{row['xnodes']:>7}  {row.get('why', '')}"
    text = f"{row['app']:<14}{row['xnodes']:>7}"
    for policy in ("fixed", "keys"):
        r = row[policy]
        longest = "-" if r["longest_to_worst_case"] is None else f"{r['longest_to_worst_case']:.3f}"
        text += f"{r['releases']:>10}{r['lost']:>6}{r['above_by_2_pct']:>5} of {r['measured']:<4}{longest:>8}"
    return text + "  " + ("; ".join(row["assumptions_broken"]) or "kept")


def main():
    options = parse()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        names = []
        for first in range(options.first, options.first + 1000, 100):
            if len(names) >= options.apps:
                break
            subprocess.run([os.path.join(options.build, "bench/bench_steady"), "--first", str(first), "--only",
                            ",".join(KINDS), "--write", folder], check=True)
            names = sorted((p.name[:-len(".app.json")] for p in pathlib.Path(folder).glob("*.app.json")),
                           key=lambda n: (int(n.split("-")[1]), n))
        print(f"{'app':<14}{'XNodes':>7}{'fixed: releases, lost, chains > 1.02 wc':>36}{'max/wc':>8}"
              f"{'keys: the same':>34}  assumptions", flush=True)
        with concurrent.futures.ThreadPoolExecutor(options.at_once) as pool:
            todo = list(enumerate(names[:options.apps]))
            for begin in range(0, len(todo), options.at_once):  # together, so that nobody solves while another one runs
                for row in pool.map(lambda n: one(folder, n[1], n[0], options), todo[begin:begin + options.at_once]):
                    rows.append(row)
                    print(line(row), flush=True)
    ran = [r for r in rows if "keys" in r]
    kept = [r for r in ran if not r["assumptions_broken"]]
    over = lambda policy, of: sum(r[policy]["above_by_2_pct"] > 0 for r in of)
    print(f"{len(ran)} apps ran, {len(rows) - len(ran)} have no policy. Keys: {over('keys', ran)} with a chain above its worst "
          f"case + 2 %; of the {len(kept)} whose assumptions were kept, {over('keys', kept)}. Fixed priorities: {over('fixed', ran)}.")
    if options.json:
        pathlib.Path(options.json).write_text(json.dumps(
            {"seconds": options.seconds, "runs": 1, "slower": options.slower, "slack_us": options.slack_us,
             "jitter_us": options.jitter_us, "apps": rows}, indent=1) + "\n")
    return 1 if over("keys", kept) else 0


if __name__ == "__main__":
    sys.exit(main())
