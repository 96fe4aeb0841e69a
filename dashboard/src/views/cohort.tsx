/** A cohort: its shapes in one picture, filters with their counts, sizes, and the table. */
import type { ComponentChildren } from "preact";
import { useEffect, useState } from "preact/hooks";
import { useMay } from "../api/caller";
import { get, patch, post, remove, type Schemas } from "../api/client";
import { useAction, useEvents, useLoaded, useSettled } from "../hooks";
import { announce, Dialog, Empty, Fault, Field, Loading, Page, Tabs } from "../parts/basic";
import { Bulk } from "../parts/bulk";
import { Chart, Spark } from "../parts/chart";
import { Correspond, isSphere } from "../parts/correspond";
import { Find } from "../parts/find";
import { Sheet, SolidSheet, SpatialSheet } from "../parts/sheet";
import { navigate, usePlace } from "../router";
import { bounded, filterBody, filterOf, toggled, withFilter } from "../shape/filter";
import { hasMesh, inPlane, isDots } from "../shape/points";
import { nameOf } from "../shape/terms";
import { count, number, t, UNITS, unit } from "../strings";
import { describe } from "./cohorts";

type Attribute = Schemas["AttributesAnswer"]["items"][number];

/** Head and tabs of every view of a cohort. */
export function CohortPage({
  cohort,
  lead,
  actions,
  mayBeEmpty,
  children,
}: {
  cohort: string;
  lead?: ComponentChildren;
  actions?: ComponentChildren;
  /** Whether the view has something to show of a cohort without shapes. */
  mayBeEmpty?: boolean;
  children: (about: Schemas["CohortOutput"], reload: () => void, round: number) => ComponentChildren;
}) {
  const { query } = usePlace();
  const writes = useMay("writer");
  const about = useLoaded(cohort, (signal) => get("/v1/cohorts/{cohort}", { path: { cohort }, signal }));
  useEvents(
    ["cohort_updated", "shapes_added", "shape_updated", "shapes_updated", "shape_deleted", "shapes_deleted"],
    (_, data) => {
      if (!about.data || data.cohort === about.data.id) about.reload();
    },
  );
  const base = `/app/cohorts/${encodeURIComponent(cohort)}`;
  const tabs: [string, string][] = [
    [t.cohort.overview, withFilter(base, query)],
    [t.cohort.table, withFilter(`${base}/table`, query)],
    [t.cohort.mean, withFilter(`${base}/mean`, query)],
    [t.cohort.compare, withFilter(`${base}/compare`, query)],
    [t.cohort.regression, withFilter(`${base}/regression`, query)],
    [t.linear.tab, withFilter(`${base}/model`, query)],
    ...(writes ? ([[t.cohort.upload, `${base}/upload`]] as [string, string][]) : []),
  ];
  const empty = about.data?.shape_count === 0 && !mayBeEmpty;
  const facts =
    about.data &&
    [
      describe(about.data.representation),
      about.data.shape_count === 1 ? t.cohort.shape : t.cohort.shapes(count(about.data.shape_count)),
      t.cohort.revision(about.data.revision),
      about.data.length_unit && t.cohort.unit(about.data.length_unit),
    ]
      .filter(Boolean)
      .join(" · ");
  return (
    <Page
      title={cohort}
      crumbs={[[t.menu.cohorts, "/app/cohorts"]]}
      lead={
        lead ?? (
          <>
            {about.data?.description && (
              <>
                {about.data.description}
                <br />
              </>
            )}
            <span class="small">{facts}</span>
          </>
        )
      }
      actions={about.error || !writes ? undefined : actions}
    >
      <div class="row spread tabs-row">
        <Tabs label={cohort} tabs={about.error ? [] : tabs} />
        {about.data && about.data.shape_count > 1 && <Find cohort={cohort} revision={about.data.revision} />}
      </div>
      <Fault error={about.error} retry={about.reload} />
      {empty ? (
        <Empty>
          <p>{t.cohort.empty}</p>
          {writes && (
            <a class="button main" href={`${base}/upload`}>
              {t.cohort.upload}
            </a>
          )}
        </Empty>
      ) : about.data ? (
        children(about.data, about.reload, about.data.revision)
      ) : (
        !about.error && <Loading on />
      )}
    </Page>
  );
}

