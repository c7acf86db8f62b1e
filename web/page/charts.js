// Curves over time, and the phase portrait.

import {constants} from "capsule.mjs";
import {clamp, decimals, niceStep, written} from "numbers.js";
import {colour, disc, font, rectangle, rem, Sheet, stroke} from "paint.js";
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
// Size of the text at the axes, rem.
const TEXT = 0.72;
// Most intervals between the labels of the time.
const MOST_LABELS = 7;

/** A canvas with axes. */
class Plot {
  constructor(canvas, changed) { this.sheet = new Sheet(canvas, changed); }

  /** Clears the canvas, maps the ranges of both axes to it, and draws the vertical axis. */
  frame(across, up) {
    const {context, width, height} = this.sheet;
    context.clearRect(0, 0, width, height);
    const size = TEXT * rem();
    this.left = 3.4 * size;
    this.right = width - 0.6 * size;
    this.top = 0.6 * size;
    this.bottom = height - 1.7 * size;
    this.perValue = (this.right - this.left) / (across.high - across.low);
    this.across = across;
    this.up = up;
    this.drawMarks();
  }

  x(value) { return this.left + (value - this.across.low) * this.perValue; }

  y(value) {
    const {low, high} = this.up;
    return this.bottom - ((value - low) / (high - low)) * (this.bottom - this.top);
  }

  /** The value at a place of the horizontal axis. */
  value(x) { return this.across.low + (x - this.left) / this.perValue; }

  /** Draws the marks of the vertical axis. */
  drawMarks() {
    const {context} = this.sheet;
    const {low, high, step} = this.up;
    context.font = font(TEXT);
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (let mark = Math.ceil(low / step - 1e-9); mark * step <= high + 1e-9 * step; mark++) {
      const y = Math.round(this.y(mark * step)) + 0.5;
      const place = [this.left, y - 0.5, this.right - this.left, 1];
      rectangle(context, place, colour(mark === 0 ? "tick" : "hairline"));
      context.fillStyle = colour("grey");
      const text = written(mark * step, decimals(step));
      context.fillText(text, this.left - 0.5 * TEXT * rem(), y);
    }
  }

  /** Writes a text below the horizontal axis. */
  label(text, x) {
    const {context, height} = this.sheet;
    context.textAlign = "center";
    context.textBaseline = "alphabetic";
    context.fillStyle = colour("grey");
    context.fillText(text, x, height - 3);
  }

  /** Draws a vertical line. */
  line(value) {
    const place = [this.x(value), this.top, 1, this.bottom - this.top];
    rectangle(this.sheet.context, place, colour("tick"));
  }

  /** Restricts what is drawn to the space between the axes, until `restore`. */
  clip() {
    const {context} = this.sheet;
    context.save();
    context.beginPath();
    context.rect(this.left, this.top - 1, this.right - this.left, this.bottom - this.top + 2);
    context.clip();
  }

  strokeCurve(rival) {
    const {context} = this.sheet;
    context.lineJoin = "round";
    context.setLineDash(rival ? [5, 3] : []);
    stroke(context, rival ? 1.2 : 1.6, colour(rival ? "rival" : "line"));
    context.setLineDash([]);
  }
}

/** A chart over time: `vertical` gives the range of its other axis, `plot` draws what it shows. */
export class Timeline extends Plot {
  /**
   * @param {Lane[]} lanes the driver's and, if any, the rival's.
   * @param {number} now s.
   * @param {number} span shown length of time, s; 0 for the whole episode.
   */
  draw(lanes, now, span) {
    const low = span ? Math.max(0, now - span) : 0;
    this.frame({low, high: low + (span || END)}, this.vertical(lanes));
    this.labelSeconds(span);
    this.clip();
    this.plot(lanes);
    this.line(now);
    this.sheet.context.restore();
  }

  labelSeconds(span) {
    const {low, high} = this.across;
    const step = niceStep((span || END) / MOST_LABELS);
    for (let t = Math.ceil(low / step) * step; t <= high; t += step) {
      const x = this.x(t);
      if (x > this.left + 8 && x < this.right - 8) this.label(`${t} s`, x);
    }
  }

