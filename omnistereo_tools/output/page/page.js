// The page: what is shown, the controls, and the explanation of a ray.
"use strict";

const canvas = $("view");
const calm = matchMedia("(prefers-reduced-motion: reduce)");
const PRESS = matchMedia("(pointer: coarse)").matches ? "Tap" : "Click";
const start = { yaw: 0, pitch: 0, zoom: 1, turn: 0.2, tilt: 0.2, distance: 0 };
const NOTHING = "no surface here: hidden, or cut at an edge";
const SLOW_MS = 70, COARSEST = 0.25;  // two frames that take longer; of the pixels along a side
const MAGNIFIED = 2;  // at most, at first: pixels of the page for one of the cameras
let view = { ...start }, renderer = null, picks = [], why = null;

const mode = () => document.querySelector("input[name=mode]:checked").value;
const halves = () => canvas.clientHeight > canvas.clientWidth ? 2 : 1;  // of the panorama, one below the other
const outside = () => mode() === "points" || mode() === "surfaces";
// Whether a line divides two runs: not points and surfaces, nor the difference of the two.
const divided = () => other && !outside() && $("layer").value !== "apart";
const doubtful = k => trust[k] < D.doubtful;

// --- The view -----------------------------------------------------------------------------------------------------

// Pixels of the page per radian, straight ahead. At first the height of the view is 90°, unless that is too coarse.
function focal() {
  const { clientWidth: w, clientHeight: h } = canvas, tallest = Math.min(Math.PI / 4, Math.max(...D.phi.map(Math.abs)));
  if (outside()) return 0.8 * Math.max(w, h);
  if (mode() === "flat") return Math.min(halves() * w / (2 * Math.PI), h / halves() / (D.phi[1] - D.phi[0])) * view.zoom;
  const sharp = MAGNIFIED * D.pixelsPerDegree * 180 / Math.PI;
  return Math.max(Math.min(h / 2 / Math.tan(tallest), sharp), w / 5.7) * view.zoom;
}

// How it looks, as the renderer takes it.
function seen() {
  const density = canvas.width / canvas.clientWidth;
  const [turn, tilt] = outside() ? [view.turn, view.tilt] : [view.yaw, view.pitch];
  return { mode: mode(), focal: focal() * density, turn: [turn, tilt], behind: outside() ? view.distance : 0, halves: halves() };
}

function settings() {
  return {
    mixed: $("mix").value / 100, least: leastTrust() / 100,
    layer: ["estimate", "truth", "error", "apart"].indexOf($("layer").value),
    divide: $("divide").value * canvas.width,
  };
}

let pending = false, storing = 0;
function draw() {
  if (pending || !renderer) return;
  pending = true;
  requestAnimationFrame(() => { pending = false; drawNow(); });
}

function drawNow() {
  renderer.draw(seen(), settings());
  drawMarks();
  $("sides").hidden = !divided();
  clearTimeout(storing);
  storing = setTimeout(storeState, 200);
  document.body.dataset.drawn = mode();
}

// On a slow machine the view is coarser while it moves, in steps.
let detail = 1, resting = 0;
function moving() {
  const began = performance.now(), before = detail;
  clearTimeout(resting);
  resting = setTimeout(() => { if (detail < 1) { detail = 1; resize(); } }, 300);
  requestAnimationFrame(() => requestAnimationFrame(() => {
    if (detail === before && detail > COARSEST && performance.now() - began > SLOW_MS) { detail /= 2; resize(); }
  }));
  draw();
}

function resize() {
  const density = detail * Math.min(devicePixelRatio, 2);
  canvas.width = Math.max(1, Math.round(canvas.clientWidth * density));
  canvas.height = Math.max(1, Math.round(canvas.clientHeight * density));
  draw();
}

