import {ACCEPTED} from "./archive.mjs";

const padded = (width) => Math.ceil(width / ACCEPTED.padding) * ACCEPTED.padding;
const HEADER_SIZE = 8;
const GRU = 3;
const LSTM = 4;

/** Returns the header of a network, in the order of `capsule_gym.policies.network.pack`. */
function readHeader(network) {
  const [layers, headLayers, , , , gates, units, skip] = network;
  return {layers, headLayers, gates, units, skip};
}

/** Returns the length of a network by its header and widths, or NaN. */
export function networkSize(network, entries) {
  const {layers, headLayers, gates, units, skip} = readHeader(network);
  const count = layers + headLayers;
  const [inputs, ...widths] = network.slice(HEADER_SIZE, HEADER_SIZE + count + 1);
  const accepted = (width) => Number.isInteger(width) && width > 0 && width <= ACCEPTED.units;
  if (inputs !== entries || widths.length !== count || !(headLayers > 0)) return NaN;
  if (!widths.every(accepted) || widths.at(-1) !== 1) return NaN;
  const recurrent = gates === GRU || gates === LSTM;
  const plain = layers === 0 && gates === 0 && units === 0 && skip === 0;
  if (!plain && !(recurrent && accepted(units) && (skip === 0 || skip === 1))) return NaN;
  let size = HEADER_SIZE + padded(count + 1) + 2 * padded(entries);
  let width = inputs;
  for (const [n, next] of widths.entries()) {
    if (recurrent && n === layers) {
      size += gates * padded(units) * (1 + width) + gates * padded(units) * (1 + units);
      width = units + skip * entries;
    }
    size += padded(next) * (1 + width);
    width = next;
  }
  return size;
}

/** Returns the number of units of a network's cell; 0 without one. */
export function memoryUnits(network) { return readHeader(network).units ?? 0; }

/** Returns the length of the memory of a network: h, and for an LSTM c, each padded. */
export function memorySize(network) {
  const {gates, units} = readHeader(network);
  if (!gates) return 0;
  return (gates === LSTM ? 2 : 1) * padded(units);
}
