import {CONTROLLERS, HEADER, sets} from "./archive.mjs";
import {Capsule} from "./capsule.mjs";
import {checkChoice, checkCount, checkFields} from "./checks.mjs";
import {startCore} from "./core.mjs";
import {DRIVERS, drivers, networkOf, optionsOf, recordingOf} from "./drivers.mjs";
import {readHeader} from "./network.mjs";
import {
  checkOptions,
  controllers,
  disturbanceOptions,
  mergeOptions,
  sameOptions
} from "./options.mjs";
import {startScripted} from "./scripted.mjs";

const LOAD_OPTIONS = ["set", "task", "disturbances", "options"];

/** A capsule and its driver in closed loop. `drive` creates it. */
export class Episode extends Capsule {
  #driver;
  #started;
  #scripted;
  #scriptedMemory = null;
  #recording = null;
  #action = 0;

  /** Called by `drive` with the results of `startCore` and `startScripted`. */
  constructor(started, driver, scripted) {
    super(started);
    this.#started = started;
    this.#driver = driver;
    this.#scripted = scripted;
  }

  /** Name of the driver. */
  get driver() { return this.#driver.name; }

  /** The driver's last action. */
  get action() { return this.#action; }

  /** A copy of the outputs h of the driver's recurrent cell; empty without one. */
  get memory() {
    const {network, network_memory} = this.#started.view;
    return network_memory.slice(0, readHeader(network).units);
  }

  /** Begins an episode. */
  reset({set, plant, seed, ...options} = {}) {
    const {name, recordings} = this.#driver;
    const frozen = set !== undefined || plant !== undefined;
    if (recordings && !frozen) {
      throw new RangeError(
        `set and plant must be given: what ${name} does is recorded on the frozen plants alone`);
    }
    const start = frozen ? this.#frozenStart(set, plant, options) : options;
    const {seed: own = 0, ...first} = start;
    if (seed !== undefined && !this.draws)
      throw new RangeError(`seed must be left out: ${name} draws nothing`);
    this.#recording = recordings ? recordingOf(recordings[set], plant) : null;
    this.#scriptedMemory = this.#scripted?.start;
    this.#action = 0;
    this.#started.view.network_memory.fill(0);
    if (this.draws && (frozen || seed !== undefined)) first.seed = seed ?? own;
    return super.reset(first);
  }

  /** Calls `step` with an action of the driver. */
  tick() {
    this.#action = Math.fround(this.#choose());
    return this.step(this.#action);
  }

  /** The whole state, including the driver's. */
  snapshot() {
    const driver = {
      action: this.#action,
      recording: this.#recording,
      scriptedMemory: this.#scriptedMemory,
      memory: this.#started.view.network_memory.slice()
    };
    return {...super.snapshot(), ...driver};
  }

  /** Restores the state, including the driver's. */
  restore(snapshot) {
    super.restore(snapshot);
    this.#action = snapshot.action;
    this.#recording = snapshot.recording;
    this.#scriptedMemory = snapshot.scriptedMemory;
    this.#started.view.network_memory.set(snapshot.memory);
  }

  /** The start on a plant of a frozen set, with other jumps if given. */
  #frozenStart(set, plant, {changes, ...others}) {
    if (Object.keys(others).length > 0)
      throw new RangeError("set and plant must stand without M, mu and a start");
    checkChoice("set", set, Object.keys(this.#driver.recordings ?? sets));
    const {task, plants, options} = sets[set];
    const wanted = optionsOf(this.#driver, options);
    if (task !== this.task || !sameOptions(wanted, this.#started.options)) {
      throw new RangeError(
        `set must be one with the disturbances that drive() was given, got ${set}`);
    }
    const start = {...plants[checkCount("plant", plant, plants.length)]};
    if (changes) start.changes = changes;
    return start;
  }

  #choose() {
    const {address, core} = this.#started;
    if (this.#driver.network) return core.act(address.network, address.network_memory);
    if (this.#scripted) {
      const [action, memory] = this.#scripted.act(this.observation, this.#scriptedMemory);
      this.#scriptedMemory = memory;
      return action;
    }
    if (this.#recording) return HEADER.torques[this.#recording[this.info.steps]];
    return 0;
  }
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
  const {set, disturbances, options: own = {}} = checkFields("options", options, LOAD_OPTIONS);
  if (set !== undefined) {
    checkChoice("set", set, Object.keys(sets));
    const other =
      Object.keys(options).find((name) => name !== "set" && options[name] !== undefined);
    if (other) throw new RangeError(`${other} must be left out: the set says it`);
  }
  const known = CONTROLLERS[controller].tasks;
  const wanted = options.task ?? sets[set]?.task ?? known[0];
  const task = checkChoice(`task with ${controller}`, wanted, known);
  const disturbed = disturbanceOptions(disturbances);
  const given = sets[set]?.options ?? {...checkOptions(own, task), ...disturbed};
  const merged = mergeOptions(task, controller, given);
  const capsule = new Capsule(await startCore(task, controller, merged));
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
  const given = optionsOf(driver, found?.options ?? disturbanceOptions(disturbances));
  const started = await startCore(task, controller, given, networkOf(driver));
  const episode = new Episode(started, driver, await startScripted(driver));
  episode.reset(options);
  return episode;
}
