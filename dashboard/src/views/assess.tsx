/** One shape against a dictionary, as a report of one page. */
import { useEffect, useState } from "preact/hooks";
import { get, pages, post, type Schemas } from "../api/client";
import { ACCEPT, shapesOf, type Input } from "../formats/read";
import { Drop } from "../parts/drop";
import { Fault, Field, Loading, Page, Picture, Select } from "../parts/basic";
import { Chart } from "../parts/chart";
import { useLoaded } from "../hooks";
import { useSetting } from "../router";
import { inPlane } from "../shape/points";
import { number, percent, t, time } from "../strings";
import { handedOver } from "../shape/handover";

export function Assess(_: object) {
  const list = useLoaded("dictionaries", (signal) => pages((cursor) => get("/v1/dictionaries", { query: { cursor, limit: 1000 }, signal })));
  const [chosen, setChosen] = useSetting("dictionary", "");
  const [cohort] = useSetting("cohort", "");
  const [stored, setStored] = useSetting("shape", "");
  const [shapes, setShapes] = useState<Input[]>(() => handedOver());
  const [index, setIndex] = useState(0);
  const [error, setError] = useState<Error>();
  const dictionaries = [...(list.data ?? [])].reverse();
  const dictionary = chosen || (dictionaries[0] ? `${dictionaries[0].name}@${dictionaries[0].version}` : "");
  const about = useLoaded(dictionary || null, (signal) => get("/v1/dictionaries/{dictionary}", { path: { dictionary }, signal }));
  useEffect(() => setIndex(0), [shapes]);
  const take = async ([file]: File[]) => {
    try {
      const found = await shapesOf(file!);
      if (!found.length) throw new Error(t.assess.nothing);
      setShapes(found);
      if (stored) setStored("");
      setError(undefined);
    } catch (fault) {
      setError(fault instanceof SyntaxError ? new Error(t.upload.syntax(fault.message)) : (fault as Error));
    }
  };
  const source = about.data?.cohort_name ?? cohort;
  const shape = shapes[index];
  const body: Schemas["AssessRequest"] | null = stored ? { cohort: cohort || source, ids: [stored] } : shape ? { shapes: [{ points: shape.points, control_points: shape.control_points }] as Input[] } : null;
  const name = stored || shape?.external_id || t.assess.posted;
  return (
    <Page title={t.assess.title} lead={<span class="no-print">{t.assess.lead}</span>} actions={body && <button onClick={() => print()}>{t.assess.print}</button>}>
      <Fault error={list.error ?? error} />
      {list.data?.length === 0 && <div class="card empty"><p>{t.dictionaries.none}</p><a class="button main" href="/app/dictionaries?learn=new">{t.learn.title}</a></div>}
      {dictionaries.length > 0 && (
        <>
          <div class="form no-print">
            <Select label={t.words.dictionary} value={dictionary} options={[...(dictionaries.some((one) => `${one.name}@${one.version}` === dictionary) ? [] : [[dictionary, dictionary] as [string, string]]), ...dictionaries.map((one): [string, string] => [`${one.name}@${one.version}`, `${one.name}, ${t.words.version} ${one.version}${one.classifier ? ` (${t.assess.withClasses})` : ""}`])]} onChange={setChosen} />
            <Field label={t.assess.stored(source || "–")}><input value={stored} placeholder="external_id" onChange={(event) => setStored(event.currentTarget.value.trim())} /></Field>
            {shapes.length > 1 && !stored && <Select label={t.words.shape} value={String(index)} options={shapes.slice(0, 500).map((one, at) => [String(at), one.external_id ?? String(at + 1)])} onChange={(value) => setIndex(Number(value))} />}
          </div>
          <Drop title={t.assess.drop} hint={t.assess.formats} accept={ACCEPT} onFiles={(files) => void take(files)} />
          <p class="small quiet no-print">{t.assess.picture} <a href="/app/segment">{t.menu.segment}</a></p>
          <Fault error={about.error} />
          {body && about.data && <Report key={dictionary} about={about.data} dictionary={dictionary} body={body} name={name} cohort={source} />}
        </>
      )}
    </Page>
  );
}

/** What the dictionary says of the shape, in numbers: scores in standard deviations, or the atoms in use. */
function Code({ about, code }: { about: Schemas["DictionaryOutput"]; code: { indices: number[]; values: number[] } }) {
  const covariance = about.statistics.scores?.covariance;
  const values = code.values.map((value, at) => (covariance ? value / Math.sqrt(covariance[code.indices[at]!]![code.indices[at]!]! || 1) : value));
  const label = covariance ? t.assess.scores : t.assess.atoms;
  return (
    <figure class="card">
      <h2>{t.assess.code}</h2>
      <Chart x={code.indices.map((index) => index + 1)} lines={[{ label, values, kind: "bars" }]} height={170} xLabel={covariance ? t.words.component : t.dictionary.atoms} yLabel={covariance ? "σ" : t.assess.weight} describe={`${label}: ${values.map((value) => number(value, 2)).join(", ")}`} />
      <figcaption>{label}</figcaption>
    </figure>
  );
}

const rank = (part: number) => (part >= 1 ? t.assess.first : t.assess.rank(percent(part, 0)));

