// The page around the scene: colours, numbers, map, keys, and where the vessel comes from.

const $ = (id) => document.getElementById(id);
const canvas = $("scene"),
  stage = $("stage");
let vessel = new Vessel({});
let frames = new Frames();
let quantity = "",
  range = [0, 1],
  fixedRange = null,
  values = new Float32Array(0);
let measured = null; // what was clicked: { ring } or { point, normal }, and its outline
let clip = { kind: "none", normal: [0, 0, 1] };
let flying = 0; // handle of the flight by itself
const eye = new Eye();
let gl = null,
  scene = null,
  dirty = true,
  mapDirty = true,
  colours = {};

const say = (text) => {
  if ([...$("alerts").children].some((p) => p.firstChild.textContent === text)) return;
  const line = document.createElement("p"),
    close = document.createElement("button");
  const words = document.createElement("span");
  words.textContent = text;
  close.textContent = "Close";
  close.addEventListener("click", () => {
    line.remove();
    resize();
  });
  line.append(words, close);
  $("alerts").append(line);
  while ($("alerts").children.length > 4) $("alerts").firstChild.remove();
  resize();
};

/** Lines of a table of facts: name and value, or a remark without a name. */
function fill(id, facts) {
  $(id).replaceChildren(
    ...facts
      .filter(([, value]) => value !== undefined && value !== "")
      .map(([name, value]) => {
        const row = document.createElement("tr"),
          head = document.createElement("th"),
          cell = document.createElement("td");
        head.scope = "row";
        head.textContent = name;
        cell.textContent = value;
        if (name) row.append(head, cell);
        else {
          cell.colSpan = 2;
          cell.className = "remark";
          row.append(cell);
        }
        return row;
      }),
  );
}

const text = (value, decimals, unit) =>
  Number.isFinite(value) ? `${value.toFixed(decimals)} ${unit}`.trim() : undefined;
const percent = (share) => `${(100 * share).toFixed(share > 0.995 && share < 1 ? 1 : 0)} %`;

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["paper", "ink", "soft", "hatch", "none"]) {
    const hex = style.getPropertyValue(`--${name}`).trim();
    colours[name] = [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
  }
  const dark = colours.paper[0] < 0.5;
  colours.path = dark ? [0.85, 0.88, 0.95] : [0.1, 0.1, 0.15];
  colours.fast = dark ? [1, 0.45, 0.75] : [0.8, 0, 0.45];
  colours.contour = dark ? [1, 1, 1] : [0, 0, 0];
  marks();
  redraw(true);
}

/** Marks the picture as out of date: it is drawn once before the screen is next refreshed. */
let asked = false;
function redraw(map = false) {
  dirty = true;
  mapDirty ||= map;
  if (!asked) {
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      draw();
    });
  }
}

function resize() {
  const pixels = Math.min(window.devicePixelRatio || 1, 2);
  const [width, height] = [stage.clientWidth, stage.clientHeight].map((n) =>
    Math.max(1, Math.round(n * pixels)),
  );
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  if (eye.follow && !eye.flight) fit();
  redraw(true);
}

const aspect = () => canvas.width / canvas.height;

function fit() {
  eye.flight = null;
  if (vessel.count) eye.fit(vessel.positions, vessel.count, aspect());
  else {
    const path = frames.list.filter((frame) => frame.world).flatMap((frame) => fromOrigin(vessel, frame.world));
    eye.fit(path, path.length / 3, aspect());
  }
}

/** A ball about all there is. */
function bounds() {
  const low = [Infinity, Infinity, Infinity],
    high = [-Infinity, -Infinity, -Infinity];
  const take = (points, count) => {
    for (let i = 0; i < 3 * count; i += 1) {
      if (points[i] < low[i % 3]) low[i % 3] = points[i];
      if (points[i] > high[i % 3]) high[i % 3] = points[i];
    }
  };
  take(vessel.positions, vessel.count);
  for (const frame of frames.list) if (frame.world) take(fromOrigin(vessel, frame.world), 1);
  const ok = high[0] >= low[0];
  return ok
    ? { centre: low.map((v, i) => (v + high[i]) / 2), radius: Math.max(norm(minus(high, low)) / 2, 1) + 15 }
    : { centre: [0, 0, 0], radius: 100 };
}
let ball = bounds();

/** The clip plane as (normal, offset): what lies beyond is cut away. */
function clipPlane() {
  if (clip.kind === "none") return [0, 0, 0, 1];
  if (clip.kind === "axis")
    return measured ? [...measured.normal, dot(measured.normal, measured.middle)] : [0, 0, 0, 1];
  const normal = clip.kind === "view" ? eye.turn[2] : ["x", "y", "z"].map((name) => Number(name === clip.kind));
  return [...normal, dot(normal, ball.centre) + (Number($("clip-at").value) / 500 - 1) * ball.radius];
}

