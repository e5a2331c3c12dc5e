"use strict";
(() => {
const byId = (id) => document.getElementById(id);
const scene = JSON.parse(byId("scene").textContent);
const canvas = byId("canvas"), root = document.documentElement, dark = matchMedia("(prefers-color-scheme: dark)");
const setTheme = (on) => { root.dataset.theme = on ? "dark" : "light"; };
setTheme(dark.matches);
const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, preserveDrawingBuffer: true });
if (!gl) { byId("missing").hidden = false; return; }

// Faces and lines have the same projection: parallel, along "towards", which points at the viewer.
const PROJECTION = `#version 300 es
precision highp float;
uniform vec3 right, up, towards;
uniform vec4 frame;  // middle of the picture in mm, and 2 / (its width, its height)
uniform vec2 span;   // middle and half of the depth
vec3 project(vec3 p) {
  return vec3((vec2(dot(right, p), dot(up, p)) - frame.xy) * frame.zw, (span.x - dot(towards, p)) / span.y);
}`;
const FACES = [PROJECTION + `
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
out vec3 across;
void main() { across = normal; gl_Position = vec4(project(position), 1.0); }`, `#version 300 es
precision highp float;
uniform vec3 right, up, towards, color;
uniform float opacity, glass, lit;
in vec3 across;
out vec4 shown;
void main() {
  vec3 n = normalize(across);
  float facing = dot(n, towards);
  n *= sign(facing);
  vec3 light = normalize(towards + 0.7 * up - 0.5 * right);
  float shine = lit * pow(max(dot(n, normalize(light + towards)), 0.0), 60.0);
  float shade = mix(1.0, 0.72 + 0.28 * max(dot(n, light), 0.0), lit);
  float rim = glass * pow(1.0 - abs(facing), 2.0);
  float a = opacity * mix(1.0, 0.5 + 1.2 * rim, glass);
  shown = vec4(mix(color * shade, vec3(0.27, 0.47, 0.62), 0.7 * rim) * a + 0.45 * shine, a);
}`];
const LINES = [PROJECTION + `
layout(location = 0) in vec3 start;
layout(location = 1) in vec3 end;
uniform vec2 pixels;
uniform float width;
void main() {
  vec3 a = project(start), b = project(end);
  vec2 run = (b.xy - a.xy) * pixels;
  vec2 along = length(run) > 1e-4 ? normalize(run) : vec2(1.0, 0.0);
  bool last = gl_VertexID > 1;
  vec2 side = vec2(-along.y, along.x) * (gl_VertexID % 2 == 0 ? 1.0 : -1.0) + along * (last ? 0.6 : -0.6);
  vec3 p = last ? b : a;
  gl_Position = vec4(p.xy + side * width / pixels, p.z - 1e-4, 1.0);
}`, `#version 300 es
precision highp float;
uniform vec3 color;
out vec4 shown;
void main() { shown = vec4(color, 1.0); }`];

function program([vertex, fragment]) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const places = {};
  for (let i = gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) - 1; i >= 0; i--) {
    const { name } = gl.getActiveUniform(made, i);
    places[name] = gl.getUniformLocation(made, name);
  }
  return { made, places };
}
const faces = program(FACES), lines = program(LINES);

const decoded = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

// Corners of triangles, with normals that are continuous within a surface but not across its edges.
function corners(vertices, indices) {
  const count = indices.length / 3, normals = [], around = [];
  for (let f = 0; f < count; f++) {
    const [a, b, c] = [0, 1, 2].map((k) => vertices.subarray(3 * indices[3 * f + k], 3 * indices[3 * f + k] + 3));
    const u = [b[0] - a[0], b[1] - a[1], b[2] - a[2]], v = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
    normals.push([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]);
    for (let k = 0; k < 3; k++) (around[indices[3 * f + k]] ??= []).push(f);
  }
  const sizes = normals.map((n) => Math.hypot(...n)), data = new Float32Array(18 * count);
  for (let i = 0; i < indices.length; i++) {
    const f = Math.floor(i / 3), sum = [0, 0, 0];
    for (const g of around[indices[i]]) {
      if (dot(normals[f], normals[g]) < scene.smooth * sizes[f] * sizes[g]) continue;
      for (let k = 0; k < 3; k++) sum[k] += normals[g][k];
    }
    data.set(vertices.subarray(3 * indices[i], 3 * indices[i] + 3), 6 * i);
    data.set(sum, 6 * i + 3);
  }
  return data;
}

