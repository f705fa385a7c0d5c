// The simulated microscope, served by the program: its link, and how it ends.
import { spawn } from "node:child_process";

const program = process.env.SCOPESERVO ?? "scopeservo";

/** The demonstration; or the instrument that is described in a folder. */
export function serve(folder) {
  const what = folder ? [] : ["--demo"];
  const child = spawn(program, ["serve", ...what, "--listen", "127.0.0.1:0"], { cwd: folder, stdio: ["ignore", "pipe", "inherit"] });
  process.on("exit", () => child.kill());
  return new Promise((resolve, reject) => {
    let said = "";
    child.stdout.on("data", (bytes) => {
      said += bytes;
      const link = /open (\S+)/.exec(said);
      if (link) resolve({ link: link[1], end: () => new Promise((ended) => (child.on("exit", ended), child.kill("SIGINT"))) });
    });
    child.on("exit", (code) => reject(new Error(`the program ended with ${code}`)));
  });
}

/** Does a command of the program in a folder. */
export function run(folder, ...args) {
  const child = spawn(program, args, { cwd: folder, stdio: "ignore" });
  return new Promise((resolve, reject) => child.on("exit", (code) => (code === 0 ? resolve() : reject(new Error(`${args}: ${code}`)))));
}
