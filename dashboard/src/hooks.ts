/** What views ask of the service, and what they remember. */
import { useCallback, useEffect, useRef, useState } from "preact/hooks";
import { authorization, Refusal, type Schemas } from "./api/client";

export interface Loaded<T> {
  data: T | undefined;
  error: Error | undefined;
  loading: boolean;
  reload: () => void;
}

/** Asks when `key` changes; the last answer stays until the next one has come. */
export function useLoaded<T>(key: string | null, ask: (signal: AbortSignal) => Promise<T>): Loaded<T> {
  const [state, setState] = useState<{ data?: T; error?: Error; loading: boolean; key: string | null }>({
    loading: key !== null,
    key: null,
  });
  const [round, setRound] = useState(0);
  const asked = useRef(ask);
  asked.current = ask;
  useEffect(() => {
    if (key === null) {
      setState({ loading: false, key });
      return;
    }
    const abort = new AbortController();
    setState((before) => ({ ...before, loading: true }));
    asked.current(abort.signal).then(
      (data) => !abort.signal.aborted && setState({ data, loading: false, key }),
      (error: Error) =>
        !abort.signal.aborted &&
        setState((before) => ({
          ...before,
          error,
          data: error instanceof Refusal ? undefined : before.data,
          loading: false,
          key,
        })),
    );
    return () => abort.abort();
  }, [key, round]);
  const reload = useCallback(() => setRound((count) => count + 1), []);
  return { data: state.data, error: state.error, loading: state.loading, reload };
}

/** One action at a time, with its refusal. */
export function useAction<A extends unknown[]>(
  act: (...values: A) => Promise<void>,
): { run: (...values: A) => void; busy: boolean; error: Error | undefined; clear: () => void } {
  const [state, setState] = useState<{ busy: boolean; error?: Error }>({ busy: false });
  const run = (...values: A) => {
    setState({ busy: true });
    act(...values).then(
      () => setState({ busy: false }),
      (error: Error) => setState({ busy: false, error: error.name === "AbortError" ? undefined : error }),
    );
  };
  return { run, busy: state.busy, error: state.error, clear: () => setState({ busy: false }) };
}

export type Event = Schemas["TenantEvent"];

/** Follows `/v1/events`, again after a lost connection. An `EventSource` cannot send a key; `fetch` can. */
export function useEvents(kinds: string[], then: (kind: string, data: Record<string, unknown>) => void): boolean {
  const [live, setLive] = useState(false);
  const handler = useRef(then);
  handler.current = then;
  const names = kinds.join(",");
  useEffect(() => {
    let abort = new AbortController();
    let last = "";
    const follow = async ({ signal }: AbortController): Promise<void> => {
      let wait = 1000;
      while (!signal.aborted) {
        try {
          const headers: Record<string, string> = { accept: "text/event-stream", ...authorization() };
          if (last) headers["last-event-id"] = last;
          const response = await fetch(`/v1/events?kind=${names}`, { headers, signal, credentials: "omit" });
          if (!response.ok || !response.body) {
            if (response.status < 500 && response.status !== 429) return;
            throw new Error(response.statusText);
          }
          setLive(true);
          wait = 1000;
          await read(response.body, (event) => {
            if (event.id) last = event.id;
            if (event.data) handler.current(event.name, JSON.parse(event.data) as Record<string, unknown>);
          });
        } catch {
          if (signal.aborted) return;
        }
        setLive(false);
        await new Promise((resolve) => setTimeout(resolve, wait));
        wait = Math.min(2 * wait, 30_000);
      }
    };
    // Browsers allow few connections to a service: tabs that nobody looks at do without, and catch up when they are shown.
    const look = () => {
      abort.abort();
      abort = new AbortController();
      if (!document.hidden) void follow(abort);
    };
    document.addEventListener("visibilitychange", look);
    look();
    return () => {
      document.removeEventListener("visibilitychange", look);
      abort.abort();
    };
  }, [names]);
  return live;
}

async function read(
  body: ReadableStream<Uint8Array>,
  then: (event: { name: string; id: string; data: string }) => void,
): Promise<void> {
  const reader = body
    .pipeThrough(new TextDecoderStream() as unknown as ReadableWritablePair<string, Uint8Array>)
    .getReader();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const parts = (rest + value).split("\n\n");
    rest = parts.pop()!;
    for (const part of parts) {
      const event = { name: "message", id: "", data: "" };
      for (const line of part.split("\n")) {
        if (line.startsWith("event: ")) event.name = line.slice(7);
        else if (line.startsWith("id: ")) event.id = line.slice(4);
        else if (line.startsWith("data: ")) event.data += line.slice(6);
      }
      then(event);
    }
  }
}

/** Width of an element, for drawings that follow it. */
export function useWidth<E extends HTMLElement>(): [{ current: E | null }, number] {
  const ref = useRef<E>(null);
  const [width, setWidth] = useState(0);
  useEffect(() => {
    if (!ref.current) return;
    const observer = new ResizeObserver(([entry]) => setWidth(Math.floor(entry!.contentRect.width)));
    observer.observe(ref.current);
    return () => observer.disconnect();
  }, []);
  return [ref, width];
}

/** Waits until typing has paused. */
export function useSettled<T>(value: T, pause = 250): T {
  const [settled, setSettled] = useState(value);
  useEffect(() => {
    const timer = setTimeout(() => setSettled(value), pause);
    return () => clearTimeout(timer);
  }, [value, pause]);
  return settled;
}
