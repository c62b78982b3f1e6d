#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""An app over two computers, each a network and a time namespace of this machine, for many releases: what was longer than claimed, what X
broke. Needs root, and a machine that does nothing else.
usage: soak.py BUILD_DIR RELEASES PERIOD_MS X_MS        prints one JSON object"""
import json
import os
import pathlib
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
if len(sys.argv) != 5:
    sys.exit(__doc__)
os.environ.setdefault("XAUTO_BIN", str(pathlib.Path(sys.argv[1]).resolve() / "bin"))
sys.path.insert(0, str(ROOT / "tests/integration"))
import parts_test  # noqa: E402


class Soak(parts_test.Parts):
    def runTest(self):
        releases, period_ms, x_ms = map(int, sys.argv[2:])
        self.solve(parts_test.TWO, x_ms=x_ms, period_ms=period_ms)
        processes = {host: self.start(host, activations=releases) for host in ("rear", "front")}
        for process in processes.values():
            process.wait(timeout=2 * releases * period_ms / 1000 + 60)
        front = {host: self.ended(host, process) for host, process in processes.items()}["front"]
        print(json.dumps({"releases": releases, "period_ms": period_ms, "x_ms": x_ms, "crossings": front["crossings"],
                          "chains": [{k: c.get(k) for k in ("name", "results", "lost", "worst_case_us", "latency_us", "exceeded")} for c in front["chains"]],
                          "claims": {k: front["claims"].get(k) for k in ("verdict", "broken", "exceeded")}}))


if __name__ == "__main__":
    Soak.setUpClass()
    try:
        test = Soak()
        test.setUp()
        try:
            test.runTest()
        finally:
            test.doCleanups()
    finally:
        Soak.doClassCleanups()
