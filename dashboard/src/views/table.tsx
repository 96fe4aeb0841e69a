/** The shapes of a cohort as a table: columns by choice, also what dictionaries say of the shapes; rows are chosen and labelled. */
import { useMemo, useState } from "preact/hooks";
import { useMay } from "../api/caller";
import { type Answer, get, pages, post, type Schemas } from "../api/client";
import { useLoaded } from "../hooks";
import { Download, Fault, Loading, SortHead } from "../parts/basic";
import { Bulk } from "../parts/bulk";
import { Pages } from "../parts/sheet";
import { usePlace, useSetting } from "../router";
import { filterBody, filterOf } from "../shape/filter";
import { nameOf } from "../shape/terms";
import { count, number, t, time, unit } from "../strings";
import { Chips, CohortPage, Facets, useAttributes } from "./cohort";

const PER_PAGE = 50;
/** Scores of components that are offered as columns. */
const SCORES = 5;

type Value = string | number | boolean | null | undefined;
interface Row {
  id: string;
  name: string;
  values: Record<string, Value>;
}
interface Listed {
  rows: Row[];
  total: number | undefined;
  next: string | null | undefined;
}

export function ShapeTable({ cohort }: { cohort: string }) {
  const { query } = usePlace();
  const filter = filterOf(query);
  return (
    <CohortPage cohort={cohort}>
      {(about, _, revision) => <Rows cohort={cohort} about={about} filter={filter} revision={revision} />}
    </CohortPage>
  );
}

/** Columns that a dictionary of the cohort has, with their names for people. */
function columnsOf(one: Answer<"get", "/v1/dictionaries">["items"][number]): [string, string][] {
  const own = `${one.name}@${one.version}`;
  return [
    [`${own}.outlier`, t.columns.outlier(own)],
    [`${own}.relative_error`, t.columns.error(own)],
    ...(one.method.kind === "functional_pca"
      ? Array.from({ length: Math.min(one.atoms, SCORES) }, (_, k): [string, string] => [
          `${own}.score.${k + 1}`,
          t.columns.score(own, k + 1),
        ])
      : []),
    ...(one.classifier
      ? ([
          [`${own}.class`, t.columns.class(own)],
          [`${own}.confidence`, t.columns.confidence(own)],
        ] as [string, string][])
      : []),
  ];
}

const isOfDictionary = (name: string) => name.includes("@");

/** Value of a column of a stored shape. */
function fieldOf(row: Schemas["ListedShape"], name: string): Value {
  const [group, ...rest] = name.split(".");
  const inner = group === "labels" || group === "measures" ? (row[group] as Record<string, Value> | null) : undefined;
  return inner === undefined ? ((row as Record<string, unknown>)[name] as Value) : inner?.[rest.join(".")];
}

/** A page of the list of the service. */
async function listed(cohort: string, query: URLSearchParams, columns: string[], signal: AbortSignal): Promise<Listed> {
  const list = await get("/v1/cohorts/{cohort}/shapes", { path: { cohort }, query, signal });
  return {
    rows: list.items.map((row) => ({
      id: row.id ?? "",
      name: row.external_id ?? row.id ?? "",
      values: Object.fromEntries(columns.map((name) => [name, fieldOf(row, name)])),
    })),
    total: list.total ?? undefined,
    next: list.next,
  };
}

const rankOf = (value: Value) => (value === null || value === undefined ? 2 : typeof value === "number" ? 0 : 1);

/** Numbers, then texts, then what is missing, as lists of the service are ordered. */
function compared(a: Value, b: Value): number {
  if (rankOf(a) !== rankOf(b)) return rankOf(a) - rankOf(b);
  if (typeof a === "number" && typeof b === "number") return a - b;
  return String(a ?? "").localeCompare(String(b ?? ""));
}

/** All rows with columns of dictionaries, which lists do not have: ordered and divided into pages here. */
async function tabled(
  cohort: string,
  filter: URLSearchParams,
  columns: string[],
  only: boolean,
  signal: AbortSignal,
): Promise<Row[]> {
  const asked = [...new Set(["id", "external_id", ...columns])];
  const table = (await post("/v1/cohorts/{cohort}/table", {
    path: { cohort },
    body: { columns: asked, filter: filterBody(filter) } as never,
    signal,
  })) as unknown as Schemas["TableAnswer"];
  const values = table.columns.map((one) => one.values as Value[]);
  const outlier = asked.findIndex((name) => name.endsWith(".outlier"));
  return (values[0] ?? []).flatMap((id, row) =>
    only && outlier >= 0 && values[outlier]![row] !== true
      ? []
      : [
          {
            id: String(id),
            name: String(values[1]![row] ?? id),
            values: Object.fromEntries(asked.map((name, at) => [name, values[at]![row]])),
          },
        ],
  );
}

