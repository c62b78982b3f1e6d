# SPDX-License-Identifier: Apache-2.0
"""Topics to and from another program over DDS (Cyclone), in the way of ROS 2: what it hears is what the app published, what it feeds is what
the app computes with, and it can neither stop nor slow the app. dds_peer is that program; it knows the DDS type only."""
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time
import unittest

from common import BIN, QUEUES, activations, wait_for, xauto
from isolate_test import Case as Runs  # the test app and how it is run

PEER = BIN / "dds_peer"
PLUGIN = BIN.parent / "lib/xauto/cyclonedds.so"
DOMAIN = str(101 + os.getpid() % 100)  # others may test on this machine
LOOPBACK = ("<CycloneDDS><Domain id='any'><General><Interfaces><NetworkInterface name='lo'/></Interfaces><AllowMulticast>false</AllowMulticast>"
            "</General><Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>40</MaxAutoParticipantIndex>"
            "<Peers><Peer address='localhost'/></Peers></Discovery></Domain></CycloneDDS>")


class Peers(Runs):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        os.environ["CYCLONEDDS_URI"], os.environ["ROS_DOMAIN_ID"] = LOOPBACK, DOMAIN

    def peer(self, *arguments):
        process = subprocess.Popen([PEER, *map(str, arguments)], stdout=subprocess.PIPE, text=True)

        def end():
            process.kill()
            process.communicate()
        self.addCleanup(end)
        return process

    def run_dds(self, *flags, **keywords):
        """The run's report. Status 1: a release was lost."""
        done = subprocess.run(self.command(*flags, **keywords), capture_output=True, text=True, timeout=100)
        self.assertTrue(done.stdout, done.stderr)
        run = json.loads(done.stdout)["runs"][0]
        self.assertTrue(run["complete"], done.stdout)
        self.assertEqual(done.returncode, 1 if run["lost_activations"] else 0, done.stderr)
        return run

    def deployment(self, **transport):
        """Queues hold all that comes while the machine stands still."""
        return self.deploy(**QUEUES, transport=transport)


