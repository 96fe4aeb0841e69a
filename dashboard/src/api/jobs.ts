/** Answers that may be jobs: waited for, with progress. */
import { get, Said, type Schemas } from "./client";

type Job = Schemas["JobOutput"];
const isJob = (answer: unknown): answer is Job =>
  typeof answer === "object" && answer !== null && "status" in answer && "kind" in answer && "attempt" in answer;

/** The answer, or the result of the job that was begun instead. */
export async function settled<T>(
  answer: T | Job,
  signal: AbortSignal,
  progress: (job: Job) => void = () => {},
): Promise<T> {
  if (!isJob(answer)) return answer;
  let job: Job = answer;
  while (job.status === "queued" || job.status === "running") {
    progress(job);
    await new Promise((resolve) => setTimeout(resolve, 500));
    signal.throwIfAborted();
    job = await get("/v1/jobs/{job}", { path: { job: job.id }, signal });
  }
  if (job.status !== "succeeded") throw new Said(job.problem?.detail ?? job.status);
  return job.result as T;
}