function paged(rows: Row[], order: string, from: number): Listed {
  const name = order.replace(/^-/, ""),
    sign = order.startsWith("-") ? -1 : 1;
  const sorted = order
    ? [...rows].sort((a, b) => {
        const [x, y] = [a.values[name], b.values[name]];
        return rankOf(x) === rankOf(y) ? sign * compared(x, y) : compared(x, y);
      })
    : rows;
  return {
    rows: sorted.slice(from, from + PER_PAGE),
    total: rows.length,
    next: from + PER_PAGE < rows.length ? String(from + PER_PAGE) : null,
  };
}

const shownValue = (value: Value): string =>
  typeof value === "number"
    ? number(value)
    : typeof value === "boolean"
      ? value
        ? t.words.yes
        : t.words.no
      : String(value ?? "–");

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
  const shown = useAttributes(cohort, filter, revision);
  const dictionaries = useLoaded(cohort, (signal) =>
    pages((cursor) => get("/v1/dictionaries", { query: { cohort, cursor, limit: 1000 }, signal })),
  );
  const extra = (dictionaries.data ?? []).slice(-3).reverse().flatMap(columnsOf);
  const [wanted, setWanted] = useSetting("columns", "");
  const [only, setOnly] = useSetting("unusual", "");
  const [, setCursor] = useSetting("cursor", "");
  const [chosen, setChosen] = useState<Set<string>>(new Set());
  const writes = useMay("writer");
  const items = attributes.data?.items ?? [];
  const has = (name: string) => items.some((one) => one.name === name && one.missing < about.shape_count);
  const own = [
    ...["label", "subject"].filter(has),
    ...items.map((one) => one.name).filter((name) => /^(labels|measures)\./.test(name) && name !== "measures.points"),
    "created_at",
  ];
  const picked = wanted ? wanted.split(",").filter((name) => name !== "-") : own;
  const columns = ["external_id", ...picked];
  const whole = columns.some(isOfDictionary);
  const order = place.get("order") ?? "",
    cursor = place.get("cursor") ?? "";
  const query = new URLSearchParams(filter);
  for (const [name, value] of [
    ["order", order],
    ["cursor", cursor],
    ["limit", String(PER_PAGE)],
    ["total", "true"],
    ["fields", "id,external_id,subject,label,labels,measures,created_at"],
  ])
    if (value) query.set(name!, value);
  const list = useLoaded(attributes.data && !whole ? `${cohort} ${query} ${columns} ${revision}` : null, (signal) =>
    listed(cohort, query, columns, signal),
  );
  const table = useLoaded(whole ? `${cohort} ${filter} ${columns} ${only} ${revision}` : null, (signal) =>
    tabled(cohort, filter, columns, only !== "", signal),
  );
  const data = useMemo(
    () => (whole ? table.data && paged(table.data, order, Number(cursor) || 0) : list.data),
    [whole, table.data, list.data, order, cursor],
  );
  const label = (name: string) => {
    const suffix = name.startsWith("measures.") && unit(name.slice(9), about.length_unit);
    return (
      extra.find(([id]) => id === name)?.[1] ??
      (name === "created_at" ? t.words.created : nameOf(name) + (suffix ? ` (${suffix})` : ""))
    );
  };
  const numeric = (name: string) =>
    items.find((one) => one.name === name)?.type === "number" ||
    /@.*\.(score\.\d+|relative_error|confidence)$/.test(name);
  const toggle = (id: string) =>
    setChosen((before) => {
      const next = new Set(before);
      if (!next.delete(id)) next.add(id);
      return next;
    });
  const ids = data?.rows.map((row) => row.id) ?? [];
  const all = ids.length > 0 && ids.every((id) => chosen.has(id));
  const names = items.map((one) => one.name).filter((name) => name.startsWith("labels."));
  return (
    <>
      <details class="card filters wide">
        <summary>{t.cohort.filters}</summary>
        {attributes.data && (
          <Facets all={attributes.data.items} shown={shown.data?.items} lengthUnit={about.length_unit} />
        )}
      </details>
      <div class="stack" style={{ gap: "18px" }}>
        <div class="row spread">
          <Chips total={about.shape_count} shown={data?.total} />
          <Download
            name={cohort}
            source={{
              path: `/v1/cohorts/${encodeURIComponent(cohort)}/table`,
              query: tableQuery(filter, ["id", ...columns, ...(picked.includes("created_at") ? [] : ["created_at"])]),
            }}
            formats={[
              ["CSV", "csv", "text/csv"],
              ["NDJSON", "ndjson", "application/x-ndjson"],
              ["Arrow", "arrow", "application/vnd.apache.arrow.stream"],
            ]}
          />
        </div>
        <div class="row spread">
          <Columns
            own={own}
            extra={extra}
            picked={picked}
            label={label}
            onPick={(next) => setWanted(next.join() === own.join() ? "" : next.join(",") || "-")}
          />
          {whole && columns.some((name) => name.endsWith(".outlier")) && (
            <label class="check">
              <input
                type="checkbox"
                checked={only !== ""}
                onChange={(event) => setOnly(event.currentTarget.checked ? "yes" : "")}
              />
              <span>{t.columns.only}</span>
            </label>
          )}
        </div>
        {writes && (
          <details class="card" open={chosen.size > 0}>
            <summary>{chosen.size ? t.scores.chosen(chosen.size) : t.bulk.summary}</summary>
            {chosen.size > 0 && (
              <div class="row">
                <button class="plain" onClick={() => setChosen(new Set())}>
                  {t.scores.clear}
                </button>
              </div>
            )}
            <Bulk
              cohort={cohort}
              names={names}
              target={
                chosen.size
                  ? { ids: [...chosen], size: chosen.size }
                  : { filter: filterBody(filter), size: shown.data?.shape_count ?? about.shape_count }
              }
            />
          </details>
        )}
        <Fault error={list.error ?? table.error ?? attributes.error ?? dictionaries.error} />
        <Loading on={list.loading || table.loading} />
        {data && (
          <div class="card scroll" tabIndex={0}>
            <table>
              <caption class="hidden">{t.cohort.table}</caption>
              <thead>
                <tr>
                  <th scope="col">
                    <input
                      type="checkbox"
                      aria-label={t.columns.page}
                      checked={all}
                      onChange={() =>
                        setChosen(
                          (before) =>
                            new Set([...before].filter((id) => !all || !ids.includes(id)).concat(all ? [] : ids)),
                        )
                      }
                    />
                  </th>
                  {columns.map((name) => (
                    <SortHead key={name} name={name} numeric={numeric(name)} label={label(name)} />
                  ))}
                </tr>
              </thead>
              <tbody>
                {data.rows.map((row) => (
                  <tr key={row.id}>
                    <td>
                      <input
                        type="checkbox"
                        aria-label={t.columns.choose(row.name)}
                        checked={chosen.has(row.id)}
                        onChange={() => toggle(row.id)}
                      />
                    </td>
                    {columns.map((name) => (
                      <td key={name} class={numeric(name) ? "number" : name === "created_at" ? "nowrap" : ""}>
                        {name === "external_id" ? (
                          <a href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(row.name)}`}>
                            {row.name}
                          </a>
                        ) : name === "created_at" ? (
                          time(row.values[name] as string)
                        ) : (
                          shownValue(row.values[name])
                        )}
                      </td>
                    ))}
                  </tr>
                ))}
              </tbody>
            </table>
          </div>
        )}
        {whole && data?.total === 0 && <p class="quiet">{t.columns.none}</p>}
        <Pages cursor={cursor} next={data?.next} onNext={(next) => setCursor(next, false)} />
        {data && (data.next || cursor) && data.total !== undefined && (
          <p class="small quiet">{t.columns.of(count(data.rows.length), count(data.total))}</p>
        )}
      </div>
    </>
  );
}

/** The choice of columns, among them those of dictionaries that were learnt from the cohort. */
function Columns({
  own,
  extra,
  picked,
  label,
  onPick,
}: {
  own: string[];
  extra: [string, string][];
  picked: string[];
  label: (name: string) => string;
  onPick: (names: string[]) => void;
}) {
  const box = (name: string) => (
    <label class="check" key={name}>
      <input
        type="checkbox"
        checked={picked.includes(name)}
        onChange={(event) =>
          onPick(
            event.currentTarget.checked
              ? [...own, ...extra.map(([id]) => id)].filter((one) => one === name || picked.includes(one))
              : picked.filter((one) => one !== name),
          )
        }
      />
      <span>{label(name)}</span>
    </label>
  );
  return (
    <details>
      <summary>{t.columns.title}</summary>
      <div class="card columns-choice">
        {own.map(box)}
        {extra.length > 0 && <h3>{t.columns.ofModels}</h3>}
        {extra.map(([name]) => box(name))}
      </div>
    </details>
  );
}

function tableQuery(filter: URLSearchParams, columns: string[]): URLSearchParams {
  const query = new URLSearchParams(filter);
  query.set("columns", columns.join(","));
  return query;
}
