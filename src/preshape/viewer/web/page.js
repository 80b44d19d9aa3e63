"use strict";
(() => {
const $ = id => document.getElementById(id);
const data = JSON.parse($("data").textContent);
const state = {view: 0, share: 1, hidden: new Set(data.hidden), spin: 0, tilt: 0, zoom: 1, pan: [0, 0], playing: 0};

// Geometry: base64 text to typed arrays.
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;
function geometry(g) {
  const q = new Int16Array(bytes(g.p)), p = new Float32Array(q.length);
  for (let i = 0; i < q.length; i++) p[i] = g.o[i % 3] + g.s * q[i] / 32767;
  return {p, n: new Int8Array(bytes(g.n)), t: g.w ? new Uint32Array(bytes(g.t)) : new Uint16Array(bytes(g.t)), w: g.w};
}

// Vectors and matrices; a matrix has sixteen numbers, column by column.
const sub = (a, b) => a.map((x, i) => x - b[i]), dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const l = Math.hypot(...a) || 1; return a.map(x => x / l); };
function mul(a, b) {
  const m = new Float32Array(16);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) {
    let s = 0;
    for (let k = 0; k < 4; k++) s += a[4 * k + r] * b[4 * c + k];
    m[4 * c + r] = s;
  }
  return m;
}
const ONE = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

// The camera: its first pose, rotated and moved by the user.
function camera(aspect) {
  const home = data.views[state.view].camera;
  const away = sub(home.eye, home.target), flat = Math.hypot(away[0], away[1]);
  const length = Math.hypot(...away) * state.zoom * Math.max(1, 1.25 / aspect);
  const turn = Math.atan2(away[1], away[0]) + state.spin;
  const rise = Math.max(-1.5, Math.min(1.5, Math.atan2(away[2], flat) + state.tilt));
  const back = [Math.cos(rise) * Math.cos(turn), Math.cos(rise) * Math.sin(turn), Math.sin(rise)];
  const right = unit(cross([0, 0, 1], back)), up = cross(back, right);
  const target = home.target.map((x, i) => x - (right[i] * state.pan[0] + up[i] * state.pan[1]) * length);
  const eye = target.map((x, i) => x + back[i] * length);
  const see = new Float32Array([right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, eye), -dot(up, eye), -dot(back, eye), 1]);
  const f = 1 / Math.tan(home.fov * Math.PI / 360), near = length / 50, far = length * 20;
  const lens = new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1,
    0, 0, 2 * far * near / (near - far), 0]);
  return {eye, back, right, up, all: mul(lens, see)};
}

const canvas = $("gl"), gl = canvas.getContext("webgl", {antialias: true, alpha: true, premultipliedAlpha: false});
const wide = gl && gl.getExtension("OES_element_index_uint");
let program, at = {}, made = new Map();
if (gl) start(); else $("none").style.display = "flex";

