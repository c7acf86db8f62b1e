// The robot as `capsule_gym.rendering.renderer` draws it, with trail and speed arrow. Lengths are
// that drawing's pixels; `lane` scales them.

import {constants} from "capsule.mjs";
import {figure} from "figure.js";
import {clamp, decimals, niceStep, written} from "numbers.js";
import {colour, disc, font, line, polygon, rectangle, rem, Sheet, stroke} from "paint.js";

const {ROD, BALL, PIVOT, SHELL_HALF, SHELL_HEIGHT, GAUGE} = figure;
const PER_METRE = ROD / constants.l;
// The labelled marks of the ruler, m.
const MAJOR = niceStep(50 / PER_METRE);
// Space in a lane above the shell and below the floor.
const ABOVE = 44;
const BELOW = 40;
const WIDEST = 1.6;
// Most changes of the contact's colour in a second; three flashes (six changes) may harm.
const MOST_CHANGES = 4;
const TURN = 2 * Math.PI;
// Lengths of the ticks of the ruler, ten between two labelled marks.
const TICKS = [12, 5, 5, 5, 5, 8, 5, 5, 5, 5];
// Distance of marks, in CSS pixels, below which every second one is labelled.
const NARROW_LABEL = 44;
// Width of the flag at the start.
const FLAG = 28;
// Length of the speed arrow, pixels per m/s, and its maximum, pixels.
const SPEED_ARROW = 320;
const SPEED_ARROW_LIMIT = 220;
// Lengths of the heads of the arrows of speed, pixels, and of torque, rad.
const ARROW_HEAD = 13;
const TORQUE_HEAD = 0.22;
const TRAIL_SECONDS = 0.07;
const TRAIL_PARTS = 12;
const SPRING_PARTS = 59;

/** The contact to show: stick or slip, or "both" if the colour would flash. */
export class Contact {
  constructor() {
    this.stuck = true;
    this.changes = [];
  }

  /** @returns {"stick" | "slip" | "both"} */
  see(stuck) {
    const now = performance.now();
    if (stuck !== this.stuck) this.changes.push(now);
    this.stuck = stuck;
    this.changes = this.changes.filter((time) => time > now - 1000);
    if (this.changes.length > MOST_CHANGES) return "both";
    return stuck ? "stick" : "slip";
  }
}

/** The picture of one lane, of two, or of one with a ghost. */
export class Stage {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {() => void} changed called when the canvas has become empty.
   */
  constructor(canvas, changed) { this.sheet = new Sheet(canvas, changed); }

  /**
   * @param {{name: string, view: object}} driver a title, and the result of `Lane.at`.
   * @param {{name: string, view: object} | null} rival
   * @param {{lanes: boolean, still: boolean}} how `lanes` draws the rival in its own lane; `still`
   *   draws no trail.
   */
  draw(driver, rival, {lanes, still}) {
    const {context, width, height} = this.sheet;
    rectangle(context, [0, 0, width, height], colour("paper"));
    if (rival && lanes) {
      this.lane({top: 0, height: height / 2}, driver, null, still, "line");
      this.lane({top: height / 2, height: height / 2}, rival, null, still, "rival");
    } else {
      this.lane({top: 0, height}, driver, rival, still, "line");
    }
  }

  /** Returns the shown picture as a PNG with a line of text below. */
  picture(text) {
    const {canvas} = this.sheet;
    const size = canvas.width / 32;
    const copy = document.createElement("canvas");
    copy.width = canvas.width;
    copy.height = canvas.height + 2 * size;
    const context = copy.getContext("2d");
    rectangle(context, [0, 0, copy.width, copy.height], colour("paper"));
    context.drawImage(canvas, 0, 0);
    context.fillStyle = colour("ink");
    context.font = `600 ${size}px sans-serif`;
    context.fillText(`capsule_gym  ${text}`, size, copy.height - (2 / 3) * size);
    return new Promise((resolve) => {
      copy.toBlob(resolve);
    });
  }

  lane({top, height}, {name, view}, ghost, still, ink) {
    const {context, width} = this.sheet;
    const highest = height / (ABOVE + SHELL_HEIGHT + BELOW);
    const scale = Math.min(WIDEST, width / (2.2 * SHELL_HALF), highest);
    const half = width / 2 / scale;
    const lead = ghost ? ghost.view.x - view.x : 0;
    context.save();
    context.beginPath();
    context.rect(0, top, width, height);
    context.clip();
    context.translate(width / 2, top + height - BELOW * scale);
    context.scale(scale, scale);
    drawFloor(context, view.x, half, scale, height / scale);
    drawBody(context, view.contact);
    if (Number.isFinite(view.target)) drawTarget(context, (view.target - view.x) * PER_METRE, half);
    if (ghost) drawGhost(context, ghost.view, lead * PER_METRE, half, scale);
    drawSpeed(context, view.x_dot);
    drawTorque(context, view.torque / constants.torque_limit);
    drawPendulum(context, view, still);
    context.restore();
    this.title(name, top + 1.5 * rem(), ink);
    if (ghost) {
      const distance = isAway(lead * PER_METRE, half) ? `, ${leadText(lead)}` : "";
      this.title(ghost.name + distance, top + 2.9 * rem(), "rival");
    }
  }

