/** Scores of all shapes in the plane of two components. */
import { useMemo, useState } from "preact/hooks";
import { useMay } from "../api/caller";
import { get, type Schemas } from "../api/client";
import { useLoaded } from "../hooks";
import { Choice, Download, Empty, Fault, Loading, Select } from "../parts/basic";
import { Bulk } from "../parts/bulk";
import { CATEGORIES, ramp } from "../parts/chart";
import { SaveDrawing } from "../parts/drawn";
import { plotSvg } from "../parts/plot";
import { extent, Scatter } from "../parts/scatter";
import { Shape } from "../parts/shape";
import { useSetting } from "../router";
import { ellipse, hull, type Spot } from "../shape/around";
import { DASHES, type Look } from "../shape/groups";
import { type Model, modelOf } from "../shape/model";
import { box, inPlane, isClosed, isDots, type Points, path as pathOf, sum } from "../shape/points";
import { nameOf } from "../shape/terms";
import { count, number, percent, t } from "../strings";
import { useAttributes } from "./cohort";
import { type About, DictionaryPage } from "./dictionary";

type Values = (string | number | boolean | null)[];

export function Scores({ dictionary }: { dictionary: string }) {
  return (
    <DictionaryPage dictionary={dictionary}>
      {(about) =>
        about.cohort_name ? (
          <Plane about={about} dictionary={dictionary} cohort={about.cohort_name} />
        ) : (
          <Empty>
            <p>{t.scores.noCohort}</p>
          </Empty>
        )
      }
    </DictionaryPage>
  );
}

