/** A cohort for files that were dropped: what is in them, which cohort would hold them, what would be left out; created and stored at once. */
import { useEffect, useRef, useState } from "preact/hooks";
import { get, patch, post, type Schemas } from "../api/client";
import { asFile, type Found, firstOf, inspected, type Kept, type Line, type Reading } from "../formats/file";
import { isPicture } from "../formats/image";
import { sendTo } from "../formats/send";
import { useAction, useLoaded } from "../hooks";
import { Fault, Field, Loading, Select, Sentence, Warning } from "../parts/basic";
import { Remarks } from "../parts/contents";
import { Corresponding, freeName, isSphere } from "../parts/correspond";
import { Thumb } from "../parts/thumbs";
import { count, number, percent, t, UNITS } from "../strings";
import { describe } from "./cohorts";
import { Causes, type Failed, ToSegment } from "./upload";

/** Shapes that are drawn, of the first files. */
const SHOWN = 12;
/** Errors of representation that one may choose from, as parts of the size of a shape. */
const TOLERANCES = ["0.001", "0.005", "0.01", "0.02", "0.05"];

interface Looked {
  file: File;
  kept?: Kept;
  found?: Found;
  error?: Error;
}
type Kind = "closed_curve" | "open_curve" | "landmarks" | "surface";
type Group = Found["groups"][number];

/** Kinds of cohorts that the shapes of a file fit into, with their numbers. */
function kindsOf(found: Found): [Kind, number][] {
  return found.groups.flatMap((group): [Kind, number][] =>
    group.kind === "mesh"
      ? [["surface", group.records]]
      : group.kind === "landmarks"
        ? [["landmarks", group.records]]
        : group.kind === "fourier"
          ? [["closed_curve", group.records]]
          : [
              ["closed_curve", group.closed],
              ["open_curve", group.records - group.closed],
            ],
  );
}

function tally(files: Looked[]): Map<Kind, number> {
  const counts = new Map<Kind, number>();
  for (const { found } of files)
    for (const [kind, records] of found ? kindsOf(found) : [])
      if (records > 0) counts.set(kind, (counts.get(kind) ?? 0) + records);
  return counts;
}

const isOf = (group: Group, kind: Kind): boolean =>
  kind === "surface"
    ? group.kind === "mesh"
    : kind === "landmarks"
      ? group.kind === "landmarks"
      : group.kind === "curve" || (group.kind === "fourier" && kind === "closed_curve");

/** Shapes, dimension and unit of a kind in all files. */
function factsOf(files: Looked[], kind: Kind) {
  const groups = files.flatMap(({ found }) => found?.groups.filter((group) => isOf(group, kind)) ?? []);
  const solid = groups.filter((group) => group.dimension === 3).reduce((sum, group) => sum + group.records, 0);
  const all = groups.reduce((sum, group) => sum + group.records, 0);
  const units = files.flatMap(({ found }) =>
    typeof found?.properties.unit === "string" ? [found.properties.unit] : [],
  );
  const points = groups.flatMap((group) => group.points);
  return {
    dimension: (2 * solid > all ? 3 : 2) as 2 | 3,
    unit: units[0] ?? "",
    units: [...new Set(units)],
    points: points.length ? Math.max(...points) : 0,
    uneven: points.length > 0 && Math.min(...points) !== Math.max(...points),
  };
}

type Proposal = NonNullable<Found["proposals"]>[number];

/** The proposal that suffices for all files: the one with the most control points. */
function proposalOf(files: Looked[], kind: Kind): { size: string; left: number | null } | null {
  const sizeOf = ({ representation }: Proposal): number[] =>
    representation && "control_points" in representation
      ? [representation.control_points].flat()
      : representation && "intervals" in representation
        ? [representation.intervals]
        : [];
  const all = files
    .flatMap(({ found }) => found?.proposals ?? [])
    .filter((one) => (kind === "surface") === (one.kind === "mesh") && sizeOf(one).length > 0)
    .sort((a, b) => sizeOf(b).reduce((x, y) => x * y, 1) - sizeOf(a).reduce((x, y) => x * y, 1));
  return all[0]
    ? { size: sizeOf(all[0]).join(" × "), left: Math.max(...all.map((one) => one.relative_residual ?? 0)) }
    : null;
}

