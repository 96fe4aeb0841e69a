/** The page's own drawing of curves and landmarks, in the plane or turned in space: numbers, lines, marks, and files for papers. */
import { useMemo, useRef, useState } from "preact/hooks";
import { axesOf } from "../shape/around";
import { linksOf, useLinks } from "../shape/links";
import type { Points } from "../shape/points";
import { type Flat, projection, START } from "../shape/view";
import { t } from "../strings";
import { SaveDrawing, serialised } from "./drawn";
import { Field } from "./fields";

export interface FigureSet {
  name: string;
  points: Points;
  colour: string;
  dash?: string;
  closed?: boolean;
  dots?: boolean;
  width?: number;
  /** Drawn behind, without a name in the legend. */
  pale?: boolean;
}

/** A band along a shape: wide where it counts. */
export interface Strip {
  points: Points;
  colours: string[];
  strong: boolean[];
  closed: boolean;
}

/** A band around a shape: at each place the ellipse, or ellipsoid, `pᵀ M⁻¹ p ≤ 1` of its matrix. */
export interface Tube {
  points: Points;
  matrices: number[][][];
  closed: boolean;
  dots: boolean;
}

/** Lines of a grid behind a shape, and the nodes at which it folds. */
export interface Mesh {
  lines: Points[];
  folds: Points;
}

/** How far a band reaches along the axes, at each place. */
export const reachOf = ({ points, matrices }: Tube): Points =>
  points.flatMap((p, at) =>
    p.flatMap((_, axis) =>
      [-1, 1].map((side) =>
        p.map((x, k) => (k === axis ? x + side * Math.sqrt(Math.max(matrices[at]![k]![k]!, 0)) : x)),
      ),
    ),
  );

/** A square that holds all shapes however they are turned. */
function viewOf(sets: Points[], flat: (p: number[]) => Flat): [number, number, number] {
  const all = sets.flat();
  const n = Math.max(all.length, 1);
  const centre = (all[0] ?? [0, 0]).map((_, axis) => all.reduce((sum, p) => sum + p[axis]!, 0) / n);
  const radius = Math.max(...all.map((p) => Math.hypot(...p.map((x, axis) => x - centre[axis]!))), 1e-9);
  const [x, y] = flat(centre);
  if (centre.length === 3) return [x - 1.08 * radius, y - 1.08 * radius, 2.16 * radius];
  const places = all.map(flat),
    extent = [0, 1].map((axis) => {
      const values = places.map((p) => p[axis]!);
      return [Math.min(...values), Math.max(...values)];
    });
  const size = 1.14 * Math.max(extent[0]![1]! - extent[0]![0]!, extent[1]![1]! - extent[1]![0]!, 1e-9);
  return [(extent[0]![0]! + extent[0]![1]! - size) / 2, (extent[1]![0]! + extent[1]![1]! - size) / 2, size];
}

const word = ([x, y]: Flat) => `${x.toPrecision(6)} ${y.toPrecision(6)}`;

