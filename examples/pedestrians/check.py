# SPDX-License-Identifier: Apache-2.0
"""Compares the tracks of a run with the golden ones: check.py detections.json golden.json

Tolerant of numeric noise between builds of OpenCV and libjpeg, of nothing else: nine of ten golden tracks must
be found again in their frame, with the same identity throughout, by boxes that overlap by 70 % (IoU); no more
than one of ten tracks may be new; no frame may be missing."""
import json
import sys


def iou(a, b):
    width = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    height = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    return width * height / (a[2] * a[3] + b[2] * b[3] - width * height)


def main():
    with open(sys.argv[1]) as file:
        run = {f["frame"]: f["tracks"] for f in json.load(file)["frames"]}
    with open(sys.argv[2]) as file:
        golden = {f["frame"]: f["tracks"] for f in json.load(file)["frames"]}
    missing = sorted(set(golden) - set(run))
    if missing:
        print(f"frames without result: {missing}")
        return 1
    identity, person, expected, found, extra = {}, {}, 0, 0, 0
    for frame, tracks in golden.items():
        unmatched = list(run[frame])
        for track in tracks:
            expected += 1
            best = max(unmatched, key=lambda t: iou(t["box"], track["box"]), default=None)
            if best is None or iou(best["box"], track["box"]) < 0.7:
                continue
            if identity.setdefault(track["id"], best["id"]) != best["id"]:
                continue
            if person.setdefault(best["id"], track["id"]) != track["id"]:  # two people under one identity
                continue
            unmatched.remove(best)
            found += 1
        extra += len(unmatched)
    good = expected > 0 and found >= 0.9 * expected and extra <= 0.1 * expected
    print(f"pedestrians: {found} of {expected} golden tracks found in {len(golden)} frames, {extra} others: "
          f"{'as expected' if good else 'NOT as expected'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
