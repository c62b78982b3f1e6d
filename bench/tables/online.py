#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What tables do while the Driving Case runs on emulated XPUs. Parts, each a number of docs/modes.md:

    throttle    the GPU falls to half of its clock: one policy and tables in turn, several rounds; and how long it takes
                from the moment when the first job passes its WCET to the first release that has another table; and how
                many releases miss a deadline that tables can keep at half of the clock
    switches    people ask for another scenario again and again: lost releases, and those longer than their worst case
    deaths      the same in processes of their own, one of which is killed at a random moment around each wish; whether
                each job ran where its release's table has it, and whether anything stays suspended
    violations  clocks and a mode of no scenario, a job longer than every scenario has it: how long until it is said

One more is in a guest that keeps time (bench/guest.py, 1 ns an instruction), and runs when it is named:

    guest-switches a file's text names the scenario, and changes again and again; WCETs are what jobs take

Four more are of tables of keys, with the case's three rates by one clock; they run when they are named:

    key-switches   as `switches`, but a wish comes when the change before has settled: else it waits, and nothing is claimed
    key-clocks     the same with the LiDAR's own clock, each clock on XPUs of its own
    key-drains     the same with a slower GPU, so that the clocks share XPUs, and changes drain
    key-deaths     as `deaths`

    bench/tables/online.py [--bin build/bin] [--json FILE] [throttle switches deaths violations guest-switches key-switches key-clocks key-drains key-deaths]
