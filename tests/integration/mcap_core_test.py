#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""npm's @mcap/core reads what an app records, to the last message, and writes what feeds it."""
import json
import pathlib
import shutil
import struct
import subprocess
import sys
import unittest

from common import SOURCE, xauto
from mcap_test import MESSAGE_SCHEMA, Case, block, enclosed

CORE = SOURCE / "build/mcap-core"
PEER = SOURCE / "tests/integration/mcap/peer.js"


def peer(*arguments, given=None):
    done = subprocess.run(["node", PEER, CORE, *map(str, arguments)], capture_output=True, text=True, timeout=100,
                          input=given and json.dumps(given))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout) if arguments[0] == "read" else None


class Core(Case):
    def test_answer_is_read_by_mcap_core_to_the_last_message(self):
        given, made = self.path("given.mcap"), self.path("made.mcap")
        def half(k):  # gets smaller, but for every third
            return block(k) if k % 3 == 0 else struct.pack("<512Q", *(k % 7,) * 512)

        pathlib.Path(given).write_bytes(self.bag(self.messages(1000, made=half)))
        self.run_app("--activations", 1000, "--input", given, "--record", made)
        seen = peer("read", made)
        # One by log time, the other as it was written.
        self.assertEqual(sorted(seen["indexed"]), sorted(seen["streamed"]))
        self.assertEqual(seen["count"], 2000)
        self.assertEqual(sum(topic == "/xauto/releases" for _, topic, _ in seen["indexed"]), 1000)
        seen["indexed"] = [m for m in seen["indexed"] if m[1] == "/src"]
        self.assertEqual([enclosed(bytes.fromhex(d))[1:] for _, _, d in seen["indexed"]],
                         [(k, half(k)) for k in range(1000)])
        self.assertEqual([enclosed(bytes.fromhex(d))[0] for _, _, d in seen["indexed"]], [int(t) for t, _, _ in seen["indexed"]])
        self.assertIn("zstd", seen["compressions"])
        self.assertEqual(seen["profile"], "ros2")
        topic = next(t for t in seen["topics"] if t["topic"] == "/src")
        self.assertEqual((topic["topic"], topic["encoding"], topic["type"], topic["schemaEncoding"], topic["qos"]),
                         ("/src", "cdr", "xauto_msgs/msg/Message", "ros2msg", "[]"))
        self.assertIn("serialized_metadata", seen["metadata"]["rosbag2"])

    def test_outputs_are_read_by_mcap_core_to_the_last_message(self):
        """What modules publish, also those in processes of their own: as the app's own observer hears it."""
        for flags in ((), ("--isolate",)):
            with self.subTest(flags):
                made = self.path(f"all{len(flags)}.mcap")
                result = self.run_app("--activations", 100, "--record", made, "--record-outputs", *flags)
                seen = peer("read", made)
                self.assertEqual(sorted(seen["indexed"]), sorted(seen["streamed"]))
                of = {}
                for _, topic, data in seen["indexed"]:
                    if topic != "/xauto/releases":
                        of.setdefault(topic, []).append(enclosed(bytes.fromhex(data))[1:])
                self.assertEqual(set(of), {"/src", "/a", "/b", "/c", "/d"})
                for topic, messages in of.items():
                    self.assertEqual([k for k, _ in messages], list(range(100)), topic)
                lines = [line.split() for line in result.splitlines()]  # TOPIC NUMBER VALUE
                for topic in "cd":
                    self.assertEqual({k: struct.unpack("<Q", data)[0] for k, data in of["/" + topic]},
                                     {int(k): int(value) for name, k, value in lines if name == topic})

    def test_what_mcap_core_writes_feeds_an_app(self):
        expected = self.run_app("--activations", 20)
        for chunked in (True, False):
            with self.subTest(chunked=chunked):
                made = self.path(f"core-{chunked}.mcap")
                peer("write", made, given={"topic": "/src", "type": "xauto_msgs/msg/Message", "schema": MESSAGE_SCHEMA, "chunked": chunked,
                                           "messages": [[str(t), d.hex()] for t, d in self.messages()]})
                self.assertEqual(xauto("recording", "check", made).returncode, 0)
                self.assertEqual(self.run_app("--input", made), expected)


if __name__ == "__main__":
    if not shutil.which("node") or not (CORE / "whole").exists():
        print("@mcap/core is not there: scripts/fetch-mcap-core.sh installs it, from npm's registry")
        sys.exit(77)
    unittest.main()
