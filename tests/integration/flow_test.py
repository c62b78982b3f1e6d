# SPDX-License-Identifier: Apache-2.0
"""The whole way: record, profile, solve, check, simulate, run, compare, status. Times are not judged here,
except that the simulator must give the published latencies of the Driving Case."""
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

import pftrace
from common import APP, BIN, DRIVING, SOURCE, XAUTO, wait_for, xauto


RATES = str(pathlib.Path(APP).with_name("rates.json"))
GOLDEN = pathlib.Path(__file__).resolve().parents[1] / "golden"


def load(path):
    return json.loads(pathlib.Path(path).read_text())


class Flow(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)

    def path(self, name):
        return os.path.join(self.folder.name, name)

    def good(self, *arguments, **keywords):
        result = xauto(*arguments, **keywords)
        self.assertEqual(result.returncode, 0, result.stderr)
        return result.stdout

    def test_an_xpu_that_preempts_by_levels(self):
        """Nobody suspends its jobs: each is put on a level of the hardware, and the order is kept."""
        def platform(levels):
            xpus = [{"id": f"cpu{i}", "type": "cpu"} for i in range(4)]
            xpus.append({"id": "gpu0", "type": "gpu", "preempt_us": 275, "timeslice_us": 1000, "levels": levels})
            text = json.dumps({"schema": "xauto.platform", "version": 1, "name": "levels", "xpus": xpus})
            pathlib.Path(self.path("levels.json")).write_text(text)
            return ["--app", APP, "--platform", self.path("levels.json")]

        rates = ["--app", RATES, "--platform", self.path("levels.json"), "--policy", self.path("keys.json")]
        for levels in 3, 16:
            platform(levels)
            self.good("solve", *rates[:4], "--max-evaluations", 500, "--threads", 1, "--time-limit", "60s", "--out", rates[5])
            self.good("check", *rates)
            self.good("simulate", *rates, "--duration", "1s")
        self.good("solve", *platform(3), "--method", "heft", "--out", self.path("p.json"))
        self.good("check", *platform(3), "--policy", self.path("p.json"))
        self.good("solve", "--app", APP, "--platform", "core-ultra", "--max-evaluations", 2000, "--threads", 1,
                  "--time-limit", "60s", "--out", self.path("intel.json"))
        self.good("check", "--app", APP, "--platform", "core-ultra", "--policy", self.path("intel.json"))
        run = json.loads(self.good("run", *platform(3), "--policy", self.path("p.json"), "--emulate", "--lockstep",
                                   "--activations", 20, "--trace-out", self.path("t.pftrace"), "--json", "--",
                                   DRIVING))["runs"][0]
        self.assertTrue(run["complete"])
        self.assertEqual(run["lost_activations"], 0)
        self.assertFalse({"misplaced_job", "held_up_job"} & {a["kind"] for a in run["claims"]["assumptions"]})
        trace = pftrace.Trace(pathlib.Path(self.path("t.pftrace")).read_bytes())
        there = {x["name"] for x in load(self.path("p.json"))["xnodes"] if x["xpu"] == "gpu0"}
        parts = {s.args["part"] for s in trace.on("run", "run") if s.name.split(" ")[0] in there}
        self.assertEqual(parts, {1}, "nobody was suspended")

    def test_tables_for_scenarios(self):
        """Several policies: what the file says of each scenario is true, and is checked."""
        clocks = [{"name": f"gpu {g}", "wcet_scale_pct": {"gpu": g, "dla": 100}} for g in (100, 150, 200)]
        document = {"schema": "xauto.scenarios", "version": 1, "app": "driving", "scenarios": clocks + [{"name": "no DLA", "lost": ["dla0"]}]}
        pathlib.Path(self.path("scenarios.json")).write_text(json.dumps(document))
        asked = ["--app", APP, "--platform", "small", "--scenarios", self.path("scenarios.json")]
        limits = ["--max-evaluations", 1000, "--threads", 1, "--time-limit", "100s"]
        told = json.loads(self.good("solve", *asked, "--tables", 2, *limits, "--out", self.path("t.json"), "--json"))
        tables = load(self.path("t.json"))
        self.assertLessEqual(len(tables["tables"]), 2)
        self.assertEqual([s["scenario"] for s in tables["serves"]], [s["name"] for s in document["scenarios"]])
        by_name = {t["name"]: t for t in tables["tables"]}

        def regret(serve):
            """All chains have one deadline."""
            claims = {c["name"]: c["worst_case_us"] for c in by_name[serve["table"]]["chains"]}
            worst = max(c.get("worst_case_us", claims[c["name"]]) for c in serve["chains"])
            return worst / max(serve.get("lower_bound_us", 0), *(c["lower_bound_us"] for c in serve["chains"]))
        worst = max(map(regret, tables["serves"]))
        self.assertAlmostEqual(told["worst_regret"], worst)
        self.assertLess(worst, 1.5)
        without = next(s for s in tables["serves"] if s["scenario"] == "no DLA")
        self.assertNotIn("dla0", {x["xpu"] for x in by_name[without["table"]]["xnodes"]})
        check = ["check", "--app", APP, "--platform", "small", "--policy", self.path("t.json")]
        self.assertIn("tells the truth", self.good(*check))
        longest = max(tables["serves"][1]["chains"], key=lambda c: c.get("worst_case_us", 0))
        longest["worst_case_us"] -= 1
        pathlib.Path(self.path("t.json")).write_text(json.dumps(tables))
        lie = xauto(*check)
        self.assertEqual(lie.returncode, 1, lie.stdout)
        self.assertIn("scenario 'gpu 150'", lie.stdout)
        profile = load(GOLDEN / "profile-sources.json")
        for name, times in ("full", 1), ("throttled", 2):
            for xnode in profile["xnodes"]:
                for samples in xnode["on"].values():
                    samples["max_us"] *= times
            pathlib.Path(self.path(name + ".json")).write_text(json.dumps(profile))
        bench = ["--platform", GOLDEN / "platform.json"]
        self.good("profile", *bench, "--merge", self.path("full.json"), self.path("throttled.json"), "--out", self.path("m.json"))
        merged = load(self.path("m.json"))["scenarios"]
        self.assertEqual([s["name"] for s in merged], ["full", "throttled"])
        self.good("profile", *bench, "--read", self.path("full.json"), "--app-out", self.path("ma.json"))
        self.good("solve", "--app", self.path("ma.json"), *bench, "--scenarios", self.path("m.json"), "--regret", 1.5, "--out",
                  self.path("mt.json"), *limits)
        self.good("check", "--app", self.path("ma.json"), *bench, "--policy", self.path("mt.json"))
        self.assertEqual(xauto("profile", *bench, "--merge", self.path("full.json"), "--read", self.path("full.json")).returncode, 2)
        for wrong in ((["--tables", 2], ["--regret", 1.1]), (["--method", "heft"], asked[4:] + ["--tables", 1]), ([], asked[4:]),
                      (["--method", "heft"], ["--objective", "sum"])):
            refused = xauto("solve", "--app", APP, "--platform", "small", *wrong[0], *wrong[1])
            self.assertEqual(refused.returncode, 2, refused.stdout)
        refused = xauto("solve", "--app", RATES, *asked[2:], "--tables", 1)
        self.assertEqual(refused.returncode, 2, refused.stdout)

    def test_driving_case_gives_the_published_latencies(self):
        published = {"heft": 30_100, "auto": 26_100}
        for method, latency in published.items():
            told = json.loads(self.good("solve", "--app", APP, "--platform", "small", "--method", method, "--json",
                                        "--time-limit", "60s", "--out", self.path("p.json")))  # it is proven optimal long before
            self.good("check", "--app", APP, "--platform", "small", "--policy", self.path("p.json"))
            took = told["release_us"] if method == "heft" else max(c["worst_case_us"] for c in told["chains"])
            self.assertLess(abs(took - latency) / latency, 0.05, method)
        self.assertTrue(told["objective"]["largest"]["optimal"])
        placed = {x["name"]: x["xpu"] for x in load(self.path("p.json"))["xnodes"]}
        self.assertEqual([n for n, x in sorted(placed.items()) if x == "dla0"], ["fcd.infer", "td.infer"])

    def test_record_profile_solve_run(self):
        solve = ["--platform", "small", "--method", "heft"]
        self.good("solve", "--app", APP, *solve, "--out", self.path("p.json"))
        self.good("run", "--app", APP, "--policy", self.path("p.json"), "--platform", "small", "--emulate",
                  "--activations", 8, "--lockstep", "--record", self.path("drive.mcap"), "--", DRIVING)
        info = json.loads(self.good("recording", "info", self.path("drive.mcap"), "--json"))
        self.assertEqual({t["name"]: t["messages"] for t in info["topics"]},
                         {"/camera/front": 8, "/camera/rear": 8, "/lidar/top": 8, "/xauto/releases": 8})

        self.good("profile", "--platform", "small", "--emulate", "--input", self.path("drive.mcap"),
                  "--warmup", 1, "--repetitions", 4, "--out", self.path("profile.json"),
                  "--app-out", self.path("app.json"), "--", DRIVING)
        profile = load(self.path("profile.json"))
        declared = {x["name"]: x["wcet_us"] for x in load(APP)["xnodes"]}
        for xnode in profile["xnodes"]:
            for xpu, samples in xnode["on"].items():
                self.assertEqual(samples["count"], 4)
                self.assertGreaterEqual(samples["min_us"], declared[xnode["name"]][xpu[:3]])

        app = self.path("app.json")
        # With which periods the app was built, and who hears of which source, as far as nobody comes before.
        spec = load(app)
        sensors = {t: 60000 for t in ("camera/front", "camera/rear", "lidar/top")}
        self.assertEqual({s["name"]: s["period_us"] for s in spec["sources"]}, sensors)
        self.assertEqual([s["name"] for s in spec["sources"]], [s["name"] for s in profile["sources"]])
        roots = {x["name"] for x in spec["xnodes"]} - {v for _, v in spec["edges"]}
        self.assertEqual({x["name"] for x in spec["xnodes"] if "source" in x}, roots)
        self.good("solve", "--app", app, *solve, "--out", self.path("p2.json"))
        report = json.loads(self.good("run", "--app", app, "--policy", self.path("p2.json"), "--platform",
                                      "small", "--emulate", "--input", self.path("drive.mcap"), "--json", "--lockstep",
                                      "--page", self.path("t.html"), "--", DRIVING))
        run = report["runs"][0]
        self.assertEqual((run["activations"], run["lost_activations"], run["complete"]), (8, 0, True))
        self.assertEqual(run["trace_events_lost"], 0)
        self.assertIn("fcd.infer", pathlib.Path(self.path("t.html")).read_text())

    def test_stale_policy_is_refused(self):
        self.good("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", self.path("p.json"))
        changed = load(APP)
        changed["xnodes"][0]["wcet_us"]["cpu"] += 1
        pathlib.Path(self.path("app.json")).write_text(json.dumps(changed))
        result = xauto("run", "--app", self.path("app.json"), "--policy", self.path("p.json"), "--", DRIVING)
        self.assertEqual(result.returncode, 2)
        self.assertIn("the policy was made for another version of the app", result.stderr)

    def test_a_policy_of_priorities_is_not_explained(self):
        self.good("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", self.path("p.json"))
        result = xauto("explain", "--app", APP, "--platform", "small", "--policy", self.path("p.json"))
        self.assertEqual((result.returncode, result.stdout), (2, ""))
        self.assertIn("has priorities: nothing is planned or claimed by them\n  hint: `xauto simulate`, and `xauto explain "
                      "--trace` of a run, show what happens", result.stderr)

    def test_app_of_another_graph_is_refused(self):
        self.good("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", self.path("p.json"))
        result = xauto("run", "--app", APP, "--policy", self.path("p.json"), "--emulate", "--", BIN / "camera")
        self.assertEqual(result.returncode, 2)
        self.assertIn("XNode 'camera.preprocess' is not in app.json", result.stderr)

    def test_program_that_is_no_app(self):
        self.good("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", self.path("p.json"))
        result = xauto("run", "--app", APP, "--policy", self.path("p.json"), "--emulate", "--", "true")
        self.assertEqual(result.returncode, 1)
        self.assertIn("true: ended without an answer (exit status 0)", result.stderr)

    def test_compare_writes_report_and_page(self):
        self.good("compare", "--app", APP, "--platform", "small", "--emulate", "--activations", 5, "--lockstep",
                  "--time-limit", "1s", "--out", self.path("out"), "--", DRIVING)
        runs = load(self.path("out/report.json"))["runs"]
        self.assertEqual([r["policy"] for r in runs], ["ros2", "heft", "xauto", "xauto-unscheduled"])
        for run in runs:
            self.assertEqual(run["activations"], 5)
            self.assertGreater(run["p50_us"], 0)
        page = pathlib.Path(self.path("out/report.html")).read_text()
        self.assertNotIn("http://", page)
        self.assertNotIn("https://", page)

    def start(self, *before):
        """A run without an end under HEFT, which preempts on the GPU."""
        self.good("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", self.path("p.json"))
        run = subprocess.Popen([*before, XAUTO, "run", "--app", APP, "--policy", self.path("p.json"), "--platform", "small",
                                "--emulate", "--activations", "0", "--", DRIVING],
                               stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

        def end():
            run.terminate()
            run.communicate(timeout=60)
        self.addCleanup(end)
        return run

    def all_runs(self):
        return {run["run"]: run for run in json.loads(self.good("top", "--once", "--json", "--interval", "50ms"))["runs"]}

    def test_one_look_tells_who_runs(self):
        run = self.start()
        seen = set()

        def both():
            seen.update(w["state"] for xpu in self.all_runs().get(f"{run.pid}-0", {"xpus": []})["xpus"] for w in xpu["workers"])
            return {"running", "suspended"} <= seen
        wait_for("somebody who runs, and somebody who is suspended", both, run)
        run.terminate()
        run.communicate(timeout=60)
        self.assertNotIn(f"{run.pid}-0", self.all_runs())

    def test_generated_apps_pass_the_whole_chain(self):
        for seed in (1, 2):
            self.good("generate", "--nodes", 15, "--seed", seed, "--out", self.path("g.json"))
            for method in ("local", "heft", "search", "auto"):
                self.good("solve", "--app", self.path("g.json"), "--platform", "large", "--method", method,
                          "--time-limit", "0.2s", "--out", self.path("g.policy.json"))
                self.good("check", "--app", self.path("g.json"), "--platform", "large", "--policy",
                          self.path("g.policy.json"))

    def test_a_generated_app_runs_by_its_stand_in(self):
        app, policy = self.path("g.json"), self.path("g.policy.json")
        said = self.good("generate", "--nodes", 12, "--seed", 5, "--out", app)
        self.assertIn("-- xauto-standin", said)
        self.good("solve", "--app", app, "--platform", "small", "--time-limit", "1s", "--out", policy)
        wcets = {x["name"]: x["wcet_us"] for x in load(app)["xnodes"]}
        for words, least in (((), 0.6), (("--worst",), 1), (("--seed", 7, "--slack", "300us"), 0.25)):
            # In another folder: the stand-in is found beside the tool.
            report = json.loads(self.good("run", "--app", app, "--policy", policy, "--emulate", "--json", "--activations", 4,
                                          "--", "xauto-standin", app, *words))
            run = report["runs"][0]
            self.assertEqual((run["activations"], run["lost_activations"]), (4, 0))
            self.assertEqual([c["results"] for c in run["chains"]], [4] * len(load(app).get("chains", [0])))
            for xnode in run["limited_xnodes"]:
                wcet = wcets[xnode["name"]][run["placement"][xnode["name"]].rstrip("0123456789")]
                self.assertGreaterEqual(xnode["wcet_us"], wcet)  # a preemption that it may pay for is on top
                self.assertGreaterEqual(xnode["longest_us"], int(least * wcet) - 300 * (len(words) > 1), (words, xnode))
            claims = run["claims"]
            self.assertTrue(not claims["exceeded"] or claims["broken"], claims)
            if least == 0.6 and not claims["broken"]:  # nobody outran its WCET: the machine did not stall
                self.assertTrue(claims["verdict"].startswith("kept"), claims)

    def test_a_stand_in_refuses_what_no_program_has(self):
        def run(edit):
            app = {"schema": "xauto.app", "version": 3, "name": "odd", "sources": [{"name": "s"}],
                   "xnodes": [{"name": n, "module": m, "wcet_us": {"cpu": 1000}} | ({"source": "s"} if n == "a1" else {})
                              for n, m in (("a1", "A"), ("a2", "A"), ("b1", "B"))], "edges": [["a1", "a2"], ["a1", "b1"]]}
            edit(app)
            pathlib.Path(self.path("odd.json")).write_text(json.dumps(app))
            return subprocess.run([BIN / "xauto-standin", self.path("odd.json")], capture_output=True, text=True)
        done = run(lambda app: None)
        self.assertEqual(done.returncode, 2)
        self.assertIn("no program has an edge or sample like that from 'a1' to 'b1'", done.stderr)
        self.assertIn("version", run(lambda app: app.update(version=99)).stderr)

    def test_compares_with_the_best_schedule_on_the_fastest_xpus(self):
        app = json.loads(pathlib.Path(APP).read_text())
        fastest = {x["name"]: min(x["wcet_us"], key=x["wcet_us"].get) for x in app["xnodes"]}
        flags = ("--app", APP, "--platform", "small", "--time-limit", "5s", "--out")
        self.good("compare", *flags, self.path("out"), "--policies", "local", "--activations", 2, "--", DRIVING)
        made = load(self.path("out/local.policy.json"))
        self.assertEqual({x["name"]: x["xpu"].rstrip("0123456789") for x in made["xnodes"]}, fastest)
        # The solver itself, told where: no schedule of this assignment is shorter.
        pins = [word for name, xpu in fastest.items() for word in ("--pin", f"{name}={xpu}")]
        self.good("solve", *flags, self.path("pinned.json"), *pins)
        asked = load(self.path("pinned.json"))
        worst = [max(c["worst_case_us"] for c in p["chains"]) for p in (made, asked)]
        self.assertEqual(worst[0], worst[1])
        self.assertLess(worst[0], 35670, "what a greedy schedule of it takes; none is shorter than 34675")

    def test_help_of_every_verb_shows_an_example(self):
        verbs = ["doctor", "generate", "import", "whatif", "split", "profile", "solve", "simulate", "check", "run", "compare", "top",
                 "recording", "explain", "graph"]
        for verb in verbs:
            self.assertIn("Example:\n  ", self.good(verb, "--help"), verb)

    def test_what_is_mistyped_is_named_with_what_was_meant(self):
        for words, said in ((["record", "info", "x"], "there is no verb 'record'; did you mean 'recording'?"),
                            (["slove"], "there is no verb 'slove'; did you mean 'solve'?"),
                            (["solve", "--ap", "a.json"], "--ap is no option of solve; did you mean --app?"),
                            (["run", "--polic", "x"], "--polic is no option of run; did you mean --policy?"),
                            (["solve", "-app", "a.json"], "-app is no option of solve; did you mean --app?"),
                            (["status"], "there is no verb 'status'\n")):
            done = xauto(*words)
            self.assertEqual(done.returncode, 2)
            self.assertIn(said, done.stderr)

    def test_what_is_installed_is_made_of_the_help(self):
        made = pathlib.Path(self.path("help"))
        subprocess.run([sys.executable, SOURCE / "packaging/from-help.py", BIN, made], check=True)
        self.assertEqual(subprocess.run(["bash", "-n", made / "completions/xauto"]).returncode, 0)
        verbs = self.completed("xauto", "")
        self.assertLess({"solve", "run", "doctor"}, verbs)
        self.assertEqual({page.stem for page in (made / "man1").iterdir()}, {"xauto"} | {f"xauto-{verb}" for verb in verbs})
        self.assertIn("\\-\\-policy", (made / "man1/xauto-run.1").read_text())

    def completed(self, *words):
        made = pathlib.Path(self.path("help/completions/xauto"))
        if not made.exists():
            subprocess.run([sys.executable, SOURCE / "packaging/from-help.py", BIN, self.path("help")], check=True)
        script = made.read_text()
        line = " ".join(f"'{word}'" for word in words)
        reply = subprocess.run(["bash", "-c", f"{script}\nCOMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _xauto; "
                                'printf "%s\\n" "${COMPREPLY[@]}"'], capture_output=True, text=True,
                               cwd=self.folder.name)
        self.assertEqual(reply.stderr, "")
        return set(reply.stdout.split())

    def test_completion_offers_values_and_stops_behind_the_dashes(self):
        self.assertEqual(self.completed("xauto", "solve", "--method", ""),
                         {"auto", "search", "ilp", "heft", "local"})
        self.assertEqual(self.completed("xauto", "solve", "--method", "he"), {"heft"})
        self.assertEqual(self.completed("xauto", "run", "--platform", "s"), {"small"})
        self.assertEqual(self.completed("xauto", "run", "--overload", ""), {"newest", "skip", "queue:"})
        self.assertEqual(self.completed("xauto", "run", "--scheduling", "t"), {"timeshare"})
        self.assertIn("--policy", self.completed("xauto", "run", "--app", "a", "--p"))
        self.assertEqual(self.completed("xauto", "run", "--app", "a", "--", "prog", "--p"), set())
        pathlib.Path(self.path("small.json")).write_text("{}")
        self.assertEqual(self.completed("xauto", "run", "--platform", "s"), {"small", "small.json"})
        self.assertEqual(self.completed("xauto", "solve", "--method", "s"), {"search"}, "no file is a method")

    def test_an_app_tells_what_it_is_and_who_starts_it(self):
        for flag in ("--help", "-h"):
            answer = subprocess.run([DRIVING, flag], capture_output=True, text=True, timeout=60)
            self.assertEqual((answer.returncode, answer.stderr), (0, ""))
            self.assertIn("driving: an app for XAuto", answer.stdout)
            for word in ("FCD", "camera/front", f"xauto run --app app.json --platform small --policy policy.json -- {DRIVING}"):
                self.assertIn(word, answer.stdout)

    def test_a_run_is_called_by_its_policys_file_or_by_name(self):
        self.good("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", self.path("night.json"))
        run = ["run", "--app", APP, "--policy", self.path("night.json"), "--platform", "small", "--emulate",
               "--lockstep", "--activations", 3]
        answer = self.good(*run, "--out", self.path("r.json"), "--", DRIVING)
        self.assertRegex(answer, r"(?m)^  night +\d")
        report = load(self.path("r.json"))["runs"][0]
        self.assertEqual((report["policy"], report["name"]), ("night", "night"))
        self.assertRegex(self.good(*run, "--name", "as it was", "--", DRIVING), r"(?m)^  as it was +\d")

    def test_a_comparison_says_how_far_each_run_is_spread(self):
        answer = self.good("compare", "--app", APP, "--platform", "small", "--emulate", "--activations", 6, "--lockstep",
                           "--policies", "heft,ros2", "--out", self.path("out"), "--", DRIVING)
        self.assertIn("One run each.", answer)
        runs = {r["name"]: r for r in load(self.path("out/report.json"))["runs"]}
        for name, run in runs.items():
            self.assertLessEqual(run["p10_us"], run["p50_us"])
            self.assertLessEqual(run["p50_us"], run["p90_us"])
            self.assertIn(f"{run['p10_us'] / 1000:.2f} to", next(
                line for line in answer.splitlines() if line.startswith("  " + name) and " to " in line))
        heft, ros2 = runs["HEFT"], runs["ROS 2 model"]
        apart = not (heft["p10_us"] <= ros2["p50_us"] <= heft["p90_us"] and
                     ros2["p10_us"] <= heft["p50_us"] <= ros2["p90_us"])
        self.assertEqual("the difference is noise" in answer, not apart, answer)

    def test_one_look_tells_of_another_users_run(self):
        if os.geteuid() != 0:
            self.skipTest("no right to become another user")
        run = self.start()
        said = (r"not seen: coordinator pid \d+ of root answers only that user and root; `sudo xauto top --once` asks it")
        answer = lambda: subprocess.run([XAUTO, "top", "--once"], capture_output=True, text=True, user=65534, group=65534,
                                        cwd="/").stdout
        wait_for(said, lambda: re.search(said, answer()), run)
        self.assertNotIn("no app is running", answer())

    def test_one_look_tells_of_a_run_that_it_cannot_ask(self):
        """A coordinator's program under our name in a network namespace of its own."""
        new = subprocess.run(["unshare", "--net", "true"], capture_output=True)
        if new.returncode != 0:
            self.skipTest("no right to make a network namespace")
        run = self.start("unshare", "--net")
        said = (r"not seen: coordinator pid (\d+) of \S+ is in another network namespace; "
                r"`sudo nsenter -t \d+ -n xauto top --once`")
        pid = wait_for(said, lambda: re.search(said, self.good("top", "--once")), run).group(1)
        self.assertNotIn("no app is running", self.good("top", "--once"))
        there = subprocess.run(["nsenter", "-t", pid, "-n", XAUTO, "top", "--once"], capture_output=True, text=True)
        self.assertIn("coordinator pid " + pid, there.stdout)

    def test_doctor(self):
        findings = {f["id"]: f for f in json.loads(self.good("doctor", "--json"))["findings"]}
        for name in ("kernel", "realtime", "sched_ext", "xauto.ko", "gpu", "dla", "cores"):
            self.assertIn(findings[name]["state"], ("ok", "degraded", "missing"))


if __name__ == "__main__":
    unittest.main()
