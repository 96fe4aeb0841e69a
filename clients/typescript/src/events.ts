/** Server-sent events, resumed after a lost connection. */
import { request } from "./call.js";
import { type Client, sleep } from "./client.js";
import { Refusal, ShapelexError, Unreachable } from "./errors.js";
import { linesOf } from "./text.js";
import type { Common, Operation, Options, Schemas } from "./types.js";

type JobEntry = Schemas["JobEntry"];
type Change = Schemas["ChangeOutput"];

/** A change of the feed, with its number as `id`, or the progress of a running job. */
export type TenantEvent =
  | { kind: Change["kind"]; data: Change; id: string }
  | { kind: "job_progress"; data: JobEntry; id?: undefined };
/** The state of a job: `progress`, or how it ended. */
export interface JobEvent {
  kind: "progress" | JobEntry["status"];
  data: Schemas["JobOutput"];
  id: string;
}
interface Streams {
  "/v1/events": TenantEvent;
  "/v1/jobs/{job}/events": JobEvent;
}

export interface Following {
  /** The event after which the stream goes on; without it, it begins with what happens from now on. */
  lastEventId?: string;
  /** Told when the connection is there, and when it is lost. */
  onConnection?: (connected: boolean) => void;
  /** Told from where to go on, also between events: a later `lastEventId`. */
  onPosition?: (id: string) => void;
  /** Times in a row that a connection may fail before the stream ends with the error. Default: 6. */
  tries?: number;
}

/** Milliseconds of the first pause before the next connection, and of the longest one. */
const FIRST_PAUSE = 1000;
const LONGEST_PAUSE = 30_000;
const TRIES = 6;

interface Block {
  event: string;
  data?: string;
  id?: string;
}

/** The events of `text/event-stream`. A block without data only tells where to go on. */
async function* blocksOf(body: ReadableStream<Uint8Array>): AsyncGenerator<Block, void> {
  let block: Block = { event: "message" };
  for await (const line of linesOf(body)) {
    if (!line) {
      yield block;
      block = { event: "message" };
      continue;
    }
    const [, name, value = ""] = /^(\w*)(?:: ?(.*))?$/s.exec(line) ?? [];
    if (name === "data") block.data = block.data === undefined ? value : `${block.data}\n${value}`;
    else if (name === "event" || name === "id") block[name] = value;
  }
}

/** Whether another connection may be better than one that failed so. */
const mayPass = (error: unknown): boolean =>
  error instanceof Refusal
    ? error.status >= 500 || error.status === 429
    : error instanceof Unreachable || !(error instanceof ShapelexError);

async function* follow(client: Client, path: string, options: Following & Common & { headers?: object }) {
  const { signal, tries = TRIES, onConnection, onPosition } = options;
  let { lastEventId } = options;
  for (let failures = 0, pause = FIRST_PAUSE; ; pause = Math.min(2 * pause, LONGEST_PAUSE)) {
    try {
      const headers = { accept: "text/event-stream", ...options.headers, "last-event-id": lastEventId };
      const response = await request({ ...client, retry: undefined }, "get", path, { ...options, headers });
      // The job has ended, and its last event was seen.
      if (response.status === 204) return;
      onConnection?.(true);
      [failures, pause] = [0, FIRST_PAUSE];
      for await (const { event, data, id } of blocksOf(response.body!)) {
        if (id) {
          lastEventId = id;
          onPosition?.(id);
        }
        if (data) yield { kind: event, data: JSON.parse(data), id };
      }
    } catch (error) {
      if (signal?.aborted || !mayPass(error) || ++failures >= tries) throw error;
    } finally {
      onConnection?.(false);
    }
    await sleep(pause, signal);
  }
}

/** The function of an operation whose answer is a stream of events. */
export type Follow<P extends keyof Streams> = (
  client: Client,
  ...options: P extends "/v1/events"
    ? [options?: Following & Omit<Options<Operation<"get", P>>, "accept">]
    : [options: Following & Omit<Options<Operation<"get", P>>, "accept">]
) => AsyncGenerator<Streams[P], void>;

/** The function of a stream of events. */
export function stream<P extends keyof Streams>(path: P): Follow<P> {
  return ((client: Client, options: Following = {}) => follow(client, path, options)) as Follow<P>;
}
