# SPDX-License-Identifier: Apache-2.0
"""docs/schema/ against real files: the golden ones, the examples', the malformed ones, and what the tools write. The
validator below is the subset of JSON Schema (draft 2020-12) that the schemas use; a keyword that it does not know is a
failure. That the schemas have the readers' keys is tested in tests/unit/model/keys_test.cc."""
import json
import pathlib
import re
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "integration"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "golden/errors"))
from cases import cases  # noqa: E402
import onnx_file
from common import APP, DRIVING, SOURCE, xauto  # noqa: E402

TYPES = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None), "number": (int, float),
         "integer": int}


def is_type(value, name):
    if isinstance(value, bool):
        return name == "boolean"
    return isinstance(value, TYPES[name])


def errors(value, schema, root, where=""):
    """What is wrong with value, as a list of texts."""
    def wrong(what):
        return [f"{where or '/'}: {what}"]

    found = []
    for word, rule in schema.items():
        if word in ("$schema", "$id", "$defs", "title", "description"):
            continue
        if word == "$ref":
            assert rule.startswith("#/$defs/"), rule
            found += errors(value, root["$defs"][rule[len("#/$defs/"):]], root, where)
        elif word == "type":
            names = rule if isinstance(rule, list) else [rule]
            if not any(is_type(value, name) for name in names):
                found += wrong(f"is no {' or '.join(names)}")
        elif word == "const":
            found += [] if value == rule and type(value) is type(rule) else wrong(f"is not {rule!r}")
        elif word == "enum":
            found += [] if value in rule else wrong(f"is none of {rule}")
        elif word in ("anyOf", "oneOf"):
            fit = sum(not errors(value, one, root, where) for one in rule)
            found += [] if fit == 1 or (fit > 1 and word == "anyOf") else wrong(f"fits {fit} of {word}")
        elif word in ("minimum", "maximum"):
            if is_type(value, "number") and (value < rule if word == "minimum" else value > rule):
                found += wrong(f"is out of range: {word} {rule}")
        elif word in ("minLength", "maxLength", "pattern"):
            if isinstance(value, str) and (len(value) < rule if word == "minLength" else
                                           len(value) > rule if word == "maxLength" else
                                           not re.search(rule, value)):
                found += wrong(f"{word} {rule}")
        elif word in ("minItems", "maxItems"):
            if isinstance(value, list) and (len(value) < rule if word == "minItems" else len(value) > rule):
                found += wrong(f"{word} {rule}")
        elif word == "items":
            for i, element in enumerate(value if isinstance(value, list) else []):
                found += errors(element, rule, root, f"{where}/{i}")
        elif word in ("minProperties", "maxProperties"):
            if isinstance(value, dict) and (len(value) < rule if word == "minProperties" else len(value) > rule):
                found += wrong(f"{word} {rule}")
        elif word == "required":
            if isinstance(value, dict):
                found += [e for key in rule if key not in value for e in wrong(f"{key} is missing")]
        elif word == "propertyNames":
            for key in value if isinstance(value, dict) else []:
                found += errors(key, rule, root, f"{where}/{key}")
        elif word in ("properties", "patternProperties", "additionalProperties"):
            pass  # below, together
        else:
            raise AssertionError(f"keyword {word} is not in this validator")
    if isinstance(value, dict):
        for key, member in value.items():
            rules = [schema["properties"][key]] if key in schema.get("properties", {}) else []
            rules += [r for p, r in schema.get("patternProperties", {}).items() if re.search(p, key)]
            rest = schema.get("additionalProperties", True)
            if not rules and rest is False:
                found.append(f"{where}/{key}: is no key of this format")
            for rule in rules or ([rest] if isinstance(rest, dict) else []):
                found += errors(member, rule, root, f"{where}/{key}")
    return found


SCHEMAS = {p.name.split(".")[0]: json.loads(p.read_text()) for p in (SOURCE / "docs/schema").glob("*.schema.json")}


def check(format_, document, what):
    found = errors(document, SCHEMAS[format_], SCHEMAS[format_])
    assert not found, f"{what}: {found[:3]}"


