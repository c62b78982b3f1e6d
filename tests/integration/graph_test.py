# SPDX-License-Identifier: Apache-2.0
"""`xauto graph`: what it draws is counted by an XML reader that is not ours, and compared with app.json."""
import json
import pathlib
import tempfile
import unittest
import xml.etree.ElementTree as ET

from common import SOURCE, xauto

APP = SOURCE / "examples/driving/rates.json"
SVG = "{http://www.w3.org/2000/svg}"


class Graph(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def draw(self, app, *flags):
        done = xauto("graph", "--app", app, "--svg", self.folder / "g.svg", "--dot", self.folder / "g.dot", *flags)
        self.assertEqual(done.returncode, 0, done.stderr)
        return ET.parse(self.folder / "g.svg").getroot(), (self.folder / "g.dot").read_text()

    def check(self, app, svg, dot):
        titles = [t.text for t in svg.iter(SVG + "title")]
        for x in app["xnodes"]:
            self.assertEqual(sum(t.startswith(f"{x['name']} of XModule {x['module']}: ") for t in titles), 1, x)
        arrows = {style: sum(p.get("class") == style for p in svg.iter(SVG + "path")) for style in ("line", "line sample")}
        heard = sum(len(s) if isinstance(s := x.get("source", []), list) else 1 for x in app["xnodes"])
        self.assertEqual(arrows, {"line": heard + len(app["edges"]), "line sample": len(app["samples"])})
        for u, v in app["samples"]:
            self.assertIn(f"{v} samples {u}", titles)
        self.assertEqual(dot.count("style=dashed"), len(app["samples"]))
        self.assertEqual(dot.count(" -> "), sum(arrows.values()))

    def test_all_of_an_app_is_there(self):
        app = json.loads(APP.read_text())
        svg, dot = self.draw(APP)
        self.check(app, svg, dot)
        text = " ".join(t.text for t in svg.iter(SVG + "text"))
        for rate in ("30 Hz, clock main", "10 Hz, clock lidar", "50 Hz, clock main"):
            self.assertIn(rate, text)

    def test_with_a_policy_each_xnode_stands_on_its_xpu(self):
        done = xauto("solve", "--app", APP, "--platform", "small", "--max-evaluations", 300, "--threads", 1, "--time-limit", "60s",
                     "--out", self.folder / "policy.json")
        self.assertEqual(done.returncode, 0, done.stderr)
        svg, dot = self.draw(APP, "--policy", self.folder / "policy.json")
        titles = [t.text for t in svg.iter(SVG + "title")]
        for x in json.loads((self.folder / "policy.json").read_text())["xnodes"]:
            self.assertEqual(sum(t.startswith(x["name"] + " of ") and f": {x['xpu']}, " in t for t in titles), 1, x["name"])

    def test_odd_names_stay_names(self):
        app = json.loads(APP.read_text())
        text = json.dumps(app)
        for old, new in (("la.pre", 'a"b<c>&amp;\\N'), ("ctl.plan", "größe ]]> --"), ("front", "\u202e<x/>")):
            text = text.replace(json.dumps(old), json.dumps(new))
        (self.folder / "odd.json").write_text(text)
        svg, dot = self.draw(self.folder / "odd.json")
        self.check(json.loads(text), svg, dot)
        done = xauto("graph", "--app", self.folder / "odd.json")
        self.assertEqual(done.stdout, dot)
        self.assertEqual(json.loads(xauto("graph", "--app", self.folder / "odd.json", "--json").stdout)["dot"], dot)

    def test_what_cannot_be_drawn_is_said(self):
        self.assertEqual(xauto("graph", "--app", self.folder / "none.json").returncode, 2)
        done = xauto("graph", "--app", APP, "--svg", self.folder / "no/such.svg")
        self.assertEqual(done.returncode, 2)
        self.assertIn("no/such.svg", done.stderr)
        done = xauto("graph", "--app", APP, "--policy", SOURCE / "tests/golden/policy-keys.json")
        self.assertEqual(done.returncode, 2)
        self.assertIn("policy-keys.json", done.stderr)


if __name__ == "__main__":
    unittest.main()
