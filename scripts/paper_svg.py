# SPDX-License-Identifier: Apache-2.0
"""Pictures of `make paper`: SVG text that brings its colours for light and dark, by itself or within a page."""
import html
import math
import statistics

CSS = (".f text{fill:#1c1f24;font:13px system-ui,sans-serif}.f .s{fill:#5a6270}.f .g{stroke:#d5d9e0}.f .a{fill:#0b62c4;stroke:#0b62c4}"
       ".f .b{fill:#c2570c;stroke:#c2570c}.f .c{fill:#19794a;stroke:#19794a}.f .m{fill:none;stroke:#1c1f24;stroke-width:2}"
       ".f .w{fill:#5a6270;opacity:.22}@media(prefers-color-scheme:dark){.f text{fill:#e7e9ed}.f .s{fill:#a4acb9}.f .g{stroke:#3a404a}"
       ".f .a{fill:#6cb2ff;stroke:#6cb2ff}.f .b{fill:#ff9d5c;stroke:#ff9d5c}.f .c{fill:#62cf94;stroke:#62cf94}.f .m{stroke:#e7e9ed}.f .w{opacity:.4}}")
WIDTH, LEFT, RIGHT = 900, 60, 20


def whole(title, height, parts):
    return (f'<svg class="f" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" role="img" aria-label="{html.escape(title)}">'
            f"<!-- SPDX-License-Identifier: Apache-2.0; by scripts/paper.py --><style>{CSS}</style>"
            f'<text x="{LEFT}" y="20" font-weight="650">{html.escape(title)}</text>\n' + "\n".join(parts) + "\n</svg>\n")


def words(x, y, text, anchor="middle", kind=""):
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{kind and f" class={chr(34)}{kind}{chr(34)}"}>{html.escape(str(text))}</text>'


def legend(names, y=40):
    parts, x = [], LEFT
    for kind, name in names:
        parts.append(f'<path class="m" d="M{x} {y - 4}h14"/>' if kind == "m" else f'<rect class="{kind}" x="{x}" y="{y - 10}" width="14" height="10"/>')
        parts.append(words(x + 20, y, name, "start"))
        x += 40 + 7.5 * len(name)
    return parts


def grid(low, high, y, text):
    step = 10 ** math.floor(math.log10((high - low) or 1))
    while (high - low) / step < 4:
        step /= 2
    parts, value = [], math.ceil(low / step) * step
    while value <= high + 1e-9:
        parts += [f'<line class="g" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y(value):.1f}" y2="{y(value):.1f}"/>', words(LEFT - 8, y(value) + 4, text(value), "end", "s")]
        value += step
    return parts


def bars(title, labels, series, marks=None, mark_name="", base=1):
    """Grouped bars from `base` up; `marks`: a line over each group, or None."""
    top, height = 56, 230
    values = [v for _, of in series for v in of if v is not None] + [m for m in marks or [] if m is not None]
    high = max([*values, base + 0.1]) * 1.06
    low = min([base, *values])
    y = lambda v: top + height * (high - v) / (high - low)
    parts = [*legend([*zip("abc", [n for n, _ in series]), *([("m", mark_name)] if marks and any(marks) else [])]),
             *grid(low, high, y, lambda v: f"{v:.3g}")]
    room = (WIDTH - LEFT - RIGHT) / len(labels)
    for i, label in enumerate(labels):
        x, wide = LEFT + room * i + 8, (room - 16) / len(series)
        for k, (_, of) in enumerate(series):
            if of[i] is not None:
                parts.append(f'<rect class="{"abc"[k]}" x="{x + wide * k:.1f}" y="{min(y(of[i]), y(base)):.1f}" width="{wide - 3:.1f}" height="{abs(y(base) - y(of[i])):.1f}"/>')
                parts.append(words(x + wide * (k + 0.5) - 1, min(y(of[i]), y(base)) - 4, f"{of[i]:.2f}" if base else f"{of[i]:.0f}"))
        if marks and marks[i] is not None:
            parts.append(f'<path class="m" d="M{x:.1f} {y(marks[i]):.1f}h{room - 16:.1f}"/>')
        parts.append(words(LEFT + room * (i + 0.5), top + height + 18, label))
    return whole(title, top + height + 28, parts)


def sorted_dots(title, series):
    top, height = 56, 220
    high = max(v for _, of in series for v in of) * 1.05
    low = min(1, *(v for _, of in series for v in of))
    y = lambda v: top + height * (high - v) / (high - low)
    parts = [*legend(list(zip("abc", [n for n, _ in series]))), *grid(low, high, y, lambda v: f"{v:.3g}")]
    for k, (_, of) in enumerate(series):
        for i, v in enumerate(of):
            x = LEFT + 10 + (WIDTH - LEFT - RIGHT - 20) * (i + 0.5) / len(of)
            parts.append(f'<circle class="{"abc"[k]}" cx="{x:.1f}" cy="{y(v):.1f}" r="4"/>')
    return whole(title, top + height + 12, parts)


