import {ACCEPTED} from "./archive.mjs";

const padded = (width) => Math.ceil(width / ACCEPTED.padding) * ACCEPTED.padding;

/**
 * Returns the header of a network, in the order of `capsule_gym.policies.network.pack`; without a
 * cell, or of no network, gates and units are 0.
 */
export function readHeader(network) {
  const [layers, headLayers, , , , gates = 0, units = 0, skip] = network;
  return {layers, headLayers, gates, units, skip};
}

/** Returns the length of a network by its header and widths, or NaN. */
export function networkSize(network, entries) {
  const {layers, headLayers, gates, units, skip} = readHeader(network);
  const {header} = ACCEPTED;
  const count = layers + headLayers;
  const [inputs, ...widths] = network.slice(header, header + count + 1);
  const accepted = (width) => Number.isInteger(width) && width > 0 && width <= ACCEPTED.units;
  if (inputs !== entries || widths.length !== count || !(headLayers > 0)) return NaN;
  if (!widths.every(accepted) || widths.at(-1) !== 1) return NaN;
  const recurrent = ACCEPTED.gates.includes(gates);
  const plain = layers === 0 && gates === 0 && units === 0 && skip === 0;
  if (!plain && !(recurrent && accepted(units) && (skip === 0 || skip === 1))) return NaN;
  let size = header + padded(count + 1) + 2 * padded(entries);
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
