// Every state of the page, at a made-up instrument (mock/), at a desk and on a phone: what is shown, and that nothing moves which nobody asks for.
//   [SCOPESERVO_CHROMIUM=/usr/bin/chromium] [SCREENSHOTS=folder] npm run states [-- PART_OF_A_NAME]
import { strict as assert } from "node:assert";
import { mkdirSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { chromium } from "playwright-core";
import { serve } from "../mock/server.mjs";
import { World } from "../mock/world.mjs";

const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const shots = process.env.SCREENSHOTS;
if (shots) mkdirSync(shots, { recursive: true });
const SIZES = { desk: { width: 1400, height: 900 }, phone: { width: 390, height: 844 } };
const AT_ONCE = 4;
const LONG = { timeout: 15_000 };

let number = 0;
const target = (name, more = {}) => ({
  number: ++number, name, saved: "2026-03-04T09:12:00Z", instrument: "bench 3", slide: "17B", note: "", objective: "40x", um_per_px: 0.25, width: 320, height: 240, features: 812,
  quality: { word: "good", text: "can be told from its surroundings: found in 24 of 24 with 10x of the views made of it", chance: 0.98 }, at: {},
  where: { x_um: 40 * name.length, y_um: 90, umPerPx: 0.25 }, ...more,
});
const SOME = () => [
  target("mitosis-3"),
  target("gland", { slide: "17C", note: "edge of the tumour", quality: { word: "poor", text: "looks like much around it: found in 9 of 24 with 10x of the views made of it", chance: 0.41 } }),
  target("vessel-12", { slide: null, quality: { word: "fair", text: "can be told with 40x alone", chance: 0.8 } }),
];

const tests = [];
/** One of them: at both sizes, unless it says which. */
const test = (name, world, act, sizes = ["desk", "phone"]) => tests.push(...sizes.map((size) => ({ name, world, act, size })));

async function wellFormed(page, where) {
  // Without the page's policy, which keeps out whatever it did not bring along.
  await page.evaluate(axe);
  const found = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  const serious = found.violations.filter((v) => ["serious", "critical"].includes(v.impact));
  assert.deepEqual(serious.map((v) => [v.id, v.nodes.map((n) => n.html.slice(0, 160))]), [], where);
}

/** Nothing is cut off at the side, and Stop can be reached: large enough, in the window, under nothing. */
async function wellLaid(page, where) {
  const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  assert.ok(wide <= 0, `${where}: ${wide} pixels too wide`);
  if ((await page.locator("dialog[open]").count()) > 0 || (await page.locator(".stop").count()) === 0) return;
  const stop = await page.locator(".stop").evaluate((node) => {
    const { x, y, width, height } = node.getBoundingClientRect();
    return { height, width, bottom: y + height, isOnTop: node.contains(document.elementFromPoint(x + width / 2, y + height / 2)), screen: innerHeight };
  });
  assert.ok(stop.height >= 48 && stop.width >= 48 && stop.bottom <= stop.screen && stop.isOnTop, `${where}: Stop ${JSON.stringify(stop)}`);
}

const button = (page, name) => page.getByRole("button", { name });
const count = (world, type) => world.said.filter((said) => said.type === type).length;
async function until(is, what) {
  for (let k = 0; k < 300; k++) {
    if (await is()) return;
    await new Promise((done) => setTimeout(done, 20));
  }
  assert.fail(what);
}

test("empty", {}, async ({ page }) => {
  await button(page, /^Save this view/).waitFor();
  assert.ok(await button(page, /^Go back/).isDisabled());
  await button(page, "Targets").click();
  await page.getByText(/^Nothing is saved yet/).waitFor();
});

test("live", { targets: SOME() }, async ({ page, world }) => {
  await page.getByText("simulated", { exact: true }).waitFor();
  await until(() => count(world, "ack") > 3, "frames are acknowledged once they are drawn");
});

test("a first save and return", {}, async ({ page, shoot }) => {
  let clicks = 0;
  const click = async (name) => (await button(page, name).click(), clicks++);
  await click(/^Save this view/);
  await page.getByRole("dialog").waitFor();
  assert.equal(await page.getByLabel("Name").inputValue(), "view-1");
  await shoot("saving");
  await page.keyboard.press("Enter");
  clicks++;
  await page.getByRole("heading", { name: /^Done/ }).waitFor(LONG);
  await click(/^Take the slide out/);
  await click(/^Go back/);
  await page.getByText(/228.0 µm away/).waitFor(LONG);
  await page.locator(".found polygon").waitFor();
  // Where it was to come, and where it is: the one hollow, the other filled, an ellipse about each.
  const looked = await page.waitForFunction(() => {
    const all = [...document.querySelectorAll(".found .promised, .found .seen")];
    return all.length === 2 && all.map((g) => [getComputedStyle(g.querySelector("circle")).fill, Number(g.querySelector("ellipse").getAttribute("rx"))]);
  });
  const marks = await looked.jsonValue();
  assert.equal(marks[0][0], "none");
  assert.notEqual(marks[1][0], "none");
  assert.ok(marks[0][1] > marks[1][1], "what was promised is known less well than what is seen");
  await shoot("running");
  await page.getByRole("heading", { name: /^Arrived/ }).waitFor(LONG);
  assert.ok(clicks <= 5, `${clicks} clicks`);
});

for (const [verdict, title] of [["ambiguous", "Ambiguous"], ["not_found", "Not found"], ["refused", "Refused"]]) {
  test(verdict, { targets: SOME(), verdict }, async ({ page }) => {
    await button(page, /^Go back/).click();
    await page.getByRole("heading", { name: new RegExp(`^${title}`) }).waitFor(LONG);
    assert.equal(await page.getByText("Arrived").count(), 0);
    await button(page, "Runs").click();
    await page.locator(".tag", { hasText: title }).waitFor();
    await button(page, "Live").click();
  });
}

test("a refusal stays until it is read", {}, async ({ page, world }) => {
  world.start({ job: "move", to: { x_um: 9000 } });
  await page.getByRole("alert").getByText(/x to 9000.0 µm is beyond its limit/).waitFor();
  await page.waitForTimeout(1500);
  await page.getByRole("alert").waitFor();
});

test("a view that is not live says so", { targets: SOME() }, async ({ page, world }) => {
  world.frames = false;
  await page.getByText(/^not live, \d+ s old/).waitFor(LONG);
});

test("a lost camera", { targets: SOME() }, async ({ page, world }) => {
  world.frames = false;
  world.cameraTrouble = "the camera does not answer: look at its cable, and start the program again";
  await page.getByText(/the camera does not answer/).waitFor(LONG);
});

test("the connection is cut, and comes back", { targets: SOME() }, async ({ page, world, served, shoot }) => {
  world.down = true;
  served.cut();
  await page.getByText(/^Connection lost/).waitFor(LONG);
  await page.getByText(/^not live/).waitFor(LONG);
  assert.ok(await button(page, /^Go back/).isDisabled(), "nothing can be asked of who does not answer");
  assert.ok(await button(page, /^Stop/).isEnabled());
  await page.waitForTimeout(1500);
  await shoot("lost");
  world.down = false;
  await page.getByText("● live").waitFor(LONG);
});

test("a connection that died without a word is found dead", { targets: SOME() }, async ({ page, world, served }) => {
  world.silent = true;
  await page.getByText(/^not live/).waitFor(LONG);
  await until(() => served.connections() > 1, "it was not tried again");
  world.silent = false;
  await page.getByText("● live").waitFor(LONG);
}, ["desk"]);

test("where a lasting connection is blocked", { targets: SOME(), blocked: true }, async ({ page, world }) => {
  await page.getByText(/a lasting connection is blocked/).waitFor(LONG);
  const seq = () => page.locator(".paper").getAttribute("data-seq").then(Number);
  await until(async () => (await seq()) > 2, "no pictures came");
  await button(page, /^Go back/).click();
  await page.getByRole("heading", { name: /^Arrived/ }).waitFor(LONG);
  // Whoever drives is not forgotten, though nothing lasts.
  await until(() => world.asked.some(([, path]) => path === "lease"), "the seat was not kept");
  // What cannot work says why, and does nothing.
  await page.keyboard.down("ArrowRight");
  await page.getByRole("alert").getByText(/hold/i).waitFor();
  await page.keyboard.up("ArrowRight");
}, ["desk"]);

test("no permission", { targets: SOME(), me: { user: "eve", role: "viewer", here: true, may_move: false } }, async ({ page, world }) => {
  for (const name of [/^Save this view/, /^Go back/, /^Take the slide/, /^Focus/, /hold$/]) assert.equal(await button(page, name).count(), 0, String(name));
  await page.keyboard.press("g");
  await page.keyboard.down("ArrowRight");
  await page.locator(".paper").click();
  await page.waitForTimeout(300);
  await page.keyboard.up("ArrowRight");
  await button(page, "Targets").click();
  assert.equal(await page.locator(".contact").getByRole("button", { name: /^Go back/ }).count(), 0);
  await button(page, /^open mitosis-3/).click();
  assert.equal(await page.getByRole("dialog").getByRole("button", { name: /^(Keep|Remove)/ }).count(), 0);
  await button(page, "Close").click();
  assert.deepEqual([world.asked, count(world, "jog")], [[], 0], "nothing was asked that would be refused");
  await button(page, "Live").click();
  await button(page, /^Stop/).click();
  await until(() => world.asked.some(([, path]) => path === "stop"), "a viewer may stop");
});

test("somebody else drives", { targets: SOME(), owner: "bob" }, async ({ page, world }) => {
  await page.getByText("bob drives", { exact: true }).waitFor();
  assert.ok(await button(page, /^Go back/).isDisabled());
  assert.ok(await button(page, /^Save this view/).isDisabled());
  await page.getByRole("status").getByText("bob drives this instrument: ask for it, or wait").waitFor();
  await page.keyboard.press("g");
  await page.keyboard.down("ArrowRight");
  await page.waitForTimeout(300);
  await page.keyboard.up("ArrowRight");
  assert.deepEqual([world.asked, count(world, "jog")], [[], 0], "nothing was asked that would be refused");
  await button(page, "ask to drive").click();
  await until(() => world.asked_by === "anna", "it was not asked");
});

test("the seat is asked for, and given", { targets: SOME(), owner: "anna", asked_by: "bob" }, async ({ page, world }) => {
  await button(page, /^hand over to bob/).click();
  await until(() => world.owner === "bob", "it was not given");
});

test("Escape while a key is held", { targets: SOME() }, async ({ page, world }) => {
  await page.keyboard.down("ArrowRight");
  await until(() => count(world, "jog") > 3, "it did not move");
  await page.keyboard.press("Escape");
  await until(() => count(world, "stop") > 0, "it was not stopped");
  const at = world.said.findLastIndex((said) => said.type === "stop");
  // The key is held on, and repeats itself as keys do: nothing moves until it is pressed anew.
  for (let k = 0; k < 6; k++) await page.keyboard.down("ArrowRight"), await page.waitForTimeout(60);
  assert.deepEqual(world.said.slice(at).filter((said) => said.type === "jog"), []);
  await page.keyboard.up("ArrowRight");
  const before = count(world, "jog");
  await page.keyboard.down("ArrowRight");
  await until(() => count(world, "jog") > before, "it moves when it is pressed anew");
  await page.keyboard.up("ArrowRight");
}, ["desk"]);

test("what is held is let go of when the page cannot be held", { targets: SOME() }, async ({ page, world, served }) => {
  const press = async () => {
    const had = count(world, "jog");
    const pad = await button(page, /^right, hold/).boundingBox();
    await page.mouse.move(pad.x + 10, pad.y + 10);
    await page.mouse.down();
    await until(() => count(world, "jog") > had + 2, "it did not move");
  };
  const still = async (why) => {
    await page.waitForTimeout(250);
    const had = count(world, "jog");
    await page.waitForTimeout(400);
    assert.equal(count(world, "jog"), had, why);
    await page.mouse.up();
  };
  await press();
  await page.evaluate(() => window.dispatchEvent(new Event("blur")));
  await still("the window is not looked at");
  await press();
  await page.keyboard.press("t");
  await still("another page is shown");
  await page.keyboard.press("l");
  await press();
  served.cut();
  await page.waitForTimeout(1500);
  await still("the connection is another one");
  await press();
  await page.keyboard.press("Escape");
  await still("Stop was pressed");
}, ["desk"]);

test("a pad is held by a finger", { targets: SOME() }, async ({ page, world }) => {
  await button(page, "Controls").click();
  const pad = button(page, /^right, hold/);
  await pad.scrollIntoViewIfNeeded();
  const box = await pad.boundingBox();
  const touch = { x: box.x + 20, y: box.y + 20 };
  const session = await page.context().newCDPSession(page);
  await session.send("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: [touch] });
  await until(() => count(world, "jog") > 3, "it did not move");
  await session.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
  await until(() => count(world, "jog_end") === 1, "it was not let go");
}, ["phone"]);

test("by keys alone", { targets: SOME() }, async ({ page, world }) => {
  await page.keyboard.press("s");
  await page.getByRole("dialog", { name: "Save this view" }).waitFor();
  await page.keyboard.press("Enter");
  await page.getByRole("heading", { name: /^Done/ }).waitFor(LONG);
  assert.equal(world.targets[0].name, "view-1");
  await page.keyboard.press("g");
  await page.getByRole("heading", { name: /^Arrived/ }).waitFor(LONG);
  await page.keyboard.press("?");
  await page.getByRole("dialog", { name: "Keys" }).waitFor();
  await page.keyboard.press("Enter");
  await page.keyboard.press("t");
  await page.getByRole("heading", { name: "Targets" }).waitFor();
  await page.keyboard.press("Tab");
  for (let k = 0; k < 30 && !(await page.evaluate(() => document.activeElement?.getAttribute("aria-label")?.startsWith("open "))); k++) await page.keyboard.press("Tab");
  await page.keyboard.press("Enter");
  await page.getByRole("dialog", { name: "view-1" }).waitFor();
}, ["desk"]);

test("click, drag and wheel", { targets: SOME() }, async ({ page, world }) => {
  const box = await page.locator(".paper").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const jobs = () => world.asked.filter(([, path]) => path === "jobs").map(([, , body]) => body);
  const idle = () => until(() => !world.job, "a job goes on");
  await page.mouse.click(x, y);
  await until(() => jobs().length === 1, "a click did nothing");
  assert.ok(Math.abs(jobs()[0].x - 0.5) < 0.01 && Math.abs(jobs()[0].y - 0.5) < 0.01);
  await idle();
  // At once, before the page has heard that the stage stands.
  await page.mouse.move(x, y);
  await page.mouse.down();
  await page.mouse.move(x + 60, y + 30, { steps: 5 });
  await page.mouse.up();
  await until(() => jobs().length === 2, "a drag did nothing");
  assert.ok(jobs()[1].x < 0.5 && jobs()[1].y < 0.5, "what was taken hold of comes along");
  await idle();
  await page.waitForTimeout(300);
  await page.mouse.wheel(0, -100);
  await until(() => jobs().length === 3, "the wheel did nothing");
  assert.deepEqual(jobs()[2].by, { z_um: -1 }, "upwards is away from the specimen");
  // Many notches are not many jobs.
  for (let k = 0; k < 8; k++) await page.mouse.wheel(0, 100);
  await idle();
  await page.waitForTimeout(1200);
  await idle();
  await until(() => jobs().length > 3, "more notches did nothing");
  await idle();
  const [, , , ...turned] = jobs();
  assert.ok(turned.length <= 4, `${turned.length} jobs`);
  assert.ok(turned.every((job) => job.by.z_um > 0));
  assert.equal(await page.getByRole("alert").count(), 0, "none was refused");
}, ["desk"]);

test("contact sheet", { targets: SOME() }, async ({ page, world, shoot }) => {
  await button(page, "Targets").click();
  await page.getByText("looks like much around it").waitFor();
  await page.getByPlaceholder("search").fill("tumour");
  await until(async () => (await page.locator(".contact > li").count()) === 1, "the note was not searched");
  await page.getByPlaceholder("search").fill("");
  await page.locator("main").getByRole("combobox", { name: /^slide/ }).selectOption("17B");
  await until(async () => (await page.locator(".contact > li").count()) === 1, "the slide was not looked for");
  await page.locator("main").getByRole("combobox", { name: /^slide/ }).selectOption("");
  await shoot("targets");
  await button(page, /^open gland/).click();
  await page.getByRole("dialog", { name: "gland" }).waitFor();
  await shoot("target");
  await page.getByRole("dialog").getByLabel("name").fill("gland-2");
  await button(page, "Keep").click();
  await until(() => world.targets.some((t) => t.name === "gland-2"), "it was not renamed");
  await button(page, /^open gland-2/).click();
  await button(page, /^Remove/).click();
  await button(page, /^Yes/).click();
  await until(() => world.targets.length === 2, "it was not taken out");
});

test("a slide and a note are written down, and what lies in the bin is taken back", { targets: SOME() }, async ({ page, world, shoot }) => {
  await button(page, "Targets").click();
  await button(page, /^open gland/).click();
  const one = page.getByRole("dialog", { name: "gland" });
  await one.getByLabel("slide").fill("17-B");
  await one.getByLabel("note").fill("at the rim");
  await shoot("edit");
  await button(page, "Keep").click();
  await until(() => world.targets.some((t) => t.slide === "17-B" && t.note === "at the rim"), "it was not written down");
  await button(page, /^open gland/).click();
  await button(page, /^Remove/).click();
  await button(page, /^Yes/).click();
  await until(() => world.targets.length === 2, "it was not taken out");
  await button(page, "Bin").click();
  const bin = page.getByRole("dialog", { name: "Bin" });
  await bin.getByText("gland", { exact: true }).waitFor();
  await shoot("bin");
  await bin.getByRole("button", { name: "Take back" }).click();
  await until(() => world.targets.length === 3, "it was not taken back");
  await bin.getByText("Nothing lies in it.").waitFor();
});

const MANY = 230;
/** Shown by and by until all are there, each once; how many were shown at first. */
async function byAndBy(within, rows, all) {
  await until(async () => (await rows.count()) > 0, "nothing is shown");
  const first = await rows.count();
  const more = within.getByRole("button", { name: "Show more" });
  await until(async () => {
    if (await more.count()) await more.scrollIntoViewIfNeeded().catch(() => undefined);
    return (await rows.count()) === all;
  }, `not all of ${all} are shown`);
  assert.equal(await more.count(), 0, "nothing more is offered when all are there");
  const said = await rows.allTextContents();
  assert.equal(new Set(said).size, all, "each is shown once");
  return first;
}

const oneRun = (k) => ({ id: `${String(k).padStart(6, "0")}_reposition`, job: "reposition", began: new Date(Date.UTC(2026, 0, 1, 0, k)).toISOString(), user: "anna", slide: null, target: `t-${k}`, verdict: "arrived", message: `number ${k}`, seconds: 9, ended: true, report: false, arrival: false });
const RUNS = () => Array.from({ length: MANY }, (_, k) => oneRun(MANY - k));

test("all runs are there, the newest first, however many", { runs: RUNS() }, async ({ page, world, shoot }) => {
  await button(page, "Runs").click();
  const rows = page.locator(".runs article");
  const first = await byAndBy(page, rows, MANY);
  assert.ok(first < MANY, `${first} at first`);
  assert.match(await rows.last().textContent(), /number 1(?!\d)/);
  // One more is made, and one that is not the newest goes: as many as were shown stay, each once.
  world.runs.unshift(oneRun(MANY + 1));
  world.runs = world.runs.filter((one) => one.message !== "number 7");
  world.revision++;
  await until(async () => /number 231/.test(await rows.first().textContent()), "the newest is not shown");
  await byAndBy(page, rows, MANY);
  await shoot("runs");
});

test("the next runs come though the last one that was shown is gone", { runs: RUNS(), loses: RUNS()[99].id }, async ({ page }) => {
  await button(page, "Runs").click();
  await byAndBy(page, page.locator(".runs article"), MANY - 1);
  assert.equal(await page.getByRole("alert").count(), 0);
}, ["desk"]);

const BINNED = () => Array.from({ length: MANY }, (_, k) => target(k % 3 ? `view-${k}` : "same", { note: String(k), binned: new Date(Date.UTC(2026, 5, 1, 0, MANY - k)).toISOString() }));

test("all that lies in the bin is there, also what has one name", { targets: SOME(), bin: BINNED() }, async ({ page, world, shoot }) => {
  await button(page, "Targets").click();
  await button(page, "Bin").click();
  const bin = page.getByRole("dialog", { name: "Bin" });
  const first = await byAndBy(bin, bin.locator("li"), MANY);
  assert.ok(first < MANY, `${first} at first`);
  await shoot("bin-many");
  // One is taken back: as many as were shown stay, without it.
  await bin.locator("li", { hasText: "view-229" }).getByRole("button", { name: "Take back" }).click();
  await until(() => world.targets.some((t) => t.name === "view-229"), "it was not taken back");
  await byAndBy(bin, bin.locator("li"), MANY - 1);
});

test("several are taken out at once", { targets: SOME() }, async ({ page, world, shoot }) => {
  await button(page, "Targets").click();
  await page.getByRole("checkbox", { name: "mark gland" }).check();
  await page.getByRole("checkbox", { name: "mark vessel-12" }).check();
  await page.getByText("2 marked").waitFor();
  await shoot("marked");
  // What is not shown is not taken out.
  await page.getByPlaceholder("search").fill("gland");
  await page.getByText("1 marked").waitFor();
  await page.getByPlaceholder("search").fill("");
  await button(page, /^Remove 2/).click();
  const asks = page.getByRole("dialog", { name: "Take these 2 views out?" });
  await asks.getByText("gland, vessel-12").waitFor();
  await shoot("remove");
  await asks.getByRole("button", { name: "Keep them" }).click();
  assert.equal(world.targets.length, 3);
  await button(page, /^Remove 2/).click();
  await button(page, /^Yes/).click();
  await until(() => world.targets.length === 1 && world.targets[0].name === "mitosis-3", "they were not taken out");
  await page.getByText("none marked").waitFor();
});

test("somebody else sits down", { targets: SOME(), owner: "anna", demo: null, there: ["anna", "bob"] }, async ({ page, world, served, shoot }) => {
  await button(page, /^you are anna/).click();
  const here = page.getByRole("dialog", { name: "You are anna" });
  await here.getByText("Also there: bob").waitFor();
  await here.getByLabel("Name").fill("vera");
  await here.getByLabel("Password").fill("wrong horse");
  await button(page, "Sit down").click();
  await here.getByText(/nobody has this name and password/).waitFor();
  await shoot("change");
  const seen = await page.locator(".paper").getAttribute("data-seq");
  await here.getByLabel("Password").fill("right horse");
  await button(page, "Sit down").click();
  await button(page, /^you are vera/).waitFor();
  await until(() => served.connections() === 2, "the connection is still that of the one before");
  await until(() => world.owner === null, "who left drives on");
  assert.ok(Number(seen) > 0 && (await page.locator(".paper[data-seq]").count()) === 1, "the view went away");
  await page.getByText("nobody drives").waitFor({ state: "attached" });
});

test("colours", { targets: SOME() }, async ({ page, shoot }) => {
  const theme = () => page.evaluate(() => document.documentElement.dataset.theme);
  const becomes = (colours, why) => until(async () => (await theme()) === colours, why);
  assert.equal(await theme(), "dark");
  await button(page, /^you are/).click();
  await page.getByLabel("Colours").selectOption("light");
  await becomes("light", "light was chosen");
  await shoot("light");
  await page.reload();
  await page.locator(".paper[data-seq]").waitFor(LONG);
  await becomes("light", "it is kept");
  await button(page, /^you are/).click();
  await page.getByLabel("Colours").selectOption("auto");
  for (const scheme of ["dark", "light", "dark"]) {
    await page.emulateMedia({ colorScheme: scheme });
    await becomes(scheme, `the system is ${scheme}`);
  }
});

test("a question is a dialog that keeps the focus", { targets: SOME() }, async ({ page, world, shoot }) => {
  world.question = { id: 1, job: 1, text: "Is the 40x objective in place, and the slide on the stage?" };
  await page.getByRole("alertdialog", { name: "The instrument asks" }).waitFor();
  await shoot("question");
  for (let k = 0; k < 6; k++) {
    await page.keyboard.press("Tab");
    assert.ok(await page.evaluate(() => document.activeElement === document.body || document.activeElement.closest("dialog") !== null), "the focus went out");
  }
  await button(page, "Yes").click();
  await until(() => world.question === null, "it was not answered");
});

test("what a killed program left", { targets: SOME(), left: "going back to 'mitosis-3' was under way when the program ended; the stage should stand at x 120.0 um" }, async ({ page, world, shoot }) => {
  await page.getByRole("heading", { name: "Something was under way" }).waitFor();
  assert.ok(await button(page, /^Save this view/).isDisabled());
  await button(page, "Targets").click();
  await page.getByRole("status").getByText(/Resume it or abandon it first/).waitFor();
  await button(page, "Live").click();
  // By hand one may go all the same.
  assert.ok(await page.getByRole("combobox", { name: "objective" }).isEnabled());
  await shoot("left");
  await button(page, "Abandon it").click();
  await until(() => world.left === null, "it was not abandoned");
});

test("log in", { loggedIn: false }, async ({ page, shoot }) => {
  await page.getByLabel("Name").fill("anna");
  await page.getByLabel("Password").fill("wrong horse");
  await button(page, "Log in").click();
  await page.getByText(/nobody has this name and password/).waitFor();
  await shoot("login");
  await page.getByLabel("Password").fill("right horse");
  await button(page, "Log in").click();
  await page.locator(".paper[data-seq]").waitFor(LONG);
});

async function run({ name, world: more, act, size }, browser) {
  const served = await serve(new World(structuredClone(more)));
  const { world } = served;
  // Axe is no part of the page: where it looks, the policy is not asked. That the page holds it is seen in all of the messages.
  const context = await browser.newContext({ viewport: SIZES[size], hasTouch: size === "phone", isMobile: size === "phone", bypassCSP: false });
  const page = await context.newPage();
  page.setDefaultTimeout(10_000);
  const wrong = [];
  page.on("pageerror", (error) => wrong.push(String(error)));
  page.on("console", (message) => message.type() === "error" && !/40[1-9]|WebSocket|ERR_/.test(message.text()) && wrong.push(message.text()));
  const file = (what) => `${shots}/${size}-${what.replaceAll(/[^a-z]+/gi, "-")}.png`;
  const shoot = async (what) => {
    await wellLaid(page, what);
    if (shots) await page.waitForTimeout(250), await page.screenshot({ path: file(what) });
  };
  try {
    // Below a path, as behind a proxy.
    await page.goto(`${served.link}bench/`);
    if (world.loggedIn && !world.blocked) await page.locator(".paper[data-seq]").waitFor(LONG), await page.waitForTimeout(400);
    await act({ page, world, served, shoot });
    await shoot(name);
    await wellFormed(page, `${size}: ${name}`);
    assert.deepEqual(wrong, []);
    console.log(`ok ${size}: ${name}`);
    return true;
  } catch (error) {
    if (shots) await page.screenshot({ path: file(`failed-${name}`) }).catch(() => {});
    console.log(`FAILED ${size}: ${name}\n  ${String(error.message).split("\n").slice(0, 14).join("\n  ")}`);
    return false;
  } finally {
    await context.close();
    served.end();
  }
}

const browser = await chromium.launch({ executablePath: process.env.SCOPESERVO_CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
const wanted = tests.filter(({ size, name }) => `${size} ${name}`.includes(process.argv[2] ?? ""));
const waiting = [...wanted];
let failed = 0;
// Each has an instrument of its own, and mostly waits for it: several at once.
const some = async () => {
  for (let one = waiting.shift(); one; one = waiting.shift()) {
    const isRight = await run(one, browser);
    // Counted after it was waited for: another one may have been counted meanwhile.
    if (!isRight) failed += 1;
  }
};
await Promise.all(Array.from({ length: AT_ONCE }, some));
await browser.close();
console.log(failed === 0 ? `all ${wanted.length} states are right` : `${failed} of ${wanted.length} failed`);
process.exit(failed === 0 ? 0 : 1);
