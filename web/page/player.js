// Time: what is simulated, what is shown, and how fast.

import { constants } from "capsule.mjs";
import { END } from "scene.js";
import { clamp } from "numbers.js";

const DT = constants.control_dt;
// Of a frame of 16.7 ms: so much may be spent on simulating, s and ms.
const LONGEST_FRAME = 0.1;
const BUDGET = 8;

/** The clock of some lanes. */
export class Player {
  constructor() {
    this.lanes = [];
    this.now = 0;
    this.speed = 1;
    this.playing = false;
    /** The time that is being reached by simulating as fast as can be; null where there is none. */
    this.goal = null;
    /** Called after each agent step of a lane. */
    this.stepped = () => {};
  }

  /** The time of the step that is shown, or of the one that comes to be shown, s: a multiple of 20 ms. */
  get moment() {
    return Math.min(Math.ceil(this.now / DT - 1e-6) * DT, END);
  }

  /** Whether no lane can go on, and what it did has been shown. */
  get over() {
    return this.lanes.every((lane) => lane.ended && this.now >= lane.time - 1e-9);
  }

  /** Goes to that time, simulating what is missing. */
  seek(time) {
    this.goal = clamp(time, 0, this.reach);
  }

  /** One step on or back, as a pause. */
  nudge(steps) {
    this.playing = false;
    const step = steps > 0 ? Math.floor(this.now / DT + 1e-6) : Math.ceil(this.now / DT - 1e-6);
    this.seek((step + steps) * DT);
  }

  /** Forgets in every lane what came after the present step. */
  branch() {
    this.now = this.moment;
    this.goal = null;
    for (const lane of this.lanes) lane.rewind(this.now);
  }

  /**
   * Lets `elapsed` seconds of the reader's time pass.
   *
   * @returns {boolean} whether there is something new to be drawn.
   */
  pass(elapsed) {
    const before = this.now;
    if (this.goal !== null) {
      this.now = Math.min(this.goal, this.simulate(this.goal));
      if (this.now >= this.goal - 1e-9) this.goal = null;
    } else if (this.playing) {
      const wanted = Math.min(this.now + Math.min(elapsed, LONGEST_FRAME) * this.speed, this.last);
      this.now = Math.max(before, Math.min(wanted, this.simulate(wanted)));
    }
    return this.now !== before;
  }

  /** Takes every lane up to that time, and answers how far the budget of a frame went. */
  simulate(time) {
    const begin = performance.now();
    for (;;) {
      const behind = this.lanes.filter((lane) => !lane.ended && lane.steps < lane.stepAt(time));
      if (behind.length === 0) return time;
      const lane = behind.reduce((one, other) => (other.time < one.time ? other : one));
      if (performance.now() - begin > BUDGET) return lane.time;
      lane.advance();
      this.stepped(lane);
    }
  }

  /** The time at which the last lane ends, as far as is known. */
  get last() {
    return this.lanes.every((lane) => lane.ended) ? Math.max(...this.lanes.map((lane) => lane.time)) : END;
  }

  /** How far `seek` may go: hands that have not moved yet cannot be foreseen. */
  get reach() {
    const lane = this.lanes.find(({ hand }) => hand);
    if (!lane) return this.last;
    return Math.min(this.last, Math.max(lane.time, lane.hand.replay.length * lane.dt, this.moment + DT));
  }
}
