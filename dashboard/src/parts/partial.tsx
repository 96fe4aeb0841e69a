/** A part of a shape that is hidden or broken, marked by hand, and what a model says it looks like, with bands. */
import { useRef, useState } from "preact/hooks";
import { get, post, type Schemas } from "../api/client";
import { useAction, useLoaded } from "../hooks";
import { axesOf } from "../shape/around";
import { box, evaluated, inPlane, isClosed, isDots, type Points, path } from "../shape/points";
import { number, percent, t } from "../strings";
import type { About } from "../views/dictionary";
import { Choice, Fault, Keys, Loading } from "./basic";
import { SaveDrawing, serialised } from "./drawn";

/** Points of an outline, and of them those that are sent. */
const OUTLINE = 160,
  SENT = 64;

/** Whether a model can complete shapes that are drawn in the plane. */
export const canComplete = (about: About): boolean =>
  about.method.kind === "functional_pca" &&
  inPlane(about.representation) &&
  ["closed_curve", "open_curve", "landmarks"].includes(about.representation.kind);

interface Seen {
  outline: Points;
  /** Parameter of each point in the model: its place on the reconstruction. */
  at: number[];
}

/** The outline as it was given, and where its points lie in the parameters of the model. */
async function seenOf(
  about: About,
  dictionary: string,
  body: Schemas["AssessRequest"],
  signal: AbortSignal,
): Promise<Seen> {
  const { representation } = about,
    stored = body.ids?.[0];
  const given = stored
    ? await get("/v1/cohorts/{cohort}/shapes/{shape}", { path: { cohort: body.cohort!, shape: stored }, signal })
    : body.shapes![0]!;
  const raw = ("points" in given ? given.points : undefined) as Points | undefined;
  const control = given.control_points as Points | undefined;
  if (isDots(representation)) {
    const outline = control ?? raw ?? [];
    return { outline, at: outline.map((_, index) => index) };
  }
  const [outline] = control
    ? await evaluated(representation, [control], signal, OUTLINE)
    : [thinned(raw ?? [], OUTLINE)];
  const answer = await post("/v1/dictionaries/{dictionary}/reconstruct", {
    path: { dictionary },
    body: { ...body, pose: "input" } as Schemas["ReconstructRequest"],
    signal,
  });
  const other = answer.results[0] as { control_points?: Points };
  const samples = 3 * OUTLINE;
  const [curve] = await evaluated(representation, [other.control_points!], signal, samples);
  const end = isClosed(representation) ? samples : samples - 1;
  return {
    outline: outline!,
    at: outline!.map((p) => {
      let [best, least] = [0, Infinity];
      curve!.forEach((q, index) => {
        const d = (p[0]! - q[0]!) ** 2 + (p[1]! - q[1]!) ** 2;
        if (d < least) [best, least] = [index, d];
      });
      return best / end;
    }),
  };
}

const thinned = <T,>(all: T[], most: number): T[] =>
  all.length <= most ? all : Array.from({ length: most }, (_, k) => all[Math.floor((k * all.length) / most)]!);

type Completed = Schemas["CompleteAnswer"];

export function Partial({
  about,
  dictionary,
  body,
  name,
}: {
  about: About;
  dictionary: string;
  body: Schemas["AssessRequest"];
  name: string;
}) {
  const [asked, setAsked] = useState(false);
  const seen = useLoaded(asked ? `${dictionary} ${JSON.stringify(body)}` : null, (signal) =>
    seenOf(about, dictionary, body, signal),
  );
  return (
    <section class="card no-print">
      <h2>{t.partial.title}</h2>
      {!asked && (
        <>
          <p class="quiet">{t.partial.lead}</p>
          <div class="row">
            <button onClick={() => setAsked(true)}>{t.partial.begin}</button>
          </div>
        </>
      )}
      <Loading on={seen.loading} />
      <Fault error={seen.error} retry={seen.reload} />
      {seen.data && <Mask key={name} about={about} dictionary={dictionary} seen={seen.data} name={name} />}
    </section>
  );
}

