# SPDX-License-Identifier: Apache-2.0
"""Urgent releases at run time: who goes first, and beside which worst case. The policy's keys are written here, and
`xauto check` says that they hold: the camera's job has time until 18 ms after its release, the lidar's until 15 ms.
Where the camera's is urgent it has 10 ms less. So an ordinary one waits for the lidar's 8 ms, an urgent one does not."""
import json
import pathlib
import subprocess
import tempfile
import unittest

from common import BIN, QUEUES, XAUTO, activations, top, wait_for, xauto

KEYS = {"camera.run": 18000, "lidar.run": 15000}
BY = 10000


class Urgent(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        cls.write("platform", {"schema": "xauto.platform", "version": 1, "name": "one",
                               "xpus": [{"id": "gpu0", "type": "gpu"}]})
        cls.write("queues", {"schema": "xauto.deployment", "version": 1, "app": "urgentapp", **QUEUES})
        cls.plan("app", "policy", {"by_us": BY, "every_us": 40000})
        cls.plan("plain", "plain-policy", None)

    @classmethod
    def write(cls, name, document):
        (cls.folder / f"{name}.json").write_text(json.dumps(document))

    @classmethod
    def plan(cls, app, policy, urgent):
        source = {"period_us": 20000, "jitter_us": 1000}
        cls.write(app, {"schema": "xauto.app", "version": 3, "name": "urgentapp", "edges": [],
                        "sources": [{"name": "camera", **source, **({"urgent": urgent} if urgent else {})},
                                    {"name": "lidar", **source}],
                        "xnodes": [{"name": f"{n}.run", "module": f"{n}M", "source": n, "wcet_us": {"gpu": us}}
                                   for n, us in (("camera", 3000), ("lidar", 8000))]})
        done = cls.tool("solve", app, "--max-evaluations", 300, "--threads", 1, "--time-limit", "60s",
                        "--out", cls.folder / f"{policy}.json")
        assert done.returncode == 0, done.stdout + done.stderr
        document = json.loads((cls.folder / f"{policy}.json").read_text())
        for row in document["xnodes"]:
            for unused in ("hold_us", "start_us", "finish_us"):
                row.pop(unused, None)
            row["key_us"] = [KEYS[row["name"]]]
        for chain, name in zip(document["chains"], KEYS):
            chain.update(worst_case_us=KEYS[name], lower_bound_us=0, optimal=False)
            if "urgent_worst_case_us" in chain:
                chain["urgent_worst_case_us"] = KEYS[name] - BY
        cls.write(policy, document)

    @classmethod
    def tool(cls, verb, app, *more):
        return xauto(verb, "--app", cls.folder / f"{app}.json", "--platform", cls.folder / "platform.json", *more)

    def run_app(self, every, *flags, app="app", policy="policy", polled=()):
        done = self.tool("run", app, "--policy", self.folder / f"{policy}.json", "--emulate", "--json", "--deployment",
                         self.folder / "queues.json", *flags, "--", BIN / "urgentapp", str(every), *polled)
        return done, json.loads(done.stdout)["runs"][0] if done.stdout else None

    def test_the_policy_holds_and_is_played(self):
        done = self.tool("check", "app", "--policy", self.folder / "policy.json")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertIn("urgent", done.stdout)
        done = self.tool("simulate", "app", "--policy", self.folder / "policy.json", "--urgent", "--random-times",
                         "--jitter", "--json")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        camera = json.loads(done.stdout)["chains"][0]
        self.assertGreater(camera["urgent"]["releases"], 50)
        self.assertLessEqual(camera["urgent"]["longest_us"], KEYS["camera.run"] - BY)

    def check_run(self, *flags, polled=()):
        done, run = self.run_app(2, "--duration", "4s", *flags, polled=polled)
        self.assertEqual(done.returncode, 0, done.stderr)
        camera = run["chains"][0]
        self.assertEqual(camera["urgent_worst_case_us"], KEYS["camera.run"] - BY)
        self.assertGreater(camera["urgent_results"], 20)
        self.assertGreater(camera["results"], 1.5 * camera["urgent_results"])
        # Half of all are urgent, and the longer half is ordinary: it has waited for the lidar's 8 ms.
        self.assertGreater(camera["latency_us"]["p99"], 8000)
        self.assertLess(camera["urgent_us"]["p50"], 8000)
        self.assertLess(camera["urgent_us"]["p50"], camera["latency_us"]["p99"])
        if run["claims"]["exceeded"]:
            self.assertTrue(run["claims"]["broken"], "exceeded, and nothing was seen to be broken")
        # After a stall a message may be the release after its own: then two that are urgent are too near.
        broken = run["claims"]["broken"] or []
        if any("too soon" in line for line in broken):
            self.assertTrue([line for line in broken if "off its grid" in line or "left out" in line], broken)

    def test_an_urgent_release_goes_first(self):
        self.check_run()

    def test_so_does_one_of_a_polled_source(self):
        self.check_run(polled=["polled"])

    def test_the_mark_travels_between_processes(self):
        self.check_run("--isolate")

    def test_what_is_urgent_too_soon_is_an_ordinary_release(self):
        done, run = self.run_app(1, "--duration", "2s")
        self.assertEqual(done.returncode, 0, done.stderr)
        broken = [line for line in run["claims"]["broken"] if "too soon" in line]
        self.assertEqual(len(broken), 1, run["claims"]["broken"])
        self.assertIn("source 'camera' marked", broken[0])
        camera = run["chains"][0]
        self.assertLessEqual(camera["urgent_results"], camera["results"] / 2 + 1)
        self.assertGreater(camera["urgent_results"], 10)

    def test_the_trace_tells_which_were_urgent(self):
        trace = self.folder / "urgent.pftrace"
        done, _ = self.run_app(2, "--duration", "2s", "--trace-out", trace)
        self.assertEqual(done.returncode, 0, done.stderr)
        chains = {}
        for number in range(10, 30):
            done = xauto("explain", "--trace", trace, "--chain", "camera -> camera.run", "--activation", number,
                         "--json")
            if done.returncode == 0:
                chains[number] = json.loads(done.stdout)["chains"][0]
        self.assertGreater(len(chains), 10)
        # Every second one is; a stall may have lost a message, and with it the count.
        self.assertGreaterEqual(sum(c["urgent"] for c in chains.values()), len(chains) // 3)
        self.assertGreaterEqual(sum(not c["urgent"] for c in chains.values()), len(chains) // 3)
        told = 0
        for number, chain in chains.items():
            job = next(j for j in chain["jobs"] if j["xnode"] == "camera.run")
            # Of a release that a stall has lost the result is that of a newer one, which may be urgent where it was not.
            self.assertGreaterEqual(job["release"], number)
            if of_job := chains.get(job["release"]):
                self.assertEqual(job["key_us"] - job["released_us"], KEYS["camera.run"] - BY * of_job["urgent"])
                told += 1
        self.assertGreater(told, len(chains) // 2)

    def test_phases_of_what_is_pushed_are_its_own(self):
        """The camera is pushed: no run can say when its clock begins."""
        self.plan("apart", "apart-policy", None)
        app = json.loads((self.folder / "apart.json").read_text())
        app["clocks"] = [{"name": "camera", "ppm": 50}]
        app["sources"][0]["clock"] = "camera"
        self.write("apart", app)
        done = self.tool("solve", "apart", "--max-evaluations", 300, "--time-limit", "60s", "--out", self.folder / "apart-policy.json")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        done, _ = self.run_app(1_000_000, "--duration", "1s", "--phases", app="apart", policy="apart-policy")
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("all clocks but the first are those of what is pushed or fed", done.stderr)
        done, run = self.run_app(1_000_000, "--duration", "1s", "--phases", app="apart", policy="apart-policy", polled=["polled"])
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertTrue([note for note in run["notes"] if note.startswith("clock 'camera' began")], run["notes"])

    def plan_marks(self, app, by):
        """look.run, due at 4 ms, says whether what it has seen is urgent: then camera.run, due at 18 ms, is due at 8."""
        keys = {"look.run": 4000, **KEYS}
        source = {"period_us": 20000, "jitter_us": 1000}
        urgent = {"by_us": BY, "every_us": 40000, "marked_by": by}
        self.write(app, {"schema": "xauto.app", "version": 3, "name": "urgentapp", "edges": [["look.run", "camera.run"]],
                         "sources": [{"name": "camera", **source, "urgent": urgent}, {"name": "lidar", **source}],
                         "xnodes": [{"name": "look.run", "module": "lookM", "source": "camera", "wcet_us": {"gpu": 1000}},
                                    {"name": "camera.run", "module": "cameraM", "wcet_us": {"gpu": 3000}},
                                    {"name": "lidar.run", "module": "lidarM", "source": "lidar", "wcet_us": {"gpu": 8000}}]})
        done = self.tool("solve", app, "--max-evaluations", 300, "--threads", 1, "--time-limit", "60s", "--out",
                         self.folder / f"{app}-policy.json")
        if done.returncode != 0:
            return done
        policy = json.loads((self.folder / f"{app}-policy.json").read_text())
        for row in policy["xnodes"]:
            for unused in ("hold_us", "start_us", "finish_us"):
                row.pop(unused, None)
            row["key_us"] = [keys[row["name"]]]
        for chain, name in zip(policy["chains"], KEYS):
            chain.update(worst_case_us=keys[name], lower_bound_us=0, optimal=False)
            if "urgent_worst_case_us" in chain:
                chain["urgent_worst_case_us"] = keys[name] - BY
        self.write(f"{app}-policy", policy)
        return self.tool("check", app, "--policy", self.folder / f"{app}-policy.json")

    def test_a_module_marks_what_it_has_seen_and_those_behind_it_are_sooner(self):
        done = self.plan_marks("marks", "lookM")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        for flags in ([], ["--isolate"]):
            trace = self.folder / "marks.pftrace"
            done, run = self.run_app(3, "--duration", "3s", "--trace-out", trace, *flags, app="marks", policy="marks-policy",
                                     polled=["marks"])
            self.assertEqual(done.returncode, 0, done.stderr)
            camera = run["chains"][0]
            self.assertEqual(camera["urgent_worst_case_us"], KEYS["camera.run"] - BY)
            self.assertGreater(camera["urgent_results"], 20)
            self.assertGreater(camera["results"], 2 * camera["urgent_results"])
            self.assertLess(camera["urgent_us"]["p50"], 8000, "an ordinary one waits for the lidar's 8 ms")
            self.assertGreater(camera["latency_us"]["p99"], 8000)
        keys = {}
        for number in range(10, 40):
            done = xauto("explain", "--trace", trace, "--chain", "camera -> camera.run", "--activation", number, "--json")
            if done.returncode == 0:
                chain = json.loads(done.stdout)["chains"][0]
                for job in chain["jobs"]:
                    keys.setdefault((job["xnode"], chain["urgent"]), set()).add(job["key_us"] - job["released_us"])
        self.assertEqual(keys["camera.run", True], {KEYS["camera.run"] - BY})
        self.assertEqual(keys["camera.run", False], {KEYS["camera.run"]})
        self.assertEqual(keys["look.run", True], {4000}, "it had run before it was known")

    def test_what_a_module_marks_and_nobody_states_is_ordinary_and_told(self):
        self.plan_marks("marks", "lookM")
        done = self.plan_marks("nobody", "lidarM")
        self.assertEqual(done.returncode, 2)
        self.assertIn("module 'lidarM' does not hear of source 'camera' by edges", done.stderr)
        app = json.loads((self.folder / "marks.json").read_text())
        del app["sources"][0]["urgent"]
        self.write("unmarked", app)
        done = self.tool("solve", "unmarked", "--max-evaluations", 300, "--threads", 1, "--time-limit", "60s", "--out",
                         self.folder / "unmarked-policy.json")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        done, run = self.run_app(1, "--activations", 20, app="unmarked", policy="unmarked-policy", polled=["marks"])
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertRegex(" ".join(run["notes"]), r"XModule 'lookM' marked \d+ results urgent, which nothing certifies")

    def test_without_a_statement_it_is_refused(self):
        done, _ = self.run_app(2, "--duration", "1s", app="plain", policy="plain-policy")
        self.assertIn("nothing certifies that in this run", done.stderr)
        self.assertIn('"urgent": {"by_us", "every_us"}', done.stderr)

    def test_top_has_them_beside_their_own_worst_case(self):
        tool = subprocess.Popen(
            [XAUTO, "run", *(part for name in ("app", "platform", "policy", "deployment") for part in (
                f"--{name}", str(self.folder / f"{'queues' if name == 'deployment' else name}.json"))),
             "--emulate", "--activations", "0", "--", str(BIN / "urgentapp"), "2", "polled"],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            wait_for("results", lambda: activations(tool).get("cameraM", 0) > 20, tool)
            one = top(tool)
            words = xauto("top", "--run", f"{tool.pid}-0", "--once", "--interval", "50ms").stdout
            runs = json.loads(xauto("top", "--once", "--json").stdout)["runs"]
        finally:
            tool.terminate()
            tool.communicate(timeout=60)
        own = [of for of in runs if of["run"] == f"{tool.pid}-0"]
        for camera, lidar in (one["chains"], own[0]["chains"]):
            self.assertEqual(camera["urgent"]["worst_case_us"], KEYS["camera.run"] - BY)
            self.assertLessEqual(3000, camera["urgent"]["longest_us"])
            self.assertLessEqual(camera["urgent"]["longest_us"], camera["longest_us"])
            self.assertNotIn("urgent", lidar)
        self.assertRegex(words, r"\n    urgent +\d+\.\d\d +\*?8\.00\n")

    def test_of_a_polled_source_it_is_told(self):
        done, run = self.run_app(2, "--activations", 20, app="plain", policy="plain-policy", polled=["polled"])
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("source 'camera' marked 10 releases urgent, which nothing certifies", " ".join(run["notes"]))


if __name__ == "__main__":
    unittest.main()