// Ends of the segments of polylines; segments of zero length are omitted.
function segments(points, each) {
  const found = [];
  for (let i = 0; i + 3 < points.length; i += 3) {
    if (((i / 3) + 1) % each === 0) continue;
    const two = points.subarray(i, i + 6);
    if (two[0] !== two[3] || two[1] !== two[4] || two[2] !== two[5]) found.push(...two);
  }
  return new Float32Array(found);
}

function upload(data, perInstance) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
  for (const place of [0, 1]) {
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 24, 12 * place);
    gl.vertexAttribDivisor(place, perInstance);
  }
  return { array, count: data.length / 6 };
}

const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
const parts = scene.parts.map((part) => {
  const vertices = new Float32Array(decoded(part.vertices)), points = new Float32Array(decoded(part.lines));
  let first = Infinity, last = -Infinity;
  for (const data of [vertices, points]) {
    data.forEach((x, i) => { low[i % 3] = Math.min(low[i % 3], x); high[i % 3] = Math.max(high[i % 3], x); });
    for (let i = 2; i < data.length; i += 3) { first = Math.min(first, data[i]); last = Math.max(last, data[i]); }
  }
  const name = document.createElement("span");
  name.textContent = part.label;
  if (part.kind !== "rays") byId("labels").append(name);
  return {
    ...part, name, corners: vertices, visible: true, middle: 0.5 * (first + last), rgb: [1, 3, 5].map((i) => parseInt(part.color.slice(i, i + 2), 16) / 255),
    body: upload(corners(vertices, new Uint32Array(decoded(part.faces))), 0), wires: upload(segments(points, part.points), 1),
  };
});

const START = { turn: -122, rise: 20 };
let view, fitted;
function axes() {
  const a = view.turn * Math.PI / 180, e = view.rise * Math.PI / 180, [sa, ca, se, ce] = [Math.sin(a), Math.cos(a), Math.sin(e), Math.cos(e)];
  return { right: [ca, 0, -sa], up: [-sa * se, ce, -ca * se], towards: [sa * ce, se, ca * ce] };
}
function extent(direction) {
  let from = 0, to = 0;
  direction.forEach((d, i) => { from += Math.min(d * low[i], d * high[i]); to += Math.max(d * low[i], d * high[i]); });
  return [0.5 * (from + to), 0.5 * (to - from)];
}
// Sets pixels per mm and the middle of the picture so that everything is visible.
function fit() {
  const { right, up } = axes(), [x, halfX] = extent(right), [y, halfY] = extent(up);
  const [w, h] = [canvas.clientWidth, canvas.clientHeight];
  Object.assign(view, { x, y, zoom: Math.min((w - 100) / (2 * halfX), (h - 90) / (2 * halfY)) });
}
function look(turn, rise) { view = { turn, rise }; fit(); fitted = true; redraw(); }
function zoomBy(factor, px = 0, py = 0) {  // about a point, in pixels from the middle
  const after = Math.min(Math.max(view.zoom * factor, 0.01), 1e6), keep = 1 / view.zoom - 1 / after;
  Object.assign(view, { x: view.x + px * keep, y: view.y - py * keep, zoom: after });
}
function moveBy(px, py) { view.x -= px / view.zoom; view.y += py / view.zoom; }
function turnBy(px, py) { view.turn -= 0.4 * px; view.rise = Math.max(-90, Math.min(90, view.rise + 0.4 * py)); }

let waiting = false;
function redraw() { if (!waiting) { waiting = true; requestAnimationFrame(() => { waiting = false; draw(); }); } }
function changed() { fitted = false; redraw(); }

