# SPDX-License-Identifier: Apache-2.0
"""A job that its policy holds begins before its planned start where the reason for that has gone, and not where it has
not. Two jobs on one GPU that nobody can preempt: the lidar's takes 8 ms, and the camera's is held until 15 ms after its
release, so that it cannot be in the lidar's way. The trace is read by pftrace.py."""
import json
import pathlib
import tempfile
import unittest

import pftrace
from common import BIN, QUEUES, xauto

HOLD_US = 15_000
KEYS = {"camera.run": 19_500, "lidar.run": 10_000}


class Early(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        cls.write("platform", {"schema": "xauto.platform", "version": 1, "name": "one",
                               "xpus": [{"id": "gpu0", "type": "gpu", "preemptive": False}]})
        cls.write("queues", {"schema": "xauto.deployment", "version": 1, "app": "urgentapp", **QUEUES})

    @classmethod
    def write(cls, name, document):
        (cls.folder / f"{name}.json").write_text(json.dumps(document))

    def tool(self, verb, *more):
        return xauto(verb, "--app", self.folder / "app.json", "--platform", self.folder / "platform.json", *more)

    def run_app(self, *flags, lidar_offset_us=0, polled=("polled",)):
        """The report, and {activation: (camera began, lidar ended)} in us since the nominal release of the camera."""
        source = {"period_us": 20_000, "jitter_us": 1000}
        self.write("app", {"schema": "xauto.app", "version": 3, "name": "urgentapp", "edges": [],
                           "sources": [{"name": "camera", **source},
                                       {"name": "lidar", **source, "offset_us": lidar_offset_us}],
                           "xnodes": [{"name": f"{n}.run", "module": f"{n}M", "source": n, "wcet_us": {"gpu": us}}
                                      for n, us in (("camera", 3500), ("lidar", 8500))]})
        done = self.tool("solve", "--max-evaluations", 300, "--threads", 1, "--time-limit", "60s",
                         "--out", self.folder / "policy.json")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        policy = json.loads((self.folder / "policy.json").read_text())
        for row in policy["xnodes"]:
            for unused in ("hold_us", "start_us", "finish_us"):
                row.pop(unused, None)
            row["key_us"] = [KEYS[row["name"]]]
        policy["xnodes"][0]["hold_us"] = [HOLD_US]
        for chain, name in zip(policy["chains"], KEYS):
            chain.update(worst_case_us=KEYS[name], lower_bound_us=0, optimal=False)
        self.write("policy", policy)
        done = self.tool("check", "--policy", self.folder / "policy.json")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        done = self.tool("run", "--policy", self.folder / "policy.json", "--emulate", "--json", "--deployment",
                         self.folder / "queues.json", "--duration", "3s", "--trace-out", self.folder / "t.pftrace", *flags,
                         "--", BIN / "urgentapp", "1000000", *polled)
        self.assertEqual(done.returncode, 0, done.stderr)
        trace = pftrace.Trace((self.folder / "t.pftrace").read_bytes())
        start = min(s.begin for s in trace.slices if s.category == "release")
        seen = {}
        self.told = []
        for s in trace.slices:
            if s.category != "run":
                continue
            n, camera = s.args["release"], s.name.startswith("camera")
            at = (s.begin if camera else s.end) - start - n * 20_000_000
            seen.setdefault(n, [None, None])[0 if camera else 1] = at / 1000
            if camera:
                self.told.append(s.args.get("held_us", 0))
        return json.loads(done.stdout)["runs"][0], {n: tuple(at) for n, at in seen.items() if None not in at}

    def test_a_hold_ends_when_its_reason_has_gone(self):
        run, seen = self.run_app()
        self.assertGreater(len(seen), 100)
        for n, (began, ended) in seen.items():
            self.assertGreaterEqual(began, min(ended, HOLD_US), f"activation {n} began before the lidar's had ended")
        early = [began for began, ended in seen.values() if began < HOLD_US - 1000]
        # A machine that stands still has fewer; without early start there is none.
        self.assertGreater(len(early), 20)
        self.assertGreaterEqual(run["early_starts"]["jobs"], len(early))
        self.assertGreaterEqual(run["early_starts"]["sum_us"], 1000 * len(early))
        self.assertGreater(max(self.told), 5000, "the trace does not tell that it was held")

    def test_a_smaller_key_that_is_still_to_come_is_waited_for(self):
        """The lidar's is released 5 ms after the camera's, and has its key before the camera's."""
        run, seen = self.run_app(lidar_offset_us=5000)
        self.assertGreater(len(seen), 100)
        for n, (began, ended) in seen.items():
            self.assertGreaterEqual(began, min(ended, HOLD_US), f"activation {n} began before the lidar's, which was to come")

    def test_so_does_one_where_sensors_publish_by_themselves(self):
        run, seen = self.run_app(polled=())
        self.assertGreater(run["early_starts"]["jobs"], 20)
        # The grid moves with what comes, so a release of it is only roughly where the first one has it.
        early = [began for began, ended in seen.values() if ended <= began < HOLD_US - 1000]
        self.assertGreater(len(early), 20)

    def test_where_not_all_is_known_holds_are_waited_for(self):
        run, seen = self.run_app("--isolate")
        self.assertNotIn("early_starts", run)
        for n, (began, _) in seen.items():
            self.assertGreaterEqual(began, HOLD_US, f"activation {n}")


if __name__ == "__main__":
    unittest.main()
