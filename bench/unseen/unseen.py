#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Apps that nothing was tuned on, run on emulated XPUs: is any chain longer than its certified worst case?

Apps of several rates, of several clocks, and of both with activations in flight (bench_keys, from a seed of their own).
Each is solved and run twice: under fixed priorities, and under keys. XNodes take random
times, the same in both runs (xauto-standin), and where there are several clocks, each begins at a random phase, the same in
both, and is as far off as it may be. The certificate allows each XNode SLACK us more than what it draws, and each
source JITTER us: that is what dispatch and the emulator's timers take here, as a WCET that was measured here would hold
it. Periods and times are those of the cases times SLOWER.

What is told of a run: chains whose longest latency is above their worst case, and above it by more than 2 %. Next to it
whether the run itself says that its assumptions were broken (a machine that stands still): then nothing is claimed. Fixed
priorities claim nothing for such apps; theirs are held against the keys' worst cases.

With --guest the runs are in a guest that keeps time (bench/guest.py), where --slower 1 will do.

    bench/unseen/unseen.py [--build build] [--apps 50] [--seconds 60] [--at-once 2] [--slower 2] [--real-time | --guest] [--json FILE]
"""
import argparse
import concurrent.futures
import json
import os
import pathlib
import subprocess
import sys
import tempfile

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1]))
import guest

SOURCE = pathlib.Path(__file__).resolve().parents[2]
KINDS = ("rates", "clocks", "mixed")


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", default=str(SOURCE / "build"))
    parser.add_argument("--apps", type=int, default=50)
    parser.add_argument("--only", help="of these the named ones: rates-105,clocks-204")
    parser.add_argument("--first", type=int, default=101, help="seed of the first case of each kind")
    parser.add_argument("--seconds", type=float, default=60, help="of each run")
    parser.add_argument("--solve-s", type=float, default=5)
    parser.add_argument("--slower", type=int, default=2)
    parser.add_argument("--slack-us", type=int, default=400)
    parser.add_argument("--jitter-us", type=int, default=500)
    parser.add_argument("--at-once", type=int, default=2, help="how many apps run side by side")
    parser.add_argument("--real-time", action="store_true", help="all of it under SCHED_FIFO, for a machine with other work")
    parser.add_argument("--guest", action="store_true", help="the runs in a guest that keeps time")
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


def tool(options, *arguments, real_time=False):
    chrt = ["chrt", "-f", "50"] if real_time and options.real_time else []
    return subprocess.run([*chrt, os.path.join(options.build, "bin/xauto"), *map(str, arguments)], capture_output=True, text=True)


class App:
    def __init__(self, folder, number, name, options):
        self.name, self.options = name, options
        self.path = lambda what: os.path.join(folder, f"{name}.{what}")
        made = json.loads(pathlib.Path(self.path("app.json")).read_text())
        pathlib.Path(self.path("run.json")).write_text(json.dumps(runnable(made, options)))
        at = os.path.basename if options.guest else str
        self.of = ["--app", at(self.path("run.json")), "--platform", at(self.path("platform.json"))]
        self.run_flags = ["--emulate", "--json", "--duration", f"{options.seconds}s"]
        if any(clock["name"] != "main" for clock in made.get("clocks", [])):
            self.run_flags += ["--phases", "--seed", number + 1]
        self.program = ["--", "xauto-standin", at(self.path("run.json")), "--seed", number + 1, "--slack", f"{options.slack_us}us"]
        self.commands = {
            "fixed": ["compare", *self.of, *self.run_flags, "--policies", "fixed", "--time-limit", "1s", "--out",
                      "compare" if options.guest else self.path("compare"), *self.program],
            "keys": ["run", *self.of, *self.run_flags, "--policy", at(self.path("policy.json")), *self.program]}
        self.row = {"app": name, "xnodes": len(made["xnodes"])}
        self.runs = {}

    def solve(self):
        done = tool(self.options, "solve", "--app", self.path("run.json"), "--platform", self.path("platform.json"), "--time-limit", f"{self.options.solve_s}s", "--out", self.path("policy.json"))
        if done.returncode:
            self.row["why"] = " ".join((done.stdout + done.stderr).strip().splitlines()[-2:])

    def run(self, policy):
        if "why" not in self.row:
            self.take(policy, tool(self.options, *self.commands[policy], real_time=True))

    def run_in_guest(self):
        if "why" in self.row:
            return
        files = {os.path.basename(self.path(what)): self.path(what) for what in ("run.json", "platform.json", "policy.json")}
        done = guest.run(self.options.build, files, [["xauto", *map(str, command)] for command in self.commands.values()])
        for policy, ran in zip(self.commands, done):
            self.take(policy, ran)

    def take(self, policy, done):
        if done.stdout.startswith("{"):
            self.runs[policy] = json.loads(done.stdout)["runs"][0]
        else:
            self.row["why"] = f"{policy}: " + " ".join(done.stderr.strip().splitlines()[-2:])

    def account(self):
        if "why" in self.row:
            return
        worst = {c["name"]: c["worst_case_us"] for c in self.runs["keys"]["chains"]}
        for policy, run in self.runs.items():
            seen = [c["latency_us"]["max"] / worst[c["name"]] for c in run["chains"] if c["latency_us"]["max"] is not None]
            lost = sum(m["failed"] + m["dropped"] for m in run["modules"])
            self.row[policy] = {
                "activations": sum(m["activations"] for m in run["modules"]) + lost, "lost": lost, "chains": len(run["chains"]),
                "measured": len(seen), "above": sum(s > 1 for s in seen), "above_by_2_pct": sum(s > 1.02 for s in seen),
                "longest_to_worst_case": max(seen, default=None)}
        self.row["assumptions_broken"] = self.runs["keys"]["claims"]["broken"]


def line(row):
    text = f"{row['app']:<14}{row['xnodes']:>7}"
    if "why" in row:
        return f"{text}  {row['why']}"
    for policy in ("fixed", "keys"):
        r = row[policy]
        longest = "-" if r["longest_to_worst_case"] is None else f"{r['longest_to_worst_case']:.3f}"
        text += f"  {r['activations']:>11}{r['lost']:>6}{r['above_by_2_pct']:>5} of {r['measured']:<3}{longest:>7}"
    return text + "  " + ("; ".join(row["assumptions_broken"]) or "kept")


def main():
    options = parse()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        names = []
        for first in range(options.first, options.first + 1000, 100):
            if len(names) >= options.apps:
                break
            subprocess.run([os.path.join(options.build, "bench/bench_keys"), "--first", str(first), "--only",
                            ",".join(KINDS), "--write", folder], check=True)
            names = sorted((p.name[:-len(".app.json")] for p in pathlib.Path(folder).glob("*.app.json")),
                           key=lambda n: (int(n.split("-")[1]), n))
        print(f"{'':<21}  {'fixed priorities':<36}  {'keys':<36}\n{'app':<14}{'XNodes':>7}" +
              2 * f"  {'activations':>11}{'lost':>6}{'> 1.02 wc':>12}{'max/wc':>7}" + "  assumptions", flush=True)
        with concurrent.futures.ThreadPoolExecutor(options.at_once) as pool:
            todo = [App(folder, number, name, options) for number, name in enumerate(names[:options.apps])
                    if not options.only or name in options.only.split(",")]
            for begin in range(0, len(todo), options.at_once):  # in step, so that nobody solves while another one runs
                apps = todo[begin:begin + options.at_once]
                list(pool.map(App.solve, apps))
                if options.guest:
                    list(pool.map(App.run_in_guest, apps))
                else:
                    for policy in ("fixed", "keys"):
                        list(pool.map(lambda app: app.run(policy), apps))
                for app in apps:
                    app.account()
                    rows.append(app.row)
                    print(line(app.row), flush=True)
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
