/** What is in an image that someone drops: labels or a photograph, and where its largest object is. */
import type { Slice, Volume } from "../formats/image";

/** Sampled cells, and the part of equal neighbours among those that are not 0, from which an image is one of labels. */
const SAMPLED = 1_000_000,
  FEW = 64,
  EQUAL = 0.9;

/**
 * Whether the cells are labels: whole numbers with 0 for the outside, and either few different ones, or neighbours that are mostly
 * equal. Photographs have neither.
 */
export function isMask({ values, size, colours }: Volume): boolean {
  if (colours && /jpeg|webp/.test(colours.type)) return false;
  const seen = new Set<number>();
  const rows = Math.floor(values.length / size[0]),
    step = Math.max(1, Math.floor(values.length / SAMPLED));
  let pairs = 0,
    equal = 0;
  for (let row = 0; row < rows; row += step) {
    for (let column = 0; column < size[0]; column++) {
      const value = values[row * size[0] + column]!;
      if (value < 0 || !Number.isInteger(value)) return false;
      if (seen.size <= FEW) seen.add(value);
      const next = column + 1 < size[0] ? values[row * size[0] + column + 1]! : 0;
      if (value && next) {
        pairs++;
        equal += Number(value === next);
      }
    }
  }
  return seen.has(0) && seen.size > 1 && (seen.size <= FEW || equal >= EQUAL * pairs);
}

export interface Found {
  box: { x: number; y: number; w: number; h: number };
  polarity: "bright" | "dark";
}

/** Longest side of the grid in which the object is looked for, and the space around it relative to its size. */
const SIDE = 256,
  MARGIN = 0.08;

/** Least size of an object in cells of the grid, and number of objects that are proposed. */
const LEAST = 12,
  MOST = 100;

interface Grid {
  block: number;
  w: number;
  h: number;
  inside: (at: number) => boolean;
  polarity: Found["polarity"];
}

/** The image in blocks, divided in two at Otsu's threshold (1979): the half that holds most of the border is the outside. */
function divided({ size: [width, height], values }: Slice): Grid | null {
  const block = Math.ceil(Math.max(width, height) / SIDE),
    w = Math.ceil(width / block),
    h = Math.ceil(height / block);
  const grey = new Float64Array(w * h),
    counts = new Float64Array(w * h);
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      const at = Math.floor(y / block) * w + Math.floor(x / block);
      grey[at]! += values[y * width + x]!;
      counts[at]!++;
    }
  }
  grey.forEach((sum, at) => {
    grey[at] = sum / counts[at]!;
  });
  const level = otsu(grey);
  if (level === null) return null;
  let bright = 0,
    border = 0;
  for (let at = 0; at < w * h; at++) {
    const x = at % w,
      y = Math.floor(at / w);
    if (x > 0 && y > 0 && x < w - 1 && y < h - 1) continue;
    border++;
    bright += Number(grey[at]! > level);
  }
  const polarity = 2 * bright > border ? "dark" : "bright";
  const inside = (at: number) => (polarity === "bright" ? grey[at]! > level : grey[at]! <= level);
  return { block, w, h, inside, polarity };
}

interface Component {
  cells: number;
  left: number;
  top: number;
  right: number;
  bottom: number;
}

/** Cells of the grid that lie inside and hang together, the largest first. */
function componentsOf({ w, h, inside }: Grid): Component[] {
  const done = new Uint8Array(w * h);
  const all: Component[] = [];
  for (let start = 0; start < w * h; start++) {
    if (done[start] || !inside(start)) continue;
    const one = { cells: 0, left: w, top: h, right: 0, bottom: 0 },
      waiting = [start];
    done[start] = 1;
    while (waiting.length) {
      const at = waiting.pop()!,
        x = at % w,
        y = Math.floor(at / w);
      one.cells++;
      one.left = Math.min(one.left, x);
      one.right = Math.max(one.right, x);
      one.top = Math.min(one.top, y);
      one.bottom = Math.max(one.bottom, y);
      for (const [dx, dy] of [
        [-1, 0],
        [1, 0],
        [0, -1],
        [0, 1],
      ] as const) {
        const [nx, ny] = [x + dx, y + dy],
          next = ny * w + nx;
        if (nx < 0 || ny < 0 || nx >= w || ny >= h || done[next] || !inside(next)) continue;
        done[next] = 1;
        waiting.push(next);
      }
    }
    if (one.cells >= LEAST) all.push(one);
  }
  return all.sort((a, b) => b.cells - a.cells);
}

/** Boxes of all objects that stand out from an image, in cells, the largest first. */
export function objectsOf(slice: Slice): Found[] {
  const grid = divided(slice);
  if (!grid) return [];
  const { block, polarity } = grid,
    [width, height] = slice.size;
  return componentsOf(grid)
    .slice(0, MOST)
    .map((one) => {
      const [ow, oh] = [(one.right - one.left + 1) * block, (one.bottom - one.top + 1) * block];
      const x = Math.max(one.left * block - MARGIN * ow, 0),
        y = Math.max(one.top * block - MARGIN * oh, 0);
      const w = Math.min(ow * (1 + 2 * MARGIN), width - 1 - x),
        h = Math.min(oh * (1 + 2 * MARGIN), height - 1 - y);
      return { box: { x, y, w, h }, polarity };
    });
}

/** The box of the largest object, in cells; null where there is none. */
export const largestObject = (slice: Slice): Found | null => objectsOf(slice)[0] ?? null;

/** The threshold that makes the variance between both sides largest; null for an image of one grey. */
function otsu(grey: Float64Array): number | null {
  let [low, high] = [Infinity, -Infinity];
  for (const value of grey) {
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  if (!(high > low)) return null;
  const bins = new Float64Array(256);
  for (const value of grey) bins[Math.min(Math.floor((256 * (value - low)) / (high - low)), 255)]!++;
  const total = bins.reduce((sum, count, bin) => sum + count * bin, 0);
  let below = 0,
    sum = 0,
    best = 0,
    level = 0;
  for (let bin = 0; bin < 255; bin++) {
    below += bins[bin]!;
    sum += bins[bin]! * bin;
    const above = grey.length - below;
    if (!below || !above) continue;
    const between = below * above * (sum / below - (total - sum) / above) ** 2;
    if (between > best) [best, level] = [between, bin];
  }
  return low + ((level + 1) * (high - low)) / 256;
}
