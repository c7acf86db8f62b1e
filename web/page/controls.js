// The form: choice of policies, of the plant, and of disturbances.

import {constants, drivers, sets} from "capsule.mjs";
import {announce, complain, element, on, show} from "elements.js";
import {clamp, written} from "numbers.js";
import {open} from "playback.js";
import {
  firstScene,
  keepFrozen,
  limits,
  SEEDS,
  SENSED,
  SLIDER_RANGES,
  takePlant,
  useTask,
  YOURSELF
} from "scene.js";
import {handActions, plantNow, player, reduced, scene, writeLink} from "session.js";
import {DISTURBANCE_TEXTS, plantText, SCALES, showPlant, showScene} from "settings.js";

const DT = constants.control_dt;

export function bindControls() {
  bindPolicies();
  bindPlant();
  bindDisturbances();
}

/** Binds the lists of tasks, policies and views. */
function bindPolicies() {
  const choose = (name, after) => on(name, "change", () => {
    scene[name] = element(name).value;
    after();
  });
  choose("task", openTask);
  choose("driver", () => {
    scene.hand = [];
    keepFrozen(scene);
    // With manual control, the reader starts the episode.
    open({play: scene.driver !== YOURSELF && !reduced.matches});
  });
  choose("rival", () => {
    const moved = keepFrozen(scene);
    scene.hand = moved ? [] : handActions();
    open({time: moved ? 0 : player.now});
  });
  choose("view", () => {
    showScene();
    writeLink();
  });
}

/** Opens the first driver and set of the scene's task. */
function openTask() {
  const {task} = scene;
  useTask(task);
  const first = firstScene();
  const driver =
    task === first.task ? first.driver : drivers.find((each) => each.task === task).name;
  Object.assign(scene, {driver, rival: "", hand: []});
  takePlant(scene, firstSet(), 0);
  open({play: !reduced.matches});
}

function bindPlant() {
  on("set", "change", () => choosePlant(element("set").value));
  // A number under own values is that of a plant of a set.
  on("plant", "change", () => choosePlant(scene.set || firstSet()));
  for (const name of Object.keys(SCALES)) bindConstant(name);
  on("seed", "change", () => {
    scene.seed = clamp(Math.trunc(Number(element("seed").value)) || 0, 0, SEEDS - 1);
    scene.hand = [];
    open();
  });
  on("jump", "click", () => {
    const {M, mu} = constants.ranges.wide ?? limits;
    jump({M: rounded(uniform(...M)), mu: rounded(logUniform(...mu))});
  });
  on("clear", "click", () => {
    scene.hand = handActions();
    if (scene.set) takePlant(scene, scene.set, scene.plant);
    else scene.jumps = [];
    open({time: player.now});
  });
}

function uniform(low, high) { return low + (high - low) * Math.random(); }

function logUniform(low, high) { return low * (high / low) ** Math.random(); }

/** Rounds to four digits. */
function rounded(value) { return Number(value.toPrecision(4)); }

/** The first set of the scene's task with different plants. */
function firstSet() {
  return Object.keys(sets).find((name) => name !== "nominal" && sets[name].task === scene.task);
}

/** Takes the plant of a set with the chosen number; the one on the screen without a set. */
function choosePlant(set) {
  if (set) takePlant(scene, set, chosenNumber(sets[set].plants.length - 1));
  else Object.assign(scene, {set: "", theta: undefined, jumps: []});
  scene.hand = [];
  open();
}

/** Returns the number of the plant, the nearest one if there is none with the given number. */
function chosenNumber(last) {
  const field = element("plant");
  const given = Number(field.value);
  const number = clamp(Math.trunc(given) || 0, 0, last);
  field.value = number;
  const accepted = `Plant must be a whole number from 0 to ${last}`;
  complain(number === given ? "" : `${accepted}: ${number} is taken`);
  return number;
}

/** Binds the slider and the field of M or mu. */
function bindConstant(name) {
  const slider = element(name);
  const field = element(`${name}-number`);
  const chosen = () => SCALES[name].fromSlider(Number(slider.value));
  slider.addEventListener("input", () => {
    field.value = rounded(chosen());
  });
  slider.addEventListener("change", () => chooseConstant(name, chosen()));
  field.addEventListener("change", () => {
    chooseConstant(name, field.value === "" ? NaN : Number(field.value));
  });
}

/** Changes M or mu to the nearest accepted value. */
function chooseConstant(name, given) {
  const value = rounded(given);
  const {M, mu} = plantNow();
  const plant = {M, mu};
  if (Number.isFinite(value)) plant[name] = value;
  plant[name] = clamp(plant[name], ...limits[name]);
  const accepted = `${name} must be a number from ${limits[name].join(" to ")}`;
  complain(plant[name] === value ? "" : `${accepted}: ${plant[name]} is taken`);
  element(`${name}-number`).value = plant[name];
  jump(plant);
}

/** Changes M and mu from now on; before the first step, changes the episode's plant. */
function jump({M, mu}) {
  player.branch();
  if (player.moment === 0) {
    Object.assign(scene, {set: "", M, mu, theta: undefined});
    open();
    return;
  }
  const t = Number(player.moment.toFixed(6));
  const others = scene.jumps.filter((other) => Math.abs(other.t - t) > DT / 2);
  const jumps = [...others, {t, M, mu}].sort((one, other) => one.t - other.t);
  // The lanes share this array.
  scene.jumps.splice(0, Infinity, ...jumps);
  announce(`At ${written(t, 2)} s: ${plantText({M, mu})}`);
  showPlant();
  writeLink();
}

function bindDisturbances() {
  on("disturbances", "change", () => {
    const {value} = element("disturbances");
    const own = Object.fromEntries(SENSED.map((name) => [name, 0]));
    if (value === "own") Object.assign(own, {latency: 0.01, noise: 1});
    disturb({disturbances: value, ...own});
  });
  for (const name of Object.keys(SLIDER_RANGES)) {
    const value = () => Number(element(name).value);
    on(name, "input", () => show(`${name}-value`, DISTURBANCE_TEXTS[name](value())));
    on(name, "change", () => {
      const disturbances = SENSED.includes(name) ? "own" : scene.disturbances;
      disturb({disturbances, [name]: value()});
    });
  }
}

/** Opens the scene with other disturbances. */
function disturb(changed) {
  Object.assign(scene, {set: "", theta: undefined, hand: []}, changed);
  open();
}
