/** How requests are written, sent and sent again, against a service that answers as a test says. */
import assert from "node:assert/strict";
import { test } from "node:test";
import * as shapelex from "../dist/index.js";
import { fake, JSON_TYPE, json, problem } from "./fake.mjs";

const { createClient } = shapelex;
const soon = { "retry-after": "0" };
const lines = [{ points: [[0, 0]] }, { points: [[1, 1]] }];

async function against(answers, then, options) {
  const service = await fake(...answers);
  try {
    await then(createClient({ url: `${service.url}/`, ...options }), service);
  } finally {
    await service.stop();
  }
}
const statuses = (promise) =>
  promise.then(
    (value) => value,
    (error) => error,
  );

test("a busy service is asked again, with one key for what changes something", () =>
  against(
    [problem(503, "overloaded", soon), problem(429, "too-many-requests", soon), json({}, 201)],
    async (client, { asked }) => {
      await shapelex.createCohort(client, { body: { name: "a" } });
      const keys = asked.map(({ headers }) => headers["idempotency-key"]);
      assert.equal(keys.length, 3);
      assert.match(keys[0], /^[0-9a-f]{32}$/);
      assert.equal(new Set(keys).size, 1);
      assert.deepEqual(new Set(asked.map(({ body }) => body)), new Set(['{"name":"a"}']));
    },
  ));

test("keys of the caller are kept", () =>
  against([json({}, 201)], async (client, { asked }) => {
    await shapelex.createCohort(client, { body: { name: "a" }, headers: { "Idempotency-Key": "import-17" } });
    assert.equal(asked[0].headers["idempotency-key"], "import-17");
  }));

test("what would be refused again is not repeated", async () => {
  for (const [status, code] of [
    [503, "took-too-long"],
    [422, "invalid-input"],
    [409, "name-taken"],
  ])
    await against([problem(status, code, soon)], async (client, { asked }) => {
      await assert.rejects(shapelex.createCohort(client, { body: { name: "a" } }), { code, status });
      assert.equal(asked.length, 1);
    });
});

test("an answer that got lost is asked for again where that does no harm", async () => {
  await against([null, json({ items: [] })], async (client, { asked }) => {
    await shapelex.listCohorts(client);
    assert.equal(asked.length, 2);
  });
  await against([null, json({})], async (client, { asked }) => {
    const lost = await statuses(shapelex.createKey(client, { body: { name: "a", role: "reader" } }));
    assert.ok(lost instanceof shapelex.Unreachable, String(lost));
    assert.equal(asked.length, 1);
  });
  await against([[502, {}, "<html>"], json({ items: [] })], async (client, { asked }) => {
    await shapelex.listCohorts(client);
    assert.equal(asked.length, 2);
  });
});

test("tries are bounded, and the last refusal is told with its seconds", () =>
  against(
    [problem(503, "overloaded", soon)],
    async (client, { asked }) => {
      await assert.rejects(shapelex.listCohorts(client), { name: "Refusal", status: 503, retryAfter: 0 });
      assert.equal(asked.length, 3);
    },
    { tries: 3 },
  ));

test("no service at the address", async () => {
  const { url, stop } = await fake([200]);
  await stop();
  const lost = await statuses(
    shapelex.createKey(createClient({ url, tries: 2 }), { body: { name: "a", role: "reader" } }),
  );
  assert.ok(lost instanceof shapelex.Unreachable);
  assert.equal(lost.message, `POST ${url}/v1/keys: ECONNREFUSED`);
});

test("a proxy that answers without a problem document", () =>
  against([[404, { "content-type": "text/html" }, "<h1>nothing"]], (client) =>
    assert.rejects(shapelex.listCohorts(client), { status: 404, code: "unknown", message: "Not Found" }),
  ));

test("a key goes into a header, and a function renews it", async () => {
  await against(
    [json({ items: [] })],
    async (client, { asked }) => {
      await shapelex.listCohorts(client);
      assert.equal(asked[0].headers.authorization, "Bearer shk_one");
    },
    { key: "shk_one" },
  );
  const refusals = [];
  const key = async (refused) => {
    refusals.push([...refused]);
    return `token-${refused.length}`;
  };
  await against(
    [problem(401, "unauthenticated"), json({ items: [] })],
    async (client, { asked }) => {
      await shapelex.listCohorts(client);
      assert.deepEqual(
        asked.map(({ headers }) => headers.authorization),
        ["Bearer token-0", "Bearer token-1"],
      );
      assert.deepEqual(refusals, [[], ["token-0"]]);
    },
    { key },
  );
  await against(
    [problem(401, "unauthenticated")],
    async (client, { asked }) => {
      await assert.rejects(shapelex.listCohorts(client), { status: 401 });
      assert.equal(asked.length, 3);
    },
    { key },
  );
  await against(
    [problem(401, "unauthenticated")],
    async (client, { asked }) => {
      await assert.rejects(shapelex.listCohorts(client), { status: 401 });
      assert.equal(asked.length, 1);
    },
    { key: () => "always the same" },
  );
});

