#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""No function's body is above 80 lines: what is longer has parts, and parts have names. Usage:
scripts/check-function-length.py [FILE...], by default the C and C++ sources of what users run. --list prints the longest."""
import pathlib
import re
import subprocess
import sys

LINES = 80
# Not tests, bench and examples: a case is read from top to bottom, and the main of an app lists its modules.
PARTS = ["lib", "solver", "tools", "include", "kmod", "bpf"]
ROOT = pathlib.Path(__file__).resolve().parents[1]
# What stands for nothing here: comments, texts, directives. Each becomes its line ends.
NOISE = re.compile(r'''//[^\n]*|/\*.*?\*/|R"(\w*)\(.*?\)\1"|"(?:\\.|[^"\\\n])*"|(?<!\w)'(?:\\.|[^'\\\n])+'|^[ \t]*\#(?:\\\n|[^\n])*''',
                   re.DOTALL | re.MULTILINE)
SCOPE = re.compile(r"\s*(?:template\s*<.*>\s*)?(?:inline\s+)?(?:namespace|class|struct|union|enum|extern)\b", re.DOTALL)
NAME = re.compile(r"([\w:~]+|operator\s*\S+)\s*\(")


def is_scope(head):
    """`namespace x {`, `class X : Y {`, and no `struct x *f(int) {`."""
    return SCOPE.match(head) is not None and not head.rstrip().endswith(")")


def functions(text):
    """(line of the name, name, lines of the body) of each function that stands in a namespace or a class."""
    text = NOISE.sub(lambda m: '""' * m.group().startswith(("R", '"')) + "\n" * m.group().count("\n"), text)
    found, head, line = [], "", 1
    scopes, depth, began = 0, 0, None  # depth: of braces in a body, or in what a declaration is given
    for c in text:
        line += c == "\n"
        if depth > 0:
            depth += {"{": 1, "}": -1}.get(c, 0)
            if depth == 0 and began is None:
                head += "{}"
            elif depth == 0:
                name = NAME.search(head)
                found.append((began[0], name.group(1) if name else "?", max(line - began[1] - 1, 0)))
                began, head = None, ""
        elif c == "{":
            if is_scope(head):
                scopes, head = scopes + 1, ""
                continue
            depth = 1
            # `) : a_{1} {`: what a member is given goes on with the head.
            is_body = "(" in head and "=" not in re.sub(r"\(.*\)|operator\S*", "", head, flags=re.DOTALL) and not (
                re.search(r"\)\s*(?:noexcept\s*)?:(?!:)", head) and re.search(r"[\w>]\s*$", head))
            if is_body:
                began = (line - head.lstrip().count("\n"), line)
        elif c == "}":
            scopes, head = scopes - 1, ""
        elif c == ";" and head.count("(") == head.count(")"):
            head = ""
        else:
            head += c
    return found


def test():
    def body(lines):
        return "{\n" + "x();\n" * lines + "}\n"

    for head in ("int f(int a) ", "A::A(int a) : b_(a), c_{a} ", "bool X::operator==(const X& x) const ",
                 "auto f(int a = 1) -> int ", "static struct x *f(void)\n", "void f() override XAUTO_REQUIRES(m_) ",
                 'TEST(A, B) ', "namespace a {\nclass B : C {\n int d_ = 0, e_{1};\n struct alignas(8) E {};\n void f() const "):
        assert [n for _, _, n in functions(head + body(81))] == [81], head
    assert [n for _, _, n in functions("int a[] = " + body(90) + "struct S " + "{\n" + "int a;\n" * 90 + "};\n")] == []
    assert functions("// int f() {\nint g() { return '{' + \"{\"[0]; }\nint h() {\n\n}") == [(2, "g", 0), (3, "h", 1)]


def main():
    test()
    listed = "--list" in sys.argv
    files = [pathlib.Path(f) for f in sys.argv[1:] if not f.startswith("--")]
    if not files:
        names = subprocess.run(["git", "ls-files", *PARTS], cwd=ROOT, check=True, capture_output=True, text=True)
        files = [ROOT / f for f in names.stdout.split() if f.endswith((".cc", ".h", ".c"))]
    found = [(n, f"{f.relative_to(ROOT) if f.is_relative_to(ROOT) else f}:{at}: {name}")
             for f in files for at, name, n in functions(f.read_text())]
    if listed:
        for lines, where in sorted(found, reverse=True)[:60]:
            print(lines, where)
        return 0
    long = [f"{where} has {lines} lines, {LINES} are allowed: give its parts names" for lines, where in found if lines > LINES]
    print("\n".join(long), end="\n" if long else "")
    return 1 if long else 0


if __name__ == "__main__":
    sys.exit(main())
