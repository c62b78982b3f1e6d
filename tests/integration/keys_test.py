# SPDX-License-Identifier: Apache-2.0
"""A run by keys: what ran, in its trace, is compared with policy.json. The keys are computed here, out of the files; the
trace is read by pftrace.py. Neither shares code with the tools."""
import collections
import functools
import json
import math
import os
import pathlib
import re
import tempfile
import unittest
from fractions import Fraction

import pftrace
from common import BIN, QUEUES, SOURCE, xauto

APP = SOURCE / "examples/driving/rates.json"
PROGRAM = str(BIN / "driving-rates")
PATIENCE_NS = 5_000_000  # a machine may stand still between a decision and what follows it


def may_use_fifo():
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


class Keys(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        cls.app = json.loads(APP.read_text())
        done = xauto("solve", "--app", APP, "--platform", "small", "--max-evaluations", 3000, "--threads", 1,
                     "--time-limit", "60s", "--out", cls.folder / "policy.json")
        assert done.returncode == 0, done.stdout + done.stderr
        cls.policy = json.loads((cls.folder / "policy.json").read_text())
        # A machine that stands still loses nothing.
        (cls.folder / "queues.json").write_text(json.dumps(
            {"schema": "xauto.deployment", "version": 1, "app": "driving-rates", **QUEUES}))

    def run_app(self, *flags, app=APP, status=0, program=PROGRAM):
        named = () if "--policy" in flags else ("--policy", self.folder / "policy.json")
        done = xauto("run", "--app", app, "--platform", "small", "--emulate", "--json", "--deployment",
                     self.folder / "queues.json", *named, *flags, "--", program)
        self.assertEqual(done.returncode, status, done.stderr)
        return done

    @functools.cached_property
    def components(self):
        """XNode -> (period in us, offset in us) of its component."""
        near = collections.defaultdict(set)
        for u, v in self.app["edges"]:
            near[u].add(v)
            near[v].add(u)
        sources = {s["name"]: s for s in self.app["sources"]}
        of = {}
        for first in (x["name"] for x in self.app["xnodes"]):
            if first in of:
                continue
            members, front = {first}, [first]
            while front:
                for other in near[front.pop()] - members:
                    members.add(other)
                    front.append(other)
            heard = [sources[x["source"]] for x in self.app["xnodes"] if x["name"] in members and "source" in x]
            period = Fraction(1_000_000) / Fraction(heard[0]["rate_hz"])
            offset = min(s.get("offset_us", 0) for s in heard)
            of.update({x: (period, offset) for x in members})
        return of

    def nominal(self, xnode, n):
        """ns after the run's start. The lidar's clock may begin later, and run faster or slower: (ms, ppm)."""
        period, offset = self.components[xnode]
        ms, ppm = self.lidar if self.clock_of(xnode) == "lidar" else (0, 0)
        return math.floor((offset + n * period) * (1_000_000 + ppm) / 1000) + round(ms * 1e6)

    def mixed_policy(self):
        """Three XNodes that are always released together, on one core; on every third activation two of them change places.
        No order of priorities does that. Nothing is proven of it."""
        policy = json.loads(json.dumps(self.policy))
        for row in policy["xnodes"]:
            for unused in ("hold_us", "start_us", "finish_us"):
                row.pop(unused, None)
            row["key_us"] = [4 * max(row["key_us"])]
            if row["name"] in self.MIXED:
                row["xpu"], row["key_us"] = "cpu0", self.MIXED[row["name"]]
        (self.folder / "mixed.json").write_text(json.dumps(policy))
        return policy

    MIXED = {"la.pre": [6000] * 3, "td.pre": [10000, 10000, 20000], "fcd.pre": [15000] * 3}

    def began(self, policy, *flags, app=APP):
        """XPU -> (began, ready, key, XNode, activation) of each job, out of a run's trace."""
        done = self.run_app("--trace-out", self.folder / "t.pftrace", *flags, app=app)
        report = json.loads(done.stdout)["runs"][0]
        self.lidar = self.lidar_of(report)
        self.assertEqual([m["dropped"] + m["failed"] for m in report["modules"]], [0] * 9)
        trace = pftrace.Trace((self.folder / "t.pftrace").read_bytes())
        self.releases = [s for s in trace.slices if s.category == "release"]
        start = min(s.begin for s in self.releases)
        placed = {x["name"]: x for x in policy["xnodes"]}
        jobs, self.ended, early = collections.defaultdict(list), {}, []
        for s in trace.slices:
            if s.category != "run":
                continue
            name, n = s.name.split(" ")[0], s.args["release"]
            self.ended[name, n] = max(s.end, self.ended.get((name, n), 0))
            if s.args["part"] != 1:
                continue
            nominal = start + self.nominal(name, n)
            row = placed[name]
            self.assertEqual(s.track, "run/" + row["xpu"])
            key = nominal + row["key_us"][n % len(row["key_us"])] * 1000
            hold = row.get("hold_us", [0])
            held = nominal + hold[n % len(hold)] * 1000
            if s.begin + 2000 < held:
                early.append((name, n, key, held, s.begin))
            waited_us = s.args["waited_us"] - s.args.get("held_us", 0)
            jobs[s.track].append((s.begin, s.begin - waited_us * 1000, key, name, n))
        self.assertEqual(sum(map(len, jobs.values())), sum(m["activations"] * self.stages(m["name"]) for m in report["modules"]))
        for job in early:
            self.assert_early(placed, start, *job)
        self.assertGreaterEqual(report["early_starts"]["jobs"], len(early))
        self.early = early
        return jobs

    def assert_early(self, placed, start, name, n, key, held, began):
        """It began before its hold was over. So all that has a smaller key on its XPU had ended, where taking that from
        another costs something, and all that it reads by its plan. What is planned is no sooner than its hold."""
        def all_ended(x, counts):
            for k in range(10_000):
                nominal = start + self.nominal(x, k)
                if not counts(nominal, nominal + placed[x]["key_us"][k % len(placed[x]["key_us"])] * 1000):
                    return
                self.assertLessEqual(self.ended.get((x, k), math.inf), began, f"{x} {k} had not ended when {name} {n} began early")
        if not placed[name]["xpu"].startswith("cpu"):
            for x, row in placed.items():
                if x != name and row["xpu"] == placed[name]["xpu"]:
                    all_ended(x, lambda nominal, its: its <= key)
        for u, v in self.app["samples"]:
            if v == name:
                one = (self.clock_of(u) == "lidar") == (self.clock_of(v) == "lidar")
                all_ended(u, lambda nominal, its: its <= held if one else nominal < held)

    def lidar_of(self, report):
        told = re.findall(r"clock 'lidar' began ([0-9.]+) ms after the run, (\d+) ppm (slow|fast)", " ".join(report["notes"]))
        return (float(told[0][0]), int(told[0][1]) * (1 if told[0][2] == "slow" else -1)) if told else (0, 0)

    def clock_of(self, xnode):
        """By its period: the lidar alone has a clock of its own."""
        return "lidar" if self.components[xnode][0] == 100_000 else "main"

    def inversions(self, jobs, key_of=lambda job: job[2]):
        """Pairs of jobs of which the second waited when the first began, and how many of them are the wrong way round."""
        pairs = wrong = 0
        for on in jobs.values():
            on.sort()
            for i, job in enumerate(on):
                for later in on[i + 1:i + 30]:
                    if later[1] < job[0] - PATIENCE_NS:
                        pairs += 1
                        wrong += key_of(later) < key_of(job)
        return pairs, wrong

    def test_no_job_goes_before_one_of_a_smaller_key_that_waits(self):
        for policy, flags in ((self.policy, ()), (self.mixed_policy(), ("--policy", self.folder / "mixed.json"))):
            pairs, wrong = self.inversions(self.began(policy, "--duration", "4s", *flags))
            # A job is ready before its thread has asked for the XPU. Where the machine stands still in between, the pair looks
            # wrong; each stall makes a few. Without an order half of all would be.
            self.assertLess(wrong, max(8, pairs / 5), f"{wrong} of {pairs}")

    def test_clocks_begin_at_other_phases_and_drift_as_far_as_they_may(self):
        seen = set()
        for seed in (1, 2, 4):
            pairs, wrong = self.inversions(self.began(self.policy, "--duration", "2s", "--phases", "--seed", seed))
            self.assertLess(wrong, max(8, pairs / 5), f"{wrong} of {pairs}")
            ms, ppm = self.lidar
            self.assertTrue(0 < ms < 100, ms)
            self.assertEqual(abs(ppm), next(c["ppm"] for c in self.app["clocks"] if c["name"] == "lidar"))
            start = min(s.begin for s in self.releases)
            for source, first in (("front", "la.pre"), ("tick", "ctl.plan"), ("lidar", "ld.pre")):
                at = [s.begin - start for s in self.releases if s.args["source"] == source]
                self.assertGreater(len(at), 10)
                for n, ns in enumerate(at):
                    self.assertLessEqual(abs(ns - self.nominal(first, n)), 1)
            seen.add(self.lidar)
        self.assertEqual(len(seen), 3, "each seed has a phase of its own")
        self.assertEqual({ppm > 0 for _, ppm in seen}, {True, False}, "slow and fast")

    def test_phases_are_refused_where_there_are_none(self):
        one = json.loads(json.dumps(self.app))
        one.pop("clocks")
        for source in one["sources"]:
            source.pop("clock", None)
        (self.folder / "one.json").write_text(json.dumps(one))
        self.assertIn("has one clock", self.run_app("--phases", app=self.folder / "one.json", status=2).stderr)
        self.assertIn("--lockstep", self.run_app("--phases", "--lockstep", status=2).stderr)
        self.assertIn("--phases", self.run_app("--seed", 2, status=2).stderr)

    def test_what_goes_first_changes_with_the_activation(self):
        jobs = self.began(self.mixed_policy(), "--duration", "4s", "--policy", self.folder / "mixed.json")
        ready = {(name, n): at for _, at, _, name, n in jobs["run/cpu0"]}
        # Both are released at one instant; whoever is there first is suspended for a smaller key. After the machine stood
        # still, one of the modules may be at its last activation yet: then they did not meet.
        first = {n: self.ended["fcd.pre", n] < self.ended["td.pre", n] for name, n in self.ended
                 if name == "td.pre" and abs(ready["fcd.pre", n] - ready[name, n]) < 500_000}
        of_third = [fcd for n, fcd in first.items() if n % 3 == 2]
        of_others = [fcd for n, fcd in first.items() if n % 3 != 2]
        if min(len(of_third), len(of_others)) <= 5:
            self.skipTest("the machine stood still: they hardly met")
        self.assertGreater(sum(of_third), 0.8 * len(of_third))
        self.assertLess(sum(of_others), 0.2 * len(of_others))

    def test_jobs_that_take_less_than_their_wcets_do_not_wait_for_holds(self):
        app = json.loads(json.dumps(self.app))
        for row in app["xnodes"]:
            row["wcet_us"] = {on: us * 13 // 10 for on, us in row["wcet_us"].items()}
        paths = [self.folder / f"slack-{name}.json" for name in ("app", "policy")]
        paths[0].write_text(json.dumps(app))
        done = xauto("solve", "--app", paths[0], "--platform", "small", "--max-evaluations", 3000, "--threads", 1,
                     "--time-limit", "60s", "--out", paths[1])
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        policy = json.loads(paths[1].read_text())
        self.assertTrue([row for row in policy["xnodes"] if row.get("hold_us")], "nothing is held")
        self.began(policy, "--duration", "4s", "--policy", paths[1], app=paths[0])
        self.assertGreater(len(self.early), 20, "assert_early has judged nothing")

    def stages(self, module):
        return sum(x["module"] == module for x in self.app["xnodes"])

    def test_each_chain_stands_beside_its_claim(self):
        """Reactions are at least what the chain's own jobs take, and a longer one is never beside an unqualified claim."""
        report = json.loads(self.run_app("--duration", "3s").stdout)["runs"][0]
        claims = {c["name"]: c for c in self.policy["chains"]}
        self.assertEqual([c["name"] for c in report["chains"]], list(claims))
        for chain in report["chains"]:
            claim = claims[chain["name"]]
            self.assertEqual(chain["worst_case_us"], claim["worst_case_us"])
            self.assertEqual(chain["lower_bound_us"], claim["lower_bound_us"])
            self.assertGreater(chain["results"], 20)
            self.assertEqual(chain["exceeded"], chain["latency_us"]["max"] > chain["worst_case_us"] * 1.02)
        self.assertEqual(report["claims"]["exceeded"], any(c["exceeded"] for c in report["chains"]))
        if report["claims"]["exceeded"]:
            self.assertTrue(report["claims"]["broken"], "exceeded, and nothing was seen to be broken")

    def test_a_run_that_is_set_up_otherwise_claims_nothing(self):
        done = self.run_app("--lockstep", "--activations", 5)
        report = json.loads(done.stdout)["runs"][0]
        self.assertIn("each release waits for the one before (--lockstep)", report["claims"]["broken"])
        self.assertIn("do not hold in this run", done.stderr)

    def test_a_policy_that_is_not_certified_runs_and_is_held_against_nothing(self):
        app = json.loads(json.dumps(self.app))
        for xnode in app["xnodes"]:
            xnode["wcet_us"] = {kind: 4 * us for kind, us in xnode["wcet_us"].items()}
            xnode.pop("typical_us", None)
        crowded, policy = self.folder / "crowded.json", self.folder / "crowded.policy.json"
        crowded.write_text(json.dumps(app))
        solved = xauto("solve", "--app", crowded, "--platform", "small", "--max-evaluations", 1000, "--threads", 1,
                       "--time-limit", "60s", "--out", policy)
        self.assertEqual(solved.returncode, 1, solved.stdout + solved.stderr)
        self.assertIs(json.loads(policy.read_text())["certified"], False)
        done = self.run_app("--policy", policy, "--duration", "2s", app=crowded)
        self.assertIn("nothing is claimed of this run", done.stderr)
        report = json.loads(done.stdout)["runs"][0]
        self.assertIs(report["certified"], False)
        self.assertEqual(report["claims"]["verdict"], "nothing claimed")
        self.assertNotIn("of", report["claims"])
        for chain in report["chains"]:
            self.assertGreater(chain["results"], 10, chain)
            self.assertFalse({"worst_case_us", "exceeded"} & set(chain), chain)
        refused = self.run_app("--policy", policy, "--duration", "1s", "--fail-on", "claim", app=crowded, status=2)
        self.assertIn("nothing is claimed: the policy is not certified", refused.stderr)

    def test_in_lockstep_the_time_between_releases_is_no_measurement(self):
        for flags in ((), ("--isolate",)):
            run = json.loads(self.run_app("--lockstep", "--activations", 4, *flags).stdout)["runs"][0]
            chains = {c["name"]: c for c in run["chains"]}
            done = {m["name"]: m for m in run["modules"]}
            none = {"p50": None, "p99": None, "max": None}
            for chain in chains.values():
                self.assertEqual(chain["age_us"], none)
            # `control` lies within one module: each of its activations is a result, and took as long as it says.
            control, ctl = chains.pop("control"), done["CTL"]
            self.assertEqual(control["results"], ctl["activations"])
            self.assertEqual([control["latency_us"][q] for q in ("p50", "p99", "max")],
                             [ctl[q] for q in ("p50_us", "p99_us", "max_us")])
            self.assertNotIn("not_measured", control)
            # The others wait for a tick to sample what is there. The first that comes through a sample counts nowhere.
            for chain, module in (("lane", "LA"), ("behind", "RCD"), ("obstacle", "LD")):
                self.assertLess(chains[chain]["results"] + chains[chain]["not_measured"], done[module]["activations"])
                self.assertGreater(chains[chain]["not_measured"], 0)
                self.assertEqual(chains[chain]["deadline_misses"], 0, "nothing is late that was not measured")
                if chains[chain]["results"] == 0:
                    self.assertEqual(chains[chain]["latency_us"], none)
            self.assertTrue([n for n in run["notes"] if "means nothing in lockstep" in n], run["notes"])

    def test_isolated_modules_follow_the_same_keys(self):
        report = json.loads(self.run_app("--duration", "2s", "--isolate").stdout)["runs"][0]
        self.assertEqual([m["dropped"] + m["failed"] for m in report["modules"]], [0] * 9)
        for chain in report["chains"]:
            self.assertGreater(chain["results"], 10, chain)

    def test_refuses_what_would_not_be_the_plan(self):
        done = self.run_app("--period", "50ms", status=2)
        self.assertIn("would change what the policy was made for", done.stderr)
        app = json.loads(json.dumps(self.app))
        for module in app["modules"]:
            module["max_in_flight"] = 2
        (self.folder / "wide.json").write_text(json.dumps(app))
        done = xauto("solve", "--app", self.folder / "wide.json", "--platform", "small", "--max-evaluations", 500, "--threads", 1,
                     "--time-limit", "60s", "--out", self.folder / "wide.policy.json")
        self.assertEqual(done.returncode, 0, done.stderr)
        done = self.run_app("--policy", self.folder / "wide.policy.json", app=self.folder / "wide.json", status=2)
        self.assertIn("has max_in_flight 2", done.stderr)
        done = self.run_app(program=str(BIN / "driving"), status=2)
        self.assertIn("app.json", done.stderr)

    @unittest.skipUnless(may_use_fifo(), "SCHED_FIFO needs a right")
    def test_a_real_core_follows_keys_that_no_priority_could(self):
        """`short` is released while `long` runs. Its key is before that of `long` in every other activation: then it takes
        the core; in the others it waits, although it is the same XNode."""
        source = {"jitter_us": 5000}
        app = {"schema": "xauto.app", "version": 3, "name": "keysapp", "sources": [
            {"name": "long", "period_us": 50000, **source}, {"name": "short", "period_us": 50000, "offset_us": 5000, **source},
            {"name": "slow", "period_us": 100000, **source}],
            "xnodes": [{"name": f"{n}.run", "module": f"{n}M", "source": n, "wcet_us": {"cpu": us}}
                       for n, us in (("long", 21000), ("short", 2100), ("slow", 1100))], "edges": []}
        platform = {"schema": "xauto.platform", "version": 1, "name": "core", "xpus": [{"id": "cpu0", "type": "cpu"}]}
        paths = {n: self.folder / f"core-{n}.json" for n in ("app", "platform", "policy")}
        paths["app"].write_text(json.dumps(app))
        paths["platform"].write_text(json.dumps(platform))
        done = xauto("solve", "--app", paths["app"], "--platform", paths["platform"], "--max-evaluations", 200, "--threads", 1,
                     "--time-limit", "60s", "--out", paths["policy"])
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        policy = json.loads(paths["policy"].read_text())
        keys = {"long.run": [40000, 40000], "short.run": [10000, 48000], "slow.run": [90000]}
        for row in policy["xnodes"]:
            for unused in ("hold_us", "start_us", "finish_us"):
                row.pop(unused, None)
            row["key_us"] = keys[row["name"]]
        paths["policy"].write_text(json.dumps(policy))
        done = xauto("run", "--app", paths["app"], "--platform", paths["platform"], "--policy", paths["policy"], "--real",
                     "--duration", "4s", "--json", "--trace-out", self.folder / "core.pftrace", "--", BIN / "keysapp")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(json.loads(done.stdout)["runs"][0]["real_cpus"], "SCHED_FIFO, told by coordinators")
        trace = pftrace.Trace((self.folder / "core.pftrace").read_bytes())
        ends = collections.defaultdict(dict)
        for s in trace.slices:
            if s.category == "run":
                of, n = ends[s.name.split(" ")[0]], s.args["release"]
                of[n] = max(s.end, of.get(n, 0))
        took = {n: ends["short.run"][n] < end for n, end in ends["long.run"].items() if n in ends["short.run"]}
        in_even, in_odd = ([t for n, t in took.items() if n % 2 == odd] for odd in (0, 1))
        self.assertGreater(len(in_odd), 10)
        self.assertGreater(sum(in_even), 0.7 * len(in_even), took)
        self.assertLess(sum(in_odd), 0.3 * len(in_odd), took)

    def test_profile_writes_the_samples(self):
        done = xauto("profile", "--platform", "small", "--emulate", "--repetitions", 1, "--warmup", 0, "--app-out",
                     self.folder / "profiled.json", "--", PROGRAM)
        self.assertEqual(done.returncode, 0, done.stderr)
        profiled = json.loads((self.folder / "profiled.json").read_text())
        self.assertEqual(sorted(profiled["samples"]), sorted(self.app["samples"]))
        self.assertEqual(sorted(profiled["edges"]), sorted(self.app["edges"]))


if __name__ == "__main__":
    unittest.main()
