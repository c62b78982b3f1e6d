# SPDX-License-Identifier: Apache-2.0
"""A run of the Driving Case as a Perfetto trace, as a page and in words: all tell the same story. The trace is read
by pftrace.py, which shares no code with the tools. No time is judged."""
import html.parser
import json
import math
import os
import pathlib
import re
import tempfile
import unittest

import pftrace
from common import APP, DRIVING, xauto

ACTIVATIONS = 12


class Element:
    def __init__(self, tag, attributes=()):
        self.tag, self.attributes, self.children = tag, dict(attributes), []

    def all(self, tag, css=None):
        """Below it, in their order."""
        for child in self.children:
            if isinstance(child, Element):
                if child.tag == tag and (css is None or css in child.attributes.get("class", "").split()):
                    yield child
                yield from child.all(tag, css)

    def text(self):
        return "".join(c if isinstance(c, str) else c.text() for c in self.children if isinstance(c, str) or c.tag != "style")

    def percent(self, of):
        """`left` or `width` of its style."""
        return float(re.search(of + r":([\d.]+)%", self.attributes["style"])[1])


class Page(html.parser.HTMLParser):
    """What is nested must close in its order."""

    def __init__(self, text):
        super().__init__()
        self.root = Element("page")
        self._open = [self.root]
        self.feed(text)
        assert self._open == [self.root], [e.tag for e in self._open]

    def handle_starttag(self, tag, attributes):
        self._open[-1].children.append(Element(tag, attributes))
        if tag not in ("meta", "br", "line", "circle"):
            self._open.append(self._open[-1].children[-1])
        elif tag == "line":  # it has a title
            self._open.append(self._open[-1].children[-1])

    def handle_startendtag(self, tag, attributes):
        self._open[-1].children.append(Element(tag, attributes))

    def handle_endtag(self, tag):
        assert self._open.pop().tag == tag, tag

    def handle_data(self, data):
        self._open[-1].children.append(data)

    def panel(self, heading):
        return next(e for e in self.root.all("section") if next(e.all("h2")).text() == heading)

    def rows(self, first):
        """Of the table whose first head is `first`: its cells."""
        for table in self.root.all("table"):
            rows = [[c.text() for c in row.children] for row in table.all("tr")]
            if rows[0][0] == first:
                return rows[1:]
        raise AssertionError(first)

    def table(self, first):
        return {row[0]: row[1:] for row in self.rows(first)}


def quantile(values, q):
    values = sorted(values)
    return values[max(1, min(len(values), math.ceil(q * len(values)))) - 1]


def ms(us):
    return f"{us / 1000:.2f}"


