/** A thin client of the public API. Its types are generated from `openapi/openapi.json`. */
import type { components, paths } from "./schema";

export type Schemas = components["schemas"];
export type Problem = Schemas["ProblemDocument"];

type Method = "get" | "post" | "put" | "patch" | "delete";
type PathsWith<M extends Method> = {
  [P in keyof paths]: paths[P] extends { [K in M]: object } ? P : never;
}[keyof paths];
type Operation<P extends keyof paths, M extends Method> = paths[P][M & keyof paths[P]];
type JsonOf<R> = R extends { content: { "application/json": infer T } } ? T : never;
type Good<O> = O extends { responses: infer R }
  ? { [S in keyof R]: S extends 200 | 201 | 202 ? JsonOf<R[S]> : never }[keyof R]
  : never;
type Body<O> = O extends { requestBody?: infer B }
  ? NonNullable<B> extends { content: { "application/json": infer T } }
    ? T
    : undefined
  : undefined;
type Names<P extends string> = P extends `${string}{${infer N}}${infer Rest}` ? N | Names<Rest> : never;

export type Answer<M extends Method, P extends PathsWith<M>> = Good<Operation<P, M>>;
export type Query = URLSearchParams | Record<string, string | number | boolean | null | undefined>;

export interface Options {
  query?: Query;
  headers?: Record<string, string>;
  signal?: AbortSignal;
}
type PathOption<P extends string> = [Names<P>] extends [never]
  ? { path?: undefined }
  : { path: Record<Names<P>, string> };

/** A refusal, as the service words it. */
export class Refusal extends Error {
  constructor(readonly problem: Problem) {
    super(problem.detail || problem.title);
  }
}

/** A fault that the page itself has found, as a sentence. */
export class Said extends Error {}

const SESSION = "shapelex.key";
let key = sessionStorage.getItem(SESSION);
let whenRefused: () => void = () => {};
let renewal: () => Promise<boolean> = () => Promise.resolve(false);

/** The key is kept for this tab only, and sent in a header only. */
export function setKey(value: string | null): void {
  key = value;
  if (value) sessionStorage.setItem(SESSION, value);
  else sessionStorage.removeItem(SESSION);
}
export const hasKey = (): boolean => key !== null;
export function onUnauthenticated(then: () => void): void {
  whenRefused = then;
}
/** How a token that is no longer accepted is renewed, if it can be. */
export function setRenewal(renew: () => Promise<boolean>): void {
  renewal = renew;
}
export const authorization = (): Record<string, string> => (key ? { authorization: `Bearer ${key}` } : {});

export function search(query: Query = {}): string {
  if (query instanceof URLSearchParams) return query.size ? `?${query}` : "";
  const entries = Object.entries(query).filter(([, value]) => value !== undefined && value !== null && value !== "");
  return entries.length ? `?${new URLSearchParams(entries.map(([name, value]) => [name, String(value)]))}` : "";
}

export function fill(path: string, values: Record<string, string> = {}): string {
  return path.replace(/\{(\w+)\}/g, (_, name: string) => encodeURIComponent(values[name] ?? ""));
}

export async function problemOf(response: Response): Promise<Problem> {
  try {
    return JSON.parse(await response.text()) as Problem;
  } catch {
    return {
      type: "about:blank",
      title: response.statusText || `HTTP ${response.status}`,
      status: response.status,
      code: "unknown",
      detail: "",
      errors: [],
    };
  }
}

/** Any request; refusals become a [`Refusal`], a lost connection an ordinary error. */
export async function send(
  method: string,
  url: string,
  options: Options & { body?: BodyInit } = {},
): Promise<Response> {
  const ask = () =>
    fetch(url, {
      method,
      body: options.body,
      signal: options.signal,
      headers: { accept: "application/json", ...options.headers, ...authorization() },
      credentials: "omit",
    });
  let response = await ask();
  if (response.status === 401 && (await renewal())) response = await ask();
  if (response.ok) return response;
  if (response.status === 401) whenRefused();
  throw new Refusal(await problemOf(response));
}

async function call(
  method: string,
  path: string,
  options: Options & { path?: Record<string, string>; body?: unknown },
) {
  const headers =
    options.body === undefined ? options.headers : { "content-type": "application/json", ...options.headers };
  const body = options.body === undefined ? undefined : JSON.stringify(options.body);
  const response = await send(method.toUpperCase(), fill(path, options.path) + search(options.query), {
    ...options,
    headers,
    body,
  });
  return response.status === 204 ? undefined : response.json();
}

export function get<P extends PathsWith<"get"> & string>(
  path: P,
  options: Options & PathOption<P>,
): Promise<Answer<"get", P>> {
  return call("get", path, options) as Promise<Answer<"get", P>>;
}
export function post<P extends PathsWith<"post"> & string>(
  path: P,
  options: Options & PathOption<P> & { body?: Body<Operation<P, "post">> },
): Promise<Answer<"post", P>> {
  return call("post", path, options) as Promise<Answer<"post", P>>;
}
export function put<P extends PathsWith<"put"> & string>(
  path: P,
  options: Options & PathOption<P> & { body: Body<Operation<P, "put">> },
): Promise<Answer<"put", P>> {
  return call("put", path, options) as Promise<Answer<"put", P>>;
}
export function patch<P extends PathsWith<"patch"> & string>(
  path: P,
  options: Options & PathOption<P> & { body: Body<Operation<P, "patch">> },
): Promise<Answer<"patch", P>> {
  return call("patch", path, options) as Promise<Answer<"patch", P>>;
}
export function remove<P extends PathsWith<"delete"> & string>(
  path: P,
  options: Options & PathOption<P>,
): Promise<unknown> {
  return call("delete", path, options);
}

/** A form with a document and a file, such as `POST /v1/segment`. What becomes a job is waited for. */
export async function postImage<T>(
  path: "/v1/contours" | "/v1/segment",
  parameters: object,
  image: Blob,
  signal?: AbortSignal,
): Promise<T> {
  const form = new FormData();
  form.append("parameters", new Blob([JSON.stringify(parameters)], { type: "application/json" }));
  form.append("image", image, "image");
  const response = await send("POST", path, { body: form, signal, headers: { prefer: "wait=10" } });
  if (response.status !== 202) return response.json() as Promise<T>;
  let job = (await response.json()) as Schemas["JobOutput"];
  while (job.status === "queued" || job.status === "running") {
    await new Promise((resolve) => setTimeout(resolve, 1000));
    job = await get("/v1/jobs/{job}", { path: { job: job.id }, signal });
  }
  if (job.problem) throw new Refusal(job.problem as Problem);
  if (!job.result) throw new Error(job.status);
  return job.result as T;
}

/** All entries of a list, page by page, at most `most`. */
export async function pages<T>(
  page: (cursor: string | undefined) => Promise<{ items: T[]; next?: string | null }>,
  most = 1000,
): Promise<T[]> {
  const items: T[] = [];
  let cursor: string | undefined;
  do {
    const answer = await page(cursor);
    items.push(...answer.items);
    cursor = answer.next ?? undefined;
  } while (cursor && items.length < most);
  return items;
}
