/** The mean of a cohort over its aligned shapes, live. */
import { type Answer, get, type Schemas } from "../api/client";
import { useLoaded } from "../hooks";
import { Download, Fault, Loading, Picture, Select, Warning, WITH_NUMBERS } from "../parts/basic";
import { Chart } from "../parts/chart";
import { Classes, dimensionOf } from "../parts/classes";
import { isSeams, Seams } from "../parts/correspond";
import { Figure } from "../parts/figure";
import { Robust } from "../parts/robust";
import { Solid } from "../parts/solid";
import { usePlace, useSetting } from "../router";
import { filterOf } from "../shape/filter";
import { evaluated, hasMesh, isClosed, isDots, type Points, upright } from "../shape/points";
import { count, percent, t } from "../strings";
import { Chips, CohortPage } from "./cohort";

export function MeanView({ cohort }: { cohort: string }) {
  return (
    <CohortPage cohort={cohort}>
      {(about, _, revision) => <Mean cohort={cohort} about={about} revision={revision} />}
    </CohortPage>
  );
}

function Mean({ cohort, about, revision }: { cohort: string; about: Schemas["CohortOutput"]; revision: number }) {
  const { query: place } = usePlace();
  const dimension = dimensionOf(about.representation);
  const [transformation, setTransformation] = useSetting("transformation", "similarity");
  const [frame, setFrame] = useSetting("frame", "training");
  const [alignment, setAlignment] = useSetting("alignment", "");
  const [robust, setRobust] = useSetting("robust", "");
  const [corresponding, setCorresponding] = useSetting("corresponding", "");
  const filter = filterOf(place);
  const query = new URLSearchParams(filter);
  query.set("transformation", transformation);
  if (frame !== "training") query.set("frame", frame);
  if (alignment) query.set("alignment", alignment);
  if (robust) query.set("robust", "true");
  if (corresponding) query.set("corresponding", "true");
  const path = `/v1/cohorts/${encodeURIComponent(cohort)}/mean`;
  const mean = useLoaded(`${cohort} ${query} ${revision}`, (signal) =>
    get("/v1/cohorts/{cohort}/mean", { path: { cohort }, query, signal }),
  );
  const source = { path, query };
  const values = mean.data?.eigenvalues ?? [];
  const formats: [string, string, string][] = hasMesh(about.representation)
    ? [
        ...WITH_NUMBERS,
        ["OBJ", "obj", "model/obj"],
        ["PLY", "ply", "application/ply"],
        ["glTF", "gltf", "model/gltf-binary"],
      ]
    : WITH_NUMBERS;
  return (
    <div class="aside right">
      <div class="stack" style={{ gap: "22px" }}>
        <Chips total={about.shape_count} shown={mean.data?.shape_count} />
        {isSeams(mean.error) ? (
          <Seams cohort={cohort} onAsTheyAre={() => setCorresponding("yes")} />
        ) : (
          <Fault error={mean.error} retry={mean.reload} />
        )}
        <Loading on={mean.loading} />
        {mean.data && (
          <div class="card">
            {hasMesh(about.representation) ? (
              <>
                <Solid source={source} describe={t.mean.alt(cohort)} />
                <Download source={source} name={`${cohort}-mean`} formats={formats} />
              </>
            ) : dimension === 3 || isDots(about.representation) ? (
              <Drawn about={about} mean={mean.data} transformation={transformation} source={source} />
            ) : (
              <Picture
                key={revision}
                source={source}
                name={`${cohort}-mean`}
                alt={t.mean.alt(cohort)}
                caption={t.mean.caption(Math.min(mean.data.shape_count, 300))}
                formats={formats}
              />
            )}
          </div>
        )}
        {mean.data?.warnings.map((warning) => (
          <Warning text={warning} />
        ))}
        {mean.data?.robust && (
          <Robust
            cohort={cohort}
            representation={about.representation}
            found={{
              rejected: mean.data.robust.rejected_count,
              reduced: mean.data.robust.reduced_count,
              effective: mean.data.robust.effective_count,
              minority: mean.data.robust.minority,
              shapes: mean.data.robust.shapes ?? [],
            }}
          />
        )}
        {values.length > 1 && (
          <figure class="card">
            <h2>{t.mean.eigenvalues}</h2>
            <Chart
              x={values.map((_, index) => index + 1)}
              lines={[{ label: t.mean.eigenvalues, values, kind: "bars" }]}
              xLabel={t.words.rank}
              yLabel={t.mean.eigenvalue}
              describe={t.mean.eigenvalues}
              range={[0, null]}
            />
            <figcaption>{t.mean.eigenvaluesHint}</figcaption>
          </figure>
        )}
      </div>
      <div class="stack" style={{ gap: "22px" }}>
        <div class="card">
          <Classes dimension={dimension} value={transformation} onChange={setTransformation} />
          <Select
            label={t.mean.alignment}
            value={alignment}
            options={[
              ["", t.mean.standard],
              ["projection", t.mean.projection],
              ["procrustes", "Procrustes"],
              ["partial_procrustes", t.mean.partial],
            ]}
            onChange={setAlignment}
          />
          <label class="check">
            <input
              type="checkbox"
              checked={robust !== ""}
              onChange={(event) => setRobust(event.currentTarget.checked ? "yes" : "")}
            />
            <span>{t.robust.use}</span>
          </label>
          <Select
            label={t.mean.frame}
            value={frame}
            options={[
              ["training", t.mean.training],
              ["canonical", t.mean.canonical],
            ]}
            onChange={setFrame}
          />
        </div>
        {mean.data && (
          <div class="card">
            <h2>{t.mean.certificate}</h2>
            <p>
              {mean.data.unique ? t.mean.unique : mean.data.unique === false ? t.mean.notUnique : t.mean.noCertificate}
            </p>
            <dl class="facts">
              <dt>{t.words.shapes}</dt>
              <dd>{count(mean.data.shape_count)}</dd>
              <dt>{t.mean.gap}</dt>
              <dd>{values[0] && typeof mean.data.gap === "number" ? percent(mean.data.gap / values[0]) : "–"}</dd>
              <dt>{t.mean.rounds}</dt>
              <dd>{mean.data.rounds}</dd>
              <dt>{t.mean.converged}</dt>
              <dd>{mean.data.converged ? t.words.yes : t.words.no}</dd>
              <dt>{t.words.revision}</dt>
              <dd>{mean.data.revision}</dd>
            </dl>
          </div>
        )}
      </div>
    </div>
  );
}

