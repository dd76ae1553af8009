// WebGL: the panorama as it is seen from the rig, and its points or surfaces from anywhere.
"use strict";

// Two rays show one surface if their depths differ by less, or by at most so many spheres: as in mesh_export.py.
const EDGE = 1.2, STEP = 1.5;
const SHARPER = 0.5;  // levels of the picture: that of the same size, drawn between its pixels, is blurred
const sameSurface = (a, b) => Math.max(a, b) <= EDGE * Math.min(a, b) || Math.abs(a - b) <= STEP * perSphere;

// A program has only the parts that it needs, since a processor that draws runs both sides of every condition:
// NAMING writes the number of the ray in place of its colour; MIXED shows depth in the picture; THIN leaves out rays
// that are not trusted enough; WHOLE is the panorama as it is stored; RIM is the fringe of surfaces; POINTS are discs
// around the rays. BESIDE: whether a place shows another run. LAYER is 0 for the estimated depth, 1 for the exact one, 2
// for the error, 3 for the difference from the other run.
// What nothing is drawn on, in any colour scheme: dark, since between points and surfaces anything bright would dazzle.
const GROUND = 0.125;

const SHADE = `
#define GROUND ${GROUND}
precision highp float;
uniform sampler2D picture, colors, trusts;
uniform highp sampler2D rays;  // of each ray: inverse depth in 1/m, the exact one, another run's; -1 is unknown
uniform vec2 size, range;      // columns and rows of the rays; inverse depths at the ends of the colours
uniform float mixed, least, doubtful, perPercent, edge, divide;

// Of what a place shows: values of the near and of the far surface there, and how much of the near one. They come from
// the four rays around the place. At an edge in depth a ray whose colour is that of the place counts more, so that rims
// follow the edges of the picture.
vec3 surfaces(vec2 at, bool byExact, vec3 here) {
  vec2 corner = floor(at - 0.5), part = at - 0.5 - corner;
  vec2 columns = mod(corner.x + vec2(0, 1), size.x), rows = clamp(corner.y + vec2(0, 1), 0.0, size.y - 1.0);
  vec4 a = texelFetch(rays, ivec2(columns.x, rows.x), 0), b = texelFetch(rays, ivec2(columns.y, rows.x), 0);
  vec4 c = texelFetch(rays, ivec2(columns.x, rows.y), 0), d = texelFetch(rays, ivec2(columns.y, rows.y), 0);
  vec4 share = vec4(1.0 - part.x, part.x, 1.0 - part.x, part.x) * vec4(vec2(1.0 - part.y), vec2(part.y));
  vec4 estimate = BESIDE ? vec4(a.z, b.z, c.z, d.z) : vec4(a.x, b.x, c.x, d.x), exact = vec4(a.y, b.y, c.y, d.y), inverse = byExact ? exact : estimate;
  vec4 from = LAYER == 3 ? vec4(a.z, b.z, c.z, d.z) : exact, own = LAYER == 3 ? vec4(a.x, b.x, c.x, d.x) : estimate;
  vec4 value = LAYER > 1 ? mix(abs(own - from), vec4(-1), lessThan(min(own, from), vec4(0))) : inverse;
  float low = min(min(inverse.x, inverse.y), min(inverse.z, inverse.w));
  float high = max(max(inverse.x, inverse.y), max(inverse.z, inverse.w));
  if (high <= ${EDGE} * low || high - low <= edge) return vec3(dot(share, value), 0, 1);
  vec4 off;
  for (int i = 0; i < 4; i++) {
    vec3 other = textureLod(picture, (corner + vec2(i & 1, i >> 1) + 0.5) / size, 0.0).rgb - here;
    off[i] = dot(other, other);
  }
  share = max(share, 1e-4) * exp(-30.0 * off);
  vec4 near = share * vec4(greaterThan(inverse, vec4(0.5 * (low + high)))), far = share - near;
  vec2 sums = vec2(dot(near, vec4(1)), dot(far, vec4(1)));
  return vec3(vec2(dot(near, value), dot(far, value)) / max(sums, 1e-6), sums.x / (sums.x + sums.y));
}

// Where nothing is seen: the ground, hatched.
vec3 unseen() { return vec3(mod(gl_FragCoord.x + gl_FragCoord.y, 10.0) < 2.0 ? 0.22 : GROUND); }

vec3 inColors(float value) {
  if (value < 0.0) return unseen();
  float scaled = LAYER > 1 ? value * perPercent : (value - range.x) / (range.y - range.x);
  return texture(colors, vec2(clamp(scaled, 0.002, 0.998), 0.5)).rgb;
}

// The colour of a place, in rays, and how much of it is shown, given the picture there: doubtful parts fade.
vec4 shade(vec2 at, vec3 picked, bool fades) {
  vec3 seen = fades ? pow(picked, vec3(0.8)) : picked;  // shadows, as in render.py
  vec2 both = texture(trusts, at / size).rg;
  float trust = BESIDE ? both.y : both.x, doubt = 1.0 - smoothstep(doubtful - 0.1, doubtful + 0.1, trust);
#ifdef MIXED
  vec3 found = surfaces(at, LAYER == 1, picked);
  vec3 depth = mix(inColors(found.y), inColors(found.x), smoothstep(0.3, 0.7, found.z));
  // Half blended, what is far keeps the light of the picture: it is dark in the colours of depth.
  float light = dot(depth, vec3(0.3, 0.6, 0.1)), much = mixed * mix(smoothstep(0.0, 0.5, light), 1.0, mixed * mixed);
  seen = min(seen * (1.0 - much * much) + mix(depth, vec3(light), 0.85 * doubt) * much, 1.0);
#endif
  if (fades) seen = mix(seen, mix(vec3(dot(seen, vec3(0.3, 0.6, 0.1))), vec3(GROUND), 0.4), 0.85 * doubt);
#ifdef THIN
  float shown = smoothstep(least - 0.08, least + 0.01, trust);
  return vec4(mix(unseen(), seen, shown), shown);
#else
  return vec4(seen, 1);
#endif
}

// A ray as a colour: 24 bits of its number.
vec4 name(vec2 at) {
  int k = int(clamp(at.y, 0.0, size.y - 1.0)) * int(size.x) + int(mod(at.x, size.x));
  return vec4(k & 255, k >> 8 & 255, k >> 16, 255) / 255.0;
}
`;

