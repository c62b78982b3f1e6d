#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`xauto run --fail-on`: each word trips on what it names, and on nothing else."""
import json
import os
import pathlib
import signal
import subprocess
import tempfile
import unittest

from common import BIN, SOURCE, TESTAPP, XAUTO, activations, children_of, testapp_files, wait_for, xauto


class Gate(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def run_app(self, words, *app, deployment=None, **of_app):
        """In lockstep, so that nothing is lost but what `app` loses."""
        files = testapp_files(self.folder, deployment, **of_app)
        fail_on = ["--fail-on", words] if words else []
        done = xauto("run", *files, "--activations", 20, "--lockstep", "--json", *fail_on, "--", TESTAPP,
                     os.path.join(self.folder, "result"), *app)
        return done, json.loads(done.stdout)["runs"][0] if done.stdout else None

    def test_a_missed_deadline(self):
        slow = ["slow", "B", 0, 30]  # ms, every job
        done, run = self.run_app("", *slow, deadline_us=20_000)
        self.assertEqual((done.returncode, run["lost_activations"]), (0, 0), done.stderr)
        self.assertNotIn("fail_on", run)
        done, run = self.run_app("lost,miss", *slow, deadline_us=20_000)
        self.assertEqual(done.returncode, 1)
        self.assertEqual(run["fail_on"], {"miss": 20, "lost": 0})  # all: 30 ms are more than 20
        self.assertIn("--fail-on miss: 20 ", done.stderr)
        self.assertNotIn("--fail-on lost", done.stderr)
        done, run = self.run_app("miss", deadline_us=3_600_000_000)
        self.assertEqual((done.returncode, run["fail_on"]), (0, {"miss": 0}), done.stderr)

    def test_a_lost_activation(self):
        done, run = self.run_app("lost", "throw", "A", 3)
        self.assertEqual((done.returncode, run["fail_on"], run["lost_activations"]), (1, {"lost": 1}, 1), done.stderr)
        self.assertIn("--fail-on lost: 1 ", done.stderr)
        done, run = self.run_app("lost")
        self.assertEqual((done.returncode, run["fail_on"]), (0, {"lost": 0}), done.stderr)

    def test_status_1_says_why(self):
        done, run = self.run_app("", "throw", "A", 3)
        self.assertEqual((done.returncode, run["lost_activations"]), (1, 1), done.stderr)
        self.assertIn("error: run policy: 1 of 20 activations were lost (of XModule A: 1 failed, 0 dropped; "
                      "C: 0 failed, 1 dropped)\n", done.stderr)
        # B needs 50 ms for each of what comes every 10 ms.
        done = xauto("run", *testapp_files(self.folder, period_us=10_000), "--activations", 200, "--json", "--",
                     TESTAPP, os.path.join(self.folder, "result"), "slow", "B", 0, 50)
        lost = json.loads(done.stdout)["runs"][0]["lost_activations"]
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertIn(f"error: run policy: {lost} of 200 activations were lost", done.stderr)
        self.assertIn("--overload queue:8", done.stderr)

    def test_a_hang(self):
        limit = {"modules": {"D": {"hang_us": 300_000, "on_hang": "log"}}}
        done, run = self.run_app("hang", "hang", "D", 3, 700, deployment=limit)
        hangs = next(x["hangs"] for x in run["limited_xnodes"] if x["name"] == "d1")
        self.assertGreaterEqual(hangs, 1)  # a machine that stalls makes more of them
        self.assertEqual((done.returncode, run["fail_on"]), (1, {"hang": hangs}), done.stderr)
        self.assertIn(f"--fail-on hang: {hangs} ", done.stderr)
        limit["modules"]["D"]["hang_us"] = 3_600_000_000
        done, run = self.run_app("hang", deployment=limit)
        self.assertEqual((done.returncode, run["fail_on"]), (0, {"hang": 0}), done.stderr)

    def test_a_coordinator_that_was_started_again(self):
        files = testapp_files(self.folder, period_us=20_000)

        def coordinators(tool):
            return {pid for pid, name in children_of(tool.pid).items() if name == "xauto-coordinat"}

        for words, status in ([], 0), (["--fail-on", "restart,lost"], 1):  # what queues meanwhile is not lost
            tool = subprocess.Popen([XAUTO, "run", *files, "--activations", "0", "--overload", "queue:256", "--json",
                                     *words, "--", TESTAPP, os.path.join(self.folder, "result")],
                                    stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            self.addCleanup(tool.kill)
            wait_for("results", lambda: activations(tool).get("C", 0) > 2, tool)
            before = coordinators(tool)
            victim = min(before)
            os.kill(victim, signal.SIGKILL)
            wait_for("another coordinator", lambda: len(coordinators(tool) - {victim}) == len(before), tool)
            done = activations(tool).get("C", 0)
            wait_for("results", lambda: activations(tool).get("C", 0) > done + 2, tool)
            tool.terminate()
            out, err = tool.communicate(timeout=60)
            self.assertEqual(tool.returncode, status, err)
            if words:
                self.assertEqual(json.loads(out)["runs"][0]["fail_on"], {"lost": 0, "restart": 1})
                self.assertIn("--fail-on restart: 1 ", err)

    def test_a_worst_case_that_is_exceeded(self):
        done, run = self.run_app("claim", "slow", "B", 0, 200)
        exceeded = [chain["name"] for chain in run["chains"] if chain["exceeded"]]
        self.assertIn("src -> c1", exceeded)  # a machine that stalls makes more of them
        self.assertEqual((done.returncode, run["fail_on"]), (1, {"claim": len(exceeded)}), done.stderr)
        self.assertIn(f"--fail-on claim: {len(exceeded)} ", done.stderr)

    def rates(self):
        app, policy = SOURCE / "examples/driving/rates.json", f"{self.folder}/s.json"
        made = xauto("solve", "--app", app, "--platform", "small", "--time-limit", "1s", "--out", policy)
        self.assertEqual(made.returncode, 0, made.stderr)
        return app, policy

    def test_deadlines_of_chains(self):
        """Each chain has its own, and the app has none."""
        app, policy, script = (f"{self.folder}/{name}.json" for name in ("app", "p", "script"))
        spec = json.loads((SOURCE / "examples/driving/rates.json").read_text())

        def solved():
            pathlib.Path(app).write_text(json.dumps(spec))
            made = xauto("solve", "--app", app, "--platform", "small", "--time-limit", "2s", "--out", policy)
            self.assertEqual(made.returncode, 0, made.stderr)

        for of_clock, status in (10, 1), (100, 0):  # percent
            if status == 0:
                for chain in spec["chains"]:
                    chain["deadline_us"] = 600_000_000
            solved()
            steps = [{"at_us": 0, "speed_pct": {"gpu": of_clock, "cpu": of_clock, "dla": of_clock}}]
            pathlib.Path(script).write_text(json.dumps({"schema": "xauto.emulation", "version": 1, "steps": steps}))
            done = xauto("run", "--app", app, "--platform", "small", "--policy", policy, "--emulate", "--duration", "1s",
                         "--emulate-script", script, "--fail-on", "miss", "--json", "--", BIN / "driving-rates")
            run = json.loads(done.stdout)["runs"][0]
            missed = {c["name"]: c["deadline_misses"] for c in run["chains"] if c["deadline_misses"] > 0}
            self.assertEqual((done.returncode, run["fail_on"]), (status, {"miss": sum(missed.values())}), done.stderr)
            self.assertEqual(bool(missed), status == 1)
            for name, count in missed.items():
                self.assertIn(f"{count} of chain '{name}'", done.stderr)
        for chain in spec["chains"]:
            del chain["deadline_us"]
        solved()
        done = xauto("run", "--app", app, "--platform", "small", "--policy", policy, "--emulate", "--duration", "1s",
                     "--fail-on", "miss", "--", BIN / "driving-rates")
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertIn("nothing has a deadline", done.stderr)

    def test_an_overrun_that_the_trace_has_forgotten(self):
        """What is judged was counted over the whole run: the trace holds its end, and all was right there."""
        files = testapp_files(self.folder)
        done = xauto("run", *files, "--activations", 600, "--lockstep", "--trace-keep", "1ms", "--json", "--", TESTAPP,
                     os.path.join(self.folder, "result"), "early", "B", 3, 50)
        run = json.loads(done.stdout)["runs"][0]
        self.assertGreater(run["trace_events_overwritten"], 0, done.stderr)
        counted = {x["name"]: x["over_wcet"] for x in run["limited_xnodes"]}
        self.assertGreaterEqual(counted["b1"], 3)
        self.assertRegex(" ".join(run["claims"]["broken"]), rf"\b{sum(counted.values())} of \d+ jobs outran their WCET")

    def test_a_process_that_is_gone_for_good(self):
        """With several rates lost activations make no status 1; who loses all from now on does."""
        app, policy = self.rates()
        tool = subprocess.Popen([XAUTO, "run", "--app", app, "--platform", "small", "--policy", policy, "--emulate",
                                 "--isolate", "--json", "--", BIN / "driving-rates"],
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addCleanup(tool.kill)
        wait_for("results", lambda: min(activations(tool).values(), default=0) > 2, tool)
        member = next(pid for pid in children_of(tool.pid)
                      if b"XAUTO_PROCESS=" in pathlib.Path(f"/proc/{pid}/environ").read_bytes())
        os.kill(member, signal.SIGKILL)
        wait_for("the tool to know of its end", lambda: not pathlib.Path(f"/proc/{member}").exists(), tool)
        tool.terminate()
        _, err = tool.communicate(timeout=60)
        self.assertEqual(tool.returncode, 1, err)
        self.assertRegex(err, r"error: run s: the process of \S+ died \(signal SIGKILL\), and nothing took its place")

    def test_a_policy_of_another_platform(self):
        """A GPU that does not preempt: blocking counts, and the policy does not know it."""
        platform = f"{self.folder}/p.json"
        app, policy = self.rates()
        hardware = json.loads((SOURCE / "tests/golden/platform.json").read_text())
        with open(policy) as f:
            xpus = {x["xpu"] for x in json.load(f)["xnodes"]}
        hardware["xpus"] = [{"id": x, "type": x.rstrip("0123456789"), "preemptive": False} for x in sorted(xpus)]
        hardware["name"] = "another"
        with open(platform, "w") as f:
            json.dump(hardware, f)
        done = xauto("run", "--app", app, "--platform", platform, "--policy", policy, "--emulate", "--duration", "1s",
                     "--", BIN / "driving-rates")
        self.assertEqual((done.returncode, done.stdout), (2, ""))
        self.assertIn("was made for platform 'small', and this run is on 'another'", done.stderr)
        # Without --platform it is the policy's.
        done = xauto("run", "--app", app, "--policy", policy, "--emulate", "--duration", "1s", "--json", "--", BIN / "driving-rates")
        self.assertEqual((done.returncode, json.loads(done.stdout)["platform"]), (0, "small"), done.stderr)
        with open(policy) as f:
            elsewhere = {**json.load(f), "platform": "another"}
        with open(f"{self.folder}/elsewhere.json", "w") as f:
            json.dump(elsewhere, f)
        for verb in ("run", "check", "simulate", "explain"):
            more = ("--emulate", "--", BIN / "driving-rates") if verb == "run" else ()
            done = xauto(verb, "--app", app, "--policy", f"{self.folder}/elsewhere.json", *more)
            self.assertEqual(done.returncode, 2, (verb, done.stderr))
            self.assertIn("was made for platform 'another', which does not come with XAuto", done.stderr)
            self.assertIn("--platform FILE", done.stderr)
        hardware["name"] = "small"  # it says it is the same, and is not
        with open(platform, "w") as f:
            json.dump(hardware, f)
        done = xauto("run", "--app", app, "--platform", platform, "--policy", policy, "--emulate", "--duration", "1s",
                     "--json", "--", BIN / "driving-rates")
        self.assertIn("`xauto check` refuses it here", done.stderr)
        self.assertIn("`xauto check` refuses the policy",
                      "".join(json.loads(done.stdout)["runs"][0]["claims"]["broken"]))

    def test_a_policy_of_one_release_that_was_edited(self):
        files = testapp_files(self.folder)
        run = ["run", *files, "--activations", "3", "--json", "--", TESTAPP, os.path.join(self.folder, "result")]
        self.assertNotIn("xauto check", xauto(*run).stderr)
        policy = pathlib.Path(files[files.index("--policy") + 1])
        edited = json.loads(policy.read_text())
        edited["chains"][0]["worst_case_us"] -= 1
        policy.write_text(json.dumps(edited))
        done = xauto(*run)
        self.assertIn("policy.json: `xauto check` refuses it here: chain 'src -> c1': worst_case_us is 2999",
                      done.stderr)
        self.assertIn("`xauto check` refuses the policy", "".join(json.loads(done.stdout)["runs"][0]["claims"]["broken"]))

    def test_what_cannot_be_is_refused(self):
        done, _ = self.run_app("miss,late")
        self.assertEqual(done.returncode, 2)
        for word in ("late", "miss", "lost", "hang", "restart", "claim"):
            self.assertIn(word, done.stderr)
        for word in ("miss", "hang"):  # it could not fail, whatever happens
            done, _ = self.run_app(word)
            self.assertEqual(done.returncode, 2)
            self.assertIn(f"--fail-on {word}", done.stderr)


if __name__ == "__main__":
    unittest.main()
