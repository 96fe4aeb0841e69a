/** Long work: live, with progress, and stopped when it is not wanted. */
import { useState } from "preact/hooks";
import { get, pages, post, type Schemas } from "../api/client";
import { useAction, useEvents, useLoaded } from "../hooks";
import { announce, Empty, Fault, Loading, Page, Select, Sentence } from "../parts/basic";
import { useSetting } from "../router";
import { number, percent, t, time } from "../strings";

type Job = Schemas["JobEntry"];

export function Jobs() {
  const [status, setStatus] = useSetting("status", "");
  const [now, setNow] = useState<Record<string, { progress: number; seconds_left: number | null }>>({});
  const list = useLoaded(`jobs ${status}`, (signal) =>
    pages((cursor) => get("/v1/jobs", { query: { status, cursor, limit: 100 }, signal }), 200),
  );
  const live = useEvents(
    ["job_queued", "job_succeeded", "job_failed", "job_cancelled", "job_progress"],
    (kind, data) => {
      if (kind !== "job_progress") return list.reload();
      const id = String(data.object ?? data.job ?? data.id);
      setNow((before) => ({
        ...before,
        [id]: { progress: Number(data.progress), seconds_left: (data.seconds_left as number | null) ?? null },
      }));
      if (list.data?.some((one) => one.id === id && one.status === "queued")) list.reload();
    },
  );
  return (
    <Page
      title={t.menu.jobs}
      lead={t.jobs.lead}
      actions={<span class={`tag ${live ? "live" : "warn"}`}>{live ? t.jobs.live : t.jobs.offline}</span>}
    >
      <div class="form" style={{ maxWidth: "260px" }}>
        <Select
          label={t.jobs.status}
          value={status}
          options={[["", t.jobs.all], ...Object.entries(t.jobs.states)]}
          onChange={setStatus}
        />
      </div>
      <Fault error={list.error} retry={list.reload} />
      <Loading on={list.loading && !list.data} />
      {list.data?.length === 0 && (
        <Empty>
          <p>{t.jobs.none}</p>
        </Empty>
      )}
      {list.data && list.data.length > 0 && (
        <div class="card scroll" tabIndex={0}>
          <table>
            <caption class="hidden">{t.menu.jobs}</caption>
            <thead>
              <tr>
                <th scope="col">{t.jobs.work}</th>
                <th scope="col">{t.jobs.status}</th>
                <th scope="col">{t.jobs.progress}</th>
                <th scope="col">{t.jobs.begun}</th>
                <th scope="col" class="number">
                  {t.jobs.duration}
                </th>
                <th scope="col">
                  <span class="hidden">{t.act.cancel}</span>
                </th>
              </tr>
            </thead>
            <tbody>
              {list.data.map((one) => (
                <Row key={one.id} job={one} now={now[one.id]} onChange={list.reload} />
              ))}
            </tbody>
          </table>
        </div>
      )}
    </Page>
  );
}

function Row({
  job,
  now,
  onChange,
}: {
  job: Job;
  now: { progress: number; seconds_left: number | null } | undefined;
  onChange: () => void;
}) {
  const open = job.status === "queued" || job.status === "running";
  const cancel = useAction(async () => {
    await post("/v1/jobs/{job}/cancel", { path: { job: job.id } });
    announce({ text: t.jobs.cancelled });
    onChange();
  });
  const result = useAction(async () => {
    const full = await get("/v1/jobs/{job}", { path: { job: job.id } });
    const dictionary = (full.result as { dictionary?: string } | null)?.dictionary;
    if (dictionary) location.assign(`/app/dictionaries/${encodeURIComponent(dictionary)}`);
  });
  const progress = open ? Math.max(now?.progress ?? 0, job.progress) : job.progress;
  const left = now?.seconds_left ?? job.seconds_left;
  const seconds =
    job.started_at && job.finished_at ? (Date.parse(job.finished_at) - Date.parse(job.started_at)) / 1000 : null;
  const tone = { succeeded: "good", failed: "bad", cancelled: "warn", running: "live", queued: "" }[job.status];
  return (
    <tr>
      <td>
        <strong>{t.jobs.kinds[job.kind]}</strong>
        <div class="small quiet mono">{job.id}</div>
        {job.problem && (
          <div class="small" style={{ color: "var(--bad)" }}>
            <Sentence text={job.problem.detail} />
          </div>
        )}
        <Fault error={cancel.error} />
      </td>
      <td>
        <span class={`tag ${tone}`}>{t.jobs.states[job.status]}</span>
      </td>
      <td style={{ minWidth: "150px" }}>
        {open ? (
          <>
            <progress value={progress} max={1} aria-label={t.jobs.progress} />
            <div class="small quiet">
              {percent(progress, 0)}
              {left ? `, ${t.jobs.left(number(left, 2))}` : ""}
            </div>
          </>
        ) : (
          percent(progress, 0)
        )}
      </td>
      <td class="nowrap">{time(job.created_at)}</td>
      <td class="number">{seconds === null ? "–" : `${number(seconds, 3)} s`}</td>
      <td>
        {open ? (
          <button disabled={cancel.busy} onClick={() => cancel.run()}>
            {t.act.cancel}
          </button>
        ) : job.kind === "learn_dictionary" && job.status === "succeeded" ? (
          <button class="plain" disabled={result.busy} onClick={() => result.run()}>
            {t.words.dictionary}
          </button>
        ) : null}
      </td>
    </tr>
  );
}