// From the rig: the direction of each pixel. Straight ahead is as large as by a lens; far to the side, a cylinder
// through the eye keeps it from being stretched (Panini's projection, d = 1).
const INSIDE = {
  vertex: `
    void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 1, 1); }  // behind everything`,
  fragment: SHADE + `
    out vec4 color;
    uniform vec2 view, turn, phi;  // pixels; azimuth and tilt; first and last elevation
    uniform mat3 axes;
    uniform float focal, level, halves;  // pixels per radian; level of the picture, whose pixels are about as large
    void main() {
      vec2 p = (gl_FragCoord.xy - 0.5 * view) / focal * vec2(1, -1);
#ifdef HATCHED
      color = vec4(unseen(), 1);
      return;
#endif
#ifdef WHOLE
      // Of two halves, what lies behind is below.
      bool below = halves > 1.0 && p.y > 0.0;
      p += halves > 1.0 ? vec2(below ? 3.141592654 : 0.0, (below ? -0.25 : 0.25) * view.y / focal) : vec2(0);
      vec2 angles = p + turn + vec2(0, 0.5 * (phi.x + phi.y));
#else
      vec3 d = vec3(p, 1.0 - 0.25 * p.x * p.x) * axes;
      vec2 angles = vec2(atan(d.x, d.z), atan(d.y, length(d.xz)));
#endif
      vec2 at = vec2(angles.x / 6.283185307 + 0.5, (angles.y - phi.x) / (phi.y - phi.x)) * size;
      bool inside = at.y >= 0.0 && at.y <= size.y;
#ifdef NAMING
      color = inside ? name(at) : vec4(0);
#else
      color = vec4(inside ? shade(at, textureLod(picture, at / size, level).rgb, false).rgb : vec3(GROUND), 1);
#endif
    }`,
};

