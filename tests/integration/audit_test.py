# SPDX-License-Identifier: Apache-2.0
"""`xauto profile --audit`: a DLA stage that also uses the GPU is found, and whoever else uses the GPU is not taken for it.
A false alarm has a chance of 1 in 10 000 in each of these profiles, by the rule itself (lib/profile/audit.h)."""
import json
import pathlib
import tempfile
import unittest

from common import BIN, xauto

FALLBACK = BIN / "fallback"
BUSY = ["background", "2000", "7000"]


class Audit(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def audit(self, *app, status=0, repetitions=30):
        xpus = [{"id": f"{type}{i}", "type": type, "preemptive": True, "preempt_us": 0, "timeslice_us": 1000}
                for type, i in (("gpu", 0), ("dla", 0))] + \
               [{"id": f"{type}0", "type": type, "preemptive": False, "preempt_us": 0, "timeslice_us": 0}
                for type in ("cpu", "npu")]
        (self.folder / "platform.json").write_text(json.dumps(
            {"schema": "xauto.platform", "version": 1, "name": "bench", "xpus": xpus}))
        done = xauto("profile", "--platform", "platform.json", "--audit", "--warmup", 1, "--repetitions", repetitions, "--out",
                     "profile.json", "--", FALLBACK, self.folder / "lock", *app, cwd=self.folder)
        self.assertEqual(done.returncode, status, done.stdout + done.stderr)
        if status != 2:
            profile = json.loads((self.folder / "profile.json").read_text())
            self.others = {x["name"]: {on: s.get("others", {}) for on, s in x["on"].items()} for x in profile["xnodes"]}
        return done

    def line(self, done, xnode):
        table = done.stdout[done.stdout.index("busy beside/without"):]
        lines = table.splitlines()
        return next(row + verdict for row, verdict in zip(lines, lines[1:]) if row.split()[:1] == [xnode])

    def test_a_stage_that_falls_back_is_found(self):
        # Under load more repetitions: of a pair the background alone may have the longer part.
        for background, repetitions in (([], 30), (BUSY, 60)):
            with self.subTest(background=background):
                done = self.audit("fallback", "2500", *background, status=1, repetitions=repetitions)
                self.assertIn("XNode 'm.infer' is said to run on dla0, and is also on gpu0", done.stderr)
                self.assertIn("also on gpu0", self.line(done, "m.infer"))
                gpu = self.others["m.infer"]["dla0"]["gpu0"]
                self.assertTrue(gpu["used"])
                self.assertGreaterEqual(gpu["busy_us"], 2500, "all that it ran there, and the background's")
                self.assertIn("on no other", self.line(done, "m.plain"))
                self.assertFalse(any(o["used"] for o in self.others["m.plain"]["gpu0"].values()))

    def test_who_else_uses_the_gpu_is_no_fallback(self):
        done = self.audit(*BUSY)
        gpu = self.others["m.infer"]["dla0"]["gpu0"]
        self.assertFalse(gpu["used"])
        self.assertGreater(gpu["busy_us"] + gpu["idle_us"], 0, "it was seen")
        self.assertIn("on no other", self.line(done, "m.infer"))

    def test_what_nobody_tells_of_is_said(self):
        done = self.audit()
        self.assertIn("on no other that is seen", self.line(done, "m.work"), "a real stage, and no driver of a GPU here")
        self.assertEqual(self.others["m.engine"]["npu0"].keys(), {"cpu0"})
        self.assertFalse(self.others["m.engine"]["npu0"]["cpu0"]["used"], "a CPU is shown and not judged")

    def test_too_few_repetitions_are_refused(self):
        done = self.audit(repetitions=5, status=2)
        self.assertIn("5 repetitions cannot tell use from chance", done.stderr)
        # 4 pairs: m.infer beside gpu0 and npu0, m.plain beside dla0 and npu0. 4 / 2^16 is below 1e-4, 4 / 2^15 is not.
        self.assertIn("--repetitions 16", done.stderr)


if __name__ == "__main__":
    unittest.main()
