// sherf view: requests pictures of the avatar from the camera that the mouse moves. While something moves, the page
// draws the baked surface itself (live.js), or requests small pictures if it cannot. Then it requests the still view,
// larger each time. At most one request is in progress; a request for a newer view replaces a refinement, since the
// server drops the older one.
"use strict";

const $ = (id) => document.getElementById(id);
const stage = $("stage"), canvas = $("canvas"), paper = canvas.getContext("2d");
const randomName = () => Array.from(crypto.getRandomValues(new Uint8Array(8)), (b) => (b % 36).toString(36)).join("");
const client = randomName();
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

const limits = { quick: true, sideLeast: 96, sideMost: 288, frameMs: 45, stillMs: 130, stepMs: 250, tellMs: 120 };
const start = { azimuth: 0, elevation: 0, zoom: 1 };
const view = { avatar: 0, motion: 0, time: 0, ...start,
  offset: [0, 0, 0], mode: "color", ground: "page", follow: true };
const play = { on: false, loop: true, rate: 1, last: 0, told: 0 };
let about = null;

// ---- the view, the request in progress, the measured speed
let stamp = 1;              // number of changes of the view
let changed = 0;            // time of the last change
let sequence = 0;           // number of requests
let pending = null;          // the request in progress
let got = { stamp: 0, side: 0, sequence: 0 }; // the newest picture received,
let shown = got;            // and the newest one drawn
let moving = 128;           // side of pictures while something moves
let costMs = 0;             // recent milliseconds per picture of side 1
let metresHigh = 0;         // height of the stage at zoom 1
let retry = 0, broken = false, timer = 0;
let drawing = 0;            // the requested animation frame that draws the surface
const drawn = [];           // times of pictures while something moves

function touch() {
  stamp++;
  changed = performance.now();
  schedule();
  if (!drawing && about) drawing = requestAnimationFrame(drawLive);
}

const motion = () => about.motions[view.motion];
const motionFps = () => motion().fps || 1; // single poses: one per second
const frameNow = () => clamp(Math.floor(view.time * motionFps() + 1e-6), 0, motion().frames - 1);
const isMoving = () => play.on || performance.now() - changed < limits.stillMs;

// Width and height of a picture with this side, in the stage's shape: the side is the height, or the width if that is
// shorter.
function dimensions(side, largest = 2 * about.side) {
  const w = Math.max(stage.clientWidth, 1), h = Math.max(stage.clientHeight, 1);
  const height = w >= h ? side : (side * h) / w, width = (height * w) / h;
  const scale = Math.min(1, largest / Math.max(width, height));
  return [clamp(Math.round(width * scale), 16, largest), clamp(Math.round(height * scale), 16, largest)];
}

const fullSide = () =>
  clamp(Math.round(Math.min(stage.clientWidth, stage.clientHeight) * Math.min(devicePixelRatio || 1, 2)), 16,
    about.side);

function ground() {
  if (view.ground !== "page") return view.ground;
  return document.documentElement.dataset.theme === "light" ? "f1f1ee" : "16181b";
}

function query(width, height, more) {
  return new URLSearchParams({
    avatar: view.avatar, motion: view.motion, frame: frameNow(), w: width, h: height,
    az: view.azimuth.toFixed(5), el: view.elevation.toFixed(5), zoom: view.zoom.toFixed(5),
    ox: view.offset[0].toFixed(5), oy: view.offset[1].toFixed(5), oz: view.offset[2].toFixed(5),
    mode: view.mode, bg: ground(), follow: view.follow ? 1 : 0, ...more,
  });
}

// Whether the page itself draws moving views.
const isLive = () => view.mode === "color" && live.ready(view.avatar, view.motion, frameNow(), motion().frames);

function drawLive() {
  drawing = 0;
  if (!isLive() || got.stamp === stamp) return;
  const ratio = Math.min(devicePixelRatio || 1, 2), color = ground(), none = color === "none";
  const rgba = none ? [0, 0, 0, 0] : [0, 2, 4].map((k) => parseInt(color.slice(k, k + 2), 16) / 255).concat(1);
  const size = live.draw(view, frameNow(), Math.max(stage.clientWidth * ratio, 1),
    Math.max(stage.clientHeight * ratio, 1), rgba);
  metresHigh = size.metres * view.zoom;
  stage.classList.toggle("checks", none);
  showLive(true);
  tellPace(`${size.width} × ${size.height} · surface`, performance.now());
}

