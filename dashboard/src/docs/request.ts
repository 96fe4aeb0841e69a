/** A request as it was filled in: for the browser to send, and for a program to repeat. */
import { flat, type Operation, type Parameter, resolve } from "./document";

export interface Filled {
  /** Values of parameters by place and name, as typed. */
  values: Record<string, string>;
  /** Media type of the body, and its text; or the texts of the parts of a form. */
  type: string;
  text: string;
  parts: Record<string, string>;
  /** Files by the name of their part; of a whole body by "". */
  files: Record<string, File | undefined>;
  accept: string;
}

/** The key is kept in memory: a reload forgets it. */
let key = "";
export const setKey = (value: string): void => void (key = value.trim());
export const currentKey = (): string => key;

export const slot = ({ in: place, name }: Parameter): string => `${place} ${name}`;
export const isForm = (type: string): boolean => type.startsWith("multipart/");
export const isBinary = (schema: Parameters<typeof resolve>[0]): boolean => resolve(schema).schema.format === "binary";
export const partsOf = (operation: Operation, type: string) =>
  Object.entries(flat(operation.body?.content[type]?.schema).properties ?? {});

function queryOf(parameter: Parameter, value: string): [string, string][] {
  const { name, style, schema } = parameter;
  if (style === "deepObject") return [...new URLSearchParams(value)].map(([part, one]) => [`${name}.${part}`, one]);
  const isList = [resolve(schema).schema.type].flat().includes("array");
  return isList ? value.split(",").map((one) => [name, one.trim()]) : [[name, value]];
}

export function urlOf({ path, parameters }: Operation, { values }: Filled): string {
  const filled = path.replace(/\{(\w+)\}/g, (whole, name: string) => {
    const value = values[`path ${name}`];
    return value ? encodeURIComponent(value) : whole;
  });
  const given = parameters.filter((one) => one.in === "query" && values[slot(one)]);
  const query = new URLSearchParams(given.flatMap((one) => queryOf(one, values[slot(one)]!)));
  return filled + (query.size ? `?${query}` : "");
}

function headersOf({ parameters, body }: Operation, { values, type, accept }: Filled): [string, string][] {
  const given = parameters.filter((one) => one.in === "header" && values[slot(one)]);
  return [
    ...(accept ? [["accept", accept] as [string, string]] : []),
    // The browser writes that of a form itself, with its boundary.
    ...(body && type && !isForm(type) ? [["content-type", type] as [string, string]] : []),
    ...given.map((one): [string, string] => [one.name, values[slot(one)]!]),
  ];
}

function bodyOf(operation: Operation, { type, text, parts, files }: Filled): BodyInit | undefined {
  if (!operation.body) return undefined;
  if (!isForm(type)) return files[""] ?? (text || undefined);
  const form = new FormData();
  for (const [name, schema] of partsOf(operation, type)) {
    if (!isBinary(schema)) form.append(name, new Blob([parts[name] ?? ""], { type: "application/json" }));
    else if (files[name]) form.append(name, files[name]);
  }
  return form;
}

export function ask(operation: Operation, filled: Filled, signal: AbortSignal): Promise<Response> {
  const authorization = key ? [["authorization", `Bearer ${key}`] as [string, string]] : [];
  return fetch(urlOf(operation, filled), {
    method: operation.method,
    headers: [...headersOf(operation, filled), ...authorization],
    body: bodyOf(operation, filled),
    credentials: "omit",
    signal,
  });
}

const quote = (text: string): string => `'${text.replaceAll("'", "'\\''")}'`;

/** The request in the words of `curl`. The key is named, never written out. */
export function curl(operation: Operation, filled: Filled, withKey: boolean): string {
  const { type, text, parts, files } = filled;
  const lines = [`curl -X ${operation.method} ${quote(location.origin + urlOf(operation, filled))}`];
  if (withKey) lines.push('-H "authorization: Bearer $SHAPELEX_KEY"');
  lines.push(...headersOf(operation, filled).map(([name, value]) => `-H ${quote(`${name}: ${value}`)}`));
  if (operation.body && isForm(type)) {
    for (const [name, schema] of partsOf(operation, type)) {
      if (!isBinary(schema)) lines.push(`-F ${quote(`${name}=${parts[name] ?? ""};type=application/json`)}`);
      else if (files[name]) lines.push(`-F ${quote(`${name}=@${files[name].name}`)}`);
    }
  } else if (operation.body) {
    if (files[""]) lines.push(`--data-binary ${quote(`@${files[""].name}`)}`);
    else if (text) lines.push(`-d ${quote(text)}`);
  }
  return lines.join(" \\\n  ");
}
