"use strict";
// Numbers into shapes. Nothing here touches the page, so any engine can run it.
// Lengths are metres, vectors are arrays of three, a mesh is {vertices, indices} with nine numbers
// a vertex: position, normal, colour.

const NOTHING = 65535; // stands for NaN in packed arrays
const COLOURS = ("440154 481769 472a7a 433d84 3d4e8a 355e8d 2e6d8e 297b8e 23898e "
  + "1f978b 21a585 2eb37c 46c06f 65cb5e 89d548 b0dd2f d8e219 fde725")
  .split(" ").map((hex) => rgb(`#${hex}`)); // viridis

function rgb(hex) {
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
}

function colourOf(share) {
  const place = Math.min(Math.max(share || 0, 0), 1) * (COLOURS.length - 1);
  const low = Math.min(Math.floor(place), COLOURS.length - 2);
  return COLOURS[low].map((c, i) => c + (place - low) * (COLOURS[low + 1][i] - c));
}

function unpack({ shape, low, step, data }) {
  const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  const values = new Float64Array(bytes.length / 2);
  for (let i = 0; i < values.length; i++) {
    const whole = view.getUint16(2 * i, true);
    values[i] = whole === NOTHING ? NaN : low + step * whole;
  }
  return { shape, values };
}

function unpackScene(packed) {
  const scene = { ...packed };
  for (const [name, entry] of Object.entries(packed)) {
    if (entry && entry.data !== undefined) scene[name] = unpack(entry);
  }
  if (packed.arrows) scene.arrows = { ...packed.arrows, force: unpack(packed.arrows.force),
    root: unpack(packed.arrows.root) };
  scene.std = deviations(scene);
  return scene;
}

// One row of an array: row(scene.centre, f, n) is a list of three numbers.
function row({ shape, values }, ...at) {
  let first = 0;
  for (let i = 0; i < at.length; i++) first = first * shape[i] + at[i];
  let size = 1;
  for (let i = at.length; i < shape.length; i++) size *= shape[i];
  return Array.from(values.subarray(first * size, (first + 1) * size));
}

// The root of the total position variance, (F, N): the size of the symmetric root.
function deviations({ root }) {
  const [moments, along] = root.shape;
  const std = new Float64Array(moments * along);
  for (let i = 0; i < std.length; i++) {
    const [xx, xy, xz, yy, yz, zz] = root.values.subarray(6 * i, 6 * i + 6);
    std[i] = Math.sqrt(xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz));
  }
  return { shape: [moments, along], values: std };
}

// The moment nearest to a time.
function momentAt(scene, time) {
  let low = 0, high = scene.time.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (scene.time[middle + 1] + scene.time[middle] > 2 * time) high = middle;
    else low = middle + 1;
  }
  return low;
}

// Columns of the rotation of a unit quaternion [w, x, y, z].
function axesOf([w, x, y, z]) {
  const s = 2 / (w * w + x * x + y * y + z * z);
  return [
    [1 - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)],
    [s * (x * y - w * z), 1 - s * (x * x + z * z), s * (y * z + w * x)],
    [s * (x * z + w * y), s * (y * z - w * x), 1 - s * (x * x + y * y)],
  ];
}

// The body at a moment: a list of {centre, axes, root, std}.
function bodyAt(scene, moment) {
  return scene.arclength.map((_, n) => {
    const [xx, xy, xz, yy, yz, zz] = row(scene.root, moment, n);
    return {
      centre: row(scene.centre, moment, n),
      axes: axesOf(row(scene.quaternion, moment, n)),
      root: [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]],
      std: row(scene.std, moment, n)[0],
    };
  });
}

// The point before an arclength and how far it is to the next, 0 to 1; points lie as they like.
function cellOf(points, arclength) {
  const after = points.findIndex((s) => s > arclength);
  const low = Math.max((after < 0 ? points.length : after) - 1, 0);
  const cell = Math.min(low, points.length - 2);
  const share = (arclength - points[cell]) / (points[cell + 1] - points[cell]);
  return [cell, Math.min(Math.max(share, 0), 1)];
}

