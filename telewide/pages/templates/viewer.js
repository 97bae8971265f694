"use strict";
// One capture at a time: click to focus, look around, compare, read distances. Everything it needs lies in the page.
(() => {
const root = document.getElementById("viewer");
const scenes = [...document.querySelectorAll("script[data-scene]")];
if (!root || !scenes.length) return;
const byId = (id) => document.getElementById(id);
const canvas = byId("picture"), stage = root.querySelector(".stage"), pair = root.querySelector(".stage .comparing");
// Lens points of a finished picture, more of a large blur, and of the first frame: a click waits for the frame that is drawn,
// where the processor draws it for half a second a point.
const LEAST = 192, MOST = 960, FIRST = 2;
const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2((gl_VertexID << 1) & 2, gl_VertexID & 2) * 2.0 - 1.0, 0, 1); }`;
// Each lens point sees the levels shifted by their blur radius; the nearest that is there hides the others. Where a level
// is cut by another of the same surface it goes on under it; behind an edge the hidden picture goes on.
const LENS = `#version 300 es
precision highp float; precision highp sampler2D;
uniform sampler2D photo, hidden, levels, span, former;
uniform ivec2 size; uniform int cell; uniform vec2 ends, sharp; uniform float count, scale, cap, weight, lights, jitter; uniform int done;
uniform int points; uniform vec2 point[32];
out vec4 colour;
float radiusOf(int level) {
  float d = mix(ends.x, ends.y, float(level) / (count - 1.0));
  return clamp((d - clamp(d, sharp.x, sharp.y)) * scale, -cap, cap);
}
ivec2 mirrored(ivec2 at) { at = abs(at); return size - 1 - abs(size - 1 - at); }
vec3 shown(ivec2 at) { // alpha tells small clipped lights, which were brighter than white
  vec4 own = texelFetch(photo, at, 0);
  return own.rgb * (1.0 + (lights - 1.0) * own.a);
}
vec3 seen(ivec2 here, vec2 from, ivec2 between) {
  vec3 last = shown(here);
  for (int level = between.y; level >= between.x; level--) {
    ivec2 at = mirrored(ivec2(floor(vec2(here) + 0.5 - radiusOf(level) * from)));
    ivec4 there = ivec4(texelFetch(levels, at, 0) * 255.0 + 0.5);
    if (level <= there.r) {
      if (level >= there.b) return shown(at);
      if (there.g < there.b && level <= there.g) {
        vec3 behind = texelFetch(hidden, at, 0).rgb;
        if (level >= there.a) return behind;
        last = behind;
      }
    }
  }
  return last;
}
// Each pixel looks through points of its own beside the common ones, or a small light would show as many dots.
vec2 beside(ivec2 here, int k) { // two numbers in [-0.5, 0.5]: PCG hash, Jarzynski and Olano 2020
  uvec3 v = uvec3(here, k) * 1664525u + 1013904223u;
  v.x += v.y * v.z; v.y += v.z * v.x; v.z += v.x * v.y;
  v ^= v >> 16u;
  v.x += v.y * v.z; v.y += v.z * v.x;
  return vec2(v.xy >> 8u) / 16777216.0 - 0.5;
}
void main() {
  ivec2 here = ivec2(gl_FragCoord.xy);
  ivec2 between = ivec2(texelFetch(span, here / cell, 0).rg * 255.0 + 0.5);
  vec3 sum = vec3(0);
  for (int k = 0; k < points; k++) sum += seen(here, point[k] + jitter * beside(here, done + k), between);
  colour = vec4(mix(texelFetch(former, here, 0).rgb, sum / float(points), weight), 1);
}`;
const SHOW = `#version 300 es
precision highp float; precision highp sampler2D;
uniform sampler2D light, levels; uniform ivec2 size; uniform int edges, jump; uniform vec2 mark;
out vec4 colour;
int levelAt(ivec2 at) { return int(texelFetch(levels, clamp(at, ivec2(0), size - 1), 0).r * 255.0 + 0.5); }
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy); at.y = size.y - 1 - at.y;
  vec3 linear = clamp(texelFetch(light, at, 0).rgb, 0.0, 1.0);
  vec3 srgb = mix(linear * 12.92, 1.055 * pow(linear, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, linear));
  if (edges == 1) {
    int own = levelAt(at);
    if (own - min(levelAt(at + ivec2(1, 0)), levelAt(at + ivec2(0, 1))) > jump ||
        own - min(levelAt(at - ivec2(1, 0)), levelAt(at - ivec2(0, 1))) > jump) srgb = vec3(1.0, 0.45, 0.1);
  }
  colour = vec4(srgb, 1);
}`;

// The index leads to captures of this page: #capture-name.
const links = [...document.querySelectorAll('.index a[href^="#"]')];
function nameIn(hash) {
  try { return decodeURIComponent(hash.replace(/^#capture-/, "")); } catch { return ""; }
}
const sceneNamed = (name) => scenes.findIndex((each) => each.dataset.scene === name);

let gl = null, depth = null, programs = null, scene = null, state = null, waiting = 0;

function start() {
  gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
  if (!gl) return false;
  depth = gl.getExtension("EXT_color_buffer_float") ? gl.RGBA32F : gl.getExtension("EXT_color_buffer_half_float") ? gl.RGBA16F : null;
  if (!depth) return false;
  programs = { lens: program(LENS), show: program(SHOW) };
  gl.bindVertexArray(gl.createVertexArray());
  return true;
}

function program(fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return made;
}

const place = (used, name) => gl.getUniformLocation(used, name);

function texture(format, wh, kind, type, data) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
  gl.texImage2D(gl.TEXTURE_2D, 0, format, wh[0], wh[1], 0, kind, type, data);
  return made;
}

// Pixels of a picture as they are stored, (h, w, 4).
async function pixels(uri) {
  const text = atob(uri.slice(uri.indexOf(",") + 1)), bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  const blob = new Blob([bytes], { type: uri.slice(5, uri.indexOf(";")) });
  const bitmap = await createImageBitmap(blob, { premultiplyAlpha: "none", colorSpaceConversion: "none" });
  const paper = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d", { willReadFrequently: true });
  paper.drawImage(bitmap, 0, 0);
  return paper.getImageData(0, 0, bitmap.width, bitmap.height).data;
}

// The farthest level beside a pixel that is no other surface: under it a level goes on.
function lowest(levels, channel, [width, height], jump) {
  const low = new Uint8Array(width * height);
  for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
    const own = levels[4 * (y * width + x) + channel];
    let least = own;
    for (let v = Math.max(y - 1, 0); v <= Math.min(y + 1, height - 1); v++)
      for (let u = Math.max(x - 1, 0); u <= Math.min(x + 1, width - 1); u++) {
        const other = levels[4 * (v * width + u) + channel];
        if (other < least && own - other <= jump) least = other;
      }
    low[y * width + x] = least;
  }
  return low;
}

// Least and largest level that can reach the pixels of each square.
function spans(levels, [width, height], cell, reach) {
  const w = Math.ceil(width / cell), h = Math.ceil(height / cell);
  const low = new Uint8Array(w * h).fill(255), high = new Uint8Array(w * h);
  for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
    const at = Math.floor(y / cell) * w + Math.floor(x / cell), from = 4 * (y * width + x);
    low[at] = Math.min(low[at], levels[from], levels[from + 1]);
    high[at] = Math.max(high[at], levels[from]);
  }
  const widened = (values, pick, step, count, apart, lines, line) => {
    const out = new Uint8Array(values.length);
    for (let l = 0; l < lines; l++) for (let k = 0; k < count; k++) {
      let best = values[l * line + k * apart];
      for (let j = Math.max(0, k - step); j <= Math.min(count - 1, k + step); j++)
        best = pick(best, values[l * line + j * apart]);
      out[l * line + k * apart] = best;
    }
    return out;
  };
  const step = Math.ceil(reach / cell) + 1, both = (values, pick) =>
    widened(widened(values, pick, step, w, 1, h, w), pick, step, h, w, w, 1);
  const far = both(low, Math.min), near = both(high, Math.max), packed = new Uint8Array(w * h * 2);
  for (let k = 0; k < w * h; k++) { packed[2 * k] = far[k]; packed[2 * k + 1] = near[k]; }
  return { packed, wh: [w, h] };
}

async function open(index) {
  const told = JSON.parse(scenes[index].textContent);
  const [photo, hidden, levels, map] = await Promise.all(
    [told.pictures.tele, told.hidden, told.levels, told.map].map(pixels));
  if (scene) for (const name of ["photo", "hidden", "levels", "span", "former", "next"]) gl.deleteTexture(scene[name]);
  const both = new Uint8Array(levels.length), wh = told.wh, cell = 16;
  const own = lowest(levels, 0, wh, told.jump), behind = lowest(levels, 1, wh, told.jump);
  for (let k = 0; k < own.length; k++) {
    both[4 * k] = levels[4 * k]; both[4 * k + 1] = levels[4 * k + 1]; both[4 * k + 2] = own[k]; both[4 * k + 3] = behind[k];
    photo[4 * k + 3] = levels[4 * k + 2];
  }
  const span = spans(levels, wh, cell, told.capPx * 1.3), srgb = [gl.SRGB8_ALPHA8, wh, gl.RGBA, gl.UNSIGNED_BYTE];
  scene = { told, index, map, cell, frame: gl.createFramebuffer(),
    photo: texture(...srgb, new Uint8Array(photo.buffer)), hidden: texture(...srgb, new Uint8Array(hidden.buffer)),
    levels: texture(gl.RGBA8, wh, gl.RGBA, gl.UNSIGNED_BYTE, both),
    span: texture(gl.RG8, span.wh, gl.RG, gl.UNSIGNED_BYTE, span.packed),
    former: texture(depth, wh, gl.RGBA, gl.FLOAT, null), next: texture(depth, wh, gl.RGBA, gl.FLOAT, null) };
  canvas.width = wh[0]; canvas.height = wh[1];
  root.style.setProperty("--ratio", `${wh[0]} / ${wh[1]}`);
  root.style.setProperty("--aspect", wh[0] / wh[1]);
  state = { at: told.focus, focus: told.focusPx, sharp: told.sharpPx, from: null, view: state ? state.view : "focus" };
  for (const [k, each] of document.querySelectorAll("#strip button").entries())
    each.setAttribute("aria-current", String(k === index));
  byId("name").textContent = told.name;
  byId("extent").textContent = extent();
  byId("notes").replaceChildren(...told.notes.map((note) => { const line = document.createElement("p"); line.textContent = note; return line; }));
  byId("madeBy").textContent = told.madeBy;
  for (const [k, each] of document.querySelectorAll("#next code").entries()) each.textContent = told.next[k];
  for (const each of links) each.setAttribute("aria-current", String(nameIn(each.hash) === told.name));
  for (const side of ["left", "right"]) choices(byId(side), side === "left" ? "tele" : "disparity");
  setSliders();
  aperture();
  compare();
  readOut(...told.focus);
}

function choices(select, wanted) {
  const former = select.value || wanted;
  select.replaceChildren(...Object.keys(scene.told.pictures).map((name) => new Option(name, name)));
  select.value = former in scene.told.pictures ? former : wanted;
}

const inMetres = (metres) => metres < 1 ? `${(100 * metres).toFixed(0)} cm` : `${metres.toFixed(metres < 10 ? 2 : 0)} m`;

function metres(disparity) { // px of the page's picture
  const metric = scene.told.metric;
  if (!metric) return null;
  const depth = metric[0] / (disparity * scene.told.photoPx + metric[1]);
  return depth > 0 && depth <= metric[3] ? depth : Infinity;
}

function extent() {
  const [far, near] = scene.told.levelEnds.map(metres);
  if (far === null) return "Distances are not known of this capture: it has no rig.";
  return `From ${inMetres(near)} to ${far === Infinity ? "very far" : inMetres(far)}.`;
}

// Disparity in px of the photo and of the page's picture. The place it opens with is told as the command tells it.
function disparityAt(x, y) {
  const told = scene.told, at = 4 * (y * told.wh[0] + x), [red, green, blue] = scene.map.subarray(at, at + 3);
  const confidence = blue === 0 || blue === 255 ? null : (blue - 1) / 253;
  const opens = told.opensAt && x === told.focus[0] && y === told.focus[1] ? told.opensAt : null;
  const place = opens || [x, y].map((each) => Math.round((each + 0.5) * told.photoPx - 0.5));
  if (blue === 255 && !opens) return { place, inPhoto: null, disparity: null, confidence };
  const inPhoto = opens ? opens[2] : told.mapSteps[0] + (256 * red + green) * told.mapSteps[1];
  return { place, inPhoto, disparity: inPhoto / told.photoPx, confidence };
}

function readOut(x, y) {
  const { place, inPhoto, disparity, confidence } = disparityAt(x, y), away = disparity === null ? null : metres(disparity);
  const words = [`x ${place[0]}, y ${place[1]}`];
  words.push(inPhoto === null ? "not known" : `${inPhoto.toFixed(1)} px`);
  if (away !== null) words.push(away === Infinity ? "too far to tell" : inMetres(away));
  words.push(confidence === null ? "filled in, not measured" : `confidence ${(100 * confidence).toFixed(0)} %`);
  byId("readout").textContent = words.join(" · ");
}

// Points of the opening: a sequence that fills a square evenly (R2, Roberts 2018), of which those inside are kept.
function lensPoints({ blades, curvature, turn }, count) {
  const half = Math.PI / (blades || 1), points = [];
  const outline = (angle) => { // distance of the edge from the middle where a corner lies at 1 and at angle 0
    const within = (angle % (2 * half) + 2 * half) % (2 * half);
    return blades ? (1 - curvature) * Math.cos(half) / Math.cos(within - half) + curvature : 1;
  };
  let area = 0;
  for (let k = 0; k < 4096; k++) {
    area += outline((k + 0.5) / 4096 * 2 * Math.PI) ** 2 / 4096;
  }
  const reach = 1 / Math.sqrt(area);
  for (let k = 1; points.length < count; k++) {
    const x = reach * (2 * ((0.5 + k * 0.7548776662466927) % 1) - 1), y = reach * (2 * ((0.5 + k * 0.5698402909980532) % 1) - 1);
    if (Math.hypot(x, y) <= reach * outline(Math.atan2(-x, y) - turn)) points.push([x, y]);
  }
  return points;
}

const turned = new Set(); // sliders

function setSliders() {
  const stops = 6 * Math.log2(scene.told.fNumber), set = (id, value) => { if (!turned.has(id)) byId(id).value = value; };
  byId("stop").min = Math.min(0, Math.floor(stops));
  byId("stop").max = Math.max(24, Math.ceil(stops));
  byId("lights").max = Math.ceil(Math.log2(scene.told.mostLights));
  set("stop", stops);
  set("blades", scene.told.blades || 4);
  set("lights", Math.log2(scene.told.lights));
}

function aperture() {
  // As the bokeh was made, until somebody turns a slider.
  const told = scene.told, value = (id, own, of) => turned.has(id) ? of(Number(byId(id).value)) : own;
  const number = value("stop", told.fNumber, (stops) => Math.pow(2, stops / 6));
  const blades = value("blades", told.blades || 4, (count) => count);
  state.scale = told.radiusPerPx * told.fNumber / number;
  byId("stop").setAttribute("aria-valuetext", `f/${number.toFixed(1)}`);
  byId("number").textContent = `f/${number.toFixed(1)}`;
  state.lights = value("lights", told.lights, (doublings) => Math.min(Math.pow(2, doublings), told.mostLights));
  byId("lightsWord").textContent = `× ${Number(state.lights.toFixed(1))}`;
  byId("bladesWord").textContent = blades < 5 ? "round" : String(blades);
  state.opening = { blades: blades < 5 ? 0 : blades, curvature: told.curvature, turn: told.turnRad };
  redraw();
}

function largestRadius() {
  const away = Math.max(...scene.told.levelEnds.map((end) => Math.max(state.sharp[0] - end, end - state.sharp[1])), 0);
  return Math.min(away * state.scale, scene.told.capPx);
}

function redraw() {
  state.done = 0;
  const total = Math.min(MOST, Math.max(LEAST, Math.ceil(0.6 * largestRadius() ** 2)));
  state.points = lensPoints(state.opening, total);
  canvas.dataset.done = "0";
  canvas.dataset.drawing = String(Number(canvas.dataset.drawing || 0) + 1);
  if (!waiting) waiting = requestAnimationFrame(frame);
}

function pass(used, target, wh, textures) {
  gl.useProgram(used);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target ? scene.frame : null);
  if (target) gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  gl.viewport(0, 0, wh[0], wh[1]);
  Object.entries(textures).forEach(([name, bound], unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, bound);
    gl.uniform1i(place(used, name), unit);
  });
}

let share = FIRST, before = 0;
function frame(now) {
  waiting = 0;
  if (!scene || state.view === "compare") return;
  const told = scene.told, wh = told.wh, looks = state.view === "around";
  if (state.done && before && now > before) // as many points as keep a frame below a fifteenth of a second
    share = Math.min(32, Math.max(2, Math.round(share * (now - before > 66 ? 0.6 : now - before < 30 ? 1.5 : 1))));
  before = now;
  const total = looks ? 1 : state.points.length, some = looks ? [state.from || [0, 0]] : state.points.slice(state.done, state.done + share);
  const lens = programs.lens;
  pass(lens, scene.next, wh, { photo: scene.photo, hidden: scene.hidden, levels: scene.levels, span: scene.span, former: scene.former });
  gl.uniform2i(place(lens, "size"), wh[0], wh[1]);
  gl.uniform1i(place(lens, "cell"), scene.cell);
  gl.uniform2f(place(lens, "ends"), ...told.levelEnds);
  gl.uniform2f(place(lens, "sharp"), ...(looks ? [state.focus, state.focus] : state.sharp));
  gl.uniform1f(place(lens, "count"), told.levelCount);
  // Looking around, what is farthest from the focus moves by 2 % of the picture.
  const widest = Math.max(...told.levelEnds.map((end) => Math.abs(end - state.focus)), 1e-6);
  gl.uniform1f(place(lens, "scale"), looks ? 0.02 * Math.max(...wh) / widest : state.scale);
  gl.uniform1f(place(lens, "cap"), told.capPx);
  gl.uniform1f(place(lens, "lights"), looks ? 1 : state.lights);
  gl.uniform1f(place(lens, "weight"), some.length / (state.done + some.length));
  gl.uniform1f(place(lens, "jitter"), looks ? 0 : 1.7 / Math.sqrt(total));
  gl.uniform1i(place(lens, "done"), state.done);
  gl.uniform1i(place(lens, "points"), some.length);
  gl.uniform2fv(place(lens, "point"), some.flat());
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  [scene.former, scene.next] = [scene.next, scene.former];
  state.done += some.length;
  const show = programs.show;
  pass(show, null, wh, { light: scene.former, levels: scene.levels });
  gl.uniform2i(place(show, "size"), wh[0], wh[1]);
  gl.uniform1i(place(show, "edges"), byId("edges").checked ? 1 : 0);
  gl.uniform1i(place(show, "jump"), told.jump);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  const mark = byId("mark");
  mark.style.left = `${100 * (state.at[0] + 0.5) / wh[0]}%`;
  mark.style.top = `${100 * (state.at[1] + 0.5) / wh[1]}%`;
  canvas.dataset.done = state.done >= total ? "1" : "0";
  if (state.done < total) waiting = requestAnimationFrame(frame); else before = 0;
}

function focusAt(x, y) {
  const { disparity } = disparityAt(x, y);
  state.at = [x, y];
  if (disparity !== null) { state.focus = disparity; state.sharp = [disparity, disparity]; }
  readOut(x, y);
  redraw();
}

function pixelOf(event) {
  const box = stage.getBoundingClientRect(), wh = scene.told.wh;
  const held = (value, most) => Math.min(Math.max(Math.floor(value), 0), most - 1);
  return [held((event.clientX - box.left) / box.width * wh[0], wh[0]), held((event.clientY - box.top) / box.height * wh[1], wh[1])];
}

function lookFrom(event) {
  const box = canvas.getBoundingClientRect();
  state.from = [2 * (event.clientX - box.left) / box.width - 1, 2 * (event.clientY - box.top) / box.height - 1];
  redraw();
}

canvas.addEventListener("pointerdown", (event) => {
  if (state.view === "around") { canvas.setPointerCapture(event.pointerId); lookFrom(event); } else focusAt(...pixelOf(event));
});
canvas.addEventListener("pointermove", (event) => {
  if (!scene) return;
  readOut(...pixelOf(event));
  if (state.view === "around" && event.buttons) lookFrom(event);
});
canvas.addEventListener("pointerleave", () => scene && readOut(...state.at));
canvas.addEventListener("keydown", (event) => {
  const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (!step) return;
  event.preventDefault();
  const wh = scene.told.wh, held = (value, most) => Math.min(Math.max(Math.round(value), 0), most - 1);
  if (state.view === "around") {
    const from = state.from || [0, 0];
    state.from = step.map((each, k) => Math.min(Math.max(from[k] + 0.1 * each, -1), 1));
    redraw();
  } else {
    const least = Math.max(Math.round(0.01 * Math.min(...wh)), 1), many = event.shiftKey ? 10 : 1;
    focusAt(...step.map((each, k) => held(state.at[k] + each * least * many, wh[k])));
  }
});
canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
canvas.addEventListener("webglcontextrestored", () => { const { index } = scene; scene = null; if (start()) open(index); });
for (const id of ["stop", "blades", "lights"]) byId(id).addEventListener("input", () => { turned.add(id); aperture(); });
byId("edges").addEventListener("change", redraw);

function compare() {
  const [under, over] = ["right", "left"].map((side) => scene.told.pictures[byId(side).value]);
  byId("under").src = under;
  byId("over").src = over;
  byId("under").alt = `${byId("right").value} of ${scene.told.name}`;
  byId("over").alt = `${byId("left").value} of ${scene.told.name}`;
  divide();
}
function divide() { root.style.setProperty("--cut", `${byId("divider").value}%`); }
function wipe(event) {
  const box = stage.getBoundingClientRect();
  byId("divider").value = 100 * (event.clientX - box.left) / box.width;
  divide();
}
// Only some of the pictures have their points where the photo has them.
const READ = ["tele", "bokeh", "disparity"];
function readUnder(event) {
  const box = stage.getBoundingClientRect(), isLeft = (event.clientX - box.left) / box.width < byId("divider").value / 100;
  if (READ.includes(byId(isLeft ? "left" : "right").value)) readOut(...pixelOf(event));
  else byId("readout").textContent = "Distances are read over tele, bokeh and disparity.";
}
pair.addEventListener("pointerdown", (event) => {
  if (event.button) return;
  pair.setPointerCapture(event.pointerId);
  byId("divider").focus({ preventScroll: true });
  wipe(event);
  readUnder(event);
});
pair.addEventListener("mousedown", (event) => event.preventDefault()); // it would take the focus from the slider
pair.addEventListener("pointermove", (event) => {
  if (pair.hasPointerCapture(event.pointerId)) wipe(event);
  readUnder(event);
});
pair.addEventListener("pointerleave", () => readOut(...state.at));
for (const id of ["left", "right"]) byId(id).addEventListener("change", compare);
byId("divider").addEventListener("input", divide);

function show(view) {
  state.view = root.dataset.view = view;
  for (const each of document.querySelectorAll("#views button"))
    each.setAttribute("aria-pressed", String(each.value === view));
  redraw();
}
function showAndHold(view) { // the arrow keys are those of what is shown
  show(view);
  (view === "compare" ? byId("divider") : canvas).focus({ preventScroll: true });
}
for (const each of document.querySelectorAll("#views button")) each.addEventListener("click", () => showAndHold(each.value));
for (const [k, each] of document.querySelectorAll("#strip button").entries()) each.addEventListener("click", () => open(k));

for (const each of links) each.addEventListener("click", () => {
  const index = sceneNamed(nameIn(each.hash));
  if (scene && index >= 0) open(index);
});
const first = Math.max(sceneNamed(nameIn(location.hash)), 0);
if (!start()) { byId("lack").hidden = false; root.dataset.view = "none"; return; }
document.documentElement.dataset.live = "1";
open(first).then(() => show("focus"));
})();
