/** A linear model of the shapes of a cohort: its formula by choice of attributes, the table of its terms, and predicted shapes. */
import { useMemo, useState } from "preact/hooks";
import { post, type Schemas } from "../api/client";
import { settled } from "../api/jobs";
import { useLoaded } from "../hooks";
import { Download, Fault, Field, Loading, Select, Warning } from "../parts/basic";
import { Classes, dimensionOf } from "../parts/classes";
import { CATEGORIES } from "../parts/colours";
import { Figure } from "../parts/figure";
import { Matrix } from "../parts/matrix";
import { usePlace, useSetting } from "../router";
import { filterBody, filterOf } from "../shape/filter";
import { DASHES } from "../shape/groups";
import { evaluated, hasMesh, isClosed, isDots, type Points, upright } from "../shape/points";
import { nameOf, termName, variablesOf } from "../shape/terms";
import { count, number, percent, probability, t } from "../strings";
import { words } from "../strings/kept";
import { Chips, CohortPage, useAttributes } from "./cohort";
import { Progress } from "./compare";
import { Kept } from "./kept";

type Model = Schemas["ShapeModel"];
type Attribute = Schemas["AttributeOutput"];

/** Values of a factor beyond which it divides shapes into too many groups. */
const LEVELS = 20;

export function Linear({ cohort }: { cohort: string }) {
  return (
    <CohortPage cohort={cohort}>
      {(about, _, revision) => <View cohort={cohort} about={about} revision={revision} />}
    </CohortPage>
  );
}

/** An attribute as a formula names it. */
const written = (name: string): string => {
  const bare = name.replace(/^labels\./, "");
  return /^[\p{L}_][\p{L}\d_.]*$/u.test(bare) ? bare : `\`${bare}\``;
};

/** Attributes that can be terms: numbers, and texts with few values. */
const candidates = (items: Attribute[]): Attribute[] =>
  items.filter(
    (one) =>
      /^(label$|labels\.)/.test(one.name) && one.distinct > 1 && (one.type === "number" || one.distinct <= LEVELS),
  );

function View({ cohort, about, revision }: { cohort: string; about: Schemas["CohortOutput"]; revision: number }) {
  const { query } = usePlace();
  const filter = filterOf(query);
  const attributes = useAttributes(cohort, filter, revision);
  const all = candidates(attributes.data?.items ?? []);
  const first = all.find((one) => one.type === "text") ?? all[0];
  const [own, setOwn] = useSetting("formula", "");
  const [type, setType] = useSetting("type", "II");
  const [permutations, setPermutations] = useSetting("permutations", "999");
  const [transformation, setTransformation] = useSetting("transformation", "similarity");
  const [beside, setBeside] = useSetting("pairs", "");
  const standard = attributes.data ? `~ log_centroid_size${first ? ` + ${written(first.name)}` : ""}` : "";
  const formula = own || standard;
  const [draft, setDraft] = useState<string>();
  const [part, setPart] = useState<number | null>(null);
  const named = variablesOf(formula);
  const factors = all.filter((one) => one.type === "text" && named.includes(one.name.replace(/^labels\./, "")));
  const groups = factors.find((one) => one.name === beside)?.name.replace(/^labels\./, "");
  const body = {
    cohort,
    formula,
    type,
    filter: filterBody(filter),
    permutations: Number(permutations),
    missing: "skip",
    transformation,
    pairs: groups ? { groups: [groups], null: without(formula, groups) } : undefined,
  } as Schemas["ModelRequest"];
  const result = useLoaded(formula ? JSON.stringify([body, revision]) : null, async (signal) =>
    settled<Model>(
      (await post("/v1/models", { body, headers: { prefer: "wait=5" }, signal })) as Model,
      signal,
      (job) => setPart(job.progress),
    ),
  );
  return (
    <div class="aside right">
      <div class="stack" style={{ gap: "22px" }}>
        <Chips total={about.shape_count} shown={attributes.data?.shape_count} />
        <Fault error={result.error ?? attributes.error} retry={result.reload} />
        {result.loading && <Progress part={part} />}
        {result.data && (
          <>
            <p class="card say">{sentence(result.data)}</p>
            {result.data.warnings.map((warning) => (
              <Warning key={warning} text={warning} />
            ))}
            <Terms model={result.data} source={{ method: "POST", path: "/v1/models", body }} name={`${cohort}-model`} />
            {result.data.pairs && (
              <Matrix
                pairs={result.data.pairs}
                factor={termName(groups ?? "")}
                permutations={count(Number(permutations))}
              />
            )}
            {!hasMesh(about.representation) && (
              <Predicted model={result.data} about={about} transformation={transformation} />
            )}
            <Kept about={about} attributes={attributes.data?.items ?? []} body={body} shown={result.data} />
          </>
        )}
      </div>
      <div class="card no-print">
        <h2>{t.linear.formula}</h2>
        <Builder all={all} formula={formula} onFormula={setOwn} />
        <form
          onSubmit={(event) => {
            event.preventDefault();
            if (draft !== undefined) setOwn(draft.trim());
            setDraft(undefined);
          }}
        >
          <Field label={t.linear.written}>
            <input
              value={draft ?? formula}
              spellcheck={false}
              onInput={(event) => setDraft(event.currentTarget.value)}
            />
          </Field>
          {draft !== undefined && draft.trim() !== formula && (
            <div class="row">
              <button class="main">{t.linear.fit}</button>
            </div>
          )}
        </form>
        <p class="small quiet">{t.linear.hint}</p>
        <Select
          label={t.linear.type}
          value={type}
          options={["I", "II", "III"].map((one) => [one, t.linear.types[one]!])}
          onChange={setType}
        />
        <Select
          label={t.compare.permutations}
          value={permutations}
          options={["199", "999", "9999"].map((value) => [value, count(Number(value))])}
          onChange={setPermutations}
        />
        {factors.length > 0 && (
          <Select
            label={words().pairs}
            value={groups ? beside : ""}
            options={[["", words().noPairs], ...factors.map((one): [string, string] => [one.name, nameOf(one.name)])]}
            onChange={setBeside}
          />
        )}
        <Classes dimension={dimensionOf(about.representation)} value={transformation} onChange={setTransformation} />
      </div>
    </div>
  );
}

