#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""One coordinator per XPU of the machine: runs that know nothing of each other join, are refused, leave and die."""
import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest

import pftrace
from common import BIN, FULL, HOG, TESTAPP, children_of, system_service, testapp_files, wait_for, xauto


class System(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.at = pathlib.Path(folder.name)
        self.service, self.socket = system_service(self, self.at, log=subprocess.PIPE)
        # The first leaves room, the second is planned into it, the third knows of nobody.
        self.plan("first", 40_000, "--reserve", 50, "--demand-out", self.at / "demand.json")
        self.plan("second", 50_000, "--beside", self.at / "demand.json")
        self.plan("third", 12_000)

    def plan(self, name, period_us, *more):
        (self.at / name).mkdir()
        testapp_files(str(self.at / name), period_us=period_us, name=name)
        done = xauto("solve", "--app", self.at / name / "app.json", "--platform", self.at / name / "platform.json",
                     "--max-evaluations", 400, "--time-limit", "60s", "--out", self.at / name / "policy.json", *more)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)

    def start(self, name, period_us, seconds=None, system=None, before=(), flags=()):
        """Without `seconds` it goes on until it is told to end."""
        at = self.at / name
        how_long = ("--duration", f"{seconds}s") if seconds else ("--activations", "0")
        run = subprocess.Popen(
            [*before, BIN / "xauto", "run", "--app", at / "app.json", "--platform", at / "platform.json", "--policy", at / "policy.json",
             *how_long, *flags, "--system", system or self.socket, "--out", at / "report.json", "--", TESTAPP,
             at / "result", "period", str(period_us)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.addCleanup(run.stdout.close)
        self.addCleanup(run.wait)
        self.addCleanup(run.kill)
        return run

    def stopped(self, run, name):
        run.send_signal(signal.SIGTERM)
        return self.ended(run, name)

    def ended(self, run, name, status=0):
        said, _ = run.communicate(timeout=60)
        self.assertEqual(run.returncode, status, said)
        return json.loads((self.at / name / "report.json").read_text())["runs"][0] if status == 0 else said

    def admitted(self):
        """Names of the apps that are there."""
        told = json.loads(xauto("top", "--system", self.socket, "--interval", "50ms", "--json").stdout)
        return [app["app"] for app in told["machine"]["apps"]]

    def machine(self, *flags):
        """What xauto top says of the machine over half a second."""
        return json.loads(xauto("top", "--system", self.socket, "--interval", "500ms", "--json", *flags).stdout)["machine"]

    def coordinators(self):
        return [pid for pid, name in children_of(self.service.pid).items() if name.startswith("xauto-coord")]

    def test_who_fits_comes_and_who_does_not_is_told_why(self):
        first, second = self.start("first", 40_000), self.start("second", 50_000)
        wait_for("both", lambda: sorted(self.admitted()) == ["first", "second"], first)
        self.assertEqual(len(self.coordinators()), 2)  # of a core and of npu0, whoever uses them
        shown = xauto("top", "--system", self.socket, "--once", "--interval", "50ms").stdout
        app = r"    (first|second) \(uid \d+\) +\d+\.\d +(\d+\.\d|-)\n"
        self.assertRegex(shown, r"(?m)^  core\d+ +\d+\.\d +(\d+\.\d|-) +\d+\n" + 2 * app)
        for pid in self.coordinators():
            self.assertNotIn(f"pid {pid} of", shown)
        said = self.ended(self.start("third", 12_000, 2), "third", status=1)
        self.assertRegex(said, r"third: is not admitted: XPU (core\d+|npu0).*(too much|load it by)")
        for run, name, other in ((first, "first", second), (second, "second", first)):
            # Who is admitted is no stranger; tests that run beside this one are.
            self.assertNotIn(f"run {other.pid}-0", " ".join(self.stopped(run, name)["claims"]["broken"]))
        wait_for("nobody", lambda: self.admitted() == [] and self.coordinators() == [])

    def test_shares_and_slack_are_told_and_who_had_an_xpu_is_drawn(self):
        first, second = (self.start(name, us, flags=("--overload", "queue:64")) for name, us in (("first", 40_000), ("second", 50_000)))
        wait_for("both", lambda: sorted(self.admitted()) == ["first", "second"], first)
        def had():
            on = [xpu["had_pct"] for app in self.machine()["apps"] for xpu in app["xpus"]]
            return len(on) == 4 and all(on)
        wait_for("jobs of both on both", had, first)
        machine = self.machine("--timeline", self.at / "machine.pftrace")
        self.assertEqual(machine["left_out"], 0)
        for xpu in machine["coordinators"]:
            admitted = {app["app"]: on["admitted_pct"] for app in machine["apps"] for on in app["xpus"] if on["xpu"] == xpu["xpu"]}
            self.assertEqual(sorted(admitted), ["first", "second"])
            # At t without end what the demands leave is 1 - utilisation: the least over all t is no more.
            self.assertLessEqual(xpu["slack_pct"], 100 - sum(admitted.values()))
            self.assertGreaterEqual(xpu["slack_pct"], 0)
        for app in machine["apps"]:
            self.assertGreater(len(app["pids"]), 0)
            for on in app["xpus"]:
                self.assertGreater(on["admitted_pct"], 0)
                self.assertTrue(on["had_pct"] is None or 0 <= on["had_pct"] <= 100, on)
        metrics = xauto("monitor", "--system", self.socket, "--interval", "50ms").stdout
        self.assertRegex(metrics, r'xauto_machine_slack_ratio\{xpu="core\d+"\} 0\.\d+')
        self.assertRegex(metrics, r'xauto_machine_had_seconds_total\{app="second",lease="\d+",uid="\d+",xpu="npu0"\} \d')
        trace = pftrace.Trace((self.at / "machine.pftrace").read_bytes())
        tracks = {s.track for s in trace.slices if s.track}
        self.assertEqual(tracks, {xpu["xpu"] for xpu in machine["coordinators"]})
        for track in tracks:
            slices = [s for s in trace.slices if s.track == track]
            self.assertEqual({s.name.split()[0] for s in slices}, {"first", "second"})
            for before, after in zip(slices, slices[1:]):
                self.assertLessEqual(before.end, after.begin)
        for run, name in (first, "first"), (second, "second"):
            report = self.stopped(run, name)
            self.assertNotIn("strangers", report["claims"].get("not_watched", ""))

    def test_a_stranger_that_takes_a_core_is_named(self):
        if os.geteuid() != 0:
            self.skipTest("only root may take a core from a run")
        first, second = (self.start(name, us, flags=("--overload", "queue:64")) for name, us in (("first", 40_000), ("second", 50_000)))
        wait_for("both", lambda: sorted(self.admitted()) == ["first", "second"], first)
        core = next(int(on["xpu"][4:]) for app in self.machine()["apps"] for on in app["xpus"] if on["xpu"].startswith("core"))
        hog = subprocess.Popen([sys.executable, "-c", HOG, str(core)], stdout=subprocess.PIPE, text=True)
        self.addCleanup(hog.stdout.close)
        self.addCleanup(hog.wait)
        self.addCleanup(hog.kill)
        self.assertEqual(hog.stdout.readline(), "there\n")
        time.sleep(6)
        hog.kill()
        words = " ".join(self.stopped(first, "first")["claims"]["broken"] + self.stopped(second, "second")["claims"]["broken"])
        self.assertIn(f"python3 (pid {hog.pid}, SCHED_FIFO 98)", words)

    def test_coordinators_and_runs_that_are_killed_take_nobody_with_them(self):
        first = self.start("first", 40_000, flags=("--overload", "queue:64"))
        wait_for("the first", lambda: self.admitted() == ["first"] and len(self.coordinators()) == 2, first)
        for _ in range(300 if FULL else 5):
            second = self.start("second", 50_000)
            wait_for("the second", lambda: "second" in self.admitted(), second)
            victim = self.coordinators()[0]
            os.kill(victim, signal.SIGKILL)
            wait_for("another coordinator", lambda: victim not in self.coordinators() and len(self.coordinators()) == 2)
            second.send_signal(signal.SIGKILL)
            second.wait()
            wait_for("it has left", lambda: self.admitted() == ["first"])
        self.assertEqual(self.stopped(first, "first")["lost_activations"], 0)

    def test_one_that_joins_and_leaves_takes_nothing_from_the_other(self):
        first = self.start("first", 40_000, flags=("--overload", "queue:64"))
        wait_for("the first", lambda: self.admitted() == ["first"], first)
        for _ in range(1000 if FULL else 3):
            second = self.start("second", 50_000, flags=("--overload", "queue:64"))
            wait_for("the second", lambda: "second" in self.admitted(), second)
            second.terminate()  # its program may not have begun: what it says of that is early_test's
            second.communicate(timeout=60)
            wait_for("it has left", lambda: self.admitted() == ["first"], first)
        self.assertEqual(self.stopped(first, "first")["lost_activations"], 0)

    def test_the_service_is_killed(self):
        first = self.start("first", 40_000)
        wait_for("the first", lambda: self.admitted() == ["first"])
        time.sleep(0.5)
        self.service.send_signal(signal.SIGKILL)
        time.sleep(0.5)
        first.send_signal(signal.SIGTERM)
        said, _ = first.communicate(timeout=60)
        self.assertIn("xauto-system ended", said)
        self.assertEqual(first.returncode, 1)  # it ran to its end, and says that nobody scheduled it

    def test_who_may_not_ask_is_told_in_one_sentence(self):
        said = self.ended(self.start("first", 40_000, 1, system=self.at / "nobody.sock"), "first", status=2)
        self.assertIn("no service of the machine listens there", said)
        if os.geteuid() != 0 or shutil.which("setpriv") is None:
            self.skipTest("only root is another user")
        self.socket.chmod(0o600)
        other = ("setpriv", "--reuid", "65534", "--clear-groups")
        (self.at / "first").chmod(0o777)
        said = self.ended(self.start("first", 40_000, 1, before=other), "first", status=1)
        self.assertIn("this user may not use the machine's coordinators", said)

    def test_a_container_needs_the_socket_alone(self):
        """Network and processes of its own: nothing abstract of the machine's is seen there, and no pid."""
        away = ("unshare", "--net", "--pid", "--fork", "--kill-child", "--mount-proc")
        if subprocess.run([*away, "true"], capture_output=True).returncode != 0:
            self.skipTest("only root makes namespaces")
        queued = ("--overload", "queue:8")  # this machine stalls
        first = self.start("first", 40_000, flags=queued)
        wait_for("the first", lambda: self.admitted() == ["first"], first)
        second = self.start("second", 50_000, 5, before=away, flags=queued)
        wait_for("the second", lambda: sorted(self.admitted()) == ["first", "second"], second)
        self.assertEqual(len(self.coordinators()), 2)
        self.assertEqual(self.ended(second, "second")["lost_activations"], 0)
        self.stopped(first, "first")

    def test_a_run_at_other_rates_than_it_states_is_not_asked_for(self):
        for more in (("--period", "5ms"), ("--lockstep",)):
            done = xauto("run", "--app", self.at / "first/app.json", "--platform", self.at / "first/platform.json", "--policy",
                         self.at / "first/policy.json", *more, "--activations", 3, "--system", self.socket, "--", TESTAPP, self.at / "r")
            self.assertIn("it releases at other rates than those of the app", done.stderr)
            self.assertEqual(done.returncode, 2)

    def test_without_rates_or_certificate_nothing_is_asked(self):
        (self.at / "alone").mkdir()
        alone = testapp_files(str(self.at / "alone"), name="alone")
        done = xauto("run", *alone, "--activations", 3, "--system", self.socket, "--", TESTAPP, self.at / "r")
        self.assertIn("sources without a rate take all that they get", done.stderr)
        self.assertEqual(done.returncode, 2)
        policy = self.at / "first" / "policy.json"
        done = xauto("run", "--app", self.at / "first/app.json", "--platform", self.at / "first/platform.json", "--policy", policy,
                     "--scheduling", "timeshare", "--duration", "200ms", "--system", self.socket, "--", TESTAPP, self.at / "r", "period", 40_000)
        self.assertIn("--system", done.stderr)
        self.assertEqual(done.returncode, 2)


if __name__ == "__main__":
    unittest.main()
