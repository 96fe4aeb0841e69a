/** All dictionaries, and how a new one is learnt. */
import { useState } from "preact/hooks";
import { useMay } from "../api/caller";
import { get, pages, post, type Schemas } from "../api/client";
import { settled } from "../api/jobs";
import { useAction, useEvents, useLoaded } from "../hooks";
import { announce, Dialog, Empty, Fault, Field, Loading, Page, Select } from "../parts/basic";
import { Classes, dimensionOf } from "../parts/classes";
import { isSeams, Seams } from "../parts/correspond";
import { navigate, usePlace } from "../router";
import { filterBody, filterOf } from "../shape/filter";
import { nameOf } from "../shape/terms";
import { count, percent, t, time } from "../strings";
import { useAttributes } from "./cohort";

export function Dictionaries() {
  const list = useLoaded("dictionaries", (signal) =>
    pages((cursor) => get("/v1/dictionaries", { query: { cursor, limit: 1000 }, signal })),
  );
  const { query } = usePlace();
  const writes = useMay("writer");
  const learning = query.has("learn") && writes;
  useEvents(["dictionary_added", "dictionary_deleted", "dictionary_restored"], list.reload);
  return (
    <Page
      title={t.menu.dictionaries}
      lead={t.dictionaries.lead}
      actions={
        writes && (
          <button class="main" onClick={() => navigate("/app/dictionaries?learn=new")}>
            {t.learn.title}
          </button>
        )
      }
    >
      <Loading on={list.loading && !list.data} />
      <Fault error={list.error} retry={list.reload} />
      {list.data?.length === 0 && (
        <Empty>
          <p>{t.dictionaries.none}</p>
        </Empty>
      )}
      {list.data && list.data.length > 0 && (
        <div class="card scroll" tabIndex={0}>
          <table>
            <caption class="hidden">{t.menu.dictionaries}</caption>
            <thead>
              <tr>
                <th scope="col">{t.words.name}</th>
                <th scope="col">{t.words.cohort}</th>
                <th scope="col">{t.words.method}</th>
                <th scope="col" class="number">
                  {t.words.shapes}
                </th>
                <th scope="col" class="number">
                  {t.report.error}
                </th>
                <th scope="col" class="number">
                  {t.report.accuracy}
                </th>
                <th scope="col">{t.words.created}</th>
              </tr>
            </thead>
            <tbody>
              {[...list.data].reverse().map((one) => (
                <tr key={one.id}>
                  <td>
                    <a href={`/app/dictionaries/${encodeURIComponent(`${one.name}@${one.version}`)}`}>{one.name}</a>{" "}
                    <span class="tag">
                      {t.words.version} {one.version}
                    </span>
                  </td>
                  <td>{one.cohort_name}</td>
                  <td class="nowrap">
                    {one.method.kind === "sparse"
                      ? t.dictionaries.atoms(one.atoms)
                      : t.dictionaries.components(one.atoms)}
                  </td>
                  <td class="number">{count(one.shape_count)}</td>
                  <td class="number">{percent(Math.sqrt(one.reconstruction_error))}</td>
                  <td class="number">{percent(one.accuracy)}</td>
                  <td class="nowrap">{time(one.provenance.created_at)}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </div>
      )}
      {learning && (
        <Learn
          cohort={query.get("learn") === "new" ? "" : query.get("learn")!}
          filter={filterOf(query)}
          onClose={() => navigate("/app/dictionaries", true)}
        />
      )}
    </Page>
  );
}

function Learn({
  cohort: given,
  filter: conditions,
  onClose,
}: {
  cohort: string;
  filter: URLSearchParams;
  onClose: () => void;
}) {
  const cohorts = useLoaded("cohorts", (signal) =>
    pages((cursor) => get("/v1/cohorts", { query: { cursor, limit: 1000 }, signal })),
  );
  const [form, setForm] = useState({
    cohort: given,
    name: "",
    kind: "functional_pca",
    size: "10",
    nonzeros: "3",
    transformation: "similarity",
    classes: "",
    robust: false,
    corresponding: false,
  });
  const set = (change: Partial<typeof form>) => setForm({ ...form, ...change });
  const cohort = form.cohort || cohorts.data?.[0]?.name || "";
  // The filter is that of the cohort from which one came.
  const filter = cohort === given ? conditions : new URLSearchParams();
  const about = cohorts.data?.find((one) => one.name === cohort);
  const attributes = useAttributes(cohort, new URLSearchParams(), 0);
  const labels =
    attributes.data?.items.filter(
      (one) => /^(label$|labels\.)/.test(one.name) && one.distinct >= 2 && one.distinct <= 50 && one.type === "text",
    ) ?? [];
  const [part, setPart] = useState<number>();
  const body = (dry_run: boolean): Schemas["LearnRequest"] => ({
    name: form.name.trim() || cohort,
    cohort,
    filter: filterBody(filter),
    transformation: form.transformation as Schemas["ClassName"],
    method:
      form.kind === "sparse"
        ? {
            kind: "sparse",
            atoms: Number(form.size),
            nonzeros: Number(form.nonzeros),
            codes:
              form.transformation === "similarity" && about && dimensionOf(about.representation) === 2
                ? "invariant"
                : "aligned",
          }
        : { kind: "functional_pca", components: Number(form.size), centre: true },
    ...(form.classes && form.kind !== "sparse"
      ? { classifier: { kind: "discriminant" as const, attribute: form.classes } }
      : {}),
    ...(form.robust ? { robust: true } : {}),
    ...(form.corresponding ? { corresponding: true } : {}),
    ...(dry_run ? { dry_run } : {}),
  });
  const action = useAction(async () => {
    const job = (await post("/v1/dictionaries", { body: body(false) })) as Schemas["JobOutput"];
    setPart(0);
    const learnt = (await settled<unknown>(job, new AbortController().signal, (now) => setPart(now.progress))) as {
      dictionary: string;
    };
    const { name, version } = await get("/v1/dictionaries/{dictionary}", { path: { dictionary: learnt.dictionary } });
    announce({ text: t.learn.done(`${name}@${version}`) });
    navigate(`/app/dictionaries/${encodeURIComponent(`${name}@${version}`)}`);
  });
  return (
    <Dialog title={t.learn.title} onClose={onClose}>
      <form
        class="stack"
        onSubmit={(event) => {
          event.preventDefault();
          action.run();
        }}
      >
        <Select
          label={t.words.cohort}
          value={cohort}
          options={(cohorts.data ?? []).map((one) => [one.name, `${one.name} (${count(one.shape_count)})`])}
          onChange={(value) => set({ cohort: value, classes: "" })}
        />
        {filter.size > 0 && (
          <p class="small">
            {t.learn.only}{" "}
            {[...filter]
              .map(
                ([name, value]) =>
                  `${nameOf(name.replace(/\.(gte|lte)$/, ""))} ${name.endsWith(".gte") ? "≥" : name.endsWith(".lte") ? "≤" : "="} ${value}`,
              )
              .join(", ")}
          </p>
        )}
        <Field label={t.words.name}>
          <input placeholder={cohort} value={form.name} onInput={(event) => set({ name: event.currentTarget.value })} />
        </Field>
        <div class="form">
          <Select
            label={t.words.method}
            value={form.kind}
            options={[
              ["functional_pca", t.learn.components],
              ["sparse", t.learn.sparse],
            ]}
            onChange={(kind) => set({ kind })}
          />
          <Field label={form.kind === "sparse" ? t.learn.atoms : t.learn.number}>
            <input
              type="number"
              min={1}
              max={200}
              value={form.size}
              onInput={(event) => set({ size: event.currentTarget.value })}
            />
          </Field>
          {form.kind === "sparse" ? (
            <Field label={t.learn.nonzeros}>
              <input
                type="number"
                min={1}
                max={20}
                value={form.nonzeros}
                onInput={(event) => set({ nonzeros: event.currentTarget.value })}
              />
            </Field>
          ) : (
            <Select
              label={t.learn.classes}
              value={form.classes}
              options={[["", t.words.none], ...labels.map((one): [string, string] => [one.name, nameOf(one.name)])]}
              onChange={(classes) => set({ classes })}
            />
          )}
        </div>
        {about && (
          <Classes
            dimension={dimensionOf(about.representation)}
            value={form.transformation}
            onChange={(transformation) => set({ transformation })}
          />
        )}
        <p class="small quiet">{form.kind === "sparse" ? t.learn.sparseHint : t.learn.componentsHint}</p>
        {form.kind !== "sparse" && (
          <label class="check">
            <input
              type="checkbox"
              checked={form.robust}
              onChange={(event) => set({ robust: event.currentTarget.checked })}
            />
            <span>{t.robust.use}</span>
          </label>
        )}
        {isSeams(action.error) ? (
          <Seams
            cohort={cohort}
            onAsTheyAre={() => {
              set({ corresponding: true });
              action.clear();
            }}
          />
        ) : (
          <Fault error={action.error ?? cohorts.error} />
        )}
        {action.busy && (
          <label class="stack tight">
            <span>{t.learn.busy}</span>
            <progress value={part} max={1} />
          </label>
        )}
        <div class="row">
          <button class="main" disabled={action.busy || !cohort}>
            {t.learn.begin}
          </button>
          <button type="button" onClick={onClose}>
            {action.busy ? t.learn.background : t.act.cancel}
          </button>
        </div>
      </form>
    </Dialog>
  );
}
