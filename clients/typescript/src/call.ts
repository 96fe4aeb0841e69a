/** Calls: a request with what an operation takes, and its answer as a value. */
import { type Client, send } from "./client.js";
import { fields, fill, present, search } from "./query.js";
import { linesOf } from "./text.js";
import type {
  Answer,
  Common,
  DefaultMediaType,
  MediaType,
  Method,
  Operation,
  Options,
  PathsWith,
  Query,
} from "./types.js";

/** What makes a request of an operation one that may be sent again when its answer was lost. */
export type Repeats = (headers: Headers) => void;

/** It changes nothing, or the same. */
export const repeatable: Repeats = () => {};

/** With an `Idempotency-Key` it takes effect once, however often it is sent. */
export const keyed: Repeats = (headers) => {
  // Thirty-two digits by chance: pages without TLS have no `randomUUID`.
  const digits = Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0"));
  if (!headers.has("idempotency-key")) headers.set("idempotency-key", digits.join(""));
};

/** What a call takes, whatever the operation. */
export interface AnyOptions extends Common {
  path?: { [name: string]: unknown };
  query?: object;
  headers?: { [name: string]: string | number | null | undefined };
  body?: unknown;
  contentType?: string;
  options?: Record<string, unknown>;
  accept?: string;
}

const OCTETS = "application/octet-stream";
const isRaw = (body: unknown): body is BodyInit =>
  typeof body === "string" ||
  body instanceof Blob ||
  body instanceof ArrayBuffer ||
  body instanceof ReadableStream ||
  ArrayBuffer.isView(body);

/** A form: documents first, then files, with their names where they have some. */
function formOf(parts: object): FormData {
  const form = new FormData();
  const isFile = (part: unknown) => part instanceof Blob;
  for (const [name, part] of present(parts))
    if (!isFile(part)) form.append(name, new Blob([JSON.stringify(part)], { type: "application/json" }));
  for (const [name, part] of present(parts))
    if (isFile(part)) form.append(name, part as File, (part as File).name ?? name);
  return form;
}

/** What is sent of a body, and its media type: a file as it is, a form where one of its parts is a file, anything else as JSON. */
function encoded(body: unknown, contentType: string | undefined): [BodyInit, string?] | [] {
  if (body === undefined) return [];
  if (isRaw(body)) return [body, contentType ?? OCTETS];
  if (Object.values(body as object).some((part) => part instanceof Blob)) return [formOf(body as object)];
  return [JSON.stringify(body), "application/json"];
}

/** Sends what an operation takes; the answer as it comes. */
export async function request(
  client: Client,
  method: string,
  path: string,
  options: AnyOptions = {},
  repeats?: Repeats,
): Promise<Response> {
  const { query = {}, signal, accept = "application/json" } = options;
  const [body, type] = encoded(options.body, options.contentType);
  const headers = new Headers({ accept, ...(type && { "content-type": type }) });
  for (const [name, value] of present(options.headers)) headers.set(name, String(value));
  repeats?.(headers);
  const asked = query instanceof URLSearchParams ? query : ({ ...query, ...fields(options.options) } as Query);
  const response = await send(client, {
    method: method.toUpperCase(),
    path: fill(path, options.path) + search(asked),
    headers,
    body,
    signal,
    repeatable: !!repeats || method === "get" || method === "put" || headers.has("idempotency-key"),
  });
  options.onResponse?.(response);
  return response;
}

/** The lines of NDJSON, read one after the other. */
async function* valuesOf(body: ReadableStream<Uint8Array>): AsyncGenerator<unknown, void> {
  for await (const line of linesOf(body)) if (line) yield JSON.parse(line);
}

/** The body of an answer, by its media type. */
async function bodyOf(response: Response, accept: string | undefined): Promise<unknown> {
  const type = (response.headers.get("content-type") ?? "").split(";")[0]!.trim();
  if (response.status === 204) return undefined;
  if (accept === "*/*") return response.arrayBuffer();
  if (type === "application/json") return response.json();
  if (type === "application/x-ndjson") return valuesOf(response.body!);
  return type.startsWith("text/") || type === "image/svg+xml" ? response.text() : response.arrayBuffer();
}

/** The function of an operation, which takes a client and what the operation takes. */
export type Call<M extends Method, P extends PathsWith<M>> = CallOf<Operation<M, P>>;
type CallOf<O> =
  object extends Options<O, DefaultMediaType<O>>
    ? <A extends MediaType<O> = DefaultMediaType<O>>(client: Client, options?: Options<O, A>) => Promise<Answer<O, A>>
    : <A extends MediaType<O> = DefaultMediaType<O>>(client: Client, options: Options<O, A>) => Promise<Answer<O, A>>;

/** The function of an operation. */
export function operation<M extends Method, P extends PathsWith<M>>(method: M, path: P, repeats?: Repeats): Call<M, P> {
  const made = async (client: Client, options?: AnyOptions) =>
    bodyOf(await request(client, method, path, options, repeats), options?.accept);
  return made as unknown as Call<M, P>;
}