function Plane({ about, dictionary, cohort }: { about: About; dictionary: string; cohort: string }) {
  const shown = Math.min(about.atoms.length, 10);
  const [x, setX] = useSetting("x", "1");
  const [y, setY] = useSetting("y", String(Math.min(2, shown)));
  const [by, setBy] = useSetting("colour", "");
  const [tool, setTool] = useSetting("tool", "lasso");
  const [morphs, setMorphs] = useSetting("morphospace", "");
  const [around, setAround] = useSetting("around", "");
  const [chosen, setChosen] = useState<Set<number> | null>(null);
  const attributes = useAttributes(cohort, new URLSearchParams(), about.cohort_revision ?? 0);
  const own = `${about.name}@${about.version}`;
  const useful =
    attributes.data?.items.filter(
      (one) =>
        (/^(label$|labels\.)/.test(one.name) && one.distinct > 1 && (one.type === "number" || one.distinct <= 40)) ||
        (one.name.startsWith("measures.") && one.distinct > 1 && one.name !== "measures.points"),
    ) ?? [];
  const attribute = by || (useful.find((one) => one.name.startsWith("labels.")) ?? useful[0])?.name || "";
  const scores = Array.from({ length: shown }, (_, index) => `${own}.score.${index + 1}`);
  const table = useLoaded(attributes.data ? `${own} ${attribute}` : null, async (signal) => {
    const extra = attribute && !attribute.startsWith("+") ? [attribute] : [];
    const special = attribute === "+outlier" ? [`${own}.outlier`] : attribute === "+class" ? [`${own}.class`] : [];
    const answer = (await get("/v1/cohorts/{cohort}/table", {
      path: { cohort },
      query: { columns: ["external_id", "id", ...scores, ...extra, ...special].join(",") },
      signal,
    })) as Schemas["TableAnswer"];
    const column = (index: number) => answer.columns[index]!.values as Values;
    const good = column(2).flatMap((value, index) => (value === null ? [] : [index]));
    const pick = (values: Values) => good.map((index) => values[index]!);
    return {
      ids: pick(column(0)).map((id, index) => String(id ?? pick(column(1))[index])),
      scores: scores.map((_, index) => pick(column(2 + index)) as number[]),
      colour: answer.columns[2 + shown] ? pick(column(2 + shown)) : null,
      rows: answer.rows,
    };
  });
  const model = useLoaded(inPlane(about.representation) ? about.id : null, (signal) =>
    modelOf(about, dictionary, signal, 96),
  );
  const data = table.data;
  const [a, b] = [Math.min(Number(x) || 1, shown) - 1, Math.min(Number(y) || 2, shown) - 1];
  const coloured = useMemo(() => colours(data?.colour ?? null), [data]);
  const rings = useMemo(
    () => (data && around && coloured.kinds ? ringsOf(data.scores[a]!, data.scores[b]!, coloured, around) : []),
    [data, around, a, b],
  );
  const reach = useMemo(() => rings.flatMap((ring) => ring.corners), [rings]);
  const draw = (index: number): Points | undefined =>
    model.data &&
    sum(
      model.data.mean,
      data!.scores.map((values, component) => [values[index]!, model.data!.components[component]!]),
    );
  const view = useMemo(
    () =>
      model.data &&
      box([
        model.data.mean,
        ...[-2.2, 2.2].flatMap((side) =>
          model
            .data!.components.slice(0, 2)
            .map((component, index) => sum(model.data!.mean, [[side * model.data!.deviations[index]!, component]])),
        ),
      ]),
    [model.data],
  );
  const closed = isClosed(about.representation),
    dots = isDots(about.representation);
  const axisName = (index: number) => `${t.words.component} ${index + 1} (${percent(about.atoms[index]!.explained)})`;
  const options = Array.from({ length: shown }, (_, index): [string, string] => [String(index + 1), axisName(index)]);
  return (
    <>
      <Fault error={table.error ?? attributes.error ?? model.error} retry={table.reload} />
      <div class="form">
        <Select label={t.scores.across} value={x} options={options} onChange={setX} />
        <Select label={t.scores.up} value={y} options={options} onChange={setY} />
        <Select
          label={t.scores.colour}
          value={attribute}
          options={[
            ...useful.map((one): [string, string] => [one.name, nameOf(one.name)]),
            ["+outlier", t.scores.outlier],
            ...(about.classifier ? [["+class", t.scores.class] as [string, string]] : []),
          ]}
          onChange={setBy}
        />
        <div class="row">
          <Choice
            label={t.scores.tool}
            value={tool}
            options={[
              ["lasso", t.scores.lasso],
              ["zoom", t.scores.zoom],
            ]}
            onChange={setTool}
          />
          {model.data && (
            <label class="check">
              <input
                type="checkbox"
                checked={morphs !== ""}
                onChange={(event) => setMorphs(event.currentTarget.checked ? "yes" : "")}
              />
              <span>{t.scores.morphospace}</span>
            </label>
          )}
        </div>
        {coloured.kinds && (
          <Select
            label={t.scores.around}
            value={around}
            options={[
              ["", t.words.none],
              ["hull", t.scores.hull],
              ["ellipse", t.scores.ellipse],
            ]}
            onChange={setAround}
          />
        )}
      </div>
      <Loading on={table.loading} />
      {data && (
        <div class="aside right">
          <figure class="card">
            <Scatter
              x={data.scores[a]!}
              y={data.scores[b]!}
              xLabel={axisName(a)}
              yLabel={axisName(b)}
              groups={coloured.groups}
              palette={coloured.palette}
              tool={tool as "lasso" | "zoom"}
              chosen={chosen}
              onChoose={setChosen}
              describe={t.scores.alt(data.ids.length)}
              reach={reach}
              hover={(index) => {
                const points = draw(index);
                return (
                  <>
                    {points && (
                      <Shape
                        view={box([points])}
                        height={92}
                        describe={data.ids[index]!}
                        parts={[{ points, closed, dots }]}
                      />
                    )}
                    <strong>{data.ids[index]}</strong>
                    <div class="quiet">
                      {data.colour
                        ? String(
                            typeof data.colour[index] === "number"
                              ? number(data.colour[index] as number)
                              : (data.colour[index] ?? "–"),
                          )
                        : ""}
                    </div>
                  </>
                );
              }}
              backdrop={
                (morphs && model.data) || rings.length
                  ? (place) => (
                      <>
                        {morphs && model.data && (
                          <Morphospace
                            model={model.data}
                            a={a}
                            b={b}
                            x={data.scores[a]!}
                            y={data.scores[b]!}
                            place={place}
                            closed={closed}
                            dots={dots}
                          />
                        )}
                        {rings.map((ring) => (
                          <path
                            key={ring.name}
                            d={`M${ring.corners.map(([x, y]) => place(x, y).join(" ")).join("L")}Z`}
                            fill={ring.colour}
                            fill-opacity="0.07"
                            stroke={ring.colour}
                            stroke-width="1.8"
                            stroke-dasharray={ring.dash || undefined}
                          />
                        ))}
                      </>
                    )
                  : undefined
              }
            />
            {coloured.legend.length > 0 && (
              <div class="legend-list">
                {coloured.legend.map(([name, value]) => (
                  <span key={name}>
                    <i class="swatch" style={{ background: value }} />
                    {name}
                  </span>
                ))}
              </div>
            )}
            <figcaption>{t.scores.caption(count(data.ids.length))}</figcaption>
            <SaveDrawing
              name={`${about.name}-scores`}
              of={() =>
                plotSvg({
                  x: [],
                  lines: [],
                  xLabel: axisName(a),
                  yLabel: axisName(b),
                  xRange: extent([...data.scores[a]!, ...reach.map((p) => p[0])]),
                  yRange: extent([...data.scores[b]!, ...reach.map((p) => p[1])]),
                  xText: (value) => number(value, 6),
                  yText: (value) => number(value, 6),
                  legend: coloured.legend,
                  inner: (place) =>
                    drawnPlane(
                      data.scores[a]!,
                      data.scores[b]!,
                      coloured,
                      rings,
                      morphs ? model.data : undefined,
                      [a, b],
                      closed,
                      dots,
                      place,
                    ),
                })
              }
            />
            <Download
              name={`${about.name}-scores`}
              source={{
                path: `/v1/cohorts/${encodeURIComponent(cohort)}/table`,
                query: {
                  columns: [
                    "external_id",
                    ...scores,
                    ...(attribute && !attribute.startsWith("+") ? [attribute] : []),
                  ].join(","),
                },
              }}
              formats={[
                ["CSV", "csv", "text/csv"],
                ["Arrow", "arrow", "application/vnd.apache.arrow.stream"],
              ]}
            />
          </figure>
          <Chosen
            data={data}
            chosen={chosen}
            model={model.data}
            view={view}
            closed={closed}
            dots={dots}
            cohort={cohort}
            names={(attributes.data?.items ?? []).map((one) => one.name).filter((name) => name.startsWith("labels."))}
            onClear={() => setChosen(null)}
            onChanged={() => {
              setChosen(null);
              attributes.reload();
              table.reload();
            }}
          />
        </div>
      )}
    </>
  );
}

