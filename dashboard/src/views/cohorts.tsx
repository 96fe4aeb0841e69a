/** All cohorts, and a new one. */
import { useState } from "preact/hooks";
import { useMay } from "../api/caller";
import { get, pages, post, type Schemas } from "../api/client";
import { useAction, useEvents, useLoaded } from "../hooks";
import { Dialog, Empty, Fault, Field, Loading, Page, Select } from "../parts/basic";
import { Drop } from "../parts/drop";
import { navigate, useSetting } from "../router";
import { count, t, time, UNITS } from "../strings";
import { Proposal } from "./proposal";

export function describe(representation: Schemas["Representation"]): string {
  const kind = t.kinds[representation.kind];
  switch (representation.kind) {
    case "landmarks":
      return `${kind}, ${representation.points} × ${representation.dimension}`;
    case "open_curve":
      return `${kind}, ${t.kinds.intervals(representation.intervals)}`;
    case "closed_curve":
      return `${kind}, ${t.kinds.points(representation.control_points)}`;
    case "surface":
      return `${kind} (${t.topologies[representation.topology]}), ${representation.control_points.join(" × ")}`;
    default:
      return kind;
  }
}

export function Cohorts() {
  const list = useLoaded("cohorts", (signal) =>
    pages((cursor) => get("/v1/cohorts", { query: { cursor, limit: 1000 }, signal })),
  );
  const writes = useMay("writer");
  const [create, setCreate] = useSetting("new", "");
  const [files, setFiles] = useState<File[]>([]);
  useEvents(
    [
      "cohort_created",
      "cohort_updated",
      "cohort_deleted",
      "cohort_restored",
      "shapes_added",
      "shape_deleted",
      "shapes_deleted",
    ],
    list.reload,
  );
  return (
    <Page
      title={t.menu.cohorts}
      lead={t.cohorts.lead}
      actions={
        writes && (
          <button class="main" onClick={() => setCreate("yes")}>
            {t.cohorts.create}
          </button>
        )
      }
    >
      {!writes ? null : files.length > 0 ? (
        <Proposal
          key={files.map((file) => `${file.name} ${file.lastModified}`).join()}
          files={files}
          onClose={() => setFiles([])}
        />
      ) : (
        <Drop title={t.propose.drop} hint={t.propose.hint} multiple onFiles={setFiles} />
      )}
      <Loading on={list.loading && !list.data} />
      <Fault error={list.error} retry={list.reload} />
      {list.data?.length === 0 && files.length === 0 && (
        <Empty>
          <p>{t.cohorts.none}</p>
        </Empty>
      )}
      {list.data && list.data.length > 0 && (
        <div class="card scroll" tabIndex={0}>
          <table>
            <caption class="hidden">{t.menu.cohorts}</caption>
            <thead>
              <tr>
                <th scope="col">{t.words.name}</th>
                <th scope="col">{t.words.kind}</th>
                <th scope="col" class="number">
                  {t.words.shapes}
                </th>
                <th scope="col" class="number">
                  {t.words.revision}
                </th>
                <th scope="col">{t.words.changed}</th>
              </tr>
            </thead>
            <tbody>
              {list.data.map((one) => (
                <tr key={one.id}>
                  <td>
                    <a href={`/app/cohorts/${encodeURIComponent(one.name)}`}>{one.name}</a>
                    {one.description && <div class="small quiet">{one.description}</div>}
                  </td>
                  <td class="nowrap">{describe(one.representation)}</td>
                  <td class="number">{count(one.shape_count)}</td>
                  <td class="number">{one.revision}</td>
                  <td class="nowrap">{time(one.updated_at)}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </div>
      )}
      {create && writes && <NewCohort onClose={() => setCreate("")} />}
    </Page>
  );
}

function NewCohort({ onClose }: { onClose: () => void }) {
  const [form, setForm] = useState({
    name: "",
    description: "",
    unit: "",
    kind: "closed_curve",
    size: "64",
    dimension: "2",
    correspondence: "cyclic",
    direction: "",
    mirror: "forbid",
    topology: "sphere",
  });
  const set = (change: Partial<typeof form>) => setForm({ ...form, ...change });
  const curve = form.kind === "closed_curve" || form.kind === "open_curve";
  const direction =
    form.direction ||
    (form.kind === "closed_curve" && form.dimension === "2" && form.correspondence === "cyclic" ? "either" : "given");
  const action = useAction(async () => {
    const size = Number(form.size),
      dimension = Number(form.dimension);
    const representation = (
      form.kind === "landmarks"
        ? { kind: "landmarks", dimension, points: size }
        : form.kind === "surface"
          ? { kind: "surface", topology: form.topology, control_points: [size, Math.max(2, Math.round(size / 2))] }
          : form.kind === "open_curve"
            ? { kind: "open_curve", dimension, intervals: size, generator: { name: "bspline", degree: 3 } }
            : { kind: "closed_curve", dimension, control_points: size, generator: { name: "trigonometric" } }
    ) as Schemas["Representation"];
    const correspondence = (curve ? form.correspondence : "landmarks") as Schemas["Correspondence"];
    const cohort = await post("/v1/cohorts", {
      body: {
        name: form.name.trim(),
        description: form.description || null,
        length_unit: form.unit || null,
        representation,
        correspondence,
        direction: (curve ? direction : "given") as Schemas["Direction"],
        mirror: form.mirror as Schemas["Mirror"],
      },
    });
    navigate(`/app/cohorts/${encodeURIComponent(cohort.name)}/upload`);
  });
  return (
    <Dialog title={t.cohorts.create} onClose={onClose}>
      <form
        class="stack"
        onSubmit={(event) => {
          event.preventDefault();
          action.run();
        }}
      >
        <Field label={t.words.name}>
          <input
            required
            maxLength={100}
            value={form.name}
            onInput={(event) => set({ name: event.currentTarget.value })}
          />
        </Field>
        <Field label={t.words.description}>
          <input value={form.description} onInput={(event) => set({ description: event.currentTarget.value })} />
        </Field>
        <div class="form">
          <Select
            label={t.words.kind}
            value={form.kind}
            options={(["closed_curve", "open_curve", "landmarks", "surface"] as const).map((kind) => [
              kind,
              t.kinds[kind],
            ])}
            onChange={(kind) =>
              set({
                kind,
                size: kind === "surface" ? "10" : kind === "landmarks" ? "12" : "64",
                correspondence: kind === "open_curve" ? "arc_length" : "cyclic",
              })
            }
          />
          {form.kind === "surface" ? (
            <Select
              label={t.words.topology}
              value={form.topology}
              options={Object.entries(t.topologies)}
              onChange={(topology) => set({ topology })}
            />
          ) : (
            <Select
              label={t.words.dimension}
              value={form.dimension}
              options={[
                ["2", t.cohorts.plane],
                ["3", t.cohorts.space],
              ]}
              onChange={(dimension) => set({ dimension })}
            />
          )}
          <Field label={t.cohorts.sizes[form.kind as keyof typeof t.cohorts.sizes]}>
            <input
              type="number"
              min={2}
              max={4096}
              required
              value={form.size}
              onInput={(event) => set({ size: event.currentTarget.value })}
            />
          </Field>
          <Select
            label={t.words.unit}
            value={form.unit}
            options={[["", t.upload.unsaid], ...UNITS]}
            onChange={(unit) => set({ unit })}
          />
        </div>
        {curve && (
          <Select
            label={t.cohorts.direction}
            value={direction}
            options={Object.entries(t.directions)}
            onChange={(direction) => set({ direction })}
          />
        )}
        <Select
          label={t.cohorts.mirror}
          value={form.mirror}
          options={Object.entries(t.mirrors)}
          onChange={(mirror) => set({ mirror })}
        />
        {curve && (
          <Select
            label={t.cohorts.correspondence}
            value={form.correspondence}
            options={Object.entries(t.correspondences).filter(
              ([id]) => form.kind === "closed_curve" || id !== "cyclic",
            )}
            onChange={(correspondence) => set({ correspondence })}
          />
        )}
        <Fault error={action.error} />
        <div class="row">
          <button class="main" disabled={action.busy}>
            {t.act.create}
          </button>
          <button type="button" onClick={onClose}>
            {t.act.cancel}
          </button>
        </div>
      </form>
    </Dialog>
  );
}
