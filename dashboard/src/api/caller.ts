/** Who is logged in, and what that lets one do: the page hides what a role may not do. */
import { useEffect, useState } from "preact/hooks";
import { get, onForbidden } from "./client";

export type Role = "reader" | "writer" | "admin";
export interface Caller {
  role: Role;
  tenant?: string | null;
  name?: string | null;
  /** An open service: everyone on its machine is an administrator. */
  open?: boolean;
}

const RANK: Record<Role, number> = { reader: 0, writer: 1, admin: 2 };
const listeners = new Set<() => void>();
/** Until the service has said something else, everything is offered: the service refuses what is not allowed. */
let caller: Caller | undefined;
let asked = false;

function set(value: Caller | undefined): void {
  caller = value;
  listeners.forEach((listener) => listener());
}

/** Asks the service anew, after a login. */
export async function findCaller(): Promise<void> {
  asked = true;
  const version = (await get("/v1/version", {})) as { caller?: Caller | null };
  set(version.caller ?? undefined);
}

export function forgetCaller(): void {
  asked = false;
  set(undefined);
}

// A refusal says which role the caller has.
onForbidden(({ detail }) => {
  const role = /the caller has the role (reader|writer)/.exec(detail)?.[1] as Role | undefined;
  if (!role) return;
  if (caller?.role !== role) set({ ...caller, role });
  whenTold(role);
});

let whenTold: (role: Role) => void = () => {};
/** When the service has refused something because of the role. */
export function onRole(then: (role: Role) => void): void {
  whenTold = then;
}

export function useCaller(): Caller | undefined {
  const [, update] = useState(0);
  useEffect(() => {
    const listener = () => update((count) => count + 1);
    listeners.add(listener);
    if (!asked) void findCaller().catch(() => {});
    return () => void listeners.delete(listener);
  }, []);
  return caller;
}

/** Whether the role may do what needs this one. */
export function useMay(role: Role): boolean {
  const known = useCaller();
  return !known || RANK[known.role] >= RANK[role];
}