// Where a point is on the page, relative to the view; nothing if it is behind.
function placeOf([x, y, z]) {
  const { clientWidth: w, clientHeight: h } = canvas, f = focal();
  const { turn: [turn, tilt], behind } = seen();
  const [s, c, t, u] = [Math.sin(turn), Math.cos(turn), Math.sin(tilt), Math.cos(tilt)];
  if (mode() === "flat") {
    const azimuth = Math.atan2(x, z) - turn, low = Math.atan2(y, Math.hypot(x, z)) - tilt - (D.phi[0] + D.phi[1]) / 2;
    const below = halves() > 1 && Math.cos(azimuth) < 0, right = azimuth - below * Math.PI;
    return [w / 2 + f * Math.atan2(Math.sin(right), Math.cos(right)), h * (halves() > 1 ? below ? 0.75 : 0.25 : 0.5) + f * low];
  }
  const right = c * x - s * z, forward = s * x + c * z, down = u * y - t * forward, ahead = t * y + u * forward + behind;
  if (outside()) return ahead > 0 ? [w / 2 + f * right / ahead, h / 2 + f * down / ahead] : null;
  const theta = Math.atan2(right, ahead), level = Math.hypot(right, ahead);
  return [w / 2 + 2 * f * Math.tan(theta / 2), h / 2 + 2 * f * down / level / (1 + Math.cos(theta))];
}

// The ray that is shown at a place of the page, -1 if there is none.
function rayAt({ clientX, clientY }) {
  const box = canvas.getBoundingClientRect(), density = canvas.width / box.width;
  const x = Math.floor((clientX - box.left) * density), y = Math.floor((clientY - box.top) * density);
  if (x < 0 || y < 0 || x >= canvas.width || y >= canvas.height) return -1;
  return renderer.names(seen(), settings(), x, y)[0];
}

function move(dx, dy) {
  if (outside()) {
    view.turn += dx / 300;
    view.tilt = clamp(view.tilt + dy / 300, -1.5, 1.5);
  } else {
    view.yaw -= dx / focal();
    view.pitch = clamp(view.pitch - dy / focal(), -1.5, 1.5);
  }
  moving();
}

function zoom(factor) {
  view.zoom = clamp(view.zoom * factor, 0.5, 16);
  view.distance = clamp(view.distance / factor, start.distance / 50, start.distance * 10);
  moving();
}

// --- Marks and distances --------------------------------------------------------------------------------------------

const svg = (name, values) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(values)) made.setAttribute(key, value);
  return made;
};

function drawMarks() {
  const places = picks.map(k => placeOf(inverse(k) > 1e-6 ? pointOf(k) : directionOf(k).map(x => 1e6 * x)));
  const shapes = places.filter(Boolean).map(([cx, cy]) => svg("circle", { cx, cy, r: 8 }));
  const [a, b] = places, x = $("divide").value * canvas.clientWidth;
  if (divided()) {
    shapes.push(svg("line", { x1: x, y1: 0, x2: x, y2: canvas.clientHeight }));
    $("left").style.right = canvas.clientWidth - x + 8 + "px";
    $("right").style.left = x + 8 + "px";
  }
  if (a && b) shapes.push(svg("line", { x1: a[0], y1: a[1], x2: b[0], y2: b[1] }));
  if (mode() === "flat" && !other) shapes.push(...["ahead", "right", "behind", "left"].map((words, i) => {
    const turn = i * Math.PI / 2, [x, y] = placeOf([Math.sin(turn), Math.tan(Math.min(D.phi[1], 1.5)), Math.cos(turn)]);
    return Object.assign(svg("text", { x: clamp(x, 36, canvas.clientWidth - 36), y: y - 10 }), { textContent: words });
  }));
  $("marks").replaceChildren(...shapes);
}

// The first two picks are measured, a third begins again.
function pick(k) {
  if (k < 0 || !steps[k]) return;
  picks = [...(picks.length === 2 ? [] : picks), k];
  $("distance").textContent = distanceWords();
  showWhy(k);
  draw();
}

function distanceWords() {
  if (picks.length < 2) return `${PRESS} a second place to measure.`;
  const [length, error] = distanceBetween(...picks);
  if (!(length < 1e6)) return "One of the two is too far away to measure.";
  return (error < length / 2 ? `${metres(length)} ± ${oneDigit(error)}` : `about ${metres(length)}`) + " between the two marks";
}

