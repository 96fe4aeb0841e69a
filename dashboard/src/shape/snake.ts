/** The segmentation of one object of a slice by `POST /v1/segment`. Shapes are in the unit of the slice, from the centre of its first cell. */
import { postImage, type Schemas } from "../api/client";
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
  energies: Record<string, unknown>;
  history: number[];
  warnings: string[];
}

export const curve = (points: number) =>
  ({
    kind: "closed_curve",
    dimension: 2,
    control_points: points,
    generator: { name: "trigonometric" },
  }) as Schemas["Representation"];

/** From a box on: coarse to fine. From a contour on, perhaps corrected by hand: the fine stage alone. */
export async function segmented(
  volume: Volume,
  slice: Slice,
  wanted: Wanted,
  start: { box: Box } | { control: Points },
  signal?: AbortSignal,
): Promise<Contour> {
  const representation = curve(wanted.points);
  // Blurs are in the unit of the slice, and half a cell along every axis at least.
  const sigma = wanted.sigma * Math.max(...slice.spacing);
  const goesOn = "control" in start;
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
      ? { shapes: [{ control_points: start.control }] }
      : {
          boxes: [{ lower: [start.box.x, start.box.y], upper: [start.box.x + start.box.w, start.box.y + start.box.h] }],
        }),
  };
  const answer = await postImage<Schemas["SegmentAnswer"]>("/v1/segment", parameters, fileOf(volume, slice), signal);
  const one = answer.results[0]!;
  const control = one.control_points as Points;
  const [outline] = await evaluated(representation, [control], signal);
  const stagesDone = one.stages as { history?: number[] | null }[];
  return {
    control,
    outline: outline!,
    stop: one.stop,
    iterations: one.iterations,
    energies: one.energies,
    warnings: one.warnings,
    history: stagesDone.flatMap((stage) => stage.history ?? []),
  };
}
