// The robot as `capsule_gym.rendering.renderer` draws it, with trail and speed arrow. Lengths are
// that drawing's pixels; `lane` scales them.

import {constants} from "capsule.mjs";
import {figure} from "figure.js";
import {clamp, decimals, niceStep, written} from "numbers.js";
import {colour, font, rem, Sheet} from "paint.js";

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
// Length of the speed arrow, pixels per m/s, and its maximum, pixels.
const SPEED_ARROW = 320;
const SPEED_ARROW_LIMIT = 220;
const TRAIL_SECONDS = 0.07;

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
    context.fillStyle = colour("paper");
    context.fillRect(0, 0, width, height);
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
    const copy = document.createElement("canvas");
    const [size, band] = [canvas.width / 32, canvas.width / 16];
    [copy.width, copy.height] = [canvas.width, canvas.height + band];
    const context = copy.getContext("2d");
    context.fillStyle = colour("paper");
    context.fillRect(0, 0, copy.width, copy.height);
    context.drawImage(canvas, 0, 0);
    context.fillStyle = colour("ink");
    context.font = `600 ${size}px sans-serif`;
    context.fillText(`capsule_gym  ${text}`, size, copy.height - band / 3);
    return new Promise((resolve) => {
      copy.toBlob(resolve);
    });
  }

  lane({top, height}, {name, view}, ghost, still, ink) {
    const {context, width} = this.sheet;
    const scale =
      Math.min(WIDEST, width / (2.2 * SHELL_HALF), height / (ABOVE + SHELL_HEIGHT + BELOW));
    const half = width / 2 / scale;
    context.save();
    context.beginPath();
    context.rect(0, top, width, height);
    context.clip();
    context.translate(width / 2, top + height - BELOW * scale);
    context.scale(scale, scale);
    drawFloor(context, view.x, half, scale, height / scale);
    drawBody(context, view.contact);
    if (Number.isFinite(view.target)) drawTarget(context, (view.target - view.x) * PER_METRE, half);
    const lead = ghost ? ghost.view.x - view.x : 0;
    if (ghost) drawGhost(context, ghost.view, lead * PER_METRE, half, scale);
    drawSpeed(context, view.x_dot);
    drawTorque(context, view.torque / constants.torque_limit);
    drawPendulum(context, view, still);
    context.restore();
    context.font = font(0.88, 600);
    context.textAlign = "left";
    const away = isAway(lead * PER_METRE, half);
    const where =
      away ? `, ${written(Math.abs(100 * lead), 0)} cm ${lead > 0 ? "ahead" : "behind"}` : "";
    const names = ghost ? [[name, ink], [ghost.name + where, "rival"]] : [[name, ink]];
    context.lineWidth = 5;
    context.strokeStyle = colour("paper");
    names.forEach(([text, shade], row) => {
      const place = [14, top + (1.5 + 1.4 * row) * rem(), width - 28];
      context.strokeText(text, ...place);
      context.fillStyle = colour(shade);
      context.fillText(text, ...place);
    });
  }
}

/** The point at an angle from the upright, positive to the left, and a distance from the pivot. */
function polar(angle, radius) {
  return [-radius * Math.sin(angle), -PIVOT - radius * Math.cos(angle)];
}

function line(context, points, width, stroke) {
  context.beginPath();
  for (const [x, y] of points) context.lineTo(x, y);
  context.lineWidth = width;
  context.strokeStyle = stroke;
  context.stroke();
}

function polygon(context, points, fill) {
  context.beginPath();
  for (const [x, y] of points) context.lineTo(x, y);
  context.closePath();
  context.fillStyle = fill;
  context.fill();
}

function disc(context, [x, y], radius, fill) {
  context.beginPath();
  context.arc(x, y, radius, 0, TURN);
  context.fillStyle = fill;
  context.fill();
}

