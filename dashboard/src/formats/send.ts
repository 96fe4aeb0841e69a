/** Files on their way into a cohort: a request whose progress can be seen, and tables of attributes. */
import { authorization, get, type Problem, post, Refusal, Said, type Schemas, search, send } from "../api/client";
import { t } from "../strings";
import { ANY_FILE, type Kept, type Reading } from "./file";

export interface Sent {
  done: Promise<Schemas["AddAnswer"]>;
  stop: () => void;
}

/** A request whose progress can be seen, which `fetch` does not show. */
function upload(url: string, type: string, body: Blob, key: string, progress: (part: number) => void): Sent {
  const request = new XMLHttpRequest();
  const done = new Promise<Schemas["AddAnswer"]>((resolve, reject) => {
    request.open("POST", url);
    for (const [name, value] of Object.entries({
      "content-type": type,
      accept: "application/json",
      "idempotency-key": key,
      ...authorization(),
    }))
      request.setRequestHeader(name, value);
    request.upload.onprogress = (event) => event.lengthComputable && progress(event.loaded / event.total);
    request.onload = () => {
      if (request.status < 300) return resolve(JSON.parse(request.responseText) as Schemas["AddAnswer"]);
      try {
        reject(new Refusal(JSON.parse(request.responseText) as Problem));
      } catch {
        reject(new Error(request.statusText));
      }
    };
    request.onerror = () => reject(new TypeError("network"));
    request.onabort = () => reject(new Said(t.upload.stopped));
    request.send(body);
  });
  return { done, stop: () => request.abort() };
}

/** Sends a file to a cohort: as it is with its name and parameters, or the body of the API that it holds. */
export function sendTo(
  cohort: string,
  file: File,
  kept: Kept | undefined,
  onError: string,
  parameters: Reading,
  progress: (part: number) => void,
): Sent {
  const query = { return: "none", on_error: onError, ...(kept ? {} : { name: file.name, ...parameters }) };
  return upload(
    `/v1/cohorts/${encodeURIComponent(cohort)}/shapes${search(query)}`,
    kept?.type ?? ANY_FILE["content-type"],
    kept?.body ?? file,
    crypto.randomUUID(),
    progress,
  );
}

/** What is read of a file to know whether it is a table of attributes. */
const HEAD = 1 << 14;

/** The columns of a table of attributes: it names shapes, and has no coordinates. Null of any other file. */
export async function attributeColumns(file: File): Promise<string[] | null> {
  if (!/\.(csv|tsv|txt)$/i.test(file.name)) return null;
  const [head = ""] = (await file.slice(0, HEAD).text()).replace(/^\uFEFF/, "").split(/\r?\n/);
  const columns = head.split(/[,;\t]/).map((name) => name.trim().replace(/^"(.*)"$/, "$1"));
  const names = columns.some((name) => /^(id|external_id)$/i.test(name));
  return names && columns.length > 1 && !columns.some((name) => /^[xyz][_ ]?\d*$/i.test(name)) ? columns : null;
}

/** Numbers of tables that semicolons or tabs divide have points in place of decimal commas. */
async function withPoints(file: Blob): Promise<Blob> {
  const text = await file.text();
  const [head = ""] = text.split(/\r?\n/);
  if (!/[;\t]/.test(head) || head.includes(",")) return file;
  return new Blob([text.replace(/(^|[;\t\n])(-?\d+),(\d+)(?=[;\t\r\n]|$)/g, "$1$2.$3")]);
}

/** Attributes by id from a table; `dry` only counts. */
export async function sendAttributes(
  cohort: string,
  file: Blob,
  dry: boolean,
  onError = "skip",
): Promise<Schemas["BulkAnswer"]> {
  const response = await send(
    "POST",
    `/v1/cohorts/${encodeURIComponent(cohort)}/attributes${search({ on_error: onError, ...(dry ? { dry_run: true } : {}) })}`,
    { body: await withPoints(file), headers: { "content-type": "text/csv" } },
  );
  return response.json() as Promise<Schemas["BulkAnswer"]>;
}

type Values = (string | number | boolean | null)[];

/** Attributes of shapes as they are, as edits that bring them back: a value that is missing is removed again. */
export async function attributesNow(
  cohort: string,
  names: string[],
  select: { ids?: string[]; filter?: Schemas["ShapeFilter"] },
): Promise<Record<string, unknown>[]> {
  const { items } = await get("/v1/cohorts/{cohort}/attributes", { path: { cohort }, query: { values: 1, bins: 1 } });
  const asked = names.filter((name) => items.some((one) => one.name === name));
  const table = (await post("/v1/cohorts/{cohort}/table", {
    path: { cohort },
    body: { columns: ["id", "external_id", ...asked], filter: select.filter } as never,
  })) as unknown as Schemas["TableAnswer"];
  const column = (at: number) => table.columns[at]!.values as Values;
  const wanted = select.ids && new Set(select.ids);
  return column(0).flatMap((id, row) => {
    if (wanted && !wanted.has(String(id)) && !wanted.has(String(column(1)[row]))) return [];
    const edit: Record<string, unknown> = { id },
      labels: Record<string, unknown> = {};
    for (const name of names) {
      const value = asked.includes(name) ? (column(asked.indexOf(name) + 2)[row] ?? null) : null;
      if (name.startsWith("labels.")) labels[name.slice(7)] = value;
      else edit[name] = value;
    }
    return [Object.keys(labels).length ? { ...edit, labels } : edit];
  });
}

/** Brings attributes back that [`attributesNow`] has kept. */
export async function restoreAttributes(cohort: string, edits: Record<string, unknown>[]): Promise<void> {
  await post("/v1/cohorts/{cohort}/attributes", { path: { cohort }, body: { shapes: edits } as never });
}
