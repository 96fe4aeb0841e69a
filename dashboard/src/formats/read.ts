/** Files of contours and landmarks as shapes of the API: JSON, lines, GeoJSON, CSV, TPS; label images by the service. */
import { postImage, type Schemas } from "../api/client";

export type Input = Schemas["ShapeInput"];
export const ACCEPT = ".json,.ndjson,.jsonl,.geojson,.csv,.tps,.png,.tif,.tiff,.nii,.gz";

const bare = (name: string) => name.replace(/\.[^.]*$/, "");
export const isImage = (name: string): boolean => /\.(png|tiff?|nii|nii\.gz)$/i.test(name);
export const isLines = (name: string): boolean => /\.(ndjson|jsonl)$/i.test(name);

/** The shapes of a file. Lines are left to the service, which names the bad ones. */
export async function shapesOf(file: File, signal?: AbortSignal): Promise<Input[]> {
  if (isImage(file.name)) return ofLabels(file, signal);
  const text = await file.text();
  if (isLines(file.name)) return text.split("\n").filter((line) => line.trim()).map((line) => JSON.parse(line) as Input);
  if (/\.csv$/i.test(file.name)) return ofTable(text, bare(file.name));
  if (/\.tps$/i.test(file.name)) return ofTps(text);
  return ofJson(JSON.parse(text), bare(file.name));
}

/** Contours of the labels of a mask in the plane. */
export async function ofLabels(file: File, signal?: AbortSignal): Promise<Input[]> {
  const answer = await postImage<Schemas["ContoursAnswer"]>("/v1/contours", { least_cells: 20 }, file, signal);
  return answer.results.map((one) => ({
    external_id: `${bare(file.name)}-${one.label}${one.component ? `-${one.component}` : ""}`, points: (one as { points?: number[][] }).points,
  })) as Input[];
}

function ofJson(value: unknown, name: string): Input[] {
  if (Array.isArray(value)) return value.length && Array.isArray(value[0]) && typeof value[0][0] === "number" ? [{ external_id: name, points: value } as Input] : (value as Input[]);
  const object = value as { type?: string; features?: Feature[]; shapes?: Input[]; geometry?: unknown };
  if (object.shapes) return object.shapes;
  if (object.type === "FeatureCollection") return (object.features ?? []).flatMap((feature, index) => ofFeature(feature, `${name}-${index + 1}`));
  if (object.type === "Feature") return ofFeature(object as Feature, name);
  return [{ external_id: name, ...(value as object) } as Input];
}

interface Feature {
  id?: string | number;
  geometry: { type: string; coordinates: unknown } | null;
  properties?: { [name: string]: unknown } | null;
}

function ofFeature(feature: Feature, name: string): Input[] {
  const id = feature.id === undefined ? name : String(feature.id);
  const kind = feature.properties?.classification as { name?: string } | undefined;
  const label = kind?.name ?? (typeof feature.properties?.label === "string" ? feature.properties.label : undefined);
  const ring = (points: number[][]) => (points.length > 1 && points[0]!.every((value, index) => value === points[points.length - 1]![index]) ? points.slice(0, -1) : points);
  const one = (points: number[][], suffix = ""): Input => ({ external_id: id + suffix, ...(label ? { label } : {}), points: ring(points) }) as Input;
  const geometry = feature.geometry;
  if (geometry?.type === "Polygon") return [one((geometry.coordinates as number[][][])[0]!)];
  if (geometry?.type === "MultiPolygon") return (geometry.coordinates as number[][][][]).map((polygon, index) => one(polygon[0]!, `-${index + 1}`));
  if (geometry?.type === "LineString") return [one(geometry.coordinates as number[][])];
  return [{ external_id: id } as Input];
}

