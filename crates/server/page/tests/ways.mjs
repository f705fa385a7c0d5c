// How long a frame takes from the camera to a canvas by three ways, in one run: as the server sends it, as base64 in JSON, as MJPEG; on a page that has
// nothing else to do, and on one that is slower than the camera. A measurement, no test.
//   SCOPESERVO=target/release/scopeservo node tests/ways.mjs [ROUNDS]
import { loadavg } from "node:os";
import { chromium } from "playwright-core";
import { draw, relay } from "./relay.mjs";
import { serve } from "./served.mjs";

const ROUNDS = Number(process.argv[2] ?? 3);
const FRAMES = 100;
const WAYS = [["own", "WebSocket, one place, drawn before the next"], ["json", "base64 in JSON over WebSocket"], ["mjpeg", "MJPEG"]];
/** What a slow page does with each frame beside, ms: more than there is between two. */
const SLOW = 50;

const { link, end } = await serve();
const address = new URL(link).origin;
const entered = await fetch(`${address}/api/v1/enter`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ key: link.split("#key=")[1] }) });
const cookie = entered.headers.get("set-cookie").split(";")[0];
const { url, end: endRelay } = await relay(address, cookie);
const browser = await chromium.launch({ executablePath: process.env.SCOPESERVO_CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
const page = await browser.newPage();
await page.goto(url);
// The demonstration is calibrated meanwhile.
await page.waitForTimeout(12_000);
console.log(`load before: ${loadavg()[0].toFixed(1)}`);

const at = (values, share) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(share * values.length))];
for (const [busy, what] of [[0, "a page with nothing else to do"], [SLOW, `a page that takes ${SLOW} ms more for each frame`]]) {
  const all = Object.fromEntries(WAYS.map(([way]) => [way, []]));
  const rates = Object.fromEntries(WAYS.map(([way]) => [way, []]));
  for (let round = 0; round < ROUNDS; round++) {
    // Each way has been each of the first, the second and the third.
    for (let k = 0; k < WAYS.length; k++) {
      const [way] = WAYS[(k + round) % WAYS.length];
      const came = await page.evaluate(draw, { way, count: FRAMES, busy });
      // The first ones begin the connection.
      all[way].push(...came.all.slice(5));
      rates[way].push(came.perSecond);
    }
  }
  console.log(`${what}:`);
  for (const [way, name] of WAYS) {
    const ms = (share) => at(all[way], share).toFixed(1);
    console.log(`  ${name}: median ${ms(0.5)} ms, 95 % ${ms(0.95)} ms, 99 % ${ms(0.99)} ms, of ${all[way].length}, ${at(rates[way], 0.5).toFixed(1)} per second`);
  }
}
console.log(`load after: ${loadavg()[0].toFixed(1)}`);
await browser.close();
endRelay();
await end();
process.exit(0);