/** The mean of landmarks or of curves in space: numbered, joined by lines, turned. */
function Drawn({
  about,
  mean,
  transformation,
  source,
}: {
  about: Schemas["CohortOutput"];
  mean: Answer<"get", "/v1/cohorts/{cohort}/mean">;
  transformation: string;
  source: { path: string; query: URLSearchParams };
}) {
  const control = mean.mean.control_points as Points;
  const drawn = useLoaded(`${about.id} ${mean.revision} ${source.query}`, async (signal) => {
    const [points] = await evaluated(about.representation, [control], signal);
    return upright(points!, transformation)(points!);
  });
  const dots = isDots(about.representation);
  return (
    <figure>
      <Fault error={drawn.error} />
      {drawn.data && (
        <Figure
          describe={t.mean.alt(about.name)}
          name={`${about.name}-mean`}
          links={dots ? about.name : undefined}
          sets={[
            {
              name: about.name,
              points: drawn.data,
              dots,
              closed: isClosed(about.representation),
              colour: "var(--ink)",
            },
          ]}
        />
      )}
      <figcaption>{t.mean.alone}</figcaption>
      <Picture
        source={source}
        name={`${about.name}-aligned`}
        alt={t.mean.alt(about.name)}
        caption={t.mean.caption(Math.min(mean.shape_count, 300))}
      />
    </figure>
  );
}
