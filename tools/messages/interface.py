# SPDX-License-Identifier: Apache-2.0
"""Message types, whatever file they come from: what they hold, where they are found, their definition as text."""
from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path


class Refused(Exception):
    """A file that is no interface description; says where and why."""

    def __init__(self, where, what):
        super().__init__(f"{where}: {what}")


# Type of a field -> bytes on the wire, which is also the alignment. byte and char are octets, as in ROS 2.
PRIMITIVES = {"bool": 1, "byte": 1, "char": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4,
              "int64": 8, "uint64": 8, "float32": 4, "float64": 8}
TEXTS = ("string", "wstring")
INTEGERS = {}  # -> smallest and largest value
for _name, _bytes in PRIMITIVES.items():
    if _name.startswith("int"):
        INTEGERS[_name] = (-(1 << 8 * _bytes - 1), (1 << 8 * _bytes - 1) - 1)
    elif _name != "bool" and not _name.startswith("float"):
        INTEGERS[_name] = (0, (1 << 8 * _bytes) - 1)

PACKAGE = re.compile(r"[a-z](_?[a-z0-9])*")
TYPE_NAME = re.compile(r"[A-Z][A-Za-z0-9]*")
FIELD_NAME = re.compile(r"[a-z](_?[a-z0-9])*")
CONSTANT_NAME = re.compile(r"[A-Z](_?[A-Z0-9])*")

MAX_BOUND = (1 << 32) - 2
MAX_ARRAY = 1 << 24  # elements of an array, or of several, one in the other
EMPTY = "structure_needs_at_least_one_member"  # IDL has no empty struct: ROS 2 puts this octet into it


@dataclass
class Type:
    """Of a field: its element, and what it makes of it."""
    element: str  # of PRIMITIVES or TEXTS, or pkg/msg/Name
    text_bound: int | None = None
    array: int | None = None  # fixed number of elements
    sequence: bool = False
    bound: int | None = None  # of a sequence

    @property
    def nested(self):
        return "/" in self.element

    def text(self, package):
        """As a .msg file of this package has it."""
        element = self.element
        if self.nested:
            of, _, name = self.element.split("/")
            element = name if of == package else f"{of}/{name}"
        if self.text_bound is not None:
            element += f"<={self.text_bound}"
        if self.array is not None:
            return f"{element}[{self.array}]"
        if self.sequence:
            return element + ("[]" if self.bound is None else f"[<={self.bound}]")
        return element


@dataclass
class Field:
    type: Type
    name: str
    where: str
    default: object = None  # a value of the type, a list of them; None: zero, empty


@dataclass
class Constant:
    type: str
    name: str
    value: object


@dataclass
class Message:
    package: str
    name: str
    path: Path
    fields: list[Field] = field(default_factory=list)
    constants: list[Constant] = field(default_factory=list)

    @property
    def full_name(self):
        return f"{self.package}/msg/{self.name}"

    def add(self, made, where):
        """One more field or constant."""
        kind = FIELD_NAME if isinstance(made, Field) else CONSTANT_NAME
        if not kind.fullmatch(made.name):
            rule = "lower case, digits and single _" if isinstance(made, Field) else "upper case, digits and single _"
            raise Refused(where, f"'{made.name}' is no name for a {type(made).__name__.lower()}: {rule}, a letter first")
        if any(known.name == made.name for known in self.fields + self.constants):
            raise Refused(where, f"'{made.name}' is there twice")
        (self.fields if isinstance(made, Field) else self.constants).append(made)

    def definition(self):
        """As a .msg file, without comments."""
        lines = [f"{c.type} {c.name}={literal(c.value)}" for c in self.constants]
        for f in self.fields:
            if f.name == EMPTY:
                continue
            default = "" if f.default is None else " " + literal(f.default)
            lines.append(f"{f.type.text(self.package)} {f.name}{default}")
        return "".join(line + "\n" for line in lines)


