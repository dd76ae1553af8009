// What the page holds: numbers, packed; and how it is read.
"use strict";

const $ = id => document.getElementById(id);
const D = JSON.parse($("data").textContent);
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));

// Unsigned integers of a type, in rows: differences along the rows, low bytes before high ones, deflated.
async function unpacked(text, width, type) {
  const stream = new Blob([bytes(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const values = new type(planes.length / type.BYTES_PER_ELEMENT);
  planes.forEach((byte, at) => values[at % values.length] += byte << 8 * Math.floor(at / values.length));
  for (let k = 1; k < values.length; k++) if (k % width) values[k] += values[k - 1];  // sums wrap around
  return values;
}
