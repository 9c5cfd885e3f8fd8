// Areas and diameters of the lumen.

/**
 * Area, diameters and perimeter of a closed outline of points, as `lumenmesh sections` defines them. Area and
 * diameters are those of its projection along its vector area, which for a plane outline is the outline itself.
 */
function measure(points) {
  const middle = times(
    points.reduce((sum, p) => plus(sum, p), [0, 0, 0]),
    1 / points.length,
  );
  const near = points.map((p) => minus(p, middle));
  const next = (i) => near[(i + 1) % near.length];
  let vector = [0, 0, 0],
    perimeter = 0;
  near.forEach((p, i) => {
    vector = plus(vector, cross(p, next(i)), 0.5);
    perimeter += norm(minus(next(i), p));
  });
  const area = norm(vector),
    [e1, e2] = across(unit(vector));
  const flat = near.map((p) => [dot(p, e1), dot(p, e2)]);
  // Centroid of the area.
  let [cx, cy, twice] = [0, 0, 0];
  flat.forEach(([x, y], i) => {
    const [u, v] = flat[(i + 1) % flat.length],
      w = x * v - u * y;
    [cx, cy, twice] = [cx + (x + u) * w, cy + (y + v) * w, twice + w];
  });
  [cx, cy] = [cx / (3 * twice), cy / (3 * twice)];
  const edges = flat.map(([x, y], i) => {
    const [u, v] = flat[(i + 1) % flat.length];
    return [x - cx, y - cy, u - cx, v - cy];
  });
  // Chords through the centroid, in 360 directions. Where a ray has no or an even number of crossings, it lies
  // outside.
  let [least, greatest] = [Infinity, 0];
  for (let i = 0; i < 360; i += 1) {
    const [c, s] = [Math.cos((Math.PI * i) / 360), Math.sin((Math.PI * i) / 360)];
    let [forth, back, ahead] = [Infinity, Infinity, 0];
    for (const [x, y, u, v] of edges) {
      const [p, q] = [c * y - s * x, c * v - s * u];
      if (p >= 0 === q >= 0) continue;
      const t = p / (p - q),
        along = c * (x + t * (u - x)) + s * (y + t * (v - y));
      if (along > 0) {
        forth = Math.min(forth, along);
        ahead += 1;
      } else back = Math.min(back, -along);
    }
    if (i === 0 && ahead % 2 === 0) {
      least = greatest = NaN;
      break;
    }
    [least, greatest] = [Math.min(least, forth + back), Math.max(greatest, forth + back)];
  }
  const equivalent = 2 * Math.sqrt(area / Math.PI);
  return { area, equivalent, least, greatest, perimeter, middle, normal: unit(vector) };
}

/**
 * Cuts a mesh by the plane through a point and returns the closed outline about the point, or else the nearest
 * one: its
 * points, each with the triangle's nodes that it lies between. Null where the plane meets no closed outline.
 */
function cut(vessel, point, normal) {
  const p = vessel.positions,
    heights = new Float64Array(vessel.count);
  for (let i = 0; i < vessel.count; i += 1) heights[i] = dot(minus(at(p, i), point), normal);
  const ends = new Map();
  const join = (a, b) => {
    const list = ends.get(a);
    if (list) list.push(b);
    else ends.set(a, [b]);
  };
  for (let t = 0; t < vessel.triangleCount; t += 1) {
    const nodes = vessel.corners(t),
      crossed = [];
    for (let i = 0; i < 3; i += 1) {
      const [a, b] = [nodes[i], nodes[(i + 1) % 3]];
      if (heights[a] >= 0 !== heights[b] >= 0) crossed.push(Math.min(a, b) * vessel.count + Math.max(a, b));
    }
    if (crossed.length === 2) {
      join(crossed[0], crossed[1]);
      join(crossed[1], crossed[0]);
    }
  }
  const between = (edge) => {
    const [a, b] = [Math.floor(edge / vessel.count), edge % vessel.count];
    return {
      nodes: [a, b],
      point: plus(at(p, a), minus(at(p, b), at(p, a)), heights[a] / (heights[a] - heights[b])),
    };
  };
  const [e1, e2] = across(normal);
  let best = null;
  const done = new Set();
  for (const start of ends.keys()) {
    if (done.has(start)) continue;
    const loop = [];
    let edge = start,
      last = -1,
      closed = false;
    while (!done.has(edge)) {
      done.add(edge);
      loop.push(edge);
      const onward = ends.get(edge).find((other) => other !== last);
      closed = onward === start && ends.get(edge).length === 2;
      if (onward === undefined) break;
      [last, edge] = [edge, onward];
    }
    if (!closed || loop.length < 3) continue;
    const outline = loop.map(between);
    const flat = outline.map(({ point: q }) => [dot(minus(q, point), e1), dot(minus(q, point), e2)]);
    const away = contains(flat) ? 0 : Math.min(...flat.map(([x, y]) => Math.hypot(x, y)));
    if (!best || away < best.away) best = { outline, away };
  }
  return best;
}

/** Whether a polygon contains (0, 0). */
function contains(flat) {
  let inside = false;
  flat.forEach(([x, y], i) => {
    const [u, v] = flat[(i + 1) % flat.length];
    if (y > 0 !== v > 0 && x + ((u - x) * y) / (y - v) > 0) inside = !inside;
  });
  return inside;
}
