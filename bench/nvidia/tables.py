#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tables on a GPU of NVIDIA's RM driver (no Jetson) that somebody else uses, too: tables.cc, planned from profiles with
and without a program that computes on the GPU all the time.

    wishes    people ask for the other scenario again and again, nobody else is there
    load      that program comes and goes, and nobody tells the run; how long until it is back
    policies  with that program there: the policy for nobody else, and tables

Needs CUDA's nvcc, g++ and a release build of XAuto; root or a user who may open /dev/nvidia*.
usage: tables.py OUT [BUILD_DIR]        docs/results/nvidia.md has what it printed on an H100.
"""
import contextlib
import json
import os
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import time

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
WISHES, LOADS, SECONDS = 200, 12, 10
ALONE, BESIDE = "alone", "beside"
OUT = pathlib.Path(sys.argv[1]).resolve()
BUILD = pathlib.Path(sys.argv[2] if len(sys.argv) > 2 else SOURCE / "build").resolve()


def sh(*words, **more):
    return subprocess.run([str(w) for w in words], cwd=OUT, check=True, **more)


def xauto(*words):
    done = subprocess.run([BUILD / "bin/xauto", *map(str, words)], cwd=OUT, capture_output=True, text=True)
    # 1: a change may miss a deadline, and the tables are written all the same.
    if done.returncode > (1 if words[0] == "solve" and "MISSES" in done.stdout else 0):
        raise RuntimeError(f"xauto {' '.join(map(str, words))}: status {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def read(name):
    return json.loads((OUT / name).read_text())


def write(name, value):
    (OUT / name).write_text(json.dumps(value, indent=1))


def build():
    cuda = pathlib.Path(shutil.which("nvcc")).resolve().parents[1]
    os.environ["KERNELS"] = str(OUT / "kernels.ptx")
    sh("nvcc", "-ptx", "-arch=compute_80", HERE / "kernels.cu", "-o", "kernels.ptx")
    flags = ["-std=c++20", "-O2", f"-I{SOURCE}/include", f"-I{SOURCE}/lib", f"-I{cuda}/include", f"-L{cuda}/lib64/stubs"]
    kernel = [SOURCE / "lib/kernel" / f"{name}.cc" for name in ("rm_queues", "queue_files", "kfd_queues", "i915_contexts")]
    sh("g++", *flags, HERE / "suspend.cc", *kernel, SOURCE / "lib/base/pi_mutex.cc", "-o", "suspend", "-lcuda", "-ldl", "-lpthread")
    sh("g++", *flags, HERE / "tables.cc", "-o", "tables", f"-L{BUILD}/lib", f"-Wl,-rpath,{BUILD}/lib", "-Wl,--allow-shlib-undefined",
       "-lxauto", "-lcuda", "-ldl")


@contextlib.contextmanager
def load():
    """Somebody else computes on the GPU."""
    program = subprocess.Popen([OUT / "suspend", OUT / "kernels.ptx", "load"],
                               env={**os.environ, "LD_PRELOAD": str(BUILD / "bin/libxauto_watch.so")})
    try:
        time.sleep(1)
        if program.poll() is not None:
            raise RuntimeError("the load has ended")
        yield
    finally:
        program.kill()
        program.wait()


def platform(preempt_us):
    here = read("here.json")
    xpus = [x for x in here["xpus"] if x["type"] == "gpu"] + [x for x in here["xpus"] if x["type"] == "cpu"][:2]
    for xpu in xpus:
        if xpu["type"] == "gpu":
            xpu.update(preempt_us=preempt_us, preemptive=True)
    write("platform.json", {**here, "xpus": xpus})


def profile():
    common = ("--platform", "platform.json", "--repetitions", 60)
    xauto("profile", *common, "--out", f"{ALONE}.json", "--app-out", "app.json", "--", "./tables")
    with load():
        xauto("profile", *common, "--out", f"{BESIDE}.json", "--", "./tables")
    app = read("app.json")
    for source in app["sources"]:
        source["jitter_us"] = 2000  # ordinary threads wake late
    for chain in app["chains"]:
        chain["deadline_us"] = 198_000 if chain["name"].startswith("map") or chain["from"] == "map" else 40_000
    write("app.json", app)
    xauto("profile", "--platform", "platform.json", "--merge", f"{ALONE}.json", f"{BESIDE}.json", "--out", "scenarios.json")
    scenarios = read("scenarios.json")
    for scenario in scenarios["scenarios"]:
        scenario.pop("when", None)  # no clock tells who else is there
    write("scenarios.json", scenarios)


def plan():
    xauto("solve", "--app", "app.json", "--platform", "platform.json", "--scenarios", "scenarios.json", "--tables", 2, "--time-limit", "10s",
          "--out", "tables.json")
    xauto("solve", "--app", "app.json", "--platform", "platform.json", "--time-limit", "3s", "--out", "one.json")
    write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "shared-gpu", "queue_depth": 256, "keep": 256,
                              "defaults": {"overload": "queue:256"}, "tables": {"dwell_us": 500000}})


class Run:
    def __init__(self, policy):
        self.policy = policy

    def __enter__(self):
        self.out, self.err = open(OUT / "out", "w"), open(OUT / f"{self.policy}.err", "a")
        self.tool = subprocess.Popen([BUILD / "bin/xauto", "run", "--app", "app.json", "--platform", "platform.json", "--policy", self.policy,
                                      "--deployment", "deployment.json", "--activations", "0", "--json", "--", "./tables"],
                                     cwd=OUT, stdout=self.out, stderr=self.err)
        time.sleep(3)
        return self

    def __exit__(self, *what):
        self.tool.send_signal(signal.SIGTERM)
        try:
            self.tool.wait(timeout=60)
        finally:
            self.tool.kill()
        if what[0] is None:
            self.report = json.loads((OUT / "out").read_text())["runs"][0]

    def mode(self, *words):
        return json.loads(xauto("param", "scenario" if words else "list", "--run", f"{self.tool.pid}-0", "--wait", "10s", "--json", *words))

    def scenario(self):
        return self.mode()["now"]

    def until(self, name, seconds=20):
        """How long it takes in ms until that scenario counts; None: it does not."""
        since = time.monotonic()
        while self.scenario() != name:
            if time.monotonic() - since > seconds:
                return None
        return (time.monotonic() - since) * 1000


def told(report):
    chains = {c["name"]: {"results": c["results"], "lost": c["lost"], "p99_us": c["latency_us"]["p99"], "max_us": c["latency_us"]["max"],
                          "worst_case_us": c.get("worst_case_us"), "longer_than_claimed": c.get("longer_than_claimed")} for c in report["chains"]}
    return {"activations": report["activations"], "lost": report["lost_activations"], "changes": report.get("num_switches"),
            "why": sorted({s["why"] for s in report.get("switches", [])}), "chains": chains, "preemptions": report.get("preemptions"),
            "broken": report["claims"]["broken"]}


def wishes():
    settles_s = max(h["settles_us"] for h in read("tables.json")["handovers"]) / 1e6
    draw, since = random.Random(1), time.monotonic()
    with Run("tables.json") as run:
        for i in range(WISHES):
            run.mode(BESIDE if i % 2 == 0 else ALONE)
            time.sleep(settles_s + draw.uniform(0.05, 0.1))  # else nothing is claimed
    return {"settles_s": settles_s, "seconds": time.monotonic() - since, **told(run.report)}


def loads():
    there, gone, draw = [], [], random.Random(2)
    with Run("tables.json") as run:
        for _ in range(LOADS):
            with load():  # it has been there for 1 s
                there.append(run.scenario() == BESIDE)
                time.sleep(draw.uniform(0.5, 1))
            gone.append(run.until(ALONE))
            time.sleep(draw.uniform(0.5, 1))
    return {"beside_after_1_s": there, "until_alone_ms": gone, **told(run.report)}


def policies():
    result = {}
    with load():
        for policy in ("one.json", "tables.json"):
            with Run(policy) as run:
                time.sleep(SECONDS)
            result[policy] = told(run.report)
    return result


def main():
    OUT.mkdir(parents=True, exist_ok=True)
    build()
    xauto("doctor", "--platform-out", "here.json")
    platform(2000)
    profile()
    plan()
    with Run("tables.json") as run:
        time.sleep(4)
        run.mode(BESIDE)
        with load():
            time.sleep(4)
    costs = [p["suspend_us"] + p["resume_us"] for p in run.report.get("preemptions", [])]
    print("first run:", json.dumps(told(run.report)), flush=True)
    platform(max(costs, default=2000) * 3 // 2)
    plan()
    print("planned with preempt_us", max(costs, default=2000) * 3 // 2)
    for part in (wishes, loads, policies):
        result = part()
        write(f"{part.__name__}.result.json", result)
        print(part.__name__, json.dumps(result, indent=1), flush=True)


if __name__ == "__main__":
    main()
