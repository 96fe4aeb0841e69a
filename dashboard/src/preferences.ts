/** Language and colours: of the browser, unless chosen. They are no secret, and outlive the tab. */
import { useEffect, useState } from "preact/hooks";
import { setLanguage } from "./strings";

export type Theme = "auto" | "light" | "dark";
export type Language = "en" | "de";

const dark = matchMedia("(prefers-color-scheme: dark)");
const listeners = new Set<() => void>();
const stored = (name: string) => localStorage.getItem(`shapelex.${name}`);

let theme: Theme = (stored("theme") as Theme | null) ?? "auto";
let language: Language = (stored("language") as Language | null) ?? (navigator.language.startsWith("de") ? "de" : "en");

function apply(): void {
  document.documentElement.dataset.theme = shown();
  document.documentElement.lang = language;
  setLanguage(language);
  listeners.forEach((listener) => listener());
}

export const shown = (): "light" | "dark" => (theme === "auto" ? (dark.matches ? "dark" : "light") : theme);

export function choose(what: { theme?: Theme; language?: Language }): void {
  theme = what.theme ?? theme;
  language = what.language ?? language;
  localStorage.setItem("shapelex.theme", theme);
  localStorage.setItem("shapelex.language", language);
  apply();
}

export function usePreferences(): { theme: Theme; shown: "light" | "dark"; language: Language } {
  const [, update] = useState(0);
  useEffect(() => {
    const listener = () => update((count) => count + 1);
    listeners.add(listener);
    return () => void listeners.delete(listener);
  }, []);
  return { theme, shown: shown(), language };
}

dark.addEventListener("change", apply);
apply();