export function useAttributes(cohort: string, filter: URLSearchParams, revision: number, bins = 24) {
  const query = new URLSearchParams(filter);
  query.set("values", "40");
  query.set("bins", String(bins));
  return useLoaded(cohort ? `${cohort} ${query} ${revision}` : null, (signal) =>
    get("/v1/cohorts/{cohort}/attributes", { path: { cohort }, query, signal }),
  );
}

/** Attributes whose values are worth a filter: few texts, or numbers. */
const filterable = (one: Attribute) =>
  one.name !== "external_id" &&
  one.name !== "created_at" &&
  one.name !== "measures.points" &&
  (one.type === "number" || (one.distinct > 1 && one.distinct <= 200) || one.type === "boolean");

export function Facets({
  all,
  shown,
  lengthUnit,
}: {
  all: Attribute[];
  shown: Attribute[] | undefined;
  lengthUnit: string | null | undefined;
}) {
  const { query } = usePlace();
  return (
    <div class="stack" role="group" aria-label={t.cohort.filters}>
      {all.filter(filterable).map((one) => {
        const now = shown?.find((other) => other.name === one.name);
        const measure = one.name.replace("measures.", "");
        const suffix = one.name.startsWith("measures.") && unit(measure, lengthUnit);
        return (
          <fieldset class="facet" key={one.name}>
            <legend>
              {nameOf(one.name)}
              {suffix && ` (${suffix})`}
            </legend>
            {one.type === "number" ? (
              <Range attribute={one} now={now} />
            ) : (
              <Values attribute={one} now={now} query={query} />
            )}
          </fieldset>
        );
      })}
    </div>
  );
}

function Values({
  attribute,
  now,
  query,
}: {
  attribute: Attribute;
  now: Attribute | undefined;
  query: URLSearchParams;
}) {
  const [all, setAll] = useState(false);
  const counts = new Map(now?.values.map((value) => [String(value.value), value.count]));
  const values = all ? attribute.values : attribute.values.slice(0, 8);
  return (
    <>
      {values.map((value) => {
        const name = String(value.value);
        return (
          <label class="check" key={name}>
            <input
              type="checkbox"
              aria-label={`${attribute.type === "boolean" ? (name === "true" ? t.words.yes : t.words.no) : name} (${counts.get(name) ?? 0})`}
              checked={query.getAll(attribute.name).includes(name)}
              onChange={() => navigate(toggled(query, attribute.name, name), true)}
            />
            <span title={name}>
              {attribute.type === "boolean" ? (name === "true" ? t.words.yes : t.words.no) : name}
            </span>
            <span class="count quiet number">{count(counts.get(name) ?? 0)}</span>
          </label>
        );
      })}
      {attribute.values.length > 8 && (
        <button class="plain small" onClick={() => setAll(!all)}>
          {all ? t.act.less : t.act.more(attribute.values.length - 8)}
        </button>
      )}
    </>
  );
}

