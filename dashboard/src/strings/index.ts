/** The words of the page: one file per language, of one shape. */
import { de } from "./de";
import { en } from "./en";

export type Strings = typeof en;

/** The words in use; a new language is a new value. */
export let t: Strings = en;
let locale = "en-GB";

export function setLanguage(language: "en" | "de"): void {
  t = language === "de" ? de : en;
  locale = language === "de" ? "de-DE" : "en-GB";
}

/** Units of lengths that the service knows, as choices. */
export const UNITS: [string, string][] = ["mm", "cm", "m", "um", "nm", "inch", "pixel", "voxel", "none"].map((word) => [
  word,
  word === "um" ? "µm" : word,
]);

export const count = (value: number): string => value.toLocaleString(locale);

/** A number with as many digits as matter. */
export function number(value: number | null | undefined, digits = 4): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const style: Intl.NumberFormatOptions =
    size !== 0 && (size < 1e-3 || size >= 1e7)
      ? { notation: "scientific", maximumSignificantDigits: 3 }
      : size >= 10 ** (digits - 1)
        ? { maximumFractionDigits: 0 }
        : { maximumSignificantDigits: digits };
  return value.toLocaleString(locale, style).replaceAll("-", "−");
}
export const percent = (value: number | null | undefined, digits = 1): string =>
  value === null || value === undefined
    ? "–"
    : value.toLocaleString(locale, { style: "percent", maximumFractionDigits: digits });
export function probability(p: number | null | undefined): string {
  if (p === null || p === undefined) return "–";
  return p < 0.001
    ? `< ${(0.001).toLocaleString(locale)}`
    : p.toLocaleString(locale, { maximumFractionDigits: 3, minimumFractionDigits: 3 });
}
export const time = (text: string | null | undefined): string =>
  text ? new Date(text).toLocaleString(locale, { dateStyle: "medium", timeStyle: "short" }) : "–";
/** A measure with its unit: areas have the square, volumes the cube. */
export function unit(measure: string, length: string | null | undefined): string {
  if (!length) return "";
  if (measure === "area") return `${length}²`;
  if (measure === "volume") return `${length}³`;
  return ["length", "centroid_size"].includes(measure) ? length : "";
}
