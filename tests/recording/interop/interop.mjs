// Our recordings in the official readers, and the official writer's in ours.
// Usage: node interop.mjs MCAP_PEER FOLDER
// It runs where `npm ci` has put the packages: copy it there with package.json and the lock. FOLDER is new.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";

import { crc32 } from "@foxglove/crc";
import { parseIDL } from "@foxglove/omgidl-parser";
import { MessageReader } from "@foxglove/omgidl-serialization";
import { McapIndexedReader, McapStreamReader, McapWriter } from "@mcap/core";

import { decompressHandlers } from "./decompress.mjs";

const [peer, folder] = process.argv.slice(2);
mkdirSync(folder, { recursive: true });

const readable = (bytes) => ({
  size: async () => BigInt(bytes.byteLength),
  read: async (offset, size) => {
    assert(offset + size <= BigInt(bytes.byteLength), "a read beyond the file");
    return bytes.subarray(Number(offset), Number(offset + size));
  },
});

const stream = (bytes) => {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true, includeChunks: true });
  reader.append(bytes);
  const records = [];
  for (let record; (record = reader.nextRecord()); ) records.push(record);
  assert(reader.done(), "the streaming reader did not come to the end");
  return records;
};

// What mcap_peer writes as message k; times as in its write_recording().
const expectedSample = (k) => ({
  unit: k % 3,
  state: k % 2,
  step: BigInt(k) << 33n,
  alpha: 0.1 * k,
  text: `Schritt ${k} ä`,
  tail: Float64Array.from({ length: k % 4 }, (_, n) => 1 / (n + 1)),
});
const expectedTime = (k) =>
  1_700_000_000_000_000_000n + (BigInt(k >> 1) - (k % 10 === 0 && k > 9 ? 3n : 0n)) * 50_000n;

const of = (records, type) => records.filter((record) => record.type === type);

function checkCrcs(bytes, records) {
  const [dataEnd] = of(records, "DataEnd");
  const [footer] = of(records, "Footer");
  const dataEndOffset = Number(footer.summaryStart) - 13;
  assert.equal(dataEnd.dataSectionCrc, crc32(bytes.subarray(0, dataEndOffset)), "data section CRC");
  for (const chunk of of(records, "Chunk")) assert.notEqual(chunk.uncompressedCrc, 0);
  assert.notEqual(footer.summaryCrc, 0); // checked by the indexed reader
}

async function checkOurs(name, { compression, atLeast, atMost }) {
  const bytes = new Uint8Array(readFileSync(join(folder, name)));
  const records = stream(bytes);
  checkCrcs(bytes, records);
  for (const chunk of of(records, "Chunk")) assert.equal(chunk.compression, compression);
  const streamed = of(records, "Message");
  assert(streamed.length >= atLeast && streamed.length <= atMost, `${name}: ${streamed.length} messages`);
  assert.deepEqual(streamed.map((message) => message.sequence), streamed.map((_, k) => k));

  const reader = await McapIndexedReader.Initialize({ readable: readable(bytes), decompressHandlers });
  assert.deepEqual(reader.header, { type: "Header", profile: "", library: "weakgrid interop" });
  const indexed = [];
  for await (const message of reader.readMessages()) indexed.push(message);
  const byTime = streamed
    .map((message, k) => ({ message, k }))
    .sort((a, b) => Number(a.message.logTime - b.message.logTime) || a.k - b.k)
    .map(({ message }) => message);
  assert.deepEqual(indexed, byTime, "both readers agree, equal times in file order");

  const { statistics } = reader;
  assert.equal(statistics.messageCount, BigInt(streamed.length));
  assert.equal(statistics.chunkCount, reader.chunkIndexes.length);
  assert.equal(statistics.chunkCount, of(records, "Chunk").length);
  assert.equal(statistics.channelCount, reader.channelsById.size);
  assert.equal(statistics.schemaCount, reader.schemasById.size);
  assert.equal(statistics.attachmentCount, 1);
  const topics = [...reader.channelsById.values()].map((channel) => channel.topic).sort();
  assert.deepEqual(topics, streamed.length > 0 ? ["weakgrid/a", "weakgrid/b"] : []);
  for (const [id, count] of statistics.channelMessageCounts)
    assert.equal(count, BigInt(streamed.filter((message) => message.channelId === id).length));

  const metadata = new Map();
  for await (const record of reader.readMetadata()) metadata.set(record.name, record.metadata);
  assert.equal(statistics.metadataCount, metadata.size);
  assert.deepEqual(metadata.get("run"), new Map([["empty", ""], ["settings", "schwaches Netz ä"]]));
  for await (const attachment of reader.readAttachments({ validateCrcs: true })) {
    assert.equal(attachment.name, "settings.toml");
    assert.equal(attachment.data.byteLength, 1000);
  }

  const decoders = new Map();
  for (const { id, name: root, encoding, data } of reader.schemasById.values()) {
    assert.equal(encoding, "omgidl");
    decoders.set(id, new MessageReader(root, parseIDL(new TextDecoder().decode(data))));
  }
  for (const message of streamed) {
    const channel = reader.channelsById.get(message.channelId);
    assert.equal(channel.messageEncoding, "cdr");
    assert.equal(message.logTime, expectedTime(message.sequence));
    assert.equal(message.publishTime, message.logTime - 1000n);
    const decoded = decoders.get(channel.schemaId).readMessage(message.data);
    assert.deepEqual(decoded, expectedSample(message.sequence));
  }
  console.log(`${name}: ${streamed.length} messages in ${statistics.chunkCount} chunks, all decoded`);
  return metadata;
}

