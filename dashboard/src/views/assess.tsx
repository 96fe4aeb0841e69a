/** One shape against a dictionary, as a report of one page: from a file of shapes, a mask, or a picture in which it is found first. */
import { useEffect, useState } from "preact/hooks";
import { get, type Problem, pages, post, Refusal, Said, type Schemas } from "../api/client";
import { contoursOf, type Found, formats, type Input, inspected, keptLines, type Line, linesOf } from "../formats/file";
import { IMAGE_FORMATS, isPicture, shownOf, sliceOf, type Volume, volumeOf } from "../formats/image";
import { useLoaded } from "../hooks";
import { Choice, Fault, Field, Loading, Page, Picture, Select, Warning } from "../parts/basic";
import { Chart, colour } from "../parts/chart";
import { Contents, Formats } from "../parts/contents";
import { Drop } from "../parts/drop";
import { canComplete, Partial } from "../parts/partial";
import { Scale, Solid } from "../parts/solid";
import { navigate, useSetting } from "../router";
import { handedOver, handOverImage } from "../shape/handover";
import { isMask, largestObject } from "../shape/object";
import { hasMesh, inPlane, isDots, type Points, path, type Representation } from "../shape/points";
import { segmented, USUAL } from "../shape/snake";
import { factor, scaled, unitOf } from "../shape/units";
import { number, percent, t, time } from "../strings";
import { shown } from "../theme";

