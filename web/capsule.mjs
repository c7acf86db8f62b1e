/**
 * The capsule robot in a browser or in node. The core (`capsule_gym/core/bindings/web.cpp`) with the environment's step,
 * its laws and its trained policies runs as WebAssembly, with the same bits as in Python. `capsule.d.mts` declares the
 * types; docs/live.md shows the usage.
 *
 * @module
 */

/** The data that `python -m web.build` inserts: the core, tables, networks, plants; see `web/data.py`. */
const ARCHIVE = "";

/** Returns the archive's header and the bytes after it. */
async function unpack(text) {
  const packed = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const content = new Uint8Array(await new Response(stream).arrayBuffer());
  const size = new DataView(content.buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(content.subarray(4, 4 + size)));
  return [header, content.subarray(4 + size)];
}

const [HEADER, CONTENT] = await unpack(ARCHIVE);
const { core: CORE, tasks: TASKS, controllers: CONTROLLERS, drivers: DRIVERS, variation: VARIATION } = HEADER;
const { constants: CONSTANTS, disturbances: DISTURBANCES } = VARIATION;
const MODULE = await WebAssembly.compile(CONTENT.slice(HEADER.module.at, HEADER.module.at + HEADER.module.size));
const SENSORS = ["theta", "theta_dot", "x_dot"];
const ROW = numbered(CORE.row_names);
const SETTING = numbered(CORE.settings);
const STATE = Object.keys(HEADER.constants.start);
const GIVEN = [...STATE, "M", "mu"].map((name) => [ROW[name], 0, 0, 0, 0, 0]);
/** The quantities that are meaningful between two steps. */
const SHOWN = CORE.row_names.slice(0, ROW.clock + 1);

/** Returns the place of each name. */
function numbered(names) {
  return Object.fromEntries(names.map((name, place) => [name, place]));
}

/** Returns the public fields of a driver. */
function describe({ settings, network, recordings, ...shown }) {
  const own = { controlDt: settings.control_dt, steps: settings.steps };
  return { ...shown, ...own, ...(recordings && { recorded: Object.keys(recordings) }) };
}

/** All drivers with their public fields. */
export const drivers = DRIVERS.map(describe);
/** The frozen evaluation sets: hash and plants. */
export const sets = HEADER.sets;
/** Numbers of the task and of the plant, in SI units. */
export const constants = HEADER.constants;
/** Names of the controllers and of the tasks that `load` accepts. */
export const controllers = Object.keys(CONTROLLERS);
export const tasks = Object.keys(TASKS);
/**
 * Names of the rows of `world`, in their order. The law's memory, its row of the reference table, the task's memory,
 * the history of a disturbed plant, and the filter of observed estimates follow.
 */
export const quantities = CORE.row_names;

/** Reads a float64 array from the archive, which stores its bytes by column and significance. */
function readArray({ at, rows, columns }) {
  const bytes = new Uint8Array(8 * rows * columns);
  for (let j = 0; j < columns; j++) {
    for (let b = 0; b < 8; b++) {
      const from = at + (8 * j + b) * rows;
      for (let i = 0; i < rows; i++) bytes[8 * (i * columns + j) + b] = CONTENT[from + i];
    }
  }
  return new Float64Array(bytes.buffer);
}

/** Starts the core with arrays in its memory; returns their addresses, the core's functions, and the views. */
async function place(sizes) {
  const { exports: call } = await WebAssembly.instantiate(MODULE, {});
  const entries = Object.entries(sizes);
  const places = entries.map(([name, [Kind, length]]) => [name, call.allocate(length * Kind.BYTES_PER_ELEMENT)]);
  const address = Object.fromEntries(places);
  const views = entries.map(([name, [Kind, length]]) => [name, new Kind(call.memory.buffer, address[name], length)]);
  return { address, call, view: Object.fromEntries(views) };
}

/** Returns a number, or throws an error that names the argument. */
function checkNumber(name, value, low = -Infinity, high = Infinity) {
  const accepted = `a finite number${Number.isFinite(high) ? ` in [${low}, ${high}]` : ""}`;
  if (typeof value !== "number") throw new TypeError(`${name} must be ${accepted}, got ${String(value)}`);
  if (!(Number.isFinite(value) && value >= low && value <= high)) {
    throw new RangeError(`${name} must be ${accepted}, got ${value}`);
  }
  return value;
}

