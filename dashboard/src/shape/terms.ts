/** Formulas of linear models: the attributes that they name, in the words of the page and of the service. */
import type { Schemas } from "../api/client";
import { t } from "../strings";

type Attribute = Schemas["AttributeOutput"];

/** An attribute as people read it. */
export const nameOf = (attribute: string): string =>
  (t.attributes as Record<string, string>)[attribute] ?? attribute.replace(/^labels\./, "").replaceAll("_", " ");

/** A term for people: its attributes by their names. */
export const termName = (term: string): string =>
  term
    .split(":")
    .map((part) => {
      const bare = part.replaceAll("`", "");
      return bare in t.attributes ? nameOf(bare) : nameOf(`labels.${bare.replace(/^labels\./, "")}`);
    })
    .join(" × ");

/** Names of the attributes in a formula, once each: what stands before a parenthesis is a function, and after `|` an error term. */
export function variablesOf(formula: string): string[] {
  const text = formula.replace(/\|[^)]*/g, "");
  const names = [...text.matchAll(/`([^`]+)`|([\p{L}_][\p{L}\d_.]*)(\s*\()?/gu)];
  return [...new Set(names.flatMap(([, quoted, bare, call]) => (call ? [] : [quoted ?? bare!])))];
}

/** A number that a model depends on: its range in the data, and how its value is told. */
export interface Range {
  least: number;
  most: number;
  middle: number;
  /** A logarithm, which is shown as the size itself. */
  logarithm: boolean;
}

/** The range of an attribute of a formula; null where it is no number. */
export function rangeOf(name: string, items: Attribute[]): Range | null {
  const logarithm = name === "log_centroid_size";
  const wanted = logarithm ? ["measures.centroid_size"] : [`labels.${name}`, name, `measures.${name}`];
  const found = items.find((one) => wanted.includes(one.name) && one.type === "number");
  if (!found || typeof found.min !== "number" || typeof found.max !== "number" || found.min === found.max) return null;
  const middle = found.quantiles?.find((one) => one.probability === 0.5)?.value ?? found.mean ?? found.min;
  const of = (value: number) => (logarithm ? Math.log(value) : value);
  return { least: of(found.min), most: of(found.max), middle: of(middle), logarithm };
}
