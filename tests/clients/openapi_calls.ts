// Calls of the TypeScript client that openapi-generator writes: wrong types are found by tsc, the rest by the assertions.
//
//     node built/openapi_calls.js ADDRESS KEY

import assert from "node:assert/strict";

import { CohortsApi, Configuration, DictionariesApi } from "./openapi/index.js";
import type { ShapeInput } from "./openapi/index.js";

const [basePath, accessToken] = process.argv.slice(2);
const configuration = new Configuration({ basePath, accessToken });
const [cohorts, dictionaries] = [new CohortsApi(configuration), new DictionariesApi(configuration)];

/** Forty points of a contour, another one for every `k`. */
function blob(k: number): number[][] {
  return Array.from({ length: 40 }, (_, i) => {
    const t = (2 * Math.PI * i) / 40;
    const r = 1 + 0.1 * Math.cos(3 * t + k) + 0.05 * k * Math.sin(2 * t);
    return [2 * r * Math.cos(t), r * Math.sin(t)];
  });
}

const made = await cohorts.createCohort({
  cohortRequest: {
    name: "openapi-typescript",
    representation: { kind: "closed_curve", dimension: 2, control_points: 12, generator: { name: "trigonometric" } },
    correspondence: "arc_length",
  },
});
assert.equal(made.status, 201);

const shapes: ShapeInput[] = Array.from({ length: 12 }, (_, k) => ({
  external_id: `scan-${k}`,
  points: blob(k),
  label: k % 2 === 0 ? "even" : "odd",
  labels: { site: k < 4 ? "zrh" : "gva", age: k },
}));
const cohort = "openapi-typescript";
const added = await cohorts.addShapes({ cohort, addRequest: { shapes } });
assert.equal(added.data.added, 12);

// The generator writes the entries of a map as parameters by their names: these hold the brackets. Or as a list of texts.
for (const filter of [{ labels: { "labels[site]": "zrh" } }, { condition: ["labels.site=zrh"] }]) {
  const page = await cohorts.listShapes({ cohort, ...filter, label: ["odd"], limit: 100 });
  assert.deepEqual(page.data.items.map((shape) => shape.external_id), ["scan-1", "scan-3"]);
  assert.equal(page.data.items[0]?.labels?.["age"], 1);
}

const missing = await dictionaries.findDictionary({ dictionary: "nothing" }).catch((error) => error.response);
assert.equal(missing.status, 404);
assert.equal(missing.data.code, "not-found");
console.log("clients: the calls in TypeScript by openapi-generator are right");
