#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs that the machine's service does not trust: an honest one of another user, and what an attacker may still do. He is
uid 65534, and shares no code with us (tests/attack/page.py)."""
import json
import os
import pathlib
import shutil
import subprocess
import tempfile
import time
import unittest

from common import BIN, SOURCE, TESTAPP, children_of, system_service, top, wait_for, xauto

NOBODY, OTHER = 65534, 65533
CORE = min(os.sched_getaffinity(0))
RTTIME_US = 1_000_000
CAP_SYS_RESOURCE = 24
EFFECTIVE = next(line for line in pathlib.Path("/proc/self/status").read_text().splitlines() if line.startswith("CapEff"))
MAY_LIMIT = int(EFFECTIVE.split()[1], 16) >> CAP_SYS_RESOURCE & 1


@unittest.skipIf(os.geteuid() != 0 or shutil.which("setpriv") is None, "only root is another user")
class Regulated(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.at = pathlib.Path(folder.name)
        self.attacker = self.at / "page.py"
        shutil.copy(SOURCE / "tests/attack/page.py", self.attacker)
        self.serve("root")

    def serve(self, trust):
        self.service, self.socket = system_service(self, self.at, "--trust", trust)
        self.socket.chmod(0o666)

    def as_user(self, uid, *command):
        return ["setpriv", "--reuid", str(uid), "--regid", str(uid), "--clear-groups", "prlimit", "--rtprio=0", *map(str, command)]

    def begin(self, attack, *more, uid=NOBODY):
        attacker = subprocess.Popen(self.as_user(uid, "python3", self.attacker, self.socket, CORE, attack, *more), stdout=subprocess.PIPE,
                                    text=True)
        self.addCleanup(attacker.stdout.close)
        self.addCleanup(attacker.wait)
        self.addCleanup(attacker.kill)
        return attacker

    def ends(self, attacker):
        said = attacker.stdout.read()  # not communicate: readline may have read on
        self.assertEqual(attacker.wait(), 0)
        return json.loads(said.splitlines()[-1])

    def attack(self, attack, *more):
        return self.ends(self.begin(attack, *more))

    def coordinators(self):
        return [pid for pid, name in children_of(self.service.pid).items() if name.startswith("xauto-coord")]

    def test_who_asks_for_a_core_has_it_and_gives_it_back(self):
        self.assertEqual(self.attack("honest"), {"granted": True, "fifo": True, "cpus": [CORE], "over": True})

    def test_a_job_that_never_ends_is_off_the_core_after_its_budget(self):
        seen = self.attack("never_ends")
        self.assertTrue(seen["granted"])
        self.assertIsNotNone(seen["cut_s"])
        self.assertIsNone(seen["again"])

    def test_forged_starts_and_garbage_have_no_more_than_was_admitted(self):
        for attack in ("starts_and_starts",), ("garbage", 2):
            seen = self.attack(*attack)
            self.assertLessEqual(seen["had_s"], seen["allowed_s"] + 0.2, attack)  # 0.2 s: this machine may stall

    def test_threads_and_xnodes_of_others_stay_theirs(self):
        before = os.sched_getscheduler(0), os.sched_getaffinity(0)
        self.attack("names_a_thread", os.getpid())
        self.assertEqual((os.sched_getscheduler(0), os.sched_getaffinity(0)), before)
        raised = subprocess.Popen(["chrt", "-f", "5", "sleep", "60"])
        self.addCleanup(raised.wait)
        self.addCleanup(raised.kill)
        wait_for("its priority", lambda: os.sched_getscheduler(raised.pid) == os.SCHED_FIFO)
        self.attack("names_a_thread", raised.pid)
        self.assertEqual(os.sched_getscheduler(raised.pid), os.SCHED_FIFO)
        self.assertEqual(self.attack("names_an_xnode"), {"hello": "names an unknown XNode", "granted": False})

    def test_nothing_is_told_at_a_coordinator_but_who_one_is(self):
        self.assertEqual(self.attack("asks_on"), {"observe": 0, "status": 0, "adopt": 0, "regulate": 0, "records": 0})

    def test_who_has_a_core_cannot_make_more_of_it(self):
        seen = self.attack("raises_itself")
        limit_us = seen.pop("limit_us")
        self.assertEqual(seen, {"higher": "refused", "truncate": "refused", "child": 0})
        if MAY_LIMIT:
            self.assertEqual(limit_us, RTTIME_US)

    def test_who_leaves_or_dies_with_a_core_has_it_no_more(self):
        seen = self.attack("closes")
        self.assertIsNotNone(seen["worker"])
        self.assertIsNotNone(seen["lease"])
        self.begin("dies").wait()
        wait_for("its place", lambda: self.coordinators() == [])

    def test_who_rings_all_the_time_is_not_heard_all_the_time(self):
        attacker = self.begin("rings", 4)
        pid = wait_for("a coordinator", lambda: (self.coordinators() or [None])[0])
        time.sleep(0.5)

        def cpu_s():
            words = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
            return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
        before = cpu_s()
        time.sleep(1)
        self.assertLess(cpu_s() - before, 0.1)
        self.assertGreater(self.ends(attacker)["rings"], 10_000)

    def test_places_are_left_for_others(self):
        seen = self.attack("many")
        self.assertLessEqual(seen["workers"], 8)
        self.assertLessEqual(seen["runs"], 4)
        self.assertEqual(seen["xnodes"], "refused")

    def test_two_such_users_do_not_meet(self):
        first = self.begin("joins", 3)
        self.assertEqual(first.stdout.readline(), "there\n")
        seen = self.ends(self.begin("joins", 0, uid=OTHER))
        self.assertEqual(seen, {"refused": "another user who is not trusted is there"})

    def test_a_coordinator_that_dies_leaves_nobody_with_a_core(self):
        attacker = self.begin("stays")
        self.assertEqual(attacker.stdout.readline(), "there\n")
        for pid in self.coordinators():
            os.kill(pid, 9)
        self.assertIsNotNone(self.ends(attacker)["lowered_s"])

    # Runs of ours.

    def app(self, name, period_us, wcet_us):
        """One XNode on the first core."""
        at = self.at / name
        at.mkdir()
        at.chmod(0o777)
        (at / "app.json").write_text(json.dumps({
            "schema": "xauto.app", "version": 3, "name": name,
            "sources": [{"name": f"{name}_source", "period_us": period_us, "jitter_us": 100}],
            "xnodes": [{"name": f"{name}_step", "module": f"{name}_module", "source": f"{name}_source", "wcet_us": {"cpu": wcet_us}}],
            "edges": [], "chains": [{"name": "all", "from": f"{name}_source", "to": f"{name}_step", "deadline_us": period_us}]}))
        (at / "platform.json").write_text(json.dumps({
            "schema": "xauto.platform", "version": 1, "name": "one", "xpus": [{"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 50}]}))

    def plan(self, *names):
        """Together, with room for what is counted of those who are not trusted."""
        each = [option for name in names for option in ("--app", self.at / name / "app.json", "--out", self.at / name / "policy.json")]
        done = xauto("solve", *each, "--platform", self.at / names[0] / "platform.json", "--time-limit", "1s", "--reserve", 20)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)

    def run_app(self, name, period_us, burn_us, every=0, times=1, uid=None):
        at = self.at / name
        command = [BIN / "xauto", "run", "--app", at / "app.json", "--platform", at / "platform.json", "--policy", at / "policy.json", "--real",
                   "--activations", "0", "--overload", "queue:64", "--system", self.socket, "--out", at / "report.json", "--",
                   BIN / "loadapp", name, period_us, burn_us, every, times]
        run = subprocess.Popen([*map(str, command)] if uid is None else self.as_user(uid, *command), stdout=subprocess.PIPE,
                               stderr=subprocess.STDOUT, text=True)
        self.addCleanup(run.stdout.close)
        self.addCleanup(run.wait)
        self.addCleanup(run.kill)
        wait_for(name, lambda: name in self.admitted(), run)
        return run

    def admitted(self):
        told = json.loads(xauto("top", "--system", self.socket, "--interval", "50ms", "--json").stdout)
        return {app["app"]: app["regulated"] for app in told["machine"]["apps"]}

    def report(self, run, name, status=(0,)):
        run.terminate()
        said, _ = run.communicate(timeout=60)
        self.assertIn(run.returncode, status, said)
        return json.loads((self.at / name / "report.json").read_text())["runs"][0]

    def test_a_run_of_another_user_is_scheduled_beside_ours(self):
        self.app("ours", 40_000, 6_000)
        self.app("theirs", 50_000, 8_000)
        self.plan("ours", "theirs")
        ours, theirs = self.run_app("ours", 40_000, 3_000), self.run_app("theirs", 50_000, 4_000, uid=NOBODY)
        self.assertEqual(self.admitted(), {"ours": False, "theirs": True})
        time.sleep(1.5)
        told = json.loads(xauto("top", "--system", self.socket, "--interval", "500ms", "--json").stdout)["machine"]
        for app in told["apps"]:  # what is said of theirs is the coordinator's clock
            self.assertGreater(app["xpus"][0]["had_us"], 10_000, app)
            self.assertGreater(app["xpus"][0]["times"], 5, app)
        for name, run in ("theirs", theirs), ("ours", ours):
            report = self.report(run, name)
            self.assertEqual(report["lost_activations"], 0)
            self.assertGreater(report["chains"][0]["results"], 10)
            self.assertNotIn("strangers", report["claims"].get("not_watched", ""))

    def test_who_overruns_ten_times_is_late_alone(self):
        """With `--trust nobody`, of one user. What is late is told by half of the results: this machine may stall."""
        self.service.kill()
        self.service.wait()
        self.serve("nobody")
        self.app("steady", 40_000, 6_000)
        self.app("wild", 40_000, 5_000)
        self.plan("steady", "wild")
        steady, wild = self.run_app("steady", 40_000, 3_000), self.run_app("wild", 40_000, 4_500, every=2, times=10)
        time.sleep(4)
        seen = self.report(steady, "steady"), self.report(wild, "wild", (0, 1))  # it may lose what it has no time for
        said = json.dumps([(report["claims"], report["chains"]) for report in seen])
        self.assertEqual(seen[0]["lost_activations"], 0, said)
        chain, late = (report["chains"][0] for report in seen)
        self.assertGreater(chain["results"], 50, said)
        self.assertLess(chain["latency_us"]["p50"], chain["worst_case_us"], said)
        self.assertLess(5 * chain["longer_than_claimed"], chain["results"], said)
        self.assertGreater(late["latency_us"]["p50"], 10 * late["worst_case_us"])

    def test_who_is_trusted_finds_room_whoever_is_there(self):
        self.app("ours", 40_000, 6_000)
        self.plan("ours")
        attacker = self.begin("wants_all", 30)
        self.assertEqual(attacker.stdout.readline(), "there\n")
        ours = self.run_app("ours", 40_000, 3_000)
        self.assertEqual(self.ends(attacker), {"ended": True, "lowered": True})
        wait_for("releases", lambda: top(ours).get("releases", 0) > 2, ours)
        self.assertEqual(self.report(ours, "ours")["lost_activations"], 0)


if __name__ == "__main__":
    unittest.main()
