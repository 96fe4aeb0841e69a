/** How shapes depend on a number, with a slider over it. */
import { useMemo, useState } from "preact/hooks";
import { post, type Schemas } from "../api/client";
import { settled } from "../api/jobs";
import { useLoaded } from "../hooks";
import { Fault, Picture, Select } from "../parts/basic";
import { Chart } from "../parts/chart";
import { Classes, dimensionOf } from "../parts/classes";
import { Shape } from "../parts/shape";
import { usePlace, useSetting } from "../router";
import { filterBody, filterOf } from "../shape/filter";
import { box, evaluated, inPlane, isClosed, type Points, sum, upright } from "../shape/points";
import { number, percent, probability, t } from "../strings";
import { shown } from "../theme";
import { Chips, CohortPage, nameOf, useAttributes } from "./cohort";
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
    const drawn = inPlane(about.representation)
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
              <p class="note warn">{warning}</p>
            ))}
            {result.data?.drawn && (
              <Slide
                data={data}
                drawn={result.data.drawn}
                closed={isClosed(about.representation)}
                dots={about.representation.kind === "landmarks"}
                label={label}
                transformation={transformation}
              />
            )}
            <figure class="card">
              <h2>{t.regression.scores}</h2>
              <Scores data={data} label={label} />
              <figcaption>{t.regression.scoresHint}</figcaption>
            </figure>
            <div class="card">
              <Picture
                source={{ method: "POST", path: "/v1/regressions", body }}
                name={`${cohort}-regression`}
                alt={t.regression.alt(label)}
                caption={t.regression.caption}
                keys={[
                  [SHADES[shown()], t.regression.key(quantile(data, 0), quantile(data, data.predictions.length - 1))],
                ]}
              />
            </div>
          </>
        )}
      </div>
      <div class="stack" style={{ gap: "22px" }}>
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
  closed,
  dots,
  label,
  transformation,
}: {
  data: Result;
  drawn: Points[];
  closed: boolean;
  dots: boolean;
  label: string;
  transformation: string;
}) {
  const { smallest, largest, mean } = data.attribute;
  const [value, setValue] = useState(data.predictions[data.predictions.length - 1]?.attribute ?? mean);
  const [average, slope] = drawn as [Points, Points];
  const turn = useMemo(() => upright(average, transformation), [average, transformation]);
  const at = (x: number) => turn(sum(average, [[x - mean, slope]]));
  const view = useMemo(() => box([at(smallest), at(largest), turn(average)]), [average]);
  return (
    <figure class="card">
      <Shape
        view={view}
        height={340}
        describe={t.regression.slider(label)}
        parts={[
          { points: turn(average), closed, dots, class: "pale" },
          { points: at(value), closed, dots, class: "accent" },
        ]}
      />
      <label class="slider" style={{ gridTemplateColumns: "auto minmax(0, 1fr) 3.6em" }}>
        <span>{label}</span>
        <input
          type="range"
          min={smallest}
          max={largest}
          step={(largest - smallest) / 200}
          value={value}
          onInput={(event) => setValue(Number(event.currentTarget.value))}
        />
        <output class="number">{number(value, 3)}</output>
      </label>
      <figcaption>{t.regression.slideHint}</figcaption>
    </figure>
  );
}

function Scores({ data, label }: { data: Result; label: string }) {
  const points = [...data.scores].sort((a, b) => a.attribute - b.attribute);
  return (
    <Chart
      x={points.map((one) => one.attribute)}
      lines={[{ label, values: points.map((one) => one.score), kind: "dots" }]}
      xLabel={label}
      yLabel={t.regression.score}
      height={280}
      describe={t.regression.scores}
    />
  );
}