export function Figure({
  sets,
  describe,
  name,
  height = 400,
  strip,
  tube,
  mesh,
  arrows,
  place0,
  cursor,
  onCursor,
  links: linked,
  legend = true,
  fit,
}: {
  sets: FigureSet[];
  describe: string;
  /** Name of the files. */
  name: string;
  height?: number;
  strip?: Strip;
  tube?: Tube;
  mesh?: Mesh;
  /** From where to where. */
  arrows?: [number[], number[]][];
  /** Marks where places along the contour begin, and which way they go. */
  place0?: Points;
  cursor?: number[] | null;
  onCursor?: (index: number | null) => void;
  /** Cohort whose landmarks are joined by lines. */
  links?: string;
  legend?: boolean;
  /** Shapes that the frame holds, where it is to stay as shapes move. */
  fit?: Points[];
}) {
  const svg = useRef<SVGSVGElement>(null);
  const first = sets.find((set) => !set.pale) ?? sets[0]!;
  const spatial = (first.points[0]?.length ?? 2) === 3;
  const [turn, setTurn] = useState<Flat>(START);
  const drag = useRef<{ x: number; y: number; turn: Flat } | undefined>(undefined);
  const [numbers, setNumbers] = useState(false);
  const [text, setText] = useLinks(linked ?? "");
  const flat = useMemo(() => projection(turn).flat, [turn]);
  const [x, y, size] = useMemo(
    () =>
      viewOf(
        fit ?? [
          ...sets.map((set) => set.points),
          ...(strip ? [strip.points] : []),
          ...(mesh?.lines ?? []),
          ...(arrows ?? []),
          ...(tube ? [reachOf(tube)] : []),
        ],
        flat,
      ),
    [fit ?? sets, strip, mesh, tube, flat],
  );
  const lines = linked && first.dots ? linksOf(text, first.points.length) : [];
  const unit = size / height;
  const keys = (event: KeyboardEvent) => {
    const way = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.15], ArrowDown: [0, -0.15] }[event.key];
    if (!spatial || !way) return;
    event.preventDefault();
    setTurn([turn[0] + way[0]!, Math.min(Math.max(turn[1] + way[1]!, -1.5), 1.5)]);
  };
  const move = (event: PointerEvent) => {
    const from = drag.current;
    if (from)
      setTurn([
        from.turn[0] + (event.clientX - from.x) / 120,
        Math.min(Math.max(from.turn[1] + (event.clientY - from.y) / 120, -1.5), 1.5),
      ]);
    else if (onCursor && strip && svg.current) {
      const frame = svg.current.getBoundingClientRect(),
        scale = size / Math.min(frame.width, frame.height);
      const px = (event.clientX - frame.left - frame.width / 2) * scale + x + size / 2,
        py = (event.clientY - frame.top - frame.height / 2) * scale + y + size / 2;
      const near = strip.points
        .map((p, index) => ({ index, d: Math.hypot(flat(p)[0] - px, flat(p)[1] - py) }))
        .sort((a, b) => a.d - b.d)[0];
      onCursor(near && near.d < 40 * unit ? near.index : null);
    }
  };
  return (
    <figure class="drawing">
      <svg
        ref={svg}
        class="shape"
        viewBox={`${x} ${y} ${size} ${size}`}
        style={{ height: `${height}px`, touchAction: spatial ? "none" : "auto", cursor: spatial ? "grab" : "default" }}
        role="img"
        tabindex={spatial ? 0 : undefined}
        aria-label={spatial ? `${describe}. ${t.figure.turn}` : describe}
        onKeyDown={keys}
        onPointerDown={(event) => {
          if (!spatial) return;
          (event.currentTarget as Element).setPointerCapture(event.pointerId);
          drag.current = { x: event.clientX, y: event.clientY, turn };
        }}
        onPointerMove={move}
        onPointerUp={() => {
          drag.current = undefined;
        }}
        onPointerLeave={() => onCursor?.(null)}
      >
        {mesh && <Net mesh={mesh} flat={flat} unit={unit} />}
        {tube && <Around tube={tube} flat={flat} />}
        {strip && <Band strip={strip} flat={flat} />}
        {sets.map((set) => (
          <g key={set.name}>
            {!set.dots && (
              <path
                d={`M${set.points.map((p) => word(flat(p))).join("L")}${set.closed ? "Z" : ""}`}
                fill="none"
                stroke={set.colour}
                stroke-width={set.width ?? (set.pale ? 1.2 : 2.2)}
                stroke-dasharray={set.dash || undefined}
                stroke-linejoin="round"
                vector-effect="non-scaling-stroke"
              />
            )}
            {set.dots &&
              lines.map(([from, to]) => (
                <path
                  key={`${from} ${to}`}
                  d={`M${word(flat(set.points[from]!))}L${word(flat(set.points[to]!))}`}
                  stroke={set.colour}
                  stroke-width={set.pale ? 1 : 1.6}
                  stroke-dasharray={set.dash || undefined}
                  vector-effect="non-scaling-stroke"
                />
              ))}
            {set.dots &&
              set.points.map((p, at) => {
                const [cx, cy] = flat(p);
                return <circle key={at} cx={cx} cy={cy} r={(set.pale ? 2.6 : 4.2) * unit} fill={set.colour} />;
              })}
          </g>
        ))}
        {arrows?.map(([from, to], at) => (
          <Arrow key={at} from={flat(from)} to={flat(to)} unit={unit} />
        ))}
        {numbers &&
          first.points.map((p, at) => {
            const [cx, cy] = flat(p);
            return (
              <text key={at} x={cx + 6 * unit} y={cy - 6 * unit} font-size={13 * unit} style={{ fill: "var(--ink)" }}>
                {at + 1}
              </text>
            );
          })}
        {place0 && <Beginning points={place0} flat={flat} unit={unit} />}
        {cursor && <Cursor at={flat(cursor)} unit={unit} />}
      </svg>
      {legend && sets.filter((set) => !set.pale).length > 1 && (
        <ul class="keys">
          {sets
            .filter((set) => !set.pale)
            .map((set) => (
              <li key={set.name}>
                <svg width="30" height="10" viewBox="0 0 30 10" aria-hidden="true">
                  <path
                    d="M1 5h28"
                    stroke={set.colour}
                    stroke-width="2.6"
                    stroke-dasharray={set.dots ? undefined : set.dash || undefined}
                  />
                </svg>
                {set.name}
              </li>
            ))}
        </ul>
      )}
      {first.dots && linked && (
        <div class="row no-print">
          <label class="check">
            <input type="checkbox" checked={numbers} onChange={(event) => setNumbers(event.currentTarget.checked)} />
            <span>{t.figure.numbers}</span>
          </label>
          <Field label={t.figure.links}>
            <input
              value={text}
              placeholder="1-2-3, 4-5"
              spellcheck={false}
              onInput={(event) => setText(event.currentTarget.value)}
            />
          </Field>
        </div>
      )}
      <SaveDrawing
        name={name}
        of={() => (svg.current ? withLegend(serialised(svg.current), legend ? sets : []) : undefined)}
      />
    </figure>
  );
}