  /** The shown steps of a lane, and how many of them share a pixel column. */
  shownSteps(lane) {
    const {first, last} = within(lane, this.across.low, this.across.high);
    const each = Math.max(1, Math.floor(1 / (lane.dt * this.perValue)));
    return {first: first - (first % each), last, each};
  }
}

/** One curve per lane over time, with the driver's stick and slip behind them. */
export class TimeChart extends Timeline {
  constructor(canvas, curve, changed) {
    super(canvas, changed);
    this.curve = curve;
  }

  vertical(lanes) { return range(this.curve, lanes); }

  plot(lanes) {
    this.shade(lanes[0]);
    for (const lane of lanes.toReversed()) {
      this.path(lane);
      this.strokeCurve(lane !== lanes[0]);
    }
  }

  /** Draws bands where the driver sticks and where it slips. */
  shade(lane) {
    const {context} = this.sheet;
    const {x_dot} = lane.trace;
    const {first, last} = within(lane, this.across.low, this.across.high);
    let begin = first;
    while (begin <= last) {
      const stuck = x_dot[begin] === 0;
      let end = begin + 1;
      while (end <= last && (x_dot[end] === 0) === stuck) end++;
      const left = this.x(begin * lane.dt);
      const right = this.x(Math.min(end, last) * lane.dt);
      const place = [left, this.top, right - left, this.bottom - this.top];
      rectangle(context, place, colour(stuck ? "stick-shade" : "slip-shade"));
      begin = end;
    }
  }

  /** Traces the curve; of steps that share a pixel column, the lowest and the highest value. */
  path(lane) {
    const {context} = this.sheet;
    const {channel, factor} = this.curve;
    const values = lane.trace[channel];
    const {first, last, each} = this.shownSteps(lane);
    context.beginPath();
    for (let begin = first; begin <= last; begin += each) {
      const column = values.subarray(begin, Math.min(begin + each, last + 1));
      const low = Math.min(...column);
      const high = Math.max(...column);
      if (!Number.isFinite(low + high)) continue;
      const x = this.x(begin * lane.dt);
      context.lineTo(x, this.y(factor * low));
      if (high > low) context.lineTo(x, this.y(factor * high));
    }
  }
}

/** theta_dot over theta. */
export class PhasePortrait extends Plot {
  draw(lanes, now, span) {
    this.frame({low: -90, high: 90}, range(RATE, lanes));
    for (const degrees of [-90, -45, 0, 45, 90]) {
      const x = clamp(this.x(degrees), this.left + 10, this.right - 12);
      this.label(`${written(degrees, 0)}°`, x);
    }
    this.clip();
    this.line(0);
    const from = span ? now - span : 0;
    for (const lane of lanes) this.orbit(within(lane, from, now), lane, lane !== lanes[0]);
    this.sheet.context.restore();
  }

  /** Draws the curve of a lane, with a ball at its end. */
  orbit({first, last}, {trace}, rival) {
    const {context} = this.sheet;
    const x = (step) => this.x(DEGREES * trace.theta[step]);
    const y = (step) => this.y(trace.theta_dot[step]);
    context.beginPath();
    for (let step = first; step <= last; step++) context.lineTo(x(step), y(step));
    context.globalAlpha = 0.75;
    this.strokeCurve(rival);
    context.globalAlpha = 1;
    disc(context, [x(last), y(last)], 4, colour(rival ? "rival" : "ball-colour"));
  }
}

/** The first and the last step of a lane between two times. */
function within(lane, from, to) {
  const first = Math.max(0, Math.floor(from / lane.dt));
  const last = Math.min(Math.floor(to / lane.dt + 1e-6), lane.steps);
  return {first, last};
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
  return {
    low: mark * Math.floor(low / mark + 1e-9),
    high: mark * Math.ceil(high / mark - 1e-9),
    step: mark,
  };
}
