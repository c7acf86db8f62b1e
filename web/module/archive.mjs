/**
 * The data that `python -m web.build` inserts: the core, tables, networks, plants; see
 * `web/data.py`.
 */
const ARCHIVE = "";

/** Returns the archive's header and the bytes after it. */
async function unpack(text) {
  const packed = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const archive = new Uint8Array(await new Response(stream).arrayBuffer());
  const end = 4 + new DataView(archive.buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(archive.subarray(4, end)));
  return [header, archive.subarray(end)];
}

export const [HEADER, CONTENT] = await unpack(ARCHIVE);
/** Limits of what a user passes. */
export const ACCEPTED = HEADER.accepted;
export const CONTROLLERS = HEADER.controllers;
/** The frozen evaluation sets: hash and plants. */
export const sets = HEADER.sets;
/** Numbers of the task and of the plant, in SI units. */
export const constants = HEADER.constants;

/** Reads a float64 array, whose bytes are stored by column and significance. */
export function readArray({at, rows, columns}) {
  const bytes = new Uint8Array(8 * rows * columns);
  let from = at;
  for (let column = 0; column < columns; column++) {
    for (let place = 0; place < 8; place++) {
      for (let row = 0; row < rows; row++)
        bytes[8 * (row * columns + column) + place] = CONTENT[from++];
    }
  }
  return new Float64Array(bytes.buffer);
}
