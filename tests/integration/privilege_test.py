# SPDX-License-Identifier: Apache-2.0
"""What a run is without root: its threads have the real-time priorities that the kernel's limit leaves them, it says
what it lacks, and another user reaches nothing of it. Needs root, to become somebody else. To give a limit takes
CAP_SYS_RESOURCE as well, which root in a container seldom has: tests/kselftest/scx/tools.sh does it in a VM, too."""
import json
import os
import pathlib
import resource
import shutil
import signal
import socket
import stat
import subprocess
import tempfile
import time
import unittest

import common

NOBODY = 65534


class Privilege(unittest.TestCase):
    def setUp(self):
        if os.geteuid() != 0:
            self.skipTest("needs root")
        # Where somebody else may read them.
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="xauto-privilege-", dir="/var/tmp"))
        self.addCleanup(shutil.rmtree, self.folder)
        for program in ("xauto", "xauto-coordinator", "xauto-emud", "testapp"):
            shutil.copy(common.BIN / program, self.folder)
        self.arguments = common.testapp_files(self.folder, period_us=20_000)
        for file in self.folder.glob("*.json"):
            file.chmod(0o644)
        self.folder.chmod(0o777)

    def start(self, *words, limit=0):
        """A program of the folder as nobody, without any right but that to priorities up to `limit`."""
        def become():
            resource.setrlimit(resource.RLIMIT_RTPRIO, (limit, limit))
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
        process = subprocess.Popen([str(self.folder / words[0]), *words[1:]], preexec_fn=become, cwd=self.folder,
                                   text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self.addCleanup(process.communicate)
        self.addCleanup(process.kill)  # before that
        return process

    def end(self, process):
        out, err = process.communicate(timeout=60)
        self.assertEqual(process.returncode, 0, err)
        return out, err

    def run_app(self, *options, **more):
        return self.start("xauto", "run", *self.arguments, "--overload", "queue:256", *options, "--",
                          str(self.folder / "testapp"), str(self.folder / "results"), **more)

    def realtime(self, **more):
        """What doctor says of it."""
        out, _ = self.end(self.start("xauto", "doctor", "--json", **more))
        return next(f for f in json.loads(out)["findings"] if f["id"] == "realtime")

    def wait_for_app(self, process):
        """Its hub, once it releases: then all threads and processes of the run are there."""
        until = time.monotonic() + 60
        while time.monotonic() < until:
            for pid in [pid for pid, name in common.children_of(process.pid).items() if name == "testapp"]:
                for task in pathlib.Path(f"/proc/{pid}/task").glob("*/comm"):
                    try:
                        if task.read_text() == "xauto/sources\n":
                            return pid
                    except OSError:
                        continue  # it has just ended
            if process.poll() is not None:
                self.fail(f"the run ended: {process.communicate()}")
            time.sleep(0.05)
        self.fail("the app did not start")

    def priorities(self, *pids):
        """Of their SCHED_FIFO threads."""
        found = []
        for pid in pids:
            for task in pathlib.Path(f"/proc/{pid}/task").iterdir():
                if os.sched_getscheduler(int(task.name)) == os.SCHED_FIFO:
                    found.append(os.sched_getparam(int(task.name)).sched_priority)
        return found

    def test_without_the_right_one_line_says_how_to_get_it(self):
        found = self.realtime()
        self.assertEqual((found["state"], found["found"]), ("degraded", "SCHED_FIFO refused, rtprio limit 0"))
        for words in ("'@GROUP - rtprio 60' into /etc/security/limits.d/xauto.conf", "LimitRTPRIO=60"):
            self.assertIn(words, found["advice"])
        _, err = self.end(self.run_app("--activations", "3", "--out", "report.json"))
        said = [line for line in err.splitlines() if "no permission for SCHED_FIFO" in line]
        self.assertEqual(len(said), 1, err)
        self.assertIn("/etc/security/limits.d/xauto.conf", said[0])
        self.assertIn("no permission for SCHED_FIFO", (self.folder / "report.json").read_text())

    def test_smaller_limit_presses_the_priorities_together(self):
        """From the top: coordinators 8, management 7, sources 6, other XPUs 5, and 2 to 4 are the CPU XNodes'."""
        try:
            process = self.run_app("--activations", "0", "--out", "report.json", limit=8)
        except subprocess.SubprocessError:
            self.skipTest("no CAP_SYS_RESOURCE, so no limit can be given")
        app = self.wait_for_app(process)
        children = common.children_of(process.pid)
        coordinators = [pid for pid, name in children.items() if name.startswith("xauto-coord")]
        of_app, of_coordinators = self.priorities(app), self.priorities(*coordinators)
        limit = resource.prlimit(app, resource.RLIMIT_RTPRIO)
        process.send_signal(signal.SIGTERM)
        _, err = self.end(process)
        said = "SCHED_FIFO is permitted up to 8, not 60: XNodes on CPUs use 2 to 4"
        self.assertEqual(err.count(said), 1, err)
        self.assertIn(said, (self.folder / "report.json").read_text())
        self.assertEqual(limit, (8, 8))
        self.assertEqual(set(of_coordinators), {8})
        self.assertEqual(max(of_app), 7)
        self.assertLessEqual({6, 5}, set(of_app))
        self.assertGreaterEqual(min(of_app), 2)
        self.assertEqual(self.realtime(limit=8)["found"], "SCHED_FIFO permitted up to 8")

    def test_tool_and_app_have_no_capability(self):
        process = self.run_app("--activations", "0")
        for pid in (process.pid, self.wait_for_app(process), *common.children_of(process.pid)):
            status = pathlib.Path(f"/proc/{pid}/status").read_text()
            for kind in ("CapPrm", "CapEff", "CapInh", "CapAmb"):
                self.assertRegex(status, rf"{kind}:\t0+\n")
            self.assertRegex(status, rf"Uid:\t{NOBODY}\t{NOBODY}\t{NOBODY}\t{NOBODY}\n")
        process.send_signal(signal.SIGTERM)
        self.end(process)

    def test_another_user_reaches_nothing_of_a_run(self):
        """Not its sockets, not the memory behind its descriptors, not its processes; and it is not disturbed."""
        process = self.run_app("--activations", "0", "--isolate")
        self.wait_for_app(process)
        family = [process.pid, *common.children_of(process.pid)]
        open_to_all, seen = set(), set()
        for pid in family:
            for fd in pathlib.Path(f"/proc/{pid}/fd").iterdir():
                try:
                    status, name = fd.stat(), os.readlink(fd)
                except OSError:
                    continue  # closed meanwhile
                if stat.S_ISREG(status.st_mode):
                    seen.add(name)
                    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                        open_to_all.add(name)
        self.assertGreater(len(seen), 4, "memory of the run")
        self.assertFalse(open_to_all)
        prefix = f"@xauto/{process.pid}-"
        names = [line.split()[-1] for line in pathlib.Path("/proc/net/unix").read_text().splitlines()]
        addresses = sorted({name for name in names if name.startswith(prefix)})
        self.assertGreaterEqual(len(addresses), 3, f"two coordinators and the emulator: {addresses}")
        report, told = os.pipe()
        stranger = os.fork()
        if stranger == 0:
            try:
                os.setgroups([])
                os.setgid(NOBODY - 1)
                os.setuid(NOBODY - 1)
                os.write(told, "; ".join(["tried", *self.attack(family, addresses)]).encode())
            finally:
                os._exit(0)
        os.close(told)
        os.waitpid(stranger, 0)
        self.assertEqual(os.read(report, 65536).decode(), "tried")
        os.close(report)
        process.send_signal(signal.SIGTERM)
        self.end(process)

    def attack(self, family, addresses):
        """What succeeds of it."""
        done = []
        for address in addresses:
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as peer:
                peer.settimeout(10)
                try:
                    peer.connect("\0" + address[1:])
                except ConnectionRefusedError:
                    assert "/real:" in address, address  # a name that takes nobody in
                    continue
                for packet in (b"\x04\0\0\0", b"\x01\0\0\0\x02\0\0\0" + bytes(1096), os.urandom(500)):
                    try:
                        peer.send(packet)
                        if peer.recv(65536):
                            done.append(f"answer from {address}")
                    except ConnectionError:
                        pass
        for pid in family:
            for attempt in (lambda p: os.listdir(f"/proc/{p}/fd"), lambda p: os.kill(p, 0),
                            lambda p: open(f"/proc/{p}/mem", "rb"), lambda p: open(f"/proc/{p}/environ", "rb").read(),
                            lambda p: os.sched_setscheduler(p, os.SCHED_BATCH, os.sched_param(0))):
                try:
                    attempt(pid)
                    done.append(f"process {pid}")
                except PermissionError:
                    pass
        return done


if __name__ == "__main__":
    unittest.main()
