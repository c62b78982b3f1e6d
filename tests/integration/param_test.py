#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Parameters: deployment.json sets them, `xauto param` changes them while the app runs, in each of its processes. Nothing
here depends on time: a value that was set is waited for."""
import json
import os
import pathlib
import re
import socket
import subprocess
import tempfile
import unittest

from common import BIN, QUEUES, XAUTO, socket_of, sourced, wait_for, xauto

PLATFORM = {"schema": "xauto.platform", "version": 1, "name": "test", "xpus": [
    {"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 0}]}
XNODES = [("a.first", "A"), ("a.second", "A"), ("b.only", "B")]
DEFAULTS = {("A", "on"): True, ("A", "count"): 3, ("A", "gain"): 0.5, ("A", "mode"): "day", ("A", "twin"): "day",
            ("B", "mode"): "day"}


class Params(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.write("platform.json", PLATFORM)
        self.write("app.json", sourced({"name": "params",
                                "xnodes": [{"name": n, "module": m, "wcet_us": {"cpu": 200}} for n, m in XNODES],
                                "edges": [["a.first", "a.second"], ["a.second", "b.only"]]}, "tick"))
        done = xauto("solve", "--app", "app.json", "--platform", "platform.json", "--out", "policy.json",
                     cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)

    def write(self, name, value):
        (self.folder / name).write_text(json.dumps(value))

    def command(self, *flags, activations=0, app=(), **modules):
        self.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "params", **QUEUES,
                                       "modules": modules})
        return [XAUTO, "run", "--app", "app.json", "--platform", "platform.json", "--policy", "policy.json", "--real",
                "--activations", str(activations), "--deployment", "deployment.json", "--json", *map(str, flags), "--",
                str(BIN / "params"), "result", *map(str, app)]

    def start(self, *flags, **keywords):
        with open(self.folder / "out", "w") as out, open(self.folder / "err", "w") as err:
            tool = subprocess.Popen(self.command(*flags, **keywords), cwd=self.folder, stdout=out, stderr=err)
        self.addCleanup(lambda: (tool.kill(), tool.wait()))
        self.tool, self.run_id = tool, f"{tool.pid}-0"
        wait_for("a message of b", lambda: self.newest("b"), tool)
        return tool

    def end(self, status=0):
        self.tool.terminate()
        self.assertEqual(self.tool.wait(timeout=60), status, (self.folder / "err").read_text())
        return json.loads((self.folder / "out").read_text())["runs"][0]

    def refused(self, *flags, **keywords):
        done = subprocess.run(self.command(*flags, activations=5, **keywords), cwd=self.folder, capture_output=True, text=True,
                              timeout=60)
        self.assertNotEqual(done.returncode, 0)
        return done.stderr

    def lines(self, topic):
        path = self.folder / "result"
        text = path.read_text() if path.exists() else ""
        return [line.split(" ", 2)[2] for line in text.split("\n")[:-1] if line.startswith(topic + " ")]

    def newest(self, topic):
        return (self.lines(topic) or [""])[-1]

    def param(self, action, *words, status=0):
        done = xauto("param", action, *words, "--run", self.run_id, "--wait", "30s")
        self.assertEqual(done.returncode, status, done.stdout + done.stderr)
        return done.stdout if status == 0 else done.stderr

    def values(self, key="value"):
        listed = json.loads(self.param("list", "--json"))["parameters"]
        return {(p["module"], p["name"]): p[key] for p in listed}

    def sees(self, topic, text):
        wait_for(f"{text} on {topic}", lambda: self.newest(topic) == f"{text}|{text}", self.tool)


class Prio(Params):
    def prio(self, *words, status=0):
        done = xauto("prio", *words, "--run", self.run_id, "--wait", "30s")
        self.assertEqual(done.returncode, status, done.stdout + done.stderr)
        return done.stdout if status == 0 else done.stderr

    def test_a_key_is_changed_while_it_runs_and_nothing_is_claimed_then(self):
        self.start()
        listed = {x["xnode"]: x for x in json.loads(self.prio("--json"))["xnodes"]}
        self.assertEqual({x["by"] for x in listed.values()}, {"key"})
        self.assertGreater(listed["a.first"]["planned_us"], 0)
        self.assertIn("a.first: as planned -> 5.00 ms", self.prio("a.first", "--key", "5ms"))
        self.assertIn("a.first: 5.00 ms -> 6.00 ms", self.prio("a.first", "--key", "6ms"))
        listed = {x["xnode"]: x for x in json.loads(self.prio("--json"))["xnodes"]}
        self.assertEqual([listed[x]["asked_us"] for x in ("a.first", "a.second")], [6000, None])
        self.assertIn("has a key", self.prio("a.first", "7", status=2))
        self.assertIn("no XNode 'c.none'", self.prio("c.none", "--key", "1ms", status=2))
        self.assertIn("needs one of", self.prio("a.first", status=2))
        self.assertIn("6.00 ms -> as planned", self.prio("a.first", "--planned"))
        claims = self.end()["claims"]
        kinds = {a["kind"]: a for a in claims["assumptions"]}
        self.assertEqual(kinds["changed_urgency"]["count"], 3)
        self.assertIn("the key of XNode 'a.first' was changed by hand, 3 times; it is the policy's again",
                      " ".join(claims["broken"]))
        self.assertIn("not claimed", claims["verdict"])


class Live(Params):
    def test_a_value_reaches_every_process_and_the_report_names_it(self):
        for flags in ([], ["--isolate"]):
            with self.subTest(flags=flags):
                self.start(*flags)
                self.assertEqual(self.values(), DEFAULTS)
                self.sees("a", "1,3,0.500000,day,day")
                self.assertEqual(self.param("set", "A", "count=42", "on=false"), "count: 3 -> 42\non: true -> false\n")
                self.sees("a", "0,42,0.500000,day,day")
                self.param("set", "A", "gain=-0.25")
                self.sees("a", "0,42,-0.250000,day,day")
                self.param("set", "B", "mode=a = b")
                self.sees("b", "a = b")
                self.assertEqual(self.param("get", "B", "mode"), "a = b\n")
                self.assertEqual(self.param("get", "A", "mode"), "day\n", "each module has its own")
                self.assertEqual(self.values("default"), DEFAULTS)
                self.assertEqual(self.values()[("A", "gain")], -0.25)
                notes = " ".join(self.end()["notes"])
                self.assertIn("parameters were changed during the run, which may not be the values that WCETs were measured with: "
                              "A on (1 times, now false), A count (1 times, now 42), A gain (1 times, now -0.25), "
                              "B mode (1 times, now a = b)", notes)
                (self.folder / "result").unlink()

    def test_an_activation_sees_one_value_and_what_is_set_together_together(self):
        self.start("--isolate", app=("period", 1000))
        for i in range(60):
            name = f"{i:03}" * (1 + i)
            self.param("set", "A", f"mode={name}", f"twin={name}")
        self.sees("a", f"1,3,0.500000,{name},{name}")
        self.end()
        seen = set()
        for line in self.lines("a"):
            first, second = line.split("|")
            self.assertEqual(first, second, "both XNodes of an activation see the same")
            mode, twin = first.split(",")[3:]
            self.assertEqual(mode, twin)
            seen.add(mode)
        self.assertGreater(len(seen), 5, "values do change while it runs")

    def test_a_module_that_is_started_again_has_the_value_of_now(self):
        self.start("--isolate", "--restarts", 1, app=("crash", 400))
        self.param("set", "B", "mode=night")
        self.sees("b", "night")
        wait_for("the crash", lambda: "was started again" in self.err() or "died" in self.err(), self.tool)
        count = len(self.lines("b"))
        wait_for("messages after it", lambda: len(self.lines("b")) > count + 5, self.tool)
        self.sees("b", "night")
        self.end(status=1)

    def err(self):
        return (self.folder / "err").read_text()

    def test_a_run_without_changes_says_nothing_of_them(self):
        self.start(A={"parameters": {"count": 7, "gain": 1, "mode": "dusk", "on": False}})
        self.sees("a", "0,7,1.000000,dusk,day")
        self.assertEqual(self.values()[("A", "count")], 7)
        self.assertEqual(self.values("default"), DEFAULTS)
        self.assertNotIn("parameters", " ".join(self.end()["notes"]))

    def test_the_table(self):
        self.start()
        rows = [re.split(r"  +", line) for line in self.param("list").splitlines()]
        self.assertEqual(rows, [["module", "name", "type", "range", "value", "default"],
                                ["A", "on", "bool", "true", "true"], ["A", "count", "integer", "0 to 100", "3", "3"],
                                ["A", "gain", "number", "-1 to 1", "0.5", "0.5"], ["A", "mode", "text", "day", "day"],
                                ["A", "twin", "text", "day", "day"], ["B", "mode", "text", "day", "day"]])
        self.end()


class Refused(Params):
    def test_what_is_wrong_is_said_and_nothing_changes(self):
        self.start()
        for words, told in (
                (("A", "cuont=1"), "XModule 'A' has no parameter 'cuont'"),
                (("C", "count=1"), "the app has no XModule 'C'"),
                (("A", "count=101"), "parameter 'count' of XModule 'A': '101' is out of range\n  hint: possible is 0 to 100"),
                (("A", "count=1.5"), "parameter 'count' of XModule 'A': is integer, not '1.5'"),
                (("A", "on=1"), "say true or false"),
                (("A", "gain=nan"), "is number, not 'nan'"),
                (("A", "gain=1e999"), "is number"),
                (("A", "gain=1.01"), "out of range"),
                (("A", "mode=" + "x" * 249), "has 249 bytes, at most 248"),
                (("A", "mode=\x1b[2J"), "contains a control character"),
                (("A", "count"), "'count' is not NAME=VALUE"),
                (("A", "count=1", "count=2"), "'count' is given twice"),
                (("A",), "needs a module and NAME=VALUE"),
                (("A", "count=5", "gain=7"), "out of range")):
            with self.subTest(words=words):
                self.assertIn(told, self.param("set", *words, status=2))
        self.assertIn("XModule 'A' has no parameter 'x'", self.param("get", "A", "x", status=2))
        self.assertIn("no XModule 'x'", self.param("list", "x", status=2))
        self.assertEqual(self.values(), DEFAULTS)
        self.assertNotIn("parameters", " ".join(self.end()["notes"]))

    def test_nobody_there(self):
        done = xauto("param", "list", "--run", "1-0")
        self.assertEqual(done.returncode, 2)
        self.assertIn("no run '1-0' is going on", done.stderr)

    def test_a_deployment_that_the_program_does_not_know(self):
        for parameters, told in (({"cuont": 1}, "XModule 'A' has no parameter 'cuont'\n  hint: it has on, count, gain, mode, twin"),
                                 ({"count": 1.5}, "parameter 'count' of XModule 'A': is integer, given is number '1.5'"),
                                 ({"count": 101}, "out of range"),
                                 ({"on": 1}, "is bool, given is integer '1'"),
                                 ({"mode": "x" * 249}, "at most 248"),
                                 ({"mode": [1]}, "deployment.json: /modules/A/parameters/mode: must be true, false, a number")):
            with self.subTest(parameters=parameters):
                self.assertIn(told, self.refused(A={"parameters": parameters}))

    def test_whoever_sends_nonsense_is_answered_and_who_says_nothing_holds_nobody_up(self):
        self.start()
        address = socket_of(self.run_id, "desk")
        for _ in range(20):
            s = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self.addCleanup(s.close)
            s.connect(address)
        for text in (b"", b"\0" * 100, b"[]", b"{}", b'{"module": 1, "set": {}}', b'{"module": "A", "set": {"count": 1}}',
                     b'{"module": "A", "set": {}}', b"[" * 10_000, b"x" * 16_384, b"x" * 60_000):
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as s:
                s.settimeout(60)
                s.connect(address)
                s.send(text)
                answer = s.recv(20_000)
                if answer:
                    self.assertIn("error", json.loads(answer), text[:50])
        self.param("set", "A", "count=9")
        self.assertEqual(self.values()[("A", "count")], 9)
        self.end()

    def test_another_user_may_not(self):
        if os.geteuid() != 0:
            self.skipTest("only root becomes somebody else")
        self.start()
        def become():
            os.setgroups([])
            os.setgid(65534)
            os.setuid(65534)
        for words in (("list",), ("set", "A", "count=9")):
            done = subprocess.run([XAUTO, "param", *words, "--run", self.run_id], capture_output=True, text=True, timeout=60,
                                  preexec_fn=become, cwd="/")
            if done.returncode in (126, 127):
                self.skipTest("nobody may not start our programs")
            self.assertEqual(done.returncode, 1, done.stderr)
            self.assertIn("answers only that user and root", done.stderr)
        self.assertEqual(self.values(), DEFAULTS)
        self.end()


class Instances(Params):
    """A under two names, "left" and "right", with values of their own; B reads what left publishes."""
    NAMES = {"instances": {"left": "A", "right": "A"},
             "modules": {"right": {"remap": {"a": "a"}, "parameters": {"count": 8}},
                         "left": {"parameters": {"count": 7}}, "B": {"remap": {"a": "left/a"}}}}

    def deploy(self, **names):
        self.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "params", **QUEUES, **names})

    def profile(self, *flags):
        return xauto("profile", "--platform", "platform.json", "--real", "--repetitions", 3, *flags, "--app-out", "app.json",
                     "--", BIN / "params", "result", cwd=self.folder)

    def plan(self, **names):
        self.deploy(**names)
        (self.folder / "app.json").unlink(missing_ok=True)  # it states no source, and what is asked in it would stay
        done = self.profile("--deployment", "deployment.json")
        self.assertEqual(done.returncode, 0, done.stderr)
        done = xauto("solve", "--app", "app.json", "--platform", "platform.json", "--max-evaluations", 200, "--out", "policy.json",
                     cwd=self.folder)
        self.assertEqual(done.returncode, 0, done.stderr)

    def command(self, *flags, deploy=True, activations=0, app=()):
        words = super().command(*flags, activations=activations, app=app)
        self.deploy(**self.NAMES)
        if not deploy:
            at = words.index("--deployment")
            del words[at:at + 2]
        return words

    def test_profile_solve_and_run_agree_on_the_names(self):
        self.plan(**self.NAMES)
        app = json.loads((self.folder / "app.json").read_text())
        self.assertEqual([(x["name"], x["module"]) for x in app["xnodes"]],
                         [("left/a.first", "left"), ("left/a.second", "left"), ("right/a.first", "right"),
                          ("right/a.second", "right"), ("b.only", "B")])
        self.assertIn(["left/a.second", "b.only"], app["edges"])
        for flags in ([], ["--isolate"]):
            with self.subTest(flags=flags):
                self.start(*flags)
                self.sees("a", "1,8,0.500000,day,day")
                self.assertEqual(self.values()[("left", "count")], 7)
                self.param("set", "right", "mode=night")
                self.sees("a", "1,8,0.500000,night,day")
                self.assertEqual(self.param("get", "left", "mode"), "day\n")
                self.assertEqual(self.values("changes")[("right", "mode")], 1)
                self.sees("b", "day")
                run = self.end()
                self.assertEqual([m["name"] for m in run["modules"]], ["left", "right", "B"])
                self.assertIn("right mode (1 times, now night)", " ".join(run["notes"]))
                (self.folder / "result").unlink()

    def test_names_that_do_not_fit_are_refused(self):
        self.plan(**self.NAMES)
        self.assertIn("XNode 'a.first' is not in app.json", self.refused(deploy=False))
        for names, told in (
                ({"instances": {"left": "A"}}, "topic 'a' has no publisher, but XModule 'B' reads it"),
                ({"modules": {"B": {"remap": {"a": "tick"}}}}, "topic 'tick' has two types"),
                ({"instances": {"B": "A"}}, "two XModules are called 'B'"),
                ({"instances": {"left": "C"}}, "instance 'left' is of XModule 'C', which is not in the program\n  hint: the program has A, B"),
                ({"modules": {"A": {"remap": {"x": "y"}}}}, "XModule 'A' has no topic 'x' to remap\n  hint: its topics are a, tick")):
            with self.subTest(names=names):
                self.deploy(**names)
                done = self.profile("--deployment", "deployment.json")
                self.assertNotEqual(done.returncode, 0)
                self.assertIn(told, done.stderr)
        self.write("other.json", {"schema": "xauto.deployment", "version": 1, "app": "other"})
        self.assertIn("deployment.json: is for app 'other', not for 'params'", self.profile("--deployment", "other.json").stderr)
        self.deploy()
        self.assertEqual(self.profile().returncode, 0)
        self.assertIn("instance 'left' is not in the app", self.refused())


if __name__ == "__main__":
    unittest.main()
