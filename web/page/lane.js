// One driver on one plant: an episode, its recorded values, and snapshots for a return to any step.

import {constants, drive, load, sets} from "capsule.mjs";
import {disturbancesOf, driverNamed, startOf, titleOf, YOURSELF} from "scene.js";

// Tolerance of `Simulation` for the time of a jump, s.
const TIME_TOLERANCE = 1e-9;
const SNAPSHOT_SECONDS = 1;
// Angles of the helper, rad: beyond LET_GO, the motor does not push the ball further out; the key
// to hold changes at RETURN_AT and PUSH_AT.
const LET_GO = 0.8;
const RETURN_AT = 0.7;
const PUSH_AT = 0.09;
const CHANNELS = [
  "theta", "theta_dot", "x", "x_dot", "torque", "normal", "speed", "transport", "action", "target"
];

/**
 * The reader as driver: a capsule without a law, and an action that the page changes between two
 * steps.
 */
class Hand {
  /** @param {number[]} replay actions of the first steps. */
  constructor(capsule, replay) {
    this.capsule = capsule;
    this.replay = replay;
    this.live = 0;
    this.action = 0;
    this.helped = false;
    /** As of an episode whose driver has no recurrent cell. */
    this.memory = new Float64Array(0);
    /** The direction in which the helper says to push: 1 is to the left. */
    this.turn = 1;
  }

  tick() {
    const {state, info} = this.capsule;
    this.action = this.replay[info.steps] ?? this.helpedAction(state.theta);
    const turned = this.turn > 0 ? state.theta > RETURN_AT : state.theta < PUSH_AT;
    if (turned) this.turn *= -1;
    return this.capsule.step(this.action);
  }

  /** The reader's action; the helper releases a key that pushes the ball further out. */
  helpedAction(theta) {
    const outwards = this.live * theta > 0;
    const released = this.helped && outwards && Math.abs(theta) > LET_GO;
    return released ? 0 : this.live;
  }
}

/** Opens a driver's episode without its jumps, which the lane applies. */
async function start(name, scene) {
  const {set, plant, task, hand} = scene;
  const disturbances = disturbancesOf(scene);
  if (name === YOURSELF) {
    const capsule = await load("direct", set ? {set} : {task, disturbances});
    const {seed, ...first} = set ? sets[set].plants[plant] : startOf(scene);
    first.changes = [];
    if (capsule.draws) first.seed = seed;
    capsule.reset(first);
    return {capsule, driver: new Hand(capsule, hand)};
  }
  const options = set ? {set, plant, changes: []} : {disturbances, ...startOf(scene)};
  const episode = await drive(name, options);
  return {capsule: episode, driver: episode};
}

/** An episode and its recording. */
export class Lane {
  /**
   * Opens the lane of a driver at the start of its episode.
   *
   * @param {string} name of the driver.
   * @param {object} scene plant, jumps and hand; a recorded driver requires `keepFrozen(scene)`
   *   before.
   */
  static async open(name, scene) { return new Lane(name, await start(name, scene), scene.jumps); }

  constructor(name, {capsule, driver}, jumps) {
    this.name = name;
    this.title = titleOf(name);
    this.capsule = capsule;
    this.driver = driver;
    this.jumps = jumps;
    /** Length of a step, s, and number of steps in an episode. */
    this.dt = capsule.controlDt;
    this.horizon = capsule.horizon;
    this.stepsOfSnapshot = Math.round(SNAPSHOT_SECONDS / this.dt);
    this.steps = 0;
    /** Why the episode failed, or "". */
    this.failure = "";
    this.trace =
      Object.fromEntries(CHANNELS.map((name) => [name, new Float64Array(this.horizon + 1)]));
    /** Number of units of the driver's memory; their values follow each other step by step. */
    this.units = driver.memory.length;
    this.trace.memory = new Float64Array((this.horizon + 1) * this.units);
    /** Lowest and highest value so far, per channel. */
    this.extent = Object.fromEntries(CHANNELS.map((name) => [name, [Infinity, -Infinity]]));
    this.metrics = new Array(this.horizon + 1);
    this.snapshots = [capsule.snapshot()];
    this.record();
  }

