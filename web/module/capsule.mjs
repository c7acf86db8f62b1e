import {checkCount, checkNumber} from "./checks.mjs";
import {named, NAMES, quantities, ROW, STATE, TASKS} from "./core.mjs";
import {checkChanges, checkPlant, givenValues} from "./reset.mjs";

/** The quantities that are meaningful between two steps. */
const SHOWN = quantities.slice(0, ROW.clock + 1);
/** Tolerance for the time of a jump, s. */
const TIME_TOLERANCE = 1e-9;

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
    const {core, view} = this.#started;
    const schedule = checkChanges(changes);
    const values = givenValues(given, this.task, this.description);
    if (seed !== undefined) {
      if (!this.draws) throw new RangeError("seed must be left out: nothing is drawn");
      checkCount("seed", seed, 2 ** 53);
      view.keys.set([BigInt(seed), 0n]);
      view.episodes[0] = 0n;
    }
    core.draw_episode();
    this.description.draws.forEach(([row], line) => {
      if (values.has(row)) view.drawn[line] = values.get(row);
    });
    this.#changes = schedule;
    this.#due = 0;
    core.begin_episode();
    this.#advance(true);
    return {observation: this.observation, info: this.info};
  }

  /** Takes one step; the action is rounded to float32 and clipped to [-1, 1]. */
  step(action) {
    checkNumber("action", action);
    if (this.#get(ROW.termination)) throw new Error("the episode has ended: reset() first");
    this.#applyChanges();
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
    const {settings, layout} = this.description;
    const {fields, shown} = TASKS[this.task];
    const info = this.#read(SHOWN);
    for (const name of shown) info[name] = this.#get(layout.task + fields.indexOf(name));
    if (settings.varied) {
      info.reading = this.#read(STATE, "read_");
      info.capsule = this.#read(NAMES.CONSTANTS, "drawn_");
      info.disturbances = this.#read(NAMES.DISTURBANCES);
    }
    info.termination = NAMES.TERMINATIONS[info.termination];
    return info;
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
   * reading, the observation.
   */
  get compared() {
    const {settings, layout} = this.description;
    const {world} = this;
    const parts = [
      world.slice(0, SHOWN.length),
      world.slice(layout.law_memory, layout.task_end),
    ];
    if (settings.varied) parts.push(world.slice(ROW.read_theta, ROW.read_x_dot + 1));
    parts.push(this.observation);
    return parts;
  }

  /** The whole state, for `restore`. */
  snapshot() {
    const {episodes, keys} = this.#started.view;
    return {
      world: this.world,
      observation: this.observation,
      changes: this.#changes,
      due: this.#due,
      episode: episodes[0],
      keys: keys.slice(),
    };
  }

  /** Restores the state from a snapshot of this capsule. */
  restore({world, observation, changes, due, episode, keys}) {
    const {view} = this.#started;
    if (world.length !== view.world.length)
      throw new RangeError("snapshot must be one of a capsule of the same kind");
    view.world.set(world);
    view.observations.set(observation);
    view.episodes[0] = episode;
    view.keys.set(keys);
    this.#changes = changes;
    this.#due = due;
  }

  #get(row) { return this.#started.view.world[row]; }

  /** Values of rows by their names without the prefix. */
  #read(names, prefix = "") {
    return Object.fromEntries(names.map((name) => [name, this.#get(ROW[prefix + name])]));
  }

  /** Applies the jumps that are due before this step. */
  #applyChanges() {
    const now = this.#get(ROW.steps) * this.controlDt + TIME_TOLERANCE;
    while (this.#changes[this.#due]?.t <= now) {
      this.#setPlant(this.#changes[this.#due]);
      this.#due++;
    }
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
