# SPDX-License-Identifier: Apache-2.0
"""Between hosts that are network namespaces: hands on their frames, and delays, reorders or drops those of UDP as it is told.

    wire.py INTERFACE...     a line on stdin: {"from": 0, "delay_ms": 5, "jitter_ms": 0, "drop": false, "twice": false}

sched_netem would do, and few test machines' kernels have it."""
import heapq
import json
import os
import random
import select
import socket
import sys
import time

UDP = 17


def is_udp(frame):
    return len(frame) > 23 and frame[12:14] == b"\x08\x00" and frame[23] == UDP


def is_whole(frame):
    """A fragment of a datagram that comes twice would stay in the receiver's kernel for 30 s, and fill its memory."""
    return is_udp(frame) and int.from_bytes(frame[20:22], "big") & 0x3FFF == 0


def main(names):
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    except PermissionError:
        pass
    ends = []
    for name in names:
        end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
        end.setsockopt(263, 23, 1)  # SOL_PACKET, PACKET_IGNORE_OUTGOING
        end.bind((name, 0))
        ends.append(end)
    rules = [{"delay_ms": 0, "jitter_ms": 0, "drop": False, "twice": False} for _ in ends]
    waiting, number = [], 0
    print("ready", flush=True)
    while True:
        now = time.monotonic()
        while waiting and waiting[0][0] <= now:
            _, _, origin, frame = heapq.heappop(waiting)
            for other in ends:
                if other is not origin:
                    try:
                        other.send(frame)
                    except OSError:
                        pass  # that host is gone
        limit = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        ready, _, _ = select.select([*ends, sys.stdin], [], [], limit)
        for one in ready:
            if one is sys.stdin:
                line = sys.stdin.readline()
                if not line:
                    return
                order = json.loads(line)
                rules[order.pop("from")].update(order)
                print("ok", flush=True)
                continue
            frame, rule = one.recv(65536), rules[ends.index(one)]
            delay = 0.0
            if is_udp(frame):
                if rule["drop"]:
                    continue
                delay = (rule["delay_ms"] + random.uniform(0, rule["jitter_ms"])) / 1000
            for _ in range(2 if rule["twice"] and is_whole(frame) else 1):
                number += 1
                heapq.heappush(waiting, (time.monotonic() + delay, number, one, frame))


main(sys.argv[1:])
