/** A cohort: its shapes in one picture, filters with their counts, sizes, and the table. */
import type { ComponentChildren } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { get, patch, post, remove, type Schemas, send } from "../api/client";
import { settled } from "../api/jobs";
import { useAction, useEvents, useLoaded, useSettled } from "../hooks";
import {
  announce,
  Choice,
  Dialog,
  Download,
  Empty,
  Fault,
  Field,
  Loading,
  Page,
  PICTURES,
  Picture,
  SortHead,
  Tabs,
} from "../parts/basic";
import { Chart, Spark } from "../parts/chart";
import { navigate, usePlace, useSetting } from "../router";
import { bounded, filterOf, toggled, withFilter } from "../shape/filter";
import { hasMesh } from "../shape/points";
import { count, number, t, time, UNITS, unit } from "../strings";
import { describe } from "./cohorts";

type Attribute = Schemas["AttributesAnswer"]["items"][number];

/** Head and tabs of every view of a cohort. */
export function CohortPage({
  cohort,
  lead,
  actions,
  children,
}: {
  cohort: string;
  lead?: ComponentChildren;
  actions?: ComponentChildren;
  children: (about: Schemas["CohortOutput"], reload: () => void, round: number) => ComponentChildren;
}) {
  const { query } = usePlace();
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
    [t.cohort.upload, `${base}/upload`],
  ];
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
      actions={actions}
    >
      <Tabs label={cohort} tabs={tabs} />
      <Fault error={about.error} retry={about.reload} />
      {about.data ? children(about.data, about.reload, about.data.revision) : !about.error && <Loading on />}
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

export const nameOf = (attribute: string): string =>
  (t.attributes as Record<string, string>)[attribute] ?? attribute.replace(/^labels\./, "").replaceAll("_", " ");

function Facets({
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

/** The paths of a contact sheet, which the service draws, each a link to its shape. */
function Sheet({
  cohort,
  filter,
  revision,
  total,
}: {
  cohort: string;
  filter: URLSearchParams;
  revision: number;
  total: number;
}) {
  const [cursor, setCursor] = useSetting("cursor", "");
  const [scale, setScale] = useSetting("scale", "");
  const [largest, setLargest] = useState(1);
  const query = new URLSearchParams(filter);
  for (const [name, value] of [
    ["columns", "1"],
    ["size", "96"],
    ["limit", "90"],
    ["title", "false"],
    ["scale_bar", "false"],
    ["background", "none"],
    ["theme", "light"],
  ])
    query.append(name!, value!);
  if (cursor) query.set("cursor", cursor);
  const sheet = useLoaded(`${cohort} ${query} ${revision}`, async (signal) => {
    const response = await send("GET", `/v1/cohorts/${encodeURIComponent(cohort)}/sheet?${query}`, {
      headers: { accept: "image/svg+xml" },
      signal,
    });
    const next = /[?&]cursor=([^&>]*)/.exec(response.headers.get("link") ?? "")?.[1];
    const drawing = new DOMParser().parseFromString(await response.text(), "image/svg+xml");
    const cells = [...drawing.querySelectorAll("g, path")]
      .filter((one) => [...one.children].some((child) => child.tagName === "title"))
      .map((one) => ({
        id: [...one.children].find((child) => child.tagName === "title")!.textContent ?? "",
        paths: (one.tagName === "path" ? [one] : [...one.querySelectorAll("path")]).map(
          (path) => path.getAttribute("d") ?? "",
        ),
        // Landmarks: lines without length, whose round ends are dots of one size on the screen.
        dots: [...one.querySelectorAll("circle")]
          .map((dot) => `M${dot.getAttribute("cx")} ${dot.getAttribute("cy")}h0`)
          .join(""),
      }));
    return { cells, next: next ? decodeURIComponent(next) : "" };
  });
  return (
    <section class="card" aria-busy={sheet.loading}>
      <div class="row spread">
        <div class="row">
          <h2>{t.cohort.sheet}</h2>
          <Choice
            label={t.cohort.scale}
            value={scale}
            options={[
              ["", t.cohort.oneScale],
              ["own", t.cohort.ownScale],
            ]}
            onChange={setScale}
          />
        </div>
        <Download
          name={`${cohort}-sheet`}
          source={{ path: `/v1/cohorts/${encodeURIComponent(cohort)}/sheet`, query: filter, ownWidth: true }}
          formats={PICTURES}
        />
      </div>
      <Fault error={sheet.error} />
      {sheet.data?.cells.length === 0 && total > 0 && <p class="quiet">{t.cohort.nothing}</p>}
      <div class="sheet">
        {sheet.data?.cells.map((cell) => (
          <a
            key={cell.id}
            href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(cell.id)}`}
            title={cell.id}
            aria-label={cell.id}
          >
            <Cell
              paths={cell.paths}
              dots={cell.dots}
              size={scale === "own" ? undefined : largest}
              onSize={(size) => setLargest((before) => Math.max(before, size))}
            />
          </a>
        ))}
      </div>
      <Pages cursor={cursor} next={sheet.data?.next} onNext={(next) => setCursor(next, false)} />
    </section>
  );
}

/** The way to the pages before and after. */
function Pages({
  cursor,
  next,
  onNext,
}: {
  cursor: string;
  next: string | null | undefined;
  onNext: (next: string) => void;
}) {
  if (!cursor && !next) return null;
  return (
    <div class="row">
      {cursor && <button onClick={() => history.back()}>{t.act.previous}</button>}
      {next && <button onClick={() => onNext(next)}>{t.act.next}</button>}
    </div>
  );
}

/** Surfaces are pictures of the service, twelve a page, with links below. */
function SolidSheet({ cohort: name, filter, revision }: { cohort: string; filter: URLSearchParams; revision: number }) {
  const cohort = name,
    path = `/v1/cohorts/${encodeURIComponent(cohort)}`;
  const [cursor, setCursor] = useSetting("cursor", "");
  const page: [string, string][] = [...filter, ["limit", "12"]];
  if (cursor) page.push(["cursor", cursor]);
  const query = new URLSearchParams([...page, ["columns", "4"], ["size", "170"]]);
  const listed = useLoaded(`${cohort} ${query} ${revision}`, (signal) =>
    get("/v1/cohorts/{cohort}/shapes", {
      path: { cohort },
      query: new URLSearchParams([...page, ["fields", "id,external_id"]]),
      signal,
    }),
  );
  return (
    <section class="card">
      <h2>{t.cohort.sheet}</h2>
      <Picture
        key={`${revision} ${cursor}`}
        source={{ path: `${path}/sheet`, query, ownWidth: true }}
        name={`${cohort}-sheet`}
        alt={t.cohort.sheet}
      />
      <Fault error={listed.error} />
      <div class="chips">
        {listed.data?.items.map((one) => (
          <a
            class="tag"
            key={one.id}
            href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(one.external_id ?? one.id ?? "")}`}
          >
            {one.external_id ?? one.id}
          </a>
        ))}
      </div>
      <Pages cursor={cursor} next={listed.data?.next} onNext={(next) => setCursor(next, false)} />
    </section>
  );
}

