# SPDX-License-Identifier: Apache-2.0
"""Every command in README.md, docs/tutorial.md and docs/nets.md is run, in order, and must print what the page shows.

A ```console block holds `$ command` lines, each followed by what it prints to stdout. Compared up to numbers (each is
a #), instances of XPUs, whether a chain is `optimal`, a worst case starred, a job kept waiting before it began or after
it, what is tightest and what took most of a way (times decide), runs of blanks and rulers; `...` on a line of its own stands for any lines, `…` inside a line
for any text. Every command must end with status 0. Where a number says how long something took, no page can be wrong
about it.

The folder is a temporary checkout: links to this one, a `build` of its own that links to what is built, its own home.
`make`, which would build again, is asked whether it knows the target (`make -n`); `make demo` runs what it
runs after building, with fewer activations; a search takes as long as those of other tests."""
import os
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "integration"))
from common import in_little_time  # noqa: E402

SOURCE = pathlib.Path(__file__).resolve().parents[2]
BIN = pathlib.Path(os.environ.get("XAUTO_BIN", SOURCE / "build/bin"))
PAGES = ("README.md", "docs/tutorial.md", "docs/nets.md")
TIMEOUT_S = 200  # of one command
SHARED = SOURCE.parent / "shared"  # data of others: without it a page's commands that name it, or caret, are left out
OF_SHARED = re.compile(r"\.\./shared|\bcaret\b")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def normal(line):
    line = re.sub(r"[-=_|]{3,}", "---", line)
    line = re.sub(r"\b(?:cpu|gpu|dla)(?=\d)", "xpu", line)
    line = re.sub(r"% +optimal$", "%", line)
    line = re.sub(r"\*(?=\d)", "", line)
    line = re.sub(r"\btightest \S+", "tightest", line)
    line = line.replace("off the XPU for ", "waited ").replace(" ms, preempted by ", " ms for ")
    line = re.sub(r"\s+", " ", NUMBER.sub(" # ", line)).strip()
    line = re.sub(r"^(On its way, # ms: )(.*), (# running)", r"\1\3, \2", line)  # else by size
    return re.sub(r"(?<!# )# - #", "# # #", line, count=1)  # no p99 of fewer than 100 results


def difference(shown, printed):
    """What is wrong with the shown lines, or None."""
    shown = [line for line in map(normal, shown)]
    printed = [line for line in map(normal, printed)]
    while printed and not printed[-1]:
        printed.pop()
    while shown and not shown[-1]:
        shown.pop()

    def matches(line, text):
        return re.fullmatch(".*".join(map(re.escape, line.split("…"))), text) is not None

    # at[i]: how many printed lines the first i shown lines can have used up.
    at = [{0}]
    for line in shown:
        if line == "...":
            at.append(set(range(min(at[-1]), len(printed) + 1)))
        else:
            at.append({p + 1 for p in at[-1] if p < len(printed) and matches(line, printed[p])})
        if not at[-1]:
            tried = sorted(p for p in at[-2] if p < len(printed))
            got = f"printed is: {printed[tried[0]]}" if tried else "nothing more is printed"
            return f"shown is: {line}\n  {got}"
    if len(printed) not in at[-1]:
        return f"not shown is: {printed[max(at[-1])]}"
    return None


def blocks(text):
    """(line number, command, shown lines) of each console block."""
    found, inside, number = [], False, 0
    for line in text.splitlines():
        number += 1
        if line.startswith("```"):
            inside = not inside and line.strip() == "```console"
        elif inside and line.startswith("$ "):
            found.append((number, line[2:], []))
        elif inside and found and found[-1][1].endswith("\\"):
            found[-1] = (found[-1][0], found[-1][1][:-1] + line.strip(), [])
        elif inside and found:
            found[-1][2].append(line)
        elif inside:
            raise ValueError(f"line {number}: no command before '{line}'")
    return found


def uncovered(text):
    """Commands outside of console blocks, where nothing runs them."""
    found, kind = [], None
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("```"):
            kind = None if kind is not None else line[3:].strip()
        elif kind == "console":
            continue
        elif (kind is not None or line.startswith("    ")) and re.match(
                r"\s*(?:\$ )?(?:xauto |make\b|build/bin/|scripts/|cmake |apt)", line):
            found.append(f"line {number}: {line.strip()}")
    return found


