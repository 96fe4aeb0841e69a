/** A shape by a part of its name: the names of a cohort are read once, and looked through in the browser. */
import { useState } from "preact/hooks";
import { get, type Schemas } from "../api/client";
import { useLoaded } from "../hooks";
import { navigate } from "../router";
import { count, t } from "../strings";
import { Fault } from "./basic";

/** Names that are listed, and names that a filter may have. */
const LISTED = 12,
  FILTERED = 100;

export function Find({ cohort, revision }: { cohort: string; revision: number }) {
  const [text, setText] = useState("");
  const base = `/app/cohorts/${encodeURIComponent(cohort)}`;
  const asked = text.trim().toLowerCase();
  const names = useLoaded(asked ? `${cohort} ${revision}` : null, async (signal) => {
    const table = (await get("/v1/cohorts/{cohort}/table", {
      path: { cohort },
      query: { columns: "id,external_id" },
      signal,
    })) as Schemas["TableAnswer"];
    const [ids, external] = table.columns.map((one) => one.values as (string | null)[]);
    return ids!.map((id, row) => external![row] ?? id!);
  });
  const found = asked && names.data ? names.data.filter((name) => name.toLowerCase().includes(asked)) : [];
  const filter = new URLSearchParams(found.slice(0, FILTERED).map((name) => ["external_id", name]));
  return (
    <search class="find no-print">
      <input
        type="search"
        aria-label={t.find.label}
        placeholder={t.find.label}
        value={text}
        onInput={(event) => setText(event.currentTarget.value)}
        onKeyDown={(event) => {
          if (event.key === "Escape") setText("");
          if (event.key === "Enter" && found.length) navigate(`${base}/shapes/${encodeURIComponent(found[0]!)}`);
        }}
      />
      {asked && (
        <div class="found card" role="group" aria-label={t.find.label}>
          <Fault error={names.error} />
          {names.data && (
            <p class="small quiet" aria-live="polite">
              {t.find.found(count(found.length))}
            </p>
          )}
          {found.slice(0, LISTED).map((name) => (
            <a key={name} href={`${base}/shapes/${encodeURIComponent(name)}`} onClick={() => setText("")}>
              {name}
            </a>
          ))}
          {found.length > 1 && found.length <= FILTERED && (
            <a class="button" href={`${base}?${filter}`} onClick={() => setText("")}>
              {t.find.filter(count(found.length))}
            </a>
          )}
        </div>
      )}
    </search>
  );
}
