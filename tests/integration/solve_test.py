# SPDX-License-Identifier: Apache-2.0
"""xauto solve as a user runs it: progress, the time limit, Ctrl-C with the best answer written, and memory."""
import json
import os
import pathlib
import re
import resource
import signal
import subprocess
import tempfile
import time
import unittest

from common import XAUTO, sourced, wait_for, xauto

MOST_KIB = 500 * 1024
# AddressSanitizer keeps freed memory in a quarantine, and every stack that ever allocated: its memory, not the solver's.
LITTLE_OF_ASAN = {**os.environ, "ASAN_OPTIONS": os.environ.get("ASAN_OPTIONS", "") + ":quarantine_size_mb=16:malloc_context_size=1"}


SANITIZED = any(word in pathlib.Path(XAUTO).read_bytes() for word in (b"__asan_init", b"__tsan_init"))
SLACK = 10 if SANITIZED else 1


class Solve(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.at = pathlib.Path(self.folder.name)

    def app(self, nodes, seed=3):
        path = self.at / f"app-{nodes}-{seed}.json"
        made = xauto("generate", "--nodes", nodes, "--seed", seed, "--out", path)
        self.assertEqual(made.returncode, 0, made.stderr)
        return path

    def solve(self, app, *arguments, interrupt_when=None):
        """Interrupted as soon as interrupt_when(stderr) holds. Exit status, both texts, the policy, and the peak of resident memory in KiB."""
        policy = self.at / "policy.json"
        policy.unlink(missing_ok=True)
        with open(self.at / "out", "w+") as out, open(self.at / "err", "w+") as err:
            process = subprocess.Popen([XAUTO, "solve", "--app", app, "--platform", "small", "--out", policy,
                                        *map(str, arguments)], stdout=out, stderr=err, env=LITTLE_OF_ASAN)
            if interrupt_when is not None:
                wait_for("its handler", lambda: catches_sigint(process.pid) or ended(process.pid))
                wait_for("what is interrupted", lambda: interrupt_when((self.at / "err").read_text()) or ended(process.pid))
                os.kill(process.pid, signal.SIGINT)  # a zombie takes it too
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            out.seek(0)
            err.seek(0)
            return process.returncode, out.read(), err.read(), json.loads(policy.read_text()), usage.ru_maxrss

    def check(self, app):
        checked = xauto("check", "--app", app, "--platform", "small", "--policy", self.at / "policy.json")
        self.assertEqual(checked.returncode, 0, checked.stdout + checked.stderr)

    @staticmethod
    def longest(policy):
        return max(chain["worst_case_us"] for chain in policy["chains"])

    def test_a_missed_deadline_is_status_1_proven_or_not(self):
        app = self.app(40, 5)
        limits = "--max-evaluations", 1, "--threads", 1, "--time-limit", "1s"
        out = json.loads(self.solve(app, *limits, "--json")[1])
        between = int(out["objective"]["largest"]["value"] + out["objective"]["largest"]["lower_bound"]) // 2
        spec = json.loads(app.read_text())
        for deadline, code, words in ((1, 1, "proven, by lower bounds"), (between, 1, "is not proven"), (10**9, 0, "")):
            app.write_text(json.dumps({**spec, "deadline_us": deadline}))
            done, out, err, policy, _ = self.solve(app, *limits)
            self.assertEqual((done, self.longest(policy) > deadline), (code, code == 1), out + err)
            self.assertIn(words, out)

    def test_a_wcet_far_above_what_is_usual_is_named_where_it_decides(self):
        app = self.at / "app.json"
        for wcet, named in ((32000, ["spiky"]), (1200, [])):
            app.write_text(json.dumps(sourced({"name": "a", "edges": [], "xnodes": [
                {"name": "spiky", "module": "m", "wcet_us": {"cpu": wcet}, "typical_us": {"cpu": 600}},
                {"name": "calm", "module": "n", "wcet_us": {"cpu": 900}, "typical_us": {"cpu": 500}}]}, "s")))
            told = json.loads(self.solve(app, "--json")[1])
            self.assertEqual([r["xnode"] for r in told.get("rare_wcets", [])], named)
            self.assertEqual("usually 0.600 ms" in self.solve(app)[1], bool(named))

    def test_scenarios_name_it_too_where_a_deadline_is_missed(self):
        app, scenarios = self.at / "app.json", self.at / "scenarios.json"
        scenarios.write_text(json.dumps({"schema": "xauto.scenarios", "version": 1, "app": "a",
                                         "scenarios": [{"name": "nominal"}, {"name": "slow", "wcet_scale_pct": {"cpu": 150}}]}))
        for period, deadline, code, named in ((100_000, 40_000, 1, ["spiky"]), (100_000, 90_000, 0, []), (25_000, 40_000, 1, None)):
            app.write_text(json.dumps({"schema": "xauto.app", "version": 3, "name": "a", "edges": [],
                "sources": [{"name": "s", "period_us": period}],
                "chains": [{"name": "c", "from": "s", "to": "spiky", "deadline_us": deadline}], "xnodes": [
                {"name": "spiky", "module": "m", "source": "s", "wcet_us": {"cpu": 32000}, "typical_us": {"cpu": 600}},
                {"name": "calm", "module": "n", "source": "s", "wcet_us": {"cpu": 900}, "typical_us": {"cpu": 500}}]}))
            done = xauto("solve", "--app", app, "--platform", "small", "--scenarios", scenarios, "--tables", 2,
                         "--time-limit", "0.5s")
            self.assertEqual(done.returncode, code, done.stdout + done.stderr)
            self.assertEqual("usually 0.600 ms" in done.stdout + done.stderr, named != [], done.stdout + done.stderr)
            if named is not None:
                told = json.loads(xauto("solve", "--app", app, "--platform", "small", "--scenarios", scenarios, "--tables",
                                        2, "--time-limit", "0.5s", "--json").stdout)
                self.assertEqual([r["xnode"] for r in told.get("rare_wcets", [])], named)

    def test_ctrl_c_on_40_xnodes_writes_the_best_so_far(self):
        app = self.app(40, 5)  # not proven within half a minute
        code, out, err, policy, memory = self.solve(app, "--time-limit", "600s",
                                                    interrupt_when=lambda err: err.count("best ") >= 2)
        self.assertEqual(code, 0, err)
        self.assertIn("interrupted: best so far", out)
        lines = re.findall(r"best ([\d.]+) ms +bound ([\d.]+) ms +gap ([\d.]+) %.*evaluations/s", err)
        self.assertGreaterEqual(len(lines), 2, err)
        for best, bound, gap in lines:
            self.assertLessEqual(float(bound), float(best))
            self.assertAlmostEqual(float(gap), 100 * (1 - float(bound) / float(best)), delta=0.02)
        self.assertLessEqual(self.longest(policy), float(lines[-1][0]) * 1000 + 5)
        self.assertLess(memory, MOST_KIB)
        self.check(app)

    def test_40_xnodes_to_the_time_limit_stay_small(self):
        app = self.app(40)
        code, _, err, _, memory = self.solve(app, "--time-limit", "2s", "--threads", 4)
        self.assertEqual(code, 0, err)
        self.assertLess(memory, MOST_KIB)
        self.check(app)

    def test_ilp_takes_a_time_limit_and_ctrl_c(self):
        heft = json.loads(xauto("solve", "--app", self.app(14, 20), "--platform", "small", "--method", "heft",
                                "--json").stdout)
        def within(_):  # its search, which says nothing of itself
            time.sleep(1)
            return True
        for arguments, interrupt in ((("--time-limit", "1s"), None), (("--time-limit", "600s"), within)):
            app = self.app(14, 20)
            code, out, err, policy, memory = self.solve(app, "--method", "ilp", *arguments, interrupt_when=interrupt)
            self.assertEqual(code, 0, err)
            self.assertIn(policy["method"], ("ilp", "auto"))  # what the model leaves open others go on with
            self.assertRegex(out, r"the paper's model( is open after| has nothing shorter|, which)" if interrupt is None
                             else "the paper's model is open after")
            self.assertGreater(self.longest(policy), 0.7 * heft["release_us"])  # in its order
            self.assertLess(memory, MOST_KIB)
            self.check(app)

    def test_check_knows_what_was_asked_for(self):
        app = self.app(12, 4)
        spec = json.loads(app.read_text())
        first, second = spec["xnodes"][0]["name"], spec["xnodes"][1]["name"]
        asked = ["--pin", f"{first}=cpu3", "--group", f"{first},{second}"]
        code, out, err, policy, _ = self.solve(app, "--json", "--time-limit", "2s", *asked)
        self.assertEqual(code, 0, err)
        def checked(*arguments):
            return xauto("check", "--app", app, "--platform", "small", "--policy", self.at / "policy.json", *arguments)

        self.assertEqual(checked(*asked).returncode, 0, checked(*asked).stdout)
        other = checked("--pin", f"{first}=cpu2")
        self.assertEqual(other.returncode, 1)
        self.assertIn(f"MISSED XNode '{first}' runs on cpu3, pinned to cpu2", other.stdout)
        self.assertRegex(other.stdout.splitlines()[-1], "^But it misses what was asked for, so the exit status is 1: XNode ")
        # The same in app.json: solve and check read it from there.
        spec["pins"] = [{"xnode": first, "xpu": "cpu3"}]
        app.write_text(json.dumps(spec))
        code, _, err, policy, _ = self.solve(app)
        self.assertEqual(code, 0, err)
        self.assertEqual(checked().returncode, 0, checked().stdout)

    # 5 000 XNodes. Seconds of CPU, which a busy machine does not lengthen; reading
    # and writing the files are in them, which the limit is not about: hence twice the rule, and two seconds.
    def huge(self):
        path = self.at / "huge.json"
        if not path.exists():
            xnodes = [{"name": f"x{i}", "module": f"m{i}",
                       "wcet_us": {"cpu": 100 + i * 7919 % 800, "gpu": 50 + i * 104729 % 300}} for i in range(5000)]
            edges = [[f"x{i - 500 + k * 7}", f"x{i}"] for i in range(500, 5000) for k in range(3)]
            path.write_text(json.dumps(sourced({"name": "huge", "xnodes": xnodes, "edges": edges}, "s")))
        return path

    def test_the_largest_app_keeps_the_time_limit(self):
        limit = f"{5 * stretch():.1f}s"
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        code, _, err, policy, _ = self.solve(self.huge(), "--time-limit", limit, "--threads", 1)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.assertEqual(code, 0, err)
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        self.assertLess(used, SLACK * (2 * (5 * 1.3 + 1) + 2))
        self.assertTrue(policy["chains"])
        checked = xauto("check", "--app", self.huge(), "--platform", "small", "--policy", self.at / "policy.json")
        self.assertEqual(checked.returncode, 0, checked.stdout + checked.stderr)
        checking = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.assertLess(checking.ru_utime - after.ru_utime, SLACK * 30)

    def test_ctrl_c_on_the_largest_app_writes_the_best_so_far(self):
        policy = self.at / "policy.json"
        process = subprocess.Popen([XAUTO, "solve", "--app", self.huge(), "--platform", "small", "--threads", "1",
                                    "--out", policy, "--time-limit", "600s"],
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addCleanup(process.stdout.close)
        self.addCleanup(process.stderr.close)
        self.assertIn("best", process.stderr.readline())  # the first answer is there, the search goes on
        used = cpu_seconds(process.pid)
        process.send_signal(signal.SIGTERM)
        _, _, usage = os.wait4(process.pid, 0)
        process.returncode = 0
        self.assertIn("interrupted: best so far", process.stdout.read())
        self.assertLess(usage.ru_utime + usage.ru_stime - used, SLACK * 2)
        self.assertEqual(len(json.loads(policy.read_text())["xnodes"]), 5000)


def stretch():
    """For how long one second of CPU time takes now, beside what else this machine does: at most 2.5, for it may end."""
    began, used = time.monotonic(), time.process_time()
    while time.process_time() - used < 0.3:
        pass
    return min(2.5, max(1, (time.monotonic() - began) / 0.3))


def catches_sigint(pid):
    caught = re.search(r"SigCgt:\t(\w+)", pathlib.Path(f"/proc/{pid}/status").read_text())
    return caught and int(caught.group(1), 16) >> (signal.SIGINT - 1) & 1


def ended(pid):
    return pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"


def cpu_seconds(pid):
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    unittest.main()
