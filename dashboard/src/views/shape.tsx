/** One shape: its picture, what is known of it, corrections, and the shapes most like it. */
import { useMay } from "../api/caller";
import { get, patch, post, remove, type Schemas } from "../api/client";
import { useAction, useLoaded } from "../hooks";
import { announce, Download, Fault, Field, Loading, Page, Picture, WITH_NUMBERS } from "../parts/basic";
import { Figure } from "../parts/figure";
import { Solid } from "../parts/solid";
import { canWarp, type Form, Warp } from "../parts/warp";
import { navigate, useSetting } from "../router";
import { inPlane, isDots, type Points, upright } from "../shape/points";
import { number, t, time, unit } from "../strings";
import { words } from "../strings/warp";

export function ShapeView({ cohort, shape }: { cohort: string; shape: string }) {
  const path = { cohort, shape };
  const writes = useMay("writer");
  const loaded = useLoaded(`${cohort}/${shape}`, async (signal) => {
    const [about, found] = await Promise.all([
      get("/v1/cohorts/{cohort}", { path: { cohort }, signal }),
      get("/v1/cohorts/{cohort}/shapes/{shape}", { path, signal }),
    ]);
    return { about, found };
  });
  const base = `/app/cohorts/${encodeURIComponent(cohort)}`;
  const source = { path: `/v1/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(shape)}` };
  const data = loaded.data;
  const around = useLoaded(`${cohort} ${shape} around`, async (signal) => {
    const [table, models] = await Promise.all([
      get("/v1/cohorts/{cohort}/table", { path: { cohort }, query: { columns: "id,external_id" }, signal }),
      get("/v1/dictionaries", { query: { cohort, limit: 1000 }, signal }),
    ]);
    const [ids, external] = (table as Schemas["TableAnswer"]).columns.map((one) => one.values as (string | null)[]);
    const names = ids!.map((id, row) => external![row] ?? id!);
    const at = names.findIndex((name, row) => name === shape || ids![row] === shape);
    return { before: names[at - 1], after: at < 0 ? undefined : names[at + 1], model: models.items.at(-1) };
  });
  const to = (name: string) => `${base}/shapes/${encodeURIComponent(name)}`;
  const drop = useAction(async () => {
    const before = data!.found;
    await remove("/v1/cohorts/{cohort}/shapes/{shape}", { path });
    navigate(base);
    announce({
      text: t.shape.deleted(shape),
      undo: async () => {
        const { id: _, measures: __, created_at: ___, ...again } = before;
        await post("/v1/cohorts/{cohort}/shapes", {
          path: { cohort },
          body: { shapes: [again as Schemas["ShapeInput"]] },
        });
        navigate(`${base}/shapes/${encodeURIComponent(shape)}`);
      },
    });
  });
  return (
    <Page
      title={shape}
      crumbs={[
        [t.menu.cohorts, "/app/cohorts"],
        [cohort, base],
      ]}
      actions={
        <>
          {around.data?.before && (
            <a class="button" href={to(around.data.before)} aria-label={t.shape.before(around.data.before)}>
              ←
            </a>
          )}
          {around.data?.after && (
            <a class="button" href={to(around.data.after)} aria-label={t.shape.after(around.data.after)}>
              →
            </a>
          )}
          {around.data?.model && (
            <a
              class="button main"
              href={`/app/assess?${new URLSearchParams({
                dictionary: `${around.data.model.name}@${around.data.model.version}`,
                cohort,
                shape,
              })}`}
            >
              {t.shape.assess}
            </a>
          )}
          {data && writes && (
            <button class="bad" disabled={drop.busy} onClick={() => drop.run()}>
              {t.act.remove}
            </button>
          )}
        </>
      }
    >
      <Fault error={loaded.error ?? drop.error} />
      {!data && !loaded.error && <Loading on />}
      {data && (
        <div class="aside right">
          <div class="stack" style={{ gap: "22px" }}>
            <div class="card">
              {isDots(data.about.representation) ? (
                <figure>
                  <Figure
                    describe={t.shape.alt(shape)}
                    name={shape}
                    links={cohort}
                    sets={[
                      {
                        name: shape,
                        points: data.found.control_points as Points,
                        dots: true,
                        colour: "var(--ink)",
                      },
                    ]}
                  />
                  <figcaption>{t.shape.caption}</figcaption>
                </figure>
              ) : inPlane(data.about.representation) ? (
                <Picture source={source} name={shape} alt={t.shape.alt(shape)} width={560} caption={t.shape.caption} />
              ) : (
                <>
                  <Solid source={source} describe={t.shape.alt(shape)} />
                  <Download
                    source={source}
                    name={shape}
                    formats={[
                      ...WITH_NUMBERS,
                      ["OBJ", "obj", "model/obj"],
                      ["PLY", "ply", "application/ply"],
                      ["STL", "stl", "model/stl"],
                      ["glTF", "gltf", "model/gltf-binary"],
                    ]}
                  />
                </>
              )}
            </div>
            <Neighbours cohort={cohort} about={data.about} shape={data.found} />
            {canWarp(data.about.representation) && (
              <Deformation key={data.found.id} cohort={cohort} about={data.about} shape={data.found} />
            )}
          </div>
          <div class="stack" style={{ gap: "22px" }}>
            <div class="card">
              <h2>{t.shape.about}</h2>
              <dl class="facts">
                {Object.entries(data.found.measures ?? {}).map(([name, value]) => (
                  <>
                    <dt>{(t.attributes as Record<string, string>)[`measures.${name}`] ?? name}</dt>
                    <dd>
                      {typeof value === "boolean"
                        ? value
                          ? t.words.yes
                          : t.words.no
                        : `${number(value as number)}\u00a0${unit(name, data.about.length_unit)}`}
                    </dd>
                  </>
                ))}
                <dt>{t.words.created}</dt>
                <dd>{time(data.found.created_at)}</dd>
                <dt>{t.words.weight}</dt>
                <dd>{number(data.found.weight)}</dd>
                <dt>{t.words.id}</dt>
                <dd>
                  <code>{data.found.id}</code>
                </dd>
              </dl>
            </div>
            {writes && (
              <Correct
                key={JSON.stringify(data.found.labels) + data.found.label + data.found.subject}
                path={path}
                shape={data.found}
                onDone={loaded.reload}
              />
            )}
          </div>
        </div>
      )}
    </Page>
  );
}

