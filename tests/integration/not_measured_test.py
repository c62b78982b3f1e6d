# SPDX-License-Identifier: Apache-2.0
"""Nothing that was not measured is printed as a number."""
import json
import pathlib
import re
import subprocess
import unittest

from common import xauto
from isolate_test import Case


class NotMeasured(Case):
    def test_what_was_not_measured_is_no_number(self):
        """D fails, so its chain has no result; C has one."""
        command = self.command("--trace-out", self.path("t.pftrace"), activations=1, fault=("throw", "D", 0))
        run = json.loads(subprocess.run(command, capture_output=True, text=True, timeout=100).stdout)["runs"][0]
        modules = {m["name"]: m for m in run["modules"]}
        self.assertEqual((modules["D"]["activations"], modules["D"]["failed"], modules["C"]["activations"]), (0, 1, 1))
        self.assertEqual([modules["D"][k] for k in ("p50_us", "p99_us", "max_us")], [None] * 3)
        self.assertIsNotNone(modules["C"]["p50_us"])
        chains = {c["name"]: c for c in run["chains"]}
        self.assertEqual(chains["src -> d1"]["latency_us"], {"p50": None, "p99": None, "max": None})
        self.assertEqual(chains["src -> d1"]["age_us"], {"p50": None, "p99": None, "max": None})
        self.assertIsNone(run["deadline_misses"])  # nothing has a deadline
        text = subprocess.run([w for w in command if w != "--json"], capture_output=True, text=True, timeout=100).stdout
        self.assertRegex(text, r"(?m)^  src -> d1 +- +- +- ")
        self.assertRegex(text, r"XModule D: 0 activations done, 0 dropped, 1 failed")

    def test_an_app_without_a_result_has_no_latency(self):
        """Every activation of one rate fails: no number, in words, in JSON and on the page."""
        bad = self.command("--page", self.path("t.html"), "--trace-out", self.path("t.pftrace"), activations=1,
                           fault=("throw", "C", 0))
        text = subprocess.run([w for w in bad if w != "--json"], capture_output=True, text=True, timeout=100)
        self.assertRegex(text.stdout, r"(?m)^  \S+ +- +- +- +0$")
        self.assertNotIn("-100.0 %", text.stdout)
        self.assertRegex(text.stdout, r"XModule C: 0 activations done, 0 dropped, 1 failed")
        done = subprocess.run(bad, capture_output=True, text=True, timeout=100)
        run = json.loads(done.stdout)["runs"][0]
        self.assertEqual([run[k] for k in ("p10_us", "p50_us", "p90_us", "p99_us", "max_us", "mean_us")], [None] * 6)
        answer = xauto("report", self.path("t.pftrace"), "--out", self.path("r.html"))
        self.assertEqual(answer.returncode, 0, answer.stderr)
        for name in ("r.html", "t.html"):
            page = pathlib.Path(self.path(name)).read_text()
            self.assertEqual(page.count("<svg class='strip'"), 1, "src -> d1 has a result, src -> c1 has none")
            self.assertRegex(page, r"<h2>src -&gt; c1</h2>[^§]*?p50 -, p99 -, max - of 0 results")


del Case  # its tests are not ours

if __name__ == "__main__":
    unittest.main()
