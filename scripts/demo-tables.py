#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The demo's last table: two report.json of one app under one emulation script, and what the tables did."""
import json
import sys


def ms(us):
    return f"{'-':>8}" if us is None else f"{us / 1000:8.2f}"


def main():
    print(f"  {'measured, one run each, ms':32}{'p50':>8}{'p99':>8}{'max':>8}{'lost':>7}{'n':>6}")
    for words, path in zip(("one policy", "tables"), sys.argv[1:]):
        with open(path, encoding="utf-8") as file:
            run = json.load(file)["runs"][0]
        lost, n = run["lost_activations"], run["activations"] - run["lost_activations"]
        print(f"  {words:32}{ms(run['p50_us'])}{ms(run['p99_us'])}{ms(run['max_us'])}{lost:>7}{n:>6}")
        for change in run.get("switches", [])[:3]:
            why = change["detail"] or change["why"]
            print(f"    from release {change['release']} on: {change['table']}, for '{change['to']}': {why}")


if __name__ == "__main__":
    main()
