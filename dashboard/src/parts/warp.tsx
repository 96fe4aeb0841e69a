/** The thin-plate spline between two shapes: a bent grid, arrows, or both shapes; of landmarks, and of curves in the plane. */
import { useMemo, useState } from "preact/hooks";
import { post, type Schemas } from "../api/client";
import { useFollowed, useLoaded } from "../hooks";
import { useSetting } from "../router";
import { linksOf, useLinks } from "../shape/links";
import { evaluated, inPlane, isClosed, isDots, type Points, type Representation } from "../shape/points";
import { count, number } from "../strings";
import { words } from "../strings/warp";
import { Choice, Fault, Loading, PICTURES, Picture, Select, Warning } from "./basic";
import { Figure, type Mesh } from "./figure";

/** Places along a curve that are taken as landmarks. */
const PLACES = 60;
/** Cells of the grid along its longest side. */
const CELLS = 22;

export interface Form {
  id: string;
  name: string;
  /** Control points. */
  points: Points;
}

/** Whether there is a grid between shapes of this kind. */
export const canWarp = (representation: Representation): boolean =>
  isDots(representation) || (representation.kind.endsWith("curve") && inPlane(representation));

/** Nodes along the lines of a grid in the plane, and those at which it folds. */
function meshOf(grid: NonNullable<Schemas["WarpAnswer"]["grid"]>): Mesh {
  const [rows, columns] = grid.size as [number, number];
  const nodes = grid.nodes as Points;
  const at = (r: number, c: number) => nodes[r * columns + c]!;
  const range = (n: number) => Array.from({ length: n }, (_, k) => k);
  return {
    lines: [
      ...range(rows).map((r) => range(columns).map((c) => at(r, c))),
      ...range(columns).map((c) => range(rows).map((r) => at(r, c))),
    ],
    folds: nodes.filter((_, k) => !(grid.determinants[k]! > 0)),
  };
}

export function Warp({
  about,
  forms,
  superimpose,
  turn = (same) => same,
}: {
  about: Schemas["CohortOutput"];
  forms: Form[];
  /** Whether the target is moved onto the reference, which shapes of one alignment do not need. */
  superimpose: boolean;
  /** How the page turns shapes of this alignment. */
  turn?: (points: Points) => Points;
}) {
  const w = words();
  const [view, setView] = useSetting("warp", "");
  return (
    <section class="card">
      <h2>{w.title}</h2>
      {view in w.views && forms.length > 1 ? (
        <>
          <div class="row">
            <Choice label={w.show} value={view} options={Object.entries(w.views)} onChange={setView} />
            <button class="plain no-print" onClick={() => setView("")}>
              {w.hide}
            </button>
          </div>
          <Between about={about} forms={forms} superimpose={superimpose} turn={turn} view={view} />
        </>
      ) : (
        <>
          <p class="quiet">{w.lead}</p>
          <div class="row no-print">
            <button onClick={() => setView("grid")}>{w.draw}</button>
          </div>
        </>
      )}
    </section>
  );
}