// From anywhere: a vertex is a place in rays and an inverse depth, so that what is infinitely far has one, too.
const OUTSIDE = {
  vertex: `
    layout(location = 0) in vec2 ray;        // column and row
    layout(location = 1) in vec4 direction;  // and the inverse depth along it
    layout(location = 2) in float fringe;    // at an edge in depth 1 the near side, 2 the far side
    uniform vec2 view;
    uniform mat3 axes;
    uniform float focal, behind;
    out vec2 at;
    out float rim, depth;
    void main() {
      at = ray;
      rim = fringe;
      depth = direction.w;
      vec3 d = axes * direction.xyz + vec3(0, 0, direction.w * behind);
      gl_Position = vec4(2.0 * focal / view * vec2(d.x, -d.y), d.z - 2.0 * 0.02 * behind * direction.w, d.z);
    }`,
  fragment: SHADE + `
    in vec2 at;
    in float rim, depth;
    uniform float nearest;
    out vec4 color;
    void main() {
#ifdef POINTS
      // A disc on the surface around each ray, as large as it touches the next ones; what is left between them is darker.
      vec2 ray = floor(at) + 0.5;
      float here = texelFetch(rays, ivec2(mod(ray.x, size.x), clamp(ray.y, 0.0, size.y - 1.0)), 0).x;
      float many = max(length(dFdx(at)), length(dFdy(at))), between = smoothstep(0.3, 0.6, length(at - ray)) * (1.0 - smoothstep(0.1, 0.35, many));
      bool same = max(here, depth) <= ${EDGE} * min(here, depth) || abs(here - depth) <= edge;
      vec4 tint = shade(ray, texture(picture, at / size).rgb, true);
      if (!same || depth < nearest || tint.a < 0.02) discard;
      tint.rgb *= 1.0 - 0.35 * between;
#endif
#if defined(NAMING) && (defined(POINTS) || !defined(RIM))
      color = name(at);
#elif defined(POINTS)
      color = tint;
#else
      vec4 shown = shade(at, texture(picture, at / size).rgb, true);
#ifdef RIM
      // Each side ends within a ray; where they meet, both are whole, so that nothing shines through.
      float share = surfaces(at, false, textureLod(picture, at / size, 0.0).rgb).z;
      shown.a *= rim < 1.5 ? smoothstep(0.0, 0.5, share) : 1.0 - smoothstep(0.5, 1.0, share);
#endif
#ifdef NAMING
      if (shown.a < 0.5) discard;
      color = name(at);
#else
#if defined(RIM) || defined(THIN)
      if (shown.a < 0.02) discard;
#endif
      color = shown;
#endif
#endif
    }`,
};

// Vertices (column, row, direction, inverse depth, fringe) and triangles. Rays are at half columns and rows; the first
// and the last row reach the rim of the panorama, and one column more closes the circle.
function makeMesh(known) {
  const across = D.width + 1, rows = D.height + 2, vertices = [], fringes = [[], []];
  const rayAt = (column, row) => clamp(row - 1, 0, D.height - 1) * D.width + column % D.width;
  for (let row = 0; row < rows; row++)
    for (let column = 0; column < across; column++)
      vertices.push(...vertexOf(column + 0.5, clamp(row - 0.5, 0, D.height), drawn[rayAt(column, row)] || 0, 1));
  const depths = Float64Array.from({ length: across * rows }, (_, i) => vertices[FLOATS * i + 5]);
  // Of each cell whether its corners are known, 1, and show one surface, 2.
  const cells = new Uint8Array(across * rows), used = new Uint8Array(across * rows);
  for (let row = 0; row + 1 < rows; row++)
    for (let column = 0; column < D.width; column++) {
      const corners = cornersOf(row * across + column, 1, across);
      if (![[0, 0], [1, 0], [0, 1], [1, 1]].every(([x, y]) => known(rayAt(column + x, row + y)))) continue;
      const four = corners.map(i => depths[i]), low = Math.min(...four), high = Math.max(...four);
      cells[corners[0]] = sameSurface(low, high) ? 2 : 1;
      if (cells[corners[0]] === 2) continue;
      // An edge in depth: both surfaces go on for a ray, one before the other.
      corners.forEach(i => { used[i] = 1; });
      const near = four.map(depth => sameSurface(depth, high));
      const far = four.map((depth, i) => !near[i] && sameSurface(depth, low));
      fringes[0].push(...twoTriangles(extended(vertices, corners, far, 2)));
      fringes[1].push(...twoTriangles(extended(vertices, corners, near, 1)));
    }
  const blocks = blocksOf(cells, depths, across, rows), opaque = [];
  for (const [corner, side] of blocks) cornersOf(corner, side, across).forEach(i => { used[i] = 1; });
  for (const [corner, side] of blocks) opaque.push(...fan(outline(corner, side, across).filter(i => used[i])));
  return { vertices: Float32Array.from(vertices), opaque: Uint32Array.from(opaque), fringe: Uint32Array.from(fringes.flat()) };
}

const LARGEST = 8, FLAT_SPHERES = 0.5;  // cells along a block; how far a ray in it may be from its corners' surface

const cornersOf = (i, side, across) => [i, i + side, i + side * across, i + side * across + side];

