# SPDX-License-Identifier: Apache-2.0
"""Sensors of several rates: a trace tells of every result what it was made of, `explain` accounts for it per chain, and
nothing that was not measured is printed as a number. The trace is read by pftrace.py, which shares no code with the
tools. No time is judged."""
import json
import pathlib
import re
import subprocess
import unittest

import pftrace
from common import XAUTO, xauto
from isolate_test import Case


class Rates(Case):
    def run_rates(self, *flags, activations=40):
        """testapp: A, B, C hear src (10 ms), and lose none of it. D joins it with src2 (33 ms). Sinks are C and D."""
        flags += tuple(self.deploy(queue_depth=256, keep=256, modules={m: {"overload": "queue:256"} for m in "ABC"}))
        command = self.command("--trace-out", self.path("t.pftrace"), "--timeline", self.path("t.html"), *flags,
                               period=10_000, activations=activations, more=("second", 33_000))
        done = subprocess.run(command, capture_output=True, text=True, timeout=100)
        self.assertEqual(done.returncode, 0, done.stderr)
        return json.loads(done.stdout)["runs"][0]

    def traced(self):
        return pftrace.Trace(pathlib.Path(self.path("t.pftrace")).read_bytes())

    def explain(self, *arguments):
        answer = xauto("explain", "--trace", self.path("t.pftrace"), "--json", *arguments)
        self.assertEqual(answer.returncode, 0, answer.stderr)
        return {a["chain"]: a for a in json.loads(answer.stdout)["chains"]}

    def test_the_trace_tells_what_every_result_was_made_of(self):
        for isolate in ([], ["--isolate"]):
            run = self.run_rates(*isolate)
            trace = self.traced()
            source = {f: s for s in trace.slices for f in s.flows_out}
            jobs = trace.on("run", "run")
            done = trace.on("done", "done")
            counts = {m["name"]: m["activations"] for m in run["modules"]}
            names = [s.name.rsplit(" ", 1)[0] for s in done]
            self.assertEqual({n: names.count(n) for n in set(names)}, {"C": counts["C"], "D": counts["D"]})
            apart = 0
            for output in done:
                # Everything from which an arrow leads to it, releases at the end.
                front, seen, begins = [output], set(), []
                while front:
                    for flow in front.pop().flows_in:
                        at = source[flow]
                        if at.category == "release":
                            begins.append(at.begin)
                        else:  # a preempted job's arrows end at its first part
                            first = next(s for s in jobs if s.args["part"] == 1 and s.name == at.name and
                                         s.args["activation"] == at.args["activation"])
                            if id(first) not in seen:
                                seen.add(id(first))
                                front.append(first)
                # Sensors that are due at one instant have one release, and so have the two inputs of C.
                self.assertEqual(len(begins), 2, output)
                if output.name[0] == "C":
                    self.assertEqual(len(set(begins)), 1, output)
                apart += len(set(begins)) - 1
                self.assertEqual((output.begin - min(begins)) // 1000, output.args["latency_us"])  # the oldest's
                passed = {s.name for s in jobs if id(s) in seen}
                self.assertEqual(passed, {"C": {"a1", "a2", "b1", "c1"}, "D": {"d1"}}[output.name[0]])
            self.assertGreater(apart, 5)
            self.assertEqual(counts["C"], 132)  # of src, in 40 * 33 ms

    def test_explain_accounts_for_the_slowest_result_of_each_chain(self):
        run = self.run_rates("--isolate")
        table = {m["name"]: m for m in run["modules"]}
        latencies = {}
        for s in self.traced().on("done", "done"):
            latencies.setdefault(s.name.rsplit(" ", 1)[0], []).append(s.args["latency_us"])
        accounts = self.explain()
        self.assertEqual(set(accounts), {"C", "D"})
        for chain, account in accounts.items():
            self.assertEqual(account["latency_us"], max(latencies[chain]))
            self.assertEqual((account["rank"], account["of"]), (1, len(latencies[chain])))
            self.assertEqual(table[chain]["max_us"], account["latency_us"])
            total, before = account["publish_us"], 0
            for step in account["steps"]:
                parts = [step[k + "_us"] for k in ("handover", "waited", "ran", "switched", "suspended")]
                self.assertTrue(all(p >= 0 for p in parts), step)
                self.assertEqual(before + sum(parts), step["end_us"])
                before = step["end_us"]
                total += sum(parts)
            self.assertEqual(total, account["latency_us"])
            self.assertEqual(account["steps"][-1]["xnode"], {"C": "c1", "D": "d1"}[chain])
        self.assertEqual(set(self.explain("--chain", "D")), {"D"})
        refused = xauto("explain", "--trace", self.path("t.pftrace"), "--chain", "A")
        self.assertEqual(refused.returncode, 2)
        self.assertIn("'A' has no result in the trace\n  hint: there are ", refused.stderr)
        words = xauto("explain", "--trace", self.path("t.pftrace")).stdout
        for chain in ("C", "D"):
            self.assertRegex(words, rf"(?m)^{chain}: release \d+ took [\d.]+ ms, the longest of \d+")

    def test_pages_show_every_chain(self):
        self.run_rates()
        answer = xauto("report", self.path("t.pftrace"), "--out", self.path("r.html"))
        self.assertEqual(answer.returncode, 0, answer.stderr)
        for name in ("r.html", "t.html"):
            page = pathlib.Path(self.path(name)).read_text()
            panels = json.loads(re.search(r"const DATA = (.*?);</script>", page, re.S).group(1))["panels"]
            self.assertEqual([p["name"].rsplit(": ", 1)[1] for p in sorted(panels, key=lambda p: p["name"])], ["C", "D"])
            for panel in panels:
                self.assertEqual(panel["max"], max(panel["latencies"]))
                self.assertEqual(panel["shownLatency"], panel["max"])  # the slowest
                self.assertIsNone(panel["predicted"])
                self.assertTrue(panel["measured"])
                self.assertTrue(all(0 <= b[3] <= b[4] <= panel["max"] for b in panel["measured"]))
        self.assertIn("Slowest release of D", pathlib.Path(self.path("r.html")).read_text())

    def test_what_was_not_measured_is_no_number(self):
        """One release of the slower sensor, four of the other; D fails, so its chains have no result."""
        flags = ["--trace-out", self.path("t.pftrace"), "--timeline", self.path("t.html"), "--overload", "queue:256"]
        command = self.command(*flags, period=10_000, activations=1, more=("second", 33_000), fault=("throw", "D", 0))
        run = json.loads(subprocess.run(command, capture_output=True, text=True, timeout=100).stdout)["runs"][0]
        modules = {m["name"]: m for m in run["modules"]}
        self.assertEqual((modules["D"]["activations"], modules["D"]["failed"], modules["C"]["activations"]), (0, 1, 4))
        self.assertEqual([modules["D"][k] for k in ("p50_us", "p99_us", "max_us")], [None] * 3)
        self.assertIsNotNone(modules["C"]["p50_us"])
        chains = {c["name"]: c for c in run["chains"]}
        self.assertEqual(chains["src2 -> D"]["latency_us"], {"p50": None, "p99": None, "max": None})
        self.assertEqual(chains["src2 -> D"]["age_us"], {"p50": None, "p99": None, "max": None})
        self.assertIsNone(run["deadline_misses"])  # nothing has a deadline
        text = subprocess.run([w for w in command if w != "--json"], capture_output=True, text=True, timeout=100).stdout
        self.assertRegex(text, r"(?m)^  src2 -> D +- +- +- +- +0$")
        self.assertRegex(text, r"(?m)^  policy(?: +[\d.]+){4} +- +4$")  # p50/sim: what was simulated is one release
        self.assertRegex(text, r"XModule D: 0 activations done, \d dropped, 1 failed")
        answer = xauto("report", self.path("t.pftrace"), "--out", self.path("r.html"))
        self.assertEqual(answer.returncode, 0, answer.stderr)

    def test_an_app_without_a_result_has_no_latency(self):
        """Every activation of one rate fails: no number, in words, in JSON and on the page."""
        bad = self.command("--timeline", self.path("t.html"), "--trace-out", self.path("t.pftrace"), activations=1,
                           fault=("throw", "C", 0))
        text = subprocess.run([w for w in bad if w != "--json"], capture_output=True, text=True, timeout=100)
        self.assertRegex(text.stdout, r"(?m)^  \S+ +- +- +- +[\d.]+ +- +0$")
        self.assertNotIn("-100.0 %", text.stdout)
        self.assertRegex(text.stdout, r"XModule C: 0 activations done, 0 dropped, 1 failed")
        done = subprocess.run(bad, capture_output=True, text=True, timeout=100)
        run = json.loads(done.stdout)["runs"][0]
        self.assertEqual([run[k] for k in ("p10_us", "p50_us", "p90_us", "p99_us", "max_us", "mean_us")], [None] * 6)
        answer = xauto("report", self.path("t.pftrace"), "--out", self.path("r.html"))
        self.assertEqual(answer.returncode, 0, answer.stderr)
        for name in ("r.html", "t.html"):
            page = pathlib.Path(self.path(name)).read_text()
            panel = json.loads(re.search(r"const DATA = (.*?);</script>", page, re.S).group(1))["panels"][0]
            self.assertEqual((panel["p50"], panel["p99"], panel["max"], panel["shownIs"]), (None, None, None, ""))


del Case  # its tests are not ours

if __name__ == "__main__":
    unittest.main()
