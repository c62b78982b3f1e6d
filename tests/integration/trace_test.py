#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tracing on this machine's kernel, whatever it is: the emulated Driving Case under `xauto trace` and `xauto top`."""
import json
import os
import pathlib
import signal
import subprocess
import tempfile
import unittest

import pftrace
from common import APP, DRIVING, XAUTO, activations, wait_for, xauto

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

    def own(self, run):
        """Folders of this run's maps."""
        return [p.name for p in ROOT.glob(f"{run.pid}-*")] if ROOT.exists() else []

    def test_every_xnode_of_a_run_is_seen_and_losses_are_told_first(self):
        run = self.drive()
        events = os.path.join(self.dir.name, "events.jsonl")
        trace = xauto("trace", "--run", f"{run.pid}-0", "--wait-s", 60, "--duration-s", 2, "--json", "--out", events)
        report = self.stop(run)
        self.assertEqual(trace.returncode, 0, trace.stderr)
        seen = json.loads(trace.stdout)
        names = {x["name"] for x in json.loads(pathlib.Path(APP).read_text())["xnodes"]}
        self.assertEqual({x["xnode"] for x in seen["xnodes"]}, names)
        self.assertEqual(seen["complete"], seen["lost"]["events"] + seen["lost"]["jobs"] + seen["lost"]["pipe"] == 0)
        for xnode in seen["xnodes"]:
            # What was released before the tracer was attached is missing; one job may be seen at each end.
            self.assertLessEqual(xnode["jobs"], report["activations"] + 1, xnode)
            self.assertGreater(xnode["jobs"], 0, xnode)
            self.assertGreater(xnode["run_us"]["p50"], 0, xnode)
        lines = [json.loads(line) for line in pathlib.Path(events).read_text().splitlines()]
        self.assertEqual(lines[0], {"lost_events": seen["lost"]["events"], "lost_jobs": seen["lost"]["jobs"]})
        self.assertEqual(len(lines) - 1, seen["events"])
        self.assertLessEqual({e["kind"] for e in lines[1:]}, KINDS)
        self.assertTrue(all("by" in e for e in lines[1:] if e["kind"] in ("wakeup", "preempt")))
        # A thread that gets a CPU was ready before, and runs until it is switched out: so its events alternate.
        running = set()
        for event in lines[1:] if seen["complete"] else []:
            if event["kind"] == "run":
                self.assertNotIn(event["tid"], running)
                running.add(event["tid"])
            elif event["kind"] in ("preempt", "sleep"):
                running.discard(event["tid"])

    def test_a_buffer_that_is_too_small_is_told_in_the_first_line(self):
        run = self.drive()
        trace = subprocess.Popen([XAUTO, "trace", "--run", f"{run.pid}-0", "--ring-kb", "4"], stdout=subprocess.PIPE,
                                 stderr=subprocess.PIPE, text=True)
        # Stopped for a while, it cannot empty 4 kB, 56 bytes each.
        wait_for("the tracer", lambda: list(ROOT.glob(f"{run.pid}-*/events")), trace)
        trace.send_signal(signal.SIGSTOP)
        count = lambda: min(activations(run).values(), default=0)
        before = count()
        wait_for("ten releases, of 15 jobs each", lambda: count() > before + 10, run)
        trace.send_signal(signal.SIGCONT)
        self.stop(run)
        text, errors = trace.communicate(timeout=60)
        self.assertEqual(trace.returncode, 0, errors)
        self.assertRegex(text.splitlines()[0], r"^INCOMPLETE: of \d+ events [1-9]\d* were lost")

    def test_the_kernels_cpus_and_the_run_are_one_picture(self):
        run_file, cpus = (pathlib.Path(self.dir.name, name) for name in ("run.pftrace", "cpus.pftrace"))
        run = self.drive("--trace-out", str(run_file))
        trace = xauto("trace", "--run", f"{run.pid}-0", "--wait-s", 60, "--duration-s", 1, "--json", "--out", cpus)
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

    def test_tells_which_scenario_counts(self):
        """... and what met a change, as `xauto param` does: nothing changes in between."""
        app = json.loads(pathlib.Path(APP).read_text())
        for xnode in app["xnodes"]:  # no job of this machine is too long
            xnode["wcet_us"] = {kind: 1000 * us for kind, us in xnode["wcet_us"].items()}
        app.pop("deadline_us", None)
        folder = pathlib.Path(self.dir.name)
        write = lambda name, value: (folder / name).write_text(json.dumps(value))
        write("app.json", app)
        write("scenarios.json", {"schema": "xauto.scenarios", "version": 1, "app": "driving", "scenarios": [
            {"name": "nominal"}, {"name": "GPU slow", "wcet_scale_pct": {"gpu": 150}}]})
        done = xauto("solve", "--app", "app.json", "--platform", "small", "--scenarios", "scenarios.json", "--tables", 2,
                     "--time-limit-s", 2, "--out", "tables.json", cwd=folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        run = subprocess.Popen([XAUTO, "run", "--app", "app.json", "--platform", "small", "--emulate", "--policy", "tables.json",
                                "--activations", "0", "--period-us", "60000", "--", DRIVING], cwd=folder,
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.addCleanup(lambda: (run.kill(), run.wait()))
        words = ("--run", f"{run.pid}-0", "--wait-s", 10)
        mode = lambda *more: json.loads(xauto("param", "scenario" if more else "list", *words, "--json", *more).stdout or "{}")
        wait_for("the run", lambda: any(s["releases"] > 1 for s in mode().get("scenarios", [])), run)
        mode("GPU slow")
        wait_for("the change", lambda: (mode().get("spanned") or {}).get("to") == "GPU slow", run)
        known = mode()
        self.assertEqual(known["now"], "GPU slow")
        told = json.loads(xauto("trace", *words, "--duration-s", 1, "--json").stdout)["scenario"]
        self.assertEqual((told["name"], told["why"], told["spanned"]), (known["now"], known["why"], known["spanned"]))
        text = xauto("trace", *words, "--duration-s", 1).stdout
        self.assertIn("scenario 'GPU slow' (asked), table '", text)
        self.assertIn("of what met a change the nearest to its worst case, a result of '", text)

    def test_top_shows_load_and_xnodes(self):
        run = self.drive()
        def look():
            """Of the second look: what has begun and ended since the first. None if the GPU did nothing meanwhile."""
            top = xauto("top", "--run", f"{run.pid}-0", "--wait-s", 60, "--count", "2", "--interval-ms", "700", "--json")
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
        xauto("trace", "--run", f"{run.pid}-0", "--wait-s", 60, "--duration-s", "1")
        self.assertEqual(len(self.own(run)), 1)
        run.kill()
        run.communicate()
        after = self.drive(releases=2)
        after.communicate(timeout=60)
        self.assertEqual(self.own(run), [])

    def test_without_a_run_it_says_so(self):
        trace = xauto("trace", "--run", "1-999", "--wait-s", "0")
        self.assertEqual(trace.returncode, 2)
        self.assertIn("no run '1-999' is going on", trace.stderr)
        trace = xauto("trace", "--run", "../etc", "--wait-s", "0")
        self.assertEqual(trace.returncode, 2)

    def test_emulated_cpus_are_not_scheduled_by_sched_ext(self):
        run = self.drive("--cpu-sched", "ext", releases=2)
        answer, _ = run.communicate(timeout=60)
        self.assertIn("the CPUs are emulated: --cpu-sched ext has no effect", answer)


if __name__ == "__main__":
    unittest.main()
