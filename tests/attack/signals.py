#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Random signals to random processes of runs, at random instants: signals.py BIN [--signals N] [--seed S].

A run is asked for nothing but what a user sees of it from outside: it ends when it is told to, nothing of it is left (a
process, a socket's name, shared memory), what it writes is whole JSON that does not contradict itself, and a claim that
it calls kept was not of a run whose coordinator, emulator or module died or stood still. Shares no code with lib/.
The last line is a count, as scripts/check.sh reads it: a run is a test."""
import argparse
import json
import os
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import time

HARD = [signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS]
SOFT = [signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGPIPE, signal.SIGUSR1, signal.SIGALRM, signal.SIGCHLD]
ENDS_WITHIN_S = 60  # a machine that stands still, and a watchdog of 4 s per process that hangs


def processes():
    """{pid: (parent, command)} of all that are no zombies."""
    found = {}
    for entry in filter(str.isdigit, os.listdir("/proc")):
        try:
            stat = pathlib.Path(f"/proc/{entry}/stat").read_text()
        except OSError:
            continue
        name, rest = stat[stat.index("(") + 1:stat.rindex(")")], stat[stat.rindex(")") + 2:].split()
        if rest[0] != "Z":
            found[int(entry)] = (int(rest[1]), name)
    return found


def family(pid):
    now, found = processes(), {}
    if pid not in now:
        return {}
    front = [pid]
    while front:
        at = front.pop()
        found[at] = now[at][1]
        front += [child for child, (parent, _) in now.items() if parent == at and child not in found]
    return found


class Runs:
    """The runs that are attacked, each a command; files are made once."""

    def __init__(self, bin_folder, folder):
        self.bin, self.folder = bin_folder, folder
        self.xauto = str(bin_folder / "xauto")
        xnodes = [("a1", "A", "cpu"), ("a2", "A", "npu"), ("b1", "B", "npu"), ("c1", "C", "cpu"), ("d1", "D", "cpu")]
        self.write("platform.json", {"schema": "xauto.platform", "version": 1, "name": "test", "xpus": [
            {"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 0},
            {"id": "npu0", "type": "npu", "preemptive": True, "preempt_us": 100, "timeslice_us": 500}]})
        self.write("app.json", {"schema": "xauto.app", "version": 3, "name": "testapp", "sources": [{"name": "src", "period_us": 20000}],
                                "xnodes": [{"name": n, "module": m, "wcet_us": {x: 6000}} | ({"source": "src"} if n in ("a1", "b1", "d1") else {})
                                           for n, m, x in xnodes],
                                "edges": [["a1", "a2"], ["a2", "c1"], ["b1", "c1"]]})
        source = pathlib.Path(__file__).resolve().parents[2]
        self.rates = str(source / "examples/driving/rates.json")
        self.solve("app.json", "platform.json", "policy.json")
        self.solve(self.rates, "small", "keys.json")

    def write(self, name, content):
        (self.folder / name).write_text(json.dumps(content))

    def path(self, name):
        return str(self.folder / name)

    def solve(self, app, platform, out):
        done = subprocess.run([self.xauto, "solve", "--app", self.path(app), "--platform",
                               self.path(platform) if platform.endswith(".json") else platform, "--time-limit", "3s",
                               "--out", self.path(out)], capture_output=True, text=True)
        assert os.path.exists(self.path(out)), done.stderr

    def command(self, rng):
        """(name, command)."""
        kind = rng.choice(["one process", "isolated", "keys", "keys isolated", "profile"])
        flags = ["--isolate"] if "isolated" in kind else []
        if kind == "profile":
            return kind, [self.xauto, "profile", "--platform", self.path("platform.json"), "--json", "--repetitions", "30", "--app-out",
                          self.path("profiled.json"), "--", str(self.bin / "testapp"), self.path("result"), "emulated", "1000"]
        if "keys" in kind:
            app = ["--app", self.rates, "--policy", self.path("keys.json"), "--platform", "small", "--emulate"]
            program = [str(self.bin / "driving-rates")]
        else:
            app = ["--app", self.path("app.json"), "--policy", self.path("policy.json"), "--platform", self.path("platform.json"), "--emulate"]
            program = [str(self.bin / "testapp"), self.path("result"), "period", "20000", "emulated", "1500"]
        return kind, [self.xauto, "run", *app, "--json", "--activations", "0", *flags, "--", *program]


def attack(runs, rng, wanted):
    """One run; the complaints about it, and how many signals it got."""
    kind, command = runs.command(rng)
    memory = {name for name in os.listdir("/dev/shm") if "xauto" in name and "fuzz" not in name}
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        tool = subprocess.Popen(command, stdout=out, stderr=err, start_new_session=True)
        seen, sent, said, stopped = {}, 0, [], set()
        time.sleep(rng.uniform(0, 1.5))
        for _ in range(wanted):
            now = family(tool.pid)
            if tool.poll() is not None or not now:
                break
            seen.update(now)
            # Rarely the tool itself, since that ends the run.
            others = [pid for pid in now if pid != tool.pid] or [tool.pid]
            victim = tool.pid if rng.random() < 0.03 else rng.choice(others)
            number = rng.choice(HARD if rng.random() < 0.4 else SOFT)
            try:
                if rng.random() < 0.3:
                    os.kill(victim, signal.SIGSTOP)
                    stopped.add(victim)
                    said.append(f"STOP {seen[victim]}")
                    time.sleep(rng.choice([0.02, 0.3, 3.0]))
                    os.kill(victim, signal.SIGCONT)
                    sent += 2
                else:
                    os.kill(victim, number)
                    said.append(f"{number.name} {seen[victim]}")
                    sent += 1
            except ProcessLookupError:
                pass
            time.sleep(rng.choice([0, 0.01, 0.05, 0.3]))
        seen.update(family(tool.pid))
        bad = []
        if tool.poll() is None:
            tool.send_signal(signal.SIGTERM)
        try:
            tool.wait(timeout=ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            bad.append(f"did not end within {ENDS_WITHIN_S} s of SIGTERM: {family(tool.pid)}")
            os.killpg(tool.pid, signal.SIGKILL)
            tool.wait()
        bad += left(tool.pid, seen, memory)
        out.seek(0)
        err.seek(0)
        bad += judged(kind, out.read(), said, tool.returncode)
        if bad:
            bad.append("stderr ends: " + err.read()[-1500:])
        return [f"{kind}: after {', '.join(said)}: {line}" for line in bad], sent


def left(pid, seen, memory):
    until = time.monotonic() + 30
    while (alive := {p: n for p, n in seen.items() if p in processes()}) and time.monotonic() < until:
        time.sleep(0.05)
    bad = [f"still there: {alive}"] if alive else []
    while f"@xauto/{pid}-" in (names := pathlib.Path("/proc/net/unix").read_text()) and time.monotonic() < until:
        time.sleep(0.05)
    if f"@xauto/{pid}-" in names:
        bad.append("a socket's name is still there")
    more = {name for name in os.listdir("/dev/shm") if "xauto" in name and "fuzz" not in name} - memory
    return bad + ([f"shared memory is left: {more}"] if more else [])


def judged(kind, text, said, status):
    """What the report says of itself."""
    if not text.strip():
        return [] if status != 0 else ["status 0 without a report"]
    try:
        report = json.loads(text)
    except ValueError as error:
        return [f"its JSON is broken: {error}"]
    bad = []
    for run in report.get("runs", []):
        hurt = [s for s in said if s.split()[0] in ("SIGKILL", "SIGSEGV", "SIGABRT", "SIGBUS") and not s.endswith(" xauto")]
        claimed = run.get("worst_case_us") is not None or any(c.get("worst_case_us") is not None for c in run.get("chains", []))
        broken = run["claims"]["broken"]
        if hurt and claimed and run.get("complete", True) and broken in (None, [], False, ""):
            bad.append(f"claims stand although there was {hurt}")
        for module in run.get("modules", []):
            if min(module["activations"], module["failed"], module["dropped"]) < 0:
                bad.append(f"a count below 0: {module}")
    return bad


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("--signals", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng, sent, number, failed = random.Random(options.seed), 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        runs = Runs(options.bin.resolve(), pathlib.Path(folder))
        while sent < options.signals:
            bad, more = attack(runs, rng, rng.randint(1, 14))
            sent, number, failed = sent + more, number + 1, failed + bool(bad)
            for line in bad:
                print(f"signals: run {number}: {line}", flush=True)
    print(f"signals: {sent} signals in {number} runs")
    print(f"{number - failed} passed, {failed} failed, 0 skipped")
    return failed != 0


if __name__ == "__main__":
    sys.exit(main())
