/** A kept linear model: sliders and choices for its attributes, and the shape that it predicts at them, before the mean. */
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { get, post, Refusal, type Schemas } from "../api/client";
import { settled } from "../api/jobs";
import { useAction, useFollowed, useLoaded, useSettled } from "../hooks";
import { Download, Fault, Loading, Select, WITH_NUMBERS } from "../parts/basic";
import { Figure, reachOf, type Tube } from "../parts/figure";
import { Scale, Solid } from "../parts/solid";
import { useSetting } from "../router";
import { evaluated, hasMesh, isClosed, isDots, type Points, upright } from "../shape/points";
import { type Range, rangeOf, termName, variablesOf } from "../shape/terms";
import { number, t } from "../strings";
import { words } from "../strings/kept";

type Model = Schemas["ShapeModel"];
type Prediction = Schemas["PredictionRecord"];
type Values = Record<string, string | number>;

/** Places along curves at which bands are kept. */
const SAMPLES = 120;
/** Steps of a slider. */
const STEPS = 200;

/** A button that keeps the model of the view, and the one that is kept. */
export function Kept({
  about,
  attributes,
  body,
  shown,
}: {
  about: Schemas["CohortOutput"];
  attributes: Schemas["AttributeOutput"][];
  /** The request of the model of the view, and its answer. */
  body: Schemas["ModelRequest"];
  shown: Model;
}) {
  const w = words();
  const [job, setJob] = useSetting("kept", "");
  const [, setAt] = useSetting("at", "");
  const keep = useAction(async () => {
    const samples = about.representation.kind.endsWith("curve") ? SAMPLES : undefined;
    const { pairs: _, ...rest } = body;
    const answer = (await post("/v1/models", {
      body: { ...rest, keep: true, samples },
      headers: { prefer: "wait=5" },
    })) as Model;
    const model = await settled<Model>(answer, new AbortController().signal);
    setAt("");
    setJob(/models\/([^/]+)\/predictions/.exec(model.kept_at ?? "")?.[1] ?? "");
  });
  const kept = useLoaded(job || null, async (signal) => {
    const found = await get("/v1/jobs/{job}", { path: { job }, signal });
    return found.result as Model;
  });
  const isGone = kept.error instanceof Refusal && kept.error.status === 404;
  const model = job && !isGone ? kept.data : undefined;
  const isOther = model && whatOf(model) !== whatOf(shown);
  return (
    <section class="card no-print">
      <h2>{w.title}</h2>
      {!model && <p class="quiet">{w.lead}</p>}
      {isGone ? <p class="note warn">{w.gone}</p> : <Fault error={kept.error} retry={kept.reload} />}
      <Loading on={kept.loading && !!job} />
      {isOther && <p class="small quiet">{w.other}</p>}
      {(!model || isOther) && (
        <div class="row">
          <button class={model ? "" : "main"} disabled={keep.busy} onClick={() => keep.run()}>
            {model ? w.again : w.keep}
          </button>
          {keep.busy && (
            <span class="quiet" role="status">
              {w.keeping}
            </span>
          )}
        </div>
      )}
      <Fault error={keep.error} />
      {model?.pooled && <Predicting key={job} about={about} attributes={attributes} job={job} model={model} />}
    </section>
  );
}

/** By what two models are told to be the same. */
const whatOf = ({ formula, type, transformation, cohort_revision, shape_count }: Model): string =>
  JSON.stringify([formula, type, transformation, cohort_revision, shape_count]);

/** What the model depends on: factors with their levels, and numbers with their ranges. */
function inputsOf(model: Model, attributes: Schemas["AttributeOutput"][]) {
  const bare = (name: string) => name.replace(/^\w+\((.*?)(,.*)?\)$/, "$1").replaceAll("`", "");
  const levels = Object.entries(model.design.levels).map(([name, all]): [string, string[]] => [bare(name), all]);
  const factors = levels.filter(([, all]) => all.length > 1);
  const numbers = variablesOf(model.formula).flatMap((name): [string, Range][] => {
    const range = levels.some(([other]) => other === name) ? null : rangeOf(name, attributes);
    return range ? [[name, range]] : [];
  });
  return { factors, numbers };
}

/** Values in an address. */
function readFrom(text: string, standard: Values): Values {
  try {
    return { ...standard, ...(JSON.parse(text) as Values) };
  } catch {
    return standard;
  }
}

