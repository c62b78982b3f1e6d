# SPDX-License-Identifier: Apache-2.0
"""Where things are, how to call them, and how to wait. Environment: XAUTO_BIN (set by ctest), else build/bin;
XAUTO_FULL=1: the long forms of the tests that have one (make check-full).

No test depends on time: this machine may stall for a second at any moment (tests/stall.sh makes it). So what is said of
a run holds whatever was lost in it, or nothing can be lost: the run is in lockstep, or its queues hold all of it."""
import ctypes
import json
import os
import pathlib
import re
import shutil
import subprocess
import time

SOURCE = pathlib.Path(__file__).resolve().parents[2]
BIN = pathlib.Path(os.environ.get("XAUTO_BIN", SOURCE / "build/bin"))
XAUTO = str(BIN / "xauto")
DRIVING = str(BIN / "driving")
APP = str(SOURCE / "examples/driving/app.json")
os.environ.setdefault("DRIVING_TIMES", "worst")  # each job as long as app.json says: what a test knows beforehand


FULL = bool(os.environ.get("XAUTO_FULL"))


def in_little_time(arguments):
    """A search takes a second at most: a test asks what is said of an answer, not how good it is. Where a number of evaluations is
    said, that is the limit; `make check-full` leaves every search its time."""
    if FULL or arguments[:1] not in (["solve"], ["explain"], ["whatif"], ["compare"]) or "--max-evaluations" in arguments:
        return arguments
    end = arguments.index("--") if "--" in arguments else len(arguments)
    of_xauto = list(arguments[:end])
    if "--time-limit" in of_xauto:
        limit = of_xauto.index("--time-limit") + 1
        if re.fullmatch(r"[1-9][0-9.]*s", of_xauto[limit]):
            of_xauto[limit] = "1s"
    elif "--trace" not in of_xauto:
        of_xauto += ["--time-limit", "1s"]
    if of_xauto[0] == "solve" and "--threads" not in of_xauto:
        of_xauto += ["--threads", "1"]
    return of_xauto + arguments[end:]


def xauto(*arguments, cwd=None, timeout=120, stdin=None):
    """Runs the tool to its end."""
    return subprocess.run([XAUTO, *in_little_time(list(map(str, arguments)))], cwd=cwd, timeout=timeout, capture_output=True,
                          text=True, input=stdin, errors="replace")


# Above every thread of a run, on one core: 40 ms it computes, 10 ms it does not.
HOG = """import os, time
os.sched_setaffinity(0, {int(__import__("sys").argv[1])})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(98))
print("there", flush=True)
while True:
    end = time.thread_time() + 0.04
    while time.thread_time() < end: pass
    time.sleep(0.01)
"""


def wait_for(what, probe, tool=None, seconds=60):
    """The first true answer of `probe`. Fails after a minute, or when `tool`, a process, has ended."""
    until = time.monotonic() + seconds
    while True:
        asked = time.monotonic()
        if answer := probe():
            return answer
        now = time.monotonic()
        assert now < until, f"{what}: not within {seconds} s"
        if tool is not None and tool.poll() is not None:
            raise AssertionError(f"{what}: the run ended before, status {tool.returncode}: {tool.communicate()}")
        time.sleep(min(max(0.02, 2 * (now - asked)), 0.5))  # a probe that starts a program takes the core that others wait for


def system_service(test, folder, *flags, log=subprocess.DEVNULL):
    """`xauto-system` of this test, to its end, whose socket is in `folder`: the process, and the socket."""
    folder.chmod(0o755)  # other users come, too
    socket = folder / "coordinator.sock"
    service = subprocess.Popen([BIN / "xauto-system", "--socket", socket, *flags], stderr=log, text=True)
    if service.stderr:
        test.addCleanup(service.stderr.close)
    test.addCleanup(service.wait)
    test.addCleanup(service.kill)
    wait_for("the socket", socket.exists, service)
    return service, socket


def socket_of(run, name):
    """Where this socket of the run listens, with the \\0 of an abstract address: one part of it is a secret."""
    lines = (line.split() for line in pathlib.Path("/proc/net/unix").read_text(errors="replace").splitlines())
    return "\0" + next(words[7][1:] for words in lines if len(words) == 8 and words[3] == "00010000"
                       and words[7].startswith(f"@xauto/{run}/") and words[7].endswith(f"/{name}"))


