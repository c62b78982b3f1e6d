#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Public job shops through `xauto solve`: each machine a type with one XPU that does not preempt, each job a chain.

usage: shops.py FOLDER [--xauto build/bin/xauto] [--time-limit-s 10] [--seed 1] [--threads 2] [--out FILE]

FOLDER has instances as they are published: `NAME.txt`, flexible ("jobs machines", then per job its operations, each
"alternatives, (machine, time) ..."; github.com/SchedulingLab/fjsp-instances, brandimarte/), or `NAME.jsp`, classic
("jobs machines", then per job (machine, time) ...; github.com/tamy0612/JSPLIB, instances/). Prints a table and, with
--out, one JSON object per line. The gap is to the best known makespan, below."""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

# Brandimarte's: best known upper bounds. Classic ones: optima, as JSPLIB's instances.json has them.
BEST = dict(mk01=40, mk02=26, mk03=204, mk04=60, mk05=172, mk06=57, mk07=139, mk08=523, mk09=307, mk10=193, ft06=55,
            ft10=930, la16=945, la17=784, la18=848, la19=842, la20=902, orb01=1059, orb03=1005, orb05=887, abz5=1234,
            abz6=943)
UNIT_US = 1000


def jobs_of(path):
    """Number of machines; per job, per operation, its alternatives (machine, time)."""
    lines = [l for l in path.read_text().splitlines() if l.strip() and not l.startswith("#")]
    count, machines = (int(v) for v in lines[0].split()[:2])
    jobs = []
    for line in lines[1:1 + count]:
        values = iter([int(v) for v in line.split()])
        if path.suffix == ".txt":
            jobs.append([[(next(values), next(values)) for _ in range(next(values))] for _ in range(next(values))])
        else:
            jobs.append([[(next(values), next(values))] for _ in range(machines)])
    return machines, jobs


def makespan(args, path, folder):
    machines, jobs = jobs_of(path)
    app = {"schema": "xauto.app", "version": 1, "name": path.stem, "xnodes": [], "edges": []}
    for j, operations in enumerate(jobs):
        for k, alternatives in enumerate(operations):
            wcet_us = {f"t{machine}": time * UNIT_US for machine, time in alternatives}
            app["xnodes"].append({"name": f"x{j}.{k}", "module": f"j{j}", "wcet_us": wcet_us})
            if k > 0:
                app["edges"].append([f"x{j}.{k - 1}", f"x{j}.{k}"])
    xpus = [{"id": f"m{m}", "type": f"t{m}", "preemptive": False, "preempt_us": 0} for m in range(machines)]
    platform = {"schema": "xauto.platform", "version": 1, "name": "machines", "xpus": xpus}
    files = [pathlib.Path(folder) / "app.json", pathlib.Path(folder) / "platform.json"]
    for file, content in zip(files, (app, platform)):
        file.write_text(json.dumps(content))
    done = subprocess.run([args.xauto, "solve", "--app", files[0], "--platform", files[1], "--json",
                           "--time-limit-s", str(args.time_limit_s), "--seed", str(args.seed), "--threads",
                           str(args.threads)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"shops: {path}: {done.stderr.strip()}")
    policy = json.loads(done.stdout)
    return policy["latency_us"] / UNIT_US, policy["lower_bound_us"] / UNIT_US, sum(len(job) for job in jobs)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--xauto", default="build/bin/xauto")
    parser.add_argument("--time-limit-s", type=float, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out")
    args = parser.parse_args()
    paths = [p for p in sorted(args.folder.iterdir()) if p.suffix in (".txt", ".jsp") and p.stem in BEST]
    if not paths:
        sys.exit(f"shops: no instance that it knows in {args.folder}; see --help for where they are")
    rows = []
    print(f"{'instance':10} {'operations':>10} {'best known':>10} {'here':>8} {'bound':>8} {'gap, %':>7}")
    with tempfile.TemporaryDirectory() as folder:
        for path in paths:
            here, bound, operations = makespan(args, path, folder)
            gap = 100 * (here / BEST[path.stem] - 1)
            rows.append({"instance": path.stem, "flexible": path.suffix == ".txt", "operations": operations,
                         "best": BEST[path.stem], "makespan": here, "bound": bound, "gap_pct": round(gap, 3),
                         "time_limit_s": args.time_limit_s, "seed": args.seed})
            print(f"{path.stem:10} {operations:10} {BEST[path.stem]:10} {here:8.0f} {bound:8.1f} {gap:7.2f}", flush=True)
    for name, flexible in (("flexible", True), ("classic", False)):
        gaps = [row["gap_pct"] for row in rows if row["flexible"] == flexible]
        if gaps:
            print(f"{name}: {len(gaps)} instances, mean gap {sum(gaps) / len(gaps):.2f} %, largest {max(gaps):.2f} %")
    if args.out:
        pathlib.Path(args.out).write_text("".join(json.dumps(row) + "\n" for row in rows))


if __name__ == "__main__":
    main()
