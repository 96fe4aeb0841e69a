/** Contours in slices of a volume, as they are seen in the planes across. */
import { layout, type Plane, type Volume } from "../formats/image";
import type { Points } from "./points";

/** Where a line in a slice, at `at` along the axis `axis` (0 across, 1 down), crosses a contour: the values along the other axis, sorted. */
function crossed(outline: Points, axis: 0 | 1, at: number): number[] {
  const other = axis ? 0 : 1;
  return outline
    .flatMap((p, index) => {
      const q = outline[(index + 1) % outline.length]!,
        [a, b] = [p[axis]! - at, q[axis]! - at];
      return a > 0 !== b > 0 ? [p[other]! + ((q[other]! - p[other]!) * a) / (a - b)] : [];
    })
    .sort((a, b) => a - b);
}

/** The place of a cell along an axis of a slice, and back. */
const placed = (volume: Volume, axis: number, flip: boolean, cell: number): number =>
  (flip ? volume.size[axis]! - 1 - cell : cell) * volume.spacing[axis]!;
const cellAt = (volume: Volume, axis: number, flip: boolean, place: number): number => {
  const cell = place / volume.spacing[axis]!;
  return flip ? volume.size[axis]! - 1 - cell : cell;
};

/** The cell of the axis that another plane cuts, under a place of a slice: the slice of that plane through the place. */
export function sliceThrough(volume: Volume, plane: Plane, [x, y]: [number, number], other: Plane): number {
  const own = layout(volume, plane),
    { cut } = layout(volume, other);
  const cell =
    cut === own.across ? cellAt(volume, own.across, own.flips[0], x) : cellAt(volume, own.down, own.flips[1], y);
  return Math.min(Math.max(Math.round(cell), 0), volume.size[cut]! - 1);
}

export type Segment = [number, number, number, number];

/** Contours of slices of one plane, cut by a slice of another one: lines across the inside, one for each slice. */
export function cutBy(
  volume: Volume,
  plane: Plane,
  levels: [number, Points][],
  other: Plane,
  index: number,
): Segment[] {
  const own = layout(volume, plane),
    their = layout(volume, other);
  const axis = their.cut === own.across ? 0 : 1,
    along = axis ? own.across : own.down,
    flip = own.flips[axis ? 0 : 1]!;
  const at = placed(volume, their.cut, own.flips[axis]!, index);
  return levels.flatMap(([level, outline]) => {
    const ends = crossed(outline, axis, at).map((place) => {
      const cells = [0, 0, 0];
      cells[own.cut] = level;
      cells[along] = cellAt(volume, along, flip, place);
      return [
        placed(volume, their.across, their.flips[0], cells[their.across]!),
        placed(volume, their.down, their.flips[1], cells[their.down]!),
      ];
    });
    return Array.from({ length: Math.floor(ends.length / 2) }, (_, k): Segment => {
      const [a, b] = [ends[2 * k]!, ends[2 * k + 1]!];
      return [a[0]!, a[1]!, b[0]!, b[1]!];
    });
  });
}
