/** Language: of the browser, unless chosen. It is no secret, and outlives the tab. */
import { useEffect, useState } from "preact/hooks";
import { setLanguage } from "./strings";

export type Language = "en" | "de";

const listeners = new Set<() => void>();
const stored = localStorage.getItem("shapelex.language") as Language | null;
let language: Language = stored ?? (navigator.language.startsWith("de") ? "de" : "en");

function apply(): void {
  document.documentElement.lang = language;
  setLanguage(language);
  listeners.forEach((listener) => listener());
}

export function chooseLanguage(value: Language): void {
  language = value;
  localStorage.setItem("shapelex.language", language);
  apply();
}

export function useLanguage(): Language {
  const [, update] = useState(0);
  useEffect(() => {
    const listener = () => update((count) => count + 1);
    listeners.add(listener);
    return () => void listeners.delete(listener);
  }, []);
  return language;
}

apply();
