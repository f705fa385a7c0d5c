// Makes built/ of src/: three files that the program carries. The same sources give the same bytes.
import { build } from "esbuild";
import { gzipSync } from "node:zlib";
import { copyFileSync, mkdirSync, readFileSync } from "node:fs";

mkdirSync("built", { recursive: true });
await build({
  entryPoints: ["src/main.tsx"],
  outfile: "built/app.js",
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  jsx: "automatic",
  jsxImportSource: "preact",
  legalComments: "eof",
  charset: "utf8",
});
await build({ entryPoints: ["src/app.css"], outfile: "built/app.css", minify: true });
copyFileSync("src/index.html", "built/index.html");

const LARGEST = 150_000;
let sum = 0;
for (const name of ["index.html", "app.js", "app.css"]) {
  const bytes = gzipSync(readFileSync(`built/${name}`), { level: 9 }).length;
  console.log(`${name}: ${(bytes / 1000).toFixed(1)} kB, compressed`);
  sum += bytes;
}
console.log(`all: ${(sum / 1000).toFixed(1)} kB of ${LARGEST / 1000}`);
if (sum > LARGEST) process.exit(1);
