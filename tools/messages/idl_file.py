# SPDX-License-Identifier: Apache-2.0
"""Reads .idl files: of OMG IDL 4.2 what ROS 2 has for messages (design.ros2.org/articles/idl_interface_definition.html): modules, one
struct, constants, typedefs, sequences, arrays, bounded texts, @default. What it leaves out is refused by name."""
from __future__ import annotations

import ast
import re

from interface import (MAX_ARRAY, MAX_BOUND, Constant, Field, Refused, Type, check_default, check_value)

TOKEN = re.compile(r"""(?P<space>[ \t\r\f\n]+|//[^\n]*|/\*.*?\*/|\#[^\n]*)|(?P<text>L?"(\\.|[^"\\\n])*")|(?P<char>'(\\.|[^'\\\n])')
                       |(?P<number>[0-9][0-9a-zA-Z.]*([eE][-+][0-9]+)?)|(?P<word>[A-Za-z_][A-Za-z0-9_]*)|(?P<sign>::|.)""", re.X | re.S)
# IDL's names -> those of .msg
SIMPLE = {"boolean": "bool", "octet": "byte", "char": "char", "short": "int16", "long": "int32", "float": "float32", "double": "float64",
          **{name: name for name in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")}}
LEFT_OUT = ("union", "enum", "bitmask", "bitset", "map", "interface", "valuetype", "exception", "wchar", "fixed", "any", "native")
IGNORED = ("verbatim", "unit", "range", "min", "max", "final", "extensibility", "autoid", "id", "try_construct", "nested", "topic", "external")


def read_idl(text, message):
    Parser(text, message).file()


class Parser:
    def __init__(self, text, message):
        self.message = message
        self.tokens = []  # (kind, text, line)
        line = 1
        for found in TOKEN.finditer(text):
            if found.lastgroup != "space":
                self.tokens.append((found.lastgroup, found[0], line))
            line += found[0].count("\n")
        self.tokens.append(("end", "the end of the file", line))
        self.at = 0
        self.scope = []
        self.typedefs = {}
        self.done = False

    # What comes next.

    @property
    def next(self):
        return self.tokens[self.at][1]

    @property
    def where(self):
        return f"{self.message.path}:{self.tokens[self.at][2]}"

    def refuse(self, what):
        raise Refused(self.where, what)

    def take(self, expected=None):
        kind, text, _ = self.tokens[self.at]
        if expected is not None and text != expected:
            self.refuse(f"'{text}' where '{expected}' is expected")
        if kind == "end":
            self.refuse(f"{text} where more is expected")
        self.at += 1
        return text

    def word(self):
        if self.tokens[self.at][0] != "word":
            self.refuse(f"'{self.next}' where a name is expected")
        return self.take()

    def accept(self, text):
        if self.next != text:
            return False
        self.at += 1
        return True

    # Grammar.

    def file(self):
        while self.tokens[self.at][0] != "end":
            self.definition()
        if not self.done:
            self.refuse(f"there is no struct {self.message.name} in the module {self.message.package}::msg")

    def definition(self):
        self.annotations()
        what = self.word()
        if what in LEFT_OUT:
            self.at -= 1
            self.refuse(f"'{what}' is nothing that ROS 2 has in messages")
        if what == "module":
            self.scope.append(self.word())
            self.take("{")
            while not self.accept("}"):
                self.definition()
            self.scope.pop()
        elif what == "const":
            self.constant()
        elif what == "typedef":
            self.typedef()
        elif what == "struct":
            self.struct()
        else:
            self.at -= 1
            self.refuse(f"'{what}' where a module, struct, typedef or const is expected")
        self.take(";")

    def constant(self):
        name, value, type_, where = None, None, self.type(), self.where
        name = self.word()
        self.take("=")
        value = self.literal()
        if self.scope != [self.message.package, "msg", f"{self.message.name}_Constants"]:
            raise Refused(where, f"'{name}' is outside of the module {self.message.name}_Constants, where ROS 2 has constants")
        if type_.nested or type_.sequence:
            raise Refused(where, f"a constant cannot be of type {type_.element}")
        self.message.add(Constant(type_.element, name, check_value(type_.element, value, where)), where)

    def typedef(self):
        type_ = self.type()
        name = self.word()
        self.typedefs[name] = self.dimensions(type_)

    def struct(self):
        where, name = self.where, self.word()
        if self.scope != [self.message.package, "msg"] or name != self.message.name:
            raise Refused(where, f"'{'::'.join([*self.scope, name])}': a file has one struct, and it is called like the file: "
                          f"{self.message.package}::msg::{self.message.name}")
        if self.next == ":":
            self.refuse("a struct cannot inherit")
        self.take("{")
        while not self.accept("}"):
            default = self.annotations()
            type_ = self.type()
            while True:
                where, name = self.where, self.word()
                of = self.dimensions(type_)
                value = None
                if default is not None:
                    if isinstance(default, str) and (of.sequence or of.array is not None):
                        default = listed(default, where)
                    value = check_default(of, default, where)
                self.message.add(Field(of, name, where, value), where)
                if not self.accept(","):
                    break
            self.take(";")
        self.done = True

    def annotations(self):
        """The value of @default, if there is one."""
        default = None
        while self.accept("@"):
            where, name = self.where, self.word()
            if name in ("key", "optional", "mutable", "appendable"):
                raise Refused(where, f"@{name} changes what goes over the wire, and ROS 2 has no such messages")
            if name not in ("default", *IGNORED):
                raise Refused(where, f"@{name} is not known")
            if not self.accept("("):
                continue
            if name == "default":
                if self.next == "value":
                    self.take()
                    self.take("=")
                default = self.literal()
                self.take(")")
            else:
                depth = 1
                while depth:
                    token = self.take()
                    depth += (token == "(") - (token == ")")
        return default

    def type(self):
        where, name = self.where, self.word()
        if name in LEFT_OUT:
            raise Refused(where, f"'{name}' is nothing that ROS 2 has in messages")
        if name == "unsigned":
            name = {"short": "uint16", "long": "uint32"}.get(self.word())
            if name is None:
                raise Refused(where, "'unsigned' must be of short, long or long long")
            if name == "uint32" and self.accept("long"):
                name = "uint64"
            return Type(name)
        if name == "long":
            if self.next == "double":
                self.refuse("'long double' is nothing that can be sent")
            return Type("int64" if self.accept("long") else "int32")
        if name in SIMPLE:
            return Type(SIMPLE[name])
        if name in ("string", "wstring"):
            return Type(name, text_bound=self.bound(MAX_BOUND) if self.accept("<") else None)
        if name == "sequence":
            self.take("<")
            inner = self.type()
            if inner.sequence or inner.array is not None:
                raise Refused(where, "a sequence of sequences or arrays is nothing that ROS 2 has: put a struct in between")
            bound = self.bound(MAX_BOUND) if self.accept(",") else self.take(">") and None
            return Type(inner.element, text_bound=inner.text_bound, sequence=True, bound=bound)
        path = [name]
        while self.accept("::"):
            path.append(self.word())
        if path[-1] in self.typedefs and (len(path) == 1 or path[:-1] == self.scope[:len(path) - 1]):
            return self.typedefs[path[-1]]
        if len(path) == 1:
            path = [self.message.package, "msg", path[0]]
        if len(path) != 3 or path[1] != "msg":
            raise Refused(where, f"'{'::'.join(path)}' is no type <package>::msg::<Type>")
        return Type("/".join(path))

    def bound(self, most, end=">"):
        if self.tokens[self.at][0] != "number" or not self.next.isdigit() or not 1 <= int(self.next) <= most:
            self.refuse(f"{self.next} is not from 1 to {most}")
        bound = int(self.take())
        self.take(end)
        return bound

    def dimensions(self, type_):
        if not self.accept("["):
            return type_
        if type_.sequence or type_.array is not None:
            self.refuse("an array of sequences or arrays is nothing that ROS 2 has: put a struct in between")
        made = Type(type_.element, text_bound=type_.text_bound, array=self.bound(MAX_ARRAY, "]"))
        if self.next == "[":
            self.refuse("an array of sequences or arrays is nothing that ROS 2 has: put a struct in between")
        return made

    def literal(self):
        kind, text, _ = self.tokens[self.at]
        sign = -1 if text == "-" else 1
        if text in ("-", "+"):
            self.at += 1
            kind, text, _ = self.tokens[self.at]
            if kind != "number":
                self.refuse(f"'{text}' where a number is expected")
        if kind == "number":
            try:
                value = int(text, 8 if re.fullmatch("0[0-7]+", text) else 0) if re.fullmatch("0[xX][0-9a-fA-F]+|[0-9]+", text) else float(text)
            except ValueError:
                self.refuse(f"'{text}' is no number")
            self.at += 1
            return sign * value
        if text in ("TRUE", "FALSE"):
            self.at += 1
            return text == "TRUE"
        if kind == "text":
            value = ""
            while self.tokens[self.at][0] == "text":  # one behind the other are one
                try:
                    value += ast.literal_eval(self.next.lstrip("L"))
                except (SyntaxError, ValueError):
                    self.refuse(f"{self.next} is no text")
                self.at += 1
            return value
        return self.refuse(f"'{text}' where a value is expected")


def listed(text, where):
    """ROS 2 writes the default of an array as a text: "(1, 2, 3)"."""
    try:
        value = ast.literal_eval(text if text.startswith("(") else f"({text},)")
        return list(value) if isinstance(value, tuple) else [value]
    except (SyntaxError, ValueError):
        raise Refused(where, f"'{text}' is no list of values") from None