function draw() {
  if (stale) refresh();
  if (mapDirty) {
    mapDirty = false;
    drawMap();
  }
  if (!scene || !dirty || gl.isContextLost()) return;
  dirty = false;
  const pixels = canvas.width / Math.max(1, stage.clientWidth);
  const [right, up, back] = eye.turn;
  scene.draw({
    matrix: eye.matrix(aspect(), ball.centre, ball.radius),
    clip: clipPlane(),
    range,
    pixels,
    ...colours,
    light: unit(plus(plus(times(back, 0.82), up, 0.45), right, -0.35)),
    inside: eye.flight ? 1 : 0.72,
    path: !eye.flight,
    hideUnsupported: $("unsupported").value === "hidden",
  });
}

// ---- colours of the wall

/** The quantities that can be shown: arrays with a value somewhere. */
function quantities() {
  const order = [...KNOWN.keys()],
    place = (name) => (order.indexOf(name) + order.length + 1) % (order.length + 1);
  return [...vessel.arrays.keys()]
    .filter((name) => name !== "supported" && (name !== "branch" || !vessel.isGrid || vessel.seams.size))
    .sort((a, b) => place(a) - place(b) || (a < b ? -1 : 1));
}

function setQuantity(name) {
  quantity = name;
  $("quantity").value = name;
  fixedRange = null;
  paint(0, vessel.isGrid ? vessel.rings : vessel.count);
}

/** Values for the device, of some rings; then the range that they span. */
function paint(fromRing, toRing) {
  const array = vessel.arrays.get(quantity);
  if (values.length !== vessel.supported.length) {
    values = new Float32Array(vessel.supported.length).fill(NO_VALUE);
    [fromRing, toRing] = [0, vessel.isGrid ? vessel.rings : vessel.count];
  }
  const N = vessel.isGrid ? vessel.nodes : 1;
  for (let i = fromRing * N; i < toRing * N; i += 1)
    values[i] = array && Number.isFinite(array[i]) ? array[i] : NO_VALUE;
  let [low, high, sum, count, missing, unsupported] = [Infinity, -Infinity, 0, 0, false, false];
  for (let i = 0; i < vessel.count; i += 1) {
    if (!vessel.supported[i]) {
      unsupported = true;
      continue;
    }
    const v = values[i];
    if (v === NO_VALUE) {
      missing = true;
      continue;
    }
    if (v < low) low = v;
    if (v > high) high = v;
    sum += Math.abs(v);
    count += 1;
  }
  const signed = low < 0,
    most = Math.min(Math.max(-low, high), (10 * sum) / count);
  // As pictures of meshes have it: from 0, and at most 10 times the mean, so that outliers do not take all
  // colours.
  if (!count) range = [0, 1];
  else if (quantity === "frame" || quantity === "radius_mm") range = [low, high];
  else range = [signed ? -most : 0, most];
  if (fixedRange) range = [...fixedRange];
  if (!(range[1] > range[0])) range = [range[0], range[0] + Math.max(Math.abs(range[0]), 1)];
  legend(signed ? DIVERGING : SEQUENTIAL, count > 0, missing, unsupported, low, high);
  if (scene) {
    scene.setColours(signed ? DIVERGING : SEQUENTIAL);
    scene.setValues(values, vessel.count);
  }
  redraw(true);
}

let shownMap = SEQUENTIAL,
  shownLegend = "";
function legend(map, any, missing, unsupported, low, high) {
  shownMap = map;
  const [name, unitName] = described(quantity);
  const fresh = JSON.stringify([
    vessel.count > 0,
    quantity,
    range,
    any,
    missing,
    unsupported,
    low < range[0],
    high > range[1],
  ]);
  if (fresh === shownLegend) return;
  shownLegend = fresh;
  $("legend").hidden = !(vessel.count && quantity);
  $("legend-title").textContent = unitName ? `${name} (${unitName})` : name;
  const stops = map.map((c, i) => `rgb(${c}) ${(100 * i) / (map.length - 1)}%`);
  $("legend-bar").style.background = `linear-gradient(to top, ${stops})`;
  $("legend-scale").hidden = !any;
  const more = ({ value, text: label }, i, all) => {
    const last = i === all.length - 1 && high > range[1] * (1 + 1e-6),
      first = i === 0 && low < range[0] - 1e-6 * Math.abs(range[0]);
    const line = document.createElement("span");
    line.style.bottom = `${(100 * (value - range[0])) / (range[1] - range[0])}%`;
    line.textContent = label + (last ? " and more" : first ? " and less" : "");
    return line;
  };
  $("legend-ticks").replaceChildren(...ticks(...range).map(more));
  $("legend-none").hidden = !missing;
  $("legend-unsupported").hidden = !unsupported;
  if (document.activeElement !== $("low")) $("low").value = Number(range[0].toPrecision(4));
  if (document.activeElement !== $("high")) $("high").value = Number(range[1].toPrecision(4));
  canvas.setAttribute(
    "aria-label",
    `The vessel in three dimensions, coloured by ${name}. Arrow keys turn it; ? lists all keys.`,
  );
}

