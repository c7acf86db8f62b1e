/**
 * The capsule robot in a browser or in node. The core (`capsule_gym/core/bindings/web.cpp`) with
 * the environment's step, its laws and its trained policies runs as WebAssembly, with the same bits
 * as in Python. `capsule.d.mts` declares the types; docs/live.md shows the usage.
 *
 * @module
 */

/**
 * The data that `python -m web.build` inserts: the core, tables, networks, plants; see
 * `web/data.py`.
 */
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
const {accepted: ACCEPTED, controllers: CONTROLLERS, drivers: DRIVERS} = HEADER;
const MODULE =
  await WebAssembly.compile(CONTENT.slice(HEADER.module.at, HEADER.module.at + HEADER.module.size));
/**
 * An instance of the core that describes environments; every capsule has an instance of its own.
 */
const {exports: CORE} = await WebAssembly.instantiate(MODULE, {});
const {TASKS, ...NAMES} = readNames(CORE);
const {CONSTANTS, DISTURBANCES} = NAMES;
const ROW = named(NAMES.ROW_NAMES, [...NAMES.ROW_NAMES.keys()]);
const STATE = Object.keys(HEADER.constants.start);
/** The quantities that are meaningful between two steps. */
const SHOWN = NAMES.ROW_NAMES.slice(0, ROW.clock + 1);
/** Sizes of an entry of the observation and of a draw in the core's memory, bytes. */
const [ENTRY_SIZE, DRAW_SIZE] = [32, 48];
/** Largest number of rows of an environment, 128 MB. */
const MOST_ROWS = 2 ** 24;
const LOAD_OPTIONS = ["set", "task", "disturbances", "options"];
const DRIVER_FIELDS =
  ["name", "description", "kind", "task", "controller", "seed", "options", "network"];

/** Returns values by their names. */
function named(names, values) {
  return Object.fromEntries(names.map((name, place) => [name, values[place]]));
}

/** Reads a string of the core. */
function readText(buffer, at) {
  const bytes = new Uint8Array(buffer, at);
  return new TextDecoder().decode(bytes.subarray(0, bytes.indexOf(0)));
}

/** Reads the lists of names of the core, and in `TASKS` those of each task. */
function readNames({memory: {buffer}, name_lists}) {
  const [lists, tasks] = [{}, {}];
  const pairs = new Uint32Array(buffer, name_lists());
  let present = lists;
  for (let n = 0; pairs[n] !== 0; n += 2) {
    const list = readText(buffer, pairs[n]);
    const names = readText(buffer, pairs[n + 1]).split(" ").filter(Boolean);
    if (list === "TASK") present = tasks[names[0]] = {};
    else (present[list] ??= []).push(...names);
  }
  return {...lists, TASKS: tasks};
}

/** Describes an environment with options of the core. */
function describe(core, options) {
  const {memory} = core;
  const given = NAMES.OPTIONS.map((name) => options[name] ?? NaN);
  new Float64Array(memory.buffer, core.options(), given.length).set(given);
  const at = core.describe();
  const {buffer} = memory;
  const settings = new Float64Array(buffer, at, NAMES.SETTINGS.length);
  const layout = new BigInt64Array(buffer, at + settings.byteLength, NAMES.LAYOUT.length);
  const [entries, draws] = new Uint32Array(buffer, layout.byteOffset + layout.byteLength, 2);
  const description = {
    settings: named(NAMES.SETTINGS, settings),
    layout: named(NAMES.LAYOUT, Array.from(layout, Number)),
    entries: [],
    draws: [],
  };
  checkSizes(options, description);
  for (let n = 0; n < description.layout.entries; n++) {
    description.entries.push(readEntry(buffer, entries + ENTRY_SIZE * n));
  }
  for (let n = 0; n < description.layout.draws; n++) {
    description.draws.push(Array.from(new Float64Array(buffer, draws + DRAW_SIZE * n, 6)));
  }
  return description;
}