function Range({ attribute, now }: { attribute: Attribute; now: Attribute | undefined }) {
  const { query } = usePlace();
  const [low, setLow] = useState(query.get(`${attribute.name}.gte`) ?? "");
  const [high, setHigh] = useState(query.get(`${attribute.name}.lte`) ?? "");
  const settledLow = useSettled(low, 400),
    settledHigh = useSettled(high, 400);
  useEffect(() => {
    const here = new URLSearchParams(location.search);
    if (settledLow !== (here.get(`${attribute.name}.gte`) ?? ""))
      navigate(bounded(here, `${attribute.name}.gte`, settledLow), true);
  }, [settledLow]);
  useEffect(() => {
    const here = new URLSearchParams(location.search);
    if (settledHigh !== (here.get(`${attribute.name}.lte`) ?? ""))
      navigate(bounded(here, `${attribute.name}.lte`, settledHigh), true);
  }, [settledHigh]);
  const counts = now?.histogram?.counts ?? attribute.histogram?.counts;
  return (
    <>
      {counts && <Spark counts={counts} label={t.cohort.spark(nameOf(attribute.name))} />}
      <div class="between">
        <input
          type="number"
          step="any"
          aria-label={t.cohort.from(nameOf(attribute.name))}
          placeholder={number(attribute.min, 3)}
          value={low}
          onInput={(event) => setLow(event.currentTarget.value)}
        />
        <input
          type="number"
          step="any"
          aria-label={t.cohort.to(nameOf(attribute.name))}
          placeholder={number(attribute.max, 3)}
          value={high}
          onInput={(event) => setHigh(event.currentTarget.value)}
        />
      </div>
    </>
  );
}

export function Chips({ total, shown }: { total: number; shown: number | undefined }) {
  const { query } = usePlace();
  const filter = [...filterOf(query)];
  return (
    <div class="row">
      <strong aria-live="polite">
        {shown === undefined || shown === total
          ? total === 1
            ? t.cohort.shape
            : t.cohort.all(count(total))
          : t.cohort.some(count(shown), count(total))}
      </strong>
      <div class="chips">
        {filter.map(([name, value]) => (
          <button
            key={`${name} ${value}`}
            onClick={() => navigate(toggled(query, name, value))}
            aria-label={t.cohort.without(nameOf(name), value)}
          >
            {nameOf(name.replace(/\.(gte|lte)$/, ""))} {name.endsWith(".gte") ? "≥" : name.endsWith(".lte") ? "≤" : "="}{" "}
            {value} ✕
          </button>
        ))}
      </div>
    </div>
  );
}

export function Overview({ cohort }: { cohort: string }) {
  const { query } = usePlace();
  const filter = filterOf(query);
  return (
    <CohortPage cohort={cohort} actions={<CohortActions cohort={cohort} />}>
      {(about, _, revision) => <Shapes cohort={cohort} about={about} filter={filter} revision={revision} />}
    </CohortPage>
  );
}

function Shapes({
  cohort,
  about,
  filter,
  revision,
}: {
  cohort: string;
  about: Schemas["CohortOutput"];
  filter: URLSearchParams;
  revision: number;
}) {
  const all = useAttributes(cohort, new URLSearchParams(), revision);
  const some = useAttributes(cohort, filter, revision);
  const writes = useMay("writer");
  const shown = some.data ?? all.data;
  const names = (all.data?.items ?? []).map((one) => one.name).filter((name) => name !== "measures.points");
  const sizes = shown?.items.filter(
    (one) =>
      one.name.startsWith("measures.") && one.type === "number" && one.name !== "measures.points" && one.histogram,
  );
  return (
    <>
      <Fault error={some.error ?? all.error} />
      <div class="aside">
        <details class="card filters" open={matchMedia("(min-width: 1021px)").matches}>
          <summary>{t.cohort.filters}</summary>
          {all.data ? (
            <Facets all={all.data.items} shown={some.data?.items} lengthUnit={about.length_unit} />
          ) : (
            <Loading on />
          )}
        </details>
        <div class="stack" style={{ gap: "22px" }}>
          <Chips total={about.shape_count} shown={some.data?.shape_count} />
          {writes && (
            <details class="card">
              <summary>{t.bulk.summary}</summary>
              <Bulk
                cohort={cohort}
                names={names.filter((name) => name.startsWith("labels."))}
                target={{ filter: filterBody(filter), size: some.data?.shape_count ?? about.shape_count }}
              />
            </details>
          )}
          {hasMesh(about.representation) ? (
            <SolidSheet cohort={cohort} filter={filter} revision={revision} names={names} />
          ) : isDots(about.representation) && !inPlane(about.representation) ? (
            <SpatialSheet cohort={cohort} filter={filter} revision={revision} names={names} />
          ) : (
            <Sheet cohort={cohort} filter={filter} revision={revision} total={about.shape_count} names={names} />
          )}
          <section class="columns">
            {sizes?.map((one) => {
              const { edges, counts } = barsOf(one);
              const measure = one.name.replace("measures.", "");
              const suffix = unit(measure, about.length_unit);
              const label = nameOf(one.name) + (suffix && ` (${suffix})`);
              return (
                <figure class="card" key={one.name}>
                  <h3>{label}</h3>
                  <Histogram edges={edges} counts={counts} label={label} />
                  <figcaption>
                    {t.cohort.sizes(
                      number(one.quantiles?.find((q) => q.probability === 0.5)?.value),
                      number(one.quantiles?.find((q) => q.probability === 0.05)?.value),
                      number(one.quantiles?.find((q) => q.probability === 0.95)?.value),
                      suffix,
                    )}
                  </figcaption>
                </figure>
              );
            })}
          </section>
        </div>
      </div>
    </>
  );
}

