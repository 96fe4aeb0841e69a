/** A dictionary of components as points on curves: what sliders and scatters draw without asking the service again. */
import { get } from "../api/client";
import type { About } from "../views/dictionary";
import { evaluated, type Points, upright } from "./points";

export interface Model {
  mean: Points;
  components: Points[];
  deviations: number[];
}

/** Standard deviations of the scores of all components, as the service states that of the first one. */
export async function deviationsOf(about: About, dictionary: string, signal: AbortSignal): Promise<number[]> {
  if (!about.atoms.length) return [];
  const query = { component: 1, sigma: 1 };
  const first = await get("/v1/dictionaries/{dictionary}/modes", { path: { dictionary }, query, signal });
  const scale = first.deviation / Math.sqrt(about.atoms[0]!.eigenvalue ?? 1);
  return about.atoms.map((atom) => scale * Math.sqrt(Math.max(atom.eigenvalue ?? 0, 0)));
}

/** Turned upright; standard deviations of the scores as the service states them. */
export async function modelOf(about: About, dictionary: string, signal: AbortSignal, samples = 240): Promise<Model> {
  const shapes = [
    (about.centre ?? about.mean.control_points) as Points,
    ...about.atoms.map((atom) => atom.control_points as Points),
  ];
  const [points, deviations] = await Promise.all([
    evaluated(about.representation, shapes, signal, samples),
    deviationsOf(about, dictionary, signal),
  ]);
  const turn = upright(points[0]!, about.transformation);
  const [mean, ...components] = points.map(turn) as [Points, ...Points[]];
  return { mean, components, deviations };
}
