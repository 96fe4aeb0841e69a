/** Lines between landmarks of a cohort, as someone has written them: `1-2-3, 4-5`. They are kept in the browser, for this cohort. */
import { useState } from "preact/hooks";

export type Link = [number, number];

/** Pairs of landmarks, counted from 0, of numbers counted from 1: chains and single lines. */
export function linksOf(text: string, points: number): Link[] {
  return text
    .split(/[,;\s]+/)
    .map((chain) => chain.split(/[-–]/).map((word) => Number(word) - 1))
    .flatMap((chain) => chain.slice(1).map((to, at): Link => [chain[at]!, to]))
    .filter((pair) => pair.every((at) => Number.isInteger(at) && at >= 0 && at < points));
}

const place = (cohort: string) => `shapelex.links.${cohort}`;

export function useLinks(cohort: string): [string, (text: string) => void] {
  const [text, setText] = useState(() => localStorage.getItem(place(cohort)) ?? "");
  const set = (next: string) => {
    setText(next);
    if (next) localStorage.setItem(place(cohort), next);
    else localStorage.removeItem(place(cohort));
  };
  return [text, set];
}
