/** Lists, page after page. */
import type { Client } from "./client.js";
import { listChanges } from "./operations.js";
import type { Operation, Options, Schemas } from "./types.js";

interface Page<T> {
  items: T[];
  next?: string | null;
}

/** The pages of a list, each asked for when it is wanted. `page` gives the one at a cursor. */
export async function* pages<P extends Page<unknown>>(
  page: (cursor: string | undefined) => Promise<P>,
): AsyncGenerator<P, void> {
  let cursor: string | undefined;
  do {
    const answer = await page(cursor);
    yield answer;
    cursor = answer.next ?? undefined;
  } while (cursor !== undefined);
}

/** The entries of a list, page after page. */
export async function* entries<T>(page: (cursor: string | undefined) => Promise<Page<T>>): AsyncGenerator<T, void> {
  for await (const { items } of pages(page)) yield* items;
}

type Changes = Options<Operation<"get", "/v1/changes">>;

/** The changes after a number, until there are no more. The last one's `sequence` is the number to go on from. */
export async function* changes(
  client: Client,
  since = 0,
  options: Changes = {},
): AsyncGenerator<Schemas["ChangeOutput"], void> {
  for (let isDone = false; !isDone; ) {
    const { items, next, done } = await listChanges(client, { ...options, query: { ...options.query, since } });
    yield* items;
    [since, isDone] = [next, done];
  }
}
