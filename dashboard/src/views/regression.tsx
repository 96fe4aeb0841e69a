/** How shapes depend on a number, with a slider over it. */
import { useMemo, useState } from "preact/hooks";
import { get, post, type Schemas } from "../api/client";
import { settled } from "../api/jobs";
import { useLoaded } from "../hooks";
import { Fault, type Key, Keys, Picture, Select, Warning } from "../parts/basic";
import { Chart, type Line } from "../parts/chart";
import { Classes, dimensionOf } from "../parts/classes";
import { Figure } from "../parts/figure";
import { usePlace, useSetting } from "../router";
import { filterBody, filterOf } from "../shape/filter";
import { looksOf } from "../shape/groups";
import { evaluated, hasMesh, isClosed, isDots, type Points, sum, upright } from "../shape/points";
import { nameOf } from "../shape/terms";
import { number, percent, probability, t } from "../strings";
import { shown } from "../theme";
import { Chips, CohortPage, useAttributes } from "./cohort";
import { Progress } from "./compare";

type Result = Schemas["ShapeRegression"];

export function Regression({ cohort }: { cohort: string }) {
  return (
    <CohortPage cohort={cohort}>
      {(about, _, revision) => <View cohort={cohort} about={about} revision={revision} />}
    </CohortPage>
  );
}