/** Draws the floor with its ruler, and the flag at the start. */
function drawFloor(context, x, half, scale, height) {
  const major = MAJOR * PER_METRE;
  const every = major * scale < 44 ? 2 : 1;
  const start = -x * PER_METRE;
  const first = Math.floor((-half - start) / major);
  const last = Math.ceil((half - start) / major);
  context.fillStyle = colour("floor-fill");
  context.fillRect(-half, 0, 2 * half, BELOW);
  context.font = font(0.8 / scale);
  context.textAlign = "center";
  const [grid, tick, grey] = ["grid", "tick", "grey"].map(colour);
  const fine = 1 / scale;
  for (let mark = first; mark <= last; mark++) {
    const at = start + mark * major;
    context.fillStyle = grid;
    context.fillRect(at, -height, fine, height);
    context.fillStyle = tick;
    for (let part = 0; part < 10; part++) {
      context.fillRect(at + (part * major) / 10, 0, fine, part === 0 ? 12 : part === 5 ? 8 : 5);
    }
    context.fillStyle = grey;
    const centimetres = 100 * MAJOR;
    if (mark % every === 0)
      context.fillText(written(mark * centimetres, decimals(centimetres)), at, BELOW - 10);
  }
  if (Math.abs(start) < half + 30) {
    const ink = colour("ink");
    polygon(context, [[start, -92], [start + 28, -82], [start, -72]], ink);
    context.fillStyle = ink;
    context.fillRect(start - 1, -92, 2, 92);
  }
  context.fillStyle = tick;
  context.fillRect(-half, -1, 2 * half, 2);
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
  const {PLATFORM_HALF, PLATFORM_HEIGHT, SPRING_OUTER} = figure;
  const contact = colour(state === "both" ? "tick" : state);
  context.beginPath();
  context.roundRect(-SHELL_HALF, -SHELL_HEIGHT, 2 * SHELL_HALF, SHELL_HEIGHT, SHELL_HEIGHT / 2);
  context.globalAlpha = 0.13;
  context.fillStyle = colour("shell");
  context.fill();
  context.globalAlpha = 0.65;
  context.lineWidth = 3;
  context.strokeStyle = contact;
  context.stroke();
  context.globalAlpha = 1;
  const slate = colour("slate");
  const deck = -PLATFORM_HEIGHT - 3;
  context.beginPath();
  context.roundRect(-PLATFORM_HALF, deck, 2 * PLATFORM_HALF, PLATFORM_HEIGHT, 5);
  context.fillStyle = slate;
  context.fill();
  polygon(context, [[-46, deck + 2], [-30, -PIVOT], [30, -PIVOT], [46, deck + 2]], slate);
  disc(context, [0, -PIVOT], SPRING_OUTER + 8, slate);
  disc(context, [0, -PIVOT], SPRING_OUTER + 4, colour("paper"));
  const tick = colour("tick");
  for (let degrees = -90; degrees <= 90; degrees += 15) {
    const angle = (degrees * Math.PI) / 180;
    line(
      context, [polar(angle, GAUGE - (degrees % 90 === 0 ? 7 : 4)), polar(angle, GAUGE)], 1, tick);
  }
  const flat = SHELL_HALF - SHELL_HEIGHT / 2 + 6;
  context.fillStyle = contact;
  context.fillRect(-flat, -1, 2 * flat, 7);
}

/** Whether a robot at an offset is out of the picture. */
function isAway(offset, half) { return Math.abs(offset) > half + SHELL_HALF; }

/** Draws the rival's outline, or an arrow at the edge if it is out of the picture. */
function drawGhost(context, view, offset, half, scale) {
  const ink = colour("rival");
  context.save();
  if (isAway(offset, half)) {
    const side = Math.sign(offset);
    const at = side * (half - 12 / scale);
    const [long, wide] = [14 / scale, 8 / scale];
    polygon(
      context, [[at, -PIVOT], [at - side * long, -PIVOT - wide], [at - side * long, -PIVOT + wide]],
      ink);
  } else {
    context.translate(offset, 0);
    context.globalAlpha = 0.8;
    context.setLineDash([7, 5]);
    context.beginPath();
    context.roundRect(-SHELL_HALF, -SHELL_HEIGHT, 2 * SHELL_HALF, SHELL_HEIGHT, SHELL_HEIGHT / 2);
    context.lineWidth = 2.5;
    context.strokeStyle = ink;
    context.stroke();
    context.setLineDash([]);
    line(context, [polar(0, 0), polar(view.theta, ROD - BALL)], 4, ink);
    context.beginPath();
    context.arc(...polar(view.theta, ROD), BALL, 0, TURN);
    context.lineWidth = 3;
    context.stroke();
    disc(context, polar(0, 0), 6, ink);
  }
  context.restore();
}

