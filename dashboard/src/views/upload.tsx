/** Shapes from files, with progress, and faults at their place in the file. */
import { useRef, useState } from "preact/hooks";
import { authorization, Refusal, Said, type Problem, type Schemas } from "../api/client";
import { Choice, Fault, Place } from "../parts/basic";
import { ACCEPT, isLines, shapesOf } from "../formats/read";
import { count, percent, t } from "../strings";
import { CohortPage } from "./cohort";
import { Drop } from "../parts/drop";

interface Outcome {
  name: string;
  part: number;
  answer?: Schemas["AddAnswer"];
  error?: Error;
}

/** A request whose progress can be seen, which `fetch` does not show. */
function upload(url: string, type: string, body: Blob, key: string, progress: (part: number) => void): { done: Promise<Schemas["AddAnswer"]>; stop: () => void } {
  const request = new XMLHttpRequest();
  const done = new Promise<Schemas["AddAnswer"]>((resolve, reject) => {
    request.open("POST", url);
    for (const [name, value] of Object.entries({ "content-type": type, accept: "application/json", "idempotency-key": key, ...authorization() })) request.setRequestHeader(name, value);
    request.upload.onprogress = (event) => event.lengthComputable && progress(event.loaded / event.total);
    request.onload = () => {
      if (request.status < 300) return resolve(JSON.parse(request.responseText) as Schemas["AddAnswer"]);
      try {
        reject(new Refusal(JSON.parse(request.responseText) as Problem));
      } catch {
        reject(new Error(request.statusText));
      }
    };
    request.onerror = () => reject(new TypeError("network"));
    request.onabort = () => reject(new Said(t.upload.stopped));
    request.send(body);
  });
  return { done, stop: () => request.abort() };
}

export function Upload({ cohort }: { cohort: string }) {
  const [files, setFiles] = useState<Outcome[]>([]);
  const [onError, setOnError] = useState("skip");
  const stop = useRef<(() => void) | undefined>(undefined);
  const set = (index: number, change: Partial<Outcome>) => setFiles((before) => before.map((one, at) => (at === index ? { ...one, ...change } : one)));
  const begin = async (chosen: File[]) => {
    const first = files.length;
    setFiles([...files, ...chosen.map((file) => ({ name: file.name, part: 0 }))]);
    for (const [offset, file] of chosen.entries()) {
      const index = first + offset;
      try {
        const lines = isLines(file.name);
        const body = lines ? file : new Blob([JSON.stringify({ shapes: await shapesOf(file) })]);
        const url = `/v1/cohorts/${encodeURIComponent(cohort)}/shapes?return=none&on_error=${onError}`;
        const sent = upload(url, lines ? "application/x-ndjson" : "application/json", body, crypto.randomUUID(), (part) => set(index, { part }));
        stop.current = sent.stop;
        set(index, { answer: await sent.done, part: 1 });
      } catch (error) {
        set(index, { error: error instanceof SyntaxError ? new Said(t.upload.syntax(error.message)) : (error as Error), part: 1 });
      } finally {
        stop.current = undefined;
      }
    }
  };
  return (
    <CohortPage cohort={cohort}>
      {() => (
        <>
          <div class="row spread">
            <p class="quiet prose">{t.upload.lead}</p>
            <Choice label={t.upload.onError} value={onError} options={[["skip", t.upload.skip], ["abort", t.upload.abort]]} onChange={setOnError} />
          </div>
          <Drop title={t.upload.drop} hint={t.upload.formats} accept={ACCEPT} multiple onFiles={(chosen) => void begin(chosen)} />
          <div class="stack" aria-live="polite">
            {files.map((file, index) => (
              <section class="card" key={index}>
                <div class="row spread">
                  <h2>{file.name}</h2>
                  {file.answer ? <span class={`tag ${file.answer.skipped ? "warn" : "good"}`}>{t.upload.added(file.answer.added)}{file.answer.skipped ? `, ${t.upload.skipped(file.answer.skipped)}` : ""}</span> : file.error ? <span class="tag bad">{t.upload.failed}</span> : <span class="tag live">{percent(file.part, 0)}</span>}
                </div>
                {!file.answer && !file.error && <div class="row" style={{ flexWrap: "nowrap" }}><progress value={file.part} max={1} aria-label={file.name} />{stop.current && <button onClick={() => stop.current?.()}>{t.act.cancel}</button>}</div>}
                <Fault error={file.error} />
                {file.answer && <Added answer={file.answer} />}
              </section>
            ))}
          </div>
          {files.some((file) => file.answer?.added) && <div class="row"><a class="button main" href={`/app/cohorts/${encodeURIComponent(cohort)}`}>{t.upload.look}</a></div>}
        </>
      )}
    </CohortPage>
  );
}

function Added({ answer }: { answer: Schemas["AddAnswer"] }) {
  const failed = (answer.results ?? []).flatMap((one) => ("error" in one && one.error ? [one] : []));
  return (
    <>
      {answer.self_intersecting > 0 && <p class="note warn">{t.upload.crossing(answer.self_intersecting)}</p>}
      {failed.length > 0 && (
        <div class="note warn">
          <strong>{t.upload.left(failed.length)}</strong>
          <ul>
            {failed.slice(0, 50).map((one) => {
              const faults = one.error.errors?.length ? one.error.errors : [{ pointer: "", detail: one.error.detail, index: one.index }];
              return faults.map((fault) => <li><Place fault={fault} />{fault.detail}{"external_id" in one && one.external_id ? <> (<code>{one.external_id}</code>)</> : null}</li>);
            })}
          </ul>
          {failed.length > 50 && <p>{t.fault.more(failed.length - 50)}</p>}
        </div>
      )}
      {answer.repeated_points > 0 && <p class="small quiet">{t.upload.repeated(count(answer.repeated_points))}</p>}
    </>
  );
}
