// The form and the titles: they show the scene's settings.

import {drivers, sets} from "capsule.mjs";
import {element, sayValue, show} from "elements.js";
import {written} from "numbers.js";
import {
  drawsValues,
  driverNamed,
  END,
  hasOwnJumps,
  hasRecorded,
  limits,
  ONLY_FROZEN,
  SENSED,
  SLIDER_RANGES,
  titleOf,
  YOURSELF
} from "scene.js";
import {plantNow, player, redraw, scene, writeLink} from "session.js";

export const SPEEDS = [0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7, 10, 15, 20];
/** How sliders show the constants of the plant; friction spans two powers of ten. */
export const SCALES = {
  M: {toSlider: Number, fromSlider: Number, unit: " kg"},
  mu: {toSlider: Math.log10, fromSlider: (place) => 10 ** place, unit: ""}
};
/** Texts of the values of disturbances. */
export const DISTURBANCE_TEXTS = {
  latency: (value) => `${written(1000 * value, 0)} ms`,
  noise: (value) => `${written(value, 1)} × real`,
  lost: (value) => `${written(100 * value, 0)} %`,
  motor: (value) => `${written(value, 2)} N m`,
  slope: (value) => `${written(value, 1)} °`
};

/** Sets the ranges of the sliders and fields, which are the same for all scenes. */
export function setRanges() {
  element("speed").max = SPEEDS.length - 1;
  for (const [name, {toSlider}] of Object.entries(SCALES)) {
    const [low, high] = limits[name];
    setRange(name, toSlider(low), toSlider(high));
    setRange(`${name}-number`, low, high);
  }
  for (const [name, [low, high]] of Object.entries(SLIDER_RANGES)) setRange(name, low, high);
}

function setRange(id, low, high) {
  element(id).min = low;
  element(id).max = high;
}

/** Shows the scene's settings; `draw` shows all that changes with time. */
export function showScene() {
  fillChoices();
  for (const name of ["task", "driver", "rival", "view"]) element(name).value = scene[name];
  element("view").disabled = !scene.rival;
  const driving = scene.driver === YOURSELF;
  const own =
    "Keys, buttons or the slider below the stage, or a finger on it: hold to turn the motor.";
  show("driver-text", driving ? own : described(scene.driver));
  show("rival-text", scene.rival ? described(scene.rival) : "");
  element("hand").hidden = !driving;
  element("stage").classList.toggle("driving", driving);
  element("stage").classList.toggle("two", scene.view === "lane" && scene.rival !== "");
  for (const place of ["head", "key"]) {
    show(`${place}-driver`, titleOf(scene.driver));
    show(`${place}-rival`, titleOf(scene.rival));
  }
  element("key-rival-part").hidden = !scene.rival;
  showSpeed();
  showPlant();
  redraw();
  writeLink();
}

function described(name) {
  const {description, senses, told} = driverNamed(name);
  return senses ? `${description} It senses: ${senses}. It is told: ${told}.` : description;
}

/** Fills the lists with the choices of the scene's task. */
function fillChoices() {
  element("driver").replaceChildren(new Option("Yourself", YOURSELF), ...driverGroups());
  element("rival").replaceChildren(new Option("none", ""), ...driverGroups());
  const known = Object.keys(sets).filter((name) => sets[name].task === scene.task);
  const options = known.map((name) => new Option(name));
  element("set").replaceChildren(new Option("own values", ""), ...options);
  element("scrub").max = END;
  for (const row of element("rows").rows) {
    const {task} = row.dataset;
    row.hidden = task !== undefined && task !== scene.task;
  }
}

/** The drivers of the scene's task in the groups of the leaderboard. */
function driverGroups() {
  const groups = new Map();
  for (const {name, group, task} of drivers) {
    if (task !== scene.task) continue;
    if (!groups.has(group)) groups.set(group, makeGroup(group));
    groups.get(group).append(new Option(name));
  }
  return [...groups.values()];
}

function makeGroup(label) {
  const group = document.createElement("optgroup");
  group.label = label;
  return group;
}

export function showSpeed() {
  player.speed = scene.speed;
  const distances = SPEEDS.map((speed) => Math.abs(Math.log(speed / scene.speed)));
  element("speed").value = distances.indexOf(Math.min(...distances));
  sayValue("speed", `${scene.speed} times`);
  show("speed-value", `${scene.speed} ×`);
}

/** Shows set, plant, jumps and disturbances. */
export function showPlant() {
  // A recorded policy drives the plants of the sets alone.
  const recorded = hasRecorded(scene);
  element("set").value = scene.set;
  const ownValues = element("set").options[0];
  ownValues.disabled = recorded;
  element("plant").value = scene.set ? scene.plant : "";
  const plant = plantNow();
  for (const [name, {toSlider, unit}] of Object.entries(SCALES)) {
    const field = element(`${name}-number`);
    if (document.activeElement !== field) field.value = plant[name];
    element(name).value = toSlider(plant[name]);
    sayValue(name, `${plant[name]}${unit}`);
    field.disabled = recorded;
    element(name).disabled = recorded;
  }
  element("jump").disabled = recorded;
  const jumps = scene.jumps.map((jump) => `${written(jump.t, 2)} s: ${plantText(jump)}`);
  show("jumps", jumps.length ? `Changes: ${jumps.join("; ")}` : "No changes.");
  element("clear").disabled = !hasOwnJumps(scene);
  showDisturbances(recorded);
}

export function plantText({M, mu}) { return `M ${written(M, 4)} kg, μ ${written(mu, 4)}`; }

function showDisturbances(recorded) {
  const select = element("disturbances");
  const fixed = scene.task !== "speed" || recorded;
  const ofSet = sets[scene.set]?.disturbances ?? "none";
  element("disturbed").hidden = scene.task !== "speed";
  select.value = scene.set ? ofSet : scene.disturbances;
  select.disabled = fixed;
  for (const name of Object.keys(SLIDER_RANGES)) {
    const text = DISTURBANCE_TEXTS[name](scene[name]);
    const real = SENSED.includes(name) && select.value === "real";
    element(name).value = scene[name];
    element(name).disabled = fixed;
    sayValue(name, text);
    show(`${name}-value`, real ? "real" : text);
  }
  const real = "Real: noise, bias and drift, 5 to 15 ms of latency, a motor with lag and friction.";
  show("disturbed-text", recorded ? `${ONLY_FROZEN}.` : real);
  element("seed").value = scene.seed;
  element("seed-row").hidden = scene.set !== "" || !drawsValues(scene);
}