function start() {
  const shader = (kind, text) => { const s = gl.createShader(kind); gl.shaderSource(s, text); gl.compileShader(s); return s; };
  program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `attribute vec3 p; attribute vec3 n; uniform mat4 all, model;
    varying vec3 N, P; void main(){ vec4 w = model * vec4(p, 1.); P = w.xyz; N = mat3(model) * n; gl_Position = all * w; }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `precision mediump float; varying vec3 N, P;
    uniform vec4 colour; uniform vec3 eye, key; uniform float lit;
    void main(){ vec3 v = normalize(eye - P), n = normalize(N); if (dot(n, v) < 0.) n = -n;
      float sky = .5 + .5 * n.z, k = max(dot(n, key), 0.), fill = max(dot(n, v), 0.);
      float shine = pow(max(dot(n, normalize(key + v)), 0.), 40.) * .12;
      vec3 c = pow(colour.rgb, vec3(2.2));
      vec3 l = mix(c, c * (.26 + .22 * sky + .58 * k + .16 * fill) + shine, lit);
      gl_FragColor = vec4(pow(l, vec3(1. / 2.2)), colour.a); }`));
  gl.linkProgram(program); gl.useProgram(program);
  for (const name of ["all", "model", "colour", "eye", "key", "lit"]) at[name] = gl.getUniformLocation(program, name);
  at.p = gl.getAttribLocation(program, "p"); at.n = gl.getAttribLocation(program, "n");
  gl.enableVertexAttribArray(at.p); gl.enableVertexAttribArray(at.n);
  gl.enable(gl.DEPTH_TEST); gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
}

function buffers(key) {
  if (!made.has(key)) {
    const g = geometry(data.geometries[key]);
    const put = (kind, array) => { const b = gl.createBuffer(); gl.bindBuffer(kind, b); gl.bufferData(kind, array, gl.STATIC_DRAW); return b; };
    const mid = [0, 0, 0];
    for (let i = 0; i < g.p.length; i++) mid[i % 3] += g.p[i] / (g.p.length / 3);
    made.set(key, {p: put(gl.ARRAY_BUFFER, g.p), n: put(gl.ARRAY_BUFFER, g.n), t: put(gl.ELEMENT_ARRAY_BUFFER, g.t),
      count: g.t.length, kind: g.w ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT, mid, usable: !g.w || wide});
  }
  return made.get(key);
}

const moved = new Map();
function poses(view) {
  if (!moved.has(view)) moved.set(view, view.motion ? new Float32Array(bytes(view.motion.poses)) : null);
  return moved.get(view);
}
function model(view, solid) {
  if (solid.link === undefined) return ONE;
  const frames = view.motion.frames, links = view.motion.links;
  const where = state.share * (frames - 1), low = Math.floor(where), high = Math.min(frames - 1, low + 1), s = where - low;
  const all = poses(view), m = new Float32Array(ONE);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 3; r++) {
    const a = all[12 * (low * links + solid.link) + 3 * c + r], b = all[12 * (high * links + solid.link) + 3 * c + r];
    m[4 * c + r] = a + s * (b - a);
  }
  return m;
}

let asked = false;
const draw = () => { if (!asked) { asked = true; requestAnimationFrame(() => { asked = false; paint(); }); } };

function paint() {
  const view = data.views[state.view], scale = Math.min(2, window.devicePixelRatio || 1);
  const w = canvas.clientWidth, h = canvas.clientHeight;
  if (!w || !h) return;
  const cam = camera(w / h);
  if (gl) {
    if (canvas.width !== Math.round(w * scale) || canvas.height !== Math.round(h * scale)) {
      canvas.width = Math.round(w * scale); canvas.height = Math.round(h * scale);
    }
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0); gl.depthMask(true); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(at.all, false, cam.all); gl.uniform3fv(at.eye, cam.eye);
    gl.uniform3fv(at.key, unit(cam.back.map((x, i) => x + .9 * cam.up[i] - .7 * cam.right[i])));
    const seen = view.solids.filter(s => !state.hidden.has(s.group));
    const far = s => { const m = buffers(s.g).mid; return dot(sub(cam.eye, m), sub(cam.eye, m)); };
    gl.disable(gl.BLEND);
    for (const s of seen) if (s.c[3] >= 1) one(view, s);
    gl.enable(gl.BLEND); gl.depthMask(false);
    for (const s of seen.filter(s => s.c[3] < 1).sort((a, b) => far(b) - far(a))) one(view, s);
  }
  label(view, cam, w, h);
}

function one(view, solid) {
  const b = buffers(solid.g);
  if (!b.usable) return;
  gl.uniformMatrix4fv(at.model, false, model(view, solid));
  gl.uniform4fv(at.colour, solid.c); gl.uniform1f(at.lit, solid.lit);
  gl.bindBuffer(gl.ARRAY_BUFFER, b.p); gl.vertexAttribPointer(at.p, 3, gl.FLOAT, false, 0, 0);
  gl.bindBuffer(gl.ARRAY_BUFFER, b.n); gl.vertexAttribPointer(at.n, 3, gl.BYTE, true, 0, 0);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, b.t); gl.drawElements(gl.TRIANGLES, b.count, b.kind, 0);
}

const RANKS = ["contacts", "axes", "task", "net", "planes", "frame"];
function label(view, cam, w, h) {
  const box = $("labels"), shown = view.labels.filter(l => !state.hidden.has(l.group));
  while (box.children.length < shown.length) box.append(document.createElement("span"));
  while (box.children.length > shown.length) box.lastChild.remove();
  const places = shown.map((l, i) => {
    const m = cam.all, [x, y, z] = l.at, d = m[3] * x + m[7] * y + m[11] * z + m[15];
    const span = box.children[i];
    span.textContent = l.text;
    span.style.left = `${w / 2 * (1 + (m[0] * x + m[4] * y + m[8] * z + m[12]) / d)}px`;
    span.style.top = `${h / 2 * (1 - (m[1] * x + m[5] * y + m[9] * z + m[13]) / d)}px`;
    span.style.display = d > 0 ? "" : "none";
    return {span, rank: (RANKS.indexOf(l.group) + RANKS.length + 1) % (RANKS.length + 1)};
  });
  // Of two labels that overlap, the less important one is hidden.
  const kept = [];
  for (const {span} of [...places].sort((a, b) => a.rank - b.rank)) {
    if (span.style.display) continue;
    const r = span.getBoundingClientRect();
    if (kept.some(k => r.left < k.right && k.left < r.right && r.top < k.bottom && k.top < r.bottom)) span.style.display = "none";
    else kept.push(r);
  }
}

// Readings and controls.
function choose(index) {
  state.view = index;
  const view = data.views[index];
  $("readings").innerHTML = view.readings;
  for (const row of document.querySelectorAll("tr[data-answer]")) {
    row.tabIndex = 0;
    row.onclick = () => choose(Number(row.dataset.answer));
    row.onkeydown = e => { if (e.key === "Enter") row.onclick(); };
  }
  $("steer").style.visibility = view.motion && view.motion.frames > 1 ? "visible" : "hidden";
  move(1);
}
function move(share) {
  state.share = share; $("slider").value = share;
  const m = data.views[state.view].motion;
  $("stage").textContent = m ? m.stages[Math.round(share * (m.stages.length - 1))] : "";
  draw();
}
$("slider").oninput = () => { state.playing = 0; move(Number($("slider").value)); };
$("play").onclick = () => {
  const begun = state.playing = performance.now();
  const step = now => {
    if (state.playing !== begun) return;
    move(Math.min(1, Math.max(0, (now - begun) / 3000)));
    if (now - begun < 3000) requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
};
$("home").onclick = () => { Object.assign(state, {spin: 0, tilt: 0, zoom: 1, pan: [0, 0]}); draw(); };
$("save").onclick = () => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([$("plan").textContent], {type: "application/json"}));
  link.download = data.file; link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
};
for (const [group, words] of Object.entries(data.groups)) {
  const label = document.createElement("label"), box = document.createElement("input");
  box.type = "checkbox"; box.checked = !state.hidden.has(group);
  box.onchange = () => { state.hidden[box.checked ? "delete" : "add"](group); draw(); };
  label.append(box, " " + words); $("layers").append(label);
}

// One finger or the left button rotates, two fingers or the right button move, wheel or pinch zooms.
const fingers = new Map();
let spread = 0;
canvas.onpointerdown = e => { canvas.setPointerCapture(e.pointerId); fingers.set(e.pointerId, [e.clientX, e.clientY, e.button]); spread = 0; };
canvas.onpointerup = canvas.onpointercancel = e => { fingers.delete(e.pointerId); spread = 0; };
canvas.oncontextmenu = e => e.preventDefault();
canvas.onpointermove = e => {
  const was = fingers.get(e.pointerId);
  if (!was) return;
  const dx = e.clientX - was[0], dy = e.clientY - was[1], size = canvas.clientHeight;
  fingers.set(e.pointerId, [e.clientX, e.clientY, was[2]]);
  if (fingers.size > 1 || was[2] === 2) {
    state.pan[0] += .45 * dx / size / Math.max(1, fingers.size); state.pan[1] -= .45 * dy / size / Math.max(1, fingers.size);
    if (fingers.size === 2) {
      const [a, b] = [...fingers.values()], now = Math.hypot(a[0] - b[0], a[1] - b[1]);
      if (spread) zoom(spread / now);
      spread = now;
    }
  } else { state.spin -= 5 * dx / size; state.tilt += 5 * dy / size; state.tilt = Math.max(-3, Math.min(3, state.tilt)); }
  draw();
};
const zoom = by => { state.zoom = Math.max(.2, Math.min(6, state.zoom * by)); draw(); };
canvas.onwheel = e => { e.preventDefault(); zoom(Math.exp(Math.max(-1, Math.min(1, e.deltaY / 400)))); };
canvas.onkeydown = e => {
  const by = {ArrowLeft: [.12, 0], ArrowRight: [-.12, 0], ArrowUp: [0, .12], ArrowDown: [0, -.12]}[e.key];
  if (by) { state.spin += by[0]; state.tilt += by[1]; e.preventDefault(); draw(); }
  if (e.key === "+") zoom(.9);
  if (e.key === "-") zoom(1.1);
};
new ResizeObserver(draw).observe(canvas);
choose(0);
})();
