// Why a ray has its depth. The numbers and the sentences are those of omnistereo_tools/judge/ray.py.
"use strict";

const R = D.ray;  // the constants and the sentences of ray.py
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const mean = values => values.reduce((sum, x) => sum + x, 0) / values.length;

// Where a camera sees a point, given times its inverse depth, in pixels of its image; nothing outside its view.
function project(camera, point, inverseDepth) {
  const [x, y, z] = camera.R.map((row, i) => dot(row, point) + inverseDepth * camera.t[i]);
  const n = Math.hypot(x, y), angle = Math.atan2(-z, n);
  if (!(angle <= camera.maxAngle + 1e-12)) return null;
  const r = camera.poly.reduceRight((sum, c) => sum * angle + c, 0) / (n || 1), [c, d, e] = camera.affine;
  return [r * (x + e * y) + camera.center[0], r * (d * x + c * y) + camera.center[1]];
}

// A channel of an image between its pixels, or its gray value; NaN beside a pixel that is not visible.
function sampleOf({ pixels: { data, width, height } }, [u, v], value) {
  const column = clamp(Math.floor(u), 0, width - 2), row = clamp(Math.floor(v), 0, height - 2);
  const x = u - column, y = v - row;
  if (!(x >= 0 && x <= 1 && y >= 0 && y <= 1)) return NaN;
  let sum = 0;
  for (const [right, down] of [[0, 0], [1, 0], [0, 1], [1, 1]]) {
    const at = 4 * ((row + down) * width + column + right);
    if (data[at + 3] < 128) return NaN;
    sum += (right ? x : 1 - x) * (down ? y : 1 - y) * value(data, at);
  }
  return sum;
}

const gray = (data, at) => 0.299 * data[at] + 0.587 * data[at + 1] + 0.114 * data[at + 2];

// The samples of a square around a ray that faces the rig: as directions, side × side.
function squareOf(ray, side = R.side) {
  const theta = Math.atan2(ray[0], ray[2]), right = [Math.cos(theta), 0, -Math.sin(theta)], down = cross(ray, right);
  const step = i => R.patchDeg * Math.PI / 180 * (i / (side - 1) - 0.5);
  return Array.from({ length: side * side }, (_, i) =>
    ray.map((x, axis) => x + step(Math.floor(i / side)) * down[axis] + step(i % side) * right[axis]));
}

// What a camera sees of that square at a depth, in gray; nothing if it leaves the view.
function patchOf(camera, square, inverseDepth) {
  const values = [];
  for (const point of square) {
    const at = project(camera, point, inverseDepth), value = at ? sampleOf(camera, at, gray) : NaN;
    if (Number.isNaN(value)) return null;
    values.push(value);
  }
  return values;
}

function zncc(a, b) {
  const [p, q] = [mean(a), mean(b)];
  let product = 0, powerA = 0, powerB = 0;
  a.forEach((x, i) => { product += (x - p) * (b[i] - q); powerA += (x - p) ** 2; powerB += (b[i] - q) ** 2; });
  return product / Math.sqrt(Math.max(powerA * powerB, 1e-6));
}

// The pairs of cameras that see a square at a depth, with their agreement.
function agreements(square, inverseDepth) {
  const patches = D.cameras.map(camera => patchOf(camera, square, inverseDepth)), found = [];
  patches.forEach((a, i) => patches.forEach((b, j) => { if (a && b && i < j) found.push({ i, j, value: zncc(a, b) }); }));
  return { patches, found };
}

// How many spheres an index may be off and still be right.
const toleranceOf = index => Math.max(2, 0.1 * index);

// Depths at which the patches agree, best first: the agreement falls by a valley between any two.
function modesOf(agreement) {
  const values = agreement.map(x => Number.isNaN(x) ? -1 : x), modes = [];
  const order = [...values.keys()].sort((m, n) => values[n] - values[m]);
  for (const n of order) {
    const low = m => Math.min(...values.slice(Math.min(n, m), Math.max(n, m) + 1));
    if (values[n] > 0 && modes.every(mode => low(mode.sphere) < values[n] - R.valley))
      modes.push({ sphere: n, agreement: values[n] });
  }
  return modes;
}

