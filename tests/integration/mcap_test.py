#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A bag feeds an app, and what the app records is a bag again: written and read by ours and by mcap_file.py."""
import json
import os
import pathlib
import random
import signal
import sqlite3
import struct
import subprocess
import tempfile
import time
import unittest

from common import SOURCE, TESTAPP, XAUTO, testapp_files, wait_for, xauto
from mcap_file import Writer, channel, message, read, schema

START = 1_700_000_000_123_456_789
MESSAGE_SCHEMA = """\
builtin_interfaces/Time stamp
uint64 number
uint8[] data
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def enclose(stamp, number, data):
    """xauto_msgs/msg/Message in CDR, little-endian (docs/interop.md)."""
    return b"\0\1\0\0" + struct.pack("<iIQI", stamp // 10**9, stamp % 10**9, number, len(data)) + data


def enclosed(data):
    assert data[:4] == b"\0\1\0\0", data
    sec, nanosec, number, size = struct.unpack_from("<iIQI", data, 4)
    assert len(data) == 24 + size, data
    return sec * 10**9 + nanosec, number, data[24:]


def mix(x):
    """As testapp.cc has it."""
    x = ((x ^ x >> 30) * 0xbf58476d1ce4e5b9) % 2**64
    x = ((x ^ x >> 27) * 0x94d049bb133111eb) % 2**64
    return x ^ x >> 31


def block(k):
    """Message `k` of testapp's source."""
    return struct.pack("<512Q", *(mix(k + i) for i in range(512)))