  /** Writes a title at the left, with an outline that separates it from the picture. */
  title(text, y, ink) {
    const {context, width} = this.sheet;
    context.font = font(0.88, 600);
    context.textAlign = "left";
    context.lineWidth = 5;
    context.strokeStyle = colour("paper");
    context.strokeText(text, 14, y, width - 28);
    context.fillStyle = colour(ink);
    context.fillText(text, 14, y, width - 28);
  }
}

function leadText(lead) {
  return `${written(Math.abs(100 * lead), 0)} cm ${lead > 0 ? "ahead" : "behind"}`;
}

/** The point at an angle from the upright, positive to the left, and a distance from the pivot. */
function polar(angle, radius) {
  return [-radius * Math.sin(angle), -PIVOT - radius * Math.cos(angle)];
}

/** Traces the outline of the shell. */
function traceShell(context) {
  context.beginPath();
  context.roundRect(-SHELL_HALF, -SHELL_HEIGHT, 2 * SHELL_HALF, SHELL_HEIGHT, SHELL_HEIGHT / 2);
}

/** Draws the floor with its ruler, and the flag at the start. */
function drawFloor(context, x, half, scale, height) {
  const start = -x * PER_METRE;
  rectangle(context, [-half, 0, 2 * half, BELOW], colour("floor-fill"));
  drawRuler(context, start, half, scale, height);
  if (Math.abs(start) < half + FLAG) drawFlag(context, start);
  rectangle(context, [-half, -1, 2 * half, 2], colour("tick"));
}

/**
 * Draws the ruler, whose zero lies at `zero` in a picture from -half to half, in units of the
 * picture, of which `scale` pixels are one.
 */
function drawRuler(context, zero, half, scale, height) {
  const major = MAJOR * PER_METRE;
  const pixel = 1 / scale;
  const centimetres = 100 * MAJOR;
  const marksPerLabel = major * scale < NARROW_LABEL ? 2 : 1;
  const first = Math.floor((-half - zero) / major);
  const last = Math.ceil((half - zero) / major);
  context.font = font(0.8 / scale);
  context.textAlign = "center";
  for (let mark = first; mark <= last; mark++) {
    const at = zero + mark * major;
    rectangle(context, [at, -height, pixel, height], colour("grid"));
    for (const [part, length] of TICKS.entries())
      rectangle(context, [at + (part * major) / 10, 0, pixel, length], colour("tick"));
    if (mark % marksPerLabel !== 0) continue;
    context.fillStyle = colour("grey");
    context.fillText(written(mark * centimetres, decimals(centimetres)), at, BELOW - 10);
  }
}

function drawFlag(context, at) {
  const ink = colour("ink");
  polygon(context, [[at, -92], [at + FLAG, -82], [at, -72]], ink);
  rectangle(context, [at - 1, -92, 2, 92], ink);
}

/**
 * Draws the target of the platform's centre on the ruler, or at the edge if it is out of the
 * picture.
 */
function drawTarget(context, offset, half) {
  const at = clamp(offset, 10 - half, half - 10);
  polygon(context, [[at, 4], [at - 11, 26], [at + 11, 26]], colour("accent"));
}

/** Draws the shell, the platform, the gauge's scale, and the contact. */
function drawBody(context, state) {
  const contact = colour(state === "both" ? "tick" : state);
  traceShell(context);
  context.globalAlpha = 0.13;
  context.fillStyle = colour("shell");
  context.fill();
  context.globalAlpha = 0.65;
  stroke(context, 3, contact);
  context.globalAlpha = 1;
  drawPlatform(context);
  drawGauge(context);
  const flat = SHELL_HALF - SHELL_HEIGHT / 2 + 6;
  rectangle(context, [-flat, -1, 2 * flat, 7], contact);
}

function drawPlatform(context) {
  const {PLATFORM_HALF, PLATFORM_HEIGHT, SPRING_OUTER} = figure;
  const slate = colour("slate");
  const deck = -PLATFORM_HEIGHT - 3;
  context.beginPath();
  context.roundRect(-PLATFORM_HALF, deck, 2 * PLATFORM_HALF, PLATFORM_HEIGHT, 5);
  context.fillStyle = slate;
  context.fill();
  polygon(context, [[-46, deck + 2], [-30, -PIVOT], [30, -PIVOT], [46, deck + 2]], slate);
  disc(context, [0, -PIVOT], SPRING_OUTER + 8, slate);
  disc(context, [0, -PIVOT], SPRING_OUTER + 4, colour("paper"));
}

/** Draws the scale around the pivot. */
function drawGauge(context) {
  for (let degrees = -90; degrees <= 90; degrees += 15) {
    const angle = (degrees * Math.PI) / 180;
    const length = degrees % 90 === 0 ? 7 : 4;
    line(context, [polar(angle, GAUGE - length), polar(angle, GAUGE)], 1, colour("tick"));
  }
}

