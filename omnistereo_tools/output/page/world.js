// A world: its surface, seen from the path of the rig, and the path on a plan.
"use strict";

const canvas = $("view"), plan = $("plan"), calm = matchMedia("(prefers-reduced-motion: reduce)");
const PRESS = matchMedia("(pointer: coarse)").matches ? "Tap" : "Click";
const METRES_A_SECOND = 4, FARTHEST = 60, NEAREST = 0.05;
const start = { yaw: 0, pitch: 0.15, behind: 6 };
const view = { at: 0, ...start };  // metres on the path; how the reader looks, relative to the rig
const along = [0];  // metres from the first frame to each, on the path
for (let k = 1; k < D.path.length; k++) along.push(along[k - 1] + Math.hypot(...D.path[k].place.map((x, i) => x - D.path[k - 1].place[i])));

// Coordinates come as whole numbers, each axis in an array of its own.
const SURFACE = {
  vertex: `
    layout(location = 0) in float x; layout(location = 1) in float y; layout(location = 2) in float z;
    layout(location = 3) in float red; layout(location = 4) in float green; layout(location = 5) in float blue;
    uniform vec2 view;
    uniform vec3 low, size, place;
    uniform mat3 axes;
    uniform float focal, behind, nearest;
    out vec3 tint, point;
    void main() {
      point = low + size * vec3(x, y, z);
      vec3 d = axes * (point - place) + vec3(0, 0, behind);
      gl_Position = vec4(2.0 * focal / view * vec2(d.x, -d.y), d.z - 2.0 * nearest, d.z);
      tint = vec3(red, green, blue);
    }`,
  fragment: `
    precision highp float;
    in vec3 tint, point;
    uniform bool pictured;  // the colours are those of a frame's panorama, seen from its place
    uniform sampler2D picture;
    uniform mat3 turn;
    uniform vec3 from;
    uniform vec2 phi;
    out vec4 color;
    void main() {
      vec3 d = turn * (point - from), seen = tint;
      vec2 at = vec2(atan(d.x, d.z) / 6.283185307 + 0.5, (atan(d.y, length(d.xz)) - phi.x) / (phi.y - phi.x));
      if (pictured) seen = textureLod(picture, at, 0.0).rgb;
      color = vec4(pow(seen, vec3(0.8)), 1);  // shadows are dark
    }`,
};

// What is beyond the surface, as the frame nearest to the reader has seen it.
const SKY = {
  vertex: `
    void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }`,
  fragment: `
    precision highp float;
    uniform sampler2D picture;
    uniform mat3 axes, turn;
    uniform vec2 view, phi;
    uniform float focal;
    out vec4 color;
    void main() {
      vec3 d = turn * (vec3((gl_FragCoord.xy - 0.5 * view) / focal * vec2(1, -1), 1) * axes);
      vec2 at = vec2(atan(d.x, d.z) / 6.283185307 + 0.5, (atan(d.y, length(d.xz)) - phi.x) / (phi.y - phi.x));
      vec4 seen = textureLod(picture, at, 0.0);
      float shown = clamp(2.125 * seen.a - 1.067, 0.0, 1.0) * smoothstep(-0.3, 0.1, at.y);
      color = vec4(mix(vec3(0.125), pow(seen.rgb, vec3(0.8)), shown), 1);
    }`,
};

let corners;  // of the triangles, in metres
const measured = [];  // places that were picked
async function imageOf(source) {
  const image = new Image();
  image.src = source;
  await image.decode();
  return image;
}

// The panorama of a frame, circular in its columns.
async function pictureTexture(gl, { picture }) {
  const image = await imageOf(picture);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  return gl.getParameter(gl.TEXTURE_BINDING_2D);
}