function Between({
  about,
  forms,
  superimpose,
  turn,
  view,
}: {
  about: Schemas["CohortOutput"];
  forms: Form[];
  superimpose: boolean;
  turn: (points: Points) => Points;
  view: string;
}) {
  const w = words();
  const { representation } = about;
  const dots = isDots(representation),
    spatial = isDots(representation) && !inPlane(representation);
  const [from, setFrom] = useSetting("from", forms[0]!.id);
  const [to, setTo] = useSetting("to", forms[1]!.id);
  const [times, setTimes] = useState(1);
  const [first, second] = [from, to].map((id) => forms.find((one) => one.id === id)) as [Form?, Form?];
  const shapes = useLoaded(
    first && second && first !== second ? JSON.stringify([first, second]) : null,
    async (signal) => {
      const drawn = await evaluated(representation, [first!.points, second!.points], signal, PLACES);
      // The end of a closed curve is its beginning: landmarks stand at different places.
      const isTwice = drawn.every(
        (points) => points.length > 3 && points[0]!.every((x, axis) => x === points.at(-1)![axis]),
      );
      return drawn.map((points) => turn(isTwice && isClosed(representation) ? points.slice(0, -1) : points));
    },
  );
  const [text] = useLinks(about.name);
  const links = dots ? linksOf(text, first?.points.length ?? 0) : [];
  const body = shapes.data && {
    reference: shapes.data[0],
    target: shapes.data[1],
    superimpose,
    magnify: times,
  };
  const found = useFollowed(body ? JSON.stringify(body) : null, async (signal) => {
    const [reference] = shapes.data!;
    const answer = await post("/v1/warp", {
      body: { ...body, points: reference, grid: spatial ? undefined : { cells: CELLS } } as Schemas["WarpRequest"],
      signal,
    });
    return { answer, reference: reference!, moved: answer.points as Points };
  });
  const mesh = useMemo(() => {
    const grid = found.data?.answer.grid;
    return grid && !spatial ? meshOf(grid) : undefined;
  }, [found.data]);
  const options = forms.map((one): [string, string] => [one.id, one.name]);
  const names = [first?.name ?? "", second?.name ?? ""] as const;
  const data = found.data;
  return (
    <>
      <div class="form no-print">
        <Select label={w.from} value={from} options={options} onChange={setFrom} />
        <Select label={w.to} value={to} options={options} onChange={setTo} />
        <label class="slider wide">
          <span>{w.magnify}</span>
          <input
            type="range"
            min={0.5}
            max={5}
            step={0.5}
            value={times}
            aria-valuetext={`${number(times, 2)} ×`}
            onInput={(event) => setTimes(Number(event.currentTarget.value))}
          />
          <output class="number">{number(times, 2)} ×</output>
        </label>
        <button
          onClick={() => {
            setFrom(to);
            setTo(from);
          }}
        >
          ⇄ {w.swap}
        </button>
      </div>
      {first === second && <p class="note">{w.same}</p>}
      <Fault error={shapes.error ?? found.error} />
      <Loading on={(shapes.loading || found.waits) && !data} />
      {data && first !== second && (
        <>
          {data.answer.folds > 0 && (
            <p class="note warn">
              {w.folds(count(data.answer.folds), count(data.answer.grid?.determinants.length ?? data.answer.folds))}
            </p>
          )}
          {data.answer.warnings
            .filter((one) => !one.startsWith("the map folds"))
            .map((one) => (
              <Warning key={one} text={one} />
            ))}
          {spatial && view === "grid" ? (
            <Picture
              source={{
                method: "POST",
                path: "/v1/warp",
                query: { show: "grid", numbers: false },
                body: { ...body, links },
              }}
              formats={PICTURES}
              name={`${about.name}-warp`}
              alt={w.alt(...names)}
              caption={w.space}
            />
          ) : (
            <Figure
              height={420}
              legend={false}
              describe={w.alt(...names)}
              name={`${about.name}-warp`}
              links={dots ? about.name : undefined}
              mesh={view === "grid" ? mesh : undefined}
              arrows={view === "arrows" ? data.reference.map((p, at) => [p, data.moved[at]!]) : undefined}
              sets={setsOf(view, data, { closed: isClosed(representation), dots }, names)}
            />
          )}
          <p class="small quiet">
            {w.captions[view]!(...names)} {times !== 1 && w.magnified(number(times, 2))}{" "}
            {superimpose && w.superimposed(names[1])} {w.energy(number(data.answer.bending_energy, 3))}
          </p>
        </>
      )}
    </>
  );
}

/** The shapes of a view: the one that is bent, with or without the one that it came from. */
function setsOf(
  view: string,
  { reference, moved }: { reference: Points; moved: Points },
  look: { closed: boolean; dots: boolean },
  [from, to]: readonly [string, string],
) {
  const before = { ...look, name: from, points: reference, pale: true, colour: "var(--pale)" };
  const after = { ...look, name: to, points: moved, colour: "var(--accent)" };
  if (view === "grid") return [after];
  return view === "arrows" ? [{ ...before, pale: false, width: 1.4 }] : [before, after];
}