function tell(event) {
  const k = rayAt(event), exact = truth ? inverse(k, truth) : NaN;
  $("readout").textContent = k < 0 ? (outside() ? NOTHING : "") : !steps[k] ? "no depth here"
    : metres(1 / inverse(k)) + (rangeOf(k) && ` (${rangeOf(k)})`) + (other ? `, ${other.name} ${otherWords(k)}` : "") + (exact >= 0 ? `, exact ${metres(1 / exact)}` : "") + (doubtful(k) ? ", doubtful" : "");
}

// --- Why a ray has its depth -----------------------------------------------------------------------------------------

function showWhy(k) {
  if (!D.cameras?.length) return;
  why = explain(k);
  $("why").hidden = false;
  $("sentence").textContent = (other ? `${nameOf(D)}: ` : "") + sentenceOf(why);
  const second = sphereOf(inverse(k, seconds));
  const told = R.sentences[why.kind].includes("{other}") && Math.abs(second - why.rival?.sphere) <= toleranceOf(second);
  $("bar").textContent = [rangeOf(k) && `95 % of such rays: ${rangeOf(k)}`, !told && secondWords(k)].filter(Boolean).join("; ");
  $("exactKey").hidden = !(truth && truth[k]);
  $("tilt").textContent = tiltWords(why);
  $("along").max = D.spheres - 1;
  $("along").value = Math.round(why.index);
  $("along").oninput();
}

function tiltWords({ k, shift }) {
  if (Number.isNaN(shift)) return "";
  const near = inverse(k), far = near - shift;
  const moved = far > 0 ? oneDigit(1 / far - 1 / near) : "any distance";
  return `One camera tilted by ${R.tiltDeg}° would move it by ${moved.replace(" m", "\u00a0m")}.`;
}

// At the estimate, its own depth is shown and not that of the nearest sphere.
function showAlong() {
  const n = +$("along").value, at = n === Math.round(why.index) ? inverse(why.k) : inverseOf(n);
  const depth = metres(1 / at), agreement = why.agreement[n];
  const words = Number.isNaN(agreement) ? "fewer than two cameras see it" : `the agreement is ${agreement.toFixed(2).replace("-", "−")} of 1`;
  $("alongWords").textContent = `At ${depth}, ${words}.`;
  drawCurve(sphereOf(at));
  D.cameras.forEach((camera, i) => { drawPatch(camera, i, at); drawFisheye(camera, i, at); });
}

const INK = { line: "#d07010", estimate: "#2a7fd4", range: "#2a7fd444", cursor: "#888" };

// Agreement along the ray, far on the left; vertical lines at the estimate, within its range, the exact depth and the slider.
function drawCurve(cursor) {
  const box = $("curve"), [w, h] = [box.width, box.height] = [2 * box.clientWidth, 2 * box.clientHeight], low = h - 36;
  const context = box.getContext("2d"), ink = getComputedStyle(document.body).color, q = inverse(why.k), b = bound(why.k);
  const x = n => 10 + clamp(n, 0, D.spheres - 1) / (D.spheres - 1) * (w - 20), y = value => (low - 12) * (1 - Math.max(value, 0)) + 12;
  const line = (color, width, dash, ...points) => {
    context.beginPath();
    context.setLineDash(dash);
    points.forEach(([px, py]) => Number.isNaN(py) ? context.moveTo(px, 12) : context.lineTo(px, py));
    Object.assign(context, { strokeStyle: color, lineWidth: width });
    context.stroke();
  };
  const across = (n, color, width, dash = []) => line(color, width, dash, [x(n), 0], [x(n), low]);
  context.fillStyle = INK.range;
  if (b > 0) context.fillRect(x(sphereOf(q - b)), 0, x(sphereOf(q + b)) - x(sphereOf(q - b)), low);
  line(INK.cursor, 1, [], [0, low], [w, low]);
  across(cursor, INK.cursor, 2);
  across(why.index, INK.estimate, 5);
  const exact = truth && sphereOf(inverse(why.k, truth));
  if (exact >= 0) across(exact, ink, 3, [8, 6]);
  line(INK.line, 4, [], ...why.agreement.map((value, n) => [x(n), Number.isNaN(value) ? NaN : y(value)]));
  Object.assign(context, { fillStyle: INK.line, font: "24px system-ui", textBaseline: "bottom" });
  for (const mode of why.modes.slice(0, 3)) {
    context.beginPath();
    context.arc(x(mode.sphere), y(mode.agreement), 8, 0, 7);
    context.fill();
  }
  Object.assign(context, { fillStyle: ink, textAlign: "center" });
  let free = 0;
  for (const [at, text] of D.ticks) {
    const half = context.measureText(text).width / 2, place = clamp(x(sphereOf(D.low + at * (D.high - D.low))), half, w - half);
    if (place - half < free) continue;
    context.fillText(text, place, h);
    free = place + half + 16;
  }
}

