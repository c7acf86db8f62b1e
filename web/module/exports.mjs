/**
 * The capsule robot in a browser or in node. The core (`capsule_gym/core/bindings/web.cpp`) with
 * the environment's step, its laws and its trained policies runs as WebAssembly, with the same bits
 * as in Python. `capsule.d.mts` declares the types; docs/live.md shows the usage.
 *
 * @module
 */

export {constants, sets} from "./archive.mjs";
export {Capsule} from "./capsule.mjs";
export {quantities, tasks} from "./core.mjs";
export {addDriver, drivers} from "./drivers.mjs";
export {drive, Episode, load} from "./episode.mjs";
export {controllers} from "./options.mjs";
export {check} from "./replay.mjs";
