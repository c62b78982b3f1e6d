# SPDX-License-Identifier: Apache-2.0
"""An app and programs of rclcpp itself (only where there is one: XAUTO_RCLCPP in tests/CMakeLists.txt): messages of three types over DDS,
there and back; the example's callbacks behind gates; `ros2 bag`, where it is on the PATH. No time is judged."""
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import tempfile
import time
import unittest

from common import BIN, QUEUES, XAUTO, activations, sourced, wait_for, xauto
from dds_test import DOMAIN, LOOPBACK
import ros2_test

os.environ["CYCLONEDDS_URI"], os.environ["ROS_DOMAIN_ID"] = LOOPBACK, DOMAIN
os.environ["RMW_IMPLEMENTATION"] = "rmw_cyclonedds_cpp"
PEER, RELAY = str(BIN / "ros2_peer"), str(BIN / "ros2_relay")
ros2_test.GATE = str(BIN / "rclcpp_gate")


class Gate(ros2_test.Ros2):
    """The same test with rclcpp."""


class Runs(unittest.TestCase):
    """Of ros2_relay."""
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.write("platform", {"schema": "xauto.platform", "version": 1, "name": "one", "xpus": [
            {"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 100}]})
        # Without a rate: each message is a release, whenever it comes, and none is lost.
        self.write("app", sourced({"name": "ros2_relay", "xnodes": [
            {"name": "relay.change", "module": "relay", "wcet_us": {"cpu": 5000}}], "edges": []}, "there"))
        done = xauto("solve", *self.files("app", "platform"), "--out", self.folder / "policy.json")
        self.assertEqual(done.returncode, 0, done.stderr)

    def write(self, name, content):
        (self.folder / (name + ".json")).write_text(json.dumps(content))

    def files(self, *names):
        return [word for name in names for word in ("--" + name, str(self.folder / (name + ".json")))]

    def start(self, transport, *arguments):
        self.write("deployment", {"schema": "xauto.deployment", "version": 1, "app": "ros2_relay", "transport": transport, **QUEUES})
        tool = subprocess.Popen([XAUTO, "run", *self.files("app", "platform", "policy", "deployment"), "--cpu-sched", "other", "--json",
                                 *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addCleanup(lambda: (tool.kill(), tool.communicate()))
        return tool

    def end(self, tool, stop=True):
        """Its report."""
        if stop:
            tool.send_signal(signal.SIGINT)
        out, err = tool.communicate(timeout=60)
        self.assertTrue(out, err)
        return json.loads(out)["runs"][0]


class Messages(Runs):
    def relay(self, kind, qos):
        """A run of ros2_relay that has begun."""
        transport = {"there": {"via": "cyclonedds", "feed": True, "qos": qos}, "back": {"via": "cyclonedds", "qos": qos}}
        return self.start(transport, "--activations", "0", "--", RELAY, kind)

    def trip(self, kind, reliability="reliable", durability="volatile", size=1000, count=20):
        tool = self.relay(kind, {"reliability": reliability, "durability": durability})
        done = subprocess.run([PEER, "trip", kind, reliability, durability, str(size), str(count)], capture_output=True, text=True,
                              timeout=100)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return self.end(tool)

    def test_each_field_goes_there_and_back(self):
        for kind in ("String", "Image", "PointCloud2"):
            for size in (0, 1000, 6_000_000):
                with self.subTest(kind=kind, size=size):
                    self.trip(kind, size=size)

    def test_each_quality_of_service(self):
        for reliability in ("reliable", "best_effort"):
            for durability in ("volatile", "transient_local"):
                with self.subTest(reliability=reliability, durability=durability):
                    self.trip("Image", reliability, durability)


@unittest.skipUnless(shutil.which("ros2"), "no ros2 on the PATH")
class Bags(Runs):
    """`ros2 bag` itself."""
    COUNT = 30

    def bag(self, *arguments):
        done = subprocess.run(["ros2", "bag", *map(str, arguments)], capture_output=True, text=True, timeout=100, stdin=subprocess.DEVNULL)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout + done.stderr

    def counts(self, path):
        return {topic: int(count) for topic, count in re.findall(r"Topic: (\S+) .*Count: ([0-9]+)", self.bag("info", path))}

    def numbers(self, name):
        with open(self.folder / name) as file:
            return [int(line.split()[0]) for line in file]

    def test_what_we_record_it_plays_and_the_run_says_what_it_did_not_use(self):
        for bag in ("ours.mcap", "ours"):
            with self.subTest(bag=bag):
                path = self.folder / bag
                self.end(self.start({}, "--activations", self.COUNT, "--record", path, "--", RELAY, "Image", "/dev/null", "20", "1000"),
                         stop=False)
                self.assertEqual(self.counts(path)["/there"], self.COUNT)
                file = self.folder / "heard"
                tool = self.start({"there": "cyclonedds:feed"}, "--activations", "0", "--", RELAY, "Image", file, "20")
                wait_for("the app", lambda: activations(tool), tool)
                self.bag("play", path, "--delay", 1)  # meanwhile they find each other
                last = -1
                while len(self.numbers("heard")) > last:  # what is on the way
                    last = len(self.numbers("heard"))
                    time.sleep(0.5)
                run = self.end(tool)
                heard = self.numbers("heard")
                self.assertEqual(heard, sorted(set(heard)))
                # It plays what is of the first 100 ms at once, of which the newest waits (docs/interop.md).
                unused = re.findall("([0-9]+) messages were not used", " ".join(run["notes"]))
                self.assertEqual(len(heard) + int((unused or [0])[0]), self.COUNT, run["notes"])

    def test_what_it_records_is_an_input(self):
        for storage in ("mcap", "sqlite3"):
            with self.subTest(storage=storage):
                path = self.folder / storage
                recorder = subprocess.Popen(["ros2", "bag", "record", "-s", storage, "-o", path, "/there", "/back"], stdin=subprocess.DEVNULL,
                                            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                self.addCleanup(lambda of=recorder: (of.kill(), of.wait()))
                wait_for("the recorder", path.exists, recorder)
                # Who comes late hears all of it.
                qos = {"via": "cyclonedds", "qos": {"durability": "transient_local", "depth": 4 * self.COUNT}}
                self.end(self.start({"there": qos, "back": qos}, "--activations", 4 * self.COUNT, "--", RELAY, "Image", "/dev/null",
                                    "20", "1000"), stop=False)
                recorder.send_signal(signal.SIGINT)
                recorder.wait(60)
                count = self.counts(path)["/there"]
                self.assertGreater(count, 0)
                self.end(self.start({}, "--activations", "0", "--input", path, "--lockstep", "--", RELAY, "Image", self.folder / "read"),
                         stop=False)
                self.assertEqual(len(self.numbers("read")), count)


if __name__ == "__main__":
    unittest.main()
