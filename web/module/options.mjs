// The options of an environment, as a user passes them and as the core takes them.

import {ACCEPTED, constants, CONTROLLERS, HEADER} from "./archive.mjs";
import {checkChoice, checkCount, checkFields, checkNumber} from "./checks.mjs";
import {NAMES, tasks} from "./core.mjs";

/** Names of the controllers that `load` accepts. */
export const controllers = Object.keys(CONTROLLERS);

/**
 * Merges options of the core: those of the task, given ones, and those that follow from controller
 * and task.
 */
export function mergeOptions(task, controller, ...given) {
  const own = {...CONTROLLERS[controller].options, task: tasks.indexOf(task)};
  return Object.assign({}, HEADER.tasks[task], ...given, own);
}

/** Whether two environments have equal options. */
export function sameOptions(one, other) {
  return NAMES.OPTIONS.every((name) => one[name] === other[name]);
}

/** Returns all options of the core for given ones, or throws an error that names a wrong one. */
export function checkOptions(given, task) {
  checkFields("options", given, NAMES.OPTIONS);
  const usual = HEADER.tasks[task];
  const options = {...usual, ...given};
  for (const [name, value] of Object.entries(options)) {
    // An option that the task leaves out may be left out.
    const omitted = value === null && usual[name] === null;
    if (!omitted) checkNumber(`options.${name}`, value, ...ACCEPTED.options[name]);
    if (name.endsWith("_low")) checkLow(name, value, options[name.replace(/_low$/, "_high")]);
  }
  checkCount("options.stack_size", options.stack_size, ACCEPTED.options.stack_size[1] + 1);
  if ((options.initial_theta === null) !== (options.initial_theta_dot === null)) {
    throw new RangeError(
      "options.initial_theta and options.initial_theta_dot must be given together");
  }
  return options;
}

/** Throws an error if the ends of a range are in the wrong order, or only one is given. */
function checkLow(name, low, high) {
  if (low > high || (low === null) !== (high === null)) {
    const accepted = `the low end of a range up to ${high}`;
    throw new RangeError(`options.${name} must be ${accepted}, got ${low}`);
  }
}

/**
 * Returns the options of the core for the fields of `capsule_gym.Disturbances`, "real" or "none";
 * without a value, none.
 */
export function disturbanceOptions(given) {
  if (given === undefined) return {};
  const fields = {...HEADER.ideal, ...disturbanceFields(given)};
  const {controls, unmeasured, stick_threshold, x_noise} = fields;
  const {sensors, options: limits} = ACCEPTED;
  checkChoice("disturbances.controls", controls, ["both", "law", "agent"]);
  if (!Array.isArray(unmeasured) || !unmeasured.every((name) => sensors.includes(name))) {
    const accepted = `an array out of ${sensors.join(", ")}`;
    throw new RangeError(`disturbances.unmeasured must be ${accepted}, got ${unmeasured}`);
  }
  checkNumber("disturbances.stick_threshold", stick_threshold, ...limits.stick_threshold);
  if (x_noise !== null) checkNumber("disturbances.x_noise", x_noise, ...limits.x_noise);
  const options = {
    disturbed: Number(given !== "none"),
    law_observes: Number(controls !== "agent"),
    agent_observes: Number(controls !== "law"),
    stick_threshold,
    x_noise,
  };
  for (const name of sensors) options[`with_${name}`] = Number(!unmeasured.includes(name));
  for (const name of NAMES.DISTURBANCES) {
    const [low, high = low] = checkEnds(name, fields[name]);
    options[`disturbances_${name}_low`] = low;
    options[`disturbances_${name}_high`] = high;
  }
  return options;
}

/** Returns the fields of disturbances that differ from those of an ideal environment. */
function disturbanceFields(given) {
  if (given === "none") return {};
  if (given === "real") return constants.real;
  if (typeof given === "string")
    throw new RangeError(`disturbances must be none, real or an object, got ${given}`);
  return checkFields("disturbances", given, Object.keys(HEADER.ideal));
}

/** Returns a number or a range as an array, or throws an error. */
function checkEnds(name, given) {
  const field = `disturbances.${name}`;
  const limits = ACCEPTED.options[`disturbances_${name}_low`];
  const ends = [given].flat().map((end) => checkNumber(field, end, ...limits));
  const [low, high = low] = ends;
  if (ends.length < 1 || ends.length > 2 || low > high)
    throw new RangeError(`${field} must be a number or [low, high], got ${given}`);
  return ends;
}
