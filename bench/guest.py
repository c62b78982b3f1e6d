# SPDX-License-Identifier: Apache-2.0
"""Runs commands in a guest that keeps time, whatever this machine does.

QEMU counts the guest's instructions (2 ns each) for its clock and jumps over idle time (scripts/vm/run-vm.sh, VM_ICOUNT). So a
thread that wakes up late, a stall, or a neighbour's load do not exist in there, and a run is the same every time. What a job
costs in dispatch does exist: it is that of a CPU of 500 million instructions a second.
"""
import os
import pathlib
import shlex
import subprocess
import tempfile

SOURCE = pathlib.Path(__file__).resolve().parents[1]
PROGRAMS = ("bin/xauto", "bin/xauto-coordinator", "bin/xauto-emud", "bin/xauto-standin")


def run(build, files, commands, limit_s=3600, cpus=1, icount=1):
    """Executes `commands` (lists of words) one after the other in folder /case, which holds `files` (name there: path here).

    Programs are in PATH: PROGRAMS. `icount`: an instruction lasts 2^icount ns. Returns what `subprocess.run` would, of each command.
    """
    kernel = subprocess.run([SOURCE / "scripts/vm/fetch-kernel.sh", "7.x"], check=True, capture_output=True,
                            text=True).stdout.strip()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        (folder / "run").write_text("#!/bin/sh\ncd /case\n" + "".join(
            f"{shlex.join(map(str, command))} >/tmp/out 2>/tmp/err\nstatus=$?\n"
            f"echo; echo =out {n}; cat /tmp/out; echo; echo =err {n}; cat /tmp/err; echo; echo =end {n} $status\n"
            for n, command in enumerate(commands)))
        (folder / "run").chmod(0o755)
        subprocess.run([SOURCE / "scripts/vm/mk-initrd.sh", folder / "initrd", f"{folder}/run:/tests/run",
                        *(f"{pathlib.Path(build).resolve()}/{program}" for program in PROGRAMS),
                        *(f"{path}:/case/{name}" for name, path in files.items())], check=True, stdout=subprocess.DEVNULL)
        status = subprocess.run([SOURCE / "scripts/vm/run-vm.sh", kernel, folder / "initrd", folder / "log"],
                                env={**os.environ, "VM_ICOUNT": str(icount), "VM_CPUS": str(cpus), "VM_LIMIT_S": str(limit_s)}).returncode
        log = (folder / "log").read_text(errors="replace")
    done = []
    for n, command in enumerate(commands):
        try:
            out, rest = log.split(f"\n=out {n}\n", 1)[1].split(f"\n=err {n}\n", 1)
            err, rest = rest.split(f"\n=end {n} ", 1)
            done.append(subprocess.CompletedProcess(command, int(rest.split()[0]), out, err))
        except (IndexError, ValueError):
            why = "took too long" if status == 124 else f"ended with status {status}"
            done.append(subprocess.CompletedProcess(command, 125, "", f"the guest {why}: {log[-300:]}"))
    return done
