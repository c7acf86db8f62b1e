// One driver on one plant: an episode, everything that was recorded of it, and the way back to any step.

import { constants, drive, load } from "./capsule.mjs";
import { YOURSELF, driverNamed, titleOf } from "./scene.js";

const DT = constants.control_dt;
// As `Simulation` compares an episode's time with that of a jump.
const TIME_TOLERANCE = 1e-9;
const SNAPSHOT_STEPS = Math.round(1 / DT);
const CHANNELS = ["theta", "theta_dot", "x", "x_dot", "torque", "normal", "speed", "transport", "action"];

/** The reader: the direct task, and an action that the page changes between two steps. */
class Hand {
  /** @param {number[]} replay the actions of its first steps. */
  constructor(capsule, replay) {
    this.capsule = capsule;
    this.replay = replay;
    this.live = 0;
    this.action = 0;
  }

  tick() {
    this.action = this.replay[this.capsule.info.steps] ?? this.live;
    return this.capsule.step(this.action);
  }

  snapshot() {
    return this.capsule.snapshot();
  }

  restore(snapshot) {
    this.capsule.restore(snapshot);
  }
}

async function start(name, plant, weight, replay) {
  if (name !== YOURSELF) return drive(name, { ...plant, ...(weight === null ? {} : { energyWeight: weight }) });
  const capsule = await load("direct");
  capsule.reset(plant);
  return new Hand(capsule, replay);
}

/** An episode as it is recorded. */
export class Lane {
  /**
   * Opens the lane of a driver at the start of its episode.
   *
   * @param {string} name of the driver.
   * @param {object} scene whose plant, jumps and hand it gets.
   * @param {number | null} weight the price of energy; null for the driver's own.
   */
  static async open(name, scene, weight) {
    const { M, mu, theta } = scene;
    const plant = theta === undefined ? { M, mu } : { M, mu, theta };
    return new Lane(name, await start(name, plant, weight, scene.hand), scene.jumps);
  }

  constructor(name, episode, jumps) {
    this.name = name;
    this.title = titleOf(name);
    this.kind = driverNamed(name)?.kind;
    this.episode = episode;
    this.capsule = episode.capsule;
    this.jumps = jumps;
    this.steps = 0;
    /** Why the episode ended: "", or what happened. */
    this.failure = "";
    this.trace = Object.fromEntries(CHANNELS.map((name) => [name, new Float64Array(constants.steps + 1)]));
    /** Lowest and highest value so far, per channel. */
    this.extent = Object.fromEntries(CHANNELS.map((name) => [name, [Infinity, -Infinity]]));
    this.metrics = new Array(constants.steps + 1);
    this.snapshots = [episode.snapshot()];
    this.record();
  }

  /** The reader's hands, where they are what drives. */
  get hand() {
    return this.name === YOURSELF ? this.episode : null;
  }

  get ended() {
    return this.failure !== "" || this.steps >= constants.steps;
  }

  /** One agent step, unless the episode has ended. */
  advance() {
    if (this.ended) return;
    this.applyJump();
    const { terminated } = this.episode.tick();
    this.steps += 1;
    if (terminated) this.failure = this.reason();
    this.record();
    if (this.steps % SNAPSHOT_STEPS === 0) this.snapshots[this.steps / SNAPSHOT_STEPS] = this.episode.snapshot();
  }

  /** Forgets what came after that step, and stands there again. */
  rewind(step) {
    if (step >= this.steps) return;
    const nearest = Math.floor(step / SNAPSHOT_STEPS);
    const live = this.hand?.live;
    if (this.hand) this.hand.replay = Array.from(this.trace.action.subarray(1, step + 1));
    this.episode.restore(this.snapshots[nearest]);
    this.snapshots.length = nearest + 1;
    this.steps = nearest * SNAPSHOT_STEPS;
    this.failure = "";
    while (this.steps < step) this.advance();
    if (this.hand) this.hand.live = live;
  }

  /** What is seen at that time (s), between two steps if `smooth`: SI units. */
  at(time, smooth) {
    const { trace } = this;
    const place = Math.min(time / DT, this.steps);
    const k = Math.min(Math.floor(place + 1e-9), this.steps);
    const share = smooth && k < this.steps ? place - k : 0;
    const between = (name, rate) =>
      share > 1e-9 ? cubic(trace[name], trace[rate], k, share) : trace[name][k];
    const later = share > 0.5 ? k + 1 : k;
    return {
      step: k, theta: between("theta", "theta_dot"), x: between("x", "x_dot"), theta_dot: trace.theta_dot[later],
      x_dot: trace.x_dot[later], torque: trace.torque[share > 1e-9 ? k + 1 : k], metrics: this.metrics[k],
    };
  }

  record() {
    const { state, info, metrics } = this.capsule;
    const values = {
      ...state, torque: info.torque, normal: info.normal_force, speed: metrics.mean_speed,
      transport: metrics.cost_of_transport, action: this.episode.action,
    };
    for (const name of CHANNELS) {
      const value = values[name];
      this.trace[name][this.steps] = value;
      if (!Number.isFinite(value)) continue;
      const extent = this.extent[name];
      if (value < extent[0]) extent[0] = value;
      if (value > extent[1]) extent[1] = value;
    }
    this.metrics[this.steps] = metrics;
  }

  applyJump() {
    const now = this.steps * DT + TIME_TOLERANCE;
    const due = this.jumps.findLast(({ t }) => t <= now);
    if (due && due.t > now - DT) this.capsule.setPlant(due);
  }

  reason() {
    const { theta } = this.capsule.state;
    if (Math.abs(theta) >= constants.theta_limit) return "the ball met the platform (|θ| reached 90°)";
    return this.capsule.info.normal_force <= 0
      ? "the platform left the floor (the normal force fell to 0)"
      : "the motion was lost";
  }
}

/** A cubic between two steps through both values and both rates. */
function cubic(values, rates, k, share) {
  const [a, b] = [values[k], values[k + 1]];
  const [da, db] = [rates[k] * DT, rates[k + 1] * DT];
  const rise = b - a;
  return a + share * (da + share * (3 * rise - 2 * da - db + share * (da + db - 2 * rise)));
}