// ---- the catheter

/** Segments of a line through points; null interrupts it. */
function segments(points, paint, closed = false) {
  const all = [];
  points.forEach((p, i) => {
    const next = i + 1 < points.length ? points[i + 1] : closed ? points[0] : null;
    if (p && next) all.push(...p, ...next, ...paint);
  });
  return all;
}

/** Path, probe, contour of the current frame, and the measured outline. */
function marks(path = true) {
  if (!scene) return;
  if (path) {
    const all = [];
    frames.list.forEach((frame, i) => {
      const last = frames.list[i - 1];
      if (frame.world && last?.world)
        all.push(
          ...fromOrigin(vessel, last.world),
          ...fromOrigin(vessel, frame.world),
          ...(frame.tooFast ? colours.fast : colours.path),
        );
    });
    scene.setLines("path", all);
  }
  const frame = frames.frame,
    all = [];
  if (frame?.world) {
    const points = contourPoints(frame, vessel),
      here = fromOrigin(vessel, frame.world);
    const reach = median(points.filter(Boolean).map((p) => norm(minus(p, here)))) || 5;
    all.push(...segments(points, frame.leftOut ? colours.fast : colours.contour, true));
    // The probe, and a cross in its plane.
    all.push(...plus(here, frame.z, -0.5 * reach), ...plus(here, frame.z, 0.5 * reach), ...colours.contour);
    for (const side of [frame.x, frame.y])
      all.push(...plus(here, side, -0.12 * reach), ...plus(here, side, 0.12 * reach), ...colours.contour);
  }
  if (measured) all.push(...segments(measured.outline, colours.fast, true));
  scene.setLines("marks", all);
}

function showFrame() {
  const frame = frames.frame,
    slider = $("frame");
  $("frame-section").hidden = frames.list.length === 0;
  slider.max = Math.max(0, frames.list.length - 1);
  slider.value = frames.current;
  if (!frame) return;
  slider.setAttribute("aria-valuetext", `frame ${frame.number}`);
  const echoes = frame.contour ? contourPoints(frame, vessel) : null;
  const speed = frame.advance / frame.seconds,
    limit = frame.limit;
  fill("frame-facts", [
    ["frame", String(frame.number)],
    ["time", text(frame.time, 2, "s")],
    ["echoes", echoes ? `${echoes.filter(Boolean).length} of ${echoes.length}` : undefined],
    ["advance since the last", text(frame.advance, 2, "mm")],
    ["speed along the axis", text(speed, 1, "mm/s")],
    [
      "limit at this frame rate",
      limit > 0 && frame.seconds ? `${(limit / frame.seconds).toFixed(1)} mm/s` : undefined,
    ],
    ["", frame.leftOut ? `Not used: ${frame.leftOut}` : frame.world ? undefined : "Not used: it has no pose."],
  ]);
  const fast = frames.list.filter((one) => one.tooFast),
    count = `${fast.length} ${fast.length === 1 ? "frame" : "frames"}`;
  // The newest that is not long ago.
  const now = frames.list
    .slice(Math.max(0, frames.current - 11), frames.current + 1)
    .filter((one) => one.tooFast)
    .pop();
  $("speed-warning").hidden = fast.length === 0;
  $("speed-warning").textContent =
    fast.length === 0
      ? ""
      : now
        ? `Too fast: ${now.advance.toFixed(1)} mm up to frame ${now.number}. At most ${now.limit.toFixed(1)} mm leave no ring without echoes. ${count} so far.`
        : `${count} came too fast, the last one was frame ${fast[fast.length - 1].number}.`;
}

function setFrame(index) {
  if (!frames.list.length) return;
  frames.current = clamp(index, 0, frames.list.length - 1);
  frames.follow = frames.current === frames.list.length - 1;
  showFrame();
  marks(false);
  redraw(true);
}

// ---- measuring

/** Where a ray from the eye through a pixel first meets visible wall. */
function pick(clientX, clientY) {
  const box = canvas.getBoundingClientRect();
  const direction = eye.ray(
    (2 * (clientX - box.left)) / box.width - 1,
    1 - (2 * (clientY - box.top)) / box.height,
    aspect(),
  );
  const origin = eye.place,
    plane = clipPlane(),
    hidden = $("unsupported").value === "hidden",
    p = vessel.positions;
  let best = null;
  for (let t = 0; t < vessel.triangleCount; t += 1) {
    const nodes = vessel.corners(t),
      [a, b, c] = nodes.map((n) => at(p, n));
    const [e1, e2] = [minus(b, a), minus(c, a)],
      h = cross(direction, e2),
      det = dot(e1, h);
    if (Math.abs(det) < 1e-12) continue;
    const s = minus(origin, a),
      u = dot(s, h) / det;
    if (!(u >= 0 && u <= 1)) continue;
    const q = cross(s, e1),
      v = dot(direction, q) / det,
      distance = dot(e2, q) / det;
    if (v < 0 || u + v > 1 || distance <= 0 || (best && distance >= best.distance)) continue;
    const point = plus(origin, direction, distance);
    if (dot(plane, point) > plane[3] || (hidden && !nodes.every((n) => vessel.supported[n]))) continue;
    const weights = [1 - u - v, u, v];
    best = { point, distance, node: nodes[weights.indexOf(Math.max(...weights))], nodes, weights };
  }
  return best;
}

