#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""How short the period of the Driving Case may get, on emulated XPUs.

For each period: app.json with `max_in_flight`, a policy of keys by `xauto solve`, and a run of so many
releases, all XNodes taking their whole time. Told are what was lost, and the longest reaction of each chain beside its worst case.
The busiest XPU's load is the least that any assignment leaves, so `period / load` of 1 cannot be passed.

With --slower N all times are N times as long. The plan allows each XNode --slack-us more than it takes: what dispatch and
the emulator's timers cost, as a measured WCET would hold it. The load that is told holds it, too.

With --guest the runs are in a guest that keeps time (bench/guest.py).

    bench/runtime/sustain.py [--build build] [--releases 1000] [--periods-us 33000,27000,24000,22000] [--slower N] [--guest] [--json]
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
import guest

SOURCE = pathlib.Path(__file__).resolve().parents[2]
FED = {"la.pre": "camera/front", "td.pre": "camera/front", "fcd.pre": "camera/front", "rcd.pre": "camera/rear",
       "ld.pre": "lidar/top"}


def app_of(period_us, options):
    app = json.loads((SOURCE / "examples/driving/app.json").read_text())
    for xnode in app["xnodes"]:
        xnode.pop("source", None)
        if xnode["name"] in FED:
            xnode["source"] = FED[xnode["name"]]
        xnode["wcet_us"] = {xpu: us * options.slower + options.slack_us for xpu, us in xnode["wcet_us"].items()}
    app.pop("deadline_us", None)
    app.update(version=3, name="driving-pipelined",
               sources=[{"name": n, "period_us": period_us * options.slower, "jitter_us": options.jitter_us}
                        for n in sorted(set(FED.values()))],
               modules=[{"name": m, "max_in_flight": options.in_flight} for m in sorted({x["module"] for x in app["xnodes"]})])
    return app


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", default=str(SOURCE / "build"))
    parser.add_argument("--releases", type=int, default=1000)
    parser.add_argument("--periods-us", default="33000,27000,24000,22000")
    parser.add_argument("--in-flight", type=int, default=3)
    parser.add_argument("--jitter-us", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=10, help="of solving")
    parser.add_argument("--slower", type=int, default=1)
    parser.add_argument("--slack-us", type=int, default=200)
    parser.add_argument("--real-time", action="store_true", help="the runs under SCHED_FIFO, for a machine with other work")
    parser.add_argument("--guest", action="store_true", help="the runs in a guest that keeps time")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    tool = os.path.join(options.build, "bin/xauto")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = lambda name: os.path.join(folder, name)
        for period_us in map(int, options.periods_us.split(",")):
            pathlib.Path(path("app.json")).write_text(json.dumps(app_of(period_us, options)))
            pathlib.Path(path("d.json")).write_text(json.dumps(
                {"schema": "xauto.deployment", "version": 1, "app": "driving-pipelined", "queue_depth": 256, "keep": 256,
                 "defaults": {"overload": "queue:256"}}))
            solved = subprocess.run([tool, "solve", "--app", path("app.json"), "--platform", "small", "--time-limit", f"{options.seconds}s", "--threads", "2", "--out", path("policy.json")],
                                    capture_output=True, text=True)
            row = {"period_us": period_us, "slower": options.slower, "slack_us": options.slack_us,
                   "policy": solved.returncode == 0}
            rows.append(row)
            if not row["policy"]:
                row["why"] = (solved.stdout + solved.stderr).strip().splitlines()[-1:]
                continue
            run = lambda at: ["run", "--app", at("app.json"), "--platform", "small", "--policy", at("policy.json"), "--deployment",
                              at("d.json"), "--emulate", "--json", "--activations", str(options.releases), "--", "xauto-standin",
                              at("app.json"), "--worst", "--slack", f"{options.slack_us}us"]
            if options.guest:
                names = ("app.json", "policy.json", "d.json")
                ran = guest.run(options.build, {n: path(n) for n in names}, [["xauto", *run(str)]])[0]
            else:
                ran = subprocess.run([*(["chrt", "-f", "50"] if options.real_time else []), tool, *run(path)], capture_output=True,
                                     text=True)
            if not ran.stdout.startswith("{"):
                sys.exit(ran.stderr)
            run = json.loads(ran.stdout)["runs"][0]
            row.update(releases=run["activations"] + run["lost_activations"], lost=run["lost_activations"],
                       broken=run["claims"]["broken"],
                       chains=[{"name": c["name"], "worst_case_us": c["worst_case_us"], **c["latency_us"]} for c in run["chains"]])
    if options.json:
        print(json.dumps(rows, indent=1))
        return
    print("period ms  releases  lost  longest reaction / worst case: median, p99, maximum over the chains")
    for row in rows:
        if not row["policy"]:
            print(f"{row['period_us'] / 1000:9.2f}  no policy: {' '.join(row['why'])}")
            continue
        worst = lambda key: max(c[key] / c["worst_case_us"] for c in row["chains"])
        print(f"{row['period_us'] / 1000:9.2f}  {row['releases']:8}  {row['lost']:4}  {worst('p50'):.3f}  {worst('p99'):.3f}  "
              f"{worst('max'):.3f}")
        for line in row["broken"]:
            print(f"{'':11}{line}")


if __name__ == "__main__":
    main()
