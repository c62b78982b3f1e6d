#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Counts the tests of `ctest -L area` by gtest's own reports, for scripts/check.sh.

  count-areas.py JUNIT LOG DIRECTORY   JUNIT: ctest's report; LOG: what it printed; DIRECTORY: gtest's, AREA.xml

Prints "PASSED SKIPPED FAILED AREA|AREA": of areas that passed, and which areas to run again, each test by itself. FAILED counts areas
in which a sanitizer reported something: that is a failure, whatever a second run says. Prints nothing if no area ran."""
import os
import re
import sys
import xml.etree.ElementTree as xml

REPORTED = re.compile(r"^.*(?:WARNING: ThreadSanitizer|ERROR: \w+Sanitizer|: runtime error: ).*$", re.M)


def of_area(path):
    """Passed and skipped tests of one gtest report; None if it is none, one failed, or none ran to its end."""
    try:
        cases = xml.parse(path).getroot().findall("testsuite/testcase")
    except (OSError, xml.ParseError):
        return None
    if any(case.find("failure") is not None for case in cases):
        return None
    skipped = sum(case.get("result") == "skipped" for case in cases)
    passed = sum(case.get("result") == "completed" for case in cases)
    return (passed, skipped) if passed or skipped else None


def main(junit, log, directory):
    try:
        ran = xml.parse(junit).getroot().findall("testcase")
    except (OSError, xml.ParseError):
        return
    if not ran:
        return
    passed = skipped = 0
    again = []
    for case in ran:
        area = case.get("name").removeprefix("area.")
        counts = of_area(os.path.join(directory, area + ".xml"))
        if case.get("status") != "run" or counts is None:
            again.append(area)
            continue
        passed += counts[0]
        skipped += counts[1]
    with open(log, errors="replace") as file:
        text = file.read()
    for name in sorted(set(re.findall(r"^\[  FAILED  \] (\w+\.[\w/]+)", text, re.M))):
        print(f"check: {name} failed beside the others of its area", file=sys.stderr)
    reported = REPORTED.findall(text) if again else []
    if reported:
        print("check: a sanitizer's report counts, whatever the second run says: " + reported[0], file=sys.stderr)
    print(passed, skipped, len(reported[:1]), "|".join(again))


main(*sys.argv[1:])
