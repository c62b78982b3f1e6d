# SPDX-License-Identifier: Apache-2.0
"""An app over two computers, as a user plans it. X of each crossing is computed here a third time, from the files."""
import json
import pathlib
import tempfile
import unittest

from common import SOURCE, xauto

DRIVING = SOURCE / "examples/driving/rates.json"
HOSTS = SOURCE / "examples/driving/two-hosts.json"
BYTES = {"ld.post": 120_000, "la.post": 4_000, "td.post": 1_000, "tc.post": 500, "fcd.post": 2_000, "rcd.post": 2_000}


class Hosts(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.at = pathlib.Path(folder.name)
        app = json.loads(DRIVING.read_text())
        for x in app["xnodes"]:
            if x["name"] in BYTES:
                x["message_bytes"] = BYTES[x["name"]]
        for module in app["modules"]:
            if module["name"] in ("LD", "RCD"):
                module["host"] = "rear"
            if module["name"] == "CTL":
                module["host"] = "front"
        self.app = app
        self.write("app.json", app)

    def write(self, name, value):
        (self.at / name).write_text(json.dumps(value))

    def done(self, *arguments, status=0):
        done = xauto(*arguments, cwd=self.at)
        self.assertEqual(done.returncode, status, done.stdout + done.stderr)
        return done.stdout + done.stderr

    def solved(self):
        self.done("solve", "--app", "app.json", "--platform", HOSTS, "--max-evaluations", 2000, "--time-limit", "60s",
                  "--out", "p.json")
        return json.loads((self.at / "p.json").read_text())

    def crossings(self, policy):
        platform = json.loads(HOSTS.read_text())
        host_of_xpu = {x["id"]: x["host"] for x in platform["xpus"]}
        host = {x["name"]: host_of_xpu[x["xpu"]] for x in policy["xnodes"]}
        for module in self.app["modules"]:
            on = {host[x["name"]] for x in self.app["xnodes"] if x["module"] == module["name"]}
            self.assertEqual(len(on), 1, module)
            self.assertIn(module.get("host", *on), on)
        messages = {(u, host[v]) for u, v in self.app["edges"] + self.app["samples"] if host[u] != host[v]}
        x_us = {}
        for link in platform["links"]:
            on_link = [m for m in messages if host[m[0]] == link["from"] and m[1] == link["to"]]
            takes = link["base_us"] + sum(-(-8 * BYTES.get(u, 0) // link["mbit_s"]) for u, _ in on_link)
            x_us.update({message: takes for message in on_link})
        return x_us

    def test_what_crosses_has_the_time_that_its_link_takes(self):
        policy = self.solved()
        stated = {(c["from"], c["to"]): c["x_us"] for c in policy["crossings"]}
        self.assertEqual(stated, self.crossings(policy))
        self.assertTrue(stated)
        said = self.done("check", "--app", "app.json", "--platform", HOSTS, "--policy", "p.json")
        self.assertIn("tells the truth", said)
        self.assertIn("by that one's clock", " ".join(said.split()))
        played = json.loads(self.done("simulate", "--app", "app.json", "--platform", HOSTS, "--policy", "p.json",
                                      "--random-times", "--jitter", "--phases", "--duration", "20s", "--json"))
        self.assertEqual(played["late"], 0)
        self.assertGreater(played["jobs"], 10_000)

    def test_a_shorter_crossing_is_no_policy(self):
        policy = self.solved()
        policy["crossings"][0]["x_us"] -= 1
        self.write("p.json", policy)
        self.assertIn("the link takes", self.done("check", "--app", "app.json", "--platform", HOSTS, "--policy", "p.json", status=2))

    def test_what_knows_one_computer_is_refused(self):
        solve = ("solve", "--app", "app.json", "--platform", HOSTS, "--time-limit", "1s")
        for more in (("--method", "heft"), ("--assume", "1.1x gpu"), ("--reserve", 10)):
            self.assertIn("several hosts", self.done(*solve, *more, status=2))
        self.write("s.json", {"schema": "xauto.scenarios", "version": 1, "app": "driving-rates",
                              "scenarios": [{"name": "a"}, {"name": "b", "wcet_scale_pct": {"gpu": 150}}]})
        self.assertIn("several hosts", self.done(*solve, "--scenarios", "s.json", "--tables", 1, status=2))
        self.app["modules"][0]["host"] = "nowhere"
        self.write("app.json", self.app)
        self.assertIn("has no such host", self.done(*solve, status=2))
        self.assertIn("has no hosts", self.done("solve", "--app", "app.json", "--platform", "small", "--time-limit", "1s", status=2))


if __name__ == "__main__":
    unittest.main()
