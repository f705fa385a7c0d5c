// The page as people use it, in a real browser, on the simulated microscope that the program serves.
//   SCOPESERVO=target/release/scopeservo [SCOPESERVO_CHROMIUM=/usr/bin/chromium] [SCREENSHOTS=folder] [BUILT=built] [SCOPESERVO_PYTHON=python] npm run walk
// BUILT: the page of that folder, instead of the one that the program was built with.
import { strict as assert } from "node:assert";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { chromium } from "playwright-core";
import { onBeads } from "./beads.mjs";
import { manyTargets, ownPicture, visits } from "./kept.mjs";
import { run, serve } from "./served.mjs";
import { anna as first, idle, LONG, opened, person, shoot, SIZES, state, until, wellFormed } from "./steps.mjs";

/** A first save and return: so many presses of the pointer or of Enter. */
async function saveAndReturn(page, size) {
  let clicks = 0;
  const click = async (name) => {
    await page.getByRole("button", { name }).click();
    clicks += 1;
  };
  await click(/^Save this view/);
  await page.getByRole("dialog", { name: "Save this view" }).waitFor();
  await shoot(page, size, "saving");
  await page.keyboard.press("Enter");
  clicks += 1;
  await page.getByRole("heading", { name: /^Done/ }).waitFor(LONG);
  await shoot(page, size, "saved");
  await click(/^Take the slide out/);
  await until(page, (s) => s.demo.slide === "moved", "the slide was not moved");
  await click(/^Go back/);
  await page.getByText(/away, .*turned/).waitFor(LONG);
  await shoot(page, size, "running");
  await page.getByRole("heading", { name: /^Arrived/ }).waitFor(LONG);
  await shoot(page, size, "arrived");
  assert.ok(clicks <= 5, `${clicks} clicks`);
  console.log(`${size}: ${clicks} clicks for a first save and return`);
  await page.getByRole("button", { name: "Before and after" }).click();
  await page.locator(".compare").waitFor();
  await wellFormed(page, `${size}: arrived`);
  await shoot(page, size, "compared");
}

async function atDesk(browser, link) {
  const { page, wrong, end } = await opened(browser, link, SIZES.desk);
  await shoot(page, "desk", "live");
  await wellFormed(page, "live");
  await page.getByText("simulated", { exact: true }).waitFor();
  // The objective, by its key; then all of a first visit.
  await page.keyboard.press("3");
  await until(page, (s) => s.objective === "40x", "the objective did not change");
  await idle(page);
  await saveAndReturn(page, "desk");
  await page.getByRole("button", { name: "Close" }).click();
  // Held by a key: the stage moves, and stands when the key is let go; a second time it is stopped by Escape.
  const before = (await state(page)).at;
  await page.keyboard.down("ArrowRight");
  await until(page, ({ at }) => Math.hypot(at.x_um - before.x_um, at.y_um - before.y_um) > 5, "the key moved nothing");
  await page.keyboard.up("ArrowRight");
  await idle(page);
  await page.keyboard.down("ArrowLeft");
  await page.waitForTimeout(400);
  await page.keyboard.press("Escape");
  await page.keyboard.up("ArrowLeft");
  await idle(page);
  // A click centres: what was there is in the middle then, so that the same place moves no more by a second click in the middle.
  const paper = await page.locator(".paper").boundingBox();
  await page.mouse.click(paper.x + paper.width / 2 + 60, paper.y + paper.height / 2);
  await until(page, (s) => s.jobs[0].kind === "centre" && s.jobs[0].state.state === "ended", "the click did not centre");
  await page.getByRole("button", { name: "Targets" }).click();
  await page.getByRole("button", { name: /^open / }).waitFor();
  await shoot(page, "desk", "targets");
  await wellFormed(page, "targets");
  await page.getByRole("button", { name: /^open / }).click();
  await page.getByRole("heading", { name: "Visits" }).waitFor();
  await shoot(page, "desk", "target");
  await page.getByRole("button", { name: "Close" }).click();
  await page.keyboard.press("r");
  await page.getByRole("heading", { name: "Runs" }).waitFor();
  await shoot(page, "desk", "runs");
  await wellFormed(page, "runs");
  await page.keyboard.press("?");
  await shoot(page, "desk", "keys");
  await page.getByRole("button", { name: "Close" }).click();
  await page.getByRole("button", { name: "People" }).click();
  await page.getByRole("heading", { name: "People" }).waitFor();
  await shoot(page, "desk", "people");
  await wellFormed(page, "people");
  // What is refused says why and stays.
  await page.evaluate(() => fetch("api/v1/jobs", { method: "POST", headers: { "content-type": "application/json" }, body: '{"job":"move","to":{"x_um":99999}}' }));
  await page.getByRole("alert").waitFor(LONG);
  await page.keyboard.press("l");
  await shoot(page, "desk", "refused");
  await page.getByRole("button", { name: "Understood" }).click();
  assert.equal(await page.getByRole("alert").count(), 0);
  assert.deepEqual(wrong, []);
  await end();
}

