// The flat pictures: the curve along the body, the map over time, and marks over the stage.

const SENSORS = ["#e69f00", "#56b4e9", "#cc79a7", "#d55e00", "#f0e442", "#009e73"];
const sensorColour = (i) => SENSORS[i % SENSORS.length];
const inMm = (metres, digits = 1) => (1000 * metres).toFixed(digits);
const css = (name) => getComputedStyle(document.body).getPropertyValue(name).trim();
const hex = (colour) => `rgb(${colour.map((c) => Math.round(255 * c)).join(" ")})`;

// The canvas sized to its place on the page, cleared; its pen in CSS pixels.
function penOn(canvas) {
  const dense = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * dense);
  canvas.height = Math.round(height * dense);
  const pen = canvas.getContext("2d");
  pen.setTransform(dense, 0, 0, dense, 0, 0);
  pen.font = "12px system-ui, sans-serif";
  return { pen, width, height };
}

function drawRamp(canvas) {
  const { pen, width, height } = penOn(canvas);
  for (let x = 0; x < width; x++) {
    pen.fillStyle = hex(colourOf(x / (width - 1)));
    pen.fillRect(x, 0, 1, height);
  }
}

// Deviation along the body now; sensors as dots on it, distances to truth as crosses.
function drawCurve(canvas, scene, body, moment) {
  const { pen, width, height } = penOn(canvas);
  const [left, right, above, below] = [34, 8, 6, 18], first = scene.arclength[0];
  const long = scene.arclength.at(-1) - first;
  const x = (s) => left + ((s - first) / long) * (width - left - right);
  const y = (v) => height - below - (v / scene.tall) * (height - above - below);
  pen.strokeStyle = css("--rule");
  pen.fillStyle = css("--faint");
  pen.textAlign = "right";
  for (let v = 0, step = roundBelow(scene.tall / 2.2); v <= scene.tall; v += step) {
    line(pen, [[left, y(v)], [width - right, y(v)]]);
    pen.fillText(+inMm(v, 3), left - 5, y(v) + 4);
  }
  pen.textAlign = "center";
  for (let s = 0, step = roundBelow(long / 3); s <= long + 1e-9; s += step) {
    pen.fillText(inMm(first + s, 0), Math.min(x(first + s), width - 14), height - 4);
  }
  pen.lineWidth = 3;
  for (let n = 1; n < body.length; n++) {
    pen.strokeStyle = hex(colourOf(body[n].std / scene.top));
    line(pen, [n - 1, n].map((i) => [x(scene.arclength[i]), y(Math.min(body[i].std, scene.tall))]));
  }
  pen.lineWidth = 1.6;
  pen.strokeStyle = css("--ink");
  scene.sites.forEach((_, i) => {
    const miss = row(scene.miss, moment, i)[0];
    if (Number.isNaN(miss)) return;
    const at = x(row(scene.site_place, moment, i)[0]), off = y(Math.min(miss, scene.tall));
    for (const s of [-4, 4]) line(pen, [[at - 4, off - s], [at + 4, off + s]]);
  });
  sensorsAt(scene, moment).forEach(({ place, colour }) => {
    const { std } = bodyPoint(scene, body, place);
    disc(pen, x(place), y(Math.min(std, scene.tall)), 5, colour);
  });
}

// The sensors that have a reading now.
function sensorsAt(scene, moment) {
  return scene.sensors.map((name, i) => ({ name, place: row(scene.place, moment, i)[0],
    colour: sensorColour(i) })).filter(({ place }) => !Number.isNaN(place));
}

function line(pen, points) {
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
}

function disc(pen, x, y, radius, colour) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
  pen.fillStyle = colour;
  pen.fill();
  pen.strokeStyle = css("--ink");
  pen.lineWidth = 1.2;
  pen.stroke();
}

const HEAT_ROWS = 128;