/** A shape in the middle of its cell: `size` units of the sheet wide, or as large as fits. */
function Cell({
  paths,
  dots,
  size,
  onSize,
}: {
  paths: string[];
  dots: string;
  size: number | undefined;
  onSize: (size: number) => void;
}) {
  const [bounds, setBounds] = useState<DOMRect>();
  const measure = (group: SVGGElement | null) => {
    if (!group || bounds) return;
    const found = group.getBBox();
    setBounds(found);
    onSize(Math.max(found.width, found.height));
  };
  const side = 1.04 * (size ?? (bounds ? Math.max(bounds.width, bounds.height) : 640));
  const view = bounds
    ? `${bounds.x + bounds.width / 2 - side / 2} ${bounds.y + bounds.height / 2 - side / 2} ${side} ${side}`
    : "0 0 640 640";
  return (
    <svg viewBox={view} aria-hidden="true">
      <g ref={measure}>
        {paths.map((d) => (
          <path class="line" d={d} />
        ))}
        {dots && <path class="line dots" d={dots} />}
      </g>
    </svg>
  );
}

export function Overview({ cohort }: { cohort: string }) {
  const { query } = usePlace();
  const filter = filterOf(query);
  return (
    <CohortPage cohort={cohort} actions={<CohortActions cohort={cohort} />}>
      {(about, _, revision) =>
        about.shape_count === 0 ? (
          <Empty>
            <p>{t.cohort.empty}</p>
            <a class="button main" href={`/app/cohorts/${encodeURIComponent(cohort)}/upload`}>
              {t.cohort.upload}
            </a>
          </Empty>
        ) : (
          <Shapes cohort={cohort} about={about} filter={filter} revision={revision} />
        )
      }
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
  const shown = some.data ?? all.data;
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
          {hasMesh(about.representation) ? (
            <SolidSheet cohort={cohort} filter={filter} revision={revision} />
          ) : (
            <Sheet cohort={cohort} filter={filter} revision={revision} total={about.shape_count} />
          )}
          <section class="columns">
            {sizes?.map((one) => {
              const { edges, counts } = one.histogram!;
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
  const spheres = representation?.kind === "surface" && representation.topology === "sphere";
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

/** Spheres with parameters that correspond, as a new cohort: without them a mean of fitted meshes is the mean of their seams. */
function Correspond({ cohort, onClose }: { cohort: string; onClose: () => void }) {
  const [part, setPart] = useState<number | null>(null);
  const leaving = useRef(new AbortController());
  useEffect(() => () => leaving.current.abort(), []);
  const action = useAction(async (form: FormData) => {
    const name = String(form.get("name") ?? "").trim();
    const job = await post("/v1/cohorts/{cohort}/correspond", { path: { cohort }, body: { name } });
    await settled<unknown>(job, leaving.current.signal, (now) => setPart(now.progress));
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

const PER_PAGE = 50;

export function ShapeTable({ cohort }: { cohort: string }) {
  const { query } = usePlace();
  const filter = filterOf(query);
  return (
    <CohortPage cohort={cohort}>
      {(about, _, revision) => <Rows cohort={cohort} about={about} filter={filter} revision={revision} />}
    </CohortPage>
  );
}

function Rows({
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
  const { query: place } = usePlace();
  const attributes = useAttributes(cohort, new URLSearchParams(), revision);
  const query = new URLSearchParams(filter);
  for (const name of ["order", "cursor"]) if (place.get(name)) query.set(name, place.get(name)!);
  for (const [name, value] of [
    ["limit", String(PER_PAGE)],
    ["total", "true"],
    ["fields", "id,external_id,subject,label,labels,measures,created_at"],
  ])
    query.set(name!, value!);
  const list = useLoaded(`${cohort} ${query} ${revision}`, (signal) =>
    get("/v1/cohorts/{cohort}/shapes", { path: { cohort }, query, signal }),
  );
  const [, setCursor] = useSetting("cursor", "");
  const names = attributes.data?.items.map((one) => one.name) ?? [];
  const labels = names.filter((name) => name.startsWith("labels."));
  const measures = names.filter((name) => name.startsWith("measures.") && name !== "measures.points");
  const has = (name: string) =>
    attributes.data?.items.some((one) => one.name === name && one.missing < attributes.data!.shape_count);
  const columns = [
    "external_id",
    ...(has("label") ? ["label"] : []),
    ...(has("subject") ? ["subject"] : []),
    ...labels,
    ...measures,
  ];
  const value = (row: Schemas["ListedShape"], name: string) => {
    const group = name.split(".")[0]!;
    const found =
      group === "labels"
        ? (row.labels as Record<string, unknown> | null)?.[name.slice(7)]
        : group === "measures"
          ? (row.measures as Record<string, unknown> | undefined)?.[name.slice(9)]
          : (row as Record<string, unknown>)[name];
    return typeof found === "number"
      ? number(found)
      : typeof found === "boolean"
        ? found
          ? t.words.yes
          : t.words.no
        : String(found ?? "–");
  };
  const numeric = (name: string) => attributes.data?.items.find((one) => one.name === name)?.type === "number";
  return (
    <>
      <div class="row spread">
        <Chips total={about.shape_count} shown={list.data?.total ?? undefined} />
        <Download
          name={cohort}
          source={{
            path: `/v1/cohorts/${encodeURIComponent(cohort)}/table`,
            query: tableQuery(filter, ["id", ...columns, "created_at"]),
          }}
          formats={[
            ["CSV", "csv", "text/csv"],
            ["NDJSON", "ndjson", "application/x-ndjson"],
            ["Arrow", "arrow", "application/vnd.apache.arrow.stream"],
          ]}
        />
      </div>
      <Fault error={list.error ?? attributes.error} />
      <Loading on={list.loading} />
      {list.data && (
        <div class="card scroll" tabIndex={0}>
          <table>
            <caption class="hidden">{t.cohort.table}</caption>
            <thead>
              <tr>
                {columns.map((name) => (
                  <SortHead
                    key={name}
                    name={name}
                    numeric={numeric(name)}
                    label={
                      nameOf(name) +
                      (name.startsWith("measures.") && unit(name.slice(9), about.length_unit)
                        ? ` (${unit(name.slice(9), about.length_unit)})`
                        : "")
                    }
                  />
                ))}
                <th scope="col">{t.words.created}</th>
              </tr>
            </thead>
            <tbody>
              {list.data.items.map((row) => (
                <tr key={row.id}>
                  {columns.map((name) => (
                    <td key={name} class={numeric(name) ? "number" : ""}>
                      {name === "external_id" ? (
                        <a
                          href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(row.external_id ?? row.id ?? "")}`}
                        >
                          {row.external_id ?? row.id}
                        </a>
                      ) : (
                        value(row, name)
                      )}
                    </td>
                  ))}
                  <td class="nowrap">{time(row.created_at)}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </div>
      )}
      <Pages cursor={place.get("cursor") ?? ""} next={list.data?.next} onNext={(next) => setCursor(next, false)} />
    </>
  );
}

function tableQuery(filter: URLSearchParams, columns: string[]): URLSearchParams {
  const query = new URLSearchParams(filter);
  query.set("columns", columns.join(","));
  return query;
}
