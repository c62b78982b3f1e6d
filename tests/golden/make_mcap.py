#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes tests/golden/errors/mcap/: MCAP files that must be refused, each for one fault. usage: make_mcap.py [FOLDER]"""
import pathlib
import struct
import sys

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "integration"))
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
CASES = {
    "attachment-in-chunk": Writer().add(ONE + record(ATTACHMENT, b"")).end(b""),
    "bytes-behind-data-end": Writer().add(ONE).raw(record(DATA_END, bytes(4))).end(b""),
    "channel-cut": plain(TYPE, TOPIC[:1] + struct.pack("<Q", 20) + TOPIC[9:29]),
    "channel-differs": plain(TYPE, TOPIC, channel(1, 1, "/other")),
    "channel-not-in-summary": with_summary(lambda w: TYPE + TOPIC + w.statistics(channels=1) + index(w),
                                           ONE + channel(2, 1, "/other") + message(2, 1001, b"two")),
    "channel-without-schema": plain(channel(1, 7, "/chatter")),
    "chunk-bomb": Writer().raw(chunk(ONE, "zstd", size=1 << 40)).end(b""),
    "chunk-checksum": Writer().raw(changed(chunk(ONE), len(chunk(ONE)) - 1, 0)).end(b""),
    "chunk-compression-unknown": Writer().raw(chunk(ONE, "bz2")).end(b""),
    "chunk-cut": Writer().raw(record(CHUNK, bytes(30))).end(b""),
    "chunk-in-chunk": Writer().add(ONE + chunk(ONE)).end(b""),
    "chunk-lz4-damaged": Writer().raw(chunk(ONE, "lz4")).end(b""),
    "chunk-message-of-another-time": Writer().raw(chunk(ONE, times=[2000])).end(b""),
    "chunk-record-cut": Writer().raw(chunk(ONE + b"\x05\xff", times=[1000])).end(b""),
    "chunk-too-short-for-its-records": Writer().raw(
        chunk(ONE)[:41] + struct.pack("<Q", len(ONE) + 1) + chunk(ONE)[49:]).end(b""),
    "chunk-two-sizes": Writer().raw(chunk(ONE, size=len(ONE) + 1)).end(b""),
    "chunk-zstd-longer": Writer().raw(chunk(ONE, "zstd", size=len(ONE) - 1)).end(b""),
    "chunk-zstd-shorter": Writer().raw(chunk(ONE, "zstd", size=len(ONE) + 1)).end(b""),
    "data-end-cut": whole().end(b"", data_end=record(DATA_END, b"")),
    "data-end-missing": whole().end(data_end=b""),
    "data-section-checksum": whole().end(data_end=record(DATA_END, b"\1\0\0\0")),
    "empty-file": b"",
    "footer-in-the-middle": Writer().add(ONE).raw(record(FOOTER, bytes(20))).end(b""),
    "footer-missing": whole().end()[:-37] + bytes(29) + MAGIC,
    "header-missing": MAGIC + TYPE + plain(TOPIC)[8 + len(header()):],
    "header-short": MAGIC + record(HEADER, b"") + plain(TYPE)[8 + len(header()):],
    "header-twice": Writer().raw(header()).add(ONE).end(b""),
    "index-missing-a-chunk": Writer().add(ONE).add(message(1, 1001, b"two")).end(
        TYPE + TOPIC + Writer().add(ONE).add(message(1, 1001, b"")).statistics() + Writer().add(ONE).indexes[0]),
    "index-of-another-place": with_summary(lambda w: TYPE + TOPIC + w.statistics()
                                           + changed(index(w), 9 + 16, index(w)[9 + 16] ^ 1)),
    "message-cut": plain(TYPE, TOPIC, record(MESSAGE, bytes(21))),
    "message-of-no-channel": plain(TYPE, TOPIC, message(2, 1000, b"one")),
    "message-of-no-channel-in-chunk": Writer().add(TYPE + TOPIC + message(2, 1000, b"one")).end(b""),
    "no-messages": whole(TYPE + TOPIC).end(),
    "no-topics": Writer().end(),
    "not-mcap": b"SQLite format 3\0 and so on, for more than a tail's length of bytes, so to speak",
    "op-zero": Writer().raw(record(0, b"")).add(ONE).end(b""),
    "record-beyond-the-end": Writer().add(ONE).raw(struct.pack("<BQ", 0x80, 1 << 63)).end(b""),
    "schema-cut": plain(record(SCHEMA, struct.pack("<HI", 1, 100))),
    "schema-differs": plain(TYPE, schema(1, "std_msgs/msg/Int32")),
    "statistics-count-another-chunk": with_summary(statistics(chunks=2)),
    "statistics-count-fewer-messages": with_summary(statistics(messages=1), ONE + message(1, 1001, b"two")),
    "statistics-count-more-messages": with_summary(statistics(messages=2)),
    "statistics-cut": with_summary(lambda w: TYPE + TOPIC + record(STATISTICS, bytes(10)) + index(w)),
    "summary-checksum": changed(whole().end(), len(whole().end()) - 9, 0x55),
    "summary-has-a-message": with_summary(lambda w: TYPE + TOPIC + message(1, 1000, b"")),
    "summary-record-cut": with_summary(lambda w: TYPE + b"\x03"),
    "summary-start-beyond": changed(whole().end(), len(whole().end()) - 24, 0x55),
    "timestamp-in-the-far-future": plain(TYPE, TOPIC, message(1, YEAR_2100 + 1, b"one")),
    "topic-has-two-types": plain(TYPE, schema(2, "std_msgs/msg/Int32"), TOPIC, channel(2, 2, "/chatter"), message(1, 1, b"")),
    "topic-name-empty": plain(TYPE, channel(1, 1, "")),
}

if __name__ == "__main__":
    folder = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "errors/mcap"
    for name, data in CASES.items():
        (folder / f"{name}.mcap").write_bytes(data)
