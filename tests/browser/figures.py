#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The pictures in docs/img that our own pages give: schedules as SVG, the report in light and dark as PNG.

    build/bin/xauto compare --app examples/driving/app.json --platform small --out build/demo -- build/bin/driving
    build/bin/xauto report build/demo/heft.pftrace --out build/demo/report.html
    tests/browser/figures.py build/demo docs/img
"""
import os
import re
import struct
import sys
import zlib

import browser

STYLE = """:root { --fg:#1c1f24; --dim:#646b76; --line:#e3e6ea; --lane:#f4f5f7; --card:#fff; --ink:#111 }
@media (prefers-color-scheme: dark) { :root { --fg:#e7e9ed; --dim:#9aa2ae; --line:#30353d; --lane:#22262d; --card:#14161a; --ink:#0b0c0e } }
text { fill:var(--fg); font:11px system-ui, sans-serif } text.dim { fill:var(--dim) } .grid { stroke:var(--line) } .lane { fill:var(--lane) }
text.latency { font-weight:650 } .end { stroke:var(--fg); stroke-width:1.5; stroke-dasharray:4 3 }
text.label { fill:var(--ink); font-size:10px }"""


def schedule(page, panel):
    svg = page.js(f"document.querySelectorAll('#panels .card')[{panel}].querySelector('svg').outerHTML")
    svg = re.sub(r"(\d+\.\d\d)\d+", r"\1", svg)
    return svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1).replace(
        "><defs", f">\n<!-- SPDX-License-Identifier: Apache-2.0; by tests/browser/figures.py -->\n<style>{STYLE}</style><defs", 1) + "\n"


def smaller(path):
    """The picture with a palette of its 256 most used colours: a third of the bytes."""
    data = open(path, "rb").read()
    at, header, packed = 8, None, b""
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8:at + 8 + size]
        header = struct.unpack(">IIBBBBB", body) if kind == b"IHDR" else header
        packed += body if kind == b"IDAT" else b""
        at += size + 12
    width, height, depth, colour = header[:4]
    assert (depth, header[6]) == (8, 0) and colour in (2, 6)
    step = 3 if colour == 2 else 4
    raw, rows, before = zlib.decompress(packed), [], bytearray(width * step)
    for y in range(height):
        start = y * (width * step + 1)
        kind, row = raw[start], bytearray(raw[start + 1:start + 1 + width * step])
        for i in range(len(row) if kind else 0):
            left = row[i - step] if i >= step else 0
            up, corner = before[i], before[i - step] if i >= step else 0
            if kind == 1:
                guess = left
            elif kind == 2:
                guess = up
            elif kind == 3:
                guess = (left + up) // 2
            else:
                guess = min((left, up, corner), key=lambda v: abs(left + up - corner - v))
            row[i] = (row[i] + guess) & 255
        rows.append([bytes(row[i:i + 3]) for i in range(0, len(row), step)])
        before = row
    count = {}
    for row in rows:
        for pixel in row:
            count[pixel] = count.get(pixel, 0) + 1
    palette = sorted(count, key=count.get, reverse=True)[:256]
    index = {pixel: n for n, pixel in enumerate(palette)}
    for pixel in count:
        if pixel not in index:
            index[pixel] = min(range(len(palette)), key=lambda n: sum((a - b) ** 2 for a, b in zip(palette[n], pixel)))

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    lines = b"".join(b"\0" + bytes(index[p] for p in row) for row in rows)
    with open(path, "wb") as out:
        out.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)) +
                  chunk(b"PLTE", b"".join(palette)) + chunk(b"IDAT", zlib.compress(lines, 9)) + chunk(b"IEND", b""))


def main(demo, out):
    with browser.Browser(width=1000) as page:
        page.open(os.path.join(demo, "timeline.html"))
        ids = page.js("DATA.panels.map(p => p.id)")
        for name in ("ros2", "xauto"):
            with open(os.path.join(out, f"schedule-{name}.svg"), "w") as file:
                file.write(schedule(page, ids.index(name)))
        page.open(os.path.join(demo, "report.html"))
        for scheme in ("light", "dark"):
            page.scheme(scheme)
            path = os.path.join(out, f"report-{scheme}.png")
            page.screenshot(path)
            smaller(path)
            print(path, os.path.getsize(path))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
