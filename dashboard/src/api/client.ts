/** The API as the page asks it, by the client for TypeScript: with the login of the session, and refusals that the page hears of. */
import {
  type Answer as Answered,
  type AnyOptions,
  type Client,
  fill as filled,
  type JsonBody,
  type Method,
  type Operation,
  type PathsWith,
  type ProblemDocument,
  pages as pagesOf,
  Refusal,
  request,
  type Schemas,
  search as searched,
  send as sent,
  Unreachable,
} from "../../../clients/typescript/src/index";
import { askTabs } from "./tabs";

export { Refusal, type Schemas, Unreachable };
export type Problem = ProblemDocument;
export type Query = URLSearchParams | Record<string, string | number | boolean | null | undefined>;

type Names<P extends string> = P extends `${string}{${infer N}}${infer Rest}` ? N | Names<Rest> : never;
export type Answer<M extends Method, P extends PathsWith<M>> = Answered<Operation<M, P>, "application/json">;

export interface Options {
  query?: Query;
  headers?: Record<string, string>;
  signal?: AbortSignal;
}
type PathOption<P extends string> = [Names<P>] extends [never]
  ? { path?: undefined }
  : { path: Record<Names<P>, string> };

/** A fault that the page itself has found, as a sentence. */
export class Said extends Error {}

const SESSION = "shapelex.key";
let key = sessionStorage.getItem(SESSION);
let whenRefused: () => void = () => {};
let whenForbidden: (problem: Problem) => void = () => {};
let renewal: () => Promise<boolean> = () => Promise.resolve(false);

/** The key is kept for this tab only, and sent in a header only. */
export function setKey(value: string | null): void {
  key = value;
  if (value) sessionStorage.setItem(SESSION, value);
  else sessionStorage.removeItem(SESSION);
}
export const hasKey = (): boolean => key !== null;
export const keyNow = (): string | null => key;
export function onUnauthenticated(then: () => void): void {
  whenRefused = then;
}
export function onForbidden(then: (problem: Problem) => void): void {
  whenForbidden = then;
}
/** What is done with the key of another tab. */
let takeKey: (shared: { key: string; session: string | null }) => void = ({ key: other }) => setKey(other);
export function onShared(then: typeof takeKey): void {
  takeKey = then;
}
/** The key of another tab of this session, if it is another one. */
async function fromTabs(used: string | null): Promise<boolean> {
  const shared = await askTabs();
  // Another request may have taken it meanwhile.
  if (shared && shared.key !== key) takeKey(shared);
  return key !== null && key !== used;
}
/** How a token that is no longer accepted is renewed, if it can be. */
export function setRenewal(renew: () => Promise<boolean>): void {
  renewal = renew;
}
export const authorization = (): Record<string, string> => (key ? { authorization: `Bearer ${key}` } : {});

/** Requests for which the other tabs were asked. */
const askedTabs = new WeakSet<readonly (string | null)[]>();

/** The key of a request; after a refusal a renewed one, then that of another tab. */
async function keyAfter(refused: readonly (string | null)[]): Promise<string | null> {
  if (!refused.length) return key;
  const used = refused[0]!;
  // Another request may have renewed the token meanwhile.
  const isOld = key !== null && key !== used;
  if (refused.length === 1 && (isOld || (await renewal()))) return key;
  if (askedTabs.has(refused)) return null;
  askedTabs.add(refused);
  return (await fromTabs(used)) ? key : null;
}

/** The service of this page. People try again themselves. */
export const service: Client = { url: "", key: keyAfter };

/** Fields of forms that are empty are left out. */
const filledIn = (query: Query = {}): Query =>
  query instanceof URLSearchParams
    ? query
    : Object.fromEntries(Object.entries(query).filter(([, value]) => value !== ""));

export const search = (query: Query = {}): string => searched(filledIn(query));
export const fill = (path: string, values: Record<string, string> = {}): string => filled(path, values, "");

/** Tells the page of refusals that concern the login. */
export function heard(error: unknown): never {
  if (error instanceof Refusal && error.status === 401) whenRefused();
  if (error instanceof Refusal && error.status === 403) whenForbidden(error.problem);
  throw error;
}

/** Any request; refusals become a [`Refusal`], a lost connection another error. */
export function send(method: string, url: string, options: Options & { body?: BodyInit } = {}): Promise<Response> {
  const { body, signal } = options;
  return sent(service, {
    method,
    path: url,
    body,
    signal,
    headers: { accept: "application/json", ...options.headers },
  }).catch(heard);
}

export async function call(method: string, path: string, options: Options & AnyOptions): Promise<unknown> {
  const query = filledIn(options.query);
  const response = await request(service, method, path, { ...options, query }).catch(heard);
  return response.status === 204 ? undefined : response.json();
}

export function get<P extends PathsWith<"get">>(path: P, options: Options & PathOption<P>): Promise<Answer<"get", P>> {
  return call("get", path, options) as Promise<Answer<"get", P>>;
}
export function post<P extends PathsWith<"post">>(
  path: P,
  options: Options & PathOption<P> & { body?: JsonBody<Operation<"post", P>> },
): Promise<Answer<"post", P>> {
  return call("post", path, options) as Promise<Answer<"post", P>>;
}
export function put<P extends PathsWith<"put">>(
  path: P,
  options: Options & PathOption<P> & { body: JsonBody<Operation<"put", P>> },
): Promise<Answer<"put", P>> {
  return call("put", path, options) as Promise<Answer<"put", P>>;
}
export function patch<P extends PathsWith<"patch">>(
  path: P,
  options: Options & PathOption<P> & { body: JsonBody<Operation<"patch", P>> },
): Promise<Answer<"patch", P>> {
  return call("patch", path, options) as Promise<Answer<"patch", P>>;
}
export function remove<P extends PathsWith<"delete">>(path: P, options: Options & PathOption<P>): Promise<unknown> {
  return call("delete", path, options);
}

/** All entries of a list, page by page, at most `most`. */
export async function pages<T>(
  page: (cursor: string | undefined) => Promise<{ items: T[]; next?: string | null }>,
  most = 1000,
): Promise<T[]> {
  const items: T[] = [];
  for await (const found of pagesOf(page)) {
    items.push(...found.items);
    if (items.length >= most) break;
  }
  return items;
}
