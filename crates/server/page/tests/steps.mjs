// What all walks are made of: pages in a real browser, what they show, and how long one waits for it.
import { strict as assert } from "node:assert";
import { mkdirSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";

const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const shots = process.env.SCREENSHOTS;
if (shots) mkdirSync(shots, { recursive: true });

export const SIZES = { desk: { width: 1400, height: 900 }, phone: { width: 390, height: 844, touch: true } };
export const LONG = { timeout: 60_000 };

export async function shoot(page, size, name) {
  if (shots) await page.screenshot({ path: `${shots}/${size}-${name}.png` });
}

export async function wellFormed(page, where) {
  await page.evaluate(axe);
  const found = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  const serious = found.violations.filter((v) => ["serious", "critical"].includes(v.impact));
  assert.deepEqual(serious.map((v) => [v.id, v.nodes.map((n) => n.html.slice(0, 120))]), [], where);
}

export async function ours(page) {
  if (process.env.BUILT) await page.route(/\/app\.(js|css)$/, (route) => route.fulfill({ path: `${process.env.BUILT}${new URL(route.request().url()).pathname}` }));
}

export async function opened(browser, link, { touch, ...viewport }, more = {}) {
  const context = await browser.newContext({ viewport, hasTouch: Boolean(touch), isMobile: Boolean(touch), ...more });
  const page = await context.newPage();
  page.setDefaultTimeout(20_000);
  const wrong = [];
  page.on("pageerror", (error) => wrong.push(String(error)));
  page.on("console", (message) => message.type() === "error" && !/401|409/.test(message.text()) && wrong.push(message.text()));
  await ours(page);
  await page.goto(link);
  await page.locator(".paper[data-seq]").waitFor(LONG);
  assert.equal(new URL(page.url()).hash, "", "the key stays in no address");
  return { page, wrong, end: () => context.close() };
}

export const state = (page) => page.evaluate(() => fetch("api/v1/state").then((answer) => answer.json()));

export async function until(page, is, what) {
  const since = Date.now();
  for (;;) {
    const now = await state(page);
    if (is(now)) return now;
    assert.ok(Date.now() - since < LONG.timeout, what);
    await page.waitForTimeout(50);
  }
}

export const idle = (page) => until(page, (s) => s.jobs.every((job) => job.state.state === "ended"), "a job goes on");

/** A page of somebody's own, at an instrument that has users. */
export async function person(browser, at, size = SIZES.desk) {
  const { touch, ...viewport } = size;
  const page = await (await browser.newContext({ viewport, hasTouch: Boolean(touch), isMobile: Boolean(touch) })).newPage();
  page.setDefaultTimeout(20_000);
  await ours(page);
  await page.goto(at);
  return page;
}

/** The first user of an instrument. */
export async function anna(browser, link, size) {
  const page = await person(browser, link, size);
  await page.getByText("You are the first one here").waitFor();
  await shoot(page, "desk", "first");
  await wellFormed(page, "first");
  await page.getByLabel("Name").fill("anna");
  await page.getByLabel("Password").fill("long enough");
  await page.getByRole("button", { name: "Begin" }).click();
  await page.locator(".paper[data-seq]").waitFor(LONG);
  return page;
}
