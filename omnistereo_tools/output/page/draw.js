// WebGL: the panorama as it is seen from the rig, and its points or surfaces from anywhere.
"use strict";

// Two rays show one surface if their depths differ by less, or by at most so many spheres: as in mesh_export.py.
const EDGE = 1.2, STEP = 1.5;
const sameSurface = (a, b) => Math.max(a, b) <= EDGE * Math.min(a, b) || Math.abs(a - b) <= STEP * perSphere;

const SHADE = `#version 300 es
precision highp float;
uniform sampler2D picture, colors;
uniform highp sampler2D rays;  // of each ray: inverse depth in 1/m, the exact one, trust; -1 is unknown
uniform vec2 size, range;      // columns and rows of the rays; inverse depths at the ends of the colours
uniform vec3 paper;
uniform float mixed, least, doubtful, perPercent, edge;
uniform int layer;             // 0 estimate, 1 exact, 2 error
uniform bool naming;           // write the number of the ray in place of its colour
out vec4 color;

// The four rays around a place, each with its share of it.
struct Four { vec4 ray[4]; float share[4]; vec2 corner; };

Four around(vec2 at) {
  vec2 part = fract(at - 0.5);
  Four four;
  four.corner = floor(at - 0.5);
  for (int i = 0; i < 4; i++) {
    vec2 beside = vec2(i & 1, i >> 1), ray = four.corner + beside, weight = mix(1.0 - part, part, beside);
    four.share[i] = weight.x * weight.y;
    four.ray[i] = texelFetch(rays, ivec2(mod(ray.x, size.x), clamp(ray.y, 0.0, size.y - 1.0)), 0);
  }
  return four;
}

// Of what a place shows: values of the near and of the far surface there, and how much of the near one. At an edge in
// depth a ray whose colour is that of the place counts more, so that rims follow the edges of the picture.
vec3 surfaces(Four four, int at, vec3 here) {
  float low = 1e9, high = -1e9;
  for (int i = 0; i < 4; i++) { low = min(low, four.ray[i][at]); high = max(high, four.ray[i][at]); }
  bool one = high <= ${EDGE} * low || high - low <= edge;
  vec2 near = vec2(0), far = vec2(0);
  for (int i = 0; i < 4; i++) {
    float value = layer == 0 ? four.ray[i].x : layer == 1 ? four.ray[i].y
      : four.ray[i].y < 0.0 ? -1.0 : abs(four.ray[i].x - four.ray[i].y);
    float share = four.share[i];
    if (!one) {
      vec3 off = textureLod(picture, (four.corner + vec2(i & 1, i >> 1) + 0.5) / size, 0.0).rgb - here;
      share = max(share, 1e-4) * exp(-30.0 * dot(off, off));
    }
    if (one || four.ray[i][at] > 0.5 * (low + high)) near += share * vec2(value, 1); else far += share * vec2(value, 1);
  }
  float share = one ? 1.0 : near.y / (near.y + far.y);
  return vec3(near.x / max(near.y, 1e-6), far.x / max(far.y, 1e-6), share);
}

vec3 inColors(float value) {
  if (value < 0.0) return vec3(0.7);
  float scaled = layer == 2 ? value * perPercent : (value - range.x) / (range.y - range.x);
  return texture(colors, vec2(clamp(scaled, 0.002, 0.998), 0.5)).rgb;
}

// The colour of a place, in rays, and how far it is there: doubtful parts fade.
vec4 shade(vec2 at, vec2 dx, vec2 dy, bool fades) {
  vec3 seen = textureGrad(picture, at / size, dx / size, dy / size).rgb;
  if (!fades && mixed == 0.0 && least == 0.0) return vec4(seen, 1);
  Four four = around(at);
  float trust = 0.0;
  for (int i = 0; i < 4; i++) trust += four.share[i] * four.ray[i].z;
  float doubt = 1.0 - smoothstep(doubtful - 0.1, doubtful + 0.1, trust);
  if (mixed > 0.0) {
    vec3 found = surfaces(four, layer == 1 ? 1 : 0, seen);
    vec3 depth = mix(inColors(found.y), inColors(found.x), smoothstep(0.3, 0.7, found.z));
    seen = mix(seen, mix(depth, vec3(0.5), 0.65 * doubt), mixed);
  }
  if (fades) seen = mix(seen, paper, 0.4 * doubt);
  float shown = least > 0.0 ? smoothstep(least - 0.08, least + 0.01, trust) : 1.0;
  return vec4(mix(paper, seen, shown), shown);
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
  vertex: `#version 300 es
    void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }`,
  fragment: SHADE + `
    uniform vec2 view, turn, phi;  // pixels; azimuth and tilt; first and last elevation
    uniform float focal;           // pixels per radian
    uniform bool whole;
    void main() {
      vec2 p = (gl_FragCoord.xy - 0.5 * view) / focal * vec2(1, -1), angles;
      if (whole) angles = p + turn + vec2(0, 0.5 * (phi.x + phi.y));
      else {
        float theta = 2.0 * atan(p.x / 2.0), up = atan(p.y * (1.0 + cos(theta)) / 2.0);
        vec3 d = vec3(cos(up) * sin(theta), sin(up), cos(up) * cos(theta));
        d.yz = vec2(d.y * cos(turn.y) + d.z * sin(turn.y), d.z * cos(turn.y) - d.y * sin(turn.y));
        angles = vec2(atan(d.x, d.z) + turn.x, atan(d.y, length(d.xz)));
      }
      vec2 at = vec2(angles.x / 6.283185307 + 0.5, (angles.y - phi.x) / (phi.y - phi.x)) * size;
      at.x = mod(at.x, size.x);
      vec2 dx = dFdx(at), dy = dFdy(at);
      // Across the seam, neighbours are a whole turn apart.
      dx.x -= size.x * round(dx.x / size.x);
      dy.x -= size.x * round(dy.x / size.x);
      bool inside = at.y >= 0.0 && at.y <= size.y;
      if (naming) color = inside ? name(at) : vec4(0);
      else color = inside ? vec4(shade(at, dx, dy, false).rgb, 1) : vec4(paper, 1);
    }`,
};

// From anywhere: a vertex is a place in rays and an inverse depth, so that what is infinitely far has one, too.
const OUTSIDE = {
  vertex: `#version 300 es
    layout(location = 0) in vec2 ray;        // column and row
    layout(location = 1) in vec4 direction;  // and the inverse depth along it
    layout(location = 2) in float fringe;    // 0: opaque; at an edge in depth 1 the near side, 2 the far side
    uniform vec2 view;
    uniform mat3 axes;
    uniform float focal, behind, pointSize, nearest;
    out vec2 at;
    out float rim;
    void main() {
      at = ray;
      rim = fringe;
      vec3 d = axes * direction.xyz + vec3(0, 0, direction.w * behind);
      gl_Position = vec4(2.0 * focal / view * vec2(d.x, -d.y), d.z - 2.0 * 0.02 * behind * direction.w, d.z);
      gl_PointSize = clamp(pointSize * focal / d.z, 1.0, 40.0);
      if (pointSize > 0.0 && direction.w < nearest) gl_Position = vec4(2, 2, 2, 1);
    }`,
  fragment: SHADE + `
    in vec2 at;
    in float rim;
    void main() {
      if (naming && rim < 0.5) { color = name(at); return; }
      vec4 shown = shade(at, dFdx(at), dFdy(at), true);
      float alpha = shown.a;
      if (rim > 0.5) {
        // Each side ends within a ray; where they meet, both are whole, so that nothing shines through.
        float share = surfaces(around(at), 0, textureLod(picture, at / size, 0.0).rgb).z;
        alpha *= rim < 1.5 ? smoothstep(0.0, 0.5, share) : 1.0 - smoothstep(0.5, 1.0, share);
      }
      if (alpha < (naming ? 0.5 : 0.02)) discard;
      color = naming ? name(at) : vec4(shown.rgb, alpha);
    }`,
};

// Vertices (column, row, direction, inverse depth, fringe) and triangles. Rays are at half columns and rows; the first and the last
// row reach the rim of the panorama, and one column more closes the circle.
function makeMesh(known) {
  const across = D.width + 1, rows = D.height + 2, vertices = [], opaque = [], fringes = [[], []];
  const rayAt = (column, row) => clamp(row - 1, 0, D.height - 1) * D.width + column % D.width;
  for (let row = 0; row < rows; row++)
    for (let column = 0; column < across; column++)
      vertices.push(...vertexOf(column + 0.5, clamp(row - 0.5, 0, D.height), inverse(rayAt(column, row)) || 0, 0));
  for (let row = 0; row + 1 < rows; row++)
    for (let column = 0; column < D.width; column++) {
      const places = [[0, 0], [1, 0], [0, 1], [1, 1]].map(([right, down]) => [column + right, row + down]);
      const four = places.map(([x, y]) => rayAt(x, y));
      if (!four.every(known)) continue;
      const depths = four.map(k => inverse(k)), low = Math.min(...depths), high = Math.max(...depths);
      const corners = places.map(([x, y]) => y * across + x);
      if (sameSurface(low, high)) opaque.push(...twoTriangles(corners));
      else {
        // An edge in depth: both surfaces go on for a ray, one before the other.
        const near = depths.map(depth => sameSurface(depth, high));
        const far = depths.map((depth, i) => !near[i] && sameSurface(depth, low));
        fringes[0].push(...twoTriangles(extended(vertices, corners, far, 2)));
        fringes[1].push(...twoTriangles(extended(vertices, corners, near, 1)));
      }
    }
  return { vertices: Float32Array.from(vertices), opaque: Uint32Array.from(opaque), fringe: Uint32Array.from(fringes.flat()) };
}

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

// The axes of a view, column by column: turned about the vertical, then tilted.
function axesOf([turn, tilt]) {
  const [s, c, t, u] = [Math.sin(turn), Math.cos(turn), Math.sin(tilt), Math.cos(tilt)];
  return [c, -t * s, u * s, 0, u, t, -s, -t * c, u * c];
}

// A renderer on a canvas, or nothing without WebGL 2.
function makeRenderer(canvas, picture, mesh) {
  const gl = canvas.getContext("webgl2", { antialias: false, alpha: false });
  if (!gl) return null;
  const inside = program(gl, INSIDE), outside = program(gl, OUTSIDE), surface = upload(gl, mesh);
  const textures = [pictureTexture(gl, picture), colorTexture(gl), rayTexture(gl)];
  const target = namesTarget(gl);
  let named = null;  // the view whose names are in the target

  function render(view, settings) {
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...settings.paper, 1);
    if (settings.naming) gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const used = view.mode === "look" || view.mode === "flat" ? inside : outside;
    gl.useProgram(used.program);
    textures.forEach((texture, unit) => { gl.activeTexture(gl.TEXTURE0 + unit); gl.bindTexture(gl.TEXTURE_2D, texture); });
    const values = {
      size: [D.width, D.height], range: [D.low, D.high], phi: D.phi, doubtful: D.doubtful / 100,
      perPercent: D.percent / 10, edge: STEP * perSphere, view: [canvas.width, canvas.height],
      axes: axesOf(view.turn), nearest: 1 / D.maxDepth, whole: view.mode === "flat",
      pointSize: view.mode === "points" ? 1.6 * 2 * Math.PI / D.width : 0, ...settings, ...view,
    };
    for (const [name, value] of Object.entries(values)) used.set(name, value);
    if (used === inside) gl.drawArrays(gl.TRIANGLES, 0, 3);
    else drawMesh(view.mode);
  }

  function drawMesh(mode) {
    gl.bindVertexArray(surface);
    gl.enable(gl.DEPTH_TEST);
    if (mode === "points") gl.drawArrays(gl.POINTS, 0, (D.width + 1) * (D.height + 2));
    else {
      gl.enable(gl.CULL_FACE);
      gl.frontFace(gl.CW);
      gl.drawElements(gl.TRIANGLES, mesh.opaque.length, gl.UNSIGNED_INT, 0);
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
      gl.drawElements(gl.TRIANGLES, mesh.fringe.length, gl.UNSIGNED_INT, 4 * mesh.opaque.length);
      gl.disable(gl.BLEND);
      gl.disable(gl.CULL_FACE);
    }
    gl.disable(gl.DEPTH_TEST);
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

  return { draw: (view, settings) => render(view, { ...settings, naming: false }), names };
}

// A program, and a function that sets one of its uniforms if it has it.
function program(gl, { vertex, fragment }) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  gl.useProgram(made);
  ["picture", "colors", "rays"].forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(made, name), unit));
  const kinds = Object.fromEntries(Array.from({ length: gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) }, (_, i) => {
    const { name, type } = gl.getActiveUniform(made, i);
    return [name, { at: gl.getUniformLocation(made, name), whole: type === gl.INT || type === gl.BOOL }];
  }));
  return { program: made, set(name, value) {
    if (!(name in kinds)) return;
    const { at, whole } = kinds[name];
    if (whole) gl.uniform1i(at, value);
    else if (name === "axes") gl.uniformMatrix3fv(at, false, value);
    else if (Array.isArray(value)) gl[`uniform${value.length}fv`](at, value);
    else gl.uniform1f(at, value);
  } };
}

function upload(gl, { vertices, opaque, fringe }) {
  const made = gl.createVertexArray();
  gl.bindVertexArray(made);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.STATIC_DRAW);
  [[2, 0], [4, 2], [1, 6]].forEach(([count, first], place) => {
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, count, gl.FLOAT, false, 4 * FLOATS, 4 * first);
  });
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint32Array.from([...opaque, ...fringe]), gl.STATIC_DRAW);
  gl.bindVertexArray(null);
  return made;
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

function rayTexture(gl) {
  const made = texture(gl, gl.REPEAT, gl.NEAREST), values = new Float32Array(4 * steps.length);
  const orUnknown = value => Number.isNaN(value) ? -1 : value;
  for (let k = 0; k < steps.length; k++)
    values.set([orUnknown(inverse(k)), truth ? orUnknown(inverse(k, truth)) : -1, trust[k] / 100, 0], 4 * k);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, D.width, D.height, 0, gl.RGBA, gl.FLOAT, values);
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
