/** One shape: its picture, what is known of it, corrections, and the shapes most like it. */
import { get, patch, post, remove, type Schemas } from "../api/client";
import { useAction, useLoaded } from "../hooks";
import { announce, Download, Fault, Field, Loading, Page, Picture, WITH_NUMBERS } from "../parts/basic";
import { Solid } from "../parts/solid";
import { navigate } from "../router";
import { inPlane } from "../shape/points";
import { number, t, time, unit } from "../strings";

export function ShapeView({ cohort, shape }: { cohort: string; shape: string }) {
  const path = { cohort, shape };
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
        data && (
          <button class="bad" disabled={drop.busy} onClick={() => drop.run()}>
            {t.act.remove}
          </button>
        )
      }
    >
      <Fault error={loaded.error ?? drop.error} />
      {!data && !loaded.error && <Loading on />}
      {data && (
        <div class="aside right">
          <div class="stack" style={{ gap: "22px" }}>
            <div class="card">
              {inPlane(data.about.representation) || data.about.representation.kind === "landmarks" ? (
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
                        : `${number(value as number)} ${unit(name, data.about.length_unit)}`}
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
            <Correct
              key={JSON.stringify(data.found.labels) + data.found.label + data.found.subject}
              path={path}
              shape={data.found}
              onDone={loaded.reload}
            />
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
