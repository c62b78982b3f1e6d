#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The pictures in docs/img that our own pages give: after `make demo`,

    tests/browser/figures.py build/demo docs/img
"""
import os
import struct
import sys
import zlib

import browser

CHAIN, RESULT = "lane", "camera/front -> pr.predict"
SCHEDULES = {"ros2": "ROS 2 model", "xauto": "XAuto"}


def panel(chain):
    return f"[...document.querySelectorAll('section')].find(s => s.querySelector('h2').textContent === {chain!r})"


def box(page, element):
    return page.js(f"""(() => {{ const r = {element}.getBoundingClientRect();
        return {{x: r.x, y: r.y + scrollY, width: r.width, height: r.height}}; }})()""")


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


def picture(page, out, name, element):
    path = os.path.join(out, name + ".png")
    page.screenshot(path, clip=box(page, element))
    smaller(path)
    print(path, os.path.getsize(path))


def main(demo, out):
    with browser.Browser(width=1000) as page:
        for scheme in ("light", "dark"):
            page.scheme(scheme)
            page.open(os.path.join(demo, "rates/report.html"))
            picture(page, out, "report-" + scheme, panel(CHAIN))
        page.scheme("light")
        page.open(os.path.join(demo, "report.html"))
        for name, policy in SCHEDULES.items():
            # The rows of the XPUs, which are the last ones of the slowest release.
            page.js(f"""(() => {{ const d = [...{panel(RESULT)}.querySelectorAll('details')].find(d =>
                d.querySelector('summary').textContent.startsWith({policy + ': slowest'!r}));
                d.open = true;
                const h = [...d.querySelectorAll('h3')].find(h => h.textContent === 'Who had the XPUs');
                const b = document.createElement('div'); b.id = {name!r}; h.replaceWith(b);
                while (b.nextSibling) b.appendChild(b.nextSibling); }})()""")
            picture(page, out, "schedule-" + name, f"document.getElementById({name!r})")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*sys.argv[1:])