function showLive(on) {
  $("live").hidden = !on;
  canvas.style.visibility = on ? "hidden" : "";
}

// The side to request next; 0: nothing to do, negative: not yet.
function nextSide() {
  const full = fullSide();
  if (got.stamp !== stamp && isLive()) return isMoving() ? -1 : full;
  if (got.stamp !== stamp) return Math.min(moving, full);
  if (got.side >= full && !got.baked) return 0;
  if (isMoving()) return -1;
  if (got.baked) return full;
  if (costMs * full * full < limits.stepMs) return full;
  const next = Math.max(got.side * 2, 192);
  return next * 1.4 > full ? full : next;
}

function schedule() {
  clearTimeout(timer);
  if (!about || document.hidden || retry) return;
  if (pending && !(pending.stamp !== stamp && (pending.fine || pending.side > 1.3 * moving))) return;
  const side = nextSide();
  if (side < 0 && pending) dismiss();
  if (side > 0) request(side);
  else if (side < 0) timer = setTimeout(schedule, limits.stillMs);
}

// Replaces a picture that is no longer needed by a tiny one.
function dismiss() {
  pending = null;
  fetch("frame?" + query(16, 16, { client, n: ++sequence }), { cache: "no-store" }).catch(() => {});
}

async function request(side) {
  const [width, height] = dimensions(side), live = isMoving();
  const own = (pending = { stamp, side, sequence: ++sequence, mode: view.mode,
    fine: !live && (got.baked || side > 1.3 * moving) });
  const begun = performance.now();
  try {
    const more = { client, n: own.sequence };
    if (live && limits.quick) more.quick = 1; // drawn from the baked surface, if the program has it
    else if (own.fine) more.fine = 1;
    const answer = await fetch("frame?" + query(width, height, more), { cache: "no-store" });
    if (answer.status === 204) return;
    if (!answer.ok) throw await refusal(answer);
    const blob = await answer.blob();
    own.baked = answer.headers.has("X-Baked");
    if (own.sequence > got.sequence) got = own;
    if (pending === own) pending = null;
    schedule(); // the next one is made while this one is drawn
    const bitmap = await createImageBitmap(blob);
    const ms = performance.now() - begun;
    if (own.sequence > shown.sequence && !(own.stamp !== stamp && isLive()))
      draw(bitmap, own, Number(answer.headers.get("X-Scale")));
    bitmap.close();
    measure(side, ms, live, width, height, own.baked);
    if (broken) { broken = false; lost.waited = 0; note(""); }
  } catch (error) {
    if (got === own) got = shown; // received, but not visible
    lost(error);
  } finally {
    if (pending === own) {
      pending = null;
      schedule();
    }
  }
}

function draw(bitmap, own, scale) {
  if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
    canvas.width = bitmap.width; // the style sheet scales it to the stage
    canvas.height = bitmap.height;
  }
  paper.globalCompositeOperation = "copy";
  paper.drawImage(bitmap, 0, 0);
  shown = own;
  showLive(false);
  if (scale > 0) metresHigh = scale * view.zoom;
  stage.classList.toggle("checks", ground() === "none");
}

function measure(side, ms, live, width, height, baked) {
  if (!baked) costMs = costMs ? 0.8 * costMs + (0.2 * ms) / (side * side) : ms / (side * side);
  const now = performance.now();
  const text = `${width} × ${height} · ${Math.round(ms)} ms`;
  const sideMost = baked || about.avatars[view.avatar].baked ? about.side : limits.sideMost;
  if (live && side <= sideMost) {
    const wanted = clamp(Math.sqrt(limits.frameMs / (ms / (side * side))), limits.sideLeast, sideMost);
    moving = Math.round((0.75 * moving + 0.25 * wanted) / 8) * 8;
    return tellPace(text, now);
  }
  drawn.length = 0;
  tellPace.told = now;
  $("speed").textContent = text;
}

// Writes the bottom line while something moves, with pictures per second.
function tellPace(text, now) {
  drawn.push(now);
  while (drawn[0] < now - 1000) drawn.shift();
  if (now - tellPace.told < limits.tellMs) return;
  tellPace.told = now;
  if (drawn.length > 2) text += ` · ${(((drawn.length - 1) * 1000) / (now - drawn[0])).toFixed(0)} fps`;
  $("speed").textContent = text;
}
tellPace.told = 0; // time when the line was last written

