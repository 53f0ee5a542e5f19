// The parser that MCAP viewers use reads idl/weakgrid.idl as it is meant: every struct with every field, topics
// keyed by unit, the loop messages without a key, plain and without padding.
// usage: node idl_accepted_by_omgidl_parser.mjs IDL_FILE FOLDER_WITH_NODE_MODULES
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";

if (process.argv.length !== 4) {
  console.error("usage: node idl_accepted_by_omgidl_parser.mjs IDL_FILE FOLDER_WITH_NODE_MODULES");
  process.exit(2);
}
const [idl_file, modules] = process.argv.slice(2);
const { parseIDL } = createRequire(resolve(modules, "package.json"))("@foxglove/omgidl-parser");

const loop_structs = ["Measurement", "Modulation"];
const bytes = {
  int8: 1, uint8: 1, int16: 2, uint16: 2, int32: 4, uint32: 4, float32: 4, int64: 8, uint64: 8, float64: 8,
};
const parsed_type = {
  boolean: "bool", octet: "uint8", short: "int16", "unsigned short": "uint16", long: "int32",
  "unsigned long": "uint32", "long long": "int64", "unsigned long long": "uint64", float: "float32",
  double: "float64", string: "string",
};

// The second opinion: what the text declares, read without the parser. Knows the forms that weakgrid.idl uses:
// everything stands in the innermost of its modules.
function declared_structs(text) {
  const plain = text.replace(/\/\*[^]*?\*\//g, "").replace(/\/\/.*/g, "");
  const scope = [...plain.matchAll(/\bmodule\s+(\w+)/g)].map((found) => `${found[1]}::`).join("");
  const enums = new Set([...plain.matchAll(/\benum\s+(\w+)/g)].map((found) => found[1]));
  return [...plain.matchAll(/\bstruct\s+(\w+)\s*\{([^}]*)\}/g)].map(([, name, body]) => ({
    name: `${scope}${name}`,
    fields: body.split(";").map((line) => line.trim()).filter(Boolean).map((line) => {
      const found = line.match(/^(@key\s+)?(.*\S)\s+(\w+)$/s);
      if (!found) return { name: `"${line}"`, type: "a form this test does not know" };
      const [, key, written, field] = found;
      const sequence = written.match(/^sequence<\s*(\w[\w ]*?)\s*(?:,\s*(\d+))?\s*>$/);
      const string = written.match(/^string<\s*(\d+)\s*>$/);
      const base = (sequence?.[1] ?? (string ? "string" : written)).replace(/\s+/g, " ");
      return {
        name: field,
        type: parsed_type[base] ?? (enums.has(base) ? "uint32" : `${scope}${base}`),
        enum: enums.has(base) ? `${scope}${base}` : undefined,
        key: Boolean(key),
        bound: Number(sequence?.[2] ?? string?.[1] ?? 0),
        sequence: Boolean(sequence),
      };
    }),
  }));
}

const described = ({ name, type, enum: of, key, bound, sequence }) =>
  JSON.stringify([name, type, of, key, bound, sequence]);
const as_declared = (field) => ({
  name: field.name,
  type: field.type,
  enum: field.enumType,
  key: field.annotations?.key !== undefined,
  bound: field.arrayUpperBound ?? field.upperBound ?? 0,
  sequence: field.isArray === true && field.arrayLengths === undefined,
});

// XCDR1: a number lies at a multiple of its size, counted from behind the encapsulation header.
function padding_faults(struct) {
  const faults = [];
  let offset = 0, widest = 1;
  for (const field of struct.definitions) {
    const size = bytes[field.type];
    if (!size || field.isComplex || field.isArray || field.arrayLengths || field.enumType) {
      faults.push(`${struct.name}.${field.name} is no plain number (${field.enumType ?? field.type})`);
      continue;
    }
    if (offset % size !== 0) faults.push(`${struct.name}.${field.name} is padded: ${size} bytes at offset ${offset}`);
    offset = Math.ceil(offset / size) * size + size;
    widest = Math.max(widest, size);
  }
  if (offset % widest !== 0) {
    faults.push(`${struct.name} is padded at its end: ${offset} bytes, widest field ${widest}`);
  }
  return faults;
}

