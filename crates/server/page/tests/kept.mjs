// What is kept, as people look through it: very many views, visits beside each other, pictures of one's own.
import { strict as assert } from "node:assert";
import { copyFileSync, mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { view } from "../mock/picture.mjs";
import { run, serve } from "./served.mjs";
import { anna, idle, LONG, opened, shoot, SIZES, until, wellFormed } from "./steps.mjs";

/** More than one answer holds, and than one page shows. */
const MANY = 620;

/** Views that share one picture; the oldest two are called otherwise. */
async function manyViews() {
  const folder = mkdtempSync(join(tmpdir(), "scopeservo-"));
  await run(folder, "init", "--twin");
  await run(folder, "target", "save", "seed", "--slide", "17B", "--note", "near the vessel");
  await run(folder, "library", "export", "plain");
  rmSync(join(folder, "scopeservo-data"), { recursive: true });
  const targets = join(folder, "scopeservo-data", "targets");
  mkdirSync(targets, { recursive: true });
  const name = (k) => (k < 2 ? `needle-${k + 1}` : `view-${String(k).padStart(3, "0")}`);
  // As an earlier version kept them: taken in when the library is opened.
  for (let k = 0; k < MANY; k++) {
    for (const ending of ["target", "png"]) copyFileSync(join(folder, "plain", "targets", `seed.${ending}`), join(targets, `${name(k)}.${ending}`));
  }
  return folder;
}

export async function manyTargets(browser) {
  const folder = await manyViews();
  const { link, end } = await serve(folder);
  const page = await anna(browser, link);
  await page.getByRole("button", { name: "Targets" }).click();
  const cards = page.locator(".contact article.target");
  const shown = (count) => page.waitForFunction((n) => document.querySelectorAll(".contact article.target").length === n, count, LONG);
  await shown(100);
  await page.getByText("100 are shown").waitFor();
  await shoot(page, "desk", "many");
  await wellFormed(page, "many");
  // As one scrolls, more come; and by the keyboard.
  await page.getByRole("button", { name: "Show more" }).scrollIntoViewIfNeeded();
  await shown(200);
  await page.evaluate(() => window.scrollTo(0, 0));
  const more = page.getByRole("button", { name: "Show more" });
  for (let count = 200; count < MANY; ) {
    await more.press("Enter");
    await page.waitForFunction((n) => document.querySelectorAll(".contact article.target").length > n, count, LONG);
    count = await cards.count();
  }
  assert.equal(await cards.count(), MANY);
  assert.equal(await more.count(), 0, "nothing more is offered when all are there");
  const names = await page.locator(".contact h2").allTextContents();
  assert.equal(new Set(names).size, MANY, "each is shown once");
  // What is looked for is found wherever it is.
  await page.getByPlaceholder("search").fill("needle");
  await shown(2);
  await page.getByPlaceholder("search").fill("needle-1");
  await shown(1);
  await shoot(page, "desk", "found");
  await page.getByPlaceholder("search").fill("nobody");
  await page.getByText("None is like that.").waitFor();
  await page.getByPlaceholder("search").fill("");
  await page.getByLabel("quality").selectOption("unknown");
  await page.getByText("None is like that.").waitFor();
  await page.getByLabel("quality").selectOption("");
  await shown(100);
  // One that is none of the newest is chosen, and stays chosen.
  await page.getByPlaceholder("search").fill("needle-2");
  await shown(1);
  await page.getByRole("button", { name: "open needle-2" }).click();
  await page.getByRole("button", { name: "Choose" }).click();
  await page.getByRole("button", { name: /^Go back.*needle-2/ }).waitFor();
  await page.keyboard.press("Escape");
  await page.getByRole("button", { name: "Live" }).click();
  await page.getByRole("button", { name: /^9 µm (nearer|away)/ }).first().click();
  await until(page, (s) => s.jobs.length > 0 && s.jobs[0].state.state === "ended", "the step has not ended");
  await page.getByRole("button", { name: /^Go back.*needle-2/ }).waitFor();
  await page.setViewportSize({ width: SIZES.phone.width, height: SIZES.phone.height });
  await page.getByRole("button", { name: "Targets" }).click();
  await shown(100);
  await shoot(page, "phone", "many");
  await wellFormed(page, "phone: many");
  await page.context().close();
  await end();
  rmSync(folder, { recursive: true });
}

/** Back to a view once more; then what was seen then and before, beside each other. */
export async function visits(browser, link) {
  const { page, wrong, end } = await opened(browser, link, SIZES.desk);
  await page.getByRole("button", { name: /^Take the slide out/ }).click();
  await page.getByRole("button", { name: /^Go back/ }).click();
  await page.getByRole("heading", { name: /^Arrived/ }).waitFor(LONG);
  await page.getByRole("button", { name: "Targets" }).click();
  await page.getByRole("button", { name: /^open / }).first().click();
  const beside = page.getByRole("region", { name: "Two visits beside each other" });
  await beside.waitFor();
  const pictures = () => beside.locator("img").evaluateAll((all) => all.map((img) => [img.src.split("/").at(-1), img.complete && img.naturalWidth]));
  const loaded = (names) =>
    page.waitForFunction(
      (wanted) => {
        const all = [...document.querySelectorAll(".compare img")].map((img) => (img.complete && img.naturalWidth > 0 ? img.src.split("/").at(-1) : null));
        return JSON.stringify(all.sort()) === JSON.stringify(wanted.sort());
      },
      names,
      LONG,
    );
  await loaded(["arrival.jpg", "image.png"]);
  const options = await beside.getByLabel("right").locator("option").count();
  assert.ok(options >= 3, `the saved view and two visits at least: ${options}`);
  await shoot(page, "desk", "visits");
  await wellFormed(page, "visits");
  await beside.getByLabel("left").selectOption({ index: 2 });
  await loaded(["arrival.jpg", "arrival.jpg"]);
  await beside.getByRole("slider").fill("20");
  await shoot(page, "desk", "two-visits");
  assert.equal((await pictures()).length, 2);
  await page.setViewportSize({ width: SIZES.phone.width, height: SIZES.phone.height });
  await shoot(page, "phone", "visits");
  assert.deepEqual(wrong, []);
  await end();
}

/** A picture of one's own under the demonstration's microscope, and its own slide again. */
export async function ownPicture(browser, link) {
  const { page, wrong, end } = await opened(browser, link, SIZES.desk);
  const folder = mkdtempSync(join(tmpdir(), "scopeservo-"));
  const file = join(folder, "my gland (2).png");
  writeFileSync(file, view({ x_um: 0, y_um: 0, umPerPx: 0.5, width: 1600, height: 1200 }));
  await idle(page);
  await page.getByRole("button", { name: /^Another slide/ }).click();
  const dialog = page.getByRole("dialog", { name: "Another slide" });
  await dialog.getByText("lies there").waitFor();
  await dialog.getByLabel("a picture of your own").setInputFiles(file);
  await shoot(page, "desk", "picture");
  await wellFormed(page, "picture");
  await dialog.getByRole("button", { name: "Use it as the slide" }).click();
  await until(page, (s) => s.demo.picture === "my-gland-2", "the picture does not lie there");
  const own = dialog.getByRole("listitem").filter({ hasText: "1600 × 1200 pixels" });
  await own.getByText("lies there").waitFor();
  assert.equal(await dialog.getByRole("button", { name: "Remove" }).count(), 0, "what lies there is not removed");
  await shoot(page, "desk", "pictures");
  // What is no picture says so, and stays said.
  const text = join(folder, "words.png");
  writeFileSync(text, "no picture");
  await dialog.getByLabel("a picture of your own").setInputFiles(text);
  await dialog.getByRole("button", { name: "Use it as the slide" }).click();
  await dialog.getByRole("button", { name: "Close" }).click();
  await page.getByRole("alert").waitFor(LONG);
  await page.getByRole("button", { name: "Understood" }).click();
  await page.waitForTimeout(500);
  await shoot(page, "desk", "own-slide");
  await page.setViewportSize({ width: SIZES.phone.width, height: SIZES.phone.height });
  await shoot(page, "phone", "own-slide");
  await page.getByRole("button", { name: /^Another slide/ }).click();
  await dialog.getByText("lies there").waitFor();
  await shoot(page, "phone", "pictures");
  await wellFormed(page, "phone: pictures");
  await dialog.getByRole("button", { name: "Lay it there" }).first().click();
  await until(page, (s) => s.demo.picture === null, "the tissue is not back");
  await dialog.getByRole("button", { name: "Remove" }).click();
  await page.waitForFunction(() => !document.querySelector("dialog")?.textContent.includes("my-gland-2"), null, LONG);
  assert.deepEqual(wrong.filter((said) => !/400/.test(said)), []);
  await end();
  rmSync(folder, { recursive: true });
}