function Predicting({
  about,
  attributes,
  job,
  model,
}: {
  about: Schemas["CohortOutput"];
  attributes: Schemas["AttributeOutput"][];
  job: string;
  model: Model;
}) {
  const w = words();
  const { factors, numbers } = useMemo(() => inputsOf(model, attributes), [model, attributes]);
  const standard = Object.fromEntries<string | number>([
    ...factors.map(([name, levels]) => [name, levels[0]!] as const),
    ...numbers.map(([name, { middle }]) => [name, middle] as const),
  ]);
  const [text, setText] = useSetting("at", "");
  const [level, setLevel] = useSetting("bands", "");
  const [values, setValues] = useState<Values>(() => readFrom(text, standard));
  // The address follows when the hand rests.
  const rested = useSettled(JSON.stringify(values), 400);
  useEffect(() => setText(rested === JSON.stringify(standard) ? "" : rested), [rested]);
  const query = new URLSearchParams(
    Object.entries(values).flatMap(([name, value]) => (value === "" ? [] : [[`at.${name}`, String(value)]])),
  );
  // Surfaces have none that could be drawn.
  const solid = hasMesh(about.representation);
  if (level && !solid) query.set("bands", level);
  const found = useFollowed(`${job} ${query}`, async (signal) => {
    const answer = await get("/v1/models/{job}/predictions", { path: { job }, query, signal });
    const prediction = answer.predictions[0]!;
    // Bands come with points along the shape; without them the service is asked for these.
    const points =
      (prediction.band?.points as Points | undefined) ??
      (solid ? undefined : (await evaluated(about.representation, [prediction.shape as Points], signal))[0]!);
    return { prediction, points, draws: answer.draws };
  });
  const set = (name: string, value: string | number) => setValues({ ...values, [name]: value });
  const place = [...factors, ...numbers].map(([name]) => `${termName(name)} ${said(values[name], name, numbers)}`);
  const detail = found.error instanceof Refusal ? found.error.problem.detail : "";
  return (
    <>
      <p class="small quiet">{w.about(model.formula, model.shape_count)}</p>
      <div class="stack">
        <div class="sliders">
          {!factors.length && !numbers.length && <p class="quiet">{w.none}</p>}
          {numbers.map(([name, range]) => (
            <Slider
              key={name}
              name={name}
              range={range}
              value={Number(values[name])}
              unit={range.logarithm ? (about.length_unit ?? "") : ""}
              onInput={(value) => set(name, value)}
            />
          ))}
        </div>
        <div class="form">
          {factors.map(([name, levels]) => (
            <Select
              key={name}
              label={termName(name)}
              value={String(values[name])}
              options={[...levels.map((one): [string, string] => [one, one]), ["", w.all]]}
              onChange={(value) => set(name, value)}
            />
          ))}
          {!solid && <Select label={w.bands} value={level} options={Object.entries(w.levels)} onChange={setLevel} />}
        </div>
        {/that the shapes determine/.test(detail) ? (
          <p class="note warn" role="alert">
            {w.undetermined}
          </p>
        ) : /random parts/.test(detail) ? (
          <p class="note warn" role="alert">
            {w.noBands}
          </p>
        ) : (
          <Fault error={found.error} />
        )}
        <Loading on={!found.data && !found.error} />
        <Drawn about={about} model={model} found={found.data} place={place.join(", ")} />
        {found.data?.prediction.extrapolated && <p class="note warn">{w.outside}</p>}
        {found.data && <p class="small quiet">{w.leverage(number(found.data.prediction.leverage, 3))}</p>}
        {found.data?.prediction.band && (
          <p class="small quiet">
            {typeof found.data.prediction.band.simultaneous === "number"
              ? w.together(w.levels[level] ?? level, found.data.draws)
              : w.single(w.levels[level] ?? level)}
          </p>
        )}
        <Download
          name={`${about.name}-prediction`}
          source={{ path: `/v1/models/${encodeURIComponent(job)}/predictions`, query }}
          formats={WITH_NUMBERS.slice(2)}
        />
      </div>
    </>
  );
}

/** A value as people read it: sizes as they are, not as logarithms. */
function said(value: string | number | undefined, name: string, numbers: [string, Range][]): string {
  const range = numbers.find(([other]) => other === name)?.[1];
  if (!range) return value === "" ? words().all : String(value);
  return number(range.logarithm ? Math.exp(Number(value)) : Number(value), 3);
}

function Slider({
  name,
  range,
  value,
  unit,
  onInput,
}: {
  name: string;
  range: Range;
  value: number;
  unit: string;
  onInput: (value: number) => void;
}) {
  const { least, most, logarithm } = range;
  const label = logarithm ? t.attributes["measures.centroid_size"] : termName(name);
  const text = `${said(value, name, [[name, range]])}${unit && `\u00a0${unit}`}`;
  return (
    <label class="slider wide">
      <span>{label}</span>
      <input
        type="range"
        min={least}
        max={most}
        step={(most - least) / STEPS}
        value={value}
        aria-valuetext={text}
        // The last step of a slider may be a rounding error beyond its end.
        onInput={(event) => onInput(Math.min(Math.max(Number(event.currentTarget.value), least), most))}
      />
      <output class="number">{text}</output>
    </label>
  );
}