/** What is read and is no shape of the proposed kind, by what it is, over all files. */
function leftOut(files: Looked[], kind: Kind): [string, number][] {
  const sums = new Map<string, number>();
  const add = (what: string, records: number) => records > 0 && sums.set(what, (sums.get(what) ?? 0) + records);
  for (const { found } of files) {
    for (const one of found?.left_out ?? []) add(one.what, one.count);
    for (const [other, records] of found ? kindsOf(found) : [])
      if (other !== kind) add(t.propose.kinds[other], records);
  }
  return [...sums];
}

/** A name for a cohort: that of the only file, or of the folder, without what names may not have. */
function nameFrom(files: File[]): string {
  const folder = files[0]?.webkitRelativePath.split("/")[0];
  const text = files.length > 1 && folder ? folder : (files[0]?.name.replace(/(\.nii)?\.[^.]*$/, "") ?? "");
  return (
    text
      .normalize("NFKD")
      .replace(/[^\w.-]+/g, "-")
      .replace(/^-+|-+$/g, "")
      .slice(0, 80) || "cohort"
  );
}

interface Form {
  name: string;
  kind: Kind;
  size: string;
  dimension: string;
  unit: string;
  correspondence: string;
  plane: string;
  label: string;
}

function representationOf({ kind, size, dimension }: Form): Schemas["Representation"] {
  const sizes = size
    .split(/[^\d]+/)
    .filter(Boolean)
    .map(Number);
  const first = sizes[0] ?? 0;
  return (
    kind === "landmarks"
      ? { kind, dimension: Number(dimension), points: first }
      : kind === "surface"
        ? { kind, topology: "sphere", control_points: [first, sizes[1] ?? Math.max(2, Math.round(first / 2))] }
        : kind === "open_curve"
          ? { kind, dimension: Number(dimension), intervals: first, generator: { name: "bspline", degree: 3 } }
          : { kind, dimension: Number(dimension), control_points: first, generator: { name: "trigonometric" } }
  ) as Schemas["Representation"];
}

/** Looks into all files, one after the other, with the error that control points may leave. */
function useLooked(files: File[], tolerance: string): { looked: Looked[]; busy: boolean } {
  const [looked, setLooked] = useState<Looked[]>([]);
  const [busy, setBusy] = useState(true);
  useEffect(() => {
    const abort = new AbortController();
    setBusy(true);
    const look = async () => {
      const all: Looked[] = [];
      for (const file of files) {
        const one: Looked = { file };
        try {
          const read = await asFile(file);
          one.kept = read.kept;
          one.found = await inspected(read.file, { tolerance }, abort.signal);
        } catch (error) {
          one.error = error as Error;
        }
        if (abort.signal.aborted) return;
        all.push(one);
        setLooked([...all]);
      }
      setBusy(false);
    };
    void look();
    return () => abort.abort();
  }, [files, tolerance]);
  return { looked, busy };
}

/** The form that the files propose; what someone has written stays. */
function proposed(looked: Looked[], files: File[], own: Partial<Form>): Form | null {
  const kinds = [...tally(looked)].sort((a, b) => b[1] - a[1]);
  const kind = own.kind ?? kinds[0]?.[0];
  if (!kind) return null;
  const facts = factsOf(looked, kind);
  const slices = looked.some(({ found }) => found?.format === "rtstruct");
  const dimension = kind === "surface" ? 3 : slices && kind !== "landmarks" ? 2 : facts.dimension;
  return {
    name: nameFrom(files),
    size:
      kind === "landmarks"
        ? String(facts.points)
        : (proposalOf(looked, kind)?.size ?? (kind === "surface" ? "10 × 5" : "64")),
    dimension: String(dimension),
    unit: facts.unit,
    correspondence: kind === "closed_curve" ? "try" : kind === "open_curve" ? "arc_length" : "landmarks",
    plane: facts.dimension === 3 && dimension === 2 ? "xy" : "",
    label: "",
    ...Object.fromEntries(Object.entries(own).filter(([, value]) => value !== undefined)),
    kind,
  };
}

