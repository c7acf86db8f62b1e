// The core: its names, what it says of an environment, and its memory.

import {ACCEPTED, constants, CONTENT, CONTROLLERS, HEADER, readArray} from "./archive.mjs";
import {readHeader} from "./network.mjs";

const {at: MODULE_AT, size: MODULE_SIZE} = HEADER.module;
const MODULE = await WebAssembly.compile(CONTENT.slice(MODULE_AT, MODULE_AT + MODULE_SIZE));
/**
 * An instance of the core that describes environments; every capsule has an instance of its own.
 */
export const {exports: CORE} = await WebAssembly.instantiate(MODULE, {});
/** Lists of names of the core; `TASKS` has those of each task. */
export const {TASKS, ...NAMES} = readNames(CORE);
/** Names of the tasks that `load` accepts. */
export const tasks = Object.keys(TASKS);
/**
 * Names of the first rows of `world`, in their order; the `layout` of a capsule's description
 * names those behind them.
 */
export const quantities = NAMES.ROW_NAMES;
export const ROW = named(quantities, [...quantities.keys()]);
export const STATE = Object.keys(constants.start);
/** Sizes of an entry of the observation and of a draw in the core's memory, bytes. */
const ENTRY_SIZE = 32;
const DRAW_SIZE = 48;
/** Largest number of rows of an environment, 128 MB. */
const MOST_ROWS = 2 ** 24;

/** Returns values by their names. */
export function named(names, values) {
  return Object.fromEntries(names.map((name, place) => [name, values[place]]));
}

/** Reads a string of the core. */
function readText(buffer, at) {
  const bytes = new Uint8Array(buffer, at);
  return new TextDecoder().decode(bytes.subarray(0, bytes.indexOf(0)));
}

/** Reads the lists of names of the core; each list `TASK` begins those of a task. */
function readNames({memory: {buffer}, name_lists}) {
  const lists = {TASKS: {}};
  let present = lists;
  const pairs = new Uint32Array(buffer, name_lists());
  for (let n = 0; pairs[n] !== 0; n += 2) {
    const list = readText(buffer, pairs[n]);
    const names = readText(buffer, pairs[n + 1]).split(" ").filter(Boolean);
    if (list === "TASK") {
      present = {};
      lists.TASKS[names[0]] = present;
    } else {
      present[list] ??= [];
      present[list].push(...names);
    }
  }
  return lists;
}

/** Describes an environment with options of the core. */
export function describe(core, options) {
  const given = NAMES.OPTIONS.map((name) => options[name] ?? NaN);
  new Float64Array(core.memory.buffer, core.options(), given.length).set(given);
  const at = core.describe();
  // The description may have enlarged the memory.
  const {buffer} = core.memory;
  const numbers = new Float64Array(buffer, at, NAMES.SETTINGS.length);
  const counts = new BigInt64Array(buffer, at + numbers.byteLength, NAMES.LAYOUT.length);
  const [entriesAt, drawsAt] = new Uint32Array(buffer, counts.byteOffset + counts.byteLength, 2);
  const settings = named(NAMES.SETTINGS, numbers);
  const layout = named(NAMES.LAYOUT, Array.from(counts, Number));
  checkPeriods(options.control_dt, settings);
  checkRows(layout.rows);
  return {
    settings,
    layout,
    entries: Array.from({length: layout.entries}, (_, n) => readEntry(buffer, entriesAt, n)),
    draws: Array.from({length: layout.draws}, (_, n) => readDraw(buffer, drawsAt, n)),
  };
}

/** Reads an entry of the observation by its number: its name, and its bounds. */
function readEntry(buffer, first, n) {
  const at = first + ENTRY_SIZE * n;
  const name = readText(buffer, new Uint32Array(buffer, at)[0]);
  const [age, low, high] = new Float64Array(buffer, at + 8);
  return [age > 0 ? `${name} ${age}` : name, low, high];
}

/** Reads a draw by its number. */
function readDraw(buffer, first, n) {
  return Array.from(new Float64Array(buffer, first + DRAW_SIZE * n, 6));
}

/** Throws an error for periods that do not divide each other. */
function checkPeriods(control_dt, {law_dt, law_steps, physics_dt, physics_steps}) {
  const divides = (part, count, whole) =>
    count >= 1 && Math.abs(count * part - whole) <= 1e-9 * whole;
  const few = control_dt / physics_dt <= ACCEPTED.substeps;
  const lawFits = divides(physics_dt, physics_steps, law_dt);
  const stepFits = divides(law_dt, law_steps, control_dt);
  if (few && lawFits && stepFits) return;
  const law = `a multiple of the law's ${law_dt} s, which is one of physics_dt=${physics_dt}`;
  const accepted = `${law}, at most ${ACCEPTED.substeps} of these`;
  throw new RangeError(`options.control_dt must be ${accepted}, got ${control_dt}`);
}

/** Throws an error for too long a history. */
function checkRows(rows) {
  if (rows <= MOST_ROWS) return;
  const accepted = `need at most ${MOST_ROWS} rows`;
  throw new RangeError(`options.disturbances_latency_high must ${accepted}, got ${rows}`);
}

/**
 * Starts the core with an environment; returns its functions, and its arrays with their addresses.
 */
export async function startCore(task, controller, options, network = new Float64Array(0)) {
  const {exports: core} = await WebAssembly.instantiate(MODULE, {});
  const description = describe(core, options);
  const {law, constants: numbers, memory, table} = CONTROLLERS[controller];
  const {gates, units} = readHeader(network);
  const arrays = {
    ...environmentArrays(task, description.layout),
    law_constants: readArray(numbers),
    memory: Float64Array.from(memory),
    reference: readArray(table),
    network,
    network_memory: new Float64Array(core.memory_size(gates, units)),
  };
  const address = {};
  for (const [name, {byteLength}] of Object.entries(arrays))
    address[name] = core.allocate(byteLength);
  // Only now: an allocation may move the memory.
  const view = {};
  for (const [name, array] of Object.entries(arrays)) {
    view[name] = new array.constructor(core.memory.buffer, address[name], array.length);
    view[name].set(array);
  }
  const fields = {
    ...address,
    num_envs: 1,
    lanes: 1,
    task: options.task,
    law: NAMES.LAWS.indexOf(law),
    reference_rows: table.rows,
  };
  view.fields.set(NAMES.BATCH.map((name) => fields[name] ?? 0));
  core.bind(address.fields);
  return {core, address, view, description, task, options};
}

/** The arrays that a step reads and writes, filled with zeros. */
function environmentArrays(task, layout) {
  return {
    world: new Float64Array(layout.rows),
    observations: new Float32Array(layout.entries),
    keys: new BigUint64Array(2),
    episodes: new BigInt64Array(1),
    rows: new BigInt64Array(1),
    drawn: new Float64Array(layout.draws),
    metrics: new Float64Array(TASKS[task].metrics.length),
    fields: new Float64Array(NAMES.BATCH.length),
  };
}
