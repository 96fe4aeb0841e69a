/** A service with a fresh store for browser tests, and a browser that notices what the page should not do. */
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, openSync, readFileSync, rmSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

export const ROOT = path.resolve(path.dirname(fileURLToPath(import.meta.url)), "../..");
export const BINARY =
  process.env.SHAPELEX_BINARY ??
  path.join(process.env.CARGO_TARGET_DIR ?? path.join(ROOT, "target"), "debug", "shapelex");
export const CHROMIUM = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find(existsSync);

async function freePort() {
  const server = createServer().listen(0, "127.0.0.1");
  await new Promise((resolve) => server.once("listening", resolve));
  const { port } = server.address();
  await new Promise((resolve) => server.close(resolve));
  return port;
}

/** Starts the service; with `port` and `folder` again on the same store. */
export async function serve({
  folder = mkdtempSync(path.join(tmpdir(), "shapelex-dashboard-")),
  port,
  flags = [],
} = {}) {
  port ??= await freePort();
  const log = openSync(path.join(folder, "log"), "a");
  const child = spawn(
    BINARY,
    ["serve", "--listen", `127.0.0.1:${port}`, "--data-dir", path.join(folder, "data"), ...flags],
    { stdio: ["ignore", log, log] },
  );
  const ended = new Promise((resolve) => child.once("exit", resolve));
  const address = `http://127.0.0.1:${port}`;
  for (let tries = 0; ; tries++) {
    if (
      await fetch(`${address}/readyz`).then(
        (reply) => reply.ok,
        () => false,
      )
    )
      break;
    if (tries > 300 || child.exitCode !== null) throw new Error(`the service did not start: see ${folder}/log`);
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
  const call = async (method, route, body, headers = {}) => {
    const reply = await fetch(address + route, {
      method,
      headers: { "content-type": "application/json", ...headers },
      body: body === undefined ? undefined : typeof body === "string" ? body : JSON.stringify(body),
    });
    const text = await reply.text();
    if (!reply.ok) throw new Error(`${method} ${route}: ${reply.status} ${text}`);
    return text ? JSON.parse(text) : undefined;
  };
  const stop = async () => {
    child.kill("SIGTERM");
    await ended;
  };
  return { address, port, folder, call, stop, remove: () => rmSync(folder, { recursive: true, force: true }) };
}

export function key(folder, ...options) {
  return new Promise((resolve, reject) => {
    const child = spawn(
      BINARY,
      ["key", "create", "--name", "test", "--data-dir", path.join(folder, "data"), ...options],
      { stdio: ["ignore", "pipe", "inherit"] },
    );
    let text = "";
    child.stdout.on("data", (part) => (text += part));
    child.once("exit", (code) => (code ? reject(new Error(`key create: ${code}`)) : resolve(text.trim())));
  });
}

export async function browse() {
  return chromium.launch({
    executablePath: CHROMIUM,
    args: [
      "--no-sandbox",
      "--disable-gpu",
      "--use-gl=angle",
      "--use-angle=swiftshader",
      "--enable-unsafe-swiftshader",
      "--force-device-scale-factor=1",
      // A page from a folder is of no machine, and would not be allowed to call this one.
      ...(process.env.DIST === "1" ? ["--disable-features=LocalNetworkAccessChecks"] : []),
    ],
  });
}

/** CI has little time: it looks at each thing once. */
export const SHORT = Boolean(process.env.CI);

/** Settings under which a view is looked at: all pairs of scheme and width, in CI two that have each of them. */
export const LOOKS = ["light", "dark"]
  .flatMap((scheme) => [1280, 390].map((width) => ({ scheme, width })))
  .filter(({ scheme, width }) => !SHORT || (scheme === "light") === (width === 390));

/** What is awaited comes, or does not: a busy machine only takes longer. */
export const WAIT = Number(process.env.WAIT ?? 90_000);

const DIST = path.join(ROOT, "dashboard/dist");

/** With DIST=1 the page is that of the folder, not the one in the program, which need not be built again after each change. */
async function fromDist(context) {
  const types = { js: "text/javascript", css: "text/css", svg: "image/svg+xml", txt: "text/plain" };
  await context.route(
    (url) => /^\/(app(\/(?!login\.json).*)?)?$/.test(url.pathname),
    async (route) =>
      route.fulfill({ response: await route.fetch(), body: readFileSync(path.join(DIST, "index.html")), status: 200 }),
  );
  await context.route(
    (url) => /^\/docs\/?$/.test(url.pathname),
    async (route) =>
      route.fulfill({ response: await route.fetch(), body: readFileSync(path.join(DIST, "docs.html")), status: 200 }),
  );
  await context.route(
    (url) => url.pathname.startsWith("/assets/"),
    (route) => {
      const file = path.join(DIST, new URL(route.request().url()).pathname);
      return existsSync(file)
        ? route.fulfill({ body: readFileSync(file), contentType: types[file.split(".").pop()] })
        : route.fulfill({ status: 404 });
    },
  );
}

/**
 * A page that keeps what went wrong in `faults`: requests to other origins, violations of the policy, errors in the console.
 * Refusals that a test expects are named in `expected`, the origin of an identity provider in `provider`.
 */
export async function open(browser, address, options = {}, expected = [], provider = undefined) {
  const context = await browser.newContext({
    viewport: { width: 1280, height: 860 },
    locale: "en-GB",
    reducedMotion: "no-preference",
    ...options,
  });
  if (process.env.DIST === "1") await fromDist(context);
  const page = await context.newPage();
  page.setDefaultTimeout(WAIT);
  const faults = [];
  page.faults = faults;
  page.bytes = 0;
  page.on("request", (request) => {
    const url = new URL(request.url());
    if (url.protocol !== "blob:" && url.origin !== address && url.origin !== provider)
      faults.push(`request to ${url.origin}`);
    if (/shk_|eyJ/.test(request.url())) faults.push(`a key in an address: ${url.pathname}`);
  });
  page.on("console", (message) => {
    if (message.type() === "error" && !expected.some((text) => message.text().includes(text)))
      faults.push(`console: ${message.text()} ${message.location().url}`);
  });
  page.on("pageerror", (error) => faults.push(`error: ${error.stack}`));
  await context.addInitScript(() => {
    addEventListener("securitypolicyviolation", (event) =>
      console.error(`policy: ${event.violatedDirective} ${event.blockedURI}`),
    );
  });
  return page;
}

/** Where pictures are kept, if they are. */
const SCREENS = process.env.SCREENS ? path.resolve(ROOT, process.env.SCREENS) : undefined;
if (SCREENS) mkdirSync(SCREENS, { recursive: true });

export async function screen(page, name, options = {}) {
  if (SCREENS) await page.screenshot({ path: path.join(SCREENS, `${name}.png`), ...options });
}

export async function settled(page) {
  await page.waitForLoadState("load");
  // Twice: an answer that has come may lead to the next request.
  for (let times = 0; times < 2; times++) {
    await page.waitForFunction(
      () => document.querySelector("h1") && !document.querySelector(".loading, [aria-busy=true]"),
      null,
      { timeout: WAIT },
    );
    await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
  }
}

const AXE = readFileSync(path.join(ROOT, "dashboard/node_modules/axe-core/axe.min.js"), "utf8");

export async function accessible(page, name) {
  await page.evaluate(AXE);
  const { violations } = await page.evaluate(() => window.axe.run(document, { resultTypes: ["violations"] }));
  const serious = violations.filter((one) => ["serious", "critical"].includes(one.impact));
  assert.deepEqual(
    serious.map(
      (one) =>
        `${name}: ${one.id}: ${one.nodes
          .map((node) => node.target.join(" "))
          .slice(0, 4)
          .join(", ")}`,
    ),
    [],
  );
}

/** Drops a file, `{ name, mimeType, buffer }` or a path, and gives the card of the last file. */
export async function drop(page, file) {
  await page.locator("input[type=file]").setInputFiles(file);
  return page.locator("section.card").last();
}

/** Drops a file and stores what is in it. */
export async function store(page, file) {
  const card = await drop(page, file);
  await card.getByRole("button", { name: "Store", exact: true }).click();
  return card;
}
