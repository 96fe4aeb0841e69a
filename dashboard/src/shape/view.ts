/** The view of shapes in space: turned about the upright axis, and then towards the eye. */

export type Flat = [number, number];

/** The view from the front, the right and above. */
export const START: Flat = [-0.6, 0.35];

/** Orthographic; the plane stays as it is, with y upwards. `near` grows towards the eye. */
export function projection([yaw, pitch]: Flat): { flat: (p: number[]) => Flat; near: (p: number[]) => number } {
  const [c, s, a, b] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  const depth = (p: number[]) => s * p[0]! + c * p[1]!;
  return {
    flat: (p) => (p.length < 3 ? [p[0]!, -p[1]!] : [c * p[0]! - s * p[1]!, -(a * p[2]! + b * depth(p))]),
    near: (p) => (p.length < 3 ? 0 : b * p[2]! - a * depth(p)),
  };
}
