// WebGL: a program, and the axes of a view.
"use strict";

// The axes of a view, column by column: turned about the vertical, then tilted.
function axesOf([turn, tilt]) {
  const [s, c, t, u] = [Math.sin(turn), Math.cos(turn), Math.sin(tilt), Math.cos(tilt)];
  return [c, -t * s, u * s, 0, u, t, -s, -t * c, u * c];
}

// A program with some parts and textures, and a function that sets one of its uniforms if it has it.
function program(gl, { vertex, fragment }, parts = [], textures = []) {
  const begin = ["#version 300 es", ...parts.map(part => `#define ${part}`), ""].join("\n");
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, begin + source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  gl.useProgram(made);
  textures.forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(made, name), unit));
  const kinds = Object.fromEntries(Array.from({ length: gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) }, (_, i) => {
    const { name, type } = gl.getActiveUniform(made, i);
    return [name, { at: gl.getUniformLocation(made, name), whole: type === gl.INT || type === gl.BOOL }];
  }));
  return { program: made, set(name, value) {
    if (!(name in kinds)) return;
    const { at, whole } = kinds[name];
    if (whole) gl.uniform1i(at, value);
    else if (value.length === 9) gl.uniformMatrix3fv(at, false, value);
    else if (Array.isArray(value)) gl[`uniform${value.length}fv`](at, value);
    else gl.uniform1f(at, value);
  } };
}
