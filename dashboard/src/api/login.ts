/**
 * Login by an identity provider: the authorisation code flow with PKCE (RFC 7636) of a public client. Tokens are kept like keys, in
 * this tab. The code of the address is taken out of it before anything else happens.
 */
import { keyNow, onShared, setKey, setRenewal } from "./client";
import { leaveTabs, type Shared, shareLogin, tellTabs } from "./tabs";

export const RETURN = "/app/login";
/** What went wrong, as the name of a sentence, and whom or what it is about. */
export class LoginError extends Error {
  constructor(
    readonly reason: "insecure" | "away" | "elsewhere" | "stale" | "refused",
    readonly about = "",
  ) {
    super(reason);
  }
}

export interface Provider {
  issuer: string;
  client_id: string;
  scope: string;
}
interface Addresses {
  authorization_endpoint: string;
  token_endpoint: string;
}
interface Pending {
  state: string;
  verifier: string;
  token: string;
  client: string;
  back: string;
}
interface Session {
  token: string;
  client: string;
  refresh?: string;
  until: number;
}

const PENDING = "shapelex.login",
  SESSION = "shapelex.session";
/** Renewed after this part of the life of a token. */
const PART = 0.8;

const arrived = new URLSearchParams(location.pathname === RETURN ? location.search : "");
if (arrived.size) history.replaceState(null, "", RETURN);
export const hasArrived = (): boolean => arrived.has("state");

export const hostOf = (issuer: string): string => new URL(issuer).host;

export async function findProvider(): Promise<Provider | null> {
  const answer = await fetch("/app/login.json", { credentials: "omit" });
  return answer.ok ? ((await answer.json()) as { provider: Provider | null }).provider : null;
}

async function addressesOf({ issuer }: Provider): Promise<Addresses> {
  const answer = await fetch(`${issuer.replace(/\/$/, "")}/.well-known/openid-configuration`, {
    credentials: "omit",
  }).catch(() => null);
  if (!answer?.ok) throw new LoginError("away", hostOf(issuer));
  const found = (await answer.json()) as Addresses & { issuer: string };
  // The policy of the page allows the origin of the issuer only.
  const own = new URL(issuer).origin;
  if (found.issuer !== issuer || new URL(found.token_endpoint).origin !== own)
    throw new LoginError("elsewhere", hostOf(issuer));
  const start = new URL(found.authorization_endpoint);
  if (start.protocol !== "https:" && start.origin !== own) throw new LoginError("elsewhere", hostOf(issuer));
  return found;
}