/** Reads an entry of the observation: its name, and its bounds. */
function readEntry(buffer, at) {
  const name = readText(buffer, new Uint32Array(buffer, at)[0]);
  const [age, low, high] = new Float64Array(buffer, at + 8);
  return [age > 0 ? `${name} ${age}` : name, low, high];
}

/** Throws an error for periods that do not divide each other, or for too long a history. */
function checkSizes({control_dt}, {settings, layout}) {
  const {law_dt, law_steps, physics_dt, physics_steps} = settings;
  const divides = (part, count, whole) =>
    count >= 1 && Math.abs(count * part - whole) <= 1e-9 * whole;
  const few = control_dt / physics_dt <= ACCEPTED.substeps;
  if (!(few && divides(physics_dt, physics_steps, law_dt) &&
        divides(law_dt, law_steps, control_dt))) {
    const accepted =
      `a multiple of the law's ${law_dt} s, which is one of physics_dt=${physics_dt}`;
    throw new RangeError(`options.control_dt must be ${accepted}, at most ${
      ACCEPTED.substeps} of these, got ${control_dt}`);
  }
  if (!(layout.rows <= MOST_ROWS)) {
    throw new RangeError(
      `options.disturbances_latency_high must need at most ${MOST_ROWS} rows, got ${layout.rows}`);
  }
}

/**
 * Merges options of the core: those of the task, given ones, and those that follow from controller
 * and task.
 */
function mergeOptions(task, controller, ...given) {
  const own = {...CONTROLLERS[controller].options, task: tasks.indexOf(task)};
  return Object.assign({}, HEADER.tasks[task], ...given, own);
}

/** The frozen evaluation sets: hash and plants. */
export const sets = HEADER.sets;
/** Numbers of the task and of the plant, in SI units. */
export const constants = HEADER.constants;
/** Names of the controllers and of the tasks that `load` accepts. */
export const controllers = Object.keys(CONTROLLERS);
export const tasks = Object.keys(TASKS);
/** All drivers with their public fields. */
export const drivers = DRIVERS.map(publicFields);
/**
 * Names of the first rows of `world`, in their order; the `layout` of a capsule's description
 * names those behind them.
 */
export const quantities = NAMES.ROW_NAMES;

/** Returns the public fields of a driver. */
function publicFields({options, network, recordings, ...shown}) {
  const {steps} = describe(CORE, mergeOptions(shown.task, shown.controller, options)).layout;
  return {
    ...shown,
    controlDt: options.control_dt,
    steps,
    ...(recordings && {recorded: Object.keys(recordings)})
  };
}

/** Reads a float64 array from the archive, which stores its bytes by column and significance. */
function readArray({at, rows, columns}) {
  const bytes = new Uint8Array(8 * rows * columns);
  for (let j = 0; j < columns; j++) {
    for (let b = 0; b < 8; b++) {
      const from = at + (8 * j + b) * rows;
      for (let i = 0; i < rows; i++) bytes[8 * (i * columns + j) + b] = CONTENT[from + i];
    }
  }
  return new Float64Array(bytes.buffer);
}

/** Returns a number, or throws an error that names the argument. */
function checkNumber(name, value, low = -Infinity, high = Infinity) {
  const accepted = `a finite number${Number.isFinite(high) ? ` in [${low}, ${high}]` : ""}`;
  if (typeof value !== "number")
    throw new TypeError(`${name} must be ${accepted}, got ${String(value)}`);
  if (!(Number.isFinite(value) && value >= low && value <= high)) {
    throw new RangeError(`${name} must be ${accepted}, got ${value}`);
  }
  return value;
}

/** Returns a name, or throws an error that lists the accepted ones. */
function checkChoice(what, name, names) {
  if (!names.includes(name))
    throw new RangeError(`${what} must be one of ${names.join(", ")}, got ${String(name)}`);
  return name;
}

/** Returns an index, or throws an error with the accepted values. */
function checkCount(name, value, count) {
  const accepted = `a whole number from 0 to ${count - 1}`;
  if (!Number.isInteger(value))
    throw new TypeError(`${name} must be ${accepted}, got ${String(value)}`);
  if (value < 0 || value >= count)
    throw new RangeError(`${name} must be ${accepted}, got ${value}`);
  return value;
}