"""
import argparse
import bisect
import contextlib
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
APP = SOURCE / "examples/driving/app.json"
RATES = SOURCE / "examples/driving/rates.json"
QUEUES = {"queue_depth": 256, "keep": 256, "defaults": {"overload": "queue:256"}}
DEADLINE_PCT = 106  # of the worst case: XAuto and the emulator take 3 % of a release themselves
STALL_NS = 1_000_000  # kEmulatorStallUs: such a job shows no other clock
MARGIN_PCT = 115
KEY_MARGIN_PCT = 130
DEATHS_OF_A_DAEMON = 90  # after 100 the tool gives it up


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", default=["throttle", "switches", "deaths", "violations"])
    parser.add_argument("--bin", default=str(SOURCE / "build/bin"))
    parser.add_argument("--rounds", type=int, default=5, help="of throttle")
    parser.add_argument("--releases", type=int, default=300, help="of each run of throttle")
    parser.add_argument("--switches", type=int, default=1000)
    parser.add_argument("--deaths", type=int, default=200)
    parser.add_argument("--violations", type=int, default=100, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", help="write what was measured here, too")
    return parser.parse_args()


class Case:
    """The files of one app, and runs of it."""

    def __init__(self, folder, options, part):
        keys, clocks = part.startswith("key-"), part in ("key-clocks", "key-drains")
        self.folder, self.options = pathlib.Path(folder), options
        self.app = json.loads((RATES if keys else APP).read_text())
        self.program = "/driving-rates" if keys else "/driving"
        os.environ["DRIVING_TIMES"] = "worst"
        self.part, self.own_rates, self.own_clocks = part, keys, clocks
        if not clocks:
            for source in self.app.get("sources", []):
                source.pop("clock", None)
            self.app.pop("clocks", None)
        self.write("app.json", self.app)
        self.deploy()

    def write(self, name, value):
        (self.folder / name).write_text(json.dumps(value))

    def deploy(self, **keys):
        defaults = {**QUEUES["defaults"], **keys.pop("defaults", {})}
        self.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": self.app["name"], **QUEUES,
                                       "defaults": defaults, **keys})

    def with_margin(self, pct):
        """As `xauto profile` has one: what the emulator adds to a job is no overrun."""
        for xnode in self.app["xnodes"]:
            xnode["wcet_us"] = {kind: us * pct // 100 for kind, us in xnode["wcet_us"].items()}
        self.write("app.json", self.app)

    def script(self, *steps):
        self.write("script.json", {"schema": "xauto.emulation", "version": 1, "steps": list(steps)})

    def xauto(self, *words):
        done = subprocess.run([self.options.bin + "/xauto", *map(str, words)], cwd=self.folder, capture_output=True, text=True)
        # 1: a change may miss a deadline, and the tables are written all the same.
        may_miss = words[0] == "solve" and (self.own_rates or self.part == "throttle")
        if done.returncode != 0 and not (may_miss and done.returncode == 1):
            raise RuntimeError(f"xauto {' '.join(map(str, words))}: status {done.returncode}\n{done.stdout}{done.stderr}")
        return done.stdout

    def solve(self, out, scenarios=None, tables=2, seconds=10):
        more = ()
        if scenarios:
            self.write("scenarios.json", {"schema": "xauto.scenarios", "version": 1, "app": self.app["name"], "scenarios": scenarios})
            more = ("--scenarios", "scenarios.json", "--tables", tables)
        self.xauto("solve", "--app", "app.json", "--platform", "small", "--time-limit", f"{seconds}s", "--out", out, *more)

    def command(self, policy, *flags):
        return [self.options.bin + "/xauto", "run", "--app", "app.json", "--platform", "small", "--emulate", "--policy", policy,
                "--deployment", "deployment.json", "--json", *map(str, flags), "--", self.options.bin + self.program]

    def run(self, *arguments):
        done = subprocess.run(self.command(*arguments), cwd=self.folder, capture_output=True, text=True)
        return json.loads(done.stdout)["runs"][0]

    @contextlib.contextmanager
    def running(self, *arguments):
        """A run without an end; `report` has what it says then."""
        self.report = None
        with open(self.folder / "out", "w") as out, open(self.folder / "err", "w") as err:
            self.tool = subprocess.Popen(self.command(*arguments, "--activations", 0), cwd=self.folder, stdout=out, stderr=err)
        try:
            self.wait(lambda: self.board()["releases"] > 2)
            yield
            self.tool.send_signal(signal.SIGTERM)
            self.tool.wait(timeout=120)
            self.report = json.loads((self.folder / "out").read_text())["runs"][0]
        finally:
            self.tool.kill()
            self.tool.wait()

    def said(self):
        return (self.folder / "err").read_text()

    def board(self):
        return json.loads(self.xauto("top", "--run", f"{self.tool.pid}-0", "--wait", "10s", "--interval", "50ms", "--once", "--json"))["runs"][0]

    def mode(self, *words):
        return json.loads(self.xauto("param", "scenario" if words else "list", "--run", f"{self.tool.pid}-0", "--wait", "10s", "--json", *words))

    def wait(self, probe, seconds=60):
        """How long it took; None: it did not come to that."""
        since = time.monotonic()
        while not probe():
            if time.monotonic() - since > seconds or self.tool.poll() is not None:
                return None
            time.sleep(0.002)
        return time.monotonic() - since


def quantile(values, q):
    values = sorted(values)
    return values[min(len(values) - 1, int(q * len(values)))]


SLOWER = [{"name": "nominal"}, {"name": "GPU at half", "wcet_scale_pct": {"gpu": 200}}]


def reaction(case, report):
    """From the moment when a job first was longer than its WCET to the next release with another table, in periods."""
    import pftrace
    trace = pftrace.Trace((case.folder / "t.pftrace").read_bytes())
    wcet = {x["name"]: x["wcet_us"] for x in case.app["xnodes"]}
    came = {s.args["release"]: s.begin for s in trace.slices if s.category == "release"}
    change = next((s for s in report["switches"] if s["to"] == SLOWER[1]["name"]), None)
    parts = {}
    for s in trace.slices:
        if s.category == "run" and s.track.startswith("run/gpu"):
            parts.setdefault((s.name.split(" ")[0], s.args["release"]), []).append(s)
    passed = []
    for (name, _), slices in parts.items():
        limit = wcet[name]["gpu"] * 1020 + 100_000 + STALL_NS
        if len(slices) == 1 and slices[0].end - slices[0].begin > limit:  # nobody took the XPU from it
            passed.append(slices[0].begin + limit)
    if change is None or not passed or change["release"] not in came:
        return None
    return came[change["release"]] - min(passed), change["held_us"] * 1000


def misses(case, report):
    """Releases that were longer than the deadline: those that met a change of tables, and others."""
    import pftrace
    trace = pftrace.Trace((case.folder / "t.pftrace").read_bytes())
    missed = {s.args["release"] for s in trace.slices if s.category == "release" and s.args.get("deadline") == "missed"}
    if len(missed) != report["deadline_misses"]:
        raise RuntimeError(f"the trace has {len(missed)} missed deadlines, and the report {report['deadline_misses']}")
    met = missed & {s["release"] - 1 for s in report.get("switches", [])}
    return {"met_a_change": len(met), "others": len(missed - met)}


def throttle(case, options):
    period_us = 66_000
    case.app.pop("deadline_us", None)
    case.write("app.json", case.app)
    case.solve("two.json", SLOWER)
    serves = json.loads((case.folder / "two.json").read_text())["serves"]
    half_us = next(s["worst_case_us"] for s in serves if s["scenario"] == SLOWER[1]["name"])
    case.app["deadline_us"] = half_us * DEADLINE_PCT // 100
    case.write("app.json", case.app)
    case.solve("one.json")
    case.solve("two.json", SLOWER)
    case.script({"at_us": 1_000_000, "speed_pct": {"gpu": 50}})
    rows, reactions, missed = {"one": [], "two": []}, [], {"one": [], "two": []}
    for _ in range(options.rounds):
        for policy in rows:
            report = case.run(f"{policy}.json", "--emulate-script", "script.json", "--period", f"{period_us}us", "--activations",
                              options.releases, "--trace-out", "t.pftrace")
            rows[policy].append(report)
            missed[policy].append(misses(case, report))
            if policy == "two" and (took := reaction(case, report)):
                reactions.append(took)
    result = {"rounds": options.rounds, "releases": options.releases, "period_us": period_us}
    for policy, reports in rows.items():
        result[policy] = {key: [r[key] for r in reports] for key in ("p50_us", "p99_us", "max_us", "lost_activations")}
    for key in ("p50_us", "p99_us", "max_us"):
        medians = [statistics.median(result[policy][key]) for policy in rows]
        result[key] = {"one": medians[0], "two": medians[1], "ratio": round(medians[0] / medians[1], 3)}
        print(f"  throttle  {key[:-3]:4} one policy {medians[0] / 1000:7.2f} ms   tables {medians[1] / 1000:7.2f} ms"
              f"   {medians[0] / medians[1]:.2f} times; medians of {options.rounds} runs of {options.releases} releases each")
    result["deadline_us"], result["missed"] = case.app["deadline_us"], missed
    result["broken"] = {policy: [r["claims"]["broken"] for r in reports] for policy, reports in rows.items()}
    for policy, name in (("one", "one policy"), ("two", "tables")):
        others, met = (sum(m[kind] for m in missed[policy]) for kind in ("others", "met_a_change"))
        print(f"  throttle  deadline {case.app['deadline_us'] / 1000:.2f} ms, missed by {name}: {others}, and {met} that met a change, of "
              f"{options.rounds * options.releases}")
    result["reactions_ns"] = reactions
    late = [took - held - period_us * 1000 for took, held in reactions]
    result["later_than_period_and_delay"] = sum(ns > 0 for ns in late)
    print(f"  throttle  reaction: {len(reactions)} seen, longest {max((t for t, _ in reactions), default=0) / 1e6:.1f} ms, "
          f"{result['later_than_period_and_delay']} later than a period and what the sensors waited")
    return result


def switches(case, options):
    case.with_margin(MARGIN_PCT)  # all scenarios fit into the period
    case.solve("three.json", [{"name": "nominal"}, {"name": "GPU 8 % slower", "wcet_scale_pct": {"gpu": 108}},
                              {"name": "DLA 30 % slower", "wcet_scale_pct": {"dla": 130}},
                              {"name": "CPUs 50 % slower", "wcet_scale_pct": {"cpu": 150}}], 3)
    draw = random.Random(options.seed)
    names = [s["name"] for s in json.loads((case.folder / "scenarios.json").read_text())["scenarios"]]
    asked = names[0]
    with case.running("three.json", "--period", "33333us"):
        since = time.monotonic()
        for _ in range(options.switches):
            asked = draw.choice([n for n in names if n != asked])
            case.mode(asked)
            # Two releases are on their way before the next wish.
            time.sleep(draw.uniform(0.0, 0.07))
        seconds = time.monotonic() - since
    report = case.report
    claimed = [s for s in report["switches"] if s.get("worst_case_us") and (s["spanned_us"] or -1) >= 0]
    over = [s for s in claimed if s["spanned_us"] > 1.02 * s["worst_case_us"]]
    result = {"asked": options.switches, "seconds": round(seconds, 1), "switches": report["num_switches"],
              "told": len(report["switches"]), "table_changes": tables_changed(report["switches"]), "releases": report["activations"], "lost": report["lost_activations"],
              "claimed": len(claimed), "longer_than_claimed_by_2_pct": len(over),
              "longest": max((s["spanned_us"] / s["worst_case_us"] for s in claimed), default=None),
              "longest_wait_us": max((s["held_us"] for s in report["switches"]), default=None),
              "broken": report["claims"]["broken"]}
    print(f"  switches  {result['switches']} ({result['table_changes']} to another table) in {seconds:.0f} s, {result['releases']} releases, {result['lost']} lost; of "
          f"{len(claimed)} that met a change {len(over)} were longer than claimed + 2 %")
    return result


def guest_switches(case, options):
    sys.path.insert(0, str(SOURCE / "bench"))
    import guest
    def when(text):
        return [{"file": "/case/mode", "equals": text}]
    case.solve("three.json", [{"name": "nominal", "when": when("A")},
                              {"name": "GPU 8 % slower", "when": when("B"), "wcet_scale_pct": {"gpu": 108}},
                              {"name": "DLA 30 % slower", "when": when("C"), "wcet_scale_pct": {"dla": 130}},
                              {"name": "CPUs 50 % slower", "when": when("D"), "wcet_scale_pct": {"cpu": 150}}], 3)
    draw, now, script = random.Random(options.seed), "A", [
        "printf A >mode", "xauto run --app app.json --platform small --emulate --policy three.json --deployment deployment.json "
        "--json --period 33333us --activations 0 -- ./driving >report &", "tool=$!", "sleep 3"]
    for _ in range(options.switches * 3 // 2):  # some come before the one before is heard
        now = draw.choice([mode for mode in "ABCD" if mode != now])
        script += [f"printf {now} 1<>mode", f"sleep {draw.uniform(0.03, 0.12):.3f}"]  # never empty
    script += ["kill -TERM $tool", "wait $tool", "cat report"]
    (case.folder / "switches").write_text("\n".join(script) + "\n")
    files = {name: case.folder / name for name in ("app.json", "three.json", "deployment.json", "switches")}
    build = pathlib.Path(options.bin).parent
    done = guest.run(build, {**files, "driving": build / "bin/driving"}, [["sh", "switches"]], icount=0)[0]
    if done.returncode != 0:
        raise RuntimeError(f"in the guest: status {done.returncode}\n{done.stdout[-500:]}{done.stderr[-500:]}")
    report = json.loads(done.stdout)["runs"][0]
    spanned = [s["spanned_us"] / s["worst_case_us"] for s in report["switches"] if s.get("worst_case_us") and (s["spanned_us"] or -1) >= 0]
    result = {"switches": report["num_switches"], "table_changes": tables_changed(report["switches"]), "releases": report["activations"],
              "lost": report["lost_activations"], "claimed": len(spanned), "longest": max(spanned, default=None),
              "exceeded": report["claims"]["exceeded"], "broken": report["claims"]["broken"]}
    print(f"  guest-switches  {result['switches']} ({result['table_changes']} to another table), {result['releases']} releases, {result['lost']} lost; "
          f"of {len(spanned)} that met a change the longest took {result['longest']:.4f} of its worst case; longer than claimed: {result['exceeded']}")
    return result


def key_switches(case, options):
    """Each result of a chain is held against its table's worst case, or that of the change which its release met, by the run.
    Here only what the run tells is counted, and the longest result of each chain set beside the largest of its claims."""
    case.with_margin(KEY_MARGIN_PCT)
    # On a slow GPU the two clocks do not fit without each other's XPUs; with margin and at half of its clock not even so.
    gpu_pct = {"key-switches": 200, "key-clocks": None, "key-drains": 150}[case.part]
    scenarios = [{"name": "nominal"}, {"name": "CPUs slow", "wcet_scale_pct": {"cpu": 130}}]
    if gpu_pct:
        scenarios.insert(1, {"name": "GPU slow", "wcet_scale_pct": {"gpu": gpu_pct}})
    names = [s["name"] for s in scenarios]
    case.solve("keys.json", scenarios, len(scenarios), 10)
    tables = json.loads((case.folder / "keys.json").read_text())
    drains = case.part == "key-drains"
    settles_s = 1 if drains else max(h["settles_us"] for h in tables["handovers"]) / 1e6
    shared = shared_by_clocks(tables) if case.own_clocks else []
    if drains != bool(shared):
        raise RuntimeError(f"the clocks share {' '.join(shared) or 'nothing'}")
    draw, asked = random.Random(options.seed), names[0]
    with case.running("keys.json"):
        since = time.monotonic()
        for _ in range(options.switches):
            asked = draw.choice([n for n in names if n != asked])
            case.mode(asked)
            time.sleep(settles_s + draw.uniform(0.05, 0.1))  # the release that meets it comes at most 33 ms later
        seconds = time.monotonic() - since
    report = case.report
    chains = {c["name"]: {"results": c["results"], "lost": c["lost"], "max_us": c["latency_us"]["max"],
                          "worst_case_us": c.get("worst_case_us"), "longer_than_claimed": c.get("longer_than_claimed", 0)}
              for c in report["chains"]}
    result = {"asked": options.switches, "seconds": round(seconds, 1), "settles_s": settles_s, "held_us": max((s["held_us"] for s in report["switches"]), default=0), "switches": report["num_switches"],
              "table_changes": tables_changed(report["switches"]), "why": sorted({s["why"] for s in report["switches"]}),
              "activations": report["activations"], "lost": report["lost_activations"], "chains": chains,
              "broken": report["claims"]["broken"], "claims": report["claims"].get("of")}
    part = case.part
    print(f"  {part:12}  {result['switches']} in {seconds:.0f} s, {result['lost']} activations lost")
    for name, c in chains.items():
        longest = f"longest {c['max_us'] / 1000:.2f} ms" if c["results"] else "none to measure"
        claim = f"largest claim {c['worst_case_us'] / 1000:.2f} ms" if c["worst_case_us"] else "nothing is claimed"
        print(f"  {part:12}  {name:8} {c['results']} results, {c.get('longer_than_claimed', 0)} longer than claimed; {longest}, {claim}")
    return result


def shared_by_clocks(tables):
    """XPUs of both of rates.json's clocks, in one table or in several."""
    users = {}
    for table in tables["tables"]:
        for xnode in table["xnodes"]:
            users.setdefault(xnode["xpu"], set()).add(xnode["name"].startswith("ld."))  # the LiDAR's
    return sorted(xpu for xpu, kinds in users.items() if len(kinds) > 1)


