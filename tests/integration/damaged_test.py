# SPDX-License-Identifier: Apache-2.0
"""Recordings that a clock, a bad record or a full disk has spoilt: what is told of them, what of them is had, how a replay gets over a
gap. And a module that is told to skip."""
import json
import os
import pathlib
import signal
import subprocess
import unittest

import mcap_file as M
from common import QUEUES, wait_for, xauto
from isolate_test import Case as Runs
from mcap_test import MESSAGE_SCHEMA, block, enclose

T, MS = 1_700_000_000_000_000_000, 1_000_000


FRONT = M.MAGIC + M.header() + M.schema(1, "xauto_msgs/msg/Message", data=MESSAGE_SCHEMA) + M.channel(1, 1, "/src")


def bag(times):
    """testapp's first messages, at these times, in one chunk; not closed by its recorder."""
    records = b"".join(M.message(1, t, enclose(min(t, T), k, block(k)), k) for k, t in enumerate(times))
    return FRONT + M.chunk(records, times=[min(times), min(max(times), T + 10**12)])


class Damaged(Runs):
    def write(self, name, data):
        path = pathlib.Path(self.path(name))
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        return str(path)

    def test_one_bad_stamp_does_not_cost_the_others(self):
        path = self.write("a.mcap", bag([2**64 - 5 if k == 10 else T + k * 10 * MS for k in range(20)]))
        told = xauto("recording", "check", path)
        self.assertEqual(told.returncode, 1, told.stderr)
        self.assertIn("18446744073709551611", told.stderr)
        self.assertIn("19 messages can be read", told.stdout)
        for out in ("b.mcap", "b"):
            mended = xauto("recording", "repair", path, self.path(out), "--json")
            self.assertEqual(mended.returncode, 0, mended.stderr)
            self.assertEqual(json.loads(mended.stdout)["messages"], 19)
            self.assertIn("18446744073709551611", mended.stderr)
            whole = xauto("recording", "check", self.path(out))
            self.assertEqual((whole.returncode, "all 19 messages" in whole.stdout), (0, True), whole.stdout + whole.stderr)
        # OUT is never overwritten, and never a part of IN.
        again = xauto("recording", "repair", path, self.path("b.mcap"))
        self.assertEqual(again.returncode, 2)
        self.assertIn("exists already", again.stderr)
        inside = xauto("recording", "repair", self.path("b"), self.path("b/c.mcap"))
        self.assertEqual((inside.returncode, os.path.exists(self.path("b/c.mcap"))), (2, False), inside.stderr)
        self.assertEqual(xauto("recording", "repair", path).returncode, 2)
        self.assertEqual(xauto("recording", "check", path, self.path("b.mcap")).returncode, 2)
        nothing = xauto("recording", "repair", self.write("none.mcap", b"no recording"), self.path("d.mcap"))
        self.assertEqual((nothing.returncode, os.path.exists(self.path("d.mcap"))), (2, False), nothing.stderr)

    def test_a_damaged_file_of_a_folder_is_told(self):
        whole = bag([T + i * 10 * MS for i in range(10)]) + M.record(M.DATA_END, bytes(4)) + M.record(M.FOOTER, bytes(20)) + M.MAGIC
        for at in range(3):
            for damaged in (b"", M.MAGIC, FRONT, whole[:len(whole) - 100], b"no recording"):
                for i in range(3):
                    self.write(f"bag/bag_{i}.mcap", damaged if i == at else whole)
                told = xauto("recording", "check", self.path("bag"))
                self.assertEqual(told.returncode, 1, (at, damaged[:10], told.stdout))
                self.assertIn(f"bag_{at}.mcap", told.stderr)

    def test_a_gap_is_told_and_a_replay_gets_over_it(self):
        times = [30_000 * MS + i * 100 * MS for i in range(5)] + [T + i * 100 * MS for i in range(10)]
        path = self.write("gap.mcap", bag(times))
        told = xauto("recording", "check", path)
        self.assertIn("after message 5: 53.9 years without a message, from 1970-01-01 00:00:30.400", told.stderr)
        self.assertEqual(len(json.loads(xauto("recording", "info", path, "--json").stdout)["gaps"]), 1)
        flags = ["--input", path, "--rate", "10", *self.deploy(**QUEUES)]
        run, _ = self.run_app(*flags, "--max-gap", "0.2s", activations=0)
        self.assertEqual((run["activations"], run["lost_activations"]), (15, 0))
        self.assertTrue(any("53.9 years" in note for note in run["notes"]), run["notes"])
        # Without it the run waits, and says for what.
        with open(self.path("err"), "w+") as err:
            tool = subprocess.Popen(self.command(*flags, activations=0), stdout=subprocess.DEVNULL, stderr=err)
            wait_for("what it waits for", lambda: "53.9 years" in pathlib.Path(self.path("err")).read_text(), tool)
            tool.send_signal(signal.SIGINT)
            tool.wait(timeout=60)
        self.assertIn("--max-gap", pathlib.Path(self.path("err")).read_text())
        for refused in (["--max-gap", "1s"], ["--input", path, "--rate", "2", "--lockstep"], ["--input", path, "--max-gap", "1s", "--period", "500us"]):
            done = subprocess.run(self.command(*refused), capture_output=True, text=True)
            self.assertEqual(done.returncode, 2, done.stderr)

    def test_what_is_told_to_skip_is_no_loss_and_counted(self):
        """D, which waits for nobody else, takes 3 ms, and a release comes each ms."""
        told = {"modules": {"D": {"overload": "skip"}}}
        for content, flags in ((told, []), ({}, ["--overload", "D=skip"]), (told, ["--isolate"])):
            flags = [*flags, *self.deploy(**QUEUES, **content)]
            run, _ = self.run_app(*flags, "--fail-on", "lost", fault=("slow", "D", 0, 3), period=1000, activations=200)
            counts = {m["name"]: m for m in run["modules"]}
            self.assertEqual((run["lost_activations"], counts["D"]["dropped"]), (0, 0), counts)
            self.assertGreater(counts["D"]["skipped"], 0)
            self.assertEqual(counts["D"]["activations"] + counts["D"]["skipped"], 200)

    def test_what_is_lost_for_another_reason_is_lost(self):
        run, _ = self.run_app("--overload", "A=skip", "--lockstep", "--fail-on", "lost", fault=("throw", "A", 7), status=1)
        self.assertEqual(run["lost_activations"], 1)


if __name__ == "__main__":
    unittest.main()