// The first and the last sphere around the peak up to which the agreement falls by no valley.
function plateauOf(agreement, peak) {
  if (peak < 0) return [0, -1];
  const high = n => agreement[n] >= agreement[peak] - R.valley;
  let [first, last] = [peak, peak];
  while (high(first - 1)) first--;
  while (high(last + 1)) last++;
  return [first, last];
}

// Whether the panorama shows something much nearer on the way from the end of a ray to a camera.
function isHidden(ray, inverseDepth, camera) {
  if (!(inverseDepth > D.inverse[0])) return false;
  return Array.from({ length: R.onTheWay }, (_, i) => (i + 0.5) / R.onTheWay).some(share => {
    const place = ray.map((x, axis) => (1 - share) * x / inverseDepth + share * camera.place[axis]);
    const k = rayOf(place);
    return k >= 0 && 1 / inverse(k) < R.nearer * Math.hypot(...place);
  });
}

// By how much an error of one camera moves the inverse depth, at the worst; see tilt_shift in ray.py.
function tiltShift(ray, inverseDepth, places) {
  const moves = places.map(place => {
    const towards = ray.map((x, axis) => x - inverseDepth * place[axis]), length = Math.hypot(...towards);
    const unit = towards.map(x => x / length), along = dot(unit, place);
    return unit.map((x, axis) => (x * along - place[axis]) / length);
  });
  const less = (a, b) => a.map((x, axis) => x - b[axis]);
  const pulls = moves.map(a => Math.hypot(...[0, 1, 2].map(axis => moves.reduce((sum, b) => sum + a[axis] - b[axis], 0))));
  const power = moves.flatMap(a => moves.map(b => dot(less(a, b), less(a, b)))).reduce((sum, x) => sum + x, 0) / 2;
  return R.tiltDeg * Math.PI / 180 * Math.max(...pulls) / power;
}

// All that the page says about a ray.
function explain(k) {
  const ray = directionOf(k), square = squareOf(ray), estimate = inverse(k), index = sphereOf(estimate);
  const along = Array.from({ length: D.spheres }, (_, n) => agreements(square, inverseOf(n)));
  const agreement = along.map(({ found }) => mean(found.map(pair => pair.value)));
  const at = along[Number.isNaN(index) ? 0 : Math.round(index)];
  const spread = patch => Math.sqrt(mean(patch.map(x => (x - mean(patch)) ** 2)));
  const sees = at.patches.map(patch => patch !== null && !Number.isNaN(index));
  const hidden = D.cameras.map((camera, i) => sees[i] && isHidden(ray, estimate, camera));
  const open = D.cameras.filter((_, i) => sees[i] && !hidden[i]);
  const near = [...agreement.keys()].filter(n => Math.abs(n - index) <= toleranceOf(index) && !Number.isNaN(agreement[n]));
  const peak = near.length ? near.reduce((m, n) => agreement[n] > agreement[m] ? n : m) : -1;
  const modes = modesOf(agreement), plateau = plateauOf(agreement, peak);
  const beside = mode => mode.sphere < plateau[0] || mode.sphere > plateau[1];
  const found = {
    k, ray, square, index, agreement, sees, hidden, modes, plateau,
    alike: peak < 0 ? 0 : alikeOf(along[peak].found),
    likely: likelyRight(k, toleranceOf(index)),
    contrast: Math.max(0, ...at.patches.filter(patch => patch).map(spread)),
    chosen: peak < 0 ? NaN : agreement[peak],
    rival: modes.find(mode => beside(mode) && Math.abs(mode.sphere - index) > toleranceOf(index)),
    shift: open.length < 2 ? NaN : tiltShift(ray, estimate, open.map(camera => camera.place)),
  };
  return Object.assign(found, { kind: kindOf(found) });
}

