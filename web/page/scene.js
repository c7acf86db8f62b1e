// The scene of a link: drivers, plant, view and time.

import {constants, drivers, sets} from "capsule.mjs";
import {clamp} from "numbers.js";

/** Name of the reader of the page as a driver. */
export const YOURSELF = "yourself";
/**
 * Number of values, from -1 to 1, of the reader's actions, so that a link can contain them
 * exactly.
 */
const HAND_STEPS = 41;
/** Lowest and highest speed of the playback. */
const SPEED_LIMITS = [0.1, 20];
/** Length of an episode of the scene's task, s. */
export let END = constants.horizons.speed;
/**
 * Lowest and highest values of the sliders of disturbances: latency in s, noise relative to the
 * real noise, the probability that a reading is lost.
 */
export const SLIDER_RANGES = {
  latency: [0, 0.03],
  noise: [0, 2],
  lost: [0, 0.9],
  motor: [0, 0.2],
  slope: [-3, 3]
};
/** Those of sensors, which `disturbances` selects, too. */
export const SENSED = ["latency", "noise", "lost"];
/** Number of seeds. */
export const SEEDS = 100;
const IDEAL = {
  disturbances: "none",
  latency: 0,
  noise: 0,
  lost: 0,
  motor: 0,
  slope: 0
};

/** Sets the task that the page shows. */
export function useTask(task) { END = constants.horizons[task]; }

/** Returns a scene's disturbances for `drive` and `load`. */
export function disturbancesOf({disturbances, latency, noise, lost, motor, slope}) {
  if (disturbances === "real") return "real";
  if (disturbances === "none") return motor || slope ? {stick_threshold: 0} : "none";
  const own = {latency, lost};
  for (const [name, size] of Object.entries(constants.real)) {
    const ofSensor = /_(noise|bias|drift)$/.test(name);
    if (!ofSensor || size === null) continue;
    const [low, high = low] = [size].flat();
    own[name] = [noise * low, noise * high];
  }
  return own;
}

/** Whether the episodes of a scene draw values. */
export function drawsValues(scene) {
  return scene.task !== "speed" || disturbancesOf(scene) !== "none";
}

/** Returns the start of a scene's episode. */
export function startOf(scene) {
  const {M, mu, theta, seed, motor, slope} = scene;
  const start = {M, mu};
  if (theta !== undefined) start.theta = theta;
  if (drawsValues(scene)) start.seed = seed;
  if (motor || slope) start.capsule = {motor_friction: motor, slope: (slope * Math.PI) / 180};
  return start;
}

/** Why M and mu cannot be chosen with some drivers. */
export const ONLY_FROZEN = "dp-oracle is recorded on the plants of the sets";

/** Parts of a link that change the plant. */
const PLANT_PARTS = ["M", "mu", "jumps", "disturbances", ...Object.keys(SLIDER_RANGES)];
const LETTERS = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNO";
const HALF = (HAND_STEPS - 1) / 2;

/** The lowest and highest M (kg) and mu of any range of plants. */
export const limits = {
  M: widest("M"),
  mu: widest("mu")
};

function widest(name) {
  const ends = Object.values(constants.ranges).flatMap((range) => range[name]);
  return [Math.min(...ends), Math.max(...ends)];
}

/** The entry of `drivers` by its name; undefined for the reader and for no driver. */
export function driverNamed(name) { return drivers.find((driver) => driver.name === name); }

/** A driver's title. */
export function titleOf(name) { return name === YOURSELF ? "Yourself" : name; }

/**
 * The sets on whose plants alone the scene's recorded driver drives; undefined for no such driver.
 */
function recordedSets({driver, rival}) {
  return driverNamed(driver)?.recorded ?? driverNamed(rival)?.recorded;
}

/** Whether the scene has a recorded driver. */
export function hasRecorded(scene) { return recordedSets(scene) !== undefined; }

/**
 * Gives a scene with a recorded driver an unchanged plant of a frozen set; returns whether it had
 * another plant.
 */
export function keepFrozen(scene) {
  const known = recordedSets(scene);
  if (!known) return false;
  const frozen = known.includes(scene.set);
  if (frozen && !hasOwnJumps(scene)) return false;
  takePlant(scene, frozen ? scene.set : known[0], scene.plant);
  return true;
}