function Mask({ about, dictionary, seen, name }: { about: About; dictionary: string; seen: Seen; name: string }) {
  const { outline, at } = seen;
  const [hidden, setHidden] = useState<boolean[]>(() => outline.map(() => false));
  const [tool, setTool] = useState("hide");
  const [pressed, setPressed] = useState(false);
  const svg = useRef<SVGSVGElement>(null);
  const dots = isDots(about.representation),
    closed = isClosed(about.representation);
  const complete = useLoadedOnce(async (): Promise<{ answer: Completed; curve: Points; marked: boolean[] }> => {
    const kept = outline.flatMap((point, index) => (hidden[index] ? [] : [{ at: at[index]!, point }]));
    const answer = await post("/v1/dictionaries/{dictionary}/complete", {
      path: { dictionary },
      body: { shapes: [{ points: dots ? kept : distinct(thinned(kept, SENT)) }] } as Schemas["CompleteRequest"],
    });
    const [curve] = await evaluated(
      about.representation,
      [answer.results[0]!.control_points as Points],
      undefined,
      240,
    );
    return { answer, curve: curve!, marked: hidden };
  });
  const result = complete.data,
    found = result?.answer.results[0];
  /** Whether each place of the bands lies in the part that was marked when it was completed. */
  const covered =
    (found?.bands.points as Points | undefined)?.map((p, index) => {
      const place = found!.bands.parameters?.[index] ?? index;
      return !found!.bands.observed[index] && result!.marked[nearest(at, place, closed)] === true && p.length > 0;
    }) ?? [];
  // The frame holds the outline, what was completed, and all of its band.
  const reach = found ? reachOf(found, covered, result.answer.simultaneous_factor) : [];
  const view = box([outline, ...(result ? [result.curve, reach] : [])], 0.12),
    size = Math.max(...view.split(" ").slice(2).map(Number));
  const brush = (event: PointerEvent) => {
    const frame = svg.current!.getBoundingClientRect(),
      [x, y, w, h] = view.split(" ").map(Number) as [number, number, number, number];
    const scale = Math.max(w / frame.width, h / frame.height);
    const px = (event.clientX - frame.left - frame.width / 2) * scale + x + w / 2,
      py = (event.clientY - frame.top - frame.height / 2) * scale + y + h / 2;
    setHidden((before) =>
      before.map((old, index) =>
        Math.hypot(outline[index]![0]! - px, -outline[index]![1]! - py) < 0.05 * size ? tool === "hide" : old,
      ),
    );
  };
  const count = hidden.filter(Boolean).length;
  const range = (from: number, to: number) =>
    setHidden(outline.map((_, index) => index >= Math.min(from, to) && index < Math.max(from, to)));
  const first = hidden.indexOf(true),
    last = hidden.lastIndexOf(true);
  return (
    <>
      <p class="small quiet">{t.partial.hint}</p>
      <div class="row">
        <Choice
          label={t.scores.tool}
          value={tool}
          options={[
            ["hide", t.partial.hide],
            ["show", t.partial.show],
          ]}
          onChange={setTool}
        />
        <button class="plain" disabled={!count} onClick={() => setHidden(outline.map(() => false))}>
          {t.scores.clear}
        </button>
      </div>
      <figure>
        <svg
          ref={svg}
          class="shape"
          viewBox={view}
          style={{ height: "360px", touchAction: "none", cursor: "crosshair", overflow: "hidden" }}
          role="img"
          aria-label={t.partial.alt(name)}
          onPointerDown={(event) => {
            svg.current!.setPointerCapture(event.pointerId);
            setPressed(true);
            brush(event);
          }}
          onPointerMove={(event) => pressed && brush(event)}
          onPointerUp={() => setPressed(false)}
          onPointerCancel={() => setPressed(false)}
        >
          {found && <Bands found={found} covered={covered} factor={result.answer.simultaneous_factor} />}
          {result &&
            (dots ? (
              result.curve.map((p) => <circle class="dot accent" cx={p[0]} cy={-p[1]!} r={0.012 * size} />)
            ) : (
              <path class="line accent" d={path(result.curve, closed)} />
            ))}
          {outline.map((p, index) =>
            dots ? (
              <circle
                key={index}
                cx={p[0]}
                cy={-p[1]!}
                r={0.014 * size}
                style={{ fill: hidden[index] ? "var(--plus)" : "var(--ink)" }}
              />
            ) : closed || index + 1 < outline.length ? (
              <path
                key={index}
                class={`line ${hidden[index] ? "plus" : ""}`}
                opacity={hidden[index] ? 0.55 : undefined}
                d={path([p, outline[(index + 1) % outline.length]!], false, 6)}
              />
            ) : null,
          )}
        </svg>
        <Keys
          keys={[
            ["var(--ink)", t.partial.seen],
            ["var(--plus)", t.partial.hidden],
            ...(result ? [["var(--accent)", t.partial.completed] as [string, string]] : []),
          ]}
        />
        {found && (
          <SaveDrawing name={`${name}-completed`} of={() => (svg.current ? serialised(svg.current) : undefined)} />
        )}
      </figure>
      <div class="form">
        {(
          [
            [t.partial.from, Math.max(first, 0), (value: number) => range(value, last < 0 ? value : last + 1)],
            [t.partial.to, last < 0 ? 0 : last + 1, (value: number) => range(Math.max(first, 0), value)],
          ] as const
        ).map(([label, value, set]) => (
          <label class="slider wide" key={label}>
            <span>{label}</span>
            <input
              type="range"
              min={0}
              max={outline.length}
              value={value}
              aria-valuetext={percent(value / outline.length, 0)}
              onInput={(event) => set(Number(event.currentTarget.value))}
            />
            <output class="number">{percent(value / outline.length, 0)}</output>
          </label>
        ))}
      </div>
      <div class="row">
        <button class="main" disabled={complete.busy || !count || count > outline.length - 4} onClick={complete.run}>
          {t.partial.complete}
        </button>
      </div>
      <Fault error={complete.error} />
      {found && (
        <p>
          {found.novelty &&
            (found.novelty.is_outlier ? t.partial.unusual : t.partial.usual(percent(found.novelty.rank, 0)))}{" "}
          {t.partial.band(
            percent(result.answer.level, 0),
            `${number(Math.max(...found.bands.simultaneous.filter((_, k) => covered[k]), 0), 3)}${about.length_unit ? `\u00a0${about.length_unit}` : ""}`,
          )}
        </p>
      )}
    </>
  );
}

