/** Attributes of many shapes at once: groups by hand, for a selection or all that pass a filter, with the way back. */
import { useState } from "preact/hooks";
import { patch, type Schemas } from "../api/client";
import { attributesNow, restoreAttributes } from "../formats/send";
import { useAction } from "../hooks";
import { count, entered, t } from "../strings";
import { announce, Fault, Field } from "./basic";

/** Which shapes are changed: some by their ids, or those of a filter; none of both is all. */
export interface Target {
  ids?: string[];
  filter?: Schemas["ShapeFilter"];
  size: number;
}

/** The value that was written: a number where it is one, null where it is empty. */
const written = (text: string): string | number | null => {
  const trimmed = text.trim();
  return trimmed === "" ? null : (entered(trimmed) ?? trimmed);
};

/** The same changes of all of them; the answer brings back what was there. */
export async function labelled(
  cohort: string,
  { ids, filter }: Target,
  name: string,
  value: string | number | null,
): Promise<{ updated: number; undo: () => Promise<void> }> {
  const before = await attributesNow(cohort, [name], { ids, filter });
  const changes = name.startsWith("labels.")
    ? { labels: { [name.slice(7)]: value } }
    : { [name]: value === null ? null : String(value) };
  const { updated } = await patch("/v1/cohorts/{cohort}/shapes", {
    path: { cohort },
    body: { ...(ids ? { ids } : filter ? { filter } : { all: true }), changes } as Schemas["ShapesPatch"],
  });
  return { updated, undo: () => restoreAttributes(cohort, before) };
}

export function Bulk({
  cohort,
  target,
  names,
  onDone,
}: {
  cohort: string;
  target: Target;
  /** Attributes that the cohort has, as proposals. */
  names: string[];
  onDone?: () => void;
}) {
  const [name, setName] = useState("label");
  const [value, setValue] = useState("");
  const [list] = useState(() => `names-${Math.random().toString(36).slice(2)}`);
  const field = ["label", "subject"].includes(name.trim())
    ? name.trim()
    : `labels.${name.trim().replace(/^labels\./, "")}`;
  const action = useAction(async () => {
    const { updated, undo } = await labelled(cohort, target, field, written(value));
    announce({ text: t.bulk.done(count(updated)), undo: undo });
    onDone?.();
  });
  return (
    <form
      class="bulk"
      aria-label={t.bulk.title(count(target.size))}
      onSubmit={(event) => {
        event.preventDefault();
        action.run();
      }}
    >
      <h3>{t.bulk.title(count(target.size))}</h3>
      <div class="row" style={{ alignItems: "end" }}>
        <Field label={t.bulk.attribute}>
          <input
            required
            maxLength={100}
            list={list}
            value={name}
            onInput={(event) => setName(event.currentTarget.value)}
          />
        </Field>
        <datalist id={list}>
          {[...new Set(["label", "subject", ...names])].map((one) => (
            <option key={one} value={one} />
          ))}
        </datalist>
        <Field label={t.bulk.value}>
          <input value={value} placeholder={t.bulk.empty} onInput={(event) => setValue(event.currentTarget.value)} />
        </Field>
        <button class="main" disabled={action.busy || !name.trim() || !target.size}>
          {t.bulk.apply}
        </button>
      </div>
      <Fault error={action.error} />
    </form>
  );
}
