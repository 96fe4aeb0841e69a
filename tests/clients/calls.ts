// Calls of the generated TypeScript client: whatever is wrong with the types is found by tsc, the rest by the assertions.
//
//     node built/calls.js ADDRESS KEY

import assert from "node:assert/strict";

import createClient from "openapi-fetch";

import type { components, paths } from "./shapelex.js";

type Representation = components["schemas"]["Representation"];
type ShapeInput = components["schemas"]["ShapeInput"];

const [baseUrl, key] = process.argv.slice(2);
// Without the second parameter, an answer might be a picture.
type Json = "application/json" | "application/problem+json";
const client = createClient<paths, Json>({ baseUrl, headers: { authorization: `Bearer ${key}` } });

/** Forty points of a contour, another one for every `k`. */
function blob(k: number): number[][] {
  return Array.from({ length: 40 }, (_, i) => {
    const t = (2 * Math.PI * i) / 40;
    const r = 1 + 0.1 * Math.cos(3 * t + k) + 0.05 * k * Math.sin(2 * t);
    return [2 * r * Math.cos(t), r * Math.sin(t)];
  });
}

/** A grid of eight by six points. */
function torus(): number[][][] {
  const angles = (n: number) => Array.from({ length: n }, (_, i) => (2 * Math.PI * i) / n);
  const point = (a: number, b: number) => {
    const r = 2 + Math.cos(b);
    return [r * Math.cos(a), r * Math.sin(a), Math.sin(b)];
  };
  return angles(8).map((a) => angles(6).map((b) => point(a, b)));
}

const curve: Representation = {
  kind: "closed_curve",
  dimension: 2,
  control_points: 12,
  generator: { name: "trigonometric" },
};
const cohort = await client.POST("/v1/cohorts", {
  params: {},
  body: { name: "typescript", representation: curve, correspondence: "arc_length", length_unit: "mm" },
});
assert(cohort.data, JSON.stringify(cohort.error));
const { representation } = cohort.data;
assert(representation.kind === "closed_curve" && representation.generator.name === "trigonometric");
assert.equal(representation.control_points, 12);

const shapes: ShapeInput[] = Array.from({ length: 12 }, (_, k) => ({
  external_id: `scan-${k}`,
  points: blob(k),
  label: k % 2 === 0 ? "even" : "odd",
  labels: { site: k < 4 ? "zrh" : "gva", age: k, healthy: k > 2 },
  metadata: { scanner: k },
}));
const path = { cohort: "typescript" };
const added = await client.POST("/v1/cohorts/{cohort}/shapes", { params: { path }, body: { shapes } });
assert.equal(added.data?.added, 12, JSON.stringify(added.error));

const page = await client.GET("/v1/cohorts/{cohort}/shapes", {
  params: { path, query: { labels: { site: "zrh" }, label: ["odd"], limit: 100 } },
});
assert(page.data, JSON.stringify(page.error));
assert.deepEqual(page.data.items.map((shape) => shape.external_id), ["scan-1", "scan-3"]);
const age: string | number | boolean | null | undefined = page.data.items[0]?.labels?.["age"];
assert.equal(age, 1);
assert.equal(page.data.next, null);

const mean = await client.GET("/v1/cohorts/{cohort}/mean", {
  params: { path, query: { transformation: "similarity" } },
});
assert.equal(mean.data?.mean.control_points.length, 12, JSON.stringify(mean.error));

const learn = (prefer?: string) =>
  client.POST("/v1/dictionaries", {
    params: { header: { prefer } },
    body: {
      name: "typescript-modes",
      cohort: "typescript",
      transformation: "similarity",
      method: { kind: "functional_pca", components: 2, centre: true },
    },
  });
const waited = await learn("wait=60");
assert.equal(waited.response.status, 201, JSON.stringify(waited.error));
assert(waited.data && "atoms" in waited.data && waited.data.method.kind === "functional_pca");

const started = await learn();
assert(started.data && "status" in started.data, JSON.stringify(started.error));
let job: components["schemas"]["JobOutput"] = started.data;
for (const end = Date.now() + 60_000; job.status === "queued" || job.status === "running"; ) {
  assert(Date.now() < end, JSON.stringify(job));
  await new Promise((resolve) => setTimeout(resolve, 50));
  const found = await client.GET("/v1/jobs/{job}", { params: { path: { job: job.id } } });
  assert(found.data, JSON.stringify(found.error));
  job = found.data;
}
assert(job.result && "name" in job.result, JSON.stringify(job));
const name: string = job.result.name;
assert.equal(name, "typescript-modes");

const dictionary = { dictionary: "typescript-modes" };
const assessed = await client.POST("/v1/dictionaries/{dictionary}/assess", {
  params: { path: dictionary },
  body: { shapes: [{ points: blob(3) }, { points: blob(5) }] },
});
assert(assessed.data, JSON.stringify(assessed.error));
const first = assessed.data.results[0];
assert(first && !("error" in first) && !first.novelty.is_outlier, JSON.stringify(first));

const partly = await client.POST("/v1/dictionaries/{dictionary}/assess", {
  params: { path: dictionary, query: { on_error: "skip" } },
  body: { shapes: [{ points: [[0, 0]], external_id: "dot" }, { points: blob(5) }] },
});
const bad = partly.data?.results[0];
assert(bad && "error" in bad && bad.external_id === "dot", JSON.stringify(partly.error));
assert.equal(bad.error.code, "invalid-input");

const mode = await client.GET("/v1/dictionaries/{dictionary}/modes", {
  params: { path: dictionary, query: { component: 2, sigma: 1.5 } },
});
assert.equal(mode.data?.sigma, 1.5, JSON.stringify(mode.error));

// The generators of a surface are optional, and its points are a grid.
const measured = await client.POST("/v1/measure", {
  params: {},
  body: {
    representation: { kind: "surface", topology: "torus", control_points: [8, 6] },
    shapes: [{ points: torus() }],
  },
});
const body = measured.data?.results[0];
assert(body && "volume" in body && typeof body.volume === "number", JSON.stringify(measured.error));
assert(Math.abs(body.volume / (4 * Math.PI ** 2) - 1) < 0.05, `volume ${body.volume}`);

const missing = await client.GET("/v1/dictionaries/{dictionary}", { params: { path: { dictionary: "nothing" } } });
assert.equal(missing.response.status, 404);
assert.equal(missing.error?.code, "not-found");

const refused = await client.POST("/v1/dictionaries/{dictionary}/assess", {
  params: { path: dictionary },
  body: { shapes: [{ points: blob(1) }, { points: [[0, 0]] }] },
});
assert.equal(refused.response.status, 422);
assert(refused.error?.errors[0]?.pointer?.startsWith("/shapes/1"), JSON.stringify(refused.error));
console.log("clients: the calls in TypeScript are right");
