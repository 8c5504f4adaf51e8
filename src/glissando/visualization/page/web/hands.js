// What hands do: buttons, keys, one finger or two, the wheel.

const HOLDS = new Map(); // pointers that are down, where they were

function dragged(event) {
  const before = HOLDS.get(event.pointerId);
  if (!before) return;
  const now = [event.clientX, event.clientY], [dx, dy] = [now[0] - before[0], now[1] - before[1]];
  const { camera } = state, stageOf = of("stage");
  const view = viewOf(camera, stageOf.clientWidth, stageOf.clientHeight);
  const move = (x, y) => {
    camera.target = plus(plus(camera.target, view.right, -x * view.pixel), view.up, y * view.pixel);
  };
  state.moved = true;
  if (HOLDS.size === 2) {
    const [other] = [...HOLDS].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    const apart = (at) => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 10);
    move(dx / 2, dy / 2);
    zoom(apart(before) / apart(now));
  } else if (event.shiftKey || event.buttons === 2) {
    move(dx, dy);
  } else {
    camera.yaw -= 0.008 * dx;
    camera.pitch = Math.min(Math.max(camera.pitch + 0.008 * dy, -Math.PI / 2), Math.PI / 2);
  }
  HOLDS.set(event.pointerId, now);
  redraw();
}

function seek(event) {
  if (event.type === "pointermove" && !event.buttons) return;
  play(false);
  const { left, width } = of("heat").getBoundingClientRect(), last = scene.time.length - 1;
  const share = Math.min(Math.max((event.clientX - left) / width, 0), 1);
  showTime(scene.time[Math.round(share * last)]);
}

const KEYS = {
  " ": () => play(!state.playing),
  ArrowLeft: () => step(-1), ArrowRight: () => step(1),
  PageUp: () => step(-20), PageDown: () => step(20),
  Home: () => step(-Infinity), End: () => step(Infinity),
  "+": () => zoom(0.8), "=": () => zoom(0.8), "-": () => zoom(1.25), r: reset, R: reset,
};

function begin() {
  const drawing = of("stage");
  of("slider").max = scene.time.length - 1;
  if (scene.tube) {
    const { level, sigmas, blocks, seconds } = scene.tube;
    const what = seconds ? `of ${seconds} s` : "of one shape";
    of("promised").hidden = false;
    of("promised").title = `Of ${blocks} blocks ${what}; a further one like them lies wholly inside`;
    of("promised").querySelector("span").textContent = `${100 * level} % of whole bodies: `
      + `${sigmas.toFixed(1)} σ, promised`;
  }
  if (scene.arrows) {
    of("forces").hidden = false;
    of("forces").querySelector("span").textContent = scene.arrows.words;
  }
  of("slider").addEventListener("input", () => {
    play(false);
    showTime(scene.time[of("slider").value]);
  });
  for (const kind of ["pointerdown", "pointermove"]) of("heat").addEventListener(kind, seek);
  of("play").addEventListener("click", () => play(!state.playing));
  of("back").addEventListener("click", () => step(-1));
  of("on").addEventListener("click", () => step(1));
  of("reset").addEventListener("click", reset);
  document.querySelector("fieldset").addEventListener("change", redraw);
  drawing.addEventListener("pointerdown", (event) => {
    HOLDS.set(event.pointerId, [event.clientX, event.clientY]);
    drawing.setPointerCapture(event.pointerId);
  });
  drawing.addEventListener("pointermove", dragged);
  for (const kind of ["pointerup", "pointercancel"]) {
    drawing.addEventListener(kind, (event) => HOLDS.delete(event.pointerId));
  }
  drawing.addEventListener("contextmenu", (event) => event.preventDefault());
  drawing.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(0.0015 * event.deltaY));
  }, { passive: false });
  document.addEventListener("keydown", (event) => {
    const own = event.target.matches("button, select, input");
    if (own || event.ctrlKey || event.metaKey || event.altKey || !(event.key in KEYS)) return;
    event.preventDefault();
    KEYS[event.key]();
  });
  addEventListener("message", ({ source, data }) => {
    if (source !== parent || !data || !Number.isFinite(data.time)) return;
    play(false);
    showTime(data.time, false);
  });
  const fresh = () => {
    drawRamp(of("ramp"));
    redraw();
  };
  new ResizeObserver(fresh).observe(of("space"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", fresh);
  of("ticks").replaceChildren(...[0, 1, 2, 3, 4].map((i) => {
    const tick = document.createElement("span");
    tick.textContent = inMm((scene.top * i) / 4, scene.top < 0.004 ? 2 : 1) + (i < 4 ? "" : "+");
    return tick;
  }));
  of("sorry").hidden = Boolean(stage);
  of("sites").hidden = !scene.sites.length;
  of("curve-note").textContent += scene.sites.length ? "; × distance from truth" : "";
  showTime(Number((location.hash.match(/t=([\d.]+)/) || [])[1] || scene.time[0]));
}

begin();