function View({ cohort, about, revision }: { cohort: string; about: Schemas["CohortOutput"]; revision: number }) {
  const { query } = usePlace();
  const filter = filterOf(query);
  const attributes = useAttributes(cohort, filter, revision);
  const numbers = attributes.data?.items.filter((one) => one.name.startsWith("labels.") && one.type === "number") ?? [];
  const [attribute, setAttribute] = useSetting("attribute", "log_centroid_size");
  const [covariate, setCovariate] = useSetting("covariate", "");
  const [transformation, setTransformation] = useSetting("transformation", "similarity");
  const kinds =
    attributes.data?.items.filter(
      (one) => /^(label$|labels\.)/.test(one.name) && one.type === "text" && one.distinct > 1 && one.distinct <= 8,
    ) ?? [];
  const [colouring, setColouring] = useSetting("colour", "");
  const by = kinds.find((one) => one.name === colouring) ?? (colouring === "-" ? undefined : kinds[0]);
  const [part, setPart] = useState<number | null>(null);
  const body: Schemas["RegressRequest"] = {
    cohort,
    attribute,
    covariates: covariate ? [covariate] : [],
    filter: filterBody(filter),
    missing: "skip",
    transformation: transformation as Schemas["ClassName"],
  };
  const result = useLoaded(JSON.stringify([body, revision]), async (signal) => {
    const found = await settled<Result>(
      (await post("/v1/regressions", { body, headers: { prefer: "wait=5" }, signal })) as Result,
      signal,
      (job) => setPart(job.progress),
    );
    const drawn = !hasMesh(about.representation)
      ? await evaluated(about.representation, [found.average as Points, found.change_per_unit as Points], signal)
      : undefined;
    return { found, drawn };
  });
  const label = attribute === "log_centroid_size" ? t.regression.size : nameOf(attribute);
  const name = attribute === "log_centroid_size" ? t.regression.sizeName : label;
  const data = result.data?.found;
  const p = data?.test?.p;
  return (
    <div class="aside right">
      <div class="stack" style={{ gap: "22px" }}>
        <Chips total={about.shape_count} shown={attributes.data?.shape_count} />
        <Fault error={result.error} retry={result.reload} />
        {result.loading && <Progress part={part} />}
        {data && (
          <>
            <p class="card say">
              {p === null || p === undefined
                ? t.compare.untested(label)
                : p <= 0.05
                  ? t.regression.depends(name, probability(p), percent(data.r_squared))
                  : t.regression.independent(name, probability(p))}
            </p>
            {data.warnings.map((warning) => (
              <Warning text={warning} />
            ))}
            {result.data?.drawn && (
              <Slide
                data={data}
                drawn={result.data.drawn}
                about={about}
                label={name}
                unit={attribute === "log_centroid_size" ? (about.length_unit ?? "") : ""}
                transformation={transformation}
              />
            )}
            <figure class="card">
              <h2>{t.regression.scores}</h2>
              <Scores
                data={data}
                label={label}
                cohort={cohort}
                by={by?.name ?? ""}
                groups={by?.values.map((one) => String(one.value)) ?? []}
              />
              <figcaption>{t.regression.scoresHint}</figcaption>
            </figure>
            <div class="card">
              <Picture
                source={{ method: "POST", path: "/v1/regressions", body }}
                name={`${cohort}-regression`}
                alt={t.regression.alt(label)}
                caption={t.regression.caption}
                keys={[
                  [
                    SHADES[shown()],
                    t.regression.key(
                      `${name}: ${quantile(data, 0)}`,
                      `${quantile(data, data.predictions.length - 1)}${attribute === "log_centroid_size" && about.length_unit ? `\u00a0${about.length_unit}` : ""}`,
                    ),
                  ],
                ]}
              />
            </div>
          </>
        )}
      </div>
      <div class="stack no-print" style={{ gap: "22px" }}>
        <div class="card">
          <h2>{t.compare.settings}</h2>
          <Select
            label={t.regression.attribute}
            value={attribute}
            options={[
              ["log_centroid_size", t.regression.size],
              ...numbers.map((one): [string, string] => [one.name, nameOf(one.name)]),
            ]}
            onChange={setAttribute}
          />
          <Select
            label={t.regression.covariate}
            value={covariate}
            options={[
              ["", t.words.none],
              ...(attributes.data?.items ?? [])
                .filter((one) => one.name.startsWith("labels.") && one.name !== attribute && one.distinct > 1)
                .map((one): [string, string] => [one.name, nameOf(one.name)]),
            ]}
            onChange={setCovariate}
          />
          {kinds.length > 0 && (
            <Select
              label={t.scores.colour}
              value={by?.name ?? "-"}
              options={[["-", t.words.none], ...kinds.map((one): [string, string] => [one.name, nameOf(one.name)])]}
              onChange={setColouring}
            />
          )}
          <Classes dimension={dimensionOf(about.representation)} value={transformation} onChange={setTransformation} />
        </div>
        {data && (
          <div class="card">
            <dl class="facts">
              <dt>R²</dt>
              <dd>{percent(data.r_squared)}</dd>
              <dt>{t.regression.partial}</dt>
              <dd>{percent(data.partial_r_squared)}</dd>
              <dt>F</dt>
              <dd>{number(data.pseudo_f)}</dd>
              <dt>p</dt>
              <dd>{probability(p)}</dd>
              <dt>{t.compare.permutations}</dt>
              <dd>{data.test?.permutations ?? "–"}</dd>
              <dt>{t.words.shapes}</dt>
              <dd>{data.shape_count}</dd>
            </dl>
          </div>
        )}
      </div>
    </div>
  );
}

/** Colours of drawings of the service from low to high values. */
const SHADES = {
  light: ["#2166ac", "#92b7d8", "#8c8c8c", "#e2a184", "#b2182b"],
  dark: ["#5aa9f5", "#aecce6", "#b8b8b8", "#eab49c", "#ff655c"],
};

function quantile({ attribute, predictions }: Result, at: number): string {
  const value = predictions[at]!.attribute;
  return number(attribute.name === "log_centroid_size" ? Math.exp(value) : value, 3);
}