async function onPhone(browser, link) {
  const { page, wrong, end } = await opened(browser, link, SIZES.phone);
  await shoot(page, "phone", "live");
  const stop = await page.getByRole("button", { name: /^Stop/ }).boundingBox();
  assert.ok(stop.height >= 48 && stop.y + stop.height <= SIZES.phone.height, "Stop is out of reach");
  await page.getByRole("button", { name: "Controls" }).click();
  await shoot(page, "phone", "controls");
  await wellFormed(page, "phone: controls");
  await page.getByRole("button", { name: "Hide controls" }).click();
  await page.getByRole("button", { name: /^Go back/ }).click();
  await page.getByRole("heading", { name: /^Arrived/ }).waitFor(LONG);
  await shoot(page, "phone", "arrived");
  await page.getByRole("button", { name: "Targets" }).click();
  await shoot(page, "phone", "targets");
  await wellFormed(page, "phone: targets");
  assert.deepEqual(wrong, []);
  await end();
}

async function others(browser, link, end) {
  // Light, and with more contrast.
  const light = await opened(browser, link, SIZES.desk);
  await light.page.getByRole("button", { name: /^you are/ }).click();
  await light.page.getByLabel("Colours").selectOption("light");
  await light.page.getByRole("dialog").getByRole("button", { name: "Close" }).click();
  await shoot(light.page, "desk", "light");
  await wellFormed(light.page, "light");
  await light.end();
  const contrast = await opened(browser, link, SIZES.desk, { contrast: "more" });
  await shoot(contrast.page, "desk", "contrast");
  await contrast.end();
  const stranger = await browser.newContext({ viewport: SIZES.desk });
  const page = await stranger.newPage();
  await page.goto(link.replace(/#.*/, ""));
  await page.getByRole("button", { name: "Log in" }).waitFor();
  await shoot(page, "desk", "login");
  await wellFormed(page, "login");
  await stranger.close();
  // The program ends while somebody looks.
  const lost = await opened(browser, link, SIZES.desk);
  await end();
  await lost.page.getByText(/^Connection lost/).waitFor(LONG);
  await lost.page.getByText(/^not live/).waitFor(LONG);
  await lost.page.waitForTimeout(2500);
  await shoot(lost.page, "desk", "lost");
  await lost.end();
}

/** An instrument of one's own: the first user, another one who may only look, and one who drives. */
async function withPeople(browser) {
  const folder = mkdtempSync(join(tmpdir(), "scopeservo-"));
  await run(folder, "init", "--twin");
  const { link, end } = await serve(folder);
  const anna = await first(browser, link);
  await anna.getByRole("button", { name: "People" }).click();
  const users = anna.locator("section", { has: anna.getByRole("heading", { name: "Users" }) });
  await users.getByPlaceholder("name").fill("vera");
  await users.getByPlaceholder("password").fill("long enough");
  await users.getByRole("button", { name: "Add" }).click();
  await users.getByText("vera").waitFor();
  await shoot(anna, "desk", "users");
  // Whoever may look sees all of it, and no button that would be refused; stopping is everybody's.
  const vera = await person(browser, link.replace(/#.*/, ""));
  await vera.getByLabel("Name").fill("vera");
  await vera.getByLabel("Password").fill("a wrong one");
  await vera.getByRole("button", { name: "Log in" }).click();
  await vera.getByRole("alert").waitFor();
  await vera.getByLabel("Password").fill("long enough");
  await vera.getByRole("button", { name: "Log in" }).click();
  await vera.locator(".paper[data-seq]").waitFor(LONG);
  for (const name of [/^Save this view/, /^Go back/, /^Focus/, "Calibrate", /^up/, "People"]) {
    assert.equal(await vera.getByRole("button", { name }).count(), 0, `a viewer sees ${name}`);
  }
  await anna.keyboard.press("l");
  await anna.getByRole("button", { name: "9 µm nearer" }).click();
  await vera.getByText("anna drives").waitFor();
  await shoot(vera, "desk", "viewer");
  await wellFormed(vera, "viewer");
  await vera.getByRole("button", { name: /^Stop/ }).click();
  await vera.keyboard.press("s");
  assert.equal(await vera.getByRole("dialog").count(), 0);
  await end();
  rmSync(folder, { recursive: true });
}

const executablePath = process.env.SCOPESERVO_CHROMIUM ?? "/usr/bin/chromium";
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
// One of them: npm run walk -- beads.
const only = process.argv[2];
const ALONE = { many: manyTargets, beads: onBeads, people: withPeople };
try {
  if (only) {
    await ALONE[only](browser);
    process.exit(0);
  }
  const { link, end } = await serve();
  await atDesk(browser, link);
  await onPhone(browser, link);
  await visits(browser, link);
  await ownPicture(browser, link);
  await others(browser, link, end);
  await withPeople(browser);
  await manyTargets(browser);
  await onBeads(browser);
  console.log("all of it works");
} finally {
  await browser.close();
}
process.exit(0);
