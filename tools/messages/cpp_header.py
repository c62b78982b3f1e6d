# SPDX-License-Identifier: Apache-2.0
"""Message types as C++: a struct, and what xauto/cdr.h needs to know of it."""
from __future__ import annotations

import math
import re

from interface import EMPTY

CPP = {"bool": "bool", "byte": "std::uint8_t", "char": "std::uint8_t", "float32": "float", "float64": "double", "string": "std::string",
       "wstring": "std::u16string",
       **{name: f"std::{name}_t" for name in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")}}
KEYWORDS = set("""alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t char32_t class compl concept
const consteval constexpr constinit const_cast continue co_await co_return co_yield decltype default delete do double dynamic_cast else enum
explicit export extern false float for friend goto if inline int long mutable namespace new noexcept not not_eq nullptr operator or or_eq
private protected public register reinterpret_cast requires return short signed sizeof static static_assert static_cast struct switch
template this thread_local throw true try typedef typeid typename union unsigned using virtual void volatile wchar_t while xor
xor_eq""".split())


def header_name(message):
    """As ROS 2 calls its headers, which end with .hpp: sensor_msgs/msg/point_cloud2.h"""
    name = re.sub(r"(.)([A-Z][a-z]+)", r"\1_\2", message.name)
    name = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).lower()
    return f"{message.package}/msg/{name}.h"


def cpp_name(name):
    return name + "_" if name in KEYWORDS else name


def cpp_type(type_):
    element = "::" + type_.element.replace("/", "::") if type_.nested else CPP[type_.element]
    if type_.array is not None:
        return f"std::array<{element}, {type_.array}>"
    return f"std::vector<{element}>" if type_.sequence else element


def number(type_name, value):
    if type_name == "bool":
        return "true" if value else "false"
    if type_name in ("float32", "float64"):
        cpp = CPP[type_name]
        if math.isnan(value):
            return f"std::numeric_limits<{cpp}>::quiet_NaN()"
        if math.isinf(value) or type_name == "float32" and abs(value) > 3.4028235677973366e38:
            return f"{'-' if value < 0 else ''}std::numeric_limits<{cpp}>::infinity()"
        return repr(value) + ("F" if type_name == "float32" else "")
    if value == -(1 << 63):
        return "std::numeric_limits<std::int64_t>::min()"
    return str(value) + ("U" if type_name == "uint32" else "ULL" if type_name == "uint64" else "LL" if type_name == "int64" else "")


def text(value, wide=False):
    """A literal of exactly these characters."""
    out = ""
    for c in value:
        if wide and ord(c) > 0x7e:
            out += f"\\u{ord(c):04x}" if ord(c) <= 0xffff else f"\\U{ord(c):08x}"
        elif c == "\n":
            out += "\\n"
        elif 0x20 <= ord(c) <= 0x7e and c not in "\\\"?":
            out += c
        else:
            out += "".join(f"\\{byte:03o}" for byte in c.encode())
    return ('u"' if wide else '"') + out + '"'


def value_of(type_, value):
    """An initialiser for a field; None: nothing."""
    if value is None:
        return ""
    if isinstance(value, list):
        inner = ", ".join(element_of(type_.element, v) for v in value)
        return f"{{{inner}}}" if type_.sequence else f"{{{{{inner}}}}}"
    return f"{{{element_of(type_.element, value)}}}"


def element_of(element, value):
    return text(value, element == "wstring") if element in ("string", "wstring") else number(element, value)


def constant(made):
    if made.type == "string":
        return f"  static constexpr std::string_view {made.name}{{{text(made.value)}, {len(made.value.encode())}}};\n"
    if made.type == "wstring":
        units = len(made.value.encode("utf-16-le")) // 2
        return f"  static constexpr std::u16string_view {made.name}{{{text(made.value, True)}, {units}}};\n"
    return f"  static constexpr {CPP[made.type]} {made.name} = {number(made.type, made.value)};\n"


def visit(field):
    """How xauto/cdr.h is told of a field: with the bounds that it has."""
    type_, name = field.type, f"m.{cpp_name(field.name)}"
    inner = [] if type_.text_bound is None else [f"{type_.text_bound}U"]
    if not type_.sequence:
        return f"    visit({', '.join([name, *inner])});\n"
    bound = [] if type_.bound is None else [f"{type_.bound}U"]
    if inner and not bound:
        bound = ["xauto::cdr::kUnbounded"]
    return f"    visit({', '.join([name, *bound, *inner])});\n"


def raw(definition):
    """A literal for each line."""
    lines = definition.splitlines(keepends=True)
    return "\n".join(f"      {text(line)}" for line in lines) or '      ""'


def header(message, library, max_bytes=None):
    """The whole header of one type. `max_bytes`: Codec's kMaxBytes."""
    needs = sorted({header_name(library.find(f.type.element, f.where)) for f in message.fields if f.type.nested})
    includes = "".join(f"#include <{name}>\n" for name in needs)
    fields = "".join(f"  {cpp_type(f.type)} {cpp_name(f.name)}{value_of(f.type, f.default) or '{}'};\n" for f in message.fields)
    constants = "".join(constant(c) for c in message.constants)
    cpp = f"{message.package}::msg::{message.name}"
    first = message.fields[0]
    stamp = ""
    if first.type.element == "std_msgs/msg/Header" and first.type.array is None and not first.type.sequence:
        stamp = (f"  static std::int64_t stamp_ns(const {cpp}& m) {{\n"
                 f"    return std::int64_t{{m.{cpp_name(first.name)}.stamp.sec}} * 1'000'000'000 + m.{cpp_name(first.name)}.stamp.nanosec;\n"
                 "  }\n")
    limit = "" if max_bytes is None else f"  static constexpr std::size_t kMaxBytes = {max_bytes};\n"
    empty = " // has no fields in its definition" if first.name == EMPTY else ""
    return f"""// Made of {message.full_name}{message.path.suffix} by XAuto's tools/messages.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/cdr.h>
{includes and chr(10)}{includes}
namespace {message.package}::msg {{

struct {message.name} {{{empty}
{constants}{fields}
  bool operator==(const {message.name}&) const = default;
}};

}}  // namespace {message.package}::msg

template <>
struct xauto::Interface<{cpp}> {{
  static constexpr const char* kName = "{message.full_name}";
  static constexpr const char* kSchema =
{raw(library.schema(message))};
  template <class Message, class Visit>
  static void fields(Message& m, Visit&& visit) {{
{"".join(visit(f) for f in message.fields)}  }}
{stamp}}};
template <>
struct xauto::Codec<{cpp}> : xauto::cdr::MessageCodec<{cpp}> {{
{limit}}};
"""
