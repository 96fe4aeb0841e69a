/** Shapes from files: what is in each of them and what the cohort would take of it, then its shapes into the cohort, with faults at their place in the file. */
import { useRef, useState } from "preact/hooks";
import { Said, type Schemas } from "../api/client";
import { type Format, type Found, formats, inspected, type Kept, keptBody, type Reading } from "../formats/file";
import { isPicture } from "../formats/image";
import { attributeColumns, attributesNow, restoreAttributes, sendAttributes, sendTo } from "../formats/send";
import { useAction, useLoaded } from "../hooks";
import { announce, Choice, Fault, Field, Place, Select, Sentence, Warning } from "../parts/basic";
import { Contents, Formats, Remarks } from "../parts/contents";
import { Corresponding, isSphere } from "../parts/correspond";
import { Drop } from "../parts/drop";
import { navigate } from "../router";
import { handOverImage } from "../shape/handover";
import { count, percent, t, UNITS } from "../strings";
import { CohortPage } from "./cohort";

/** A file on its way into the cohort. */
interface Dropped {
  file: File;
  state: "looking" | "ready" | "refused" | "sending" | "stored" | "failed";
  /** Its format and the options of reading that were chosen, and how its shapes become those of the cohort. */
  reading: Reading;
  placing: Reading;
  found?: Found;
  kept?: Kept;
  part: number;
  answer?: Schemas["AddAnswer"];
  error?: Error;
}

/** The parameters of reading that a format has; archives have those of the files within. */
function optionsOf(list: Format[], id: string | undefined): string[] {
  const options = list.find((one) => one.id === id)?.options ?? [];
  return options.includes("*")
    ? [...new Set(list.flatMap((one) => one.options))].filter((name) => name !== "*").sort()
    : options;
}

