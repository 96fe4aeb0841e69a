/** Filters in addresses: the grammar of the API itself (docs/tables.md), so that a link is a query. */
import type { Schemas } from "../api/client";

const isCondition = (name: string) =>
  /^(label|subject|external_id|created_at|has)(\.(eq|ne|gte|gt|lte|lt))?$/.test(name) ||
  /^(labels|measures)\./.test(name);

export function filterOf(query: URLSearchParams): URLSearchParams {
  const filter = new URLSearchParams();
  for (const [name, value] of query) if (isCondition(name)) filter.append(name, value);
  return filter;
}

/** The same filter as an object of a body. */
export function filterBody(filter: URLSearchParams): Schemas["ShapeFilter"] | undefined {
  if (!filter.size) return undefined;
  const body: Record<string, unknown> = {};
  const put = (into: Record<string, unknown>, name: string, operator: string | undefined, value: string) => {
    const number = operator && value.trim() !== "" && Number.isFinite(Number(value)) ? Number(value) : value;
    if (operator && operator !== "eq") into[name] = { ...(into[name] as object | undefined), [operator]: number };
    else into[name] = name in into ? [into[name], value].flat() : value;
  };
  for (const [name, value] of filter) {
    const [, group, rest] = /^(labels|measures)\.(.+)$/.exec(name) ?? [];
    const bare = rest ?? name;
    const [, field, operator] = /^(.*?)(?:\.(eq|ne|gte|gt|lte|lt))?$/.exec(bare)!;
    if (group) put((body[group] ??= {}) as Record<string, unknown>, field!, operator, value);
    else if (name === "has") body.has = [...((body.has as string[] | undefined) ?? []), value];
    else put(body, field!, operator, value);
  }
  return body as Schemas["ShapeFilter"];
}

/** The address with one value of a condition added or taken away. */
export function toggled(query: URLSearchParams, name: string, value: string): string {
  const next = new URLSearchParams();
  let had = false;
  for (const [key, old] of query) {
    if (key === name && old === value) had = true;
    else if (key !== "cursor") next.append(key, old);
  }
  if (!had) next.append(name, value);
  return `${location.pathname}${next.size ? `?${next}` : ""}`;
}

export function bounded(query: URLSearchParams, name: string, value: string): string {
  const next = new URLSearchParams(query);
  next.delete("cursor");
  if (value === "") next.delete(name);
  else next.set(name, value);
  return `${location.pathname}${next.size ? `?${next}` : ""}`;
}

export function withFilter(path: string, query: URLSearchParams): string {
  const filter = filterOf(query);
  return filter.size ? `${path}?${filter}` : path;
}