async function refusal(answer) {
  const error = new Error((await answer.text()).trim());
  error.status = answer.status;
  return error;
}

function note(text) {
  $("notice").textContent = text;
  $("notice").hidden = !text;
}

// Tries again, at growing intervals.
function lost(error) {
  const again = clamp(2 * (lost.waited || 250), 500, 4000);
  broken = true;
  if (error.status === 403) note("This viewer was started anew: open the address that sherf view printed last.");
  else if (error.status) note(error.message || "The viewer has a problem.");
  else note("The viewer does not answer. Trying again…");
  lost.waited = again;
  clearTimeout(retry);
  retry = setTimeout(() => { retry = 0; about ? schedule() : open(); }, again);
}

// ---- the camera
function axes() {
  const ca = Math.cos(view.azimuth), sa = Math.sin(view.azimuth),
    ce = Math.cos(view.elevation), se = Math.sin(view.elevation);
  return { right: [ca, 0, -sa], down: [sa * se, -ce, ca * se] };
}

function turn(dx, dy) {
  view.azimuth = (view.azimuth - dx * 0.0085) % (2 * Math.PI);
  view.elevation = clamp(view.elevation + dy * 0.0065, -1.5, 1.5);
  touch();
}

function shift(dx, dy) {
  const m = metresHigh / view.zoom / Math.max(stage.clientHeight, 1), { right, down } = axes();
  view.offset = view.offset.map((x, k) => clamp(x - m * (right[k] * dx + down[k] * dy), -10, 10));
  touch();
}

// The point at (x, y) of the window stays there.
function zoom(factor, x = stage.clientWidth / 2, y = stage.clientHeight / 2) {
  const before = view.zoom;
  view.zoom = clamp(view.zoom * factor, 0.2, 20);
  const away = 1 - before / view.zoom, dx = x - stage.clientWidth / 2, dy = y - stage.clientHeight / 2;
  const m = metresHigh / before / Math.max(stage.clientHeight, 1), { right, down } = axes();
  view.offset = view.offset.map((o, k) => clamp(o + m * away * (right[k] * dx + down[k] * dy), -10, 10));
  touch();
}

function home() {
  Object.assign(view, start, { offset: [0, 0, 0] });
  touch();
}

const fingers = new Map();
let pushed = false;

stage.addEventListener("pointerdown", (e) => {
  stage.setPointerCapture(e.pointerId);
  fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
  pushed = e.button === 2 || e.button === 1 || e.shiftKey;
  stage.classList.add("turning");
});

stage.addEventListener("pointermove", (e) => {
  const own = fingers.get(e.pointerId);
  if (!own) return;
  const dx = e.clientX - own.x, dy = e.clientY - own.y;
  if (!dx && !dy) return;
  if (fingers.size === 1) {
    pushed ? shift(dx, dy) : turn(dx, dy);
  } else if (fingers.size === 2) {
    const other = [...fingers.entries()].find(([id]) => id !== e.pointerId)[1];
    const before = Math.hypot(own.x - other.x, own.y - other.y),
      after = Math.hypot(e.clientX - other.x, e.clientY - other.y);
    shift(dx / 2, dy / 2);
    if (before > 8 && after > 8) zoom(after / before, (e.clientX + other.x) / 2, (e.clientY + other.y) / 2);
  }
  own.x = e.clientX;
  own.y = e.clientY;
});

function lift(e) {
  fingers.delete(e.pointerId);
  if (!fingers.size) stage.classList.remove("turning");
  pushed = false;
}
stage.addEventListener("pointerup", lift);
stage.addEventListener("pointercancel", lift);
stage.addEventListener("contextmenu", (e) => e.preventDefault());
stage.addEventListener("dblclick", home);
stage.addEventListener("wheel", (e) => {
  e.preventDefault();
  const lines = e.deltaMode === 1 ? 33 : e.deltaMode === 2 ? 400 : 1;
  zoom(Math.exp(-clamp(e.deltaY * lines, -240, 240) * (e.ctrlKey ? 0.008 : 0.0016)), e.clientX, e.clientY);
}, { passive: false });

