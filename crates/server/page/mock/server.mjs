// Speaks docs/server.md for an instrument that is not there. `node mock/server.mjs [PORT]` serves it to look at.
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { WebSocketServer } from "ws";
import { view } from "./picture.mjs";
import { Refusal, World } from "./world.mjs";

const BUILT = new URL("../built/", import.meta.url);
const KINDS = { html: "text/html; charset=utf-8", js: "text/javascript; charset=utf-8", css: "text/css; charset=utf-8" };
/** Nothing from elsewhere, nothing written into the page: as the program has it. */
const CSP = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; font-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
const FRAME_MS = 80;

/** Routes by method and pattern; what they answer is JSON, or bytes with a kind. */
/** Saved views as they are asked for. */
function found(w, asked) {
  const has = (t, word) => [t.name, t.slide ?? "", t.note ?? ""].some((text) => text.toLowerCase().includes(word));
  const words = (asked.get("text") ?? "").toLowerCase().split(/\s+/).filter(Boolean);
  let all = asked.get("bin") === "true" ? (w.bin ?? []) : w.targets;
  if (asked.get("after_number")) all = all.slice(all.findIndex((t) => t.number === Number(asked.get("after_number"))) + 1);
  if (asked.get("after")) all = all.slice(all.findIndex((t) => t.name === asked.get("after")) + 1);
  all = all.filter((t) => words.every((word) => has(t, word)) && (!asked.get("slide") || t.slide === asked.get("slide")) && (!asked.get("quality") || t.quality?.word === asked.get("quality")));
  return all.slice(0, Number(asked.get("limit") ?? 500));
}

const ROUTES = [
  ["GET", /^me$/, (w) => w.me],
  ["POST", /^login$/, (w, _, body) => {
    if (body.password !== "right horse") throw new Refusal(401, "not_known", "nobody has this name and password", "input");
    w.loggedIn = true;
    if (body.name !== w.me.user) {
      if (w.owner === w.me.user) w.owner = null;
      w.me = { ...w.me, user: body.name };
    }
    return {};
  }],
  ["POST", /^enter$/, () => ({ claim: false })],
  ["POST", /^logout$/, (w) => ((w.loggedIn = false), {})],
  ["GET", /^instrument$/, (w) => w.instrument()],
  ["GET", /^state$/, (w) => w.state()],
  ["POST", /^stop$/, (w) => (w.stop(), { stopped: true })],
  ["POST", /^lease$/, (w) => (w.may("drive"), (w.owner = w.me.user), {})],
  ["POST", /^lease\/ask$/, (w) => ((w.asked_by = w.me.user), {})],
  ["POST", /^lease\/give$/, (w) => ((w.owner = w.asked_by), (w.asked_by = null), {})],
  ["POST", /^exposure$/, (w, _, body) => (w.may("expose"), (w.exposure_ms = body.ms), {})],
  ["POST", /^light$/, (w, _, body) => (w.may("light"), (w.light = body.level), {})],
  ["POST", /^slide$/, (w, _, body) => ((w.slide = body.name), {})],
  ["POST", /^demo$/, (w) => (w.may("move"), (w.demo = "moved"), (w.offset = { x: 38, y: -24, deg: 4.3 }), {})],
  ["POST", /^jobs$/, (w, _, body) => ({ id: w.start(body).id })],
  ["GET", /^jobs\/(\d+)$/, (w, id) => w.jobs.find((job) => job.id === Number(id))],
  ["POST", /^jobs\/(\d+)\/pause$/, (w, id) => ((w.jobs.find((job) => job.id === Number(id)).state = { state: "paused", why: "asked" }), {})],
  ["POST", /^jobs\/(\d+)\/resume$/, (w, id) => ((w.jobs.find((job) => job.id === Number(id)).state = { state: "running" }), {})],
  ["POST", /^questions\/\d+$/, (w) => ((w.question = null), {})],
  ["POST", /^abandon$/, (w) => ((w.left = null), {})],
  ["GET", /^targets$/, (w, _, __, asked) => found(w, asked).map(({ where, ...rest }) => rest)],
  ["GET", /^targets\/([^/]+)$/, (w, name) => w.targets.find((t) => t.name === name)],
  ["GET", /^slides$/, (w) => [...new Set(w.targets.map((t) => t.slide).filter(Boolean))].sort().map((name) => ({ name, targets: w.targets.filter((t) => t.slide === name).length }))],
  ["GET", /^pictures$/, () => []],
  ["GET", /^targets\/([^/]+)\/(?:image\.png|thumb\.jpg)$/, (w, name) => {
    const target = w.targets.find((t) => t.name === name);
    return target && { kind: "image/png", bytes: view(target.where) };
  }],
  ["PATCH", /^targets\/([^/]+)$/, (w, name, { restore, ...to }) => {
    const back = restore && (w.bin ?? []).find((t) => t.name === name);
    if (back) {
      w.bin = w.bin.filter((t) => t !== back);
      const { binned, ...target } = back;
      w.targets.unshift(target);
    }
    Object.assign(w.targets.find((t) => t.name === name), to);
    w.revision++;
    return {};
  }],
  ["DELETE", /^targets\/([^/]+)$/, (w, name) => ((w.bin = [...w.targets.filter((t) => t.name === name).map((t) => ({ ...t, binned: new Date().toISOString() })), ...(w.bin ?? [])]), (w.targets = w.targets.filter((t) => t.name !== name)), w.revision++, {})],
  ["DELETE", /^bin\/([^/]+)$/, (w, name) => ((w.bin = (w.bin ?? []).filter((t) => t.name !== name)), w.revision++, {})],
  ["GET", /^runs$/, (w, _, __, asked) => {
    const before = asked.get("before");
    if (before === w.loses) w.runs = w.runs.filter((run) => run.id !== before);
    if (before && !w.runs.some((run) => run.id === before)) throw new Refusal(404, "no_run", `there is no run '${before}'`, "input");
    const all = w.runs.filter((run) => !asked.get("target") || run.target === asked.get("target"));
    return all.slice(before ? all.findIndex((run) => run.id === before) + 1 : 0).slice(0, Number(asked.get("limit") ?? 50));
  }],
  ["GET", /^runs\/[^/]+\/report\.html$/, () => ({ kind: KINDS.html, bytes: Buffer.from("<!doctype html><title>report</title><p>made up") })],
  ["GET", /^users$/, () => [{ name: "anna", role: "admin" }, { name: "bob", role: "operator" }]],
  ["GET", /^tokens$/, () => []],
  ["GET", /^frame\.jpg$/, (w) => ({ kind: "image/png", bytes: view(w.where()) })],
];

