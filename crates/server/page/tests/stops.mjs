// How long each way to stop takes while the stage moves, from the press until the driver reads `stop`: the page's button and its key, REST, the WebSocket,
// Ctrl-C at a command that the server does, and Ctrl-C at the server itself. A measurement, no test. All times are of one clock of this computer.
//   SCOPESERVO=target/release/scopeservo node tests/stops.mjs [STOPS]
import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { loadavg, tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";
import { WebSocket } from "ws";
import { anna, person, SIZES } from "./steps.mjs";

const STOPS = Number(process.argv[2] ?? 200);
const program = process.env.SCOPESERVO ?? "scopeservo";
const now = () => Number(process.hrtime.bigint()) / 1e6;
const sleep = (ms) => new Promise((go) => setTimeout(go, ms));

const folder = mkdtempSync(join(tmpdir(), "scopeservo-"));
const log = join(folder, "stops.log");
writeFileSync(log, "");
const driver = fileURLToPath(new URL("stopped_driver.mjs", import.meta.url));
writeFileSync(
  join(folder, "scopeservo.toml"),
  `name = "stopwatch"\n[drivers.watch]\nprogram = ${JSON.stringify([process.execPath, driver, log])}\n[devices]\nstage = "watch"\ncamera = "watch"\nnosepiece = "watch"\n[limits]\nx_um = [-60000, 60000]\ny_um = [-60000, 60000]\n`,
);

/** The server of that folder, with how it is ended by hand. */
async function serve() {
  const child = spawn(program, ["serve", "--listen", "127.0.0.1:0"], { cwd: folder, stdio: ["ignore", "pipe", "inherit"] });
  const leave = () => child.kill("SIGKILL");
  process.on("exit", leave);
  const ended = new Promise((over) => child.on("exit", over)).then(() => process.off("exit", leave));
  const link = await new Promise((resolve, reject) => {
    child.on("exit", (code) => reject(new Error(`the program ended with ${code}`)));
    let said = "";
    child.stdout.on("data", (bytes) => {
      said += bytes;
      const found = /open (\S+)/.exec(said);
      if (found) resolve(found[1]);
    });
  });
  const door = JSON.parse(readFileSync(join(folder, "scopeservo-data/server/door.json")));
  const headers = { "content-type": "application/json", authorization: `Bearer ${door.token}` };
  const ask = async (path, body) => {
    const how = body ? { method: "POST", headers, body: JSON.stringify(body) } : { headers };
    const answer = await fetch(`http://${door.address}/api/v1/${path}`, how);
    const told = await answer.json();
    if (!answer.ok) throw new Error(`${path}: ${told.message}`);
    return told;
  };
  return { child, ended, link, door, ask };
}

const lines = () => readFileSync(log, "utf8").trim().split("\n").map((line) => line.split(" "));
const moves = () => lines().filter(([what]) => what === "move").length;

/** Waits until the driver began one more move. */
async function begun(before) {
  for (const since = now(); moves() <= before; await sleep(3)) if (now() - since > 20_000) throw new Error("nothing moves");
}

/** When the driver heard the first stop after that, and that it moved until then. */
async function heard(since) {
  for (;;) {
    const stop = lines().find(([what, at]) => what === "stop" && Number(at) >= since);
    if (stop) {
      if (stop[2] !== "moving") throw new Error("it stood already");
      return Number(stop[1]) - since;
    }
    if (now() - since > 20_000) throw new Error("no stop came");
    await sleep(3);
  }
}

/** Waits until nothing is under way and no stop comes any more: the page says each by two ways, and the later one is not for the next move. */
async function quiet(server) {
  for (let [count, same] = [lines().length, 0]; same < 8; await sleep(25)) {
    const jobs = await server.ask("jobs");
    const is = lines().length === count && jobs.every((job) => job.state.state === "ended");
    [count, same] = [lines().length, is ? same + 1 : 0];
  }
}

/** So many stops by one way: `press` says when it was pressed. */
async function times(server, press, start) {
  const all = [];
  for (let k = 0; k < STOPS; k++) {
    const before = moves();
    const ends = await (start ?? (({ job }) => server.ask("jobs", job)))({ job: { job: "move", to: { x_um: k % 2 ? 50_000 : -50_000 } }, x: k % 2 ? 50_000 : -50_000 });
    await begun(before);
    // Anywhere within a look of the server at its devices, and of the page at the server.
    await sleep(40 + 137 * ((k * 0.618) % 1));
    const since = now();
    await press(ends);
    all.push(await heard(since));
    await quiet(server);
  }
  return all;
}

const at = (values, share) => [...values].sort((a, b) => a - b)[Math.max(0, Math.ceil(share * values.length) - 1)];
const say = (what, v) => console.log(`| ${what} | ${at(v, 0.5).toFixed(1)} | ${at(v, 0.95).toFixed(1)} | ${at(v, 0.99).toFixed(1)} | ${Math.max(...v).toFixed(1)} | ${v.length} |`);

console.log(`load before: ${loadavg()[0].toFixed(1)}`);
const executablePath = process.env.SCOPESERVO_CHROMIUM ?? "/usr/bin/chromium";
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
let server = await serve();
const page = await anna(browser, server.link);

const button = page.locator("button.verb.stop").first();
const press = async () => page.mouse.up();
say(
  "the page's button",
  await times(
    server,
    press,
    // The pointer lies on it, pressed: what counts is that it is let go.
    async ({ job }) => {
      const { x, y, width, height } = await button.boundingBox();
      await page.mouse.move(x + width / 2, y + height / 2);
      await page.mouse.down();
      return server.ask("jobs", job);
    },
  ),
);
say("Escape on the page", await times(server, () => page.keyboard.press("Escape")));
// Somebody who may only look, in a browser of their own.
await page.evaluate(() =>
  fetch("api/v1/users", { method: "POST", headers: { "content-type": "application/json" }, body: '{"name":"looks","password":"long enough","role":"viewer"}' }),
);
const other = await person(browser, server.link.replace(/#.*/, ""), SIZES.phone);
await other.getByLabel("Name").fill("looks");
await other.getByLabel("Password").fill("long enough");
await other.getByRole("button", { name: "Log in" }).click();
await other.locator(".paper[data-seq]").waitFor();
say("Escape, of a viewer", await times(server, () => other.keyboard.press("Escape")));
say("REST", await times(server, () => server.ask("stop", {})));
const socket = new WebSocket(`ws://${server.door.address}/api/v1/live`, { headers: { authorization: `Bearer ${server.door.token}` } });
await new Promise((open) => socket.on("open", open));
say("WebSocket", await times(server, () => void socket.send('{"type":"stop"}')));
say(
  "Ctrl-C at a command",
  await times(
    server,
    (child) => void child.kill("SIGINT"),
    async ({ x }) => spawn(program, ["stage", "go", "--x-um", String(x)], { cwd: folder, stdio: "ignore" }),
  ),
);
await browser.close();
socket.terminate();
server.child.kill("SIGINT");
await server.ended;

const atTheServer = [];
for (let k = 0; k < STOPS; k++) {
  server = await serve();
  const before = moves();
  await server.ask("jobs", { job: "move", to: { x_um: k % 2 ? 50_000 : -50_000 } });
  await begun(before);
  await sleep(40 + 137 * ((k * 0.618) % 1));
  const since = now();
  server.child.kill("SIGINT");
  atTheServer.push(await heard(since));
  await server.ended;
}
say("Ctrl-C at the server", atTheServer);
console.log("(median, 95 %, 99 %, the longest, ms; how many)");
console.log(`load after: ${loadavg()[0].toFixed(1)}`);
rmSync(folder, { recursive: true });
process.exit(0);