export function Assess(_: object) {
  const list = useLoaded("dictionaries", (signal) =>
    pages((cursor) => get("/v1/dictionaries", { query: { cursor, limit: 1000 }, signal })),
  );
  const [chosen, setChosen] = useSetting("dictionary", "");
  const [cohort] = useSetting("cohort", "");
  const [stored, setStored] = useSetting("shape", "");
  const [handed] = useState(handedOver);
  const [shapes, setShapes] = useState<(Input | Line)[]>(handed.shapes);
  const [unit, setUnit] = useState(handed.unit);
  const [round, setRound] = useState(0);
  const [found, setFound] = useState<Found>();
  const [index, setIndex] = useState(0);
  const [error, setError] = useState<Error>();
  const dictionaries = [...(list.data ?? [])].reverse();
  const dictionary = chosen || (dictionaries[0] ? `${dictionaries[0].name}@${dictionaries[0].version}` : "");
  const about = useLoaded(dictionary || null, (signal) =>
    get("/v1/dictionaries/{dictionary}", { path: { dictionary }, signal }),
  );
  useEffect(() => setIndex(0), [shapes]);
  const [image, setImage] = useState<Image>();
  const [file, setFile] = useState("");
  const [remark, setRemark] = useState("");
  const [busy, setBusy] = useState(false);
  const known = useLoaded("formats", formats);
  const set = (all: (Input | Line)[], unit?: string) => {
    if (!all.length) throw new Said(t.assess.nothing);
    setShapes(all);
    setUnit(unit);
    setRound(round + 1);
    if (stored) setStored("");
  };
  /** A picture as labels, or as greys among which an object is found. */
  const read = async (file: File, volume: Volume, as: Image["as"]) => {
    const solid = as === "mask" && volume.size[2] > 1;
    const found = as === "image" ? [] : solid ? await linesOf(file) : await contoursOf(file, volume.name);
    let outline: Points | undefined;
    if (as === "image") {
      if (volume.size[2] > 1) {
        setImage({ file, volume, as });
        setShapes([]);
        return;
      }
      const slice = sliceOf(volume, 2, 0),
        object = largestObject(slice);
      if (!object) throw new Said(t.assess.noObject);
      outline = (await segmented(volume, slice, { ...USUAL, polarity: object.polarity }, { box: object.box })).outline;
      found.push({ external_id: volume.name, points: outline });
    }
    setImage({ file, volume, as, outline });
    set(found, solid ? unitOfFile(await inspected(file, {})) : unitOf(volume));
  };
  const take = async ([file]: File[]) => {
    setBusy(true);
    setError(undefined);
    setImage(undefined);
    setFound(undefined);
    setFile(file!.name);
    try {
      if (isPicture(file!.name)) {
        const volume = await volumeOf(file!).catch(() => {
          throw new Said(t.segment.unreadable(file!.name));
        });
        await read(file!, volume, isMask(volume) ? "mask" : "image");
      } else {
        const kept = await keptLines(file!);
        const inside = kept ? undefined : await inspected(file!, {});
        setFound(inside);
        set(kept ?? (await linesOf(file!)), inside && unitOfFile(inside));
      }
    } catch (fault) {
      setError(fault instanceof SyntaxError ? new Said(t.upload.syntax(fault.message)) : (fault as Error));
    }
    setBusy(false);
  };
  const reread = async (as: Image["as"]) => {
    setBusy(true);
    setError(undefined);
    await read(image!.file, image!.volume, as).catch((fault: Error) => {
      setError(fault);
      setImage({ ...image!, as, outline: undefined });
      setShapes([]);
    });
    setBusy(false);
  };
  const source = about.data?.cohort_name ?? cohort;
  const shape = shapes[index];
  const by = factor(unit, about.data?.length_unit);
  const key = shape && about.data ? `${about.data.name}@${about.data.version} ${round} ${index}` : null;
  const taken = useLoaded(stored ? null : key, async (signal) => ({
    key,
    input: await assessable(shape!, about.data!.representation, by ?? 1, signal),
  }));
  const body: Schemas["AssessRequest"] | null = stored
    ? { cohort: cohort || source, ids: [stored] }
    : taken.data && taken.data.key === key
      ? { shapes: [taken.data.input] }
      : null;
  const name = stored || shape?.external_id || bareName(file) || t.assess.posted;
  return (
    <Page
      title={t.assess.title}
      lead={<span class="no-print">{t.assess.lead}</span>}
      actions={body && <button onClick={() => print()}>{t.assess.print}</button>}
    >
      <Fault error={list.error ?? error} />
      {list.data?.length === 0 && (
        <div class="card empty">
          <p>{t.dictionaries.none}</p>
          <a class="button main" href="/app/dictionaries?learn=new">
            {t.learn.title}
          </a>
        </div>
      )}
      {dictionaries.length > 0 && (
        <>
          <div class="form no-print">
            <Select
              label={t.words.dictionary}
              value={dictionary}
              options={[
                ...(dictionaries.some((one) => `${one.name}@${one.version}` === dictionary)
                  ? []
                  : [[dictionary, dictionary] as [string, string]]),
                ...dictionaries.map((one): [string, string] => [
                  `${one.name}@${one.version}`,
                  `${one.name}, ${t.words.version} ${one.version}${one.classifier ? ` (${t.assess.withClasses})` : ""}`,
                ]),
              ]}
              onChange={setChosen}
            />
            <Field label={t.assess.stored(source || "–")}>
              <input
                value={stored}
                placeholder="external_id"
                onChange={(event) => setStored(event.currentTarget.value.trim())}
              />
            </Field>
            {shapes.length > 1 && !stored && (
              <Select
                label={t.words.shape}
                value={String(index)}
                options={shapes.slice(0, 500).map((one, at) => [String(at), one.external_id ?? String(at + 1)])}
                onChange={(value) => setIndex(Number(value))}
              />
            )}
          </div>
          <Drop title={t.assess.drop} hint={t.assess.formats(IMAGE_FORMATS)} onFiles={(files) => void take(files)} />
          {known.data && <Formats formats={known.data} />}
          <Loading on={busy || taken.loading} />
          {found && !stored && (
            <section class="card no-print">
              <Contents found={found} formats={known.data} />
            </section>
          )}
          <Fault error={taken.error} />
          {by === null && !stored && shape && (
            <p class="note warn">{t.assess.otherUnit(unit!, about.data!.length_unit!)}</p>
          )}
          {image && !stored && <Source image={image} shapes={shapes} index={index} onRead={(as) => void reread(as)} />}
          <p class="small quiet no-print">
            {t.assess.picture} <a href="/app/segment">{t.menu.segment}</a>
          </p>
          <Fault error={about.error} />
          {body && about.data && (
            <Report
              key={dictionary}
              about={about.data}
              dictionary={dictionary}
              body={body}
              name={name}
              cohort={source}
              file={stored ? "" : file}
              remark={remark}
              onRemark={setRemark}
            />
          )}
        </>
      )}
    </Page>
  );
}

const bareName = (name: string): string => name.replace(/\.[^.]*$/, "");

/** Unit that a file states. */
const unitOfFile = ({ properties }: Found): string | undefined =>
  typeof properties.unit === "string" ? properties.unit : undefined;

