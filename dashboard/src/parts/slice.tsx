/** One slice of an image with boxes and contours in it, to be drawn and corrected; zoomed by the wheel, buttons and keys. */
import { useRef, useState } from "preact/hooks";
import type { Slice } from "../formats/image";
import { path } from "../shape/points";
import { type Box, type Contour, isLost } from "../shape/snake";
import { t } from "../strings";
import { Choice } from "./fields";

/** An object of an image: the box that someone drew around it, and its contour once it is found. */
export interface Item {
  id: number;
  box: Box;
  /** Whether the page has proposed the box, and a drawn one takes its place. */
  proposed?: boolean;
  found?: Contour;
  /** Whether the contour is to go on: it was corrected, or is that of another slice. */
  moved?: boolean;
  /** Contours of the slices of a volume, by their index. */
  levels?: [number, Contour][];
}

export const CONTOUR = "#00d0e4";
const LOST = "#ff5a4f",
  BOX = "#ffb000";

/** The contour of an object: red where it has left its object, dashed where it is to go on. */
export function Outline({ item, chosen }: { item: Item; chosen: boolean }) {
  const { found, moved, box } = item;
  return found ? (
    <path
      class={`contour${isLost(found) ? " lost" : ""}`}
      d={path(
        found.outline.map((p) => [p[0]!, -p[1]!]),
        true,
      )}
      fill="none"
      stroke={isLost(found) ? LOST : CONTOUR}
      stroke-width={chosen ? 2.6 : 1.5}
      stroke-dasharray={moved ? "7 4" : undefined}
      vector-effect="non-scaling-stroke"
    />
  ) : (
    <rect
      x={box.x}
      y={box.y}
      width={box.w}
      height={box.h}
      fill="none"
      stroke={BOX}
      stroke-width={chosen ? 2.4 : 1.3}
      vector-effect="non-scaling-stroke"
    />
  );
}

type View = [number, number, number, number];
/** Steps of the buttons, and the largest magnification. */
const STEP = 1.4,
  MOST = 40;

/** The part of the picture that is seen: never beyond its sides. */
function within([x, y, w, h]: View, [X, Y, W, H]: View): View {
  const [cw, ch] = [Math.min(Math.max(w, W / MOST), W), Math.min(Math.max(h, H / MOST), H)];
  return [Math.min(Math.max(x, X), X + W - cw), Math.min(Math.max(y, Y), Y + H - ch), cw, ch];
}

const zoomed = ([x, y, w, h]: View, by: number, px: number, py: number): View => [
  px - (px - x) / by,
  py - (py - y) / by,
  w / by,
  h / by,
];

