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

/** Words of a view that is read on demand, which stand in a file beside it and not in those of the first view. */
export const ownWords = <T>(words: { en: T; de: T }): T => (t === de ? words.de : words.en);

/** Units of lengths that the service knows, as choices. */
export const UNITS: [string, string][] = ["mm", "cm", "m", "um", "nm", "inch", "pixel", "voxel", "none"].map((word) => [
  word,
  word === "um" ? "µm" : word,
]);

/** Sentences of the service by their form, for the languages that have them; they are read when the first one is shown. */
let sentences: [RegExp, string][] | undefined;

/** Reads the sentences of the language, if it has some that are not there yet. */
export function readSentences(then: () => void): void {
  if (t === en || sentences) return;
  import("./sentences.de").then(
    (found) => {
      sentences = found.SENTENCES;
      then();
    },
    () => {},
  );
}

/** A part of a sentence, with the decimal point of the language if it is a number. */
const inLocale = (part: string): string => (/^-?\d+\.\d+(e-?\d+)?$/.test(part) ? part.replace(".", ",") : part);

/** A sentence of the service in the language of the page, where its form is known; null of all others. */
export function translated(text: string): string | null {
  if (t === en) return null;
  for (const [form, own] of sentences ?? []) {
    const parts = form.exec(text);
    if (parts)
      return own
        .replace(/\$(~?)(\d)/g, (_, deep: string, at: string) => {
          const part = parts[Number(at)] ?? "";
          return (deep && translated(part)) || inLocale(part);
        })
        .trim();
  }
  return null;
}

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
/** The number that someone has written in the way of the language, with its decimal comma; null of anything else. */
export function entered(text: string): number | null {
  const trimmed = text.trim().replace("−", "-");
  const groups = locale === "de-DE" ? /^-?\d{1,3}(\.\d{3})+(,\d+)?$/ : /^-?\d{1,3}(,\d{3})+(\.\d+)?$/;
  const plain =
    locale === "de-DE"
      ? (groups.test(trimmed) ? trimmed.replaceAll(".", "") : trimmed).replace(",", ".")
      : groups.test(trimmed)
        ? trimmed.replaceAll(",", "")
        : trimmed;
  return /^-?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(plain) ? Number(plain) : null;
}
/** A part as a percentage, with a space that does not break: as German has it, and the fixed sentences in English. */
export const percent = (value: number | null | undefined, digits = 1): string =>
  value === null || value === undefined
    ? "–"
    : value.toLocaleString(locale, { style: "percent", maximumFractionDigits: digits }).replace(/\s?%/, "\u00a0%");
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
