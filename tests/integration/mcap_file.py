# SPDX-License-Identifier: Apache-2.0
"""MCAP once more, in Python's standard library and from the specification alone (https://mcap.dev/spec): what writes
and reads as lib/record does, without a line of it."""
import struct
import zlib

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)


def record(op, content):
    return struct.pack("<BQ", op, len(content)) + content


def text(value):
    value = value if isinstance(value, bytes) else value.encode()
    return struct.pack("<I", len(value)) + value


def mapping(pairs):
    return text(b"".join(text(k) + text(v) for k, v in pairs))


def header(profile="ros2", library="libmcap 0.8.0"):
    return record(HEADER, text(profile) + text(library))


def schema(number, name, encoding="ros2msg", data="uint8[] data\n"):
    return record(SCHEMA, struct.pack("<H", number) + text(name) + text(encoding) + text(data))


def channel(number, schema_number, topic, encoding="cdr", metadata=(("offered_qos_profiles", ""),)):
    return record(CHANNEL, struct.pack("<HH", number, schema_number) + text(topic) + text(encoding) + mapping(metadata))


def message(channel_number, time, data, sequence=0):
    return record(MESSAGE, struct.pack("<HIQQ", channel_number, sequence, time, time) + data)


def zstd(data):
    """A frame of which nothing is compressed: one segment, raw blocks of at most 128 KiB (RFC 8878)."""
    blocks = [data[i:i + 131072] for i in range(0, len(data), 131072)] or [b""]
    frame = struct.pack("<IBQ", 0xFD2FB528, 0b11100000, len(data))
    for i, block in enumerate(blocks):
        frame += struct.pack("<I", (i == len(blocks) - 1) | len(block) << 3)[:3] + block
    return frame


def times_of(records):
    return [struct.unpack_from("<HIQ", c)[2] for op, c in split(records) if op == MESSAGE]


def chunk(records, compression="", crc=True, times=None, size=None):
    times = times or times_of(records)
    packed = zstd(records) if compression == "zstd" else records
    return record(CHUNK, struct.pack("<QQQI", min(times, default=0), max(times, default=0),
                                     len(records) if size is None else size, zlib.crc32(records) if crc else 0)
                  + text(compression) + struct.pack("<Q", len(packed)) + packed)


def message_indexes(records):
    """One per channel that has messages, in the order in which they come first."""
    at, found = 0, {}
    for op, content in split(records):
        if op == MESSAGE:
            number, _, time = struct.unpack_from("<HIQ", content)
            found.setdefault(number, []).append(struct.pack("<QQ", time, at))
        at += 9 + len(content)
    return {n: record(MESSAGE_INDEX, struct.pack("<H", n) + text(b"".join(entries))) for n, entries in found.items()}


class Writer:
    """A file as rosbag2 writes one: chunks with their indexes, and a summary."""

    def __init__(self):
        self.data = MAGIC + header()
        self.schemas, self.channels, self.counts, self.times, self.indexes = {}, {}, {}, [], []

    def add(self, records, compression="", chunked=True, crc=False):
        """Schemas, channels and messages: as a chunk, or as they are."""
        for op, content in split(records):
            number = int.from_bytes(content[:2], "little")
            if op == MESSAGE:
                self.counts[number] = self.counts.get(number, 0) + 1
                self.times.append(struct.unpack_from("<HIQ", content)[2])
            elif op in (SCHEMA, CHANNEL):
                (self.schemas if op == SCHEMA else self.channels)[number] = record(op, content)
        if not chunked:
            self.data += records
            return self
        start, made = len(self.data), chunk(records, compression, crc)
        times = times_of(records)
        self.data += made
        offsets, length = b"", 0
        for number, index in message_indexes(records).items():
            offsets += struct.pack("<HQ", number, len(self.data))
            length += len(index)
            self.data += index
        packed = len(made) - 9 - 40 - len(compression)
        self.indexes.append(record(CHUNK_INDEX, struct.pack("<QQQQ", min(times, default=0), max(times, default=0), start, len(made))
                                   + text(offsets) + struct.pack("<Q", length) + text(compression)
                                   + struct.pack("<QQ", packed, len(records))))
        return self

    def raw(self, data):
        self.data += data
        return self

    def statistics(self, **changed):
        values = {"messages": len(self.times), "channels": len(self.channels), "chunks": len(self.indexes)} | changed
        return record(STATISTICS, struct.pack("<QHIIIIQQ", values["messages"], len(self.schemas), values["channels"], 0, 0,
                                              values["chunks"], min(self.times, default=0), max(self.times, default=0))
                      + text(b"".join(struct.pack("<HQ", n, c) for n, c in self.counts.items())))

    def end(self, summary=None, crc=True, data_end=record(DATA_END, bytes(4))):
        """`summary`: instead of the right one; b"" for none."""
        self.data += data_end
        if summary is None:
            summary = b"".join([*self.schemas.values(), *self.channels.values(), self.statistics(), *self.indexes])
        start = len(self.data) if summary else 0
        foot = struct.pack("<BQQQ", FOOTER, 20, start, 0)
        return self.data + summary + foot + struct.pack("<I", zlib.crc32(summary + foot) if crc else 0) + MAGIC


def split(data):
    """The records of a section: opcode, content."""
    at = 0
    while at < len(data):
        op, length = struct.unpack_from("<BQ", data, at)
        if at + 9 + length > len(data):
            raise ValueError(f"record {op} at {at} is longer than what follows")
        yield op, data[at + 9:at + 9 + length]
        at += 9 + length


