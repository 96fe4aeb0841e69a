/** Shapes as the browser draws them: points on curves, which the service evaluates, and their sums. */
import { post, type Schemas } from "../api/client";

export type Representation = Schemas["Representation"];
export type Points = number[][];

export const inPlane = (representation: Representation): boolean =>
  "dimension" in representation && representation.dimension === 2;
export const isClosed = (representation: Representation): boolean => representation.kind === "closed_curve";
export const isDots = (representation: Representation): boolean => representation.kind === "landmarks";
export const hasMesh = (representation: Representation): boolean =>
  representation.kind === "surface" || representation.kind === "subdivision";

/** Points on curves with these control points. Evaluation is linear, so sums of shapes are sums of their points. */
export async function evaluated(
  representation: Representation,
  shapes: Points[],
  signal?: AbortSignal,
  samples = 240,
): Promise<Points[]> {
  if (isDots(representation)) return shapes;
  const body = {
    representation,
    samples,
    shapes: shapes.map((control_points) => ({ control_points })),
  } as Schemas["EvaluateRequest"];
  const answer = await post("/v1/evaluate", { body, signal });
  return answer.evaluations.map((evaluation) => (evaluation as { points: Points }).points);
}

export function sum(mean: Points, parts: [number, Points][]): Points {
  return mean.map((point, row) =>
    point.map((value, column) => parts.reduce((total, [weight, part]) => total + weight * part[row]![column]!, value)),
  );
}

/** Classes that remove rotations: their shapes have no direction of their own, and are drawn upright as the service does. */
const TURNED = [
  "similarity",
  "scaled_rotation",
  "affine",
  "linear",
  "reflected_similarity",
  "reflected_scaled_rotation",
  "rigid",
];

/** The rotation of the plane that puts a shape upright: docs/drawings.md, Orientation. */
export function upright(points: Points, transformation: unknown): (points: Points) => Points {
  if (typeof transformation !== "string" || !TURNED.includes(transformation) || points[0]?.length !== 2)
    return (same) => same;
  const n = points.length;
  const [cx, cy] = [0, 1].map((c) => points.reduce((total, p) => total + p[c]!, 0) / n) as [number, number];
  let xx = 0,
    xy = 0,
    yy = 0,
    mx = 0,
    my = 0;
  for (const p of points) {
    const x = p[0]! - cx,
      y = p[1]! - cy,
      square = x * x + y * y;
    xx += x * x;
    xy += x * y;
    yy += y * y;
    mx += x * square;
    my += y * square;
  }
  const angle = 0.5 * Math.atan2(2 * xy, xx - yy);
  const spread = Math.hypot(xx - yy, 2 * xy),
    largest = (xx + yy + spread) / 2;
  const third = Math.hypot(mx, my);
  let up: [number, number] =
    spread <= 0.02 * largest && third > 0 ? [mx / third, my / third] : [Math.cos(angle), Math.sin(angle)];
  const sign = 0.5 * (mx * up[1] - my * up[0]) + 0.8 * (mx * up[0] + my * up[1]);
  if (sign < 0) up = [-up[0], -up[1]];
  return (shape) => shape.map((p) => [up[1] * p[0]! - up[0] * p[1]!, up[0] * p[0]! + up[1] * p[1]!]);
}

/** A path with y upwards. */
export function path(points: Points, closed: boolean, digits = 4): string {
  return (
    points
      .map((p, index) => `${index ? "L" : "M"}${p[0]!.toPrecision(digits)} ${(-p[1]!).toPrecision(digits)}`)
      .join("") + (closed ? "Z" : "")
  );
}

/** A square view box around shapes. */
export function box(shapes: Points[], margin = 0.08): string {
  let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
  for (const shape of shapes) {
    for (const p of shape) {
      left = Math.min(left, p[0]!);
      right = Math.max(right, p[0]!);
      low = Math.min(low, -p[1]!);
      high = Math.max(high, -p[1]!);
    }
  }
  const gap = margin * Math.max(right - left, high - low, 1e-9);
  return [left - gap, low - gap, right - left + 2 * gap, high - low + 2 * gap]
    .map((value) => value.toPrecision(5))
    .join(" ");
}