def without_bpf():
    """In a child: with BPF `xauto top` says more, and takes up to 10 s where a machine stalls."""
    for capability in (21, 38, 39):  # CAP_SYS_ADMIN, CAP_PERFMON, CAP_BPF, out of the bounding set
        ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)


def top(tool, *options, wait_s=10):
    """What `xauto top` says of this run, as it is now; {} before it has begun."""
    done = subprocess.run([XAUTO, "top", "--run", f"{tool.pid}-0", "--wait", f"{wait_s}s", "--interval", "50ms", "--once",
                           "--json", *map(str, options)], timeout=120, capture_output=True, text=True, preexec_fn=without_bpf)
    return json.loads(done.stdout)["runs"][0] if done.stdout else {}


def deployed(tool):
    """What bpftool shows of the policy of a run by `xauto run`, as docs/tracing.md says; None: it may not, or is not there."""
    bpftool = shutil.which("bpftool", path=os.environ["PATH"] + ":/usr/sbin")
    path = f"/sys/fs/bpf/xauto/{tool.pid}-0/policy"
    if bpftool is None or os.geteuid() != 0 or not os.path.exists("/sys/fs/bpf"):
        return None
    shown = subprocess.run([bpftool, "map", "dump", "pinned", path], capture_output=True, text=True)
    return [row["value"] for row in json.loads(shown.stdout)] if shown.returncode == 0 else None


def activations(tool):
    """How many activations each module of this run has done by now, {module: number}; {} before it has begun."""
    return {m["name"]: m["activations"] for m in top(tool, wait_s=5).get("modules", [])}


TESTAPP = str(BIN / "testapp")
QUEUES = {"queue_depth": 256, "keep": 256, "defaults": {"overload": "queue:256"}}  # of a deployment: nothing is lost


def sourced(app, source, period_us=0):
    """`app`, of one source that all hear who wait for nobody. Without a period it releases one at a time."""
    waits = {v for _, v in app["edges"]}
    for xnode in app["xnodes"]:
        if xnode["name"] not in waits:
            xnode["source"] = source
    return {"schema": "xauto.app", "version": 3, "sources": [{"name": source} | ({"period_us": period_us} if period_us else {})],
            **app}


def testapp_files(folder, deployment=None, period_us=0, **of_app):
    """app.json, platform.json and policy.json of tests/integration/apps/testapp.cc, and the arguments of `run` that
    name them. `of_app`: further keys of the app; `deployment`: keys of a deployment.json. `period_us`: of its source;
    without one it releases one at a time."""
    def write(name, value):
        path = os.path.join(folder, name)
        pathlib.Path(path).write_text(json.dumps(value))
        return path

    xnodes = [("a1", "A", "cpu"), ("a2", "A", "npu"), ("b1", "B", "npu"), ("c1", "C", "cpu"), ("d1", "D", "cpu")]
    platform = write("platform.json", {"schema": "xauto.platform", "version": 1, "name": "test", "xpus": [
        {"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 0},
        {"id": "npu0", "type": "npu", "preemptive": False, "preempt_us": 100, "timeslice_us": 500}]})
    app = write("app.json", sourced({"name": "testapp",
                                     "xnodes": [{"name": n, "module": m, "wcet_us": {x: 1000}} for n, m, x in xnodes],
                                     "edges": [["a1", "a2"], ["a2", "c1"], ["b1", "c1"]], **of_app}, "src", period_us))
    policy = os.path.join(folder, "policy.json")
    done = xauto("solve", "--app", app, "--platform", platform, "--max-evaluations", 200, "--out", policy)
    assert os.path.exists(policy), done.stderr  # status 1: no policy keeps the deadline, but there is one
    arguments = ["--app", app, "--platform", platform, "--policy", policy]
    if deployment is not None:
        path = write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "testapp", **deployment})
        arguments += ["--deployment", path]
    return arguments


def children_of(pid):
    """All living descendants: {pid: command name}."""
    parent, name = {}, {}
    for entry in pathlib.Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            stat = (entry / "stat").read_text()
        except OSError:
            continue
        open_, close = stat.index("("), stat.rindex(")")
        fields = stat[close + 2:].split()
        if fields[0] == "Z":
            continue
        parent[int(entry.name)] = int(fields[1])
        name[int(entry.name)] = stat[open_ + 1:close]
    found, front = {}, [pid]
    while front:
        at = front.pop()
        for child, mother in parent.items():
            if mother == at:
                found[child] = name[child]
                front.append(child)
    return found


def alive(pid):
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