class Case(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.files = testapp_files(self.folder.name)

    def path(self, name):
        return os.path.join(self.folder.name, name)

    def run_app(self, *arguments, result="result"):
        """In lockstep: no message is lost. The app's results, of which each depends on the message it is of."""
        done = xauto("run", *self.files, "--lockstep", *arguments, "--", TESTAPP, self.path(result))
        self.assertEqual(done.returncode, 0, done.stderr)
        return pathlib.Path(self.path(result)).read_text()

    def messages(self, count=20, step=10_000_000, made=block):
        """What testapp's source would release."""
        return [(START + k * step, enclose(START + k * step, k, made(k))) for k in range(count)]

    def bag(self, messages, chunked=True, compression="", per_chunk=4, topic="/src"):
        bag = Writer().add(schema(1, "xauto_msgs/msg/Message", data=MESSAGE_SCHEMA) + channel(1, 1, topic), chunked=False)
        for at in range(0, len(messages), per_chunk):
            bag.add(b"".join(message(1, t, d, at) for t, d in messages[at:at + per_chunk]), compression, chunked)
        return bag.end()

    def look(self, path, count):
        """Reads the answer by its bytes, where they are not compressed, and by `recording`."""
        info = json.loads(xauto("recording", "info", path, "--json").stdout)
        self.assertEqual([(t["name"], t["type"], t["serialization_format"], t["schema_encoding"], t["messages"]) for t in info["topics"]],
                         [("/src", "xauto_msgs/msg/Message", "cdr", "ros2msg", count),
                          ("/xauto/releases", "xauto_msgs/msg/Release", "cdr", "ros2msg", count)])
        self.assertEqual(xauto("recording", "check", path).returncode, 0)


class Bags(Case):
    def test_bag_feeds_an_app_whose_answer_is_a_bag(self):
        messages = self.messages()
        shuffled = messages[:]
        random.Random(1).shuffle(shuffled)  # chunks that overlap in time
        expected = self.run_app("--activations", 20)
        bags = {"chunks": self.bag(messages), "zstd": self.bag(messages, compression="zstd"),
                "outside-of-chunks": self.bag(messages, chunked=False), "overlapping": self.bag(shuffled),
                "relative-name": self.bag(messages, topic="src"), "without-end": self.bag(messages).split(b"\x0f\x04\0\0\0\0\0\0\0")[0] + bytes(100)}
        for name, data in bags.items():
            with self.subTest(bag=name):
                given, made = self.path(name + ".mcap"), self.path(name + ".out.mcap")
                pathlib.Path(given).write_bytes(data)
                self.assertEqual(self.run_app("--input", given, "--record", made), expected)
                self.look(made, 20)

    def test_answer_is_read_by_a_program_of_its_own(self):
        made = self.path("small.mcap")
        begin = time.time_ns()
        noise = [random.Random(k).randbytes(4096) for k in range(300)]  # does not get smaller: the chunks are as they are
        pathlib.Path(self.path("noise.mcap")).write_bytes(self.bag(self.messages(300, made=lambda k: noise[k])))
        self.run_app("--activations", 300, "--input", self.path("noise.mcap"), "--record", made)
        end = time.time_ns()
        bag = read(pathlib.Path(made).read_bytes())
        self.assertEqual(bag["profile"], "ros2")
        self.assertGreater(len(bag["chunks"]), 1)
        found = {topic: [m for m in bag["messages"] if m[1] == topic] for topic in ("/src", "/xauto/releases")}
        self.assertEqual([len(messages) for messages in found.values()], [300, 300])
        for k, (stamp, topic, sequence, data) in enumerate(found["/src"]):
            self.assertEqual((topic, sequence, enclosed(data)), ("/src", k, (stamp, k, noise[k])))
            self.assertTrue(begin <= stamp <= end, (begin, stamp, end))
        # In lockstep no release is lost, and each ends before the next begins.
        for k, (stamp, topic, sequence, data) in enumerate(found["/xauto/releases"]):
            sec, nanosec, number, latency_us = struct.unpack("<iIQq", data[4:])
            self.assertEqual((sequence, number, sec * 10**9 + nanosec + latency_us * 1000), (k, k, stamp))
            self.assertGreaterEqual(latency_us, 0)
            self.assertLessEqual(found["/src"][k][0], stamp + 1000)
            self.assertTrue(k == 299 or stamp <= found["/src"][k + 1][0])
        [schema_number, _, encoding, metadata] = next(c for c in bag["channels"].values() if c[1] == "/src")
        self.assertEqual((encoding, metadata), ("cdr", {"offered_qos_profiles": "[]"}))
        name, schema_encoding, text = bag["schemas"][schema_number]
        self.assertEqual((name, schema_encoding), ("xauto_msgs/msg/Message", "ros2msg"))
        fields = [line.split("#")[0].split() for line in text.splitlines()]
        self.assertEqual([f for f in fields if f], [f for f in map(str.split, MESSAGE_SCHEMA.splitlines())])
        self.assertIn("storage_identifier: mcap\n", bag["metadata"]["rosbag2"]["serialized_metadata"])
        self.assertIn("message_count: 600\n", bag["metadata"]["rosbag2"]["serialized_metadata"])

    def test_golden_file_is_read_by_a_program_of_its_own(self):
        bag = read((SOURCE / "tests/golden/recording.mcap").read_bytes())
        self.assertEqual([(t, topic, sequence, len(d)) for t, topic, sequence, d in bag["messages"]],
                         [(1_700_000_000_000_000_000 + i * 600_000_000, ("/camera", "/lidar")[i % 2], i // 2, 300) for i in range(4)])

    def test_folder_is_a_bag(self):
        self.run_app("--activations", 5, "--record", self.path("drive"))
        self.assertEqual(sorted(os.listdir(self.path("drive"))), ["drive_0.mcap", "metadata.yaml"])
        self.look(self.path("drive"), 5)
        self.assertEqual(self.run_app("--input", self.path("drive"), result="again"), pathlib.Path(self.path("result")).read_text())

    def test_sqlite_is_read_and_not_written(self):
        """Its topics have the app's names, C++ types and plain bytes."""
        expected = self.run_app("--activations", 5)
        new = self.path("new.db3")
        done = xauto("run", *self.files, "--activations", 5, "--record", new, "--", TESTAPP, self.path("r"))
        self.assertEqual((done.returncode, os.path.exists(new)), (2, False), done.stderr)
        self.assertRegex(done.stderr, r"new.db3: SQLite is read and not written\n.*\.mcap")
        database = sqlite3.connect(self.path("old.db3"))
        database.executescript("""
            CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL); INSERT INTO schema VALUES (3, '');
            CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
                                offered_qos_profiles TEXT NOT NULL); INSERT INTO topics VALUES (1, 'src', 'Block', 'xauto', '[]');
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
            CREATE INDEX timestamp_idx ON messages (timestamp ASC);""")
        database.executemany("INSERT INTO messages VALUES (NULL, 1, ?, ?)", [(1_000_000 * k, block(k)) for k in range(5)])
        database.commit()
        database.close()
        self.assertEqual(self.run_app("--input", self.path("old.db3"), result="again"), expected)

    def test_what_is_not_such_a_message_is_refused(self):
        for name, data in {"short": b"\0\1\0\0" + bytes(19), "big-endian": b"\0\0\0\0" + bytes(28)}.items():
            with self.subTest(bag=name):
                pathlib.Path(self.path(name + ".mcap")).write_bytes(self.bag([(START, data)]))
                done = xauto("run", *self.files, "--lockstep", "--input", self.path(name + ".mcap"), "--", TESTAPP, self.path("r"))
                self.assertEqual(done.returncode, 2, done.stderr)
                self.assertRegex(done.stderr, "error: /src: a message of type xauto_msgs/msg/Message is ")

    @staticmethod
    def open_files(process):
        try:
            return [os.readlink(f) for f in pathlib.Path(f"/proc/{process}/fd").iterdir()]
        except OSError:
            return []

    def test_recorder_that_was_killed_leaves_what_it_wrote(self):
        made = self.path("killed.mcap")
        tool = subprocess.Popen([XAUTO, "run", *self.files, "--lockstep", "--activations", "0", "--record", made, "--", TESTAPP,
                                 self.path("result"), "tally"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_for("the second chunk", lambda: os.path.exists(made) and os.path.getsize(made) > 2_500_000, tool)
        # The app has the file open, and nobody else.
        [app] = [p for p in map(int, filter(str.isdigit, os.listdir("/proc"))) if made in self.open_files(p)]
        os.kill(app, signal.SIGKILL)
        tool.wait(timeout=60)
        done = xauto("recording", "check", made)
        self.assertEqual(done.returncode, 1, done.stdout + done.stderr)
        self.assertRegex(done.stdout, r"all \d+ messages that are there can be read; more were recorded")
        self.assertIn("its recorder did not close it", done.stderr)


if __name__ == "__main__":
    unittest.main()
