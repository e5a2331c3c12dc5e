"use strict";
(() => {
const byId = (id) => document.getElementById(id);
const { tile: TILE, steps: STEPS, layers } = JSON.parse(byId("page").textContent);
const texts = byId("tiles").textContent.split("\n");
const canvas = byId("canvas"), overview = byId("overview"), root = document.documentElement;
const dark = matchMedia("(prefers-color-scheme: dark)");
const setTheme = (on) => { root.dataset.theme = on ? "dark" : "light"; };
setTheme(dark.matches);

for (const layer of layers) {
  layer.rgb = Uint8Array.from(atob(layer.palette), (c) => c.charCodeAt(0));
  layer.width = layer.size[0] * layer.pitch;
  layer.height = layer.size[1] * layer.pitch;
  for (const level of layer.levels) {
    level.side = layer.pitch * 2 ** level.halvings;  // of a sample, in um
    level.across = Math.ceil(level.size[0] / TILE);
    level.down = Math.ceil(level.size[1] / TILE);
  }
}

// What is shown: a layer, and for each plane the point in the middle (um) and the pixels for a um.
const views = {};
let current = 0, pointer = null;
const shown = () => layers[current];
const view = () => views[shown().plane];
const stageSize = () => [canvas.clientWidth, canvas.clientHeight];
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

function fit() {
  const layer = shown(), [w, h] = stageSize();
  const scale = Math.min(Math.max(w - 16, 1) / layer.width, Math.max(h - 16, 1) / layer.height);
  views[layer.plane] = { x: layer.left + 0.5 * layer.width, y: layer.top - 0.5 * layer.height, scale, fitted: true };
}
function place(x, y, scale) {
  const layer = shown(), [w, h] = stageSize();
  const least = 0.5 * Math.min(w / layer.width, h / layer.height);
  views[layer.plane] = {
    x: clamp(x, layer.left, layer.left + layer.width),
    y: clamp(y, layer.top - layer.height, layer.top),
    scale: clamp(scale, Math.min(least, 1 / layer.pitch), 64 / layer.pitch),
    fitted: false,
  };
  redraw();
}
const positionAt = ([px, py]) => {
  const { x, y, scale } = view(), [w, h] = stageSize();
  return [x + (px - 0.5 * w) / scale, y - (py - 0.5 * h) / scale];
};
function zoomBy(factor, at) {
  const [w, h] = stageSize(), [px, py] = at ?? [0.5 * w, 0.5 * h], [x, y] = positionAt([px, py]);
  const layer = shown(), scale = clamp(view().scale * factor, 1e-9, 64 / layer.pitch);
  place(x - (px - 0.5 * w) / scale, y + (py - 0.5 * h) / scale, scale);
}
const moveBy = (px, py) => { const { x, y, scale } = view(); place(x - px / scale, y + py / scale, scale); };

// Tiles as they were decoded: levels of 8 bits, and a canvas for them in the layer's colours.
const decoded = new Map(), MOST_DECODED = 120;
let clock = 0, failed = "", awaited = false;
function tileAt(layer, level, column, row) {
  const number = level.first + row * level.across + column;
  let entry = decoded.get(number);
  if (!entry) { entry = { ready: false }; decoded.set(number, entry); decode(layer, number, entry); }
  entry.used = clock;
  return entry;
}
async function decode(layer, number, entry) {
  try {
    const bytes = Uint8Array.from(atob(texts[number]), (c) => c.charCodeAt(0));
    const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/png" }), { colorSpaceConversion: "none" });
    const picture = document.createElement("canvas");
    [picture.width, picture.height] = [bitmap.width, bitmap.height];
    const context = picture.getContext("2d", { willReadFrequently: true });
    context.drawImage(bitmap, 0, 0);
    const { data } = context.getImageData(0, 0, bitmap.width, bitmap.height);
    const levels = Uint8Array.from({ length: data.length / 4 }, (_, i) => data[4 * i]);
    Object.assign(entry, { ready: true, picture, context, levels });
  } catch (error) {
    failed = `a tile of the picture cannot be decoded (${error.message})`;
  }
  redraw();
}
// Once in the colours of the layer, and again when these were moved.
function coloured(layer, entry) {
  if (entry.colours !== layer.colours) {
    const { levels, picture, context } = entry, pixels = context.createImageData(picture.width, picture.height), { data } = pixels;
    for (let i = 0, at = 0; i < levels.length; i++, at += 4) {
      const from = 3 * levels[i];
      data[at] = layer.colours[from];
      data[at + 1] = layer.colours[from + 1];
      data[at + 2] = layer.colours[from + 2];
      data[at + 3] = levels[i] ? 255 : 0;
    }
    context.putImageData(pixels, 0, 0);
    entry.colours = layer.colours;
  }
  return entry.picture;
}
// The palette stretched over a part of the range.
function stretch(layer, from, to) {
  layer.window = [from, to];
  layer.colours = new Uint8Array(3 * (STEPS + 2));
  for (let step = 1; step <= STEPS + 1; step++) {
    const at = Math.round(STEPS * clamp((step - 1 - from) / (to - from), 0, 1));
    layer.colours.set(layer.rgb.subarray(3 * at, 3 * at + 3), 3 * step);
  }
}
function forget() {
  if (decoded.size <= MOST_DECODED) return;
  const idle = [...decoded].filter(([, entry]) => entry.used < clock).sort((a, b) => a[1].used - b[1].used);
  for (const [number] of idle.slice(0, decoded.size - MOST_DECODED)) decoded.delete(number);
}

// Index of the level whose samples are just finer than the pixels of the screen, or the finest there is.
function levelFor(layer, pixelsPerUm) {
  const wanted = Math.floor(Math.log2(1 / (pixelsPerUm * layer.pitch)) + 1e-9), { levels } = layer;
  return clamp(wanted - levels[0].halvings, 0, levels.length - 1);
}

// The tile if it is decoded; else the part of a coarser one that lies there.
function best(layer, index, column, row) {
  for (let up = 0; index + up < layer.levels.length; up++) {
    const level = layer.levels[index + up], c = column >> up, r = row >> up;
    const entry = tileAt(layer, level, c, r);
    if (!entry.ready) { awaited = true; continue; }
    const part = TILE / 2 ** up, x = (column - (c << up)) * part, y = (row - (r << up)) * part;
    const picture = coloured(layer, entry), { width, height } = picture;
    return { picture, x, y, w: Math.min(part, width - x), h: Math.min(part, height - y), side: level.side };
  }
  return null;
}

function paint(context, width, height, { x, y, scale }, layer) {
  const left = 0.5 * width + (layer.left - x) * scale, top = 0.5 * height + (y - layer.top) * scale;
  const index = levelFor(layer, scale), level = layer.levels[index], step = TILE * level.side * scale;
  const first = (edge) => Math.max(0, Math.floor(-edge / step));
  const last = (edge, size, count) => Math.min(count - 1, Math.floor((size - edge) / step));
  context.save();
  context.beginPath();  // samples of coarse levels may reach beyond the picture
  context.rect(left, top, layer.width * scale, layer.height * scale);
  context.clip();
  for (let row = first(top); row <= last(top, height, level.down); row++) {
    for (let column = first(left); column <= last(left, width, level.across); column++) {
      const part = best(layer, index, column, row);
      if (!part) continue;
      const [x0, y0] = [left + column * step, top + row * step], size = part.side * scale;
      const [a, b, c, d] = [x0, y0, x0 + part.w * size, y0 + part.h * size].map(Math.round);
      context.imageSmoothingEnabled = size < 2;
      context.drawImage(part.picture, part.x, part.y, part.w, part.h, a, b, c - a, d - b);
    }
  }
  context.restore();
}

const short = (x) => {
  const text = Math.abs(x) >= 1e5 || (x !== 0 && Math.abs(x) < 1e-3) ? x.toExponential(2) : String(+x.toPrecision(3));
  return text.replace("-", "−");
};
const fixed = (x, digits) => x.toFixed(digits).replace(/^-(?=[\d.]*[1-9])/, "−").replace(/^-/, "");
const length = (um) => um >= 1000 ? `${short(um / 1000)} mm` : um >= 1 ? `${short(um)} µm` : `${short(1000 * um)} nm`;
function valueOf(layer, step) {
  const share = (step - 1) / STEPS;
  return layer.logarithmic ? layer.low * (layer.high / layer.low) ** share : layer.low + share * (layer.high - layer.low);
}

// Level of 8 bits at a point of the layer, from the finest decoded tile of those that are drawn.
function stepAt(layer, x, y, pixelsPerUm) {
  const dx = x - layer.left, dy = layer.top - y;
  if (dx < 0 || dy < 0 || dx >= layer.width || dy >= layer.height) return null;
  for (let index = levelFor(layer, pixelsPerUm); index < layer.levels.length; index++) {
    const level = layer.levels[index], column = Math.floor(dx / level.side), row = Math.floor(dy / level.side);
    const entry = tileAt(layer, level, Math.floor(column / TILE), Math.floor(row / TILE));
    if (entry.ready) return { step: entry.levels[(row % TILE) * entry.picture.width + column % TILE], level };
  }
  return null;
}
function tell(pixelsPerUm) {
  const layer = shown(), [w, h] = stageSize(), [x, y] = positionAt(pointer ?? [0.5 * w, 0.5 * h]);
  const digits = clamp(Math.ceil(Math.log10(view().scale)), 0, 3);
  const found = stepAt(layer, x, y, pixelsPerUm), many = found ? 2 ** found.level.halvings : 1;
  let value = "beyond the picture";
  if (found) {
    const end = found.step === 1 && layer.beyond[0] ? "≤ " : found.step === STEPS + 1 && layer.beyond[1] ? "≥ " : "";
    value = found.step === 0 ? "no value" : `${layer.unit ? "" : `${layer.name} `}${end}${short(valueOf(layer, found.step))} ${layer.unit}`.trim();
    if (many > 1 && found.step) value += ` (mean of ${many} × ${many} samples)`;
  }
  byId("readout").textContent = failed || `${pointer ? "" : "middle: "}x ${fixed(x, digits)} µm, y ${fixed(y, digits)} µm: ${value}`;
}

let waiting = false;
function redraw() { if (!waiting) { waiting = true; requestAnimationFrame(() => { waiting = false; draw(); }); } }
function sized(which, w, h) {
  const ratio = devicePixelRatio || 1, [across, down] = [w, h].map((n) => Math.max(1, Math.round(n * ratio)));
  if (which.width !== across || which.height !== down) [which.width, which.height] = [across, down];
  const context = which.getContext("2d");
  context.clearRect(0, 0, across, down);
  return [context, across, down, ratio];
}
function draw() {
  if (view().fitted) fit();
  clock++;
  awaited = false;
  const layer = shown(), [w, h] = stageSize(), { x, y, scale } = view();
  const [context, across, down, ratio] = sized(canvas, w, h);
  paint(context, across, down, { x, y, scale: scale * ratio }, layer);
  if (canvas.matches(":focus-visible") && !pointer) drawCross(context, 0.5 * across, 0.5 * down, ratio);
  drawOverview(layer);
  drawBar(scale);
  tell(scale * ratio);
  canvas.setAttribute("aria-busy", awaited && !failed);
  forget();
  remember();
}
// For those who move by keys: where the value is read.
function drawCross(context, x, y, ratio) {
  const arm = 8 * ratio;
  for (const [colour, line] of [["#000", 4], ["#ffb703", 2]]) {
    Object.assign(context, { strokeStyle: colour, lineWidth: line * ratio });
    context.beginPath();
    for (const [a, b] of [[arm, 0], [0, arm]]) { context.moveTo(x - a, y - b); context.lineTo(x + a, y + b); }
    context.stroke();
  }
}
function drawOverview(layer) {
  const [w, h] = stageSize(), most = Math.min(150, 0.28 * Math.min(w, h));
  const small = most / Math.max(layer.width, layer.height), { x, y, scale } = view();
  const [width, height] = [layer.width * small, layer.height * small];
  const all = w >= layer.width * scale && h >= layer.height * scale;  // it would only hide a part of what it shows
  Object.assign(overview.style, { width: `${width}px`, height: `${height}px`, display: all ? "none" : "block" });
  if (all) return;
  const [context, across, down, ratio] = sized(overview, width, height), s = small * ratio;
  paint(context, across, down, { x: layer.left + 0.5 * layer.width, y: layer.top - 0.5 * layer.height, scale: s }, layer);
  const [a, b] = [(x - layer.left - 0.5 * w / scale) * s, (layer.top - y - 0.5 * h / scale) * s];
  const [l, t, r, m] = [a, b, a + w / scale * s, b + h / scale * s].map((n, i) => clamp(n, 1, (i % 2 ? down : across) - 1));
  for (const [colour, line] of [["#000", 4], ["#ffb703", 2]]) {
    Object.assign(context, { strokeStyle: colour, lineWidth: line * ratio });
    context.strokeRect(l, t, Math.max(r - l, 1), Math.max(m - t, 1));
  }
}
function drawBar(scale) {
  const most = 130 / scale, unit = 10 ** Math.floor(Math.log10(most));
  const um = unit * [5, 2, 1].find((n) => n * unit <= most);
  const [text, line] = byId("bar").children;
  text.textContent = length(um);
  line.style.width = `${um * scale}px`;
}

// page.html#layer=phase&x=12&y=-3&scale=2 opens there: um, and pixels for a um.
let later = 0;
function remember() {
  clearTimeout(later);
  later = setTimeout(() => {
    const { x, y, scale, fitted } = view(), asked = new URLSearchParams({ layer: shown().name });
    if (!fitted) for (const [name, n] of Object.entries({ x, y, scale })) asked.set(name, +n.toPrecision(6));
    try { history.replaceState(null, "", `#${asked}`); } catch { /* a browser may not allow it for files */ }
  }, 300);
}
function recall() {
  const asked = new URLSearchParams(location.hash.slice(1));
  const number = layers.findIndex((layer) => layer.name === asked.get("layer"));
  choose(Math.max(number, 0));
  fit();
  const [x, y, scale] = ["x", "y", "scale"].map((name) => asked.has(name) ? Number(asked.get(name)) : NaN);
  const here = view(), or = (value, other) => Number.isFinite(value) ? value : other;
  if ([x, y, scale].some(Number.isFinite)) place(or(x, here.x), or(y, here.y), scale > 0 ? or(scale, here.scale) : here.scale);
  redraw();
}

function choose(number) {
  current = number;
  const layer = shown(), [wide, high] = layer.size, finest = layer.levels[0].halvings;
  for (const box of document.querySelectorAll("[name=layer]")) box.checked = +box.value === number;
  if (!view()) fit();
  const pixels = new ImageData(STEPS + 1, 1);
  for (let i = 0; i <= STEPS; i++) pixels.data.set([...layer.rgb.subarray(3 * i, 3 * i + 3), 255], 4 * i);
  byId("ramp").getContext("2d").putImageData(pixels, 0, 0);
  const unit = layer.unit ? ` ${layer.unit}` : "";
  showWindow();
  const about = [layer.left + 0.5 * layer.width, layer.top - 0.5 * layer.height];
  const off = about.some((n) => Math.abs(n) > 0.01 * layer.pitch) ? ` about ${about.map((n) => short(n / 1000)).join(", ")} mm` : "";
  byId("size").textContent = `${length(layer.width)} × ${length(layer.height)}${off}`;
  byId("samples").textContent = `${wide} × ${high} of ${length(layer.pitch)}`;
  const step = layer.logarithmic ? `${short(100 * ((layer.high / layer.low) ** (1 / STEPS) - 1))} %` : short((layer.high - layer.low) / STEPS) + unit;
  byId("known").textContent = `${step} (1/${STEPS} of the range)`;
  byId("left-out").textContent = finest ? `There was no room for every sample: the finest that this page shows are means of ${2 ** finest} × ${2 ** finest}.` : "";
  redraw();
}

function showWindow() {
  const layer = shown(), unit = layer.unit ? ` ${layer.unit}` : "";
  layer.window.forEach((step, i) => {
    byId("ends").children[i].textContent = short(valueOf(layer, step + 1)) + unit;
    const slider = byId(i ? "to" : "from");
    slider.value = step;
    slider.setAttribute("aria-valuetext", byId("ends").children[i].textContent);
  });
}
for (const name of ["from", "to"]) {
  byId(name).addEventListener("input", () => {
    const [from, to] = [+byId("from").value, +byId("to").value];
    stretch(shown(), ...(name === "from" ? [Math.min(from, to - 1), to] : [from, Math.max(to, from + 1)]));
    showWindow();
    redraw();
  });
}
byId("whole").addEventListener("click", () => { stretch(shown(), 0, STEPS); showWindow(); redraw(); });

// One pointer moves, two pinch.
const pointers = new Map();
const within = (e) => { const box = canvas.getBoundingClientRect(); return [e.clientX - box.left, e.clientY - box.top]; };
canvas.addEventListener("pointerdown", (e) => {
  canvas.setPointerCapture(e.pointerId);
  pointers.set(e.pointerId, within(e));
  canvas.classList.add("moved");
});
canvas.addEventListener("pointermove", (e) => {
  const now = within(e), before = pointers.get(e.pointerId);
  pointer = now;
  if (before) {
    const other = [...pointers].find(([id]) => id !== e.pointerId)?.[1];
    pointers.set(e.pointerId, now);
    if (other) {
      const apart = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]) || 1;
      moveBy(0.5 * (now[0] - before[0]), 0.5 * (now[1] - before[1]));
      zoomBy(apart(now) / apart(before), [0.5 * (now[0] + other[0]), 0.5 * (now[1] + other[1])]);
    } else moveBy(now[0] - before[0], now[1] - before[1]);
  }
  redraw();
});
for (const name of ["pointerup", "pointercancel"]) {
  canvas.addEventListener(name, (e) => { pointers.delete(e.pointerId); if (!pointers.size) canvas.classList.remove("moved"); });
}
canvas.addEventListener("pointerleave", () => { pointer = null; redraw(); });
canvas.addEventListener("wheel", (e) => {
  e.preventDefault();
  zoomBy(Math.exp(-e.deltaY * (e.ctrlKey ? 0.01 : e.deltaMode ? 0.05 : 0.0015)), within(e));  // ctrl: a pinch
}, { passive: false });
canvas.addEventListener("dblclick", (e) => zoomBy(e.shiftKey ? 0.5 : 2, within(e)));
const jump = (e) => {
  if (!(e.buttons & 1)) return;
  const layer = shown(), box = overview.getBoundingClientRect();
  const [x, y] = [(e.clientX - box.left) / box.width, (e.clientY - box.top) / box.height];
  place(layer.left + x * layer.width, layer.top - y * layer.height, view().scale);
};
overview.addEventListener("pointerdown", (e) => { overview.setPointerCapture(e.pointerId); jump(e); });
overview.addEventListener("pointermove", jump);