/** Bars of a histogram: one for each value of few whole numbers, which bins of equal width would comb. */
function barsOf(one: Attribute): { edges: number[]; counts: number[] } {
  const values = one.values.map(({ value }) => Number(value));
  const [low, high] = [one.min ?? 0, one.max ?? 0];
  if (one.distinct > values.length || !values.every(Number.isInteger) || high - low > 60 || high === low)
    return one.histogram!;
  const counts = Array.from({ length: high - low + 1 }, () => 0);
  for (const { value, count } of one.values) counts[Number(value) - low] = count;
  return { edges: Array.from({ length: counts.length + 1 }, (_, k) => low - 0.5 + k), counts };
}

function Histogram({ edges, counts, label }: { edges: number[]; counts: number[]; label: string }) {
  const x = counts.map((_, index) => (edges[index]! + edges[index + 1]!) / 2);
  if (edges[0] === edges[edges.length - 1]) return <p class="quiet">{t.cohort.same(number(edges[0]))}</p>;
  return (
    <Chart
      x={x}
      lines={[{ label, values: counts, kind: "bars" }]}
      xLabel={label}
      yLabel={t.words.shapes}
      height={190}
      describe={t.cohort.spark(label)}
      range={[0, null]}
    />
  );
}

function CohortActions({ cohort }: { cohort: string }) {
  const { query } = usePlace();
  const learn = new URLSearchParams([["learn", cohort], ...filterOf(query)]);
  const [ask, setAsk] = useState<"" | "change" | "delete" | "correspond">("");
  const about = useLoaded(cohort, (signal) => get("/v1/cohorts/{cohort}", { path: { cohort }, signal }));
  const representation = about.data?.representation;
  const spheres = isSphere(representation);
  return (
    <>
      {spheres && <button onClick={() => setAsk("correspond")}>{t.correspond.title}</button>}
      {ask === "correspond" && <Correspond cohort={cohort} onClose={() => setAsk("")} />}
      <a class="button" href={`/app/dictionaries?${learn}`}>
        {t.learn.title}
      </a>
      <button onClick={() => setAsk("change")}>{t.act.change}</button>
      <button class="bad" onClick={() => setAsk("delete")}>
        {t.act.remove}
      </button>
      {ask === "delete" && <DeleteCohort cohort={cohort} onClose={() => setAsk("")} />}
      {ask === "change" && <ChangeCohort cohort={cohort} onClose={() => setAsk("")} />}
    </>
  );
}

