/**
 * The capsule robot in a browser or in node: the environment's own compiled step, its laws and its trained policies as
 * WebAssembly, with the bits that Python gives. `capsule.d.mts` says the types, docs/live.md shows how to use it.
 *
 * Nothing here knows any physics: this file lays arrays out in a memory, calls what is compiled, and reads the results.
 *
 * @module
 */

/** What `python -m web.build` puts here: modules, tables, networks, plants; see `web/data.py`. */
const ARCHIVE = "";

const STACK = 65536;
const PAGE = 65536;
const LINE = 64;

/** The archive's header, and the bytes behind it. */
async function unpack(text) {
  const packed = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const content = new Uint8Array(await new Response(stream).arrayBuffer());
  const size = new DataView(content.buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(content.subarray(4, 4 + size)));
  return [header, content.subarray(4 + size)];
}

const [HEADER, CONTENT] = await unpack(ARCHIVE);
const { layout: LAYOUT, tasks: TASKS, drivers: DRIVERS } = HEADER;
const { lanes: LANES, quantities: QUANTITIES } = LAYOUT;
const ROW = Object.fromEntries(QUANTITIES.map((name, row) => [name, row]));
const STATE = Object.keys(HEADER.constants.start);
/** The quantities that mean something between two steps. */
const SHOWN = QUANTITIES.slice(0, ROW.clock + 1);
const MODULES = new Map();

/** What a page shows of a driver. */
function describe({ settings, network, units, gaits, recordings, seeds, ...shown }) {
  const own = { controlDt: settings.control_dt, steps: settings.steps };
  return { ...shown, ...own, ...(recordings && { recorded: true }), ...(seeds && { seeds: seeds.count }) };
}

/** Every driver, with what a page shows of it. */
export const drivers = DRIVERS.map(describe);
/** The frozen evaluation sets: hash and plants. */
export const sets = HEADER.sets;
/** Numbers of the task and of the plant, in SI units. */
export const constants = HEADER.constants;
/** Names of the tasks that `load` takes. */
export const tasks = Object.keys(TASKS);
/** Names of the rows of `world`, in their order; behind them lie the law's memory and its line of the reference. */
export const quantities = QUANTITIES;

/** A float64 array out of the archive, where its bytes lie by columns and significance. */
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

/** A compiled module, compiled once. */
function compiled(name) {
  if (!MODULES.has(name)) {
    const { at, size } = HEADER.modules[name];
    MODULES.set(name, WebAssembly.compile(CONTENT.slice(at, at + size)));
  }
  return MODULES.get(name);
}

/** Arrays in one memory: the views, their addresses, and the functions of modules that work in it. */
async function place(sizes, names) {
  let end = STACK;
  const address = {};
  for (const [name, [Kind, length]] of Object.entries(sizes)) {
    address[name] = end;
    end += Math.ceil((length * Kind.BYTES_PER_ELEMENT) / LINE) * LINE;
  }
  const memory = new WebAssembly.Memory({ initial: Math.ceil(end / PAGE) });
  const env = {
    __linear_memory: memory,
    __stack_pointer: new WebAssembly.Global({ value: "i32", mutable: true }, STACK),
  };
  const call = {};
  for (const name of names) {
    Object.assign(call, (await WebAssembly.instantiate(await compiled(name), { env })).exports);
  }
  const views = Object.entries(sizes).map(([name, [Kind, length]]) => [
    name,
    new Kind(memory.buffer, address[name], length),
  ]);
  return { address, call, view: Object.fromEntries(views) };
}

/** Returns a number, or says which argument is none, or out of range. */
function checkNumber(name, value, low = -Infinity, high = Infinity) {
  const accepted = `a finite number${Number.isFinite(high) ? ` in [${low}, ${high}]` : ""}`;
  if (typeof value !== "number") throw new TypeError(`${name} must be ${accepted}, got ${String(value)}`);
  if (!(Number.isFinite(value) && value >= low && value <= high)) {
    throw new RangeError(`${name} must be ${accepted}, got ${value}`);
  }
  return value;
}

