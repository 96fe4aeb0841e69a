/** The reference of the interface in a real browser: found, read, tried, by mouse and keyboard, wide and narrow. */
import assert from "node:assert/strict";
import { readdirSync, readFileSync, statSync } from "node:fs";
import path from "node:path";
import { after, before, test } from "node:test";
import { accessible, browse, key, LOOKS, open, ROOT, SHORT, screen, serve } from "./service.mjs";

let service, browser;

before(async () => {
  service = await serve();
  browser = await browse();
});

after(async () => {
  await browser?.close();
  await service?.stop();
  service?.remove();
});

const document = JSON.parse(readFileSync(path.join(ROOT, "openapi/openapi.json"), "utf8"));
const OPERATIONS = Object.entries(document.paths).flatMap(([route, methods]) =>
  Object.entries(methods).map(([method, { operationId }]) => ({
    id: operationId,
    title: `${method.toUpperCase()} ${route}`,
  })),
);

/** Waits for the heading of an operation: the page draws it after its address has changed. */
async function headed(page, text) {
  await page.waitForFunction(
    (text) => window.document.querySelector("h1")?.innerText.replace(/\s+/g, " ") === text,
    text,
  );
}

/** Goes to an operation, as a link of another page would. */
async function show(page, fragment) {
  await page.goto("about:blank");
  await page.goto(`${service.address}/docs${fragment}`);
  await page.locator("h1").waitFor();
}

const trying = (page) => page.locator("section.try");

