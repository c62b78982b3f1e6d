#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A suspended job that a more urgent one waits for gets that one's urgency, and the run says so. The policy's
keys are written here, and `xauto check` says that they hold: of two releases the second's job of P has time until
40 ms after the first's release, M's until 38 ms, and the first's job of C until 30 ms.

Without it no round of tests/integration/apps/heldup.cc ever ends. No test here depends on time: 20 s are the app's
patience."""
import json
import os
import pathlib
import re
import tempfile
import unittest

from common import BIN, sourced, xauto

HELDUP = str(BIN / "heldup")
PLACES = {"p.work": "gpu0", "m.meet": "cpu1", "m.work": "gpu0", "c.meet": "cpu0"}
KEYS = {"p.work": 20_000, "m.meet": 6000, "m.work": 18_000, "c.meet": 25_000, "c.work": 30_000}


class HeldUp(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def path(self, name, value=None):
        path = os.path.join(self.folder, name)
        if value is not None:
            pathlib.Path(path).write_text(json.dumps(value))
        return path

    def run_app(self, c_on, *flags, app=()):
        xpus = [(x, x[:3], True) for x in ("cpu0", "cpu1", "gpu0", "dla0")]
        platform = self.path("platform.json", {"schema": "xauto.platform", "version": 1, "name": "test", "xpus": [
            {"id": i, "type": t, "preemptive": p, "preempt_us": 0} for i, t, p in xpus]})
        types = {"p.work": ["gpu"], "m.meet": ["cpu"], "m.work": ["gpu"], "c.meet": ["cpu"], "c.work": ["dla", "gpu"]}
        spec = self.path("app.json", sourced({
            "name": "heldup",
            "xnodes": [{"name": n, "module": n[0].upper(), "wcet_us": dict.fromkeys(on, 5000)} for n, on in types.items()],
            "edges": [["p.work", "c.meet"], ["c.meet", "c.work"], ["m.meet", "m.work"]]}, "tick", 20_000))
        policy = self.path("policy.json")
        done = xauto("solve", "--app", spec, "--platform", platform, "--out", policy)
        self.assertEqual(done.returncode, 0, done.stderr)
        chosen = json.loads(pathlib.Path(policy).read_text())
        chosen["xnodes"] = [{"name": n, "xpu": {**PLACES, "c.work": c_on}[n], "key_us": [KEYS[n]]} for n in types]
        chosen.pop("order", None)
        for chain in chosen["chains"]:
            chain.update(worst_case_us=KEYS[chain["name"].removeprefix("tick -> ")], lower_bound_us=0, optimal=False)
        self.path("policy.json", chosen)
        done = xauto("check", "--app", spec, "--platform", platform, "--policy", policy)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        done = xauto("run", "--app", spec, "--platform", platform, "--policy", policy, "--emulate", "cpu,gpu,dla",
                     "--activations", 10, "--overload", "queue:64", "--json", "--trace-out", self.path("run.pftrace"), *flags,
                     "--", HELDUP, self.path("shared"), *app, timeout=240)
        rounds = re.search(r"rounds (\d+) stuck (\d+)", done.stderr)
        self.assertTrue(done.stdout and rounds, done.stderr)
        return done, json.loads(done.stdout)["runs"][0], tuple(map(int, rounds.groups()))

    def check_held_up(self, c_on, *flags):
        done, run, rounds = self.run_app(c_on, *flags)
        self.assertEqual((rounds, run["lost_activations"]), ((5, 0), 0), done.stderr)
        held_up, = [a["count"] for a in run["claims"]["assumptions"] if a["kind"] == "held_up_job"]
        self.assertTrue(1 <= held_up <= 5, held_up)
        self.assertIn(f"{held_up} suspended jobs held up a more urgent one", "; ".join(run["claims"]["broken"]))
        self.assertIn("XNode 'p.work' was suspended on gpu0 while the more urgent 'c.work' waits", done.stderr)
        trace = pathlib.Path(self.path("run.pftrace")).read_bytes()
        self.assertIn(b"p.work was suspended while c.work waits for its work", trace)

    def test_on_another_xpu(self):
        self.check_held_up("dla0")

    def test_on_its_own_xpu(self):
        self.check_held_up("gpu0")

    def test_in_another_process(self):
        self.check_held_up("dla0", "--isolate")

    def test_who_does_not_wait_is_not_held_up(self):
        done, run, rounds = self.run_app("dla0", app=["polite"])
        self.assertEqual((rounds, run["lost_activations"]), ((5, 0), 0), done.stderr)
        self.assertNotIn("held_up_job", str(run["claims"]))
        self.assertNotIn("was suspended", done.stderr)


if __name__ == "__main__":
    unittest.main()
