# SPDX-License-Identifier: Apache-2.0
"""Perfetto's trace format, read without a schema and without code of the writer's: field numbers as its documentation
gives them. The tests of the tools read their traces by it, so a mistake of the writer is seen."""
import collections
import struct

BEGIN, END, INSTANT, COUNTER = 1, 2, 3, 4

Slice = collections.namedtuple("Slice", "track name begin end category args flows_out flows_in")


def fields(data):
    """(number, value) of one message; value: int, or bytes for a length-delimited field."""
    at = 0

    def varint():
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 0x7f) << shift
            if byte < 0x80:
                return value
            shift += 7

    end = len(data)
    while at < end:
        key = data[at]
        if key < 0x80:
            at += 1
        else:
            key = varint()
        kind = key & 7
        if kind == 0:
            yield key >> 3, varint()
        elif kind == 1:
            yield key >> 3, struct.unpack_from("<Q", data, at)[0]
            at += 8
        elif kind == 2:
            size = data[at]
            if size < 0x80:
                at += 1
            else:
                size = varint()
            if at + size > end:
                raise ValueError("broken off")
            yield key >> 3, data[at:at + size]
            at += size
        elif kind == 5:
            yield key >> 3, struct.unpack_from("<I", data, at)[0]
            at += 4
        else:
            raise ValueError(f"wire type {kind}")


def signed(value):
    return value - (1 << 64) if value >> 63 else value


class Trace:
    """tracks: path -> uuid; slices: in the order of their begins; counters: path -> [(ts, value)]."""

    def __init__(self, data):
        self.path, self.slices, self.counters = {}, [], collections.defaultdict(list)
        opened, parents, names = collections.defaultdict(list), {}, {}
        for number, packet in fields(data):
            if number != 1:
                raise ValueError("is no Perfetto trace: it has more than packets")
            packet = dict(fields(packet))
            if 60 in packet:
                track = dict(fields(packet[60]))
                names[track[1]], parents[track[1]] = track[2].decode(), track.get(5)
                parts, uuid = [], track[1]
                while uuid is not None:
                    parts.append(names[uuid])
                    uuid = parents[uuid]
                self.path[track[1]] = "/".join(reversed(parts[:-1]))
                if not track.get(5):
                    self.title = names[track[1]]
            elif 11 in packet:
                self._event(packet[8], packet[11], opened)
        if any(opened.values()):
            raise ValueError("a slice is open at the end: the trace is broken off")

    def _event(self, ts, message, opened):
        args, flows_out, flows_in = {}, [], []
        kind = track = name = category = value = None
        for number, field in fields(message):
            if number == 4:
                arg = dict(fields(field))
                args[arg[10].decode()] = arg[6].decode() if 6 in arg else signed(arg[4])
            elif number == 9:
                kind = field
            elif number == 11:
                track = field
            elif number == 22:
                category = field.decode()
            elif number == 23:
                name = field.decode()
            elif number == 30:
                value = signed(field)
            elif number == 47:
                flows_out.append(field)
            elif number == 48:
                flows_in.append(field)
        path = self.path[track]
        if kind == COUNTER:
            self.counters[path].append((ts, value))
        elif kind == END:
            index = opened[track].pop()
            self.slices[index] = self.slices[index]._replace(end=ts)
        else:
            if kind == BEGIN:
                opened[track].append(len(self.slices))
            self.slices.append(Slice(path, name, ts, ts, category, args, flows_out, flows_in))

    def on(self, prefix, category=None):
        """Slices of the tracks below `prefix`."""
        return [s for s in self.slices if (s.track == prefix or s.track.startswith(prefix + "/")) and
                category in (None, s.category)]
