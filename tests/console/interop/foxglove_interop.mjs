// The official client of Foxglove's WebSocket protocol at weakgrid-console: it is told of every topic, decodes what is
// written there by the schema that it gets, and hears late what stands.
// usage: node foxglove_interop.mjs PROGRAMS DDS_DOMAIN SCRATCH_FOLDER SCENARIO
// foxglove_interop.sh copies it to where the packages are and finds the domain.
import assert from "node:assert/strict";
import { spawn, spawnSync } from "node:child_process";
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";

import { parseIDL } from "@foxglove/omgidl-parser";
import { MessageReader } from "@foxglove/omgidl-serialization";
import protocol from "@foxglove/ws-protocol";
import WebSocket from "ws";

const { FoxgloveClient } = protocol;
const [programs, domain, scratch, scenario] = process.argv.slice(2);
const patience = 60_000;

const settings = join(scratch, "console.toml");
writeFileSync(settings, "[console]\nport = 0\n");

const running = [];
function start(name, ...args) {
  const child = spawn(join(programs, name), [...args, "--domain", domain], { stdio: ["ignore", "inherit", "pipe"] });
  child.said = "";
  child.stderr.on("data", (text) => (child.said += text));
  running.push(child);
  return child;
}
process.on("exit", () => running.forEach((child) => child.kill("SIGKILL")));

async function until(what, condition) {
  for (const end = Date.now() + patience; Date.now() < end; await sleep(20)) {
    const value = condition();
    if (value) return value;
  }
  assert.fail(`waited in vain until ${what}`);
}
function weakgrid(...args) {
  const done = spawnSync(join(programs, "weakgrid"), [...args, "--domain", domain], { encoding: "utf8" });
  assert.equal(done.status, 0, `weakgrid ${args.join(" ")}: ${done.stdout}${done.stderr}`);
  return done.stdout;
}

const served = start("weakgrid-console", "--settings", settings);
const at = await until("the console serves", () => /serves at http:\/\/(\S+)\//.exec(served.said)?.[1]);

// What Lichtblick's player does: a client, its channels, a reader for each schema.
function connect() {
  const socket = new WebSocket(`ws://${at}/`, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
  const client = new FoxgloveClient({ ws: socket });
  const seen = { socket, info: undefined, channels: new Map(), messages: new Map(), status: [], errors: [], client };
  const subscriptions = new Map();
  client.on("serverInfo", (info) => (seen.info = info));
  client.on("error", (error) => seen.errors.push(error));
  client.on("status", (status) => seen.status.push(status));
  client.on("advertise", (channels) => {
    for (const channel of channels) {
      assert.equal(channel.encoding, "cdr");
      assert.equal(channel.schemaEncoding, "omgidl");
      const reader = new MessageReader(channel.schemaName, parseIDL(channel.schema));
      seen.channels.set(channel.topic, channel);
      seen.messages.set(channel.topic, []);
      subscriptions.set(client.subscribe(channel.id), { topic: channel.topic, reader });
    }
  });
  client.on("message", ({ subscriptionId, timestamp, data }) => {
    const { topic, reader } = subscriptions.get(subscriptionId);
    seen.messages.get(topic).push({ timestamp, message: reader.readMessage(data) });
  });
  return seen;
}

const early = connect();
await until("the server says who it is", () => early.info);
assert.equal(early.info.name, "weakgrid");
for (const name of ["plant", "controller", "gateway"]) start(`weakgrid-${name}`, "--settings", scenario);
// Whoever wants every sample of a topic subscribes before they come.
await until("the gateway's topics are there", () => early.channels.has("weakgrid/reference"));
weakgrid("set", "--settings", scenario, "--p", "0.2", "--q", "0", "--vc", "1.8385", "--timeout", "60");
weakgrid("operate", "stop", "--settings", scenario);

const topics = ["measurement", "modulation", "setpoint_request", "setpoint_decision", "reference", "envelope",
  "operation", "controller_state", "health", "manifest"].map((name) => `weakgrid/${name}`);
for (const topic of topics)
  await until(`${topic} has come`, () => early.messages.get(topic)?.length > 0);

const of = (seen, topic) => seen.messages.get(`weakgrid/${topic}`).map(({ message }) => message);
let before = -1n;
for (const { step, pcc_voltage_alpha, pcc_voltage_beta } of of(early, "measurement")) {
  assert(step >= before, "steps of one plant rise");
  before = step;
  const voltage = Math.hypot(pcc_voltage_alpha, pcc_voltage_beta);
  assert(voltage > 0.3 && voltage < 1.6, `|v_p| = ${voltage}`);
}
for (const { modulation_alpha, modulation_beta } of of(early, "modulation"))
  assert(Math.hypot(modulation_alpha, modulation_beta) <= Math.SQRT1_2 + 1e-12);
assert(of(early, "setpoint_request").some((request) => request.active_power === 0.2));
assert(of(early, "reference").some((reference) => reference.active_power === 0.2));
const services = new Set(of(early, "health").map(({ service }) => service));
for (const service of ["plant", "controller", "gateway", "console"]) assert(services.has(service), service);
const now = BigInt(Date.now()) * 1_000_000n;
for (const { timestamp } of early.messages.get("weakgrid/measurement"))
  assert(timestamp > now - 300_000_000_000n && timestamp <= now + 1_000_000_000n, "received lately");

// Who comes later gets what stands, once, and no more of the samples than come from then on.
const late = connect();
for (const topic of ["reference", "envelope", "health", "manifest"])
  await until(`what stands of ${topic} has come`, () => late.messages.get(`weakgrid/${topic}`)?.length > 0);
assert.equal(late.channels.size, early.channels.size);
assert(of(late, "reference").some(({ id }) => id === of(early, "reference").at(-1).id));

// Nonsense is told so, and nothing else happens.
for (const text of ["{", "[]", "{}", '{"op":7}', '{"op":"advertise","channels":[]}', '{"op":"subscribe"}',
  '{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1},{"id":900,"channelId":999},7]}',
  '{"op":"unsubscribe","subscriptionIds":[12345,"x"]}'])
  late.socket.send(text);
late.socket.send(new Uint8Array([1, 2, 3]));
await until("each is answered", () => late.status.length >= 11);
assert.deepEqual(early.errors, []);
assert.equal(early.status.length, 0);

// Metrics go on beside it.
const page = await fetch(`http://${at}/metrics`);
assert.equal(page.status, 200);
const text = await page.text();
for (const service of ["plant", "controller", "gateway"])
  assert.match(text, new RegExp(`weakgrid_service_up\\{unit="1",service="${service}"\\} 1\\b`));
assert.match(text, /weakgrid_decisions_total\{unit="1",verdict="accepted"\} [1-9]/);
assert.match(text, /weakgrid_stage_duration_seconds_bucket\{unit="1",service="plant",stage="round_trip",le="\+Inf"\} [1-9]/);
// Every counter that a service has is there.
for (const { service, counters } of of(early, "health"))
  for (const { name } of counters)
    if (["plant", "controller", "gateway", "console"].includes(service))
      assert.match(text, new RegExp(`weakgrid_${name}(_total)?\\{unit="1",service="${service}"\\}`), `${service}: ${name}`);
writeFileSync(join(scratch, "metrics.txt"), text);

early.client.close();
late.client.close();
served.kill("SIGTERM");
await until("the console has stopped", () => served.exitCode !== null);
assert.equal(served.exitCode, 0, served.said);
console.log(`${topics.length} topics by the official client, ${of(early, "measurement").length} samples`);
process.exit(0);
