// What changes with time: the stage, the charts, the figures and the measures.

import {constants} from "capsule.mjs";
import {CURVES, PhasePortrait, TimeChart} from "charts.js";
import {addRow, announce, element, on, sayValue, setText, show} from "elements.js";
import {showBest} from "hand.js";
import {MemoryStrip} from "memory.js";
import {written} from "numbers.js";
import {END, hasRecorded, ONLY_FROZEN} from "scene.js";
import {handFailed, hasFailed, player, redraw, reduced, scene, seek, writeLink} from "session.js";
import {Contact, Stage} from "stage.js";

/** The measures of an episode; `task` has those that only one task has. */
const MEASURES = [
  {name: "Goal reached", unit: "s", task: "goal", text: goalText},
  {
    name: "Velocity error",
    unit: "%",
    task: "velocity",
    text: (metrics) => written(metrics.velocity_error, 1)
  },
  {name: "Mean speed", unit: "cm/s", text: (metrics) => written(metrics.mean_speed, 2)},
  {name: "Cost of transport", unit: "1", text: (metrics) => written(metrics.cost_of_transport, 2)},
  {name: "Distance", unit: "cm", text: (metrics) => written(100 * metrics.distance, 1)},
  {name: "Energy", unit: "J", text: (metrics) => written(metrics.energy, 2)},
  {name: "Peak torque", unit: "N m", text: (metrics) => written(metrics.peak_torque, 3)},
  {name: "Time in stick", unit: "%", text: (metrics) => written(100 * metrics.stuck_fraction, 1)},
  {name: "Backward / forward", unit: "1", text: (metrics) => written(metrics.backward_ratio, 3)},
];

export const stage = new Stage(element("scene"), redraw);
const contacts = [new Contact(), new Contact()];
const charts = makeCharts();
const strip = makeStrip();
let drawings = 0;
let span = reduced.matches ? 0 : 10;
let announced = "";

function goalText({success, goal_time}) {
  return success === 1 ? written(goal_time, 2) : "not yet";
}

/** A quantity with its unit; the unit 1 is left out. */
function titled(name, unit) { return unit === "1" ? name : `${name}, ${unit}`; }

function makeCharts() {
  const [first, ...others] = CURVES;
  return [makeTimeChart(first), makePortrait(), ...others.map(makeTimeChart)];
}

function makePortrait() {
  const canvas = addCanvas("Phase portrait: rate, rad/s, over angle");
  canvas.parentElement.className = "tall";
  return new PhasePortrait(canvas, redraw);
}

function makeTimeChart(curve) {
  const canvas = addCanvas(titled(curve.title, curve.unit));
  return bindSeek(new TimeChart(canvas, curve, redraw));
}

function makeStrip() {
  const canvas = addCanvas("Memory of the first policy");
  canvas.id = "memory";
  return bindSeek(new MemoryStrip(canvas, redraw));
}

/** Has a click on a chart seek the time there; returns the chart. */
function bindSeek(chart) {
  chart.sheet.canvas.addEventListener("click", (event) => {
    seek(chart.value(event.offsetX));
    writeLink();
  });
  return chart;
}

