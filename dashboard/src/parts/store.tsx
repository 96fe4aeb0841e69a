/** Contours that were found in an image, on their way into a cohort: one that there is, or a new one. */
import { useState } from "preact/hooks";
import { get, pages, post, remove, type Schemas } from "../api/client";
import { useAction, useLoaded } from "../hooks";
import { curve } from "../shape/snake";
import { factor, scaled } from "../shape/units";
import { count, t } from "../strings";
import { announce, Dialog, Fault, Field, Loading, Select } from "./basic";
import { freeName } from "./correspond";

export interface Shaped {
  external_id: string;
  points: number[][];
}

const NEW = "+";

export function StoreShapes({
  shapes,
  unit,
  file,
  points,
  onClose,
}: {
  shapes: Shaped[];
  unit: string;
  file: string;
  points: number;
  onClose: () => void;
}) {
  const list = useLoaded("contour cohorts", async (signal) =>
    (await pages((cursor) => get("/v1/cohorts", { query: { cursor, limit: 1000 }, signal }))).filter(
      ({ representation }) => representation.kind === "closed_curve" && representation.dimension === 2,
    ),
  );
  const [chosen, setChosen] = useState("");
  const [name, setName] = useState(file.replace(/[^\w.-]+/g, "-"));
  const [label, setLabel] = useState("");
  const cohort = chosen || list.data?.find((one) => one.name !== "example-cells")?.name || NEW;
  const target = list.data?.find((one) => one.name === cohort);
  const by = factor(unit, target?.length_unit);
  const action = useAction(async () => {
    const into = cohort === NEW ? await freeName(name.trim()) : cohort;
    if (cohort === NEW)
      await post("/v1/cohorts", {
        body: {
          name: into,
          representation: curve(Math.max(points, 32)),
          correspondence: "cyclic",
          length_unit: unit === "voxel" ? "pixel" : unit,
        },
      });
    const { added } = await post("/v1/cohorts/{cohort}/shapes", {
      path: { cohort: into },
      body: {
        shapes: shapes.map(({ external_id, points }) => ({
          external_id,
          points: scaled(points, by ?? 1),
          labels: { file },
          ...(label.trim() ? { label: label.trim() } : {}),
        })) as Schemas["ShapeInput"][],
      },
    });
    onClose();
    announce({
      text: t.store.done(count(added), into),
      undo: async () => {
        await remove("/v1/cohorts/{cohort}/shapes", {
          path: { cohort: into },
          query: new URLSearchParams(shapes.map((shape) => ["external_id", shape.external_id])),
        });
      },
    });
  });
  return (
    <Dialog title={t.store.title(count(shapes.length))} onClose={onClose}>
      <form
        class="stack"
        onSubmit={(event) => {
          event.preventDefault();
          action.run();
        }}
      >
        <Loading on={list.loading} />
        <Select
          label={t.words.cohort}
          value={cohort}
          options={[
            ...(list.data ?? []).map((one): [string, string] => [one.name, `${one.name} (${count(one.shape_count)})`]),
            [NEW, t.cohorts.create],
          ]}
          onChange={setChosen}
        />
        {cohort === NEW && (
          <Field label={t.propose.name}>
            <input required maxLength={100} value={name} onInput={(event) => setName(event.currentTarget.value)} />
          </Field>
        )}
        <Field label={t.upload.labelAll}>
          <input value={label} onInput={(event) => setLabel(event.currentTarget.value)} />
        </Field>
        {by === null && target && <p class="note warn">{t.assess.otherUnit(unit, target.length_unit!)}</p>}
        <Fault error={action.error ?? list.error} />
        <div class="row">
          <button class="main" disabled={action.busy || by === null || list.loading}>
            {t.upload.store}
          </button>
          <button type="button" onClick={onClose}>
            {t.act.cancel}
          </button>
        </div>
      </form>
    </Dialog>
  );
}