/** A shape as the dictionary takes it, multiplied by the factor to its unit. A mesh becomes its vertices, or the surface that is fitted to it, as in an upload to a cohort. */
async function assessable(
  shape: Input | Line,
  representation: Representation,
  by: number,
  signal: AbortSignal,
): Promise<Input> {
  if (!("vertices" in shape) || !shape.vertices) {
    const { points, control_points } = shape as Input;
    if (!points && !control_points) throw new Said(t.assess.unfit);
    return {
      points: scaled(points as Points | undefined, by),
      control_points: scaled(control_points as Points | undefined, by),
    } as Input;
  }
  const { faces = [] } = shape,
    vertices = scaled(shape.vertices, by);
  if (isDots(representation)) return { points: vertices };
  if (representation.kind === "subdivision") return { control_points: vertices };
  if (representation.kind !== "surface") throw new Said(t.assess.unfit);
  // Polygons as fans of triangles.
  const triangles = faces.flatMap(([first, ...rest]) => rest.slice(1).map((last, at) => [first!, rest[at]!, last]));
  const answer = await post("/v1/fit", {
    body: { representation, meshes: [{ vertices, faces: triangles }] } as Schemas["FitRequest"],
    signal,
  });
  const [fitted] = answer.results as { control_points?: Points; error?: Problem }[];
  if (fitted?.error) throw new Refusal(fitted.error);
  return { control_points: fitted!.control_points };
}

interface Image {
  file: File;
  volume: Volume;
  as: "mask" | "image";
  outline?: Points;
}

/** The picture from which the shape comes, with its contour: whoever reads the report must see whether it is the right one. */
function Source({
  image: { file, volume, as, outline },
  shapes,
  index,
  onRead,
}: {
  image: Image;
  shapes: (Input | Line)[];
  index: number;
  onRead: (as: Image["as"]) => void;
}) {
  const planar = volume.size[2] === 1;
  const picture = useLoaded(planar ? `${file.name} ${file.size} ${file.lastModified}` : null, async () =>
    URL.createObjectURL(await shownOf(volume, sliceOf(volume, 2, 0))),
  );
  useEffect(
    () => () => {
      if (picture.data) URL.revokeObjectURL(picture.data);
    },
    [picture.data],
  );
  const [sx, sy] = volume.spacing,
    [width, height] = [volume.size[0] * sx, volume.size[1] * sy];
  const contour = outline ?? (as === "mask" ? (shapes[index]?.points as Points | undefined) : undefined);
  return (
    <section class="card">
      <h2>{t.assess.from}</h2>
      <div class="row" style={{ alignItems: "start", gap: "22px" }}>
        {planar && (
          <svg
            viewBox={`${-0.5 * sx} ${-0.5 * sy} ${width} ${height}`}
            style={{ width: "min(100%, 320px)", maxHeight: "320px", background: "var(--sunken)" }}
            role="img"
            aria-label={t.assess.contourAlt(volume.name)}
          >
            {picture.data && (
              <image
                href={picture.data}
                x={-0.5 * sx}
                y={-0.5 * sy}
                width={width}
                height={height}
                preserveAspectRatio="none"
              />
            )}
            {contour && (
              <path
                d={path(
                  contour.map((p) => [p[0]!, -p[1]!]),
                  true,
                )}
                fill="none"
                stroke="#00d0e4"
                stroke-width="2"
                vector-effect="non-scaling-stroke"
              />
            )}
          </svg>
        )}
        <div class="stack" style={{ flex: "1 1 260px" }}>
          <div class="stack tight no-print">
            <span class="legend">{t.assess.readAs}</span>
            <Choice
              label={t.assess.readAs}
              value={as}
              options={[
                ["mask", t.assess.mask],
                ["image", t.assess.image],
              ]}
              onChange={(value) => onRead(value as Image["as"])}
            />
          </div>
          <p class="small quiet">{planar ? contour && t.assess.contourHint : as === "image" && t.assess.volume}</p>
          {as === "image" && (
            <div class="row no-print">
              <button
                onClick={() => {
                  handOverImage(file);
                  navigate("/app/segment");
                }}
              >
                {planar ? t.assess.correct : t.menu.segment}
              </button>
            </div>
          )}
        </div>
      </div>
    </section>
  );
}

