// The frames of a served microscope, passed on by one relay in three ways: as the server sends them, as base64 in JSON, and as MJPEG. So what is
// measured is the way, and nothing else: the same camera, the same JPEG, one more hop for each.
import { createServer } from "node:http";
import { WebSocket, WebSocketServer } from "ws";

/** Takes frames as fast as they come, and gives them to whoever is connected. */
export async function relay(address, cookie) {
  const ears = new Set();
  const source = new WebSocket(`${address.replace("http", "ws")}/api/v1/live`, { headers: { cookie } });
  source.on("open", () => source.send('{"type":"watch","fps":30}'));
  source.on("message", (data, isBinary) => {
    if (!isBinary) return;
    const length = data.readUInt32LE(0);
    const head = JSON.parse(data.subarray(4, 4 + length));
    source.send(JSON.stringify({ type: "ack", seq: head.seq }));
    // When it was grabbed, by the clock that browsers have, too.
    const frame = { seq: head.seq, grabbed: head.sent_ms - head.age_ms, jpeg: data.subarray(4 + length) };
    for (const ear of ears) ear(frame);
  });
  await new Promise((open) => source.on("open", open));

  const listen = (ear, gone) => (ears.add(ear), gone.on("close", () => ears.delete(ear)));
  const headed = ({ seq, grabbed, jpeg }) => {
    const head = Buffer.from(JSON.stringify({ seq, grabbed }));
    const length = Buffer.alloc(4);
    length.writeUInt32LE(head.length);
    return Buffer.concat([length, head, jpeg]);
  };
  const server = createServer((request, response) => {
    if (request.url !== "/mjpeg") return void response.writeHead(200, { "content-type": "text/html" }).end("<!doctype html><title>relay</title>");
    response.writeHead(200, { "content-type": "multipart/x-mixed-replace; boundary=frame" });
    listen(({ seq, grabbed, jpeg }) => {
      response.write(`--frame\r\ncontent-type: image/jpeg\r\ncontent-length: ${jpeg.length}\r\nx-seq: ${seq}\r\nx-grabbed: ${grabbed}\r\n\r\n`);
      response.write(jpeg);
      response.write("\r\n");
    }, response);
  });
  const sockets = new WebSocketServer({ server });
  sockets.on("connection", (socket, request) => {
    if (request.url === "/json") return void listen(({ seq, grabbed, jpeg }) => socket.send(JSON.stringify({ seq, grabbed, image: jpeg.toString("base64") })), socket);
    // One place: the newest goes when the last was drawn.
    let [waits, isDrawn] = [null, true];
    const next = () => {
      if (!isDrawn || !waits) return;
      socket.send(headed(waits));
      [waits, isDrawn] = [null, false];
    };
    socket.on("message", () => ((isDrawn = true), next()));
    listen((frame) => ((waits = frame), next()), socket);
  });
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  return { url: `http://127.0.0.1:${server.address().port}/`, end: () => (source.close(), server.closeAllConnections(), server.close()) };
}

/** In the browser: so many frames by one way onto a canvas, how long each took from the camera, ms. `busy`: what else the page does with each, ms. */
export function draw({ way, count, busy }) {
  return new Promise((resolve, reject) => {
    const canvas = document.createElement("canvas");
    const pen = canvas.getContext("2d");
    const [all, took] = [[], () => performance.timeOrigin + performance.now()];
    let first = 0;
    const drawn = (picture, grabbed) => {
      canvas.width = picture.width;
      canvas.height = picture.height;
      pen.drawImage(picture, 0, 0);
      const now = took();
      first ||= now;
      all.push(now - grabbed);
      for (const until = performance.now() + busy; performance.now() < until; );
      return all.length >= count;
    };
    const end = () => resolve({ all, perSecond: (all.length - 1) / ((took() - first) / 1000) });
    const fromJpeg = (bytes) => createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
    if (way === "mjpeg") {
      const gone = new AbortController();
      const read = async () => {
        const reader = (await fetch("/mjpeg", { signal: gone.signal })).body.getReader();
        let rest = new Uint8Array(0);
        for (;;) {
          const { value } = await reader.read();
          const grown = new Uint8Array(rest.length + value.length);
          grown.set(rest);
          grown.set(value, rest.length);
          rest = grown;
          for (;;) {
            const text = new TextDecoder("latin1").decode(rest.subarray(0, 300));
            const head = text.indexOf("\r\n\r\n");
            if (head < 0) break;
            const number = (name) => Number(new RegExp(`${name}: ([0-9.]+)`).exec(text)[1]);
            const length = number("content-length");
            if (rest.length < head + 6 + length) break;
            const picture = await fromJpeg(rest.slice(head + 4, head + 4 + length));
            rest = rest.slice(head + 6 + length);
            if (drawn(picture, number("x-grabbed"))) return gone.abort(), end();
          }
        }
      };
      return void read().catch(reject);
    }
    const socket = new WebSocket(new URL(way, location.href.replace("http", "ws")));
    socket.binaryType = "arraybuffer";
    let before = Promise.resolve();
    const over = () => {
      socket.onmessage = null;
      socket.close();
      end();
    };
    if (way === "json") {
      // One after the other, as they came.
      const one = async (data) => {
        const { grabbed, image } = JSON.parse(data);
        const picture = new Image();
        picture.src = `data:image/jpeg;base64,${image}`;
        await picture.decode();
        if (drawn(picture, grabbed)) over();
      };
      socket.onmessage = ({ data }) => void (before = before.then(() => (all.length < count ? one(data) : null)));
    } else {
      socket.onmessage = async ({ data }) => {
        const length = new DataView(data).getUint32(0, true);
        const { grabbed } = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
        const picture = await fromJpeg(new Uint8Array(data, 4 + length));
        if (drawn(picture, grabbed)) return over();
        socket.send("drawn");
      };
    }
    socket.onerror = reject;
  });
}
