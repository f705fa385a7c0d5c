// A made-up specimen, as grey pictures: cells and fibres that are where they are, wherever one looks from.
// PNG, because Node has zlib; what shows pictures looks at their first bytes, not at their names.
import { crc32, deflateSync } from "node:zlib";

const crc = crc32 ?? ((bytes) => {
  let c = ~0;
  for (const byte of bytes) {
    c ^= byte;
    for (let k = 0; k < 8; k++) c = c & 1 ? (c >>> 1) ^ 0xedb88320 : c >>> 1;
  }
  return ~c >>> 0;
});

function chunk(name, data) {
  const body = Buffer.concat([Buffer.from(name, "latin1"), data]);
  const out = Buffer.alloc(body.length + 8);
  out.writeUInt32BE(data.length, 0);
  body.copy(out, 4);
  out.writeUInt32BE(crc(body) >>> 0, body.length + 4);
  return out;
}

/** Grey levels, row by row, as a file. */
export function png(levels, width, height) {
  const head = Buffer.alloc(13);
  head.writeUInt32BE(width, 0);
  head.writeUInt32BE(height, 4);
  head.set([8, 0, 0, 0, 0], 8);
  const rows = Buffer.alloc((width + 1) * height);
  for (let y = 0; y < height; y++) rows.set(levels.subarray(y * width, (y + 1) * width), y * (width + 1) + 1);
  const signature = Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]);
  return Buffer.concat([signature, chunk("IHDR", head), chunk("IDAT", deflateSync(rows, { level: 1 })), chunk("IEND", Buffer.alloc(0))]);
}

/** How bright the specimen is there, um. */
function level(x, y) {
  const fibre = Math.sin(0.045 * x + 1.7 * Math.sin(0.021 * y)) + 0.6 * Math.sin(0.11 * y - 0.07 * x);
  const [u, v] = [x / 14, y / 14];
  const [i, j] = [Math.round(u), Math.round(v)];
  const odd = Math.abs(Math.sin(i * 127.1 + j * 311.7) * 43758.5453) % 1;
  const cell = odd > 0.45 && Math.hypot(u - i, v - j) < 0.2 + 0.16 * odd ? -70 : 0;
  return Math.max(0, Math.min(255, 165 + 24 * fibre + cell));
}

/** What a camera of that size sees from there; `deg` is how the specimen lies turned. */
export function view({ x_um, y_um, deg = 0, umPerPx, width = 320, height = 240, bright = 1 }) {
  const levels = new Uint8Array(width * height);
  const [c, s] = [Math.cos((deg * Math.PI) / 180) * umPerPx, Math.sin((deg * Math.PI) / 180) * umPerPx];
  for (let v = 0; v < height; v++) {
    for (let u = 0; u < width; u++) {
      const [p, q] = [u - width / 2, v - height / 2];
      levels[v * width + u] = bright * level(x_um + c * p - s * q, y_um + s * p + c * q);
    }
  }
  return png(levels, width, height);
}
