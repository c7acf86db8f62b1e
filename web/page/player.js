// Playback: simulated time, shown time, and speed.

import {constants} from "capsule.mjs";
import {clamp} from "numbers.js";
import {END} from "scene.js";

const DT = constants.control_dt;
// Longest time counted for a frame, s; time for simulation in a frame of 16.7 ms, ms.
const LONGEST_FRAME = 0.1;
const BUDGET = 8;

/** The clock of the lanes. */
export class Player {
  constructor() {
    this.lanes = [];
    this.now = 0;
    this.speed = 1;
    this.playing = false;
    /** The time up to which the lanes are simulated as fast as possible, s; null if none. */
    this.goal = null;
    /** Called after each agent step of a lane. */
    this.stepped = () => {};
  }

  /** The shown time, rounded up to a multiple of 20 ms, s. */
  get moment() { return Math.min(Math.ceil(this.now / DT - 1e-6) * DT, END); }

  /** Whether all lanes have ended and are shown up to their ends. */
  get over() { return this.lanes.every((lane) => lane.ended && this.now >= lane.time - 1e-9); }

  /** Goes to a time (s), and simulates the missing steps. */
  seek(time) { this.goal = clamp(time, 0, this.reach); }

  /** Pauses, and goes forward or back by steps. */
  nudge(steps) {
    this.playing = false;
    const shown = this.now / DT;
    const step = steps > 0 ? Math.floor(shown + 1e-6) : Math.ceil(shown - 1e-6);
    this.seek((step + steps) * DT);
  }

  /** Deletes in every lane what was recorded after the current step. */
  branch() {
    this.now = this.moment;
    this.goal = null;
    for (const lane of this.lanes) lane.rewind(this.now);
  }

  /**
   * Advances by `elapsed` seconds of real time.
   *
   * @returns {boolean} whether the shown time has changed.
   */
  pass(elapsed) {
    const before = this.now;
    if (this.goal !== null) {
      this.now = Math.min(this.goal, this.simulate(this.goal));
      if (this.now >= this.goal - 1e-9) this.goal = null;
    } else if (this.playing) {
      const ahead = Math.min(elapsed, LONGEST_FRAME) * this.speed;
      const wanted = Math.min(before + ahead, this.last);
      this.now = Math.max(before, Math.min(wanted, this.simulate(wanted)));
    }
    return this.now !== before;
  }

  /** Simulates every lane up to a time (s) within a frame's budget; returns the reached time. */
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

  /** The time at which the last lane ends, if known, else END; s. */
  get last() {
    const ended = this.lanes.every((lane) => lane.ended);
    return ended ? Math.max(...this.lanes.map((lane) => lane.time)) : END;
  }

  /** Latest time of `seek`, s: the reader's future actions are unknown. */
  get reach() {
    const lane = this.lanes.find(({hand}) => hand);
    if (!lane) return this.last;
    const known = Math.max(lane.time, lane.hand.replay.length * lane.dt);
    return Math.min(this.last, Math.max(known, this.moment + DT));
  }
}
