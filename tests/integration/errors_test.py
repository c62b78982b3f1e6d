# SPDX-License-Identifier: Apache-2.0
"""Every malformed file of tests/golden/errors makes the tool exit with 2 and say what its case says. Of a recording of
which some messages can be read, `recording check` says it as a warning, then how many, and exits with 1."""
import json
import os
import pathlib
import resource
import signal
import subprocess
import sys
import tempfile
import unittest

from common import APP, DRIVING, SOURCE, XAUTO, wait_for, xauto

GOLDEN = SOURCE / "tests/golden"
sys.path.insert(0, str(GOLDEN / "errors"))
from cases import cases  # noqa: E402

COMMANDS = {
    "app": lambda f: ["graph", "--app", f],
    "platform": lambda f: ["solve", "--app", GOLDEN / "app.json", "--platform", f],
    "policy": lambda f: ["check", "--app", GOLDEN / "app.json", "--platform", GOLDEN / "platform.json",
                         "--policy", f],
    "policy-keys": lambda f: ["check", "--app", GOLDEN / "app-rates.json", "--platform", GOLDEN / "platform.json", "--policy", f],
    "demand": lambda f: ["solve", "--app", GOLDEN / "app-rates.json", "--platform", GOLDEN / "platform.json", "--beside", f],
    "profile": lambda f: ["profile", "--read", f],
    "recording": lambda f: ["recording", "check", f],
    "mcap": lambda f: ["recording", "check", f],
}


def little_memory(megabytes):
    return lambda: resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20, megabytes << 20))


def wchan(pid):
    return pathlib.Path(f"/proc/{pid}/wchan").read_text()