function Correct({
  path,
  shape,
  onDone,
}: {
  path: { cohort: string; shape: string };
  shape: Schemas["StoredShape"];
  onDone: () => void;
}) {
  const attributes = Object.entries(shape.labels ?? {});
  const change = async (body: Schemas["ShapePatch"]) => {
    await patch("/v1/cohorts/{cohort}/shapes/{shape}", { path, body });
    onDone();
  };
  const action = useAction(async (form: FormData) => {
    const text = (name: string) => String(form.get(name) ?? "").trim() || null;
    const labels = Object.fromEntries(
      attributes
        .map(([name, old]) => {
          const value = text(`labels.${name}`);
          return [
            name,
            typeof old === "number" && value !== null && Number.isFinite(Number(value)) ? Number(value) : value,
          ];
        })
        .filter(([, value]) => value !== null),
    ) as Schemas["Attributes"];
    const before = { label: shape.label, subject: shape.subject, labels: shape.labels } as Schemas["ShapePatch"];
    await change({ label: text("label"), subject: text("subject"), labels });
    announce({ text: t.act.saved, undo: () => change(before) });
  });
  return (
    <form
      class="card"
      onSubmit={(event) => {
        event.preventDefault();
        action.run(new FormData(event.currentTarget));
      }}
    >
      <h2>{t.shape.correct}</h2>
      <Field label={t.attributes.label}>
        <input name="label" defaultValue={shape.label ?? ""} />
      </Field>
      <Field label={t.attributes.subject}>
        <input name="subject" defaultValue={shape.subject ?? ""} />
      </Field>
      {attributes.map(([name, value]) => (
        <Field key={name} label={name}>
          <input name={`labels.${name}`} defaultValue={String(value)} />
        </Field>
      ))}
      <Fault error={action.error} />
      <div class="row">
        <button class="main" disabled={action.busy}>
          {t.act.save}
        </button>
      </div>
    </form>
  );
}