export function Proposal({ files, onClose }: { files: File[]; onClose: () => void }) {
  const [tolerance, setTolerance] = useState("0.01");
  const { looked, busy } = useLooked(files, tolerance);
  const [own, setOwn] = useState<Partial<Form>>({});
  const [made, setMade] = useState<string>();
  const [match, setMatch] = useState(true);
  const form = proposed(looked, files, own);
  const set = (change: Partial<Form>) => setOwn({ ...own, ...change });
  const left = form ? leftOut(looked, form.kind) : [];
  const facts = form && factsOf(looked, form.kind);
  const best = form && proposalOf(looked, form.kind);
  if (made && form) return <Storing cohort={made} looked={looked} form={form} match={match} onClose={onClose} />;
  return (
    <section class="card" aria-busy={busy}>
      <div class="row spread">
        <h2>{t.propose.title(files.length)}</h2>
        <button class="plain" onClick={onClose}>
          {t.act.cancel}
        </button>
      </div>
      <Loading on={busy} />
      {busy && files.length > 1 && <progress value={looked.length} max={files.length} aria-label={t.upload.looking} />}
      {looked.some((one) => one.error) && <Unread looked={looked} />}
      {form && facts && (
        <>
          <Pictures looked={looked} kind={form.kind} />
          <p class="say">
            {t.propose.sentence(count(tally(looked).get(form.kind) ?? 0), form.kind, describe(representationOf(form)))}
          </p>
          <ProposalForm
            form={form}
            kinds={[...tally(looked).keys()]}
            onChange={set}
            tolerance={tolerance}
            onTolerance={(value) => {
              setTolerance(value);
              setOwn({ ...own, size: undefined as never });
            }}
          />
          {best && form.kind !== "landmarks" && form.size === best.size && best.left !== null && (
            <p class="small quiet">{t.file.proposed(best.size, percent(best.left, 2))}</p>
          )}
          {form.kind === "landmarks" && facts.uneven && <p class="note warn">{t.propose.uneven}</p>}
          {facts.units.length > 1 && <p class="note warn">{t.propose.mixed(facts.units.join(", "))}</p>}
          <p class="small quiet">{t.propose.reasons[form.correspondence]}</p>
          {isSphere(representationOf(form)) && (
            <label class="check">
              <input type="checkbox" checked={match} onChange={(event) => setMatch(event.currentTarget.checked)} />
              <span>{t.correspond.afterwards}</span>
            </label>
          )}
          {left.length > 0 && (
            <div class="note warn">
              <strong>{t.file.leftOut}</strong>
              <ul>
                {left.map(([what, records]) => (
                  <li key={what}>
                    {/* Kinds of shapes are words of the page, what else is in the files is one of the service. */}
                    <Sentence text={what} ours={Object.values(t.propose.kinds).includes(what)} />: {count(records)}
                  </li>
                ))}
              </ul>
            </div>
          )}
          {looked.length === 1 && looked[0]!.found && <Remarks file={{ ...looked[0]!.found, left_out: [] }} title="" />}
          <Create form={form} disabled={busy} onMade={setMade} />
        </>
      )}
      {!busy && !form && <p class="note warn">{t.propose.nothing}</p>}
    </section>
  );
}

/** Files that were not read, each cause once; photographs have a way on. */
function Unread({ looked }: { looked: Looked[] }) {
  const failed = looked.filter((one) => one.error);
  const picture = failed.find((one) => isPicture(one.file.name));
  return (
    <>
      {[...new Map(failed.map((one) => [one.error!.message, one])).values()].slice(0, 6).map((one) => (
        <div key={one.error!.message}>
          <p class="small quiet">
            {failed
              .filter((other) => other.error!.message === one.error!.message)
              .slice(0, 4)
              .map((other) => other.file.name)
              .join(", ")}
          </p>
          <Fault error={one.error} />
        </div>
      ))}
      {picture && <ToSegment file={picture.file} />}
    </>
  );
}

function Pictures({ looked, kind }: { looked: Looked[]; kind: Kind }) {
  const files = looked.filter(({ found }) => found?.groups.some((group) => isOf(group, kind))).slice(0, SHOWN);
  const each = Math.max(1, Math.ceil(SHOWN / Math.max(files.length, 1)));
  const lines = useLoaded(files.map((one) => one.file.name).join(" "), async (signal) => {
    const all = await Promise.all(
      files.map(async ({ file }) => {
        const found = await firstOf((await asFile(file)).file, {}, each, signal).catch((): Line[] => []);
        // Meshes are named by their file.
        return found.map((line) => ({ ...line, external_id: line.external_id ?? file.name }));
      }),
    );
    return all.flat().slice(0, SHOWN);
  });
  return lines.data?.length ? (
    <div class="thumbs" role="group" aria-label={t.propose.pictures}>
      {lines.data.map((line, at) => (
        <Thumb key={at} line={line} />
      ))}
    </div>
  ) : null;
}

