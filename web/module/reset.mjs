// The arguments of `reset`: values that replace drawn ones, and jumps of the plant.

import {ACCEPTED, constants} from "./archive.mjs";
import {checkFields, checkNumber} from "./checks.mjs";
import {NAMES, ROW, STATE, TASKS} from "./core.mjs";

const {CONSTANTS, DISTURBANCES} = NAMES;
const {limits, largest_state: LARGEST} = constants;

/** Checks and returns a plant's M and mu; the prefix begins their names in an error. */
export function checkPlant(prefix, plant) {
  const M = checkNumber(`${prefix}M`, plant.M, ...limits.M);
  const mu = checkNumber(`${prefix}mu`, plant.mu, ...limits.mu);
  return {M, mu};
}

/** Checks and returns the jumps of an episode. */
export function checkChanges(changes) {
  if (!Array.isArray(changes))
    throw new TypeError(`changes must be an array of {t, M, mu}, got ${String(changes)}`);
  let last = -Infinity;
  return changes.map((change, n) => {
    const name = `changes[${n}]`;
    const t = checkNumber(`${name}.t`, change.t, 0, Number.MAX_VALUE);
    if (t <= last)
      throw new RangeError(`${name}.t must be later than the one before, ${last} s, got ${t}`);
    last = t;
    return {t, ...checkPlant(`${name}.`, change)};
  });
}

/** Returns the values that replace drawn ones, by row of the world. */
export function givenValues(given, task, description) {
  const varied = description.settings.varied ? ["capsule", "disturbances"] : [];
  const names = ["M", "mu", ...STATE, ...new Set(TASKS[task].draws), ...varied];
  const values = new Map();
  for (const [name, value] of Object.entries(given)) {
    if (value === undefined) continue;
    if (!names.includes(name)) {
      const accepted = [...names, "changes", "seed"].join(", ");
      throw new RangeError(`reset takes ${accepted}, got ${name}`);
    }
    for (const [row, number] of parseStart(name, value, task, description)) values.set(row, number);
  }
  const {theta} = given;
  const {theta_limit: limit} = constants;
  if (Math.abs(theta) === limit)
    throw new RangeError(`theta must be a number within +-${limit}, got ${theta}`);
  return values;
}

/** Returns pairs of a row and its value for an argument of `reset`. */
function parseStart(name, value, task, description) {
  if (STATE.includes(name)) {
    const largest = LARGEST[name];
    return [[ROW[name], checkNumber(name, value, -largest, largest)]];
  }
  if (name === "capsule") return parseCapsule(value);
  if (name === "disturbances") return parseDisturbances(value, description.settings);
  if (TASKS[task].draws.includes(name)) return parseTask(name, value, task, description);
  return [[ROW[name], checkNumber(name, value, ...limits[name])]];
}

function parseCapsule(capsule) {
  return Object.entries(checkFields("capsule", capsule, CONSTANTS)).map(([name, value]) => {
    const number = checkNumber(`capsule.${name}`, value, ...limits[name]);
    return [ROW[`drawn_${name}`], number];
  });
}

/** Returns the row of each disturbance and its value. */
function parseDisturbances(given, settings) {
  const fields = checkFields("disturbances", given, DISTURBANCES);
  return Object.entries(fields).map(([name, value]) => {
    // A value has the limits of the low end of the option's range.
    const [smallest, largest] = ACCEPTED.options[`disturbances_${name}_low`];
    // The history reaches back as far as the options need.
    const most = settings[`longest_${name}`] ?? largest;
    return [ROW[name], checkNumber(`disturbances.${name}`, value, smallest, most)];
  });
}

/** Parses what a task draws: commands, or as many numbers as it draws under this name. */
function parseTask(name, value, task, {draws, layout}) {
  const options = TASKS[task].draws;
  const lines = draws.slice(layout.task_draws).filter((_, n) => options[n] === name);
  const numbers =
    name === "commands" ? parseCommands(value) : parseNumbers(name, value, lines.length);
  return lines.map(([row], n) => [row, numbers[n]]);
}

function parseNumbers(name, value, count) {
  const {x} = LARGEST;
  const numbers = [value].flat().map((number) => checkNumber(name, number, -x, x));
  if (numbers.length !== count)
    throw new RangeError(`${name} must be ${count} numbers, got ${numbers.length}`);
  return numbers;
}

/** Returns the velocities of the commands of an episode, and how long each lasts. */
function parseCommands(commands) {
  const {commands: most, command: largest} = ACCEPTED;
  if (!Array.isArray(commands) || commands.length < 1 || commands.length > most) {
    const accepted = `an array of 1 to ${most} of {t, v}`;
    throw new RangeError(`commands must be ${accepted}, got ${String(commands)}`);
  }
  const velocities =
    commands.map((command, n) => checkNumber(`commands[${n}].v`, command.v, -largest, largest));
  // The first one begins with the episode.
  const times = commands.map(
    (command, n) => checkNumber(`commands[${n}].t`, command.t, 0, n === 0 ? 0 : Infinity));
  if (times.some((time, n) => time <= times[n - 1]))
    throw new RangeError("commands must be in the order of their t");
  const durations = times.map((time, n) => (times[n + 1] ?? Infinity) - time);
  const rest = most - commands.length;
  return [
    ...velocities, ...Array(rest).fill(velocities.at(-1)), ...durations,
    ...Array(rest).fill(Infinity)
  ];
}