/** Returns the entry by its name, or throws an error that lists the names. */
function find(what, name, entries) {
  const found = entries.find((entry) => entry.name === name);
  if (!found) throw new RangeError(`${what} must be one of ${entries.map((e) => e.name).join(", ")}, got ${name}`);
  return found;
}

/** Returns an index, or throws an error with the accepted values. */
function checkCount(name, value, count) {
  const accepted = `a whole number from 0 to ${count - 1}`;
  if (!Number.isInteger(value)) throw new TypeError(`${name} must be ${accepted}, got ${String(value)}`);
  if (value < 0 || value >= count) throw new RangeError(`${name} must be ${accepted}, got ${value}`);
  return value;
}

/** Returns an object, or throws an error with the accepted fields. */
function checkFields(name, value, names) {
  const accepted = `an object with fields out of ${names.join(", ")}`;
  if (typeof value !== "object" || value === null) throw new TypeError(`${name} must be ${accepted}, got ${value}`);
  const stranger = Object.keys(value).find((key) => !names.includes(key));
  if (stranger !== undefined) throw new RangeError(`${name} must be ${accepted}, got ${stranger}`);
  return value;
}

/** Returns the fields of `capsule_gym.Disturbances` for a name or an object; null for none. */
function checkDisturbances(given) {
  if (given === "none") return null;
  if (given === "real") return constants.real;
  if (typeof given === "string") throw new RangeError(`disturbances must be none, real or an object, got ${given}`);
  checkFields("disturbances", given, Object.keys(VARIATION.ideal));
  const found = { ...VARIATION.ideal, ...given };
  for (const name of DISTURBANCES) {
    const ends = [found[name]].flat().map((end) => checkNumber(`disturbances.${name}`, end, ...VARIATION.limits[name]));
    if (ends.length < 1 || ends.length > 2 || ends[0] > ends.at(-1)) {
      throw new RangeError(`disturbances.${name} must be a number or [low, high], got ${found[name]}`);
    }
  }
  if (!["both", "law", "agent"].includes(found.controls)) {
    throw new RangeError(`disturbances.controls must be both, law or agent, got ${found.controls}`);
  }
  if (!Array.isArray(found.unmeasured) || !found.unmeasured.every((name) => SENSORS.includes(name))) {
    throw new RangeError(`disturbances.unmeasured must be an array out of ${SENSORS.join(", ")}, got ${found.unmeasured}`);
  }
  checkNumber("disturbances.stick_threshold", found.stick_threshold, 0, 1e3);
  if (found.x_noise !== null) checkNumber("disturbances.x_noise", found.x_noise, 0, 1e3);
  return found;
}

/** Rounds to the nearest whole number, halves to even. */
function rounded(value) {
  return value + 1.5 * 2 ** 52 - 1.5 * 2 ** 52;
}

/** Time between two calls of the law or, without a law, of the integrator, s. */
function periodOf(packed) {
  return packed[SETTING.physics_steps] * packed[SETTING.physics_dt];
}

/** Packs plant and settings for the step, for an ideal or a disturbed plant. */
function packSettings(settings, capsule, disturbed) {
  const packed = Float64Array.from(disturbed ? settings.disturbed : settings.ideal);
  CONSTANTS.forEach((name, n) => { if (name in SETTING) packed[SETTING[name]] = capsule[n]; });
  if (!disturbed) return packed;
  const { controls, unmeasured, latency, x_noise, stick_threshold } = disturbed;
  packed[SETTING.history] = rounded([latency].flat().at(-1) / periodOf(packed)) + 1;
  packed[SETTING.law_reads] = packed[SETTING.with_reference] && controls !== "agent";
  packed[SETTING.agent_reads] = controls !== "law";
  [packed[SETTING.with_x], packed[SETTING.x_noise]] = [x_noise !== null, x_noise ?? 0];
  packed[SETTING.stick_threshold] = stick_threshold;
  for (const name of SENSORS) packed[SETTING[`with_${name}`]] = !unmeasured.includes(name);
  return packed;
}

