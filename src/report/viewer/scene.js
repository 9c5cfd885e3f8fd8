// What WebGL draws, in which colours, and where the eye is.

const table = (text) => text.split(" ").map((hex) => [0, 2, 4].map((i) => parseInt(hex.slice(i, i + 2), 16)));
// Evenly spaced to the eye, lighter for more, and safe for colour-blind readers: viridis (matplotlib, CC0).
const SEQUENTIAL = table(
  "440154 470d60 48186a 482374 472d7b 453781 424086 3e4989 3b528b 375b8d 33638d 2f6b8e 2c728e 297a8e 26828e 23898e 21918c 1f988b 1fa088 22a785 28ae80 32b67a 3fbc73 4ec36b 5ec962 70cf57 84d44b 98d83e addc30 c2df23 d8e219 ece51b fde725",
);
// Blue below zero and orange above it, as dark at both ends: straight lines of lightness and chroma in OKLab.
const DIVERGING = table(
  "145cad 2666b1 356fb6 4378ba 5081be 5d8ac3 6a92c7 769bcb 83a4cf 90add2 9db6d6 a9bfda b6c7dd c3d0e1 d1d9e4 dee2e8 ebebeb e6e0dd e1d6cf dccbc1 d7c1b3 d1b7a5 ccac98 c6a28a c1987c bb8d6f b58361 b07954 aa6f46 a46537 9e5b27 975013 914600",
);

/** The colour of t from 0 to 1, components from 0 to 255. */
function colour(map, t) {
  const x = clamp(t, 0, 1) * (map.length - 1),
    i = Math.min(Math.floor(x), map.length - 2);
  return map[i].map((c, k) => Math.round(c + (map[i + 1][k] - c) * (x - i)));
}

const KNOWN = new Map([
  ["support", ["support", "echoes"]],
  ["standard_error_mm", ["standard error", "mm"]],
  ["error_mm", ["error", "mm"]],
  ["signed_error_mm", ["signed error: outside is positive", "mm"]],
  ["residual_mm", ["residual", "mm"]],
  ["radius_mm", ["radius", "mm"]],
  ["frame", ["last frame", "number"]],
]);
const UNITS = { mm2: "mm²", mm: "mm", s: "s", deg: "°", rad: "rad" };

/** The name and unit of an array: known ones have words of their own, others state the unit at their end. */
function described(name) {
  if (KNOWN.has(name)) return KNOWN.get(name);
  const unit = Object.keys(UNITS).find((ending) => name.endsWith(`_${ending}`));
  return unit
    ? [name.slice(0, -unit.length - 1).replaceAll("_", " "), UNITS[unit]]
    : [name.replaceAll("_", " "), ""];
}

/** Round numbers in a range, as texts with as many decimals as they need. */
function ticks(low, high) {
  const rough = (high - low) / 4,
    power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((digit) => digit * power >= rough * (1 - 1e-9));
  const decimals = clamp(-Math.floor(Math.log10(step) + 1e-9), 0, 12),
    found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i += 1) {
    found.push({
      value: i * step,
      text: step >= 1e6 || step < 1e-4 ? (i * step).toExponential(1) : (i * step).toFixed(decimals),
    });
  }
  return found;
}

