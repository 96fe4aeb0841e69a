/** Our own drawing of shapes, for those that move. */
import { type Points, path } from "../shape/points";

export interface Part {
  points: Points;
  closed: boolean;
  dots?: boolean;
  class?: string;
}

export function Shape({
  parts,
  view,
  describe,
  height = 360,
}: {
  parts: Part[];
  view: string;
  describe: string;
  height?: number;
}) {
  const size = Math.max(...view.split(" ").slice(2).map(Number));
  return (
    <svg class="shape" viewBox={view} style={{ height: `${height}px` }} role="img" aria-label={describe}>
      {parts.map((part) =>
        part.dots ? (
          part.points.map((p) => <circle class={`dot ${part.class ?? ""}`} cx={p[0]} cy={-p[1]!} r={0.012 * size} />)
        ) : (
          <path class={`line ${part.class ?? ""}`} d={path(part.points, part.closed)} />
        ),
      )}
    </svg>
  );
}