/** Places in ascending order, each once: the service takes one point at a place. */
function distinct<T extends { at: number }>(points: T[]): T[] {
  return [...new Map(points.map((one) => [one.at, one])).values()].sort((a, b) => a.at - b.at);
}

/** The outline's point whose parameter is nearest to a place; closed curves end where they begin. */
function nearest(at: number[], place: number, closed: boolean): number {
  let [best, least] = [0, Infinity];
  at.forEach((one, index) => {
    const apart = Math.abs(one - place),
      d = closed ? Math.min(apart, 1 - apart) : apart;
    if (d < least) [best, least] = [index, d];
  });
  return best;
}

/** An answer on request, with the last one kept. */
function useLoadedOnce<T>(ask: () => Promise<T>) {
  const [data, setData] = useState<T>();
  const action = useAction(async () => setData(await ask()));
  return { data, busy: action.busy, error: action.error, run: () => action.run() };
}

/** Corners of boxes around the regions of hidden places: along an axis an ellipse reaches the root of that variance. */
function reachOf({ bands }: Completed["results"][number], covered: boolean[], factor: number): Points {
  return (bands.points as Points).flatMap((p, index) => {
    if (!covered[index]) return [];
    const reach = p.map((_, axis) => factor * Math.sqrt(Math.max(bands.covariances[index]![axis]![axis]!, 0)));
    return [-1, 1].map((side) => p.map((x, axis) => x + side * reach[axis]!));
  });
}

/** Regions of hidden places, in which all of them lie together at the level of the band. */
function Bands({
  found,
  covered,
  factor,
}: {
  found: Completed["results"][number];
  covered: boolean[];
  factor: number;
}) {
  const { points, covariances } = found.bands;
  return (
    <g style={{ fill: "var(--accent)", stroke: "none" }} opacity="0.16">
      {(points as Points).map((p, index) => {
        if (!covered[index]) return null;
        const [a, b, angle] = axesOf(covariances[index] as [[number, number], [number, number]]);
        return (
          <ellipse
            key={index}
            transform={`translate(${p[0]} ${-p[1]!}) rotate(${-angle})`}
            rx={factor * a}
            ry={factor * b}
          />
        );
      })}
    </g>
  );
}