function Slide({
  data,
  drawn,
  about,
  label,
  unit,
  transformation,
}: {
  data: Result;
  drawn: Points[];
  about: Schemas["CohortOutput"];
  label: string;
  unit: string;
  transformation: string;
}) {
  const { smallest, largest, mean } = data.attribute;
  const [value, setValue] = useState(data.predictions[data.predictions.length - 1]?.attribute ?? mean);
  const [average, slope] = drawn as [Points, Points];
  const closed = isClosed(about.representation),
    dots = isDots(about.representation);
  const turn = useMemo(() => upright(average, transformation), [average, transformation]);
  const at = (x: number) => turn(sum(average, [[x - mean, slope]]));
  const fit = useMemo(() => [at(smallest), at(largest), turn(average)], [average]);
  return (
    <figure class="card">
      <Figure
        fit={fit}
        height={340}
        legend={false}
        describe={t.regression.slider(label)}
        name={`${about.name}-predicted`}
        links={dots ? about.name : undefined}
        sets={[
          { name: "average", points: turn(average), closed, dots, pale: true, colour: "var(--pale)" },
          { name: "predicted", points: at(value), closed, dots, colour: "var(--accent)" },
        ]}
      />
      <label class="slider" style={{ gridTemplateColumns: "auto minmax(0, 1fr) auto" }}>
        <span>{label}</span>
        <input
          type="range"
          min={smallest}
          max={largest}
          step={(largest - smallest) / 200}
          value={value}
          aria-valuetext={plain(data, value, unit)}
          onInput={(event) => setValue(Number(event.currentTarget.value))}
        />
        <output class="number">{plain(data, value, unit)}</output>
      </label>
      <figcaption>{t.regression.slideHint}</figcaption>
    </figure>
  );
}

/** A value of the attribute for people: sizes as they are, not as logarithms. */
function plain({ attribute }: Result, value: number, unit: string): string {
  const shown = number(attribute.name === "log_centroid_size" ? Math.exp(value) : value, 3);
  return unit ? `${shown}\u00a0${unit}` : shown;
}

/** The line of least squares through the scores: its ends. */
function lineOf(points: Result["scores"]): (x: number) => number {
  const n = points.length || 1;
  const mx = points.reduce((sum, one) => sum + one.attribute, 0) / n,
    my = points.reduce((sum, one) => sum + one.score, 0) / n;
  const xx = points.reduce((sum, one) => sum + (one.attribute - mx) ** 2, 0),
    xy = points.reduce((sum, one) => sum + (one.attribute - mx) * (one.score - my), 0);
  return (x) => my + (xx > 0 ? xy / xx : 0) * (x - mx);
}

/** The score of each shape over the attribute, with a line, in the colours of a group. */
function Scores({
  data,
  label,
  cohort,
  by,
  groups,
}: {
  data: Result;
  label: string;
  cohort: string;
  by: string;
  groups: string[];
}) {
  const table = useLoaded(by ? `${cohort} ${by} ${data.cohort_revision}` : null, async (signal) => {
    const { columns } = (await get("/v1/cohorts/{cohort}/table", {
      path: { cohort },
      query: { columns: `id,${by}` },
      signal,
    })) as Schemas["TableAnswer"];
    const values = columns[1]!.values as unknown[];
    return new Map((columns[0]!.values as string[]).map((id, row) => [id, String(values[row] ?? "–")]));
  });
  const points = [...data.scores].sort((a, b) => a.attribute - b.attribute);
  const line = lineOf(points),
    looks = looksOf(groups);
  const names = by && table.data ? groups : [""];
  const lines: Line[] = names.map((name) => ({
    label: name || label,
    kind: "dots",
    colour: looks.get(name)?.colour ?? "accent",
    values: points.map((one) => (!name || table.data?.get(one.id) === name ? one.score : null)),
  }));
  return (
    <>
      <Chart
        x={points.map((one) => one.attribute)}
        lines={[
          ...lines,
          { label: t.regression.line, values: points.map((one) => line(one.attribute)), colour: "ink" },
        ]}
        xLabel={label}
        yLabel={t.regression.score}
        height={280}
        name={`${cohort}-regression-scores`}
        describe={t.regression.scores}
      />
      {names.length > 1 && <Keys keys={names.map((name): Key => [looks.get(name)!.colour, name])} />}
    </>
  );
}
