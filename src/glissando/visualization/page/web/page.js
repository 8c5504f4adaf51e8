// The page: what is shown, at what moment, from where, and what hands do to it.

const of = (id) => document.getElementById(id);
const scene = unpackScene(JSON.parse(of("scene").textContent));
const EVERY = 8; // points along the body from one ellipsoid to the next
const START = { yaw: -0.9, pitch: 0.35 };
const long = scene.arclength.at(-1) - scene.arclength[0];
const heat = heatOf(scene), stage = stageOn(of("stage"));
const around = (scene.solids || []).map(solidOf);
const state = { moment: -1, time: scene.time[0], playing: false, moved: false, waiting: false,
  camera: { ...START, half: 1, target: [0, 0, 0] } };

const shown = () => Object.fromEntries(
  [...document.querySelectorAll("fieldset input")].map((box) => [box.name, box.checked]));

// What of the scene is in space at a moment.
function partsAt(body, moment) {
  const show = shown(), wide = scene.sigmas * Number(of("wider").value);
  const colours = body.map(({ std }) => colourOf(std / scene.top));
  const thin = 0.0035 * long, solid = [], shells = [];
  solid.push(sweep(body, body.map(() => round(thin)), colours, 10, 1));
  if (show.sensors) {
    for (const { place, colour } of sensorsAt(scene, moment)) {
      const { centre, axes } = bodyPoint(scene, body, place), half = 0.011 * long;
      const ends = [-half, half].map((t) => plus(centre, axes[2], t));
      solid.push(rod(...ends, 0.009 * long, rgb(colour)));
    }
  }
  if (scene.arrows && show.forces) {
    const forces = forcesAt(scene, body, moment), colour = rgb("#cc79a7");
    solid.push(...forces.map((at) => arrow(at, 0.005 * long, colour)));
    shells.push({ mesh: joined(forces.map((at) => ellipsoid(at, wide, colour))), dense: 0.2 });
  }
  const few = body.filter((_, n) => n % EVERY === 0);
  if (show.frames) solid.push(...few.flatMap(({ centre, axes }) => triad([centre,
    ...axes.map((axis) => plus(centre, axis, 0.035 * long))], 0.0025 * long)));
  if (show.truth) scene.sites.forEach((_, i) => solid.push(...truthAt(moment, i)));
  if (show.ellipsoids) {
    const mesh = joined(few.map((at) => ellipsoid(at, wide, colourOf(at.std / scene.top))));
    shells.push({ mesh, dense: 0.16 });
  }
  if (show.tube) {
    const mesh = sweep(body, body.map((at) => sectionOf(at, wide)), colours);
    shells.push({ mesh, dense: show.ellipsoids ? 0.1 : 0.22 });
  }
  if (scene.tube && show.promised) {
    const far = (scene.tube.sigmas / scene.sigmas) * wide, grey = rgb("#888888");
    const mesh = sweep(body, body.map((at) => sectionOf(at, far)), body.map(() => grey));
    shells.push({ mesh, dense: 0.06 });
  }
  for (const { mesh, clear } of around) {
    if (clear) shells.push({ mesh, dense: 0.2 });
    else solid.push(mesh);
  }
  return { solid: joined(solid), shells, lines: groundIn(rgb(css("--rule"))) };
}

// Rods from an origin to the tips of x, y and z.
function triad([origin, ...tips], radius) {
  return tips.map((tip, i) => rod(origin, tip, radius, rgb(["#d55e00", "#009e73", "#0072b2"][i])));
}

// A true frame, or where only a place is known, a dark bead.
function truthAt(moment, site) {
  const points = [0, 1, 2, 3].map((i) => row(scene.truth, moment, site, i));
  if (Number.isNaN(points[0][0])) return [];
  if (!Number.isNaN(points[1][0])) return triad(points, 0.004 * long);
  const ends = [-1, 1].map((t) => plus(points[0], [0, 0, 1], 0.006 * t * long));
  return [rod(...ends, 0.008 * long, [0.35, 0.35, 0.35])];
}

// A square net below the robot; scene.low and scene.high bound all it does.
function groundIn(colour) {
  const mesh = { vertices: [], indices: [] }, step = roundBelow(long / 4);
  const [low, high] = [scene.low, scene.high].map((corner, i) => corner.map(
    (c) => step * (i ? Math.ceil(c / step + 0.5) : Math.floor(c / step - 0.5))));
  const add = (...ends) => ends.forEach((end) => {
    mesh.indices.push(mesh.vertices.length / 9);
    mesh.vertices.push(...end, 0, 0, 0, ...colour);
  });
  for (const [u, v] of [[0, 1], [1, 0]]) {
    for (let c = low[u]; c <= high[u] + step / 2; c += step) {
      add(...[low[v], high[v]].map((d) => (u ? [d, c, scene.low[2]] : [c, d, scene.low[2]])));
    }
  }
  return mesh;
}

