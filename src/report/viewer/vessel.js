// What is known: the wall, and the frames of the recording.

/** Bytes of a base64 text. */
function bytes(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/**
 * Little-endian numbers of 4 bytes, as every browser's processor has them; `count` of them, or as many as there
 * are.
 */
function numbers(Kind, text, what, count) {
  if (typeof text !== "string") throw new Error(`${what}: found ${typeof text}, expected base64`);
  let raw;
  try {
    raw = bytes(text);
  } catch {
    throw new Error(`${what}: found a text that is not base64`);
  }
  if (raw.length % 4 || (count !== undefined && raw.length !== 4 * count)) {
    const expected = count === undefined ? "a multiple of 4" : `${4 * count}`;
    throw new Error(`${what}: found ${raw.length} bytes, expected ${expected}`);
  }
  return new Kind(raw.buffer, raw.byteOffset, raw.length / 4);
}
const floats = (text, what, count) => numbers(Float32Array, text, what, count);

/** A whole number that is not negative; 0 where it is absent. */
function whole(value, what) {
  if (value === undefined || value === null) return 0;
  if (!Number.isSafeInteger(value) || value < 0)
    throw new Error(`${what}: found ${value}, expected a whole number`);
  return value;
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** a + t b */
const plus = (a, b, t = 1) => [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]];
const times = (a, t) => [a[0] * t, a[1] * t, a[2] * t];
const norm = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => times(a, 1 / (norm(a) || 1));
const at = (array, i) => [array[3 * i], array[3 * i + 1], array[3 * i + 2]];
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const median = (values) => {
  const sorted = Float64Array.from(values).sort();
  const middle = sorted.length >> 1;
  return sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2;
};

/** Any direction across a unit vector, and the one across both. */
function across(normal) {
  const least = normal.map(Math.abs).indexOf(Math.min(...normal.map(Math.abs)));
  const first = unit(
    cross(
      normal,
      [0, 1, 2].map((i) => Number(i === least)),
    ),
  );
  return [first, cross(normal, first)];
}

/** Room for more numbers: an array at least twice as long with the same content, or the same one. */
function roomFor(array, length) {
  if (array.length >= length) return array;
  const larger = new array.constructor(Math.max(length, 2 * array.length));
  larger.set(array);
  return larger;
}

/**
 * The wall: a grid of `rings` rings of `nodes` nodes, or any triangle mesh (`nodes` is 0).
 *
 * Positions are kept as seen from `origin`, the first node: so far from the origin of the world as a tracker
 * may be,
 * f32 would be coarse for the graphics. Arrays are longer than what they hold, so that rings can be added.
 */
class Vessel {
  constructor(json) {
    this.title = typeof json.title === "string" ? json.title : "";
    this.nodes = whole(json.nodes, "nodes");
    this.rings = whole(json.rings, "rings");
    this.maxFrameDistance = json.max_frame_distance_mm ?? undefined;
    const isGrid = json.triangles === undefined;
    const all =
      json.positions_mm === undefined
        ? new Float32Array(0)
        : floats(json.positions_mm, "positions_mm", isGrid ? 3 * this.nodes * this.rings : undefined);
    if (all.length % 3) throw new Error(`positions_mm: found ${all.length} numbers, expected three per node`);
    this.count = all.length / 3;
    this.origin = this.count ? at(all, 0).map((x) => (Number.isFinite(x) ? x : 0)) : undefined;
    this.positions = this.seen(all);
    this.arrays = new Map();
    for (const [name, text] of Object.entries(json.arrays ?? {})) {
      this.arrays.set(name, floats(text, name, this.count));
    }
    this.names = [...this.arrays.keys()];
    this.triangles = null;
    if (!isGrid) {
      this.nodes = this.rings = 0;
      this.triangles = numbers(Uint32Array, json.triangles, "triangles");
      if (this.triangles.length % 3) throw new Error("triangles: expected three nodes each");
      const largest = this.triangles.reduce((a, b) => Math.max(a, b), 0);
      if (this.triangles.length && largest >= this.count) {
        throw new Error(`triangles: found node ${largest}, expected less than ${this.count}`);
      }
    }
    this.normals = new Float32Array(this.positions.length);
    this.supported = new Float32Array(this.count);
    this.givenAxis = json.axis_mm === undefined ? null : this.seen(floats(json.axis_mm, "axis_mm"));
    this.middles = new Float32Array(3 * this.rings);
    this.seams = new Set();
    if (isGrid && !this.arrays.has("radius_mm")) this.arrays.set("radius_mm", new Float32Array(this.count));
    this.derive(0, isGrid ? this.rings : this.count);
  }

  get isGrid() {
    return this.triangles === null;
  }

  /** World coordinates as seen from the origin. */
  seen(world) {
    this.origin ??= world.length ? at(world, 0) : undefined;
    const o = this.origin ?? [0, 0, 0];
    return world.map((x, i) => x - o[i % 3]);
  }

  /**
   * Takes the members of a `change`. Everything is checked before anything is changed.
   * Returns the rings that are different now, as [from, to], or null.
   */
  change(json) {
    const before = whole(json.before, "before");
    const rings = json.rings === undefined ? this.rings + before : whole(json.rings, "rings");
    if (!this.isGrid || (this.nodes === 0 && rings > 0))
      throw new Error("a change of a vessel that has no rings");
    const parts = (json.changed ?? []).map((part) => {
      const from = whole(part.from, "from"),
        to = whole(part.to, "to");
      if (from > to || to > rings) throw new Error(`rings: found ${from} to ${to}, expected up to ${rings}`);
      const count = (to - from) * this.nodes;
      const arrays = this.names.map((name) => [name, floats(part.arrays?.[name], name, count)]);
      return { from, to, positions: floats(part.positions_mm, "positions_mm", 3 * count), arrays };
    });
    const N = this.nodes,
      old = Math.min(this.rings + before, rings);
    const sized = (array, perRing) => {
      const room = roomFor(array, perRing * rings);
      if (before) room.copyWithin(perRing * before, 0, perRing * Math.max(0, old - before));
      return room;
    };
    this.positions = sized(this.positions, 3 * N);
    this.normals = sized(this.normals, 3 * N);
    this.supported = sized(this.supported, N);
    this.middles = sized(this.middles, 3);
    for (const [name, array] of this.arrays) this.arrays.set(name, sized(array, N));
    let [from, to] = before ? [0, rings] : [Math.min(this.rings, rings), rings];
    // A ring that was announced and did not come is shown as nothing, not as what lay in memory.
    this.positions.fill(NaN, 3 * N * old, 3 * N * rings);
    if (before) this.positions.fill(NaN, 0, 3 * N * Math.min(before, rings));
    [this.rings, this.count] = [rings, rings * N];
    for (const part of parts) {
      this.positions.set(this.seen(part.positions), 3 * N * part.from);
      for (const [name, values] of part.arrays) this.arrays.get(name).set(values, N * part.from);
      from = Math.min(from, part.from);
      to = Math.max(to, part.to);
    }
    // Without new rings, `to` would be the end of the vessel although only a part of it changed.
    if (!before && old === rings && parts.length) to = Math.max(...parts.map((part) => part.to));
    return from < to ? this.derive(from, to) : null;
  }

  /**
   * What follows from positions and arrays, of rings `from` up to `to`. Normals of the rings beside them change
   * too.
   */
  derive(from, to) {
    const N = this.nodes,
      p = this.positions;
    const flags = this.names.includes("supported") ? this.arrays.get("supported") : null;
    const echoes = this.arrays.get("support");
    const [first, last] = this.isGrid ? [from * N, to * N] : [0, this.count];
    for (let i = first; i < last; i += 1) {
      const known = Number.isFinite(p[3 * i] + p[3 * i + 1] + p[3 * i + 2]);
      this.supported[i] = Number(known && (flags ? flags[i] > 0.5 : echoes ? echoes[i] > 0 : true));
    }
    if (!this.isGrid) {
      this.meshNormals();
      return [0, 0];
    }
    for (let k = from; k < to; k += 1) {
      for (let axis = 0; axis < 3; axis += 1) {
        let sum = 0;
        for (let i = 3 * k * N + axis; i < 3 * (k + 1) * N; i += 3) sum += p[i];
        this.middles[3 * k + axis] = sum / N;
      }
    }
    if (!this.names.includes("radius_mm")) {
      const radius = this.arrays.get("radius_mm");
      for (let i = first; i < last; i += 1)
        radius[i] = norm(minus(at(p, i), at(this.middles, Math.floor(i / N))));
    }
    this.findSeams();
    [from, to] = [Math.max(from - 1, 0), Math.min(to + 1, this.rings)];
    for (let k = from; k < to; k += 1) {
      const low = (this.seams.has(k - 1) ? k : Math.max(k - 1, 0)) * N,
        high = (this.seams.has(k) ? k : Math.min(k + 1, this.rings - 1)) * N;
      for (let j = 0; j < N; j += 1) {
        const [next, last] = [k * N + ((j + 1) % N), k * N + ((j + N - 1) % N)];
        const around = minus(at(p, next), at(p, last)),
          along = minus(at(p, high + j), at(p, low + j));
        this.normals.set(unit(cross(around, along)), 3 * (k * N + j));
      }
    }
    return [from, to];
  }

  /** The rings after which another branch begins: nothing lies between such a ring and the next. */
  findSeams() {
    const branch = this.names.includes("branch") ? this.arrays.get("branch") : null,
      N = this.nodes;
    this.seams = new Set();
    for (let k = 0; branch && k + 1 < this.rings; k += 1)
      if (branch[k * N] !== branch[(k + 1) * N]) this.seams.add(k);
  }

  meshNormals() {
    const { positions: p, normals, triangles } = this;
    normals.fill(0);
    for (let t = 0; t < triangles.length; t += 3) {
      const a = at(p, triangles[t]);
      const n = cross(minus(at(p, triangles[t + 1]), a), minus(at(p, triangles[t + 2]), a));
      for (let i = t; i < t + 3; i += 1) for (let c = 0; c < 3; c += 1) normals[3 * triangles[i] + c] += n[c];
    }
  }

  /** The nodes of the triangles between rings, from triangle 6·N·from on; of a mesh all. */
  indices(from, to) {
    if (!this.isGrid) return this.triangles;
    const N = this.nodes,
      all = new Uint32Array(6 * N * Math.max(0, to - from));
    let at = 0;
    for (let k = from; k < to; k += 1) {
      for (let j = 0; j < N; j += 1) {
        const a = k * N + j,
          b = k * N + ((j + 1) % N);
        // Triangles of a seam are a point each, and nothing is seen of them.
        all.set(this.seams.has(k) ? [a, a, a, a, a, a] : [a, b, b + N, a, b + N, a + N], at);
        at += 6;
      }
    }
    return all;
  }

  get triangleCount() {
    return this.isGrid ? 2 * this.nodes * Math.max(0, this.rings - 1) : this.triangles.length / 3;
  }

  /** The nodes of triangle t. */
  corners(t) {
    if (!this.isGrid) return [this.triangles[3 * t], this.triangles[3 * t + 1], this.triangles[3 * t + 2]];
    const N = this.nodes,
      face = t >> 1,
      k = Math.floor(face / N),
      j = face % N;
    const a = k * N + j,
      b = k * N + ((j + 1) % N);
    if (this.seams.has(k)) return [a, a, a];
    return t & 1 ? [a, b + N, a + N] : [a, b, b + N];
  }

  /**
   * The axis as points from the origin: the middles of the rings, or what was given; null where neither is
   * there.
   */
  get axis() {
    if (this.isGrid && this.rings > 1) return this.middles.subarray(0, 3 * this.rings);
    return this.givenAxis?.length > 3 ? this.givenAxis : null;
  }

  get axisLength() {
    const axis = this.axis;
    let sum = 0;
    for (let i = 1; axis && i < axis.length / 3; i += 1)
      if (!this.isGrid || !this.seams.has(i - 1)) sum += norm(minus(at(axis, i), at(axis, i - 1))) || 0;
    return sum;
  }

  /** The place on the axis that is nearest to a point: its index and the direction there. */
  nearestOnAxis(point) {
    const axis = this.axis;
    if (!axis) return null;
    let best = -1,
      least = Infinity;
    for (let i = 0; i < axis.length; i += 3) {
      const d = (axis[i] - point[0]) ** 2 + (axis[i + 1] - point[1]) ** 2 + (axis[i + 2] - point[2]) ** 2;
      if (d < least) [best, least] = [i / 3, d];
    }
    return best < 0 ? null : { index: best, direction: this.directionAt(best) };
  }

  directionAt(index) {
    const last = this.axis.length / 3 - 1;
    const low = clamp(Math.floor(index) - 1, 0, last),
      high = clamp(Math.ceil(index) + 1, 0, last);
    return unit(minus(at(this.axis, high), at(this.axis, low)));
  }

  /**
   * The advance of the probe from frame to frame, in mm, beyond which rings between them have no echoes of
   * their own.
   */
  get frameDistanceLimit() {
    if (this.maxFrameDistance !== undefined) return this.maxFrameDistance;
    if (!this.isGrid || this.rings < 2) return undefined;
    const step = Math.ceil((this.rings - 1) / 2000),
      distances = [];
    for (let k = 1; k < this.rings; k += step)
      if (!this.seams.has(k - 1)) distances.push(norm(minus(at(this.middles, k), at(this.middles, k - 1))));
    return 2 * median(distances.filter(Number.isFinite));
  }
}

/** Frames that the page keeps; of more, the oldest are forgotten. */
const MAX_FRAMES = 20000;

/** The recording's frames, as far as they were sent. */
class Frames {
  constructor() {
    this.list = [];
    this.current = -1;
    this.follow = true;
  }

  /** Adds a frame, with its advance along the vessel since the one before. */
  add(json, vessel) {
    const frame = {
      number: whole(json.number, "frame number"),
      time: json.time_s ?? undefined,
      leftOut: json.left_out,
    };
    const pose = json.world_from_probe;
    if (pose !== undefined && pose !== null) {
      if (!Array.isArray(pose) || pose.length !== 12 || !pose.every(Number.isFinite)) {
        throw new Error(`frame ${frame.number}, world_from_probe: expected 12 numbers`);
      }
      const column = (c) => [pose[c], pose[4 + c], pose[8 + c]];
      Object.assign(frame, { x: column(0), y: column(1), z: column(2), world: column(3) });
    }
    if (json.contour_mm) frame.contour = floats(json.contour_mm, `frame ${frame.number}, contour_mm`);
    this.list.push(frame);
    this.judge(this.list.length - 1, vessel);
    if (this.list.length > MAX_FRAMES) {
      this.list.shift();
      this.current = Math.max(0, this.current - 1);
    }
    if (this.follow) this.current = this.list.length - 1;
  }

  /**
   * Whether the probe came too far since the frame before. Only along the axis: moves across it leave nothing
   * out.
   */
  judge(i, vessel) {
    const [last, frame] = [this.list[i - 1], this.list[i]];
    if (!last?.world || !frame.world) return;
    const place = vessel.nearestOnAxis(fromOrigin(vessel, frame.world));
    frame.advance = place ? Math.abs(dot(minus(frame.world, last.world), place.direction)) : undefined;
    const seconds = frame.time - last.time;
    frame.seconds = seconds > 0 ? seconds : undefined;
    frame.limit = vessel.frameDistanceLimit;
    frame.tooFast = frame.advance > frame.limit;
  }

  get frame() {
    return this.list[this.current];
  }
}

/** A world point as seen from the vessel's origin. */
const fromOrigin = (vessel, world) => minus(world, vessel.origin ?? [0, 0, 0]);

/** The contour of a frame as seen from the vessel's origin; null for a missing echo. */
function contourPoints(frame, vessel) {
  const points = [];
  for (let i = 0; frame?.world && frame.contour && i + 1 < frame.contour.length; i += 2) {
    const [x, y] = [frame.contour[i], frame.contour[i + 1]];
    const world = plus(plus(frame.world, frame.x, x), frame.y, y);
    points.push(Number.isFinite(x + y) ? fromOrigin(vessel, world) : null);
  }
  return points;
}
