# SPDX-License-Identifier: Apache-2.0
"""What a page of measurements says of where they were made."""
import datetime
import os
import pathlib
import platform
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[1]


def text_of(*command):
    try:
        return subprocess.run(command, capture_output=True, text=True, cwd=ROOT).stdout.strip()
    except OSError:
        return ""


def machine():
    info = pathlib.Path("/proc/cpuinfo").read_text()
    model = next((line.split(":", 1)[1].strip() for line in info.splitlines() if line.startswith("model name")),
                 platform.machine())
    virtual = text_of("systemd-detect-virt", "--vm").replace("none", "") or ("yes" if "hypervisor" in info else "none seen")
    memory = int(pathlib.Path("/proc/meminfo").read_text().split()[1]) // 1024
    changed = text_of("git", "status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs")
    return [("CPU", f"{model}, {os.cpu_count()} cores"), ("memory", f"{memory} MiB"), ("virtual machine", virtual),
            ("kernel", platform.release()), ("compiler", text_of("c++", "--version").split("\n")[0]),
            ("revision", (text_of("git", "rev-parse", "--short", "HEAD") or "unknown") + (", with changes" if changed else "")),
            ("date", datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%d %H:%M UTC"))]