// The camera turned as it is, moved so that all the motion fits.
function fit() {
  const { camera } = state, [width, height] = [of("stage").clientWidth, of("stage").clientHeight];
  const view = viewOf(camera, width, height), { shape, values } = scene.centre;
  const sides = [view.right, view.up].map((axis) => {
    let [low, high] = [Infinity, -Infinity];
    for (let i = 0; i < shape[0] * shape[1]; i++) {
      const at = dot(axis, values.subarray(3 * i, 3 * i + 3));
      [low, high] = [Math.min(low, at), Math.max(high, at)];
    }
    return [low, high];
  });
  const smaller = Math.min(width, height);
  const halves = sides.map(([low, high], i) => ((high - low) / 2) * (smaller / [width, height][i]));
  camera.half = 1.3 * Math.max(...halves, 0.1 * long);
  camera.target = [view.right, view.up].reduce(
    (sum, axis, i) => plus(sum, axis, (sides[i][0] + sides[i][1]) / 2), [0, 0, 0]);
}

function draw() {
  state.waiting = false;
  const { moment } = state, body = bodyAt(scene, moment);
  const [width, height] = [of("stage").clientWidth, of("stage").clientHeight];
  if (stage) {
    if (!state.moved) fit();
    const dense = window.devicePixelRatio || 1;
    of("stage").width = Math.round(width * dense);
    of("stage").height = Math.round(height * dense);
    const view = viewOf(state.camera, width, height);
    stage.draw(view, partsAt(body, moment));
    drawMarks(of("marks"), scene, body, moment, view, shown());
  }
  drawCurve(of("curve"), scene, body, moment);
  drawHeat(of("heat"), scene, heat, moment);
  tell(body, moment);
}

function redraw() {
  if (!state.waiting) requestAnimationFrame(draw);
  state.waiting = true;
}

// The panel of numbers.
function tell(body, moment) {
  of("clock").value = `${scene.time[moment].toFixed(2)} s of ${scene.time.at(-1).toFixed(2)} s`;
  const worst = body.reduce((best, at, n) => (at.std > body[best].std ? n : best), 0);
  const loads = !scene.arrows ? [] : forcesAt(scene, body, moment).map(({ place, force, root }) => {
    const per = scene.arrows.unit / scene.arrows.length, along = unit(force);
    const sure = Math.hypot(...root.map((r) => dot(r, along)));
    return [`force at ${inMm(place, 0)} mm`, `${(per * Math.hypot(...force)).toPrecision(2)} ± `
      + `${(per * sure).toPrecision(2)} N`];
  });
  const rows = [["tip", `± ${inMm(body.at(-1).std)} mm`],
    ["least sure", `± ${inMm(body[worst].std)} mm at ${inMm(scene.arclength[worst], 0)} mm`],
    ...scene.sensors.map((name, i) => {
      const place = row(scene.place, moment, i)[0];
      return [name, Number.isNaN(place) ? "no reading"
        : `± ${inMm(bodyPoint(scene, body, place).std)} mm at ${inMm(place, 0)} mm`];
    }), ...loads];
  of("now").replaceChildren(...rows.flatMap((texts) => texts.map((text, i) => {
    const cell = document.createElement(i ? "dd" : "dt");
    cell.textContent = text;
    return cell;
  })));
  const lines = scene.sites.map((name, i) => {
    const [place, miss, nees] = [scene.site_place, scene.miss, scene.nees].map(
      (values) => row(values, moment, i)[0]);
    const known = Number.isNaN(miss) ? ["", "–", ""]
      : [inMm(place, 0), inMm(miss), nees <= scene.sigmas ** 2 ? "yes" : "no"];
    const tr = document.createElement("tr");
    tr.append(...[name, ...known].map((text) => {
      const cell = document.createElement("td");
      cell.textContent = text;
      return cell;
    }));
    return tr;
  });
  of("sites").tBodies[0].replaceChildren(...lines);
}

// Show the moment nearest to a time in seconds, and tell a page that this one stands in.
function showTime(time, tell = true) {
  state.time = time;
  const moment = momentAt(scene, time);
  if (moment === state.moment) return;
  if (tell && parent !== window) parent.postMessage({ time }, "*");
  state.moment = moment;
  of("slider").value = moment;
  of("slider").setAttribute("aria-valuetext", `${scene.time[moment].toFixed(2)} seconds`);
  redraw();
}

function play(playing) {
  if (playing && !state.playing) {
    if (state.moment === scene.time.length - 1) showTime(scene.time[0]);
    requestAnimationFrame((now) => advance(now, now));
  }
  state.playing = playing;
  of("play").textContent = playing ? "pause" : "play";
}

function advance(now, before) {
  if (!state.playing) return;
  const time = state.time + (Number(of("speed").value) * (now - before)) / 1000;
  showTime(Math.min(time, scene.time.at(-1)));
  if (time >= scene.time.at(-1)) play(false);
  requestAnimationFrame((next) => advance(next, now));
}

function step(by) {
  play(false);
  const last = scene.time.length - 1;
  showTime(scene.time[Math.min(Math.max(state.moment + by, 0), last)]);
}

function zoom(by) {
  const { camera } = state;
  camera.half = Math.min(Math.max(camera.half * by, 0.002 * long), 20 * long);
  state.moved = true;
  redraw();
}

function reset() {
  Object.assign(state.camera, START);
  state.moved = false;
  redraw();
}
