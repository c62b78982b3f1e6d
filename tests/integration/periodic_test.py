# SPDX-License-Identifier: Apache-2.0
"""xauto check and xauto simulate on an app of version 2."""
import json
import pathlib
import tempfile
import unittest

from common import xauto

GOLDEN = pathlib.Path(__file__).parent.parent / "golden"


class Periodic(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.at = pathlib.Path(folder.name)
        self.policy = json.loads((GOLDEN / "policy-2.json").read_text())
        for chain in self.policy["chains"]:
            chain.update(worst_case_us=40000, lower_bound_us=0, optimal=False)

    def call(self, verb, *arguments):
        path = self.at / "policy.json"
        path.write_text(json.dumps(self.policy))
        return xauto(verb, "--app", GOLDEN / "app-2.json", "--platform", GOLDEN / "platform.json", "--policy", path, *arguments)

    def test_check_shows_each_xpu_and_each_chain(self):
        checked = self.call("check")
        self.assertEqual(checked.returncode, 0, checked.stdout + checked.stderr)
        self.assertIn("schedule", checked.stdout)
        self.assertIn("chain 'steer' never takes longer than 25.50 ms, claimed 40.00 ms", checked.stdout)
        report = json.loads(self.call("check", "--json").stdout)
        self.assertTrue(report["truthful"])
        # The key of spur/größe, a period of mpc at 5 ppm, and mpc's longest key.
        self.assertEqual([c["derived_us"] for c in report["chains"] if c["name"] == "steer"], [3000 + 20001 + 2500])

    def test_check_refuses_a_claim_below_what_follows(self):
        self.policy["chains"][1]["worst_case_us"] = 25500
        checked = self.call("check")
        self.assertEqual(checked.returncode, 1, checked.stdout + checked.stderr)
        self.assertIn("LIE    chain 'steer': worst_case_us is 25500, what follows is 25501", checked.stdout)

    def test_check_holds_pins_against_it(self):
        checked = self.call("check", "--pin", "mpc=cpu1")
        self.assertEqual(checked.returncode, 1, checked.stdout + checked.stderr)
        self.assertIn("LIE    XNode 'mpc' runs on cpu0, pinned to cpu1", checked.stdout)

    def test_simulate_plays_and_tells_who_is_late(self):
        played = self.call("simulate", "--seconds", 5, "--random-times", "--jitter", "--phases", "--seed", 3, "--json")
        self.assertEqual(played.returncode, 0, played.stdout + played.stderr)
        report = json.loads(played.stdout)
        # Every 20 ms; clocks drift, and at the end one may be under way.
        self.assertAlmostEqual(next(x["jobs"] for x in report["xnodes"] if x["name"] == "mpc"), 250, delta=1)
        self.assertEqual(report["late"], 0)
        again = self.call("simulate", "--seconds", 5, "--random-times", "--jitter", "--phases", "--seed", 3, "--json")
        self.assertEqual(played.stdout, again.stdout)

    def test_simulate_ends_with_status_1_where_a_chain_takes_longer_than_claimed(self):
        self.policy["chains"][0]["worst_case_us"] = 12000
        played = self.call("simulate", "--seconds", 5)
        self.assertEqual(played.returncode, 1, played.stdout + played.stderr)


if __name__ == "__main__":
    unittest.main()