class Errors(unittest.TestCase):
    def refuse(self, kind):
        self.assertGreaterEqual(len(cases(kind)), 8)
        with tempfile.TemporaryDirectory() as folder:
            for case in cases(kind):
                with self.subTest(case=case.name):
                    case.write(folder)
                    result = xauto(*COMMANDS[kind](case.file), cwd=folder)
                    if kind in ("recording", "mcap") and result.stdout:
                        self.assertEqual(result.returncode, 1, result.stderr)
                        self.assertTrue(result.stderr.startswith("xauto: warning: " + case.message), result.stderr)
                        self.assertRegex(result.stdout, r"[1-9]\d* messages can be read, with \d+ faults")
                        continue
                    self.assertEqual(result.returncode, 2, result.stderr)
                    self.assertEqual(result.stderr, "xauto: error: " + case.message)
                    self.assertEqual(result.stdout, "")

    def test_app(self):
        self.refuse("app")

    def test_platform(self):
        self.refuse("platform")

    def test_policy(self):
        for kind in ("policy", "policy-keys"):
            self.refuse(kind)

    def test_demand(self):
        self.refuse("demand")

    def test_profile(self):
        self.refuse("profile")

    def test_recording(self):
        self.refuse("recording")

    def test_mcap(self):
        self.refuse("mcap")

    def test_profile_writes_the_rates_of_the_sources(self):
        profile = json.loads((GOLDEN / "profile-sources.json").read_text())
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)

            def written():
                (folder / "profile.json").write_text(json.dumps(profile))
                done = xauto("profile", "--read", "profile.json", "--platform", GOLDEN / "platform.json", "--app-out",
                             "app.json", cwd=folder)
                self.assertEqual(done.returncode, 0, done.stderr)
                return json.loads((folder / "app.json").read_text()), done.stderr

            app, said = written()
            self.assertEqual(app["version"], 3)
            (folder / "app.json").unlink()  # what was asked for in it would stay
            self.assertNotIn("'camera' is pushed", said)
            self.assertIn("source 'camera' has period_us 33333, and 30 Hz is none of whole us", said)
            self.assertIn("source 'lidar/größe' is pushed, and its grid was not measured: period_us 100000 is the least", said)
            self.assertNotIn("pushed", json.dumps(app))
            del profile["sources"][1]["pushed"]
            self.assertEqual(written()[0], app)
            self.assertEqual(app["chains"], [{"name": "camera -> fcd.infer", "from": "camera", "to": "fcd.infer"}])
            profile["xnodes"][0]["source"] = ["camera", "lidar/größe"]
            (folder / "app.json").unlink()
            (folder / "profile.json").write_text(json.dumps(profile))
            done = xauto("profile", "--read", "profile.json", "--platform", GOLDEN / "platform.json", "--app-out",
                         "app.json", cwd=folder)
            self.assertEqual(done.returncode, 2)
            self.assertIn("/xnodes/0/source: XNode 'fcd.pre' joins sources", done.stderr)
            self.assertFalse((folder / "app.json").exists())

    def test_usage(self):
        for arguments in ([], ["nonsense"], ["solve"], ["simulate", "--app"], ["run", "--app", "x"],
                          ["solve", "--method", "cyberrt", "--app", GOLDEN / "app.json"]):
            with self.subTest(arguments=arguments):
                self.assertEqual(xauto(*arguments).returncode, 2)
        for option in ("--time-limit", "--regret"):
            for number in ("nan", "inf", "-nan", "infinity"):
                with self.subTest(option=option, number=number):
                    result = xauto("solve", "--app", GOLDEN / "app.json", "--platform", "small", option, number)
                    self.assertEqual(result.returncode, 2)
                    self.assertIn(f"'{number}' is no {'finite number' if option == '--regret' else 'time such as'}", result.stderr)

    def test_too_many_values_are_refused_before_they_fill_the_memory(self):
        with tempfile.TemporaryDirectory() as folder:
            given = pathlib.Path(folder) / "a.json"
            given.write_text('{"schema":"xauto.app","version":1,"junk":[0' + ",0" * 8_000_000 + "]}")
            result = xauto("graph", "--app", "a.json", cwd=folder)
            self.assertEqual(result.returncode, 2)
            self.assertIn("a.json: has more than 8000000 values", result.stderr)

    def test_where_memory_ends_solve_goes_on_with_fewer_threads_or_says_so(self):
        tried = 0
        for megabytes in (64, 96, 128, 192):
            result = subprocess.run([XAUTO, "solve", "--app", GOLDEN / "app.json", "--platform", "small", "--threads", "16",
                                     "--time-limit", "0.2s"], preexec_fn=little_memory(megabytes), capture_output=True,
                                    text=True, timeout=120)
            if "error while loading shared libraries" in result.stderr:
                continue
            tried += 1
            if result.returncode != 0:
                self.assertEqual(result.returncode, 1, result.stderr)
                self.assertIn("there is no memory left", result.stderr)
        self.assertGreater(tried, 0)

    def test_where_threads_end_a_run_says_so(self):
        with tempfile.TemporaryDirectory() as folder:
            policy = os.path.join(folder, "policy.json")
            xauto("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", policy)
            result = subprocess.run([XAUTO, "run", "--app", APP, "--platform", "small", "--policy", policy, "--emulate",
                                     "--activations", "3", "--", DRIVING], preexec_fn=little_memory(100), capture_output=True,
                                    text=True, timeout=120)
            self.assertEqual(result.returncode, 1, result.stderr)
            self.assertIn("no more threads", result.stderr)
            self.assertNotIn("terminate called", result.stderr)

    def test_a_run_with_closed_streams_few_descriptors_or_without_room_for_a_file(self):
        def without(*streams):
            return lambda: [os.close(stream) for stream in streams]

        def at_most(what, limit):
            return lambda: resource.setrlimit(what, (limit, limit))

        with tempfile.TemporaryDirectory() as folder:
            policy = os.path.join(folder, "policy.json")
            xauto("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", policy)
            for name, before, status, said in (
                    ("stdin", without(0), 0, ""),
                    ("stdout and stderr", without(1, 2), 0, ""),
                    ("all three", without(0, 1, 2), 0, ""),
                    ("64 descriptors", at_most(resource.RLIMIT_NOFILE, 64), None, "open files"),
                    ("files of no bytes", at_most(resource.RLIMIT_FSIZE, 0), 1, "File too large")):
                with self.subTest(name=name):
                    result = subprocess.run([XAUTO, "run", "--app", APP, "--platform", "small", "--policy", policy,
                                             "--emulate", "--activations", "3", "--", DRIVING], preexec_fn=before,
                                            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120)
                    self.assertIn(said, result.stderr)
                    if status is None:
                        self.assertIn(result.returncode, (1, 2), result.stderr)
                    else:
                        self.assertEqual(result.returncode, status, result.stderr)

    def test_a_program_that_is_none_of_xauto(self):
        with tempfile.TemporaryDirectory() as folder:
            policy = os.path.join(folder, "policy.json")
            xauto("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", policy)
            result = xauto("run", "--app", APP, "--platform", "small", "--policy", policy, "--emulate", "--", "sleep", "12")
            self.assertEqual(result.returncode, 1, result.stderr)
            self.assertIn("sleep has not begun after 10 s", result.stderr)
            self.assertIn("sleep: ended without an answer (exit status 0)", result.stderr)

    def test_a_pipe_that_nobody_reads_holds_up_no_sigterm(self):
        with tempfile.TemporaryDirectory() as folder:
            pipe = os.path.join(folder, "pipe")
            os.mkfifo(pipe)
            process = subprocess.Popen([XAUTO, "solve", "--app", GOLDEN / "app.json", "--platform", "small",
                                        "--time-limit", "0.1s", "--out", pipe], stdout=subprocess.PIPE,
                                       stderr=subprocess.PIPE, text=True)
            wait_for("it waits for a reader", lambda: "wait_for_partner" in wchan(process.pid))
            process.send_signal(signal.SIGTERM)
            _, err = process.communicate(timeout=60)
            self.assertEqual(process.returncode, 1, err)
            self.assertIn("cannot be written: Interrupted system call", err)

    def test_missing_files(self):
        result = xauto("graph", "--app", "/nowhere/app.json")
        self.assertEqual(result.returncode, 2)
        self.assertIn("/nowhere/app.json: cannot be opened: No such file or directory", result.stderr)


if __name__ == "__main__":
    unittest.main()
