# SPDX-License-Identifier: Apache-2.0
"""Where things are, and how to call them. Environment: XAUTO_BIN (set by ctest), else build/bin."""
import os
import pathlib
import subprocess

SOURCE = pathlib.Path(__file__).resolve().parents[2]
BIN = pathlib.Path(os.environ.get("XAUTO_BIN", SOURCE / "build/bin"))
XAUTO = str(BIN / "xauto")
DRIVING = str(BIN / "driving")
APP = str(SOURCE / "examples/driving/app.json")


def xauto(*arguments, cwd=None, timeout=120, stdin=None):
    """Runs the tool to its end."""
    return subprocess.run([XAUTO, *map(str, arguments)], cwd=cwd, timeout=timeout, capture_output=True,
                          text=True, input=stdin, errors="replace")


def children_of(pid):
    """All living descendants: {pid: command name}."""
    parent, name = {}, {}
    for entry in pathlib.Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            stat = (entry / "stat").read_text()
        except OSError:
            continue
        open_, close = stat.index("("), stat.rindex(")")
        fields = stat[close + 2:].split()
        if fields[0] == "Z":
            continue
        parent[int(entry.name)] = int(fields[1])
        name[int(entry.name)] = stat[open_ + 1:close]
    found, front = {}, [pid]
    while front:
        at = front.pop()
        for child, mother in parent.items():
            if mother == at:
                found[child] = name[child]
                front.append(child)
    return found


def alive(pid):
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