def literal(value):
    """A value as a .msg file has it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return "[" + ", ".join(literal(v) for v in value) + "]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\t", "\\t") + '"'
    return repr(value)


def check_value(type_name, value, where):
    """`value` as one of this primitive type or text; raises Refused where it is none."""
    if type_name == "bool":
        if isinstance(value, bool):
            return value
        if isinstance(value, int) and value in (0, 1):
            return bool(value)
    elif type_name in INTEGERS:
        low, high = INTEGERS[type_name]
        if isinstance(value, int) and not isinstance(value, bool):
            if low <= value <= high:
                return value
            raise Refused(where, f"{value} is beyond {type_name}: {low} to {high}")
    elif type_name in ("float32", "float64"):
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            try:
                return float(value)
            except OverflowError:
                raise Refused(where, f"{value} is beyond {type_name}") from None
    elif isinstance(value, str):
        return value
    raise Refused(where, f"{literal(value)} is no {type_name}")


def check_default(type_, value, where):
    if type_.nested:
        raise Refused(where, f"a field of type {type_.element} cannot have a default value")
    many = type_.array is not None or type_.sequence
    if many != isinstance(value, list):
        raise Refused(where, f"the default value {literal(value)} is {'a' if many else 'no'} single value"
                      f"{', not a list in [ ]' if many else ''}")
    if not many:
        checked = check_value(type_.element, value, where)
        check_text(type_, checked, where)
        return checked
    if type_.array is not None and len(value) != type_.array:
        raise Refused(where, f"{len(value)} default values for {type_.array} elements")
    if type_.bound is not None and len(value) > type_.bound:
        raise Refused(where, f"{len(value)} default values for at most {type_.bound} elements")
    for v in value:
        check_text(type_, check_value(type_.element, v, where), where)
    return [check_value(type_.element, v, where) for v in value]


def check_text(type_, value, where):
    if type_.text_bound is not None and len(value.encode()) > type_.text_bound:
        raise Refused(where, f"the default value has more than {type_.text_bound} bytes")


class Library:
    """Finds types below some folders, <package>/msg/<Type>.msg or .idl, and reads each once."""

    def __init__(self, roots, readers):
        self.roots = roots
        self.readers = readers  # ".msg" -> function(text, Message)
        self.known = {}

    def find(self, name, where):
        """The type pkg/msg/Name, read."""
        if name in self.known:
            return self.known[name]
        for root in self.roots:
            for suffix in self.readers:
                path = root / f"{name}{suffix}"
                if path.is_file():
                    return self.read(name, path)
        raise Refused(where, f"there is no {name}.msg or .idl below {', '.join(map(str, self.roots))}")

    def read(self, name, path):
        package, folder, short = name.split("/")
        if not PACKAGE.fullmatch(package) or folder != "msg" or not TYPE_NAME.fullmatch(short):
            raise Refused(path, "is not called <package>/msg/<Type>: the package in lower case, the type in CamelCase")
        message = Message(package, short, path)
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError as error:
            raise Refused(path, f"is not UTF-8: {error.reason} at byte {error.start}") from None
        self.known[name] = message
        self.readers[path.suffix](text, message)
        if not message.fields:
            message.fields.append(Field(Type("uint8"), EMPTY, f"{path}"))
        return message

    def needs(self, message, above=()):
        """Types that it holds, directly or not, each before those that hold it; the type itself comes last."""
        if message.full_name in above:
            circle = (*above[above.index(message.full_name):], message.full_name)
            raise Refused(message.path, f"holds itself: {' holds '.join(circle)}")
        found = {}
        for f in message.fields:
            if f.type.nested:
                for inner in self.needs(self.find(f.type.element, f.where), (*above, message.full_name)):
                    found[inner.full_name] = inner
        found[message.full_name] = message
        return list(found.values())

    def schema(self, message):
        """As MCAP's schema encoding "ros2msg": the definition, then those of what it needs, each behind a line of 80 =."""
        text = message.definition()
        for inner in self.needs(message)[:-1]:
            text += f"{'=' * 80}\nMSG: {inner.package}/{inner.name}\n{inner.definition()}"
        return text
