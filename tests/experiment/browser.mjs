// Tests a preference study in a real browser: node tests/experiment/browser.mjs SHERF FOLDER
// FOLDER is the output of `sherf experiment preference`. Needs Debian's chromium and npm's playwright-core (found
// through NODE_PATH, or PLAYWRIGHT_CORE=its folder). Saves screenshots in $SCREENSHOTS if that is a folder. Exit
// status: 0 passed, 1 failed, 77 cannot be run.
import { spawnSync } from "node:child_process";
import { createServer } from "node:http";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { browserPath, check, chromium, failures, shot, skip } from "../support/chromium.mjs";

const [sherf, folder] = process.argv.slice(2);
if (!folder) skip("usage: browser.mjs SHERF FOLDER");
const file = path.join(folder, "preference", "study.html"),
  html = readFileSync(file);
const key = JSON.parse(readFileSync(path.join(folder, "preference", "key.json")));
const patience = 120000; // ms; a busy machine is slow

// Serves this one page and nothing else, like any static host.
const asked = [];
const server = createServer((request, answer) => {
  asked.push(request.method + " " + request.url.split("?")[0]);
  answer.writeHead(request.url.startsWith("/study.html") ? 200 : 404, { "Content-Type": "text/html; charset=utf-8" });
  answer.end(request.url.startsWith("/study.html") ? html : "");
});
await new Promise((done) => server.listen(0, "127.0.0.1", done));
const address = `http://127.0.0.1:${server.address().port}/study.html`;
const out = mkdtempSync(path.join(tmpdir(), "sherf-study-"));

const ready = (page) =>
  page.waitForFunction(() => open && performance.now() - shownAt > 260, null, { timeout: patience, polling: 20 });
// The current question: the trial, and the side of the wanted method. In catch trials the sharp picture is wanted,
// otherwise the subject's.
const wanted = async (page) => {
  const q = await page.evaluate(() => plan[state.answers.length]);
  const t = key.trials[q.trial],
    good = t.blurred ? (t.blurred === "a" ? "b" : "a") : t.a === 0 ? "a" : "b";
  return { ...q, ...t, side: q.left === good ? "left" : "right" };
};

// Answers all questions from the page's current position; `press` gives one answer. Checks that every pair is shown
// with its pictures on the recorded sides.
async function answerAll(page, press) {
  const total = await page.evaluate(() => plan.length);
  for (let n = await page.evaluate(() => state.answers.length); n < total; n++) {
    await ready(page);
    await press((await wanted(page)).side);
    await page.waitForFunction((n) => state.answers.length === n, n + 1, { timeout: patience, polling: 20 });
  }
  await page.waitForSelector("#end:not([hidden])", { timeout: patience });
  return total;
}

async function saved(page, name) {
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("#save")]);
  const to = path.join(out, name);
  await download.saveAs(to);
  return to;
}

const score = (...files) =>
  spawnSync(sherf, ["experiment", "preference", "--score", "-o", folder, ...files], { encoding: "utf8" });

