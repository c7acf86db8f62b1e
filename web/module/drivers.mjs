// The drivers: policies and laws, and those that a user adds.

import {CONTENT, CONTROLLERS, HEADER, readArray} from "./archive.mjs";
import {checkChoice, checkFields, checkNumber} from "./checks.mjs";
import {CORE, describe} from "./core.mjs";
import {networkSize} from "./network.mjs";
import {checkOptions, controllers, mergeOptions} from "./options.mjs";

export const DRIVERS = HEADER.drivers;
const DRIVER_FIELDS =
  ["name", "description", "kind", "task", "controller", "seed", "options", "network"];
/** All drivers with their public fields. */
export const drivers = DRIVERS.map(publicFields);

/** Returns the public fields of a driver. */
function publicFields({options, network, recordings, regulator, lookahead, planner, ...shown}) {
  const {layout} = describe(CORE, mergeOptions(shown.task, shown.controller, options));
  shown.controlDt = options.control_dt;
  shown.steps = layout.steps;
  if (recordings) shown.recorded = Object.keys(recordings);
  return shown;
}

/** Returns the options of the core for a driver's environment, some of them replaced. */
export function optionsOf({task, controller, options}, given) {
  return mergeOptions(task, controller, options, given);
}

/**
 * Returns a driver's network, from the archive if the module contains the driver; undefined if
 * there is none.
 */
export function networkOf({network}) {
  const archived = network !== undefined && !(network instanceof Float64Array);
  return archived ? readArray(network) : network;
}

/** Returns the index in `HEADER.torques` of each action on a plant. */
export function recordingOf({at, steps}, plant) {
  const begin = steps.slice(0, plant).reduce((sum, length) => sum + length, at);
  return CONTENT.subarray(begin, begin + steps[plant]);
}

/** Adds a policy of your own to `drivers`, as `web.data.describe_policy` describes it in Python. */
export function addDriver(driver) {
  // A copy: what is checked is what is added.
  const added = structuredClone(checkFields("driver", driver, DRIVER_FIELDS));
  const {name, kind, task, controller} = added;
  for (const field of ["name", "description"]) {
    if (typeof added[field] !== "string")
      throw new TypeError(`${field} must be a string, got ${String(added[field])}`);
  }
  if (DRIVERS.some((other) => other.name === name))
    throw new RangeError(`name must be a new one, got ${name}`);
  checkChoice("kind", kind, ["policy"]);
  checkChoice("controller", controller, controllers);
  checkChoice(`task with ${controller}`, task, CONTROLLERS[controller].tasks);
  added.options = checkOptions(added.options, task);
  const {layout} = describe(CORE, optionsOf(added, {}));
  added.network = checkNetwork(added.network, layout.entries);
  added.group = "Added";
  DRIVERS.push(added);
  drivers.push(publicFields(added));
}

/** Returns the network of an added driver as the core takes it. */
function checkNetwork(given, entries) {
  if (!Array.isArray(given))
    throw new TypeError(`network must be an array of numbers, got ${String(given)}`);
  const network = Float64Array.from(given, (number, n) => checkNumber(`network[${n}]`, number));
  if (network.length !== networkSize(network, entries)) {
    const accepted = `as web.data.describe_policy gives it, for ${entries} entries`;
    throw new RangeError(`network must be ${accepted}, got ${network.length} numbers`);
  }
  return network;
}
