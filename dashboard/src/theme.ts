/** Colours: of the browser, unless chosen. The choice is no secret, and outlives the tab. */
import { useEffect, useState } from "preact/hooks";

export type Theme = "auto" | "light" | "dark";

const dark = matchMedia("(prefers-color-scheme: dark)");
const listeners = new Set<() => void>();
let theme: Theme = (localStorage.getItem("shapelex.theme") as Theme | null) ?? "auto";

export const shown = (): "light" | "dark" => (theme === "auto" ? (dark.matches ? "dark" : "light") : theme);

function apply(): void {
  document.documentElement.dataset.theme = shown();
  listeners.forEach((listener) => listener());
}

export function chooseTheme(value: Theme): void {
  theme = value;
  localStorage.setItem("shapelex.theme", theme);
  apply();
}

export function useTheme(): { theme: Theme; shown: "light" | "dark" } {
  const [, update] = useState(0);
  useEffect(() => {
    const listener = () => update((count) => count + 1);
    listeners.add(listener);
    return () => void listeners.delete(listener);
  }, []);
  return { theme, shown: shown() };
}

dark.addEventListener("change", apply);
apply();