class Report(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        cls.report = os.path.join(cls.folder.name, "report.json")
        answer = xauto("solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", cls.at("heft.json"))
        assert answer.returncode == 0, answer.stderr
        answer = xauto("run", "--app", APP, "--platform", "small", "--policy", cls.at("heft.json"), "--emulate",
                       "--lockstep", "--activations", ACTIVATIONS, "--trace-out", cls.at("heft.pftrace"), "--out", cls.report,
                       "--", DRIVING)
        assert answer.returncode == 0, answer.stderr
        cls.bytes = pathlib.Path(cls.at("heft.pftrace")).read_bytes()
        cls.trace = pftrace.Trace(cls.bytes)
        answer = xauto("report", cls.at("heft.pftrace"), "--out", cls.at("page.html"))
        assert answer.returncode == 0, answer.stderr
        cls.html = pathlib.Path(cls.at("page.html")).read_text()
        cls.page = Page(cls.html)
        cls.run_json = json.loads(pathlib.Path(cls.report).read_text())["runs"][0]

    @classmethod
    def at(cls, name):
        return os.path.join(cls.folder.name, name)

    def explain(self, activation):
        """{chain: what is told of this release of it}"""
        answer = xauto("explain", "--trace", self.at("heft.pftrace"), "--activation", activation, "--json")
        self.assertEqual(answer.returncode, 0, answer.stderr)
        return {c["chain"]: c for c in json.loads(answer.stdout)["chains"]}

    def releases(self):
        """{number: the last slice of it}: all sources release at one instant."""
        return {s.args["release"]: s for s in self.trace.on("releases", "release")}

    def chains(self):
        """{chain: {release: its reaction}}"""
        chains = {}
        for s in self.trace.on("chains", "chain"):
            chains.setdefault(s.track.removeprefix("chains/"), {})[s.args["release"]] = s
        return chains

    def slices_of(self, xnode, release):
        return [s for s in self.trace.on("run", "run") if (s.name, s.args["release"]) == (xnode, release)]

    # ---- the trace tells what the run's report tells

    def test_the_trace_has_every_release_with_its_latency(self):
        releases = self.releases()
        self.assertEqual(sorted(releases), list(range(ACTIVATIONS)))
        of_source = {(s.args["release"], s.args["source"]): s.begin for s in self.trace.on("releases", "release")}
        self.assertEqual(of_source, {(n, source): s.begin for n, s in releases.items()
                                     for source in ("camera/front", "camera/rear", "lidar/top")})
        done = self.trace.on("done", "done")
        for s in done:
            self.assertEqual(s.args["latency_us"], (s.begin - releases[s.args["release"]].begin) // 1000)
        latencies = [max(s.args["latency_us"] for s in done if s.args["release"] == n) for n in releases]
        self.assertEqual((quantile(latencies, 0.5), max(latencies)), (self.run_json["p50_us"], self.run_json["max_us"]))

    def test_the_trace_has_every_reaction_of_every_chain(self):
        releases, chains = self.releases(), self.chains()
        self.assertEqual(set(chains), {c["name"] for c in self.run_json["chains"]})
        for chain in self.run_json["chains"]:
            reactions = chains[chain["name"]]
            self.assertEqual(sorted(reactions), list(range(ACTIVATIONS)))
            for n, s in reactions.items():
                self.assertEqual(s.begin, releases[n].begin)
                self.assertEqual(s.args["reaction_us"], (s.end - s.begin) // 1000)
                self.assertEqual(s.args["xnode"], chain["to"])
            took = [s.args["reaction_us"] for s in reactions.values()]
            self.assertEqual((chain["results"], chain["latency_us"]["p50"], chain["latency_us"]["max"]),
                             (ACTIVATIONS, quantile(took, 0.5), max(took)))

    def test_every_job_is_on_its_xpu_and_its_module(self):
        placed = {x["name"]: x["xpu"] for x in json.loads(pathlib.Path(self.at("heft.json")).read_text())["xnodes"]}
        module = {x["name"]: x["module"] for x in json.loads(pathlib.Path(APP).read_text())["xnodes"]}
        jobs = [s for s in self.trace.on("run", "run") if s.args["part"] == 1]
        self.assertEqual(len(jobs), ACTIVATIONS * len(placed))
        for s in jobs:
            self.assertEqual(s.track, "run/" + placed[s.name])
            self.assertEqual(s.args["module"], module[s.name])
        in_modules = [s for s in self.trace.on("modules", "job")]
        self.assertEqual(len(in_modules), len(jobs))
        for s in in_modules:
            self.assertEqual(s.track, "modules/" + module[s.name])

    def test_arrows_lead_from_a_release_to_its_outputs(self):
        source = {f: s for s in self.trace.slices for f in s.flows_out}
        done = self.trace.on("done", "done")
        self.assertEqual(len(done), 3 * ACTIVATIONS)  # the sinks are LA, PR and TC
        for output in done:
            at, steps = output, 0
            while at.category != "release":
                before = [source[f] for f in at.flows_in]
                self.assertTrue(before, at)
                # A preempted job's arrows end at its first part and leave from its last.
                at = min(before, key=lambda s: s.begin)
                if at.category == "run":
                    at = next(s for s in self.trace.on("run", "run")
                              if (s.name, s.args["release"], s.args["part"]) == (at.name, at.args["release"], 1))
                steps += 1
                self.assertLess(steps, 30)
            self.assertEqual(at.args["release"], output.args["release"])

    def test_counters_say_that_nothing_was_lost(self):
        self.assertEqual({v for _, v in self.trace.counters["counters/trace events lost"]}, {0})
        self.assertEqual(self.run_json["trace_events_lost"], 0)

    # ---- the page tells what the trace tells

    def test_every_chain_has_its_numbers_and_a_dot_per_release(self):
        deadline = json.loads(pathlib.Path(APP).read_text())["deadline_us"]
        chains = self.chains()
        shown = [next(e.all("h2")).text() for e in self.page.root.all("section") if list(e.all("svg"))]
        self.assertEqual(shown, [c["name"] for c in self.run_json["chains"]])
        for name, reactions in chains.items():
            took = [s.args["reaction_us"] for s in reactions.values()]
            panel = self.page.panel(name)
            words = next(panel.all("p", "run")).text()
            self.assertIn(f"heft p50 {ms(quantile(took, 0.5))}, p99 -, max {ms(max(took))} of {ACTIVATIONS} results", words)
            missed = sum(us > deadline for us in took)
            self.assertEqual("missed the deadline" in words, missed > 0)
            self.assertIn(f"deadline {ms(deadline)} ms", panel.text())
            far = deadline > 3 * max(took)
            axis = max(took) if far else max(deadline, *took)
            axis += axis // 20
            dots = sorted(float(c.attributes["cx"].rstrip("%")) for c in panel.all("circle"))
            for dot, us in zip(dots, sorted(took), strict=True):
                self.assertAlmostEqual(dot, 100 * us / axis, delta=0.02)
            lines = [e for e in panel.all("line", "deadline")]
            self.assertEqual(len(lines), 0 if far else 1)
            for e in lines:
                self.assertAlmostEqual(float(e.attributes["x1"].rstrip("%")), 100 * deadline / axis, delta=0.02)

    def test_page_and_trace_give_the_same_preemptions_and_load(self):
        rows = self.page.table("XPU, and preemptions")
        self.assertEqual(set(rows), {s.track.split("/")[1] for s in self.trace.on("run")})
        whole = [s for s in self.trace.slices if s.track == "releases" or s.track.startswith("run/")]
        length = max(s.end for s in whole) - min(s.begin for s in whole)
        preempted = 0
        for xpu, (cell,) in rows.items():
            parts = [s.args["part"] for s in self.trace.on("run/" + xpu, "run")]
            again = len(parts) - parts.count(1)
            preempted += again
            busy, until = 0, 0
            for s in sorted(self.trace.on("run/" + xpu), key=lambda s: s.begin):
                busy += max(0, s.end - max(s.begin, until))
                until = max(until, s.end)
            percent, *rest = cell.split(" %")
            self.assertAlmostEqual(float(percent), 100 * busy / length, delta=0.11)
            self.assertEqual(rest, [f", {again}" if again else ""])
        self.assertGreater(preempted, 0)  # HEFT preempts on the GPU: else this test sees nothing

    def test_the_worst_release_is_the_same_everywhere(self):
        told, chains = self.explain("worst"), self.chains()
        self.assertEqual(list(told), [c["name"] for c in self.run_json["chains"]])
        for name, words in told.items():
            longest = max(s.args["reaction_us"] for s in chains[name].values())
            self.assertEqual((words["reaction_us"], words["rank"], words["of"]), (longest, 1, ACTIVATIONS))
            self.assertEqual(chains[name][words["release"]].args["reaction_us"], longest)
            worst = next(self.page.panel(name).all("details"))
            self.assertEqual(next(worst.all("summary")).text(),
                             f"heft: slowest release, {words['release']}, took {ms(longest)} ms")
            self.assertIn(f"search there for “{name} {words['release']}”", worst.text())

    def test_a_waterfall_has_every_job_where_it_ran(self):
        releases = self.releases()
        for name, words in self.explain("worst").items():
            rows = {next(row.all("span", "who")).text(): row
                    for row in next(self.page.panel(name).all("details")).all("div", "row")}
            release, whole = releases[words["release"]], words["reaction_us"] * 1000
            for job in words["jobs"] + words["own"] + words["missed"]:
                row = rows[f"{job['xnode']} {job['release']} {job['xpu']}"]
                ran = sorted((e.percent("left"), e.percent("width")) for e in row.all("i", "run"))
                for (left, width), s in zip(ran, self.slices_of(job["xnode"], job["release"]), strict=True):
                    self.assertAlmostEqual(left, 100 * (s.begin - release.begin) / whole, delta=0.03)
                    self.assertAlmostEqual(width, 100 * (s.end - s.begin) / whole, delta=0.03)
                if job["ready_us"] + 100 < job["began_us"]:
                    self.assertTrue(list(row.all("i", "wait")), job)
            way = [(e.percent("left"), e.percent("width")) for e in rows["all of it "].all("i")]
            self.assertAlmostEqual(sum(width for _, width in way), 100, delta=0.02 * len(way))
            # Who had the XPUs: what is wide enough to be seen, and nothing else.
            for xpu in {s.track.split("/")[1] for s in self.trace.on("run", "run")}:
                wide = sorted(s.name for s in self.trace.on("run/" + xpu, "run")
                              if s.begin < release.begin + whole and s.end > release.begin and (s.end - s.begin) * 2000 > whole * 1.01)
                drawn = sorted(e.text() for css in ("run", "other") for e in rows[xpu + " "].all("i", css)) if wide else []
                self.assertLessEqual(set(wide), set(drawn), xpu)

    def test_the_page_needs_neither_network_nor_script(self):
        links = {v for e in self.page.root.all("a") for v in [e.attributes["href"]]}
        self.assertEqual(links, {"heft.pftrace"})
        self.assertEqual(re.findall(r".{0,20}(?:://|@import|url\(|<script|<link| src=).{0,20}", self.html), [])

    # ---- in words

    def test_every_job_of_every_chain_is_told_as_it_was(self):
        releases, chains = self.releases(), self.chains()
        before = {}
        for u, v in json.loads(pathlib.Path(APP).read_text())["edges"]:
            before.setdefault(v, []).append(u)
        for number, release in releases.items():
            for name, words in self.explain(number).items():
                reaction = chains[name][number].args
                self.assertEqual((words["release"], words["reaction_us"]), (number, reaction["reaction_us"]))
                self.assertEqual({s["released_us"] for s in words["sensors"]}, {0})
                ended = {j["xnode"]: j["ended_us"] for j in words["jobs"]}
                for job in words["jobs"]:
                    parts = self.slices_of(job["xnode"], number)
                    self.assertEqual({s.track for s in parts}, {"run/" + job["xpu"]})
                    self.assertEqual(job["began_us"], (min(s.begin for s in parts) - release.begin) // 1000)
                    self.assertEqual(job["ended_us"], (max(s.end for s in parts) - release.begin) // 1000)
                    self.assertAlmostEqual(job["ran_us"], sum(s.end - s.begin for s in parts) / 1000, delta=len(parts))
                    for u in before.get(job["xnode"], []):  # all that it waits for by edges is told before it
                        self.assertLessEqual(ended[u], job["ready_us"], (u, job))
                    self.assertLessEqual(job["ready_us"], job["began_us"], job)
                    waited = sum(b["us"] for b in job["waited_for"])
                    self.assertLessEqual(waited, job["began_us"] - job["ready_us"] + 1, job)
                self.assertLessEqual(ended[reaction["xnode"]], words["reaction_us"])
                self.assertEqual(max(ended.values()), ended[reaction["xnode"]])

    def test_who_was_waited_for_had_the_xpu(self):
        named = 0
        for words in self.explain("worst").values():
            start = self.releases()[words["release"]].begin
            for job in words["jobs"]:
                waited = {}
                for blocker in job["waited_for"]:
                    named += 1
                    waited[blocker["who"]] = waited.get(blocker["who"], 0) + blocker["us"]
                for who, us in waited.items():
                    name, number = who.rsplit(" ", 1)
                    since, until = start + job["ready_us"] * 1000, start + (job["began_us"] + 1) * 1000
                    had = sum(max(0, min(s.end, until) - max(s.begin, since)) for s in self.trace.on("run/" + job["xpu"])
                              if s.name.endswith(name) and s.args.get("release", int(number)) == int(number))
                    self.assertGreaterEqual(had / 1000 + 2, us, (job, who))
        self.assertGreater(named, 0)  # under HEFT somebody always waits for the GPU

    def test_what_is_printed_is_what_is_told(self):
        answer = xauto("explain", "--trace", self.at("heft.pftrace"))
        self.assertEqual(answer.returncode, 0, answer.stderr)
        told = self.explain("worst")
        us = lambda text: int(text.replace(".", ""))  # of ms with three digits
        took = re.findall(r"^(.*): release (\d+) took ([\d.]+) ms, the longest of 12; the median is ([\d.]+)\.$",
                          answer.stdout, re.M)
        self.assertEqual([(name, int(n), us(of), us(median)) for name, n, of, median in took],
                         [(name, c["release"], c["reaction_us"], c["median_us"]) for name, c in told.items()])
        rows = re.findall(r"^  (\S+) +(\d+)  (\S+) +([\d.]+) +([\d.]+) +([\d.]+) +- +-$", answer.stdout, re.M)
        self.assertEqual([(x, int(n), xpu, *map(us, times)) for x, n, xpu, *times in rows],
                         [(j["xnode"], j["release"], j["xpu"], j["ready_us"], j["began_us"], j["ended_us"])
                          for c in told.values() for j in c["jobs"]])

    def test_what_cannot_be_answered_is_refused(self):
        for arguments, status, message in (
                (["--activation", "best"], 2, "'best' is no activation"),
                (["--activation", "-1"], 2, "'-1' is no activation"),
                (["--activation", "12"], 2, "release 12: is not in the trace\n  hint: it has 0 to 11"),
                (["--app", APP], 2, "excludes")):
            answer = xauto("explain", "--trace", self.at("heft.pftrace"), *arguments)
            self.assertEqual(answer.returncode, status, arguments)
            self.assertIn(message, answer.stderr)
        answer = xauto("explain")
        self.assertEqual(answer.returncode, 2)
        self.assertIn("or give the trace of a run", answer.stderr)
        short = pathlib.Path(self.at("short.pftrace"))
        short.write_bytes(self.bytes[:-1])
        answer = xauto("explain", "--trace", short)
        self.assertEqual(answer.returncode, 2)
        self.assertIn("was broken off", answer.stderr)


if __name__ == "__main__":
    unittest.main()