function Neighbours({
  cohort,
  about,
  shape,
}: {
  cohort: string;
  about: Schemas["CohortOutput"];
  shape: Schemas["StoredShape"];
}) {
  const body = { ids: [shape.external_id ?? shape.id], neighbours: 8 };
  const found = useLoaded(`${cohort} ${shape.id}`, (signal) =>
    post("/v1/cohorts/{cohort}/search", { path: { cohort }, body, signal }),
  );
  const first = found.data?.results[0];
  const list = first && "neighbours" in first ? first.neighbours.filter((one) => one.id !== shape.id) : [];
  return (
    <section class="card">
      <h2>{t.shape.neighbours}</h2>
      <Fault error={found.error} />
      {about.shape_count > 1 && inPlane(about.representation) && (
        <Picture
          source={{ method: "POST", path: `/v1/cohorts/${encodeURIComponent(cohort)}/search`, body }}
          name={`${shape.external_id ?? shape.id}-neighbours`}
          alt={t.shape.neighboursAlt}
        />
      )}
      {!inPlane(about.representation) && list.some((one) => one.external_id) && (
        <Picture
          source={{
            path: `/v1/cohorts/${encodeURIComponent(cohort)}/sheet`,
            query: new URLSearchParams([
              ...list.flatMap((one): [string, string][] => (one.external_id ? [["external_id", one.external_id]] : [])),
              ["columns", "4"],
              ["size", "150"],
            ]),
            ownWidth: true,
          }}
          name={`${shape.external_id ?? shape.id}-neighbours`}
          alt={t.shape.neighboursAlt}
        />
      )}
      {list.length > 0 && (
        <table>
          <thead>
            <tr>
              <th scope="col">{t.words.shape}</th>
              <th scope="col">{t.attributes.label}</th>
              <th scope="col" class="number">
                {t.words.distance}
              </th>
            </tr>
          </thead>
          <tbody>
            {list.map((one) => (
              <tr key={one.id}>
                <td>
                  <a
                    href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(one.external_id ?? one.id)}`}
                  >
                    {one.external_id ?? one.id}
                  </a>
                </td>
                <td>{one.label ?? "–"}</td>
                <td class="number">{number(one.distance)}</td>
              </tr>
            ))}
          </tbody>
        </table>
      )}
      <p class="small quiet">{t.shape.distanceHint}</p>
    </section>
  );
}

/** Weight of the mean among the shapes that are aligned to it: their starts are those that fit the mean. */
const WEIGHT_OF_MEAN = 1000;

/** Shapes with the start points that fit the first one, the mean, and in its pose. */
async function matched(about: Schemas["CohortOutput"], forms: Form[], signal: AbortSignal): Promise<Form[]> {
  const { representation, correspondence, direction, mirror } = about;
  const answer = await post("/v1/align", {
    body: {
      representation,
      correspondence,
      direction,
      mirror,
      transformation: "similarity",
      shapes: forms.map(({ points }, at) => ({ control_points: points, weight: at === 0 ? WEIGHT_OF_MEAN : 1 })),
    } as Schemas["StatisticsRequest"],
    signal,
  });
  const aligned = answer.aligned.map((one) => one.control_points as Points);
  const turn = upright(aligned[0]!, "similarity");
  return forms.map((form, at) => ({ ...form, points: turn(aligned[at]!) }));
}

/** What takes the mean, or a similar shape, to this one. */
function Deformation({
  cohort,
  about,
  shape,
}: {
  cohort: string;
  about: Schemas["CohortOutput"];
  shape: Schemas["StoredShape"];
}) {
  const own = shape.external_id ?? shape.id;
  const [view] = useSetting("warp", "");
  const forms = useLoaded(view ? `${cohort} ${about.revision} ${shape.id}` : null, async (signal): Promise<Form[]> => {
    const [mean, found] = await Promise.all([
      get("/v1/cohorts/{cohort}/mean", { path: { cohort }, query: { transformation: "similarity" }, signal }),
      post("/v1/cohorts/{cohort}/search", { path: { cohort }, body: { ids: [own], neighbours: 8 }, signal }),
    ]);
    const first = found.results[0];
    const near = (first && "neighbours" in first ? first.neighbours : []).flatMap((one) =>
      one.external_id && one.id !== shape.id ? [one.external_id] : [],
    );
    const listed = near.length
      ? await get("/v1/cohorts/{cohort}/shapes", {
          path: { cohort },
          query: new URLSearchParams([
            ...near.map((id): [string, string] => ["external_id", id]),
            ["fields", "external_id,control_points"],
          ]),
          signal,
        })
      : { items: [] };
    const control = mean.mean.control_points as Points;
    const all: Form[] = [
      // No external id has a space before it.
      { id: " mean", name: words().mean, points: upright(control, "similarity")(control) },
      { id: own, name: own, points: shape.control_points as Points },
      ...listed.items.map((one) => ({
        id: one.external_id!,
        name: one.external_id!,
        points: one.control_points as Points,
      })),
    ];
    return about.correspondence === "cyclic" ? matched(about, all, signal) : all;
  });
  return (
    <>
      <Fault error={forms.error} />
      {view && !forms.data && !forms.error ? (
        <Loading on />
      ) : (
        <Warp about={about} forms={forms.data ?? []} superimpose />
      )}
    </>
  );
}