/** The scene that an empty link shows. */
export function firstScene() {
  const known = (name) => (driverNamed(name) ? name : drivers[0].name);
  return {
    task: "speed",
    driver: known("residual-ppo"),
    rival: known("adaptive"),
    view: "ghost",
    set: "",
    plant: 0,
    M: constants.nominal.M,
    mu: constants.nominal.mu,
    theta: undefined,
    jumps: [],
    seed: 0,
    ...IDEAL,
    speed: 1,
    t: null,
    hand: [],
  };
}

/** Puts a plant of a frozen set, with its start and its jumps, into a scene. */
export function takePlant(scene, set, index) {
  const {M, mu, theta, changes = []} = sets[set].plants[index];
  const jumps = changes.map(({t, M, mu}) => ({t, M, mu}));
  Object.assign(scene, {set, plant: index, M, mu, theta, jumps, ...IDEAL});
}

/**
 * Reads the part of a link after the #.
 *
 * Invalid parts keep the first scene's values, and add a complaint.
 *
 * @param {string} hash with or without the #.
 * @returns {{scene: object, complaints: string[]}}
 */
export function readScene(hash) {
  const scene = firstScene();
  const complaints = [];
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  if ([...given.keys()].length > 0) scene.rival = "";
  readDrivers(given, scene, complaints);
  readPlant(given, scene, complaints);
  scene.speed = readNumber(given, "speed", ...SPEED_LIMITS, complaints) ?? scene.speed;
  scene.t = readNumber(given, "t", 0, END, complaints);
  if (given.get("view") === "lane") scene.view = "lane";
  if (scene.driver === YOURSELF && given.has("hand")) {
    try {
      scene.hand = readHand(given.get("hand"));
    } catch (error) {
      complaints.push(error.message);
    }
  }
  return {scene, complaints};
}

/** The part of a link after the #, with all values that differ from the defaults of `readScene`. */
export function writeScene(scene) {
  const first = firstScene();
  const parts = new URLSearchParams({driver: scene.driver});
  if (scene.driver === YOURSELF && scene.task !== first.task) parts.set("task", scene.task);
  if (scene.rival) parts.set("rival", scene.rival);
  if (scene.rival && scene.view !== first.view) parts.set("view", scene.view);
  if (scene.set) {
    parts.set("set", scene.set);
    parts.set("plant", scene.plant);
  } else {
    parts.set("M", shortened(scene.M));
    parts.set("mu", shortened(scene.mu));
  }
  if (!scene.set && scene.seed) parts.set("seed", scene.seed);
  if (scene.disturbances === "real") parts.set("disturbances", "real");
  for (const name of Object.keys(SLIDER_RANGES)) {
    const own = SENSED.includes(name) ? scene.disturbances === "own" : scene[name] !== 0;
    if (own) parts.set(name, shortened(scene[name]));
  }
  if (hasOwnJumps(scene)) parts.set("jumps", writeJumps(scene.jumps));
  if (scene.speed !== first.speed) parts.set("speed", shortened(scene.speed));
  if (scene.t !== null) parts.set("t", shortened(scene.t));
  if (scene.hand.length) parts.set("hand", writeHand(scene.hand));
  return `#${parts}`.replaceAll("%3A", ":").replaceAll("%2C", ",");
}

/** Whether the jumps of M and mu differ from those of the set. */
export function hasOwnJumps({set, plant, jumps}) {
  const expected = set ? (sets[set].plants[plant].changes ?? []) : [];
  return writeJumps(jumps) !== writeJumps(expected);
}

/** The nearest action that a link can contain. */
export function handAction(action) { return Math.round(clamp(action, -1, 1) * HALF) / HALF; }

function readDrivers(given, scene, complaints) {
  for (const part of ["driver", "rival"]) {
    const name = given.get(part);
    if (!name) continue;
    const accepted = acceptedDrivers(part, scene.task);
    if (!accepted.includes(name)) {
      complaints.push(`${part} must be one of ${accepted.join(", ")}, got "${name}"`);
      continue;
    }
    scene[part] = name;
    if (part === "driver") scene.task = driverNamed(name)?.task ?? readTask(given, complaints);
  }
  useTask(scene.task);
}

