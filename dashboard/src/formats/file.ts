/**
 * Files of shapes. The service reads them, whatever program they are of: it says what is in one, stores its shapes, and answers them
 * as lines of JSON. What the page reads itself are the bodies of the API: they are requests, not files.
 */
import { get, type Schemas, search, send } from "../api/client";
import { postImage } from "../api/jobs";

export type Input = Schemas["ShapeInput"];
export type Format = Schemas["FormatEntry"];
export type Found = Schemas["InspectAnswer"];
/** Parameters of a file by their names: its format, and how it is read. */
export type Reading = Record<string, string>;

/** A shape of a file, as a line of NDJSON: points on it, or a mesh, or coefficients. */
export interface Line {
  external_id?: string;
  points?: number[][];
  vertices?: number[][];
  faces?: number[][];
  /** Of curves: whether the last point is joined with the first one. */
  closed?: boolean | null;
}

export const ANY_FILE = { "content-type": "application/octet-stream" };
const bare = (name: string) => name.replace(/\.[^.]*$/, "");

/** The formats that the service reads. */
export const formats = async (signal: AbortSignal): Promise<Format[]> =>
  (await get("/v1/formats", { signal })).items.filter((one) => one.read);

/** What is in a file, without storing it. */
export async function inspected(file: File, reading: Reading, signal?: AbortSignal): Promise<Found> {
  const response = await send("POST", `/v1/inspect${search({ name: file.name, ...reading })}`, {
    body: file,
    headers: ANY_FILE,
    signal,
  });
  return response.json() as Promise<Found>;
}

/** The shapes of a file as lines. */
export async function linesOf(file: File, signal?: AbortSignal): Promise<Line[]> {
  const response = await send("POST", `/v1/convert${search({ name: file.name, to: "ndjson" })}`, {
    body: file,
    headers: { ...ANY_FILE, accept: "*/*" },
    signal,
  });
  return parsedLines(await response.text());
}

const parsedLines = (text: string): Line[] =>
  text
    .split("\n")
    .filter((line) => line.trim())
    .map((line) => JSON.parse(line) as Line);

/** A body of `POST /v1/cohorts/{cohort}/shapes` that someone keeps as a file. */
export interface Kept {
  type: string;
  body: Blob;
  /** Its shapes, where the page has read them. */
  shapes?: Input[];
}

/** What is read of lines to know whether they are shapes of the API. */
const HEAD = 1 << 16;

/**
 * The body of the API in a file; null in files of other programs. Documents and lines of shapes may have control points, which no
 * format of files has, and of lines the service names every bad one, where a file ends at its first fault. Lines with meshes or
 * coefficients are a file.
 *
 * @throws {SyntaxError} when a `.json` file is not JSON.
 */
export async function keptBody(file: File): Promise<Kept | null> {
  if (/\.(ndjson|jsonl)$/i.test(file.name)) {
    const [first = ""] = (await file.slice(0, HEAD).text()).trimStart().split("\n");
    return /"(vertices|fourier)"\s*:/.test(first) ? null : { type: "application/x-ndjson", body: file };
  }
  if (!/\.json$/i.test(file.name)) return null;
  const shapes = shapesOfDocument(JSON.parse(await file.text()), bare(file.name));
  return shapes && { type: "application/json", body: new Blob([JSON.stringify({ shapes })]), shapes };
}

const isShape = (value: unknown): boolean =>
  typeof value === "object" && value !== null && ("points" in value || "control_points" in value);

/** The shapes of `{"shapes": […]}`, of a list of shapes, of one shape, or of points alone; null of any other document. */
function shapesOfDocument(value: unknown, name: string): Input[] | null {
  if (Array.isArray(value)) {
    if (value.length && value.every(isShape)) return value as Input[];
    return Array.isArray(value[0]) && typeof value[0][0] === "number"
      ? [{ external_id: name, points: value } as Input]
      : null;
  }
  const shapes = (value as { shapes?: unknown } | null)?.shapes;
  if (Array.isArray(shapes)) return shapes as Input[];
  return isShape(value) ? [{ external_id: name, ...(value as object) } as Input] : null;
}

/** The shapes of a file with a body of the API, to be looked at one by one; null in files of other programs. */
export async function keptLines(file: File): Promise<(Input | Line)[] | null> {
  const kept = await keptBody(file);
  return kept && (kept.shapes ?? parsedLines(await file.text()));
}

/** Cells below which a component of a mask is a speck. */
const SPECK = 20;

/** Contours of the labels of a mask in the plane, without specks, which a file of labels would have as shapes. */
export async function contoursOf(file: File, name: string): Promise<Line[]> {
  const answer = await postImage<Schemas["ContoursAnswer"]>("/v1/contours", { least_cells: SPECK }, file);
  return answer.results.map((one) => ({
    external_id: `${name}-${one.label}${one.component ? `-${one.component}` : ""}`,
    points: (one as { points: number[][] }).points,
  }));
}

/** The first shapes of a file, to be looked at: reading ends when there are enough. */
export async function firstOf(file: File, reading: Reading, most: number, signal?: AbortSignal): Promise<Line[]> {
  const response = await send("POST", `/v1/convert${search({ name: file.name, ...reading, to: "ndjson" })}`, {
    body: file,
    headers: { ...ANY_FILE, accept: "*/*" },
    signal,
  });
  const reader = response.body!.getReader(),
    decoder = new TextDecoder();
  const read = async (text: string): Promise<string> => {
    if (text.split("\n").length > most) return text;
    const { done, value } = await reader.read();
    return done ? text : read(text + decoder.decode(value, { stream: true }));
  };
  const text = await read("");
  await reader.cancel().catch(() => {});
  return parsedLines(text.split("\n").slice(0, most).join("\n"));
}

/** A document or lines of the API as a file that the service looks into. */
export async function asFile(file: File): Promise<{ file: File; kept?: Kept }> {
  const kept = await keptBody(file);
  if (!kept?.shapes) return { file, kept: kept ?? undefined };
  const lines = kept.shapes.map((shape) => JSON.stringify(shape)).join("\n");
  return { file: new File([lines], `${bare(file.name)}.ndjson`), kept };
}