function ProposalForm({
  form,
  kinds,
  onChange,
  tolerance,
  onTolerance,
}: {
  form: Form;
  kinds: Kind[];
  onChange: (change: Partial<Form>) => void;
  tolerance: string;
  onTolerance: (value: string) => void;
}) {
  const curve = form.kind === "closed_curve" || form.kind === "open_curve";
  return (
    <div class="form">
      <Field label={t.propose.name}>
        <input
          required
          maxLength={100}
          pattern="[A-Za-z0-9._\-]+"
          value={form.name}
          onInput={(event) => onChange({ name: event.currentTarget.value })}
        />
      </Field>
      <Select
        label={t.words.kind}
        value={form.kind}
        options={kinds.map((kind) => [kind, t.kinds[kind]])}
        onChange={(kind) =>
          onChange({ kind: kind as Kind, size: undefined, dimension: undefined, correspondence: undefined } as never)
        }
      />
      <Field label={form.kind === "surface" ? t.cohorts.sizes.closed_curve : t.cohorts.sizes[form.kind]}>
        <input value={form.size} onInput={(event) => onChange({ size: event.currentTarget.value })} />
      </Field>
      {form.kind !== "landmarks" && (
        <Select
          label={t.propose.tolerance}
          value={tolerance}
          options={TOLERANCES.map((value) => [value, t.propose.ofSize(percent(Number(value)))])}
          onChange={onTolerance}
        />
      )}
      {curve && (
        <Select
          label={t.words.dimension}
          value={form.dimension}
          options={[
            ["2", t.cohorts.plane],
            ["3", t.cohorts.space],
          ]}
          onChange={(dimension) => onChange({ dimension, plane: dimension === "3" ? "" : form.plane })}
        />
      )}
      {form.plane !== "" && (
        <Select
          label={t.file.plane}
          value={form.plane}
          options={["xy", "xz", "yz"].map((plane) => [plane, plane])}
          onChange={(plane) => onChange({ plane })}
        />
      )}
      <Select
        label={t.words.unit}
        value={form.unit}
        options={[["", t.upload.unsaid], ...UNITS]}
        onChange={(unit) => onChange({ unit })}
      />
      {curve && (
        <Select
          label={t.cohorts.correspondence}
          value={form.correspondence}
          options={[
            ...(form.kind === "closed_curve" ? [["try", t.propose.try] as [string, string]] : []),
            ...Object.entries(t.correspondences).filter(([id]) => form.kind === "closed_curve" || id !== "cyclic"),
          ]}
          onChange={(correspondence) => onChange({ correspondence })}
        />
      )}
      <Field label={t.upload.labelAll}>
        <input value={form.label} onInput={(event) => onChange({ label: event.currentTarget.value })} />
      </Field>
    </div>
  );
}

function Create({ form, disabled, onMade }: { form: Form; disabled: boolean; onMade: (cohort: string) => void }) {
  const action = useAction(async () => {
    const correspondence = form.correspondence === "try" ? "cyclic" : form.correspondence;
    const name = await freeName(form.name.trim());
    await post("/v1/cohorts", {
      body: {
        name,
        length_unit: form.unit || null,
        representation: representationOf(form),
        correspondence: correspondence as Schemas["Correspondence"],
      },
    });
    onMade(name);
  });
  return (
    <>
      <Fault error={action.error} />
      <div class="row">
        <button class="main" disabled={disabled || action.busy || !form.name.trim()} onClick={() => action.run()}>
          {t.propose.create}
        </button>
      </div>
    </>
  );
}

interface Result {
  name: string;
  part: number;
  answer?: Schemas["AddAnswer"];
  error?: Error;
}