def test_the_validator_sees_what_it_should():
    schema = {"type": "object", "properties": {"a": {"type": "integer", "minimum": 1}}, "required": ["a"],
              "patternProperties": {"^x-": {}}, "additionalProperties": False}
    for good in ({"a": 1}, {"a": 2, "x-b": []}):
        assert not errors(good, schema, schema), good
    for bad in ({}, {"a": 0}, {"a": True}, {"a": 1.5}, {"a": 1, "b": 2}, [], 5):
        assert errors(bad, schema, schema), bad


def test_every_format_has_a_schema():
    table = re.findall(r"`xauto\.(\w+)` (\d)", (SOURCE / "docs/formats.md").read_text())
    named = {name: int(version) for name, version in table}
    assert set(named) == set(SCHEMAS), (sorted(named), sorted(SCHEMAS))
    for name, schema in SCHEMAS.items():
        assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema", name
        assert schema["properties"]["schema"] == {"const": f"xauto.{name}"}, name
        assert schema["properties"]["version"] == {"const": named[name]}, name


def test_golden_files_and_examples_are_valid():
    files = [p for p in (SOURCE / "tests/golden").glob("*.json")] + list((SOURCE / "examples").rglob("*.json"))
    seen = set()
    for path in files:
        document = json.loads(path.read_text())
        if "schema" not in document:
            continue
        format_ = document["schema"].split(".")[1]
        seen.add(format_)
        check(format_, document, path)
    assert seen >= {"app", "platform", "policy", "profile", "deployment", "scenarios", "tables"}, seen


