/** A client as a value: where the service is, and how requests reach it. */
import { NotModified, refusalOf, Unreachable } from "./errors.js";

/**
 * A key or token, or a function that gives one for each request. After an answer of 401 the function is asked again, with the keys that
 * were refused: with another one the request is sent again, twice at most. So it can renew a token. A request
 * has one list, which grows.
 */
export type Key = string | ((refused: readonly (string | null)[]) => string | null | Promise<string | null>);

/** A service and how it is asked. [`createClient`] makes one that tries again. */
export interface Client {
  /** Address of the service, without a slash at its end. */
  readonly url: string;
  readonly key?: Key | null;
  /** What sends requests in place of `fetch`. */
  readonly fetch?: typeof fetch;
  /** Milliseconds after which a request that failed is sent again; undefined: it is not. Without it, none is. */
  readonly retry?: (error: unknown, attempt: number, wanted: Wanted) => number | undefined;
}

/** A request that can be sent, and sent again. */
export interface Wanted {
  method: string;
  /** Path and query. */
  path: string;
  headers?: RequestInit["headers"];
  body?: RequestInit["body"];
  signal?: AbortSignal;
  /** Whether it may be sent again when its answer was lost. */
  repeatable?: boolean;
}

/** Keys that are refused to one request at most. */
const KEYS = 2;

/** Waits so many milliseconds, or until it is given up. */
export function sleep(milliseconds: number, signal?: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const stop = () => {
      clearTimeout(timer);
      reject(signal!.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, milliseconds);
    if (signal?.aborted) stop();
    else signal?.addEventListener("abort", stop);
  });
}

/** What the cause of an error of Node tells. */
export const codeOf = (cause: unknown): string | undefined => (cause as { cause?: { code?: string } }).cause?.code;

/** One try, with another key after a refused one where the client has a function for it. */
async function ask(client: Client, { method, path, ...wanted }: Wanted): Promise<Response> {
  const { key, fetch = globalThis.fetch } = client;
  const refused: (string | null)[] = [];
  let now = typeof key === "function" ? await key(refused) : key;
  for (;;) {
    const headers = new Headers(wanted.headers);
    if (now) headers.set("authorization", `Bearer ${now}`);
    const init = { method, ...wanted, headers, credentials: "omit", duplex: "half" } as RequestInit;
    const response = await fetch(client.url + path, init).catch((cause) => {
      if (wanted.signal?.aborted) throw cause;
      throw new Unreachable(`${method} ${client.url}${path}: ${codeOf(cause) ?? cause.message}`, { cause });
    });
    // A stream is used up.
    const isFinal = response.status !== 401 || refused.length === KEYS || wanted.body instanceof ReadableStream;
    if (isFinal || typeof key !== "function") return response;
    refused.push(now!);
    now = await key(refused);
    if (!now || now === refused.at(-1)) return response;
  }
}

/** Sends a request until it is answered, or is not to be tried again. */
export async function send(client: Client, wanted: Wanted): Promise<Response> {
  for (let attempt = 1; ; attempt++)
    try {
      const response = await ask(client, wanted);
      if (response.ok) return response;
      throw response.status === 304 ? new NotModified(wanted.path) : await refusalOf(response);
    } catch (error) {
      const pause = client.retry?.(error, attempt, wanted);
      if (pause === undefined) throw error;
      await sleep(pause, wanted.signal);
    }
}