let browser;
try {
  browser = await chromium.launch({ executablePath: browserPath, args: ["--no-sandbox", "--disable-gpu"] });
  const problems = [];
  const open = async (options, url) => {
    const context = await browser.newContext({ acceptDownloads: true, ...options });
    context.setDefaultTimeout(patience);
    const page = await context.newPage();
    page.on("pageerror", (e) => problems.push(e.message));
    page.on("console", (m) => m.type() === "error" && problems.push(m.text()));
    await page.goto(url);
    return page;
  };

  // on a desktop, with keys
  const page = await open({ viewport: { width: 1280, height: 800 } }, address + "?rater=desk");
  check(await page.isDisabled("#start"), "nothing begins without consent");
  await shot(page, "study-welcome");
  await page.check("#consent");
  await page.click("#start");
  await ready(page);
  await shot(page, "study-desktop");
  const shownPictures = await page.evaluate(() =>
    ["#input", "#left img", "#right img"]
      .map((s) => document.querySelector(s))
      .map((i) => [i.naturalWidth, i.naturalHeight, i.getBoundingClientRect().width]),
  );
  check(
    shownPictures.every(([w, h, shown]) => w > 0 && h > 0 && shown > 40),
    "three pictures are shown",
  );
  check(shownPictures[1].join() === shownPictures[2].join(), "both of a pair have the same size");
  const inside = await page.evaluate(
    () =>
      document.documentElement.scrollHeight <= innerHeight &&
      document.querySelector("#pair").getBoundingClientRect().bottom <= innerHeight,
  );
  check(inside, "all of a question fits the window");
  await page.keyboard.press("ArrowLeft");
  await ready(page);
  check((await page.textContent("#place")).startsWith("2 /"), "a key answers");
  await page.keyboard.press("Backspace");
  await ready(page);
  check((await page.textContent("#place")).startsWith("1 /"), "and another goes back");
  await page.keyboard.press((await wanted(page)).side === "left" ? "ArrowLeft" : "ArrowRight");
  await ready(page);
  const before = await page.evaluate(() => JSON.stringify(plan));
  await page.reload();
  await ready(page);
  check(
    (await page.textContent("#place")).startsWith("2 /") &&
      (await page.evaluate(() => JSON.stringify(plan))) === before,
    "a reload goes on in the same order",
  );
  const total = await answerAll(page, (side) => page.keyboard.press(side === "left" ? "ArrowLeft" : "ArrowRight"));
  await shot(page, "study-end");
  const answers = JSON.parse(readFileSync(await saved(page, "desk.json")));
  check(
    answers.rater === "desk" && answers.study === key.study && answers.trials.length === total,
    `${total} answers are in the file`,
  );
  const repeats = answers.trials.filter((t) => t.repeat);
  check(
    repeats.length > 0 &&
      repeats.every((r) => answers.trials.find((t) => !t.repeat && t.trial === r.trial).left !== r.left),
    `${repeats.length} pairs came again with sides exchanged`,
  );
  const catches = key.trials.flatMap((t, i) => (t.blurred ? [i] : []));
  check(
    catches.every((i) => answers.trials.some((t) => t.trial === i)),
    `${catches.length} catch trials were there`,
  );

  // on a phone, with taps
  const phone = await open(
    { viewport: { width: 390, height: 780 }, hasTouch: true, isMobile: true, deviceScaleFactor: 2 },
    address,
  );
  await phone.tap("#consent");
  await phone.tap("#start");
  await ready(phone);
  await shot(phone, "study-phone");
  check(
    await phone.evaluate(
      () =>
        document.documentElement.scrollWidth <= innerWidth &&
        document.querySelector("#pair").getBoundingClientRect().bottom <= innerHeight,
    ),
    "a question fits a phone",
  );
  check(
    (await phone.evaluate(() => JSON.stringify(plan.map((q) => [q.trial, q.left])))) !==
      JSON.stringify(answers.trials.map((t) => [t.trial, t.left])),
    "another rater has another order",
  );
  await answerAll(phone, (side) => phone.tap("#" + side));
  await saved(phone, "phone.json");

  // opened from the disk
  const local = await open({ viewport: { width: 900, height: 700 } }, "file://" + path.resolve(file));
  await local.check("#consent");
  await local.click("#start");
  await answerAll(local, (side) => local.click("#" + side));
  await saved(local, "local.json");
  check(
    asked.every((a) => a === "GET /study.html"),
    "the page asks its host for nothing but itself",
  );
  check(!problems.length, "no errors in the page" + (problems.length ? ": " + problems.join("; ") : ""));

  // scores
  const names = ["desk", "phone", "local"].map((n) => path.join(out, n + ".json"));
  const good = score(...names);
  check(
    good.status === 0 && good.stdout.includes("100.0 ["),
    "all votes for the subject are 100 %" + (good.status ? ": " + good.stderr : ""),
  );
  check(/\| all \| 3 \| 0 \| 100\.0 \[/.test(good.stdout), "three raters, none left out, who agree with themselves");
  const twice = score(names[0], names[0]);
  check(
    twice.status === 1 && twice.stderr.trim().split("\n").length === 1 && twice.stderr.includes("rater desk"),
    "the same rater twice is refused in a line",
  );
} finally {
  await browser?.close();
  server.close();
  rmSync(out, { recursive: true, force: true });
}
console.log(failures ? `${failures} failed` : "all passed");
process.exit(failures ? 1 : 0);