/** Measures ring k of a grid. */
function measureRing(k) {
  if (!vessel.isGrid || !vessel.rings) return;
  k = clamp(k, 0, vessel.rings - 1);
  const nodes = Array.from({ length: vessel.nodes }, (_, j) => k * vessel.nodes + j);
  showMeasured({ ring: k, outline: nodes.map((n) => at(vessel.positions, n)), nodes });
}

/** Measures at a place of the wall: the ring there, or a cut by a frame's plane or across the axis. */
function measureAt(hit) {
  if (vessel.isGrid) {
    // The ring that the place is nearer to.
    const N = vessel.nodes;
    measureRing(Math.round(hit.nodes.reduce((sum, n, i) => sum + hit.weights[i] * Math.floor(n / N), 0)));
    return;
  }
  let plane = null;
  const posed = frames.list.filter((frame) => frame.world);
  const wanted = vessel.arrays.get("frame")?.[hit.node];
  if (posed.length) {
    const key = (frame) =>
      Number.isFinite(wanted)
        ? Math.abs(frame.number - wanted)
        : Math.abs(dot(minus(hit.point, fromOrigin(vessel, frame.world)), frame.z)) +
          1e-3 * norm(minus(hit.point, fromOrigin(vessel, frame.world)));
    const frame = posed.reduce((a, b) => (key(b) < key(a) ? b : a));
    plane = { point: fromOrigin(vessel, frame.world), normal: frame.z, frame };
  } else if (vessel.axis) {
    const { index, direction } = vessel.nearestOnAxis(hit.point);
    plane = { point: at(vessel.axis, index), normal: direction };
  }
  const found = plane && cut(vessel, plane.point, plane.normal);
  if (!found) {
    showMeasured({
      outline: [],
      nodes: [hit.node],
      frame: plane?.frame,
      hit,
      remark: plane
        ? "The outline is open here."
        : "Neither frames nor an axis are known: there is no plane to cut by.",
    });
    return;
  }
  showMeasured({
    outline: found.outline.map((o) => o.point),
    nodes: found.outline.flatMap((o) => o.nodes),
    frame: plane.frame,
    remark:
      found.away > 0
        ? `The outline is ${found.away.toFixed(1)} mm from the ${plane.frame ? "probe" : "axis"}.`
        : undefined,
  });
}

function showMeasured(found) {
  measured = null;
  const { outline, nodes, ring, frame, hit } = found;
  const finite = (name) => nodes.map((n) => vessel.arrays.get(name)?.[n]).filter(Number.isFinite);
  const share = nodes.filter((n) => vessel.supported[n]).length / nodes.length;
  const seen = finite("frame"),
    errors = finite("standard_error_mm");
  const frameText = frame
    ? String(frame.number)
    : seen.length
      ? [...new Set([Math.min(...seen), Math.max(...seen)])].join(" to ")
      : undefined;
  const complete = outline.length > 2 && outline.every((p) => p.every(Number.isFinite));
  const numbersHere = complete ? measure(outline) : {};
  if (complete) measured = { ...found, ...numbersHere };
  const own = hit
    ? quantities().map((name) => {
        const [label, unitName] = described(name);
        return [
          label,
          Number.isFinite(vessel.arrays.get(name)[hit.node])
            ? `${Number(vessel.arrays.get(name)[hit.node].toPrecision(4))} ${unitName}`
            : undefined,
        ];
      })
    : [];
  fill("measured", [
    ["ring", ring === undefined ? undefined : `${ring} of ${vessel.rings}`],
    [ring === undefined ? "frame" : "last seen in frame", frameText],
    ["area", text(numbersHere.area, 2, "mm²")],
    ["circular-equivalent diameter", text(numbersHere.equivalent, 2, "mm")],
    ["least diameter", text(numbersHere.least, 2, "mm")],
    ["greatest diameter", text(numbersHere.greatest, 2, "mm")],
    ["perimeter", text(numbersHere.perimeter, 2, "mm")],
    ["outline with echoes", percent(share)],
    ["standard error (median)", errors.length ? text(median(errors), 3, "mm") : undefined],
    ...own,
    [
      "",
      found.remark ??
        (share < 1 && complete ? "Where there are no echoes, the outline is a guess." : undefined),
    ],
  ]);
  $("measured-none").hidden = true;
  marks(false);
  redraw(true);
}

// ---- the wall, unrolled