# What only a program can see: what holds between values, or bytes that a parser of JSON does not show.
BEYOND = {
        "app": {"beside-faster-than-alone", "beside-on-no-implementation", "beside-twice",
            "chain-behind-all-that-does-not-connect", "chain-from-an-xnode", "chain-name-twice",
            "chain-that-does-not-connect", "chain-that-returns-to-a-component", "chain-to-unknown-xnode",
            "chains-of-all-from-unknown-source", "chains-of-all-from-what-nobody-hears-of",
            "chains-of-all-to-unknown-xnode", "chains-of-all-to-what-is-not-last", "clock-listed-twice",
            "clock-main-listed-twice", "cycle", "duplicate-key", "edge-self", "edge-to-unknown-xnode", "edge-twice",
            "edge-twice-once-with-a-transfer", "edge-unknown-xnode", "join-of-two-clocks", "join-of-two-periods",
            "memory-of-no-implementation", "module-in-two-components", "module-listed-twice", "module-without-xnodes",
            "offset-of-a-fraction-of-a-period", "offset-of-a-period", "rate-below-one-an-hour", "rate-divided-by-zero",
            "rate-too-long", "rate-without-a-tick", "rate-zero", "rates-without-a-common-tick", "root-of-two-clocks",
            "root-of-two-periods", "sample-forward-inside-a-component", "sample-twice", "sample-unknown-xnode",
            "source-behind-an-edge", "source-heard-twice", "source-name-twice", "source-unknown",
            "source-with-two-periods", "transfer-from-a-type-without-implementation",
            "transfer-to-a-type-without-implementation", "typical-above-wcet", "typical-of-no-implementation",
            "urgent-above-period", "urgent-too-often", "variant-name-twice", "without-a-rate-in-flight",
            "without-a-rate-sample", "xnode-name-twice", "xnode-without-source"},
    "platform": {"duplicate-key", "host-missing", "host-unknown", "host-without-xpu", "hosts-same", "id-twice", "link-to-itself",
                 "link-twice", "link-unknown"},
    "profile": {"beside-does-not-ascend", "edge-unknown-xnode", "reading-out-of-its-range", "reading-twice",
                "source-behind-an-edge", "source-name-twice", "statistics-do-not-ascend", "xnode-twice"},
    "policy": {"app-of-another-name", "order-across-xpus", "order-against-the-edges",
               "order-self", "order-twice", "order-unknown-xnode", "priority-twice", "stale-hash", "xnode-not-placed",
               "xnode-twice", "xnode-unknown", "xpu-unknown", "xpu-without-implementation",
               "xpu-without-implementation-other-order"},
    "policy-keys": {"app-of-another-name", "wcet-of-one-that-states-none", "chain-missing", "chain-twice", "chain-unknown", "crossing-without-hosts",
                 "finish-after-key",
                 "finish-before-start", "hold-of-another-size", "key-before-hold-and-work",
                 "key-before-offset-and-work", "key-before-predecessor-and-work",
                 "key-before-predecessor-other-order", "key-before-predecessor-transfer-and-work",
                 "key-before-the-work", "key-falls-around-the-end", "key-falls", "key-zero",
                 "keys-more-than-activations", "keys-that-do-not-divide", "order-across-xpus", "order-against-the-edges",
                 "order-of-two-clocks", "order-unknown-xnode", "stale-hash", "start-before-hold",
                 "start-without-finish", "xnode-not-placed", "xnode-twice", "xnode-unknown", "xpu-unknown",
                 "xpu-without-implementation"},
    "scenarios": {"another-app", "lost-twice", "lost-unknown", "name-twice", "no-implementation", "type-unknown",
                  "xnode-unknown", "when-both", "when-empty-range", "when-nothing"},
    "emulation": {"order", "twice", "type-unknown", "stop-unknown", "stop-twice", "stop-and-start", "nothing",
                  "repeat-too-soon"},
    "demand": {"ready-after-key", "release-beyond-the-period", "slip-of-what-is-not-once", "start-after-ready",
               "start-before-the-release", "xpu-twice"},
    "tables": {"another-app", "more-than-its-table", "not-placed", "not-served", "order-cycle", "order-of-two-xpus", "placed-twice",
               "scenario-unknown", "served-twice", "stale", "table-twice",
               "table-unknown", "xpu-of-no-implementation", "xpu-unknown"},
    "tables-keys": {"chain-missing", "chain-twice", "chain-unknown", "handover-claims-what-is-off",
                 "handover-off-where-both-have-it", "handover-off-with-a-worst-case", "handover-to-an-unknown-table",
                 "handovers-not-all", "handovers-out-of-order", "key-count", "key-too-early-for-what-it-serves",
                 "keys-that-fall", "less-than-its-table", "loses-where-it-is-not-degraded", "not-off-and-no-chain", "not-placed",
                 "off-and-not-optional", "order", "off-chain-with-a-bound", "off-chain-with-a-worst-case", "off-with-an-xpu",
                 "off-without-a-key", "serves-with-a-lost-xpu", "variant-unknown"},
}


def test_malformed_files_are_invalid_unless_only_a_program_can_see_it():
    caught = 0
    for format_ in BEYOND:
        passed = set()
        for case in cases(format_):
            try:
                document = json.loads(case.data, parse_constant=lambda c: 1 / 0)
            except (ValueError, ZeroDivisionError, RecursionError):
                continue
            schema = SCHEMAS[format_.partition("-")[0]]  # of tables-keys, too
            if errors(document, schema, schema):
                caught += 1
            else:
                passed.add(case.name)
        assert passed == BEYOND[format_], (format_, sorted(passed ^ BEYOND[format_]))
    assert caught > 50, caught