// Where the body is at an arclength: {centre, axes, std}, on the chord of two neighbours.
function bodyPoint(scene, body, arclength) {
  const [low, share] = cellOf(scene.arclength, arclength);
  const [a, b] = [body[low], body[low + 1]];
  const centre = a.centre.map((c, i) => c + share * (b.centre[i] - c));
  const near = share < 0.5 ? a : b;
  return { centre, axes: near.axes, std: a.std + share * (b.std - a.std) };
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, t = 1) => [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0]];
function unit(a) {
  const size = Math.hypot(...a);
  return size > 0 ? a.map((c) => c / size) : [0, 0, 0];
}

// The section of a point's ellipsoid, `scale` standard deviations wide: the symmetric root
// [[a, b], [b, c]] of the covariance across the body, and its deviation along.
function sectionOf({ axes, root }, scale) {
  const rows = axes.map((axis) => root.map((r) => dot(r, axis))); // in the body frame
  const [xx, xy, yy, zz] = [[0, 0], [0, 1], [1, 1], [2, 2]].map(([i, j]) => dot(rows[i], rows[j]));
  const product = Math.sqrt(Math.max(xx * yy - xy * xy, 0));
  const total = Math.sqrt(xx + yy + 2 * product + 1e-24) / scale;
  return { a: (xx + product) / total, b: xy / total, c: (yy + product) / total,
    along: scale * Math.sqrt(zz) };
}

const round = (radius) => ({ a: radius, b: 0, c: radius, along: 0 });

// A surface swept along points {centre, axes} with a section each, rounded off at both ends.
function sweep(points, sections, colours, around = 24, cap = 4) {
  const last = points.length - 1, rings = [];
  for (let i = 0; i < cap; i++) rings.push([0, (Math.PI / 2) * (i / cap - 1)]);
  for (let i = 0; i <= last; i++) rings.push([i, 0]);
  for (let i = cap - 1; i >= 0; i--) rings.push([last, (Math.PI / 2) * (1 - i / cap)]);
  const vertices = [];
  for (const [i, tilt] of rings) {
    const { centre, axes } = points[i], { a, b, c, along } = sections[i];
    const wide = Math.cos(tilt), far = Math.sin(tilt);
    for (let j = 0; j < around; j++) {
      const angle = (2 * Math.PI * j) / around, x = Math.cos(angle), y = Math.sin(angle);
      const off = [wide * (a * x + b * y), wide * (b * x + c * y), far * along];
      let flat = unit([c * x - b * y, a * y - b * x, 0]); // across the ellipse, not its radius
      if (!flat[0] && !flat[1]) flat = [x, y, 0];
      const normal = [wide * flat[0], wide * flat[1], far];
      const turned = (v) => axes[0].map((_, k) => axes[0][k] * v[0] + axes[1][k] * v[1]
        + axes[2][k] * v[2]);
      vertices.push(...plus(centre, turned(off)), ...turned(normal), ...colours[i]);
    }
  }
  return { vertices, indices: sheet(rings.length, around) };
}

// The surface of the points `scale` standard deviations away.
function ellipsoid({ centre, root }, scale, colour, around = 20, down = 11) {
  const [[xx, xy, xz], [, yy, yz], [, , zz]] = root, vertices = [];
  const inverse = [[yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy],
    [xz * yz - xy * zz, xx * zz - xz * xz, xy * xz - xx * yz],
    [xy * yz - xz * yy, xy * xz - xx * yz, xx * yy - xy * xy]]; // times the determinant
  for (let i = 0; i < down; i++) {
    const polar = (Math.PI * i) / (down - 1);
    for (let j = 0; j < around; j++) {
      const angle = (2 * Math.PI * j) / around;
      const u = [Math.sin(polar) * Math.cos(angle), Math.sin(polar) * Math.sin(angle),
        Math.cos(polar)];
      const at = plus(centre, root.map((r) => dot(r, u)), scale);
      vertices.push(...at, ...unit(inverse.map((r) => dot(r, u))), ...colour);
    }
  }
  return { vertices, indices: sheet(down, around) };
}