function drawMap() {
  const show = vessel.isGrid && vessel.rings > 1;
  if ($("unrolled").hidden === show) {
    $("unrolled").hidden = !show;
    resize();
  }
  if (!show) return;
  const map = $("map"),
    pixels = Math.min(window.devicePixelRatio || 1, 2),
    N = vessel.nodes,
    K = vessel.rings;
  Object.assign(map, {
    width: Math.max(1, Math.round(map.clientWidth * pixels)),
    height: Math.round(map.clientHeight * pixels),
  });
  const context = map.getContext("2d"),
    { width, height } = map;
  const image = context.createImageData(width, height),
    hatch = colours.hatch.map((c) => 255 * c),
    none = colours.none.map((c) => 255 * c);
  const texels = Array.from({ length: 256 }, (_, i) => colour(shownMap, i / 255));
  for (let y = 0; y < height; y += 1) {
    const j = Math.floor(((height - 1 - y) * N) / height);
    for (let x = 0; x < width; x += 1) {
      const node = Math.floor((x * K) / width) * N + j;
      let rgb = none;
      if (!vessel.supported[node]) {
        if (mod(x + y, 7 * pixels) > 3 * pixels) continue;
        rgb = hatch;
      } else if (values[node] !== NO_VALUE) {
        rgb = texels[Math.round(255 * clamp((values[node] - range[0]) / (range[1] - range[0]), 0, 1))];
      }
      image.data.set([rgb[0], rgb[1], rgb[2], 255], 4 * (y * width + x));
    }
  }
  context.putImageData(image, 0, 0);
  const css = (name) => `rgb(${colours[name].map((c) => Math.round(255 * c))})`;
  const line = (ring, name) => {
    const x = ((ring + 0.5) * width) / K;
    context.fillStyle = css("paper");
    context.fillRect(x - 2.5 * pixels, 0, 5 * pixels, height);
    context.fillStyle = css(name);
    context.fillRect(x - pixels, 0, 2 * pixels, height);
  };
  const frame = frames.frame;
  if (frame?.world) line(vessel.nearestOnAxis(fromOrigin(vessel, frame.world))?.index ?? 0, "ink");
  if (measured?.ring !== undefined) line(measured.ring, "fast");
  $("map-length").textContent = `${vessel.axisLength.toFixed(0)} mm`;
}
const mod = (x, n) => ((x % n) + n) % n;

// ---- facts

function showFacts() {
  const supported = vessel.supported.subarray(0, vessel.count).reduce((sum, s) => sum + s, 0);
  fill("facts", [
    ["rings", vessel.isGrid && vessel.rings ? `${vessel.rings} of ${vessel.nodes} nodes` : undefined],
    ["nodes", vessel.count ? String(vessel.count) : undefined],
    ["triangles", vessel.isGrid ? undefined : String(vessel.triangleCount)],
    ["length", vessel.axis ? text(vessel.axisLength, 1, "mm") : undefined],
    ["nodes with echoes", vessel.count ? percent(supported / vessel.count) : undefined],
    ["frames", frames.list.length ? String(frames.list.length) : undefined],
  ]);
  $("empty").hidden = Boolean(scene) && vessel.count > 0;
  $("unsupported-row").hidden = supported === vessel.count;
  $("fly").disabled = !flightPath();
  $("fly").title = flightPath() ? "" : "Neither an axis nor a catheter's path is known";
}

// ---- flight

/** The points to fly along: the axis, or else the catheter's path. */
function flightPath() {
  if (vessel.axis) return vessel.axis;
  const path = frames.list.filter((frame) => frame.world).flatMap((frame) => fromOrigin(vessel, frame.world));
  return path.length > 6 ? Float32Array.from(path) : null;
}

/**
 * Puts the eye on the axis, at a share of its points from 0 to 1. Averages over neighbours take away the jitter
 * of a path.
 */
function flyTo(share) {
  const path = flightPath();
  if (!path) return;
  const last = path.length / 3 - 1,
    wide = Math.max(2, Math.round(last / 60));
  const smooth = (x) => {
    let sum = [0, 0, 0],
      weight = 0;
    for (let i = Math.max(0, Math.ceil(x - wide)); i <= Math.min(last, Math.floor(x + wide)); i += 1) {
      const w = 1 - Math.abs(i - x) / (wide + 1),
        p = at(path, i);
      if (Number.isFinite(p[0] + p[1] + p[2])) [sum, weight] = [plus(sum, p, w), weight + w];
    }
    return times(sum, 1 / (weight || 1));
  };
  share = clamp(share, 0, 1);
  const x = share * last,
    [behind, ahead] = [smooth(Math.max(x - wide, 0)), smooth(Math.min(x + wide, last))];
  const back = unit(minus(behind, ahead));
  // Up stays as near as possible to what it was, so that the view does not roll.
  const sideways = cross(eye.turn[1], back),
    right = norm(sideways) > 1e-6 ? unit(sideways) : across(back)[0];
  [eye.turn, eye.target] = [[right, cross(back, right), back], smooth(x)];
  eye.flight = { share };
  eye.follow = false;
  $("flight").value = 1000 * share;
  redraw();
}

