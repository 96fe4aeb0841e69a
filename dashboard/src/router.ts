/** Addresses of views: the path names the thing, the query how it is looked at. Every state can be shared and gone back to. */
import { useCallback, useEffect, useState } from "preact/hooks";

const listeners = new Set<() => void>();
const tell = () => listeners.forEach((listener) => listener());
window.addEventListener("popstate", tell);

/** Links within the page are followed without loading it anew. */
document.addEventListener("click", (event) => {
  if (event.defaultPrevented || event.button !== 0 || event.metaKey || event.ctrlKey || event.shiftKey || event.altKey)
    return;
  const link = (event.target as Element | null)?.closest("a");
  if (!link || link.target || link.hasAttribute("download") || link.origin !== location.origin) return;
  if (link.pathname !== "/" && link.pathname !== "/app" && !link.pathname.startsWith("/app/")) return;
  event.preventDefault();
  if (link.href !== location.href) navigate(link.pathname + link.search);
});

export function navigate(url: string, replace = false): void {
  const leaves = new URL(url, location.href).pathname !== location.pathname;
  history[replace ? "replaceState" : "pushState"](null, "", url);
  tell();
  if (leaves) window.scrollTo(0, 0);
}

export function usePlace(): { path: string; query: URLSearchParams } {
  const [, update] = useState(0);
  useEffect(() => {
    const listener = () => update((count) => count + 1);
    listeners.add(listener);
    return () => void listeners.delete(listener);
  }, []);
  return { path: location.pathname, query: new URLSearchParams(location.search) };
}

/** One setting of a view in its address; the default is left out. */
export function useSetting(name: string, standard: string): [string, (value: string, replace?: boolean) => void] {
  const { query } = usePlace();
  const set = useCallback(
    (value: string, replace = true) => {
      const next = new URLSearchParams(location.search);
      if (value === standard) next.delete(name);
      else next.set(name, value);
      // Another order, or other rows, have other pages.
      if (["order", "unusual", "columns"].includes(name)) next.delete("cursor");
      navigate(location.pathname + (next.size ? `?${next}` : ""), replace);
    },
    [name, standard],
  );
  return [query.get(name) ?? standard, set];
}

/** The values of `{name}` in a pattern, or null if the path is another one. */
export function match(pattern: string, path: string): Record<string, string> | null {
  const wanted = pattern.split("/"),
    found = path.replace(/\/$/, "").split("/");
  if (wanted.length !== found.length) return null;
  const values: Record<string, string> = {};
  for (const [index, part] of wanted.entries()) {
    if (!part.startsWith("{")) {
      if (part !== found[index]) return null;
      continue;
    }
    try {
      values[part.slice(1, -1)] = decodeURIComponent(found[index]!);
    } catch {
      return null;
    }
  }
  return values;
}