// ---- time
function showTime() {
  const m = motion(), n = frameNow();
  $("line").value = n;
  $("time").textContent = m.fps ? `${view.time.toFixed(2)} / ${(m.frames / m.fps).toFixed(2)} s`
    : `pose ${n + 1} of ${m.frames}`;
  $("line").setAttribute("aria-valuetext", $("time").textContent);
}

function setPlaying(on) {
  play.on = on && motion().frames > 1;
  const end = motion().frames / motionFps();
  if (play.on && !play.loop && view.time >= end - 1 / motionFps()) view.time = 0;
  play.last = performance.now();
  $("play-icon").setAttribute("href", play.on ? "#i-pause" : "#i-play");
  $("play").setAttribute("aria-label", play.on ? "Pause" : "Play");
  if (play.on) requestAnimationFrame(tick);
  showTime();
  changed = performance.now();
  schedule();
}

function tick(now) {
  if (!play.on) return;
  const end = motion().frames / motionFps(), before = frameNow();
  view.time += (clamp(now - play.last, 0, 500) / 1000) * play.rate;
  play.last = now;
  if (view.time >= end) {
    if (play.loop) view.time %= end;
    else { view.time = (motion().frames - 1) / motionFps(); setPlaying(false); }
  }
  if (frameNow() !== before) {
    touch();
    if (now - play.told > limits.tellMs) { // drawing the time line for every picture would be slow
      play.told = now;
      showTime();
    }
  }
  if (play.on) requestAnimationFrame(tick);
}

function setFrame(n) {
  view.time = clamp(n, 0, motion().frames - 1) / motionFps();
  showTime();
  touch();
}

function step(by) {
  setPlaying(false);
  const count = motion().frames, n = frameNow() + by;
  setFrame(play.loop ? (n + count) % count : n);
}

function setMotion(n) {
  view.motion = n;
  view.time = 0;
  view.offset = [0, 0, 0];
  $("motion").value = n;
  const frames = motion().frames;
  $("bar").hidden = frames < 2;
  document.body.classList.toggle("plays", frames > 1);
  $("line").max = frames - 1;
  showTime();
  setPlaying(frames > 1 && motion().fps > 0);
  touch();
}

// ---- the rest of the page
function setAvatar(n) {
  view.avatar = n;
  $("avatar").value = n;
  const { picture } = about.avatars[n];
  $("show-input").disabled = !picture;
  if (picture) $("input-image").src = "picture?avatar=" + n;
  else showInput(false); // a baked avatar does not contain it
  document.title = about.avatars[n].name + " · sherf";
  touch();
}

function setMode(mode) {
  view.mode = mode;
  for (const b of $("modes").children) choose(b, b.dataset.mode === mode);
  touch();
}

function choose(button, on) {
  button.setAttribute("aria-checked", on);
  button.tabIndex = on ? 0 : -1;
}

function setGround(name) {
  view.ground = name;
  let found = false;
  for (const b of $("grounds").querySelectorAll("button")) {
    const on = b.dataset.ground === name;
    choose(b, on);
    found = found || on;
  }
  $("own-ground").classList.toggle("chosen", !found);
  touch();
}

function setPressed(id, on) {
  $(id).setAttribute("aria-pressed", on);
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  touch();
}

function showInput(on) {
  $("input").hidden = !on;
  setPressed("show-input", on);
}

function toggleInput() {
  showInput($("input").hidden && about.avatars[view.avatar].picture);
}

function toggleFollow() {
  view.follow = !view.follow;
  setPressed("follow", view.follow);
  touch();
}

function toggleLoop() {
  play.loop = !play.loop;
  setPressed("loop", play.loop);
}

function save(blob, name) {
  const a = document.createElement("a");
  a.href = URL.createObjectURL(blob);
  a.download = name;
  a.click();
  setTimeout(() => URL.revokeObjectURL(a.href), 10000);
}

const fileName = (end) => "sherf-" + about.avatars[view.avatar].name.replace(/[^\p{L}\p{N}_-]+/gu, "-") + end;

