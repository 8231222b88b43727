// Tests the viewer in a real browser: node tests/viewer/browser.mjs SHERF BODY AVATAR... [-- MOTION...]
// Needs Debian's chromium and npm's playwright-core (found through NODE_PATH, or PLAYWRIGHT_CORE=its folder).
// $RATES=only: only measures the number of pictures per second (10 seconds).
// Saves screenshots in $SCREENSHOTS if that is a folder; $SIZE is the viewer's --size (384). Exit status: 0 passed,
// 1 failed, 77 cannot be run.
import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { browserPath, check, chromium, failures, shot, skip } from "../support/chromium.mjs";

const words = process.argv.slice(2), dash = words.indexOf("--");
const [sherf, body, ...avatars] = dash < 0 ? words : words.slice(0, dash);
const motions = dash < 0 ? [] : words.slice(dash + 1);
if (!avatars.length) skip("usage: browser.mjs SHERF BODY AVATAR... [-- MOTION...]");
const size = process.env.SIZE || "384";
const patience = 180000; // ms; a busy machine is slow

function serve(port) {
  const words = ["view", ...avatars, "-b", body, "--port", String(port), "--size", size,
    ...motions.flatMap((m) => ["--motion", m])];
  const child = spawn(sherf, words, { stdio: ["ignore", "pipe", "pipe"] });
  let said = "";
  child.stderr.on("data", (d) => (said += d));
  const ended = new Promise((done) => child.on("exit", (code) => done(code)));
  const address = new Promise((done, failed) => {
    let text = "";
    child.stdout.on("data", (d) => {
      text += d;
      const found = text.match(/http:\S+/);
      if (found) done(found[0]);
    });
    ended.then((code) => failed(new Error(`sherf view ended with ${code}: ${said}`)));
  });
  return { child, address, ended };
}

const text = (page) => page.textContent("#speed");
const ready = (page) =>
  page.waitForFunction(() => document.getElementById("speed").textContent.includes("ms"), null,
  { timeout: patience });
// Refined: the picture has its full size and nothing is under way.
const still = (page) =>
  page.waitForFunction(() => shown.stamp === stamp && shown.side >= fullSide() && !shown.baked && !pending, null,
  { timeout: patience, polling: 50 });
// A small copy of the canvas's pixels.
const pixels = (page, canvas = "canvas") => page.evaluate((canvas) => {
  const c = document.createElement("canvas");
  c.width = c.height = 64;
  const p = c.getContext("2d");
  p.drawImage(document.getElementById(canvas), 0, 0, 64, 64);
  return [...p.getImageData(0, 0, 64, 64).data];
}, canvas);
const difference = (a, b) => a.reduce((sum, x, i) => sum + Math.abs(x - b[i]), 0) / a.length;
const colours = (a) => new Set(a.map((x, i) => (i % 4 ? -1 : (x << 16) | (a[i + 1] << 8) | a[i + 2]))).size;

