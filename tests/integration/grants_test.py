# SPDX-License-Identifier: Apache-2.0
"""How xauto goes through xauto-grant and comes back: as the same process, with its arguments, environment, descriptors and
parent-death signal, whether or not anything is granted. That what is granted holds, and what is not does not, needs a machine whose root has
CAP_SYS_RESOURCE, and is tests/vm/run-grants. Needs root, to give the capability and to become somebody else."""
import ctypes
import json
import os
import pathlib
import random
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
PR_SET_PDEATHSIG, PR_SET_NO_NEW_PRIVS = 1, 38
# A v2 file capability: CAP_SYS_RESOURCE permitted, nothing inheritable, not effective. And CAP_SYS_NICE, which machines have that lack
# the other: kernel and loader then treat it as a program with rights, whose parent's death and whose environment they forget.
CAPABILITY = (0x02000000).to_bytes(4, "little") + (1 << 24 | 1 << 23).to_bytes(4, "little") + bytes(12)
libc = ctypes.CDLL(None, use_errno=True)


class Grants(unittest.TestCase):
    def setUp(self):
        if os.geteuid() != 0:
            self.skipTest("needs root")
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="xauto-grants-", dir="/var/tmp"))
        self.addCleanup(shutil.rmtree, self.folder)
        self.folder.chmod(0o755)
        for program in ("xauto", "xauto-grant", "xauto-coordinator", "xauto-emud", "driving"):
            shutil.copy(common.BIN / program, self.folder)
        self.helper = str(self.folder / "xauto-grant")
        try:
            os.setxattr(self.helper, "security.capability", CAPABILITY)
        except OSError as error:
            self.skipTest(f"no file capabilities here: {error}")

    def start(self, *words, prepare=None, env=None, **more):
        """A program of the folder as nobody, without any right."""
        def become():
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
            if prepare:
                prepare()
        out = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **more}
        return subprocess.Popen([str(self.folder / words[0]), *words[1:]], preexec_fn=become, cwd="/", text=True,
                                env=env or os.environ, **out)

    def end(self, process, limit=60):
        out, err = process.communicate(timeout=limit)
        return process.returncode, out, err

    def realtime(self, **more):
        status, out, err = self.end(self.start("xauto", "doctor", "--json", **more))
        self.assertEqual(status, 0, err)
        return next(f for f in json.loads(out)["findings"] if f["id"] == "realtime")

    def test_refusal_says_why(self):
        found = self.realtime()
        self.assertEqual(found["state"], "degraded")
        self.assertRegex(found["found"], "/etc/xauto|no right to raise limits")
        self.assertIn("/etc/xauto/grants.json", found["advice"])

    def test_without_the_capability_nobody_is_asked(self):
        os.removexattr(self.helper, "security.capability")
        os.remove(self.helper)
        os.symlink("/bin/false", self.helper)
        self.assertNotIn("grant", self.realtime()["found"])

    def test_helper_that_cannot_be_started_is_no_obstacle(self):
        os.truncate(self.helper, 0)
        os.setxattr(self.helper, "security.capability", CAPABILITY)
        self.assertIn("cannot start", self.realtime()["found"])

    def test_no_new_privileges_are_respected(self):
        found = self.realtime(prepare=lambda: libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0))
        self.assertIn("no right to raise limits", found["found"])

    def realtime_with(self, capability):
        words = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", f"--inh-caps=-all,+{capability}",
                 f"--ambient-caps=+{capability}", str(self.folder / "xauto"), "doctor", "--json"]
        said = subprocess.run(words, capture_output=True, text=True, timeout=60)
        self.assertEqual(said.returncode, 0, said.stderr)
        return next(f for f in json.loads(said.stdout)["findings"] if f["id"] == "realtime")["found"]

    def test_capabilities_of_its_own_are_kept(self):
        """Ambient ones, as a systemd unit gives them, would be lost on the way."""
        self.assertIn("has capabilities, which would be lost", self.realtime_with("net_raw"))

    def test_capability_of_every_login_is_no_obstacle(self):
        self.assertNotIn("has capabilities", self.realtime_with("wake_alarm"))

    def run_driving(self, *options, **more):
        policy = self.folder / "policy.json"
        shutil.copy(common.APP, self.folder / "app.json")
        solved = common.xauto("solve", "--app", common.APP, "--platform", "small", "--method", "heft", "--out", policy)
        self.assertEqual(solved.returncode, 0, solved.stderr)
        for file in (policy, self.folder / "app.json"):
            file.chmod(0o644)
        return self.start("xauto", "run", "--app", str(self.folder / "app.json"), "--platform", "small", "--emulate", "--policy",
                          str(policy), "--activations", "0", *options, "--", str(self.folder / "driving"), **more)

    def wait_for_app(self, process):
        """The process that has the sources, once it releases: then all threads and processes of the run are there."""
        until = time.monotonic() + 60
        while time.monotonic() < until:
            for pid in [pid for pid, name in common.children_of(process.pid).items() if name == "driving"]:
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

    def test_environment_and_arguments_come_through(self):
        env = {**os.environ, "LD_LIBRARY_PATH": "/kept", "TMPDIR": "/kept/too", "EMPTY": "", "XAUTO_GRANT_NOT": "x"}
        process = self.run_driving(env=env)
        try:
            app = self.wait_for_app(process)
            seen = dict(v.split("=", 1) for v in pathlib.Path(f"/proc/{app}/environ").read_text().split("\0") if "=" in v)
            for name in env:
                self.assertEqual(seen.get(name), env[name], name)
            self.assertNotIn("XAUTO_GRANT", seen)
            words = pathlib.Path(f"/proc/{process.pid}/cmdline").read_text().split("\0")
            self.assertEqual(words[:-1], process.args)
            links = [os.readlink(fd) for fd in pathlib.Path(f"/proc/{process.pid}/fd").iterdir()]
            self.assertFalse([link for link in links if "xauto-environment" in link], "left open")
            for pid in (process.pid, app):
                status = pathlib.Path(f"/proc/{pid}/status").read_text()
                for kind in ("CapPrm", "CapEff", "CapInh", "CapAmb"):
                    self.assertRegex(status, rf"{kind}:\t0+\n")
        finally:
            process.send_signal(signal.SIGTERM)
            status, _, err = self.end(process)
        self.assertEqual(status, 0, err)

    def test_another_user_reaches_nothing_of_a_run(self):
        """Not its sockets, not the memory and sessions behind its descriptors, not its processes; and it is not disturbed."""
        process = self.run_driving("--isolate")
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
        names = [line.split()[-1] for line in pathlib.Path("/proc/net/unix").read_text().splitlines() if prefix in line]
        addresses = sorted({name for name in names if name.startswith(prefix)})
        self.assertGreater(len(addresses), 5, "coordinators and the emulator")
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
        status, _, err = self.end(process)
        self.assertEqual(status, 0, err)

    def attack(self, family, addresses):
        """What succeeds of it."""
        done = []
        for address in addresses:
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as peer:
                peer.settimeout(10)
                peer.connect("\0" + address[1:])
                for packet in (b"\x04\0\0\0", b"\x01\0\0\0\x02\0\0\0" + bytes(1096), os.urandom(500)):
                    try:
                        peer.send(packet)
                        if peer.recv(65536):
                            done.append(f"answer from {address}")
                    except ConnectionError:
                        pass
        for pid in family:
            for attempt in (lambda p: os.listdir(f"/proc/{p}/fd"), lambda p: os.kill(p, 0), lambda p: open(f"/proc/{p}/mem", "rb"),
                            lambda p: open(f"/proc/{p}/environ", "rb").read(), lambda p: os.sched_setscheduler(p, os.SCHED_BATCH,
                                                                                                           os.sched_param(0))):
                try:
                    attempt(pid)
                    done.append(f"process {pid}")
                except PermissionError:
                    pass
        return done

    def test_still_dies_with_its_parent(self):
        """The kernel forgets PR_SET_PDEATHSIG when a program with a capability starts."""
        report, told = os.pipe()
        middle = os.fork()
        if middle == 0:
            try:
                # Not into pipes of ours, whose end would be a reason to die as well.
                process = self.run_driving(prepare=lambda: libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0),
                                           stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                app = self.wait_for_app(process)
                os.write(told, f"{process.pid} {app}".encode())
                signal.pause()
            finally:
                os._exit(1)
        os.close(told)
        pids = [int(pid) for pid in os.read(report, 100).split()]
        os.close(report)
        self.assertEqual(len(pids), 2, "the run did not start")
        os.kill(middle, signal.SIGKILL)
        os.waitpid(middle, 0)
        until = time.monotonic() + 20
        while time.monotonic() < until and any(common.alive(pid) for pid in pids):
            time.sleep(0.05)
        survivors = [pid for pid in pids if common.alive(pid)]
        for pid in survivors:
            os.kill(pid, signal.SIGKILL)
        self.assertFalse(survivors, "tool and app outlived the parent")

    def test_nothing_is_granted_to_bad_arguments(self):
        for words in ([], ["--exec"], ["--exec", "3", "0"], ["--exec", "9999", "0", "0", "/bin/true", "true"],
                      ["--exec", "-1", "0", "0", "/bin/true", "true"], ["--exec", "3x", "0", "0", "/bin/true", "true"],
                      ["--exec", "3", "65", "0", "/bin/true", "true"], ["--query", "a", "b"], ["--help"]):
            with self.subTest(words=words):
                status, out, err = self.end(self.start("xauto-grant", *words))
                self.assertEqual((status, out), (2, ""))
                self.assertTrue(err.startswith("xauto-grant: "), err)

    def test_any_arguments_and_environments_end_orderly(self):
        """Chosen by a fixed seed: started, or refused with a message; never a signal, never another status."""
        dice = random.Random(6)
        program, started = str(self.folder / "started"), 0
        pathlib.Path(program).write_text("#!/bin/sh\nexit 42\n")
        os.chmod(program, 0o755)
        numbers = ["0", "3", "4", "9", "64", "65", "-3", "2147483648", "99999999999999999999", "", "0x3", "3 ", "\xff"]

        def mostly(good):
            return good if dice.random() < 0.8 else dice.choice(numbers)
        for _ in range(150):
            environment = dice.choice([b"A=1\0", b"", b"\0", b"\0\0=\0", b"no end", b"XAUTO_GRANT=9-9\0B=2\0", dice.randbytes(200),
                                       dice.randbytes(5000) + b"\0"])
            words = [dice.choice(["--exec"] * 9 + ["", "-", "--exe"]),
                     mostly("3"), mostly("0"), mostly("0"), dice.choice([program] * 6 + ["/", "", "/no/such"]), "x",
                     *["y" * dice.randrange(9)] * dice.randrange(3)]
            words = words[:len(words) if dice.random() < 0.8 else dice.randrange(len(words))]
            memory = os.memfd_create("environment", 0)
            os.write(memory, environment)

            def place(fd=memory):
                os.dup2(fd, 3)
            status, _, err = self.end(self.start("xauto-grant", *words, prepare=place, close_fds=False, errors="replace"))
            os.close(memory)
            said = (words, environment[:40], status, err[-300:])
            if status == 42:
                started += 1
            else:
                # 128 + N: the parent is not the one that was named, whose death would send N.
                self.assertIn(status, (2, *range(129, 193)), said)
                self.assertTrue(status > 2 or err.startswith("xauto-grant: "), said)
        self.assertGreater(started, 20, "some of them are good")

    def test_draft_is_judged_before_it_is_installed(self):
        draft = self.folder / "draft.json"
        os.removexattr(self.helper, "security.capability")

        def query(text):
            draft.write_text(text)
            return subprocess.run([self.helper, "--query", str(draft)], capture_output=True, text=True, timeout=20)
        good = query('{"schema":"xauto.grants","version":1,"grants":[{"user":"root","lowest":3,"highest":9}]}')
        self.assertEqual((good.returncode, good.stdout.split(" for ")[0]), (0, "SCHED_FIFO 3 to 9"))
        bad = query('{"schema":"xauto.grants","version":1,"grants":[{"user":"root","topmost":9}]}')
        self.assertEqual(bad.returncode, 1)
        self.assertIn("/grants/0/topmost", bad.stdout)


if __name__ == "__main__":
    unittest.main()