// In full size, as another client, so that the screen's requests continue.
async function savePicture() {
  if ($("picture").disabled) return;
  $("picture").disabled = true;
  $("picture").classList.add("busy");
  try {
    const [w, h] = dimensions(fullSide());
    const answer = await fetch("frame?" + query(w, h, { client: client + "p", n: ++sequence, png: 1, fine: 1 }));
    if (!answer.ok) throw await refusal(answer);
    save(await answer.blob(), fileName(`-${view.mode}.png`));
  } catch (error) {
    note("The picture could not be saved. " + error.message);
    setTimeout(() => note(""), 4000);
  }
  $("picture").disabled = false;
  $("picture").classList.remove("busy");
}

// ---- videos
const filmClient = client + "f";
let filming = false;

function filmNote() {
  const turns = $("film-kind").value === "turn";
  $("film-seconds-row").hidden = !turns;
  const fps = Number($("film-fps").value);
  const seconds = turns ? Number($("film-seconds").value) : motion().frames / motionFps() / play.rate;
  $("film-note").textContent = `${Math.ceil(seconds * fps)} frames, ${seconds.toFixed(1)} s, MP4` +
    (turns ? "" : ` at ${play.rate}×`) +
      (ground() === "none" ? "; videos have no transparency: the background is black" : "");
}

function filmOpen() {
  const moves = motion().frames > 1;
  $("film-kind").options[0].disabled = !moves;
  if (!moves) $("film-kind").value = "turn";
  else if (!filming) $("film-kind").value = "motion";
  filmNote();
  $("film-box").showModal();
}

function filmShow(on) {
  filming = on;
  $("film-form").hidden = on;
  $("film-progress").hidden = !on;
  $("film-start").hidden = on;
  $("film-close").textContent = on ? "Cancel" : "Close";
}

async function filmCall(method, fields = {}) {
  const answer = await fetch("film?" + new URLSearchParams({ client: filmClient, ...fields }), { method });
  if (!answer.ok) throw await refusal(answer);
  return answer;
}

async function filmMake() {
  const fps = Number($("film-fps").value), turns = $("film-kind").value === "turn";
  const [w, h] = dimensions(Number($("film-size").value), about.film_long).map((x) => x - (x % 2));
  const fields = Object.fromEntries(query(w, h, { fps, speed: play.rate }));
  if (fields.bg === "none") fields.bg = "000000";
  if (turns) fields.turn = clamp(Math.round($("film-seconds").value * fps), 1, about.film_frames);
  filmShow(true);
  $("film-meter").value = 0;
  $("film-state").textContent = "";
  try {
    await filmCall("POST", fields);
    let state;
    const begun = performance.now();
    while (filming) {
      await new Promise((done) => setTimeout(done, 400));
      state = await (await filmCall("GET")).json();
      if (state.state !== "running") break;
      const left = state.done ? (((performance.now() - begun) / state.done) * (state.frames - state.done)) / 1000 : 0;
      $("film-meter").value = state.done / state.frames;
      $("film-state").textContent = `${state.done} of ${state.frames} frames` +
        (left ? `, ${Math.ceil(left)} s left` : "");
    }
    if (!filming) return;
    if (state.state !== "done") throw new Error(state.message || "The video was not made.");
    const file = await fetch("film.mp4?client=" + filmClient);
    if (!file.ok) throw await refusal(file);
    save(await file.blob(), fileName(turns ? "-turn.mp4" : "-motion.mp4"));
    filmCall("DELETE").catch(() => {});
    $("film-box").close();
  } catch (error) {
    filmCall("DELETE").catch(() => {});
    $("film-note").textContent = error.message;
  }
  filmShow(false);
}

function filmClose() {
  if (!filming) return $("film-box").close();
  filming = false;
  filmCall("DELETE").catch(() => {});
  filmShow(false);
}

// ---- keys
const keys = {
  " ": () => setPlaying(!play.on), "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(1 / 1.15),
  ",": () => step(-1), ".": () => step(1), 0: home, Home: home, l: toggleLoop, f: toggleFollow, i: toggleInput,
  1: () => setMode("color"), 2: () => setMode("opacity"), 3: () => setMode("depth"), 4: () => setMode("normal"),
  b: () => { const all = ["page", "000000", "ffffff", "none"];
    setGround(all[(all.indexOf(view.ground) + 1) % all.length]); },
  a: () => setAvatar((view.avatar + 1) % about.avatars.length),
    m: () => setMotion((view.motion + 1) % about.motions.length),
  p: savePicture, v: filmOpen, t: () => $("theme").click(),
    h: () => $("help-box").showModal(), "?": () => $("help-box").showModal(),
};
const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

