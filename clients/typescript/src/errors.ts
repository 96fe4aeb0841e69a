/** Errors: refusals of the service in its own words, and services that cannot be reached. */
import type { Schemas } from "./types.js";

export type ProblemDocument = Schemas["ProblemDocument"];
/** A single fault of an input: `detail`, with the `pointer` or the `parameter`, and the `index` of the shape. */
export type Fault = Schemas["FaultDocument"];

/** Any failure of the client. */
export class ShapelexError extends Error {
  override name = "ShapelexError";
}

/** No answer: no service at the address, or a connection that broke after all tries. The reason is `cause`. */
export class Unreachable extends ShapelexError {
  override name = "Unreachable";
}

/** The answer 304 to a request with `if-none-match`: what the caller has is what the service has. */
export class NotModified extends ShapelexError {
  override name = "NotModified";
}

/** A refusal: a problem document (RFC 9457) of the service, with its fields. */
export class Refusal extends ShapelexError {
  override name = "Refusal";
  /** Stable URI of the problem type, `urn:shapelex:problem:` and the code. */
  declare readonly type: string;
  /** The same for every occurrence of the type. */
  declare readonly title: string;
  /** Status of HTTP. */
  declare readonly status: number;
  /** Last part of `type`, such as `invalid-input`. */
  declare readonly code: string;
  /** What happened and what to do, with the numbers. */
  declare readonly detail: string;
  /** All faults of the input, at most 100. */
  declare readonly errors: Fault[];
  /** Id of the request, as in the log of the service. */
  declare readonly request_id?: string | null;
  /** JSON pointer (RFC 6901) of the first fault that has one. */
  readonly pointer: string | undefined;
  /** Position of the first shape with a fault, from 0. */
  readonly index: number | undefined;

  constructor(
    /** The document as it came. */
    readonly problem: ProblemDocument,
    /** Seconds after which the service asks to try again. */
    readonly retryAfter?: number,
  ) {
    super(problem.detail || problem.title);
    Object.assign(this, problem);
    const first = (name: "pointer" | "index") => problem.errors.find((fault) => fault[name] != null)?.[name];
    this.pointer = first("pointer") as string | undefined;
    this.index = first("index") as number | undefined;
  }
}

/** A job failed: the problem that it keeps, with the status of a request with the same fault. */
export class JobFailed extends Refusal {
  override name = "JobFailed";
}

/** A job was cancelled before it ended. */
export class JobCancelled extends ShapelexError {
  override name = "JobCancelled";
}

/** Seconds of the header `Retry-After`. */
function retryAfter(response: Response): number | undefined {
  const seconds = Number(response.headers.get("retry-after") ?? Number.NaN);
  return seconds >= 0 ? seconds : undefined;
}

/** The error of an answer; what is no problem document, as of a proxy, has the title of its status. */
export async function refusalOf(response: Response): Promise<Refusal> {
  const { status, statusText } = response;
  const found = await response.json().catch(() => undefined);
  const unknown = {
    type: "about:blank",
    title: statusText || `HTTP ${status}`,
    status,
    code: "unknown",
    detail: "",
    errors: [],
  };
  return new Refusal(found?.code ? found : unknown, retryAfter(response));
}