function toggleFlight() {
  if (eye.flight) {
    stopFlying();
    eye.flight = null;
    eye.follow = true;
    fit();
  } else flyTo(0.02);
  $("fly").setAttribute("aria-pressed", String(Boolean(eye.flight)));
  $("flight").hidden = !eye.flight;
  redraw();
}

function stopFlying() {
  cancelAnimationFrame(flying);
  flying = 0;
}

/** Flies by itself: the length of the vessel in 30 s. */
function flyOn() {
  if (flying) {
    stopFlying();
    return;
  }
  let last = performance.now();
  const step = (now) => {
    if (!eye.flight || eye.flight.share >= 1) {
      stopFlying();
      return;
    }
    flyTo(eye.flight.share + (now - last) / 30000);
    last = now;
    flying = requestAnimationFrame(step);
  };
  flying = requestAnimationFrame(step);
}

// ---- pictures

/** The scene with title and legend, as a PNG. */
function picture() {
  dirty = true;
  draw();
  const sheet = document.createElement("canvas"),
    pixels = canvas.width / Math.max(1, stage.clientWidth);
  Object.assign(sheet, { width: canvas.width, height: canvas.height });
  const c = sheet.getContext("2d"),
    css = (name) => `rgb(${colours[name].map((v) => Math.round(255 * v))})`;
  c.drawImage(canvas, 0, 0);
  c.scale(pixels, pixels);
  c.fillStyle = css("ink");
  c.font = "600 14px system-ui, sans-serif";
  c.fillText(vessel.title, 12, 22);
  if (!$("legend").hidden && !$("legend-scale").hidden) {
    const [bottom, height] = [stage.clientHeight - 30, 140];
    c.fillText($("legend-title").textContent, 12, bottom - height - 12);
    for (let y = 0; y < height; y += 1) {
      c.fillStyle = `rgb(${colour(shownMap, y / (height - 1))})`;
      c.fillRect(12, bottom - y - 1, 16, 1.5);
    }
    c.fillStyle = css("ink");
    c.font = "13px system-ui, sans-serif";
    for (const { value, text: label } of ticks(...range)) {
      const y = bottom - (height * (value - range[0])) / (range[1] - range[0]);
      c.fillRect(28, y - 0.5, 6, 1);
      c.fillText(label, 38, y + 4);
    }
    c.fillText(
      ["unsupported", "none"]
        .filter((n) => !$(`legend-${n}`).hidden)
        .map((n) => ({ unsupported: "hatched: no echo supports it", none: "grey: no value" })[n])
        .join("; "),
      12,
      bottom + 20,
    );
  }
  return sheet;
}

function savePicture() {
  picture().toBlob((blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${(vessel.title || "vessel").replace(/[^\w.-]+/g, "_")}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  });
}

// ---------------------------------------------------------------- mouse, fingers, keys

const pointers = new Map();
let moved = 0;
const pointer = ({ clientX, clientY, button }) => ({ clientX, clientY, button });
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, pointer(event));
  moved = pointers.size > 1 ? Infinity : 0;
});
canvas.addEventListener("pointermove", (event) => {
  const last = pointers.get(event.pointerId);
  if (!last) return;
  const [dx, dy] = [event.clientX - last.clientX, event.clientY - last.clientY];
  moved += Math.abs(dx) + Math.abs(dy);
  const others = [...pointers.values()].filter((other) => other !== last);
  const scale = (2 * eye.distance * Math.tan(eye.field / 2)) / Math.max(1, stage.clientHeight);
  if (others.length) {
    const gap = (one) => Math.hypot(one.clientX - others[0].clientX, one.clientY - others[0].clientY) || 1;
    eye.zoom(gap(last) / gap(event));
    eye.move((dx * scale) / 2, (-dy * scale) / 2);
  } else if ((event.shiftKey || last.button === 2) && !eye.flight) eye.move(dx * scale, -dy * scale);
  else if (moved > 3) eye.rotate(0.008 * dx, 0.008 * dy);
  pointers.set(event.pointerId, { ...pointer(event), button: last.button });
  redraw();
});
canvas.addEventListener("pointerup", (event) => {
  if (pointers.has(event.pointerId) && moved <= 3 && event.button === 0) {
    const hit = pick(event.clientX, event.clientY);
    if (hit) measureAt(hit);
  }
  pointers.delete(event.pointerId);
});
canvas.addEventListener("pointercancel", (event) => pointers.delete(event.pointerId));
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener(
  "wheel",
  (event) => {
    // Within another page, the wheel scrolls that page until the picture is used.
    if (window.self !== window.top && document.activeElement !== canvas) return;
    event.preventDefault();
    if (eye.flight) flyTo(eye.flight.share - Math.sign(event.deltaY) * 0.01);
    else eye.zoom(Math.exp(clamp(event.deltaY, -300, 300) * 0.0015));
    redraw();
  },
  { passive: false },
);
$("map").addEventListener("click", (event) => {
  const box = $("map").getBoundingClientRect();
  measureRing(Math.floor(((event.clientX - box.left) / box.width) * vessel.rings));
});

