# SPDX-License-Identifier: Apache-2.0
"""Of what the MCAP files of mcap.txt are made; its expressions see these names."""
import pathlib
import struct  # noqa: F401
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "integration"))
from mcap_file import *  # noqa: E402,F403

TYPE = schema(1, "std_msgs/msg/String")
TOPIC = channel(1, 1, "/chatter")
ONE = TYPE + TOPIC + message(1, 1000, b"one")


def whole(records=ONE, **options):
    return Writer().add(records, **options)


def with_summary(summary, records=ONE):
    return whole(records).end(summary(whole(records)))


def changed(data, at, byte):
    return data[:at] + bytes([byte]) + data[at + 1:]


def plain(*records):
    """Records outside of chunks, without a summary."""
    return Writer().add(b"".join(records), chunked=False).end(b"")


def index(writer):
    return writer.indexes[0]


def statistics(**values):
    return lambda w: TYPE + TOPIC + w.statistics(**values) + index(w)


YEAR_2100 = 4_102_444_800_000_000_000
