#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""What a host's load does to messages between hosts: a hog of ordinary priority on each core, DDS's threads with their priority and, in turns,
without (tests/integration/apps/clock_shift.c refuses it to them). Needs root, and a machine that does nothing else.
usage: load.py BUILD_DIR RELEASES PERIOD_MS X_MS TIMES        prints a JSON object per run, and one of all"""
import json
import os
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
if len(sys.argv) != 6:
    sys.exit(__doc__)
os.environ.setdefault("XAUTO_BIN", str(pathlib.Path(sys.argv[1]).resolve() / "bin"))
sys.path.insert(0, str(ROOT / "tests/integration"))
import parts_test  # noqa: E402

HOG = "import os, sys; os.sched_setaffinity(0, {int(sys.argv[1])})\nwhile True: pass"


def quantiles(ways):
    return {"messages": len(ways), **{f"p{q}_us": ways[len(ways) * q // 100] for q in (50, 90, 99)}, "max_us": ways[-1]}


class Load(parts_test.Parts):
    def one(self, ordinary):
        """Messages of one run: how many were not there by X, and each one's way, from the end of a2 to the begin of c1, by both traces."""
        releases, period_ms, x_ms = map(int, sys.argv[2:5])
        self.setUp()
        try:
            self.solve(parts_test.TWO, x_ms=x_ms, period_ms=period_ms)
            before = ("env", f"LD_PRELOAD={parts_test.SHIFT}", "XAUTO_TEST_ORDINARY=1") if ordinary else ()
            processes = {host: self.start(host, activations=releases, before=before, more=("--trace-out", f"{host}.pftrace")) for host in ("rear", "front")}
            for process in processes.values():
                process.wait(timeout=2 * releases * period_ms / 1000 + 60)
            crossing, = {host: self.ended(host, process) for host, process in processes.items()}["front"]["crossings"]
            traces = {host: parts_test.Trace((self.at / f"{host}.pftrace").read_bytes()).on("run", "run") for host in processes}
        finally:
            self.doCleanups()
        sent = {flow: s.end for s in traces["front"] for flow in s.flows_out if flow >> 63}
        ways = sorted((s.begin - sent[flow]) // 1000 for s in traces["rear"] for flow in s.flows_in if flow in sent and flow >> 63)
        return {"ordinary": ordinary, "lost": crossing["lost"], "way_us": ways}

    def runTest(self):
        hogs = [subprocess.Popen([sys.executable, "-c", HOG, str(core)]) for core in sorted(os.sched_getaffinity(0))]
        runs = []
        try:
            for _ in range(int(sys.argv[5])):
                for ordinary in (False, True):
                    runs.append(self.one(ordinary))
                    print(json.dumps({"ordinary": ordinary, "lost": runs[-1]["lost"], **quantiles(runs[-1]["way_us"])}), flush=True)
        finally:
            for hog in hogs:
                hog.kill()
                hog.wait()
        of = {ordinary: [run for run in runs if run["ordinary"] == ordinary] for ordinary in (False, True)}
        print(json.dumps({"ordinary" if ordinary else "priority": {"lost": sum(r["lost"] for r in list_), **quantiles(sorted(sum((r["way_us"] for r in list_), [])))}
                          for ordinary, list_ in of.items()}))


if __name__ == "__main__":
    Load.setUpClass()
    try:
        Load().runTest()
    finally:
        Load.doClassCleanups()
