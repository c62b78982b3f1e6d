#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Garbage to the doors of living runs: packets.py BIN [--seconds N] [--seed S].

Two runs in turn, each attacked until its part of the time is over:
  sockets  every Unix socket of a run: random packets with small numbers in front, descriptors, connections that say nothing,
           answers that nobody reads; as the run's own user, and as another one (65534) where this is root
  dds      the UDP ports of a run that hears and speaks over DDS: real RTPS packets of its own, seen on the loopback device and
           sent again with bytes changed, cut and joined (needs root, and the Cyclone DDS plug-in)
The run has to end by itself when it is told to, with all its releases accounted for, and to answer `xauto top` meanwhile.
All goes to this machine's loopback and its own sockets. Shares no code with lib/. The last line is a count."""
import argparse
import array
import json
import os
import pathlib
import random
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time

NOBODY = 65534
DOMAIN = 60 + os.getpid() % 30
LOOPBACK = ("<CycloneDDS><Domain id='any'><General><Interfaces><NetworkInterface name='lo'/></Interfaces><AllowMulticast>false</AllowMulticast>"
            "</General><Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>10</MaxAutoParticipantIndex>"
            "<Peers><Peer address='localhost'/></Peers></Discovery></Domain></CycloneDDS>")


class Target:
    """A run without an end of the tests' app, whose releases come every 20 ms."""

    def __init__(self, bin_folder, folder, name, transport=None, isolate=True):
        self.xauto, self.folder = str(bin_folder / "xauto"), folder
        xnodes = [("a1", "A", "cpu"), ("a2", "A", "npu"), ("b1", "B", "npu"), ("c1", "C", "cpu"), ("d1", "D", "cpu")]
        self.write("platform.json", {"schema": "xauto.platform", "version": 1, "name": "test", "xpus": [
            {"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 0},
            {"id": "npu0", "type": "npu", "preemptive": True, "preempt_us": 100, "timeslice_us": 500}]})
        self.write("app.json", {"schema": "xauto.app", "version": 3, "name": "testapp", "sources": [{"name": "src", "period_us": 20000}],
                                "xnodes": [{"name": n, "module": m, "wcet_us": {x: 6000}} | ({"source": "src"} if n in ("a1", "b1", "d1") else {})
                                           for n, m, x in xnodes],
                                "edges": [["a1", "a2"], ["a2", "c1"], ["b1", "c1"]]})
        self.write("deployment.json", {"schema": "xauto.deployment", "version": 1, "app": "testapp", "transport": transport or {}})
        subprocess.run([self.xauto, "solve", "--app", self.path("app.json"), "--platform", self.path("platform.json"), "--time-limit", "1s",
                        "--out", self.path("policy.json")], check=True, capture_output=True)
        self.since = time.monotonic()
        self.err = open(self.path(name + ".err"), "w+")
        self.out = open(self.path(name + ".out"), "w+")
        environment = dict(os.environ, CYCLONEDDS_URI=LOOPBACK, ROS_DOMAIN_ID=str(DOMAIN))
        self.tool = subprocess.Popen(
            [self.xauto, "run", "--app", self.path("app.json"), "--policy", self.path("policy.json"), "--platform", self.path("platform.json"),
             "--deployment", self.path("deployment.json"), "--emulate", "--json", "--activations", "0", *(["--isolate"] if isolate else []),
             "--", str(bin_folder / "testapp"), self.path("result"), "period", "20000", "emulated", "1000"],
            stdout=self.out, stderr=self.err, env=environment, start_new_session=True)
        until = time.monotonic() + 60
        while self.activations() < 5 and time.monotonic() < until and self.tool.poll() is None:
            time.sleep(0.1)

    def write(self, name, content):
        (self.folder / name).write_text(json.dumps(content))

    def path(self, name):
        return str(self.folder / name)

    def activations(self):
        try:
            done = subprocess.run([self.xauto, "top", "--run", f"{self.tool.pid}-0", "--wait", "2s", "--once", "--interval", "50ms", "--json"],
                                  capture_output=True, text=True, timeout=40)
            return min(m["activations"] for m in json.loads(done.stdout)["runs"][0]["modules"])
        except (ValueError, KeyError, IndexError, subprocess.TimeoutExpired):
            return 0

    def end(self):
        """The complaints."""
        bad = []
        if self.tool.poll() is not None:
            bad.append(f"it ended by itself, status {self.tool.returncode}")
        else:
            before = self.activations()
            time.sleep(1)
            after = self.activations()
            if after <= before:
                bad.append(f"it does not go on: {before} activations, then {after}")
            try:
                answer = subprocess.run([self.xauto, "top", "--once", "--json"], capture_output=True, text=True, timeout=30)
                if f"{self.tool.pid}-" not in answer.stdout:
                    bad.append(f"top does not show it: {answer.stdout[:300]} {answer.stderr[:300]}")
            except subprocess.TimeoutExpired:
                bad.append("`xauto top` does not end within 30 s")
            self.tool.send_signal(signal.SIGTERM)
            try:
                self.tool.wait(timeout=60)
            except subprocess.TimeoutExpired:
                bad.append("it did not end within 60 s of SIGTERM")
                os.killpg(self.tool.pid, signal.SIGKILL)
                self.tool.wait()
        self.out.seek(0)
        self.err.seek(0)
        text, errors = self.out.read(), self.err.read()
        if not bad:
            run = json.loads(text)["runs"][0]
            counts = [m["activations"] + m["failed"] + m["dropped"] for m in run["modules"]]
            if not run["complete"]:
                bad.append("its report is not complete")
            if max(counts) - min(counts) > 3:
                bad.append(f"its counts do not add up: {run['modules']}")
        # A line a second of each process, and Cyclone's of 500 bytes.
        if len(errors) > 100_000 + 1_000 * (time.monotonic() - self.since):
            bad.append(f"{len(errors)} bytes of log")
        return bad + (["stderr ends: " + errors[-1500:]] if bad else [])


def garbage(rng):
    size = rng.choice([0, 1, 4, 8, 16, 24, 32, 64, 200, 1000, 4096, 60_000])
    front = b"".join(rng.choice([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 255, 2**31, 2**32 - 1]).to_bytes(4, "little") for _ in range(rng.randint(0, 6)))
    return (front + rng.randbytes(size))[:max(size, len(front))]


def throw(address, kind, rng, held):
    door = socket.socket(socket.AF_UNIX, kind)
    door.settimeout(0.2)
    try:
        door.connect(address)
        for _ in range(rng.choice([0, 1, 3, 50])):
            if rng.random() < 0.2:
                file = os.open("/dev/null", os.O_RDONLY)
                try:
                    door.sendmsg([garbage(rng) or b"x"], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [file] * rng.randint(1, 4)))])
                finally:
                    os.close(file)
            else:
                door.send(garbage(rng) or b"x")
        if rng.random() < 0.3:
            door.recv(1 << 16)
    except OSError:
        pass
    if rng.random() < 0.2:
        held.append(door)  # it says nothing more, and reads nothing
        if len(held) > 200:
            held.pop(rng.randrange(len(held))).close()
    else:
        door.close()


