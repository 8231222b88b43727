// Shared by the tests in a real browser: Debian's chromium, driven by npm's playwright-core (found through NODE_PATH,
// or PLAYWRIGHT_CORE=its folder); counted checks; screenshots in $SCREENSHOTS if that is a folder.
import { createRequire } from "node:module";
import { existsSync } from "node:fs";
import path from "node:path";

export function skip(why) {
  console.error("browser.mjs: skipped: " + why);
  process.exit(77);
}

export const browserPath = process.env.CHROMIUM || "/usr/bin/chromium";
if (!existsSync(browserPath)) skip(browserPath + " is not there");
let found;
try {
  found = createRequire(import.meta.url)(process.env.PLAYWRIGHT_CORE || "playwright-core");
} catch {
  skip("playwright-core is not there (npm install playwright-core)");
}
export const chromium = found.chromium;

export let failures = 0;
export function check(good, what) {
  console.log((good ? "ok    " : "FAIL  ") + what);
  if (!good) failures++;
}

const pictures = process.env.SCREENSHOTS;
export const shot = async (page, name) =>
  pictures && page.screenshot({ path: path.join(pictures, name + ".png") });