function DeleteCohort({ cohort, onClose }: { cohort: string; onClose: () => void }) {
  const action = useAction(async () => {
    const { id } = await get("/v1/cohorts/{cohort}", { path: { cohort } });
    await remove("/v1/cohorts/{cohort}", { path: { cohort } });
    navigate("/app/cohorts");
    announce({
      text: t.cohort.deleted(cohort),
      undo: async () => {
        await post("/v1/trash/{id}/restore", { path: { id } });
        navigate(`/app/cohorts/${encodeURIComponent(cohort)}`);
      },
    });
  });
  return (
    <Dialog title={t.cohort.deleteTitle(cohort)} onClose={onClose}>
      <p>{t.cohort.deleteHint}</p>
      <Fault error={action.error} />
      <div class="row">
        <button class="bad" disabled={action.busy} onClick={() => action.run()}>
          {t.act.remove}
        </button>
        <button onClick={onClose}>{t.act.cancel}</button>
      </div>
    </Dialog>
  );
}

const isCurve = ({ representation: { kind } }: Schemas["CohortOutput"]) =>
  kind === "closed_curve" || kind === "open_curve";

/** The parts of the rule of matching that were changed. */
function ruleOf(about: Schemas["CohortOutput"], text: (name: string) => string) {
  const changed = Object.entries({
    correspondence: about.correspondence,
    direction: about.direction,
    mirror: about.mirror,
  }).filter(([name, before]) => text(name) && text(name) !== before);
  return Object.fromEntries(changed.map(([name]) => [name, text(name)]));
}

/** How shapes are matched: a change makes a new revision. */
function RuleFields({ about }: { about: Schemas["CohortOutput"] }) {
  const choices = (name: string, label: string, value: string, options: Record<string, string>) => (
    <Field key={name} label={label}>
      <select name={name} defaultValue={value}>
        {Object.entries(options).map(([id, text]) => (
          <option key={id} value={id} selected={id === value}>
            {text}
          </option>
        ))}
      </select>
    </Field>
  );
  return (
    <>
      {isCurve(about) &&
        choices(
          "correspondence",
          t.cohorts.correspondence,
          about.correspondence,
          Object.fromEntries(
            Object.entries(t.correspondences).filter(
              ([id]) => about.representation.kind === "closed_curve" || id !== "cyclic",
            ),
          ),
        )}
      {isCurve(about) && choices("direction", t.cohorts.direction, about.direction, t.directions)}
      {choices("mirror", t.cohorts.mirror, about.mirror, t.mirrors)}
    </>
  );
}

function ChangeCohort({ cohort, onClose }: { cohort: string; onClose: () => void }) {
  const now = useLoaded(cohort, (signal) => get("/v1/cohorts/{cohort}", { path: { cohort }, signal }));
  const action = useAction(async (form: FormData) => {
    const text = (name: string) => String(form.get(name) ?? "").trim();
    const changed = await patch("/v1/cohorts/{cohort}", {
      path: { cohort },
      body: {
        name: text("name"),
        description: text("description") || null,
        length_unit: text("unit") || null,
        ...ruleOf(now.data!, text),
      },
    });
    onClose();
    announce({ text: t.act.saved });
    if (changed.name !== cohort) navigate(`/app/cohorts/${encodeURIComponent(changed.name)}`);
  });
  return (
    <Dialog title={t.cohort.changeTitle(cohort)} onClose={onClose}>
      {now.data && (
        <form
          class="stack"
          onSubmit={(event) => {
            event.preventDefault();
            action.run(new FormData(event.currentTarget));
          }}
        >
          <Field label={t.words.name}>
            <input name="name" required defaultValue={now.data.name} />
          </Field>
          <Field label={t.words.description}>
            <input name="description" defaultValue={now.data.description ?? ""} />
          </Field>
          <Field label={t.words.unit}>
            <select name="unit">
              {[["", t.upload.unsaid] as [string, string], ...UNITS].map(([id, name]) => (
                <option key={id} value={id} selected={id === (now.data!.length_unit ?? "")}>
                  {name}
                </option>
              ))}
            </select>
          </Field>
          <RuleFields about={now.data} />
          <Fault error={action.error} />
          <div class="row">
            <button class="main" disabled={action.busy}>
              {t.act.save}
            </button>
            <button type="button" onClick={onClose}>
              {t.act.cancel}
            </button>
          </div>
        </form>
      )}
    </Dialog>
  );
}
