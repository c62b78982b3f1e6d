#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the man pages xauto(1) and xauto-VERB(1), and bash's completion, from what the tool itself says with --help, so that they
are never out of date; what --help does not say (files, environment, exit status) is below.

usage: from-help.py BIN OUT      BIN: folder with the xauto to ask; OUT gets man1/*.1 and completions/xauto
"""
import pathlib
import re
import subprocess
import sys

FILES = """
.SH FILES
.TP
.I app.json, profile.json, policy.json, report.json
What the verbs hand to each other.
.TP
.I /etc/xauto/NAME.conf
What the unit
.B xauto@NAME.service
runs; an example is in /usr/share/doc/xauto-tools/examples.
.TP
.I /etc/security/limits.d/xauto.conf
Who may use which real-time priorities without root, see limits.conf(5); an example is in /usr/share/doc/xauto-tools/examples.
.TP
.I /sys/fs/bpf/xauto/RUN
BPF maps of a run, gone when it ends.
"""
ENVIRONMENT = """
.SH ENVIRONMENT
.TP
.B XAUTO_LOG
error, warn, info (default) or debug: how much is said on stderr.
"""
STATUS = """
.SH EXIT STATUS
0: done. 1: the answer is no (infeasible, check failed), or something outside failed (I/O, a peer, a permission).
2: bad usage or bad input.
"""


def escape(text):
    """Literal text for roff: no line is taken for a request, hyphens can be searched for."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return "\n".join("\\&" + line if line[:1] in ".'" else line for line in text.split("\n"))


def sections(text):
    """The parts of a help text: {"": head, "Options": [...], ...}."""
    parts, name = {"": []}, ""
    for line in text.splitlines():
        if found := re.fullmatch(r"(Positionals|Options|Subcommands|Example|Examples):", line):
            name = found[1]
            parts[name] = []
        elif name and line and not line.startswith(" "):
            name = ""
            parts[""].append(line)
        else:
            parts[name].append(line)
    return parts


def entries(lines):
    """CLI11's two columns: [(term, explanation)]."""
    out = []
    for line in lines:
        found = re.match(r"  (\S.*?)(?:\s{2,}(\S.*))?$", line)
        if found and not line.startswith("    "):
            out.append([found[1], found[2] or ""])
        elif line.strip() and out:
            out[-1][1] = (out[-1][1] + " " + line.strip()).strip()
    return out


def listed(title, lines):
    body = "".join(f".TP\n.B {escape(term)}\n{escape(what)}\n" for term, what in entries(lines))
    return f".SH {title}\n{body}" if body else ""


def page(name, version, summary, synopsis, description, rest):
    return (f'.\\" SPDX-License-Identifier: Apache-2.0\n.\\" Made by packaging/from-help.py from the tool\'s own help.\n'
            f'.TH {name.upper()} 1 "" "xauto {version}" "XAuto"\n.SH NAME\n{name} \\- {escape(summary)}\n'
            f".SH SYNOPSIS\n.B {escape(synopsis)}\n.SH DESCRIPTION\n{escape(description)}\n{rest}")


# Words that begin what an option takes, where its help has none in braces.
MORE = {"--overload": "newest skip queue:", "--activation": "worst median"}
COMPLETION = """# bash completion for xauto, made by packaging/from-help.py from the tool's own help.
_xauto() {
  local current="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" words="" values="" files=1 i
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W "@VERBS@" -- "$current"))
    return
  fi
  for ((i = 2; i < COMP_CWORD; i++)); do  # behind -- it is the app's command line
    if [ "${COMP_WORDS[i]}" = "--" ]; then
      COMPREPLY=($(compgen -f -- "$current"))
      return
    fi
  done
  case "${COMP_WORDS[1]}" in
@WORDS@  esac
  case "$before" in -*) ;; *) before="" ;; esac
  case "${COMP_WORDS[1]} $before" in
@VALUES@  esac
  case "$current" in
    -*) COMPREPLY=($(compgen -W "$words" -- "$current")) ;;
    *) COMPREPLY=($(compgen -W "$values" -- "$current") $([ -z "$files" ] || compgen -f -- "$current")) ;;
  esac
}
complete -o filenames -F _xauto xauto
"""


def completion(options):
    """options: {verb: [(term, explanation)]}, as --help has them."""
    words = values = ""
    for verb, listed_options in options.items():
        names = [found[0] for term, _ in listed_options if (found := re.search(r"--[a-z][a-z-]*", term))]
        words += f'    {verb}) words="{" ".join(names)}" ;;\n'
        for term, what in listed_options:
            option = re.search(r"--[a-z][a-z-]*|$", term)[0]
            of_braces = re.search(r":\{([^}]*)\}", term + " " + what)
            platforms = re.search(r"((?:[a-z][a-z-]*, )+)or a platform", what)
            if of_braces:
                values += f"    '{verb} {option}') values=\"{of_braces[1].replace(',', ' ')}\" files=\"\" ;;\n"
            elif more := platforms[1].replace(",", "").strip() if platforms else MORE.get(option):
                values += f"    '{verb} {option}') values=\"{more}\"{' ' if platforms else ' files= '};;\n"
    return COMPLETION.replace("@VERBS@", " ".join(options)).replace("@WORDS@", words).replace("@VALUES@", values)


def main():
    tool, out = pathlib.Path(sys.argv[1]) / "xauto", pathlib.Path(sys.argv[2])
    man, completions = out / "man1", out / "completions"
    for folder in (man, completions):
        folder.mkdir(parents=True, exist_ok=True)

    def ask(*words):
        return subprocess.run([tool, *words], check=True, capture_output=True, text=True, timeout=20).stdout

    version = re.search(r"\d+(\.\d+)+", ask("--version"))[0]
    root = sections(ask("--help"))
    verbs = entries(root["Subcommands"])
    if not verbs:
        sys.exit("from-help: xauto --help names no verbs")
    options = {}
    for verb, summary in verbs:
        parts = sections(ask(verb, "--help"))
        options[verb] = entries(parts["Options"])
        usage = next(line for line in parts[""] if line.startswith("Usage: ")).removeprefix("Usage: ")
        rest = listed("ARGUMENTS", parts.get("Positionals", [])) + listed("OPTIONS", parts["Options"])
        if example := [line.strip() for line in parts.get("Example", []) if line.strip()]:
            rest += ".SH EXAMPLE\n.nf\n" + "\n".join(escape(line) for line in example) + "\n.fi\n"
        rest += STATUS.lstrip("\n") + ".SH SEE ALSO\n.BR xauto (1)\n"
        short = re.split(r"[;:.] ", summary)[0].rstrip(".")
        (man / f"xauto-{verb}.1").write_text(
            page(f"xauto-{verb}", version, short[0].lower() + short[1:], usage, summary, rest))

    rest = listed("VERBS", root["Subcommands"]) + listed("OPTIONS", root["Options"])
    rest += ".SH EXAMPLE\n.nf\n" + "\n".join(escape(line) for line in (
        "xauto profile --platform small --app-out app.json -- build/camera",
        "xauto solve --app app.json --platform small --out policy.json",
        "xauto run --app app.json --policy policy.json --trace-out run.pftrace -- build/camera",
        "xauto report run.pftrace --out report.html")) + "\n.fi\n"
    rest += (FILES + ENVIRONMENT + STATUS).replace("\n\n", "\n").lstrip("\n")
    rest += ".SH SEE ALSO\n" + ",\n".join(f".BR xauto\\-{verb} (1)" for verb, _ in verbs) + "\n"
    (man / "xauto.1").write_text(page(
        "xauto", version, "schedules perception stages over CPUs, GPUs and DLAs", "xauto VERB [OPTIONS]",
        "XAuto gives each stage (XNode) of an application a processor and a priority, and enforces both: a coordinator per processor "
        "suspends a less urgent stage the moment a more urgent one starts. One verb per step, each with a page of its own.", rest))
    (completions / "xauto").write_text(completion(options))


if __name__ == "__main__":
    main()