function key_faults(structs) {
  const nested = new Set(structs.flatMap((struct) => struct.definitions.map((field) => field.type)));
  return structs.filter((struct) => !nested.has(struct.name)).flatMap((struct) => {
    const [first] = struct.definitions;
    const wanted = (loop_structs.includes(struct.name.split("::").at(-1)) ? "" : "@key ") + "unsigned long unit";
    const found = first?.type === "uint32" && `${first.annotations?.key ? "@key " : ""}unsigned long ${first.name}`;
    return found === wanted ? [] : [`${struct.name} is a topic's type and does not start with "${wanted}"`];
  });
}

function faults_of(text) {
  let structs;
  try {
    structs = parseIDL(text).filter((definition) => definition.aggregatedKind === "struct");
  } catch (error) {
    return [`the parser refuses it: ${error.message.split(" Instead, I was")[0]}`];
  }
  const faults = [];
  const declared = declared_structs(text);
  const by_name = new Map(structs.map((struct) => [struct.name, struct]));
  if (declared.length !== structs.length) faults.push(`${declared.length} structs declared, ${structs.length} parsed`);
  for (const { name, fields } of declared) {
    const parsed = by_name.get(name)?.definitions;
    if (!parsed) { faults.push(`${name} is declared and not parsed`); continue; }
    for (let k = 0; k < Math.max(fields.length, parsed.length); ++k) {
      const written = fields[k] ? described(fields[k]) : "nothing";
      const read = parsed[k] ? described(as_declared(parsed[k])) : "nothing";
      if (written !== read) faults.push(`${name}, field ${k}: declared ${written}, parsed ${read}`);
    }
  }
  for (const name of loop_structs) {
    const struct = structs.find((candidate) => candidate.name.split("::").at(-1) === name);
    faults.push(...(struct ? padding_faults(struct) : [`there is no ${name}`]));
  }
  return [...faults, ...key_faults(structs)];
}

// Proof that this test can fail: each way to spoil a small good contract is found. [from, to, what is said]
const good = `module weakgrid { module wire {
  enum Kind { A, B };
  struct Part { string<31> name; Kind kind; };
  struct Measurement { unsigned long unit; unsigned long flags; double x; };
  struct Modulation { unsigned long unit; unsigned long flags; double x; };
  struct Report { @key unsigned long unit; sequence<Part, 4> parts; };
}; };`;
const spoiled = [
  ["double x;", "double x; unsigned long more;", "is padded at its end: 20 bytes"],
  ["unsigned long flags;", "unsigned long flags; unsigned long more;", "is padded: 8 bytes at offset 12"],
  ["unsigned long flags;", "Kind flags;", "Measurement.flags is no plain number"],
  ["unsigned long flags;", "unsigned long flags[3];", "Measurement.flags is no plain number"],
  ["double x;", "double x; string<7> text;", "Measurement.text is no plain number"],
  ["@key unsigned long unit; sequence", "unsigned long unit; sequence", "weakgrid::wire::Report is a topic's type"],
  ["Measurement { unsigned", "Measurement { @key unsigned", "weakgrid::wire::Measurement is a topic's type"],
  ["unit; sequence", "station; sequence", "weakgrid::wire::Report is a topic's type"],
  ["struct Modulation", "struct Modulated", "there is no Modulation"],
  ["unsigned long flags;", "@optional unsigned long flags;", "Measurement, field 1: declared"],
  ["enum Kind", "#pragma once\nenum Kind", "the parser refuses it"],
  ["sequence<Part, 4>", "sequence<Port, 4>", "the parser refuses it"],
];
const unfit = faults_of(good).map((fault) => `this test calls a good contract faulty: ${fault}`);
for (const [from, to, expected] of spoiled) {
  const found = faults_of(good.replace(from, to));
  if (!found.some((fault) => fault.includes(expected))) {
    unfit.push(`this test misses "${to}", finds: ${found.join("; ") || "nothing"}`);
  }
}

const faults = [...unfit, ...faults_of(readFileSync(idl_file, "utf8")).map((fault) => `${idl_file}: ${fault}`)];
for (const fault of faults) console.error(fault);
process.exit(faults.length === 0 ? 0 : 1);
