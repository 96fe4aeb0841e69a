/** A dictionary: how good it is, and its atoms. */
import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import { useMay } from "../api/caller";
import { get, post, remove, type Schemas } from "../api/client";
import { settled } from "../api/jobs";
import { useAction, useLoaded } from "../hooks";
import {
  announce,
  Dialog,
  Download,
  Fault,
  Keys,
  Loading,
  Page,
  Picture,
  Tabs,
  Warning,
  WITH_NUMBERS,
} from "../parts/basic";
import { Chart, colour } from "../parts/chart";
import { Robust } from "../parts/robust";
import { Shape } from "../parts/shape";
import { navigate } from "../router";
import { box, evaluated, inPlane, isClosed, isDots, type Points, upright } from "../shape/points";
import { nameOf } from "../shape/terms";
import { count, number, percent, t, time } from "../strings";
import { Progress } from "./compare";

export type About = Schemas["DictionaryOutput"];

export function DictionaryPage({
  dictionary,
  children,
}: {
  dictionary: string;
  children: (about: About) => ComponentChildren;
}) {
  const about = useLoaded(dictionary, (signal) =>
    get("/v1/dictionaries/{dictionary}", { path: { dictionary }, signal }),
  );
  const [ask, setAsk] = useState(false);
  const writes = useMay("writer");
  const data = about.data;
  const base = `/app/dictionaries/${encodeURIComponent(dictionary)}`;
  const components = data?.method.kind === "functional_pca";
  const tabs: [string, string][] = data
    ? [
        [t.dictionary.report, base],
        ...(components
          ? ([
              [t.dictionary.modes, `${base}/modes`],
              [t.dictionary.scores, `${base}/scores`],
            ] as [string, string][])
          : []),
        [components ? t.dictionary.components : t.dictionary.atoms, `${base}/atoms`],
        [t.dictionary.drift, `${base}/drift`],
      ]
    : [];
  const lead =
    data &&
    t.dictionary.lead(
      data.cohort_name ?? data.cohort ?? "–",
      data.statistics.shapes,
      typeof data.transformation === "string" ? t.classes[data.transformation]![0] : t.classes.own![0],
      time(data.provenance.created_at),
    );
  return (
    <Page
      title={data?.name ?? dictionary}
      tag={data && `${t.words.version} ${data.version}`}
      crumbs={[
        [t.menu.dictionaries, "/app/dictionaries"],
        ...(data?.cohort_name
          ? [[data.cohort_name, `/app/cohorts/${encodeURIComponent(data.cohort_name)}`] as [string, string]]
          : []),
      ]}
      lead={lead}
      actions={
        data && (
          <>
            <a
              class="button main"
              href={`/app/assess?dictionary=${encodeURIComponent(`${data.name}@${data.version}`)}`}
            >
              {t.menu.assess}
            </a>
            <Download
              name={`${data.name}-${data.version}`}
              source={{ path: `/v1/dictionaries/${encodeURIComponent(dictionary)}/export` }}
              formats={[[t.act.export, "json", "application/json"]]}
            />
            {writes && (
              <button class="bad" onClick={() => setAsk(true)}>
                {t.act.remove}
              </button>
            )}
          </>
        )
      }
    >
      {tabs.length > 0 && <Tabs label={dictionary} tabs={tabs} />}
      {data?.warnings?.map((warning) => (
        <Warning key={warning} text={warning} />
      ))}
      <Fault error={about.error} retry={about.reload} />
      {data ? children(data) : !about.error && <Loading on />}
      {ask && data && <Delete about={data} onClose={() => setAsk(false)} />}
    </Page>
  );
}

