# SPDX-License-Identifier: Apache-2.0
"""ONNX files for tests, by a reader and writer of protobuf of their own; and a second opinion on a net that was cut:
whether its parts, composed, are the whole. Numbers of fields: onnx/onnx, onnx/onnx.proto."""

GRAPH, NODE, TENSOR, INFO, ATTRIBUTE, SPARSE, ENTRY, MODEL = "graph node tensor info attribute sparse entry model".split()
NESTED = {MODEL: {7: GRAPH}, GRAPH: {1: NODE, 5: TENSOR, 11: INFO, 12: INFO, 13: INFO, 15: SPARSE}, NODE: {5: ATTRIBUTE},
          ATTRIBUTE: {5: TENSOR, 6: GRAPH, 10: TENSOR, 11: GRAPH}, TENSOR: {13: ENTRY}, SPARSE: {1: TENSOR}}


def varint(value):
    out = b""
    while value > 127:
        out += bytes([value & 127 | 128])
        value >>= 7
    return out + bytes([value])


def field(number, value):
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    value = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(value)) + value


def read(data, kind=MODEL):
    """{field: [values]}, nested where it is known how."""
    at, out = 0, {}

    def number():
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    while at < len(data):
        key = number()
        wire = key & 7
        if wire == 0:
            value = number()
        else:
            size = {1: 8, 5: 4}.get(wire) or number()
            value = bytes(data[at:at + size])
            assert len(value) == size, "truncated"
            at += size
        inner = NESTED.get(kind, {}).get(key >> 3)
        out.setdefault(key >> 3, []).append(read(value, inner) if inner and wire == 2 else value)
    return out


def texts(message, number):
    return [value.decode() for value in message.get(number, [])]


def name(message, number=1):
    return (texts(message, number) or [""])[0]


def captured(graph):
    """What a graph inside a node uses of the graph around it."""
    made = {name(i) for i in graph.get(11, [])} | {name(t, 8) for t in graph.get(5, [])}
    used = set()
    for node in graph.get(1, []):
        used |= uses(node) - made
        made |= set(texts(node, 2))
    return used | {name(o) for o in graph.get(12, [])} - made


def uses(node):
    names = set(texts(node, 1))
    for attribute in node.get(5, []):
        for graph in attribute.get(6, []) + attribute.get(11, []):
            names |= captured(graph)
    return names - {""}


def faults(whole_bytes, part_bytes):
    """What is wrong with parts, in words."""
    whole, parts, wrong = read(whole_bytes)[7][0], [read(p)[7][0] for p in part_bytes], []
    tensors = {name(t, 8): t for t in whole.get(5, [])}
    nodes, fixed, there = whole.get(1, []), set(tensors), None
    free = []  # nodes that need no input of the net
    inputs = {name(i) for i in whole.get(11, [])} - fixed
    for n, node in enumerate(nodes):
        op = name(node, 4)
        if uses(node) <= fixed and not op.startswith("Random") and not any(6 in a or 11 in a for a in node.get(5, [])) \
                and not set(texts(node, 2)) & {name(o) for o in whole.get(12, [])}:
            fixed |= set(texts(node, 2))
            free.append(n)
    needed, live = {name(o) for o in whole.get(12, [])}, []
    for n in reversed(range(len(nodes))):
        if set(texts(nodes[n], 2)) & needed:
            needed |= uses(nodes[n])
            if n not in free:
                live.append(n)
    count, there = [0] * len(nodes), set(inputs)
    for p, part in enumerate(parts):
        given = {name(t, 8) for t in part.get(5, [])}
        for tensor in part.get(5, []):
            if tensors.get(name(tensor, 8)) != tensor:
                wrong.append(f"part {p + 1}: initializer '{name(tensor, 8)}' is not the whole's")
        for value in part.get(11, []):
            if name(value) not in given and name(value) not in there:
                wrong.append(f"part {p + 1}: nothing before it makes input '{name(value)}'")
            if 2 not in value:
                wrong.append(f"part {p + 1}: input '{name(value)}' has no type")
        known = given | {name(i) for i in part.get(11, [])}
        for node in part.get(1, []):
            if node in nodes:
                count[nodes.index(node)] += 1
            else:
                wrong.append(f"part {p + 1}: node '{name(node, 3)}' is not the whole's")
            for one in uses(node) - known:
                wrong.append(f"part {p + 1}: node '{name(node, 3)}' uses '{one}', which is not there")
            known |= set(texts(node, 2))
        for output in part.get(12, []):
            if name(output) not in known:
                wrong.append(f"part {p + 1}: nothing makes output '{name(output)}'")
            there.add(name(output))
        if not part.get(12):
            wrong.append(f"part {p + 1} has no output")
    for n in live:
        if count[n] != 1:
            wrong.append(f"node {n} '{name(nodes[n], 3)}' is in {count[n]} parts")
    for output in whole.get(12, []):
        if name(output) not in there:
            wrong.append(f"no part makes output '{name(output)}'")
    return wrong


# ---- nets ------------------------------------------------------------------------------------------------------------

def info(title, shape, kind=1):
    dims = b"".join(field(1, field(1, d)) for d in shape)
    return field(1, title) + field(2, field(1, field(1, kind) + field(2, dims)))


def node(op, inputs, outputs, title="", attributes=()):
    return (b"".join(field(1, i) for i in inputs) + b"".join(field(2, o) for o in outputs) + field(3, title or f"/{outputs[0]}/{op}") +
            field(4, op) + b"".join(field(5, a) for a in attributes))


def floats(title, shape, values):
    import struct
    return b"".join(field(1, d) for d in shape) + field(2, 1) + field(8, title) + field(9, struct.pack(f"<{len(values)}f", *values))


def model(nodes, inputs, outputs, tensors=(), infos=()):
    graph = (b"".join(field(1, n) for n in nodes) + field(2, "net") + b"".join(field(5, t) for t in tensors) +
             b"".join(field(11, i) for i in inputs) + b"".join(field(12, o) for o in outputs) +
             b"".join(field(13, i) for i in infos))
    return field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 13))


def residual(blocks):
    """Blocks of MatMul, Relu and an addition around them; a constant that all of them use; two outputs."""
    import random
    dice = random.Random(1)
    nodes, tensors, last = [node("Identity", ["scale"], ["scaled"])], [floats("scale", [1], [0.5])], "x"
    for b in range(blocks):
        tensors.append(floats(f"w{b}", [4, 4], [dice.uniform(-1, 1) for _ in range(16)]))
        nodes += [node("MatMul", [last, f"w{b}"], [f"m{b}"]), node("Relu", [f"m{b}"], [f"r{b}"]),
                  node("Mul", [f"r{b}", "scaled"], [f"s{b}"]), node("Add", [f"s{b}", last], [f"a{b}"])]
        last = f"a{b}"
        if b == 0:
            nodes.append(node("Sigmoid", [last], ["early"]))
    nodes.append(node("Tanh", [last], ["y"]))
    return model(nodes, [info("x", [2, 4])], [info("y", [2, 4]), info("early", [2, 4])], tensors)
