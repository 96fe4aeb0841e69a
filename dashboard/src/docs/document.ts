/** The OpenAPI document, as far as the reference shows it: operations, and schemas in words. */

export interface Schema {
  $ref?: string;
  type?: string | string[];
  title?: string;
  description?: string;
  format?: string;
  contentMediaType?: string;
  properties?: Record<string, Schema>;
  required?: string[];
  items?: Schema;
  additionalProperties?: Schema | boolean;
  oneOf?: Schema[];
  anyOf?: Schema[];
  allOf?: Schema[];
  enum?: unknown[];
  const?: unknown;
  default?: unknown;
  example?: unknown;
  examples?: unknown[];
  discriminator?: { propertyName: string; mapping?: Record<string, string> };
  minimum?: number;
  maximum?: number;
  exclusiveMinimum?: number;
  exclusiveMaximum?: number;
  minItems?: number;
  maxItems?: number;
}

export interface Parameter {
  name: string;
  in: "path" | "query" | "header";
  required?: boolean;
  description?: string;
  schema: Schema;
  style?: string;
  example?: unknown;
}

export interface Media {
  schema?: Schema;
  example?: unknown;
}

export interface Answer {
  description: string;
  headers?: Record<string, { description?: string; schema?: Schema }>;
  content?: Record<string, Media>;
}

export interface Operation {
  id: string;
  method: string;
  path: string;
  tag: string;
  summary: string;
  description?: string;
  role: string;
  parameters: Parameter[];
  body?: { required?: boolean; content: Record<string, Media> };
  responses: Record<string, Answer>;
  /** What the search looks through, in lower case. */
  text: string;
}

interface Written {
  operationId: string;
  tags: string[];
  summary: string;
  description?: string;
  parameters?: Parameter[];
  requestBody?: Operation["body"];
  responses: Operation["responses"];
  "x-role": string;
}

export interface Document {
  info: { title: string; description?: string; version: string };
  tags?: { name: string; description?: string }[];
  paths: Record<string, Record<string, Written>>;
  components: { schemas: Record<string, Schema>; securitySchemes?: Record<string, { description?: string }> };
}

let schemas: Record<string, Schema> = {};

export function operationsOf(document: Document): Operation[] {
  schemas = document.components.schemas;
  return Object.entries(document.paths).flatMap(([path, methods]) =>
    Object.entries(methods).map(([method, one]) => operation(method.toUpperCase(), path, one)),
  );
}

function operation(method: string, path: string, one: Written): Operation {
  const parameters = one.parameters ?? [];
  const fields = Object.values(one.requestBody?.content ?? {}).flatMap(({ schema }) =>
    Object.keys(flat(schema).properties ?? {}),
  );
  const { operationId: id, summary, tags } = one;
  const words = [method, path, id, summary, ...tags, ...parameters.map(({ name }) => name), ...fields];
  const text = words.join(" ").toLowerCase();
  return { ...one, id, method, path, parameters, tag: tags[0]!, role: one["x-role"], body: one.requestBody, text };
}

const isNull = (schema: Schema): boolean => schema.type === "null";

/** A schema as what it is, also where it is named or may be null: with its name, and the nearest description. */
export interface Found {
  schema: Schema;
  name?: string;
  nullable: boolean;
  description?: string;
}

export function resolve(given: Schema | undefined): Found {
  let schema = given ?? {};
  let { description } = schema;
  let name: string | undefined;
  let nullable = false;
  for (;;) {
    const choices = schema.oneOf ?? schema.anyOf;
    const rest = choices?.filter((one) => !isNull(one));
    if (schema.$ref) {
      name = schema.$ref.split("/").pop()!;
      schema = schemas[name] ?? {};
    } else if (rest?.length === 1) {
      nullable ||= choices!.length > 1;
      schema = rest[0]!;
    } else {
      break;
    }
    description ??= schema.description;
  }
  if (Array.isArray(schema.type) && schema.type.includes("null")) nullable = true;
  return { schema, name, nullable, description };
}

/** The properties of all parts of an object as one schema. */
export function flat(given: Schema | undefined): Schema {
  const { schema } = resolve(given);
  if (!schema.allOf) return schema;
  const parts = schema.allOf.map(flat);
  return {
    ...schema,
    type: "object",
    properties: Object.assign({}, ...parts.map((part) => part.properties)) as Schema["properties"],
    required: parts.flatMap((part) => part.required ?? []),
  };
}

