# SPDX-License-Identifier: Apache-2.0
"""What another user can do to a run from outside: nothing. Strangers knock at its sockets, take names, listen at names
of runs and say nothing, or say what paints a terminal; and nobody reads what the run says of it. Needs root, to become
somebody else. Where a limit were missing, these tests would not end: ctest's time is the net."""
import ctypes
import json
import os
import pathlib
import pwd
import resource
import signal
import socket
import subprocess
import tempfile
import time
import traceback
import unittest

from common import QUEUES, TESTAPP, XAUTO, activations, children_of, testapp_files, wait_for

NOBODY = 65534
LIMIT = 100  # seconds: of what used to take for ever


def run_names():
    """Addresses below xauto/ at which somebody listens."""
    lines = (line.split() for line in pathlib.Path("/proc/net/unix").read_text(errors="replace").splitlines())
    return {words[7][1:] for words in lines if len(words) == 8 and words[7].startswith("@xauto/") and words[3] == "00010000"}


def seqpacket():
    return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def listen(name, backlog=128):
    listener = seqpacket()
    listener.bind("\0" + name)
    listener.listen(backlog)
    return listener


class Strangers(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.files = testapp_files(self.folder, QUEUES, period_us=20_000)

    def stranger(self, act):
        """Another user's process that calls `act(ready)`, until the test ends. Returns once it has called `ready`."""
        if os.geteuid() != 0:
            self.skipTest("needs root, to become somebody else")
        ours, theirs = os.pipe()
        pid = os.fork()
        if pid == 0:
            try:
                ctypes.CDLL(None).prctl(1, signal.SIGKILL)
                resource.setrlimit(resource.RLIMIT_NOFILE, (4096, 4096))
                os.setgroups([])
                os.setresgid(NOBODY, NOBODY, NOBODY)
                os.setresuid(NOBODY, NOBODY, NOBODY)
                act(lambda: os.write(theirs, b"ready"))
                while True:
                    signal.pause()
            except BaseException:  # pylint: disable=broad-except
                traceback.print_exc()
            os._exit(1)

        def end():
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        self.addCleanup(end)
        os.close(theirs)
        self.assertEqual(os.read(ours, 5), b"ready", "the stranger could not act")
        os.close(ours)
        return pid

    def start(self, *options, activations=0, stderr=subprocess.PIPE, **more):
        """A run, until it is told to end."""
        tool = subprocess.Popen([XAUTO, "run", *self.files, "--activations", str(activations), "--out", os.path.join(self.folder, "report.json"), *options,
                                 "--", TESTAPP, os.path.join(self.folder, "result"),
                                 *(["emulated", "1000"] if "--emulate" in options else [])],
                                stdout=subprocess.DEVNULL, stderr=stderr, **more)
        self.addCleanup(lambda: (tool.kill(), tool.communicate()))
        return tool

    def run_of(self, tool, *names):
        """Where these sockets of the run listen, once they do."""
        def addresses():
            own = {name.rsplit("/", 1)[1]: name for name in run_names() if name.startswith(f"xauto/{tool.pid}-")}
            return all(name in own for name in names) and own
        return wait_for("the run's sockets", addresses, tool)

    def wait_for_more_activations(self, tool, more=50):
        first = sum(activations(tool).values())
        wait_for("activations", lambda: sum(activations(tool).values()) >= first + more, tool, LIMIT)

    def report(self):
        return json.loads(pathlib.Path(self.folder, "report.json").read_text())

    def end(self, tool):
        tool.send_signal(signal.SIGTERM)
        _, err = tool.communicate(timeout=LIMIT)
        self.assertEqual(tool.returncode, 0, err)

    # ---- logs ----

    def test_a_run_ends_though_nobody_reads_its_log_and_strangers_fill_it(self):
        unread, full = os.pipe()
        self.addCleanup(os.close, unread)
        os.set_blocking(full, False)
        junk = 0
        try:
            while True:
                junk += os.write(full, b"." * 1024)
        except BlockingIOError:
            pass
        os.set_blocking(full, True)  # the run's children have this open file as well
        tool = self.start("--isolate", "--emulate", stderr=full, env={**os.environ, "XAUTO_LOG": "debug"})
        os.close(full)
        addresses = list(self.run_of(tool, "cpu0", "npu0", "live", "desk", "hub", "emud").values())

        def knock(ready):
            told = False
            while True:
                for address in addresses:
                    with seqpacket() as peer:
                        try:
                            peer.setblocking(False)
                            peer.connect("\0" + address)
                        except OSError:
                            continue
                if not told:
                    told = bool(ready())
        self.stranger(knock)
        # Releases go on, each of which the whole run takes part in.
        self.wait_for_more_activations(tool)
        tool.send_signal(signal.SIGTERM)
        self.assertEqual(tool.wait(LIMIT), 0)
        self.assertTrue(self.report()["runs"][0]["complete"])
        # Once somebody reads there is room again, but nobody is left who would have waited for it.
        os.set_blocking(unread, False)
        heard = b""
        while True:
            try:
                got = os.read(unread, 65536)
            except BlockingIOError:
                break
            if not got:
                break
            heard += got
        self.assertGreaterEqual(len(heard), junk)

    def test_refusals_are_a_line_a_second_and_counted(self):
        log = os.path.join(self.folder, "log")
        with open(log, "wb") as file:
            tool = self.start(stderr=file)
        address = self.run_of(tool, "cpu0")["cpu0"]
        began = time.monotonic()

        def knock(ready):
            for _ in range(3000):
                with seqpacket() as peer:
                    peer.connect("\0" + address)
            ready()
        self.stranger(knock)
        # The last ones are told when the coordinator ends.
        self.end(tool)
        took = time.monotonic() - began
        lines = [line for line in pathlib.Path(log).read_text().splitlines() if "cpu0" in line and "refused" in line]
        self.assertGreaterEqual(len(lines), 2)
        self.assertLessEqual(len(lines), took + 2)
        counted = [int(line.rsplit("; ", 1)[1].split()[0]) for line in lines if "more since" in line]
        last = [int(line.split("cpu0: ", 1)[1].split()[0]) for line in lines if "more refused" in line]
        first = [line for line in lines if f"refused a connection of uid {NOBODY}" in line]
        self.assertEqual(len(first) + sum(counted) + sum(last), 3000, lines)

    # ---- names ----

    def test_names_cannot_be_taken_in_advance(self):
        def squat(ready):
            kept = []
            for pid in range(os.getpid(), os.getpid() + 600):  # the run's is one of the next ones
                for name in ("emud", "cpu0", "npu0", "live", "desk", "hub"):
                    kept.append(seqpacket())
                    kept[-1].bind(f"\0xauto/{pid}-0/{name}")
            ready()
        self.stranger(squat)
        tool = self.start(activations=3)
        _, err = tool.communicate(timeout=LIMIT)
        self.assertEqual(tool.returncode, 0, err)

    def test_nor_when_the_first_of_them_is_seen(self):
        """Who is quick takes what is still free of a run's names; then the run listens elsewhere."""
        def squat(ready):
            ready()
            kept = {}
            while True:
                for address in run_names():
                    base = address.rsplit("/", 1)[0]
                    if base in kept:
                        continue
                    kept[base] = [seqpacket() for _ in range(4)]
                    for peer, name in zip(kept[base], ("cpu0", "npu0", "emud", "live")):
                        try:
                            peer.bind(f"\0{base}/{name}")
                        except OSError:
                            pass
        self.stranger(squat)
        for _ in range(3):
            tool = self.start(activations=3)
            _, err = tool.communicate(timeout=LIMIT)
            self.assertEqual(tool.returncode, 0, err)

    # ---- those who ask and do not read ----

    def test_who_asks_and_does_not_read_kills_no_coordinator(self):
        tool = self.start()
        addresses = self.run_of(tool, "cpu0", "npu0", "desk", "live")
        self.wait_for_more_activations(tool, 4)  # everybody is there
        before = children_of(tool.pid)
        peers = []
        for name, packet in (("cpu0", b"\x04\0\0\0"), ("npu0", b"\x05\0\0\0"), ("desk", b"{}"), ("live", b"?")):
            for _ in range(3):
                peers.append(seqpacket())
                peers[-1].connect("\0" + addresses[name])
                peers[-1].setblocking(False)
                try:
                    for _ in range(1000):
                        peers[-1].send(packet)
                except OSError:
                    pass  # full, or cut off
        for name in ("cpu0", "npu0"):  # answers come after all of that was heard
            with seqpacket() as asks:
                asks.settimeout(LIMIT)
                asks.connect("\0" + addresses[name])
                asks.send(b"\x04\0\0\0")
                self.assertEqual(json.loads(asks.recv(65536))["xpu"], name)
        self.assertEqual(children_of(tool.pid), before)
        self.end(tool)
        self.assertTrue(self.report()["runs"][0]["complete"])

    # ---- those who listen ----

    def fakes(self, tool):
        """Names of runs at which a stranger listens: silent, with a full queue, talkative, of other pids."""
        def act(ready):
            me, kept = os.getpid(), []
            for number in range(300):
                kept.append(listen(f"xauto/{me}-{number}/0123456789abcdef/{('live', 'cpu0')[number % 2]}"))
            for number, pid in enumerate((tool.pid, os.getppid(), 1, me)):
                for name in ("live", "cpu0", "desk"):
                    kept.append(listen(f"xauto/{pid}-{10 * me + number}/{name}"))
                    kept.append(listen(f"xauto/{tool.pid}-0/{me}-{number}/{name}"))
            for number in range(20):  # full: who connects waits
                name = f"xauto/{me}-{2000 + number}/{('live', 'cpu0')[number % 2]}"
                kept.append(listen(name, 0))
                for _ in range(3):
                    kept.append(seqpacket())
                    kept[-1].setblocking(False)
                    kept[-1].connect_ex("\0" + name)
            kept.append(listen(f"xauto/{me}-3000/\x1b[31m/live"))
            kept.append(listen(f"xauto/\x1b[31m{me}-0/live"))
            painter, runs = listen(f"xauto/{me}-4000/cpu0"), listen(f"xauto/{me}-4000/live")
            ready()
            text = json.dumps({"xpu": "\x1b[31mcpu0\nrun 1-0", "pid": 1, "discipline": "preemptive", "arbitrated": False,
                               "looks": 1, "decisions": 1, "app": "\x1b]0;title\x07", "platform": "\x9b31m",
                               "workers": [{"worker": "\x1b[2J", "state": "idle"}]}).encode()
            while True:
                for listener in (painter, runs):
                    listener.settimeout(0.05)
                    try:
                        peer, _ = listener.accept()
                        peer.send(text)
                        kept.append(peer)
                    except OSError:
                        pass
        return self.stranger(act)

    def ask(self, *words):
        done = subprocess.run([XAUTO, *map(str, words)], capture_output=True, timeout=LIMIT)
        for out in (done.stdout, done.stderr):
            for byte in (b"\x1b", b"\x07", b"\x9b"):
                self.assertNotIn(byte, out, words)
        return done.returncode, done.stdout.decode(), done.stderr.decode()

    def test_silent_strangers_keep_nobody_from_looking_at_a_run(self):
        tool = self.start("--isolate")
        self.run_of(tool, "cpu0", "npu0", "live", "desk")
        run = f"{tool.pid}-0"
        wait_for("the run", lambda: self.ask("top", "--run", run, "--once", "--interval", "50ms")[0] == 0, tool)
        fake = self.fakes(tool)
        status, out, err = self.ask("top", "--once")
        self.assertEqual(status, 0, err)
        self.assertIn(f"run {run}: testapp on test", out)
        for line in out.splitlines():  # of the stranger's runs it is said whose they are
            if line.startswith(f"run {fake}-"):
                self.assertTrue(line.endswith(" of nobody"), line)
            elif line.startswith("run "):
                self.assertFalse(line.startswith("run 1-"), line)
        runs = {one["run"]: one for one in json.loads(self.ask("top", "--once", "--json")[1])["runs"]}
        self.assertEqual({xpu["xpu"] for xpu in runs[run]["xpus"]}, {"cpu0", "npu0"})
        self.assertEqual({one["user"] for name, one in runs.items() if name.startswith(f"{fake}-")} - {"nobody"}, set())
        self.assertEqual(runs[run]["user"], pwd.getpwuid(os.geteuid()).pw_name)
        # The only run of this user's is meant, whoever else says to have one. Other tests may run beside this one.
        others = [name for name in runs if not name.startswith(f"{fake}-") and name != run]
        for words in (["top", "--count", 2, "--interval", "50ms"], ["param"], ["monitor", "--interval", "50ms"]):
            named = words if not others or words[0] == "monitor" else [*words, "--run", run]
            _, out, err = self.ask(*named)
            self.assertNotIn(f" {fake}-", err)
            self.assertNotIn("no run", err)
            if words[0] in ("top", "monitor") and "several runs" not in err:  # another test's has begun
                self.assertIn(run, out)
        status, out, err = self.ask("top", "--run", f"{fake}-0")
        self.assertNotEqual(status, 0, out)
        self.end(tool)

    def test_the_exporter_goes_on_whoever_is_silent(self):
        tool = self.start()
        self.run_of(tool, "cpu0", "npu0", "live")
        self.fakes(tool)
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        file = pathlib.Path(folder.name, "m.prom")
        monitor = subprocess.Popen([XAUTO, "monitor", "--metrics-file", file], stderr=subprocess.PIPE, text=True)
        self.addCleanup(lambda: (monitor.kill(), monitor.communicate()))
        wait_for("the run's metrics", lambda: file.exists() and f'run="{tool.pid}-0"' in file.read_text(), monitor, LIMIT)
        looks = set()
        wait_for("further looks", lambda: looks.add(file.stat().st_ino) or len(looks) > 3, monitor, LIMIT)
        self.assertNotIn("\x1b", file.read_text())
        self.end(tool)


if __name__ == "__main__":
    unittest.main()