def test_what_the_tools_write_is_valid():
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)

        def written(format_, *arguments, out):
            done = xauto(*arguments, cwd=folder)
            assert done.returncode == 0, done.stderr
            check(format_, json.loads((folder / out).read_text()), out)

        written("app", "generate", "--nodes", 12, "--seed", 3, "--out", "a.json", out="a.json")
        written("policy", "solve", "--app", APP, "--platform", "small", "--method", "heft", "--out", "p.json",
                out="p.json")
        scenarios = {"schema": "xauto.scenarios", "version": 1, "app": "driving", "scenarios": [{"name": "slow", "wcet_scale_pct": {"gpu": 150}}]}
        (folder / "scenarios.json").write_text(json.dumps(scenarios))
        written("tables", "solve", "--app", APP, "--platform", "small", "--scenarios", "scenarios.json", "--tables", 1,
                "--max-evaluations", 200, "--time-limit", "60s", "--out", "t.json", out="t.json")
        written("simulation", "simulate", "--app", APP, "--platform", "small", "--policy", "p.json", "--out", "s.json",
                out="s.json")
        rates = SOURCE / "examples/driving/rates.json"
        written("policy", "solve", "--app", rates, "--platform", "small", "--max-evaluations", 3000, "--out", "p2.json",
                out="p2.json")
        scenarios["app"] = "driving-rates"
        (folder / "scenarios-2.json").write_text(json.dumps(scenarios))
        written("tables", "solve", "--app", rates, "--platform", "small", "--scenarios", "scenarios-2.json", "--tables", 1,
                "--max-evaluations", 200, "--time-limit", "60s", "--out", "t2.json", out="t2.json")
        written("demand", "check", "--app", rates, "--policy", "p2.json", "--demand-out", "d.json", out="d.json")
        written("simulation", "simulate", "--app", rates, "--platform", "small", "--policy", "p2.json", "--duration", "2s",
                "--out", "s2.json", out="s2.json")
        for format_, verb in (("check", "check"), ("explanation", "explain")):
            printed = xauto(verb, "--app", rates, "--platform", "small", "--policy", "p2.json", "--json", cwd=folder).stdout
            check(format_, json.loads(printed), verb)
        crowded = json.loads(rates.read_text())
        for source in crowded["sources"]:
            source.pop("period_us", None)
            source["rate_hz"] = 200
        (folder / "crowded.json").write_text(json.dumps(crowded))
        printed = xauto("solve", "--app", "crowded.json", "--platform", "small", "--json", cwd=folder).stdout
        told = json.loads(printed)
        check("uncertified", told, "solve")
        check("policy", told["policy"], "solve")
        trace = SOURCE / "tests/golden/ros2-trace/made"
        printed = xauto("import", trace, "--json", "--out", "i.json", cwd=folder)
        if "without lib" not in printed.stderr:
            check("import", json.loads(printed.stdout), "import")
            check("app", json.loads((folder / "i.json").read_text()), "i.json")
            printed = xauto("whatif", "i.json", "--time-limit", "1s", "--json", cwd=folder).stdout
            check("whatif", json.loads(printed), "whatif")
        (folder / "net.onnx").write_bytes(onnx_file.residual(2))
        check("split", json.loads(xauto("split", "net.onnx", "--at", "1", "--out", "parts", "--json", cwd=folder).stdout), "split")
        written("report", "run", "--app", APP, "--platform", "small", "--policy", "p.json", "--emulate",
                "--lockstep", "--activations", 3, "--out", "r.json", "--", DRIVING, out="r.json")
        written("profile", "profile", "--platform", "small", "--emulate", "--warmup", 0, "--repetitions", 2, "--out",
                "f.json", "--", DRIVING, out="f.json")
        written("profile", "profile", "--platform", "small", "--emulate", "--warmup", 0, "--repetitions", 2,
                "--contended", "--out", "g.json", "--", DRIVING, out="g.json")


def test_a_typo_is_told_once_and_refused_with_strict():
    with tempfile.TemporaryDirectory() as folder:
        app = json.loads(pathlib.Path(APP).read_text())
        app["deadine_us"] = 1
        app["x-mine"] = {"pinz": 1}
        path = pathlib.Path(folder, "app.json")
        path.write_text(json.dumps(app))
        arguments = ("solve", "--app", path, "--platform", "small", "--method", "heft", "--json")
        done = xauto(*arguments)
        assert done.returncode == 0, done.stderr
        assert done.stderr.count("deadine_us") == 1 and 'did you mean "deadline_us"?' in done.stderr, done.stderr
        assert "pinz" not in done.stderr and "x-mine" not in done.stderr, done.stderr
        done = xauto(*arguments, "--strict")
        assert done.returncode == 2 and 'did you mean "deadline_us"?' in done.stderr, (done.returncode, done.stderr)


if __name__ == "__main__":
    for name, test in list(globals().items()):
        if name.startswith("test_"):
            test()
            print("ok", name)
