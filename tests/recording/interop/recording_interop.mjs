// Recordings of the real programs in the official readers: both readers agree message for message, every message of
// ours decodes by the schema in the file itself, and `weakgrid export` says the same, field for field.
// usage: node recording_interop.mjs PROGRAMS DDS_DOMAIN SCRATCH_FOLDER SCENARIO [RECORDING...]
// recording_interop.sh copies it to where the packages are and finds the domain.
import assert from "node:assert/strict";
import { spawn, spawnSync } from "node:child_process";
import {
  closeSync, existsSync, fstatSync, mkdirSync, openSync, readdirSync, readFileSync, readSync, rmSync, writeFileSync,
} from "node:fs";
import { basename, join } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";

import { crc32, crc32Final, crc32Init, crc32Update } from "@foxglove/crc";
import { parseIDL } from "@foxglove/omgidl-parser";
import { MessageReader } from "@foxglove/omgidl-serialization";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";

import { decompressHandlers } from "./decompress.mjs";

const [programs, domain, scratch, scenario, ...given] = process.argv.slice(2);
const ours = "weakgrid::wire::";

// A file in pieces: a recording may be larger than a buffer.
class FileBytes {
  constructor(path) {
    this.file = openSync(path);
    this.bytes = fstatSync(this.file).size;
  }
  at(offset, count) {
    const bytes = new Uint8Array(count);
    for (let done = 0; done < count; ) {
      const read = readSync(this.file, bytes, done, count - done, offset + done);
      assert(read > 0, "a read beyond the file");
      done += read;
    }
    return bytes;
  }
  *pieces(bytesMax = 1 << 22) {
    for (let offset = 0; offset < this.bytes; offset += bytesMax)
      yield this.at(offset, Math.min(bytesMax, this.bytes - offset));
  }
  async size() { return BigInt(this.bytes); }
  async read(offset, count) { return this.at(Number(offset), Number(count)); }
  close() { closeSync(this.file); }
}

// RFC 4180, row by row.
function* csvRows(path) {
  const file = new FileBytes(path);
  const decoder = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });
  let text = "";
  for (const piece of file.pieces()) {
    text += decoder.decode(piece, { stream: true });
    let begin = 0;
    let end = -1;
    let quotes = 0;
    while ((end = text.indexOf("\n", end + 1)) >= 0) {
      // A line break between quotes is part of a field.
      const line = text.slice(begin, end);
      if (line.includes('"')) quotes = line.split('"').length - 1;
      if (quotes % 2 === 0) {
        yield quotes === 0 ? line.split(",") : quotedFields(line);
        begin = end + 1;
      }
      quotes = 0;
    }
    text = text.slice(begin);
  }
  assert.equal(text + decoder.decode(), "", `${path} ends inside a row`);
  file.close();
}

function quotedFields(line) {
  const fields = [];
  for (let at = 0; at <= line.length; ++at) {
    let end = at;
    if (line[at] === '"') {
      do end = line.indexOf('"', end + 1) + 1; while (line[end] === '"');
      fields.push(line.slice(at + 1, end - 1).replace(/""/g, '"'));
    } else {
      end = line.indexOf(",", at);
      if (end < 0) end = line.length;
      fields.push(line.slice(at, end));
    }
    assert(end === line.length || line[end] === ",", `not RFC 4180: ${line}`);
    at = end;
  }
  return fields;
}
assert.deepEqual(quotedFields('"a,""b""\n",,c,""'), ['a,"b"\n', "", "c", ""]);

/// What the text of a schema declares: how its messages decode and which columns their table has.
class Contract {
  constructor(text) {
    this.definitions = parseIDL(text);
    this.structs = new Map();
    this.enumerators = new Map();
    for (const { name, aggregatedKind, definitions } of this.definitions) {
      if (aggregatedKind === "struct") this.structs.set(name, definitions);
      else this.enumerators.set(name, new Map(definitions.map((constant) => [constant.value, constant.name])));
    }
  }
  /// [{ name: "outer.inner", path: ["outer", "inner"], field }]
  columns(type, path = []) {
    return this.structs.get(type).flatMap((field) => {
      const inner = [...path, field.name];
      if (field.isComplex && !field.isArray) return this.columns(field.type, inner);
      return [{ name: inner.join("."), path: inner, field }];
    });
  }
  /// The topics' types: what begins with the unit.
  roots() {
    const isRoot = ([, [first]]) => first.name === "unit";
    return [...this.structs].filter(isRoot).map(([name]) => name);
  }
  says(field, value, text) {
    if (field.isArray && !this.structs.has(field.type)) {
      const elements = text === "" ? [] : text.split("/");
      return elements.length === value.length &&
        elements.every((element, k) => this.says({ ...field, isArray: false }, value[k], element));
    }
    if (field.isArray) {
      const elements = text === "" ? [] : text.split(";");
      return elements.length === value.length && elements.every((element, k) => {
        const parts = element.split(":");
        const inner = this.structs.get(field.type);
        return parts.length === inner.length && inner.every((part, n) => this.says(part, value[k][part.name], parts[n]));
      });
    }
    if (field.enumType) return text === (this.enumerators.get(field.enumType).get(value) ?? String(value));
    switch (field.type) {
      case "bool": return text === (value ? "1" : "0");
      case "float64": return saysDouble(value, text);
      case "string": return text === value;
      default: return text === String(value) && typeof value === (/64$/.test(field.type) ? "bigint" : "number");
    }
  }
}

