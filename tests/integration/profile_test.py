# SPDX-License-Identifier: Apache-2.0
"""Profile, solve and run of an app that is half written: a stage computes, the others are stand-ins. What is real,
what is emulated, what is refused; profiles that end early; outliers."""
import json
import os
import pathlib
import signal
import subprocess
import tempfile
import unittest

from common import BIN, XAUTO, xauto

STAGES = str(BIN / "stages")
CORES = sorted(os.sched_getaffinity(0))[:2]  # all that the tool may use here: fewer than `small` has


def compute(x):
    """What the app's m.work does, once more."""
    for _ in range(300_000):
        x ^= x >> 30
        x = (x * 0xbf58476d1ce4e5b9 + 1) & (1 << 64) - 1
    return x


class Case(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def path(self, name):
        return str(self.folder / name)

    def xauto(self, *arguments, timeout=120):
        return subprocess.run([XAUTO, *map(str, arguments)], capture_output=True, text=True, timeout=timeout,
                              cwd=self.folder, preexec_fn=lambda: os.sched_setaffinity(0, CORES))

    def good(self, *arguments, status=0):
        done = self.xauto(*arguments)
        self.assertEqual(done.returncode, status, (arguments, done.stdout, done.stderr))
        return done

    def read(self, name):
        return json.loads((self.folder / name).read_text())

    def profile(self, platform, *more, status=0, app=(STAGES, "/dev/null")):
        return self.good("profile", "--platform", platform, "--warmup", 1, "--repetitions", 5, "--out", "profile.json",
                         "--app-out", "app.json", *more, "--", *app, status=status)

    def on(self, xnode):
        return next(x["on"] for x in self.read("profile.json")["xnodes"] if x["name"] == xnode)


class WhatTheProgramAsks(Case):
    def test_deadlines_and_clocks_stand_in_the_app(self):
        self.profile("small", "--emulate", app=(str(BIN / "driving-rates"),))
        app = self.read("app.json")
        asked = {c["name"]: c["deadline_us"] for c in app["chains"] if "deadline_us" in c}
        self.assertEqual(asked, {"front -> ctl.act": 100000, "rear -> ctl.act": 100000, "lidar -> ctl.act": 150000,
                                 "tick -> ctl.act": 10000})
        self.assertEqual(app["clocks"], [{"name": "lidar", "ppm": 5000}])
        self.assertEqual([s["name"] for s in app["sources"] if s.get("clock") == "lidar"], ["lidar"])
        self.assertEqual([s.get("rate_hz") for s in app["sources"][:2]], [30, 30])
        # What a person changes in the file stays, and is told.
        for chain in app["chains"]:
            if chain["name"] == "tick -> ctl.act":
                chain["deadline_us"] = 8000
        (self.folder / "app.json").write_text(json.dumps(app))
        again = self.profile("small", "--emulate", app=(str(BIN / "driving-rates"),))
        self.assertIn("deadline of chain 'tick -> ctl.act': 8000 us (the program says 10000)", again.stdout + again.stderr)
        self.assertEqual([c["deadline_us"] for c in self.read("app.json")["chains"] if c["name"] == "tick -> ctl.act"],
                         [8000])


class RealAndEmulated(Case):
    def test_profile_solve_run_with_a_stage_that_computes(self):
        self.good("doctor", "--platform-out", "here.json")
        here = self.read("here.json")
        self.assertEqual([x["id"] for x in here["xpus"] if x["type"] == "cpu"], [f"cpu{i}" for i in range(len(CORES))])
        self.profile("here.json", "--from", "p50")  # a stall in five repetitions is no WCET to plan with
        self.good("solve", "--app", "app.json", "--platform", "here.json", "--out", "policy.json")
        run = self.good("run", "--app", "app.json", "--platform", "here.json", "--policy", "policy.json", "--lockstep",
                        "--activations", 20, "--json", "--", STAGES, "result")
        report = json.loads(run.stdout)
        self.assertTrue(report["emulated"])
        self.assertEqual(report["real_xpus"], [f"cpu{i}" for i in range(len(CORES))])
        *lines, cores = (self.folder / "result").read_text().splitlines()
        self.assertEqual(len(lines), 20)
        for line in lines[:3]:
            k, value = map(int, line.split())
            self.assertEqual(value, compute(k))
        placed = next(x["xpu"] for x in self.read("policy.json")["xnodes"] if x["name"] == "m.work")
        self.assertEqual(cores, f"cores {CORES[int(placed.removeprefix('cpu'))]}", "the core that the policy names")

    def test_a_job_that_sleeps_on_its_real_core_breaks_the_claim(self):
        self.good("doctor", "--platform-out", "here.json")
        self.profile("here.json")
        app = self.read("app.json")
        next(x for x in app["xnodes"] if x["name"] == "m.work")["wcet_us"] = {"cpu": 100_000}  # no stall is as long
        app["sources"][0]["period_us"] = 200_000  # so that keys keep up
        (self.folder / "app.json").write_text(json.dumps(app))
        self.good("solve", "--app", "app.json", "--platform", "here.json", "--out", "policy.json")
        run = self.good("run", "--app", "app.json", "--platform", "here.json", "--policy", "policy.json", "--lockstep",
                        "--activations", 20, "--json", "--", STAGES, "result", "once", 9, 500)
        report = json.loads(run.stdout)["runs"][0]
        work = next(x for x in report["limited_xnodes"] if x["name"] == "m.work")
        self.assertEqual((work["jobs"], work["wcet_us"], work["over_wcet"]), (20, 100_000, 1))
        self.assertNotIn("budget_us", work)
        self.assertRegex(" ".join(report["claims"]["broken"]), r"[1-9]\d* of 60 jobs outran their WCET, m\.work by 4\d\d\.\d+ ms")

    def test_small_measures_the_cores_there_are(self):
        done = self.profile("small")
        self.assertEqual(sorted(self.on("m.work")), [f"cpu{i}" for i in range(len(CORES))])
        self.assertTrue(all(s["emulated"] is False for s in self.on("m.work").values()))
        self.assertEqual(sorted(self.on("m.prep")), ["cpu0", "cpu1", "cpu2", "cpu3"], "a stand-in runs on any")
        self.assertNotIn("emulated", self.on("m.infer")["gpu0"], "as the conditions say")
        self.assertTrue(self.read("profile.json")["conditions"]["emulated"])
        app = {x["name"]: x for x in self.read("app.json")["xnodes"]}
        self.assertEqual(app["m.work"]["real_on"], ["cpu"])
        self.assertNotIn("real_on", app["m.infer"])
        self.assertIn("real", done.stdout)
        # A placement on a core that is there runs, on one that is not is refused before anything starts.
        self.good("solve", "--app", "app.json", "--platform", "small", "--out", "policy.json")
        policy = self.read("policy.json")
        work = next(x for x in policy["xnodes"] if x["name"] == "m.work")
        for xpu, status in (("cpu0", 0), ("cpu3", 2)):
            for x in policy["xnodes"]:
                x["xpu"] = xpu if x["xpu"].startswith("cpu") else x["xpu"]
            (self.folder / "moved.json").write_text(json.dumps(policy))
            run = self.good("run", "--app", "app.json", "--platform", "small", "--policy", "moved.json", "--lockstep",
                            "--activations", 5, "--", STAGES, "/dev/null", status=status)
        self.assertEqual(work["name"], "m.work")
        for word in ("moved.json: XNode 'm.work'", "cpu3", f"may use {len(CORES)} CPU", "doctor --platform-out"):
            self.assertIn(word, run.stderr)

    def test_names_say_what_is_emulated(self):
        self.profile("small", "--emulate", "gpu,dla")
        self.assertEqual(sorted(self.on("m.prep")), [f"cpu{i}" for i in range(len(CORES))], "real, as the others")
        self.assertGreaterEqual(self.on("m.prep")["cpu0"]["min_us"], 1000, "keeps the core busy for as long")
        self.good("solve", "--app", "app.json", "--platform", "small", "--out", "policy.json")
        refused = self.good("run", "--app", "app.json", "--policy", "policy.json", "--emulate", "gpu,tpu", "--", STAGES,
                            status=2)
        self.assertIn("'tpu' is no XPU of platform 'small'", refused.stderr)

    def test_bare_emulate_is_all_and_says_what_a_computing_stage_needs(self):
        refused = self.good("profile", "--emulate", "--", STAGES, status=2)
        self.assertIn("m.work", refused.stderr)
        self.assertIn("SchedHandle::thread()", refused.stderr)
        self.assertIn("--emulate gpu,dla", refused.stderr)

    def test_the_platform_file_says_it_per_xpu(self):
        self.good("doctor", "--platform-out", "here.json")
        here = self.read("here.json")
        for x in here["xpus"]:
            if x["id"] == "cpu0":
                x["emulated"] = True
        (self.folder / "half.json").write_text(json.dumps(here))
        refused = self.good("profile", "--platform", "half.json", "--", STAGES, status=2)
        self.assertIn("cpu0: returned SchedHandle::thread(), it computes itself, and its XPU is emulated", refused.stderr)

    def test_an_app_of_stand_ins_is_emulated_as_ever(self):
        done = self.good("profile", "--platform", "small", "--repetitions", 3, "--out", "profile.json", "--app-out",
                         "app.json", "--", BIN / "camera")
        self.assertIn("(emulated)", done.stdout)
        self.assertNotIn("real_on", (self.folder / "app.json").read_text())


class OneRate(Case):
    """The camera's module: one source, one chain, and its keys claim what the run keeps."""

    def test_its_policy_claims_the_chain(self):
        self.profile("small", app=(str(BIN / "camera"),))
        app = self.read("app.json")
        ends = ("camera/image", "camera.postprocess")
        self.assertEqual([(s["name"], s["period_us"]) for s in app["sources"]], [("camera/image", 33000)])
        self.assertEqual([(c["from"], c["to"]) for c in app["chains"]], [ends])
        jitter = self.read("profile.json")["sources"][0]["jitter_us"]
        self.assertEqual(app["sources"][0]["jitter_us"], jitter)
        # Where the machine stood still in a job, its WCET is one that no policy keeps up with.
        for xnode in app["xnodes"]:
            if max(xnode["wcet_us"].values()) > 5000:
                xnode["wcet_us"] = {on: min(us, 5000) for on, us in xnode["wcet_us"].items()}
                xnode.pop("typical_us", None)
                (self.folder / "app.json").write_text(json.dumps(app))
        files = ("--app", "app.json", "--platform", "small")
        self.good("solve", *files, "--out", "policy.json")
        policy = self.read("policy.json")
        wcet = {x["name"]: x["wcet_us"] for x in app["xnodes"]}
        least = jitter + sum(min(times.values()) for times in wcet.values())
        chain, = policy["chains"]
        self.assertEqual((chain["worst_case_us"], chain["lower_bound_us"], chain["optimal"]), (least, least, True))
        self.assertIn("tells the truth", self.good("check", *files, "--policy", "policy.json").stdout)
        policy["chains"][0]["worst_case_us"] -= 1
        (self.folder / "lie.json").write_text(json.dumps(policy))
        self.good("check", *files, "--policy", "lie.json", status=1)
        run = json.loads(self.good("run", *files, "--policy", "policy.json", "--activations", 20, "--lockstep", "--json", "--",
                                   BIN / "camera").stdout)["runs"][0]
        self.assertEqual((run["activations"], run["lost_activations"]), (20, 0))


class Memory(Case):
    """What init of m.work holds, on purpose, is what profile says, and solve adds it up over all instances."""
    HELD_MB = 48

    def memory(self, *app):
        self.profile("small", "--from", "p50", app=app)  # a stall in five repetitions is no WCET to plan with
        return {xpu: s["memory_kb"] for xpu, s in self.on("m.work").items()}

    def test_what_an_init_holds_is_measured_and_added_up(self):
        work = self.memory(STAGES, "/dev/null", "holds", self.HELD_MB, 0)
        self.assertEqual(len(work), len(CORES))
        for xpu, kb in work.items():
            self.assertAlmostEqual(kb, self.HELD_MB * 1024, delta=4096, msg=xpu)  # also where the one before was freed
        for x in ("m.prep", "m.infer"):
            self.assertTrue(all("memory_kb" not in s for s in self.on(x).values()), "a stand-in's says nothing")
        app = {x["name"]: x for x in self.read("app.json")["xnodes"]}
        self.assertEqual(app["m.work"]["memory_kb"], {"cpu": max(work.values())})
        self.assertNotIn("memory_kb", app["m.infer"])
        text, told = self.solve()
        self.assertEqual((told["memory_kb"], told["memory_measured"]), (max(work.values()), 1))
        self.assertIn(f"Memory of all instances: at least {-(-max(work.values()) // 1024)} MiB measured by profile, of 1 of "
                      f"{told['instances']} instances (device memory not included)", text)
        whole = self.read("app.json")
        whole["xnodes"] = [x | {"memory_kb": dict.fromkeys(x["wcet_us"], 1000)} for x in whole["xnodes"]]
        self.write_app(whole)
        text, told = self.solve()
        self.assertEqual(told["memory_kb"], 1000 * told["instances"])
        self.assertIn(f"Memory of all instances: {-(-told['memory_kb'] // 1024)} MiB measured by profile (device", text)
        for x in whole["xnodes"]:
            del x["memory_kb"]
        self.write_app(whole)
        text, told = self.solve()
        self.assertIsNone(told["memory_kb"])
        self.assertIn("Memory of all instances: not measured", text)

    def test_what_holds_nothing_is_small_and_known(self):
        work = self.memory(STAGES, "/dev/null")
        for xpu, kb in work.items():
            self.assertLess(kb, 4096, xpu)

    def write_app(self, app):
        (self.folder / "app.json").write_text(json.dumps(app))

    def solve(self):
        (self.folder / "scenarios.json").write_text(json.dumps(
            {"schema": "xauto.scenarios", "version": 1, "app": "stages", "scenarios": [{"name": "nominal"}]}))
        words = ("solve", "--app", "app.json", "--platform", "small", "--scenarios", "scenarios.json", "--tables", 1,
                 "--time-limit", "1s")
        return self.good(*words).stdout, json.loads(self.good(*words, "--json").stdout)


class EndsEarly(Case):
    def profile_and_stop(self, *app):
        tool = subprocess.Popen([XAUTO, "profile", "--platform", "small", "--warmup", "0", "--repetitions", "100000", "--out",
                                 "profile.json", "--", *app], cwd=self.folder, stdout=subprocess.PIPE,
                                stderr=subprocess.PIPE, text=True, preexec_fn=lambda: os.sched_setaffinity(0, CORES))
        self.addCleanup(tool.kill)
        while "m.work has run 20 times" not in (line := tool.stderr.readline()):
            self.assertTrue(line, "it has ended before")
        tool.send_signal(signal.SIGINT)
        out, err = tool.communicate(timeout=60)
        return tool.returncode, out, err

    def test_ctrl_c_writes_what_there_is(self):
        for app in ((STAGES, "/dev/null"), (STAGES, "/dev/null", "hang", "20", "cpu0")):
            with self.subTest(app=app):
                status, out, err = self.profile_and_stop(*app)
                self.assertEqual(status, 1, err)
                self.assertNotIn("was killed", out + err)
                self.assertIn("incomplete: stopped by the user", out)
                self.assertGreater(self.on("m.work")["cpu0"]["count"], 5)
                written = self.read("profile.json")
                self.assertEqual(written["incomplete"], "stopped by the user")
                work = next(x for x in written["xnodes"] if x["name"] == "m.work")
                self.assertEqual(work.get("missing", []), [f"cpu{i}" for i in range(1, len(CORES))])
                os.remove(self.folder / "profile.json")

    def test_an_exec_that_hangs_is_named_and_the_rest_kept(self):
        last = f"cpu{len(CORES) - 1}"
        done = self.profile("small", "--exec-limit", "1s", status=1, app=(STAGES, "/dev/null", "hang", "9", last))
        self.assertIn(f"exec of XNode 'm.work' on {last} did not return within 1 s", done.stderr)
        self.assertEqual(self.on("m.infer")["gpu0"]["count"], 5)
        self.assertFalse((self.folder / "app.json").exists(), "of an incomplete profile none is written")
        done = xauto("profile", "--platform", "small", "--read", "profile.json", "--app-out", "app.json", cwd=self.folder)
        self.assertTrue((self.folder / "app.json").exists(), f"each XNode was measured somewhere, and it was asked for: {done.stderr}")
        why = self.read("profile.json")["incomplete"]
        self.assertEqual(self.read("app.json")["incomplete"], why)
        files = ("--app", "app.json", "--platform", "small")
        for words in (("solve", *files, "--time-limit", "1s", "--out", "policy.json"), ("check", *files, "--policy", "policy.json"),
                      ("run", *files, "--policy", "policy.json", "--emulate", "--activations", 2, "--", STAGES, "/dev/null")):
            said = xauto(*words, cwd=self.folder).stderr
            self.assertEqual(said.count(f"app.json: its WCETs are of an incomplete profile: {why}\n"), 1, f"{words}: {said}")

    def test_an_xnode_without_a_time_makes_no_app(self):
        done = self.profile("small", "--exec-limit", "1s", status=1, app=(STAGES, "/dev/null", "hang", "1", "cpu0"))
        self.assertIn("m.work", done.stderr)
        self.assertFalse((self.folder / "app.json").exists())
        self.assertNotIn("m.work", [x["name"] for x in self.read("profile.json")["xnodes"] if x["on"]])


class Outliers(Case):
    WORK = "m.work on cpu0"

    def measure(self, *fault, flags=()):
        done = self.profile("small", *flags, app=(STAGES, "/dev/null", *map(str, fault)))
        wcet = next(x["wcet_us"]["cpu"] for x in self.read("app.json")["xnodes"] if x["name"] == "m.work")
        return done.stdout, self.on("m.work")["cpu0"], wcet

    def test_one_is_named_and_becomes_the_wcet(self):
        out, samples, wcet = self.measure("once", 4, 300)
        self.assertGreaterEqual(samples["max_us"], 300_000)
        self.assertIn(f"{self.WORK}: repetition 3 of 5 took", out)  # after one warm-up
        self.assertIn("--stable", out)
        self.assertGreaterEqual(wcet, 360_000)

    def test_one_that_does_not_come_back_is_reported_as_such(self):
        out, samples, wcet = self.measure("once", 4, 300, flags=["--stable"])
        self.assertGreaterEqual(samples["max_us"], 300_000, "what was seen is never dropped")
        self.assertGreaterEqual(samples["outlier"]["count"], 1)  # a machine that stalls makes more of them
        self.assertGreaterEqual(samples["outlier"]["later_count"], 15)
        self.assertIn(f"{self.WORK}: outlier: repetition 3 took", out)
        self.assertLess(wcet, 150_000)

    def test_one_that_comes_back_stays(self):
        out, samples, wcet = self.measure("each", 3, 60, flags=["--stable"])
        self.assertNotIn("outlier", samples)
        self.assertGreater(samples["count"], 5)
        self.assertIn("came back", out)
        self.assertGreaterEqual(wcet, 72_000)

    def test_few_samples_have_no_p99(self):
        done = self.profile("small")
        line = next(x for x in done.stdout.splitlines() if x.startswith("  m.infer"))
        self.assertEqual(line.split()[4], "-")
        refused = self.profile("small", "--from", "p99", status=2)
        self.assertIn("5 repetitions have no p99", refused.stderr)
        done = self.good("profile", "--platform", "small", "--from", "p99", "--emulate", "gpu", "--repetitions", 100, "--out",
                         "profile.json", "--", STAGES)
        self.assertEqual(self.on("m.infer")["gpu0"]["count"], 100)


class Conditions(Case):
    """Clocks, power mode and temperatures of a machine whose files are in a folder."""
    GPU = "/sys/class/devfreq/17000000.gpu/cur_freq"
    MODE = "/var/lib/nvpmodel/status"

    def machine(self, name, gpu, mode="pmode:0000"):
        for file, text in ((self.GPU, gpu), (self.MODE, mode), ("/sys/class/thermal/thermal_zone0/temp", 45500),
                           ("/sys/class/thermal/thermal_zone0/type", "cpu-thermal")):
            path = self.folder / name / file[1:]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"{text}\n")

    def profile_on(self, machine):
        done = self.good("profile", "--platform", "small", "--emulate", "--repetitions", 3, "--machine-root", machine, "--out",
                         f"{machine}.json", "--", BIN / "camera")
        readings = self.read(f"{machine}.json")["conditions"]["readings"]
        return done.stderr, {r["file"]: r for r in readings}

    def merge(self, *profiles):
        done = self.good("profile", "--platform", "small", "--merge", *profiles, "--out", "scenarios.json")
        return done.stderr, {s["name"]: s.get("when") for s in self.read("scenarios.json")["scenarios"]}

    def test_a_machine_that_stands_still_is_written_down(self):
        self.machine("orin", 1300500000)
        said, readings = self.profile_on("orin")
        self.assertNotIn("changed", said)
        self.assertEqual(readings[self.GPU], {"of": "clock", "file": self.GPU, "first": 1300500000, "min": 1300500000,
                                              "max": 1300500000, "last": 1300500000})
        self.assertEqual(readings[self.MODE], {"of": "power_mode", "file": self.MODE, "texts": ["pmode:0000"]})
        zone = readings["/sys/class/thermal/thermal_zone0/temp"]
        self.assertEqual((zone["name"], zone["last"]), ("cpu-thermal", 45500))

    def test_profiles_that_would_make_scenarios_of_one_name_are_refused(self):
        self.machine("orin", 1300500000)
        self.profile_on("orin")
        (self.folder / "other").mkdir()
        (self.folder / "other/orin.json").write_text((self.folder / "orin.json").read_text())
        done = xauto("profile", "--platform", "small", "--merge", "orin.json", "other/orin.json", cwd=self.folder)
        self.assertEqual(done.returncode, 2)
        self.assertIn("other/orin.json: another file gives the scenario 'orin' its name", done.stderr)

    def test_a_clock_that_changes_meanwhile_is_said_with_what_to_do(self):
        self.machine("orin", 1300500000)
        tool = subprocess.Popen([XAUTO, "profile", "--platform", "small", "--repetitions", "60", "--machine-root", "orin",
                                 "--out", "orin.json", "--", STAGES, "/dev/null"], cwd=self.folder, stdout=subprocess.PIPE,
                                stderr=subprocess.PIPE, text=True)
        self.addCleanup(tool.kill)
        while "m.work has run 20 times" not in (line := tool.stderr.readline()):
            self.assertTrue(line, "it has ended before")
        self.machine("orin", 306000000)
        _, said = tool.communicate(timeout=120)
        self.assertEqual(tool.returncode, 0, said)
        lines = [line for line in said.splitlines() if "changed" in line]
        self.assertEqual(len(lines), 1, said)
        for word in (self.GPU, "306000000", "1300500000", "jetson_clocks", "performance"):
            self.assertIn(word, lines[0])
        calm = self.read("orin.json")
        for reading in calm["conditions"]["readings"]:
            if "min" in reading:
                reading["min"] = reading["last"] = reading["max"]
        (self.folder / "calm.json").write_text(json.dumps(calm))
        warned, when = self.merge("orin.json", "calm.json")
        self.assertEqual(when, {"orin": None, "calm": None})
        self.assertIn(f"{self.GPU} changed meanwhile", warned)

    def test_scenarios_are_told_apart_by_what_differed(self):
        self.machine("full", 1000000000)
        self.machine("half", 500000000, "pmode:0002")
        self.profile_on("full")
        self.profile_on("half")
        warned, when = self.merge("full.json", "half.json")
        self.assertNotIn("when", warned)
        self.assertEqual(when, {"full": [{"file": self.GPU, "at_least": 990000000}],
                                "half": [{"file": self.GPU, "at_least": 495000000}]})

    def test_one_condition_with_two_times_is_told(self):
        self.machine("quiet", 1000000000)
        self.machine("busy", 1000000000)
        self.profile_on("quiet")
        self.profile_on("busy")
        slow = self.read("busy.json")
        slow["xnodes"][1]["on"]["gpu0"]["max_us"] += 1_000_000
        (self.folder / "busy.json").write_text(json.dumps(slow))
        warned, when = self.merge("quiet.json", "busy.json")
        self.assertEqual(when, {"quiet": None, "busy": None})
        for word in ("quiet and busy were measured under the same clocks and power mode", "camera.infer", "on gpu"):
            self.assertIn(word, warned)


if __name__ == "__main__":
    unittest.main()