const base64 = (bytes: Uint8Array): string =>
  btoa(String.fromCharCode(...bytes))
    .replace(/\+/g, "-")
    .replace(/\//g, "_")
    .replace(/=/g, "");
const secret = (): string => base64(crypto.getRandomValues(new Uint8Array(32)));

/** Leaves for the provider, which sends people back to [`RETURN`]. */
export async function begin(provider: Provider): Promise<void> {
  if (!crypto.subtle) throw new LoginError("insecure");
  const addresses = await addressesOf(provider);
  const back = location.pathname === RETURN ? "/" : location.pathname + location.search;
  const pending: Pending = {
    state: secret(),
    verifier: secret(),
    token: addresses.token_endpoint,
    client: provider.client_id,
    back,
  };
  sessionStorage.setItem(PENDING, JSON.stringify(pending));
  const digest = await crypto.subtle.digest("SHA-256", new TextEncoder().encode(pending.verifier));
  const target = new URL(addresses.authorization_endpoint);
  const query = {
    response_type: "code",
    client_id: provider.client_id,
    redirect_uri: location.origin + RETURN,
    scope: provider.scope,
    state: pending.state,
    code_challenge: base64(new Uint8Array(digest)),
    code_challenge_method: "S256",
  };
  for (const [name, value] of Object.entries(query)) target.searchParams.set(name, value);
  location.assign(target);
}

/** Exchanges the code with which the provider sent someone back; the address to go on with. */
export async function finish(): Promise<string> {
  const text = sessionStorage.getItem(PENDING);
  sessionStorage.removeItem(PENDING);
  const pending = text ? (JSON.parse(text) as Pending) : null;
  const state = arrived.get("state"),
    code = arrived.get("code"),
    error = arrived.get("error_description") ?? arrived.get("error");
  for (const name of [...arrived.keys()]) arrived.delete(name);
  if (!pending || state !== pending.state) throw new LoginError("stale");
  if (!code) throw new LoginError("refused", error ?? "");
  await exchange(pending, {
    grant_type: "authorization_code",
    code,
    redirect_uri: location.origin + RETURN,
    code_verifier: pending.verifier,
  });
  return pending.back;
}

async function exchange(
  { token, client }: { token: string; client: string },
  fields: Record<string, string>,
  refresh?: string,
): Promise<void> {
  const body = new URLSearchParams({ ...fields, client_id: client });
  const answer = await fetch(token, {
    method: "POST",
    body,
    credentials: "omit",
    headers: { accept: "application/json" },
  }).catch(() => null);
  if (!answer) throw new LoginError("away", new URL(token).host);
  const found = (await answer.json().catch(() => ({}))) as {
    access_token?: string;
    refresh_token?: string;
    expires_in?: number;
    error?: string;
    error_description?: string;
  };
  if (!answer.ok || !found.access_token) throw new LoginError("refused", found.error_description ?? found.error ?? "");
  setKey(found.access_token);
  keep({
    token,
    client,
    refresh: found.refresh_token ?? refresh,
    until: Date.now() + 1000 * PART * (found.expires_in ?? 300),
  });
  // Providers may take a refresh token once: the other tabs have to know the new one.
  tellTabs(shared()!);
}

let timer: ReturnType<typeof setTimeout> | undefined;
let renewing: Promise<boolean> | undefined;

function keep(session: Session): void {
  sessionStorage.setItem(SESSION, JSON.stringify(session));
  schedule(session);
}

function schedule(session: Session): void {
  clearTimeout(timer);
  if (session.refresh)
    timer = setTimeout(() => void renew(), Math.min(Math.max(session.until - Date.now(), 0), 2 ** 31 - 1));
}

export const hasSession = (): boolean => sessionStorage.getItem(SESSION) !== null;

/** Forgets the session; a key that someone pastes has none. */
export function forget(): void {
  clearTimeout(timer);
  sessionStorage.removeItem(SESSION);
}

/** A new token for an old one, if the provider gave the means; several callers wait for one answer. */
function renew(): Promise<boolean> {
  const text = sessionStorage.getItem(SESSION);
  const session = text ? (JSON.parse(text) as Session) : null;
  if (!session?.refresh) return Promise.resolve(false);
  const { refresh } = session;
  renewing ??= exchange(session, { grant_type: "refresh_token", refresh_token: refresh }, refresh)
    // Without a connection the refresh token stays good.
    .then(
      () => true,
      (error: LoginError) => {
        if (error.reason === "refused") forget();
        return false;
      },
    )
    .finally(() => {
      renewing = undefined;
    });
  return renewing;
}

const shared = (): Shared | null => {
  const key = keyNow();
  return key ? { key, session: sessionStorage.getItem(SESSION) } : null;
};

/** The login of another tab of this session. */
function take({ key, session }: Shared): void {
  setKey(key);
  if (session) keep(JSON.parse(session) as Session);
  else forget();
}

let whenLeft: () => void = () => {};
/** When another tab has logged out. */
export function onLeft(then: () => void): void {
  whenLeft = then;
}

/** Logs out, in all tabs of the session. */
export function leave(): void {
  forget();
  setKey(null);
  leaveTabs();
}

shareLogin(shared, take, () => {
  forget();
  setKey(null);
  whenLeft();
});
onShared(take);
setRenewal(renew);
const text = sessionStorage.getItem(SESSION);
if (text) keep(JSON.parse(text) as Session);