class Dds(Peers):
    def read(self, name):
        """{number: (age in us, bytes)} of what the peer heard."""
        with open(self.path(name)) as file:
            rows = [line.rstrip("\n").split(" ") for line in file if line.endswith("\n")]
        return {int(number): (int(age), bytes.fromhex(data)) for number, age, size, data in rows}

    def heard(self, name):
        """How many messages by now."""
        try:
            with open(self.path(name)) as file:
                return sum(line.endswith("\n") for line in file)
        except FileNotFoundError:
            return 0

    def hear(self, *flags):
        """The app's own source and two results, heard by the peers until each has 100 messages."""
        topics = ("src", "b", "c")
        for topic in topics:
            pathlib.Path(self.path(topic)).unlink(missing_ok=True)
        peers = {topic: self.peer("hear", "rt/" + topic, self.path(topic), 60) for topic in topics}
        run, results = self.run_until(lambda tool: min(self.heard(topic) for topic in topics) >= 100,
                                      *self.deployment(**{topic: "cyclonedds" for topic in topics}), *flags, period=10_000)
        for process in peers.values():
            process.communicate(timeout=60)
            self.assertEqual(process.returncode, 0)
        return run, results, {topic: self.read(topic) for topic in topics}

    def check_heard(self, run, results, heard):
        self.assertEqual(run["lost_activations"], 0)
        for topic, messages in heard.items():
            # Those before the two have found each other are missing, and what a busy machine loses; never the last.
            self.assertGreaterEqual(len(messages), 100, topic)
            self.assertEqual(max(messages), run["activations"] - 1, topic)
        for number, (age, data) in heard["c"].items():
            self.assertEqual(int.from_bytes(data, "little"), int(results["c"][str(number)]), number)
            self.assertTrue(0 <= age < 60_000_000, age)
        for number, (_, data) in heard["src"].items():
            self.assertEqual(len(data), 4096)
        self.assertEqual(len({data for _, data in heard["src"].values()}), len(heard["src"]))

    def test_what_is_heard_is_what_was_published(self):
        self.check_heard(*self.hear())

    def test_so_it_is_with_modules_in_processes_of_their_own(self):
        self.check_heard(*self.hear("--isolate"))

    def feed(self, messages, period_us, *flags, activations=100, app_period=10000):
        """The app is fed `messages` [(number, bytes)]; its report, results, and warnings."""
        with open(self.path("feed"), "w") as file:
            file.writelines(f"{number} 0 {len(data)} {data.hex()}\n" for number, data in messages)
        self.peer("feed", "rt/src", self.path("feed"), period_us)
        run = self.run_dds(*self.deployment(src="cyclonedds:feed"), *flags, period=app_period, activations=activations)
        self.assertEqual(run["activations"] + run["lost_activations"], activations, run)
        results = self.results()
        self.assertEqual((len(results["c"]), len(results["d"])), (run["activations"],) * 2)
        return run, results

    def test_what_is_fed_is_what_it_computes_with(self):
        _, _, heard = self.hear()
        blocks = [(number, data) for number, (_, data) in sorted(heard["src"].items())]
        known = {self.expected()["d"][str(number)] for number, _ in blocks if number < 1000}
        for flags in ((), ("--isolate",)):
            _, fed = self.feed(blocks, 20_000, *flags, activations=20, app_period=100_000)
            self.assertGreater(len(fed["d"]), 5)
            self.assertLessEqual(set(fed["d"].values()), known)

    def test_message_of_another_type_is_refused_and_told(self):
        good = bytes(range(256)) * 16
        run, results = self.feed([(k, good if k % 2 else b"short") for k in range(120)], 10_000, activations=30)
        self.assertRegex(" ".join(run["notes"]), "topic 'src' from DDS: [0-9]+ messages were refused")
        self.assertEqual(len(set(results["d"].values())), 1)

    def test_feeder_that_stops_costs_releases_not_the_run(self):
        run, results = self.feed([(k, bytes([k]) * 4096) for k in range(20)], 10_000, activations=40)
        self.assertGreater(run["lost_activations"], 0)
        self.assertLessEqual(len(set(results["d"].values())), 20)
        self.assertGreater(len(results["d"]), 0)

    def test_who_feeds_too_fast_is_told_what_was_not_used(self):
        run, _ = self.feed([(k, bytes([k % 250]) * 4096) for k in range(400)], 1_000, activations=20, app_period=20_000)
        self.assertRegex(" ".join(run["notes"]), "topic 'src' from DDS: [1-9][0-9]* messages were not used, a newer one came before")

    def test_listener_that_is_stopped_or_dead_holds_nobody_up(self):
        listener = self.peer("hear", "rt/src", self.path("stopped"), 60)
        other = self.peer("hear", "rt/src", self.path("dead"), 60)
        app = subprocess.Popen(self.command(*self.deployment(src="cyclonedds", a="cyclonedds"), period=5000, activations=250),
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.assertEqual(listener.stdout.readline(), "ready\n")
        self.assertEqual(other.stdout.readline(), "ready\n")
        listener.send_signal(signal.SIGSTOP)
        other.kill()
        out, err = app.communicate(timeout=60)
        run = json.loads(out)["runs"][0]
        # The queues hold all of them, so nothing is lost unless somebody waits for the listeners for ever.
        self.assertEqual((app.returncode, run["complete"], run["activations"]), (0, True, 250), out + err)

    def test_app_that_nobody_feeds_waits_until_it_is_told_to_stop(self):
        for flags in ((), ("--isolate",)):
            app = subprocess.Popen(self.command(*self.deployment(src="cyclonedds:feed"), *flags, activations=10),
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            wait_for("the app", lambda: activations(app), app)
            self.assertIsNone(app.poll())
            app.terminate()
            out, err = app.communicate(timeout=60)
            run = json.loads(out)["runs"][0]
            self.assertEqual((run["activations"], run["lost_activations"]), (0, 0), out + err)

    def test_module_that_dies_is_heard_again_when_it_is_back(self):
        pathlib.Path(self.path("c")).unlink(missing_ok=True)
        listener = self.peer("hear", "rt/c", self.path("c"), 60)
        run, _ = self.run_until(lambda tool: self.heard("c") and max(self.read("c")) > 60, *self.deployment(c="cyclonedds"),
                                "--isolate", "--restarts", 1, fault=("crash", "C", 20), period=10_000, status=1)
        listener.communicate(timeout=60)
        self.assertRegex(" ".join(run["notes"]), "the process of C died .* and was started again")
        self.assertGreater(max(self.read("c")), 60)

    def test_what_cannot_be_is_said_before_the_run(self):
        for transport, text in (({"zz": "cyclonedds"}, "transport of topic 'zz': the app has no such topic"),
                                ({"c": "cyclonedds:feed"}, "is published by a module, so it cannot be fed"),
                                ({"c": "pigeon"}, 'must be "cyclonedds" or "cyclonedds:feed"')):
            done = subprocess.run(self.command(*self.deployment(**transport)), capture_output=True, text=True, timeout=60)
            self.assertNotEqual(done.returncode, 0)
            self.assertIn(text, done.stderr)
        alone = shutil.copy(BIN / "testapp", self.path("alone"))  # where no plug-in is
        command = self.command(*self.deployment(c="cyclonedds"))
        command[command.index("--") + 1] = alone
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertIn("transport 'cyclonedds' is not there", done.stderr)
        self.assertIn("scripts/setup.sh transport", done.stderr)
        done = subprocess.run(self.command(*self.deployment(src="cyclonedds:feed"), "--lockstep"), capture_output=True, text=True,
                              timeout=60)
        self.assertIn("run without --lockstep", done.stderr)
        done = subprocess.run(self.command(*self.deployment(c="cyclonedds")), capture_output=True, text=True, timeout=60,
                              env={**os.environ, "ROS_DOMAIN_ID": "x"})
        self.assertIn("ROS_DOMAIN_ID is 'x'", done.stderr)


del Runs  # or its own tests would run here, too


class FedOneAtATime(Peers):
    """Without a rate a release waits for its message, however long, and for the end of the last one: none is lost."""

    @classmethod
    def files(cls, period, more=()):
        return super().files(0, more)

    def test_each_message_is_a_release_and_what_is_refused_costs_none(self):
        good = bytes(range(256)) * 16
        with open(self.path("feed"), "w") as file:  # more than are asked for: some are not heard, or not used
            for k in range(400):
                data = good if k % 2 else b"short"
                file.write(f"{k} 0 {len(data)} {data.hex()}\n")
        for flags in ((), ("--isolate",)):
            self.peer("feed", "rt/src", self.path("feed"), 10_000)
            run = self.run_dds(*self.deployment(src="cyclonedds:feed"), *flags, activations=20)
            self.assertEqual((run["activations"], run["lost_activations"]), (20, 0), run)
            self.assertRegex(" ".join(run["notes"]), "topic 'src' from DDS: [1-9][0-9]* messages were refused")
            results = self.results()
            for topic in "cd":
                self.assertEqual(sorted(map(int, results[topic])), list(range(20)))
            self.assertEqual(len(set(results["d"].values())), 1)


class FedByKeys(Peers):
    """Who feeds a run by keys gives it its grid, and cannot make it faster."""
    PERIOD_US, JITTER_US = 50_000, 20_000

    @classmethod
    def files(cls, period, more=()):
        """Of its app the rate and the jitter, and keys for them."""
        flags = super().files(period, more)
        app, policy = pathlib.Path(flags[1]), pathlib.Path(flags[3])
        of_keys = json.loads(app.read_text())
        if of_keys["sources"] != (sources := [{"name": "src", "period_us": cls.PERIOD_US, "jitter_us": cls.JITTER_US}]):
            app.write_text(json.dumps({**of_keys, "sources": sources}))
            done = xauto("solve", "--app", app, "--platform", cls.path("platform.json"), "--time-limit", "10s",
                         "--max-evaluations", 200, "--out", policy)
            assert done.returncode == 0, done.stderr
        return flags

    def feed_by_keys(self, period_us, count, *flags, activations=30):
        """The run's report, what it says is broken, and how long it was fed, in s."""
        with open(self.path("feed"), "w") as file:
            file.writelines(f"{k} 0 4096 {bytes([k % 250]).hex() * 4096}\n" for k in range(count))
        self.peer("feed", "rt/src", self.path("feed"), period_us)
        began = time.monotonic()
        run = self.run_dds(*self.deployment(src="cyclonedds:feed"), *flags, period=self.PERIOD_US, activations=activations)
        return run, " ".join(run["claims"]["broken"]), time.monotonic() - began

    def test_who_feeds_gives_the_grid(self):
        for flags in ((), ("--isolate",)):
            run, broken, _ = self.feed_by_keys(self.PERIOD_US, 60, *flags)
            # A message is a release; where the machine stands still, some are left out, and lost by number.
            left_out = int((re.findall("source 'src' left out ([0-9]+) of", broken) or [0])[0])
            modules = {m["name"]: m for m in run["modules"]}
            self.assertGreaterEqual(modules["D"]["activations"], 20)
            self.assertEqual([modules[m]["dropped"] for m in "ABCD"], [left_out] * 4, run)
            self.assertNotIn("as they come", broken)
            numbers = sorted(int(k) for k in self.results()["d"])
            self.assertEqual(len(numbers), modules["D"]["activations"])
            # What was left out before the first or behind the last result is in no gap.
            between = numbers[-1] - numbers[0] + 1 - modules["D"]["activations"]
            self.assertTrue(0 <= between <= left_out, (numbers, left_out))

    def test_who_stops_feeding_costs_releases_not_the_run(self):
        run, broken, _ = self.feed_by_keys(self.PERIOD_US, 15)
        self.assertRegex(broken, "source 'src' left out [0-9]+ of 30 releases")
        self.assertEqual(run["activations"] + run["lost_activations"], 30)
        self.assertGreaterEqual(run["lost_activations"], 15)

    def test_who_feeds_too_fast_is_slowed_down(self):
        run, broken, took_s = self.feed_by_keys(1_000, 6000, activations=30)
        # 30 of them at their period, less the jitter, wherever it begins.
        self.assertGreater(took_s, (29 * self.PERIOD_US - self.JITTER_US) * 1e-6)
        self.assertIn("off its grid", broken)
        self.assertRegex(" ".join(run["notes"]), "topic 'src' from DDS: [1-9][0-9]* messages were not used, a newer one came before")
        self.assertEqual(run["modules"][0]["failed"], 0)


if __name__ == "__main__":
    if not PEER.exists() or not PLUGIN.exists():
        print("skipped: built without Cyclone DDS (scripts/setup.sh transport, then build again)")
        sys.exit(77)
    unittest.main()
