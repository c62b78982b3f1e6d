#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Reads tests/golden/errors/<format>.txt: what each case is made of, and the message that it must give (README.md).

usage: cases.py FOLDER           writes FOLDER/<format>/<file> and FOLDER/messages/<format>/<case>
       cases.py --update BUILD   writes into the cases what the programs of the folder BUILD say; read the diff"""
import itertools
import json
import os
import pathlib
import shutil
import sqlite3
import subprocess
import sys

import mcap_parts

HERE = pathlib.Path(__file__).resolve().parent
FORMATS = sorted(file.stem for file in HERE.glob("*.txt"))
SUFFIXES = {"mcap": ".mcap", "recording": ".db3"}


class Case:
    def __init__(self, format_, name, data, message, is_sql):
        self.name, self.file, self.data, self.message = name, name + SUFFIXES.get(format_, ".json"), data, message
        self.is_sql = is_sql

    def write(self, folder):
        path = pathlib.Path(folder) / self.file
        if not self.is_sql:
            path.write_bytes(self.data)
            return
        database = sqlite3.connect(path)
        database.executescript("PRAGMA synchronous=OFF;" + self.data.decode())
        database.close()


def changed(text, lines, where):
    """`text` after the changes that `lines` of a case say."""
    before = after = b""  # what a change leaves as it is: nothing, where it does not say what it replaces
    for sign, run in itertools.groupby(lines, lambda line: line[0]):
        content = "\n".join(line[2:] for line in run)
        if sign == "-":
            if text.count(content.encode()) != 1:
                raise ValueError(f"{where}: is {text.count(content.encode())} times in the base, not once:\n{content}")
            before, after = text.split(content.encode())
            text = before + after
        elif sign in "+=":
            new = eval(f"({content})", {"base": text, "json": json, **vars(mcap_parts)}) if sign == "=" else content.encode()
            text = before + new + after
            before = after = b""
        elif sign != "!":
            raise ValueError(f"{where}: a line begins with none of - + = !: {sign}{content}")
    return text


def blocks(format_):
    return [block.split("\n") for block in (HERE / f"{format_}.txt").read_text("utf-8").strip("\n").split("\n\n")]


def cases(format_):
    found = {}
    for first, *lines in blocks(format_):
        where = f"{format_}.txt: {first}"
        if first.startswith("@"):
            name = first[2:]
            base = changed((HERE.parent / name).read_bytes() if name else b"", lines, where)
            continue
        if first in found:
            raise ValueError(f"{where}: is there twice")
        message = "".join(line[2:] + "\n" for line in lines if line[0] == "!")
        found[first] = Case(format_, first, changed(base, lines, where), message, name.endswith(".sql"))
    return list(found.values())


def write(folder):
    for format_ in FORMATS:
        inputs, messages = folder / format_, folder / "messages" / format_
        for place in (inputs, messages):
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir(parents=True)
        for case in cases(format_):
            case.write(inputs)
            (messages / case.name).write_text(case.message, "utf-8")


def update(build):
    for program in ("test_model", "test_record"):
        subprocess.run([build / "tests" / program, "--gtest_filter=*.EveryMalformed*"], check=True,
                       env={**os.environ, "XAUTO_UPDATE_GOLDEN": "1"})
    for format_ in FORMATS:
        written = []
        for first, *lines in blocks(format_):
            said = build / "tests/errors/messages" / format_ / first
            if not first.startswith("@"):
                lines = [line for line in lines if line[0] != "!"] + ["! " + line for line in said.read_text("utf-8").splitlines()]
            written.append("\n".join([first, *lines]))
        (HERE / f"{format_}.txt").write_text("\n\n".join(written) + "\n", "utf-8")


if __name__ == "__main__":
    if len(sys.argv) == 3 and sys.argv[1] == "--update":
        update(pathlib.Path(sys.argv[2]))
    elif len(sys.argv) == 2:
        write(pathlib.Path(sys.argv[1]))
    else:
        sys.exit(__doc__)
