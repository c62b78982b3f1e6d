# SPDX-License-Identifier: Apache-2.0
"""tools/python (the package python3-xauto) on what a run has written, held against the report's own numbers and against
schemas; and the notebooks, cell by cell."""
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

from common import DRIVING, SOURCE, xauto

PYTHON = SOURCE / "tools/python"
sys.path.insert(0, str(PYTHON))
import xauto as package  # noqa: E402


class Python(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        app = SOURCE / "examples/driving/rates.json"
        done = xauto("solve", "--app", app, "--platform", "small", "--max-evaluations", 100, "--threads", 1, "--out", cls.path("policy.json"))
        assert done.returncode == 0, done.stderr
        done = xauto("run", "--app", app, "--policy", cls.path("policy.json"), "--emulate", "--duration", "2s", "--out", cls.path("report.json"),
                     "--trace-out", cls.path("run.pftrace"), "--", pathlib.Path(DRIVING).parent / "driving-rates")
        assert done.returncode == 0, done.stderr

    @classmethod
    def path(cls, name):
        return cls.folder / name

    def test_chains_are_the_reports(self):
        report = package.load(self.path("report.json"), "xauto.report")
        written = json.loads(self.path("report.json").read_text())["runs"][0]["chains"]
        rows = package.chains(report)
        self.assertEqual([r["chain"] for r in rows], [c["name"] for c in written])
        for row, chain in zip(rows, written):
            self.assertEqual((row["p50_us"], row["max_us"], row["worst_case_us"], row["deadline_us"], row["results"]),
                             (chain["latency_us"]["p50"], chain["latency_us"]["max"], chain["worst_case_us"], chain["deadline_us"],
                              chain["results"]))

    def test_jobs_are_those_of_the_policy_and_one_at_a_time(self):
        where = {row["xnode"]: row["xpu"] for row in package.placements(package.load(self.path("policy.json"), "xauto.policy"))}
        by_xpu, seen = {}, set()
        for job in package.jobs(self.path("run.pftrace")):
            self.assertEqual(job["xpu"], where[job["xnode"]])
            by_xpu.setdefault(job["xpu"], []).append(job)
            seen.add(job["xnode"])
        self.assertEqual(seen, set(where))
        for jobs in by_xpu.values():
            jobs.sort(key=lambda job: job["begin_ns"])
            for first, second in zip(jobs, jobs[1:]):
                self.assertLessEqual(first["end_ns"], second["begin_ns"])

    def test_the_versions_are_those_of_the_schemas(self):
        for kind, version in package.KINDS.items():
            schema = json.loads((SOURCE / f"docs/schema/{kind.split('.')[1]}.schema.json").read_text())
            self.assertEqual(schema["properties"]["version"], {"const": version}, kind)

    def test_what_is_something_else_is_refused_by_name(self):
        for name, text, says in (("x.json", "{", "is no JSON"), ("x.json", "[]", "expected"), ("x.json", '{"schema": "xauto.report", "version": 9}', "9"),
                                 ("x.json", '{"schema": "xauto.app", "version": 3}', "expected")):
            self.path(name).write_text(text)
            with self.assertRaises(ValueError) as refused:
                package.load(self.path(name), "xauto.report")
            self.assertIn(says, str(refused.exception))
            self.assertIn(str(self.path(name)), str(refused.exception))
        # Cut within a packet, and where a packet begins other bytes: those of a string could be any.
        whole = self.path("run.pftrace").read_bytes()
        packets = packet_starts(whole)
        middle = packets[len(packets) // 2]
        for part in (whole[:middle + 2], whole[:packets[-1] + 2], b"no trace", whole[:middle] + b"\xff" * 100 + whole[middle + 100:]):
            self.path("part.pftrace").write_bytes(part)
            with self.assertRaises(ValueError) as refused:
                package.jobs(self.path("part.pftrace"))
            self.assertIn("part.pftrace", str(refused.exception))

    def test_notebooks_run(self):
        shows = "import json, sys\nspace = {}\nfor cell in json.load(open(sys.argv[1]))['cells']:\n" \
                "    if cell['cell_type'] == 'code':\n        exec(compile(''.join(cell['source']), sys.argv[1], 'exec'), space)"
        for python in (sys.executable, "/usr/bin/python3"):  # Debian's has Debian's packages
            if subprocess.run([python, "-c", "import pandas"], capture_output=True).returncode == 0:
                break
        else:
            self.skipTest("python3-pandas is not installed: the notebooks show data frames")
        for path in sorted((PYTHON / "notebooks").glob("*.ipynb")):
            with self.subTest(path.name):
                done = subprocess.run([python, "-c", shows, str(path)], capture_output=True, text=True,
                                      env=dict(os.environ, FOLDER=str(self.folder), PYTHONPATH=str(PYTHON)))
                self.assertEqual(done.returncode, 0, done.stderr)


def packet_starts(trace):
    """Each packet of it is a tag, its length, and itself; all of them together are the trace."""
    starts, at = [], 0
    for _, packet in package.pftrace.fields(trace):
        starts.append(at)
        at += 1 + -(-len(packet).bit_length() // 7) + len(packet)
    assert at == len(trace), (at, len(trace))
    return starts


if __name__ == "__main__":
    unittest.main()
