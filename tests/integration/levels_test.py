#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Jobs of three rates on the levels of one GPU, over a CUDA that is acted out (tests/nvidia). How long each had the GPU
is computed here from what the GPU knows of it and from the trace, and compared with what the run says."""
import collections
import json
import pathlib
import subprocess
import tempfile
import unittest

import pftrace
from common import BIN, XAUTO, xauto

# Of the program: period in ms, kernels, blocks of each, us of a block. Two blocks fill the GPU: `fast` shares it.
WORK = {"fast": (20, 2, 1, 500), "mid": (50, 4, 2, 1000), "slow": (200, 40, 2, 1000)}
WCET_US = {"fast": 5000, "mid": 11000, "slow": 52000}

# What the GPU says of a job, and its time by the trace: from before the run's clock of it to behind.
Job = collections.namedtuple("Job", "module priority since until met waits begin end")


def covered(spans, begin, end):
    """How much of [begin, end) lies in any of the spans."""
    sum_, at = 0, begin
    for b, e in sorted(spans):
        sum_ += max(0, min(e, end) - max(b, at))
        at = max(at, min(e, end))
    return sum_


class Case(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.write("platform.json", {"schema": "xauto.platform", "version": 1, "name": "test", "xpus": [
            {"id": "gpu0", "type": "gpu", "preemptive": True, "preempt_us": 0, "timeslice_us": 1000, "levels": 6}]})

    def write(self, name, value):
        (self.folder / name).write_text(json.dumps(value))

    def on_gpu(self, verb, work, *flags, units=2):
        """The tool, with the program on a machine that has NVIDIA's nodes."""
        (self.folder / "log").unlink(missing_ok=True)
        done = subprocess.run([BIN / "on_devices", "rm", "state", XAUTO, verb, "--platform", "platform.json", *map(str, flags), "--",
                               BIN / "levelsapp", "log", str(units), *(":".join(map(str, (m, *w))) for m, w in work.items())],
                              cwd=self.folder, capture_output=True, text=True, timeout=120)
        if done.returncode == 77:
            self.skipTest(done.stderr)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done

    def log(self):
        """(module, release, priority, since, until, met, waits) of each job."""
        for line in (self.folder / "log").read_text().splitlines():
            name, *numbers = line.split()
            yield name, *map(int, numbers)