def tables_changed(changes):
    return sum(a["table"] != b["table"] for a, b in zip(changes, changes[1:]))


def suspended(case):
    """(XPU, XNode, its job) of all that are; and how many coordinators told."""
    runs = json.loads(case.xauto("top", "--once", "--json", "--interval", "50ms"))["runs"]
    xpus = [xpu for run in runs if run["run"] == f"{case.tool.pid}-0" for xpu in run["xpus"]]
    return {(xpu["xpu"], w["xnode"], w["job"]) for xpu in xpus for w in xpu["workers"] if w["state"] == "suspended"}, len(xpus)


def stay_suspended(case):
    """What is suspended for longer than three periods; and the fewest coordinators that told."""
    always, fewest = None, None
    for look in range(3):
        if look:
            time.sleep(0.12)
        now, told = suspended(case)
        always = now if always is None else always & now
        fewest = told if fewest is None else min(fewest, told)
    return always, fewest


def elsewhere(case, report, policy):
    """By the trace: jobs in all, and those on another XPU than their release's table has them on."""
    import pftrace
    tables = json.loads((case.folder / policy).read_text())
    xpu_of = {t["name"]: {x["name"]: x["xpu"] for x in t["xnodes"]} for t in tables["tables"]}
    changes = sorted((s["release"], s["table"]) for s in report["switches"])
    if len(changes) != report["num_switches"] or report["trace_events_overwritten"] > 0:
        raise RuntimeError(f"the report tells {len(changes)} of {report['num_switches']} changes; the trace lacks "
                           f"{report['trace_events_overwritten']} events")
    jobs, wrong = set(), []
    for s in pftrace.Trace((case.folder / "t.pftrace").read_bytes()).slices:
        if s.category != "run":
            continue
        job = (s.name.split(" ")[0], s.args["release"])
        at = bisect.bisect_right(changes, job[1], key=lambda change: change[0])
        table = changes[at - 1][1] if at else tables["serves"][0]["table"]
        jobs.add(job)
        if s.track != "run/" + xpu_of[table][job[0]]:
            wrong.append((*job, s.track, table))
    return len(jobs), wrong