export function Upload({ cohort }: { cohort: string }) {
  const [files, setFiles] = useState<Dropped[]>([]);
  const [onError, setOnError] = useState("skip");
  const [busy, setBusy] = useState(false);
  const [tables, setTables] = useState<File[]>([]);
  /** What is said of all files, unless a file says something else. */
  const [common, setCommon] = useState<Reading>({});
  const [match, setMatch] = useState(true);
  const [matching, setMatching] = useState(0);
  const stop = useRef<(() => void) | undefined>(undefined);
  const known = useLoaded("formats", formats);
  /** Number of looks at each file: an answer to an earlier one says nothing of it any more. */
  const looks = useRef<number[]>([]);
  const set = (index: number, change: Partial<Dropped>) =>
    setFiles((before) => before.map((one, at) => (at === index ? { ...one, ...change } : one)));
  const look = async (
    index: number,
    { file, reading, placing }: Pick<Dropped, "file" | "reading" | "placing">,
    state: Dropped["state"] = "looking",
    on_error = onError,
    all = common,
  ) => {
    const own = (looks.current[index] = (looks.current[index] ?? 0) + 1);
    const tell = (change: Partial<Dropped>) => looks.current[index] === own && set(index, change);
    set(index, { state, reading, placing, error: undefined });
    try {
      const kept = Object.keys(reading).length ? null : await keptBody(file);
      tell(
        kept
          ? { state: "ready", kept }
          : {
              state: "ready",
              kept: undefined,
              found: await inspected(file, { cohort, on_error, ...reading, ...all, ...placing }),
            },
      );
    } catch (error) {
      if (error instanceof SyntaxError)
        return tell({ state: "refused", found: undefined, error: new Said(t.upload.syntax(error.message)) });
      // A file that this cohort refuses may be one of another unit: what is in it is told nevertheless.
      const found = await inspected(file, reading).catch(() => undefined);
      tell({ state: found ? "ready" : "refused", found, kept: undefined, error: error as Error });
    }
  };
  const again = (on_error: string, all: Reading) =>
    files.forEach(
      (one, index) =>
        ["ready", "refused"].includes(one.state) && !one.kept && void look(index, one, one.state, on_error, all),
    );
  const change = (on_error: string) => {
    setOnError(on_error);
    again(on_error, common);
  };
  const say = (all: Reading) => {
    setCommon(all);
    again(onError, all);
  };
  const take = async (dropped: File[]) => {
    const columns = await Promise.all(dropped.map(attributeColumns));
    setTables((before) => [...before, ...dropped.filter((_, at) => columns[at])]);
    const chosen = dropped.filter((_, at) => !columns[at]);
    const first = files.length;
    setFiles([
      ...files,
      ...chosen.map((file): Dropped => ({ file, state: "looking", reading: {}, placing: {}, part: 0 })),
    ]);
    for (const [offset, file] of chosen.entries()) await look(first + offset, { file, reading: {}, placing: {} });
  };
  const store = async (index: number, { file, kept, reading, placing }: Dropped) => {
    looks.current[index]! += 1;
    set(index, { state: "sending", part: 0, error: undefined });
    try {
      const sent = sendTo(cohort, file, kept, onError, { ...reading, ...common, ...placing }, (part) =>
        set(index, { part }),
      );
      stop.current = sent.stop;
      set(index, { state: "stored", answer: await sent.done });
    } catch (error) {
      set(index, { state: "failed", error: error as Error });
    } finally {
      stop.current = undefined;
    }
  };
  const storeAll = async (which: number[]) => {
    setBusy(true);
    for (const index of which) await store(index, files[index]!);
    setBusy(false);
    const meshes = which.some((index) => files[index]!.found?.groups.some((group) => group.kind === "mesh"));
    const rest = files.some((one, index) => one.state === "ready" && !which.includes(index));
    if (match && meshes && !rest) setMatching((round) => round + 1);
  };
  const ready = files.flatMap((one, index) =>
    one.state === "ready" && !one.error && one.found?.records !== 0 ? [index] : [],
  );
  return (
    <CohortPage cohort={cohort} mayBeEmpty>
      {({ representation, shape_count }) => (
        <>
          <div class="row spread">
            <p class="quiet prose">{t.upload.lead}</p>
            <Choice
              label={t.upload.onError}
              value={onError}
              options={[
                ["skip", t.upload.skip],
                ["abort", t.upload.abort],
              ]}
              onChange={change}
            />
          </div>
          <Drop title={t.upload.drop} hint={t.upload.formats} multiple onFiles={(chosen) => void take(chosen)} />
          <Fault error={known.error} retry={known.reload} />
          {known.data && <Formats formats={known.data} />}
          <Common value={common} onChange={say} />
          {isSphere(representation) && (
            <label class="check">
              <input type="checkbox" checked={match} onChange={(event) => setMatch(event.currentTarget.checked)} />
              <span>{t.correspond.afterwards}</span>
            </label>
          )}
          {tables.map((file) => (
            <Table key={`${file.name} ${file.lastModified}`} cohort={cohort} file={file} />
          ))}
          {ready.length > 1 && (
            <div class="row">
              <button class="main" disabled={busy} onClick={() => void storeAll(ready)}>
                {t.upload.storeAll(ready.length)}
              </button>
            </div>
          )}
          <div class="stack" aria-live="polite">
            {files.map((one, index) => (
              <Card
                key={index}
                one={one}
                formats={known.data ?? []}
                planar={"dimension" in representation && representation.dimension === 2}
                busy={busy}
                onStop={() => stop.current?.()}
                onStore={() => void storeAll([index])}
                onRead={(reading) => void look(index, { ...one, reading })}
                onPlace={(placing) => void look(index, { ...one, placing }, "ready")}
              />
            ))}
          </div>
          {matching > 0 && shape_count > 1 && <Corresponding key={matching} cohort={cohort} />}
          {files.some((file) => file.answer?.added) && (
            <div class="row">
              <a class="button main" href={`/app/cohorts/${encodeURIComponent(cohort)}`}>
                {t.upload.look}
              </a>
            </div>
          )}
        </>
      )}
    </CohortPage>
  );
}

function State({ state, part, answer, found, error }: Dropped) {
  if (answer)
    return (
      <span class={`tag ${answer.skipped ? "warn" : "good"}`}>
        {t.upload.added(answer.added)}
        {answer.skipped ? `, ${t.upload.skipped(answer.skipped)}` : ""}
      </span>
    );
  if (state === "ready")
    return error || found?.cohort?.accepted === false ? (
      <span class="tag bad">{t.upload.unfit}</span>
    ) : (
      <span class="tag">{t.upload.ready}</span>
    );
  if (state === "looking") return <span class="tag live">{t.upload.looking}</span>;
  return state === "sending" ? (
    <span class="tag live">{percent(part, 0)}</span>
  ) : (
    <span class="tag bad">{state === "refused" ? t.upload.refused : t.upload.failed}</span>
  );
}

