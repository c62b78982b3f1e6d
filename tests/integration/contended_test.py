# SPDX-License-Identifier: Apache-2.0
"""`xauto profile --contended`: each stage beside a load of each type of XPU. What a stage took is compared with what the
emulator's rules make of its work, and only from below: this machine may make anything longer."""
import json
import pathlib
import tempfile
import unittest

from common import BIN, xauto

CAMERA = BIN / "camera"
FALLBACK = BIN / "fallback"
PLATFORM = {"schema": "xauto.platform", "version": 1, "name": "bench",
            "xpus": [{"id": f"{type}{i}", "type": type, "preemptive": type != "npu", "preempt_us": 0, "timeslice_us": 0}
                     for type, i in (("cpu", 0), ("cpu", 1), ("gpu", 0), ("dla", 0), ("npu", 0))]}


class Contended(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.write("platform.json", PLATFORM)

    def write(self, name, value):
        (self.folder / name).write_text(json.dumps(value))

    def profile(self, *flags, app, status=0):
        done = xauto("profile", "--contended", "--warmup", 1, "--repetitions", 10, "--out", "profile.json", "--app-out",
                     "app.json", *flags, "--", *app, cwd=self.folder)
        self.assertEqual(done.returncode, status, done.stderr)
        if status == 0:
            self.profiled = json.loads((self.folder / "profile.json").read_text())
        return done

    def xnode(self, name):
        return next(x for x in self.profiled["xnodes"] if x["name"] == name)

    def test_every_class_has_what_the_scripts_contention_makes_of_it(self):
        self.write("script.json", {"schema": "xauto.emulation", "version": 1,
                                   "steps": [{"at_us": 0, "contention_pct": {"gpu": 50, "cpu": 20, "dla": 10}}]})
        done = self.profile("--platform", "small", "--emulate", "--emulate-script", "script.json", app=[CAMERA])
        infer, post = self.xnode("camera.infer"), self.xnode("camera.postprocess")
        # docs/emulation.md: longer by the type's percentage per other XPU that is busy. `small` has four CPUs.
        nothing, cpus, one_other = 5000, 4, 1
        self.assertGreaterEqual(infer["on"]["gpu0"]["min_us"], nothing)
        for beside, others in (("cpu", cpus), ("dla", one_other)):
            self.assertGreaterEqual(infer["beside"][beside]["gpu0"]["max_us"], nothing * (100 + 50 * others) // 100 * 0.98)
        self.assertNotIn("gpu0", infer["beside"].get("gpu", {}), "it is the only GPU")
        self.assertGreaterEqual(infer["beside"]["gpu"]["dla0"]["max_us"], 8000 * 1.1 * 0.98)
        self.assertEqual(set(post["beside"]["cpu"]), {"cpu0", "cpu1", "cpu2", "cpu3"}, "beside the three others")
        self.assertGreaterEqual(infer["beside"]["*"]["gpu0"]["max_us"], nothing * (100 + 50 * (cpus + 1)) // 100 * 0.98)
        stated = {x["name"]: x for x in json.loads((self.folder / "app.json").read_text())["xnodes"]}["camera.infer"]

        def wcet(samples):
            return samples["max_us"] + -(-samples["max_us"] * 20 // 100)

        alone = wcet(infer["on"]["gpu0"])
        self.assertEqual(stated["wcet_us"]["gpu"], alone)
        on_gpu = {json.dumps(b["load"]): b["wcet_us"] for b in stated["beside"] if b["on"] == "gpu"}
        for load, of_class in (({"cpu": cpus}, "cpu"), ({"dla": one_other}, "dla"), ({"cpu": cpus, "dla": one_other}, "*")):
            self.assertEqual(on_gpu.pop(json.dumps(load)), max(alone, wcet(infer["beside"][of_class]["gpu0"])))
        self.assertEqual(on_gpu, {})
        for word in ("max beside load of", "beside dla: emulated jobs", "max of all co-run classes"):
            self.assertIn(word, done.stdout)
        again = xauto("profile", "--platform", "small", "--read", "profile.json", cwd=self.folder)
        self.assertEqual(again.stdout, done.stdout)

    def test_real_stages_are_measured_beside_cores_and_the_apps_own_processes(self):
        self.profile("--platform", "platform.json", app=[FALLBACK, self.folder / "lock"])
        work = self.xnode("m.work")
        self.assertGreaterEqual(work["beside"]["npu"]["cpu0"]["max_us"], 20_000, "m.engine ran in another process")
        self.assertNotIn("gpu", work["beside"], "nobody computes on a real GPU here")
        self.assertIn("the app's own XNodes there", self.profiled["conditions"]["beside"]["npu"])
        self.assertIn("memory streams", self.profiled["conditions"]["beside"]["cpu"])
        self.assertIn("cpu0", work["beside"]["cpu"])
        self.assertIn("dla0", self.xnode("m.infer")["beside"]["gpu"])

    def test_a_load_that_fails_costs_its_class_and_is_named(self):
        done = self.profile("--platform", "platform.json", app=[FALLBACK, self.folder / "lock", "fails"])
        self.assertNotIn("npu", self.xnode("m.work").get("beside", {}))
        self.assertGreater(self.xnode("m.work")["on"]["cpu0"]["count"], 0)
        self.assertIn("the engine has one user", done.stderr, "the process says so")
        self.assertIn("ended (exit status 1)", done.stdout)

    def test_what_is_planned_apart_is_named_where_a_job_outruns_what_that_counts(self):
        """A GPU net of 45 ms alone, 51 beside one DLA, 59 beside two (a public report)."""
        self.write("soc.json", {"schema": "xauto.platform", "version": 1, "name": "soc", "xpus": [
            {"id": id, "type": id[:3], "preemptive": True, "preempt_us": 0, "timeslice_us": 0} for id in ("gpu0", "dla0", "dla1")]})
        names = {"detect": {"gpu": 45000}, "lane": {"dla": 17700}, "depth": {"dla": 21800}}
        app = {"schema": "xauto.app", "version": 3, "name": "report", "edges": [],
               "sources": [{"name": "camera", "period_us": 1000000, "jitter_us": 1000}],
               "xnodes": [{"name": n, "module": n, "source": "camera", "wcet_us": wcet} for n, wcet in names.items()],
               "chains": [{"name": n, "from": "camera", "to": n, "deadline_us": 52000 if n == "detect" else 100000}
                          for n in names]}

        def solve(name):
            return xauto("solve", "--app", name, "--platform", "soc.json", "--time-limit", "2s", "--out", "policy.json",
                         cwd=self.folder)

        self.write("alone.json", app)
        alone = solve("alone.json")
        self.assertEqual(alone.returncode, 0, alone.stderr)
        self.assertIn("taken  XPUs are independent", alone.stdout)
        app["xnodes"][0]["beside"] = [{"on": "gpu", "load": {"dla": 1}, "wcet_us": 51000}]
        self.write("app.json", app)
        refused = solve("app.json")
        self.assertEqual(refused.returncode, 2)
        self.assertIn("may run beside 2 dla, of which no time is stated", refused.stderr)
        app["xnodes"][0]["beside"].append({"on": "gpu", "load": {"dla": 2}, "wcet_us": 59000})
        self.write("app.json", app)
        apart = solve("app.json")
        self.assertEqual(apart.returncode, 0, apart.stderr)
        self.assertIn("detect 45.00 ms of 59.00 ms", apart.stdout)
        app["xnodes"][0]["wcet_us"] = {"gpu": 700000}
        del app["xnodes"][0]["beside"]
        self.write("slow.json", app)
        done = xauto("run", "--app", "app.json", "--platform", "soc.json", "--policy", "policy.json", "--activations", 2,
                     "--emulate", "--json", "--", BIN / "xauto-standin", "--worst", "slow.json", cwd=self.folder)
        broken = " ".join(json.loads(done.stdout)["runs"][0]["claims"]["broken"])
        self.assertIn("the plan keeps it apart from jobs on other XPUs", broken)

    def test_contended_goes_without_audit(self):
        done = self.profile("--audit", app=[CAMERA], status=2)
        self.assertIn("--contended", done.stderr)


if __name__ == "__main__":
    unittest.main()
