# SPDX-License-Identifier: Apache-2.0
"""An app and programs of rclcpp itself (only where there is one: XAUTO_RCLCPP in tests/CMakeLists.txt): messages of three types over DDS,
there and back; the example's callbacks behind gates. No time is judged."""
import json
import os
import pathlib
import signal
import subprocess
import tempfile
import unittest

from common import BIN, XAUTO, xauto
from dds_test import DOMAIN, LOOPBACK
import ros2_test

os.environ["CYCLONEDDS_URI"], os.environ["ROS_DOMAIN_ID"] = LOOPBACK, DOMAIN
os.environ["RMW_IMPLEMENTATION"] = "rmw_cyclonedds_cpp"
PEER, RELAY = str(BIN / "ros2_peer"), str(BIN / "ros2_relay")
ros2_test.GATE = str(BIN / "rclcpp_gate")


class Gate(ros2_test.Ros2):
    """The same test with rclcpp."""


class Messages(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.write("platform", {"schema": "xauto.platform", "version": 1, "name": "one", "xpus": [
            {"id": "cpu0", "type": "cpu", "preemptive": True, "preempt_us": 100}]})
        self.write("app", {"schema": "xauto.app", "version": 1, "name": "ros2_relay", "xnodes": [
            {"name": "relay.change", "module": "relay", "wcet_us": {"cpu": 5000}}], "edges": []})
        done = xauto("solve", *self.files("app", "platform"), "--method", "heft", "--out", self.folder / "policy.json")
        self.assertEqual(done.returncode, 0, done.stderr)

    def write(self, name, content):
        (self.folder / (name + ".json")).write_text(json.dumps(content))

    def files(self, *names):
        return [word for name in names for word in ("--" + name, str(self.folder / (name + ".json")))]

    def relay(self, kind, qos):
        """A run of ros2_relay that has begun."""
        transport = {"there": {"via": "cyclonedds", "feed": True, "qos": qos}, "back": {"via": "cyclonedds", "qos": qos}}
        self.write("deployment", {"schema": "xauto.deployment", "version": 1, "app": "ros2_relay", "transport": transport})
        tool = subprocess.Popen([XAUTO, "run", *self.files("app", "platform", "policy", "deployment"), "--cpu-sched", "other", "--json",
                                 "--activations", "0", "--", RELAY, kind],
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addCleanup(lambda: (tool.kill(), tool.communicate()))
        return tool

    def trip(self, kind, reliability="reliable", durability="volatile", size=1000, count=20):
        tool = self.relay(kind, {"reliability": reliability, "durability": durability})
        done = subprocess.run([PEER, "trip", kind, reliability, durability, str(size), str(count)], capture_output=True, text=True,
                              timeout=100)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        tool.send_signal(signal.SIGINT)
        out, err = tool.communicate(timeout=60)
        self.assertTrue(out, err)
        return json.loads(out)["runs"][0]

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


if __name__ == "__main__":
    unittest.main()