def sockets(target, rng, until):
    """In two children, one of which is another user."""
    children = []
    for uid in {os.getuid(), NOBODY} if os.getuid() == 0 else {os.getuid()}:
        seed = rng.random()
        child = os.fork()
        if child == 0:
            if uid != os.getuid():
                os.setgroups([])
                os.setgid(NOBODY)
                os.setuid(uid)
            own, held = random.Random(seed), []
            while time.monotonic() < until:
                names = re.findall(rf" (000[125]) \d\d +\d+ @(xauto/{target.tool.pid}-\S+)", pathlib.Path("/proc/net/unix").read_text())
                for kind, name in set(names):
                    throw("\0" + name, int(kind, 16), own, held)
                time.sleep(0.01)
            os._exit(0)
        children.append(child)
    for child in children:
        os.waitpid(child, 0)


def rtps(target, rng, until):
    """Mutates what is seen on the loopback device; the ports are the standard's (RTPS 2.3, 9.6.1.1)."""
    base = 7400 + 250 * DOMAIN
    ports = range(base, base + 60)
    seen, sniffer, sender = [], socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(0x0800)), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sniffer.bind(("lo", 0))
    sniffer.settimeout(0.05)
    while time.monotonic() < until:
        try:
            packet = sniffer.recv(65536)
            header = (packet[0] & 15) * 4
            to = int.from_bytes(packet[header + 2:header + 4], "big")
            if packet[9] == 17 and to in ports and packet[header + 8:header + 12] == b"RTPS" and len(seen) < 4000:
                seen.append((to, packet[header + 8:]))
        except (TimeoutError, IndexError):
            pass
        for _ in range(20 if seen else 0):
            to, data = rng.choice(seen)
            data = bytearray(data)
            for _ in range(rng.choice([1, 2, 8, 40])):
                at = rng.randrange(len(data))
                what = rng.random()
                if what < 0.5:
                    data[at] = rng.choice([0, 1, 127, 128, 255, rng.randrange(256)])
                elif what < 0.7:
                    del data[at:at + rng.randint(1, 8)]
                elif what < 0.85:
                    data[at:at] = rng.randbytes(rng.choice([1, 4, 64]))
                else:
                    data[at:] = rng.choice(seen)[1][20:]
                if len(data) < 8:
                    break
            try:
                sender.sendto(bytes(data[:60_000]), ("127.0.0.1", to if rng.random() < 0.8 else rng.choice(ports)))
            except OSError:
                pass
    return len(seen)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("--seconds", type=float, default=600)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    bin_folder, rng, passed, failed, skipped = options.bin.resolve(), random.Random(options.seed), 0, 0, 0
    with tempfile.TemporaryDirectory() as name:
        os.chmod(name, 0o755)
        folder = pathlib.Path(name)
        for part in ("sockets", "dds"):
            until = time.monotonic() + options.seconds / 2
            if part == "sockets":
                target = Target(bin_folder, folder, part)
                sockets(target, rng, until)
                bad = target.end()
            else:
                if os.getuid() != 0 or not (bin_folder.parent / "lib/xauto/cyclonedds.so").exists():
                    print("packets: skipped: dds needs root and the Cyclone DDS plug-in")
                    skipped += 1
                    continue
                # A program that knows nothing of XAuto hears what the run says: what goes between them is what is changed.
                target = Target(bin_folder, folder, part, {"src": "cyclonedds", "b": "cyclonedds", "c": "cyclonedds"})
                hearer = subprocess.Popen([str(bin_folder / "dds_peer"), "hear", "rt/c", str(folder / "heard"), str(options.seconds)],
                                          stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=dict(os.environ, CYCLONEDDS_URI=LOOPBACK, ROS_DOMAIN_ID=str(DOMAIN)))
                seen = rtps(target, rng, until)
                hearer.kill()
                hearer.wait()
                bad = target.end() + ([] if seen else ["no RTPS packet was seen, so none was changed"])
            passed, failed = passed + (not bad), failed + bool(bad)
            for line in bad:
                print(f"packets: {part}: {line}", flush=True)
    print(f"{passed} passed, {failed} failed, {skipped} skipped")
    return failed != 0


if __name__ == "__main__":
    sys.exit(main())
