/** Units of coordinates: a shape from a file is in that of the file, and a dictionary in that of its cohort. */
import type { Volume } from "../formats/image";
import type { Points } from "./points";

/** Units of length in millimetres; all others count cells, or nothing. */
const LENGTHS: Record<string, number> = { m: 1000, cm: 10, mm: 1, um: 1e-3, nm: 1e-6, inch: 25.4 };

/** Factor from one unit to another: 1 where one of both is unknown, null where only one of both is a length. */
export function factor(from?: string | null, to?: string | null): number | null {
  if (!from || !to || from === to) return 1;
  const [a, b] = [LENGTHS[from], LENGTHS[to]];
  return a && b ? a / b : a || b ? null : 1;
}

export const scaled = <T extends Points | undefined>(points: T, by: number): T =>
  (by === 1 ? points : points?.map((point) => point.map((x) => x * by))) as T;

/** Unit of positions in a picture. */
export const unitOf = ({ hasLengths, size }: Volume): string => (hasLengths ? "mm" : size[2] > 1 ? "voxel" : "pixel");
