// How long a frame takes from the camera to a canvas, and a stop to the devices, in a real browser on this computer. A measurement, no test.
//   SCOPESERVO=target/release/scopeservo node tests/latency.mjs
import { serve } from "./served.mjs";
import { chromium } from "playwright-core";

const FRAMES = 300;
const STOPS = 100;

const { link, end } = await serve();
const executablePath = process.env.SCOPESERVO_CHROMIUM ?? "/usr/bin/chromium";
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage();
await page.goto(link);
await page.locator(".paper[data-seq]").waitFor();
// The page itself goes away, so that what is measured is one connection.
await page.goto(link.replace(/#.*/, "app.css"));
// The demonstration is calibrated meanwhile.
await page.waitForTimeout(12_000);

const frames = await page.evaluate(
  (count) =>
    new Promise((resolve) => {
      const canvas = document.createElement("canvas");
      const pen = canvas.getContext("2d");
      const all = [];
      const socket = new WebSocket(new URL("api/v1/live", location.href.replace("http", "ws")));
      socket.binaryType = "arraybuffer";
      socket.onopen = () => socket.send('{"type":"watch","fps":30}');
      let first = 0;
      socket.onmessage = async ({ data }) => {
        if (typeof data === "string") return;
        const length = new DataView(data).getUint32(0, true);
        const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
        const picture = await createImageBitmap(new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" }));
        canvas.width = picture.width;
        canvas.height = picture.height;
        pen.drawImage(picture, 0, 0);
        const now = performance.timeOrigin + performance.now();
        first ||= now;
        all.push({ drawn: now - head.sent_ms + head.age_ms, encoded: head.age_ms });
        socket.send(JSON.stringify({ type: "ack", seq: head.seq }));
        if (all.length === count) {
          socket.close();
          resolve({ all, perSecond: (count - 1) / ((now - first) / 1000) });
        }
      };
    }),
  FRAMES,
);

const stops = await page.evaluate(async (count) => {
  const ask = (path, body) => fetch(new URL(`api/v1/${path}`, location.href), { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) });
  const idle = async () => {
    for (;;) {
      const jobs = await (await fetch(new URL("api/v1/jobs", location.href))).json();
      if (jobs.every((job) => job.state.state === "ended")) return;
      await new Promise((go) => setTimeout(go, 10));
    }
  };
  const all = [];
  for (let k = 0; k < count; k++) {
    await ask("jobs", { job: "move", to: { x_um: k % 2 ? 4000 : -4000 } });
    await new Promise((go) => setTimeout(go, 60));
    const since = performance.now();
    await ask("stop", {});
    all.push(performance.now() - since);
    await idle();
  }
  return all;
}, STOPS);

const at = (values, share) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(share * values.length))];
const say = (what, values) => console.log(`${what}: median ${at(values, 0.5).toFixed(1)} ms, 95 % ${at(values, 0.95).toFixed(1)} ms, 99 % ${at(values, 0.99).toFixed(1)} ms, of ${values.length}`);
say("from the camera to the canvas", frames.all.map((f) => f.drawn));
say("of that until it is sent", frames.all.map((f) => f.encoded));
console.log(`frames per second: ${frames.perSecond.toFixed(1)}`);
say("a stop, until the devices have it and the browser knows", stops);
await browser.close();
await end();
process.exit(0);
