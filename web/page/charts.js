// Curves over time, and the phase portrait.

import {constants} from "capsule.mjs";
import {clamp, decimals, niceStep, written} from "numbers.js";
import {colour, font, rem, Sheet} from "paint.js";
import {END} from "scene.js";

const LIMIT = constants.torque_limit;
const MARK = niceStep(LIMIT / 3);
const DEGREES = 180 / Math.PI;

/**
 * The curves over time: channel of a lane, title, unit, factor, and bounds that the axis always
 * contains.
 */
export const CURVES = [
  {
    channel: "theta",
    title: "Angle θ",
    unit: "°",
    factor: DEGREES,
    bounds: [-90, 90],
    most: 90,
    step: 45
  },
  {channel: "x_dot", title: "Speed of the platform", unit: "cm/s", factor: 100, bounds: [-5, 5]},
  {
    channel: "torque",
    title: "Motor torque",
    unit: "N m",
    factor: 1,
    bounds: [-LIMIT, LIMIT],
    step: MARK
  },
  {channel: "normal", title: "Normal force", unit: "N", factor: 1, bounds: [0, 8]},
  {channel: "speed", title: "Mean speed so far", unit: "cm/s", factor: 1, bounds: [0, 2], most: 40},
  {
    channel: "transport",
    title: "Cost of transport so far",
    unit: "1",
    factor: 1,
    bounds: [0, 4],
    most: 12
  },
];
const RATE = {
  channel: "theta_dot",
  factor: 1,
  bounds: [-5, 5]
};

/** A canvas with axes. */
class Plot {
  constructor(canvas, changed) { this.sheet = new Sheet(canvas, changed); }

  /**
   * Maps the ranges of both axes to the canvas and draws the marks; returns {left, right, top,
   * bottom}.
   */
  frame(across, up, step) {
    const {context, width, height} = this.sheet;
    context.clearRect(0, 0, width, height);
    const size = 0.72 * rem();
    const box =
      {left: 3.4 * size, right: width - 0.6 * size, top: 0.6 * size, bottom: height - 1.7 * size};
    const [low, high] = up;
    this.box = box;
    this.x = (value) =>
      box.left + ((value - across[0]) / (across[1] - across[0])) * (box.right - box.left);
    this.y = (value) => box.bottom - ((value - low) / (high - low)) * (box.bottom - box.top);
    this.value = (x) =>
      across[0] + ((x - box.left) / (box.right - box.left)) * (across[1] - across[0]);
    context.font = font(0.72);
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
      const y = Math.round(this.y(k * step)) + 0.5;
      context.fillStyle = colour(k === 0 ? "tick" : "hairline");
      context.fillRect(box.left, y - 0.5, box.right - box.left, 1);
      context.fillStyle = colour("grey");
      context.fillText(written(k * step, decimals(step)), box.left - 0.5 * size, y);
    }
    context.textAlign = "center";
    context.textBaseline = "alphabetic";
    return box;
  }

  clip() {
    const {context} = this.sheet;
    const {left, right, top, bottom} = this.box;
    context.save();
    context.beginPath();
    context.rect(left, top - 1, right - left, bottom - top + 2);
    context.clip();
  }

  stroke(rival) {
    const {context} = this.sheet;
    context.lineWidth = rival ? 1.2 : 1.6;
    context.lineJoin = "round";
    context.strokeStyle = colour(rival ? "rival" : "line");
    context.setLineDash(rival ? [5, 3] : []);
    context.stroke();
    context.setLineDash([]);
  }
}

/** One curve per lane over time, with the driver's stick and slip behind them. */
export class TimeChart extends Plot {
  constructor(canvas, curve, changed) {
    super(canvas, changed);
    this.curve = curve;
  }

  /**
   * @param {Lane[]} lanes the driver's and, if any, the rival's.
   * @param {number} now s.
   * @param {number} span shown length of time, s; 0 for the whole episode.
   */
  draw(lanes, now, span) {
    const from = span ? Math.max(0, now - span) : 0;
    const to = span ? from + span : END;
    const [up, step] = range(this.curve, lanes);
    const box = this.frame([from, to], up, step);
    const {context} = this.sheet;
    const second = span && span <= 5 ? 1 : span ? 2 : 5;
    context.fillStyle = colour("grey");
    for (let t = Math.ceil(from / second) * second; t <= to; t += second) {
      const x = this.x(t);
      if (x > box.left + 8 && x < box.right - 8)
        context.fillText(`${t} s`, x, this.sheet.height - 3);
    }
    this.clip();
    this.shade(lanes[0], from, to);
    for (const lane of lanes.toReversed()) {
      this.path(lane, from, to);
      this.stroke(lane !== lanes[0]);
    }
    context.fillStyle = colour("tick");
    context.fillRect(this.x(now), box.top, 1, box.bottom - box.top);
    context.restore();
  }

