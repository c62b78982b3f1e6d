#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""No line of a Markdown file is above 120 columns, unless it cannot be broken: a table's row, code and what a program
printed, a single word (a link). Usage: scripts/check-doc-lines.py [FILE...], by default all that git knows."""
import pathlib
import subprocess
import sys

COLUMNS = 120
ROOT = pathlib.Path(__file__).resolve().parents[1]


def too_long(text):
    """(number, columns) of each line that could be broken and is too long."""
    found, fenced, indented, before = [], False, False, ""
    for number, line in enumerate(text.split("\n"), 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        indented = line.startswith("    ") and (indented or not before.strip())
        before = line
        words = line.split()
        breakable = len(words) > 1 and not (words[0] in ("-", "*") and len(words) == 2)
        if len(line) > COLUMNS and breakable and not (fenced or indented or line.startswith("|")):
            found.append((number, len(line)))
    return found


def test():
    long = "word " * 30
    assert too_long(long) == [(1, 150)]
    assert too_long("x\n" + long) == [(2, 150)]
    assert too_long("- " + long) == [(1, 152)]
    assert too_long("text\n    " + long) == [(2, 154)]  # goes on with a paragraph: no code
    for fine in ("| " + long, "```\n" + long + "\n```", "\n    " + long, "- " + "x" * 150, "µ" * 60 + " " + "µ" * 59):
        assert too_long(fine) == [], fine
    assert too_long("```\n```\n" + long) == [(3, 150)]


def main():
    test()
    files = sys.argv[1:] or subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True,
                                           check=True).stdout.split()
    bad = [(file, *line) for file in files for line in too_long((ROOT / file).read_text())]
    for file, number, columns in bad:
        print(f"{file}:{number}: {columns} columns, {COLUMNS} at most")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