// Pictures per second while the page turns the body or plays the motion for some seconds, with this side in pixels.
// Without a side the page chooses its own.
async function rate(page, plays, side = 128, seconds = 3) {
  await page.evaluate(([plays, side]) => {
    Object.assign(limits, { quick: false, sideLeast: side, sideMost: side });
    moving = side;
    if (!plays) return;
    setMotion(2);
    play.loop = true;
    setPlaying(true);
  }, [plays, side]);
  const result = await page.evaluate(([plays, side, seconds]) => new Promise((done) => {
    const begun = performance.now(), first = 500; // ms until the rate is steady
    let from = 0, sequence = -1, pictures = 0, size = "";
    const step = (now) => {
      if (shown.sequence !== sequence && now - begun > first) {
        if (from) pictures++;
        else from = now;
        if (shown.side === side) size = `${canvas.width} x ${canvas.height}`;
      }
      sequence = shown.sequence;
      if (now - begun > first + 1000 * seconds)
        return done({ fps: (1000 * pictures) / (now - from), size, ms: costMs * side * side });
      if (!plays) turn(3, 0);
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }), [plays, side, seconds]);
  await page.evaluate(() => {
    setPlaying(false);
    Object.assign(limits, { quick: true, sideLeast: 96, sideMost: 288 });
  });
  console.log(`      while ${plays ? "playing" : "turning"}: ` +
    `${result.fps.toFixed(1)} pictures a second of ${result.size}, ` +
    `${result.ms.toFixed(0)} ms each from the request to the picture`);
}

const folder = mkdtempSync(path.join(tmpdir(), "sherf-browser-"));
let server = serve(0), browser;
try {
  const address = await server.address;
  browser = await chromium.launch({ executablePath: browserPath,
    args: ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"] });
  const desktop = await browser.newContext({ viewport: { width: 1280, height: 800 }, acceptDownloads: true });
  desktop.setDefaultTimeout(patience);
  const page = await desktop.newPage();
  const problems = [];
  page.on("pageerror", (e) => problems.push(e.message));
  page.on("console", (m) => m.type() === "error" && problems.push(m.text()));

  // load
  await page.goto(address);
  await ready(page);
  if (motions.length) await page.keyboard.press("Space");
  await still(page);
  await rate(page, false);
  if (motions.length) await rate(page, true);
  if (process.env.RATES === "only") throw null;
  await page.keyboard.press("0");
  await page.selectOption("#motion", "0");
  await still(page);
  const front = await pixels(page);
  check(colours(front) > 50, `a person is on the screen (${colours(front)} colours; ${await text(page)})`);
  await shot(page, "desktop");

  // orbit
  await page.mouse.move(600, 400);
  await page.mouse.down();
  const speeds = [];
  for (let i = 1; i <= 40; i++) {
    await page.mouse.move(600 + 6 * i, 400 + i, { steps: 1 });
    await page.waitForTimeout(40);
    speeds.push(await text(page));
  }
  await page.mouse.up();
  const lifted = Date.now();
  console.log("      while turning: " + speeds.at(-1));
  await page.waitForFunction(() => shown.stamp === stamp && (shown.fine || shown.side > 1.3 * moving), null,
    { timeout: patience, polling: 10 });
  console.log(`      first refined picture after ${Date.now() - lifted} ms: ${await text(page)}`);
  await still(page);
  console.log(`      full size after ${Date.now() - lifted} ms: ${await text(page)}`);
  const side = await pixels(page);
  check(difference(front, side) > 1, `turning changes the picture (${difference(front, side).toFixed(1)})`);
  await shot(page, "turned");
  await page.keyboard.press("0");
  await still(page);
  const back = await pixels(page);
  check(difference(front, back) < 1, `reset brings it back (${difference(front, back).toFixed(2)})`);

  // zoom about a point, pan
  await page.mouse.move(640, 250);
  await page.mouse.wheel(0, -700);
  await still(page);
  const near = await pixels(page);
  check(difference(front, near) > 3, "the wheel zooms");
  await shot(page, "near");
  await page.mouse.move(500, 500);
  await page.mouse.down({ button: "right" });
  await page.mouse.move(600, 450, { steps: 4 });
  await page.mouse.up({ button: "right" });
  await still(page);
  check(difference(near, await pixels(page)) > 2, "the right button moves");
  await page.keyboard.press("0");

  // what the page shows
  for (const [key, mode] of [["2", "opacity"], ["3", "depth"], ["4", "normal"], ["1", "color"]]) {
    await page.keyboard.press(key);
    await still(page);
    const now = await pixels(page);
    check(mode === "color" ? difference(front, now) < 1 : difference(front, now) > 1, mode);
    if (mode !== "color") await shot(page, mode);
  }
  await page.click('[data-ground="none"]');
  await still(page);
  check((await pixels(page)).filter((x, i) => i % 4 === 3 && x === 0).length > 100, "transparent background");
  await page.click("#show-input");
  await page.waitForFunction(() => document.getElementById("input-image").naturalWidth > 0);
  await shot(page, "transparent");
  await page.click("#theme");
  await page.click('[data-ground="page"]');
  await still(page);
  await shot(page, "light");
  await page.click("#theme");
  await page.keyboard.press("h");
  await shot(page, "help");
  await page.keyboard.press("Escape");

  // capture
  let [download] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("p")]);
  const png = path.join(folder, "picture.png");
  await download.saveAs(png);
  const head = readFileSync(png);
  check(head.subarray(1, 4).toString() === "PNG" && head.length > 5000,
    `a picture is saved: ${download.suggestedFilename()}, ${head.length} bytes`);

  // play
  if (motions.length) {
    await page.selectOption("#motion", "2");
    await page.waitForTimeout(300);
    const times = [];
    for (let i = 0; i < 8; i++) {
      await page.waitForTimeout(200 + 17 * i); // never a fraction of a short clip's length
      times.push(Number(await page.inputValue("#line")));
    }
    check(new Set(times).size > 4, `the motion plays: frames ${times.join(" ")}; ${await text(page)}`);
    await shot(page, "playing");
    await page.keyboard.press("Space");
    const paused = await page.inputValue("#line");
    await page.waitForTimeout(400);
    check((await page.inputValue("#line")) === paused, "space pauses");
    await page.keyboard.press(".");
    check(Number(await page.inputValue("#line")) !== Number(paused), "a frame on");
    await page.fill("#line", "1");
    await still(page);
    check((await page.evaluate(() => frameNow())) === 1, "the time line scrubs");
  }

  // video
  await page.keyboard.press("v");
  await page.selectOption("#film-kind", "turn");
  await page.fill("#film-seconds", "1");
  await page.selectOption("#film-size", { index: 0 });
  await page.selectOption("#film-fps", "12");
  await shot(page, "film");
  [download] = await Promise.all([page.waitForEvent("download", { timeout: patience }), page.click("#film-start")]);
  const mp4 = path.join(folder, "turn.mp4");
  await download.saveAs(mp4);
  const film = readFileSync(mp4);
  check(film.subarray(4, 8).toString() === "ftyp" && film.length > 3000, `a video is saved: ${film.length} bytes`);

  // another avatar
  if (avatars.length > 1) {
    await page.selectOption("#motion", "0");
    await still(page);
    const one = await pixels(page);
    await page.selectOption("#avatar", "1");
    await still(page);
    check(difference(one, await pixels(page)) > 1, "another avatar");
    await page.selectOption("#avatar", "0");
  }

  // the surface that the page draws itself, which it does without a graphics card only in this test
  check(await page.evaluate(() => !live.ready(0, 0, 0, 1)), "without a graphics card the page asks for pictures");
  const surface = await desktop.newPage();
  surface.on("pageerror", (e) => problems.push(e.message));
  await surface.goto(address + "#surface");
  await ready(surface);
  await surface.evaluate(() => setPlaying(false));
  await surface.selectOption("#motion", "0");
  await surface.waitForFunction(() => isLive(), null, { timeout: patience });
  await still(surface);
  await surface.evaluate(() => turn(40, 0));
  await surface.waitForFunction(() => !$("live").hidden, null, { timeout: patience });
  const drawnHere = await pixels(surface, "live");
  check(colours(drawnHere) > 50, `what moves is drawn by the page (${await text(surface)})`);
  await shot(surface, "surface");
  await still(surface);
  check(await surface.evaluate(() => $("live").hidden), "a still view is the network's picture");
  const apart = difference(drawnHere, await pixels(surface));
  await surface.evaluate(() => turn(80, 0));
  await still(surface);
  const turned = difference(drawnHere, await pixels(surface));
  check(apart < 3 && apart < 0.6 * turned,
    `both are of the same view (${apart.toFixed(2)} apart, another view ${turned.toFixed(2)})`);
  await surface.close();

  // two clients, the second one a phone
  const phone = await browser.newContext({ viewport: { width: 390, height: 844 },
    deviceScaleFactor: 2, isMobile: true, hasTouch: true });
  phone.setDefaultTimeout(patience);
  const small = await phone.newPage();
  small.on("pageerror", (e) => problems.push(e.message));
  await small.goto(address);
  await ready(small);
  await page.mouse.move(500, 400);
  await page.mouse.down();
  await small.evaluate(() => setPlaying(false));
  const count = async () => [await page.evaluate(() => shown.sequence), await small.evaluate(() => shown.sequence)];
  const before = await count(), until = Date.now() + patience;
  let now = before;
  for (let i = 1; now.some((n, k) => n < before[k] + 5) && Date.now() < until; i++) {
    await page.mouse.move(500 + 8 * (i % 40), 400);
    await small.evaluate((n) => turn(4 * n, 0), i);
    await page.waitForTimeout(60);
    now = await count();
  }
  await page.mouse.up();
  check(now.every((n, k) => n >= before[k] + 5),
    `two clients are served side by side (${now.map((n, k) => n - before[k])})`);
  await Promise.all([still(page), still(small)]);
  await small.evaluate(() => home());
  await still(small);
  await shot(small, "phone");
  await small.selectOption("#motion", "0");
  await still(small);
  await shot(small, "phone-pose");
  await small.tap("#help");
  await shot(small, "phone-help");
  // a pinch with two touches
  await small.evaluate(() => document.getElementById("help-box").close());
  const zoomed = await small.evaluate(() => {
    const touch = (type, id, x, y) => stage.dispatchEvent(
      new PointerEvent(type, { pointerId: id, pointerType: "touch", clientX: x, clientY: y, bubbles: true }));
    stage.setPointerCapture = () => {};
    touch("pointerdown", 11, 150, 400);
    touch("pointerdown", 12, 250, 400);
    touch("pointermove", 11, 100, 400);
    touch("pointermove", 12, 300, 400);
    touch("pointerup", 11, 100, 400);
    touch("pointerup", 12, 300, 400);
    return view.zoom;
  });
  check(Math.abs(zoomed - 2) < 0.01, `a pinch zooms (${zoomed.toFixed(2)})`);
  await small.setViewportSize({ width: 844, height: 390 });
  await small.evaluate(() => home());
  await still(small);
  await shot(small, "phone-wide");
  await small.close();

  // reconnect: the network fails and comes back
  await desktop.setOffline(true);
  await page.keyboard.press("ArrowLeft");
  await page.waitForFunction(() => !document.getElementById("notice").hidden, null, { timeout: 60000 });
  await shot(page, "offline");
  await desktop.setOffline(false);
  await still(page);
  check(await page.evaluate(() => document.getElementById("notice").hidden), "comes back after the network was away");
  const own = problems.filter((p) => !/Failed to load resource: net::ERR_INTERNET_DISCONNECTED/.test(p));
  check(own.length === 0, "no errors in the page" + own.map((p) => "\n      " + p).join(""));

  // the program ends and starts again at the same port with another key
  const port = new URL(address).port;
  server.child.kill("SIGINT");
  check((await server.ended) === 0, "Ctrl-C ends the program with status 0");
  await page.keyboard.press("ArrowLeft");
  await page.waitForFunction(() => /does not answer/.test(document.getElementById("notice").textContent), null,
    { timeout: 60000 });
  server = serve(port);
  const anew = await server.address;
  check(anew !== address, "another key after another start");
  await page.waitForFunction(() => /anew/.test(document.getElementById("notice").textContent), null,
    { timeout: 60000 });
  check(true, "the page says that the viewer was started anew");
  await page.goto(anew);
  await ready(page);
  check(colours(await pixels(page)) > 50, "and works at its new address");
} catch (error) {
  if (error) console.error(error);
  if (error) failures++;
} finally {
  await browser?.close();
  server.child.kill("SIGINT");
  await server.ended;
  rmSync(folder, { recursive: true, force: true });
}
console.log(failures ? `${failures} failed` : "all passed");
process.exit(failures ? 1 : 0);