// What a camera sees around the ray at a depth, in colour.
function drawPatch(camera, i, inverseDepth) {
  const side = 44, { canvas: box, caption } = patches[i], context = box.getContext("2d");
  box.width = box.height = side;
  const image = context.createImageData(side, side);
  squareOf(why.ray, side).forEach((point, at) => {
    const place = project(camera, point, inverseDepth);
    const color = [0, 1, 2].map(c => place ? sampleOf(camera, place, (data, k) => data[k + c]) : NaN);
    image.data.set(Number.isNaN(color[0]) ? [0, 0, 0, 0] : [...color, 255], 4 * at);
  });
  context.putImageData(image, 0, 0);
  caption.textContent = why.hidden[i] ? "hidden there" : `camera ${i + 1}`;
}

// The image of a camera with the curve on which the match lies, and a cross at the depth of the slider.
function drawFisheye(camera, i, inverseDepth) {
  const { canvas: box, caption } = fisheyes[i], context = box.getContext("2d"), side = camera.pixels.width;
  context.putImageData(camera.pixels, 0, 0);
  // The middle of pixel (0, 0) is half a pixel from the corner.
  context.setTransform(1, 0, 0, 1, 0.5, 0.5);
  const places = Array.from({ length: D.spheres }, (_, n) => visiblePlace(camera, inverseOf(n)));
  const at = visiblePlace(camera, inverseDepth), reach = side / 7;
  for (const [width, color] of [[side / 18, "#000"], [side / 40, "#ff0"]]) {
    Object.assign(context, { lineWidth: width, strokeStyle: color });
    context.beginPath();
    places.forEach((place, n) => place && (n && places[n - 1] ? context.lineTo(...place) : context.moveTo(...place)));
    for (const [dx, dy] of at ? [[1, 0], [-1, 0], [0, 1], [0, -1]] : []) {
      context.moveTo(at[0] + reach * dx / 3, at[1] + reach * dy / 3);
      context.lineTo(at[0] + reach * dx, at[1] + reach * dy);
    }
    context.stroke();
  }
  caption.textContent = `camera ${i + 1} ` + (at ? `at ${at.map(Math.round).join(", ")} px` : "does not see it");
}

// Where a camera sees the point of the ray at a depth; nothing where it does not.
function visiblePlace(camera, inverseDepth) {
  const place = project(camera, why.ray, inverseDepth);
  return place && !Number.isNaN(sampleOf(camera, place, gray)) ? place : null;
}

let patches = [], fisheyes = [];
async function makeRows() {
  const row = name => D.cameras.map(() => {
    const figure = document.createElement("figure"), caption = document.createElement("figcaption");
    const canvas = document.createElement("canvas");
    figure.append(canvas, caption);
    $(name).append(figure);
    return { canvas, caption };
  });
  [patches, fisheyes] = [row("patches"), row("fisheyes")];
  await Promise.all(D.cameras.map(async (camera, i) => {
    camera.pixels = await pixelsOf(camera.image);
    Object.assign(fisheyes[i].canvas, { width: camera.pixels.width, height: camera.pixels.height });
  }));
}

$("along").oninput = showAlong;
$("curve").onpointerdown = $("curve").onpointermove = event => {
  if (event.type === "pointermove" && !event.buttons) return;
  const box = $("curve").getBoundingClientRect();
  $("along").value = Math.round((event.clientX - box.left - 5) / (box.width - 10) * (D.spheres - 1));
  showAlong();
};
function closeWhy() {
  $("why").hidden = true;
  picks = [];
  $("distance").textContent = $("readout").textContent = "";
  draw();
}
document.querySelector("#why .close").onclick = () => { closeWhy(); canvas.focus(); };

