/** Shapes that count less in a robust mean or model, and where along them they are unlike the others. */
import { get, type Schemas } from "../api/client";
import { useLoaded } from "../hooks";
import { evaluated, isClosed, isDots, type Points } from "../shape/points";
import { count, number, percent, t } from "../strings";
import { Fault, Loading } from "./basic";

type Found = Schemas["RobustSummary"] & { shapes: Schemas["LessCountedShape"][] };
/** Shapes that are drawn. */
const SHOWN = 12;

/** Grey where a place is like the others, red where it is not. */
const shade = (weight: number): string =>
  `color-mix(in srgb, var(--plus) ${Math.round(100 * (1 - weight))}%, var(--pale))`;

export function Robust({
  cohort,
  representation,
  found,
}: {
  cohort: string;
  representation: Schemas["Representation"];
  found: Found;
}) {
  const shapes = found.shapes.slice(0, SHOWN);
  const loaded = useLoaded(`${cohort} ${shapes.map((one) => one.id).join()}`, async (signal) => {
    const stored = await Promise.all(
      shapes.map((one) => get("/v1/cohorts/{cohort}/shapes/{shape}", { path: { cohort, shape: one.id }, signal })),
    );
    const drawable = representation.kind !== "surface" && representation.kind !== "subdivision";
    const points = drawable
      ? await evaluated(
          representation,
          stored.map((one) => one.control_points as Points),
          signal,
          120,
        )
      : [];
    return stored.map((one, at) => ({ name: one.external_id ?? one.id, points: points[at], given: shapes[at]! }));
  });
  const { minority } = found;
  return (
    <section class="card">
      <h2>{t.robust.title}</h2>
      <p>{t.robust.sentence(count(found.rejected), count(found.reduced), number(found.effective, 3))}</p>
      {minority && <p class="note warn">{t.robust.minority(count(minority.shapes), percent(minority.share))}</p>}
      <Fault error={loaded.error} />
      <Loading on={loaded.loading} />
      {shapes.length === 0 && <p class="quiet">{t.robust.none}</p>}
      <div class="thumbs">
        {loaded.data?.map(({ name, points, given }) => (
          <figure class="thumb" key={given.id}>
            {points && (
              <Weighted
                points={points}
                weights={given.point_weights ?? []}
                closed={isClosed(representation)}
                dots={isDots(representation)}
                name={name}
              />
            )}
            <figcaption>
              <a href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(name)}`}>{name}</a>
              <br />
              {given.weight === 0 ? t.robust.left : t.robust.counts(percent(given.weight, 0))}
            </figcaption>
          </figure>
        ))}
      </div>
      {shapes.length > 0 && <p class="small quiet">{t.robust.hint}</p>}
    </section>
  );
}

function Weighted({
  points,
  weights,
  closed,
  dots,
  name,
}: {
  points: Points;
  weights: number[];
  closed: boolean;
  dots: boolean;
  name: string;
}) {
  const at = (index: number) => weights[Math.floor((index / points.length) * weights.length)] ?? 1;
  const [xs, ys] = [points.map((p) => p[0]!), points.map((p) => -p[1]!)];
  const size = 1.15 * Math.max(Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys), 1e-9);
  const view = [
    (Math.max(...xs) + Math.min(...xs) - size) / 2,
    (Math.max(...ys) + Math.min(...ys) - size) / 2,
    size,
    size,
  ];
  const n = points.length;
  return (
    <svg viewBox={view.join(" ")} role="img" aria-label={t.robust.alt(name)}>
      {points
        .slice(0, closed || dots ? n : n - 1)
        .map((p, index) =>
          dots ? (
            <circle key={index} cx={p[0]} cy={-p[1]!} r={size / 45} style={{ fill: shade(at(index)) }} />
          ) : (
            <path
              key={index}
              d={`M${p[0]} ${-p[1]!}L${points[(index + 1) % n]![0]} ${-points[(index + 1) % n]![1]!}`}
              style={{ stroke: shade(at(index)) }}
              stroke-width="2.4"
              stroke-linecap="round"
              vector-effect="non-scaling-stroke"
            />
          ),
        )}
    </svg>
  );
}
