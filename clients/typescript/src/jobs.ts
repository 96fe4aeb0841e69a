/** Jobs: what takes long, waited for. */
import { request } from "./call.js";
import { type Client, sleep } from "./client.js";
import { JobCancelled, JobFailed, type ProblemDocument } from "./errors.js";
import { cancelJob, findDictionary, findJob, jobOutput, learnDictionary } from "./operations.js";
import type { Answer, MediaType, Operation, Schemas } from "./types.js";

export type JobDocument = Schemas["JobOutput"];
export type JobResult = NonNullable<JobDocument["result"]>;

export interface Waiting {
  /** Gives up waiting; the job runs on. */
  signal?: AbortSignal;
  /** Sees the job at every look while it is queued or running. */
  onProgress?: (job: JobDocument) => void;
  /** Milliseconds between looks. Default: 50, then half as much again each time up to 2000. */
  pause?: number;
}

const FIRST_LOOK = 50;
const LAST_LOOK = 2000;

/** Whether an answer is a job that was begun in its place. */
export const isJob = (answer: unknown): answer is JobDocument =>
  typeof answer === "object" && answer !== null && "status" in answer && "kind" in answer && "attempt" in answer;

const runs = ({ status }: JobDocument): boolean => status === "queued" || status === "running";

/** The job when it has ended. */
async function ended(client: Client, job: JobDocument, { signal, onProgress, pause }: Waiting): Promise<JobDocument> {
  for (let look = pause ?? FIRST_LOOK; runs(job); look = pause ?? Math.min(1.5 * look, LAST_LOOK)) {
    onProgress?.(job);
    await sleep(look, signal);
    job = await (await request(client, "get", "/v1/jobs/{job}", { path: { job: job.id }, signal })).json();
  }
  return job;
}

function resultOf(job: JobDocument): JobResult {
  if (job.status === "failed") throw new JobFailed(job.problem as ProblemDocument);
  if (job.status === "cancelled")
    throw new JobCancelled(`expected the result of ${job.id}, got a job that was cancelled`);
  return job.result as JobResult;
}

/** What a job gives where that differs from the answer in whose place it was begun. */
type ResultInPlaceOf<T> = T extends Schemas["DictionaryOutput"]
  ? Schemas["LearntDictionary"]
  : T extends Schemas["DistancesAnswer"]
    ? Schemas["StoredMatrix"]
    : T extends AsyncGenerator
      ? Schemas["AssessedCohort"]
      : T extends string | ArrayBuffer
        ? JobResult
        : never;
/** An answer, or the result of its job. */
export type Settled<T> = Exclude<T, JobDocument> | (JobDocument extends T ? ResultInPlaceOf<T> : never);

/** The answer, or the result of the job that was begun in its place. */
export async function settle<T>(
  client: Client,
  answer: T | PromiseLike<T>,
  waiting: Waiting = {},
): Promise<Settled<T>> {
  const given = await answer;
  return (isJob(given) ? resultOf(await ended(client, given, waiting)) : given) as Settled<T>;
}

/** What learning takes; the cost of a dry run is an answer of [`learnDictionary`]. */
export type Learning = Schemas["LearnRequest"] & { dry_run?: false };

/** Learns a dictionary, waits for it, and gives it. */
export async function learn(
  client: Client,
  body: Learning,
  waiting: Waiting = {},
): Promise<Schemas["DictionaryOutput"]> {
  const { signal } = waiting;
  const learnt = await settle(client, learnDictionary(client, { body, signal }), waiting);
  if (!("dictionary" in learnt)) return learnt as Schemas["DictionaryOutput"];
  return findDictionary(client, { path: { dictionary: learnt.dictionary }, signal });
}

type Output = Operation<"get", "/v1/jobs/{job}/output">;

/** A job of the service. */
export class Job {
  constructor(
    readonly client: Client,
    /** The job at the last look. */
    public document: JobDocument,
  ) {}

  get id(): string {
    return this.document.id;
  }
  get status(): JobDocument["status"] {
    return this.document.status;
  }
  /** Looks again. */
  async refresh(): Promise<this> {
    this.document = await findJob(this.client, { path: { job: this.id } });
    return this;
  }
  /** Waits until it ends, and gives its result. Fails with [`JobFailed`], or [`JobCancelled`]. */
  async wait(waiting: Waiting = {}): Promise<JobResult> {
    const onProgress = (job: JobDocument) => {
      this.document = job;
      waiting.onProgress?.(job);
    };
    this.document = await ended(this.client, this.document, { ...waiting, onProgress });
    return resultOf(this.document);
  }
  async cancel(): Promise<this> {
    this.document = await cancelJob(this.client, { path: { job: this.id } });
    return this;
  }
  /** The output of a job that has one, such as a matrix or lines of assessments. */
  output<A extends MediaType<Output>>(accept: A): Promise<Answer<Output, A>> {
    return jobOutput(this.client, { path: { job: this.id }, accept });
  }
}