// A function that draws the surface on the canvas as it is seen from somewhere.
async function makeDraw(gl) {
  const [vertices, colors, planar] = await Promise.all(
    [[D.vertices, D.count, Uint16Array], [D.colors, D.count, Uint8Array], [D.faces, D.triangles, Uint32Array]].map(each => unpacked(...each)));
  const faces = planar.map((_, k) => planar[k % 3 * D.triangles + Math.floor(k / 3)]), used = program(gl, SURFACE, [], ["picture"]);
  const sky = program(gl, SKY, [], ["picture"]), place = (vertex, axis) => D.low[axis] + D.size[axis] * vertices[axis * D.count + vertex] / 65535;
  corners = Float32Array.from({ length: 3 * faces.length }, (_, k) => place(faces[Math.floor(k / 3)], k % 3));
  const textures = [];
  for (const view of D.views) textures.push(await pictureTexture(gl, view));
  for (const [first, values, type] of [[0, vertices, gl.UNSIGNED_SHORT], [3, colors, gl.UNSIGNED_BYTE]]) {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    for (let axis = 0; axis < 3; axis++) {
      gl.enableVertexAttribArray(first + axis);
      gl.vertexAttribPointer(first + axis, 1, type, true, 0, axis * D.count * values.BYTES_PER_ELEMENT);
    }
  }
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  for (const kind of [gl.DEPTH_TEST, gl.CULL_FACE]) gl.enable(kind);
  gl.clearColor(0.125, 0.125, 0.125, 1);
  return seen => {
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const values = { low: D.low, size: D.size, view: [canvas.width, canvas.height], nearest: NEAREST, phi: D.phi, ...seen, axes: axesOf(seen.turn) };
    delete values.turn;  // of the reader; each picture has its own
    if (seen.sky) {
      gl.useProgram(sky.program);
      gl.bindTexture(gl.TEXTURE_2D, textures[D.views.indexOf(seen.sky)]);
      for (const [name, value] of Object.entries({ ...values, turn: seen.sky.turn })) sky.set(name, value);
      gl.disable(gl.DEPTH_TEST);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
      gl.enable(gl.DEPTH_TEST);
    }
    gl.useProgram(used.program);
    for (const [name, value] of Object.entries(values)) used.set(name, value);
    used.set("pictured", 0);
    gl.drawElements(gl.TRIANGLES, 3 * D.plain, gl.UNSIGNED_INT, 0);
    let done = D.plain;  // triangles; those of one view follow each other
    D.views.forEach((view, k) => {
      gl.bindTexture(gl.TEXTURE_2D, textures[k]);
      for (const [name, value] of Object.entries({ pictured: 1, turn: view.turn, from: view.place })) used.set(name, value);
      gl.drawElements(gl.TRIANGLES, 3 * view.triangles, gl.UNSIGNED_INT, 12 * done);
      done += view.triangles;
    });
  };
}

// Place and heading on the path at some metres; between two frames, straight on.
function poseAt(metres) {
  let k = 0;
  while (k < along.length - 2 && along[k + 1] < metres) k++;
  const share = clamp((metres - along[k]) / (along[k + 1] - along[k] || 1), 0, 1), [a, b] = [D.path[k], D.path[k + 1]];
  const turn = Math.atan2(Math.sin(b.heading - a.heading), Math.cos(b.heading - a.heading));
  return { k: share < 0.5 ? k : k + 1, place: a.place.map((x, i) => x + share * (b.place[i] - x)), heading: a.heading + share * turn };
}

// How the reader looks; focal: pixels of the canvas per radian.
function seen() {
  const { k, place, heading } = poseAt(view.at);
  return { k, place, turn: [heading + view.yaw, view.pitch], behind: view.behind, focal: 0.6 * Math.max(canvas.width, canvas.height) };
}

let surface, background;
function draw() {
  const now = seen(), { k, place, turn } = now, frame = nearestView(D.path[k].number);
  surface({ ...now, sky: frame });
  $("place").textContent = `frame ${D.path[k].number}, ${view.at.toFixed(1)} of ${along.at(-1).toFixed(1)} m`;
  drawPlan(place, turn[0]);
  drawMarks(now);
  showFrame(frame);
  document.body.dataset.drawn = k;
}

const nearestView = number => D.views.reduce((a, b) => Math.abs(b.number - number) < Math.abs(a.number - number) ? b : a);

// The depth of the frame nearest to where the reader is, before and after.
let shownFrame = null;
function showFrame(nearest) {
  if (nearest === shownFrame) return;
  shownFrame = nearest;
  for (const [name, words] of [["before", "by itself"], ["after", "from all frames together"]]) {
    $(name).src = nearest[name];
    $(name).nextElementSibling.textContent = `Depth of frame ${nearest.number} ${words}; near is bright.`;
  }
}

// --- Measuring -------------------------------------------------------------------------------------------------------

const less = (a, b) => a.map((x, i) => x - b[i]), dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

