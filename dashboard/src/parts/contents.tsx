/** What is in a file, and what would be left out of it, as the service says. */

import type { Schemas } from "../api/client";
import type { Format, Found } from "../formats/file";
import { count, number, percent, t } from "../strings";
import { Sentence } from "./basic";

type Group = Schemas["FileGroup"];

/** Least and largest number, or the one number. */
const range = ([least, most]: number[]): string =>
  least === most ? count(least!) : `${count(least!)} – ${count(most!)}`;

/** Number of names that are listed. */
const NAMES = 8;

/** A fact of a file; things with names, such as regions, by their names. */
function textOf(value: unknown): string {
  if (typeof value === "number") return number(value);
  const names = Array.isArray(value) ? value.map((one) => (one as { name?: unknown } | null)?.name) : [];
  if (names.length && names.every((name) => typeof name === "string")) return listed(names, names.length);
  return typeof value === "string" ? value : JSON.stringify(value);
}

function listed(names: string[], all: number): string {
  const rest = all - Math.min(names.length, NAMES);
  return names.slice(0, NAMES).join(", ") + (rest > 0 ? ` ${t.fault.more(rest)}` : "");
}

export function Contents({ found, formats = [] }: { found: Found; formats?: Format[] }) {
  const unit = typeof found.properties.unit === "string" ? found.properties.unit : "";
  const facts = Object.entries(found.properties).filter(([name]) => name !== "unit" || !unit);
  const labels = Object.entries(found.labels),
    attributes = Object.keys(found.attributes);
  return (
    <div class="stack">
      <dl class="facts">
        <dt>{t.file.format}</dt>
        <dd>{formats.find((one) => one.id === found.format)?.name ?? found.format}</dd>
        {found.groups.map((group) => (
          <Shapes key={`${group.kind} ${group.dimension}`} group={group} unit={unit} />
        ))}
        <dt>{t.words.unit}</dt>
        <dd>{unit || t.file.noUnit}</dd>
        {facts.map(([name, value]) => (
          <>
            <dt>{name}</dt>
            <dd>{textOf(value)}</dd>
          </>
        ))}
        {labels.length > 0 && (
          <>
            <dt>{t.file.labels}</dt>
            <dd>
              {listed(
                labels.map(([name, some]) => `${name} (${count(some)})`),
                labels.length,
              )}
            </dd>
          </>
        )}
        {attributes.length > 0 && (
          <>
            <dt>{t.file.attributes}</dt>
            <dd>{listed(attributes, attributes.length)}</dd>
          </>
        )}
      </dl>
      {found.proposals?.map((one) => (
        <Proposed key={`${one.kind} ${one.representation?.kind}`} one={one} />
      ))}
      {found.records === 0 && <p class="note warn">{t.file.none}</p>}
      <Remarks file={found} title={t.file.leftOut} />
    </div>
  );
}

/** Control points that represent the shapes, with what they leave. */
function Proposed({ one }: { one: NonNullable<Found["proposals"]>[number] }) {
  const { representation, relative_residual: left } = one;
  const points =
    representation && "control_points" in representation
      ? [representation.control_points].flat().join(" × ")
      : representation && "intervals" in representation
        ? String(representation.intervals)
        : "";
  return representation && typeof left === "number" ? (
    <p class="small quiet">{t.file.proposed(points, percent(left, 2))}</p>
  ) : null;
}

function Shapes({ group, unit }: { group: Group; unit: string }) {
  const one = t.file.kinds[group.kind] ?? group.kind;
  const more = [
    group.kind === "curve" && t.file.closed(count(group.closed), count(group.records)),
    group.holes > 0 && t.file.holes(count(group.holes)),
    group.kind === "mesh" && t.file.faces(range(group.faces)),
    group.incomplete > 0 && t.file.incomplete(count(group.incomplete)),
  ].filter(Boolean);
  return (
    <>
      <dt>{one}</dt>
      <dd>
        {count(group.records)} · {group.dimension === 2 ? t.cohorts.plane : t.cohorts.space} ·{" "}
        {group.kind === "fourier" ? t.file.harmonics(range(group.points)) : t.file.points(range(group.points))}
        {more.map((text) => ` · ${text}`)}
        {group.names.length > 0 && (
          <>
            <br />
            <span class="small quiet">{listed(group.names, group.records)}</span>
          </>
        )}
      </dd>
      {group.lower.length > 0 && (
        <>
          <dt>{t.file.extent}</dt>
          <dd>
            {group.lower.map((low, axis) => `${"xyz"[axis]} ${number(low)} – ${number(group.upper[axis])}`).join(", ")}
            {unit && `\u00a0${unit}`}
          </dd>
        </>
      )}
    </>
  );
}

/** What a file holds that is no shape, with the place of the first of each kind, and the warnings of its reader. */
export function Remarks({ file, title }: { file: Schemas["FileSummary"]; title: string }) {
  return (
    <>
      {file.left_out.length > 0 && (
        <div class="note warn">
          <strong>{title}</strong>
          <ul>
            {file.left_out.map((one) => (
              <li key={one.what}>
                {/* A number after the word needs no singular. */}
                <Sentence text={one.what} />: {count(one.count)}
                {one.first && (
                  <>
                    {" "}
                    <code>{one.first}</code>
                  </>
                )}
                {one.names.length > 0 && (
                  <>
                    {" · "}
                    <Names of={one} />
                  </>
                )}
              </li>
            ))}
          </ul>
        </div>
      )}
      {file.warnings.length > 0 && (
        <div class="note warn">
          <strong>{t.file.warnings}</strong>
          <ul>
            {file.warnings.map((one) => (
              <li key={one}>
                <Sentence text={one} />
              </li>
            ))}
          </ul>
        </div>
      )}
    </>
  );
}

/** Names of what was left out; of broken shapes these are sentences that say why. */
function Names({ of: { what, names, count: all } }: { of: Schemas["FileSummary"]["left_out"][number] }) {
  if (what !== "broken shapes") return listed(names, all);
  return (
    <>
      {names.slice(0, NAMES).map((one, at) => (
        <>
          {at > 0 && "; "}
          <Sentence key={at} text={one} />
        </>
      ))}
      {all > NAMES && ` ${t.fault.more(all - NAMES)}`}
    </>
  );
}

/** The formats that the service reads, with the endings of their files. */
export function Formats({ formats }: { formats: Format[] }) {
  return (
    <details class="small no-print">
      <summary>{t.file.which(formats.length)}</summary>
      <ul class="formats">
        {formats.map((one) => (
          <li key={one.id}>
            {one.name} <code>{one.extensions.map((ending) => `.${ending}`).join(" ")}</code>
          </li>
        ))}
      </ul>
      <p class="quiet">{t.file.own}</p>
    </details>
  );
}