/** Draws an arrow above the shell for the platform's velocity. */
function drawSpeed(context, x_dot) {
  const length = clamp(SPEED_ARROW * x_dot, -SPEED_ARROW_LIMIT, SPEED_ARROW_LIMIT);
  if (Math.abs(length) < 1) return;
  const slip = colour("slip");
  const y = -SHELL_HEIGHT - 16;
  const head = Math.sign(length) * Math.min(13, Math.abs(length));
  if (Math.abs(length) > Math.abs(head)) line(context, [[0, y], [length - 0.8 * head, y]], 5, slip);
  const wide = 0.7 * Math.abs(head);
  polygon(context, [[length, y], [length - head, y - wide], [length - head, y + wide]], slip);
}

/**
 * Draws the torque as an arc arrow around the pivot, from the upright; the limit is a quarter
 * turn.
 */
function drawTorque(context, share) {
  if (!(Math.abs(share) >= 0.01)) return;
  const torque = colour("torque");
  const end = (Math.PI / 2) * clamp(share, -1, 1);
  const head = Math.sign(end) * Math.min(0.22, Math.abs(end));
  const base = end - head;
  context.beginPath();
  context.arc(0, -PIVOT, GAUGE, -Math.PI / 2, -Math.PI / 2 - base, end > 0);
  context.lineWidth = 7;
  context.strokeStyle = torque;
  context.stroke();
  const wide = 50 * Math.abs(head);
  polygon(
    context, [polar(end, GAUGE), polar(base, GAUGE - wide), polar(base, GAUGE + wide)], torque);
}

/** Draws the spring, the rod, and the ball with a trail. */
function drawPendulum(context, {theta, theta_dot}, still) {
  const {SPRING_INNER, SPRING_OUTER, SPRING_TURNS} = figure;
  const ball = colour("ball-colour");
  const swept = clamp(TRAIL_SECONDS * theta_dot, -1, 1);
  if (!still && Math.abs(swept) > 0.02) {
    const begin = clamp(theta - swept, -Math.PI / 2, Math.PI / 2);
    const parts = 12;
    for (let i = 0; i < parts; i++) {
      const corner = (j, side) =>
        polar(begin + ((theta - begin) * j) / parts, ROD + (side * BALL * j) / parts);
      context.globalAlpha = 0.45 * (i / parts) ** 1.5;
      polygon(context, [corner(i, 1), corner(i, -1), corner(i + 1, -1), corner(i + 1, 1)], ball);
    }
    context.globalAlpha = 1;
  }
  // The inner end turns with the rod; the outer end is fixed to the platform.
  const spiral = Array.from({length: 60}, (_, i) => {
    const share = i / 59;
    return polar(
      theta + (TURN * SPRING_TURNS - theta) * share,
      SPRING_INNER + (SPRING_OUTER - SPRING_INNER) * share);
  });
  line(context, spiral, 2.5, colour("shell"));
  const ink = colour("ink");
  const [x, y] = polar(theta, ROD);
  line(context, [polar(theta, 0), [x, y]], 7, ink);
  disc(context, polar(theta, 0), 9, ink);
  disc(context, polar(theta, 0), 4, colour("surface"));
  disc(context, [x, y], BALL, ball);
  context.globalAlpha = 0.35;
  disc(context, [x - 6, y - 7], 6, "#fff");
  context.globalAlpha = 1;
}