def columns(title, rows):
    """[(name, ROS 2's way, XAuto, bound)]"""
    top, height = 56, 250
    high, low = max(r[1] for r in rows) * 1.04, 0
    y = lambda v: top + height * (high - v) / (high - low)
    room = (WIDTH - LEFT - RIGHT) / len(rows)
    parts = [*legend([("b", "ROS 2's way"), ("a", "XAuto"), ("m", "proven bound: no policy is below")]), *grid(low, high, y, lambda v: f"{v:.3g}")]
    for i, (name, theirs, ours, bound) in enumerate(rows):
        x = LEFT + room * i
        parts.append(f'<g><title>DLA: {html.escape(name)}: {theirs:.2f}, {ours:.2f}, bound {bound:.2f}</title>'
                     f'<rect class="b" x="{x + 1:.1f}" y="{y(theirs):.1f}" width="{room / 2 - 1:.1f}" height="{y(0) - y(theirs):.1f}"/>'
                     f'<rect class="a" x="{x + room / 2:.1f}" y="{y(ours):.1f}" width="{room / 2 - 1:.1f}" height="{y(0) - y(ours):.1f}"/>'
                     f'<path class="m" d="M{x + room / 2 - 1:.1f} {y(bound):.1f}h{room / 2 + 1:.1f}"/></g>')
    parts.append(words(LEFT, y(0) + 18, f"first: {rows[0][0]} on the DLA", "start"))
    parts.append(words(WIDTH - RIGHT, y(0) + 18, f"last: {rows[-1][0]}", "end"))
    return whole(title, top + height + 28, parts)


def times(title, points, names):
    """[(N, values, values, values)], logarithmic; median and range."""
    top, height = 56, 240
    found = [v for p in points for of in p[1:] for v in of if v > 0]
    low, high = math.floor(math.log10(min(found))), math.ceil(math.log10(max(found)) + 1e-9)
    y = lambda v: top + height * (high - math.log10(v)) / (high - low)
    parts = legend(list(zip("abc", names)))
    for power in range(low, high + 1):
        parts += [f'<line class="g" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y(10.0 ** power):.1f}" y2="{y(10.0 ** power):.1f}"/>',
                  words(LEFT - 8, y(10.0 ** power) + 4, f"{10.0 ** power:g}", "end", "s")]
    room = (WIDTH - LEFT - RIGHT) / len(points)
    for i, (n, *series) in enumerate(points):
        for k, of in enumerate(series):
            of = [v for v in of if v > 0]
            if of:
                x = LEFT + room * (i + 0.25 + 0.25 * k)
                parts.append(f'<path class="{"abc"[k]}" stroke-width="2" d="M{x:.1f} {y(max(of)):.1f}V{y(min(of)):.1f}"/>'
                             f'<circle class="{"abc"[k]}" cx="{x:.1f}" cy="{y(statistics.median(of)):.1f}" r="5"/>')
        parts.append(words(LEFT + room * (i + 0.5), top + height + 18, f"N = {n}" if len(points) < 12 else n))
    return whole(title, top + height + 28, parts)


def timeline(t, longest_us):
    """A row for each module, coloured by XPU; light: it has begun and waits."""
    modules = list(dict.fromkeys(s["module"] for s in t["slices"]))
    top, row = 52, 26
    x = lambda us: LEFT + (WIDTH - LEFT - 70) * us / longest_us
    kinds = {"cpu": "c", "gpu": "a", "dla": "b"}
    parts, bottom = legend([("c", "CPU"), ("a", "GPU"), ("b", "DLA"), ("w", "waits")], 42), top + row * len(modules) + 6
    for ms in range(0, int(longest_us / 1000) + 1, 10):
        parts += [f'<line class="g" x1="{x(ms * 1000):.1f}" x2="{x(ms * 1000):.1f}" y1="{top}" y2="{bottom}"/>', words(x(ms * 1000), bottom + 16, f"{ms} ms", kind="s")]
    for i, module in enumerate(modules):
        mine = [s for s in t["slices"] if s["module"] == module and not s["switching"]]
        y = top + row * i + 4
        first, last = min(s["begin_us"] for s in mine), max(s["end_us"] for s in mine)
        parts.append(words(LEFT - 8, y + 15, module, "end"))
        parts.append(f'<rect class="w" x="{x(first):.1f}" y="{y}" width="{x(last) - x(first):.1f}" height="{row - 6}"/>')
        for s in mine:
            parts.append(f'<rect class="{kinds[s["xpu"]]}" stroke="none" x="{x(s["begin_us"]):.1f}" y="{y}" width="{max(0.5, x(s["end_us"]) - x(s["begin_us"])):.1f}" '
                         f'height="{row - 6}"><title>{s["xnode"]} {s["begin_us"] / 1000:.2f} to {s["end_us"] / 1000:.2f} ms</title></rect>')
    parts.append(words(x(t["latency_us"]) + 6, bottom - 12, f'{t["latency_us"] / 1000:.2f} ms', "start"))
    return whole(t["title"], bottom + 24, parts)
