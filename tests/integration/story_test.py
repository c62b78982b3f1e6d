# SPDX-License-Identifier: Apache-2.0
"""What a run by keys tells: its trace is read by pftrace.py, and chains, windows, samples and lateness are computed here, out
of arrows, slices and the files. Neither shares code with the tools. The report counts by what travels with messages; here
it is followed who has read what."""
import collections
import json
import math
import pathlib
import subprocess
import tempfile
import unittest
from fractions import Fraction

import pftrace
from common import BIN, QUEUES, SOURCE, XAUTO, activations, top, wait_for, xauto

APP = SOURCE / "examples/driving/rates.json"


class Told:
    """Who has read what, by the arrows of a trace."""

    def __init__(self, data):
        self.trace = pftrace.Trace(data)
        self.jobs = collections.defaultdict(list)  # (XNode, activation) -> slices
        source_of, self.releases = {}, {}
        for s in self.trace.slices:
            if s.category == "release":
                self.releases[s.args["source"], s.args["release"]] = s.begin
                source_of.update({flow: ("release", s.args["source"], s.args["release"]) for flow in s.flows_out})
            elif s.category == "run":
                job = s.name, s.args["activation"]
                self.jobs[job].append(s)
                source_of.update({flow: ("job", *job) for flow in s.flows_out})
            elif s.category == "sample":
                assert len(s.flows_in) <= 1 and len(s.flows_out) == 1, s
                source_of.update({flow: ("sample", s) for flow in s.flows_out})
        self.inputs, self.reads = collections.defaultdict(list), collections.defaultdict(list)
        for job, slices in self.jobs.items():
            for flow in slices[0].flows_in:
                kind, *of = source_of[flow]
                if kind == "sample":
                    self.reads[job].append(of[0])
                    self.inputs[job] += [source_of[f] for f in of[0].flows_in]
                else:
                    self.inputs[job].append((kind, *of))
        self.known = {}

    def knows(self, job):
        """source -> the oldest release that `job` is made of."""
        if job not in self.known:
            mine = {}
            for kind, *of in self.inputs[job]:
                for source, k in ({of[0]: of[1]} if kind == "release" else self.knows(tuple(of))).items():
                    mine[source] = min(k, mine.get(source, k))
            self.known[job] = mine
        return self.known[job]

    def reactions(self, source, module, last, sampled):
        """Release -> nanoseconds until an output of `module` knew it; `last` is its last XNode. What comes first through
        samples is not counted: nobody could read before."""
        done = {s.name.rsplit(" ", 1)[1]: s.begin for s in self.trace.slices
                if s.category == "done" and s.name.rsplit(" ", 1)[0] == module}
        took, newest = {}, None
        for job, slices in sorted(self.jobs.items(), key=lambda j: j[1][-1].end):
            if job[0] != last or source not in self.knows(job) or str(slices[0].args["release"]) not in done:
                continue
            k = self.knows(job)[source]
            if newest is None and sampled:
                newest = k
            for n in range(k if newest is None else newest + 1, k + 1):
                took[n] = done[str(slices[0].args["release"])] - self.releases[source, n]
            newest = k if newest is None else max(newest, k)
        return took


