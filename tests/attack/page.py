#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What a user whom nobody trusts does at the machine's socket: page.py SOCKET CORE ATTACK [NUMBER]. Prints what it saw, as
JSON. Shares no code with lib/: the packets and the page's layout are written here once more, from lib/coord/shm_layout.h,
lib/coord/protocol.h and lib/launch/system_protocol.h."""
import json
import mmap
import os
import random
import resource
import signal
import socket
import struct
import sys
import threading
import time

SLOT, LINE = 128, 192
BUDGET_NS, PERIOD_NS = 20_000_000, 100_000_000
GETTID = 178 if os.uname().machine == "aarch64" else 186


class Refused(Exception):
    pass


def connect(path):
    s = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    s.settimeout(20)
    s.connect(path)
    return s


class Lease:
    def __init__(self, path, core, xnodes=1, budget=BUDGET_NS, period=PERIOD_NS, preempt_us=0, text=b"attack", patient=True):
        self.path, self.core = path, f"core{core}".encode()
        tasks = b"".join(struct.pack("<IIIIqqqq", 0, 0, x, 0, period, period - 1_000_000, period, budget) for x in range(xnodes))
        xpu = struct.pack("<64s32s16siIIiq", b"cpu0", self.core, b"cpu", 0, 0, 0, 0, preempt_us)
        join = struct.pack("<II64sIIII", 0x10, 3, text, xnodes, 1, len(tasks), xnodes) + xpu + bytes(63 * len(xpu))
        until = time.monotonic() + (10 if patient else 0)
        while not (answer := self.ask(join, tasks)):
            time.sleep(0.05)
            if time.monotonic() > until:
                raise Refused(self.why)
        _, self.number, self.secret, self.first, self.xnodes = struct.unpack("<IIQII", answer)

    def ask(self, join, tasks):
        """The answer; None: later, perhaps, when what another one had is given back."""
        self.socket = connect(self.path)
        self.socket.send(join)
        try:
            self.socket.send(tasks)
        except BrokenPipeError:  # it was refused before
            pass
        try:
            answer = self.socket.recv(2048)
        except ConnectionResetError:  # it has not been read to its end; the answer is behind that error
            answer = self.socket.recv(2048)
        if struct.unpack_from("<I", answer)[0] == 0x11:
            return answer
        self.why = answer[8:].split(b"\0")[0].decode()
        if struct.unpack_from("<I", answer, 4)[0] == 0 and not self.why.startswith("as many runs"):
            raise Refused(self.why)
        return None

    def worker(self, xnodes=None):
        return Worker(self, range(self.xnodes) if xnodes is None else xnodes)


class Worker:
    def __init__(self, lease, xnodes, others=0):
        self.lease, self.generation = lease, 0
        self.socket = connect(lease.path)
        self.socket.send(struct.pack("<IIIIQ32s", 6, 8, lease.number, 0, lease.secret, lease.core))
        named = [lease.first + x + others for x in xnodes]
        self.socket.send(struct.pack("<II64sIII", 1, 8, b"w", 0, 0, len(named)) + struct.pack(f"<{len(named)}I", *named)
                         + bytes(4 * (256 - len(named))))
        answer, fds, *_ = socket.recv_fds(self.socket, 256, 4)
        if len(answer) < 8 or struct.unpack_from("<I", answer)[0] != 2:
            raise Refused(answer[4:].split(b"\0")[0].decode() if answer else "closed")
        self.slot = struct.unpack_from("<I", answer, 4)[0]
        self.memory, self.bell = fds
        self.size = os.fstat(self.memory).st_size
        self.page = mmap.mmap(self.memory, self.size)
        self.at = LINE + SLOT * self.slot

    def word(self, offset, value=None):
        if value is None:
            return struct.unpack_from("<I", self.page, self.at + offset)[0]
        struct.pack_into("<I", self.page, self.at + offset, value & 0xffffffff)

    def ring(self):
        try:
            os.eventfd_write(self.bell, 1)
        except BlockingIOError:
            pass

    def start(self, xnode=0, thread=None):
        self.generation += 1
        self.word(64 + 24, threading.get_native_id() if thread is None else thread)
        self.word(8, self.lease.first + xnode)
        self.word(0, self.generation << 2 | 1)
        self.ring()

    def granted(self, seconds=5.0):
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            if self.word(64) == self.generation:
                return True
            time.sleep(0.0005)
        return False

    def finish(self):
        self.word(0, self.generation << 2)
        self.ring()


def fifo():
    """This thread's priority; 0: an ordinary one."""
    try:
        policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    except AttributeError:
        policy = os.sched_getscheduler(0) & ~0x40000000
    return os.sched_getparam(0).sched_priority if policy == os.SCHED_FIFO else 0