const WALL_VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in float value;
layout(location = 3) in float supported;
uniform mat4 projection_from_vessel;
out vec3 v_position;
out vec3 v_normal;
out float v_value;
out float v_supported;
void main() {
  v_position = position;
  v_normal = normal;
  v_value = value;
  v_supported = supported;
  gl_Position = projection_from_vessel * vec4(position, 1.0);
}`;

const WALL_FRAGMENT = `#version 300 es
precision highp float;
in vec3 v_position;
in vec3 v_normal;
in float v_value;
in float v_supported;
uniform vec4 clip;             // kept: dot(clip.xyz, position) <= clip.w
uniform vec3 light;            // towards the light
uniform vec2 range;
uniform sampler2D map;
uniform vec3 hatch;
uniform vec3 none;
uniform float pixels;          // of the screen per pixel of the page
uniform int hide_unsupported;
uniform float inside;          // brightness of the wall's inside
out vec4 colour;
void main() {
  if (dot(clip.xyz, v_position) > clip.w) discard;
  // A triangle is measured wall only if all three of its nodes are.
  bool measured = v_supported > 0.9999;
  if (!measured && (hide_unsupported == 1 || mod((gl_FragCoord.x + gl_FragCoord.y) / pixels, 7.0) > 3.0)) discard;
  vec3 paint = hatch;
  // A node without a value has -1e38 instead, which no interpolation hides.
  if (measured) paint = v_value < -1e30 ? none
    : texture(map, vec2(clamp((v_value - range.x) / (range.y - range.x), 0.0, 1.0), 0.5)).rgb;
  vec3 n = normalize(gl_FrontFacing ? v_normal : -v_normal);
  float brightness = 0.52 + 0.48 * max(dot(n, light), 0.0);
  colour = vec4(paint * brightness * (gl_FrontFacing ? 1.0 : inside), 1.0);
}`;

// Lines of a width in pixels: every segment is a rectangle that faces the eye.
const LINE_VERTEX = `#version 300 es
layout(location = 0) in vec3 start;
layout(location = 1) in vec3 end;
layout(location = 2) in vec3 paint;
uniform mat4 projection_from_vessel;
uniform vec2 size;             // of the picture, in pixels
uniform float width;           // in pixels
out vec3 v_paint;
void main() {
  vec4 p = projection_from_vessel * vec4(start, 1.0), q = projection_from_vessel * vec4(end, 1.0);
  // The part before the near plane.
  float a = p.z + p.w, b = q.z + q.w;
  if (a < 0.0 && b > 0.0) p = mix(p, q, a / (a - b));
  if (b < 0.0 && a > 0.0) q = mix(q, p, b / (b - a));
  vec2 d = (q.xy / q.w - p.xy / p.w) * size;
  d = length(d) > 1e-6 ? normalize(d) : vec2(1.0, 0.0);
  vec4 here = gl_VertexID < 2 ? p : q;
  vec2 corner = vec2(-d.y, d.x) * (gl_VertexID % 2 == 0 ? 1.0 : -1.0) + d * (gl_VertexID < 2 ? -0.5 : 0.5);
  here.xy += corner * width / size * here.w;
  here.z -= 0.0005 * here.w;   // in front of the wall that it lies on
  v_paint = paint;
  gl_Position = a < 0.0 && b < 0.0 ? vec4(2.0, 2.0, 2.0, 1.0) : here;
}`;

const LINE_FRAGMENT = `#version 300 es
precision highp float;
in vec3 v_paint;
uniform vec4 tint;             // instead of the segment's own colour, as far as tint.a says
uniform float alpha;
out vec4 colour;
void main() { colour = vec4(mix(v_paint, tint.rgb, tint.a), alpha); }`;

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) {
    const logs = gl.getAttachedShaders(made).map((shader) => gl.getShaderInfoLog(shader));
    throw new Error(`shader: ${[gl.getProgramInfoLog(made), ...logs].join(" ")}`);
  }
  const uniforms = {};
  for (let i = 0; i < (gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) ?? 0); i += 1) {
    const { name } = gl.getActiveUniform(made, i);
    uniforms[name] = gl.getUniformLocation(made, name);
  }
  return { made, uniforms };
}

/** A buffer on the device that follows a growing array. */
class DeviceArray {
  constructor(gl, target) {
    [this.gl, this.target, this.buffer, this.length] = [gl, target, gl.createBuffer(), -1];
  }

  /** Takes elements `from` up to `to` of an array; all of it where the array has grown. */
  update(array, from, to) {
    const { gl, target } = this;
    gl.bindBuffer(target, this.buffer);
    if (array.length !== this.length) {
      gl.bufferData(target, array, gl.DYNAMIC_DRAW);
      this.length = array.length;
    } else if (to > from) {
      gl.bufferSubData(target, from * array.BYTES_PER_ELEMENT, array, from, to - from);
    }
  }
}

/** Everything on the device, and one function that draws it. */
class Scene {
  constructor(gl) {
    this.gl = gl;
    this.wall = program(gl, WALL_VERTEX, WALL_FRAGMENT);
    this.line = program(gl, LINE_VERTEX, LINE_FRAGMENT);
    this.wallArrays = gl.createVertexArray();
    gl.bindVertexArray(this.wallArrays);
    this.attributes = [3, 3, 1, 1].map((size, location) => {
      const array = new DeviceArray(gl, gl.ARRAY_BUFFER);
      gl.bindBuffer(gl.ARRAY_BUFFER, array.buffer);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, size, gl.FLOAT, false, 0, 0);
      return array;
    });
    this.indices = gl.createBuffer();
    this.indexedRings = 0;
    this.lines = ["path", "marks"].reduce((all, name) => ({ ...all, [name]: this.newLines() }), {});
    this.map = gl.createTexture();
    gl.bindVertexArray(null);
  }

  newLines() {
    const { gl } = this,
      arrays = gl.createVertexArray(),
      buffer = new DeviceArray(gl, gl.ARRAY_BUFFER);
    gl.bindVertexArray(arrays);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer.buffer);
    for (let location = 0; location < 3; location += 1) {
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 3, gl.FLOAT, false, 36, 12 * location);
      gl.vertexAttribDivisor(location, 1);
    }
    return { arrays, buffer, count: 0 };
  }

  /** Takes rings `from` up to `to` of the vessel, or all of a mesh. */
  setWall(vessel, from, to) {
    const { gl } = this,
      N = vessel.isGrid ? vessel.nodes : 1;
    if (!vessel.isGrid) [from, to] = [0, vessel.count];
    for (const [location, array, size] of [
      [0, vessel.positions, 3],
      [1, vessel.normals, 3],
      [3, vessel.supported, 1],
    ]) {
      this.attributes[location].update(array, from * N * size, to * N * size);
    }
    gl.bindVertexArray(this.wallArrays);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indices);
    if (!vessel.isGrid) {
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, vessel.triangles, gl.STATIC_DRAW);
    } else if (vessel.rings > this.indexedRings || this.indexedSeams !== [...vessel.seams].join()) {
      if (vessel.rings > this.indexedRings) this.indexedRings = Math.max(vessel.rings, 2 * this.indexedRings);
      this.indexedSeams = [...vessel.seams].join();
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, vessel.indices(0, this.indexedRings - 1), gl.STATIC_DRAW);
    }
    gl.bindVertexArray(null);
    this.wallCount = 3 * vessel.triangleCount;
  }

  /** A vessel that begins anew has other nodes per ring. */
  forget() {
    this.indexedRings = 0;
    this.wallCount = 0;
    this.attributes.forEach((array) => {
      array.length = -1;
    });
  }

  /** Takes the values that are shown in colours, NO_VALUE for NaN. */
  setValues(values, count) {
    this.attributes[2].update(values, 0, count);
  }

  /** Segments: 9 numbers each, both ends and a colour. */
  setLines(name, numbers) {
    const lines = this.lines[name];
    lines.buffer.length = -1;
    lines.buffer.update(Float32Array.from(numbers));
    lines.count = numbers.length / 9;
  }

  setColours(map) {
    const { gl } = this,
      texels = new Uint8Array(4 * 256);
    for (let i = 0; i < 256; i += 1) texels.set([...colour(map, i / 255), 255], 4 * i);
    gl.bindTexture(gl.TEXTURE_2D, this.map);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, texels);
    for (const [name, value] of [
      ["MIN_FILTER", "LINEAR"],
      ["MAG_FILTER", "LINEAR"],
      ["WRAP_S", "CLAMP_TO_EDGE"],
      ["WRAP_T", "CLAMP_TO_EDGE"],
    ]) {
      gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], gl[value]);
    }
  }

  draw(look) {
    const { gl, wall, line } = this,
      { width, height } = gl.canvas;
    gl.viewport(0, 0, width, height);
    gl.clearColor(...look.paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.disable(gl.BLEND);
    if (this.wallCount > 0) {
      gl.useProgram(wall.made);
      const u = wall.uniforms;
      gl.uniformMatrix4fv(u.projection_from_vessel, false, look.matrix);
      gl.uniform4fv(u.clip, look.clip);
      gl.uniform3fv(u.light, look.light);
      gl.uniform2fv(u.range, look.range);
      gl.uniform3fv(u.hatch, look.hatch);
      gl.uniform3fv(u.none, look.none);
      gl.uniform1f(u.pixels, look.pixels);
      gl.uniform1f(u.inside, look.inside);
      gl.uniform1i(u.hide_unsupported, Number(look.hideUnsupported));
      gl.bindTexture(gl.TEXTURE_2D, this.map);
      gl.bindVertexArray(this.wallArrays);
      gl.drawElements(gl.TRIANGLES, this.wallCount, gl.UNSIGNED_INT, 0);
    }
    gl.useProgram(line.made);
    gl.uniformMatrix4fv(line.uniforms.projection_from_vessel, false, look.matrix);
    gl.uniform2f(line.uniforms.size, width / 2, height / 2);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    // First faintly through the wall, then where nothing is in front, with an edge that shows on every colour.
    // Only
    // the wall hides lines: an edge must not hide the line that it belongs to.
    gl.depthMask(false);
    const pass = (name, width, alpha, tint, hidden) => {
      const { arrays, count } = this.lines[name];
      if (!count) return;
      (hidden ? gl.disable : gl.enable).call(gl, gl.DEPTH_TEST);
      gl.uniform1f(line.uniforms.width, width * look.pixels);
      gl.uniform1f(line.uniforms.alpha, alpha);
      gl.uniform4f(line.uniforms.tint, ...look.paper, tint);
      gl.bindVertexArray(arrays);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    };
    // From within the vessel, the jitter of a tracked path would fill the picture.
    for (const [name, size] of [...(look.path ? [["path", 1.6]] : []), ["marks", 3]]) {
      pass(name, size, 0.6, 0, true);
      pass(name, size + 2, 1, 1, false);
      pass(name, size, 1, 0, false);
    }
    gl.depthMask(true);
    gl.bindVertexArray(null);
  }
}

/** In place of NaN, which shaders cannot be trusted with. */
const NO_VALUE = -1e38;

const FIELD_OF_VIEW = (30 * Math.PI) / 180,
  FLIGHT_FIELD_OF_VIEW = (75 * Math.PI) / 180;

/** Where the eye is and where it looks. Rows of `turn`: right, up, and towards the eye. */
class Eye {
  constructor() {
    this.turn = [
      [1, 0, 0],
      [0, 0, 1],
      [0, -1, 0],
    ];
    this.target = [0, 0, 0];
    this.distance = 100;
    this.follow = true;
    this.flight = null;
  }

  get field() {
    return this.flight ? FLIGHT_FIELD_OF_VIEW : FIELD_OF_VIEW;
  }
  get place() {
    return this.flight ? this.target : plus(this.target, this.turn[2], this.distance);
  }

  /** Turns about the screen's axes, in radians. */
  rotate(right, up) {
    const about = (axis, angle) => {
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      this.turn = this.turn.map((v) =>
        plus(plus(times(v, c), cross(axis, v), s), axis, dot(axis, v) * (1 - c)),
      );
    };
    about(this.turn[1], -right);
    about(this.turn[0], -up);
    const [x, y] = [
      unit(this.turn[0]),
      unit(minus(this.turn[1], times(this.turn[0], dot(this.turn[0], this.turn[1])))),
    ];
    this.turn = [x, y, cross(x, y)];
  }

  move(right, up) {
    this.target = plus(plus(this.target, this.turn[0], -right), this.turn[1], -up);
    this.follow = false;
  }

  zoom(factor) {
    this.distance = clamp(this.distance * factor, 1e-3, 1e6);
    this.follow = false;
  }

  /** All points in the picture, of the given width over height, with a margin for legend and axes. */
  fit(points, count, aspect) {
    const low = [Infinity, Infinity, Infinity],
      high = [-Infinity, -Infinity, -Infinity];
    for (let i = 0; i < count; i += 1) {
      for (let axis = 0; axis < 3; axis += 1) {
        const v =
          points[3 * i] * this.turn[axis][0] +
          points[3 * i + 1] * this.turn[axis][1] +
          points[3 * i + 2] * this.turn[axis][2];
        if (v < low[axis]) low[axis] = v;
        if (v > high[axis]) high[axis] = v;
      }
    }
    if (!(high[0] >= low[0])) return;
    const middle = low.map((v, i) => (v + high[i]) / 2);
    this.target = this.turn.reduce((sum, v, i) => plus(sum, v, middle[i]), [0, 0, 0]);
    const half = high.map((v, i) => (v - low[i]) / 2),
      tangent = Math.tan(FIELD_OF_VIEW / 2);
    this.distance = half[2] + (1.12 * Math.max(half[1], half[0] / aspect, 1e-3)) / tangent;
  }

  /**
   * From the vessel's coordinates to the screen's, column by column. `centre` and `radius`: of all that may be
   * seen.
   */
  matrix(aspect, centre, radius) {
    const [right, up, back] = this.turn,
      eye = this.place;
    const depth = dot(minus(eye, centre), back);
    const far = Math.max(depth + 1.05 * radius, 1e-2),
      near = Math.max(depth - 1.05 * radius, far * (this.flight ? 2e-4 : 2e-3));
    const f = 1 / Math.tan(this.field / 2),
      a = (far + near) / (near - far),
      b = (2 * far * near) / (near - far);
    const rows = [
      [times(right, f / aspect), 0],
      [times(up, f), 0],
      [times(back, a), b],
      [times(back, -1), 0],
    ];
    const full = rows.map(([v, offset]) => [...v, offset - dot(v, eye)]);
    return Float32Array.from([0, 1, 2, 3].flatMap((column) => full.map((row) => row[column])));
  }

  /** The direction from the eye through a point of the screen, both from -1 to 1. */
  ray(x, y, aspect) {
    const t = Math.tan(this.field / 2),
      [right, up, back] = this.turn;
    return unit(plus(plus(times(back, -1), right, x * t * aspect), up, y * t));
  }
}