/** A surface and its reconstruction: where one lies outside or inside of the other. */
function Residual({
  about,
  dictionary,
  body,
  name,
}: {
  about: Schemas["DictionaryOutput"];
  dictionary: string;
  body: Schemas["AssessRequest"];
  name: string;
}) {
  const [most, setMost] = useState(0);
  const found = useLoaded(`${dictionary} ${JSON.stringify(body)}`, async (signal) => {
    const stored = body.ids?.[0];
    const [shape, answer] = await Promise.all([
      stored
        ? get("/v1/cohorts/{cohort}/shapes/{shape}", { path: { cohort: body.cohort!, shape: stored }, signal }).then(
            (one) => ({ control_points: one.control_points }),
          )
        : body.shapes![0]!,
      post("/v1/dictionaries/{dictionary}/reconstruct", {
        path: { dictionary },
        body: { ...body, pose: "input" } as Schemas["ReconstructRequest"],
        signal,
      }),
    ]);
    const source = (one: object) => ({
      method: "POST" as const,
      path: "/v1/evaluate",
      body: { representation: about.representation, correspondence: about.correspondence, shapes: [one] },
    });
    const other = answer.results[0] as { control_points?: Points };
    return { shape: source(shape), other: source({ control_points: other.control_points }) };
  });
  return (
    <>
      <Fault error={found.error} />
      <Loading on={found.loading} />
      {found.data && (
        <Solid
          source={found.data.shape}
          against={{ source: found.data.other, sign: -1 }}
          onMost={setMost}
          describe={t.assess.whereAlt(name)}
          height={400}
        />
      )}
      {most > 0 && <Scale most={most} unit={about.length_unit ?? ""} ends={[t.solid.inwards, t.solid.outwards]} />}
      {found.data && <p class="small quiet">{t.assess.outside}</p>}
    </>
  );
}

/** What the dictionary says of the shape, in numbers: scores in standard deviations, or the atoms in use. */
function Code({ about, code }: { about: Schemas["DictionaryOutput"]; code: { indices: number[]; values: number[] } }) {
  const covariance = about.statistics.scores?.covariance;
  const values = code.values.map((value, at) =>
    covariance ? value / Math.sqrt(covariance[code.indices[at]!]![code.indices[at]!]! || 1) : value,
  );
  const label = covariance ? t.assess.scores : t.assess.atoms;
  return (
    <figure class="card">
      <h2>{t.assess.code}</h2>
      <Chart
        x={code.indices.map((index) => index + 1)}
        lines={[{ label, values, kind: "bars" }]}
        height={170}
        xLabel={covariance ? t.words.component : t.dictionary.atoms}
        yLabel={covariance ? "σ" : t.assess.weight}
        describe={`${label}: ${values.map((value) => number(value, 2)).join(", ")}`}
      />
      <figcaption>{label}</figcaption>
    </figure>
  );
}

const rank = (part: number) => (part >= 1 ? t.assess.first : t.assess.rank(percent(part, 0)));

