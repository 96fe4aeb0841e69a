/** The client against the service. */
import assert from "node:assert/strict";
import { openAsBlob } from "node:fs";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import * as shapelex from "../dist/index.js";
import { Server } from "../dist/server.js";

const CELLS = fileURLToPath(new URL("../../../examples/cells/cells.ndjson", import.meta.url));
const representation = { kind: "closed_curve", dimension: 2, control_points: 16, generator: { name: "trigonometric" } };
const path = { cohort: "blobs" };
const similarity = { transformation: "similarity" };

/** Forty points of a contour, another one for every `k`. */
const blob = (k) =>
  Array.from({ length: 40 }, (_, i) => {
    const t = (2 * Math.PI * i) / 40;
    const r = 1 + 0.1 * Math.cos(3 * t + k) + 0.05 * Math.sin(k) * Math.sin(2 * t);
    return [2 * r * Math.cos(t), r * Math.sin(t)];
  });
const blobs = (count, from = 0) =>
  Array.from({ length: count }, (_, k) => ({
    external_id: `blob-${from + k}`,
    points: blob(from + k),
    labels: { site: k % 2 ? "zrh" : "gva", age: from + k },
  }));
const all = async (values) => {
  const found = [];
  for await (const value of values) found.push(value);
  return found;
};

let server;
let client;
before(async () => {
  server = await Server.start({ options: ["--threads=2"] });
  client = server.client();
  await shapelex.createCohort(client, { body: { name: "blobs", representation, correspondence: "arc_length" } });
  const added = await shapelex.addShapes(client, { path, body: { shapes: blobs(12) } });
  assert.equal(added.added, 12);
});
after(() => server?.stop());

test("a file, lines, bytes and a stream of bytes are stored", async () => {
  const body = { representation: { ...representation, control_points: 32 }, correspondence: "cyclic" };
  for (const name of ["file", "stream"]) await shapelex.createCohort(client, { body: { ...body, name } });
  const cells = new File([await openAsBlob(CELLS)], "cells.ndjson");
  const counts = { return: "none" };
  const ofFile = await shapelex.addShapes(client, {
    path: { cohort: "file" },
    query: counts,
    ...shapelex.file(cells, { closed: true }),
  });
  const ofStream = await shapelex.addShapes(client, {
    path: { cohort: "stream" },
    query: counts,
    body: cells.stream(),
    options: { name: "cells.ndjson", closed: true },
  });
  assert.deepEqual([ofFile.added, ofStream.added], [120, 120]);
  const lines = shapelex.ndjson(blobs(3, 20));
  const options = { path, body: lines, contentType: "application/x-ndjson" };
  assert.equal((await shapelex.addShapes(client, options)).added, 3);
  assert.equal((await shapelex.addShapes(client, options)).unchanged, 3);
});

test("lists, with conditions", async () => {
  const page = (cursor) => shapelex.listShapes(client, { path, query: { cursor, limit: 5, fields: "external_id" } });
  const names = (await all(shapelex.entries(page))).map(({ external_id }) => external_id);
  assert.equal(names.length, 15);
  assert.equal(new Set(names).size, 15);
  const query = { labels: { site: "zrh", age: { gte: 4, lt: 8 } } };
  const { items } = await shapelex.listShapes(client, { path, query });
  assert.deepEqual(
    items.map((shape) => shape.labels.age),
    [5, 7],
  );
});

test("the mean as JSON, as an array, as a drawing, as a picture", async () => {
  const made = await shapelex.cohortMean(client, { path, query: similarity });
  assert.equal(made.mean.control_points.length, 16);
  const npy = await shapelex.cohortMean(client, { path, query: similarity, accept: "application/x-npy" });
  assert.equal(new TextDecoder("latin1").decode(npy).slice(1, 6), "NUMPY");
  const arrow = await shapelex.findTable(client, { path, accept: "application/vnd.apache.arrow.stream" });
  assert.ok(arrow instanceof ArrayBuffer && arrow.byteLength > 100);
  const svg = await shapelex.cohortMean(client, { path, query: similarity, accept: "image/svg+xml" });
  assert.match(svg, /^<svg/);
  const png = await shapelex.cohortMean(client, { path, query: { ...similarity, width: 64 }, accept: "image/png" });
  assert.deepEqual([...new Uint8Array(png).slice(1, 4)], [80, 78, 71]);
  const tps = await shapelex.exportCohort(client, { path, query: { format: "tps" }, accept: "*/*" });
  assert.match(new TextDecoder().decode(tps), /LM=/i);
});

test("the table as values of NDJSON", async () => {
  const columns = { columns: ["external_id", "labels.age"] };
  const rows = await all(await shapelex.computeTable(client, { path, body: columns, accept: "application/x-ndjson" }));
  assert.equal(rows.length, 15);
  assert.equal(rows[3].external_id, "blob-3");
});