test("queries: lists repeat a name, conditions have brackets, what is not there is left out", () =>
  against([json({ items: [] })], async (client, { asked }) => {
    const query = {
      limit: 5,
      cursor: undefined,
      label: ["a", "b&c"],
      labels: { site: "zrh", age: { gte: 30, lt: 60 }, name: "" },
    };
    await shapelex.listShapes(client, { path: { cohort: "my cells/2" }, query });
    const { pathname, searchParams } = new URL(asked[0].url, "http://a");
    assert.equal(pathname, "/v1/cohorts/my%20cells%2F2/shapes");
    assert.deepEqual(
      [...searchParams],
      [
        ["limit", "5"],
        ["label", "a"],
        ["label", "b&c"],
        ["labels[site]", "zrh"],
        ["labels[age.gte]", "30"],
        ["labels[age.lt]", "60"],
        ["labels[name]", ""],
      ],
    );
  }));

test("a value of the path that is missing is told before anything is sent", () =>
  against([json({})], async (client, { asked }) => {
    for (const shape of ["", undefined])
      await assert.rejects(
        shapelex.deleteShape(client, { path: { cohort: "a", shape } }),
        /expected a value of shape in \/v1\/cohorts\/\{cohort\}\/shapes\/\{shape\}, got none/,
      );
    assert.equal(asked.length, 0);
  }));

test("files go as they are, with their names and options in the query", () =>
  against([json({}, 201)], async (client, { asked }) => {
    const csv = new File(["x,y\n"], "wings.csv", { type: "text/csv" });
    const path = { cohort: "a" };
    await shapelex.addShapes(client, { path, ...shapelex.file(csv, { closed: true, names: ["a"], prefix: "p" }) });
    await shapelex.addShapes(client, { path, body: shapelex.ndjson(lines), contentType: "application/x-ndjson" });
    await shapelex.addShapes(client, { path, body: new Uint8Array([65, 66]) });
    await shapelex.addShapes(client, { path, body: new Blob(["streamed"]).stream() });
    assert.deepEqual(
      asked.map(({ body }) => body),
      ["x,y\n", '{"points":[[0,0]]}\n{"points":[[1,1]]}\n', "AB", "streamed"],
    );
    assert.equal(asked[0].url, "/v1/cohorts/a/shapes?name=wings.csv&closed=true&names=%5B%22a%22%5D&prefix=p");
    assert.deepEqual(
      asked.map(({ headers }) => headers["content-type"]),
      ["application/octet-stream", "application/x-ndjson", "application/octet-stream", "application/octet-stream"],
    );
  }));

test("a stream is sent once", () =>
  against([problem(503, "overloaded", soon)], async (client, { asked }) => {
    await assert.rejects(shapelex.inspectFile(client, { body: new Blob(["x"]).stream() }), { status: 503 });
    assert.equal(asked.length, 1);
  }));

test("forms: the document first, then the files", () =>
  against([json({})], async (client, { asked }) => {
    await shapelex.segment(client, { body: { image: new Blob(["PNG"]), parameters: { a: 1 }, truth: null } });
    const [{ body, headers }] = asked;
    assert.match(headers["content-type"], /^multipart\/form-data; boundary=/);
    assert.match(body, /name="parameters".*application\/json.*\{"a":1\}.*name="image"; filename="image".*PNG/s);
    assert.ok(!body.includes("truth"));
  }));

test("answers by media type: values of NDJSON one after the other, texts, bytes, nothing", async () => {
  const path = { dictionary: "d" };
  const body = { shapes: [] };
  const of = (type, text) => [200, { "content-type": type }, text];
  await against(
    [
      of("application/x-ndjson", '{"a":"\u2028é"}\n{"a":2}'),
      of("text/csv; charset=utf-8", "a,b"),
      of("application/x-npy", "NUMPY"),
      [204],
    ],
    async (client, { asked }) => {
      const found = [];
      for await (const value of await shapelex.score(client, { path, body, accept: "application/x-ndjson" }))
        found.push(value);
      assert.deepEqual(found, [{ a: "\u2028é" }, { a: 2 }]);
      assert.equal(await shapelex.score(client, { path, body, accept: "text/csv" }), "a,b");
      const bytes = await shapelex.score(client, { path, body, accept: "application/x-npy" });
      assert.equal(new TextDecoder().decode(bytes), "NUMPY");
      assert.equal(await shapelex.deleteDictionary(client, { path }), undefined);
      assert.deepEqual(
        asked.map(({ headers }) => headers.accept),
        ["application/x-ndjson", "text/csv", "application/x-npy", "application/json"],
      );
    },
  );
});