addEventListener("keydown", (e) => {
  if (!about || e.ctrlKey || e.metaKey || e.altKey || document.querySelector("dialog[open]")) return;
  const field = e.target.closest("select, input");
  const arrow = arrows[e.key];
  if (field && (arrow || e.key === " " || e.key === "Home" || field.tagName === "SELECT")) return;
  if (e.target.tagName === "BUTTON" && e.key === " ") return; // presses the button
  if (arrow) e.shiftKey ? shift(-24 * arrow[0], -24 * arrow[1]) : turn(-12 * arrow[0], -12 * arrow[1]);
  else if (keys[e.key]) keys[e.key]();
  else return;
  e.preventDefault();
});

// ---- setting up
function connect() {
  $("avatar").onchange = (e) => { setAvatar(Number(e.target.value)); stage.focus(); };
  $("motion").onchange = (e) => { setMotion(Number(e.target.value)); stage.focus(); };
  for (const b of $("modes").children) b.onclick = () => setMode(b.dataset.mode);
  for (const b of $("grounds").querySelectorAll("button")) b.onclick = () => setGround(b.dataset.ground);
  $("ground-color").oninput = (e) => setGround(e.target.value.slice(1).toLowerCase());
  $("ground-color").onclick = (e) => setGround(e.target.value.slice(1).toLowerCase());
  $("home").onclick = home;
  $("follow").onclick = toggleFollow;
  $("show-input").onclick = toggleInput;
  $("input").onclick = () => $("input").classList.toggle("large");
  $("picture").onclick = savePicture;
  $("film").onclick = filmOpen;
  $("theme").onclick = () => setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light");
  $("help").onclick = () => $("help-box").showModal();
  $("play").onclick = () => setPlaying(!play.on);
  $("line").oninput = (e) => { const n = Number(e.target.value); setPlaying(false); setFrame(n); };
  $("rate").onchange = (e) => { play.rate = Number(e.target.value); stage.focus(); };
  $("loop").onclick = toggleLoop;
  for (const id of ["film-kind", "film-seconds", "film-fps"]) $(id).oninput = filmNote;
  $("film-start").onclick = filmMake;
  $("film-close").onclick = filmClose;
  $("film-box").addEventListener("cancel", filmClose);
  // arrow keys inside the groups of choices
  for (const group of document.querySelectorAll("[role=radiogroup]"))
    group.addEventListener("keydown", (e) => {
      if (!arrows[e.key]) return;
      const all = [...group.querySelectorAll("[role=radio]")], at = all.indexOf(e.target);
      const next = all[(at + all.length + (arrows[e.key][0] || arrows[e.key][1])) % all.length];
      if (at < 0 || !next) return;
      next.click();
      next.focus();
      e.preventDefault();
      e.stopPropagation();
    });
  new ResizeObserver(touch).observe(stage);
  document.addEventListener("visibilitychange", schedule);
  addEventListener("online", () => { clearTimeout(retry); retry = 0; schedule(); });
  addEventListener("pagehide", () => {
    if (filming) fetch("film?client=" + filmClient, { method: "DELETE", keepalive: true }).catch(() => {});
  });
}

function fill(select, items) {
  select.replaceChildren(...items.map((item, n) => new Option(item.name, n)));
}

async function open() {
  try {
    const answer = await fetch("about");
    if (!answer.ok) throw await refusal(answer);
    about = await answer.json();
  } catch (error) {
    return lost(error);
  }
  note("");
  fill($("avatar"), about.avatars);
  fill($("motion"), about.motions);
  $("avatar").disabled = about.avatars.length < 2;
  const sides = [256, 384, 512, 768, 1024].filter((s) => s <= about.film_side);
  for (const side of sides.length ? sides : [about.film_side])
    $("film-size").add(new Option(side, side, side === 512, side === 512));
  $("version").textContent = "sherf " + about.version + ".";
  setPressed("loop", play.loop);
  connect();
  live.open($("live"), schedule, location.hash === "#surface");
  setMode("color");
  setGround("page");
  setAvatar(0);
  setMotion(about.motions.length > 2 ? 2 : 0);
  stage.focus({ preventScroll: true });
}

document.documentElement.dataset.theme = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
note("One moment…");
open();
