/** Bodies that are files. */
import type { Raw } from "./types.js";

/** Values as NDJSON, to be sent with `contentType: "application/x-ndjson"`. */
export const ndjson = (values: Iterable<unknown>): Blob =>
  new Blob(
    Array.from(values, (value) => `${JSON.stringify(value)}\n`),
    { type: "application/x-ndjson" },
  );

/** A file as a body, its name with the other options of reading: what a call takes as `body` and `options`. */
export const file = (
  body: Raw,
  options: Record<string, unknown> = {},
): { body: Raw; options: Record<string, unknown> } => ({
  body,
  options: { name: (body as { name?: string }).name, ...options },
});