// The cells of surfaces as squares, [first corner, side], each as large as it is flat.
function blocksOf(cells, depths, across, rows) {
  const found = [];
  const isFlat = (corner, side) => {
    const [a, b, c, d] = cornersOf(corner, side, across).map(i => depths[i]);
    let low = Infinity, high = 0;
    for (let y = 0; y <= side; y++)
      for (let x = 0; x <= side; x++) {
        const i = corner + y * across + x, p = x / side, q = y / side;
        if (y < side && x < side && cells[i] !== 2) return false;
        const here = (1 - q) * ((1 - p) * a + p * b) + q * ((1 - p) * c + p * d);
        if (Math.abs(depths[i] - here) > FLAT_SPHERES * perSphere) return false;
        low = Math.min(low, depths[i]);
        high = Math.max(high, depths[i]);
      }
    return sameSurface(low, high);
  };
  const divide = (column, row, side) => {
    const corner = row * across + column;
    if (column >= D.width || row >= rows - 1) return;
    if (side === 1 ? cells[corner] === 2 : column + side <= D.width && row + side < rows && isFlat(corner, side))
      found.push([corner, side]);
    else if (side > 1)
      for (const [x, y] of [[0, 0], [1, 0], [0, 1], [1, 1]]) divide(column + x * side / 2, row + y * side / 2, side / 2);
  };
  for (let row = 0; row < rows; row += LARGEST)
    for (let column = 0; column < D.width; column += LARGEST) divide(column, row, LARGEST);
  return found;
}

// The vertices around a block, clockwise in pixels whose rows grow downwards.
function outline(corner, side, across) {
  const last = corner + side * across + side, steps = [...Array(side).keys()];
  return [
    ...steps.map(k => corner + k), ...steps.map(k => corner + side + k * across),
    ...steps.map(k => last - k), ...steps.map(k => last - side - k * across),
  ];
}

// Triangles between the first vertex and each two that follow.
const fan = around => around.slice(2).flatMap((vertex, k) => [around[0], around[k + 1], vertex]);

const vertexOf = (column, row, inverseDepth, fringe) => [column, row, ...directionAt(column, row), inverseDepth, fringe];
const FLOATS = 7;

// Clockwise as seen from the rig, in pixels whose rows grow downwards.
const twoTriangles = ([a, b, c, d]) => [a, b, c, c, b, d];

// Copies of the corners of a cell on one surface: those that are not on it get its mean inverse depth.
function extended(vertices, corners, on, fringe) {
  const depthOf = i => vertices[FLOATS * i + 5], depth = mean(corners.filter((_, i) => on[i]).map(depthOf));
  return corners.map((from, i) => {
    vertices.push(...vertexOf(vertices[FLOATS * from], vertices[FLOATS * from + 1], on[i] ? depthOf(from) : depth, fringe));
    return vertices.length / FLOATS - 1;
  });
}

// A renderer on a canvas, or nothing without WebGL 2.
function makeRenderer(canvas, picture, mesh) {
  const gl = canvas.getContext("webgl2", { antialias: false, alpha: false });
  if (!gl) return null;
  const surface = upload(gl, mesh), target = namesTarget(gl), programs = new Map();
  const textures = [pictureTexture(gl, picture), colorTexture(gl), rayTexture(gl), trustTexture(gl)];
  let named = null, paired = false;  // the view whose names are in the target; whether there is another run

  // Begin to draw with the program of a view that has the given parts.
  function use(view, settings, ...parts) {
    const side = view.mode === "look" || view.mode === "flat" ? INSIDE : OUTSIDE;
    parts.push(`LAYER ${settings.layer}`, `BESIDE ${paired && side === INSIDE ? "(gl_FragCoord.x > divide)" : "false"}`);
    if (settings.naming) parts.push("NAMING");
    else if (settings.mixed > 0) parts.push("MIXED");
    if (settings.least > 0) parts.push("THIN");
    if (view.mode === "flat") parts.push("WHOLE");
    if (view.mode === "points") parts.push("POINTS");
    const key = [side === INSIDE, ...parts].join();
    if (!programs.has(key)) programs.set(key, program(gl, side, parts, ["picture", "colors", "rays", "trusts"]));
    const used = programs.get(key);
    gl.useProgram(used.program);
    textures.forEach((texture, unit) => { gl.activeTexture(gl.TEXTURE0 + unit); gl.bindTexture(gl.TEXTURE_2D, texture); });
    const values = {
      size: [D.width, D.height], range: [D.low, D.high], phi: D.phi, doubtful: D.doubtful / 100,
      perPercent: D.percent / 10, edge: STEP * perSphere, view: [canvas.width, canvas.height],
      level: Math.max(0, Math.log2(picture.width / 2 / Math.PI / view.focal) - SHARPER), axes: axesOf(view.turn),
      nearest: 1 / D.maxDepth, ...settings, ...view,
    };
    for (const [name, value] of Object.entries(values)) used.set(name, value);
  }

  function render(view, settings) {
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...settings.naming ? [0, 0, 0, 0] : [GROUND, GROUND, GROUND, 1]);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    use(view, settings);
    if (view.mode === "look" || view.mode === "flat") gl.drawArrays(gl.TRIANGLES, 0, 3);
    else drawMesh(view, settings);
  }

  function drawMesh(view, settings) {
    gl.bindVertexArray(surface);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.frontFace(gl.CW);
    gl.drawElements(gl.TRIANGLES, mesh.opaque.length, gl.UNSIGNED_INT, 0);
    if (!settings.naming && view.mode === "surfaces") {
      use({ ...view, mode: "look" }, settings, "HATCHED");
      gl.frontFace(gl.CCW);
      gl.depthFunc(gl.LEQUAL);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
      gl.frontFace(gl.CW);
    }
    use(view, settings, "RIM");
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawElements(gl.TRIANGLES, mesh.fringe.length, gl.UNSIGNED_INT, 4 * mesh.opaque.length);
    for (const used of [gl.BLEND, gl.CULL_FACE, gl.DEPTH_TEST]) gl.disable(used);
    gl.bindVertexArray(null);
  }

  // The numbers of the rays that the pixels of a rectangle show, -1 where there is none; from the top left.
  function names(view, settings, x, y, width = 1, height = 1) {
    const wanted = JSON.stringify([view, settings.least, canvas.width, canvas.height]);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.resized(canvas.width, canvas.height));
    if (named !== wanted) render(view, { ...settings, naming: true });
    named = wanted;
    const read = new Uint8Array(4 * width * height);
    gl.readPixels(x, canvas.height - y - height, width, height, gl.RGBA, gl.UNSIGNED_BYTE, read);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return Int32Array.from({ length: width * height }, (_, i) => {
      const at = 4 * ((height - 1 - Math.floor(i / width)) * width + i % width);
      return read[at + 3] ? read[at] + 256 * read[at + 1] + 65536 * read[at + 2] : -1;
    });
  }

  function showOther(other) {
    textures.splice(2, 2, rayTexture(gl, other.inverse), trustTexture(gl, other.trust));
    paired = true;
  }

  return { draw: (view, settings) => render(view, { ...settings, naming: false }), names, showOther };
}

