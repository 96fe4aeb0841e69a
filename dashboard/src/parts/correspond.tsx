/** Spheres with parameters that correspond, as a new cohort: without them a mean of fitted meshes is the mean of their seams. */
import { useEffect, useRef, useState } from "preact/hooks";
import { useMay } from "../api/caller";
import { get, pages, post, Refusal, type Schemas } from "../api/client";
import { settled } from "../api/jobs";
import { useAction } from "../hooks";
import { navigate } from "../router";
import { t } from "../strings";
import { Dialog, Fault, Field } from "./basic";

export const isSphere = (representation: Schemas["Representation"] | undefined): boolean =>
  representation?.kind === "surface" && representation.topology === "sphere";

/** Makes the surfaces of a cohort correspond, in a new one. */
export async function corresponded(
  cohort: string,
  name: string,
  signal: AbortSignal,
  progress: (part: number | null) => void,
): Promise<string> {
  const job = await post("/v1/cohorts/{cohort}/correspond", { path: { cohort }, body: { name } });
  await settled<unknown>(job, signal, (now) => progress(now.progress));
  return name;
}

/** A name that no cohort has: with a number behind it if it is taken. */
export async function freeName(wanted: string): Promise<string> {
  const taken = new Set(
    (await pages((cursor) => get("/v1/cohorts", { query: { cursor, limit: 1000 } }))).map((one) => one.name),
  );
  if (!taken.has(wanted)) return wanted;
  const number = Array.from({ length: taken.size + 1 }, (_, k) => k + 2).find((k) => !taken.has(`${wanted}-${k}`));
  return `${wanted}-${number}`;
}

export function Correspond({ cohort, onClose }: { cohort: string; onClose: () => void }) {
  const [part, setPart] = useState<number | null>(null);
  const leaving = useRef(new AbortController());
  useEffect(() => () => leaving.current.abort(), []);
  const action = useAction(async (form: FormData) => {
    const name = String(form.get("name") ?? "").trim();
    await corresponded(cohort, name, leaving.current.signal, setPart);
    onClose();
    navigate(`/app/cohorts/${encodeURIComponent(name)}`);
  });
  return (
    <Dialog title={t.correspond.title} onClose={onClose}>
      <form
        class="stack"
        onSubmit={(event) => {
          event.preventDefault();
          action.run(new FormData(event.currentTarget));
        }}
      >
        <p class="prose">{t.correspond.hint}</p>
        <Field label={t.correspond.name}>
          <input name="name" required maxLength={100} defaultValue={`${cohort}-corresponding`} />
        </Field>
        {action.busy && <progress value={part ?? undefined} max={1} aria-label={t.correspond.title} />}
        <Fault error={action.error} />
        <div class="row">
          <button class="main" disabled={action.busy}>
            {t.correspond.start}
          </button>
          <button type="button" onClick={onClose}>
            {t.act.cancel}
          </button>
        </div>
      </form>
    </Dialog>
  );
}

/** Whether the service refused surfaces whose points do not correspond. */
export const isSeams = (error: Error | undefined): boolean =>
  error instanceof Refusal &&
  error.problem.errors.some((fault) => fault.pointer === "/corresponding" || fault.parameter === "corresponding");

/** Surfaces whose points do not correspond, in plain words, with the remedy. */
export function Seams({ cohort, onAsTheyAre }: { cohort: string; onAsTheyAre: () => void }) {
  const [ask, setAsk] = useState(false);
  const writes = useMay("writer");
  return (
    <div class="note warn" role="alert" onSubmit={(event) => event.stopPropagation()}>
      <strong>{t.correspond.refused}</strong>
      <p>{t.correspond.refusedHint}</p>
      <div class="row">
        {writes && (
          <button type="button" class="main" onClick={() => setAsk(true)}>
            {t.correspond.title}
          </button>
        )}
        <button type="button" onClick={onAsTheyAre}>
          {t.correspond.asTheyAre}
        </button>
      </div>
      {ask && <Correspond cohort={cohort} onClose={() => setAsk(false)} />}
    </div>
  );
}

/** The work itself, after an upload: its progress, and then the way to the cohort. */
export function Corresponding({ cohort, onDone }: { cohort: string; onDone?: (name: string) => void }) {
  const [part, setPart] = useState<number | null>(null);
  const [name, setName] = useState("");
  const leaving = useRef(new AbortController());
  const action = useAction(async () => {
    const made = await corresponded(cohort, await freeName(`${cohort}-corresponding`), leaving.current.signal, setPart);
    setName(made);
    onDone?.(made);
  });
  useEffect(() => {
    action.run();
    return () => leaving.current.abort();
  }, []);
  return (
    <div class="card" aria-live="polite">
      <h2>{name ? t.correspond.done : t.correspond.busy}</h2>
      <p class="small quiet">{t.correspond.hint}</p>
      {action.busy && <progress value={part ?? undefined} max={1} aria-label={t.correspond.title} />}
      <Fault error={action.error} retry={() => action.run()} />
      {name && (
        <div class="row">
          <a class="button main" href={`/app/cohorts/${encodeURIComponent(name)}`}>
            {t.correspond.look(name)}
          </a>
        </div>
      )}
    </div>
  );
}