test("an answer that is known, and headers of answers", () =>
  against([json({}, 200, { etag: '"7"' }), [304]], async (client) => {
    let etag;
    const path = { cohort: "a" };
    await shapelex.findCohort(client, { path, onResponse: ({ headers }) => (etag = headers.get("etag")) });
    const again = shapelex.findCohort(client, { path, headers: { "if-none-match": etag } });
    await assert.rejects(again, shapelex.NotModified);
  }));

test("requests, and pauses between tries, are given up", () =>
  against([problem(503, "overloaded", { "retry-after": "20" })], async (client) => {
    const began = performance.now();
    const given = shapelex.listCohorts(client, { signal: AbortSignal.timeout(50) });
    await assert.rejects(given, { name: "TimeoutError" });
    assert.ok(performance.now() - began < 10_000);
  }));

test("lists, page after page, and the feed of changes", async () => {
  await against([json({ items: [1, 2], next: "b" }), json({ items: [3], next: null })], async (client, { asked }) => {
    const found = [];
    for await (const entry of shapelex.entries((cursor) => shapelex.listJobs(client, { query: { cursor, limit: 2 } })))
      found.push(entry);
    assert.deepEqual(found, [1, 2, 3]);
    assert.deepEqual(
      asked.map(({ url }) => url),
      ["/v1/jobs?limit=2", "/v1/jobs?cursor=b&limit=2"],
    );
  });
  await against(
    [json({ items: ["a"], next: 7, done: false }), json({ items: ["b"], next: 9, done: true })],
    async (client, { asked }) => {
      const found = [];
      for await (const entry of shapelex.changes(client, 5)) found.push(entry);
      assert.deepEqual(found, ["a", "b"]);
      assert.deepEqual(
        asked.map(({ url }) => url),
        ["/v1/changes?since=5", "/v1/changes?since=7"],
      );
    },
  );
});

test("events go on after the last position when the connection is lost", async () => {
  const stream = { "content-type": "text/event-stream" };
  const first = [
    200,
    stream,
    ': position\nid: 41\n\nevent: shapes_added\nid: 42\ndata: {"sequence":42,\ndata: "kind":"shapes_added"}\n\nevent: job_pro',
  ];
  const second = [200, stream, ': position\r\nid: 45\r\n\r\nevent: job_progress\r\ndata: {"progress":0.5}\r\n\r\n'];
  await against([first, second, problem(410, "changes-gone")], async (client, { asked }) => {
    const events = [];
    const told = [];
    const following = async () => {
      const options = { lastEventId: "40", onConnection: (is) => told.push(is), onPosition: (id) => told.push(id) };
      for await (const event of shapelex.listEvents(client, { query: { kind: "shapes_added" }, ...options }))
        events.push(event);
    };
    await assert.rejects(following(), { code: "changes-gone" });
    assert.deepEqual(events, [
      { kind: "shapes_added", data: { sequence: 42, kind: "shapes_added" }, id: "42" },
      { kind: "job_progress", data: { progress: 0.5 }, id: undefined },
    ]);
    assert.deepEqual(
      asked.map(({ headers }) => headers["last-event-id"]),
      ["40", "42", "45"],
    );
    assert.deepEqual(told, [true, "41", "42", false, true, "45", false, false]);
    assert.equal(asked[0].url, "/v1/events?kind=shapes_added");
  });
  await against([[204]], async (client) => {
    for await (const _ of shapelex.jobEvents(client, { path: { job: "j" } })) assert.fail("a job that has ended");
  });
});

test("a job that failed keeps its problem, one that was cancelled says so", async () => {
  const job = { id: "job_1", kind: "learn", attempt: 1, progress: 0.5, status: "running" };
  const failed = {
    ...job,
    status: "failed",
    problem: { status: 422, code: "too-few-shapes", title: "t", detail: "expected two, got one", errors: [] },
  };
  await against([json(job, 202), json(job), json(failed)], async (client) => {
    const seen = [];
    const answer = await shapelex.learnDictionary(client, { body: {} });
    const waited = shapelex.settle(client, answer, { onProgress: ({ progress }) => seen.push(progress) });
    await assert.rejects(waited, { name: "JobFailed", code: "too-few-shapes", message: "expected two, got one" });
    assert.deepEqual(seen, [0.5, 0.5]);
  });
  await against([json({ ...job, status: "cancelled" })], async (client) => {
    await assert.rejects(new shapelex.Job(client, job).wait(), shapelex.JobCancelled);
  });
  await against([json(job)], async (client) => {
    const waited = new shapelex.Job(client, job).wait({ signal: AbortSignal.timeout(30) });
    await assert.rejects(waited, { name: "TimeoutError" });
  });
  assert.equal(await shapelex.settle(createClient(), 5), 5);
  await against([json({ ...job, status: "succeeded", result: { count: 3 } })], async (client) => {
    const begun = Promise.resolve(job);
    assert.deepEqual(await shapelex.settle(client, begun), { count: 3 });
  });
  assert.equal(JSON_TYPE["content-type"], "application/json");
});
