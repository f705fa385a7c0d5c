// The servo loop's time for a step, alone and with ten more connections of which one is asleep, in pairs and one run. A measurement, no test.
//   SCOPESERVO=target/release/scopeservo node tests/loop.mjs [PAIRS]
import { loadavg } from "node:os";
import { WebSocket } from "ws";
import { serve } from "./served.mjs";

const PAIRS = Number(process.argv[2] ?? 6);
const MORE = 10;
/** From here it goes back each time: the same way each time. */
const AWAY = { x_um: 31, y_um: -24 };

const { link, end } = await serve();
const address = new URL(link).origin;
let cookie = "";
const ask = async (path, body) => {
  const headers = { "content-type": "application/json", cookie };
  const response = await fetch(`${address}/api/v1/${path}`, body ? { method: "POST", headers, body: JSON.stringify(body) } : { headers });
  if (path === "enter") cookie = response.headers.get("set-cookie").split(";")[0];
  const told = await response.json();
  if (!response.ok) throw new Error(`${path}: ${told.message}`);
  return told;
};
const done = async (job) => {
  const { id } = await ask("jobs", job);
  for (;;) {
    const whole = await ask(`jobs/${id}`);
    if (whole.error) throw new Error(whole.error.message);
    if (whole.state.state === "ended") return whole;
    await new Promise((go) => setTimeout(go, 200));
  }
};

/** Nine that draw at once, and one that never reads. */
function connect() {
  return Array.from({ length: MORE }, (_, k) => {
    const socket = new WebSocket(`${address.replace("http", "ws")}/api/v1/live`, { headers: { cookie } });
    socket.on("open", () => {
      socket.send('{"type":"watch","fps":30}');
      if (k === 0) socket.pause();
    });
    socket.on("message", (data, isBinary) => {
      if (!isBinary) return;
      const { seq } = JSON.parse(data.subarray(4, 4 + data.readUInt32LE(0)));
      socket.send(JSON.stringify({ type: "ack", seq }));
    });
    return socket;
  });
}

/** Goes back once: from the frame to what is known of it, and from one step to the next, ms. */
async function steps() {
  await done({ job: "move", by: AWAY });
  const { run, answer } = await done({ job: "reposition", target: "view" });
  if (answer.verdict !== "arrived") throw new Error(JSON.stringify(answer));
  const events = await ask(`runs/${run}/events`);
  const grabbed = new Map(events.filter((e) => e.event === "frame_grabbed" && e.role === "servo").map((e) => [e.sequence, e.time_s]));
  const iterations = events.filter((e) => e.event === "iteration" && grabbed.has(e.sequence));
  const sum = (values) => values.reduce((a, b) => a + b, 0);
  const seen = iterations.map((e) => 1000 * (e.time_s - grabbed.get(e.sequence)));
  // From one frame to the next of the same objective: with the move between them.
  const next = iterations.slice(1).filter((e, k) => e.objective === iterations[k].objective && e.iteration === iterations[k].iteration + 1);
  const moved = next.map((e) => 1000 * (grabbed.get(e.sequence) - grabbed.get(iterations[iterations.indexOf(e) - 1].sequence)));
  return { seen: sum(seen) / seen.length, step: sum(moved) / moved.length, count: iterations.length };
}

await ask("enter", { key: link.split("#key=")[1] });
// The demonstration is calibrated meanwhile.
await new Promise((go) => setTimeout(go, 20_000));
await done({ job: "objective", objective: "40x" });
await done({ job: "save_target", name: "view", focus: true });
await steps();
console.log(`load before: ${loadavg()[0].toFixed(1)}`);
const pairs = [];
for (let k = 0; k < PAIRS; k++) {
  const pair = {};
  // The one first, then the other.
  for (const how of k % 2 ? ["with", "alone"] : ["alone", "with"]) {
    const sockets = how === "with" ? connect() : [];
    if (how === "with") await new Promise((go) => setTimeout(go, 1000));
    pair[how] = await steps();
    for (const socket of sockets) socket.terminate();
  }
  pairs.push(pair);
  const told = (one) => `${one.seen.toFixed(1)} ms for a frame, ${one.step.toFixed(0)} ms a step, ${one.count} steps`;
  console.log(`pair ${k + 1}: alone ${told(pair.alone)}; with ${MORE} more ${told(pair.with)}`);
}
for (const [what, name] of [["seen", "from the frame to what is known of it"], ["step", "a step with its move"]]) {
  const logs = pairs.map((pair) => Math.log(pair.with[what] / pair.alone[what]));
  const mean = logs.reduce((a, b) => a + b, 0) / logs.length;
  const deviation = Math.sqrt(logs.reduce((a, b) => a + (b - mean) ** 2, 0) / (logs.length - 1));
  const ratios = logs.map(Math.exp).sort((a, b) => a - b);
  console.log(`${name}: ratio ${Math.exp(mean).toFixed(3)}, of the single pairs ${ratios[0].toFixed(3)} to ${ratios.at(-1).toFixed(3)}, standard error ${((100 * deviation) / Math.sqrt(logs.length)).toFixed(1)} %`);
}
console.log(`load after: ${loadavg()[0].toFixed(1)}`);
await end();
process.exit(0);