def spin(until, seconds=20.0):
    """Computes until it is true; how long that took, in s. None: it was not."""
    since = time.monotonic()
    while not until():
        if time.monotonic() - since > seconds:
            return None
    return time.monotonic() - since


def honest(path, core, _):
    """What is asked for is had, and given back."""
    worker = Lease(path, core).worker()
    worker.start()
    seen = {"granted": worker.granted(), "fifo": spin(lambda: fifo() > 0) is not None, "cpus": sorted(os.sched_getaffinity(0))}
    worker.finish()
    seen["over"] = spin(lambda: fifo() == 0) is not None
    return seen


def never_ends(path, core, _):
    worker = Lease(path, core).worker()
    worker.start()
    seen = {"granted": worker.granted()}
    spin(lambda: fifo() > 0)
    seen["cut_s"] = spin(lambda: fifo() == 0)
    seen["again"] = spin(lambda: fifo() > 0, 0.5)  # it goes on, as an ordinary thread
    return seen


def starts_and_starts(path, core, _):
    """A new job whenever it likes, of either XNode, without a FINISH; for 2 s."""
    worker = Lease(path, core, xnodes=2).worker()
    had, begun = 0.0, time.monotonic()
    last = begun
    while last - begun < 2:
        worker.start(random.randrange(2))
        for _ in range(random.randrange(2000)):
            now = time.monotonic()
            had += now - last if fifo() > 0 else 0
            last = now
    worker.finish()
    return {"had_s": had, "allowed_s": 2 * (2 * 1e9 / PERIOD_NS + 2) * BUDGET_NS / 1e9}


def names_a_thread(path, core, thread):
    """That of a stranger, in place of its own."""
    worker = Lease(path, core).worker()
    worker.start(thread=int(thread))
    granted = worker.granted(2)
    time.sleep(0.3)
    worker.finish()
    time.sleep(0.3)
    return {"granted": granted}


def names_an_xnode(path, core, _):
    lease = Lease(path, core)
    seen = {}
    try:
        Worker(lease, [0], others=1)
        seen["hello"] = "welcome"
    except Refused as refused:
        seen["hello"] = str(refused)
    worker = lease.worker()
    worker.start(xnode=1)
    seen["granted"] = worker.granted(1)
    worker.start(xnode=-1 & 0xffff)
    seen["granted"] = seen["granted"] or worker.granted(1)
    return seen


def garbage(path, core, seconds):
    """All of the page, all the time, with and without a ring."""
    lease = Lease(path, core, xnodes=2)
    workers = [lease.worker([0]), lease.worker([1])]
    until, had, last = time.monotonic() + float(seconds), 0.0, time.monotonic()
    while time.monotonic() < until:
        worker = random.choice(workers)
        where = random.choice([random.randrange(worker.size - 64), worker.at + random.randrange(SLOT - 64)])
        worker.page[where:where + 64] = random.choice([os.urandom(64), bytes(64), b"\xff" * 64])
        if random.random() < 0.3:
            worker.ring()
        now = time.monotonic()
        had += now - last if fifo() > 0 else 0
        last = now
    return {"had_s": had, "allowed_s": 2 * (float(seconds) * 1e9 / PERIOD_NS + 2) * BUDGET_NS / 1e9}


def rings(path, core, seconds):
    worker = Lease(path, core).worker()
    until, count = time.monotonic() + float(seconds), 0
    while time.monotonic() < until:
        worker.ring()
        count += 1
    return {"rings": count}


