// The page of a preference study: a rater always gets the same order and sides, and answers stay in this browser until
// they are saved as a file. The page does not know which method made a picture; the key stays with the page's author.
"use strict";
// id, draw, repeats, always, trials of [input, a, b], pictures
const study = JSON.parse(document.getElementById("study").textContent);
const at = (id) => document.getElementById(id);
const place = "sherf-study-" + study.id;
const shortest = 250; // ms: a second press of the same key is not an answer
let state,
  plan,
  shownAt = 0,
  open = false;

// Random numbers in [0, 1), seeded by a text.
function numbers(text) {
  let h = 2166136261;
  for (const c of text) h = Math.imul(h ^ c.charCodeAt(0), 16777619);
  return () => {
    h = (h + 0x6d2b79f5) | 0;
    let t = Math.imul(h ^ (h >>> 15), 1 | h);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

function shuffle(list, next) {
  for (let i = list.length - 1; i > 0; i--) {
    const k = Math.floor(next() * (i + 1));
    [list[i], list[k]] = [list[k], list[i]];
  }
  return list;
}

// A rater's trials: a random part of all, those that everybody sees, and a few repeated later with sides swapped.
function planOf(rater) {
  const next = numbers(study.id + rater),
    always = new Set(study.always);
  const others = shuffle(
    [...study.trials.keys()].filter((i) => !always.has(i)),
    next,
  ).slice(0, study.draw);
  const list = shuffle([...others, ...study.always], next).map((trial) => ({
    trial,
    left: next() < 0.5 ? "a" : "b",
    repeat: false,
  }));
  const half = Math.floor(list.length / 2);
  const early = shuffle(
    list.slice(0, half).filter((q) => !always.has(q.trial)),
    next,
  ).slice(0, study.repeats);
  for (const q of early) {
    const where = half + 1 + Math.floor(next() * (list.length - half));
    list.splice(where, 0, { trial: q.trial, left: q.left === "a" ? "b" : "a", repeat: true });
  }
  return list;
}

function keep() {
  try {
    localStorage.setItem(place, JSON.stringify(state));
  } catch {} // private windows: the answers last as long as the page
}

function kept() {
  try {
    const old = JSON.parse(localStorage.getItem(place));
    if (
      old &&
      typeof old.rater === "string" &&
      Array.isArray(old.answers) &&
      old.answers.length <= planOf(old.rater).length
    )
      return old;
  } catch {}
  return null;
}

// ?rater=NAME fixes the order and the sides.
function newRater() {
  const asked = new URLSearchParams(location.search).get("rater");
  if (asked && /^[0-9A-Za-z-]{1,64}$/.test(asked)) return asked;
  return [...crypto.getRandomValues(new Uint8Array(8))].map((b) => b.toString(16).padStart(2, "0")).join("");
}

function only(id) {
  for (const part of ["welcome", "trial", "end"]) at(part).hidden = part !== id;
}

async function show() {
  const n = state.answers.length;
  open = false;
  at("progress").value = n / plan.length;
  at("place").textContent = `${Math.min(n + 1, plan.length)} / ${plan.length}`;
  at("back").disabled = !n;
  if (n === plan.length) return only("end");
  const q = plan[n],
    [input, a, b] = study.trials[q.trial];
  const images = [at("input"), at("left").firstElementChild, at("right").firstElementChild];
  [input, q.left === "a" ? a : b, q.left === "a" ? b : a].forEach((p, i) => (images[i].src = study.pictures[p]));
  only("trial");
  await Promise.all(images.map((i) => i.decode().catch(() => {}))); // all appear at the same time
  if (n !== state.answers.length) return;
  shownAt = performance.now();
  open = true;
}

function choose(side) {
  const ms = performance.now() - shownAt;
  if (!open || ms < shortest) return;
  const q = plan[state.answers.length];
  state.answers.push({ trial: q.trial, left: q.left, chose: side, ms: Math.round(ms), repeat: q.repeat });
  keep();
  show();
}

function back() {
  if (at("trial").hidden || !state.answers.length) return;
  state.answers.pop();
  keep();
  show();
}

function save() {
  const file = {
    format: "sherf-preference-answers",
    version: 1,
    study: study.id,
    rater: state.rater,
    consent: true,
    trials: state.answers,
  };
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([JSON.stringify(file, null, 1) + "\n"], { type: "application/json" }));
  link.download = `answers-${state.rater}.json`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function begin() {
  state = kept() || { rater: newRater(), answers: [] };
  plan = planOf(state.rater);
  at("count").textContent = plan.length;
  if (state.answers.length) show();
  else only("welcome");
}

at("consent").addEventListener("change", (e) => (at("start").disabled = !e.target.checked));
at("start").addEventListener("click", show);
at("left").addEventListener("click", () => choose("left"));
at("right").addEventListener("click", () => choose("right"));
at("back").addEventListener("click", back);
at("save").addEventListener("click", save);
at("again").addEventListener("click", () => {
  if (!confirm("Delete all answers?")) return;
  try {
    localStorage.removeItem(place);
  } catch {}
  at("consent").checked = false;
  at("start").disabled = true;
  begin();
});
addEventListener("keydown", (e) => {
  if (e.repeat || e.ctrlKey || e.metaKey || e.altKey || at("trial").hidden) return;
  if (e.key === "ArrowLeft" || e.key === "1") choose("left");
  else if (e.key === "ArrowRight" || e.key === "2") choose("right");
  else if (e.key === "Backspace") back();
  else return;
  e.preventDefault();
});
begin();