function nextQuantity(step) {
  const names = quantities();
  if (names.length) setQuantity(names[mod(names.indexOf(quantity) + step, names.length)]);
}

const CLIPS = ["none", "view", "x", "y", "z", "axis"];
function setClip(kind) {
  clip.kind = $("clip").value = kind;
  $("clip-at").disabled = kind === "none" || kind === "axis";
  redraw();
}

function moveClip(step) {
  $("clip-at").value = Number($("clip-at").value) + step;
  redraw();
}

function turnOrMove(x, y, event) {
  if (eye.flight && y) flyTo(eye.flight.share + 0.01 * y);
  else if (event.shiftKey && !eye.flight) eye.move(-x * eye.distance * 0.03, -y * eye.distance * 0.03);
  else eye.rotate(0.1 * x, -0.1 * y);
  redraw();
}

const KEYS = {
  ArrowLeft: (e) => turnOrMove(-1, 0, e),
  ArrowRight: (e) => turnOrMove(1, 0, e),
  ArrowUp: (e) => turnOrMove(0, 1, e),
  ArrowDown: (e) => turnOrMove(0, -1, e),
  "+": () => eye.zoom(0.87),
  "=": () => eye.zoom(0.87),
  "-": () => eye.zoom(1.15),
  0: () => showAll(),
  c: () => nextQuantity(1),
  C: () => nextQuantity(-1),
  u: () => {
    $("unsupported").value = $("unsupported").value === "hidden" ? "hatched" : "hidden";
  },
  x: () => setClip(CLIPS[(CLIPS.indexOf(clip.kind) + 1) % CLIPS.length]),
  ",": () => moveClip(-20),
  ".": () => moveClip(20),
  f: () => flightPath() && toggleFlight(),
  " ": () => eye.flight && flyOn(),
  "[": () => measureRing((measured?.ring ?? 0) - 1),
  "]": () => measureRing((measured?.ring ?? -1) + 1),
  j: () => setFrame(frames.current - 1),
  k: () => setFrame(frames.current + 1),
  s: () => savePicture(),
  "?": () => $("help").showModal(),
};
document.addEventListener("keydown", (event) => {
  // Keys that a control of the page needs itself are left to it.
  const own = event.target.matches?.("input, select, button, dialog *");
  if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
  if (own && (event.target.matches("input[type=number], select") || /^(Arrow|Enter| )/.test(event.key))) return;
  const act = KEYS[event.key];
  if (!act) return;
  event.preventDefault();
  act(event);
  redraw();
});

function showAll() {
  if (eye.flight) toggleFlight();
  eye.follow = true;
  fit();
  redraw();
}

$("quantity").addEventListener("change", (event) => setQuantity(event.target.value));
$("unsupported").addEventListener("change", () => redraw());
$("clip").addEventListener("change", (event) => setClip(event.target.value));
$("clip-at").addEventListener("input", () => redraw());
$("fit").addEventListener("click", showAll);
$("fly").addEventListener("click", toggleFlight);
$("flight").addEventListener("input", (event) => flyTo(event.target.value / 1000));
$("picture").addEventListener("click", savePicture);
$("help-open").addEventListener("click", () => $("help").showModal());
$("frame").addEventListener("input", (event) => setFrame(Number(event.target.value)));
$("range-auto").addEventListener("click", () => {
  fixedRange = null;
  paint(0, 0);
});
for (const id of ["low", "high"]) {
  $(id).addEventListener("change", () => {
    const wanted = [Number($("low").value), Number($("high").value)];
    if (wanted[0] < wanted[1]) {
      fixedRange = wanted;
      paint(0, 0);
    } else say("The range of colours needs a lower and a higher number.");
  });
}
window.addEventListener("resize", resize);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readColours);

// ---------------------------------------------------------------- sources

/** Begins anew with a `vessel`. */
function begin(json) {
  const next = new Vessel(json),
    nextFrames = new Frames();
  // What an empty vessel had to offer was nobody's choice.
  if (!vessel.count) quantity = "";
  for (const frame of json.frames ?? []) nextFrames.add(frame, next);
  // The eye stays where it was in the world.
  eye.target = plus(eye.target, minus(vessel.origin ?? [0, 0, 0], next.origin ?? [0, 0, 0]));
  [vessel, frames, measured] = [next, nextFrames, null];
  fill("measured", []);
  $("measured-none").hidden = false;
  $("title").textContent = document.title = vessel.title || "lumenmesh";
  scene?.forget();
  values = new Float32Array(0);
  listQuantities();
  outdate(0, vessel.isGrid ? vessel.rings : vessel.count);
}