function Chosen({
  data,
  chosen,
  model,
  view,
  closed,
  dots,
  cohort,
  names,
  onClear,
  onChanged,
}: {
  data: { ids: string[]; scores: number[][] };
  chosen: Set<number> | null;
  model: Model | undefined;
  view: string | undefined;
  closed: boolean;
  dots: boolean;
  cohort: string;
  names: string[];
  onClear: () => void;
  onChanged: () => void;
}) {
  const writes = useMay("writer");
  if (!chosen)
    return (
      <section class="card">
        <h2>{t.scores.selection}</h2>
        <p class="quiet">{t.scores.selectionHint}</p>
      </section>
    );
  const indices = [...chosen];
  const mean =
    model &&
    sum(
      model.mean,
      data.scores.map((values, component) => [
        indices.reduce((total, index) => total + values[index]!, 0) / indices.length,
        model.components[component]!,
      ]),
    );
  const link = new URLSearchParams(indices.slice(0, 100).map((index) => ["external_id", data.ids[index]!]));
  return (
    <section class="card">
      <div class="row spread">
        <h2>{t.scores.chosen(chosen.size)}</h2>
        <button class="plain" onClick={onClear}>
          {t.scores.clear}
        </button>
      </div>
      {mean && view && (
        <figure>
          <Shape
            view={view}
            height={220}
            describe={t.scores.meanOf}
            parts={[
              { points: model!.mean, closed, dots, class: "pale" },
              { points: mean, closed, dots, class: "accent" },
            ]}
          />
          <figcaption>{t.scores.meanOf}</figcaption>
        </figure>
      )}
      <div
        class="chips"
        style={{ maxHeight: "240px", overflow: "auto" }}
        tabIndex={0}
        role="group"
        aria-label={t.scores.selection}
      >
        {indices.slice(0, 60).map((index) => (
          <a
            class="tag"
            href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(data.ids[index]!)}`}
            key={index}
          >
            {data.ids[index]}
          </a>
        ))}
        {indices.length > 60 && <span class="tag">{t.scores.others(indices.length - 60)}</span>}
      </div>
      {indices.length <= 100 && (
        <a class="button" href={`/app/cohorts/${encodeURIComponent(cohort)}?${link}`}>
          {t.scores.open}
        </a>
      )}
      {writes && (
        <Bulk
          cohort={cohort}
          names={names}
          target={{ ids: indices.map((index) => data.ids[index]!), size: chosen.size }}
          onDone={onChanged}
        />
      )}
    </section>
  );
}

interface Ring extends Look {
  name: string;
  corners: Spot[];
}

/** What is drawn around the points of each group. */
function ringsOf(x: number[], y: number[], coloured: Coloured, around: string): Ring[] {
  return coloured.legend.flatMap(([name, colour], at) => {
    const points = x.flatMap((value, k): Spot[] => (coloured.groups[k] === at ? [[value, y[k]!]] : []));
    const corners = around === "hull" ? hull(points) : ellipse(points);
    return corners.length > 2 ? [{ name, colour, dash: DASHES[at % DASHES.length]!, corners }] : [];
  });
}

/** Points, what is around them and shapes in the plane, for a file. */
function drawnPlane(
  x: number[],
  y: number[],
  coloured: Coloured,
  rings: Ring[],
  model: Model | undefined,
  [a, b]: [number, number],
  closed: boolean,
  dots: boolean,
  place: (x: number, y: number) => [number, number],
): string {
  const words = ([px, py]: [number, number]) => `${px.toFixed(1)} ${py.toFixed(1)}`;
  const shapes = model
    ? grid(model, a, b, x, y, place).map(({ shape, at: [px, py], scale }) => {
        const points = shape.map((p) => [px + scale * p[0]!, py - scale * p[1]!] as [number, number]);
        return dots
          ? points
              .map(([cx, cy]) => `<circle cx="${cx.toFixed(1)}" cy="${cy.toFixed(1)}" r="1.4" fill="#9a9a9a"/>`)
              .join("")
          : `<path d="M${points.map(words).join("L")}${closed ? "Z" : ""}" fill="none" stroke="#9a9a9a" stroke-width="1.2"/>`;
      })
    : [];
  const around = rings.map(
    (ring) =>
      `<path d="M${ring.corners.map((p) => words(place(...p))).join("L")}Z" fill="${ring.colour}" fill-opacity="0.07" stroke="${ring.colour}" stroke-width="1.6"${ring.dash ? ` stroke-dasharray="${ring.dash}"` : ""}/>`,
  );
  const points = x.map((value, k) => {
    const [px, py] = place(value, y[k]!);
    return `<circle cx="${px.toFixed(1)}" cy="${py.toFixed(1)}" r="3.2" fill="${coloured.palette[coloured.groups[k]!]}" fill-opacity="0.85"/>`;
  });
  return [...shapes, ...around, ...points].join("");
}

/** Shapes of a grid of scores: 5 × 5, where they lie, and how large they are drawn. */
function grid(
  model: Model,
  a: number,
  b: number,
  x: number[],
  y: number[],
  place: (x: number, y: number) => [number, number],
): { shape: Points; at: [number, number]; scale: number }[] {
  const [left, right] = span(x),
    [low, high] = span(y);
  const size = Math.max(...model.mean.flat().map(Math.abs)) * 2.4;
  const [ox, oy] = place(left, low),
    [ex, ey] = place(right, high);
  const scale = (0.8 * Math.min(Math.abs(ex - ox), Math.abs(ey - oy))) / 5 / size;
  const steps = [0, 1, 2, 3, 4];
  return steps.flatMap((i) =>
    steps.map((j) => {
      const [sx, sy] = [left + ((i + 0.5) / 5) * (right - left), low + ((j + 0.5) / 5) * (high - low)];
      const shape = sum(model.mean, [
        [sx, model.components[a]!],
        [sy, model.components[b]!],
      ]);
      return { shape, at: place(sx, sy), scale };
    }),
  );
}

/** Shapes of a grid of scores, drawn where they belong. */
function Morphospace({
  model,
  a,
  b,
  x,
  y,
  place,
  closed,
  dots,
}: {
  model: Model;
  a: number;
  b: number;
  x: number[];
  y: number[];
  place: (x: number, y: number) => [number, number];
  closed: boolean;
  dots: boolean;
}) {
  return (
    <>
      {grid(model, a, b, x, y, place).map(({ shape, at: [px, py], scale }, key) => {
        const transform = `translate(${px} ${py}) scale(${scale})`;
        return dots ? (
          <g key={key} transform={transform}>
            {shape.map((p) => (
              <circle class="dot pale" cx={p[0]} cy={-p[1]!} r={1.4 / scale} />
            ))}
          </g>
        ) : (
          <path key={key} class="line pale" transform={transform} d={pathOf(shape, closed)} opacity="0.75" />
        );
      })}
    </>
  );
}

const span = (values: number[]): [number, number] =>
  values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);

interface Coloured {
  groups: Uint8Array;
  palette: string[];
  legend: [string, string][];
  /** Whether colours stand for groups, not for numbers. */
  kinds: boolean;
}

function colours(values: Values | null): Coloured {
  if (!values) return { groups: new Uint8Array(1_000_000), palette: [CATEGORIES[0]!], legend: [], kinds: false };
  const numeric =
    values.every((value) => typeof value === "number" || value === null) && values.some((value) => value !== null);
  if (numeric) {
    const [low, high] = span(values.filter((value) => value !== null) as number[]);
    const palette = [...Array.from({ length: 64 }, (_, index) => ramp(index / 63)), "#8a8f98"];
    const groups = Uint8Array.from(values, (value) =>
      value === null ? 64 : Math.round((63 * ((value as number) - low)) / (high - low || 1)),
    );
    return {
      groups,
      palette,
      kinds: false,
      legend: [0, 0.25, 0.5, 0.75, 1].map((part) => [number(low + part * (high - low), 3), ramp(part)]),
    };
  }
  const tally = new Map<string, number>();
  for (const value of values) tally.set(String(value ?? "–"), (tally.get(String(value ?? "–")) ?? 0) + 1);
  const names = [...tally.keys()].sort();
  const kept =
    names.length > 7
      ? [...names]
          .sort((p, q) => tally.get(q)! - tally.get(p)!)
          .slice(0, 7)
          .sort()
      : names;
  const place = new Map(kept.map((name, index) => [name, index]));
  const word = (name: string) => (name === "true" ? t.words.yes : name === "false" ? t.words.no : name);
  const legend = kept.map((name, index): [string, string] => [
    `${word(name)} (${count(tally.get(name)!)})`,
    CATEGORIES[index]!,
  ]);
  if (kept.length < names.length) legend.push([t.scores.rest(names.length - kept.length), CATEGORIES[7]!]);
  return {
    groups: Uint8Array.from(values, (value) => place.get(String(value ?? "–")) ?? 7),
    palette: CATEGORIES,
    legend,
    kinds: true,
  };
}