function use({ made, places }, shared, own) {
  gl.useProgram(made);
  for (const [name, value] of Object.entries({ ...shared, ...own })) {
    if (places[name] === undefined) continue;
    if (typeof value === "number") gl.uniform1f(places[name], value);
    else gl[`uniform${value.length}fv`](places[name], value);
  }
}
const rgbOf = (name) => getComputedStyle(root).getPropertyValue(name).trim().match(/[0-9a-f]{2}/gi).map((c) => parseInt(c, 16) / 255);
const lighter = (rgb, share) => rgb.map((c) => c + (1 - c) * share);

function draw() {
  const ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight, night = root.dataset.theme === "dark";
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
    if (fitted) fit();
  }
  const { right, up, towards } = axes(), [depth, half] = extent(towards);
  const shared = { right, up, towards, frame: [view.x, view.y, 2 * view.zoom / w, 2 * view.zoom / h], span: [depth, 1.05 * half], pixels: [w, h] };
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.clearColor(...rgbOf("--paper"), 1);
  gl.depthMask(true);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.DEPTH_TEST);
  gl.disable(gl.BLEND);
  const shown = parts.filter((part) => part.visible), solid = shown.filter((part) => part.opacity === 1);
  for (const part of solid) drawBody(part, night && part.kind === "stop" ? lighter(part.rgb, 0.55) : part.rgb, shared);
  for (const part of shown) drawWires(part, shared, night);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  gl.depthMask(false);
  // Parts do not overlap along the axis, so their order along the axis is their order in depth.
  const clear = shown.filter((part) => part.opacity < 1).sort((a, b) => (a.middle - b.middle) * (towards[2] || 1));
  for (const part of clear) {
    const glass = part.kind === "glass";
    if (glass) { gl.enable(gl.CULL_FACE); gl.cullFace(gl.FRONT); drawBody(part, part.rgb, shared); gl.cullFace(gl.BACK); }
    drawBody(part, part.rgb, shared);
    gl.disable(gl.CULL_FACE);
  }
  placeNames(right, up, w, h);
  const most = 0.25 * w / view.zoom, power = 10 ** Math.floor(Math.log10(most)), length = [5, 2, 1].find((s) => s * power <= most) * power;
  byId("bar").firstElementChild.style.width = `${length * view.zoom}px`;
  byId("bar").lastElementChild.textContent = length >= 0.1 ? `${+length.toPrecision(1)} mm` : `${+(1000 * length).toPrecision(1)} µm`;
}
function drawBody(part, color, shared) {
  if (!part.body.count) return;
  const round = part.kind === "glass" || part.kind === "stop";
  use(faces, shared, { color, opacity: part.opacity, glass: +(part.kind === "glass"), lit: +round });
  gl.bindVertexArray(part.body.array);
  gl.drawArrays(gl.TRIANGLES, 0, part.body.count);
}
function drawWires(part, shared, night) {
  if (!part.wires.count) return;
  const color = part.edge ? part.edge.match(/[0-9a-f]{2}/gi).map((c) => parseInt(c, 16) / 255) : part.rgb;
  use(lines, shared, { color: night ? lighter(color, part.edge ? 0.4 : 0.2) : color, width: part.kind === "object" ? 3 : 1.3 });
  gl.bindVertexArray(part.wires.array);
  gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, part.wires.count);
}
// Places each name above the highest or below the lowest point of its part. A name that would cross glass or another
// name is placed farther away, with a line to the point.
function placeNames(right, up, w, h) {
  const named = parts.filter((part) => part.name.parentElement), taken = [];
  for (const part of named) {
    part.seen = outline(part.corners, right, up, w, h);
    if (part.kind === "glass" && part.visible) taken.push(part.seen.box);
  }
  for (const { name, below, visible, seen } of named.sort((a, b) => (b.kind === "plane") - (a.kind === "plane"))) {
    const on = visible && byId("names").checked, [width, height] = [name.offsetWidth, name.offsetHeight];
    name.style.visibility = on ? "visible" : "hidden";
    if (!on) continue;
    const [footX, footY] = below ? seen.lowest : seen.highest, x = footX - 0.5 * width;
    let y = below ? footY + 3 : footY - 3 - height, over;
    const crosses = (b) => x - 3 < b[2] && b[0] < x + width + 3 && y < b[3] && b[1] < y + height;
    while ((over = taken.filter(crosses)).length) {
      y = below ? Math.max(...over.map((b) => b[3])) + 3 : Math.min(...over.map((b) => b[1])) - 3 - height;
    }
    name.className = below ? "below" : "";
    name.style.setProperty("--lead", `${Math.max(0, (below ? y - footY : footY - y - height) - 4)}px`);
    name.style.transform = `translate(${x}px, ${y}px)`;
    taken.push([x, y, x + width, y + height]);
  }
}
// Highest and lowest point of a part on the screen, and the rectangle around it.
function outline(corners, right, up, w, h) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  let highest, lowest;
  for (let i = 0; i < corners.length; i += 3) {
    const p = corners.subarray(i, i + 3), x = 0.5 * w + (dot(right, p) - view.x) * view.zoom, y = 0.5 * h - (dot(up, p) - view.y) * view.zoom;
    if (y < box[1]) { box[1] = y; highest = [x, y]; }
    if (y > box[3]) { box[3] = y; lowest = [x, y]; }
    box[0] = Math.min(box[0], x);
    box[2] = Math.max(box[2], x);
  }
  return { box, highest, lowest };
}