class Fields:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, form):
        values = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return values if len(values) > 1 else values[0]

    def bytes(self):
        length = self.take("I")
        self.at += length
        if self.at > len(self.data):
            raise ValueError("a text is longer than its record")
        return self.data[self.at - length:self.at]

    def text(self):
        return self.bytes().decode()

    def pairs(self, form=None):
        inner, found = Fields(self.bytes()), {}
        while inner.at < len(inner.data):
            key = inner.take("H") if form else inner.text()
            found[key] = inner.take(form) if form else inner.text()
        return found


def read(data, unpack=None):
    """All of a file, every checksum, index and offset of it proven against what is there. `unpack`: by compression."""
    assert data[:8] == MAGIC and data[-8:] == MAGIC, "magic"
    foot = data[-37:-8]
    assert struct.unpack_from("<BQ", foot) == (FOOTER, 20), "footer"
    summary_start, offset_start, summary_crc = struct.unpack_from("<QQI", foot, 9)
    assert summary_crc == zlib.crc32(data[summary_start:-12]), "summary's checksum"
    out = {"schemas": {}, "channels": {}, "messages": [], "metadata": {}, "chunks": []}
    places, at, indexes = {}, 8, {}

    def take(op, content, where):
        f = Fields(content)
        if op == SCHEMA:
            number = f.take("H")
            found = (f.text(), f.text(), f.text())
            assert out["schemas"].setdefault(number, found) == found and number > 0, "schema"
        elif op == CHANNEL:
            number, schema_number = f.take("HH")
            found = (schema_number, f.text(), f.text(), f.pairs())
            assert schema_number in out["schemas"], "channel without its schema"
            assert out["channels"].setdefault(number, found) == found, "channel"
        elif op == MESSAGE:
            number, sequence, time, published = f.take("HIQQ")
            assert published == time and number in out["channels"], "message"
            out["messages"].append((time, out["channels"][number][1], sequence, content[f.at:]))
            where.setdefault(number, []).append((time, out["at"]))

    for op, content in split(data[8:summary_start]):
        place = places.setdefault(at, (op, 9 + len(content)))
        f = Fields(content)
        out["at"] = at
        if op == HEADER:
            out["profile"], out["library"] = f.text(), f.text()
        elif op == CHUNK:
            start, end, size, crc = f.take("QQQI")
            compression = f.text()
            packed = content[f.at + 8:f.at + 8 + f.take("Q")]
            records = packed if compression == "" else unpack[compression](packed, size)
            assert len(records) == size and zlib.crc32(records) == crc, "chunk"
            assert (start, end) == (min(times_of(records)), max(times_of(records))), "chunk's times"
            inside, indexes = 0, {}
            for inner_op, inner in split(records):
                out["at"] = inside
                take(inner_op, inner, indexes)
                inside += 9 + len(inner)
            out["chunks"].append([start, end, at, place[1], {}, 0, compression, len(packed), size])
        elif op == MESSAGE_INDEX:
            number = f.take("H")
            inner, found = Fields(f.bytes()), []
            while inner.at < len(inner.data):
                found.append(inner.take("QQ"))
            assert indexes.pop(number) == found, "message index"
            out["chunks"][-1][4][number] = at
            out["chunks"][-1][5] += place[1]
        elif op == METADATA:
            name = f.text()
            out["metadata"][name] = f.pairs()
        elif op == DATA_END:
            assert f.take("I") in (0, zlib.crc32(data[:at])), "data section's checksum"
        else:
            take(op, content, {})
        at += 9 + len(content)
    assert not indexes, "a channel without its message index"
    assert places[max(places)][0] == DATA_END, "the data section's end"

    at, groups, seen = summary_start, {}, []
    schemas, channels = set(), set()
    for op, content in split(data[summary_start:-37]):
        f = Fields(content)
        if op == SUMMARY_OFFSET:
            assert at >= offset_start
            group, start, length = f.take("BQQ")
            assert groups.pop(group) == [start, length], "summary offset"
        else:
            if op in groups:
                assert seen[-1] == op, "records of the summary are grouped"
            groups.setdefault(op, [at, 0])[1] += 9 + len(content)
        seen.append(op)
        if op in (SCHEMA, CHANNEL):
            (schemas if op == SCHEMA else channels).add(f.take("H"))
            take(op, content, {})
        elif op == CHUNK_INDEX:
            found = [*f.take("QQQQ"), f.pairs("Q"), f.take("Q"), f.text(), *f.take("QQ")]
            assert found in out["chunks"], "chunk index"
            out.setdefault("indexed", []).append(found)
        elif op == STATISTICS:
            found = [*f.take("QHIIIIQQ"), f.pairs("Q")]
            times = [m[0] for m in out["messages"]]
            names = {n: c[1] for n, c in out["channels"].items()}
            assert found == [len(times), len(out["schemas"]), len(out["channels"]), 0, len(out["metadata"]), len(out["chunks"]),
                             min(times, default=0), max(times, default=0),
                             {n: sum(m[1] == name for m in out["messages"]) for n, name in names.items()}], "statistics"
        elif op == METADATA_INDEX:
            offset, length = f.take("QQ")
            assert places[offset] == (METADATA, length) and f.text() in out["metadata"], "metadata index"
        at += 9 + len(content)
    assert not groups, "a group without its summary offset"
    assert out.get("indexed", []) == out["chunks"], "every chunk is indexed"
    assert (schemas, channels) == (set(out["schemas"]), set(out["channels"])), "schemas and channels are repeated"
    return out