// The same double, in no more digits than it takes.
function saysDouble(value, text) {
  if (Number.isNaN(value)) return /^-?nan$/.test(text);
  if (!Number.isFinite(value)) return text === (value > 0 ? "inf" : "-inf");
  if (!Object.is(Number(text), value) || text === "") return false;
  const digits = (number) => number.replace(/^-|e.*$|\./g, "").replace(/^0+|0+$/g, "");
  return text === String(value) || digits(text) === digits(String(value));
}
assert(saysDouble(-0, "-0") && saysDouble(1e23, "1e+23") && saysDouble(1e-7, "1e-07") && saysDouble(NaN, "nan"));
assert(!saysDouble(0, "-0") && !saysDouble(0, "") && !saysDouble(0.1, "0.10000000000000001"));

const hex = (bytes) => Buffer.from(bytes.buffer, bytes.byteOffset, bytes.byteLength).toString("hex");
const fixed_columns = ["log_time_ns", "publish_time_ns", "writer", "sequence"];

// What is kept of each message, to find it again with the other reader.
class Seen {
  #columns = { channel: Uint16Array, sequence: Uint32Array, crc: Uint32Array, log: BigUint64Array, publish: BigUint64Array };
  count = 0;
  constructor() { this.#grow(1 << 16); }
  #grow(size) {
    for (const [name, Kind] of Object.entries(this.#columns)) {
      const larger = new Kind(size);
      if (this[name]) larger.set(this[name]);
      this[name] = larger;
    }
  }
  add(message) {
    if (this.count === this.channel.length) this.#grow(2 * this.count);
    const k = this.count++;
    this.channel[k] = message.channelId;
    this.sequence[k] = message.sequence;
    this.crc[k] = crc32(message.data);
    this.log[k] = message.logTime;
    this.publish[k] = message.publishTime;
  }
  is(k, message) {
    return this.channel[k] === message.channelId && this.sequence[k] === message.sequence &&
      this.log[k] === message.logTime && this.publish[k] === message.publishTime && this.crc[k] === crc32(message.data);
  }
  byTime() {
    return Uint32Array.from({ length: this.count }, (_, k) => k)
      .sort((a, b) => (this.log[a] < this.log[b] ? -1 : this.log[a] > this.log[b] ? 1 : a - b));
  }
}

/// The tables of an export, read along with the messages they came from.
class Tables {
  constructor(folder) {
    this.folder = folder;
    this.files = new Set(readdirSync(folder));
    this.rows = new Map();
  }
  next(topic, header) {
    const name = `${topic.replace(/\//g, "_")}.csv`;
    if (!this.rows.has(name)) {
      assert(this.files.delete(name), `there is no ${name}`);
      this.rows.set(name, csvRows(join(this.folder, name)));
      assert.deepEqual(this.rows.get(name).next().value, header, `${name}: the columns are the fields in the IDL's order`);
    }
    const { value, done } = this.rows.get(name).next();
    assert(!done, `${name} has too few rows`);
    assert.equal(value.length, header.length, `${name}: ${value}`);
    return value;
  }
  end() {
    for (const [name, rows] of this.rows) assert(rows.next().done, `${name} has too many rows`);
    assert.deepEqual([...this.files], [], "tables of nothing");
  }
}

/// A channel: how its messages decode and what their row must say.
class Source {
  constructor(channel, schema, contracts) {
    this.topic = channel.topic;
    this.type = schema?.name ?? "";
    this.writer = channel.metadata.get("writer") ?? "";
    this.isOurs = this.type.startsWith(ours);
    if (this.isOurs) {
      assert.equal(channel.messageEncoding, "cdr");
      assert.equal(schema.encoding, "omgidl");
      const text = new TextDecoder().decode(schema.data);
      if (!contracts.has(text)) contracts.set(text, new Contract(text));
      this.contract = contracts.get(text);
      this.reader = new MessageReader(schema.name, this.contract.definitions);
      this.columns = this.contract.columns(schema.name);
    }
    this.header = [...fixed_columns, ...(this.isOurs ? this.columns.map(({ name }) => name) : ["payload"])];
  }
  check(message, row, units) {
    const fail = (name, value, text) => assert.fail(
      `${this.topic}, sequence ${message.sequence}: ${name} is ${value} in the recording, "${text}" in the table`);
    const fixed = [message.logTime, message.publishTime, this.writer, message.sequence];
    fixed.forEach((value, k) => { if (row[k] !== String(value)) fail(fixed_columns[k], value, row[k]); });
    if (!this.isOurs) {
      if (row[4] !== hex(message.data)) fail("payload", hex(message.data), row[4]);
      return;
    }
    const decoded = this.reader.readMessage(message.data);
    units.add(decoded.unit);
    this.columns.forEach(({ name, path, field }, k) => {
      let value = decoded;
      for (const step of path) value = value[step];
      const text = row[fixed.length + k];
      if (!this.contract.says(field, value, text)) fail(name, value, text);
    });
  }
}

let exports = 0;

/// Throws an AssertionError at the first thing that is not as it should be. `spoil` may change the tables.
async function check(path, spoil = () => {}) {
  const folder = join(scratch, `tables_${++exports}`);
  const exported = spawnSync(join(programs, "weakgrid"), ["export", path, "-o", folder], { encoding: "utf8" });
  assert.equal(exported.status, 0, exported.stderr);
  spoil(folder);
  const tables = new Tables(folder);
  const bytes = new FileBytes(path);
  const reader = await McapIndexedReader.Initialize({ readable: bytes, decompressHandlers }); // checks the summary's CRC
  assert.notEqual(reader.footer.summaryCrc, 0);

  const dataBytes = Number(reader.footer.summaryStart) - 13; // up to DataEnd
  let crc = crc32Init();
  let offset = 0;
  const stream = new McapStreamReader({ decompressHandlers, validateCrcs: true, includeChunks: true });
  const seen = new Seen();
  const units = new Set(), types = new Set(), schemas = new Map(), sources = new Map(), contracts = new Map();
  const count = { Chunk: 0, Metadata: 0, Attachment: 0, DataEnd: 0 };
  let data_crc;
  const take = (record) => {
    if (record.type in count) ++count[record.type];
    switch (record.type) {
      case "Schema": schemas.set(record.id, record); break;
      case "Channel":
        if (!sources.has(record.id)) sources.set(record.id, new Source(record, schemas.get(record.schemaId), contracts));
        break;
      case "Chunk": assert.notEqual(record.uncompressedCrc, 0); break;
      case "DataEnd": data_crc = record.dataSectionCrc; break;
      case "Message": {
        const source = sources.get(record.channelId);
        seen.add(record);
        types.add(source.type);
        source.check(record, tables.next(source.topic, source.header), units);
        break;
      }
    }
  };
  for (const piece of bytes.pieces()) {
    if (offset < dataBytes) crc = crc32Update(crc, piece.subarray(0, Math.min(piece.length, dataBytes - offset)));
    offset += piece.length;
    stream.append(piece);
    for (let record; (record = stream.nextRecord()); ) take(record);
  }
  assert(stream.done(), "the streaming reader did not come to the end");
  assert.equal(data_crc, crc32Final(crc), "data section CRC");
  tables.end();

  const { statistics } = reader;
  assert.equal(statistics.messageCount, BigInt(seen.count));
  assert.equal(statistics.chunkCount, count.Chunk);
  assert.equal(statistics.metadataCount, count.Metadata);
  assert.equal(statistics.attachmentCount, count.Attachment);
  const order = seen.byTime();
  let k = 0;
  for await (const message of reader.readMessages()) {
    assert(k < order.length, "the indexed reader finds more");
    assert(seen.is(order[k], message), `the readers disagree on message ${k} in order of time`);
    ++k;
  }
  assert.equal(k, order.length, "the indexed reader finds less");
  bytes.close();
  rmSync(folder, { recursive: true });
  console.log(`${basename(path)}: ${seen.count} messages of ${sources.size} writers in ${count.Chunk} chunks, all agree`);
  return { units, types, contracts };
}

// The programs die with this test, should it be killed.
class Program {
  constructor(name, args) {
    this.name = name;
    this.said = "";
    const child = spawn("setpriv", ["--pdeathsig", "KILL", join(programs, name), ...args], { stdio: ["ignore", "ignore", "pipe"] });
    child.stderr.on("data", (text) => { this.said += text; });
    this.child = child;
    this.ended = new Promise((done) => child.on("close", (status, signal) => done(status ?? signal)));
  }
  async stop() {
    this.child.kill("SIGTERM");
    await this.endsWell();
  }
  async endsWell(allowed = [0]) {
    const status = await this.ended;
    assert(allowed.includes(status), `${this.name} ended with ${status}: ${this.said}`);
    assert(!/Sanitizer|runtime error:/.test(this.said), `${this.name}: ${this.said}`);
    return status;
  }
}

async function until(condition, what) {
  for (const deadline = Date.now() + 60_000; !condition(); await sleep(5))
    assert(Date.now() < deadline, `gave up waiting for ${what()}`);
}

async function recordRun(path) {
  await new Program("weakgrid", ["run", scenario, "--domain", domain, "--record", path]).endsWell();
}

// Three units in one domain, a request that is accepted and one that is refused.
async function recordSeveral(path) {
  const recorder = new Program("weakgrid-recorder", ["--domain", domain, "--output", path]);
  const services = [1, 2, 3].flatMap((unit) => {
    const settings = join(scratch, `unit${unit}.toml`);
    writeFileSync(settings, `[unit]\nnumber = ${unit}\n[grid]\nreactance = 0.${unit}\n`);
    return ["plant", "controller", "gateway"].map(
      (service) => new Program(`weakgrid-${service}`, ["--settings", settings, "--domain", domain]));
  });
  const heard = (topic) => recorder.said.split(`hears ${topic} `).length - 1;
  for (const topic of ["weakgrid/measurement", "weakgrid/modulation", "weakgrid/controller_state", "weakgrid/setpoint_decision"])
    await until(() => heard(topic) === 3, () => `the recorder to hear three writers of ${topic}: ${recorder.said}`);
  for (const [p, expected] of [["0.2", 0], ["5", 1]]) {
    const request = new Program("weakgrid", ["set", "--domain", domain, "--unit", "2", "--p", p]);
    assert.equal(await request.endsWell([0, 1]), expected, request.said);
  }
  await sleep(1000);
  await Promise.all(services.map((service) => service.stop()));
  await recorder.stop();
}

// Proof that this test can fail. [table, what, by what]
const spoils = [
  ["measurement", /,(-?0\.\d+)(\d),/, (_, all, last) => `,${all}${(Number(last) + 1) % 10},`],
  ["measurement", ",current_alpha,current_beta,", ",current_beta,current_alpha,"],
  ["measurement", /[^\n]*\n$/, ""],
  ["modulation", /$/, "1,2,3\n"],
  ["setpoint_decision", "ACCEPTED", "UNIT_BLOCKED"],
  ["setpoint_decision", "CURRENT:1:", "CURRENT:0:"],
  ["manifest", "reactance", "Reactance"],
  ["health", /,(\d+),/, (_, digits) => `,${BigInt(digits) + 1n},`],
];
async function provesToFail(path) {
  for (const [table, what, by] of spoils) {
    const spoil = (folder) => {
      const file = join(folder, `weakgrid_${table}.csv`);
      const text = readFileSync(file, "utf8");
      const spoiled = text.replace(what, by);
      if (spoiled === text) throw new Error(`nothing to spoil: ${what} in ${file}`);
      writeFileSync(file, spoiled);
    };
    let missed = true;
    try {
      await check(path, spoil);
    } catch (error) {
      if (!(error instanceof assert.AssertionError)) throw error;
      missed = false;
    }
    assert(!missed, `this test misses ${what} → ${by} in the table of ${table}`);
  }
}

mkdirSync(scratch, { recursive: true });
if (given.length > 0) {
  for (const path of given) await check(path);
} else {
  const [run, several] = ["run.mcap", "several.mcap"].map((name) => join(scratch, name));
  await recordRun(run);
  await recordSeveral(several);
  const { types, contracts } = await check(run);
  for (const contract of contracts.values())
    for (const root of contract.roots()) assert(types.has(root), `no ${root} was recorded`);
  assert.deepEqual([...(await check(several)).units].sort(), [1, 2, 3]);
  await provesToFail(run);
}
console.log("recording interop: all good");
