#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Files that the verbs write: looked at before the work, written after the table, never half."""
import json
import os
import pathlib
import signal
import subprocess
import tempfile
import unittest

from common import TESTAPP, XAUTO, testapp_files, wait_for, xauto


class Outputs(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        testapp_files(cls.folder.name)

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    @classmethod
    def path(cls, name):
        return os.path.join(cls.folder.name, name)

    def app(self, marker, *words):
        """The app's command; `marker` is there once it was started."""
        return ["sh", "-c", 'touch "$0"; exec "$@"', self.path(marker), TESTAPP, self.path("result"), "period", "20000",
                *words]

    def verbs(self, marker):
        """Verb -> the arguments that it needs, and what comes behind."""
        files = ["--app", self.path("app.json"), "--platform", self.path("platform.json")]
        app = ["--", *self.app(marker)]
        return {"run": ([*files, "--policy", self.path("policy.json"), "--lockstep", "--activations", 3], app),
                "profile": (["--platform", self.path("platform.json"), "--repetitions", 2], app),
                "compare": ([*files, "--policies", "heft", "--lockstep", "--activations", 3], app),
                "solve": ([*files, "--method", "heft"], []),
                "simulate": ([*files, "--policy", self.path("policy.json")], []),
                "report": ([self.path("run.pftrace")], [])}

    def call(self, verb, *options, marker="started"):
        words, app = self.verbs(marker)[verb]
        return xauto(verb, *words, *options, *app)

    def full(self, name):
        """A file on a disk that is full. A link: what would replace the device replaces only the link."""
        if not os.path.lexists(self.path(name)):
            os.symlink("/dev/full", self.path(name))
        return self.path(name)

    def test_a_missing_folder_is_an_error_before_the_run(self):
        self.assertEqual(self.call("run", "--trace-out", self.path("run.pftrace")).returncode, 0)
        pathlib.Path(self.path("file")).write_text("")
        for verb, options in {"run": ["--out", "--page", "--trace-out", "--record"],
                              "profile": ["--out", "--app-out"], "solve": ["--out"], "simulate": ["--out"],
                              "report": ["--out"], "compare": ["--out"]}.items():
            for option in options:
                for where in ("missing/x.mcap", "file/x.mcap"):
                    if verb == "compare" and where.startswith("missing"):
                        continue  # it makes its folder
                    with self.subTest(verb=verb, option=option, where=where):
                        marker = f"started-{verb}{option}-{where[:4]}"
                        done = self.call(verb, option, self.path(where), marker=marker)
                        self.assertIn(done.returncode, (1, 2), done.stderr)
                        if verb != "compare":
                            self.assertEqual(done.returncode, 2, done.stderr)
                            self.assertIn(option, done.stderr)
                        self.assertEqual(done.stdout, "")
                        self.assertIn(self.path(where), done.stderr)
                        self.assertFalse(os.path.exists(self.path(marker)), "the app was started")

    def test_a_full_disk_does_not_cost_the_table_nor_the_other_files(self):
        page = self.path("page.html")
        done = self.call("run", "--out", self.full("full.json"), "--trace-out", self.full("full.pftrace"), "--page", page)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertRegex(done.stdout, r"policy +\d+\.\d\d")
        for name in ("full.json", "full.pftrace"):
            self.assertRegex(done.stderr, rf"error: .*{name}: cannot be written: No space left on device")
        self.assertIn("a1", pathlib.Path(page).read_text())
        for verb, option, said in (("profile", "--out", "a1"), ("profile", "--app-out", "a1"),
                                   ("solve", "--out", "Nothing is claimed"), ("simulate", "--out", "a1")):
            with self.subTest(verb=verb):
                done = self.call(verb, option, self.full("full.json"))
                self.assertEqual(done.returncode, 1, done.stderr)
                self.assertIn(said, done.stdout)
                self.assertIn("No space left on device", done.stderr)
        self.assertTrue(os.path.islink(self.full("full.json")))
        self.assertFalse([n for n in os.listdir(self.folder.name) if ".tmp." in n])

    def test_a_full_disk_does_not_cost_the_comparison(self):
        folder = pathlib.Path(self.path("comparison"))
        folder.mkdir()
        for name in ("heft.pftrace", "report.json", "heft.policy.json"):
            os.symlink("/dev/full", folder / name)
        done = self.call("compare", "--out", folder)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertRegex(done.stdout, r"HEFT +\d+\.\d\d")
        self.assertEqual(done.stderr.count("No space left on device"), 3, done.stderr)
        self.assertIn("a1", (folder / "report.html").read_text())

    def test_a_recording_that_cannot_be_written_does_not_cost_the_table(self):
        # The app limits the size of its files: as on a full disk, writes fail.
        done = xauto("run", *self.verbs("x")["run"][0][:-1], 40, "--record-outputs", "--record", self.path("limited.mcap"), "--",
                     *self.app("x", "filelimit", "20000"))
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertRegex(done.stdout, r"policy +\d+\.\d\d.* 40\n")
        self.assertRegex(done.stderr, r"error: --record .*limited.mcap: ")

    def test_a_full_stdout_is_told_and_the_files_are_there(self):
        out = self.path("report-of-full.json")
        words, app = self.verbs("x")["run"]
        with open("/dev/full", "w") as full:
            done = subprocess.run([XAUTO, "run", *map(str, words), "--out", out, *app], stdout=full, stderr=subprocess.PIPE,
                                  text=True, timeout=60)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertIn("stdout", done.stderr)
        self.assertEqual(json.loads(pathlib.Path(out).read_text())["schema"], "xauto.report")

    def test_what_is_there_stays_until_the_new_is_whole(self):
        out = pathlib.Path(self.path("kept.json"))
        out.write_text("what was there")
        words, app = self.verbs("killed")["run"]
        tool = subprocess.Popen([XAUTO, "run", *map(str, words[:-1]), "0", "--out", str(out), *app],
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_for("the app's start", lambda: os.path.exists(self.path("killed")), tool)
        tool.send_signal(signal.SIGKILL)
        tool.wait()
        self.assertEqual(out.read_text(), "what was there")
        self.assertFalse([n for n in os.listdir(self.folder.name) if n.startswith("kept.json.")])

    def test_one_file_for_two_outputs_is_refused(self):
        same = self.path("same")
        done = self.call("run", "--out", same, "--page", same)
        self.assertEqual(done.returncode, 2)
        self.assertIn("--page", done.stderr)


if __name__ == "__main__":
    unittest.main()