/** The entry of that name, or an error that lists the names. */
function find(what, name, entries) {
  const found = entries.find((entry) => entry.name === name);
  if (!found) throw new RangeError(`${what} must be one of ${entries.map((e) => e.name).join(", ")}, got ${name}`);
  return found;
}

/** Returns an index, or says what is accepted. */
function checkCount(name, value, count) {
  const accepted = `a whole number from 0 to ${count - 1}`;
  if (!Number.isInteger(value)) throw new TypeError(`${name} must be ${accepted}, got ${String(value)}`);
  if (value < 0 || value >= count) throw new RangeError(`${name} must be ${accepted}, got ${value}`);
  return value;
}

/** A plant's M and mu, checked. */
function checkPlant(name, plant) {
  const { limits } = constants;
  return { M: checkNumber(`${name}M`, plant.M, ...limits.M), mu: checkNumber(`${name}mu`, plant.mu, ...limits.mu) };
}

/** The jumps of an episode, checked. */
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

/** The generator of random torques: numpy's PCG64, from a state and an increment of 128 bits. */
class Draws {
  constructor(state, increment) {
    this.state = state;
    this.increment = increment;
  }

  copy() {
    return new Draws(this.state, this.increment);
  }

  /** A number from -1 to 1, as `uniform` draws it. */
  next() {
    const cut = (bits, value) => BigInt.asUintN(bits, value);
    this.state = cut(128, this.state * 0x2360ed051fc65da44385df649fccf645n + this.increment);
    const [mixed, turn] = [cut(64, (this.state >> 64n) ^ this.state), this.state >> 122n];
    const turned = cut(64, (mixed >> turn) | (mixed << (64n - turn)));
    return Number(turned >> 11n) * 2 ** -52 - 1;
  }
}

/** One capsule with a law inside its step, or with none. Made by `load`. */
export class Capsule {
  #place;
  #settings;
  #task;
  #changes = [];
  #due = 0;

  /** For `load` and `drive`. */
  constructor(placed, task, settings) {
    this.#place = placed;
    this.#task = task;
    this.#settings = settings;
    const { view } = placed;
    view.fixed.set(settings.fixed);
    view.fixed.set(task.reference, settings.fixed.length);
    view.memory.set(task.memory);
  }

  /** Length of a step, s. */
  get controlDt() {
    return this.#settings.control_dt;
  }

  /** Steps of a whole episode. */
  get horizon() {
    return this.#settings.steps;
  }