// What surrounds the robot: triangles, each lit by its own normal.
function solidOf({ vertices, triangles, colour, clear }) {
  const mesh = { vertices: [], indices: [] }, tint = rgb(colour);
  for (const corners of triangles) {
    const [a, b, c] = corners.map((i) => vertices[i]);
    const normal = unit(cross(plus(b, a, -1), plus(c, a, -1)));
    for (const at of [a, b, c]) {
      mesh.indices.push(mesh.vertices.length / 9);
      mesh.vertices.push(...at, ...normal, ...tint);
    }
  }
  return { mesh, clear };
}

// Triangles between neighbouring rings of `around` vertices.
function sheet(rings, around) {
  const indices = [];
  for (let i = 0; i + 1 < rings; i++) {
    for (let j = 0; j < around; j++) {
      const a = i * around + j, b = i * around + ((j + 1) % around);
      indices.push(a, b, a + around, b, b + around, a + around);
    }
  }
  return indices;
}

// A round rod from one point to another.
function rod(from, to, radius, colour) {
  const z = unit(plus(to, from, -1));
  const x = unit(cross(Math.abs(z[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], z));
  const axes = [x, cross(z, x), z];
  const ends = [from, to].map((centre) => ({ centre, axes }));
  return sweep(ends, [round(radius), round(radius)], [colour, colour], 10, 1);
}

// The forces on the robot at a moment: a list of {place, from, force, centre, root}, where centre is
// the tip of the arrow and root that of its covariance, all in metres of the picture.
function forcesAt(scene, body, moment) {
  return scene.arrows.place.map((place, i) => {
    const from = bodyPoint(scene, body, place).centre, force = row(scene.arrows.force, moment, i);
    const [xx, xy, xz, yy, yz, zz] = row(scene.arrows.root, moment, i);
    return { place, from, force, centre: plus(from, force),
      root: [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] };
  });
}

// A rod that ends in a cone.
function arrow({ from, force, centre }, radius, colour) {
  const head = Math.min(1, (8 * radius) / Math.max(Math.hypot(...force), 1e-12));
  const neck = plus(centre, force, -head), shaft = rod(from, neck, radius, colour);
  const z = unit(force), x = unit(cross(Math.abs(z[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], z));
  const ends = [neck, centre].map((at) => ({ centre: at, axes: [x, cross(z, x), z] }));
  return joined([shaft, sweep(ends, [round(3 * radius), round(0)], [colour, colour], 16, 1)]);
}

function joined(meshes) {
  const out = { vertices: [], indices: [] };
  for (const { vertices, indices } of meshes) {
    const first = out.vertices.length / 9;
    for (const v of vertices) out.vertices.push(v);
    for (const i of indices) out.indices.push(first + i);
  }
  return out;
}

// A parallel view: `half` the metres from the middle of the picture to its nearer edge. Gives the
// unit vectors right, up and towards the eye, and the matrix of the graphics card.
function viewOf({ yaw, pitch, half, target }, width, height) {
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  const right = [-sy, cy, 0], up = [-sp * cy, -sp * sy, cp], eye = [cp * cy, cp * sy, sp];
  const smaller = Math.min(width, height), deep = 20 * half + 4;
  const rows = [[right, smaller / width / half], [up, smaller / height / half], [eye, -1 / deep]];
  const scaled = rows.map(([axis, size]) => [...axis.map((c) => c * size),
    -size * dot(axis, target)]);
  const matrix = [0, 1, 2, 3].flatMap((c) => [...scaled.map((r) => r[c]), c === 3 ? 1 : 0]);
  return { right, up, eye, matrix, pixel: (2 * half) / smaller };
}

// Where a point is in a picture of that size: [x, y] in pixels from its upper left corner.
function project({ matrix }, [x, y, z], width, height) {
  const [u, v] = [0, 1].map((i) => matrix[i] * x + matrix[4 + i] * y + matrix[8 + i] * z
    + matrix[12 + i]);
  return [(0.5 + 0.5 * u) * width, (0.5 - 0.5 * v) * height];
}

// The largest of 1, 2, 5 times a power of ten that is not above a length.
function roundBelow(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return power * [5, 2, 1].find((n) => n * power <= length * (1 + 1e-9));
}