/** Columns `x`, `y` and perhaps `z`; `id` separates shapes, `label` names their group. */
function ofTable(text: string, name: string): Input[] {
  const rows = text.split(/\r?\n/).filter((line) => line.trim()).map((line) => line.split(/[,;\t]/).map((cell) => cell.trim().replace(/^"|"$/g, "")));
  const head = rows[0]!.map((cell) => cell.toLowerCase());
  const wide = head.flatMap((cell, column) => { const found = /^([xyz])(\d+)$/.exec(cell); return found ? [{ axis: found[1]!, number: Number(found[2]), column }] : []; });
  if (wide.length > 1) return ofWideTable(rows, head, wide);
  const named = head.includes("x") && head.includes("y");
  const columns = named ? (["x", "y", "z"] as const).map((axis) => head.indexOf(axis)).filter((index) => index >= 0) : rows[0]!.map((_, index) => index).slice(0, 3);
  const id = head.findIndex((cell) => ["id", "external_id", "shape"].includes(cell)), label = head.indexOf("label");
  const shapes = new Map<string, Input & { points: number[][] }>();
  for (const row of rows.slice(named ? 1 : 0)) {
    const key = id >= 0 && named ? row[id]! : name;
    const shape = shapes.get(key) ?? ({ external_id: key, ...(label >= 0 && named ? { label: row[label] } : {}), points: [] } as unknown as Input & { points: number[][] });
    shape.points.push(columns.map((column) => Number(row[column])));
    shapes.set(key, shape);
  }
  return [...shapes.values()];
}

/** A row is a shape: columns `x1`, `y1`, `x2`, …; other columns are attributes. */
function ofWideTable(rows: string[][], head: string[], wide: { axis: string; number: number; column: number }[]): Input[] {
  const order = [...wide].sort((a, b) => a.number - b.number || a.axis.localeCompare(b.axis));
  const places = [...new Set(order.map((one) => one.number))].map((number) => order.filter((one) => one.number === number).map((one) => one.column));
  const id = head.findIndex((cell) => ["id", "external_id", "shape"].includes(cell)), label = head.indexOf("label");
  const others = head.flatMap((_, column) => (column === id || column === label || wide.some((one) => one.column === column) ? [] : [[rows[0]![column]!, column] as const]));
  const value = (text: string) => (text !== "" && Number.isFinite(Number(text)) ? Number(text) : text);
  return rows.slice(1).map((row, at) => ({
    external_id: id >= 0 ? row[id] : `row-${at + 1}`, ...(label >= 0 ? { label: row[label] } : {}),
    ...(others.length ? { labels: Object.fromEntries(others.filter(([, column]) => row[column] !== "").map(([name, column]) => [name, value(row[column]!)])) } : {}),
    points: places.map((columns) => columns.map((column) => Number(row[column]))),
  })) as Input[];
}

/** Landmarks of tpsDig: `LM=n`, n rows, then `ID=` or `IMAGE=`, `SCALE=`. */
function ofTps(text: string): Input[] {
  const shapes: (Input & { points: number[][] })[] = [];
  let left = 0;
  for (const line of text.split(/\r?\n/)) {
    const field = /^\s*([A-Z]+\d?)\s*=\s*(.*?)\s*$/i.exec(line);
    const shape = shapes[shapes.length - 1];
    if (field && /^LM3?$/i.test(field[1]!)) {
      shapes.push({ external_id: `shape-${shapes.length + 1}`, points: [] } as unknown as Input & { points: number[][] });
      left = Number(field[2]);
    } else if (field && shape) {
      const name = field[1]!.toUpperCase(), value = field[2]!;
      if (name === "IMAGE" && /^shape-/.test(shape.external_id ?? "")) shape.external_id = bare(value);
      if (name === "ID" && value) shape.external_id = value;
      if (name === "SCALE" && Number(value) > 0) shape.points = shape.points.map((point) => point.map((x) => x * Number(value)));
    } else if (left > 0 && line.trim() && shape) {
      shape.points.push(line.trim().split(/\s+/).map(Number));
      left--;
    }
  }
  return shapes;
}
