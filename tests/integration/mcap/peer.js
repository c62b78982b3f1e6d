// SPDX-License-Identifier: Apache-2.0
// MCAP by @mcap/core, for tests/integration/mcap_core_test.py.
//
//   peer.js MODULES read FILE      prints as JSON what the indexed reader and the streaming reader find, to the last message
//   peer.js MODULES write FILE     writes the messages of stdin: {"topic", "type", "schema", "chunked", "messages": [[time, hex]]}
const fs = require("node:fs");
const { createRequire } = require("node:module");

const [modules, verb, file] = process.argv.slice(2);
const load = createRequire(`${modules}/`);
const { McapIndexedReader, McapStreamReader, McapWriter } = load("@mcap/core");
const fzstd = load("fzstd");

const decompressHandlers = { zstd: (data, size) => fzstd.decompress(data, new Uint8Array(Number(size))) };
const hex = (data) => Buffer.from(data).toString("hex");

async function read() {
  const data = fs.readFileSync(file);
  const readable = {
    size: async () => BigInt(data.length),
    read: async (offset, size) => new Uint8Array(data.subarray(Number(offset), Number(offset + size))),
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const topics = [...reader.channelsById.values()].map((c) => {
    const schema = reader.schemasById.get(c.schemaId);
    return { topic: c.topic, encoding: c.messageEncoding, type: schema.name, schemaEncoding: schema.encoding,
      schema: Buffer.from(schema.data).toString(), qos: c.metadata.get("offered_qos_profiles") };
  });
  const indexed = [];
  for await (const m of reader.readMessages()) indexed.push([String(m.logTime), reader.channelsById.get(m.channelId).topic, hex(m.data)]);
  const metadata = {};
  for await (const m of reader.readMetadata()) metadata[m.name] = Object.fromEntries(m.metadata);
  // The other way: record by record, with the checksums of chunks, of the data section and of the summary.
  const stream = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  stream.append(new Uint8Array(data));
  const channels = new Map();
  const streamed = [];
  const compressions = [];
  for (let r = stream.nextRecord(); r != undefined; r = stream.nextRecord()) {
    if (r.type === "Channel") channels.set(r.id, r.topic);
    if (r.type === "Message") streamed.push([String(r.logTime), channels.get(r.channelId), hex(r.data)]);
    if (r.type === "ChunkIndex") compressions.push(r.compression);
  }
  if (!stream.done()) throw new Error("the streaming reader found no end");
  console.log(JSON.stringify({ profile: reader.header.profile, topics, indexed, streamed, metadata, compressions,
    count: Number(reader.statistics.messageCount) }));
}

async function write() {
  const given = JSON.parse(fs.readFileSync(0, "utf8"));
  const parts = [];
  let size = 0n;
  const writable = { write: async (data) => { parts.push(Buffer.from(data)); size += BigInt(data.length); }, position: () => size };
  const writer = new McapWriter({ writable, useChunks: given.chunked, chunkSize: 200 });
  await writer.start({ profile: "ros2", library: "" });
  const schemaId = await writer.registerSchema({ name: given.type, encoding: "ros2msg", data: Buffer.from(given.schema) });
  const channelId = await writer.registerChannel({ schemaId, topic: given.topic, messageEncoding: "cdr", metadata: new Map() });
  let sequence = 0;
  for (const [time, data] of given.messages)
    await writer.addMessage({ channelId, sequence: sequence++, logTime: BigInt(time), publishTime: BigInt(time), data: Buffer.from(data, "hex") });
  await writer.end();
  fs.writeFileSync(file, Buffer.concat(parts));
}

(verb === "read" ? read() : write()).catch((error) => {
  console.error(error);
  process.exit(1);
});