def commands_of(text):
    """What somebody may type: verbs named in sentences, and lines of code blocks."""
    lines, inside = re.findall(r"`(xauto [a-z][^`]*)`", text), False
    for line in text.splitlines():
        if line.startswith("```"):
            inside = not inside
        elif (inside or line.startswith("    ")) and re.match(
                r"\s*(?:[$#] )?(?:sudo |[A-Z_]+=\S+ )*(?:build/bin/\S|xauto |make\b|cmake |insmod |scripts/\S|apt)", line):
            lines.append(line.strip())
    return lines


def says_which_rights(text):
    """Before its first section."""
    return re.search(r"(?i)\brights?\b|\broot\b", re.split(r"(?m)^## ", text)[0]) is not None


class Checkout:
    """What a reader has at hand, and the shell to type into."""

    def __init__(self, folder):
        self.root = pathlib.Path(folder) / "xauto"
        home = pathlib.Path(folder) / "home"
        for place in (self.root / "build", home):
            place.mkdir(parents=True)
        for entry in SOURCE.iterdir():
            if not entry.name.startswith(("build", ".")):
                (self.root / entry.name).symlink_to(entry)
        if SHARED.exists():
            (self.root.parent / "shared").symlink_to(SHARED)
        for entry in BIN.parent.iterdir():
            if entry.name != "demo":
                (self.root / "build" / entry.name).symlink_to(entry)
        # make demo builds before it runs; here everything is built.
        idle = pathlib.Path(folder) / "idle"
        idle.mkdir()
        for tool in ("cmake", "ninja"):
            (idle / tool).write_text("#!/bin/sh\nexit 0\n")
            (idle / tool).chmod(0o755)
        self.idle, self.state = idle, pathlib.Path(folder) / "state"
        self.environment = {**os.environ, "HOME": str(home), "ACTIVATIONS": "10", "LC_ALL": "C.UTF-8"}
        self.environment.pop("XAUTO_BIN", None)
        self.state.write_text(f"cd {shlex.quote(str(self.root))}\n")

    def run(self, command):
        environment = dict(self.environment)
        words = command.split("#")[0].split()
        if words == ["make", "demo"]:
            environment["PATH"] = f"{self.idle}:{environment['PATH']}"
            command = "scripts/demo.sh"
        elif words[:1] == ["make"]:
            command = "make -n " + " ".join(map(shlex.quote, words[1:])) + " >/dev/null"
        elif words[:1] == ["xauto"] and not set(words) & {"|", "&&", ";"}:
            command = " ".join(["xauto", *in_little_time(words[1:])])
        script = f""". {shlex.quote(str(self.state))}
{command}
status=$?
{{ export -p | grep -v 'PWD='; printf 'cd %q\\n' "${{OLDPWD:-$PWD}}" "$PWD"; }} >{shlex.quote(str(self.state))}
exit $status
"""
        return subprocess.run(["bash", "-c", script], cwd=self.root, env=environment, capture_output=True, text=True,
                              timeout=TIMEOUT_S, errors="replace", stdin=subprocess.DEVNULL)


def lost_only(result):
    """Status 1 since the machine stood still for some periods, so that releases were lost; and nothing else is wrong."""
    errors = re.findall(r"^xauto: error: .*", result.stderr, re.M)
    return result.returncode == 1 and errors and all(
        re.search(r"error: run .*: \d+ of \d+ activations were lost \(of XModule (\S+: 0 failed, \d+ dropped[;)] ?)+$", e)
        for e in errors)


def of_an_outlier(result):
    """The machine stood still while a stage was timed. `solve` says so, and what to do: measure again."""
    return result.returncode == 1 and "Are they outliers of a profile? Measure again" in result.stdout


def wrong_in(text, checkout):
    """The first thing that is wrong, or None: what follows would only be its consequence."""
    profile = None
    for number, command, shown in blocks(text):
        if OF_SHARED.search(command) and not SHARED.exists():
            continue
        if command.startswith("xauto profile "):
            profile = command
        result = checkout.run(command)
        for _ in range(4):
            if profile and of_an_outlier(result):
                checkout.run(profile)
                result = checkout.run(command)
        if result.returncode != 0 and not lost_only(result):
            return f"line {number}: $ {command}\n  ends with status {result.returncode}: {result.stderr[-2000:]}"
        if problem := difference(shown, result.stdout.splitlines()):
            return f"line {number}: $ {command}\n  {problem}"
    return None