/** The table of draws for the core: given values, the task's, whose memory begins at row `first`, and a varied plant's. */
function drawTable(task, first, capsule, disturbed) {
  const table = GIVEN.concat(TASKS[task].table.map(([row, ...line]) => [row + first, ...line]));
  if (!disturbed) return table;
  const ranges = [...capsule, ...DISTURBANCES.map((name) => disturbed[name])].map((range) => [range].flat());
  return table.concat(VARIATION.table.map((line, n) => {
    const [low, high = low] = ranges[n] ?? [];
    return n < ranges.length ? [...line.slice(0, 3), low, high - low, 0] : line;
  }));
}

/** Packs the commands of an episode as in the task's memory: their velocities, then their durations. */
function packCommands(commands, count) {
  if (!Array.isArray(commands) || commands.length < 1 || commands.length > count) {
    throw new RangeError(`commands must be an array of 1 to ${count} of {t, v}, got ${String(commands)}`);
  }
  const v = commands.map((command, n) => checkNumber(`commands[${n}].v`, command.v, -0.2, 0.2));
  const t = commands.map((command, n) => checkNumber(`commands[${n}].t`, command.t, 0, n ? Infinity : 0));
  if (t.some((time, n) => n > 0 && time <= t[n - 1])) throw new RangeError("commands must be in the order of their t");
  const lasts = t.map((time, n) => (t[n + 1] ?? Infinity) - time);
  const rest = count - v.length;
  return [...v, ...Array(rest).fill(v.at(-1)), ...lasts, ...Array(rest).fill(Infinity)];
}

/** Checks and returns a plant's M and mu. */
function checkPlant(name, plant) {
  const { limits } = constants;
  return { M: checkNumber(`${name}M`, plant.M, ...limits.M), mu: checkNumber(`${name}mu`, plant.mu, ...limits.mu) };
}

/** Checks and returns the jumps of an episode. */
function checkChanges(changes) {
  if (!Array.isArray(changes)) throw new TypeError(`changes must be an array of {t, M, mu}, got ${String(changes)}`);
  let last = -Infinity;
  return changes.map((change, n) => {
    const t = checkNumber(`changes[${n}].t`, change.t, 0, Number.MAX_VALUE);
    if (t <= last) throw new RangeError(`changes[${n}].t must be later than the one before, ${last} s, got ${t}`);
    last = t;
    return { t, ...checkPlant(`changes[${n}].`, change) };
  });
}

/** One capsule, with or without a control law inside its step. `load` creates it. */
export class Capsule {
  #place;
  #settings;
  #kind;
  #changes = [];
  #due = 0;

  /** Called by `load` and `drive`. */
  constructor(placed, kind, settings) {
    this.#place = placed;
    this.#kind = kind;
    this.#settings = settings;
    const { address, call, view } = placed;
    view.settings.set(kind.settings);
    view.reference.set(kind.reference);
    view.law_constants.set(kind.constants);
    view.memory.set(kind.memory);
    view.draw_table.set(kind.table.flat());
    const fields = {
      ...address, block_rows: view.world.length, num_envs: 1, lanes: 1, entries: settings.entries,
      task: tasks.indexOf(kind.task), law: kind.law,
      task_size: TASKS[kind.task].memory.length, memory_size: kind.memory.length, draw_lines: kind.table.length,
      reference_rows: kind.reference.length / kind.columns, reference_size: kind.columns,
    };
    view.fields.set(CORE.batch.map((name) => fields[name] ?? 0));
    call.bind(address.fields);
  }

  /** Whether an episode draws values and accepts a seed. */
  get draws() {
    return this.#kind.table.length > GIVEN.length;
  }

  /** Name of the task. */
  get task() {
    return this.#kind.task;
  }

  /** Length of a step, s. */
  get controlDt() {
    return this.#settings.control_dt;
  }

  /** Steps of a whole episode. */
  get horizon() {
    return this.#settings.steps;
  }

