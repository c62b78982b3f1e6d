# SPDX-License-Identifier: Apache-2.0
"""docs/netlink/xauto.yaml says what include/uapi/xauto/netlink.h says: every name, number and limit, both ways; and
what a request may hold is what kmod/netlink.c takes."""
import pathlib
import re
import sys

import yaml

SOURCE = pathlib.Path(__file__).resolve().parents[2]
HEADER = (SOURCE / "include/uapi/xauto/netlink.h").read_text()
DOOR = (SOURCE / "kmod/netlink.c").read_text()
SPEC = yaml.safe_load((SOURCE / "docs/netlink/xauto.yaml").read_text())
failures = []


def same(what, wanted, found):
    if wanted != found:
        failures.append(f"{what}: the header has {wanted}, the spec {found}")


def upper(name):
    return name.upper().replace("-", "_")


def header_enum(name):
    """Enumerators and values, without the first, UNSPEC, and the last, __..._MAX."""
    body = re.search(rf"enum {name} {{(.*?)}};", HEADER, re.S).group(1)
    body = re.sub(r"/\*.*?\*/", "", body, flags=re.S)
    values, following = {}, 0
    for enumerator, value in re.findall(r"(\w+)(?:\s*=\s*(\d+))?\s*,", body):
        following = int(value) if value else following
        if not enumerator.startswith("__") and not enumerator.endswith("_UNSPEC"):
            values[enumerator] = following
        following += 1
    return values


def spec_values(prefix, entries):
    values, following = {}, 1
    for entry in entries:
        following = entry.get("value", following)
        values[upper(prefix + entry["name"])] = following
        following += 1
    return values


constants = {upper(c["c-define-name"]): c["value"] for c in SPEC["definitions"] if c["type"] == "const"}
constants["XAUTO_FAMILY_VERSION"] = SPEC["version"]
same("constants", {name: int(value) for name, value in re.findall(r"#define (XAUTO_\w+) (\d+)\n", HEADER)}, constants)
same("family", re.search(r'XAUTO_FAMILY_NAME "(\w+)"', HEADER).group(1), SPEC["name"])
same("group", re.search(r'XAUTO_MCGRP_EVENTS "(\w+)"', HEADER).group(1), SPEC["mcast-groups"]["list"][0]["name"])
for enum in (d for d in SPEC["definitions"] if d["type"] == "enum"):
    same(enum["name"], header_enum(enum["enum-name"]), spec_values(enum["name-prefix"], enum["entries"]))
for attributes in SPEC["attribute-sets"]:
    same(attributes["name"], header_enum(attributes["enum-name"]),
         spec_values(attributes["name-prefix"], attributes["attributes"]))
operations = SPEC["operations"]
same("commands", header_enum(operations["enum-name"]), spec_values(operations["name-prefix"], operations["list"]))

# The type that the header's comment names, of each attribute.
comments = dict(re.findall(r"XAUTO_A_(\w+),\s*/\* (\w+)", HEADER))
for attribute in SPEC["attribute-sets"][0]["attributes"]:
    if attribute["type"] not in ("pad", "indexed-array"):
        same(f"type of {attribute['name']}", comments.get(upper(attribute["name"])), attribute["type"])

# What a request may hold: the attributes of the command's policy.
policies = {name: set(re.findall(r"\[XAUTO_A_(\w+)\]", body))
            for name, body in re.findall(r"(xauto_\w+_policy)\[XAUTO_A_MAX \+ 1\] = {(.*?)\n}", DOOR, re.S)}
used = dict(re.findall(r"\.cmd = XAUTO_CMD_(\w+),.*?\.policy = (\w+),", DOOR, re.S))
assert len(used) == 5 and len(policies) == 4, "the test no longer finds what it compares"
for operation in operations["list"]:
    if "do" in operation:
        same(f"request of {operation['name']}", policies[used[upper(operation["name"])]],
             {upper(name) for name in operation["do"]["request"]["attributes"]})

for failure in failures:
    print(failure)
sys.exit(1 if failures else 0)
