/** One colour and one dash for a group, wherever it is drawn: by its place among all values of its attribute. */
import { CATEGORIES } from "../parts/colours";

/** Dashes in pixels: groups are told apart without colours too. */
export const DASHES = ["", "8 4", "2.5 3", "9 3 2.5 3", "14 5", "5 5", "1.5 5", "3 2"];

export interface Look {
  colour: string;
  dash: string;
}

/** Looks by the names of groups, of all values that the attribute has in the cohort. */
export function looksOf(names: string[]): Map<string, Look> {
  const sorted = [...new Set(names)].sort();
  return new Map(
    sorted.map((name, at) => [
      name,
      { colour: CATEGORIES[at % CATEGORIES.length]!, dash: DASHES[at % DASHES.length]! },
    ]),
  );
}