/** Adds a figure to the charts; returns its canvas. */
function addCanvas(title) {
  const figure = document.createElement("figure");
  const caption = document.createElement("figcaption");
  caption.textContent = title;
  const canvas = document.createElement("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `Chart: ${title}`);
  figure.append(caption, canvas);
  element("charts").append(figure);
  return canvas;
}

/** Makes the rows of the measures, and binds the choice of the charts' length of time. */
export function makeDisplay() {
  for (const {name, unit, task} of MEASURES) {
    const row = addRow("rows", titled(name, unit));
    row.insertCell();
    row.insertCell();
    if (task) row.dataset.task = task;
  }
  element("span").value = String(span);
  on("span", "change", () => {
    span = Number(element("span").value);
    redraw();
  });
}

/** Draws all that changes with time. */
export function draw() {
  const smooth = !reduced.matches;
  const views = player.lanes.map((lane, index) => {
    const view = lane.at(player.now, smooth);
    view.contact = contacts[index].see(view.x_dot === 0);
    return {name: titleNow(lane), view};
  });
  const [driver, rival = null] = views;
  const how = {lanes: scene.view === "lane", still: !smooth};
  if (stage.sheet.seen) stage.draw(driver, rival, how);
  drawCharts();
  showFigures(driver.view);
  showTime();
  showHand();
  showMeasures(views);
  if (!player.playing) describe(views);
  showChange();
  showEnd();
}

function drawCharts() {
  drawings += 1;
  const [{title, units}] = player.lanes;
  const remembers = units > 0;
  const {canvas} = strip.sheet;
  canvas.parentElement.hidden = !remembers;
  const caption = `Memory of ${title}: output h of each unit, −1 blue to 1 orange`;
  setText(canvas.previousSibling, caption);
  const drawn = remembers ? [...charts, strip] : charts;
  for (const [index, chart] of drawn.entries()) {
    // While playing, charts are drawn in every second frame, half of them in each.
    const due = chart.sheet.seen && (index + drawings) % 2 === 0;
    if (due || !player.playing) chart.draw(player.lanes, player.now, span);
  }
}

function showFigures({x, x_dot, torque, metrics, contact}) {
  show("figure-time", written(player.now, 2));
  show("figure-x", written(100 * x, 1));
  show("figure-speed", written(100 * x_dot, 1));
  show("figure-mean", written(metrics.mean_speed, 2));
  show("figure-torque", written(torque, 2));
  const words = {stick: "stick", slip: x_dot > 0 ? "slip →" : "← slip", both: "stick, slip"};
  show("figure-contact", words[contact]);
  element("figure-contact").dataset.contact = contact;
}

function showTime() {
  const time = `${written(player.now, 2)} s`;
  element("scrub").value = player.goal ?? player.now;
  sayValue("scrub", time);
  show("scrub-value", time);
}

/** Shows the reader's longest distance, and which key the helper says to hold. */
function showHand() {
  const {hand} = player.lanes[0];
  const turn = hand?.helped ? hand.turn : 0;
  element("push-left").classList.toggle("now", turn === 1);
  element("push-right").classList.toggle("now", turn === -1);
  showBest();
}

function showMeasures(views) {
  const {rows} = element("rows");
  MEASURES.forEach(({text}, index) => {
    const [, ...cells] = rows[index].cells;
    cells.forEach((cell, column) => {
      const metrics = views[column]?.view.metrics;
      setText(cell, metrics ? text(metrics) : "");
    });
  });
}

/** Describes a still picture in words. */
function describe(views) {
  const words = views.map(({name, view}) => {
    const speed = written(100 * view.x_dot, 1);
    const contact = view.x_dot === 0 ? "in stick" : `slipping at ${speed} cm/s`;
    const angle = written((view.theta * 180) / Math.PI, 0);
    const pendulum = `pendulum at ${angle}°, torque ${written(view.torque, 2)} N m`;
    return `${name}: at ${written(100 * view.x, 1)} cm, ${contact}, ${pendulum}`;
  });
  const description = `At ${written(player.now, 2)} s. ${words.join(". ")}.`;
  element("scene").setAttribute("aria-label", description);
}

/** Says from when on a change of the plant acts. */
function showChange() {
  const change = player.moment === 0 ? "A change sets the plant of the episode."
                                     : "A change acts from this time on.";
  show("plant-text", hasRecorded(scene) ? `${ONLY_FROZEN}.` : change);
}

/** A lane's title, with the time of its failure if any. */
function titleNow(lane) {
  return hasFailed(lane) ? `${lane.title} failed at ${written(lane.time, 2)} s` : lane.title;
}

/** Shows failures and the end of the episode once they are on the screen. */
function showEnd() {
  const failed = player.lanes.filter(hasFailed);
  const sentences = failed.map((lane) => `${titleNow(lane)}: ${lane.failure}.`);
  if (player.over && failed.length < player.lanes.length)
    sentences.push(`The episode of ${END} s has ended.`);
  if (handFailed()) sentences.push("Space begins again.");
  const text = sentences.join(" ");
  element("banner").hidden = text === "";
  show("banner-text", text);
  if (text !== announced) announce(text);
  announced = text;
}