class Story(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        cls.app = json.loads(APP.read_text())
        done = xauto("solve", "--app", APP, "--platform", "small", "--max-evaluations", 2000, "--threads", 1,
                     "--time-limit", "60s", "--out", cls.folder / "policy.json")
        assert done.returncode == 0, done.stdout + done.stderr
        cls.policy = json.loads((cls.folder / "policy.json").read_text())
        (cls.folder / "queues.json").write_text(json.dumps(
            {"schema": "xauto.deployment", "version": 1, "app": "driving-rates", **QUEUES}))
        cls.file = cls.folder / "t.pftrace"
        done = cls.run_app("--trace-out", cls.file)
        cls.report = json.loads(done.stdout)["runs"][0]
        cls.told = Told(cls.file.read_bytes())

    @classmethod
    def run_app(cls, *flags):
        done = xauto("run", "--app", APP, "--platform", "small", "--emulate", "--json", "--policy", cls.folder / "policy.json",
                     "--deployment", cls.folder / "queues.json", "--duration", "3s", *flags, "--", BIN / "driving-rates")
        assert done.returncode == 0, done.stderr
        return done

    def explain(self, *flags):
        done = xauto("explain", "--trace", self.file, *flags)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def chains(self):
        for chain in self.app["chains"]:
            module = next(x["module"] for x in self.app["xnodes"] if x["name"] == chain["to"])
            fires = {chain["to"]}  # what chain["to"] is fired by, through edges
            for _ in self.app["edges"]:
                fires |= {u for u, v in self.app["edges"] if v in fires}
            heard = {x.get("source") for x in self.app["xnodes"] if x["name"] in fires}
            yield chain["name"], self.told.reactions(chain["from"], module, chain["to"], chain["from"] not in heard)

    def test_all_time_of_a_release_is_accounted_for(self):
        """What is said to run ran then, by the slices; and there is no gap."""
        for which in ("worst", "median"):
            stories = json.loads(self.explain("--json", "--activation", which))["chains"]
            self.assertEqual(len(stories), len(self.app["chains"]))
            for story in stories:
                way = story["way"]
                ends = [0] + [s["end_us"] for s in way]
                self.assertEqual([s["begin_us"] for s in way], ends[:-1], story["chain"])
                self.assertEqual(ends[-1], story["reaction_us"])
                released = self.told.releases[next(c["from"] for c in self.app["chains"] if c["name"] == story["chain"]),
                                              story["release"]]
                for spent in way:
                    ran = sum(max(0, min(s.end - released, spent["end_us"] * 1000) - max(s.begin - released, spent["begin_us"] * 1000))
                              for (name, _), slices in self.told.jobs.items() if name == spent["xnode"] for s in slices)
                    whole = spent["end_us"] - spent["begin_us"]
                    if spent["on"] == "running":
                        self.assertAlmostEqual(ran / 1000, whole, delta=2.1, msg=spent)
                    elif spent["on"] in ("held", "waiting", "off the XPU"):
                        self.assertAlmostEqual(ran / 1000, 0, delta=2.1, msg=spent)

    def test_reactions_are_what_the_run_has_counted(self):
        counted = {c["name"]: c for c in self.report["chains"]}
        for name, took in self.chains():
            self.assertEqual(len(took), counted[name]["results"], name)
            self.assertAlmostEqual(max(took.values()) / 1000, counted[name]["latency_us"]["max"], delta=1.01)
            drawn = {s.args["release"]: s for s in self.told.trace.on("chains/" + name, "chain")}
            self.assertEqual(set(drawn), set(took), name)
            for k, s in drawn.items():
                self.assertEqual((s.end - s.begin, s.args["reaction_us"]), (took[k], took[k] // 1000), (name, k))

    def test_explain_goes_back_to_every_sensor(self):
        for name, took in self.chains():
            story, = json.loads(self.explain("--chain", name, "--json"))["chains"]
            self.assertEqual(story["reaction_us"], max(took.values()) // 1000)
            self.assertEqual((story["rank"], story["of"]), (1, len(took)))
            self.assertIn(took[story["release"]], (max(took.values()), *[t for t in took.values() if
                                                                        t // 1000 == max(took.values()) // 1000]))
            number = {(j["xnode"], j["release"]) for j in story["jobs"]}
            # All that the first job to know it is made of, and nothing else.
            wanted, front = set(), []
            for job, slices in self.told.jobs.items():
                if job[0] == "ctl.act" and ("ctl.act", slices[0].args["release"]) in number:
                    front.append(job)
            self.assertEqual(len(front), 1)
            sensors = set()
            while front:
                job = front.pop()
                if job in wanted:
                    continue
                wanted.add(job)
                for kind, *of in self.told.inputs[job]:
                    front.append(tuple(of)) if kind == "job" else sensors.add(tuple(of))
            self.assertEqual(number, {(j[0], self.told.jobs[j][0].args["release"]) for j in wanted})
            self.assertEqual({(s["source"], s["release"]) for s in story["sensors"]}, sensors)
            source = next(c["from"] for c in self.app["chains"] if c["name"] == name)
            # The job knows it, or a newer one, with which it came through: then both have the same end.
            known = min(n for s, n in sensors if s == source and n >= story["release"])
            ends = {self.told.releases[source, n] + took[n] for n in (known, story["release"])}
            self.assertEqual(len(ends), 1, (story["release"], sensors))

    def nominal(self, xnode, n):
        """Of activation n of the XNode's component. No source of this app has an offset."""
        for names, rate in (({"ld.pre", "ld.infer", "ld.post"}, 10), ({"ctl.plan", "ctl.act"}, 50)):
            if xnode in names:
                return min(self.told.releases.values()) + math.floor(n * Fraction(10**9, rate))
        return min(self.told.releases.values()) + math.floor(n * Fraction(10**9, 30))

    def placed(self, xnode, n):
        row = next(x for x in self.policy["xnodes"] if x["name"] == xnode)
        return row["xpu"], [row.get(k, [0])[n % len(row.get(k, [0]))] * 1000 for k in ("hold_us", "key_us")]

    def test_windows_and_lateness_are_the_policys(self):
        windows = {(s.name, s.args["release"]): s for s in self.told.trace.slices if s.category == "window"}
        self.assertEqual(len(windows), len(self.told.jobs))
        for (xnode, _), slices in self.told.jobs.items():
            n = slices[0].args["release"]
            xpu, (hold, key) = self.placed(xnode, n)
            nominal, window = self.nominal(xnode, n), windows[xnode, n]
            self.assertEqual((window.track, window.begin, window.end),
                             (f"run/{xpu}/windows", nominal + hold, nominal + key), (xnode, n))
            self.assertEqual(slices[0].args["key_us"], key // 1000)
            self.assertEqual(slices[0].args["since_release_us"], (slices[0].begin - nominal) // 1000)
            self.assertEqual(slices[-1].args["lateness_us"], window.args["lateness_us"])
        # A slice on an XPU ends where the next one begins; what the module's track has is the job's own end.
        ends = collections.defaultdict(list)
        for s in self.told.trace.slices:
            if s.category == "job":
                ends[s.name].append(s.end)
        jobs = collections.defaultdict(list)
        for (xnode, activation), slices in sorted(self.told.jobs.items(), key=lambda j: j[0][1]):
            jobs[xnode].append(slices)
        for xnode, of in jobs.items():
            self.assertEqual(len(of), len(ends[xnode]))
            for slices, end in zip(of, ends[xnode]):
                late = end - self.nominal(xnode, slices[0].args["release"]) - self.placed(xnode, slices[0].args["release"])[1][1]
                self.assertEqual(slices[-1].args["lateness_us"], -(-late // 1000), (xnode, slices[0].args["release"]))

    def test_what_was_read_and_how_old_it_was(self):
        modules = {x["name"]: x["module"] for x in self.app["xnodes"]}
        readers = {modules[v]: v for _, v in self.app["samples"]}
        read, newest = collections.Counter(), {}
        for job, samples in self.told.reads.items():
            self.assertEqual(readers[modules[job[0]]], job[0])
            self.assertEqual({s.args["read"] for s in samples}, {modules[u] for u, v in self.app["samples"] if v == job[0]})
            for s in samples:
                read[job[0]] += 1
                self.assertLessEqual(s.begin, self.told.jobs[job][0].begin)
                of = [d for d in self.told.jobs.values() if modules[d[0].name] == s.args["read"] and d[-1].end <= s.begin]
                last = max((d[-1] for d in of), key=lambda d: d.args["release"], default=None)
                # Between end and publication a thread may stand still: it is the newest, or one before; never one before
                # what was read last.
                before = newest.get((job[0], s.args["read"]), (-1, 0))
                number = s.args.get("number", -1)
                self.assertLessEqual(number, -1 if last is None else last.args["release"])
                self.assertTrue(number >= before[0] if s.begin > before[1] else number <= before[0], s)
                newest[job[0], s.args["read"]] = max(before, (number, s.begin), key=lambda n: n[1])
                if number < 0:
                    continue
                age = (s.begin - self.nominal(next(x for x in modules if modules[x] == s.args["read"]), s.args["number"]))
                self.assertEqual(s.args["age_us"], age // 1000)
        ctl = next(m for m in self.report["modules"] if m["name"] == "CTL")
        self.assertEqual(read["ctl.plan"], 3 * ctl["activations"])

    def test_in_flight_is_counted(self):
        for module in {x["module"] for x in self.app["xnodes"]}:
            values = [v for _, v in self.told.trace.counters[f"counters/{module} in flight"]]
            self.assertEqual((max(values), values[-1]), (1, 0), module)

    def test_no_worst_case_stands_without_what_became_of_it(self):
        said = json.loads(self.explain("--json"))
        self.assertIn("worst cases of", said["claims"])
        for why in self.report["claims"]["broken"]:
            self.assertIn(why, said["claims"])
        self.assertIn(said["claims"], self.explain())
        done = xauto("explain", "--trace", self.file, "--chain", "none")
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertIn("lane, behind, obstacle, control", done.stderr)

    def test_policies_are_compared_chain_by_chain(self):
        done = xauto("compare", "--app", APP, "--platform", "small", "--emulate", "--deployment", self.folder / "queues.json",
                     "--duration", "1.5s", "--time-limit", "1s", "--out", self.folder / "compared", "--", BIN / "driving-rates")
        self.assertEqual(done.returncode, 0, done.stderr)
        runs = json.loads((self.folder / "compared/report.json").read_text())["runs"]
        self.assertEqual([r["policy"] for r in runs], ["ros2", "fixed", "xauto"])
        lines = done.stdout.splitlines()
        for i, chain in enumerate(self.app["chains"]):
            at = lines.index("  " + chain["name"])
            for run, line in zip(runs, lines[at + 1:at + 4]):
                counted = run["chains"][i]
                self.assertEqual(counted["name"], chain["name"])
                self.assertGreater(counted["results"], 5, (run["policy"], chain["name"]))
                self.assertTrue(line.startswith("    " + run["name"]), line)
                number = line[len("    " + run["name"]):].split()
                self.assertEqual(number[:3], ["-" if counted["latency_us"][q] is None else f"{counted['latency_us'][q] / 1000:.2f}"
                                              for q in ("p50", "p99", "max")])
                self.assertEqual("worst_case_us" in counted, run["policy"] == "xauto")
                if run["policy"] == "xauto":
                    mark = "*" if run["claims"]["broken"] or run["claims"]["exceeded"] else ""
                    self.assertEqual(number[3], f"{mark}{counted['worst_case_us'] / 1000:.2f}")
                else:
                    self.assertEqual(number[3], "-")
        # It ran by its priorities.
        fixed = json.loads((self.folder / "compared/fixed.policy.json").read_text())
        self.assertIs(fixed["certified"], False)
        trace = pftrace.Trace((self.folder / "compared/fixed.pftrace").read_bytes())
        priority = {x["name"]: (x["xpu"], x["priority"]) for x in fixed["xnodes"]}
        for s in trace.slices:
            if s.category == "run":
                self.assertEqual((s.track.split("/")[1], s.args["priority"]), priority[s.name])
        self.assertFalse([s for s in trace.slices if s.category == "window"])

    def looks(self, *flags):
        """`top` of a run that goes on, of it alone and of all, as JSON and as text; then its report."""
        tool = subprocess.Popen([XAUTO, "run", "--app", str(APP), "--platform", "small", "--emulate", "--policy",
                                 str(self.folder / "policy.json"), "--deployment", str(self.folder / "queues.json"), "--activations",
                                 "0", "--out", str(self.folder / "live.json"), *flags, "--", str(BIN / "driving-rates")],
                                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            wait_for("results", lambda: activations(tool).get("CTL", 0) > 20, tool)
            run = f"{tool.pid}-0"
            one = top(tool)
            words = xauto("top", "--run", run, "--once", "--interval", "50ms").stdout
            runs, said = json.loads(xauto("top", "--once", "--json").stdout)["runs"], xauto("top", "--once").stdout
        finally:
            tool.terminate()
            tool.communicate(timeout=60)
        own = [of for of in runs if of["run"] == run]
        self.assertEqual(len(own), 1, runs)
        return one, words, own[0], said, json.loads((self.folder / "live.json").read_text())["runs"][0]

    def test_a_run_that_goes_on_shows_reactions_beside_worst_cases(self):
        one, words, of_all, said, report = self.looks()
        claims = {c["name"]: c for c in self.policy["chains"]}
        counted = {c["name"]: c for c in report["chains"]}
        for look in (one["chains"], of_all["chains"]):
            self.assertEqual([c["name"] for c in look], list(claims))
            for chain in look:
                claim, latency = claims[chain["name"]], counted[chain["name"]]["latency_us"]
                self.assertEqual((chain["worst_case_us"], chain["lower_bound_us"]),
                                 (claim["worst_case_us"], claim["lower_bound_us"]))
                self.assertLessEqual(0, chain["last_us"])
                self.assertLessEqual(chain["last_us"], chain["longest_us"])
                self.assertLessEqual(chain["longest_us"], latency["max"])
        for seen, text in ((one, words), (of_all, said)):
            longer = [c for c in seen["chains"] if c["longest_us"] > c["worst_case_us"] * 1.02]
            self.assertEqual(seen["claims"]["exceeded"], bool(longer))
            self.assertIn("worst cases, so far: ", text)
        # What was broken by then is still broken in the end.
        broken = of_all["claims"]["broken"]
        for kind in ("outran their WCET", "activations were lost"):
            if any(kind in b for b in broken):
                self.assertTrue(any(kind in b for b in report["claims"]["broken"]), kind)
        if any("were not where" in b for b in broken):
            self.assertTrue(any("states a jitter" in b for b in report["claims"]["broken"]))

    def test_what_the_run_does_not_keep_is_named_while_it_goes_on(self):
        one, words, of_all, said, _ = self.looks("--lockstep")
        for broken, text in ((one["claims"]["broken"], words), (of_all["claims"]["broken"], said)):
            self.assertTrue(any("(--lockstep)" in b for b in broken), broken)
            self.assertIn("(--lockstep)", text)
            for chain in self.policy["chains"]:
                self.assertIn(f"*{chain['worst_case_us'] / 1000:.2f}", text)


if __name__ == "__main__":
    unittest.main()
