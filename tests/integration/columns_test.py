# SPDX-License-Identifier: Apache-2.0
"""No line of a table has more than 80 columns, of the Driving Case and of an app whose names are long. Sentences may be
longer: a terminal breaks them where it likes. What is cut is whole in --json."""
import json
import pathlib
import re
import subprocess
import tempfile
import unittest

from common import APP, BIN, DRIVING, XAUTO, activations, testapp_files, wait_for, xauto

RATES = pathlib.Path(APP).with_name("rates.json")
LONG = "_of_a_name_that_is_far_too_long_for_any_column_of_any_table_of_this_tool_or_another"


def with_long_names(app, *keys):
    """`app` with long names of all that these keys hold, wherever they are told."""
    names = {one["name"] for key in keys for one in app.get(key, [])}
    longer = lambda name: name + LONG if name in names else name

    def change(value):
        if isinstance(value, dict):
            return {longer(key): change(v) for key, v in value.items()}
        return [change(v) for v in value] if isinstance(value, list) else longer(value) if isinstance(value, str) else value
    return {**app, **{key: change(app[key]) for key in ("sources", "modules", "xnodes", "edges", "samples", "chains") if key in app}}


class Columns(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.dir = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.dir.cleanup)
        cls.folder = pathlib.Path(cls.dir.name)
        rates = json.loads(RATES.read_text())
        cls.write("everything.json", with_long_names(rates, "sources", "modules", "xnodes", "chains"))
        cls.write("chains.json", with_long_names(rates, "chains"))  # the program has names of its own for the rest
        for name in ("one", "two"):
            cls.write(f"{name}.scenarios.json", {"schema": "xauto.scenarios", "version": 1, "app": "driving-rates", "scenarios": [
                {"name": f"{n}{LONG if name == 'two' else ''}", "wcet_scale_pct": {"gpu": pct}} for n, pct in
                (("nominal", 100), ("slower", 120), ("slow", 150))]})

    @classmethod
    def write(cls, name, content):
        (cls.folder / name).write_text(json.dumps(content))

    def judge(self, *words, status=(0, 1)):
        done = xauto(*words, cwd=self.folder)
        self.assertIn(done.returncode, status, done.stderr)
        self.judge_text(done.stdout)
        return done.stdout

    def judge_text(self, text):
        self.assertTrue(text)
        for line in text.splitlines():
            if len(line) > 80:
                self.assertNotRegex(line, r"\S  +\S", "a row of a table")
                self.assertRegex(line, r"[a-z],? [a-z]|" + LONG, "neither a sentence nor one word")

    def solved(self, app, out):
        return self.judge("solve", "--app", app, "--platform", "small", "--time-limit", "0.3s", "--out", out)

    def test_of_a_policy(self):
        for app in (APP, RATES, "everything.json"):
            self.solved(app, "policy.json")
            for verb in ("check", "explain", "simulate"):
                limit = ("--time-limit", "0.3s") if verb == "explain" else ()
                text = self.judge(verb, "--app", app, "--policy", "policy.json", *limit)
        self.assertIn("…", text)
        self.assertIn("la.pre" + LONG, xauto("simulate", "--app", app, "--policy", "policy.json", "--json", cwd=self.folder).stdout)

    def test_where_nothing_is_certified(self):
        app = json.loads((self.folder / "everything.json").read_text())
        for xnode in app["xnodes"]:
            xnode["wcet_us"] = {kind: 3 * us for kind, us in xnode["wcet_us"].items()}
        self.write("much.json", app)
        self.judge("solve", "--app", "much.json", "--platform", "small", "--time-limit", "0.3s", "--out", "much.policy.json", status=(1,))

    def test_of_tables(self):
        for app, scenarios in (("chains.json", "one"), ("everything.json", "two")):
            self.judge("solve", "--app", app, "--platform", "small", "--scenarios", f"{scenarios}.scenarios.json", "--tables", 3,
                       "--time-limit", "1s", "--out", "tables.json")
            self.judge("check", "--app", app, "--policy", "tables.json")

    def test_of_runs(self):
        self.solved("chains.json", "policy.json")
        emulated = ("--platform", "small", "--emulate")
        for app, policy, program in ((APP, "driving.json", DRIVING), ("chains.json", "policy.json", BIN / "driving-rates")):
            if app == APP:
                self.solved(app, policy)
            self.judge("run", "--app", app, *emulated, "--policy", policy, "--activations", 5, "--trace-out", "t.pftrace", "--", program)
            self.judge("explain", "--trace", "t.pftrace")
            self.judge("compare", "--app", app, *emulated, "--activations", 2, "--time-limit", "0.3s", "--out", "compared", "--", program)
        self.judge("run", "--app", APP, *emulated, "--policy", "driving.json", "--activations", 2, "--name", "night" + LONG, "--", DRIVING)

    def test_of_a_run_that_goes_on(self):
        self.solved("chains.json", "policy.json")
        tool = subprocess.Popen([XAUTO, "run", "--app", "chains.json", "--emulate", "--policy", "policy.json", "--activations", "0",
                                 "--", str(BIN / "driving-rates")], cwd=self.folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        self.addCleanup(lambda: (tool.kill(), tool.communicate()))
        wait_for("results", lambda: activations(tool).get("CTL", 0) > 20, tool)
        self.judge("top", "--once", "--interval", "50ms")
        for words in (("--once",), ("--count", 2)):
            self.judge("top", "--run", f"{tool.pid}-0", *words, "--interval", "50ms")
        self.judge("param", "--run", f"{tool.pid}-0", status=(0,))

    def test_of_this_machine_and_of_times(self):
        self.judge("doctor")
        self.judge("profile", "--platform", "small", "--emulate", "--repetitions", 2, "--warmup", 0, "--out", "profile.json",
                   "--app-out", "measured.json", "--", DRIVING)

    def test_of_a_recording(self):
        files = testapp_files(self.dir.name)
        self.judge("run", *files, "--lockstep", "--activations", 3, "--record", "drive.mcap", "--", BIN / "testapp", "result")
        self.judge("recording", "info", "drive.mcap")


if __name__ == "__main__":
    unittest.main()