// How many cameras agree: those of the best pair, and of pairs nearly as good.
function alikeOf(pairs) {
  const least = R.alike * Math.max(...pairs.map(pair => pair.value));
  return new Set(pairs.filter(pair => pair.value >= least).flatMap(({ i, j }) => [i, j])).size;
}

// How likely a ray is off by at most so many spheres, from its error bars; `likely` in trust.py. NaN without bars.
function likelyRight(k, spheres) {
  const [low, high] = R.within.map(share => -Math.log(1 - share));
  const power = Math.log(high / low) / Math.log(Math.max(bound(k) / sigma(k), 1.02));
  return 1 - Math.exp(-low * (spheres * perSphere / sigma(k)) ** power);
}

// Which sentence is true: the first whose rule holds.
function kindOf({ agreement, index, sees, contrast, chosen, plateau, rival, likely }) {
  const other = rival ? rival.agreement : -1, sure = likely >= R.sure, peak = chosen >= R.weak;
  if (agreement.every(Number.isNaN)) return "unseen";
  if (sees.some(Boolean) && contrast < R.flat) return "flat";
  if (!peak && !(other >= R.weak)) return "unlike";
  const [first, last] = plateau, higher = agreement.slice(first, last + 1).some(value => value > chosen);
  if (peak && (higher || plateau.some(n => Math.abs(n - index) > R.wide * toleranceOf(index)))) return "wide";
  if (peak && other < R.clear * chosen) return sure ? "agrees" : "weak";
  if (sure) return "decided";
  return peak && R.clear * other <= chosen ? "either" : "elsewhere";
}

// The spheres of the estimates around a ray, in rows; NaN unknown.
function depthsAround(k) {
  const reach = Math.max(1, Math.round(R.aroundDeg * D.width / 360)), rows = [];
  const row = Math.floor(k / D.width), left = k % D.width - reach + D.width;
  for (let y = Math.max(0, row - reach); y <= Math.min(D.height - 1, row + reach); y++)
    rows.push(Array.from({ length: 2 * reach + 1 }, (_, i) => sphereOf(inverse(y * D.width + (left + i) % D.width))));
  return rows;
}

// Spheres by which neighbours among them differ at most, of those between two depths.
function jumpOf(rows, a, b) {
  const between = rows.map(row => row.map(n => clamp(n, Math.min(a, b), Math.max(a, b))));
  const steps = between.flatMap((row, y) => row.flatMap((n, x) => [n - row[x + 1], n - between[y + 1]?.[x]]));
  return Math.max(0, ...steps.map(Math.abs).filter(step => step >= 0));
}

// Which note is added to the sentence.
function noteOf({ k, kind, rival, index }) {
  if (kind === "weak") return Number.isNaN(bound(k)) ? "" : "nearest";
  if (!["decided", "either", "elsewhere"].includes(kind) || !rival) return "";
  const around = depthsAround(k), known = around.flat().filter(n => !Number.isNaN(n));
  const off = known.map(n => Math.abs(n - rival.sphere) / toleranceOf(n)).sort((a, b) => a - b);
  if (off[Math.floor(off.length / 10)] <= R.beside)
    return jumpOf(around, index, rival.sphere) > R.jump * toleranceOf(index) ? "edge" : "";
  return off[0] > R.nowhere ? "look-alike" : "";
}

function sentenceOf(found) {
  const words = {
    count: found.alike, depth: metres(1 / inverse(found.k)),
    other: found.rival && metres(1 / inverseOf(found.rival.sphere)),
    nearest: metres(1 / (inverse(found.k) + bound(found.k))),
    farther: metres(1 / inverseOf(found.plateau[0])), nearer: metres(1 / inverseOf(found.plateau[1])),
  };
  return (R.sentences[found.kind] + R.notes[noteOf(found)]).replace(/\{([^}]+)\}/g, (_, name) => words[name]);
}
