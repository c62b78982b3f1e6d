# SPDX-License-Identifier: Apache-2.0
"""What scripts/perception.sh makes of its files:

report.py scenarios SCENARIOS PLACE-FILE   says when each scenario is there, and what it has lost
report.py variants FOLDER                  what each variant of a net costs, and how much it sees of what the largest does
report.py runs FOLDER RUN...               the runs, in a table"""
import json
import math
import pathlib
import sys

LARGEST = {"lines": "large-512", "faces": "256"}
VARIANTS = {"faces": ["128", "256"], "lines": ["tiny-320", "tiny-512", "large-320", "large-512"]}
LINE_PIXELS = 12  # both ends so close: two nets' lines are one


def load(path):
    return json.loads(pathlib.Path(path).read_text())


def scenarios(path, place):
    made = load(path)
    for scenario in made["scenarios"]:
        taken = scenario["name"] == "taken"
        scenario["name"] = "core 1 is taken" if taken else "both cores"
        scenario["when"] = [{"file": place, "equals": "taken" if taken else "free"}]
        if taken:
            scenario["lost"] = ["cpu1"]
    pathlib.Path(path).write_text(json.dumps(made, indent=2) + "\n")


def same_line(a, b):
    ends = lambda i, j: math.dist(a[i:i + 2], b[j:j + 2]) <= LINE_PIXELS
    return ends(1, 1) and ends(3, 3) or ends(1, 3) and ends(3, 1)


def same_face(a, b):
    return math.dist((a[1] + a[3] / 2, a[2] + a[4] / 2), (b[1] + b[3] / 2, b[2] + b[4] / 2)) <= max(a[3], b[3]) / 2


def seen(kind, one, other):
    """How many of what `other` has found `one` has, too, in the frames that both have."""
    same = same_line if kind == "lines" else same_face
    frames = {f["frame"]: f[kind] for f in one["frames"]}
    pairs = [(frames[f["frame"]], f[kind]) for f in other["frames"] if f["frame"] in frames]
    return sum(any(same(a, b) for a in mine) for mine, theirs in pairs for b in theirs), sum(len(theirs) for _, theirs in pairs)


def variants(folder):
    folder = pathlib.Path(folder)
    print(f"  {'net':<18} {'p50 ms':>8} {'max ms':>8}   of what the largest net finds")
    for kind, names in VARIANTS.items():
        largest = load(folder / f"{kind}-{LARGEST[kind]}/scenes.json")
        for name in names:
            times = next(x for x in load(folder / f"{kind}-{name}/profile.json")["xnodes"] if x["name"] == f"{kind}.net")["on"]["cpu0"]
            found, of = seen(kind, load(folder / f"{kind}-{name}/scenes.json"), largest)
            print(f"  {kind + ' ' + name:<18} {times['p50_us'] / 1e3:8.1f} {times['max_us'] / 1e3:8.1f}   {found} of {of}")


def runs(folder, names):
    print(f"  {'cores go by':<12} {'policy':<8} {'p50 ms':>8} {'max ms':>8} {'lost':>10}   worst case")
    for name in names:
        run = load(pathlib.Path(folder) / f"{name}.json")["runs"][0]
        now = run.get("scenarios")
        claimed = max((c["worst_case_us"] for c in run["chains"] if "worst_case_us" in c), default=None)
        verdict, broken = run["claims"]["verdict"], run["claims"]["broken"]
        lost, all_of_it = run["lost_activations"], run["lost_activations"] + run["activations"]
        number = lambda us: "-" if us is None else f"{us / 1e3:.1f}"
        print(f"  {run.get('real_cpus', '-'):<12} {'tables' if now else 'static':<8} {number(run['p50_us']):>8} {number(run['max_us']):>8} "
              f"{lost:>4} of {all_of_it:<3}  {number(claimed)} ms {verdict}{', not claimed: ' + broken[0] if broken else ''}")


if __name__ == "__main__":
    verb, *rest = sys.argv[1:]
    {"scenarios": scenarios, "variants": variants, "runs": lambda folder, *names: runs(folder, names)}[verb](*rest)