function Report({
  about,
  dictionary,
  body,
  name,
  cohort,
  file,
  remark,
  onRemark,
}: {
  about: Schemas["DictionaryOutput"];
  dictionary: string;
  body: Schemas["AssessRequest"];
  name: string;
  cohort: string;
  file: string;
  remark: string;
  onRemark: (remark: string) => void;
}) {
  const result = useLoaded(`${dictionary} ${JSON.stringify(body)}`, (signal) =>
    post("/v1/dictionaries/{dictionary}/assess", { path: { dictionary }, body, signal }),
  );
  const near = {
    ...(body.ids?.length ? { ids: body.ids } : { shapes: body.shapes }),
    neighbours: 6,
    transformation: about.transformation,
  } as Schemas["SearchRequest"];
  const search = useLoaded(cohort ? JSON.stringify([cohort, near]) : null, (signal) =>
    post("/v1/cohorts/{cohort}/search", { path: { cohort }, body: near, signal }),
  );
  const first = result.data?.results[0];
  if (!first || !("novelty" in first))
    return (
      <>
        <Fault error={result.error} />
        <Loading on={result.loading} />
      </>
    );
  const { novelty, class: found, code } = first;
  const matrix = code.transformation?.matrix;
  const planar = matrix?.length === 2;
  const neighbours = search.data?.results[0];
  return (
    <article class="report">
      {about.warnings?.map((warning) => (
        <Warning key={warning} text={warning} />
      ))}
      <header class="card">
        <p class="quiet">
          {name}
          {file && ` · ${t.assess.file}: ${file}`}
        </p>
        <p class="verdict">
          {t.assess.verdict(
            first.verdict,
            found ? (found.ranking[0]?.label ?? t.assess.noClass) : null,
            percent(found?.ranking[0]?.confidence, 0),
          )}
        </p>
        <div class="row">
          <span class={`tag ${novelty.is_outlier ? "bad" : "good"}`}>
            {novelty.is_outlier ? t.assess.outlier : t.assess.inlier}
          </span>
          <span class="small quiet">
            {t.assess.against(
              `${about.name}@${about.version}`,
              about.statistics.shapes,
              time(about.provenance.created_at),
            )}
          </span>
        </div>
        {remark && <p class="only-print">{remark}</p>}
        <div class="no-print">
          <Field label={`${t.assess.remark}. ${t.assess.remarkHint}`}>
            <input value={remark} maxLength={300} onInput={(event) => onRemark(event.currentTarget.value)} />
          </Field>
        </div>
      </header>
      <div class="columns">
        <div class="stack" style={{ gap: "22px" }}>
          <div class="card">
            <h2>{t.assess.where}</h2>
            {hasMesh(about.representation) ? (
              <Residual about={about} dictionary={dictionary} body={body} name={name} />
            ) : (
              <Picture
                source={{ method: "POST", path: `/v1/dictionaries/${encodeURIComponent(dictionary)}/assess`, body }}
                name={`${name}-report`}
                alt={t.assess.whereAlt(name)}
                width={420}
                caption={t.assess.whereCaption}
                keys={[
                  [
                    [shown() === "dark" ? "#41434a" : "#dddddd", colour("effect")],
                    t.assess.whereKey(
                      `${number(Math.max(...first.residual), 3)}${about.length_unit ? `\u00a0${about.length_unit}` : ""}`,
                    ),
                  ],
                  [colour("ink"), t.assess.reconstruction],
                ]}
              />
            )}
          </div>
          {found && <Code about={about} code={code} />}
        </div>
        <div class="stack" style={{ gap: "22px" }}>
          {found && (
            <section class="card">
              <h2>{t.report.class}</h2>
              <div class="bars">
                {found.ranking.map((one) => (
                  <div
                    class="bar"
                    style={{ gridTemplateColumns: "minmax(5em, auto) minmax(0, 1fr) 4em" }}
                    key={one.label}
                  >
                    <span>{one.label}</span>
                    <span class="track">
                      <i style={{ width: `${100 * (one.confidence ?? 0)}%` }} />
                    </span>
                    <span class="number">{percent(one.confidence, 0)}</span>
                  </div>
                ))}
              </div>
              {first.verdict !== "accepted" && <p class="note warn">{t.assess.rejected(first.verdict)}</p>}
              {about.classifier?.validation && (
                <p class="small quiet">
                  {t.assess.accuracy(
                    percent(about.classifier.validation.accuracy.value),
                    percent(about.classifier.validation.majority),
                  )}
                </p>
              )}
            </section>
          )}
          <section class="card">
            <h2>{t.assess.novelty}</h2>
            <dl class="facts">
              {typeof novelty.t_squared_rank === "number" && (
                <>
                  <dt>{t.assess.within}</dt>
                  <dd>{rank(novelty.t_squared_rank)}</dd>
                </>
              )}
              {typeof novelty.squared_prediction_error_rank === "number" && (
                <>
                  <dt>{t.assess.beyond}</dt>
                  <dd>{rank(novelty.squared_prediction_error_rank)}</dd>
                </>
              )}
              <dt>{t.assess.error}</dt>
              <dd>{percent(Math.sqrt(first.relative_error), 1)}</dd>
            </dl>
            <p class="small quiet">{t.assess.noveltyHint}</p>
          </section>
          {planar && matrix && (
            <section class="card">
              <h2>{t.assess.pose}</h2>
              <dl class="facts">
                <dt>{t.assess.scale}</dt>
                <dd>
                  {number(
                    1 / Math.sqrt(Math.abs(matrix[0]![0]! * matrix[1]![1]! - matrix[0]![1]! * matrix[1]![0]!)),
                    4,
                  )}
                  {about.length_unit ? `\u00a0${about.length_unit}` : ""}
                </dd>
                <dt>{t.assess.angle}</dt>
                <dd>{number((Math.atan2(matrix[1]![0]!, matrix[0]![0]!) * 180) / Math.PI, 3)}°</dd>
              </dl>
            </section>
          )}
          {!found && <Code about={about} code={code} />}
        </div>
      </div>
      {canComplete(about) && (
        <Partial key={JSON.stringify(body)} about={about} dictionary={dictionary} body={body} name={name} />
      )}
      <section class="card">
        <h2>{t.assess.nearest}</h2>
        <Fault error={search.error} />
        {inPlane(about.representation) && neighbours && "neighbours" in neighbours && (
          <Picture
            source={{ method: "POST", path: `/v1/cohorts/${encodeURIComponent(cohort)}/search`, body: near }}
            name={`${name}-nearest`}
            alt={t.shape.neighboursAlt}
          />
        )}
        {neighbours && "neighbours" in neighbours && (
          <p class="small">
            {neighbours.neighbours.map((one, at) => (
              <>
                {at > 0 && " · "}
                <a
                  href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(one.external_id ?? one.id)}`}
                >
                  {one.external_id ?? one.id}
                </a>
                {one.label ? ` (${one.label})` : ""}
              </>
            ))}
          </p>
        )}
      </section>
      <p class="only-print small">{t.assess.printed(time(new Date().toISOString()))}</p>
    </article>
  );
}