// The first place of the surface at a pixel of the canvas, in metres; nothing where there is none.
function placeAt(x, y) {
  const { place, turn, behind, focal } = seen(), axes = axesOf(turn);
  const toWorld = d => [0, 1, 2].map(i => dot(axes.slice(3 * i, 3 * i + 3), d));
  const way = toWorld([(x - canvas.width / 2) / focal, (y - canvas.height / 2) / focal, 1]);
  const eye = toWorld([0, 0, -behind]).map((value, i) => value + place[i]);
  let nearest = Infinity;
  for (let k = 0; k < corners.length; k += 9) {
    const a = corners.slice(k, k + 3), ab = less(corners.slice(k + 3, k + 6), a), ac = less(corners.slice(k + 6, k + 9), a);
    const p = cross(way, ac), scale = dot(ab, p), from = less(eye, a), u = dot(from, p) / scale;
    if (!(scale > 0 && u >= 0 && u <= 1)) continue;  // the reader sees no triangle from behind
    const q = cross(from, ab), v = dot(way, q) / scale, t = dot(ac, q) / scale;
    if (v >= 0 && u + v <= 1 && t > NEAREST && t < nearest) nearest = t;
  }
  return nearest < Infinity ? eye.map((value, i) => value + nearest * way[i]) : null;
}

// The first two places are measured, a third begins again.
function pick(x, y) {
  const found = placeAt(x, y), apart = (a, b) => `${Math.hypot(...less(a, b)).toFixed(2)} m`;
  if (found && measured.push(found) > 2) measured.splice(0, 2);
  const [a, b] = measured;
  $("told").textContent = !found ? "There is no surface: no frame has seen this."
    : b ? `${apart(a, b)} between the two marks.` : `${apart(a, seen().place)} from the rig. ${PRESS} a second place to measure.`;
  changed();
}

function drawMarks({ place, turn, behind, focal }) {
  const axes = axesOf(turn), density = canvas.width / canvas.clientWidth;
  const at = measured.map(point => {
    const d = less(point, place), [right, down, ahead] = [0, 1, 2].map(i => axes[i] * d[0] + axes[3 + i] * d[1] + axes[6 + i] * d[2]);
    return [right, down].map((x, i) => (x * focal / (ahead + behind) + [canvas.width, canvas.height][i] / 2) / density);
  });
  $("marks").innerHTML = at.map(([x, y]) => `<circle cx="${x}" cy="${y}" r="8"/>`).join("")
    + (at.length > 1 ? `<line x1="${at[0][0]}" y1="${at[0][1]}" x2="${at[1][0]}" y2="${at[1][1]}"/>` : "");
}

// The plan is the surface from high above; across the page lies the way from the first frame to the last.
const [first, last] = [D.path[0].place, D.path.at(-1).place];
const above = { turn: [Math.atan2(last[0] - first[0], last[2] - first[2]) - Math.PI / 2, 0.5 * Math.PI], behind: 1e4 };
function onPlan(place) {
  const [s, c] = [Math.sin(above.turn[0]), Math.cos(above.turn[0])], [x, , z] = place.map((value, i) => value - above.place[i]);
  return [plan.width / 2 + above.scale * (c * x - s * z), plan.height / 2 - above.scale * (s * x + c * z)];
}

function makePlan() {
  const box = [0, 1, 2].map(i => D.path.map(({ place }) => place[i])).map(xs => [Math.min(...xs), Math.max(...xs)]);
  above.place = box.map(([low, high]) => (low + high) / 2);
  [plan.width, plan.height] = [840, 420];
  above.scale = 1;
  const reach = D.path.map(({ place }) => onPlan(place)).map(([x, y]) => Math.max(Math.abs(x - 420) / 420, Math.abs(y - 210) / 210));
  above.scale = 0.6 / Math.max(...reach, 0.02);
  [canvas.width, canvas.height] = [plan.width, plan.height];
  surface({ ...above, focal: above.scale * above.behind, nearest: above.behind - 50 });
  background = Object.assign(document.createElement("canvas"), { width: plan.width, height: plan.height });
  background.getContext("2d").drawImage(canvas, 0, 0);
}

function drawPlan(place, heading) {
  const context = plan.getContext("2d"), [x, y] = onPlan(place), angle = heading - above.turn[0];
  context.drawImage(background, 0, 0);
  Object.assign(context, { lineWidth: 6, strokeStyle: "#ff5040", fillStyle: "#ff0" });
  context.beginPath();
  D.path.forEach(({ place }) => context.lineTo(...onPlan(place)));
  context.stroke();
  context.beginPath();
  for (const [way, to] of [[28, 0], [18, 2.5], [18, -2.5]]) context.lineTo(x + way * Math.sin(angle + to), y - way * Math.cos(angle + to));
  context.fill();
}

