# SPDX-License-Identifier: Apache-2.0
"""Prometheus's text format, version 0.0.4, read strictly: from https://prometheus.io/docs/instrumenting/exposition_formats/ and the
naming rules at https://prometheus.io/docs/practices/naming/. What that page leaves open, and no writer needs, is refused, too."""
import math
import re

NAME = r"[a-zA-Z_:][a-zA-Z0-9_:]*"
LABEL = r"[a-zA-Z_][a-zA-Z0-9_]*"
SAMPLE = re.compile(rf"({NAME})(?:\{{(.*)\}})? (\S+)")
PAIR = re.compile(rf'({LABEL})="((?:[^"\\\n]|\\\\|\\"|\\n)*)"(?:,|$)')
UNITS_NOT_BASE = ("_us", "_ms", "_ns", "_microseconds", "_milliseconds", "_nanoseconds", "_percent", "_kilobytes")


class Metric:
    def __init__(self, name, help_text):
        self.name, self.help, self.type, self.samples = name, help_text, None, []


def labels_of(text):
    labels, at = {}, 0
    while text is not None and at < len(text):
        match = PAIR.match(text, at)
        assert match, f"no label at: {text[at:]!r}"
        assert match[1] not in labels, f"label twice: {text!r}"
        labels[match[1]] = re.sub(r"\\(.)", lambda m: "\n" if m[1] == "n" else m[1], match[2])
        at = match.end()
    return labels


def number(text):
    if text in ("+Inf", "-Inf", "NaN"):
        return float(text.replace("Inf", "inf"))
    assert re.fullmatch(r"-?\d+(\.\d+)?(e[+-]?\d+)?", text), f"no number: {text!r}"
    return float(text)


def parse(text):
    """{metric: Metric}; AssertionError for what the format, or its conventions, do not allow."""
    assert text.endswith("\n"), "the last line has no end"
    metrics, now, seen = {}, None, set()
    for line in text[:-1].split("\n"):
        if line.startswith("# HELP "):
            name, help_text = line[7:].split(" ", 1)
            assert name not in metrics, f"{name}: its lines are not one group"
            now = metrics[name] = Metric(name, help_text)
            assert re.fullmatch(NAME, name) and help_text.strip(), line
            continue
        if line.startswith("# TYPE "):
            name, kind = line[7:].split(" ")
            assert now is not None and name == now.name and now.type is None and not now.samples, line
            assert kind in ("counter", "gauge", "histogram"), line
            now.type = kind
            continue
        match = SAMPLE.fullmatch(line)
        assert match, f"no line of the format: {line!r}"
        name, labels, value = match[1], labels_of(match[2]), number(match[3])
        assert now is not None and now.type, line
        allowed = {now.name + s for s in ("_bucket", "_sum", "_count")} if now.type == "histogram" else {now.name}
        assert name in allowed, f"{name} in the group of {now.name}"
        key = (name, tuple(sorted(labels.items())))
        assert key not in seen, f"twice: {line}"
        seen.add(key)
        now.samples.append((name, labels, value))
    for metric in metrics.values():
        conventions(metric)
    return metrics


def conventions(metric):
    assert metric.type and metric.samples, metric.name
    assert metric.name.startswith("xauto_"), metric.name
    assert (metric.type == "counter") == metric.name.endswith("_total"), f"{metric.name}: counters, and only they, end in _total"
    base = metric.name.removesuffix("_total")
    assert not base.endswith(UNITS_NOT_BASE), f"{metric.name}: not in base units"
    assert not metric.name.endswith(("_bucket", "_sum", "_count")), metric.name
    if metric.type == "counter":
        assert all(value >= 0 for _, _, value in metric.samples), metric.name
    if metric.type == "histogram":
        histogram(metric)


def histogram(metric):
    by_labels = {}
    for name, labels, value in metric.samples:
        bound = labels.pop("le", None)
        one = by_labels.setdefault(tuple(sorted(labels.items())), {"buckets": []})
        if name.endswith("_bucket"):
            one["buckets"].append((number(bound), value))
        else:
            assert bound is None
            one[name.removeprefix(metric.name)] = value
        if bound is not None:
            labels["le"] = bound
    for one in by_labels.values():
        bounds = [bound for bound, _ in one["buckets"]]
        counts = [count for _, count in one["buckets"]]
        assert bounds == sorted(set(bounds)) and bounds[-1] == math.inf, metric.name
        assert counts == sorted(counts) and counts[-1] == one["_count"], metric.name
        assert one["_sum"] >= 0


def value_of(metrics, name, **labels):
    """Of the one sample of this name with these labels; None: there is none."""
    family = metrics.get(name) or metrics.get(re.sub("_(bucket|sum|count)$", "", name))
    found = [value for sample, of, value in (family.samples if family else [])
             if sample == name and all(of.get(k) == v for k, v in labels.items())]
    assert len(found) <= 1, f"{name} {labels}: {len(found)} samples"
    return found[0] if found else None
