/** Answers that may be jobs: waited for, with progress. */
import { JobCancelled, type JobDocument, JobFailed, settle } from "../../../clients/typescript/src/index";
import { call, heard, Said, service } from "./client";

/** The answer, or the result of the job that was begun instead. */
export const settled = <T>(
  answer: T | JobDocument,
  signal: AbortSignal,
  onProgress: (job: JobDocument) => void = () => {},
): Promise<T> =>
  settle(service, answer, { signal, onProgress, pause: 500 }).catch((error) => {
    if (error instanceof JobFailed) throw new Said(error.message);
    if (error instanceof JobCancelled) throw new Said("cancelled");
    return heard(error);
  }) as Promise<T>;

/** A form with a document and a file, such as `POST /v1/segment`. What becomes a job is waited for. */
export async function postImage<T>(
  path: "/v1/contours" | "/v1/segment",
  parameters: object,
  image: Blob,
  signal?: AbortSignal,
): Promise<T> {
  // A slice has no name: names of files may be those of patients.
  const body = { parameters, image: image.slice() };
  const answer = await call("post", path, { body, headers: { prefer: "wait=10" }, signal });
  return settle(service, answer as T, { signal, pause: 1000 }).catch(heard) as Promise<T>;
}
