/** The generated part against the OpenAPI document. */
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import * as shapelex from "../dist/index.js";
import * as operations from "../dist/operations.js";
import { camel, operationsOf } from "../generate.mjs";

const DOCUMENT = JSON.parse(readFileSync(new URL("../../../openapi/openapi.json", import.meta.url), "utf8"));
const all = operationsOf(DOCUMENT);

test("every operation has its function, and there is no other one", () => {
  const counted = Object.values(DOCUMENT.paths).reduce((sum, item) => sum + Object.keys(item).length, 0);
  assert.ok(counted > 100);
  assert.equal(all.length, counted);
  assert.deepEqual(Object.keys(operations).sort(), all.map(({ entry }) => camel(entry.operationId)).sort());
  for (const name of Object.keys(operations)) assert.equal(shapelex[name], operations[name], name);
});

/** Calls a function without a service, and tells what it would have sent. */
async function sentBy(name, path, body) {
  let sent;
  const fetch = async (url, init) => {
    sent = { url, ...init };
    return new Response(null, { status: 204 });
  };
  const client = { url: "", fetch };
  const values = Object.fromEntries([...path.matchAll(/\{(\w+)\}/g)].map(([, part]) => [part, `a/${part}`]));
  const made = operations[name](client, { path: values, body });
  await (made[Symbol.asyncIterator] ? made.next() : made);
  return sent;
}

test("functions send the method, the path and the media types of the document", async () => {
  for (const { method, path, entry } of all) {
    const content = Object.keys(entry.requestBody?.content ?? {});
    const body = content.includes("application/json") ? {} : content.length ? new Blob(["x"]) : undefined;
    const sent = await sentBy(camel(entry.operationId), path, body);
    assert.equal(sent.method.toLowerCase(), method, entry.operationId);
    assert.equal(sent.url, path.replace(/\{(\w+)\}/g, "a%2F$1"), entry.operationId);
    const keyed = entry.parameters?.some(({ name }) => name === "Idempotency-Key") ?? false;
    assert.equal(sent.headers.has("idempotency-key"), keyed, entry.operationId);
    assert.equal(sent.repeatable, keyed || ["get", "put"].includes(method) || entry["x-role"] === "reader");
    if (content.includes("application/json")) assert.equal(sent.headers.get("content-type"), "application/json");
  }
});

test("every schema has its type", () => {
  const text = readFileSync(new URL("../schema.d.ts", import.meta.url), "utf8");
  const missing = Object.keys(DOCUMENT.components.schemas).filter((name) => !text.includes(`        ${name}: `));
  assert.deepEqual(missing, []);
});
