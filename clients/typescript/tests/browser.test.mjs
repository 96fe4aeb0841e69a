/** The client in Chromium, on a page of another origin than the service. */
import assert from "node:assert/strict";
import { existsSync, readFileSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";
import { Server } from "../dist/server.js";

const { chromium } = createRequire(new URL("../../../dashboard/package.json", import.meta.url))("playwright-core");
const CHROMIUM = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find(existsSync);
const skip = !CHROMIUM && "there is no chromium";

let pages;
let server;
let browser;
let page;
before(async () => {
  if (skip) return;
  pages = createServer((request, response) => {
    const file = new URL(`../dist${request.url}`, import.meta.url);
    if (!request.url.endsWith(".js"))
      return response.setHeader("content-type", "text/html").end("<title>a page</title>");
    response.setHeader("content-type", "text/javascript").end(existsSync(file) ? readFileSync(file) : "");
  }).listen(0, "127.0.0.1");
  await new Promise((resolve) => pages.once("listening", resolve));
  const origin = `http://127.0.0.1:${pages.address().port}`;
  server = await Server.start({ example: true, options: [`--allow-origin=${origin}`] });
  browser = await chromium.launch({ executablePath: CHROMIUM, args: ["--no-sandbox", "--disable-gpu"] });
  page = await browser.newPage();
  await page.goto(origin);
});
after(async () => {
  await browser?.close();
  await server?.stop();
  pages?.close();
});

test("files in; JSON, bytes and lines out", { skip }, async () => {
  const found = await page.evaluate(async (url) => {
    const shapelex = await import("/index.js");
    const client = shapelex.createClient({ url });
    const path = { cohort: "wings" };
    const representation = { kind: "landmarks", dimension: 2, points: 3 };
    await shapelex.createCohort(client, { body: { name: "wings", representation } });
    const rows = ["id,landmark,x,y", ..."abc"].join("\n");
    const table = rows.replace(/^(\w)$/gm, (id) => `${id},1,0,0\n${id},2,${id.charCodeAt(0) - 90},0\n${id},3,1,2`);
    const { added } = await shapelex.addShapes(client, { path, ...shapelex.file(new File([table], "wings.csv")) });
    const query = { transformation: "similarity" };
    const { mean } = await shapelex.cohortMean(client, { path, query });
    const npy = await shapelex.cohortMean(client, { path, query, accept: "application/x-npy" });
    const lines = [];
    const body = { columns: ["external_id"] };
    for await (const row of await shapelex.computeTable(client, { path, body, accept: "application/x-ndjson" }))
      lines.push(row);
    return { added, points: mean.control_points.length, bytes: npy instanceof ArrayBuffer, lines: lines.length };
  }, server.url);
  assert.deepEqual(found, { added: 3, points: 3, bytes: true, lines: 3 });
});

test("events as they happen, a job, and its end", { skip }, async () => {
  const kinds = await page.evaluate(async (url) => {
    const shapelex = await import("/index.js");
    const client = shapelex.createClient({ url });
    const seen = [];
    const stop = new AbortController();
    let connected;
    const isConnected = new Promise((resolve) => (connected = resolve));
    const following = (async () => {
      const options = { query: { kind: "job_queued,job_succeeded" }, signal: stop.signal, onConnection: connected };
      for await (const { kind } of shapelex.listEvents(client, options)) {
        seen.push(kind);
        if (kind === "job_succeeded") return;
      }
    })();
    await isConnected;
    const method = { kind: "sparse", atoms: 4, nonzeros: 2, max_epochs: 5 };
    const body = { name: "atoms", cohort: "example-cells", transformation: "similarity", method };
    const answer = await shapelex.learnDictionary(client, { body });
    const result = await new shapelex.Job(client, answer).wait();
    await following;
    return [...seen, result.name];
  }, server.url);
  assert.deepEqual(kinds, ["job_queued", "job_succeeded", "atoms"]);
});

test("a refusal in the words of the service, and a service that is away", { skip }, async () => {
  const told = await page.evaluate(async (url) => {
    const shapelex = await import("/index.js");
    const representation = { kind: "landmarks", dimension: 2, points: 3 };
    const shapes = [
      {
        points: [
          [0, 0],
          [1, 0],
          [0, "a"],
        ],
      },
    ];
    const body = { representation, transformation: "similarity", shapes };
    const refused = await shapelex.mean(shapelex.createClient({ url }), { body }).catch((error) => error);
    const lost = await shapelex
      .listCohorts(shapelex.createClient({ url: "http://127.0.0.1:9", tries: 2 }))
      .catch((error) => error);
    return [refused.name, refused.status, refused.pointer, refused.index, refused.errors[0].detail, lost.name];
  }, server.url);
  const words = "expected a number, got a string";
  assert.deepEqual(told, ["Refusal", 422, "/shapes/0/points/2/1", 0, words, "Unreachable"]);
});
