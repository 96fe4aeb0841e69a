/** Client of Shapelex, the service for statistics of shapes. */
export { type AnyOptions, type Call, request } from "./call.js";
export { type Client, type Key, send, type Wanted } from "./client.js";
export {
  type Fault,
  JobCancelled,
  JobFailed,
  NotModified,
  type ProblemDocument,
  Refusal,
  refusalOf,
  ShapelexError,
  Unreachable,
} from "./errors.js";
export type { Following, JobEvent, TenantEvent } from "./events.js";
export { file, ndjson } from "./files.js";
export {
  isJob,
  Job,
  type JobDocument,
  type JobResult,
  type Learning,
  learn,
  type Settled,
  settle,
  type Waiting,
} from "./jobs.js";
export * from "./operations.js";
export { changes, entries, pages } from "./pages.js";
export { fill, search } from "./query.js";
export { type ClientOptions, createClient } from "./retry.js";
export type * from "./types.js";
