#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tracing on this machine's kernel, whatever it is: the emulated Driving Case under `xauto top --record`."""
import json
import os
import pathlib
import shutil
import signal
import subprocess
import tempfile
import unittest

import pftrace
from common import APP, DRIVING, TESTAPP, XAUTO, activations, deployed, testapp_files, wait_for, xauto

ROOT = pathlib.Path("/sys/fs/bpf/xauto")
KINDS = {"wakeup", "run", "preempt", "sleep", "migrate"}


def why_not():
    """Why this machine cannot trace; empty if it can."""
    if os.geteuid() != 0:
        return "needs root"
    if not pathlib.Path("/sys/kernel/btf/vmlinux").exists():
        return "this kernel has no BTF"
    found = {f["id"]: f for f in json.loads(xauto("doctor", "--json").stdout)["findings"]}
    return "" if found["bpf"]["state"] == "ok" else found["bpf"]["found"]


WHY_NOT = why_not()


@unittest.skipIf(WHY_NOT, WHY_NOT)
class Trace(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.dir = tempfile.TemporaryDirectory()
        cls.policy = os.path.join(cls.dir.name, "policy.json")
        solved = xauto("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", cls.policy)
        assert solved.returncode == 0, solved.stderr

    @classmethod
    def tearDownClass(cls):
        cls.dir.cleanup()

    def drive(self, *options, releases=0):
        """A run; without a number of releases it goes on until it is told to stop. In lockstep, so none is lost."""
        run = subprocess.Popen([XAUTO, "run", "--app", APP, "--platform", "small", "--policy", self.policy, "--activations",
                                str(releases), "--lockstep", *options, "--json", "--", DRIVING],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

        def end():
            run.kill()
            run.communicate()
        self.addCleanup(end)
        return run

    def stop(self, run):
        """Its report."""
        run.terminate()
        out, err = run.communicate(timeout=60)
        self.assertEqual(run.returncode, 0, out + err)
        return json.loads(out)["runs"][0]

    def record(self, run, file, interval_ms, *options):
        return self.look("--run", f"{run.pid}-0", "--wait", "60s", "--once", "--interval", f"{interval_ms}ms", "--record", file, *options)

    def look(self, *options):
        return xauto("top", *options)

    def own(self, run):
        """Folders of this run's maps."""
        return [p.name for p in ROOT.glob(f"{run.pid}-*")] if ROOT.exists() else []

    def test_every_xnode_of_a_run_is_seen_and_losses_are_told_first(self):
        run = self.drive()
        events = os.path.join(self.dir.name, "events.jsonl")
        trace = self.record(run, events, 2000, "--json")
        report = self.stop(run)
        self.assertEqual(trace.returncode, 0, trace.stderr)
        seen = json.loads(trace.stdout)["runs"][0]
        record = seen["record"]
        names = {x["name"] for x in json.loads(pathlib.Path(APP).read_text())["xnodes"]}
        self.assertEqual({x["xnode"] for x in seen["xnodes"]}, names)
        for xnode in seen["xnodes"]:
            # What was released before the tracer was attached is missing; one job may be seen at each end.
            self.assertLessEqual(xnode["jobs"], report["activations"] + 1, xnode)
            self.assertGreater(xnode["jobs"], 0, xnode)
            self.assertGreater(xnode["run_p50_us"], 0, xnode)
            self.assertLessEqual(xnode["latency_p50_us"], xnode["latency_p99_us"], xnode)
        lines = [json.loads(line) for line in pathlib.Path(events).read_text().splitlines()]
        self.assertLessEqual(record["lost"]["events"], lines[0]["lost_events"])
        self.assertGreater(record["events"], 0)
        self.assertLessEqual(record["events"], len(lines) - 1)  # some came after the look
        self.assertLessEqual({e["kind"] for e in lines[1:]}, KINDS)
        self.assertTrue(all("by" in e for e in lines[1:] if e["kind"] in ("wakeup", "preempt")))
        # A thread that gets a CPU was ready before, and runs until it is switched out: so its events alternate.
        running = set()
        for event in lines[1:] if lines[0] == {"lost_events": 0, "lost_jobs": 0} else []:
            if event["kind"] == "run":
                self.assertNotIn(event["tid"], running)
                running.add(event["tid"])
            elif event["kind"] in ("preempt", "sleep"):
                running.discard(event["tid"])

    def test_what_the_buffer_could_not_take_is_told_first(self):
        """A run of short jobs without a pause, while who records is stopped."""
        run = subprocess.Popen([XAUTO, "run", *testapp_files(self.dir.name), "--lockstep", "--activations", "0", "--", TESTAPP,
                                os.path.join(self.dir.name, "result")], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        self.addCleanup(lambda: (run.kill(), run.communicate()))
        words = open(os.path.join(self.dir.name, "words"), "w+")
        self.addCleanup(words.close)
        trace = subprocess.Popen([XAUTO, "top", "--run", f"{run.pid}-0", "--wait", "60s", "--count", "0", "--record",
                                  os.path.join(self.dir.name, "lost.jsonl")], stdout=words, stderr=subprocess.PIPE, text=True)
        wait_for("the tracer", lambda: list(ROOT.glob(f"{run.pid}-*/events")), trace)
        trace.send_signal(signal.SIGSTOP)
        before = activations(run)["A"]
        # 1 MB is 16,384 events. A job has one at least.
        wait_for("enough jobs", lambda: activations(run)["A"] > before + 4000, run)
        trace.send_signal(signal.SIGCONT)
        run.terminate()
        run.communicate(timeout=60)
        _, errors = trace.communicate(timeout=60)
        self.assertEqual(trace.returncode, 0, errors)
        words.seek(0)
        self.assertRegex(words.read(), r"\nINCOMPLETE: of \d+ events [1-9]\d* were lost")
        self.assertGreater(json.loads(pathlib.Path(self.dir.name, "lost.jsonl").read_text().splitlines()[0])["lost_events"], 0)

    def test_the_kernels_cpus_and_the_run_are_one_picture(self):
        run_file, cpus = (pathlib.Path(self.dir.name, name) for name in ("run.pftrace", "cpus.pftrace"))
        run = self.drive("--trace-out", str(run_file))
        trace = self.record(run, cpus, 1000)
        self.assertRegex(trace.stdout, r"\n(complete|INCOMPLETE): ")
        self.stop(run)
        self.assertEqual(trace.returncode, 0, trace.stderr)
        both = pftrace.Trace(run_file.read_bytes() + cpus.read_bytes())
        tracks = {s.track for s in both.slices if s.category == "cpu"}
        self.assertLessEqual(tracks, {f"kernel cpu{n}" for n in range(os.cpu_count())})
        self.assertTrue(tracks)
        stays = [s for s in both.slices if s.category == "cpu"]
        self.assertLessEqual({s.name for s in stays if not s.name.startswith("thread ")},
                             {x["name"] for x in json.loads(pathlib.Path(APP).read_text())["xnodes"]})
        # One clock: what the kernel saw lies within the run as the runtime saw it, or close to it.
        run_begin, run_end = (f(s.begin for s in both.on("run")) for f in (min, max))
        inside = [s for s in stays if run_begin <= s.begin <= run_end]
        self.assertGreater(len(inside), len(stays) / 2)
        joined = pathlib.Path(self.dir.name, "both.pftrace")
        joined.write_bytes(run_file.read_bytes() + cpus.read_bytes())
        answers = [xauto("explain", "--trace", path, "--json") for path in (run_file, joined)]
        self.assertEqual(answers[0].returncode, 0, answers[0].stderr)
        self.assertEqual(answers[0].stdout, answers[1].stdout)

    def test_top_shows_load_and_xnodes(self):
        run = self.drive()
        def look():
            """Of the second look: what has begun and ended since the first. None if the GPU did nothing meanwhile."""
            top = self.look("--run", f"{run.pid}-0", "--wait", "60s", "--count", "2", "--interval", "700ms", "--json")
            self.assertEqual(top.returncode, 0, top.stderr)
            last = json.loads(top.stdout.splitlines()[-1])["runs"][0]
            load = {x["xpu"]: x.get("load_pct", 0) for x in last["xpus"]}
            return (load, last["xnodes"]) if load["gpu0"] > 0 else None
        load, xnodes = wait_for("load on the GPU", look, run)
        self.stop(run)
        self.assertEqual(set(load), {"cpu0", "cpu1", "cpu2", "cpu3", "gpu0", "dla0"} & set(load))
        self.assertTrue(all(0 <= pct <= 100 for pct in load.values()), load)
        self.assertTrue(any(x["jobs"] > 0 for x in xnodes))

    def test_nothing_stays_behind(self):
        run = self.drive(releases=2)
        run.communicate(timeout=60)
        self.assertEqual(self.own(run), [])
        # Killed, it cannot tidy up; the next run does.
        run = self.drive()
        self.assertEqual(self.record(run, pathlib.Path(self.dir.name, "killed.jsonl"), 1000).returncode, 0)
        self.assertEqual(len(self.own(run)), 1)
        run.kill()
        run.communicate()
        after = self.drive(releases=2)
        after.communicate(timeout=60)
        self.assertEqual(self.own(run), [])

    def test_the_policy_is_a_map_that_bpftool_shows_row_by_row(self):
        """Also without BPF programs, as on Linux 6.1; of ROS 2's way without XPUs."""
        if not shutil.which("bpftool", path=os.environ["PATH"] + ":/usr/sbin"):
            self.skipTest("no bpftool")
        policy = json.loads(pathlib.Path(self.policy).read_text())
        run = self.drive()
        rows = wait_for("the map", lambda: deployed(run), run)
        wait_for("activations", lambda: any(activations(run).values()), run)  # it hears a SIGTERM by then
        self.stop(run)
        xpus = [x["xpu"] for x in policy["xnodes"]]
        self.assertTrue({"gpu0", "dla0"} <= set(xpus) and any(x.startswith("cpu") for x in xpus), xpus)
        self.assertEqual([(r["xnode"], r["xpu"], r["by"], r["value"]) for r in rows],
                         [(x["name"], x["xpu"], "priority", x["priority"]) for x in policy["xnodes"]])
        page = (pathlib.Path(__file__).parents[2] / "docs" / "tracing.md").read_text()
        shown = page.split('"value": {', 1)[1].split("}", 1)[0]
        self.assertEqual(list(json.loads("{" + shown + "}")), list(rows[0]), "what docs/tracing.md shows")

    def test_without_a_run_it_says_so(self):
        for name in ("1-999", "../etc"):
            trace = xauto("top", "--run", name, "--record", os.path.join(self.dir.name, "none.jsonl"))
            self.assertEqual(trace.returncode, 2)
            self.assertIn(f"no run '{name}' is going on", trace.stderr)

    def test_emulated_cpus_are_not_scheduled_by_sched_ext(self):
        run = self.drive("--cpu-sched", "ext", releases=2)
        answer, _ = run.communicate(timeout=60)
        self.assertIn("the CPUs are emulated: --cpu-sched ext has no effect", answer)


@unittest.skipIf(WHY_NOT, WHY_NOT)
class TraceWithoutBtf(Trace):
    """All of it again where the tracer finds no BTF, and goes by the tracepoints' formats."""

    def look(self, *options):
        hidden = "mount -t tmpfs none /sys/kernel/btf && exec \"$@\""
        return subprocess.run(["unshare", "--mount", "sh", "-c", hidden, "-", XAUTO, "top", *map(str, options)],
                              timeout=120, capture_output=True, text=True)

    test_what_the_buffer_could_not_take_is_told_first = None  # it asks the tool, which is one
    test_without_a_run_it_says_so = test_emulated_cpus_are_not_scheduled_by_sched_ext = None
    test_the_policy_is_a_map_that_bpftool_shows_row_by_row = test_nothing_stays_behind = None


if __name__ == "__main__":
    unittest.main()