// --- Pointers and keys -----------------------------------------------------------------------------------------------

const dragging = new Map();
let pressed = null;  // where a click or tap begins; a drag is none
canvas.addEventListener("pointerdown", e => {
  canvas.setPointerCapture(e.pointerId);
  dragging.set(e.pointerId, e);
  pressed = dragging.size === 1 ? e : null;
  tell(e);
});
// Not when the finger is lifted: the page is laid out anew, and its click would fall on what then lies below it.
canvas.addEventListener("click", e => {
  if (pressed && Math.hypot(e.clientX - pressed.clientX, e.clientY - pressed.clientY) < 6) pick(rayAt(pressed));  // of a tap, to less than a pixel
});
for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, e => dragging.delete(e.pointerId));
let hovered = false;
canvas.addEventListener("pointermove", e => {
  const before = dragging.get(e.pointerId);
  if (before && dragging.size === 1) move(e.clientX - before.clientX, e.clientY - before.clientY);
  if (before && dragging.size === 2) {
    // Two fingers zoom.
    const other = [...dragging.values()].find(p => p.pointerId !== e.pointerId);
    const apart = p => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY);
    zoom(apart(e) / Math.max(apart(before), 1));
  }
  if (before) dragging.set(e.pointerId, e);
  if (before || hovered || e.pointerType === "touch") return;  // a finger does not hover
  hovered = true;
  requestAnimationFrame(() => { hovered = false; tell(e); });
});
canvas.addEventListener("wheel", e => {
  // Within another page, which scrolls.
  if (window !== parent && document.activeElement !== canvas) return;
  e.preventDefault();
  zoom(Math.exp(-e.deltaY / 600));
}, { passive: false });
canvas.addEventListener("keydown", e => {
  const steps = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] }, box = canvas.getBoundingClientRect();
  if (steps[e.key]) { e.preventDefault(); move(...steps[e.key]); }
  if (e.key === "+") zoom(1.2);
  if (e.key === "-") zoom(1 / 1.2);
  if (e.key === "Enter") pick(rayAt({ clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 }));
});

// --- Files and other runs ---------------------------------------------------------------------------------------------