/** Whether a robot at an offset is out of the picture. */
function isAway(offset, half) { return Math.abs(offset) > half + SHELL_HALF; }

/** Draws the rival's outline, or an arrow at the edge if it is out of the picture. */
function drawGhost(context, view, offset, half, scale) {
  if (isAway(offset, half)) drawAway(context, Math.sign(offset), half, scale);
  else drawOutline(context, view.theta, offset);
}

/** Draws an arrow at the left (-1) or right (1) edge. */
function drawAway(context, side, half, scale) {
  const tip = side * (half - 12 / scale);
  const base = tip - (side * 14) / scale;
  const wide = 8 / scale;
  const corners = [[tip, -PIVOT], [base, -PIVOT - wide], [base, -PIVOT + wide]];
  polygon(context, corners, colour("rival"));
}

function drawOutline(context, theta, offset) {
  const ink = colour("rival");
  context.save();
  context.translate(offset, 0);
  context.globalAlpha = 0.8;
  context.setLineDash([7, 5]);
  traceShell(context);
  stroke(context, 2.5, ink);
  context.setLineDash([]);
  line(context, [polar(0, 0), polar(theta, ROD - BALL)], 4, ink);
  context.beginPath();
  context.arc(...polar(theta, ROD), BALL, 0, TURN);
  stroke(context, 3, ink);
  disc(context, polar(0, 0), 6, ink);
  context.restore();
}

/** Draws an arrow above the shell for the platform's velocity. */
function drawSpeed(context, x_dot) {
  const length = clamp(SPEED_ARROW * x_dot, -SPEED_ARROW_LIMIT, SPEED_ARROW_LIMIT);
  if (Math.abs(length) < 1) return;
  const slip = colour("slip");
  const y = -SHELL_HEIGHT - 16;
  const head = clamp(length, -ARROW_HEAD, ARROW_HEAD);
  const base = length - head;
  if (base !== 0) line(context, [[0, y], [length - 0.8 * head, y]], 5, slip);
  const wide = 0.7 * Math.abs(head);
  polygon(context, [[length, y], [base, y - wide], [base, y + wide]], slip);
}

/**
 * Draws the torque as an arc arrow around the pivot, from the upright; the limit is a quarter
 * turn.
 */
function drawTorque(context, share) {
  if (!(Math.abs(share) >= 0.01)) return;
  const torque = colour("torque");
  const end = (Math.PI / 2) * clamp(share, -1, 1);
  const head = clamp(end, -TORQUE_HEAD, TORQUE_HEAD);
  const base = end - head;
  context.beginPath();
  context.arc(0, -PIVOT, GAUGE, -Math.PI / 2, -Math.PI / 2 - base, end > 0);
  stroke(context, 7, torque);
  const wide = 50 * Math.abs(head);
  const corners = [polar(end, GAUGE), polar(base, GAUGE - wide), polar(base, GAUGE + wide)];
  polygon(context, corners, torque);
}

/** Draws the spring, the rod, and the ball with a trail. */
function drawPendulum(context, {theta, theta_dot}, still) {
  const ink = colour("ink");
  const ball = colour("ball-colour");
  const pivot = polar(0, 0);
  const centre = polar(theta, ROD);
  if (!still) drawTrail(context, theta, theta_dot, ball);
  line(context, spiral(theta), 2.5, colour("shell"));
  line(context, [pivot, centre], 7, ink);
  disc(context, pivot, 9, ink);
  disc(context, pivot, 4, colour("surface"));
  disc(context, centre, BALL, ball);
  const [x, y] = centre;
  context.globalAlpha = 0.35;
  disc(context, [x - 6, y - 7], 6, "#fff");
  context.globalAlpha = 1;
}

/** Draws where the ball has been; the trail becomes wider and darker towards the ball. */
function drawTrail(context, theta, theta_dot, ball) {
  const swept = clamp(TRAIL_SECONDS * theta_dot, -1, 1);
  if (Math.abs(swept) <= 0.02) return;
  const begin = clamp(theta - swept, -Math.PI / 2, Math.PI / 2);
  const corner = (share, side) => polar(begin + (theta - begin) * share, ROD + side * BALL * share);
  for (let part = 0; part < TRAIL_PARTS; part++) {
    const from = part / TRAIL_PARTS;
    const to = (part + 1) / TRAIL_PARTS;
    context.globalAlpha = 0.45 * from ** 1.5;
    polygon(context, [corner(from, 1), corner(from, -1), corner(to, -1), corner(to, 1)], ball);
  }
  context.globalAlpha = 1;
}

/** The points of the spring: the inner end turns with the rod, the outer one is fixed. */
function spiral(theta) {
  const {SPRING_INNER, SPRING_OUTER, SPRING_TURNS} = figure;
  const points = [];
  for (let place = 0; place <= SPRING_PARTS; place++) {
    const share = place / SPRING_PARTS;
    const angle = theta + (TURN * SPRING_TURNS - theta) * share;
    points.push(polar(angle, SPRING_INNER + (SPRING_OUTER - SPRING_INNER) * share));
  }
  return points;
}
