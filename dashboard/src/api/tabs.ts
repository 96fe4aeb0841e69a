/**
 * One login for the tabs of a session: a tab without a key asks the others, which answer over a channel of this origin in this browser.
 * Nothing is written down: the last tab that closes takes the key with it.
 */
const channel = typeof BroadcastChannel === "undefined" ? undefined : new BroadcastChannel("shapelex.login");
/** Milliseconds that other tabs have to answer. */
const PATIENCE = 250;

export interface Shared {
  key: string;
  /** What renews a token of an identity provider, where there is one. */
  session: string | null;
}
type Message = { kind: "ask" } | ({ kind: "key" } & Shared) | { kind: "forget" };

let own: () => Shared | null = () => null;
let taken: (shared: Shared) => void = () => {};
let left: () => void = () => {};
let waiting: ((shared: Shared | null) => void) | undefined;

channel?.addEventListener("message", ({ data }: MessageEvent<Message>) => {
  if (data.kind === "ask") {
    const shared = own();
    if (shared) channel.postMessage({ kind: "key", ...shared });
  } else if (data.kind === "key") {
    const shared = { key: data.key, session: data.session };
    if (waiting) waiting(shared);
    else if (own()) taken(shared);
  } else if (own()) left();
});

/** What this tab has, what it does with a key of another one, and when another one has logged out. */
export function shareLogin(has: () => Shared | null, take: (shared: Shared) => void, leave: () => void): void {
  [own, taken, left] = [has, take, leave];
}

let asking: Promise<Shared | null> | undefined;

/** The key of another tab; null where none has one. Several callers wait for one answer. */
export function askTabs(): Promise<Shared | null> {
  if (!channel) return Promise.resolve(null);
  asking ??= new Promise<Shared | null>((resolve) => {
    waiting = resolve;
    setTimeout(resolve, PATIENCE, null);
    channel.postMessage({ kind: "ask" } satisfies Message);
  }).finally(() => {
    waiting = asking = undefined;
  });
  return asking;
}

export function tellTabs(shared: Shared): void {
  channel?.postMessage({ kind: "key", ...shared } satisfies Message);
}
export function leaveTabs(): void {
  channel?.postMessage({ kind: "forget" } satisfies Message);
}
