/** Addresses: paths with their values, and queries. */
import { ShapelexError } from "./errors.js";
import type { Query } from "./types.js";

/** A path of the document with its values. `missing` stands for a value that is not there, which is an error otherwise. */
export function fill(path: string, values: { [name: string]: unknown } = {}, missing?: string): string {
  return path.replace(/\{(\w+)\}/g, (_, name: string) => {
    const value = String(values[name] ?? "") || missing;
    if (value === undefined) throw new ShapelexError(`expected a value of ${name} in ${path}, got none`);
    return encodeURIComponent(value);
  });
}

type Pair = [name: string, value: unknown];

/** The values that are there. */
export const present = (values: object = {}): Pair[] =>
  Object.entries(values).filter(([, value]) => value !== undefined && value !== null);

/** Conditions with their operators by dots: `{ age: { gte: 30 } }` as `age.gte`. */
const dotted = (conditions: object): Pair[] =>
  present(conditions).flatMap(([name, value]) =>
    typeof value === "object"
      ? present(value!).map(([operator, bound]): Pair => [`${name}.${operator}`, bound])
      : [[name, value]],
  );

const pairs = ([name, value]: Pair): Pair[] =>
  Array.isArray(value)
    ? value.map((entry) => [name, entry])
    : typeof value === "object"
      ? dotted(value!).map(([key, bound]) => [`${name}[${key}]`, bound])
      : [[name, value]];

/** A query with its question mark, or nothing: lists repeat a name, maps are written with brackets, `labels[age.gte]=30`. */
export function search(query: Query | URLSearchParams = {}): string {
  const texts = () =>
    present(query)
      .flatMap(pairs)
      .map(([name, value]) => [name, String(value)]);
  const text = String(query instanceof URLSearchParams ? query : new URLSearchParams(texts()));
  return text && `?${text}`;
}

/** Parameters of the query that are fields of a JSON body: texts as they are, anything else as JSON. */
export const fields = (options: Record<string, unknown> = {}): Query =>
  Object.fromEntries(
    present(options).map(([name, value]) => [name, typeof value === "string" ? value : JSON.stringify(value)]),
  );
