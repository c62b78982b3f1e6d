# SPDX-License-Identifier: Apache-2.0
"""Reads .msg files: design.ros2.org/articles/legacy_interface_definition.html, and docs.ros.org "Interfaces"."""
from __future__ import annotations

import ast
import re

from interface import (CONSTANT_NAME, MAX_ARRAY, MAX_BOUND, PRIMITIVES, TEXTS, Constant, Field, Refused, Type, check_default, check_value)

TYPE = re.compile(r"(?P<element>[A-Za-z][A-Za-z0-9_/]*)(<=(?P<text>[0-9]+))?(?P<many>\[((?P<at_most><=)?(?P<count>[0-9]+))?\])?")


def read_msg(text, message):
    for number, line in enumerate(text.splitlines(), 1):
        where = f"{message.path}:{number}"
        line = without_comment(line).strip()
        if line:
            read_line(line, message, where)


def without_comment(line):
    """Up to the first # that is in no quotes; a quotation mark without its pair is none."""
    quote = None
    for i, c in enumerate(line):
        if c == "#" and quote is None:
            return line[:i]
        if c in "\"'" and line[i - 1:i] != "\\":
            quote = c if quote is None else None if c == quote else quote
    return line if quote is None else line.split("#", 1)[0]


def read_line(line, message, where):
    words = line.split(None, 1)
    if len(words) < 2:
        raise Refused(where, f"'{line}' is no field: <type> <name>")
    type_ = read_type(words[0], message.package, where)
    constant = re.match(r"([A-Za-z0-9_]+)\s*=\s*(.*)", words[1])
    if constant:
        if type_.nested or type_.array is not None or type_.sequence or type_.text_bound is not None:
            raise Refused(where, f"a constant cannot be of type {words[0]}")
        value = check_value(type_.element, read_value(constant[2], type_.element, where), where)
        message.add(Constant(type_.element, constant[1], value), where)
        return
    name, *rest = words[1].split(None, 1)
    if CONSTANT_NAME.fullmatch(name) and not rest and len(name) > 1:
        raise Refused(where, f"'{name}' is no name for a field: lower case, or a constant with = and its value")
    default = None
    if rest:
        default = check_default(type_, read_default(rest[0].strip(), type_, where), where)
    message.add(Field(type_, name, where, default), where)


def read_type(word, package, where):
    found = TYPE.fullmatch(word)
    if not found:
        raise Refused(where, f"'{word}' is no type")
    element, count = found["element"], found["count"]
    if found["text"] is not None and element not in TEXTS:
        raise Refused(where, f"'{word}': only string and wstring have a bound without [ ]")
    if element not in PRIMITIVES and element not in TEXTS:
        element = nested(element, package, where)
    type_ = Type(element, text_bound=bound(found["text"], MAX_BOUND, where))
    if found["many"] is not None:
        if count is not None and not found["at_most"]:
            type_.array = bound(count, MAX_ARRAY, where)
        else:
            type_.sequence, type_.bound = True, bound(count, MAX_BOUND, where)
    return type_


def bound(text, most, where):
    if text is None:
        return None
    if not 1 <= int(text) <= most:
        raise Refused(where, f"{text} is not from 1 to {most}")
    return int(text)


def nested(element, package, where):
    """Name, pkg/Name or pkg/msg/Name -> pkg/msg/Name."""
    parts = element.split("/")
    if len(parts) == 1:
        parts = [package, "msg", parts[0]]
    elif len(parts) == 2:
        parts = [parts[0], "msg", parts[1]]
    if len(parts) != 3 or parts[1] != "msg" or not parts[2][:1].isupper():
        raise Refused(where, f"'{element}' is no type")
    return "/".join(parts)


def read_default(text, type_, where):
    many = type_.array is not None or type_.sequence
    if type_.nested or not many or not (text.startswith("[") and text.endswith("]")):
        return read_value(text, type_.element, where)
    return [read_value(part, type_.element, where) for part in split(text[1:-1], where)]


def split(text, where):
    """At commas that are in no quotes."""
    parts, start, quote = [], 0, None
    for i, c in enumerate(text):
        if quote:
            quote = None if c == quote and text[i - 1] != "\\" else quote
        elif c in "\"'":
            quote = c
        elif c == ",":
            parts.append(text[start:i].strip())
            start = i + 1
    last = text[start:].strip()
    if quote:
        raise Refused(where, f"'{text}' has a quotation mark without its pair")
    return parts + [last] if last else parts


def read_value(text, element, where):
    if element in TEXTS:
        if text[:1] in ("'", '"'):
            if len(text) < 2 or text[-1] != text[0]:
                raise Refused(where, f"{text} has a quotation mark without its pair")
            try:
                return ast.literal_eval(text)
            except (SyntaxError, ValueError):
                raise Refused(where, f"{text} is no text") from None
        return text
    if element == "bool" and text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        if element in ("float32", "float64"):
            return float(text)
        return int(text, 0)
    except ValueError:
        raise Refused(where, f"'{text}' is no {element}") from None
