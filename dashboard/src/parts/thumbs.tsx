/** Small pictures of shapes of a file that is not stored yet: contours, landmarks, and meshes as their faces. */
import type { Line } from "../formats/file";
import { t } from "../strings";

/** Faces of a mesh that are drawn. */
const FACES = 2500;

type Flat = [number, number];

/** Onto the screen: the plane as it is with y upwards, space from the front, the right and above. */
const flat = (p: number[]): Flat =>
  p.length < 3 ? [p[0]!, -p[1]!] : [0.83 * p[0]! - 0.56 * p[1]!, -(0.3 * p[0]! + 0.45 * p[1]! + 0.84 * p[2]!)];

function pathOf({ points, vertices, faces, closed }: Line): { d: string; places: Flat[]; dots: boolean } {
  if (vertices) {
    const places = vertices.map(flat),
      step = Math.max(1, Math.ceil((faces?.length ?? 0) / FACES));
    const some = (faces ?? []).filter((_, at) => at % step === 0);
    const at = (index: number) => (places[index] ?? [0, 0]).map((x) => x.toPrecision(5)).join(" ");
    return { d: some.map((face) => `M${face.map(at).join("L")}Z`).join(""), places, dots: false };
  }
  const places = (points ?? []).filter((p) => Array.isArray(p) && p.every((x) => typeof x === "number")).map(flat);
  const dots = closed === undefined && !!points;
  const text = places.map((p) => p.map((x) => x.toPrecision(5)).join(" "));
  return {
    d: dots ? text.map((p) => `M${p}h0`).join("") : text.length ? `M${text.join("L")}${closed ? "Z" : ""}` : "",
    places,
    dots,
  };
}

export function Thumb({ line }: { line: Line }) {
  const { d, places, dots } = pathOf(line);
  const [xs, ys] = [0, 1].map((axis) => places.map((p) => p[axis]!)) as [number[], number[]];
  const least = (values: number[]) => values.reduce((low, value) => Math.min(low, value), Infinity);
  const most = (values: number[]) => values.reduce((high, value) => Math.max(high, value), -Infinity);
  const size = Math.max(most(xs) - least(xs), most(ys) - least(ys), 1e-9) * 1.12;
  const view = `${(most(xs) + least(xs) - size) / 2} ${(most(ys) + least(ys) - size) / 2} ${size} ${size}`;
  return (
    <figure class="thumb">
      {places.length > 0 && (
        <svg viewBox={view} role="img" aria-label={line.external_id ?? t.words.shape}>
          <path class={`line${dots ? " dots" : line.vertices ? " mesh" : ""}`} d={d} />
        </svg>
      )}
      <figcaption title={line.external_id}>{line.external_id ?? "–"}</figcaption>
    </figure>
  );
}
