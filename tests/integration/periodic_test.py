# SPDX-License-Identifier: Apache-2.0
"""An app from file to policy: solve, check and simulate agree, and each says no where the answer is no."""
import json
import pathlib
import re
import tempfile
import unittest
from xml.etree import ElementTree

from common import SOURCE, xauto

APP = SOURCE / "tests/golden/app-rates.json"
PLATFORM = {"schema": "xauto.platform", "version": 1, "name": "bench", "xpus": [
    {"id": "cpu0", "type": "cpu"}, {"id": "cpu1", "type": "cpu"},
    {"id": "gpu0", "type": "gpu", "preempt_us": 100},
    {"id": "dla0", "type": "dla", "preemptive": False}]}


class Periodic(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.app = json.loads(APP.read_text())
        self.platform = self.write("platform.json", PLATFORM)

    def write(self, name, value):
        (self.folder / name).write_text(json.dumps(value))
        return name

    def run_tool(self, *arguments, status=0):
        result = xauto(*arguments, "--platform", self.platform, cwd=self.folder)
        self.assertEqual(result.returncode, status, result.stdout + result.stderr)
        return result

    def solve(self, *more, status=0):
        self.write("app.json", self.app)
        return self.run_tool("solve", "--app", "app.json", "--max-evaluations", 2000, "--threads", 1, "--time-limit", "60s",
                             "--out", "policy.json", *more, status=status)

    def certified(self):
        """Late or not: what solve prints of a certified policy."""
        self.write("app.json", self.app)
        told = json.loads(xauto("solve", "--app", "app.json", "--platform", self.platform, "--max-evaluations", 2000,
                                "--threads", 1, "--time-limit", "60s", "--json", cwd=self.folder).stdout)
        self.assertEqual(told["schema"], "xauto.policy")
        return told

    def policy(self):
        return json.loads((self.folder / "policy.json").read_text())

    def check(self, status=0):
        return json.loads(self.run_tool("check", "--app", "app.json", "--policy", "policy.json", "--json", status=status).stdout)

    def test_solve_check_and_simulate_agree(self):
        answer = json.loads(self.solve("--json").stdout)
        claims = {chain["name"]: chain for chain in answer["chains"]}
        self.assertEqual(set(claims), {chain["name"] for chain in self.app["chains"]})
        self.assertEqual(self.policy()["chains"], answer["chains"])
        checked = self.check()
        self.assertTrue(checked["truthful"])
        for chain in checked["chains"]:
            claim = claims[chain["name"]]
            self.assertLessEqual(chain["worst_case_us"], claim["worst_case_us"])
            self.assertLessEqual(claim["lower_bound_us"], chain["worst_case_us"])
        self.assertEqual([proof["xpu"] for proof in checked["proofs"]], ["cpu0", "cpu1", "gpu0", "dla0"])
        for seed in (1, 2, 3):
            played = json.loads(self.run_tool("simulate", "--app", "app.json", "--policy", "policy.json", "--duration", "20s",
                                              "--random-times", "--jitter", "--phases", "--seed", seed, "--json").stdout)
            self.assertGreater(played["jobs"], 1000)
            self.assertEqual(played["late"], 0)
            for chain in played["chains"]:
                self.assertGreater(chain["releases"], 0)
                self.assertLessEqual(chain["longest_us"], claims[chain["name"]]["worst_case_us"])
                self.assertLessEqual(0, chain["median_us"])
                self.assertLessEqual(chain["median_us"], chain["p99_us"])
                self.assertLessEqual(chain["p99_us"], chain["longest_us"])
                self.assertGreater(chain["p99_us"], 0)

    def test_the_answer_depends_on_the_seed_alone(self):
        self.solve("--seed", 5)
        first = self.policy()
        self.solve("--seed", 5)
        second = self.policy()
        first.pop("solve_us"), second.pop("solve_us")
        self.assertEqual(first, second)

    def test_the_tables_name_chains_and_xpus(self):
        table = self.solve().stdout
        for word in ("brake", "cpu0", "gpu0", "worst case", "deadline", "lower bound", "written to policy.json"):
            self.assertIn(word, table)
        checked = self.run_tool("check", "--app", "app.json", "--policy", "policy.json").stdout
        self.assertIn("policy.json tells the truth", checked)
        played = self.run_tool("simulate", "--app", "app.json", "--policy", "policy.json").stdout
        self.assertIn("0 late", played)

    def test_true_numbers_that_miss_a_deadline_end_with_the_reason_of_the_status(self):
        chain = self.app["chains"][0]
        chain["deadline_us"] = 1
        self.solve(status=1)
        self.assertEqual([m.split(":")[0] for m in self.check(status=1)["missed"]], [f"chain '{chain['name']}'"])
        said = self.run_tool("check", "--app", "app.json", "--policy", "policy.json", status=1).stdout
        self.assertIn("policy.json tells the truth", said)
        self.assertRegex(said.splitlines()[-1], f"^But it misses what was asked for, so the exit status is 1: chain '{chain['name']}': ")

    def test_a_claim_that_does_not_follow_is_a_lie(self):
        self.solve()
        policy = self.policy()
        policy["chains"][0]["worst_case_us"] -= 1000
        policy["chains"][0]["lower_bound_us"] = 0
        policy["chains"][0]["optimal"] = False
        self.write("policy.json", policy)
        checked = self.check(status=1)
        self.assertFalse(checked["truthful"])
        self.assertIn(policy["chains"][0]["name"], checked["lies"][0])

    def test_more_work_than_time_is_proven(self):
        for xnode in self.app["xnodes"]:
            if xnode["name"] == "mpc":
                xnode["wcet_us"] = {"cpu": 45000}
        result = self.solve("--json", status=1)
        told = json.loads(result.stdout)
        self.assertEqual((told["schema"], told["outcome"]), ("xauto.uncertified", "unsustainable"))
        self.assertIn("mpc", result.stdout)
        said = self.solve(status=1).stdout
        for words in ("no policy keeps up", "nothing is claimed of it", "written to policy.json"):
            self.assertIn(words, said)

    def test_where_nothing_is_certified_there_is_a_policy_without_claims(self):
        for xnode in self.app["xnodes"]:
            if xnode["name"] == "mpc":
                xnode["wcet_us"] = {"cpu": 45000}
        told = json.loads(self.solve("--json", "--assume", "tick=10", status=1).stdout)
        self.assertEqual(self.policy()["xnodes"], told["policy"]["xnodes"])
        self.assertIs(self.policy()["certified"], False)
        self.assertNotIn("chains", self.policy())
        self.assertEqual([what["change"] for what in told["what_if"]], ["tick at 10 Hz"])
        checked = self.check()
        self.assertEqual((checked["truthful"], checked["certified"], checked["chains"]), (True, False, []))
        said = self.run_tool("check", "--app", "app.json", "--policy", "policy.json").stdout
        self.assertIn("nothing is claimed of any time", said)
        played = json.loads(self.run_tool("simulate", "--app", "app.json", "--policy", "policy.json", "--json").stdout)
        self.assertIs(played["certified"], False)
        self.assertFalse(any("worst_case_us" in chain for chain in played["chains"]))
        refused = xauto("explain", "--app", "app.json", "--policy", "policy.json", "--platform", self.platform, cwd=self.folder)
        self.assertEqual(refused.returncode, 2)
        self.assertIn("is not certified: it claims nothing that could be derived", refused.stderr)
        # A claim that is written into it is refused.
        policy = self.policy()
        policy["chains"] = [{"name": c["name"], "worst_case_us": 1, "lower_bound_us": 1, "optimal": True}
                            for c in self.app["chains"]]
        self.write("policy.json", policy)
        refused = xauto("check", "--app", "app.json", "--policy", "policy.json", "--platform", self.platform, cwd=self.folder)
        self.assertEqual(refused.returncode, 2)
        self.assertIn("claims something, and the policy is not certified", refused.stderr)

    def test_with_the_margin_that_is_suggested_the_same_app_is_certified(self):
        for xnode in self.app["xnodes"]:
            if xnode["name"] == "mpc":
                xnode["wcet_us"] = {"cpu": 45000}
        told = json.loads(self.solve("--json", status=1).stdout)
        margin = next(r["wcets_pct"] for r in told["remedies"] if "wcets_pct" in r)
        self.assertLess(margin, told["overloaded_pct"])
        whole = json.loads(json.dumps(self.app))
        for xnode in self.app["xnodes"]:
            xnode["wcet_us"] = {t: -(-us * margin // 100) for t, us in xnode["wcet_us"].items()}
            xnode.pop("typical_us", None)
            xnode.pop("variants", None)
        answer = self.certified()
        self.assertNotIn("certified", answer)
        self.app = whole
        rates = [r for r in told["remedies"] if "source" in r]
        for remedy in rates[:1]:
            for source in self.app["sources"]:
                if source["name"] == remedy["source"]:
                    source.pop("period_us", None)
                    source["rate_hz"] = remedy["rate_hz"]
            self.assertNotIn("certified", self.certified())

    def refused(self, xnodes, *more, edges=()):
        """App of one source of 100 ms on two CPUs and a GPU that keeps up with nothing: what solve tells."""
        self.platform = self.write("platform.json", {"schema": "xauto.platform", "version": 1, "name": "three", "xpus": [
            {"id": "cpu0", "type": "cpu"}, {"id": "cpu1", "type": "cpu"}, {"id": "gpu0", "type": "gpu"}]})
        self.app = {"schema": "xauto.app", "version": 3, "name": "much", "sources": [{"name": "s", "period_us": 100000}],
                    "edges": list(edges),
                    "xnodes": [{"module": x["name"], "source": "s"} | x for x in xnodes]}
        told = json.loads(self.solve("--json", *more, status=1).stdout)
        self.assertEqual((told["schema"], told["outcome"]), ("xauto.uncertified", "unsustainable"))
        self.assertIn("no policy keeps up", self.solve(*more, status=1).stdout)
        return told

    def test_a_refusal_says_how_much_is_asked_or_nothing(self):
        def cpu(ms, *names):
            return [{"name": name, "wcet_us": {"cpu": round(1000 * ms)}} for name in names]
        self.assertEqual(self.refused(cpu(200, "a"))["load_pct"], 200, "one takes longer than its period")
        self.assertEqual(self.refused(cpu(70, "a", "b", "c"))["load_pct"], 105, "all together")
        self.assertIsNone(self.refused(cpu(60, "a", "b", "c"))["load_pct"], "90 %, but three are not two")
        self.assertIsNone(self.refused(cpu(50.1, "a", "b", "c"))["load_pct"])
        pinned = self.refused(cpu(60, "a", "b"), "--pin", "a=cpu0", "--pin", "b=cpu0")
        self.assertEqual((pinned["load_pct"], pinned["proof"]), (120, "cpu0 at least 120 %"))
        self.assertIn("cpu0", pinned["weights"])
        self.assertEqual(self.refused(cpu(55, "a", "b"), "--forbid", "a=cpu0", "--forbid", "b=cpu0")["load_pct"], 110)
        self.assertEqual(self.refused(cpu(52, "a", "b"), "--group", "a,b")["load_pct"], 104)
        way = [{"name": "a.1", "module": "a", "wcet_us": {"cpu": 60000}}]
        way.append({"name": "a.2", "module": "a", "wcet_us": {"gpu": 60000}, "source": None})
        self.assertEqual(self.refused(way, edges=[["a.1", "a.2"]])["load_pct"], 120, "two stages, one in flight")
        self.assertEqual(self.refused(cpu(10, *(f"x{i}" for i in range(30))))["load_pct"], 150)

    def test_a_missed_deadline_is_status_1_proven_or_not(self):
        bounds = {c["name"]: c["lower_bound_us"] for c in json.loads(self.solve("--json").stdout)["chains"]}
        for chain in self.app["chains"]:
            chain["deadline_us"] = max(1, bounds[chain["name"]])
        self.write("app.json", self.app)
        told = json.loads(self.run_tool("solve", "--app", "app.json", "--max-evaluations", 1, "--threads", 1, "--json", status=1).stdout)
        self.assertIn(told["deadlines"], ("missed; not proven impossible", "proven impossible"))
        self.assertTrue(any(c["worst_case_us"] > bounds[c["name"]] for c in told["chains"]))

    def test_a_wcet_far_above_what_is_usual_is_named_where_it_decides(self):
        spiky = {"name": "spiky", "wcet_us": {"cpu": 150000}, "typical_us": {"cpu": 600}}
        calm = {"name": "calm", "wcet_us": {"cpu": 900}, "typical_us": {"cpu": 500}}
        told = self.refused([spiky, calm])
        self.assertEqual(told["rare_wcets"], [{"xnode": "spiky", "type": "cpu", "wcet_us": 150000, "typical_us": 600}])
        self.assertIn("usually", self.solve(status=1).stdout)
        heavy = [{"name": f"h{i}", "wcet_us": {"cpu": 90000}} for i in range(3)]
        self.assertNotIn("rare_wcets", self.refused([spiky | {"wcet_us": {"cpu": 5000}}, *heavy]), "at 600 us it is no different")
        # It fits, and is on the way of what is late, beside it on the XPU, or most of a worst case.
        spiky["wcet_us"] = {"cpu": 32000}
        for deadline, status, named in ((50000, 0, ["spiky"]), (20000, 1, ["spiky"])):
            self.app["xnodes"] = [x | {"module": x["name"], "source": "s"} for x in (spiky, calm)]
            self.app["chains"] = [{"name": "c", "from": "s", "to": "spiky", "deadline_us": deadline}]
            told = json.loads(self.solve("--json", status=status).stdout)
            self.assertEqual([r["xnode"] for r in told["rare_wcets"]], named)
        spiky["typical_us"] = {"cpu": 16000}
        self.app["xnodes"][0] |= spiky
        self.assertNotIn("rare_wcets", json.loads(self.solve("--json", status=1).stdout), "twice is not above twice")

    def test_the_answer_says_what_was_minimised(self):
        for chain in self.app["chains"]:
            chain["deadline_us"] = 200000
        told = {}
        for asked, option in (("mix", []), ("largest", ["--objective", "largest"]), ("sum", ["--objective", "sum"])):
            told[asked] = json.loads(self.solve("--json", *option).stdout)["objective"]
            self.assertEqual((told[asked]["asked"], told[asked]["of"]), (asked, "worst case / deadline"))
            for figure in ("largest", "sum"):
                self.assertLessEqual(told[asked][figure]["lower_bound"], told[asked][figure]["value"] * (1 + 1e-9))
            worst = [c["worst_case_us"] / 200000 for c in self.policy()["chains"]]
            self.assertAlmostEqual(told[asked]["largest"]["value"], max(worst))
        self.assertLessEqual(told["mix"]["largest"]["value"], 1.05 * told["mix"]["least_largest_found"] + 1e-5)
        self.assertNotIn("least_largest_found", told["sum"])
        self.assertIn("objective: no deadline is missed; then the least of the largest worst case / deadline",
                      self.solve("--objective", "largest").stdout)
        self.assertIn("the largest of them within 5 % of the least found", self.solve().stdout)
        self.assertIn("last, no claim being longer, the least typical latency", self.solve().stdout)
        self.assertIn("objective", self.solve("--objective", "shortest", status=2).stderr)
        one = self.run_tool("solve", "--app", str(SOURCE / "tests/golden/app.json"))
        self.assertIn("the least of the largest worst case", one.stdout, "no source has a rate")
        self.assertNotIn("typical latency", one.stdout)
        for chain in self.app["chains"]:
            del chain["deadline_us"]
        self.assertEqual(json.loads(self.solve("--json").stdout)["objective"]["of"], "worst case")
        self.assertRegex(self.solve().stdout, r"(?m)^  objective: the least weighted sum of worst case,$")
        self.assertRegex(self.solve().stdout, r"(?m)^    the largest of them within 5 % of the least found \([0-9.]+ ms\)$")
        self.assertRegex(self.solve("--objective", "sum").stdout, r"(?m)^  objective: the least weighted sum of worst case$")

    def test_a_deadline_below_the_bound_is_proven_impossible(self):
        self.app["chains"][0]["deadline_us"] = 1000
        told = json.loads(self.solve("--json", status=1).stdout)
        self.assertEqual(told["deadlines"], "proven impossible")

    def test_pins_are_kept_and_a_hint_is_a_beginning(self):
        self.solve("--pin", "mpc=cpu1")
        placed = {x["name"]: x["xpu"] for x in self.policy()["xnodes"]}
        self.assertEqual(placed["mpc"], "cpu1")
        self.write("hint.json", self.policy())
        self.assertRegex(self.solve("--hint", "hint.json", "--pin", "mpc=cpu1").stdout, rf"moved: \d+ of the {len(placed)} XNodes")

    def test_who_moves_from_where_a_hint_has_it_is_told(self):
        self.solve()
        placed = {x["name"]: x["xpu"] for x in self.policy()["xnodes"]}
        self.write("hint.json", self.policy())
        for us in self.app["xnodes"][0]["wcet_us"]:
            self.app["xnodes"][0]["wcet_us"][us] += 1
        told = json.loads(self.solve("--hint", "hint.json", "--json", "--forbid", "mpc=" + placed["mpc"]).stdout)
        now = {x["name"]: x["xpu"] for x in self.policy()["xnodes"]}
        self.assertEqual({(m["xnode"], m["from"], m["to"]) for m in told["moved"]},
                         {(name, placed[name], xpu) for name, xpu in now.items() if placed[name] != xpu})
        self.assertIn("mpc", [m["xnode"] for m in told["moved"]])

    def test_check_holds_pins_against_a_policy(self):
        self.solve("--pin", "mpc=cpu1")
        checked = self.run_tool("check", "--app", "app.json", "--policy", "policy.json", "--pin", "mpc=cpu0", status=1)
        self.assertIn("XNode 'mpc' runs on cpu1, pinned to cpu0", checked.stdout)

    def test_what_would_be_if(self):
        told = self.solve("--assume", "tick=100", "--assume", "gpu=50%", "--assume", "+dla", "--assume", "tick=5000", "--json").stdout
        cases = json.loads(told)["what_if"]
        self.assertEqual([case["change"] for case in cases],
                         ["tick at 100 Hz", "gpu at 50 % of its WCETs", "one more dla", "tick at 5000 Hz"])
        self.assertEqual([case["outcome"] for case in cases], ["policy", "policy", "policy", "unsustainable"])
        self.assertIn("mpc", cases[3]["proof"] + told)
        table = self.solve("--assume", "tick=100").stdout
        self.assertIn("tick at 100 Hz", table)
        for wrong in ("tick", "nobody=30", "gpu=0%", "+npu", "tick=50"):
            self.assertIn("--assume", self.solve("--assume", wrong, status=2).stderr)

    def test_explain_names_windows_paths_and_moves(self):
        self.solve()
        told = json.loads(self.run_tool("explain", "--app", "app.json", "--policy", "policy.json", "--json").stdout)
        self.assertEqual({chain["name"] for chain in told["chains"]}, {chain["name"] for chain in self.app["chains"]})
        self.assertTrue(any(move["change"].startswith("mpc on cpu") for move in told["moves"]), told["moves"])
        # The whole way: each XNode on it follows the one before by an edge or a sample, and may move.
        steps = {tuple(edge) if isinstance(edge, list) else (edge["from"], edge["to"])
                 for edge in self.app["edges"] + self.app["samples"]}
        for chain in told["chains"]:
            for step in zip(chain["path"][1:], chain["path"][2:]):
                self.assertIn(step, steps)
        # `check` names the same way, and words say what JSON says.
        paths = {chain["name"]: chain["path"] for chain in told["chains"]}
        self.assertEqual({chain["name"]: chain["path"] for chain in self.check()["chains"]}, paths)
        words = self.run_tool("check", "--app", "app.json", "--policy", "policy.json").stdout
        for name, path in paths.items():
            self.assertRegex(" ".join(words.split()), rf" {re.escape(name)} [\d.]+ ms [\d.]+ ms along {re.escape(' > '.join(path))} ")
        moved = {move["change"].split(" on ")[0] for move in told["moves"]}
        brake = next(chain for chain in told["chains"] if chain["name"] == "brake")
        self.assertIn("fcd.infer", brake["path"])
        tightest = {proof["tightest"]["xnode"] for proof in told["proofs"] if "tightest" in proof}
        self.assertLessEqual({x["name"] for x in self.app["xnodes"] if "cpu" in x["wcet_us"] and
                              (x["name"] in brake["path"] or x["name"] in tightest)}, moved)
        self.assertIn("The worst off is brake", self.run_tool("explain", "--app", "app.json", "--policy", "policy.json").stdout)
        self.assertEqual(told["moves_untried"], 0)
        hurried = json.loads(self.run_tool("explain", "--app", "app.json", "--policy", "policy.json", "--json", "--time-limit", "0s").stdout)
        self.assertEqual((hurried["moves"], hurried["moves_untried"] >= len(told["moves"])), ([], True))
        self.assertRegex(self.run_tool("explain", "--app", "app.json", "--policy", "policy.json", "--time-limit", "0s").stdout,
                         r"(?m)^  \d+ more were not tried in 0 s \(--time-limit\)\.$")

    def test_explain_says_what_holds_are_for(self):
        """What it names is what `check` derives from the same policy without that hold."""
        self.solve()
        flags = ("--app", "app.json", "--policy", "policy.json")
        told = json.loads(self.run_tool("explain", *flags, "--json", "--time-limit", "20s").stdout)
        policy = self.policy()
        held = {x["name"]: max(x["hold_us"]) for x in policy["xnodes"] if any(x.get("hold_us", []))}
        self.assertGreater(len(held), 0, policy)
        self.assertEqual({hold["xnode"]: hold["longest_us"] for hold in told["holds"]}, held)
        self.assertEqual(told["holds_untried"], 0)
        for hold in told["holds"]:
            self.assertTrue(hold["worst_cases"] or hold.get("keys_on"), hold)
            self.assertTrue(all(one["without_us"] < one["with_us"] for one in hold["medians"]), hold)
            without = json.loads(json.dumps(policy))
            for xnode in without["xnodes"]:
                for key in ("start_us", "finish_us") + (("hold_us",) if xnode["name"] == hold["xnode"] else ()):
                    xnode.pop(key, None)
            self.write("without.json", without)
            refused = self.run_tool("check", "--app", "app.json", "--policy", "without.json", "--json", status=1)
            derived = {chain["name"]: chain["worst_case_us"] for chain in json.loads(refused.stdout)["chains"]}
            for one in hold["worst_cases"]:
                self.assertEqual(derived[one["name"]], one["without_us"], hold)
        words = " ".join(self.run_tool("explain", *flags).stdout.split())
        for name in held:
            self.assertIn(f" {name} up to ", words)
        hurried = json.loads(self.run_tool("explain", *flags, "--json", "--time-limit", "0s").stdout)
        self.assertEqual((hurried["holds"], hurried["holds_untried"]), ([], len(held)))

    def test_explain_draws_the_windows(self):
        self.solve()
        self.run_tool("explain", "--app", "app.json", "--policy", "policy.json", "--windows", "windows.svg")
        svg = ElementTree.parse(self.folder / "windows.svg").getroot()
        self.assertEqual(svg.tag, "{http://www.w3.org/2000/svg}svg")
        titles = [title.text for title in svg.iter("{http://www.w3.org/2000/svg}title")]
        for xnode in self.policy()["xnodes"]:
            self.assertTrue(any(title.startswith(f"{xnode['name']} 0 on {xnode['xpu']}: ready by") for title in titles), xnode)
        refused = self.run_tool("explain", "--app", "app.json", "--policy", "policy.json", "--windows", "nowhere/w.svg", status=2)
        self.assertIn("--windows", refused.stderr)

    def test_what_is_of_one_release_is_refused_where_sources_have_rates(self):
        self.solve()
        refused = self.run_tool("solve", "--app", "app.json", "--method", "ilp", status=2)
        self.assertIn("plans one release", refused.stderr)


if __name__ == "__main__":
    unittest.main()
