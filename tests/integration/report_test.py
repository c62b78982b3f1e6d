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


class Page(html.parser.HTMLParser):
    """Tables by the heading or the column heads above them: {first head: [[cell]]}; headings; text."""

    def __init__(self, text):
        super().__init__()
        self.tables, self.headings, self.links, self.text = [], [], [], ""
        self._cell = self._heading = None
        self._skip = False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        if tag == "table":
            self.tables.append([])
        elif tag == "tr" and self.tables:
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self._cell = ""
        elif tag in ("h1", "h2"):
            self._heading = ""
        elif tag in ("script", "style"):
            self._skip = True
        self.links += [v for k, v in attributes if k in ("src", "href")]

    def handle_endtag(self, tag):
        if tag in ("td", "th") and self._cell is not None:
            self.tables[-1][-1].append(self._cell)
            self._cell = None
        elif tag in ("h1", "h2") and self._heading is not None:
            self.headings.append(self._heading)
            self._heading = None
        elif tag in ("script", "style"):
            self._skip = False

    def handle_data(self, data):
        if self._skip:
            return
        self.text += data
        if self._cell is not None:
            self._cell += data
        if self._heading is not None:
            self._heading += data

    def table(self, first, number=0):
        """Rows of the number-th table whose first head is `first`, as {first cell: {head: cell}}."""
        found = [t for t in self.tables if t and t[0] and t[0][0] == first][number]
        return {row[0]: dict(zip(found[0], row)) for row in found[1:]}


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

    def test_page_and_trace_give_the_same_latencies_per_chain(self):
        deadline = json.loads(pathlib.Path(APP).read_text())["deadline_us"]
        by_chain = {name: [s.args["reaction_us"] for s in of.values()] for name, of in self.chains().items()}
        rows = self.page.table("chain, ms (whole run)")
        self.assertEqual(set(rows), set(by_chain))
        for name, reactions in by_chain.items():
            expected = {"n": str(ACTIVATIONS), "p50": ms(quantile(reactions, 0.5)),
                        "p99": "-", "max": ms(max(reactions)), "deadline": ms(deadline),
                        "missed": str(sum(us > deadline for us in reactions))}
            self.assertEqual({k: rows[name][k] for k in expected}, expected, name)

    def test_page_and_trace_give_the_same_latencies_per_output(self):
        begin = {n: s.begin for n, s in self.releases().items()}
        by_output = {}
        for s in self.trace.on("done", "done"):
            by_output.setdefault(s.name.rsplit(" ", 1)[0], []).append((s.begin - begin[s.args["release"]]) // 1000)
        rows = self.page.table("output of, ms")
        self.assertEqual(set(rows), set(by_output))
        deadline = json.loads(pathlib.Path(APP).read_text())["deadline_us"]
        for name, latencies in by_output.items():
            expected = {"n": str(ACTIVATIONS), "p50": ms(quantile(latencies, 0.5)), "p99": "-",
                        "max": ms(max(latencies)), "missed": str(sum(us > deadline for us in latencies))}
            self.assertEqual({k: rows[name][k] for k in expected}, expected, name)
        self.assertEqual(self.html.count("<svg viewBox='0 0 240 34'"), len(by_output))  # a distribution each

    def test_page_and_trace_give_the_same_jobs_preemptions_and_load(self):
        rows = self.page.table("XPU")
        self.assertEqual(set(rows), {s.track.split("/")[1] for s in self.trace.on("run")})
        whole = [s for s in self.trace.slices if s.track == "releases" or s.track.startswith("run/")]
        length = max(s.end for s in whole) - min(s.begin for s in whole)
        preempted = 0
        for xpu, row in rows.items():
            pieces = self.trace.on("run/" + xpu, "run")
            parts = [s.args["part"] for s in pieces]
            self.assertEqual(row["jobs"], str(parts.count(1)))
            self.assertEqual(row["preemptions"], str(len(parts) - parts.count(1)))
            preempted += len(parts) - parts.count(1)
            busy, until = 0, 0
            for s in sorted(self.trace.on("run/" + xpu), key=lambda s: s.begin):
                busy += max(0, s.end - max(s.begin, until))
                until = max(until, s.end)
            self.assertAlmostEqual(float(row["busy"].rstrip(" %")), 100 * busy / length, delta=0.11)
        self.assertGreater(preempted, 0)  # HEFT preempts on the GPU: else this test sees nothing

    def test_the_worst_release_is_the_same_everywhere(self):
        told, chains = self.explain("worst"), self.chains()
        self.assertEqual(list(told), [c["name"] for c in self.run_json["chains"]])
        for number, (name, words) in enumerate(told.items()):
            longest = max(s.args["reaction_us"] for s in chains[name].values())
            self.assertEqual((words["reaction_us"], words["rank"], words["of"]), (longest, 1, ACTIVATIONS))
            self.assertEqual(chains[name][words["release"]].args["reaction_us"], longest)
            self.assertIn(f"Slowest release of {name}: {words['release']}, {ms(longest)} ms", self.page.headings)
            rows = self.page.table("XNode, ms since then", number)
            times = ("ready", "began", "ended")
            self.assertEqual({row: [of["on"], *(of[k] for k in times)] for row, of in rows.items()},
                             {f"{j['xnode']} {j['release']}": [j["xpu"], *(ms(j[k + "_us"]) for k in times)]
                              for j in words["jobs"]})

    def test_gantt_has_the_run(self):
        data = json.loads(re.search(r"const DATA = (.*?);</script>", self.html, re.S).group(1))
        shown = {}
        for panel in data["panels"]:
            output = panel["name"].removeprefix("heft: ")
            latencies = {s.args["release"]: s.args["latency_us"] for s in self.trace.on("done", "done")
                         if s.name.rsplit(" ", 1)[0] == output}
            shown[output] = panel["shownLatency"]
            self.assertEqual((latencies[panel["shown"]], panel["shownLatency"]), (max(latencies.values()),) * 2)
            # Nothing behind the output is drawn.
            end = self.releases()[panel["shown"]].begin + panel["shownLatency"] * 1000
            run = [s for s in self.trace.on("run", "run") if s.args["release"] == panel["shown"] and s.begin < end]
            bars = [b for b in panel["measured"] if b[5] == 0]
            self.assertEqual(sorted((b[1], panel["rows"][b[0]]) for b in bars),
                             sorted((s.name, s.track.split("/")[1]) for s in run))
        self.assertEqual(set(shown), {"LA", "PR", "TC"})

    def test_the_page_needs_no_network(self):
        self.assertEqual(self.page.links, [])
        text = self.html.replace("http://www.w3.org/2000/svg", "")
        self.assertEqual(re.findall(r".{0,20}(?:://|@import|url\((?!#h\$)|fetch\(|XMLHttpRequest).{0,20}", text), [])

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
        rows = re.findall(r"^  (\S+) +(\d+)  (\S+) +([\d.]+) +([\d.]+) +([\d.]+) +- +-  ", answer.stdout, re.M)
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