// The vertices with their triangles.
function upload(gl, { vertices, opaque, fringe }) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.STATIC_DRAW);
  [[2, 0], [4, 2], [1, 6]].forEach(([count, first], place) => {
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, count, gl.FLOAT, false, 4 * FLOATS, 4 * first);
  });
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint32Array.from([...opaque, ...fringe]), gl.STATIC_DRAW);
  gl.bindVertexArray(null);
  return array;
}

function texture(gl, around, filter, smaller = filter) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, around);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, smaller);
  return made;
}

function pictureTexture(gl, picture) {
  const made = texture(gl, gl.REPEAT, gl.LINEAR, gl.LINEAR_MIPMAP_LINEAR);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
  gl.generateMipmap(gl.TEXTURE_2D);
  return made;
}

function colorTexture(gl) {
  const made = texture(gl, gl.CLAMP_TO_EDGE, gl.LINEAR);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, bytes(D.colors));
  return made;
}

function rayTexture(gl, other) {
  const made = texture(gl, gl.REPEAT, gl.NEAREST), values = new Float32Array(4 * steps.length).fill(-1);
  [steps, truth].forEach((from, i) => from?.forEach((step, k) => { if (step) values[4 * k + i] = i ? inverse(k, from) : drawn[k]; }));
  other?.forEach((value, k) => { values[4 * k + 2] = value; });
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, D.width, D.height, 0, gl.RGBA, gl.FLOAT, values);
  return made;
}

function trustTexture(gl, other) {
  const made = texture(gl, gl.REPEAT, gl.LINEAR), values = new Uint8Array(2 * trust.length);
  [trust, other].forEach((from, i) => from?.forEach((percent, k) => { values[2 * k + i] = 2.55 * percent; }));
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RG8, D.width, D.height, 0, gl.RG, gl.UNSIGNED_BYTE, values);
  return made;
}

// Where the numbers of rays are drawn: out of sight, without blending between neighbours.
function namesTarget(gl) {
  const made = gl.createFramebuffer(), parts = [gl.createRenderbuffer(), gl.createRenderbuffer()];
  let size = "";
  return { resized(width, height) {
    if (size === `${width} ${height}`) return made;
    size = `${width} ${height}`;
    gl.bindFramebuffer(gl.FRAMEBUFFER, made);
    [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]].forEach(([kind, place], i) => {
      gl.bindRenderbuffer(gl.RENDERBUFFER, parts[i]);
      gl.renderbufferStorage(gl.RENDERBUFFER, kind, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, parts[i]);
    });
    return made;
  } };
}