/** Returns an object, or throws an error with the accepted fields. */
function checkFields(name, value, names) {
  const accepted = `an object with fields out of ${names.join(", ")}`;
  if (typeof value !== "object" || value === null)
    throw new TypeError(`${name} must be ${accepted}, got ${value}`);
  const stranger = Object.keys(value).find((key) => !names.includes(key));
  if (stranger !== undefined) throw new RangeError(`${name} must be ${accepted}, got ${stranger}`);
  return value;
}

/** Returns options of the core, or throws an error that names a wrong one. */
function checkOptions(given, task) {
  checkFields("options", given, NAMES.OPTIONS);
  const usual = HEADER.tasks[task];
  const options = {...usual, ...given};
  for (const [name, value] of Object.entries(options)) {
    // An option that the task leaves out may be left out.
    if (value !== null || usual[name] !== null)
      checkNumber(`options.${name}`, value, ...ACCEPTED.options[name]);
    const high = options[name.replace(/_low$/, "_high")];
    if (value > high || (value === null) !== (high === null)) {
      throw new RangeError(
        `options.${name} must be the low end of a range up to ${high}, got ${value}`);
    }
  }
  checkCount("options.stack_size", options.stack_size, ACCEPTED.options.stack_size[1] + 1);
  if ((options.initial_theta === null) !== (options.initial_theta_dot === null)) {
    throw new RangeError(
      "options.initial_theta and options.initial_theta_dot must be given together");
  }
  return options;
}

/**
 * Returns the options of the core for the fields of `capsule_gym.Disturbances`, "real" or "none".
 */
function disturbanceOptions(given) {
  const known = {none: {}, real: constants.real};
  if (typeof given === "string" && !Object.hasOwn(known, given)) {
    throw new RangeError(`disturbances must be none, real or an object, got ${given}`);
  }
  const fields = checkFields("disturbances", known[given] ?? given, Object.keys(HEADER.ideal));
  const {controls, unmeasured, stick_threshold, x_noise, ...drawn} = {...HEADER.ideal, ...fields};
  checkChoice("disturbances.controls", controls, ["both", "law", "agent"]);
  const {sensors, options: limits} = ACCEPTED;
  if (!Array.isArray(unmeasured) || !unmeasured.every((name) => sensors.includes(name))) {
    throw new RangeError(
      `disturbances.unmeasured must be an array out of ${sensors.join(", ")}, got ${unmeasured}`);
  }
  checkNumber("disturbances.stick_threshold", stick_threshold, ...limits.stick_threshold);
  if (x_noise !== null) checkNumber("disturbances.x_noise", x_noise, ...limits.x_noise);
  const options = {
    disturbed: given === "none" ? 0 : 1,
    law_observes: controls === "agent" ? 0 : 1,
    agent_observes: controls === "law" ? 0 : 1,
    stick_threshold,
    x_noise,
  };
  for (const name of sensors) options[`with_${name}`] = unmeasured.includes(name) ? 0 : 1;
  for (const name of DISTURBANCES) {
    const limit = limits[`disturbances_${name}_low`];
    const ends =
      [drawn[name]].flat().map((end) => checkNumber(`disturbances.${name}`, end, ...limit));
    const [low, high = low] = ends;
    if (ends.length < 1 || ends.length > 2 || low > high) {
      throw new RangeError(
        `disturbances.${name} must be a number or [low, high], got ${drawn[name]}`);
    }
    options[`disturbances_${name}_low`] = low;
    options[`disturbances_${name}_high`] = high;
  }
  return options;
}

/** Returns the numbers of a reset option of the task, as an array. */
function parseNumbers(name, value, count) {
  const {x} = constants.largest_state;
  const numbers = [value].flat().map((number) => checkNumber(name, number, -x, x));
  if (numbers.length !== count)
    throw new RangeError(`${name} must be ${count} numbers, got ${numbers.length}`);
  return numbers;
}