/** The predicted shape before the mean, with its band. */
function Drawn({
  about,
  model,
  found,
  place,
}: {
  about: Schemas["CohortOutput"];
  model: Model;
  found: { prediction: Prediction; points: Points | undefined } | undefined;
  place: string;
}) {
  const w = words();
  const { representation } = about;
  const control = model.pooled!.control_points as Points;
  const mean = useLoaded(hasMesh(representation) ? null : "mean", (signal) =>
    evaluated(representation, [control], signal),
  );
  const turn = useMemo(
    () => upright(mean.data?.[0] ?? [], typeof model.transformation === "string" ? model.transformation : ""),
    [mean.data],
  );
  // The frame holds all that was drawn so far: it does not jump as the shape moves.
  const reach = useRef<Points>([]),
    wide = useRef<Points>([]);
  if (hasMesh(representation))
    return found?.prediction.shape ? (
      <Surface
        about={about}
        shape={found.prediction.shape as Points}
        mean={control}
        unit={["rigid", "translation"].includes(String(model.transformation)) ? (about.length_unit ?? "") : ""}
      />
    ) : null;
  if (!mean.data) return <Fault error={mean.error} />;
  const pale = turn(mean.data[0]!),
    points = found?.points && turn(found.points);
  const closed = isClosed(representation),
    dots = isDots(representation);
  reach.current = corners([...reach.current, ...pale, ...(points ?? [])]);
  const band = found?.prediction.band;
  const tube: Tube | undefined =
    band && points ? { points, matrices: matricesOf(band, turn), closed, dots } : undefined;
  // Without bands the frame is that of the shapes again.
  wide.current = tube ? corners([...wide.current, ...reachOf(tube)]) : [];
  return (
    <figure>
      <Figure
        fit={[reach.current, wide.current]}
        height={420}
        legend={false}
        describe={w.alt(place)}
        name={`${about.name}-prediction`}
        links={dots ? about.name : undefined}
        tube={tube}
        sets={[
          { name: w.mean, points: pale, closed, dots, pale: true, colour: "var(--pale)" },
          ...(points ? [{ name: w.predicted, points, closed, dots, colour: "var(--accent)" }] : []),
        ]}
      />
      <figcaption>{w.caption}</figcaption>
    </figure>
  );
}

/** The least and the largest coordinates: two points that span the box of all of them. */
function corners(points: Points): Points {
  const of = (choose: (a: number, b: number) => number) =>
    points.reduce((found, p) => found.map((x, axis) => choose(x, p[axis]!)), points[0]!);
  return points.length ? [of(Math.min), of(Math.max)] : [];
}

/**
 * The regions of a band: balls of all places together, or, where there is no factor for these, the ellipses whose extent
 * in each direction is the interval of that place alone, as in the pictures of the service.
 */
function matricesOf(band: NonNullable<Prediction["band"]>, turn: (points: Points) => Points): number[][][] {
  const { simultaneous, deviation, half_width, covariance, points } = band;
  const axes = points[0]?.map((_, axis) => axis) ?? [];
  // The rows are the images of the axes.
  const turned = turn(axes.map((axis) => axes.map((other) => (other === axis ? 1 : 0))));
  return deviation.map((one, at) => {
    if (typeof simultaneous === "number")
      return axes.map((i) => axes.map((j) => (i === j ? (simultaneous * one) ** 2 : 0)));
    const entry = (i: number, j: number) =>
      covariance[at]![(Math.max(i, j) * (Math.max(i, j) + 1)) / 2 + Math.min(i, j)]!;
    const axis = axes.reduce((best, other) => (entry(other, other) > entry(best, best) ? other : best), 0);
    const square = half_width[at]![axis]! ** 2 / Math.max(entry(axis, axis), Number.MIN_VALUE);
    return axes.map((i) =>
      axes.map((j) =>
        axes.reduce(
          (sum, k) => axes.reduce((of, l) => of + square * turned[k]![i]! * entry(k, l) * turned[l]![j]!, sum),
          0,
        ),
      ),
    );
  });
}

/** A predicted surface, drawn anew when the hand rests, and coloured by where it lies outside or inside of the mean. */
function Surface({
  about,
  shape,
  mean,
  unit,
}: {
  about: Schemas["CohortOutput"];
  shape: Points;
  mean: Points;
  unit: string;
}) {
  const w = words();
  const rested = useSettled(shape, 250);
  const [most, setMost] = useState(0);
  const source = (control_points: Points) => ({
    method: "POST" as const,
    path: "/v1/evaluate",
    body: { representation: about.representation, shapes: [{ control_points }] },
  });
  return (
    <figure>
      <Solid
        source={source(rested)}
        against={{ source: source(mean), sign: -1 }}
        describe={w.predicted}
        height={360}
        onMost={setMost}
      />
      {most > 0 && <Scale most={most} unit={unit} ends={[t.solid.inwards, t.solid.outwards]} />}
      <figcaption>{w.coloured}</figcaption>
    </figure>
  );
}
