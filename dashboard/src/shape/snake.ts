/** The segmentation of one object of a slice by `POST /v1/segment`. Shapes are in the unit of the slice, from the centre of its first cell. */
import type { Schemas } from "../api/client";
import { postImage } from "../api/jobs";
import { fileOf, type Slice, type Volume } from "../formats/image";
import { evaluated, type Points } from "./points";

export type Box = { x: number; y: number; w: number; h: number };
export interface Wanted {
  term: string;
  polarity: string;
  sigma: number;
  points: number;
}
/** Terms that ask whether the object is bright or dark: the others refuse the question. */
export const asksPolarity = (term: string): boolean => term === "contour" || term === "local_contrast";
export const USUAL: Wanted = { term: "contour", polarity: "bright", sigma: 1, points: 16 };

export interface Contour {
  control: Points;
  outline: Points;
  stop: string;
  iterations: number;
  /** Terms of the energy at the result, by their names. */
  energies: [string, number][];
  /** Energy after each step of each stage: stages have scales of their own. */
  history: number[][];
  warnings: string[];
}

/** Endings after which the contour is not that of its object. */
export const isLost = ({ stop }: Contour): boolean =>
  ["left_object", "folded", "left_image", "collapsed"].includes(stop);

export const curve = (points: number) =>
  ({
    kind: "closed_curve",
    dimension: 2,
    control_points: points,
    generator: { name: "trigonometric" },
  }) as Schemas["Representation"];

export type Start = { boxes: Box[] } | { controls: Points[] };

/** Contours of several objects in one request. From boxes on: coarse to fine. From contours on: the fine stage alone. */
export async function segmentedAll(
  volume: Volume,
  slice: Slice,
  wanted: Wanted,
  start: Start,
  signal?: AbortSignal,
): Promise<Contour[]> {
  const representation = curve(wanted.points);
  // Blurs are in the unit of the slice, and half a cell along every axis at least.
  const sigma = wanted.sigma * Math.max(...slice.spacing);
  const goesOn = "controls" in start;
  const stages = goesOn
    ? [{ free: "all", sigma }]
    : [
        { free: "affine", sigma: 2 * sigma },
        { free: "all", sigma: 2 * sigma },
        { free: "all", sigma },
      ];
  const parameters = {
    representation,
    coordinates: "world",
    history: true,
    stages,
    terms: [
      asksPolarity(wanted.term) ? { name: wanted.term, polarity: wanted.polarity } : { name: wanted.term },
      { name: "spacing", weight: 0.1 },
    ],
    ...(goesOn
      ? { shapes: start.controls.map((control_points) => ({ control_points })) }
      : { boxes: start.boxes.map(({ x, y, w, h }) => ({ lower: [x, y], upper: [x + w, y + h] })) }),
  };
  const answer = await postImage<Schemas["SegmentAnswer"]>("/v1/segment", parameters, fileOf(volume, slice), signal);
  const controls = answer.results.map((one) => one.control_points as Points);
  const outlines = await evaluated(representation, controls, signal);
  return answer.results.map((one, at) => ({
    control: controls[at]!,
    outline: outlines[at]!,
    stop: one.stop,
    iterations: one.iterations,
    energies: Object.entries(one.energies).flatMap(([name, { value }]): [string, number][] =>
      typeof value === "number" ? [[name, value]] : [],
    ),
    warnings: one.warnings,
    history: one.stages.flatMap(({ history }) => (history?.length ? [history] : [])),
  }));
}

/** The contour of one object. */
export async function segmented(
  volume: Volume,
  slice: Slice,
  wanted: Wanted,
  start: { box: Box } | { control: Points },
  signal?: AbortSignal,
): Promise<Contour> {
  const all = "box" in start ? { boxes: [start.box] } : { controls: [start.control] };
  return (await segmentedAll(volume, slice, wanted, all, signal))[0]!;
}
