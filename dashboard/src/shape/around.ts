/** What is drawn around the points of a group: their convex hull, or the ellipse that holds 95 % of a normal distribution like them. */

export type Spot = [number, number];

/** Half axes of the ellipse `pᵀ M⁻¹ p ≤ 1`, and the angle in degrees from the first axis of the plane to the longer one. */
export function axesOf([[xx, xy], [, yy]]: [[number, number], [number, number]]): [number, number, number] {
  const middle = (xx + yy) / 2,
    spread = Math.hypot((xx - yy) / 2, xy);
  const half = (square: number) => Math.sqrt(Math.max(square, 0));
  return [half(middle + spread), half(middle - spread), (90 * Math.atan2(2 * xy, xx - yy)) / Math.PI];
}

/** Turn to the left from `a` over `b` to `c`: positive. */
const turn = (a: Spot, b: Spot, c: Spot): number => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);

/** Corners of the convex hull, by the monotone chain (Andrew 1979). */
export function hull(points: Spot[]): Spot[] {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  if (sorted.length < 3) return sorted;
  const half = (order: Spot[]): Spot[] => {
    const chain: Spot[] = [];
    for (const p of order) {
      while (chain.length > 1 && turn(chain[chain.length - 2]!, chain[chain.length - 1]!, p) <= 0) chain.pop();
      chain.push(p);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

/** Squared Mahalanobis distance within which 95 % of a normal distribution of two dimensions lie. */
const LIMIT = -2 * Math.log(0.05);

/** Points on the ellipse of the mean and covariance of the points; none of fewer than three. */
export function ellipse(points: Spot[], corners = 72): Spot[] {
  const n = points.length;
  if (n < 3) return [];
  const [mx, my] = [0, 1].map((axis) => points.reduce((sum, p) => sum + p[axis]!, 0) / n) as Spot;
  let xx = 0,
    xy = 0,
    yy = 0;
  for (const [x, y] of points) {
    xx += (x - mx) ** 2 / (n - 1);
    xy += ((x - mx) * (y - my)) / (n - 1);
    yy += (y - my) ** 2 / (n - 1);
  }
  // A triangular root of the covariance.
  const a = Math.sqrt(xx),
    b = a > 0 ? xy / a : 0,
    c = Math.sqrt(Math.max(yy - b * b, 0)),
    r = Math.sqrt(LIMIT);
  return Array.from({ length: corners }, (_, k): Spot => {
    const [u, v] = [Math.cos((2 * Math.PI * k) / corners), Math.sin((2 * Math.PI * k) / corners)];
    return [mx + r * a * u, my + r * (b * u + c * v)];
  });
}