  /** The `Hand` if the reader drives, else null. */
  get hand() { return this.name === YOURSELF ? this.driver : null; }

  /** Simulated time of the episode, s. */
  get time() { return this.steps * this.dt; }

  get ended() { return this.failure !== "" || this.steps >= this.horizon; }

  /** Takes one agent step unless the episode has ended. */
  advance() {
    if (this.ended) return;
    this.applyJump();
    const {terminated} = this.driver.tick();
    this.steps += 1;
    if (terminated) this.failure = this.reason();
    this.record();
    if (this.steps % this.stepsOfSnapshot === 0) this.snapshots.push(this.capsule.snapshot());
  }

  /** The first step that begins at that time (s) or after it. */
  stepAt(time) { return Math.min(Math.ceil(time / this.dt - 1e-6), this.horizon); }

  /** Rewinds to a time (s), and deletes what was recorded after it. */
  rewind(time) {
    const step = this.stepAt(time);
    if (step >= this.steps) return;
    const nearest = Math.floor(step / this.stepsOfSnapshot);
    const live = this.hand?.live;
    if (this.hand) this.hand.replay = Array.from(this.trace.action.subarray(1, step + 1));
    this.capsule.restore(this.snapshots[nearest]);
    this.snapshots.length = nearest + 1;
    this.steps = nearest * this.stepsOfSnapshot;
    this.failure = "";
    while (this.steps < step) this.advance();
    if (this.hand) this.hand.live = live;
  }

  /** The values to draw at a time (s), interpolated between steps if `smooth`; SI units. */
  at(time, smooth) {
    const {trace} = this;
    const place = Math.min(time / this.dt, this.steps);
    const k = Math.min(Math.floor(place + 1e-9), this.steps);
    const share = smooth && k < this.steps ? place - k : 0;
    const between = share > 1e-9;
    const nearest = share > 0.5 ? k + 1 : k;
    const smoothed = (name, rate) =>
      between ? hermite(trace[name], trace[rate], k, share, this.dt) : trace[name][k];
    return {
      theta: smoothed("theta", "theta_dot"),
      x: smoothed("x", "x_dot"),
      theta_dot: trace.theta_dot[nearest],
      x_dot: trace.x_dot[nearest],
      torque: trace.torque[between ? k + 1 : k],
      target: trace.target[nearest],
      metrics: this.metrics[k],
    };
  }

  record() {
    const {state, info, metrics} = this.capsule;
    const values = {
      ...state,
      torque: info.torque,
      normal: info.normal_force,
      speed: metrics.mean_speed,
      transport: metrics.cost_of_transport,
      action: this.driver.action,
      target: info.goal ?? info.target ?? NaN,
    };
    for (const name of CHANNELS) {
      const value = values[name];
      this.trace[name][this.steps] = value;
      if (!Number.isFinite(value)) continue;
      const [low, high] = this.extent[name];
      this.extent[name] = [Math.min(low, value), Math.max(high, value)];
    }
    this.trace.memory.set(this.driver.memory, this.steps * this.units);
    this.metrics[this.steps] = metrics;
  }

  applyJump() {
    const now = this.time + TIME_TOLERANCE;
    const due = this.jumps.findLast(({t}) => t <= now);
    if (due && due.t > now - this.dt) this.capsule.setPlant(due);
  }

  reason() {
    const {theta} = this.capsule.state;
    if (Math.abs(theta) >= constants.theta_limit)
      return "the ball met the platform (|θ| reached 90°)";
    return this.capsule.info.normal_force <= 0
      ? "the platform left the floor (the normal force fell to 0)"
      : "the motion was lost";
  }
}

/** Cubic Hermite interpolation between two steps. */
function hermite(values, rates, k, share, dt) {
  const begin = values[k];
  const rise = values[k + 1] - begin;
  const slope = rates[k] * dt;
  const endSlope = rates[k + 1] * dt;
  const quadratic = 3 * rise - 2 * slope - endSlope;
  const cubic = slope + endSlope - 2 * rise;
  return begin + share * (slope + share * (quadratic + share * cubic));
}