/** The driver may be any, the rival one of the scene's task. */
function acceptedDrivers(part, task) {
  if (part === "driver") return [...drivers.map(({name}) => name), YOURSELF];
  return drivers.filter((driver) => driver.task === task).map(({name}) => name);
}

function readTask(given, complaints) {
  const task = given.get("task") ?? "speed";
  if (Object.hasOwn(constants.horizons, task)) return task;
  const accepted = Object.keys(constants.horizons).join(", ");
  complaints.push(`task must be one of ${accepted}, got "${task}"`);
  return "speed";
}

/** Reads the seed and the disturbances. */
function readDisturbances(given, scene, complaints) {
  scene.seed = Math.trunc(readNumber(given, "seed", 0, SEEDS - 1, complaints) ?? 0);
  if (scene.task !== "speed") return;
  const disturbances = given.get("disturbances");
  if (disturbances === "real") scene.disturbances = "real";
  else if (disturbances !== null)
    complaints.push(`disturbances must be real, got "${disturbances}"`);
  for (const [name, bounds] of Object.entries(SLIDER_RANGES)) {
    const value = readNumber(given, name, ...bounds, complaints);
    if (value === null) continue;
    scene[name] = value;
    if (SENSED.includes(name)) scene.disturbances = "own";
  }
  if (scene.disturbances !== "none" || scene.motor || scene.slope) scene.set = "";
}

function readPlant(given, scene, complaints) {
  const set = given.get("set");
  const known = Object.keys(sets).filter((name) => sets[name].task === scene.task);
  if (set !== null && !known.includes(set)) {
    complaints.push(`set must be one of ${known.join(", ")}, got "${set}"`);
  } else if (set !== null) {
    const last = sets[set].plants.length - 1;
    takePlant(scene, set, Math.trunc(readNumber(given, "plant", 0, last, complaints) ?? 0));
  }
  for (const name of ["M", "mu"]) {
    const value = readNumber(given, name, ...limits[name], complaints);
    if (value === null || value === scene[name]) continue;
    scene.set = "";
    scene[name] = value;
  }
  if (given.has("jumps")) scene.jumps = readJumps(given.get("jumps"), complaints);
  readDisturbances(given, scene, complaints);
  const replaced = keepFrozen(scene);
  if (replaced && PLANT_PARTS.some((name) => given.has(name)))
    complaints.push(`${ONLY_FROZEN}, and what else the link says of the plant is left out`);
}

function readNumber(given, name, low, high, complaints) {
  const text = given.get(name);
  if (text === null) return null;
  const value = Number(text);
  if (text !== "" && isWithin(value, [low, high])) return value;
  complaints.push(`${name} must be a number from ${low} to ${high}, got "${text}"`);
  return null;
}

function readJumps(text, complaints) {
  const jumps = [];
  for (const part of text.split(",").filter(Boolean)) {
    const [t, M, mu, ...rest] = part.split(":").map(Number);
    const ordered = isWithin(t, [jumps.at(-1)?.t ?? 0, END]);
    if (rest.length || !ordered || !isWithin(M, limits.M) || !isWithin(mu, limits.mu)) {
      const accepted = "t:M:mu, in order of time and within the ranges of M and mu";
      complaints.push(`jumps must be ${accepted}, got "${part}"`);
      return [];
    }
    jumps.push({t, M, mu});
  }
  return jumps;
}

function isWithin(value, [low, high]) { return value >= low && value <= high; }

function writeJumps(jumps) {
  return jumps.map(({t, M, mu}) => [t, M, mu].map(shortened).join(":")).join(",");
}

/** Run-length encoding: a letter per torque, preceded by the number of repetitions if above 1. */
function writeHand(actions) {
  const letters = actions.map((action) => LETTERS[Math.round((action + 1) * HALF)]).join("");
  return letters.replace(/(.)\1+/g, (run, letter) => run.length + letter);
}

function readHand(text) {
  if (!/^(\d{0,4}[a-zA-O])*$/.test(text))
    throw new RangeError("hand must be letters a to O with counts before them");
  const actions = [];
  for (const [, count, letter] of text.matchAll(/(\d*)(\D)/g)) {
    const action = handAction(LETTERS.indexOf(letter) / HALF - 1);
    actions.push(...Array(Number(count || 1)).fill(action));
  }
  return actions.slice(0, constants.steps);
}

function shortened(value) { return String(Number(value.toPrecision(6))); }