// The streaming programs of Debian: zstd frames without their content size, lz4 frames of linked blocks.
const compressors = {
  zstd: (input) => ({ compression: "zstd", compressedData: execFileSync("zstd", ["-c", "-q"], { input }) }),
  lz4: (input) => ({ compression: "lz4", compressedData: execFileSync("lz4", ["-c", "-q"], { input }) }),
};

async function writeTheirs(path, options) {
  const parts = [];
  let position = 0n;
  const writable = {
    position: () => position,
    write: async (bytes) => {
      parts.push(bytes.slice());
      position += BigInt(bytes.byteLength);
    },
  };
  const writer = new McapWriter({ writable, chunkSize: 4096, ...options });
  await writer.start({ profile: "", library: "interop" });
  const text = new TextEncoder().encode("module m { struct T { double x; }; };");
  const schemaId = await writer.registerSchema({ name: "m::T", encoding: "omgidl", data: text });
  const channels = [];
  for (const topic of ["x", "y"]) {
    const channel = { topic, schemaId, messageEncoding: "cdr", metadata: new Map([["k", "v"]]) };
    channels.push(await writer.registerChannel(channel));
  }
  await writer.addMetadata({ name: "first", metadata: new Map([["a", "1"], ["b", ""]]) });
  await writer.addAttachment({
    name: "file", mediaType: "text/plain", logTime: 1n, createTime: 0n, data: new Uint8Array(300),
  });
  const messages = [];
  for (let k = 0; k < 1000; ++k) {
    const data = Uint8Array.from({ length: k % 97 }, (_, n) => (n * k) & 0xff);
    const logTime = BigInt(1000 + (k >> 2) - (k % 50 === 0 ? 5 : 0));
    const which = k % 3 === 0 ? 1 : 0;
    const message = { channelId: channels[which], sequence: k, logTime, publishTime: BigInt(k), data };
    messages.push({ ...message, topic: "xy"[which] });
    await writer.addMessage(message);
  }
  await writer.end();
  writeFileSync(path, Buffer.concat(parts));
  return messages;
}

async function checkTheirs(name, options, { indexed }) {
  const path = join(folder, name);
  const messages = await writeTheirs(path, options);
  const output = execFileSync(peer, ["read", path], { encoding: "utf8", maxBuffer: 1 << 26 });
  const lines = output.trim().split("\n");
  const line = (how, { topic, sequence, logTime, publishTime, data }) =>
    `${how} ${topic} ${sequence} ${logTime} ${publishTime} ${Buffer.from(data).toString("hex")}`;
  const starting = (how) => lines.filter((text) => text.startsWith(`${how} `));
  const inFileOrder = messages.map((message) => line("file", message));
  assert.deepEqual(starting("file"), inFileOrder, `${name}: in file order`);
  const byTime = [...messages].sort((a, b) => Number(a.logTime - b.logTime) || a.sequence - b.sequence);
  const expected = options.useChunks === false ? [] : byTime.map((message) => line("time", message));
  assert.deepEqual(starting("time"), expected, `${name}: in order of time`);
  assert(lines.includes("intact"), `${name}: intact`);
  assert(lines.includes(indexed ? "indexed" : "rebuilt"), `${name}: ${indexed ? "indexed" : "rebuilt"}`);
  assert.deepEqual(starting("metadata"), ["metadata first a=1 b="]);
  assert.deepEqual(starting("attachment"), ["attachment file text/plain 300"]);
  assert.deepEqual(starting("schema"), ["schema m::T omgidl 37"]);
  assert.deepEqual(starting("channel").sort(), ["channel x cdr 1", "channel y cdr 1"]);
  console.log(`${name}: ${messages.length} messages read by ours`);
}

console.log(execFileSync(peer, ["write", folder], { encoding: "utf8" }).trim());
for (const kind of ["none", "zstd", "lz4"]) {
  const compression = kind === "none" ? "" : kind;
  await checkOurs(`ours_${kind}.mcap`, { compression, atLeast: 2000, atMost: 2000 });
}
await checkOurs("ours_empty.mcap", { compression: "", atLeast: 0, atMost: 0 });
const metadata = await checkOurs("ours_recovered.mcap", { compression: "zstd", atLeast: 500, atMost: 1999 });
assert.equal(metadata.get("weakgrid_recovery").get("source_intact"), "false");

await checkTheirs("theirs_none.mcap", {}, { indexed: true });
await checkTheirs("theirs_zstd.mcap", { compressChunk: compressors.zstd }, { indexed: true });
await checkTheirs("theirs_lz4.mcap", { compressChunk: compressors.lz4 }, { indexed: true });
const unindexed = { useChunkIndex: false, useMessageIndex: false };
await checkTheirs("theirs_unindexed.mcap", unindexed, { indexed: false });
await checkTheirs("theirs_bare.mcap", { useStatistics: false, useSummaryOffsets: false }, { indexed: false });
await checkTheirs("theirs_unchunked.mcap", { useChunks: false }, { indexed: true });
console.log("interop: all good");