/** Returns the velocities of the commands of an episode, and how long each lasts. */
function parseCommands(commands) {
  const {commands: most, command: largest} = ACCEPTED;
  if (!Array.isArray(commands) || commands.length < 1 || commands.length > most) {
    throw new RangeError(
      `commands must be an array of 1 to ${most} of {t, v}, got ${String(commands)}`);
  }
  const v =
    commands.map((command, n) => checkNumber(`commands[${n}].v`, command.v, -largest, largest));
  const t =
    commands.map((command, n) => checkNumber(`commands[${n}].t`, command.t, 0, n ? Infinity : 0));
  if (t.some((time, n) => n > 0 && time <= t[n - 1]))
    throw new RangeError("commands must be in the order of their t");
  const lasts = t.map((time, n) => (t[n + 1] ?? Infinity) - time);
  const rest = most - v.length;
  return [...v, ...Array(rest).fill(v.at(-1)), ...lasts, ...Array(rest).fill(Infinity)];
}

/** Checks and returns a plant's M and mu. */
function checkPlant(name, plant) {
  const {limits} = constants;
  return {
    M: checkNumber(`${name}M`, plant.M, ...limits.M),
    mu: checkNumber(`${name}mu`, plant.mu, ...limits.mu)
  };
}

/** Checks and returns the jumps of an episode. */
function checkChanges(changes) {
  if (!Array.isArray(changes))
    throw new TypeError(`changes must be an array of {t, M, mu}, got ${String(changes)}`);
  let last = -Infinity;
  return changes.map((change, n) => {
    const t = checkNumber(`changes[${n}].t`, change.t, 0, Number.MAX_VALUE);
    if (t <= last)
      throw new RangeError(
        `changes[${n}].t must be later than the one before, ${last} s, got ${t}`);
    last = t;
    return {t, ...checkPlant(`changes[${n}].`, change)};
  });
}

/**
 * Starts the core with an environment; returns its functions, and its arrays with their addresses.
 */
async function startCore(task, controller, options, network = new Float64Array(0)) {
  const {exports: core} = await WebAssembly.instantiate(MODULE, {});
  const description = describe(core, options);
  const {layout} = description;
  const {law, constants: numbers, memory, table} = CONTROLLERS[controller];
  const arrays = {
    world: new Float64Array(layout.rows),
    observations: new Float32Array(layout.entries),
    law_constants: readArray(numbers),
    memory: Float64Array.from(memory),
    reference: readArray(table),
    keys: new BigUint64Array(2),
    episodes: new BigInt64Array(1),
    rows: new BigInt64Array(1),
    drawn: new Float64Array(layout.draws),
    metrics: new Float64Array(TASKS[task].metrics.length),
    fields: new Float64Array(NAMES.BATCH.length),
    network,
  };
  const address = {};
  for (const [name, {byteLength}] of Object.entries(arrays))
    address[name] = core.allocate(byteLength);
  const view = {};
  for (const [name, array] of Object.entries(arrays)) {
    view[name] = new array.constructor(core.memory.buffer, address[name], array.length);
    view[name].set(array);
  }
  const fields =
    {...address, num_envs: 1, lanes: 1, task: options.task, reference_rows: table.rows};
  fields.law = NAMES.LAWS.indexOf(law);
  view.fields.set(NAMES.BATCH.map((name) => fields[name] ?? 0));
  core.bind(address.fields);
  return {core, address, view, description, task, options};
}

/** One capsule, with or without a control law inside its step. `load` creates it. */
export class Capsule {
  #started;
  #changes = [];
  #due = 0;

