/** Clients that send a request again when that may help, and does no harm. */
import { type Client, codeOf, type Key, type Wanted } from "./client.js";
import { Refusal, Unreachable } from "./errors.js";

/** Milliseconds of the first pause between tries, and of the longest one. */
const FIRST_PAUSE = 200;
const LONGEST_PAUSE = 30_000;
/** Errors of Node after which nothing was sent. */
const NOT_SENT = ["ECONNREFUSED", "ENOTFOUND", "EAI_AGAIN", "UND_ERR_CONNECT_TIMEOUT"];

/** Milliseconds before the next try: those that the service asks for, else twice as many each time, with some chance. */
function pauseBefore(attempt: number, error: unknown): number {
  const asked = error instanceof Refusal ? error.retryAfter : undefined;
  if (asked !== undefined) return Math.min(1000 * asked, LONGEST_PAUSE);
  return Math.min(FIRST_PAUSE * 2 ** (attempt - 1), LONGEST_PAUSE) * (0.5 + Math.random() / 2);
}

/** Whether a failure may pass, and the request may be sent again: nothing was begun, or beginning anew does no harm. */
function isPassing(error: unknown, { body, repeatable = false }: Wanted): boolean {
  // A stream is used up.
  if (body instanceof ReadableStream) return false;
  if (error instanceof Unreachable) return repeatable || NOT_SENT.includes(codeOf(error.cause) ?? "");
  if (!(error instanceof Refusal)) return false;
  const { status, code } = error;
  // Proxies answer 502 and 504 for a service that starts again.
  const ofProxies = repeatable && (status === 502 || status === 504);
  return ofProxies || status === 429 || (status === 503 && code !== "took-too-long");
}

export interface ClientOptions {
  /** Address of the service; `""` is that of the page. Default: `http://127.0.0.1:8080`. */
  url?: string;
  key?: Key | null;
  /**
   * Times that a request is sent at most, with growing pauses: when the service is busy (429, 503) or cannot be reached, and, of requests
   * that change nothing or have an `Idempotency-Key`, when the answer got lost. Default: 6.
   */
  tries?: number;
  /** What sends requests in place of `fetch`. */
  fetch?: typeof fetch;
}

export const createClient = ({ url = "http://127.0.0.1:8080", tries = 6, ...others }: ClientOptions = {}): Client => ({
  ...others,
  url: url.replace(/\/+$/, ""),
  retry: (error, attempt, wanted) =>
    attempt < tries && isPassing(error, wanted) ? pauseBefore(attempt, error) : undefined,
});