  /** Begins an episode; what is not given is nominal, and at rest at the angle that episodes start from. */
  reset({ M = constants.nominal.M, mu = constants.nominal.mu, changes = [], ...state } = {}) {
    const plant = checkPlant("", { M, mu });
    const schedule = checkChanges(changes);
    const start = { ...constants.start, ...state };
    for (const [name, value] of Object.entries(start)) {
      if (!STATE.includes(name)) throw new RangeError(`reset takes M, mu, changes, ${STATE.join(", ")}, got ${name}`);
      const largest = constants.largest_state[name];
      checkNumber(name, value, -largest, largest);
    }
    if (Math.abs(start.theta) === constants.theta_limit) {
      throw new RangeError(`theta must be a number within +-${constants.theta_limit}, got ${start.theta}`);
    }
    const { address, call, view } = this.#place;
    view.starts.set([...STATE.map((name) => start[name]), plant.M, plant.mu]);
    [this.#changes, this.#due] = [schedule, 0];
    call.renew(
      ...[address.world, view.world.length, address.memory, view.memory.length, constants.m, constants.g],
      ...[address.starts, address.rows, address.episodes],
    );
    this.#advance(true);
    return { observation: this.observation, info: this.info };
  }

  /** One step under an action, which is clipped to [-1, 1] and as coarse as a float32. */
  step(action) {
    checkNumber("action", action);
    if (this.#get(ROW.termination)) throw new Error("the episode has ended: reset() first");
    const now = this.#get(ROW.steps) * this.controlDt + 1e-9;
    while (this.#due < this.#changes.length && this.#changes[this.#due].t <= now) {
      this.#setPlant(this.#changes[this.#due++]);
    }
    this.#place.view.world[LANES * ROW.action] = Math.fround(action);
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

  /** Lets M and mu jump before the next step. */
  setPlant({ M, mu }) {
    this.#setPlant(checkPlant("", { M, mu }));
  }

  /** theta (rad), theta_dot (rad/s), x (m) and x_dot (m/s). */
  get state() {
    return Object.fromEntries(STATE.map((name) => [name, this.#get(ROW[name])]));
  }

  /** The present observation, as Python shows it. */
  get observation() {
    return this.#place.view.observations.slice(0, this.#settings.entries);
  }

  /** Every quantity of the last step and of the episode by name, in SI units, and why the episode has ended. */
  get info() {
    const shown = Object.fromEntries(SHOWN.map((name) => [name, this.#get(ROW[name])]));
    return { ...shown, termination: LAYOUT.terminations[shown.termination] };
  }

  /** The numbers that the episode so far is judged by; of a failed one the mean speed is over a whole episode. */
  get metrics() {
    const is = this.info;
    const failed = is.termination !== LAYOUT.terminations[0];
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
    };
  }

  /** A copy of all that the step remembers, in the order of `quantities`: what bits are compared of. */
  get world() {
    return Float64Array.from({ length: this.#task.rows }, (_, row) => this.#get(row));
  }

  /** The whole state, for `restore`. */
  snapshot() {
    const [changes, due] = [this.#changes, this.#due];
    return { world: this.world, observation: this.observation, changes, due, cells: this.#place.view.cells.slice() };
  }

  /** Goes back to where a snapshot of this capsule was taken. */
  restore({ world, observation, changes, due, cells }) {
    const { view } = this.#place;
    if (world.length !== this.#task.rows || cells.length !== view.cells.length) {
      throw new RangeError("snapshot must be one of a capsule with the same law and the same kind of driver");
    }
    world.forEach((value, row) => (view.world[LANES * row] = value));
    view.observations.set(observation);
    view.cells.set(cells);
    [this.#changes, this.#due] = [changes, due];
  }

  #get(row) {
    return this.#place.view.world[LANES * row];
  }

  #setPlant({ M, mu }) {
    this.#place.view.world[LANES * ROW.M] = M;
    this.#place.view.world[LANES * ROW.mu] = mu;
  }

  #advance(begin) {
    const { address, call, view } = this.#place;
    const { world, fixed, observations } = address;
    const broken = call.advance(world, view.world.length, begin ? 1 : 0, fixed, view.fixed.length, observations);
    if (broken >= 0) throw new Error("the control law returned a torque that is not finite");
  }
}

/** A capsule and what drives it, in closed loop. Made by `drive`. */
export class Episode extends Capsule {
  #driver;
  #place;
  #recording = null;
  #draws = null;
  #action = 0;

  /** For `drive`. */
  constructor(placed, task, driver) {
    super(placed, task, driver.settings);
    this.#place = placed;
    this.#driver = driver;
  }

  /** Name of the driver. */
  get driver() {
    return this.#driver.name;
  }

  /** What it last chose. */
  get action() {
    return this.#action;
  }

  /** Begins an episode, whose driver remembers nothing of the last one. */
  reset({ set, plant, seed, ...options } = {}) {
    const { name, recordings, seeds } = this.#driver;
    let start = options;
    if (set !== undefined || plant !== undefined) {
      if (Object.keys(options).length > 0) throw new RangeError("set and plant must stand without M, mu and a start");
      if (!Object.hasOwn(sets, set)) throw new RangeError(`set must be one of ${Object.keys(sets).join(", ")}, got ${set}`);
      start = sets[set].plants[checkCount("plant", plant, sets[set].plants.length)];
    } else if (recordings) {
      throw new RangeError(`set and plant must be given: what ${name} does is recorded on the frozen plants alone`);
    }
    if (seed !== undefined && !seeds) throw new RangeError(`seed must be left out: ${name} draws nothing`);
    const draws = seeds && drawsOf(seeds, checkCount("seed", seed ?? plant ?? 0, seeds.count));
    this.#place.view.cells.fill(0);
    this.#recording = recordings ? recordingOf(recordings[set], plant) : null;
    [this.#action, this.#draws] = [0, draws];
    return super.reset(start);
  }

  /** `step`, whose action the driver chooses. */
  tick() {
    this.#action = Math.fround(this.#choose());
    return this.step(this.#action);
  }

  /** With the driver's memory. */
  snapshot() {
    const [action, recording, draws] = [this.#action, this.#recording, this.#draws?.copy() ?? null];
    return { ...super.snapshot(), action, recording, draws };
  }

  /** With the driver's memory. */
  restore(snapshot) {
    super.restore(snapshot);
    [this.#action, this.#recording] = [snapshot.action, snapshot.recording];
    this.#draws = snapshot.draws?.copy() ?? null;
  }

  #choose() {
    if (this.#driver.network) return this.#act();
    if (this.#driver.gaits) return this.#perform();
    if (this.#recording) return LAYOUT.torques[this.#recording[this.info.steps]];
    return this.#draws?.next() ?? 0;
  }

  /** The gait of the cell that the plant lies in; the plant is what the observation ends with. */
  #perform() {
    const { address, call, view } = this.#place;
    const { M, edges, cells } = this.#driver.gaits;
    const [mass, friction] = this.observation.slice(-2);
    const distances = M.map((centre) => Math.abs(mass - centre));
    const column = edges.filter((edge) => edge < friction * friction).length;
    const gait = cells[distances.indexOf(Math.min(...distances))][column];
    const time = this.info.steps * this.controlDt;
    return call.gait(address.gaits, view.gaits.length, gait, time, address.observations);
  }


  #act() {
    const { address, call, view } = this.#place;
    return call.act(
      ...[address.network, view.network.length, address.observations],
      ...[address.cells, address.inputs, address.scratch, this.#driver.units],
    );
  }
}

/** A driver's network, which lies in the archive where the driver came with the module. */
function networkOf(driver) {
  const network = driver?.network ?? new Float64Array(0);
  return network instanceof Float64Array ? network : readArray(network);
}

/** The generator that Python has for that seed. */
function drawsOf({ at }, seed) {
  const bytes = new DataView(CONTENT.buffer, CONTENT.byteOffset + at + 32 * seed, 32);
  const number = (place) => (bytes.getBigUint64(place + 8, true) << 64n) | bytes.getBigUint64(place, true);
  return new Draws(number(0), number(16));
}

/** Of each step on that plant the place of its action in `LAYOUT.torques`. */
function recordingOf({ at, steps }, plant) {
  const begin = steps.slice(0, plant).reduce((sum, length) => sum + length, at);
  return CONTENT.subarray(begin, begin + steps[plant]);
}

/** Places, and the arrays that a task and a driver need. */
async function prepare(name, driver) {
  const task = { ...TASKS[name], reference: readArray(TASKS[name].table) };
  const network = networkOf(driver);
  const gaits = driver?.gaits ? readArray(driver.gaits.table) : new Float64Array(0);
  const { fixed } = (driver ?? task).settings;
  const sizes = {
    world: [Float64Array, task.rows * LANES],
    fixed: [Float64Array, fixed.length + task.reference.length],
    observations: [Float32Array, LAYOUT.entries],
    memory: [Float64Array, task.memory.length],
    starts: [Float64Array, LAYOUT.starts],
    rows: [BigInt64Array, 1],
    episodes: [BigInt64Array, 1],
    network: [Float64Array, network.length],
    gaits: [Float64Array, gaits.length],
    cells: [Float64Array, network.length ? LAYOUT.cells : 0],
    inputs: [Float32Array, LAYOUT.entries + LAYOUT.cells],
    scratch: [Float64Array, network.length ? 2 * driver.units * LANES : 0],
  };
  const placed = await place(sizes, [name, "common"]);
  placed.view.network.set(network);
  placed.view.gaits.set(gaits);
  return [placed, task];
}

/** A capsule with one of `tasks` in its step, at the beginning of a nominal episode. */
export async function load(name) {
  if (!Object.hasOwn(TASKS, name)) throw new RangeError(`task must be one of ${tasks.join(", ")}, got ${name}`);
  const [placed, task] = await prepare(name, null);
  const capsule = new Capsule(placed, task, task.settings);
  capsule.reset();
  return capsule;
}

/**
 * An episode of one of `drivers`, at its beginning; the options are those of `reset`, and the energy weight. In their
 * place stand the name of a frozen set and the number of a plant in it.
 */
export async function drive(name, { energyWeight, ...options } = {}) {
  const driver = find("driver", name, DRIVERS);
  const [placed, task] = await prepare(driver.task, driver);
  const episode = new Episode(placed, task, driver);
  if (energyWeight !== undefined) {
    if (!driver.energyWeight) throw new RangeError(`energyWeight must be left out: ${name} is told none`);
    checkNumber("energyWeight", energyWeight, ...driver.energyWeight);
    placed.view.fixed[LAYOUT.energy_weight] = energyWeight;
    placed.view.network[LAYOUT.log_energy_weight] = placed.call.log(energyWeight);
  }
  episode.reset(options);
  return episode;
}

/** Makes a policy from elsewhere one of `drivers`: what `web.data.describe_policy` says of it in Python. */
export function addDriver(driver) {
  const { name, task, settings, network, units } = driver;
  if (typeof name !== "string") throw new TypeError(`name must be a string, got ${String(name)}`);
  if (DRIVERS.some((other) => other.name === name)) throw new RangeError(`name must be a new one, got ${name}`);
  if (!Object.hasOwn(TASKS, task)) throw new RangeError(`task must be one of ${tasks.join(", ")}, got ${task}`);
  const [size, given] = [TASKS[task].settings.fixed.length, settings?.fixed?.length];
  if (given !== size) throw new RangeError(`settings.fixed must be ${size} numbers, got ${given}`);
  checkNumber("settings.entries", settings.entries, 1, LAYOUT.entries);
  checkNumber("settings.control_dt", settings.control_dt, Number.MIN_VALUE, Number.MAX_VALUE);
  checkNumber("settings.steps", settings.steps, 1, Number.MAX_SAFE_INTEGER);
  if (!Array.isArray(network)) throw new TypeError(`network must be an array of numbers, got ${String(network)}`);
  network.forEach((number, n) => checkNumber(`network[${n}]`, number));
  checkNumber("units", units, 1, network.length);
  const added = { ...driver, network: Float64Array.from(network) };
  DRIVERS.push(added);
  drivers.push(describe(added));
}

/** The sha256 of typed arrays, one behind the other. */
async function digest(arrays) {
  const content = new Uint8Array(await new Blob(arrays).arrayBuffer());
  const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", content));
  return Array.from(hash, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Replays one committed episode; resolves to its hash, and how much was compared. */
async function replay({ driver, actions, hold, ...options }) {
  const episode = await drive(driver, options);
  const shown = [];
  for (let n = 0, over = false; !over; n++) {
    const action = actions?.[Math.floor(n / hold) % actions.length];
    const { terminated, truncated } = actions ? episode.step(action) : episode.tick();
    shown.push(episode.world, episode.observation);
    over = terminated || truncated;
    // The page stays alive.
    if (n % 200 === 199) await new Promise((resolve) => setTimeout(resolve));
  }
  return { hash: await digest(shown), steps: shown.length / 2, doubles: (shown.length / 2) * shown[0].length };
}

/**
 * Replays the committed episodes, and compares every bit of their worlds and observations with Python's by hash.
 *
 * @param report called with {name, equal, steps, doubles} after each.
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