async function read(request) {
  const parts = [];
  for await (const part of request) parts.push(part);
  const text = Buffer.concat(parts).toString();
  return text ? JSON.parse(text) : {};
}

function file(name, response) {
  try {
    const bytes = readFileSync(new URL(name || "index.html", BUILT));
    response.writeHead(200, { "content-type": KINDS[(name || "index.html").split(".").at(-1)], "content-security-policy": CSP });
    response.end(bytes);
  } catch {
    response.writeHead(404).end();
  }
}

async function answer(world, method, path, request) {
  if (!world.loggedIn && !["login", "enter"].includes(path)) throw new Refusal(401, "not_logged_in", "log in first", "input");
  for (const [verb, pattern, act] of ROUTES) {
    const found = verb === method && pattern.exec(path);
    if (!found) continue;
    const body = method === "GET" ? null : await read(request);
    if (method !== "GET") world.asked.push([method, path, body]);
    const asked = new URL(request.url, "http://x").searchParams;
    const told = act(world, found[1] && decodeURIComponent(found[1]), body, asked);
    if (told) return told;
  }
  throw new Refusal(404, "not_found", `there is no ${path}`);
}

function connected(world, socket) {
  let [seq, drawn, watching, sent, last] = [0, true, false, world.records.length, ""];
  const say = (what) => world.silent || socket.send(what);
  say(JSON.stringify({ type: "hello", version: "0.1.0", next: sent }));
  socket.on("message", (text) => {
    const said = JSON.parse(text);
    world.said.push(said);
    try {
      if (said.type === "watch") [watching, drawn] = [said.fps > 0, true];
      else if (said.type === "ack") drawn = true;
      else if (said.type === "jog") world.jog(said);
      else if (said.type === "jog_end") world.jogEnd();
      else if (said.type === "stop") world.stop();
      else if (said.type === "from") sent = Math.min(sent, said.number);
      else if (said.type === "ping") say(JSON.stringify({ type: "pong", n: said.n }));
    } catch (refused) {
      say(JSON.stringify({ type: "refused", code: refused.code, message: refused.message }));
    }
  });
  const beat = setInterval(() => {
    for (; sent < world.records.length; sent++) say(JSON.stringify({ type: "event", record: world.records[sent] }));
    const { time_s, ...state } = world.state();
    const now = JSON.stringify(state) + Math.floor(time_s);
    if (now !== last) say(JSON.stringify({ type: "state", state: { time_s, ...state } }));
    last = now;
    if (!watching || !drawn || !world.frames || world.silent) return;
    drawn = false;
    const head = Buffer.from(JSON.stringify(world.frame(++seq)));
    const length = Buffer.alloc(4);
    length.writeUInt32LE(head.length);
    socket.send(Buffer.concat([length, head, view(world.where())]));
  }, FRAME_MS);
  socket.on("close", () => clearInterval(beat));
}

/** Serves that world, also below /bench/, as behind a proxy. */
export async function serve(world = new World(), port = 0) {
  const server = createServer((request, response) => {
    const path = new URL(request.url, "http://x").pathname.replace(/^\/(bench\/)?/, "");
    if (world.down) return void request.socket.destroy();
    if (!path.startsWith("api/v1/")) return file(path, response);
    answer(world, request.method, path.slice(7), request).then(
      (told) => {
        response.writeHead(request.url.endsWith("/jobs") && request.method === "POST" ? 202 : 200, { "content-type": told.kind && told.bytes ? told.kind : "application/json", "cache-control": "no-store" });
        response.end(told.bytes ?? JSON.stringify(told));
      },
      (error) => {
        const { status = 500, code = "fault", kind = "fault", message } = error;
        response.writeHead(status, { "content-type": "application/json" });
        response.end(JSON.stringify({ code, kind, message }));
      },
    );
  });
  const sockets = new WebSocketServer({ noServer: true });
  let connections = 0;
  server.on("upgrade", (request, socket, head) => {
    if (world.blocked || world.down || !world.loggedIn) return void socket.destroy();
    sockets.handleUpgrade(request, socket, head, (open) => {
      connections += 1;
      connected(world, open);
    });
  });
  await new Promise((done) => server.listen(port, "127.0.0.1", done));
  return {
    world,
    link: `http://127.0.0.1:${server.address().port}/`,
    connections: () => connections,
    cut: () => sockets.clients.forEach((client) => client.terminate()),
    end: () => (sockets.clients.forEach((client) => client.terminate()), server.closeAllConnections(), server.close()),
  };
}

if (process.argv[1] === new URL(import.meta.url).pathname) console.log((await serve(new World(), Number(process.argv[2] ?? 7080))).link);