function save(name, parts) {
  const link = Object.assign(document.createElement("a"), { download: name, href: URL.createObjectURL(new Blob(parts)) });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

// The picture at a place in rays, for vertices.
function colorReader(picture) {
  const { data, width, height } = picture;
  return (column, row) => {
    const x = Math.floor(column / D.width * width) % width, y = clamp(Math.floor(row / D.height * height), 0, height - 1);
    return [...data.subarray(4 * (y * width + x), 4 * (y * width + x) + 3)];
  };
}

const within = k => steps[k] && inverse(k) * D.maxDepth >= 1 && trust[k] >= leastTrust();

$("savePoints").onclick = async () => {
  const color = colorReader(await pixelsOf(D.picture)), kept = [...steps.keys()].filter(within);
  const places = kept.map(k => [pointOf(k), color(k % D.width + 0.5, Math.floor(k / D.width) + 0.5)]);
  save("points.ply", plyOf(places, []));
};
$("saveMesh").onclick = async () => {
  const color = colorReader(await pixelsOf(D.picture)), { vertices, opaque } = makeMesh(within), numbers = new Map(), places = [];
  const faces = Uint32Array.from(opaque, i => {
    if (!numbers.has(i)) {
      const [column, row, x, y, z, inverseDepth] = vertices.subarray(FLOATS * i, FLOATS * (i + 1));
      numbers.set(i, places.push([[x, y, z].map(value => value / inverseDepth), color(column, row)]) - 1);
    }
    return numbers.get(i);
  }).reverse();  // they face the rig, as those of mesh_export.py
  save("mesh.ply", plyOf(places, faces));
};
$("saveDepth").onclick = () => save("inverse_depth.tiff", tiffOf(Float32Array.from(steps, (_, k) => inverse(k)), D.width));

// Another run of the same scene: at each ray of ours its nearest one.
let other = null;
const LOADING = "The other run is loading…";
async function showBeside(run, made = run.made ?? "") {
  const [theirSteps, theirTrust] = await Promise.all([unpacked(run.steps, run.width, Uint16Array), run.trust && unpacked(run.trust, run.width, Uint8Array)]);
  const at = Int32Array.from(steps, (_, k) => {
    const [x, y, z] = directionOf(k), row = Math.floor((Math.atan2(y, Math.hypot(x, z)) - run.phi[0]) / (run.phi[1] - run.phi[0]) * run.height);
    return row < 0 || row >= run.height ? -1 : row * run.width + Math.floor((Math.atan2(x, z) / (2 * Math.PI) + 0.5) * run.width) % run.width;
  });
  other = {
    name: nameOf(run),
    inverse: Float32Array.from(at, k => k < 0 || !theirSteps[k] ? -1 : (theirSteps[k] - 1) * run.perStep),
    trust: Uint8Array.from(at, k => k < 0 ? 0 : theirTrust ? theirTrust[k] : 100),
  };
  renderer.showOther(other);
  const names = [nameOf(D), other.name], exactly = of => truth ? `${offPercent(of)} % of rays off` : "";
  $("title").textContent = names.join(" against ");
  [["left", names[0], inverse, ours()], ["right", names[1], k => other.inverse[k], made]].forEach(([side, name, of, when]) =>
    $(side).replaceChildren(...[["b", name], ["span", exactly(of)], ["span", when]].map(([kind, textContent]) => Object.assign(document.createElement(kind), { textContent }))));
  $("doubtWords").textContent = "doubtful";
  $("layer").append(new Option("difference", "apart"));
  $("layers").hidden = false;
  $("mix").dataset.first = $("mix").value = 100;
  if (outside()) document.querySelector("input[value=look]").checked = true;
  if (!$("why").hidden) showWhy(why.k);
  showWords();
  draw();
}
const timeOf = date => date.toLocaleString("en-GB", { day: "numeric", month: "short", hour: "2-digit", minute: "2-digit" });
// The folder and the time of this page, which has neither within another.
const ours = () => location.protocol === "about:" ? "" : [decodeURI(location.pathname).split("/").at(-2), timeOf(new Date(document.lastModified))].filter(Boolean).join(", ");
// Of the rays whose exact depth is known, how many are off by more than 1 % of the spheres.
function offPercent(of) {
  const known = [...truth.keys()].filter(k => truth[k] && of(k) >= 0);
  return Math.round(100 * known.filter(k => Math.abs(of(k) - inverse(k, truth)) * D.percent > 1).length / known.length);
}
const nameOf = run => run.title.replace(/^Depth from \d+ cameras by /, "");
const otherWords = k => other.inverse[k] < 0 ? "has no depth" : metres(1 / other.inverse[k]);

$("beside").querySelector("input").onchange = async event => {
  $("facts").textContent = LOADING;
  try {
    const page = new DOMParser().parseFromString(await event.target.files[0].text(), "text/html");
    await showBeside(JSON.parse(page.getElementById("data").textContent), timeOf(new Date(event.target.files[0].lastModified)));
  } catch {
    event.target.value = $("facts").textContent = "";
    showWords();
    $("readout").textContent = "That is not the index.html of another run.";
  }
};

// --- The flight ------------------------------------------------------------------------------------------------------

// Out of the rig, once around what it has seen, and back; t from 0 to 1.
function flyTo(t) {
  const out = (1 - Math.cos(2 * Math.PI * t)) / 2;
  Object.assign(view, { turn: 2 * Math.PI * t, tilt: 0.5 * out, distance: start.distance * (0.03 + 2 * out) });
  moving();
}

const FLIGHT_MS = 16000, STATIONS = 6;
// A request of the browser, 0 if there is none; for who wants no motion, one station at a time.
let flight = 0, station = 0;
function land() {
  cancelAnimationFrame(flight);
  flight = 0;
  $("fly").textContent = "fly";
}

$("fly").onclick = () => {
  document.querySelector("input[value=surfaces]").checked = true;
  closeWhy();
  mixAnew();
  if (calm.matches) return flyTo(++station / STATIONS);
  if (flight) return land();
  const begin = performance.now(), next = now => {
    const t = (now - begin) / FLIGHT_MS;
    flyTo(clamp(t, 0, 1));
    if (t < 1) flight = requestAnimationFrame(next); else land();
  };
  flight = requestAnimationFrame(next);
  $("fly").textContent = "stop";
};

// Whatever the reader does ends the flight, and the hint, too.
for (const kind of ["pointerdown", "wheel", "keydown"])
  addEventListener(kind, e => {
    $("hint").hidden = true;
    if (flight && e.target !== $("fly")) land();
  }, { capture: true, passive: true });

// --- Controls --------------------------------------------------------------------------------------------------------

$("in").onclick = () => zoom(1.25);
$("out").onclick = () => zoom(0.8);
$("reset").onclick = () => {
  view = { ...start };
  closeWhy();
};

// The trust below which rays fade: of the steps of the slider, the first shows all.
const ODDS = [0, 6, 7, 8, 9];  // of ten
// At first surfaces and points have the colours of the picture, until the reader mixes.
let mixed = false;
function mixAnew() {
  if (!mixed) $("mix").value = outside() ? 0 : $("mix").dataset.first;
  showWords();
  draw();
}

const leastTrust = () => 10 * ODDS[$("least").value];

function showWords() {
  const mixed = +$("mix").value, odds = ODDS[$("least").value];
  if (other) $("facts").textContent = !divided() ? outside() ? `Shown: ${nameOf(D)}` : "Difference between the two" : truth ? "Off: wrong by more than 1 % of the range swept" : "";
  $("mixWords").textContent = mixed === 0 ? "picture only" : mixed === 100 ? "depth only" : `${100 - mixed} % picture, ${mixed} % depth`;
  const share = trust.reduce((count, value) => count + (value >= leastTrust()), 0) / trust.length;
  $("leastWords").textContent = odds ? `${Math.round(100 * share)} % of rays shown; ${odds} in 10 of them right` : "hide doubtful: none";
  $("grey").hidden = !D.trust || !outside() && mixed === 0;
  $("hatched").hidden = !(odds || mode() === "surfaces");
  $("hatched").lastChild.textContent = mode() === "surfaces" ? NOTHING : "hidden";
}

// The first two seconds: from the picture to the depth and half of the way back, so that nobody takes it for a photograph.
function sweepOnce() {
  if (location.hash || D.mode === "points" || matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  const began = performance.now(), target = +$("mix").value;
  let touched = false;
  for (const kind of ["pointerdown", "keydown", "wheel"]) addEventListener(kind, () => { touched = true; }, { once: true });
  requestAnimationFrame(function step(now) {
    if (touched || outside()) return;
    const t = clamp((now - began) / 2000, 0, 1);
    $("mix").value = t < 0.6 ? 100 * t / 0.6 : 100 + (target - 100) * (t - 0.6) / 0.4;
    showWords();
    draw();
    if (t < 1) requestAnimationFrame(step);
  });
}

$("divide").oninput = draw;
for (const name of ["mix", "least"]) $(name).oninput = () => { mixed ||= name === "mix"; showWords(); draw(); };
$("layer").onchange = () => {
  mixed = true;
  if (+$("mix").value === 0) $("mix").value = 100;
  showWords();
  showScale();
  draw();
};
document.querySelectorAll("input[name=mode]").forEach(button => { button.onchange = () => { $("hint").hidden = true; mixAnew(); }; });

let ticks, labels;
function showScale() {
  ticks = ["error", "apart"].includes($("layer").value) ? [[0, "0"], [1, $("scale").clientWidth > 118 ? "10 % of spheres" : "10 %"]] : D.ticks;
  $("scale").querySelectorAll("span").forEach(label => label.remove());
  labels = ticks.map(([, text]) => Object.assign(document.createElement("span"), { textContent: text }));
  $("scale").append(...labels);
  placeLabels();
}

// Each label below its place on the scale; those that would touch the one before are hidden.
function placeLabels() {
  const width = $("scale").clientWidth;
  let free = 0;
  labels.forEach((label, i) => {
    const left = clamp(ticks[i][0] * width - label.offsetWidth / 2, 0, width - label.offsetWidth);
    label.style.left = left + "px";
    label.style.visibility = left < free ? "hidden" : "visible";
    if (left >= free) free = left + label.offsetWidth + 6;
  });
}

function paintScale() {
  const colors = bytes(D.colors), bar = $("colors").getContext("2d"), strip = bar.createImageData(256, 1);
  for (let i = 0; i < 256; i++) strip.data.set([...colors.slice(3 * i, 3 * i + 3), 255], 4 * i);
  bar.putImageData(strip, 0, 0);
}

// --- The address -----------------------------------------------------------------------------------------------------

const INPUTS = ["mix", "least", "layer"], ANGLES = ["yaw", "pitch", "zoom", "turn", "tilt", "distance"];

// The view goes into the fragment of the address, so that it can be sent: when it rests, since browsers refuse many
// changes at a time.
function storeState() {
  const state = new URLSearchParams({ mode: mode() });
  for (const name of ANGLES) if (view[name] !== start[name]) state.set(name, +view[name].toFixed(4));
  for (const name of INPUTS) if ($(name).value !== $(name).dataset.first) state.set(name, $(name).value);
  if (picks.length) state.set("rays", picks.join(" "));
  // The page within a page has no address.
  if (location.protocol !== "about:") history.replaceState(null, "", "#" + state);
}

function readState() {
  const state = new URLSearchParams(location.hash.slice(1));
  for (const name of INPUTS) {
    $(name).dataset.first = $(name).value;
    if (state.has(name)) $(name).value = state.get(name);
  }
  for (const name of ANGLES) if (Number.isFinite(parseFloat(state.get(name)))) view[name] = parseFloat(state.get(name));
  const chosen = document.querySelector(`input[value="${CSS.escape(state.get("mode") ?? "")}"]`);
  (chosen ?? document.querySelector(`input[value=${D.mode}]`)).checked = true;
  mixed = state.has("mix");
  mixAnew();
  for (const k of (state.get("rays") ?? "").split(" ").slice(0, 2)) if (k && k in steps) pick(+k);
}

// --- Begin -----------------------------------------------------------------------------------------------------------

// What is shown of a panorama where there is no WebGL.
function showPictureOnly() {
  $("without").hidden = false;
  $("without").textContent = "This browser has no WebGL 2, which looking around and the surfaces need. Here is the panorama:";
  $("without").append(Object.assign(new Image(), { src: D.picture, alt: "the panorama", style: "width: 100%" }));
  for (const name of ["hint", "controls", "head"]) $(name).hidden = true;
  document.body.dataset.drawn = "without";
}

(async () => {
  $("title").textContent = D.title;
  if (D.beside) $("facts").textContent = LOADING;
  if (PRESS === "Tap") $("hint").firstChild.textContent = "Drag to look around, pinch to zoom.";
  $("hint").lastChild.textContent = `${PRESS} a place: why is it that far away?`;
  $("layers").hidden = !D.truth;
  if (!D.truth) for (const name of ["truth", "error"]) $("layer").querySelector(`[value=${name}]`).remove();
  $("sure").hidden = !D.trust;
  $("least").max = ODDS.length - 1;
  await unpackRays();
  $("doubtWords").textContent = `doubtful: ${Math.round(100 * trust.filter(percent => percent < D.doubtful).length / trust.length)} %`;
  const picture = new Image();
  picture.src = D.picture;
  await picture.decode();
  D.cameras ??= [];
  await makeRows();
  const known = k => steps[k] > 0 && confidence[k] >= 100 * D.minConfidence - 0.5;
  renderer = makeRenderer(canvas, picture, makeMesh(known));
  if (!renderer) return showPictureOnly();
  const near = Float32Array.from([...steps.keys()].filter(k => known(k) && inverse(k) * D.maxDepth >= 1), k => 1 / inverse(k)).sort();
  view.distance = start.distance = 0.7 * (near[Math.floor(0.6 * near.length)] || 1);
  readState();
  paintScale();
  showScale();
  showWords();
  new ResizeObserver(placeLabels).observe($("scale"));
  new ResizeObserver(resize).observe(canvas);
  resize();
  if (D.beside) await showBeside(D.beside); else sweepOnce();
})();