/** The legend below a drawing that is saved. */
function withLegend(svg: string, sets: FigureSet[]): string {
  const named = sets.filter((set) => !set.pale);
  if (named.length < 2) return svg;
  const [, x, y, width, height] = /viewBox="(\S+) (\S+) (\S+) (\S+)"/.exec(svg)!.map(Number) as number[];
  const row = (0.05 * height!) as number;
  const lines = named.map((set, at) => {
    const top = y! + height! + (at + 0.7) * row,
      escaped = set.name.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
    return `<path d="M${x} ${top}h${0.08 * width!}" stroke="${set.colour}" stroke-width="${0.006 * height!}"/><text x="${x! + 0.1 * width!}" y="${top + 0.3 * row}" font-size="${0.036 * height!}" fill="#181b20">${escaped}</text>`;
  });
  const tall = height! + named.length * row + 0.3 * row;
  return svg
    .replace(/viewBox="[^"]*"/, `viewBox="${x} ${y} ${width} ${tall}"`)
    .replace(/ height="(\d+)"/, (_, pixels) => ` height="${Math.round((Number(pixels) * tall) / height!)}"`)
    .replace(/<\/svg>$/, `${lines.join("")}</svg>`);
}

/** A grid that was bent, and its folds. */
const Net = ({ mesh: { lines, folds }, flat, unit }: { mesh: Mesh; flat: (p: number[]) => Flat; unit: number }) => (
  <g class="net">
    {lines.map((line, at) => (
      <path
        key={at}
        d={`M${line.map((p) => word(flat(p))).join("L")}`}
        fill="none"
        style={{ stroke: "var(--quiet)" }}
        stroke-opacity="0.55"
        stroke-width="0.9"
        vector-effect="non-scaling-stroke"
      />
    ))}
    {folds.map((p, at) => {
      const [cx, cy] = flat(p);
      return <circle key={at} cx={cx} cy={cy} r={4 * unit} style={{ fill: "var(--plus)" }} />;
    })}
  </g>
);

/** A line with a head; none where nothing moves. */
function Arrow({ from: [ax, ay], to: [bx, by], unit }: { from: Flat; to: Flat; unit: number }) {
  const length = Math.hypot(bx - ax, by - ay);
  if (length < 1e-3 * unit) return null;
  const head = Math.min(8 * unit, 0.6 * length),
    [dx, dy] = [((bx - ax) / length) * head, ((by - ay) / length) * head];
  return (
    <g class="arrow" style={{ stroke: "var(--accent)", fill: "var(--accent)" }}>
      <path d={`M${word([ax, ay])}L${word([bx - dx, by - dy])}`} stroke-width="2" vector-effect="non-scaling-stroke" />
      <path
        d={`M${word([bx, by])}L${word([bx - dx - 0.4 * dy, by - dy + 0.4 * dx])}L${word([bx - dx + 0.4 * dy, by - dy - 0.4 * dx])}Z`}
        stroke="none"
      />
    </g>
  );
}