function moveTo(metres) {
  view.at = clamp(metres, 0, along.at(-1));
  $("along").value = view.at;
}

let pending = false;
function changed() {
  if (pending) return;
  pending = true;
  requestAnimationFrame(() => { pending = false; draw(); });
}

function look(dx, dy) {
  view.yaw -= dx / 300;
  view.pitch = clamp(view.pitch - dy / 300, -1.5, 1.5);
  changed();
}

function approach(factor) {
  view.behind = clamp((view.behind + 1) * factor - 1, 0, FARTHEST);
  changed();
}

// For who wants no motion the flight is one frame further.
let flight = 0;
function land() {
  cancelAnimationFrame(flight);
  flight = 0;
  $("fly").textContent = "fly";
}

function fly() {
  if (flight) return land();
  if (view.at > along.at(-1) - 0.01) moveTo(0);
  if (calm.matches) {
    moveTo(along[Math.min(poseAt(view.at).k + 1, along.length - 1)]);
    return changed();
  }
  let before = performance.now();
  const next = now => {
    moveTo(view.at + METRES_A_SECOND * Math.max(now - before, 0) / 1000);
    before = now;
    draw();
    if (view.at < along.at(-1)) flight = requestAnimationFrame(next); else land();
  };
  flight = requestAnimationFrame(next);
  $("fly").textContent = "stop";
}

$("fly").onclick = fly;
$("reset").onclick = () => { land(); Object.assign(view, start); measured.length = 0; moveTo(0); changed(); };
$("along").oninput = () => { land(); view.at = Math.min(+$("along").value, along.at(-1)); changed(); };

const fingers = new Map();
let pressed = null;  // where a click begins; a drag is none
canvas.addEventListener("pointerdown", e => {
  canvas.setPointerCapture(e.pointerId);
  fingers.set(e.pointerId, e);
  pressed = fingers.size === 1 ? e : null;
});
canvas.addEventListener("pointerup", e => {
  if (!pressed || Math.hypot(e.clientX - pressed.clientX, e.clientY - pressed.clientY) > 6) return;
  const box = canvas.getBoundingClientRect(), density = canvas.width / box.width;
  pick((e.clientX - box.left) * density, (e.clientY - box.top) * density);
});
for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, e => fingers.delete(e.pointerId));
canvas.addEventListener("pointermove", e => {
  const before = fingers.get(e.pointerId), other = [...fingers.values()].find(finger => finger.pointerId !== e.pointerId);
  if (!before) return;
  const apart = ({ clientX, clientY }) => Math.max(Math.hypot(clientX - other.clientX, clientY - other.clientY), 1);
  if (other) approach(apart(before) / apart(e)); else look(e.clientX - before.clientX, e.clientY - before.clientY);
  fingers.set(e.pointerId, e);
});
canvas.addEventListener("wheel", e => { e.preventDefault(); approach(Math.exp(e.deltaY / 600)); }, { passive: false });
canvas.addEventListener("keydown", e => {
  const moves = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
  if (moves[e.key] || e.key === " ") e.preventDefault();
  if (moves[e.key]) look(...moves[e.key]);
  if (e.key === "+") approach(0.8);
  if (e.key === "-") approach(1.25);
  if (e.key === " ") fly();
  if (e.key === "Enter") pick(canvas.width / 2, canvas.height / 2);
});

(async () => {
  $("title").textContent = D.title;
  $("words").textContent = D.words;
  $("told").textContent = "One moment: the surface is being unpacked.";
  showFrame(D.views[0]);
  const gl = canvas.getContext("webgl2", { alpha: false });
  if (!gl) {
    $("title").textContent = "This browser has no WebGL 2, which the surface needs. mesh.glb, beside this page, opens in other programs.";
    document.body.dataset.drawn = "without";
    return;
  }
  surface = await makeDraw(gl);
  $("along").max = along.at(-1);
  makePlan();
  $("told").textContent = `Drag to look around, ${PRESS === "Tap" ? "" : "wheel or "}pinch to come closer. ${PRESS} a place to measure.`;
  new ResizeObserver(() => {
    const density = Math.min(devicePixelRatio, 2);
    [canvas.width, canvas.height] = [canvas.clientWidth, canvas.clientHeight].map(side => Math.max(1, Math.round(side * density)));
    draw();
  }).observe(canvas);
})();