class Pages(unittest.TestCase):
    def judge(self, page):
        text = (SOURCE / page).read_text()
        self.assertEqual(uncovered(text), [], f"{page}: commands that no test runs")
        self.assertGreater(len(blocks(text)), 3, f"{page}: where are the commands?")
        with tempfile.TemporaryDirectory() as folder:
            self.assertIsNone(problem := wrong_in(text, Checkout(folder)), f"{page}, {problem}")

    def test_readme(self):
        self.judge("README.md")

    def test_tutorial(self):
        self.judge("docs/tutorial.md")

    def test_each_page_with_commands_says_first_which_rights_they_need(self):
        pages = {page.name: page.read_text() for page in (SOURCE / "docs").glob("*.md")}
        with_commands = {name for name, text in pages.items() if commands_of(text)}
        self.assertGreater(len(with_commands), 10)
        self.assertEqual([name for name in sorted(with_commands) if not says_which_rights(pages[name])], [])

    @unittest.skipUnless((BIN.parent / "onnx/whole").exists(), "scripts/fetch-onnx.sh could not fetch ONNX Runtime")
    def test_nets(self):
        self.judge("docs/nets.md")


class TheTestItself(unittest.TestCase):
    def wrong(self, text):
        with tempfile.TemporaryDirectory() as folder:
            return wrong_in(text, Checkout(folder))

    def page(self, *lines):
        return "\n".join(["# A page", "```console", *lines, "```", ""])

    def test_a_true_page_passes(self):
        self.assertIsNone(self.wrong(self.page("$ echo 'took 17.3 ms,  all well'", "took 9 ms, all well")))
        self.assertIsNone(self.wrong(self.page("$ seq 3; echo end", "1", "...", "end")))
        self.assertIsNone(self.wrong(self.page("$ X=3; export X", "$ cd docs", "$ basename $PWD; echo $X a", "docs", "3 a")))
        self.assertIsNone(self.wrong(self.page("$ echo one \\", "    two", "one two")))
        self.assertIsNone(self.wrong(self.page("$ make check", "$ echo the rest", "the …st")))

    def test_a_wrong_line_is_seen(self):
        for page in (self.page("$ echo one", "two"), self.page("$ echo one"), self.page("$ echo one", "one", "two"),
                     self.page("$ echo one; echo two", "two", "one"), self.page("$ true", "one"),
                     self.page("$ seq 3; echo end", "1", "...", "and"), self.page("$ echo the rest", "that…")):
            self.assertIsNotNone(self.wrong(page), page)

    def test_a_command_that_fails_is_seen(self):
        self.assertIn("status 3", self.wrong(self.page("$ echo one; (exit 3)", "one")))
        self.assertIn("status 2", self.wrong(self.page("$ make no-such-target")))
        lost = "echo 'xauto: error: run a b: 2 of 9 activations were lost (of XModule A: 0 failed, 2 dropped; B: 0 failed, 1 dropped)' >&2"
        self.assertIsNone(self.wrong(self.page(f"$ echo one; {lost}; (exit 1)", "one")))
        for page in (self.page(f"$ {lost}; echo 'xauto: error: another' >&2; (exit 1)"), self.page(f"$ {lost}; (exit 2)"),
                     self.page(f"$ {lost.replace('A: 0', 'A: 1')}; (exit 1)"), self.page("$ (exit 1)")):
            self.assertIsNotNone(self.wrong(page), page)

    def test_a_page_that_says_no_rights_is_seen(self):
        self.assertEqual(len(commands_of("a\n```\n# xauto doctor\nsudo insmod x.ko\nplain text\n```\n    make check\nmake it so\n")), 3)
        self.assertTrue(says_which_rights("# A page\n\nNo rights are needed.\n## Next\n"))
        self.assertFalse(says_which_rights("# A page\n\n## Next\n\nNo rights are needed.\n"))

    def test_a_command_in_no_console_block_is_seen(self):
        self.assertEqual(len(uncovered("text\n\n    xauto solve --app a\n")), 1)
        self.assertEqual(len(uncovered("```\n$ make demo\n```\n")), 1)
        self.assertEqual(uncovered("```console\n$ make demo\n```\nmake is a tool\n"), [])


if __name__ == "__main__":
    unittest.main()