/** Ellipses at all places and, along curves, what lies between two of them: one area of one shade. */
function Around({ tube: { points, matrices, closed, dots }, flat }: { tube: Tube; flat: (p: number[]) => Flat }) {
  const places = points.map(flat),
    n = places.length;
  // The view is linear: `F M Fᵀ` is the ellipse that is seen, with the images of the axes as columns of `F`.
  const axes = points[0]?.map((_, axis) => flat(points[0]!.map((_, k) => (k === axis ? 1 : 0)))) ?? [];
  const seen = matrices.map((matrix) => {
    const entry = (i: 0 | 1, j: 0 | 1) =>
      matrix.reduce((sum, row, k) => sum + row.reduce((of, value, l) => of + axes[k]![i] * value * axes[l]![j], 0), 0);
    return [
      [entry(0, 0), entry(0, 1)],
      [entry(1, 0), entry(1, 1)],
    ] as [Flat, Flat];
  });
  /** How far the ellipse of a place reaches across a direction. */
  const across = (at: number, x: number, y: number) => {
    const [[xx, xy], [, yy]] = seen[at]!;
    return Math.sqrt(Math.max(xx * x * x + 2 * xy * x * y + yy * y * y, 0));
  };
  const between = (at: number) => {
    const [[ax, ay], [bx, by]] = [places[at]!, places[(at + 1) % n]!];
    const length = Math.hypot(bx - ax, by - ay) || 1,
      [x, y] = [(ay - by) / length, (bx - ax) / length];
    const [r, s] = [across(at, x, y), across((at + 1) % n, x, y)];
    return `M${word([ax + r * x, ay + r * y])}L${word([bx + s * x, by + s * y])}L${word([bx - s * x, by - s * y])}L${word([ax - r * x, ay - r * y])}Z`;
  };
  return (
    <g class="band" style={{ fill: "var(--accent)", stroke: "none" }} opacity="0.2">
      {!dots && places.slice(0, closed ? n : n - 1).map((_, at) => <path key={at} d={between(at)} />)}
      {places.map(([x, y], at) => {
        const [rx, ry, angle] = axesOf(seen[at]!);
        return <ellipse key={at} rx={rx} ry={ry} transform={`translate(${word([x, y])}) rotate(${angle})`} />;
      })}
    </g>
  );
}

/** Pieces between neighbouring places, wide where the difference is clear. */
function Band({ strip: { points, colours, strong, closed }, flat }: { strip: Strip; flat: (p: number[]) => Flat }) {
  const n = points.length;
  return (
    <g>
      {points.slice(0, closed ? n : n - 1).map((p, at) => (
        <path
          key={at}
          d={`M${word(flat(p))}L${word(flat(points[(at + 1) % n]!))}`}
          fill="none"
          stroke={colours[at]}
          stroke-width={strong[at] ? 11 : 4.5}
          stroke-linecap="round"
          vector-effect="non-scaling-stroke"
        />
      ))}
    </g>
  );
}

/** Place 0 and the direction of growing places, with quarters. */
function Beginning({ points, flat, unit }: { points: Points; flat: (p: number[]) => Flat; unit: number }) {
  const n = points.length,
    [ax, ay] = flat(points[0]!),
    [bx, by] = flat(points[Math.max(1, Math.round(n / 24)) % n]!);
  const length = Math.hypot(bx - ax, by - ay) || 1,
    [dx, dy] = [((bx - ax) / length) * 16 * unit, ((by - ay) / length) * 16 * unit];
  return (
    <g style={{ fill: "var(--ink)", stroke: "none" }}>
      <circle cx={ax} cy={ay} r={4.5 * unit} />
      <path
        d={`M${bx + 0.5 * dx} ${by + 0.5 * dy}L${bx - 0.5 * dx - 0.4 * dy} ${by - 0.5 * dy + 0.4 * dx}L${bx - 0.5 * dx + 0.4 * dy} ${by - 0.5 * dy - 0.4 * dx}Z`}
      />
      {[0, 0.25, 0.5, 0.75].map((part) => {
        const [x, y] = flat(points[Math.round(part * n) % n]!);
        return (
          <g key={part}>
            {part > 0 && <circle cx={x} cy={y} r={2.6 * unit} />}
            <text x={x + 7 * unit} y={y - 7 * unit} font-size={13 * unit}>
              {part === 0 ? "0" : part.toLocaleString(document.documentElement.lang)}
            </text>
          </g>
        );
      })}
    </g>
  );
}

const Cursor = ({ at: [x, y], unit }: { at: Flat; unit: number }) => (
  <circle
    class="cursor"
    cx={x}
    cy={y}
    r={8 * unit}
    fill="none"
    style={{ stroke: "var(--ink)" }}
    stroke-width="2.5"
    vector-effect="non-scaling-stroke"
  />
);