const pointers = new Map();
const middleOf = (list) => [0, 1].map((k) => list.reduce((sum, p) => sum + p[k], 0) / list.length);
const reach = (list) => (list.length > 1 ? Math.hypot(list[0][0] - list[1][0], list[0][1] - list[1][1]) : 1);
function fromMiddle([x, y]) { const b = canvas.getBoundingClientRect(); return [x - b.left - 0.5 * b.width, y - b.top - 0.5 * b.height]; }
canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); pointers.set(e.pointerId, [e.clientX, e.clientY]); });
canvas.addEventListener("pointermove", (e) => {
  if (!pointers.has(e.pointerId)) return;
  const before = [...pointers.values()];
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  const after = [...pointers.values()], from = middleOf(before), to = middleOf(after), step = [to[0] - from[0], to[1] - from[1]];
  if (after.length > 1) { moveBy(...step); zoomBy(reach(after) / (reach(before) || 1), ...fromMiddle(to)); }
  else if (e.shiftKey || e.buttons & 6) moveBy(...step);
  else turnBy(...step);
  changed();
});
for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => pointers.delete(e.pointerId));
canvas.addEventListener("contextmenu", (e) => e.preventDefault());
canvas.addEventListener("wheel", (e) => {
  e.preventDefault();
  zoomBy(Math.exp(-e.deltaY * (e.deltaMode ? 0.05 : 0.0015)), ...fromMiddle([e.clientX, e.clientY]));
  changed();
}, { passive: false });
const reset = () => look(START.turn, START.rise), views = { reset, side: () => look(-90, 0), front: () => look(180, 0) };
canvas.addEventListener("dblclick", reset);
canvas.addEventListener("keydown", (e) => {
  const steps = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, -20], ArrowDown: [0, 20] };
  if (steps[e.key]) turnBy(...steps[e.key]);
  else if (e.key === "+" || e.key === "=") zoomBy(1.2);
  else if (e.key === "-") zoomBy(1 / 1.2);
  else if (e.key === "0") { reset(); return; }
  else return;
  e.preventDefault();
  changed();
});
for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", views[button.dataset.view]);
for (const box of document.querySelectorAll("[data-part]")) {
  box.addEventListener("change", () => { parts[+box.dataset.part].visible = box.checked; redraw(); });
}
byId("names").addEventListener("change", redraw);
byId("theme").addEventListener("click", () => { setTheme(root.dataset.theme === "light"); redraw(); });
dark.addEventListener("change", () => { setTheme(dark.matches); redraw(); });
new ResizeObserver(redraw).observe(canvas);
canvas.addEventListener("webglcontextlost", (e) => e.preventDefault());
canvas.addEventListener("webglcontextrestored", () => location.reload());
// lens.html#view=-90,0,2 opens as seen from the side, twice as large.
function start() {
  const asked = location.hash.match(/^#view=([-\d.]+),([-\d.]+)(?:,([\d.]+))?$/);
  if (!asked) { reset(); return; }
  look(+asked[1], +asked[2]);
  if (asked[3]) { zoomBy(+asked[3]); changed(); }
}
addEventListener("hashchange", start);
start();
})();
