#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Counts what ctest ran, for scripts/check.sh.

  count-tests.py BUILD [DIRECTORY]   BUILD has ctest's report, junit.xml, and what it printed, ctest.log; DIRECTORY: gtest's
                                     reports, AREA.xml

Prints "PASSED FAILED SKIPPED NAME|NAME": those names are to run again, and are in no count. Where a sanitizer reported something they
have failed, whatever a second run would say: FAILED counts them, and their names follow, one a line. A test that said why it does not
run here is skipped; one that did not run for any other reason is to run again.

With DIRECTORY each of ctest's tests is an area, whose tests gtest has counted; those of an area to run again are in no count. FAILED
is 1 if a sanitizer reported something there."""
import os
import re
import sys
import xml.etree.ElementTree as xml

REPORTED = re.compile(r"^.*(?:WARNING: ThreadSanitizer|ERROR: \w+Sanitizer|: runtime error: ).*$", re.M)


def cases_of(path, where):
    """The test cases of a report; none if it is none."""
    try:
        return xml.parse(path).getroot().findall(where)
    except (OSError, xml.ParseError):
        return []


def sanitizer_reported(log):
    reported = REPORTED.findall(log)
    if reported:
        print("check: a sanitizer's report counts, whatever the second run says: " + reported[0], file=sys.stderr)
    return bool(reported)


def passed_of(cases):
    return {c.get("name") for c in cases if c.get("status") == "run" and c.find("failure") is None}


def count_tests(cases, log):
    passed = passed_of(cases)
    said = {c.get("name"): c.find("skipped") for c in cases if c.get("status") == "notrun"}
    skipped = {name for name, s in said.items() if s is not None and s.get("message", "").startswith("SKIP_")}
    bad = [c.get("name") for c in cases if c.get("name") not in passed | skipped]
    if bad and sanitizer_reported(log):
        print(len(passed), len(bad), len(skipped))
        print("".join(name + "\n" for name in bad), end="")
    else:
        print(len(passed), 0, len(skipped), "|".join(bad))


def count_areas(cases, log, directory):
    passed = skipped = 0
    again = []
    good = passed_of(cases)
    for name in sorted(c.get("name") for c in cases):
        area = name.removeprefix("area.")
        results = [c.get("result") for c in cases_of(os.path.join(directory, area + ".xml"), "testsuite/testcase")]
        done, out = results.count("completed"), results.count("skipped")
        if name not in good or done + out == 0:
            again.append(area)
            continue
        passed += done
        skipped += out
    for name in sorted(set(re.findall(r"^\[  FAILED  \] (\w+\.[\w/]+)", log, re.M))):
        print(f"check: {name} failed beside the others of its area", file=sys.stderr)
    reported = bool(again) and sanitizer_reported(log)
    print(passed, int(reported), skipped, "|".join(again))
    if reported:
        print("a sanitizer's report")


def main(build, directory=None):
    cases = cases_of(os.path.join(build, "junit.xml"), "testcase")
    with open(os.path.join(build, "ctest.log"), errors="replace") as file:
        text = file.read()
    if directory is None:
        count_tests(cases, text)
    else:
        count_areas(cases, text, directory)


main(*sys.argv[1:])