function listQuantities() {
  const names = quantities();
  $("quantity").replaceChildren(
    ...names.map((name) => {
      const option = document.createElement("option");
      option.value = name;
      option.textContent = described(name)[0];
      return option;
    }),
  );
  if (!names.includes(quantity)) quantity = names[0] ?? "";
  $("quantity").value = quantity;
}

/** Rings whose picture is out of date, as [from, to]. Events may come faster than pictures. */
let stale = null;
function outdate(fromRing, toRing) {
  stale = stale ? [Math.min(stale[0], fromRing), Math.max(stale[1], toRing)] : [fromRing, toRing];
  redraw(true);
}

/** Brings the page up to date with what is known. */
function refresh() {
  const end = vessel.isGrid ? vessel.rings : vessel.count,
    [fromRing, toRing] = stale.map((ring) => Math.min(ring, end));
  stale = null;
  ball = bounds();
  paint(fromRing, toRing);
  if (scene) scene.setWall(vessel, fromRing, toRing);
  if (measured?.ring !== undefined) measureRing(measured.ring);
  if (eye.follow && !eye.flight) fit();
  marks();
  showFrame();
  showFacts();
}

function change(json) {
  const rings = vessel.change(json);
  if (json.frame) frames.add(json.frame, vessel);
  if (measured?.ring !== undefined) measured.ring += json.before ?? 0;
  outdate(...(rings ?? [0, 0]));
}

function status(words) {
  $("status").textContent = words;
}

function take(json) {
  switch (json.type) {
    case "vessel":
      begin(json);
      break;
    case "change":
      change(json);
      break;
    case "message":
      say(String(json.text));
      break;
    case "end":
      return true;
    default:
      break;
  }
  return false;
}

/**
 * Follows the server's events. A faulty one is said; the connection then begins anew, with all of the vessel.
 */
function listen() {
  const events = new EventSource("events");
  let faults = 0;
  events.onopen = () => status("live");
  events.onerror = () =>
    status(
      events.readyState === EventSource.CLOSED
        ? "The server does not answer: load the page again."
        : "Connection lost; trying again.",
    );
  events.onmessage = ({ data }) => {
    try {
      const json = JSON.parse(data);
      if (!take(json)) return;
      events.close();
      status(json.text ? `The recording has ended: ${json.text}` : "The recording has ended.");
    } catch (error) {
      events.close();
      faults += 1;
      say(`The server sent what cannot be shown. ${error.message}`);
      status("Stopped after an error; trying again.");
      setTimeout(listen, 2000);
    }
  };
}

// ---------------------------------------------------------------- start

function startScene() {
  gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
  if (!gl) {
    $("empty").textContent =
      "This browser shows no WebGL 2, which the picture needs. Numbers and the unrolled map still work.";
    $("empty").hidden = false;
    return;
  }
  const build = () => {
    scene = new Scene(gl);
  };
  build();
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    build();
    outdate(0, vessel.isGrid ? vessel.rings : vessel.count);
  });
}

startScene();
readColours();
new ResizeObserver(resize).observe(stage);
const embedded = $("vessel").textContent.trim();
// A page that was not put together still has its mark.
if (embedded && !embedded.startsWith("/*")) {
  try {
    begin(JSON.parse(embedded));
  } catch (error) {
    say(`This page's vessel cannot be shown. ${error.message}`);
  }
} else {
  outdate(0, 0);
  status("connecting");
  listen();
}
resize();

/** For tests, and for who looks at the page with a console. */
window.lumenmesh = {
  get vessel() {
    return vessel;
  },
  get frames() {
    return frames;
  },
  get measured() {
    return measured;
  },
  get eye() {
    return eye;
  },
  get range() {
    return range;
  },
  get quantity() {
    return quantity;
  },
  measureRing,
  picture,
  take,
  /** Brings the page up to date at once, but for the scene. */
  refresh() {
    if (stale) refresh();
  },
  /** Where a node is on the page, in its pixels. */
  project(node) {
    const m = eye.matrix(aspect(), ball.centre, ball.radius),
      p = [...at(vessel.positions, node), 1],
      box = canvas.getBoundingClientRect();
    const [x, y, , w] = [0, 1, 2, 3].map((row) =>
      p.reduce((sum, v, column) => sum + v * m[4 * column + row], 0),
    );
    return [box.left + ((x / w + 1) / 2) * box.width, box.top + ((1 - y / w) / 2) * box.height];
  },
  /** Mean time to draw the scene, ms. Reading a pixel waits for the device. */
  frameTime(count) {
    const pixel = new Uint8Array(4),
      start = performance.now();
    for (let i = 0; i < count; i += 1) {
      eye.rotate(0.01, 0);
      dirty = true;
      draw();
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    }
    return (performance.now() - start) / count;
  },
};