const actions = {
  in: () => zoomBy(1.5),
  out: () => zoomBy(1 / 1.5),
  fit: () => { fit(); redraw(); },
  one: () => place(view().x, view().y, 1 / (shown().pitch * (devicePixelRatio || 1))),
  next: () => choose((current + 1) % layers.length),
};
const keys = { "+": "in", "=": "in", "-": "out", 0: "fit", 1: "one", l: "next", L: "next" };
canvas.addEventListener("keydown", (e) => {
  const steps = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] };
  if (e.ctrlKey || e.metaKey || e.altKey) return;
  if (steps[e.key]) moveBy(...steps[e.key]);
  else if (keys[e.key]) actions[keys[e.key]]();
  else return;
  e.preventDefault();
});
for (const button of document.querySelectorAll("[data-do]")) button.addEventListener("click", actions[button.dataset.do]);
for (const box of document.querySelectorAll("[name=layer]")) box.addEventListener("change", () => choose(+box.value));
byId("theme").addEventListener("click", () => { setTheme(root.dataset.theme === "light"); redraw(); });
dark.addEventListener("change", () => { setTheme(dark.matches); redraw(); });
for (const name of ["focus", "blur"]) canvas.addEventListener(name, redraw);
new ResizeObserver(draw).observe(canvas);  // at once: the old picture would be shown stretched
addEventListener("hashchange", recall);
for (const layer of layers) stretch(layer, 0, STEPS);
recall();
})();