export function SlicePicture({
  name,
  slice,
  url,
  items,
  chosen,
  onChoose,
  onBox,
  onPoint,
  onPointEnd,
}: {
  name: string;
  slice: Slice;
  url: string;
  items: Item[];
  chosen: number;
  onChoose: (id: number) => void;
  onBox: (box: Box, done: boolean) => void;
  onPoint: (index: number, place: [number, number]) => void;
  onPointEnd: (index: number, place?: [number, number]) => void;
}) {
  const svg = useRef<SVGSVGElement>(null);
  const [sx, sy] = slice.spacing,
    [width, height] = [slice.size[0] * sx, slice.size[1] * sy];
  const whole: View = [-0.5 * sx, -0.5 * sy, width, height];
  const [view, setView] = useState<View | null>(null);
  const [tool, setTool] = useState("box");
  const [drag, setDrag] = useState<
    { kind: "box" | "move"; x: number; y: number } | { kind: "point"; index: number } | undefined
  >();
  const seen = view ? within(view, whole) : whole;
  const own = items.find((item) => item.id === chosen);
  const at = (event: PointerEvent | WheelEvent): [number, number] => {
    const frame = svg.current!.getBoundingClientRect();
    // The picture may be narrower than its element.
    const scale = Math.max(seen[2] / frame.width, seen[3] / frame.height);
    return [
      (event.clientX - frame.left - frame.width / 2) * scale + seen[0] + seen[2] / 2,
      (event.clientY - frame.top - frame.height / 2) * scale + seen[1] + seen[3] / 2,
    ];
  };
  const by = (factor: number, px = seen[0] + seen[2] / 2, py = seen[1] + seen[3] / 2) =>
    setView(within(zoomed(seen, factor, px, py), whole));
  const begin = (event: PointerEvent) => {
    svg.current!.setPointerCapture(event.pointerId);
    const [x, y] = at(event);
    if (tool === "move" || event.button === 1) return setDrag({ kind: "move", x, y });
    const near = own?.found?.control
      .map((p, index) => ({ index, d: Math.hypot(p[0]! - x, p[1]! - y) }))
      .sort((a, b) => a.d - b.d)[0];
    if (near && near.d < seen[2] / 40) setDrag({ kind: "point", index: near.index });
    else setDrag({ kind: "box", x, y });
  };
  const boxOf = (from: { x: number; y: number }, [x, y]: [number, number]): Box => ({
    x: Math.min(x, from.x),
    y: Math.min(y, from.y),
    w: Math.abs(x - from.x),
    h: Math.abs(y - from.y),
  });
  const [drawn, setDrawn] = useState<Box>();
  const move = (event: PointerEvent) => {
    if (!drag) return;
    const place = at(event);
    if (drag.kind === "point") onPoint(drag.index, place);
    else if (drag.kind === "box") setDrawn(boxOf(drag, place));
    else setView(within([seen[0] + drag.x - place[0], seen[1] + drag.y - place[1], seen[2], seen[3]], whole));
  };
  const end = (event: PointerEvent) => {
    if (drag?.kind === "point") onPointEnd(drag.index);
    if (drag?.kind === "box") {
      const box = boxOf(drag, at(event));
      if (box.w >= 3 * sx && box.h >= 3 * sy) onBox(box, true);
      else choose(at(event));
    }
    setDrawn(undefined);
    setDrag(undefined);
  };
  /** A click chooses the object whose box or contour is there. */
  const choose = ([x, y]: [number, number]) => {
    const hit = items.find(({ box, found }) => {
      const places = found?.outline ?? [
        [box.x, box.y],
        [box.x + box.w, box.y + box.h],
      ];
      const [xs, ys] = [0, 1].map((axis) => places.map((p) => p[axis]!)) as [number[], number[]];
      return x >= Math.min(...xs) && x <= Math.max(...xs) && y >= Math.min(...ys) && y <= Math.max(...ys);
    });
    if (hit) onChoose(hit.id);
  };
  const keys = (event: KeyboardEvent) => {
    if (event.target !== svg.current) return;
    const [dx, dy] = ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] ?? [
      0, 0,
    ]) as [number, number];
    if (dx || dy)
      setView(within([seen[0] + 0.1 * dx * seen[2], seen[1] + 0.1 * dy * seen[3], seen[2], seen[3]], whole));
    else if (event.key === "+") by(STEP);
    else if (event.key === "-") by(1 / STEP);
    else if (event.key === "0") setView(null);
    else return;
    event.preventDefault();
  };
  const step = (event: KeyboardEvent, index: number) => {
    const way = { ArrowLeft: [-sx, 0], ArrowRight: [sx, 0], ArrowUp: [0, -sy], ArrowDown: [0, sy] }[event.key];
    if (!way || !own?.found) return;
    event.preventDefault();
    const p = own.found.control[index]!;
    onPointEnd(index, [p[0]! + way[0]!, p[1]! + way[1]!]);
  };
  const radius = seen[2] / 170;
  return (
    <div class="stack">
      <div class="row no-print">
        <Choice
          label={t.scores.tool}
          value={tool}
          options={[
            ["box", t.segment.toolBox],
            ["move", t.segment.toolMove],
          ]}
          onChange={setTool}
        />
        <button class="plain" onClick={() => by(STEP)} aria-label={t.segment.closer}>
          +
        </button>
        <button class="plain" onClick={() => by(1 / STEP)} aria-label={t.segment.farther}>
          −
        </button>
        <button class="plain" disabled={!view} onClick={() => setView(null)}>
          {t.segment.whole}
        </button>
      </div>
      <div class="slice">
        <svg
          ref={svg}
          viewBox={seen.join(" ")}
          style={{
            width: `min(100%, ${((70 * width) / height).toFixed(1)}vh)`,
            aspectRatio: `${width} / ${height}`,
            margin: "0 auto",
            touchAction: "none",
            cursor: tool === "move" ? "grab" : "crosshair",
            background: "var(--sunken)",
            overflow: "hidden",
          }}
          role="group"
          tabindex={0}
          aria-label={`${t.segment.alt(name)}. ${t.segment.keys}`}
          onKeyDown={keys}
          onPointerDown={begin}
          onPointerMove={move}
          onPointerUp={end}
          onPointerCancel={() => setDrag(undefined)}
          onWheel={(event) => {
            event.preventDefault();
            by(event.deltaY < 0 ? 1.18 : 1 / 1.18, ...at(event));
          }}
        >
          {url && (
            <image
              href={url}
              x={whole[0]}
              y={whole[1]}
              width={width}
              height={height}
              preserveAspectRatio="none"
              style={{ imageRendering: "pixelated" }}
            />
          )}
          {items.map((item) => (
            <Outline key={item.id} item={item} chosen={item.id === chosen} />
          ))}
          {drawn && (
            <rect
              x={drawn.x}
              y={drawn.y}
              width={drawn.w}
              height={drawn.h}
              fill="none"
              stroke={BOX}
              stroke-width="2"
              stroke-dasharray="5 3"
              vector-effect="non-scaling-stroke"
            />
          )}
          {own?.found?.control.map((p, index) => (
            <circle
              key={index}
              tabindex={0}
              role="button"
              aria-label={t.segment.point(index + 1)}
              cx={p[0]}
              cy={p[1]}
              r={radius}
              fill="#fff"
              stroke="#00828f"
              stroke-width="1.5"
              vector-effect="non-scaling-stroke"
              onKeyDown={(event) => step(event, index)}
            />
          ))}
          {items.length > 1 &&
            items.map((item, index) => (
              <text
                key={item.id}
                class="object-number"
                font-size={seen[3] / 28}
                x={item.box.x}
                y={item.box.y - seen[3] / 160}
              >
                {index + 1}
              </text>
            ))}
          {slice.sides?.map((letter, side) => (
            <text
              key={letter}
              class="side-letter"
              font-size={seen[3] / 22}
              text-anchor="middle"
              dominant-baseline="central"
              x={
                side === 0 ? seen[0] + seen[2] / 30 : side === 1 ? seen[0] + (seen[2] * 29) / 30 : seen[0] + seen[2] / 2
              }
              y={
                side === 2 ? seen[1] + seen[3] / 30 : side === 3 ? seen[1] + (seen[3] * 29) / 30 : seen[1] + seen[3] / 2
              }
            >
              {letter}
            </text>
          ))}
        </svg>
      </div>
    </div>
  );
}
