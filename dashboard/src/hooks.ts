/** What views ask of the service, and what they remember. */
import { useCallback, useEffect, useRef, useState } from "preact/hooks";
import { listEvents } from "../../clients/typescript/src/index";
import { Refusal, type Schemas, service } from "./api/client";

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

/**
 * Asks for what a hand moves: one request at a time, and after each the newest wish, so that none waits in a queue. The last answer and
 * its refusal stay until the next one has come.
 */
export function useFollowed<T>(key: string | null, ask: (signal: AbortSignal) => Promise<T>) {
  const [state, setState] = useState<{ data?: T; error?: Error; key: string | null }>({ key: null });
  const wanted = useRef({ key, ask });
  wanted.current = { key, ask };
  const busy = useRef(false);
  const gone = useRef<AbortController>(undefined);
  useEffect(() => {
    gone.current = new AbortController();
    return () => gone.current!.abort();
  }, []);
  useEffect(() => {
    if (busy.current || key === null) return;
    busy.current = true;
    const { signal } = gone.current!;
    const next = (): void => {
      const now = wanted.current;
      if (now.key === null) {
        busy.current = false;
        return;
      }
      const then = (found: { data?: T; error?: Error }) => {
        if (signal.aborted) return;
        setState({ ...found, key: now.key });
        if (wanted.current.key !== now.key) next();
        else busy.current = false;
      };
      now.ask(signal).then(
        (data) => then({ data }),
        (error: Error) => then({ error }),
      );
    };
    next();
  }, [key]);
  return { data: state.data, error: state.error, waits: key !== null && state.key !== key };
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
    let last: string | undefined;
    const follow = async ({ signal }: AbortController): Promise<void> => {
      const events = listEvents(service, {
        query: { kind: names },
        lastEventId: last,
        tries: Number.POSITIVE_INFINITY,
        onConnection: (connected) => signal.aborted || setLive(connected),
        onPosition: (id) => (last = id),
        signal,
      });
      for await (const { kind, data } of events) handler.current(kind, { ...data });
    };
    // Browsers allow few connections to a service: tabs that nobody looks at do without, and catch up when they are shown.
    const look = () => {
      abort.abort();
      abort = new AbortController();
      if (!document.hidden) follow(abort).catch(() => {});
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
