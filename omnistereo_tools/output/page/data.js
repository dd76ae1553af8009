// What the page holds: numbers, packed; and how it is read.
"use strict";

const $ = id => document.getElementById(id);
const D = JSON.parse($("data").textContent);
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));

// A PLY file: places as [point, colour], and three numbers of places for each triangle.
function plyOf(places, faces) {
  const header = ["ply", "format binary_little_endian 1.0", "comment metres; x right, y down, z forward", `element vertex ${places.length}`,
    ..."xyz".split("").map(axis => `property float ${axis}`), ...["red", "green", "blue"].map(name => `property uchar ${name}`),
    ...faces.length ? [`element face ${faces.length / 3}`, "property list uchar uint vertex_indices"] : [], "end_header", ""].join("\n");
  const body = new DataView(new ArrayBuffer(15 * places.length + 13 * faces.length / 3));
  places.forEach(([point, color], k) => {
    point.forEach((x, i) => body.setFloat32(15 * k + 4 * i, x, true));
    color.forEach((x, i) => body.setUint8(15 * k + 12 + i, x));
  });
  for (let k = 0, at = 15 * places.length; k < faces.length; k += 3, at += 13) {
    body.setUint8(at, 3);
    for (let i = 0; i < 3; i++) body.setUint32(at + 1 + 4 * i, faces[k + i], true);
  }
  return [header, body];
}

// A TIFF file of one channel of floats.
function tiffOf(values, width) {
  const tags = [[256, width], [257, values.length / width], [258, 32], [259, 1], [262, 1], [273, 8], [277, 1], [278, values.length / width], [279, 4 * values.length], [339, 3]];
  const head = new Uint32Array([0x2a4949, 8 + values.byteLength]), list = new DataView(new ArrayBuffer(2 + 12 * tags.length + 4));
  list.setUint16(0, tags.length, true);
  tags.forEach(([tag, value], k) => [[0, tag], [2, 4], [8, value]].forEach(([at, number], i) =>
    i < 2 ? list.setUint16(2 + 12 * k + at, number, true) : list.setUint32(2 + 12 * k + at, number, true)));
  tags.forEach((_, k) => list.setUint32(2 + 12 * k + 4, 1, true));
  return [head, values, list];
}

// Unsigned integers of a type, in rows: differences along the rows, low bytes before high ones, deflated.
async function unpacked(text, width, type) {
  const stream = new Blob([bytes(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const values = new type(planes.length / type.BYTES_PER_ELEMENT);
  planes.forEach((byte, at) => values[at % values.length] += byte << 8 * Math.floor(at / values.length));
  for (let k = 1; k < values.length; k++) if (k % width) values[k] += values[k - 1];  // sums wrap around
  return values;
}