  /**
   * Begins an episode. The seed determines the drawn values; without one, the last seed and the number of episodes
   * since then do. By default, M and mu are nominal, and the state is `constants.start`.
   */
  reset({ M = constants.nominal.M, mu = constants.nominal.mu, changes = [], seed, ...others } = {}) {
    const { task, table, disturbed } = this.#kind;
    const plant = checkPlant("", { M, mu });
    const schedule = checkChanges(changes);
    const [start, given] = [{ ...constants.start }, {}];
    const { options } = TASKS[task];
    for (const [name, value] of Object.entries(others)) {
      if (STATE.includes(name)) start[name] = value;
      else if (options.includes(name) || (disturbed && ["capsule", "disturbances"].includes(name))) given[name] = value;
      else {
        const more = disturbed ? ["capsule", "disturbances"] : [];
        const names = ["M", "mu", "changes", "seed", ...STATE, ...options, ...more];
        throw new RangeError(`reset takes ${names.join(", ")}, got ${name}`);
      }
    }
    for (const [name, value] of Object.entries(start)) {
      const largest = constants.largest_state[name];
      checkNumber(name, value, -largest, largest);
    }
    if (Math.abs(start.theta) === constants.theta_limit) {
      throw new RangeError(`theta must be a number within +-${constants.theta_limit}, got ${start.theta}`);
    }
    if (seed !== undefined) {
      if (!this.draws) throw new RangeError("seed must be left out: nothing is drawn");
      checkCount("seed", seed, 2 ** 53);
    }
    const overrides = this.#overrides(given);
    const { call, view } = this.#place;
    if (seed !== undefined) {
      view.keys.set([BigInt(seed), 0n]);
      view.episodes[0] = 0n;
    }
    call.draw_episode();
    table.forEach(([row], n) => (view.drawn[n] = overrides.get(row) ?? view.drawn[n]));
    view.drawn.set([...STATE.map((name) => start[name]), plant.M, plant.mu]);
    [this.#changes, this.#due] = [schedule, 0];
    call.begin_episode();
    this.#advance(true);
    return { observation: this.observation, info: this.info };
  }

  /** Takes one step; the action is rounded to float32 and clipped to [-1, 1]. */
  step(action) {
    checkNumber("action", action);
    if (this.#get(ROW.termination)) throw new Error("the episode has ended: reset() first");
    const now = this.#get(ROW.steps) * this.controlDt + 1e-9;
    while (this.#due < this.#changes.length && this.#changes[this.#due].t <= now) {
      this.#setPlant(this.#changes[this.#due++]);
    }
    this.#place.view.world[ROW.action] = Math.fround(action);
    this.#advance(false);
    const terminated = this.#get(ROW.termination) !== 0;
    return {
      observation: this.observation,
      reward: this.#get(ROW.reward),
      terminated,
      truncated: !terminated && this.#get(ROW.steps) >= this.horizon,
      info: this.info,
    };
  }

  /** Changes M and mu before the next step. */
  setPlant({ M, mu }) {
    this.#setPlant(checkPlant("", { M, mu }));
  }

  /** theta (rad), theta_dot (rad/s), x (m) and x_dot (m/s). */
  get state() {
    return Object.fromEntries(STATE.map((name) => [name, this.#get(ROW[name])]));
  }

  /** The current observation, as in Python. */
  get observation() {
    return this.#place.view.observations.slice();
  }

  /**
   * All quantities of the last step and of the episode by name, in SI units, values of the task, and the termination.
   * A disturbed plant adds the sensor readings and the values that the episode has drawn.
   */
  get info() {
    const shown = Object.fromEntries(SHOWN.map((name) => [name, this.#get(ROW[name])]));
    const { task, disturbed } = this.#kind;
    for (const name of TASKS[task].shown) shown[name] = this.#remembered(name);
    if (disturbed) {
      const read = (names, prefix) => Object.fromEntries(names.map((name) => [name, this.#get(ROW[prefix + name])]));
      shown.reading = read(STATE, "read_");
      shown.capsule = read(CONSTANTS, "drawn_");
      shown.disturbances = read(DISTURBANCES, "");
    }
    return { ...shown, termination: CORE.terminations[shown.termination] };
  }

  /** The metrics of the episode so far; a failed episode's mean speed is over the length of a whole episode. */
  get metrics() {
    const is = this.info;
    const failed = is.termination !== CORE.terminations[0];
    const elapsed = is.duration > 0 ? is.duration : 1;
    const distance = is.x - is.start_x;
    const nowhere = is.backward > 0 ? Infinity : 0;
    return {
      mean_speed: (100 * distance) / (failed ? this.horizon * this.controlDt : elapsed),
      cost_of_transport: is.weight_distance > 0 ? is.episode_energy / is.weight_distance : Infinity,
      peak_torque: is.peak_torque,
      rms_torque: Math.sqrt(is.torque_squared / elapsed),
      backward_ratio: is.forward > 0 ? is.backward / is.forward : nowhere,
      stuck_fraction: is.stuck / elapsed,
      smallest_normal_ratio: is.smallest_normal_ratio,
      largest_theta: is.largest_theta,
      largest_theta_dot: is.largest_theta_dot,
      distance,
      energy: is.episode_energy,
      duration: is.duration,
      failed: failed ? 1 : 0,
      ...this.#taskMetrics(failed ? this.horizon * this.controlDt : elapsed),
    };
  }

  /** The task's own metrics, for an episode of length `whole`, s. */
  #taskMetrics(whole) {
    if (this.task === "goal") {
      const reached = this.#remembered("reached");
      return { success: reached > 0 ? 1 : 0, goal_time: reached > 0 ? reached : whole };
    }
    if (this.task !== "velocity") return {};
    const is = Object.fromEntries(TASKS.velocity.memory.map((name) => [name, this.#remembered(name)]));
    const duration = is.measured_from > 0 ? is.since - is.measured_from : 0;
    // A command counts if it was measured for a second.
    const counts = duration >= 1 - 1e-9 ? 1 : 0;
    const moved = is.target - is.error - is.measured_x;
    const missed = is.missed + counts * Math.abs(moved - is.command * duration);
    const commanded = is.commanded + counts * Math.abs(is.command) * duration;
    const [measured, unsettled] = [is.measured + counts, is.unsettled + counts * (1 - is.settled)];
    const error = 100 * (commanded > 0 ? missed / commanded : 1);
    return { velocity_error: error, unsettled: measured > 0 ? unsettled / measured : 1 };
  }

  /** A copy of the step's whole memory, in the order of `quantities`. */
  get world() {
    return this.#place.view.world.slice();
  }

  /** Copies of what `check` compares: the rows of `info`, the memories of law and task, the last reading. */
  get compared() {
    const { view } = this.#place;
    const rows = CORE.row_names.length;
    const end = this.#kind.memoryRow + TASKS[this.task].memory.length;
    const reading = this.#kind.disturbed ? [view.world.slice(ROW.read_theta, ROW.read_x_dot + 1)] : [];
    return [view.world.slice(0, SHOWN.length), view.world.slice(rows, end), ...reading, this.observation];
  }

  /** The whole state, for `restore`. */
  snapshot() {
    const [changes, due] = [this.#changes, this.#due];
    const { episodes, keys } = this.#place.view;
    return { world: this.world, observation: this.observation, changes, due, drawn: [episodes[0], ...keys] };
  }

  /** Restores the state from a snapshot of this capsule. */
  restore({ world, observation, changes, due, drawn: [episodes, ...key] }) {
    const { view } = this.#place;
    if (world.length !== view.world.length) throw new RangeError("snapshot must be one of a capsule of the same kind");
    view.world.set(world);
    view.observations.set(observation);
    view.episodes[0] = episodes;
    view.keys.set(key);
    [this.#changes, this.#due] = [changes, due];
  }

  #get(row) {
    return this.#place.view.world[row];
  }

  /** A value in the task's memory. */
  #remembered(name) {
    return this.#get(this.#kind.memoryRow + TASKS[this.task].memory.indexOf(name));
  }

  /** Values passed to `reset` that replace drawn ones, by row of the world. */
  #overrides({ capsule = {}, disturbances = {}, goal, commands }) {
    const { settings, memoryRow, task } = this.#kind;
    const { memory, table } = TASKS[task];
    const found = new Map();
    checkFields("capsule", capsule, CONSTANTS);
    for (const [name, value] of Object.entries(capsule)) {
      found.set(ROW[`drawn_${name}`], checkNumber(`capsule.${name}`, value, ...constants.limits[name]));
    }
    checkFields("disturbances", disturbances, DISTURBANCES);
    for (const [name, value] of Object.entries(disturbances)) {
      const [low, high] = VARIATION.limits[name];
      const longest = name === "latency" ? (settings[SETTING.history] - 1) * periodOf(settings) : high;
      found.set(ROW[name], checkNumber(`disturbances.${name}`, value, low, longest));
    }
    const drawn = [];
    if (goal !== undefined) drawn.push(checkNumber("goal", goal, -1e6, 1e6));
    if (commands !== undefined) drawn.push(...packCommands(commands, table.length / 2));
    drawn.forEach((value, n) => found.set(memoryRow + memory.length - table.length + n, value));
    return found;
  }

  #setPlant({ M, mu }) {
    this.#place.view.world[ROW.M] = M;
    this.#place.view.world[ROW.mu] = mu;
  }

  #advance(begin) {
    if (!this.#place.call.advance(begin)) throw new Error("the control law returned a torque that is not finite");
  }
}

/** A capsule and its driver in closed loop. `drive` creates it. */
export class Episode extends Capsule {
  #driver;
  #place;
  #set;
  #recording = null;
  #action = 0;

  /** Called by `drive`. */
  constructor(placed, kind, driver) {
    super(placed, kind, driver.settings);
    this.#place = placed;
    this.#set = kind.set;
    this.#driver = driver;
  }

  /** Name of the driver. */
  get driver() {
    return this.#driver.name;
  }

  /** The driver's last action. */
  get action() {
    return this.#action;
  }

  /** Begins an episode. */
  reset({ set, plant, seed, ...options } = {}) {
    const { name, recordings } = this.#driver;
    let start = options;
    if (set !== undefined || plant !== undefined) {
      const { changes, ...others } = options;
      if (Object.keys(others).length > 0) throw new RangeError("set and plant must stand without M, mu and a start");
      const known = Object.keys(recordings ?? sets);
      if (!known.includes(set)) throw new RangeError(`set must be one of ${known.join(", ")}, got ${set}`);
      if (kindOf(sets[set]) !== this.#set) {
        throw new RangeError(`set must be one with the disturbances that drive() was given, got ${set}`);
      }
      start = { ...sets[set].plants[checkCount("plant", plant, sets[set].plants.length)], ...(changes && { changes }) };
    } else if (recordings) {
      throw new RangeError(`set and plant must be given: what ${name} does is recorded on the frozen plants alone`);
    }
    const { seed: own = 0, ...first } = start;
    const chosen = seed ?? own;
    if (seed !== undefined && !this.draws) throw new RangeError(`seed must be left out: ${name} draws nothing`);
    this.#recording = recordings ? recordingOf(recordings[set], plant) : null;
    this.#action = 0;
    return super.reset({ ...first, ...(this.draws && (seed !== undefined || set) ? { seed: chosen } : {}) });
  }

  /** Calls `step` with an action of the driver. */
  tick() {
    this.#action = Math.fround(this.#choose());
    return this.step(this.#action);
  }

  /** The whole state, including the driver's. */
  snapshot() {
    return { ...super.snapshot(), action: this.#action, recording: this.#recording };
  }

  /** Restores the state, including the driver's. */
  restore(snapshot) {
    super.restore(snapshot);
    [this.#action, this.#recording] = [snapshot.action, snapshot.recording];
  }

  #choose() {
    const { address, call } = this.#place;
    if (this.#driver.network) return call.act(address.network);
    if (this.#recording) return HEADER.torques[this.#recording[this.info.steps]];
    return 0;
  }
}

/** Returns a driver's network, from the archive if the module contains the driver. */
function networkOf(driver) {
  const network = driver?.network ?? new Float64Array(0);
  return network instanceof Float64Array ? network : readArray(network);
}

/** Returns the index in `HEADER.torques` of each action on a plant. */
function recordingOf({ at, steps }, plant) {
  const begin = steps.slice(0, plant).reduce((sum, length) => sum + length, at);
  return CONTENT.subarray(begin, begin + steps[plant]);
}

/** Returns the common settings of a set's environments, as text. */
function kindOf({ task, capsule, disturbances }) {
  return JSON.stringify([task, capsule, disturbances]);
}

/** Allocates the arrays that a controller, a task and a driver need. */
async function prepare(controller, task, settings, given, driver) {
  const { law, constants: numbers, table, memory } = CONTROLLERS[controller];
  const disturbed = checkDisturbances(given.disturbances ?? settings.disturbances);
  const packed = packSettings(settings, given.capsule ?? settings.capsule, disturbed);
  const lawEnd = CORE.row_names.length + memory.length + table.columns;
  const length = TASKS[task].memory.length;
  // A law that observes the sensors observes the memory with measured values, which then comes first.
  const memoryRow = lawEnd + packed[SETTING.law_reads] * length;
  const kind = {
    task, disturbed, settings: packed, law, constants: readArray(numbers), memory, memoryRow, reference: readArray(table),
    columns: table.columns, table: drawTable(task, memoryRow, given.capsule ?? settings.capsule, disturbed),
  };
  const network = networkOf(driver);
  const filter = packed[SETTING.with_estimates] ? CORE.estimator_cells : 0;
  const rows = lawEnd + (disturbed ? 2 : 1) * length + CORE.history_rows * packed[SETTING.history] + filter;
  const placed = await place({
    world: [Float64Array, rows],
    settings: [Float64Array, packed.length],
    observations: [Float32Array, settings.entries],
    law_constants: [Float64Array, kind.constants.length],
    memory: [Float64Array, memory.length],
    reference: [Float64Array, kind.reference.length],
    keys: [BigUint64Array, 2],
    episodes: [BigInt64Array, 1],
    rows: [BigInt64Array, 1],
    draw_table: [Float64Array, 6 * kind.table.length],
    drawn: [Float64Array, kind.table.length],
    fields: [Float64Array, CORE.batch.length],
    network: [Float64Array, network.length],
  });
  placed.view.network.set(network);
  return [placed, kind];
}

/**
 * Creates a capsule with one of `controllers` in its step, at the beginning of a nominal episode.
 *
 * @param controller "direct" or a law.
 * @param options `task`, and `disturbances`: "none", "real" or fields of `capsule_gym.Disturbances`; or `set`, the
 *   name of a set whose environments' common settings apply.
 */
export async function load(controller, options = {}) {
  if (!Object.hasOwn(CONTROLLERS, controller)) {
    throw new RangeError(`controller must be one of ${controllers.join(", ")}, got ${controller}`);
  }
  const { set, task, ...given } = { ...checkFields("options", options, ["set", "task", "disturbances"]) };
  if (set !== undefined && !Object.hasOwn(sets, set)) {
    throw new RangeError(`set must be one of ${Object.keys(sets).join(", ")}, got ${set}`);
  }
  const other = Object.keys(options).find((name) => name !== "set" && options[name] !== undefined);
  if (set !== undefined && other) throw new RangeError(`${other} must be left out: the set says it`);
  const { settings } = CONTROLLERS[controller];
  const chosen = task ?? sets[set]?.task ?? Object.keys(settings)[0];
  if (!Object.hasOwn(settings, chosen)) {
    throw new RangeError(`task must be one of ${Object.keys(settings).join(", ")} with ${controller}, got ${chosen}`);
  }
  const [placed, kind] = await prepare(controller, chosen, settings[chosen], sets[set] ?? given, null);
  const capsule = new Capsule(placed, kind, settings[chosen]);
  capsule.reset();
  return capsule;
}

/**
 * Creates an episode of one of `drivers`, at its beginning. The options are those of `reset`, and the disturbances, as
 * in `load`. Alternatively, `set` and `plant` select a plant of a frozen set by its number; the set then defines the
 * start and the disturbances.
 */
export async function drive(name, { disturbances, ...options } = {}) {
  const driver = find("driver", name, DRIVERS);
  const { task, controller, settings } = driver;
  const found = sets[options.set];
  if (found && disturbances !== undefined) throw new RangeError("disturbances must be left out: the set says them");
  if (found && found.task !== task) throw new RangeError(`set must be one of the task ${task}, got ${options.set}`);
  const given = found ?? { task, capsule: settings.capsule, disturbances: disturbances ?? settings.disturbances };
  const [placed, kind] = await prepare(controller, task, settings, given, driver);
  const episode = new Episode(placed, { ...kind, set: kindOf(given) }, driver);
  episode.reset(options);
  return episode;
}

/** Returns the length of a network by its header and widths, in the order of `capsule_gym.policies.network.pack`, or NaN. */
function networkSize([layers, , , , ...rest], entries) {
  const padded = (width) => Math.ceil(width / CORE.padding) * CORE.padding;
  const first = padded(4) - 4;
  const widths = rest.slice(first, first + layers + 1);
  const whole = widths.every((width) => Number.isInteger(width) && width > 0);
  if (!whole || widths.length !== layers + 1 || widths[0] !== entries || widths.at(-1) !== 1) return NaN;
  const units = widths.slice(1).reduce((sum, width, n) => sum + padded(width) * (1 + widths[n]), 0);
  return padded(4) + padded(layers + 1) + 2 * padded(entries) + units;
}

/** Adds a policy of your own to `drivers`, as `web.data.describe_policy` describes it in Python. */
export function addDriver(driver) {
  const { name, task, controller, settings, network } = driver;
  if (typeof name !== "string") throw new TypeError(`name must be a string, got ${String(name)}`);
  if (DRIVERS.some((other) => other.name === name)) throw new RangeError(`name must be a new one, got ${name}`);
  const known = CONTROLLERS[controller]?.settings;
  if (!known) throw new RangeError(`controller must be one of ${controllers.join(", ")}, got ${controller}`);
  if (!Object.hasOwn(known, task)) throw new RangeError(`task must be one of ${Object.keys(known).join(", ")}, got ${task}`);
  for (const kind of ["ideal", "disturbed"]) {
    const [size, given] = [CORE.settings.length, settings?.[kind]?.length];
    if (given !== size) throw new RangeError(`settings.${kind} must be ${size} numbers, got ${given}`);
  }
  checkCount("settings.entries", settings.entries, 10_001);
  checkNumber("settings.control_dt", settings.control_dt, Number.MIN_VALUE, Number.MAX_VALUE);
  checkNumber("settings.steps", settings.steps, 1, Number.MAX_SAFE_INTEGER);
  if (!Array.isArray(network)) throw new TypeError(`network must be an array of numbers, got ${String(network)}`);
  network.forEach((number, n) => checkNumber(`network[${n}]`, number));
  if (network.length !== networkSize(network, settings.entries)) {
    const accepted = `as web.data.describe_policy gives it, for ${settings.entries} entries`;
    throw new RangeError(`network must be ${accepted}, got ${network.length} numbers`);
  }
  const added = { ...driver, network: Float64Array.from(network) };
  DRIVERS.push(added);
  drivers.push(describe(added));
}

/** Returns the sha256 of concatenated typed arrays. */
async function digest(arrays) {
  const content = new Uint8Array(await new Blob(arrays).arrayBuffer());
  const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", content));
  return Array.from(hash, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Replays one committed episode; resolves to its hash and the numbers of steps and doubles. */
async function replay({ driver, actions, hold, ...options }) {
  const episode = await drive(driver, options);
  const shown = [];
  let [steps, doubles] = [0, 0];
  for (let over = false; !over; steps++) {
    const action = actions?.[Math.floor(steps / hold) % actions.length];
    const { terminated, truncated } = actions ? episode.step(action) : episode.tick();
    const arrays = episode.compared;
    shown.push(...arrays);
    doubles += arrays.slice(0, -1).reduce((sum, array) => sum + array.length, 0);
    over = terminated || truncated;
    // Keeps the page responsive.
    if (steps % 200 === 199) await new Promise((resolve) => setTimeout(resolve));
  }
  return { hash: await digest(shown), steps, doubles };
}

/**
 * Replays the committed episodes, and compares every bit of what they show with Python's by hash.
 *
 * @param report called with {name, equal, steps, doubles} after each episode.
 */
export async function check(report = () => {}) {
  let all = true;
  for (const { name, steps, sha256, ...episode } of HEADER.episodes) {
    const found = await replay(episode);
    const equal = found.hash === sha256 && found.steps === steps;
    all &&= equal;
    report({ name, equal, steps: found.steps, doubles: found.doubles });
  }
  return all;
}