// The deviation at every moment (left to right) and arclength (base below) as one picture.
function heatOf(scene) {
  const moments = scene.std.shape[0], points = scene.arclength.length, along = HEAT_ROWS;
  const first = scene.arclength[0], long = scene.arclength.at(-1) - first;
  const cells = Array.from({ length: along }, (_, n) =>
    cellOf(scene.arclength, first + (long * n) / (along - 1)));
  const picture = document.createElement("canvas");
  [picture.width, picture.height] = [moments, along];
  const pen = picture.getContext("2d");
  const pixels = pen.createImageData(moments, along);
  for (let f = 0; f < moments; f++) {
    for (let n = 0; n < along; n++) {
      const [cell, share] = cells[n], at0 = f * points + cell, std = scene.std.values;
      const colour = colourOf((std[at0] + share * (std[at0 + 1] - std[at0])) / scene.top);
      const at = 4 * ((along - 1 - n) * moments + f);
      pixels.data.set([...colour.map((c) => 255 * c), 255], at);
    }
  }
  pen.putImageData(pixels, 0, 0);
  return picture;
}

function drawHeat(canvas, scene, heat, moment) {
  const { pen, width, height } = penOn(canvas), last = scene.time.length - 1;
  const first = scene.arclength[0], long = scene.arclength.at(-1) - first;
  const x = (f) => (last ? (f / last) * width : width / 2);
  pen.drawImage(heat, 0, 0, width, height);
  scene.sensors.forEach((_, i) => {
    for (const [colour, wide] of [["#000000a0", 3.5], [sensorColour(i), 1.8]]) {
      pen.strokeStyle = colour;
      pen.lineWidth = wide;
      pen.beginPath();
      for (let f = 0, drawn = false; f <= last; f++) {
        const place = row(scene.place, f, i)[0], shown = !Number.isNaN(place);
        const y = height - ((place - first) / long) * (height - 4) - 2;
        if (shown && drawn) pen.lineTo(x(f), y);
        else if (shown) pen.moveTo(x(f), y);
        drawn = shown;
      }
      pen.stroke();
    }
  });
  for (const [colour, wide] of [["#000000", 4], ["#ffffff", 2]]) {
    pen.strokeStyle = colour;
    pen.lineWidth = wide;
    line(pen, [[x(moment), 0], [x(moment), height]]);
    pen.lineWidth = 3;
    pen.fillStyle = colour;
    for (const [name, y] of [["tip", 14], ["base", height - 6]]) {
      if (wide > 2) pen.strokeText(name, 6, y);
      else pen.fillText(name, 6, y);
    }
  }
}

// Scale bar, axes and names over the stage.
function drawMarks(canvas, scene, body, moment, view, shown) {
  const { pen, width, height } = penOn(canvas);
  const length = roundBelow(Math.min(0.3 * width, 220) * view.pixel), wide = length / view.pixel;
  const ground = height - 16;
  pen.strokeStyle = pen.fillStyle = css("--ink");
  pen.lineWidth = 2;
  line(pen, [[16, ground - 5], [16, ground], [16 + wide, ground], [16 + wide, ground - 5]]);
  pen.fillText(`${+(1000 * length).toPrecision(3)} mm`, 20, ground - 6);
  const corner = [width - 50, height - 46];
  [[1, 0, 0], [0, 1, 0], [0, 0, 1]].forEach((axis, i) => {
    const end = [corner[0] + 28 * dot(axis, view.right), corner[1] - 28 * dot(axis, view.up)];
    pen.strokeStyle = pen.fillStyle = css(`--${"xyz"[i]}`);
    line(pen, [corner, end]);
    pen.fillText("xyz"[i], end[0] + 0.25 * (end[0] - corner[0]) - 3,
      end[1] + 0.25 * (end[1] - corner[1]) + 4);
  });
  pen.fillStyle = css("--ink");
  const named = shown.sensors ? sensorsAt(scene, moment).map(({ name, place }) =>
    [name, bodyPoint(scene, body, place).centre]) : [];
  named.push(["base", body[0].centre], ["tip", body.at(-1).centre]);
  const labels = []; // names at one place share a line; sensors stand for the end they are at
  for (const [name, centre] of named) {
    const [x, y] = project(view, centre, width, height);
    const near = labels.find((label) => Math.hypot(label.x - x, label.y - y) < 14);
    if (!near) labels.push({ x, y, text: name });
    else if (name !== "base" && name !== "tip") near.text += `, ${name}`;
  }
  for (const { x, y, text } of labels) pen.fillText(text, x + 12, y - 10);
}