function Delete({ about, onClose }: { about: About; onClose: () => void }) {
  const action = useAction(async () => {
    await remove("/v1/dictionaries/{dictionary}", { path: { dictionary: about.id } });
    navigate("/app/dictionaries");
    announce({
      text: t.cohort.deleted(`${about.name}@${about.version}`),
      undo: async () => {
        await post("/v1/trash/{id}/restore", { path: { id: about.id } });
        navigate(`/app/dictionaries/${encodeURIComponent(`${about.name}@${about.version}`)}`);
      },
    });
  });
  return (
    <Dialog title={t.cohort.deleteTitle(`${about.name}@${about.version}`)} onClose={onClose}>
      <p>{t.dictionary.deleteHint}</p>
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

export function Report({ dictionary }: { dictionary: string }) {
  return <DictionaryPage dictionary={dictionary}>{(about) => <ReportCard about={about} />}</DictionaryPage>;
}

function ReportCard({ about }: { about: About }) {
  const explained = about.atoms.flatMap((atom) => (typeof atom.explained === "number" ? [atom.explained] : []));
  const kept = explained.reduce((total, value) => total + value, 0);
  let running = 0;
  const validation = about.classifier?.validation;
  return (
    <>
      <dl class="card figures" style={{ display: "flex" }}>
        {explained.length > 0 && (
          <div>
            <dt>{t.report.kept(explained.length)}</dt>
            <dd>{percent(kept)}</dd>
          </div>
        )}
        <div>
          <dt>{t.report.error}</dt>
          <dd>{percent(Math.sqrt(about.statistics.reconstruction_error))}</dd>
        </div>
        {validation && (
          <div>
            <dt>{t.report.accuracy}</dt>
            <dd>{percent(validation.accuracy.value)}</dd>
          </div>
        )}
        <div>
          <dt>{t.words.shapes}</dt>
          <dd>{count(about.statistics.shapes)}</dd>
        </div>
        {typeof about.mean.unique === "boolean" && (
          <div>
            <dt>{t.report.mean}</dt>
            <dd>{about.mean.unique ? t.report.unique : t.report.notUnique}</dd>
          </div>
        )}
      </dl>
      <div class="columns">
        {explained.length > 0 ? (
          <figure class="card">
            <h2>{t.report.explained}</h2>
            <Chart
              x={explained.map((_, index) => index + 1)}
              height={260}
              range={[0, 1]}
              format={(value) => percent(value, 0)}
              xLabel={t.words.component}
              yLabel={t.report.part}
              describe={t.report.explainedAlt(explained.map((value) => percent(value)).join(", "))}
              lines={[
                { label: t.report.each, values: explained, kind: "bars" },
                { label: t.report.sum, values: explained.map((value) => (running += value)), colour: "plus" },
              ]}
            />
            <figcaption>{t.report.explainedHint}</figcaption>
          </figure>
        ) : about.statistics.history.length > 1 ? (
          <figure class="card">
            <h2>{t.report.history}</h2>
            <Chart
              x={about.statistics.history.map((_, index) => index + 1)}
              lines={[{ label: t.report.objective, values: about.statistics.history }]}
              xLabel={t.report.pass}
              yLabel={t.report.objective}
              height={260}
              describe={t.report.history}
            />
            <figcaption>{t.report.historyHint}</figcaption>
          </figure>
        ) : null}
        {validation && about.classifier && <Classifier classifier={about.classifier} />}
        {explained.length > 0 && <Quality about={about} />}
        {about.robust && about.cohort_name && (
          <Robust cohort={about.cohort_name} representation={about.representation} found={about.robust} />
        )}
        <section class="card">
          <h2>{t.report.origin}</h2>
          <dl class="facts">
            <dt>{t.words.cohort}</dt>
            <dd>
              {about.cohort_name ?? "–"}, {t.words.revision} {about.cohort_revision}
            </dd>
            {Object.keys(about.provenance.filter ?? {}).length > 0 && (
              <>
                <dt>{t.report.filter}</dt>
                <dd>
                  <code>{JSON.stringify(about.provenance.filter)}</code>
                </dd>
              </>
            )}
            <dt>{t.words.method}</dt>
            <dd>{about.method.kind === "sparse" ? t.learn.sparse : t.learn.components}</dd>
            <dt>{t.mean.alignment}</dt>
            <dd>{about.alignment}</dd>
            <dt>{t.report.program}</dt>
            <dd>{about.provenance.program}</dd>
            <dt>{t.report.digest}</dt>
            <dd>
              <code>{about.provenance.digest.slice(0, 16)}…</code>
            </dd>
          </dl>
          <p class="small quiet">{t.report.originHint}</p>
        </section>
        {!validation && (
          <section class="card">
            <h2>{t.report.classes}</h2>
            <p class="quiet">{t.report.noClasses}</p>
          </section>
        )}
      </div>
    </>
  );
}

type Quality = Schemas["DictionaryReport"];

/** Generalisation, specificity and stability, on request: they take a moment. */
function Quality({ about }: { about: About }) {
  const [asked, setAsked] = useState(false);
  const [part, setPart] = useState<number | null>(null);
  const path = "/v1/dictionaries/{dictionary}/report";
  const found = useLoaded(asked ? about.id : null, async (signal) =>
    settled<Quality>(
      (await post(path, {
        path: { dictionary: about.id },
        body: {},
        headers: { prefer: "wait=5" },
        signal,
      })) as Quality,
      signal,
      (job) => setPart(job.progress),
    ),
  );
  const data = found.data;
  const unit = data?.length_unit ? ` (${data.length_unit})` : "";
  return (
    <figure class="card">
      <h2>{t.report.quality}</h2>
      {!asked && (
        <>
          <p class="quiet">{t.report.qualityHint}</p>
          <button class="main" onClick={() => setAsked(true)}>
            {t.report.examine}
          </button>
        </>
      )}
      <Fault error={found.error} retry={found.reload} />
      {found.loading && <Progress part={part} />}
      {data && (
        <>
          <Chart
            x={data.modes.map((mode) => mode.component)}
            height={220}
            range={[0, null]}
            xLabel={t.words.component}
            yLabel={`${t.report.distance}${unit}`}
            describe={t.report.errorsAlt(data.modes.map((mode) => number(mode.generalisation.value, 3)).join(", "))}
            lines={[
              { label: t.report.generalisation, values: data.modes.map((mode) => mode.generalisation.value) },
              { label: t.report.specificity, values: data.modes.map((mode) => mode.specificity.value), colour: "plus" },
            ]}
          />
          <div class="scroll" tabIndex={0}>
            <table>
              <thead>
                <tr>
                  <th scope="col">{t.words.component}</th>
                  <th scope="col">
                    {t.report.generalisation}
                    {unit}
                  </th>
                  <th scope="col">
                    {t.report.specificity}
                    {unit}
                  </th>
                  <th scope="col">{t.report.angle}</th>
                </tr>
              </thead>
              <tbody>
                {data.modes.map((mode) => (
                  <tr key={mode.component}>
                    <th scope="row">{mode.component}</th>
                    <td>{between(mode.generalisation)}</td>
                    <td>{between(mode.specificity)}</td>
                    <td>{mode.angle_deg ? `${number(mode.angle_deg.median, 1)}°` : "–"}</td>
                  </tr>
                ))}
              </tbody>
            </table>
          </div>
          <figcaption>{t.report.qualityCaption(data.shape_count, data.subject_count)}</figcaption>
          {data.warnings.map((warning) => (
            <p class="small quiet" key={warning}>
              {warning}
            </p>
          ))}
          <Download
            name={`${about.name}-${about.version}-report`}
            source={{ method: "POST", path: `/v1/dictionaries/${encodeURIComponent(about.id)}/report`, body: {} }}
            formats={WITH_NUMBERS}
          />
        </>
      )}
    </figure>
  );
}

/** A value with its interval. */
function between({ value, low, high }: Schemas["Interval"]): string {
  return typeof low === "number" && typeof high === "number"
    ? `${number(value, 3)} (${number(low, 3)} – ${number(high, 3)})`
    : number(value, 3);
}

function Classifier({ classifier }: { classifier: NonNullable<About["classifier"]> }) {
  const validation = classifier.validation!;
  const labels = classifier.classes.map((one) => one.label);
  return (
    <section class="card">
      <h2>
        {t.report.classes}: {nameOf(classifier.settings.attribute ?? "label")}
      </h2>
      <p>
        {t.report.accuracyText(
          percent(validation.accuracy.value),
          percent(validation.accuracy.low),
          percent(validation.accuracy.high),
          percent(validation.majority),
        )}
      </p>
      <div class="scroll" tabIndex={0}>
        <table class="matrix">
          <caption>{t.report.confusion}</caption>
          <thead>
            <tr>
              <td />
              {labels.map((label) => (
                <th scope="col" key={label}>
                  {label}
                </th>
              ))}
              <th scope="col">{t.report.recall}</th>
            </tr>
          </thead>
          <tbody>
            {validation.confusion.map((row, index) => {
              const total = row.reduce((sum, value) => sum + value, 0) || 1;
              return (
                <tr key={labels[index]}>
                  <th scope="row">{labels[index]}</th>
                  {row.map((value, column) => (
                    <td
                      style={{
                        background: `color-mix(in srgb, ${column === index ? "var(--accent)" : "var(--plus)"} ${Math.round((50 * value) / total)}%, transparent)`,
                      }}
                    >
                      {count(value)}
                    </td>
                  ))}
                  <td>{percent(validation.classes[index]?.recall.value, 0)}</td>
                </tr>
              );
            })}
          </tbody>
        </table>
      </div>
      <p class="small quiet">{t.report.folds(validation.folds, validation.repeats)}</p>
    </section>
  );
}

export function Atoms({ dictionary }: { dictionary: string }) {
  const source = { path: `/v1/dictionaries/${encodeURIComponent(dictionary)}/atoms` };
  return (
    <DictionaryPage dictionary={dictionary}>
      {(about) => (
        <>
          <p class="quiet prose">
            {about.method.kind === "sparse" ? t.dictionary.atomsHint : t.dictionary.componentsHint}
          </p>
          {inPlane(about.representation) && about.method.kind !== "sparse" && (
            <Keys
              keys={[
                [colour("minus"), t.dictionary.minus],
                [colour("plus"), t.dictionary.plus],
                [colour("pale"), t.dictionary.mean],
              ]}
            />
          )}
          {inPlane(about.representation) && <Each about={about} />}
          {inPlane(about.representation) ? (
            <Download name={`${about.name}-atoms`} source={source} formats={WITH_NUMBERS} />
          ) : (
            <div class="card">
              <Picture name={`${about.name}-atoms`} alt={t.dictionary.atomsAlt(about.atoms.length)} source={source} />
            </div>
          )}
        </>
      )}
    </DictionaryPage>
  );
}

/** Each atom with its share: variance of a component, use of an atom. */
function Each({ about }: { about: About }) {
  const sparse = about.method.kind === "sparse";
  const drawn = useLoaded(about.id, (signal) =>
    evaluated(
      about.representation,
      [
        (about.centre ?? about.mean.control_points) as Points,
        ...about.atoms.map((atom) => atom.control_points as Points),
      ],
      signal,
      160,
    ),
  );
  if (!drawn.data)
    return (
      <>
        <Fault error={drawn.error} />
        <Loading on={drawn.loading} />
      </>
    );
  const [mean, ...atoms] = drawn.data as [Points, ...Points[]];
  const closed = isClosed(about.representation),
    dots = isDots(about.representation);
  const turn = upright(mean, about.transformation);
  return (
    <div class="columns" style={{ gridTemplateColumns: "repeat(auto-fill, minmax(190px, 1fr))" }}>
      {atoms.map((atom, index) => {
        const data = about.atoms[index]!;
        const sigma = Math.sqrt(Math.max(data.eigenvalue ?? 0, 0) / Math.max(about.statistics.weight - 1, 1));
        const at = (weight: number) =>
          turn(mean.map((p, row) => p.map((value, column) => value + weight * atom[row]![column]!)));
        const own = upright(atom, about.transformation)(atom);
        const parts = sparse
          ? [{ points: own, closed, dots }]
          : [
              { points: turn(mean), closed, dots, class: "pale" },
              { points: at(-2 * sigma), closed, dots, class: "minus" },
              { points: at(2 * sigma), closed, dots, class: "plus" },
            ];
        return (
          <figure class="card" key={index}>
            <Shape
              parts={parts}
              view={box(parts.map((part) => part.points))}
              describe={t.dictionary.atom(index + 1)}
              height={150}
            />
            <figcaption>
              <strong>{sparse ? t.dictionary.atom(index + 1) : t.dictionary.component(index + 1)}</strong>
              <br />
              {sparse ? t.dictionary.use(percent(data.usage)) : t.dictionary.share(percent(data.explained))}
            </figcaption>
          </figure>
        );
      })}
    </div>
  );
}