/** The files on their way into the new cohort; then the matching that lies nearer, and surfaces that are made to correspond. */
function Storing({
  cohort,
  looked,
  form,
  match,
  onClose,
}: {
  cohort: string;
  looked: Looked[];
  form: Form;
  match: boolean;
  onClose: () => void;
}) {
  const files = looked.filter((one) => one.found);
  const [results, setResults] = useState<Result[]>([]);
  const [done, setDone] = useState(false);
  const stop = useRef<(() => void) | undefined>(undefined);
  useEffect(() => {
    const parameters: Reading = {
      ...(form.plane ? { plane: form.plane } : {}),
      ...(form.label.trim() ? { label: form.label.trim() } : {}),
    };
    const run = async () => {
      for (const [index, one] of files.entries()) {
        const tell = (change: Partial<Result>) =>
          setResults((before) => {
            const next = [...before];
            next[index] = { ...(before[index] ?? { name: one.file.name, part: 0 }), ...change };
            return next;
          });
        tell({});
        const sent = sendTo(cohort, one.file, one.kept, "skip", parameters, (part) => tell({ part }));
        stop.current = sent.stop;
        await sent.done.then(
          (answer) => tell({ answer, part: 1 }),
          (error: Error) => tell({ error, part: 1 }),
        );
      }
      setDone(true);
    };
    void run();
    return () => stop.current?.();
  }, []);
  const added = results.reduce((sum, one) => sum + (one.answer?.added ?? 0), 0);
  const failed = results.flatMap(
    (one) => one.answer?.results?.flatMap((entry): Failed[] => ("error" in entry && entry.error ? [entry] : [])) ?? [],
  );
  const spheres = isSphere(representationOf(form));
  return (
    <section class="card" aria-live="polite">
      <h2>{cohort}</h2>
      {!done && (
        <progress
          value={results.reduce((sum, one) => sum + one.part, 0)}
          max={files.length}
          aria-label={t.propose.storing}
        />
      )}
      {done && (
        <p>
          <span class={`tag ${failed.length ? "warn" : "good"}`}>
            {t.upload.added(added)}
            {failed.length > 0 && `, ${t.upload.skipped(failed.length)}`}
          </span>
        </p>
      )}
      {results.map((one) => one.error && <Fault key={one.name} error={one.error} />)}
      {failed.length > 0 && (
        <div class="note warn">
          <strong>{t.upload.left(failed.length)}</strong>
          <Causes failed={failed} />
        </div>
      )}
      {[...new Set(results.flatMap((one) => one.answer?.warnings ?? []))].map((warning) => (
        <Warning key={warning} text={warning} />
      ))}
      {done && added > 1 && form.correspondence === "try" && <Matching cohort={cohort} />}
      {done && added > 1 && spheres && match && <Corresponding cohort={cohort} />}
      {done && (
        <div class="row">
          <a class={`button ${spheres && match ? "" : "main"}`} href={`/app/cohorts/${encodeURIComponent(cohort)}`}>
            {t.upload.look}
          </a>
          <button onClick={onClose}>{t.propose.others}</button>
        </div>
      )}
    </section>
  );
}

/** Both ways of matching are tried on the shapes, and the one that lies nearer is kept, with its reason. */
function Matching({ cohort }: { cohort: string }) {
  const tried = useLoaded(cohort, async (signal) => {
    const found = await post("/v1/cohorts/{cohort}/matching", { path: { cohort }, body: {}, signal });
    if (found.recommended !== found.present) {
      await patch("/v1/cohorts/{cohort}", { path: { cohort }, body: { correspondence: found.recommended } });
    }
    const { correspondence } = await get("/v1/cohorts/{cohort}", { path: { cohort }, signal });
    return { found, correspondence };
  });
  const data = tried.data;
  return (
    <>
      <Loading on={tried.loading} />
      <Fault error={tried.error} retry={tried.reload} />
      {data && (
        <div class="note">
          <strong>{t.propose.matched(t.correspondences[data.correspondence as keyof typeof t.correspondences])}</strong>{" "}
          {data.found.matchings
            .filter((one) => one.correspondence in t.correspondences)
            .map((one) =>
              t.propose.variance(
                t.correspondences[one.correspondence as keyof typeof t.correspondences],
                number(one.residual_variance, 3),
              ),
            )
            .join("; ")}
          . <a href={`/app/cohorts/${encodeURIComponent(cohort)}`}>{t.propose.changeable}</a>
        </div>
      )}
    </>
  );
}
