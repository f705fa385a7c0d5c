// The page on an instrument of others: Micro-Manager's simulated beads, by way of their Python packages. Without those it is left out, with a word.
import { strict as assert } from "node:assert";
import { spawn } from "node:child_process";
import { createServer } from "node:net";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { serve } from "./served.mjs";
import { anna, idle, LONG, shoot, SIZES, state, until, wellFormed } from "./steps.mjs";

/** A port that nobody listens on. */
function freePort() {
  return new Promise((resolve) => {
    const server = createServer().listen(0, "127.0.0.1", () => {
      const { port } = server.address();
      server.close(() => resolve(port));
    });
  });
}

/** Their microscope, as a driver at an address. */
async function beads(python, folder) {
  const address = `127.0.0.1:${await freePort()}`;
  const args = ["-m", "scopeservo_driver.pymmcore", "--demo", "beads", "--listen", address];
  const child = spawn(python, args, { cwd: folder, stdio: ["ignore", "ignore", "pipe"] });
  process.on("exit", () => child.kill());
  return new Promise((resolve, reject) => {
    let said = "";
    child.stderr.on("data", (bytes) => {
      said += bytes;
      if (/listen/.test(said)) resolve({ address, end: () => child.kill() });
    });
    child.on("exit", (code) => reject(new Error(`the driver ended with ${code}: ${said}`)));
  });
}

export async function onBeads(browser) {
  const python = process.env.SCOPESERVO_PYTHON;
  if (!python) {
    console.log("left out: Micro-Manager's beads (SCOPESERVO_PYTHON names no Python with their packages)");
    return;
  }
  const folder = mkdtempSync(join(tmpdir(), "scopeservo-"));
  const them = await beads(python, folder);
  const text = `name = "beads"\n[drivers.them]\ntcp = "${them.address}"\n[devices]\nstage = "them"\ncamera = "them"\nnosepiece = "them"\n`;
  writeFileSync(join(folder, "scopeservo.toml"), text);
  const { link, end } = await serve(folder);
  const page = await anna(browser, link);
  await shoot(page, "desk", "beads");
  await wellFormed(page, "beads");
  // What ended is shown a moment later, and only then keys and presses count.
  const shown = async () => {
    await idle(page);
    await page.locator("button.verb:enabled", { hasText: "Save" }).waitFor();
    await page.locator(".paper:not(.watched)").waitFor();
  };
  const done = async (kind) => {
    await until(page, (s) => s.jobs[0]?.kind === kind && s.jobs[0].state.state === "ended", `${kind} has not ended`);
    const job = await page.evaluate((id) => fetch(`api/v1/jobs/${id}`).then((answer) => answer.json()), (await state(page)).jobs[0].id);
    assert.equal(job.error, null, JSON.stringify(job.error));
    await shown();
    return job;
  };
  // Their devices are simulated and say so; and what this stage cannot do is not offered.
  await page.getByText("simulated", { exact: true }).waitFor();
  assert.equal(await page.getByRole("button", { name: /^turn / }).count(), 0, "it cannot turn");
  // A look around by hand, and into focus.
  // Not far: the beads have an end, and this stage is quick.
  const held = async (key) => {
    const from = (await state(page)).at;
    await page.keyboard.down(key);
    await until(page, ({ at }) => Math.hypot(at.x_um - from.x_um, at.y_um - from.y_um) > 3, `${key} moved nothing`);
    await page.keyboard.up(key);
    await shown();
  };
  await held("ArrowRight");
  await held("ArrowLeft");
  await page.getByRole("button", { name: /^Focus/ }).click();
  await done("focus");
  await shoot(page, "desk", "beads-focus");
  const z = (await state(page)).at.z_um;
  assert.ok(Math.abs(z) < 1.5, `the beads lie at z = 0: ${z}`);
  await page.getByRole("button", { name: "Calibrate" }).click();
  const made = await done("calibrate");
  const um = made.answer.made[0].calibration;
  assert.ok(um, JSON.stringify(made.answer));
  await shoot(page, "desk", "beads-calibrated");
  // Saved, moved away by a click in the view, and back.
  await page.keyboard.press("s");
  await page.getByRole("dialog", { name: "Save this view" }).waitFor();
  await page.keyboard.press("Enter");
  await done("save_target");
  const saved = (await state(page)).at;
  const paper = await page.locator(".paper").boundingBox();
  await page.mouse.click(paper.x + paper.width * 0.72, paper.y + paper.height * 0.4);
  await done("centre");
  const away = (await state(page)).at;
  assert.ok(Math.hypot(away.x_um - saved.x_um, away.y_um - saved.y_um) > 30, "the click did not move away");
  await page.getByRole("button", { name: /^Go back/ }).click();
  await page.getByRole("heading", { name: /^Arrived/ }).waitFor({ timeout: 120_000 });
  await shoot(page, "desk", "beads-arrived");
  const back = (await state(page)).at;
  const off = Math.hypot(back.x_um - saved.x_um, back.y_um - saved.y_um);
  assert.ok(off < 2, `${off} um away`);
  await page.getByRole("button", { name: "Before and after" }).click();
  await page.locator(".compare").waitFor();
  await shoot(page, "desk", "beads-compared");
  await page.setViewportSize({ width: SIZES.phone.width, height: SIZES.phone.height });
  await shoot(page, "phone", "beads-arrived");
  await wellFormed(page, "phone: beads");
  await page.context().close();
  console.log(`beads: back within ${off.toFixed(2)} um, as the stage says`);
  await end();
  them.end();
  rmSync(folder, { recursive: true });
}
