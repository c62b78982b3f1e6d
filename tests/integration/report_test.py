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
        answer = xauto("report", cls.at("heft.pftrace"), "--report", cls.report, "--out", cls.at("page.html"))
        assert answer.returncode == 0, answer.stderr
        cls.html = pathlib.Path(cls.at("page.html")).read_text()
        cls.page = Page(cls.html)
        cls.run_json = json.loads(pathlib.Path(cls.report).read_text())["runs"][0]

    @classmethod
    def at(cls, name):
        return os.path.join(cls.folder.name, name)

    def explain(self, activation):
        answer = xauto("explain", "--trace", self.at("heft.pftrace"), "--activation", activation, "--json")
        self.assertEqual(answer.returncode, 0, answer.stderr)
        return json.loads(answer.stdout)

    def releases(self):
        return {s.args["release"]: s for s in self.trace.on("releases", "release")}

    # ---- the trace tells what the run's report tells

    def test_the_trace_has_every_release_with_its_latency(self):
        releases = self.releases()
        self.assertEqual(sorted(releases), list(range(ACTIVATIONS)))
        latencies = [s.args["latency_us"] for s in releases.values()]
        for s in releases.values():
            self.assertEqual(s.args["latency_us"], (s.end - s.begin) // 1000)
        self.assertEqual((quantile(latencies, 0.5), max(latencies)), (self.run_json["p50_us"], self.run_json["max_us"]))

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
        begin = {n: s.begin for n, s in self.releases().items()}
        by_output = {}
        for s in self.trace.on("done", "done"):
            by_output.setdefault(s.name.rsplit(" ", 1)[0], []).append((s.begin - begin[s.args["release"]]) // 1000)
        rows = self.page.table("output of, ms")
        self.assertEqual(set(rows), set(by_output))
        deadline = json.loads(pathlib.Path(APP).read_text())["deadline_us"]
        for name, latencies in by_output.items():
            expected = {"n": str(ACTIVATIONS), "p50": ms(quantile(latencies, 0.5)), "p99": ms(quantile(latencies, 0.99)),
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

    def test_the_worst_release_is_the_same_everywhere_and_adds_up(self):
        releases = self.releases()
        worst = max(releases.values(), key=lambda s: s.args["latency_us"])
        words = self.explain("worst")
        self.assertEqual(words["latency_us"], worst.args["latency_us"])
        self.assertIn(f"Slowest release: {words['release']}, {ms(words['latency_us'])} ms",
                      self.page.headings)
        rows = self.page.table("step")
        self.assertEqual([*rows], [s["xnode"] for s in words["steps"]] + ["published"])
        self.assertEqual(sum(round(float(r["took"]) * 1000) for r in rows.values()), words["latency_us"])

    def test_gantt_has_the_run_and_the_plan(self):
        data = json.loads(re.search(r"const DATA = (.*?);</script>", self.html, re.S).group(1))
        panel = data["panels"][0]
        worst = self.explain("worst")
        self.assertEqual(panel["shown"], worst["release"])
        run = [s for s in self.trace.on("run", "run") if s.args["release"] == worst["release"]]
        bars = [b for b in panel["measured"] if b[5] == 0]
        self.assertEqual(sorted((b[1], panel["rows"][b[0]]) for b in bars),
                         sorted((s.name, s.track.split("/")[1]) for s in run))
        plan = [s for s in self.trace.on("plan") if s.args["release"] == worst["release"]]
        self.assertEqual(len(panel["plan"]), len(plan))
        self.assertEqual(sorted(b[1] for b in panel["plan"] if b[5] == 0),
                         sorted(s.name for s in plan if not s.name.startswith("switch: ")))

    def test_the_page_needs_no_network(self):
        self.assertEqual(self.page.links, [])
        text = self.html.replace("http://www.w3.org/2000/svg", "")
        self.assertEqual(re.findall(r".{0,20}(?:://|@import|url\((?!#h\$)|fetch\(|XMLHttpRequest).{0,20}", text), [])

    # ---- in words

    def test_every_release_adds_up_to_its_latency(self):
        for number, release in self.releases().items():
            words = self.explain(number)
            self.assertEqual(words["latency_us"], release.args["latency_us"])
            total = words["publish_us"]
            before = 0
            for step in words["steps"]:
                parts = [step[k + "_us"] for k in ("handover", "waited", "ran", "switched", "suspended")]
                self.assertTrue(all(p >= 0 for p in parts), step)
                self.assertEqual(before + sum(parts), step["end_us"])
                before = step["end_us"]
                total += sum(parts)
            self.assertEqual(total, release.args["latency_us"])

    def test_who_was_waited_for_had_the_xpu(self):
        words = self.explain("worst")
        run = [s for s in self.trace.on("run", "run")]
        named = 0
        for step in words["steps"]:
            for blocker in step["waited_for"] + step["preempted_by"]:
                named += 1
                name, _, release = blocker["who"].partition(" of release ")
                number = int(release) if release else words["release"]
                self.assertTrue(any(s.name == name and s.args["release"] == number and s.track == "run/" + step["xpu"]
                                    for s in run), blocker)
        self.assertGreater(named, 0)  # under HEFT somebody always waits for the GPU

    def test_the_printed_account_adds_up(self):
        answer = xauto("explain", "--trace", self.at("heft.pftrace"))
        self.assertEqual(answer.returncode, 0, answer.stderr)
        latency = re.search(r"release \d+ took ([\d.]+) ms, the longest of 12", answer.stdout).group(1)
        took = [int(m.replace(".", "")) for m in re.findall(r"^ +(\d+\.\d{3}) +\d+\.\d{3} ", answer.stdout, re.M)]
        self.assertEqual(sum(took), int(latency.replace(".", "")), answer.stdout)
        kinds = re.search(r"Of it ([\d.]+) ms is work, ([\d.]+) waiting for an XPU, ([\d.]+) suspended, ([\d.]+) "
                          r"switching, ([\d.]+) handing over", answer.stdout).groups()
        self.assertEqual(sum(int(k.replace(".", "")) for k in kinds), int(latency.replace(".", "")))

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
