# SPDX-License-Identifier: Apache-2.0
"""What XAuto writes, for looking at it: report.json, policy.json and traces (.pftrace) as plain dicts and rows.

    import xauto
    report = xauto.load("report.json")          # the file, as its schema says; its kind is checked
    xauto.chains(report)                        # a dict for each chain of each run
    xauto.jobs("run.pftrace")                   # a dict for each job that ran
    xauto.frame(xauto.chains(report))           # a pandas.DataFrame, where pandas is installed

Nothing here runs or schedules anything. The schemas are in /usr/share/xauto/schema, and are the contract: what they
call a key is a key here, times are in microseconds, of jobs in nanoseconds of CLOCK_BOOTTIME. Errors: ValueError with the
file's name, OSError. Threads: functions share nothing."""
import json
import pathlib

from . import pftrace

KINDS = {"xauto.app": 3, "xauto.platform": 1, "xauto.policy": 3, "xauto.profile": 1, "xauto.report": 1, "xauto.tables": 3}


def load(path, kind=None):
    """A JSON file of XAuto's as a dict. `kind`: the schema that it must have, as "xauto.report"; None: any known one."""
    try:
        document = json.loads(pathlib.Path(path).read_text())
    except ValueError as error:
        raise ValueError(f"{path}: is no JSON: {error}") from None
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema not in KINDS or kind not in (None, schema):
        raise ValueError(f"{path}: its \"schema\" is {schema!r}, and {kind or 'one of ' + ', '.join(sorted(KINDS))} was expected")
    if document.get("version") != KINDS[schema]:
        raise ValueError(f"{path}: {schema} {document.get('version')}, and version {KINDS[schema]} is read")
    return document


def chains(report):
    """Of each chain of each run of a report: what was claimed and measured, in microseconds; None where it is not known."""
    rows = []
    for run in report["runs"]:
        for chain in run.get("chains", []):
            latency = chain.get("latency_us") or {}
            rows.append({"run": run.get("name", run.get("policy")), "chain": chain["name"], "from": chain["from"], "to": chain["to"],
                         "results": chain["results"], "lost": chain.get("lost"), "worst_case_us": chain.get("worst_case_us"),
                         "deadline_us": chain.get("deadline_us"), "deadline_misses": chain.get("deadline_misses"),
                         **{f"{key}_us": latency.get(key) for key in ("p50", "p99", "max")}})
    return rows


def placements(policy):
    """Of each XNode of a policy: XPU, keys and holds (microseconds after the nominal release), or its priority."""
    return [{"xnode": x["name"], "xpu": x["xpu"], "priority": x.get("priority"), "key_us": x.get("key_us"), "hold_us": x.get("hold_us")}
            for x in policy["xnodes"]]


def trace(path):
    """A .pftrace as pftrace.Trace: tracks, slices, counters."""
    try:
        return pftrace.Trace(pathlib.Path(path).read_bytes())
    except (ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: {error}") from None


def slices(path, category=None):
    """Each slice of a trace: its track ("run/gpu0", say), name, category, begin and end in ns, and its arguments."""
    return [{"track": s.track, "name": s.name, "category": s.category, "begin_ns": s.begin, "end_ns": s.end, **s.args}
            for s in trace(path).slices if category in (None, s.category)]


def jobs(path):
    """Each piece of time in which a job had its XPU: XPU, XNode, begin, end and length in ns, release, part (1, 2, ... of a
    job that was suspended), and how long it had waited."""
    return [{"xpu": s.track.split("/")[1], "xnode": s.name, "begin_ns": s.begin, "end_ns": s.end, "ns": s.end - s.begin, **s.args}
            for s in trace(path).slices if s.category == "run"]


def frame(rows):
    """Rows as a pandas.DataFrame. pandas is python3-pandas; without it: ImportError."""
    import pandas
    return pandas.DataFrame(rows)