def asks_on(path, core, _):
    """What a worker that is trusted may ask its coordinator for."""
    seen = {}
    for name, kind in ("observe", 5), ("status", 4), ("adopt", 7), ("regulate", 9):
        worker = Lease(path, core, budget=1_000_000).worker()
        worker.socket.send(struct.pack("<I", kind))
        answer, fds, *_ = socket.recv_fds(worker.socket, 70_000, 4)
        seen[name] = len(answer) + len(fds)
        # Before Hello, too.
        lease = Lease(path, core, budget=1_000_000)
        other = connect(path)
        other.send(struct.pack("<IIIIQ32s", 6, 8, lease.number, 0, lease.secret, lease.core))
        other.send(struct.pack("<I", kind))
        answer, fds, *_ = socket.recv_fds(other, 70_000, 4)
        seen[name] += len(answer) + len(fds)
    service = connect(path)
    service.send(struct.pack("<I", 0x13))
    seen["records"] = len(socket.recv_fds(service, 70_000, 4)[1])
    return seen


def raises_itself(path, core, _):
    """With a core it wants more: a higher priority, a child that has it, another core, memory that is cut short."""
    worker = Lease(path, core).worker()
    worker.start()
    worker.granted()
    spin(lambda: fifo() > 0)
    seen = {}

    def refused(name, call):
        try:
            call()
            seen[name] = "done"
        except OSError:
            seen[name] = "refused"

    refused("higher", lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50)))
    refused("truncate", lambda: os.ftruncate(worker.memory, 0))
    reader, writer = os.pipe()
    if os.fork() == 0:
        os.write(writer, bytes([fifo()]))
        os._exit(0)
    seen["child"] = os.read(reader, 1)[0]
    seen["limit_us"] = resource.getrlimit(22 if not hasattr(resource, "RLIMIT_RTTIME") else resource.RLIMIT_RTTIME)[1]
    worker.finish()
    return seen


def closes(path, core, _):
    """With a core it leaves, and lives on: its worker's connection first, then its lease."""
    seen = {}
    for name in "worker", "lease":
        lease = Lease(path, core)
        worker = lease.worker()
        worker.start()
        worker.granted()
        spin(lambda: fifo() > 0)
        (worker if name == "worker" else lease).socket.close()
        seen[name] = spin(lambda: fifo() == 0)
        worker.socket.close()
        lease.socket.close()
        time.sleep(0.5)  # what it had is given back
    return seen


def dies(path, core, _):
    worker = Lease(path, core).worker()
    worker.start()
    worker.granted()
    os.kill(os.getpid(), signal.SIGKILL)


def many(path, core, _):
    """Places that others need: workers, and runs."""
    lease = Lease(path, core, xnodes=3, budget=1_000_000)
    workers, seen = [], {}
    try:
        while len(workers) < 60:
            workers.append(lease.worker([0]))
    except Refused:
        pass
    seen["workers"] = len(workers)
    leases = [lease]
    try:
        while len(leases) < 30:
            leases.append(Lease(path, core, budget=1_000_000, patient=False))
    except Refused:
        pass
    seen["runs"] = len(leases)
    try:
        Lease(path, core, xnodes=300, patient=False)
        seen["xnodes"] = "admitted"
    except (Refused, OSError):
        seen["xnodes"] = "refused"
    return seen


def wants_all(path, core, seconds):
    """Nearly all of the core, at another cost of a preemption than others'. Until it is put out."""
    lease = Lease(path, core, budget=90_000_000, preempt_us=3)
    worker = lease.worker()
    worker.start()
    worker.granted()
    print("there", flush=True)
    lease.socket.settimeout(float(seconds))
    try:
        ended = lease.socket.recv(16) == b""
    except TimeoutError:
        ended = False
    return {"ended": ended, "lowered": spin(lambda: fifo() == 0) is not None}


def stays(path, core, _):
    """With a core, until somebody ends it: what becomes of it where the coordinator dies."""
    lease = Lease(path, core, budget=450_000_000, period=1_000_000_000)
    worker = lease.worker()
    worker.start()
    worker.granted()
    spin(lambda: fifo() > 0)
    print("there", flush=True)
    since = time.monotonic()
    while fifo() > 0 and time.monotonic() - since < 20:
        pass
    return {"lowered_s": time.monotonic() - since if fifo() == 0 else None}


def joins(path, core, seconds):
    """Nothing but a place; or why there is none."""
    try:
        lease = Lease(path, core)
        print("there", flush=True)
        time.sleep(float(seconds))
        return {"admitted": lease.number}
    except Refused as refused:
        return {"refused": str(refused)}


if __name__ == "__main__":
    attack = globals()[sys.argv[3]]
    print(json.dumps(attack(sys.argv[1], sys.argv[2], sys.argv[4] if len(sys.argv) > 4 else "0")))