class Run(Case):
    def setUp(self):
        super().setUp()
        self.write("app.json", {
            "schema": "xauto.app", "version": 3, "name": "levels", "clocks": [],
            "sources": [{"name": m, "period_us": 1000 * w[0], "jitter_us": 1000} for m, w in WORK.items()],
            "modules": [{"name": f"{m}M", "max_in_flight": 1, "optional": False} for m in WORK],
            "xnodes": [{"name": f"{m}.run", "module": f"{m}M", "source": m, "wcet_us": {"gpu": WCET_US[m]}} for m in WORK],
            "edges": [], "samples": [],
            "chains": [{"name": m, "from": m, "to": f"{m}.run", "deadline_us": 1000 * w[0]} for m, w in WORK.items()]})
        done = xauto("solve", "--app", "app.json", "--platform", "platform.json", "--max-evaluations", 100, "--threads", 1,
                     "--out", "policy.json", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertNotIn("hold_us", (self.folder / "policy.json").read_text(), "a job that oversleeps one is charged that, too")

    def run_app(self, *flags):
        done = self.on_gpu("run", WORK, "--app", "app.json", "--policy", "policy.json", "--duration", "2s", "--overload", "newest",
                           "--json", "--trace-out", "run.pftrace", *flags)
        return json.loads(done.stdout)["runs"][0]

    def jobs(self):
        """module -> Jobs."""
        begins, ends, jobs = {}, {}, collections.defaultdict(list)
        for s in pftrace.Trace((self.folder / "run.pftrace").read_bytes()).slices:
            if s.category == "run" and s.args["part"] == 1:
                begins[s.name, s.args["release"]] = s.begin
            elif s.category == "state" and s.name == "running":
                ends[s.track, s.begin] = s.end
        for name, release, *of_gpu in self.log():
            begin = begins[f"{name}.run", release]
            jobs[name].append(Job(name, *of_gpu, begin, ends[f"modules/{name}M", begin]))
            self.assertTrue(begin <= jobs[name][-1].since < jobs[name][-1].until <= jobs[name][-1].end, jobs[name][-1])
        return jobs

    def bounds_us(self, jobs, of):
        """Of each job of the module: the least and the most that it can have had the GPU without one above it, by the run's clock;
        and the least that passed from its begin to its end."""
        for job in jobs[of]:
            above = [j for all_ in jobs.values() for j in all_ if j.priority > job.priority]
            least = job.until - job.since - covered([(j.begin, j.end) for j in above], job.since, job.until)
            # One that may not have ended by then counts for its WCET at least.
            counts = [(j.since, j.until if j.end < job.until else min(j.until, j.begin + 1000 * WCET_US[j.module])) for j in above]
            most = job.end - job.begin - covered(counts, job.begin, job.end)
            yield least / 1000, most / 1000, (job.until - job.since) / 1000

    def test_a_job_below_others_has_had_what_the_gpu_says(self):
        for _ in range(5):  # until a run was such that who forgets those above is found
            run = self.run_app()
            jobs = self.jobs()
            shared = False
            for xnode in run["limited_xnodes"]:
                module = xnode["name"].removesuffix(".run")
                times = list(self.bounds_us(jobs, module))
                most = max(most for _, most, _ in times)
                with self.subTest(xnode=xnode, most=most):
                    self.assertEqual(xnode["jobs"], len(times))
                    self.assertGreater(xnode["longest_us"] + 1, max(least for least, _, _ in times))
                    self.assertLess(xnode["longest_us"], most + 1)
                    wcet = WCET_US[module]
                    self.assertGreaterEqual(xnode["over_wcet"], sum(least > wcet for least, _, _ in times))
                    self.assertLessEqual(xnode["over_wcet"], sum(most > wcet for _, most, _ in times))
                if module == "slow":
                    shared = max(passed for _, _, passed in times) > most + 1
            said = " ".join(run["claims"]["broken"])
            self.assertEqual("outran" in said, any(x["over_wcet"] for x in run["limited_xnodes"]), said)
            if shared:
                return
        self.fail("slow was never below others for long")

    def test_in_several_processes_nothing_is_claimed(self):
        run = self.run_app("--isolate")
        self.assertIn("work on gpu0 is ordered within one process, and 3 have some", " ".join(run["claims"]["broken"] + run["notes"]))


class Profile(Case):
    """What `profile` runs below a job, and what of that gets into its WCET."""

    def profile(self, work, *, levels=6, units):
        platform = json.loads((self.folder / "platform.json").read_text())
        platform["xpus"][0]["levels"] = levels
        self.write("platform.json", platform)
        self.on_gpu("profile", work, "--warmup", 1, "--repetitions", 12, "--out", "profile.json", "--app-out", "app.json", units=units)
        return [line for line in self.log() if line[0] == "urgent" and line[2] == 5]  # the highest stream priority

    def test_a_job_of_many_kernels_waits_for_a_block_at_each_of_them(self):
        kernels, kernel_us, block_us = 6, 200, 3000
        least_us = kernels * kernel_us + (kernels - 1) * block_us  # a block lasts that long at least, whatever the machine does
        above = self.profile({"urgent": (50, kernels, 1, kernel_us), "long": (200, 20, 1, block_us)}, units=1)
        self.assertGreaterEqual(max(waits for *_, waits in above), kernels - 1)
        times = {x["name"]: x for x in json.loads((self.folder / "profile.json").read_text())["xnodes"]}["urgent.run"]
        self.assertGreaterEqual(times["beside"]["gpu"]["gpu0"]["max_us"], least_us)
        app = json.loads((self.folder / "app.json").read_text())
        self.assertGreaterEqual(next(x["wcet_us"]["gpu"] for x in app["xnodes"] if x["name"] == "urgent.run"), least_us)
        for source in app["sources"]:  # time for all, however long a machine that stalls took
            source["period_us"], source["jitter_us"] = 60_000_000, 0
        self.write("app.json", app)
        done = xauto("solve", "--app", "app.json", "--platform", "platform.json", "--max-evaluations", 100, "--threads", 1, "--out",
                     "policy.json", cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        chain = next(c for c in json.loads((self.folder / "policy.json").read_text())["chains"] if "urgent" in c["name"])
        self.assertGreaterEqual(chain["worst_case_us"], least_us, "the claim, too")

    def test_what_leaves_room_alone_and_none_together_is_below_at_once(self):
        """One block each on a GPU of two units: who meets one of them does not wait, who meets both does."""
        work = {"urgent": (50, 1, 1, 300), "left": (200, 10, 1, 2000), "right": (200, 10, 1, 2000)}
        above = self.profile(work, units=2)
        self.assertEqual(max(met for *_, met, _ in above), 2)
        self.assertEqual(max(waits for *_, waits in above), 1)
        # Where a job has one level below it, no run has two there.
        above = self.profile(work, levels=2, units=2)
        self.assertEqual(max(met for *_, met, _ in above), 1)


if __name__ == "__main__":
    unittest.main()
