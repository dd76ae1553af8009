// The rays of the panorama: their directions, their depths, and how both are said.
"use strict";

// A depth, as `told` in ray.py.
const metres = d => d > 1e6 ? "infinitely far" : d.toFixed(d >= 100 ? 0 : d >= 10 ? 1 : 2) + " m";
const oneDigit = d => d < 1e6 ? (d >= 0.95 ? d.toFixed(0) : Number(d.toPrecision(1))) + " m" : "any distance";

// Of each ray: steps of inverse depth from 1, 0 is unknown; confidence and trust in percent; the exact steps.
let steps, confidence, trust, truth, sigmas, bounds, seconds, drawn;

async function unpackRays() {
  [steps, confidence, trust, truth, sigmas, bounds, seconds] = await Promise.all(
    [[D.steps, Uint16Array], [D.confidence, Uint8Array], [D.trust, Uint8Array], [D.truth, Uint16Array],
      [D.sigma, Uint8Array], [D.bound, Uint8Array], [D.second, Uint16Array]]
      .map(([text, type]) => text && unpacked(text, D.width, type)));
  trust ??= new Uint8Array(steps.length).fill(100);
  drawn = levelled();
}

// Inverse depth of a ray in 1/m, NaN unknown.
const inverse = (k, from = steps) => from[k] ? (from[k] - 1) * D.perStep : NaN;

// Spheres are evenly spaced in inverse depth.
const perSphere = (D.inverse[1] - D.inverse[0]) / (D.spheres - 1);
const sphereOf = inverseDepth => (inverseDepth - D.inverse[0]) / perSphere;
const inverseOf = sphere => D.inverse[0] + sphere * perSphere;

const radiansPerRow = (D.phi[1] - D.phi[0]) / D.height;

const CAP = 25 * Math.PI / 180, AROUND = 7 * Math.PI / 180;  // around a pole; around a ray

// The inverse depths that are drawn. Around the poles many rays see one place: those that are trusted least, which make
// spikes in the ground below the rig, are drawn at the mean of the others. What is told, and saved as points or depth, is the estimate.
function levelled() {
  const found = Float64Array.from(steps, (_, k) => inverse(k)), reach = Math.round(AROUND / radiansPerRow);
  const wide = row => Math.cos(D.phi[0] + (row + 0.5) * radiansPerRow);  // a ray, in heights of a row
  // Of the rays of a row around each: the sums of weights, and of weighted inverse depths.
  const sums = Array.from({ length: D.height }, (_, row) => {
    if (wide(row) > Math.sin(CAP + AROUND)) return null;
    const rays = found.subarray(row * D.width, (row + 1) * D.width), most = Math.min(D.width / 4, Math.round(reach / wide(row)));
    const weights = rays.map((value, x) => value >= 0 ? (trust[row * D.width + x] / 100) ** 6 * wide(row) / (2 * most + 1) : 0);
    return [weights, weights.map((weight, column) => weight && weight * rays[column])].map(values => sumsAround(values, most));
  });
  return found.map((value, k) => {
    const row = Math.floor(k / D.width), share = clamp((95 - trust[k]) / 15, 0, 1);
    if (!share || wide(row) > Math.sin(CAP)) return value;
    let [weight, sum] = [0, 0];
    for (let y = Math.max(0, row - reach); y <= Math.min(D.height - 1, row + reach); y++) {
      weight += sums[y][0][k % D.width];
      sum += sums[y][1][k % D.width];
    }
    return weight > 1e-9 ? value + share * (sum / weight - value) : value;
  });
}

// The sums of the values of a circle that are within a reach of each.
function sumsAround(values, reach) {
  const n = values.length;
  let sum = 0;
  for (let i = -reach; i < reach; i++) sum += values.at(i);
  return values.map((_, i) => {
    sum += values[(i + reach) % n];
    const now = sum;
    sum -= values.at(i - reach);
    return now;
  });
}

// The direction at a place of the panorama, in columns and rows: x right, y down, z forward.
function directionAt(column, row) {
  const theta = (column / D.width - 0.5) * 2 * Math.PI, phi = D.phi[0] + row * radiansPerRow;
  return [Math.cos(phi) * Math.sin(theta), Math.sin(phi), Math.cos(phi) * Math.cos(theta)];
}

const directionOf = k => directionAt(k % D.width + 0.5, Math.floor(k / D.width) + 0.5);

// The ray of a direction of any length, -1 outside of the panorama.
function rayOf([x, y, z]) {
  const row = Math.floor((Math.atan2(y, Math.hypot(x, z)) - D.phi[0]) / radiansPerRow);
  if (row < 0 || row >= D.height) return -1;
  const column = Math.floor((Math.atan2(x, z) / (2 * Math.PI) + 0.5) * D.width);
  return row * D.width + (column % D.width + D.width) % D.width;
}

// Where a ray ends, in metres.
const pointOf = (k, from = steps) => directionOf(k).map(x => x / inverse(k, from));

// Error bars of the inverse depth of a ray, in 1/m, NaN unknown: two thirds of the rays are off by at most the sigma,
// nineteen of twenty by at most the bound.
const width = code => code ? D.perStep * 2 ** ((code - 1) / 16) : NaN;
const sigma = k => width(sigmas[k]), bound = k => width(bounds[k]);

// Another surface with a tenth of the evidence or more, beyond the error bars: nearly always at the rim of something.
function secondWords(k) {
  const other = inverse(k, seconds), apart = Math.abs(1 / other - 1 / inverse(k));
  if (!(Math.abs(other - inverse(k)) > (bound(k) || 0))) return "";
  return `or ${metres(1 / other)}${apart < 1e6 ? `, ${oneDigit(apart)} ${other < inverse(k) ? "behind" : "before"} it` : ""}`;
}

// Where nineteen of twenty such rays end; nothing without error bars.
function rangeOf(k) {
  const q = inverse(k), b = bound(k), near = metres(1 / (q + b));
  return Number.isNaN(b) ? "" : q - b > 1e-6 ? `${near.replace(" m", "")} to ${metres(1 / (q - b))}` : `${near} or more`;
}

// The distance between the ends of two rays, and its standard deviation: that of depth d is d² times that of 1 / d, and
// only the part of it along the line between the two counts.
function distanceBetween(k, l) {
  const a = pointOf(k), b = pointOf(l), apart = a.map((x, i) => b[i] - x), length = Math.hypot(...apart);
  const part = m => directionOf(m).reduce((sum, x, i) => sum + x * apart[i], 0) / length * sigma(m) / inverse(m) ** 2;
  return [length, Math.hypot(part(k), part(l))];
}

async function pixelsOf(source) {
  const image = new Image();
  image.src = source;
  await image.decode();
  const copy = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height });
  copy.getContext("2d").drawImage(image, 0, 0);
  return copy.getContext("2d").getImageData(0, 0, image.width, image.height);
}