/** The alternatives of a schema, or undefined if it has none. */
export function variantsOf(schema: Schema): Schema[] | undefined {
  const all = (schema.oneOf ?? schema.anyOf)?.filter((one) => !isNull(one));
  return all && all.length > 1 ? all : undefined;
}

/** The name of an alternative: the value of the field that tells it from the others, else its title or type. */
export function variantName(variant: Schema, whole: Schema): string {
  const { schema, name } = resolve(variant);
  const field = whole.discriminator?.propertyName ?? "";
  const tag = flat(variant).properties?.[field]?.const;
  return tag === undefined ? (schema.title ?? name ?? typeOf(variant)) : `${field}: ${String(tag)}`;
}

export function typeOf(given: Schema | undefined): string {
  const { schema, name } = resolve(given);
  if (schema.const !== undefined) return JSON.stringify(schema.const);
  const types = [schema.type ?? []].flat().filter((type) => type !== "null");
  if (types.includes("array")) return `array of ${typeOf(schema.items)}`;
  if (schema.format === "binary") return "bytes";
  if (typeof schema.additionalProperties === "object") return `map of ${typeOf(schema.additionalProperties)}`;
  if (name) return name;
  if (variantsOf(schema)) return variantsOf(schema)!.map(typeOf).join(" | ");
  return types.join(" | ") || "any";
}

const BOUNDS = [
  ["minimum", "at least #"],
  ["maximum", "at most #"],
  ["exclusiveMinimum", "above #"],
  ["exclusiveMaximum", "below #"],
  ["minItems", "at least # entries"],
  ["maxItems", "at most # entries"],
] as const;

/** The bounds of a value in words. */
export function boundsOf(schema: Schema): string[] {
  const given = BOUNDS.filter(([bound]) => schema[bound] !== undefined);
  return given.map(([bound, words]) => words.replace("#", String(schema[bound])));
}

/** The allowed values of a schema, or of the entries of an array. */
export function valuesOf(given: Schema): unknown[] {
  const { schema } = resolve(given);
  return schema.enum ?? (schema.items ? valuesOf(schema.items) : []);
}

/** An example of a schema: the one of the document, else of the fields that are required. */
export function sampleOf(given: Schema | undefined, depth = 0): unknown {
  const { schema } = resolve(given);
  const said = schema.example ?? schema.examples?.[0] ?? schema.const ?? schema.default ?? schema.enum?.[0];
  if (said !== undefined) return said;
  const whole = flat(schema);
  const variants = variantsOf(schema);
  if (variants) return sampleOf(variants[0], depth + 1);
  const type = [whole.type ?? "object"].flat().find((one) => one !== "null");
  if (type === "array") return depth > 6 ? [] : [sampleOf(whole.items, depth + 1)];
  if (type === "string") return "";
  if (type === "boolean") return false;
  if (type === "number" || type === "integer") return Math.max(whole.minimum ?? 0, 0);
  if (depth > 6) return {};
  const wanted = Object.entries(whole.properties ?? {}).filter(([name]) => whole.required?.includes(name));
  return Object.fromEntries(wanted.map(([name, property]) => [name, sampleOf(property, depth + 1)]));
}

/** The example of a body as text. */
export function exampleOf(media: Media | undefined, type: string): string {
  const example = media?.example ?? sampleOf(media?.schema);
  if (typeof example === "string") return example;
  return type.includes("json") && !type.includes("ndjson") ? pretty(example) : JSON.stringify(example);
}

/** JSON in which short lists stay on one line: coordinates above all. */
export function pretty(value: unknown, indent = ""): string {
  const line = JSON.stringify(value) ?? "";
  if (typeof value !== "object" || value === null || line === "{}" || line === "[]") return line;
  const deeper = `${indent}  `;
  if (Array.isArray(value)) {
    if (line.length <= 70 && !line.includes("{")) return `[${value.map((one) => pretty(one)).join(", ")}]`;
    return `[\n${value.map((one) => deeper + pretty(one, deeper)).join(",\n")}\n${indent}]`;
  }
  const lines = Object.entries(value).map(([name, one]) => `${deeper}${JSON.stringify(name)}: ${pretty(one, deeper)}`);
  return `{\n${lines.join(",\n")}\n${indent}}`;
}
