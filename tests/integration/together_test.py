# SPDX-License-Identifier: Apache-2.0
"""Several apps on one machine, as a user plans them: all at once, or one beside the demand of the others."""
import json
import pathlib
import tempfile
import unittest

from common import APP, SOURCE, xauto

DRIVING = SOURCE / "examples/driving/rates.json"
CABIN = {"schema": "xauto.app", "version": 3, "name": "cabin",
         "sources": [{"name": "mic", "rate_hz": 25, "jitter_us": 100}],
         "xnodes": [{"name": "hear.pre", "module": "hear", "source": "mic", "wcet_us": {"cpu": 500}},
                    {"name": "hear.infer", "module": "hear", "wcet_us": {"gpu": 1500}}],
         "edges": [["hear.pre", "hear.infer"]]}
SOLVE = ("solve", "--platform", "small", "--max-evaluations", 1500, "--time-limit", "60s")


class Together(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.at = pathlib.Path(folder.name)
        (self.at / "cabin.json").write_text(json.dumps(CABIN))

    def done(self, *arguments, status=0):
        done = xauto(*arguments, cwd=self.at)
        self.assertEqual(done.returncode, status, done.stdout + done.stderr)
        return done.stdout if status == 0 else done.stderr

    def both(self, verb, first, second, *arguments):
        return self.done(verb, "--app", DRIVING, "--app", "cabin.json", "--policy", first, "--policy", second, *arguments)

    def test_planned_together_each_has_its_policy(self):
        told = json.loads(self.done(*SOLVE, "--app", DRIVING, "--app", "cabin.json", "--out", "d.json", "--out", "c.json", "--json"))
        files = [json.loads((self.at / name).read_text()) for name in ("d.json", "c.json")]
        self.assertEqual(told["policies"], files)
        self.assertEqual([f["app"] for f in files], ["driving-rates", "cabin"])
        self.assertIn("tell the truth", self.both("check", "d.json", "c.json"))
        for app, policy in ((DRIVING, "d.json"), ("cabin.json", "c.json")):
            self.assertIn("tells the truth", self.done("check", "--app", app, "--policy", policy))
        played = json.loads(self.both("simulate", "d.json", "c.json", "--phases", "--jitter", "--duration", "20s", "--json"))
        self.assertEqual(played["late"], 0)
        self.assertGreater(played["jobs"], 10_000)
        self.assertIn("cabin/hear.infer", [x["name"] for x in played["xnodes"]])

    def test_with_a_reserve_a_newcomer_finds_room_and_no_claim_changes(self):
        self.done(*SOLVE, "--app", DRIVING, "--reserve", 10, "--out", "d.json", "--demand-out", "demand.json")
        self.assertIn("10 %", self.done("check", "--app", DRIVING, "--policy", "d.json", "--reserve", 10))
        self.assertNotIn("td.infer", (self.at / "demand.json").read_text())
        self.done(*SOLVE, "--app", "cabin.json", "--beside", "demand.json", "--out", "c.json")
        said = self.done("check", "--app", "cabin.json", "--policy", "c.json", "--beside", "demand.json")
        self.assertIn("taken  demand.json", said)
        self.assertIn("those of the demands, and nobody else", said)
        self.assertIn("tell the truth", self.both("check", "d.json", "c.json"))
        # What check writes is what solve wrote.
        self.done("check", "--app", DRIVING, "--policy", "d.json", "--demand-out", "again.json")
        self.assertEqual((self.at / "again.json").read_text(), (self.at / "demand.json").read_text())

    def test_without_one_it_is_refused_with_the_xpu_and_what_is_missing(self):
        self.done(*SOLVE, "--app", DRIVING, "--out", "d.json", "--demand-out", "demand.json")
        busy = json.loads(json.dumps(CABIN))
        busy["xnodes"][1]["wcet_us"]["gpu"] = 20_000
        (self.at / "busy.json").write_text(json.dumps(busy))
        said = self.done(*SOLVE, "--app", "busy.json", "--beside", "demand.json", "--out", "b.json", status=1)
        self.assertRegex(said, r"no policy was found beside 1 demand .*XPU gpu0.*(too much|load it by)")
        self.assertFalse((self.at / "b.json").exists())
        # To the check it is true, and asked for too much.
        said = xauto("check", "--app", DRIVING, "--policy", "d.json", "--reserve", 30, cwd=self.at)
        self.assertEqual(said.returncode, 1, said.stderr)
        self.assertRegex(said.stdout, r"MISSED with 30 % of each XPU left: XPU gpu0")
        self.assertIn("d.json tells the truth: ", said.stdout)
        told = json.loads(xauto("check", "--app", DRIVING, "--policy", "d.json", "--reserve", 30, "--json", cwd=self.at).stdout)
        self.assertTrue(told["truthful"] and told["missed"] and not told["lies"])

    def test_what_does_not_go_together_is_said(self):
        self.done(*SOLVE, "--app", "cabin.json", "--out", "c.json", "--demand-out", "demand.json")
        self.done(*SOLVE, "--app", APP, "--out", "one.json")
        for arguments, said in (
                ((*SOLVE, "--app", "cabin.json", "--app", "cabin.json"), "two apps are called 'cabin'"),
                ((*SOLVE, "--app", "cabin.json", "--app", APP), "its sources have no rate"),
                ((*SOLVE, "--app", APP, "--beside", "demand.json"), "its sources have no rate"),
                (("check", "--app", APP, "--policy", "one.json", "--reserve", 5), "its sources have no rate"),
                ((*SOLVE, "--app", APP, "--demand-out", "x.json"), "no demand bounds that"),
                ((*SOLVE, "--app", DRIVING, "--app", "cabin.json", "--out", "x.json"), "--out: 1 files for 2 apps"),
                ((*SOLVE, "--app", DRIVING, "--app", "cabin.json", "--hint", "c.json"), "does not go with several --app"),
                ((*SOLVE, "--app", "cabin.json", "--reserve", 5, "--method", "heft"), "does not go with"),
                (("check", "--app", "cabin.json", "--policy", "c.json", "--platform", "large", "--beside", "none.json"), "none.json"),
                (("check", "--app", "cabin.json", "--app", DRIVING, "--policy", "c.json"), "--policy: 1 files for 2 apps")):
            self.assertIn(said, self.done(*arguments, status=2), arguments)


if __name__ == "__main__":
    unittest.main()