test("every operation has an address, and its page has no fault", async () => {
  const page = await open(browser, service.address);
  await show(page, "");
  assert.equal(await page.locator(".operations a").count(), OPERATIONS.length);
  for (const { id, title } of OPERATIONS) {
    await page.evaluate((id) => (location.hash = id), id);
    await page.waitForFunction((title) => window.document.title.startsWith(title), title);
    await headed(page, title);
    // Everything that can be opened: schemas that contain themselves are opened a few times only.
    for (let depth = 0; depth < (SHORT ? 1 : 4); depth++) await page.evaluate(openAll);
  }
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

function openAll() {
  const closed = [...window.document.querySelectorAll("main details:not([open])")];
  for (const one of closed.slice(0, 40)) one.open = true;
  return new Promise((resolve) => setTimeout(resolve));
}

for (const { scheme, width } of LOOKS) {
  test(`on ${width} pixels, ${scheme}: nothing too wide, nothing that a screen reader stumbles over`, async () => {
    const page = await open(browser, service.address, { colorScheme: scheme, viewport: { width, height: 860 } });
    for (const fragment of ["", "#cohort_mean", "#project", "#add_shapes", "#segment", "#learn_dictionary"]) {
      await show(page, fragment);
      await page.evaluate(openAll);
      await accessible(page, fragment);
      const wide = await page.evaluate(() => window.document.documentElement.scrollWidth);
      assert.ok(wide <= width, `${fragment} is ${wide} wide`);
      if (fragment === "#project" && scheme === "light" && width > 800) await screen(page, "reference");
    }
    assert.deepEqual(page.faults, []);
    await page.context().close();
  });
}

test("an operation is found by what it takes, and links of former versions lead to it", async () => {
  const page = await open(browser, service.address);
  await show(page, "#/cohorts/find_cohort");
  await headed(page, "GET /v1/cohorts/{cohort}");
  assert.equal(new URL(page.url()).hash, "#find_cohort");
  await page.keyboard.press("/");
  await page.keyboard.type("repeated_points shapes");
  await page
    .locator(".search [role=status]")
    .getByText(/^1 operation$/)
    .waitFor();
  assert.equal(await page.locator(".operations a").count(), 1);
  await page.keyboard.press("Enter");
  await page.waitForURL("**/docs#add_shapes");
  await headed(page, "POST /v1/cohorts/{cohort}/shapes");
  // Who cannot see the page hears where they are.
  assert.equal(await page.evaluate(() => window.document.activeElement.id), "title");
  await page.goBack();
  await headed(page, "GET /v1/cohorts/{cohort}");
  await show(page, "#nothing");
  assert.match(await page.getByRole("alert").innerText(), /No operation nothing/);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("a schema is a tree with alternatives, and required fields come first", async () => {
  const page = await open(browser, service.address);
  await show(page, "#project");
  const body = page.locator("section", { has: page.getByRole("heading", { name: "Request body" }) });
  const fields = body.locator(".tree .tree > li > :first-child .field-name");
  assert.deepEqual((await fields.allInnerTexts()).slice(0, 4), [
    "representation",
    "shapes",
    "transformation",
    "reference",
  ]);
  await body.locator("summary", { hasText: "representation" }).click();
  await body.locator("summary", { hasText: "kind: closed_curve" }).click();
  assert.match(await body.innerText(), /control_points\s+required\s+integer\s+at least 3/);
  await page.getByText("application/x-ndjson", { exact: true }).first().click();
  await body.locator("summary", { hasText: "ShapeInput" }).waitFor();
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("a request is sent as it was filled in, and shown for a program", async () => {
  const page = await open(browser, service.address, {}, ["422"]);
  await show(page, "#project");
  const form = trying(page);
  await form.getByRole("button", { name: "Send" }).click();
  await form.getByText("200 OK").waitFor();
  assert.match(await form.locator(".answer pre").innerText(), /"results": \[/);
  const command = await form.locator("pre.short").innerText();
  assert.ok(command.startsWith(`curl -X POST '${service.address}/v1/project'`), command);
  await form.getByLabel("Answer as").selectOption("text/csv");
  await form.getByRole("button", { name: "Send" }).click();
  await form.locator(".answer pre", { hasText: "control_points" }).waitFor();
  assert.match(await form.locator(".answer dl").textContent(), /content-typetext\/csv/);
  // A refusal is an answer like others.
  await form.getByLabel("Body", { exact: true }).fill("{}");
  await form.getByRole("button", { name: "Send" }).click();
  await form.getByText(/^4\d\d /).waitFor();

  await show(page, "#list_shapes");
  await form.getByLabel("cohort", { exact: true }).fill("example-cells");
  await form.getByText("optional parameters").click();
  await form.getByLabel("labels", { exact: true }).fill("treatment=cytd");
  await form.getByLabel("limit").fill("2");
  const asked = page.waitForRequest((request) => request.url().includes("/v1/cohorts/example-cells/shapes"));
  await form.getByRole("button", { name: "Send" }).click();
  assert.equal(new URL((await asked).url()).search, "?labels.treatment=cytd&limit=2");
  await form.getByText("200 OK").waitFor();

  await show(page, "#cohort_mean");
  await form.getByLabel("cohort", { exact: true }).fill("example-cells");
  await form.getByLabel("transformation").selectOption("similarity");
  await form.getByLabel("Answer as").selectOption("image/svg+xml");
  await form.getByRole("button", { name: "Send" }).click();
  await form.locator(".answer img").waitFor();
  assert.ok(await form.locator(".answer img").evaluate((image) => image.decode().then(() => image.naturalWidth > 0)));
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("files go up, and events come until one stops", async () => {
  const page = await open(browser, service.address);
  await show(page, "#inspect_file");
  const form = trying(page);
  await form.getByLabel("or a file").setInputFiles({
    name: "one.obj",
    mimeType: "model/obj",
    buffer: Buffer.from("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
  });
  await form.getByText("optional parameters").click();
  await form.getByLabel("format", { exact: true }).fill("obj");
  assert.match(await form.locator("pre.short").innerText(), /--data-binary '@one\.obj'/);
  await form.getByRole("button", { name: "Send" }).click();
  await form.getByText("200 OK").waitFor();

  await show(page, "#list_events");
  await form.getByRole("button", { name: "Send" }).click();
  await service.call("POST", "/v1/cohorts", {
    name: "heard",
    correspondence: "landmarks",
    representation: { kind: "landmarks", dimension: 2, points: 3 },
  });
  await form.locator(".answer pre", { hasText: "cohort_created" }).waitFor();
  await form.getByRole("button", { name: "Stop" }).click();
  await form.getByRole("button", { name: "Stop" }).waitFor({ state: "detached" });
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("the key is kept in memory, sent in a header, and never written out", async () => {
  const secret = await key(service.folder, "--role", "reader");
  const page = await open(browser, service.address);
  await show(page, "#list_cohorts");
  const form = trying(page);
  await form.getByLabel("Key").fill(secret);
  const asked = page.waitForRequest((request) => request.url().includes("/v1/cohorts"));
  await form.getByRole("button", { name: "Send" }).click();
  assert.equal((await asked).headers().authorization, `Bearer ${secret}`);
  await form.getByText("200 OK").waitFor();
  const command = await form.locator("pre.short").innerText();
  assert.ok(command.includes("$SHAPELEX_KEY") && !command.includes(secret), command);
  // It is still there at another operation, and nowhere that outlives the page.
  await page.evaluate(() => (location.hash = "list_jobs"));
  await page.waitForFunction(() => window.document.title.startsWith("GET /v1/jobs"));
  assert.equal(await form.getByLabel("Key").inputValue(), secret);
  const kept = await page.evaluate(() => JSON.stringify([{ ...localStorage }, { ...sessionStorage }]));
  assert.ok(!kept.includes(secret), kept);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("it is light", async () => {
  const folder = path.join(ROOT, "dashboard/dist/assets");
  const own = readdirSync(folder).filter((name) => /^docs-.*\.(js|css)$/.test(name));
  const bytes = own.reduce((sum, name) => sum + statSync(path.join(folder, name)).size, 0);
  assert.ok(own.length === 2 && bytes <= 25_000, `${own}: ${bytes} bytes`);
  const page = await open(browser, service.address);
  await show(page, "");
  await show(page, "#project");
  const ms = await page.evaluate(
    () => performance.getEntriesByName("first-contentful-paint")[0]?.startTime ?? performance.now(),
  );
  console.log(`reference: ${bytes} bytes of its own, first drawn after ${ms.toFixed(0)} ms`);
  if (process.env.GOALS === "1") assert.ok(ms <= 300, `${ms} ms`);
  await page.context().close();
});
