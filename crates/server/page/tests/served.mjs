// The simulated microscope, served by the program: its link, and how it ends.
import { spawn } from "node:child_process";

export function serve() {
  const program = process.env.SCOPESERVO ?? "scopeservo";
  const child = spawn(program, ["serve", "--demo", "--listen", "127.0.0.1:0"], { stdio: ["ignore", "pipe", "inherit"] });
  return new Promise((resolve, reject) => {
    let said = "";
    child.stdout.on("data", (bytes) => {
      said += bytes;
      const link = /open (\S+)/.exec(said);
      if (link) resolve({ link: link[1], end: () => new Promise((ended) => (child.on("exit", ended), child.kill("SIGINT"))) });
    });
    process.on("exit", () => child.kill());
    child.on("exit", (code) => reject(new Error(`the program ended with ${code}`)));
  });
}
