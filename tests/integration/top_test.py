#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""`xauto top` without BPF, and the progress line of a run."""
import json
import os
import pathlib
import pty
import re
import signal
import socket
import subprocess
import tempfile
import threading
import time
import unittest

from common import TESTAPP, XAUTO, activations, children_of, testapp_files, wait_for, xauto


def screen(data):
    """The lines that a terminal shows after this output."""
    lines, column = [[]], 0
    for token in re.findall(r"\x1b\[[0-9;]*[A-Za-z]|[^\x1b]", data):
        if token == "\r":
            column = 0
        elif token == "\n":
            lines.append([])
        elif token == "\x1b[K":
            del lines[-1][column:]
        elif not token.startswith("\x1b"):
            lines[-1] += " " * (column - len(lines[-1]))
            lines[-1][column:column + 1] = token
            column += 1
    return ["".join(line) for line in lines]


class Top(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def start(self, *app, files=None, **keywords):
        files = files or testapp_files(self.folder, period_us=20_000)
        tool = subprocess.Popen([XAUTO, "run", *files, "--activations", "0", "--overload", "queue:256",
                                 "--out", os.path.join(self.folder, "r.json"), "--", TESTAPP,
                                 os.path.join(self.folder, "result"), *map(str, app)],
                                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **keywords)
        self.addCleanup(self.end, tool)
        return tool

    @staticmethod
    def end(tool):
        if tool.poll() is None:
            tool.terminate()
        _, err = tool.communicate(timeout=60)
        return err

    def look(self, tool, *options):
        done = xauto("top", "--run", f"{tool.pid}-0", "--wait", "30s", "--json", *options)
        self.assertEqual(done.returncode, 0, done.stderr)
        return [json.loads(line)["runs"][0] for line in done.stdout.splitlines()]

    def test_counts_are_those_of_the_report(self):
        tool = self.start("throw", "A", 5, files=testapp_files(self.folder, period_us=20_000, deadline_us=1))
        wait_for("the activation that fails", lambda: activations(tool).get("C", 0) > 8, tool)
        first, second = self.look(tool, "--count", 2, "--interval", "1s")
        self.assertEqual(first["app"], "testapp")
        err = self.end(tool)
        with open(os.path.join(self.folder, "r.json")) as file:
            report = json.load(file)["runs"][0]
        chains = {c["name"]: c for c in report["chains"]}
        self.assertEqual({c["name"] for c in second["chains"]}, set(chains), err)
        for chain in second["chains"]:
            of_run = chains[chain["name"]]
            before = next(c for c in first["chains"] if c["name"] == chain["name"])
            self.assertGreater(chain["results"], before["results"])
            self.assertLessEqual(chain["results"], of_run["results"])
            self.assertAlmostEqual(chain["rate_hz"], (chain["results"] - before["results"]) * 1_000_000 / second["interval_us"],
                                   delta=1)
            # All results are later than 1 us, and so is what was lost. (They are read while they grow.)
            self.assertLessEqual(before["results"], chain["deadline_misses"])
            self.assertLessEqual(chain["deadline_misses"], report["activations"] + report["lost_activations"])
            self.assertLessEqual(chain["p50_us"], of_run["latency_us"]["max"] * 65 / 64 + 1)
            if chain["results"] - before["results"] >= 100:
                self.assertLessEqual(chain["p50_us"], chain["p99_us"])
            else:
                self.assertIsNone(chain["p99_us"])
            self.assertGreater(chain["age_us"], 0)
        failed = {m["name"]: m["failed"] for m in second["modules"]}
        self.assertEqual(failed, {"A": 1, "B": 0, "C": 0, "D": 0})
        self.assertEqual({m["name"]: m["failed"] for m in report["modules"]}, failed)

    def test_who_runs_and_who_waits(self):
        # b1 sleeps on the npu, and a2 of that release or the next waits for it, or is below it.
        tool = self.start("hang", "B", 5, 20000)
        seen = {}

        def runs():
            seen.update({x["xpu"]: x for x in self.look(tool, "--once", "--interval", "50ms")[0]["xpus"]})
            return [w["xnode"] for w in seen["npu0"]["workers"] if w["state"] == "running"] == ["b1"]
        wait_for("b1 on the npu", runs, tool)
        self.assertEqual(set(seen), {"cpu0", "npu0"})
        tool.kill()

    def test_a_pipe_gets_one_look_in_words(self):
        tool = self.start()
        done = xauto("top", "--run", f"{tool.pid}-0", "--wait", "30s", "--interval", "500ms")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(done.stdout.count("testapp on test"), 1)
        self.assertIn("src -> c1", done.stdout)
        self.assertNotIn("\x1b", done.stdout)
        all_runs = xauto("top", "--once", "--interval", "50ms")
        mine = all_runs.stdout[all_runs.stdout.index(f"run {tool.pid}-0: testapp on test"):].split("\nrun ")[0]
        for said in ("src -> c1", r"npu0 +gate, .*; coordinator pid \d+, \d+ decisions", r"\n    B@npu0 +\w"):
            self.assertRegex(mine, said)
        self.assertEqual(xauto("top", "--list").returncode, 2)

    @unittest.skipIf(os.geteuid() != 0, "it takes two users")
    def test_a_run_of_another_user_is_said_to_be_theirs(self):
        run = f"{os.getpid()}-78"
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.addCleanup(listener.close)
        listener.bind(f"\0xauto/{run}/live")
        listener.listen()
        nobody = {"user": 65534, "capture_output": True, "text": True, "timeout": 60}
        for words in ([], ["--json"]):
            self.assertNotIn(run, subprocess.run([XAUTO, "top", "--once", *words], **nobody).stdout)
        done = subprocess.run([XAUTO, "top", "--run", run], **nobody)
        self.assertNotEqual(done.returncode, 0)
        self.assertIn(f"run '{run}' is of root", done.stderr)

    def test_isolated_modules_are_counted_too(self):
        tool = self.start(files=[*testapp_files(self.folder, period_us=20_000), "--isolate"])
        seen = {}

        def counts():
            seen.update(self.look(tool, "--once", "--interval", "50ms")[0])
            return all(m["activations"] > 0 for m in seen["modules"]) and all(c["results"] > 0 for c in seen["chains"])
        wait_for("counts of every module and chain", counts, tool)
        self.assertEqual([m["name"] for m in seen["modules"]], ["A", "B", "C", "D"])
        self.assertFalse(any(m["deaths"] for m in seen["modules"]))
        os.kill(min(pid for pid in children_of(tool.pid) if self.is_member(pid)), signal.SIGKILL)

        def died():
            seen.update(self.look(tool, "--once", "--interval", "50ms")[0])
            return any(m["deaths"] for m in seen["modules"])
        wait_for("the death of a module's process", died, tool)
        self.assertEqual([m["deaths"] for m in seen["modules"] if m["deaths"]], [1])
        words = xauto("top", "--run", f"{tool.pid}-0", "--once", "--interval", "50ms").stdout
        self.assertEqual(words.count("  died: 1"), 1, words)

    def test_without_a_run_it_says_so(self):
        done = xauto("top", "--run", "1-99")
        self.assertEqual(done.returncode, 2)
        self.assertIn("no run '1-99' is going on", done.stderr)

    def test_who_looks_late_gets_the_answer_of_one_who_has_hung_up(self):
        # A run introduces itself unasked and hangs up. Linux resets a connection that is closed with something unread in it
        # (unix_release_sock), and the other end's next read fails, whatever waits there: so who looks sends nothing.
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.addCleanup(listener.close)
        listener.bind(f"\0xauto/{os.getpid()}-77/live")
        listener.listen()
        board = os.memfd_create("no board")
        self.addCleanup(os.close, board)
        seen = []

        def introduce():
            peer, _ = listener.accept()
            time.sleep(0.2)  # a question would be there by now
            try:
                seen.append(peer.recv(64, socket.MSG_DONTWAIT))
            except BlockingIOError:
                seen.append(None)
            socket.send_fds(peer, [b"{}"], [board])
            peer.close()
        run = threading.Thread(target=introduce)
        run.start()
        done = xauto("top", "--run", f"{os.getpid()}-77", "--once")
        run.join(10)
        self.assertEqual(seen, [None])
        self.assertIn("the app has not started yet", done.stderr)  # what an empty board says

    @staticmethod
    def is_member(pid):
        return b"XAUTO_PROCESS=" in pathlib.Path(f"/proc/{pid}/environ").read_bytes()

    def test_progress_and_logs_do_not_run_into_each_other(self):
        files = testapp_files(self.folder, period_us=20_000)
        outer, inner = pty.openpty()
        tool = subprocess.Popen([XAUTO, "run", *files, "--activations", "6000", "--isolate", "--restarts", "5", "--", TESTAPP,
                                 os.path.join(self.folder, "result")], stdout=subprocess.DEVNULL, stderr=inner)
        os.close(inner)
        line = r"run policy \[#*\.*\] +\d+ %  \d+ s, \d+\.\d/s, p50 \d+\.\d\d ms"
        data, killed = b"", 0
        while True:
            try:
                got = os.read(outer, 4096)
            except OSError:
                break
            if not got:
                break
            data += got
            # After the line has appeared: logs of the tool, and of the app's hub.
            if killed < 2 and (b"% " if killed == 0 else b"was started again") in data:
                # A coordinator; then of the app a member, not the hub.
                os.kill(next(pid for pid, name in children_of(tool.pid).items()
                             if (name == "xauto-coordinat" if killed == 0 else self.is_member(pid))), signal.SIGKILL)
                killed += 1
            elif killed == 2 and b"the process of" in data and re.search(line.encode(), data.split(b"the process of")[-1]):
                tool.terminate()
                killed = 3
        tool.wait(timeout=60)
        os.close(outer)
        text = data.decode()
        self.assertEqual(killed, 3, text)
        shown = screen(text)
        for what in ("xauto-coordinator of", "the process of"):
            line = next((l for l in shown if what in l), None)
            self.assertIsNotNone(line, shown)
            self.assertRegex(line, r"^xauto: warning: ")
        for line in shown:
            self.assertFalse("xauto: " in line and "run policy [" in line, line)
            self.assertLessEqual(line.count("run policy ["), 1, line)


if __name__ == "__main__":
    unittest.main()