function Report({ about, dictionary, body, name, cohort }: { about: Schemas["DictionaryOutput"]; dictionary: string; body: Schemas["AssessRequest"]; name: string; cohort: string }) {
  const result = useLoaded(`${dictionary} ${JSON.stringify(body)}`, (signal) => post("/v1/dictionaries/{dictionary}/assess", { path: { dictionary }, body, signal }));
  const near = { ...(body.ids?.length ? { ids: body.ids } : { shapes: body.shapes }), neighbours: 6, transformation: about.transformation } as Schemas["SearchRequest"];
  const search = useLoaded(cohort ? JSON.stringify([cohort, near]) : null, (signal) => post("/v1/cohorts/{cohort}/search", { path: { cohort }, body: near, signal }));
  const first = result.data?.results[0];
  if (!first || !("novelty" in first)) return <><Fault error={result.error} /><Loading on={result.loading} /></>;
  const { novelty, class: found, code } = first;
  const matrix = code.transformation?.matrix;
  const planar = matrix?.length === 2;
  const neighbours = search.data?.results[0];
  return (
    <article class="report">
      <header class="card">
        <p class="quiet">{name}</p>
        <p class="verdict">{found ? t.assess.verdict(found.ranking[0]?.label ?? t.assess.noClass, percent(found.ranking[0]?.confidence, 0), found.accepted) : novelty.is_outlier ? t.assess.unusual : t.assess.usual}</p>
        <div class="row">
          <span class={`tag ${novelty.is_outlier ? "bad" : "good"}`}>{novelty.is_outlier ? t.assess.outlier : t.assess.inlier}</span>
          <span class="small quiet">{t.assess.against(`${about.name}@${about.version}`, about.statistics.shapes, time(about.provenance.created_at))}</span>
        </div>
      </header>
      <div class="columns">
        <div class="stack" style={{ gap: "22px" }}>
        <div class="card">
          <h2>{t.assess.where}</h2>
          <Picture source={{ method: "POST", path: `/v1/dictionaries/${encodeURIComponent(dictionary)}/assess`, body }} name={`${name}-report`} alt={t.assess.whereAlt(name)} width={420} caption={t.assess.whereCaption} />
        </div>
        <Code about={about} code={code} />
        </div>
        <div class="stack" style={{ gap: "22px" }}>
          {found && (
            <section class="card">
              <h2>{t.report.class}</h2>
              <div class="bars">
                {found.ranking.map((one) => <div class="bar" style={{ gridTemplateColumns: "minmax(5em, auto) minmax(0, 1fr) 4em" }} key={one.label}><span>{one.label}</span><span class="track"><i style={{ width: `${100 * (one.confidence ?? 0)}%` }} /></span><span class="number">{percent(one.confidence, 0)}</span></div>)}
              </div>
              {found.accepted === false && <p class="note warn">{t.assess.rejected}</p>}
              {about.classifier?.validation && <p class="small quiet">{t.assess.accuracy(percent(about.classifier.validation.accuracy.value), percent(about.classifier.validation.majority))}</p>}
            </section>
          )}
          <section class="card">
            <h2>{t.assess.novelty}</h2>
            <dl class="facts">
              {typeof novelty.t_squared_rank === "number" && <><dt>{t.assess.within}</dt><dd>{rank(novelty.t_squared_rank)}</dd></>}
              {typeof novelty.squared_prediction_error_rank === "number" && <><dt>{t.assess.beyond}</dt><dd>{rank(novelty.squared_prediction_error_rank)}</dd></>}
              <dt>{t.assess.error}</dt><dd>{percent(first.relative_error, 2)}</dd>
            </dl>
            <p class="small quiet">{t.assess.noveltyHint}</p>
          </section>
          {planar && matrix && (
            <section class="card">
              <h2>{t.assess.pose}</h2>
              <dl class="facts">
                <dt>{t.assess.scale}</dt><dd>{number(1 / Math.sqrt(Math.abs(matrix[0]![0]! * matrix[1]![1]! - matrix[0]![1]! * matrix[1]![0]!)), 4)}{about.length_unit ? ` ${about.length_unit}` : ""}</dd>
                <dt>{t.assess.angle}</dt><dd>{number((Math.atan2(matrix[1]![0]!, matrix[0]![0]!) * 180) / Math.PI, 3)}°</dd>
              </dl>
            </section>
          )}
        </div>
      </div>
      <section class="card">
        <h2>{t.assess.nearest}</h2>
        <Fault error={search.error} />
        {inPlane(about.representation) && neighbours && "neighbours" in neighbours && <Picture source={{ method: "POST", path: `/v1/cohorts/${encodeURIComponent(cohort)}/search`, body: near }} name={`${name}-nearest`} alt={t.shape.neighboursAlt} />}
        {neighbours && "neighbours" in neighbours && (
          <p class="small">{neighbours.neighbours.map((one, at) => <>{at > 0 && " · "}<a href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(one.external_id ?? one.id)}`}>{one.external_id ?? one.id}</a>{one.label ? ` (${one.label})` : ""}</>)}</p>
        )}
      </section>
      <p class="only-print small">{t.assess.printed(time(new Date().toISOString()))}</p>
    </article>
  );
}
