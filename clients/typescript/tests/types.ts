/** What the types must say. It is compiled and never run: each `@ts-expect-error` is a fault that tsc has to find. */
import * as shapelex from "../src/index.js";

const { createClient } = shapelex;
const client = createClient();

type Camel<S extends string> = S extends `${infer A}_${infer B}` ? `${A}${Capitalize<Camel<B>>}` : S;
type Names = Camel<keyof shapelex.operations>;
type IsAny<T> = 0 extends 1 & T ? true : false;
/** Operations without a function, or whose function takes or gives anything. */
type Untyped = {
  [N in Names]: N extends keyof typeof shapelex
    ? (typeof shapelex)[N] extends (client: shapelex.Client, ...options: infer P) => infer R
      ? IsAny<Awaited<R>> extends true
        ? N
        : IsAny<P[0]> extends true
          ? N
          : never
      : N
    : N;
}[Names];
/** Is compiled only for an empty union. */
const none = <T extends never>(): T | undefined => undefined;
none<Untyped>();

const same = <A, B>(_: (<T>() => T extends A ? 1 : 2) extends <T>() => T extends B ? 1 : 2 ? true : false): void => {};
const path = { cohort: "cells" };

export async function answers(): Promise<void> {
  const query = { transformation: "similarity" } as const;
  const mean = await shapelex.cohortMean(client, { path, query });
  same<typeof mean, shapelex.Schemas["CohortMeanOutput"]>(true);
  const npy = await shapelex.cohortMean(client, { path, query, accept: "application/x-npy" });
  same<typeof npy, ArrayBuffer>(true);
  const svg = await shapelex.cohortMean(client, { path, query, accept: "image/svg+xml" });
  same<typeof svg, string>(true);
  const gone = await shapelex.deleteCohort(client, { path });
  same<typeof gone, undefined>(true);
  const learned = await shapelex.learnDictionary(client, {
    body: { name: "m", cohort: "c", transformation: "similarity", method: { kind: "functional_pca", components: 2 } },
  });
  const settled = await shapelex.settle(client, learned);
  same<typeof settled, Exclude<typeof learned, shapelex.JobDocument> | shapelex.Schemas["LearntDictionary"]>(true);
  if ("version" in settled) settled.version satisfies number;
  if ("dictionary" in settled) settled.dictionary satisfies string;
  const groups = { body: { cohort: "c", by: "labels.site" } };
  const compared = await shapelex.settle(client, shapelex.compare(client, groups));
  same<typeof compared, shapelex.Schemas["Comparison"]>(true);
  const drawn = await shapelex.settle(client, shapelex.compare(client, { ...groups, accept: "image/svg+xml" }));
  same<typeof drawn, string | shapelex.JobResult>(true);
  const lines = await shapelex.assessCohort(client, {
    path: { dictionary: "m" },
    body: { cohort: "c" },
    accept: "application/x-ndjson",
  });
  await shapelex.cohortMean(client, { path, query, headers: { "if-none-match": '"1"' } });
  if (!shapelex.isJob(lines)) for await (const line of lines) same<typeof line, unknown>(true);
  for await (const shape of shapelex.entries((cursor) => shapelex.listShapes(client, { path, query: { cursor } })))
    shape.external_id satisfies string | null | undefined;
  for await (const event of shapelex.listEvents(client))
    if (event.kind === "job_progress") event.data.progress satisfies number;
    else event.data.sequence satisfies number;
  (await shapelex.findVersion(client)).version satisfies string;
}

export async function faults(): Promise<void> {
  // @ts-expect-error: the cohort is missing
  await shapelex.findCohort(client);
  // @ts-expect-error: `transformation` is required
  await shapelex.cohortMean(client, { path });
  // @ts-expect-error: no such class
  await shapelex.cohortMean(client, { path, query: { transformation: "rotation" } });
  // @ts-expect-error: no such parameter
  await shapelex.listCohorts(client, { query: { page: 2 } });
  // @ts-expect-error: the operation does not answer in this form
  await shapelex.listCohorts(client, { accept: "image/png" });
  // @ts-expect-error: a form is asked for by `accept`
  await shapelex.cohortMean(client, { path, query: { transformation: "similarity", format: "npy" } });
  // @ts-expect-error: a picture has no JSON, so that a form must be named
  await shapelex.cohortSheet(client, { path });
  // @ts-expect-error: a dry run gives no dictionary
  await shapelex.learn(client, { name: "m", cohort: "c", dry_run: true });
  // @ts-expect-error: a fault of a body
  await shapelex.mean(client, { body: { shapes: "cells" } });
}