/** What is said of all files: label, subject and attributes of their shapes. */
function Common({ value, onChange }: { value: Reading; onChange: (value: Reading) => void }) {
  const [rows, setRows] = useState<[string, string][]>([["", ""]]);
  const attributes = (next: [string, string][]) => {
    const kept = next.filter(([name, text], at) => name || text || at === next.length - 1);
    const last = kept[kept.length - 1];
    setRows(last && (last[0] || last[1]) ? [...kept, ["", ""]] : kept);
    const { label, subject } = value;
    onChange({
      ...(label ? { label } : {}),
      ...(subject ? { subject } : {}),
      ...Object.fromEntries(
        kept.filter(([name, text]) => name && text).map(([name, text]) => [`labels.${name}`, text]),
      ),
    });
  };
  const one = (name: "label" | "subject", label: string) => (
    <Field label={label}>
      <input
        value={value[name] ?? ""}
        onChange={(event) => onChange(given({ ...value, [name]: event.currentTarget.value.trim() }))}
      />
    </Field>
  );
  return (
    <details open={Object.keys(value).length > 0}>
      <summary>{t.upload.common}</summary>
      <div class="card">
        <p class="small quiet">{t.upload.commonHint}</p>
        <div class="form">
          {one("label", t.upload.labelAll)}
          {one("subject", t.upload.subjectAll)}
        </div>
        {rows.map(([name, text], at) => (
          <div class="form" key={at}>
            <Field label={t.upload.attribute}>
              <input
                value={name}
                onChange={(event) =>
                  attributes(rows.map((row, k) => (k === at ? [event.currentTarget.value.trim(), row[1]] : row)))
                }
              />
            </Field>
            <Field label={t.upload.valueAll}>
              <input
                value={text}
                onChange={(event) =>
                  attributes(rows.map((row, k) => (k === at ? [row[0], event.currentTarget.value.trim()] : row)))
                }
              />
            </Field>
          </div>
        ))}
      </div>
    </details>
  );
}

/** A table of attributes by id: what it would change, and then the changes, with the way back. */
function Table({ cohort, file }: { cohort: string; file: File }) {
  const [round, setRound] = useState(0);
  const ahead = useLoaded(`${cohort} ${file.name} ${file.lastModified} ${round}`, () =>
    sendAttributes(cohort, file, true),
  );
  const [done, setDone] = useState(false);
  const action = useAction(async () => {
    const columns = (await attributeColumns(file))!.filter((name) => !/^(id|external_id|weight)$/i.test(name));
    const names = columns.map((name) =>
      /^(subject|label)$/.test(name) ? name : `labels.${name.replace(/^labels\./, "")}`,
    );
    const before = await attributesNow(cohort, names, {});
    const { updated } = await sendAttributes(cohort, file, false);
    setDone(true);
    announce({
      text: t.bulk.done(count(updated)),
      undo: async () => {
        await restoreAttributes(cohort, before);
        setDone(false);
        setRound(round + 1);
      },
    });
  });
  const data = ahead.data;
  return (
    <section class="card">
      <div class="row spread">
        <h2>{file.name}</h2>
        <span class={`tag ${done ? "good" : ""}`}>{done ? t.upload.attributesDone : t.upload.attributesReady}</span>
      </div>
      <Fault error={ahead.error ?? action.error} />
      {data && (
        <div class={`note ${data.skipped ? "warn" : ""}`}>
          {t.upload.attributesAhead(count(data.updated), count(data.unchanged))}
          {data.skipped > 0 && ` ${t.upload.attributesUnknown(count(data.skipped))}`}
          {data.results.length > 0 && <Causes failed={data.results} />}
        </div>
      )}
      {!done && (
        <div class="row">
          <button class="main" disabled={action.busy || !data?.updated} onClick={() => action.run()}>
            {t.upload.attributesStore}
          </button>
        </div>
      )}
    </section>
  );
}

interface CardProps {
  one: Dropped;
  formats: Format[];
  planar: boolean;
  busy: boolean;
  onStop: () => void;
  onStore: () => void;
  onRead: (reading: Reading) => void;
  onPlace: (placing: Reading) => void;
}

