# SPDX-License-Identifier: Apache-2.0
"""The page of a comparison in a real browser: it loads without a word of complaint, without network and script, opens
and closes what it tells of a release, and is legible in light and dark, and on a telephone.
XAUTO_SCREENSHOTS=FOLDER leaves pictures there. Exit status 77: there is no browser."""
import json
import os
import pathlib
import sys
import tempfile
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "integration"))
import browser
from common import APP, DRIVING, xauto

SHOTS = os.environ.get("XAUTO_SCREENSHOTS")

# Least contrast of any text on what is behind it (WCAG 2), as [ratio, text].
CONTRAST = """(() => {
  const rgb = c => { const m = c.match(/[\\d.]+/g).map(Number); return m.length > 3 && m[3] === 0 ? null : m.slice(0, 3); };
  const lum = c => { const [r, g, b] = c.map(v => (v /= 255) <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
                     return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const behind = e => { for (; e; e = e.parentElement) { const c = rgb(getComputedStyle(e).backgroundColor); if (c) return c; } };
  let least = [99, ""];
  for (const e of document.querySelectorAll("h1,h2,h3,p,td,th,span,summary,li,b,a,.lane i")) {
    if (!e.textContent.trim()) continue;
    const own = rgb(getComputedStyle(e).color);
    const a = lum(own), b = lum(behind(e));
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < least[0]) least = [ratio, e.textContent];
  }
  return least; })()"""
PANELS = "[...document.querySelectorAll('section')].filter(s => s.querySelector('svg'))"
POLICIES = ("ROS 2 model", "HEFT", "XAuto", "XAuto, unscheduled")


class Page(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        out = os.path.join(cls.folder.name, "out")
        answer = xauto("compare", "--app", APP, "--platform", "small", "--emulate", "--lockstep",
                       "--activations", 220 if SHOTS else 3, "--time-limit", "1s", "--out", out, "--", DRIVING)
        assert answer.returncode == 0, answer.stderr
        cls.report = out + "/report.html"
        cls.chains = [c["name"] for c in json.loads(pathlib.Path(out, "report.json").read_text())["runs"][0]["chains"]]
        cls.browser = cls.enterClassContext(browser.Browser()) if hasattr(cls, "enterClassContext") else None
        if cls.browser is None:  # Python 3.10 and before
            cls.browser = browser.Browser()
            cls.addClassCleanup(cls.browser.__exit__)

    def setUp(self):
        self.browser.size(1200, 900)
        self.browser.scheme("light")
        self.browser.open(self.report)

    def tearDown(self):
        self.assertEqual(self.browser.problems, [])
        self.assertTrue(all(url.startswith("file://") for url in self.browser.fetched), self.browser.fetched)
        self.assertGreater(len(self.browser.fetched), 0)  # else nothing would be seen

    def test_a_panel_per_chain_has_every_policy(self):
        headings = self.browser.js(f"{PANELS}.map(s => s.querySelector('h2').textContent)")
        self.assertEqual(headings, self.chains)
        for names in self.browser.js(f"{PANELS}.map(s => [...s.querySelectorAll('.run > b:first-child')].map(b => b.textContent))"):
            self.assertEqual(tuple(names), POLICIES)
        # Each dot is within its strip, and there is one per release.
        dots = self.browser.js(f"""{PANELS}.flatMap(s => [...s.querySelectorAll('svg')]).map(svg => {{
            const box = svg.getBoundingClientRect();
            return [...svg.querySelectorAll('circle')].filter(c => {{ const r = c.getBoundingClientRect();
                return r.left >= box.left - 3 && r.right <= box.right + 3 && r.top >= box.top && r.bottom <= box.bottom; }}).length; }})""")
        self.assertEqual(dots, [220 if SHOTS else 3] * len(self.chains) * len(POLICIES))

    def test_a_release_is_opened_and_closed(self):
        summary = f"{PANELS}[0].querySelectorAll('summary')[0]"
        row = f"{PANELS}[0].querySelectorAll('details')[0].querySelector('.row')"
        visible = f"{row}.getBoundingClientRect().height > 0 && {row}.checkVisibility()"
        self.assertFalse(self.browser.js(visible))
        for shown in (True, False):
            at = self.browser.middle(summary)
            self.assertIsNotNone(at, "cannot be clicked")
            self.browser.click(*at)
            self.assertEqual(self.browser.js(visible), shown)

    def test_light_and_dark_are_legible(self):
        backgrounds = []
        for scheme in ("light", "dark"):
            self.browser.scheme(scheme)
            self.browser.open(self.report)
            self.browser.js("document.querySelectorAll('details').forEach(d => d.open = true)")
            least, text = self.browser.js(CONTRAST)
            self.assertGreaterEqual(least, 4.5, f"{scheme}: '{text}'")
            backgrounds.append(self.browser.js("getComputedStyle(document.body).backgroundColor"))
            if SHOTS:
                self.browser.open(self.report)
                self.browser.screenshot(os.path.join(SHOTS, f"report-{scheme}.png"))
        light, dark = (sum(map(int, b[4:-1].split(","))) for b in backgrounds)
        self.assertGreater(light, 3 * 200)
        self.assertLess(dark, 3 * 60)

    def test_nothing_sticks_out_and_all_can_be_read_on_a_narrow_screen(self):
        self.browser.js("document.querySelectorAll('details').forEach(d => d.open = true)")
        for width in (1600, 900, 600, 420):
            self.browser.size(width, 900)
            self.assertLessEqual(self.browser.js("document.documentElement.scrollWidth"), width)
            out = self.browser.js("[...document.querySelectorAll('p,summary,.row,.who,.why,svg,table')].filter(e => "
                                  "e.getBoundingClientRect().right > innerWidth).map(e => e.textContent)")
            self.assertEqual(out, [], width)
            smallest = self.browser.js("Math.min(...[...document.querySelectorAll('p,span,td,th,summary,i')].filter(e => "
                                       "e.textContent.trim()).map(e => parseFloat(getComputedStyle(e).fontSize)))")
            self.assertGreaterEqual(smallest, 10, width)
            # A lane is wide enough to see something in it.
            self.assertGreater(self.browser.js("document.querySelector('.lane').getBoundingClientRect().width"), 0.4 * width)
        if SHOTS:
            self.browser.screenshot(os.path.join(SHOTS, "narrow.png"))


if __name__ == "__main__":
    if browser.find() is None:
        print("no browser: none of " + ", ".join(browser.NAMES) + " is installed (scripts/setup.sh check)")
        sys.exit(77)
    unittest.main()
