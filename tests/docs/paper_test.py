# SPDX-License-Identifier: Apache-2.0
"""The page of section 6 of the paper holds each of its figures and nothing from elsewhere; its numbers and verdicts follow from
what was computed and run; docs/paper.md is what its record gives; and the page is legible in light and dark, on a desk and on a
telephone, where there is a Chromium to look with. XAUTO_FULL=1 computes and runs all of it, as `make paper QUICK=1` does;
otherwise the page is that of the committed record."""
import copy
import json
import math
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

SOURCE = pathlib.Path(__file__).resolve().parents[2]
BUILD = pathlib.Path(os.environ.get("XAUTO_BIN", SOURCE / "build/bin")).parent
sys.path += [str(SOURCE / "scripts"), str(SOURCE / "tests/browser"), str(SOURCE / "tests/integration")]
import paper_page

FULL = bool(os.environ.get("XAUTO_FULL"))
RECORD = SOURCE / "docs/results/paper.json"
FIGURES = ("timelines", "fig8", "heft", "fig9", "fig10", "ablation", "driving", "fig11", "solving", "runs", "overhead", "runtime")


def geometric(values):
    """A second way to the mean that the page has."""
    return math.exp(sum(map(math.log, values)) / len(values))


class Paper(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.out = pathlib.Path(folder.name)
        if not FULL:
            shutil.copy(RECORD, cls.out)
        done = subprocess.run([sys.executable, SOURCE / "scripts/paper.py", "--quick" if FULL else "--render", "--bin", BUILD,
                               "--out", cls.out], capture_output=True, text=True, timeout=240)
        assert done.returncode == 0, done.stderr
        cls.data = json.loads((cls.out / "paper.json").read_text())
        cls.page = (cls.out / "index.html").read_text()

    def figure(self, name, data=None):
        return next(f for f in paper_page.figures(data or self.data) if f.name == name)

    def test_the_page_has_each_figure_with_what_ran_and_a_verdict(self):
        sections = re.findall(r'<section id="(\w+)">(.*?)</section>', self.page, re.S)
        self.assertEqual([name for name, _ in sections], list(FIGURES))
        for name, body in sections:
            kind = re.search(r'class="kind">(\w+)', body).group(1)
            self.assertIn(kind, ("Computed", "Run", "Measured"), name)
            self.assertRegex(body, r"<p>Paper: ", name)
            self.assertRegex(body, r'<b class="v (holds|part|no|open)">', name)
        for words in ("revision", *(("QUICK=1", "no result") if FULL else ("made by",)), "Load average", "Nothing was measured on a Jetson"):
            self.assertIn(words, self.page)

    def test_the_page_needs_nothing_else(self):
        self.assertEqual(re.findall(r"<(?:script|link|img|iframe)|@import|url\(", self.page), [])
        self.assertEqual(set(re.findall(r'(?:href|src)="([^#][^"]*)"', self.page)), set())

    def test_means_are_geometric(self):
        for platform in ("small", "large"):
            rows = [r for r in self.data["workload"] if r["platform"] == platform]
            self.assertGreater(len(rows), 1)
            mean = geometric([r["ros2_slices_us"] / r["xauto_us"] for r in rows])
            table = [r for r in self.figure("fig8").rows if r[:2] == [platform, "all"]]
            self.assertEqual(table[0][3], f"{mean:.2f}")
            without = 100 * (1 - 1 / geometric([r["unassigned_us"] / r["xauto_us"] for r in rows]))
            table = [r for r in self.figure("ablation").rows if r[:2] == [platform, "all"]]
            self.assertEqual(table[0][3], f"{-without:.1f}")
        data = copy.deepcopy(self.data)  # of {1/2, 2} the arithmetic mean is 1.25
        rows = [r for r in data["workload"] if r["platform"] == "small"]
        for slow, fast in zip(rows[::2], rows[1::2], strict=True):
            slow.update(ros2_slices_us=1000, xauto_us=2000)
            fast.update(ros2_slices_us=2000, xauto_us=1000)
        self.assertIn("1.000 (small)", self.figure("fig8", data).result)

    def test_verdicts_follow_from_the_numbers(self):
        def verdict(name, edit):
            data = copy.deepcopy(self.data)
            edit(data)
            return self.figure(name, data).verdict

        def workload(**factors):
            def edit(data):
                for row in data["workload"]:
                    row.update({key: round(row["xauto_us"] * factor) for key, factor in factors.items()})
            return edit

        def each(part, **values):
            return lambda data: [row.update(values) for row in data[part]]
        self.assertEqual(verdict("fig8", workload(ros2_slices_us=1.2)), paper_page.FAILS)
        self.assertEqual(verdict("fig8", workload(ros2_slices_us=1.7)), paper_page.HOLDS)
        self.assertEqual(verdict("heft", workload(heft_us=1.25)), paper_page.HOLDS)
        self.assertEqual(verdict("heft", workload(heft_us=1.05)), paper_page.FAILS)
        self.assertEqual(verdict("fig10", workload(ros2_slices_us=0.9)), paper_page.PARTLY)
        self.assertEqual(verdict("fig9", workload(ros2_slices_us=0.9)), paper_page.PARTLY)
        self.assertEqual(verdict("fig11", each("assignments", xauto_us=20000, ros2_us=19000)), paper_page.PARTLY)
        self.assertEqual(verdict("solving", each("workload", optimal=False)), paper_page.PARTLY)
        self.assertEqual(verdict("runs", each("kept", claim_us=100, xauto_max_us=103)), paper_page.PARTLY)
        self.assertEqual(verdict("runs", each("kept", claim_us=100, xauto_max_us=102)), paper_page.HOLDS)
        self.assertEqual(verdict("overhead", each("runs", claim_us=100, xauto_p50_us=110)), paper_page.PARTLY)
        self.assertEqual(verdict("runtime", each("runtime", p50=0.6)), paper_page.FAILS)
        self.assertEqual(verdict("timelines", lambda data: data["timelines"].reverse()), paper_page.FAILS)

    def test_what_did_not_run_is_not_shown_as_run(self):
        data = copy.deepcopy(self.data)
        for part in ("runs", "kept"):
            data[part] = [{"platform": r["platform"], "nodes": r["nodes"], "seed": r["seed"], "failed": "killed"} for r in data[part]]
        self.assertEqual({r[5] for r in self.figure("fig8", data).rows}, {"–"})
        self.assertIn(f"0 of {len(data['runs'])} DAGs ran", self.figure("runs", data).result)
        self.assertEqual(self.figure("runs", data).verdict, paper_page.PARTLY)

    @unittest.skipUnless(FULL, "of the run that XAUTO_FULL=1 makes")
    def test_all_that_should_run_did(self):
        self.assertEqual({r["platform"] for r in self.data["runs"]}, {"small", "large", "core-ultra-4"})
        for row in (*self.data["runs"], *self.data["columns"], *self.data["driving"]):
            self.assertNotIn("failed", row)
            self.assertEqual(row["lost"], 0)
        self.assertEqual([r["policy"] for r in self.data["driving"]], 2 * ["ros2", "heft", "xauto", "xauto-unscheduled"])
        # Each took what its stages take at least: nothing was left out.
        for row in (*self.data["runs"], *self.data["columns"]):
            self.assertGreaterEqual(row["xauto_p50_us"], row["claim_us"], row)
        self.assertEqual(len(self.data["assignments"]), 64)
        best = min(self.data["assignments"], key=lambda r: r["xauto_us"])
        self.assertEqual((best["xauto_us"], best["bound_us"], set(best["dla"])), (26100, 26100, {"fcd.infer", "td.infer"}))
        self.assertEqual(self.data["all_on_gpu"]["paper_order_us"], 34675)
        for row in self.data["optimum"]["brute"]:
            self.assertTrue(row["brute_s"] is None or not row["optimal"] or row["brute_us"] == row["solve_us"], row)

    def test_docs_are_what_their_record_gives(self):
        record = json.loads(RECORD.read_text())
        self.assertEqual(record["kind"], "usual")
        self.assertEqual((SOURCE / "docs/paper.md").read_text(), paper_page.markdown(record),
                         "scripts/paper.py --render --out FOLDER --docs docs/paper.md")
        for name, picture in paper_page.drawings(record).items():
            self.assertEqual((SOURCE / f"docs/img/paper-{name}.svg").read_text(), picture)

    def test_looks(self):
        import browser
        from page_test import CONTRAST
        if not browser.find():
            self.skipTest("no Chromium")
        with browser.Browser() as page:
            for width in (420, 1280):
                for scheme in ("light", "dark"):
                    page.size(width, 900)
                    page.scheme(scheme)
                    page.open(self.out / "index.html")
                    self.assertEqual(page.problems, [])
                    self.assertEqual(len(page.fetched), 1, page.fetched)
                    self.assertLessEqual(page.js("document.documentElement.scrollWidth"), width, "wide things scroll by themselves")
                    self.assertGreaterEqual(page.js(CONTRAST)[0], 4.5, (width, scheme))
                    # Text of a picture: pixels of an em, and its contrast with the page.
                    least = page.js("Math.min(...[...document.querySelectorAll('svg text')].map(t => parseFloat(getComputedStyle(t).fontSize)"
                                    " * t.getScreenCTM().a))")
                    self.assertGreaterEqual(least, 12, (width, scheme))
                    colours = page.js("[...new Set([...document.querySelectorAll('svg text')].map(t => getComputedStyle(t).fill))]")
                    dark = page.js("getComputedStyle(document.body).backgroundColor")
                    self.assertNotIn(dark, colours)


if __name__ == "__main__":
    unittest.main()