function Card({ one, formats, planar, busy, onStop, onStore, onRead, onPlace }: CardProps) {
  const { file, state, found, kept } = one;
  const waits = state === "ready" || state === "failed";
  return (
    <section class="card">
      <div class="row spread">
        <h2>{file.name}</h2>
        <State {...one} />
      </div>
      {state === "sending" && (
        <div class="row" style={{ flexWrap: "nowrap" }}>
          <progress value={one.part} max={1} aria-label={file.name} />
          <button onClick={onStop}>{t.act.cancel}</button>
        </div>
      )}
      <Fault error={one.error} />
      {one.answer ? (
        <Added answer={one.answer} />
      ) : (
        <>
          {found && <Contents found={found} formats={formats} />}
          {found?.cohort && waits && <Ahead cohort={found.cohort} units={found.units} />}
          {kept && <p class="quiet">{kept.shapes ? t.upload.document(count(kept.shapes.length)) : t.upload.lines}</p>}
          {found && waits && <Placing found={found} planar={planar} value={one.placing} onChange={onPlace} />}
          {!kept && (waits || state === "refused") && (
            <HowRead key={state} one={one} formats={formats} onRead={onRead} />
          )}
          {state === "refused" && isPicture(file.name) && <ToSegment file={file} />}
          {waits && (
            <div class="row">
              <button class={busy ? "" : "main"} disabled={busy || found?.records === 0} onClick={onStore}>
                {t.upload.store}
              </button>
            </div>
          )}
        </>
      )}
    </section>
  );
}

/** A photograph has no shapes in it yet: the way to where they are found. */
export function ToSegment({ file }: { file: File }) {
  return (
    <div class="row">
      <button
        class="main"
        onClick={() => {
          handOverImage(file);
          navigate("/app/segment");
        }}
      >
        {t.upload.segment}
      </button>
    </div>
  );
}

/** How records become shapes of the cohort, as far as these records need it. */
function Placing({
  found,
  planar,
  value,
  onChange,
}: {
  found: Found;
  planar: boolean;
  value: Reading;
  onChange: (value: Reading) => void;
}) {
  const projected = planar && found.groups.some((group) => group.dimension === 3),
    sampled = found.groups.some((group) => group.kind === "fourier");
  return (
    <div class="form">
      {projected && (
        <Select
          label={t.file.plane}
          value={value.plane ?? ""}
          options={[
            ["", t.file.noPlane],
            ["xy", "xy"],
            ["xz", "xz"],
            ["yz", "yz"],
          ]}
          onChange={(plane) => onChange({ ...value, plane })}
        />
      )}
      {sampled && (
        <Field label={t.file.samples}>
          <input
            type="number"
            min={3}
            max={10_000}
            value={value.samples ?? ""}
            onChange={(event) => onChange({ ...value, samples: event.currentTarget.value })}
          />
        </Field>
      )}
      {(
        [
          ["label", t.upload.label],
          ["subject", t.upload.subject],
          ["prefix", t.file.prefix],
        ] as const
      ).map(([name, label]) => (
        <Field key={name} label={label}>
          <input
            value={value[name] ?? ""}
            onChange={(event) => onChange(given({ ...value, [name]: event.currentTarget.value.trim() }))}
          />
        </Field>
      ))}
      <Select
        label={t.words.unit}
        value={value.unit ?? ""}
        options={[["", t.upload.asStated], ...UNITS]}
        onChange={(unit) => onChange(given({ ...value, unit }))}
      />
    </div>
  );
}

/** Without what is empty: an empty prefix is a wish of its own. */
const given = (reading: Reading): Reading =>
  Object.fromEntries(Object.entries(reading).filter(([, value]) => value !== ""));

