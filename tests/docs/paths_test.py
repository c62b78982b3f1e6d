# SPDX-License-Identifier: Apache-2.0
"""The paths of docs/paths.md: each file is there and defines its function, and no step is taken twice."""
import pathlib
import re
import unittest

SOURCE = pathlib.Path(__file__).resolve().parents[2]
PAGE = SOURCE / "docs/paths.md"
ROW = re.compile(r"\| `([^`]+)` \| `([^`]+)` \|")
COMMENT = re.compile(r'("(?:\\.|[^"\\\n])*")|//[^\n]*|/\*.*?\*/', re.DOTALL)


def paths(text):
    """The tables of a page: lists of (file, function)."""
    found, last = [], None
    for number, line in enumerate(text.split("\n")):
        if row := ROW.match(line):
            if last != number - 1:
                found.append([])
            found[-1].append(row.groups())
            last = number
    return found


def after_parentheses(text, at):
    """The index behind the parenthesis that closes the one at `at`."""
    depth = 0
    for i in range(at, len(text)):
        depth += {"(": 1, ")": -1}.get(text[i], 0)
        if depth == 0:
            return i + 1
    return len(text)


def has_body(text, name):
    """`name(...)` is followed by a body, or by what a constructor initialises: not by what follows a call."""
    for match in re.finditer(rf"(?<![\w:.>]){re.escape(name)}\(", text):
        rest = text[after_parentheses(text, match.end() - 1):]
        if re.match(r"\s*(const|override|noexcept|final|XAUTO_\w+\([^)]*\)|\s)*(\{|:[^:])", rest):
            return True
    return False


def defines(text, function):
    """`Class::name` in full, or `name` behind the beginning of `class Class`; or a plain function."""
    text = COMMENT.sub(lambda found: found[1] or "", text)  # in a text "/*" begins none
    if has_body(text, function):
        return True
    if "::" not in function:
        return False
    owner, name = function.rsplit("::", 1)
    head = re.search(rf"\b(class|struct) {re.escape(owner)}\b[^;(]*\{{", text)
    return head is not None and has_body(text[head.end():], name)


class Paths(unittest.TestCase):
    def setUp(self):
        self.paths = paths(PAGE.read_text())

    def test_there_are_five_paths_who_waits_in_order_and_what_is_left_to_the_coordinator(self):
        self.assertEqual(len(self.paths), 7)
        for path in self.paths:
            self.assertGreater(len(path), 5, path)

    def test_each_file_defines_its_function(self):
        for path in self.paths:
            for file, function in path:
                with self.subTest(file=file, function=function):
                    self.assertTrue(defines((SOURCE / file).read_text(), function))

    def test_no_path_comes_to_a_function_twice(self):
        for path in self.paths:
            self.assertEqual(len(path), len(set(path)), path)


class TheTestItself(unittest.TestCase):
    def test_a_call_and_a_declaration_define_nothing(self):
        self.assertFalse(defines("void f() {\n  if (gone(x)) {\n  }\n}\n", "gone"))
        self.assertFalse(defines("void f() {\n  a.gone(x); }\n", "gone"))
        self.assertFalse(defines("void gone(int);\nclass A {\n  void gone();\n};\n", "A::gone"))
        self.assertFalse(defines("// gone() {\n", "gone"))
        self.assertFalse(defines("class B {\n  void f() { A::g(); }\n};\n", "A::g"))

    def test_definitions_are_found(self):
        self.assertTrue(defines("static int f(struct a *b,\n\t     int (*c)(int))\n{\n", "f"))
        self.assertTrue(defines("Status A::f(int x) const {\n", "A::f"))
        self.assertTrue(defines("class A final : public B {\n  Status f(int) override { return {}; }\n};", "A::f"))

    def test_a_second_table_is_a_second_path(self):
        text = "| `a` | `b` | c |\n| `d` | `e` | f |\n\n| `g` | `h` | i |\n"
        self.assertEqual(paths(text), [[("a", "b"), ("d", "e")], [("g", "h")]])


if __name__ == "__main__":
    unittest.main()