def deaths(case, options):
    from common import children_of
    case.deploy(defaults={"isolate": True, "restarts": 1_000_000})
    period = () if case.own_rates else ("--period", "66ms", "--trace-out", "t.pftrace", "--trace-keep", "1h")
    case.solve("three.json", [*SLOWER, {"name": "no DLA", "lost": ["dla0"]}], 3)
    draw = random.Random(options.seed)
    names = [s["name"] for s in json.loads((case.folder / "scenarios.json").read_text())["scenarios"]]
    covering = {names[0]: names, names[1]: [names[1]], names[2]: [names[2]]}
    asked, killed, hung, wrong, waits, stuck, told = names[0], {}, 0, 0, [], [], []
    with case.running("three.json", *period):
        while sum(killed.values()) < options.deaths and case.tool.poll() is None:
            family = {pid: name for pid, name in children_of(case.tool.pid).items()
                      if name.startswith("m:") or killed.get(name, 0) < DEATHS_OF_A_DAEMON and
                      name.startswith(("xauto-coordinat", "xauto-emud"))}
            pid = draw.choice(sorted(family))
            asked = draw.choice([n for n in names if n != asked])
            wish = subprocess.Popen([options.bin + "/xauto", "param", "scenario", "--run", f"{case.tool.pid}-0", "--wait", "10s", asked],
                                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            time.sleep(draw.uniform(0.0, 0.12))  # a process needs some ms to say it; a drain lasts a release
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
                killed[family[pid]] = killed.get(family[pid], 0) + 1
            wish.wait()
            before = case.board()
            settled = {m["name"]: m["activations"] for m in before["modules"]}

            def goes_on():
                now = {m["name"]: m["activations"] for m in case.board()["modules"]}
                return all(now[name] > count + 2 for name, count in settled.items())
            took = case.wait(goes_on, 30)
            if took is None:
                hung += 1
                break
            waits.append((took, family[pid]))
            wrong += case.mode()["now"] not in covering[asked]
            left, coordinators = stay_suspended(case)
            stuck += sorted(left)
            told.append(coordinators)
    report = case.report
    jobs, other = elsewhere(case, report, "three.json") if report and not case.own_rates else (0, [])
    result = {"deaths": sum(killed.values()), "by_name": killed, "hung": hung, "another_scenario_than_asked": wrong,
              "stay_suspended": stuck, "fewest_coordinators_that_told": min(told, default=None),
              "table_changes": tables_changed(report["switches"]) if report else None,
              "activations": report["activations"] if report else None, "lost": report["lost_activations"] if report else None,
              "trace_events_lost": report["trace_events_lost"] if report else None, "traced_jobs": jobs, "jobs_on_another_xpu": other,
              "longest_until_all_modules_go_on_s": round(max(waits, default=(0, ""))[0], 2),
              "median_s": round(statistics.median(took for took, _ in waits), 2) if waits else None,
              "slowest": [(round(took, 2), name) for took, name in sorted(waits)[-10:]],
              "switches": report["num_switches"] if report else None, "notes": report["notes"][:3] if report else None}
    print(f"  deaths{' (keys)' if case.own_rates else ''}    {result['deaths']}, {hung} hung, {wrong} times another scenario than asked for; all modules had three more "
          f"results after {result['median_s']} s (median), {result['longest_until_all_modules_go_on_s']} s at most; {len(stuck)} jobs stay "
          "suspended" + ("" if case.own_rates else f"; {len(other)} of {jobs} ran on another XPU than their release's table has them on"))
    return result


def violations(case, options):
    """Of each kind so many, each in a run of its own, so that it is the first that the run says. From the injection to the words,
    on stderr, as this process finds them there, in periods of the releases:
    clock   a file's number, written by a program, which inotify shows
    kernel  the same behind a link, whose writes inotify does not show, as the kernel's own files: it is read by the clock
    mode    a file that says another word than any scenario has
    job     a GPU slower than any scenario has it, from the moment when a job was longer than every scenario allows"""
    clock, linked, mode = (case.folder / name for name in ("cur_freq", "linked", "mode"))
    (case.folder / "kernel").mkdir()
    linked.symlink_to(case.folder / "kernel/cur_freq")
    fine = {clock: "900\n", linked: "900\n", mode: "MAXN\n"}
    for file, text in fine.items():
        file.write_text(text)
    # Room for what this machine's stalls make longer: the GPU at 30 % is what is looked for.
    for xnode in case.app["xnodes"]:
        xnode["wcet_us"] = {kind: us * (3 if kind == "gpu" else 20) // 2 for kind, us in xnode["wcet_us"].items()}
    case.app.pop("deadline_us", None)
    case.write("app.json", case.app)
    common = [{"file": str(mode), "equals": "MAXN"}]
    case.solve("watched.json", [{"name": "fast", "when": [*common, *({"file": str(f), "at_least": 900} for f in (clock, linked))]},
                                {"name": "slow", "wcet_scale_pct": {"gpu": 150},
                                 "when": [*common, *({"file": str(f), "at_least": 600} for f in (clock, linked))]}])
    period_s = 1 / 30
    clocks_say = "are those of no scenario"
    kinds = {"clock": (clock, "100\n", clocks_say), "kernel": (linked, "100\n", clocks_say), "mode": (mode, "15W\n", clocks_say),
             "job": (None, None, "outside of every scenario: XNode")}
    took, heard_of = {kind: [] for kind in kinds}, dict.fromkeys(kinds, 0)
    draw = random.Random(options.seed)
    for _ in range(options.violations):
        for kind, (file, text, words) in kinds.items():
            for each, good in fine.items():
                each.write_text(good)
            case.script({"at_us": 700_000 if file is None else 3_600_000_000, "speed_pct": {"gpu": 30}})
            with case.running("watched.json", "--period", f"{int(period_s * 1e6)}us", "--emulate-script", "script.json", "--trace-out",
                              "t.pftrace"):
                time.sleep(draw.uniform(0, period_s))
                at = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
                if file is not None:
                    file.write_text(text)
                heard = case.wait(lambda words=words: words in case.said(), 10)
                said = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
            if file is None and heard is not None:
                at = passed_at(case)
            heard_of[kind] += heard is not None
            # Said before: by another job, one that this machine's stall made longer.
            if heard is not None and at is not None and said >= at:
                took[kind].append((said - at) / 1e9)
    result = {"period_s": round(period_s, 4)}
    for kind, times in took.items():
        row = result[kind] = {"injected": options.violations, "said": heard_of[kind], "timed": len(times),
                              "median_s": statistics.median(times) if times else None, "longest_s": max(times, default=None),
                              "within_a_period": sum(t <= period_s for t in times)}
        timed = (f"of {len(times)} timed: median {row['median_s'] * 1000:.1f} ms, longest {row['longest_s'] * 1000:.1f} ms, "
                 f"{row['within_a_period']} within a period of {period_s * 1000:.1f} ms") if times else "none timed"
        print(f"  violations by {kind:6} {row['injected']} injected, {row['said']} said; {timed}")
    return result


def passed_at(case):
    """When a GPU job first had had its XPU for longer than every scenario has it, by the trace's clock; None: none had."""
    import pftrace
    trace = pftrace.Trace((case.folder / "t.pftrace").read_bytes())
    wcet = {x["name"]: x["wcet_us"] for x in case.app["xnodes"]}
    had, passed = {}, []
    for s in sorted((s for s in trace.slices if s.category == "run" and s.track.startswith("run/gpu")), key=lambda s: s.begin):
        job = (s.name.split(" ")[0], s.args["release"])
        limit = wcet[job[0]]["gpu"] * 1530 + 100_000 + STALL_NS
        before = had.get(job, 0)
        had[job] = before + s.end - s.begin
        if before <= limit < had[job]:
            passed.append(s.begin + limit - before)
    return min(passed, default=None)


def main():
    options = parse()
    os.environ["XAUTO_BIN"] = options.bin
    parts = {"throttle": throttle, "switches": switches, "deaths": deaths, "violations": violations,
             "guest-switches": guest_switches, "key-switches": key_switches, "key-clocks": key_switches, "key-drains": key_switches, "key-deaths": deaths}
    result = {}
    for part in options.parts:
        with tempfile.TemporaryDirectory() as folder:
            result[part] = parts[part](Case(folder, options, part), options)
            if options.json:
                pathlib.Path(options.json).write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