/** The format, where the service should not recognise it, and the options of reading that the format has. */
function HowRead({
  one: { reading, found, error },
  formats,
  onRead,
}: {
  one: Dropped;
  formats: Format[];
  onRead: (reading: Reading) => void;
}) {
  const change = (name: string, value: string) => {
    const { [name]: _, ...others } = reading;
    onRead(value ? { ...others, [name]: value } : others);
  };
  return (
    <details open={Boolean(error) || Object.keys(reading).length > 0}>
      <summary>{t.file.reading}</summary>
      <div class="form">
        <Select
          label={t.file.format}
          value={reading.format ?? ""}
          options={[["", t.file.recognised], ...formats.map((one): [string, string] => [one.id, one.name])]}
          onChange={(format) => onRead(format ? { format } : {})}
        />
        {optionsOf(formats, reading.format ?? found?.format).map((name) => (
          <Field key={name} label={name}>
            <input
              value={reading[name] ?? ""}
              spellcheck={false}
              onChange={(event) => change(name, event.currentTarget.value)}
            />
          </Field>
        ))}
      </div>
    </details>
  );
}

export type Failed = Extract<NonNullable<Schemas["AddAnswer"]["results"]>[number], { error: unknown }>;

/** What was wrong, each cause once: at its first shape, with the number of shapes that have it. */
function causesOf(failed: Failed[]) {
  const causes = new Map<
    string,
    { detail: string; fault: Parameters<typeof Place>[0]["fault"]; name: string | null | undefined; shapes: number }
  >();
  for (const one of failed) {
    const faults = one.error.errors?.length
      ? one.error.errors
      : [{ pointer: "", detail: one.error.detail, index: one.index }];
    for (const fault of faults) {
      const before = causes.get(fault.detail);
      if (before) before.shapes += 1;
      else
        causes.set(fault.detail, {
          detail: fault.detail,
          fault,
          name: "external_id" in one ? one.external_id : undefined,
          shapes: 1,
        });
    }
  }
  return [...causes.values()];
}

/** What was wrong with shapes, at most 50 causes. */
export function Causes({ failed }: { failed: Failed[] }) {
  const causes = causesOf(failed);
  return (
    <>
      <ul>
        {causes.slice(0, 50).map(({ detail, fault, name, shapes }) => (
          <li key={detail}>
            <Place fault={fault} />
            <Sentence text={detail} />
            {name && (
              <>
                {" "}
                (<code>{name}</code>)
              </>
            )}
            {shapes > 1 && <> {t.upload.alike(shapes - 1)}</>}
          </li>
        ))}
      </ul>
      {causes.length > 50 && <p>{t.fault.more(causes.length - 50)}</p>}
    </>
  );
}

/** What the cohort would take of a file, before it is stored. */
function Ahead({ cohort, units }: { cohort: Schemas["CohortPreview"]; units: Found["units"] }) {
  const { added, unchanged, skipped, self_intersecting: crossing } = cohort;
  const parts = [
    t.upload.wouldAdd(added),
    unchanged > 0 && t.upload.there(unchanged),
    skipped > 0 && t.upload.unstored(skipped),
    crossing > 0 && t.upload.crossed(crossing),
    units?.adopted
      ? t.upload.adopts(units.stored)
      : units && units.file !== units.stored && t.upload.converted(units.file, units.stored),
  ].filter(Boolean);
  return (
    <div class={`note ${skipped || cohort.warnings.length ? "warn" : ""}`}>
      <strong>{t.upload.ahead}</strong> {parts.join("; ")}.
      {cohort.fits && <p>{t.upload.fits(count(cohort.fits.count), percent(cohort.fits.worst, 2))}</p>}
      {cohort.warnings.map((warning) => (
        <p key={warning}>
          <Sentence text={warning} />
        </p>
      ))}
      {cohort.results.length > 0 && <Causes failed={cohort.results} />}
    </div>
  );
}

function Added({ answer }: { answer: Schemas["AddAnswer"] }) {
  const failed = (answer.results ?? []).flatMap((one) => ("error" in one && one.error ? [one] : []));
  return (
    <>
      {answer.warnings?.map((warning) => (
        <Warning key={warning} text={warning} />
      ))}
      {answer.self_intersecting > 0 && <p class="note warn">{t.upload.crossing(answer.self_intersecting)}</p>}
      {failed.length > 0 && (
        <div class="note warn">
          <strong>{t.upload.left(failed.length)}</strong>
          <Causes failed={failed} />
        </div>
      )}
      {answer.file && <Remarks file={answer.file} title={t.upload.storedWithout} />}
      {answer.repeated_points > 0 && <p class="small quiet">{t.upload.repeated(count(answer.repeated_points))}</p>}
    </>
  );
}