  /** Called by `load` and `drive` with the result of `startCore`. */
  constructor(started) { this.#started = started; }

  /**
   * What the core says of the environment: settings of the step, layout of `world`, entries of the
   * observation, draws.
   */
  get description() { return this.#started.description; }

  /** Whether an episode draws values and accepts a seed. */
  get draws() { return this.description.draws.some(([, , , , range]) => range !== 0); }

  /** Name of the task. */
  get task() { return this.#started.task; }

  /** Length of a step, s. */
  get controlDt() { return this.#started.options.control_dt; }

  /** Steps of a whole episode. */
  get horizon() { return this.description.layout.steps; }

  /**
   * Begins an episode. The seed determines the drawn values; without one, the last seed and the
   * number of episodes since then do. By default, M and mu are nominal, and the state is
   * `constants.start`.
   */
  reset({changes = [], seed, ...given} = {}) {
    const schedule = checkChanges(changes);
    const numbers = this.#givenNumbers(given);
    if (seed !== undefined) {
      if (!this.draws) throw new RangeError("seed must be left out: nothing is drawn");
      checkCount("seed", seed, 2 ** 53);
    }
    const {core, view} = this.#started;
    if (seed !== undefined) {
      view.keys.set([BigInt(seed), 0n]);
      view.episodes[0] = 0n;
    }
    core.draw_episode();
    this.description.draws.forEach(([row], line) => {
      if (numbers.has(row)) view.drawn[line] = numbers.get(row);
    });
    [this.#changes, this.#due] = [schedule, 0];
    core.begin_episode();
    this.#advance(true);
    return {observation: this.observation, info: this.info};
  }

  /** Takes one step; the action is rounded to float32 and clipped to [-1, 1]. */
  step(action) {
    checkNumber("action", action);
    if (this.#get(ROW.termination)) throw new Error("the episode has ended: reset() first");
    const now = this.#get(ROW.steps) * this.controlDt + 1e-9;
    while (this.#due < this.#changes.length && this.#changes[this.#due].t <= now) {
      this.#setPlant(this.#changes[this.#due++]);
    }
    this.#started.view.world[ROW.action] = Math.fround(action);
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
  setPlant({M, mu}) { this.#setPlant(checkPlant("", {M, mu})); }

  /** theta (rad), theta_dot (rad/s), x (m) and x_dot (m/s). */
  get state() { return this.#read(STATE); }

  /** The current observation, as in Python. */
  get observation() { return this.#started.view.observations.slice(); }

  /**
   * All quantities of the last step and of the episode by name, in SI units, values of the task,
   * and the termination. A disturbed plant adds the sensor readings and the values that the episode
   * has drawn.
   */
  get info() {
    const shown = this.#read(SHOWN);
    const {fields, shown: names} = TASKS[this.task];
    for (const name of names)
      shown[name] = this.#get(this.description.layout.task + fields.indexOf(name));
    if (this.description.settings.varied) {
      shown.reading = this.#read(STATE, "read_");
      shown.capsule = this.#read(CONSTANTS, "drawn_");
      shown.disturbances = this.#read(DISTURBANCES);
    }
    return {...shown, termination: NAMES.TERMINATIONS[shown.termination]};
  }

  /**
   * The metrics of the episode so far; a failed episode's mean speed is over the length of a whole
   * episode.
   */
  get metrics() {
    const {core, address, view} = this.#started;
    core.metrics(this.horizon * this.controlDt, address.metrics);
    return named(TASKS[this.task].metrics, view.metrics);
  }

  /** A copy of the step's whole memory, in the order of `quantities`. */
  get world() { return this.#started.view.world.slice(); }

  /**
   * Copies of what `check` compares: the rows of `info`, the memories of law and task, the last
   * reading.
   */
  get compared() {
    const {settings, layout} = this.description;
    const {world} = this;
    const reading = settings.varied ? [world.slice(ROW.read_theta, ROW.read_x_dot + 1)] : [];
    return [
      world.slice(0, SHOWN.length), world.slice(layout.law_memory, layout.task_end), ...reading,
      this.observation
    ];
  }

  /** The whole state, for `restore`. */
  snapshot() {
    const [changes, due] = [this.#changes, this.#due];
    const {episodes, keys} = this.#started.view;
    return {
      world: this.world,
      observation: this.observation,
      changes,
      due,
      drawn: [episodes[0], ...keys]
    };
  }

  /** Restores the state from a snapshot of this capsule. */
  restore({world, observation, changes, due, drawn: [episodes, ...key]}) {
    const {view} = this.#started;
    if (world.length !== view.world.length)
      throw new RangeError("snapshot must be one of a capsule of the same kind");
    view.world.set(world);
    view.observations.set(observation);
    view.episodes[0] = episodes;
    view.keys.set(key);
    [this.#changes, this.#due] = [changes, due];
  }

  #get(row) { return this.#started.view.world[row]; }

  /** Values of rows by their names without the prefix. */
  #read(names, prefix = "") {
    return Object.fromEntries(names.map((name) => [name, this.#get(ROW[prefix + name])]));
  }

  /** Values passed to `reset` that replace drawn ones, by row of the world. */
  #givenNumbers(given) {
    const {settings, layout, draws} = this.description;
    const {limits, largest_state: largest} = constants;
    const options = TASKS[this.task].draws;
    const more = settings.varied ? ["capsule", "disturbances"] : [];
    const names = ["M", "mu", ...STATE, ...new Set(options), ...more];
    const found = new Map();
    const put = (row, name, value, [low, high]) =>
      found.set(ROW[row], checkNumber(name, value, low, high));
    for (const [name, value] of Object.entries(given).filter(([, value]) => value !== undefined)) {
      if (!names.includes(name)) {
        throw new RangeError(
          `reset takes ${[...names, "changes", "seed"].join(", ")}, got ${name}`);
      } else if (STATE.includes(name)) {
        put(name, name, value, [-largest[name], largest[name]]);
      } else if (name === "capsule") {
        const fields = Object.entries(checkFields(name, value, CONSTANTS));
        for (const [field, number] of fields)
          put(`drawn_${field}`, `capsule.${field}`, number, limits[field]);
      } else if (name === "disturbances") {
        for (const [field, number] of Object.entries(checkFields(name, value, DISTURBANCES))) {
          const [low, high] = ACCEPTED.options[`disturbances_${field}_low`];
          put(
            field, `disturbances.${field}`, number,
            [low, field === "latency" ? settings.longest_latency : high]);
        }
      } else if (options.includes(name)) {
        const lines = draws.slice(layout.task_draws).filter((_, n) => options[n] === name);
        const numbers =
          name === "commands" ? parseCommands(value) : parseNumbers(name, value, lines.length);
        lines.forEach(([row], n) => found.set(row, numbers[n]));
      } else put(name, name, value, limits[name]);
    }
    if (Math.abs(given.theta) === constants.theta_limit) {
      throw new RangeError(
        `theta must be a number within +-${constants.theta_limit}, got ${given.theta}`);
    }
    return found;
  }

  #setPlant({M, mu}) {
    this.#started.view.world[ROW.M] = M;
    this.#started.view.world[ROW.mu] = mu;
  }

  #advance(begin) {
    if (!this.#started.core.advance(begin))
      throw new Error("the control law returned a torque that is not finite");
  }
}

/** A capsule and its driver in closed loop. `drive` creates it. */
export class Episode extends Capsule {
  #driver;
  #started;
  #recording = null;
  #action = 0;

  /** Called by `drive`. */
  constructor(started, driver) {
    super(started);
    this.#started = started;
    this.#driver = driver;
  }

  /** Name of the driver. */
  get driver() { return this.#driver.name; }

  /** The driver's last action. */
  get action() { return this.#action; }

  /** Begins an episode. */
  reset({set, plant, seed, ...options} = {}) {
    const {name, recordings} = this.#driver;
    let start = options;
    if (set !== undefined || plant !== undefined) {
      const {changes, ...others} = options;
      if (Object.keys(others).length > 0)
        throw new RangeError("set and plant must stand without M, mu and a start");
      checkChoice("set", set, Object.keys(recordings ?? sets));
      const wanted = optionsOf(this.#driver, sets[set].options);
      if (sets[set].task !== this.task || !sameOptions(wanted, this.#started.options)) {
        throw new RangeError(
          `set must be one with the disturbances that drive() was given, got ${set}`);
      }
      start = {
        ...sets[set].plants[checkCount("plant", plant, sets[set].plants.length)],
        ...(changes && {changes})
      };
    } else if (recordings) {
      throw new RangeError(
        `set and plant must be given: what ${name} does is recorded on the frozen plants alone`);
    }
    const {seed: own = 0, ...first} = start;
    const chosen = seed ?? own;
    if (seed !== undefined && !this.draws)
      throw new RangeError(`seed must be left out: ${name} draws nothing`);
    this.#recording = recordings ? recordingOf(recordings[set], plant) : null;
    this.#action = 0;
    return super.reset(
      {...first, ...(this.draws && (seed !== undefined || set) ? {seed: chosen} : {})});
  }

  /** Calls `step` with an action of the driver. */
  tick() {
    this.#action = Math.fround(this.#choose());
    return this.step(this.#action);
  }

  /** The whole state, including the driver's. */
  snapshot() { return {...super.snapshot(), action: this.#action, recording: this.#recording}; }

  /** Restores the state, including the driver's. */
  restore(snapshot) {
    super.restore(snapshot);
    [this.#action, this.#recording] = [snapshot.action, snapshot.recording];
  }

  #choose() {
    const {address, core} = this.#started;
    if (this.#driver.network) return core.act(address.network);
    if (this.#recording) return HEADER.torques[this.#recording[this.info.steps]];
    return 0;
  }
}

/**
 * Returns a driver's network, from the archive if the module contains the driver; undefined if
 * there is none.
 */
function networkOf({network}) {
  return network === undefined || network instanceof Float64Array ? network : readArray(network);
}

/** Returns the index in `HEADER.torques` of each action on a plant. */
function recordingOf({at, steps}, plant) {
  const begin = steps.slice(0, plant).reduce((sum, length) => sum + length, at);
  return CONTENT.subarray(begin, begin + steps[plant]);
}

/** Returns the options of the core for a driver's environment, some of them replaced. */
function optionsOf({task, controller, options}, given) {
  return mergeOptions(task, controller, options, given);
}

/** Whether two environments have equal options. */
function sameOptions(one, other) {
  return NAMES.OPTIONS.every((name) => one[name] === other[name]);
}

/**
 * Creates a capsule with one of `controllers` in its step, at the beginning of an episode.
 *
 * @param controller "direct" or a law.
 * @param options `task`; `disturbances`: "none", "real" or fields of `capsule_gym.Disturbances`;
 *   `options`: options of the core by name; or `set`, the name of a set whose environments' options
 *   apply.
 */
export async function load(controller, options = {}) {
  checkChoice("controller", controller, controllers);
  const {set, task, disturbances, options: own = {}} =
    checkFields("options", options, LOAD_OPTIONS);
  if (set !== undefined) checkChoice("set", set, Object.keys(sets));
  const other = Object.keys(options).find((name) => name !== "set" && options[name] !== undefined);
  if (set !== undefined && other)
    throw new RangeError(`${other} must be left out: the set says it`);
  const known = CONTROLLERS[controller].tasks;
  const chosen = checkChoice(`task with ${controller}`, task ?? sets[set]?.task ?? known[0], known);
  const disturbed = disturbances === undefined ? {} : disturbanceOptions(disturbances);
  const given = sets[set]?.options ?? {...checkOptions(own, chosen), ...disturbed};
  const capsule =
    new Capsule(await startCore(chosen, controller, mergeOptions(chosen, controller, given)));
  capsule.reset();
  return capsule;
}

/**
 * Creates an episode of one of `drivers`, at its beginning. The options are those of `reset`, and
 * the disturbances, as in `load`. Alternatively, `set` and `plant` select a plant of a frozen set
 * by its number; the set then defines the start and the disturbances.
 */
export async function drive(name, {disturbances, ...options} = {}) {
  checkChoice("driver", name, drivers.map((driver) => driver.name));
  const driver = DRIVERS.find((each) => each.name === name);
  const {task, controller} = driver;
  const found = sets[options.set];
  if (found && disturbances !== undefined)
    throw new RangeError("disturbances must be left out: the set says them");
  if (found && found.task !== task)
    throw new RangeError(`set must be one of the task ${task}, got ${options.set}`);
  const disturbed = disturbances === undefined ? {} : disturbanceOptions(disturbances);
  const given = optionsOf(driver, found?.options ?? disturbed);
  const episode = new Episode(await startCore(task, controller, given, networkOf(driver)), driver);
  episode.reset(options);
  return episode;
}

/**
 * Returns the length of a network by its header and widths, in the order of
 * `capsule_gym.policies.network.pack`, or NaN.
 */
function networkSize([layers, , , , ...rest], entries) {
  const padded = (width) => Math.ceil(width / ACCEPTED.padding) * ACCEPTED.padding;
  const first = padded(4) - 4;
  const widths = rest.slice(first, first + layers + 1);
  const units = widths.slice(1);
  const whole =
    units.every((width) => Number.isInteger(width) && width > 0 && width <= ACCEPTED.units);
  if (!whole || units.length !== layers || widths[0] !== entries || units.at(-1) !== 1) return NaN;
  const size = units.reduce((sum, width, n) => sum + padded(width) * (1 + widths[n]), 0);
  return padded(4) + padded(layers + 1) + 2 * padded(entries) + size;
}

/** Adds a policy of your own to `drivers`, as `web.data.describe_policy` describes it in Python. */
export function addDriver(driver) {
  // A copy: what is checked is what is added.
  const added = structuredClone(checkFields("driver", driver, DRIVER_FIELDS));
  const {name, description, kind, task, controller, network} = added;
  for (const [field, text] of Object.entries({name, description})) {
    if (typeof text !== "string")
      throw new TypeError(`${field} must be a string, got ${String(text)}`);
  }
  if (DRIVERS.some((other) => other.name === name))
    throw new RangeError(`name must be a new one, got ${name}`);
  checkChoice("kind", kind, ["policy"]);
  checkChoice("controller", controller, controllers);
  checkChoice(`task with ${controller}`, task, CONTROLLERS[controller].tasks);
  added.options = checkOptions(added.options, task);
  const {entries} = describe(CORE, optionsOf(added, {})).layout;
  if (!Array.isArray(network))
    throw new TypeError(`network must be an array of numbers, got ${String(network)}`);
  added.network = Float64Array.from(network, (number, n) => checkNumber(`network[${n}]`, number));
  if (added.network.length !== networkSize(added.network, entries)) {
    const accepted = `as web.data.describe_policy gives it, for ${entries} entries`;
    throw new RangeError(`network must be ${accepted}, got ${network.length} numbers`);
  }
  DRIVERS.push(added);
  drivers.push(publicFields(added));
}

/** Returns the sha256 of concatenated typed arrays. */
async function digest(arrays) {
  const content = new Uint8Array(await new Blob(arrays).arrayBuffer());
  const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", content));
  return Array.from(hash, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Replays one committed episode; resolves to its hash and the numbers of steps and doubles. */
async function replay({driver, actions, hold, ...options}) {
  const episode = await drive(driver, options);
  const shown = [];
  let [steps, doubles] = [0, 0];
  for (let over = false; !over; steps++) {
    const action = actions?.[Math.floor(steps / hold) % actions.length];
    const {terminated, truncated} = actions ? episode.step(action) : episode.tick();
    const arrays = episode.compared;
    shown.push(...arrays);
    doubles += arrays.slice(0, -1).reduce((sum, array) => sum + array.length, 0);
    over = terminated || truncated;
    // Keeps the page responsive.
    if (steps % 200 === 199) await new Promise((resolve) => setTimeout(resolve));
  }
  return {hash: await digest(shown), steps, doubles};
}

/**
 * Replays the committed episodes, and compares every bit of what they show with Python's by hash.
 *
 * @param report called with {name, equal, steps, doubles} after each episode.
 */
export async function check(report = () => {}) {
  let all = true;
  for (const {name, steps, sha256, ...episode} of HEADER.episodes) {
    const found = await replay(episode);
    const equal = found.hash === sha256 && found.steps === steps;
    all &&= equal;
    report({name, equal, steps: found.steps, doubles: found.doubles});
  }
  return all;
}