/** Terms of a formula that the builder understands: names joined by plus or times. */
function parsed(formula: string): { names: string[]; crossed: boolean } | null {
  const text = formula.replace(/^\s*~\s*/, "").trim();
  const names = text.split(/\s*[+*]\s*/).filter(Boolean);
  const signs = new Set(text.match(/[+*]/g) ?? []);
  return names.every((name) => /^(`[^`]+`|[\p{L}\d_.]+)$/u.test(name)) && signs.size < 2
    ? { names, crossed: signs.has("*") }
    : null;
}

/** The formula without the terms of a factor, whose groups are then compared by all that it adds; undefined where it has other signs. */
function without(formula: string, factor: string): string | undefined {
  const now = parsed(formula);
  const rest = now?.names.filter((name) => name.replaceAll("`", "") !== factor);
  return now ? `~ ${rest?.length ? rest.join(now.crossed ? " * " : " + ") : "1"}` : undefined;
}

function Builder({
  all,
  formula,
  onFormula,
}: {
  all: Attribute[];
  formula: string;
  onFormula: (formula: string) => void;
}) {
  const now = parsed(formula);
  const choices: [string, string][] = [
    ["log_centroid_size", t.attributes.log_centroid_size],
    ...all.map((one): [string, string] => [written(one.name), nameOf(one.name)]),
  ];
  const set = (names: string[], crossed: boolean) =>
    onFormula(`~ ${names.length ? names.join(crossed ? " * " : " + ") : "1"}`);
  return (
    <fieldset class="stack tight">
      <legend>{t.linear.terms}</legend>
      {choices.map(([id, name]) => (
        <label class="check" key={id}>
          <input
            type="checkbox"
            disabled={!now}
            checked={now?.names.includes(id) ?? false}
            onChange={(event) =>
              set(
                event.currentTarget.checked
                  ? [...(now?.names.filter((one) => one !== "1") ?? []), id]
                  : (now?.names.filter((one) => one !== id) ?? []),
                now?.crossed ?? false,
              )
            }
          />
          <span>{name}</span>
        </label>
      ))}
      <label class="check">
        <input
          type="checkbox"
          disabled={!now || now.names.length < 2}
          checked={now?.crossed ?? false}
          onChange={(event) => set(now?.names ?? [], event.currentTarget.checked)}
        />
        <span>{t.linear.interactions}</span>
      </label>
    </fieldset>
  );
}

/** Which terms are clear, in plain words. */
function sentence(model: Model): string {
  const tested = model.terms.filter((one) => typeof one.p === "number");
  const clear = tested.filter((one) => one.p! <= 0.05);
  if (!tested.length) return t.linear.untested;
  return clear.length
    ? t.linear.clear(
        clear.map((one) => t.linear.term(termName(one.term), percent(one.r_squared), probability(one.p))).join("; "),
      )
    : t.linear.none;
}

function Terms({
  model,
  source,
  name,
}: {
  model: Model;
  source: { method: "POST"; path: string; body: object };
  name: string;
}) {
  const head = (label: string) => (
    <th scope="col" class="number" key={label}>
      {label}
    </th>
  );
  return (
    <section class="card scroll" tabIndex={0}>
      <h2>{t.linear.table}</h2>
      <table class="dense">
        <thead>
          <tr>
            <th scope="col">{t.linear.of}</th>
            {["df", "SS", "MS", "R²", "F", "Z", "p"].map(head)}
          </tr>
        </thead>
        <tbody>
          {model.terms.map((one) => (
            <tr key={one.term}>
              <th scope="row">{termName(one.term)}</th>
              <td class="number">{count(one.df)}</td>
              <td class="number">{number(one.sum_of_squares)}</td>
              <td class="number">{number(one.mean_square)}</td>
              <td class="number">{percent(one.r_squared)}</td>
              <td class="number">{number(one.f)}</td>
              <td class="number">{number(one.z, 3)}</td>
              <td class="number">{probability(one.p)}</td>
            </tr>
          ))}
        </tbody>
        <tfoot>
          <tr>
            <th scope="row">{t.linear.residual}</th>
            <td class="number">{count(model.residual.df)}</td>
            <td class="number">{number(model.residual.sum_of_squares)}</td>
            <td class="number">{number(model.residual.mean_square)}</td>
            <td class="number">{percent(model.residual.r_squared)}</td>
            <td colSpan={3} />
          </tr>
          <tr>
            <th scope="row">{t.linear.total}</th>
            <td class="number">{count(model.total.df)}</td>
            <td class="number">{number(model.total.sum_of_squares)}</td>
            <td colSpan={5} />
          </tr>
        </tfoot>
      </table>
      <p class="small quiet">{t.linear.tableHint(model.shape_count)}</p>
      <Download
        source={{ ...source, ownWidth: true }}
        name={name}
        formats={[
          ["SVG", "svg", "image/svg+xml"],
          ["PNG", "png", "image/png"],
          ["JSON", "json", "application/json"],
        ]}
      />
    </section>
  );
}

/** Predicted shapes at the values that the service has chosen: levels of a factor, or quantiles of a number. */
function Predicted({
  model,
  about,
  transformation,
}: {
  model: Model;
  about: Schemas["CohortOutput"];
  transformation: string;
}) {
  const { representation } = about,
    predictions = model.predictions.filter((one) => one.shape).slice(0, CATEGORIES.length);
  const drawn = useLoaded(
    JSON.stringify([model.formula, model.cohort_revision, transformation, model.type]),
    (signal) =>
      predictions.length
        ? evaluated(
            representation,
            predictions.map((one) => one.shape as Points),
            signal,
          )
        : Promise.resolve([]),
  );
  const sets = useMemo(() => {
    if (!drawn.data?.length || drawn.data.length !== predictions.length) return [];
    const turn = upright(drawn.data[0]!, transformation);
    return predictions.map((one, at) => ({
      name: Object.entries(one.at)
        .map(([name, value]) => `${termName(name)} ${typeof value === "number" ? number(value, 3) : String(value)}`)
        .join(", "),
      points: turn(drawn.data![at]!),
      closed: isClosed(representation),
      dots: isDots(representation),
      colour: CATEGORIES[at]!,
      dash: DASHES[at]!,
    }));
  }, [drawn.data]);
  return (
    <section class="card">
      <h2>{t.linear.predicted}</h2>
      <Fault error={drawn.error} />
      <Loading on={drawn.loading} />
      {sets.length > 0 && (
        <Figure
          sets={sets}
          describe={t.linear.predictedAlt}
          name={`${about.name}-predicted`}
          links={isDots(representation) ? about.name : undefined}
        />
      )}
      <p class="small quiet">{t.linear.predictedHint}</p>
    </section>
  );
}