  /** Draws bands where the driver sticks and where it slips. */
  shade(lane, from, to) {
    const {context} = this.sheet;
    const {top, bottom} = this.box;
    const {x_dot} = lane.trace;
    const shades = [colour("slip-shade"), colour("stick-shade")];
    const [first, end] = within(lane, from, to);
    for (let k = first; k <= end;) {
      const stuck = x_dot[k] === 0;
      let next = k + 1;
      while (next <= end && (x_dot[next] === 0) === stuck) next++;
      const [left, right] = [this.x(k * lane.dt), this.x(Math.min(next, end) * lane.dt)];
      context.fillStyle = shades[Number(stuck)];
      context.fillRect(left, top, right - left, bottom - top);
      k = next;
    }
  }

  /** Traces the curve; of steps that share a pixel column, the lowest and the highest value. */
  path(lane, from, to) {
    const {context} = this.sheet;
    const values = lane.trace[this.curve.channel];
    const {factor} = this.curve;
    const [first, end] = within(lane, from, to);
    const each = Math.max(1, Math.floor((to - from) / lane.dt / (this.box.right - this.box.left)));
    context.beginPath();
    for (let k = first - (first % each); k <= end; k += each) {
      let [low, high] = [values[k], values[k]];
      for (let j = k + 1; j < Math.min(k + each, end + 1); j++) {
        low = Math.min(low, values[j]);
        high = Math.max(high, values[j]);
      }
      if (!Number.isFinite(low + high)) continue;
      const x = this.x(k * lane.dt);
      context.lineTo(x, this.y(factor * low));
      if (high > low) context.lineTo(x, this.y(factor * high));
    }
  }
}

/** theta_dot over theta. */
export class PhasePortrait extends Plot {
  draw(lanes, now, span) {
    const [up, step] = range(RATE, lanes);
    const box = this.frame([-90, 90], up, step);
    const {context} = this.sheet;
    context.fillStyle = colour("grey");
    for (const degrees of [-90, -45, 0, 45, 90]) {
      const x = clamp(this.x(degrees), box.left + 10, box.right - 12);
      context.fillText(`${written(degrees, 0)}°`, x, this.sheet.height - 3);
    }
    this.clip();
    context.fillStyle = colour("tick");
    context.fillRect(this.x(0), box.top, 1, box.bottom - box.top);
    lanes.forEach((lane, index) => {
      const {theta, theta_dot} = lane.trace;
      const [first, last] = within(lane, span ? now - span : 0, now);
      context.beginPath();
      for (let k = first; k <= last; k++)
        context.lineTo(this.x(DEGREES * theta[k]), this.y(theta_dot[k]));
      context.globalAlpha = 0.75;
      this.stroke(index === 1);
      context.globalAlpha = 1;
      context.beginPath();
      context.arc(this.x(DEGREES * theta[last]), this.y(theta_dot[last]), 4, 0, 2 * Math.PI);
      context.fillStyle = colour(index === 1 ? "rival" : "ball-colour");
      context.fill();
    });
    context.restore();
  }
}

/** The first and the last step of a lane between two times. */
function within(lane, from, to) {
  return [
    Math.max(0, Math.floor(from / lane.dt)), Math.min(Math.floor(to / lane.dt + 1e-6), lane.steps)
  ];
}

/**
 * The range of an axis that contains all recorded values, in whole steps, and the step of its
 * marks.
 */
function range({channel, factor, bounds, most = Infinity, step}, lanes) {
  let [low, high] = bounds;
  for (const lane of lanes) {
    const [least, largest] = lane.extent[channel];
    low = Math.min(low, Math.max(-most, factor * least));
    high = Math.max(high, Math.min(most, factor * largest));
  }
  const mark = step ?? niceStep((high - low) / 4);
  return [[mark * Math.floor(low / mark + 1e-9), mark * Math.ceil(high / mark - 1e-9)], mark];
}