test("a job is waited for, told of, followed to its end; its events end by themselves", async () => {
  const method = { kind: "sparse", atoms: 4, nonzeros: 2, max_epochs: 30 };
  const body = { name: "atoms", cohort: "blobs", ...similarity, method };
  const answer = await shapelex.learnDictionary(client, { body });
  assert.ok(shapelex.isJob(answer), "a dictionary of atoms is a job");
  const job = new shapelex.Job(client, answer);
  const statuses = [];
  const [result, events] = await Promise.all([
    job.wait({ onProgress: ({ status }) => statuses.push(status) }),
    all(shapelex.jobEvents(client, { path: { job: job.id } })),
  ]);
  assert.equal(result.name, "atoms");
  assert.equal(job.status, "succeeded");
  assert.ok(statuses.every((status) => ["queued", "running"].includes(status)));
  assert.equal(events.at(-1).kind, "succeeded");
  assert.equal(events.at(-1).data.id, job.id);
  const learned = await shapelex.learnDictionary(client, {
    body: { name: "modes", cohort: "blobs", ...similarity, method: { kind: "functional_pca", components: 2 } },
    headers: { prefer: "wait=30" },
  });
  assert.equal((await shapelex.settle(client, learned)).name, "modes");
  const again = { name: "modes", cohort: "blobs", ...similarity, method: { kind: "functional_pca", components: 3 } };
  const { version, atoms } = await shapelex.learn(client, again);
  assert.deepEqual([version, atoms.length], [2, 3]);
  const same = await shapelex.learn(client, { ...again, only_if_changed: true });
  assert.equal(same.version, 2);
  const given = AbortSignal.abort(new Error("given up"));
  await assert.rejects(shapelex.learn(client, again, { signal: given }), /given up/);
});

test("a job that fails, and one that is cancelled", async () => {
  const alone = { name: "alone", representation, correspondence: "arc_length" };
  await shapelex.createCohort(client, { body: alone });
  const body = { name: "few", cohort: "alone", ...similarity, method: { kind: "functional_pca", components: 2 } };
  const refused = shapelex.learnDictionary(client, { body }).then((answer) => shapelex.settle(client, answer));
  await assert.rejects(refused, { status: 422 });
  const long = { kind: "sparse", atoms: 12, nonzeros: 3, max_epochs: 100_000, tolerance: 0 };
  const answer = await shapelex
    .learnDictionary(client, { body: { name: "long", cohort: "file", ...similarity, method: long } })
    .catch((error) => error);
  if (!shapelex.isJob(answer)) return assert.ok(answer instanceof shapelex.Refusal, String(answer));
  const job = new shapelex.Job(client, answer);
  await job.cancel();
  await assert.rejects(job.wait(), shapelex.JobCancelled);
});

test("events of the tenant, and the feed that they come from", async () => {
  const stop = new AbortController();
  const seen = [];
  const following = (async () => {
    const onConnection = (connected) => connected && seen.push("connected");
    const options = { query: { kind: "cohort_created" }, onConnection, signal: stop.signal };
    for await (const { kind, data } of shapelex.listEvents(client, options)) {
      seen.push(kind);
      assert.match(data.object, /^coh_/);
      return data.sequence;
    }
  })();
  while (!seen.length) await new Promise((resolve) => setTimeout(resolve, 10));
  await shapelex.createCohort(client, { body: { name: "seen", representation } });
  const sequence = await following;
  assert.deepEqual(seen, ["connected", "cohort_created"]);
  const feed = await all(shapelex.changes(client, sequence - 1));
  assert.equal(feed[0].sequence, sequence);
  const again = shapelex.listEvents(client, { lastEventId: String(sequence - 1), signal: stop.signal });
  assert.equal((await again.next()).value.data.sequence, sequence);
  const waiting = again.next();
  stop.abort();
  await assert.rejects(waiting, { name: "AbortError" });
});

test("an input that is refused: the words of the service, with the pointer and the index", async () => {
  const triangles = { kind: "landmarks", dimension: 2, points: 3 };
  const corners = [
    [0, 0],
    [1, 0],
    [0, 1],
  ];
  const shapes = [
    { points: corners },
    {
      points: [
        [0, 0],
        [1, 0],
        [0, "a"],
      ],
    },
  ];
  const refused = await shapelex
    .mean(client, { body: { representation: triangles, ...similarity, shapes } })
    .catch((error) => error);
  assert.ok(refused instanceof shapelex.Refusal);
  assert.deepEqual(
    { status: refused.status, code: refused.code, type: refused.type, pointer: refused.pointer, index: refused.index },
    {
      status: 422,
      code: "invalid-input",
      type: "urn:shapelex:problem:invalid-input",
      pointer: "/shapes/1/points/2/1",
      index: 1,
    },
  );
  assert.equal(refused.errors[0].detail, "expected a number, got a string");
  assert.ok(refused.title && refused.request_id && refused.message.includes("expected a number"));
  const unknown = shapelex.listShapes(client, { path, query: { limits: 5 } });
  await assert.rejects(unknown, ({ status, errors }) => status === 400 && errors[0].parameter === "limits");
  await assert.rejects(shapelex.findCohort(client, { path: { cohort: "nothing" } }), {
    status: 404,
    code: "not-found",
  });
});

test("versions: what is known is not sent again, and what has changed meanwhile is not overwritten", async () => {
  let etag;
  const found = await shapelex.findCohort(client, { path, onResponse: ({ headers }) => (etag = headers.get("etag")) });
  assert.equal(found.name, "blobs");
  const again = shapelex.findCohort(client, { path, headers: { "if-none-match": etag } });
  await assert.rejects(again, shapelex.NotModified);
  const old = { "If-Match": '"0"' };
  const changed = shapelex.updateCohort(client, { path, body: { description: "new" }, headers: old });
  await assert.rejects(changed, { status: 412 });
});
