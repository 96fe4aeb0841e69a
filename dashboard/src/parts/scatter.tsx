/** A scatter of up to some 100 000 points: axes and zoom by uPlot, points written into pixels, a lasso over it. */
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import type { ComponentChildren } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { useWidth } from "../hooks";
import { shown } from "../theme";
import { axis, colour } from "./chart";

/** Beyond this number points are squares of pixels rather than discs. */
const MANY = 4000;

type Place = [number, number];

function inside(polygon: Place[], x: number, y: number): boolean {
  let within = false;
  for (let i = 0, j = polygon.length - 1; i < polygon.length; j = i++) {
    const [ax, ay] = polygon[i]!,
      [bx, by] = polygon[j]!;
    if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) within = !within;
  }
  return within;
}

function rgb(text: string): [number, number, number] {
  const hex = /^#(..)(..)(..)$/.exec(text);
  if (hex) return hex.slice(1).map((part) => parseInt(part, 16)) as [number, number, number];
  return (text.match(/\d+/g) ?? ["0", "0", "0"]).slice(0, 3).map(Number) as [number, number, number];
}

export interface ScatterProps {
  x: number[];
  y: number[];
  xLabel: string;
  yLabel: string;
  /** Colour of each point, as an index of `palette`. */
  groups: Uint8Array;
  palette: string[];
  tool: "lasso" | "zoom";
  chosen: Set<number> | null;
  onChoose: (chosen: Set<number> | null) => void;
  hover: (index: number) => ComponentChildren;
  describe: string;
  /** Places that the first range holds beside the points: of what is drawn around them. */
  reach?: Place[];
  /** Drawn into the plane, in its coordinates, at places on the page. */
  backdrop?: (place: (x: number, y: number) => Place) => ComponentChildren;
}

export function Scatter(props: ScatterProps) {
  const [ref, width] = useWidth<HTMLDivElement>();
  const height = Math.min(560, Math.max(320, Math.round(width * 0.68)));
  const latest = useRef(props);
  latest.current = props;
  const plot = useRef<uPlot | undefined>(undefined);
  const [near, setNear] = useState<{ index: number; left: number; top: number } | null>(null);
  const [lasso, setLasso] = useState<Place[]>([]);
  const [, moved] = useState(0);
  const theme = shown();

  useEffect(() => {
    if (!ref.current || !width) return;
    const pixels = document.createElement("canvas");
    const draw = (u: uPlot) => {
      const { x, y, groups, palette, chosen } = latest.current;
      const { left, top, width: w, height: h } = u.bbox;
      const ratio = devicePixelRatio || 1;
      const sx = u.scales.x!,
        sy = u.scales.y!;
      const toX = (value: number) => ((value - sx.min!) / (sx.max! - sx.min!)) * w;
      const toY = (value: number) => (1 - (value - sy.min!) / (sy.max! - sy.min!)) * h;
      const context = u.ctx;
      if (x.length > MANY) {
        pixels.width = w;
        pixels.height = h;
        const own = pixels.getContext("2d")!;
        const image = own.createImageData(w, h);
        const data = new Uint32Array(image.data.buffer);
        const colours = palette.map((text) => {
          const [r, g, b] = rgb(text);
          return [r | (g << 8) | (b << 16) | (0xd8 << 24), r | (g << 8) | (b << 16) | (0x28 << 24)];
        });
        const size = Math.max(2, Math.round(2 * ratio));
        for (let k = 0; k < x.length; k++) {
          const px = Math.round(toX(x[k]!)),
            py = Math.round(toY(y[k]!));
          if (px < 0 || py < 0 || px + size > w || py + size > h) continue;
          const value = colours[groups[k]!]![chosen && !chosen.has(k) ? 1 : 0]!;
          for (let row = 0; row < size; row++) data.fill(value, (py + row) * w + px, (py + row) * w + px + size);
        }
        own.putImageData(image, 0, 0);
        context.drawImage(pixels, left, top);
        return;
      }
      context.save();
      context.beginPath();
      context.rect(left, top, w, h);
      context.clip();
      const radius = 3.6 * ratio;
      for (let k = 0; k < x.length; k++) {
        context.globalAlpha = chosen && !chosen.has(k) ? 0.16 : 0.85;
        context.fillStyle = palette[groups[k]!]!;
        context.beginPath();
        context.arc(left + toX(x[k]!), top + toY(y[k]!), radius, 0, 2 * Math.PI);
        context.fill();
      }
      context.restore();
    };
    const range =
      (values: () => number[]): uPlot.Range.Function =>
      (_, low, high) => {
        if (low !== null && high !== null && low !== high && (low !== 0 || high !== 100)) return [low, high];
        return extent(values());
      };
    const created = new uPlot(
      {
        mode: 2,
        width,
        height,
        legend: { show: false },
        cursor: { points: { show: false }, x: false, y: false, drag: { x: true, y: true, setScale: true, uni: 20 } },
        scales: {
          x: { time: false, auto: false, range: range(() => valuesOf(latest.current, 0)) },
          y: { auto: false, range: range(() => valuesOf(latest.current, 1)) },
        },
        axes: [axis(props.xLabel), { ...axis(props.yLabel), size: 58 }],
        series: [
          {},
          {
            facets: [
              { scale: "x", auto: false },
              { scale: "y", auto: false },
            ],
          } as uPlot.Series,
        ],
        hooks: { draw: [draw], setScale: [() => moved((count) => count + 1)] },
      },
      [[], [[], []]] as unknown as uPlot.AlignedData,
      ref.current,
    );
    plot.current = created;
    whole(created, latest.current);
    const over = created.over;
    const wheel = (event: WheelEvent) => {
      event.preventDefault();
      const box = over.getBoundingClientRect();
      zoom(created, event.deltaY < 0 ? 0.85 : 1 / 0.85, event.clientX - box.left, event.clientY - box.top);
    };
    const double = () => whole(created, latest.current);
    over.addEventListener("wheel", wheel, { passive: false });
    over.addEventListener("dblclick", double);
    return () => {
      plot.current = undefined;
      created.destroy();
    };
  }, [width, height, theme, props.xLabel, props.yLabel]);

  useEffect(() => {
    if (plot.current) whole(plot.current, latest.current);
  }, [props.x, props.y, props.reach]);
  useEffect(() => plot.current?.redraw(false), [props.groups, props.palette, props.chosen]);

  const at = (event: PointerEvent): Place => {
    const box = plot.current!.over.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const place = (x: number, y: number): Place => {
    const u = plot.current!;
    return [u.valToPos(x, "x") + u.over.offsetLeft, u.valToPos(y, "y") + u.over.offsetTop];
  };
  const look = (event: PointerEvent) => {
    const u = plot.current;
    if (!u) return;
    const [left, top] = at(event);
    const wx = (u.scales.x!.max! - u.scales.x!.min!) / u.over.clientWidth,
      wy = (u.scales.y!.max! - u.scales.y!.min!) / u.over.clientHeight;
    const vx = u.posToVal(left, "x"),
      vy = u.posToVal(top, "y");
    let best = -1,
      least = 144;
    for (let k = 0; k < props.x.length; k++) {
      const dx = (props.x[k]! - vx) / wx;
      if (dx > 12 || dx < -12) continue;
      const dy = (props.y[k]! - vy) / wy,
        distance = dx * dx + dy * dy;
      if (distance < least) [best, least] = [k, distance];
    }
    setNear(best < 0 ? null : { index: best, left: left + u.over.offsetLeft, top: top + u.over.offsetTop });
  };
  const begin = (event: PointerEvent) => {
    if (!plot.current) return;
    (event.currentTarget as Element).setPointerCapture(event.pointerId);
    setLasso([at(event)]);
  };
  const go = (event: PointerEvent) => {
    if (lasso.length) setLasso([...lasso, at(event)]);
    else look(event);
  };
  const end = () => {
    const u = plot.current;
    if (u && lasso.length > 2) {
      const polygon = lasso.map(([left, top]): Place => [u.posToVal(left, "x"), u.posToVal(top, "y")]);
      const chosen = new Set<number>();
      props.x.forEach((x, index) => inside(polygon, x, props.y[index]!) && chosen.add(index));
      props.onChoose(chosen.size ? chosen : null);
    } else if (lasso.length) props.onChoose(null);
    setLasso([]);
  };
  const over = plot.current?.over;
  const frame = over && {
    left: `${over.offsetLeft}px`,
    top: `${over.offsetTop}px`,
    width: `${over.clientWidth}px`,
    height: `${over.clientHeight}px`,
    position: "absolute" as const,
  };
  return (
    <div class="plot" onPointerLeave={() => setNear(null)} onPointerMove={props.tool === "zoom" ? look : undefined}>
      <div ref={ref} class="chart" role="img" aria-label={props.describe} />
      {over && props.backdrop && (
        <svg
          class="backdrop"
          aria-hidden="true"
          style={{
            position: "absolute",
            inset: 0,
            width: "100%",
            height: "100%",
            pointerEvents: "none",
            clipPath: `inset(${over.offsetTop}px ${width - over.offsetLeft - over.clientWidth}px ${height - over.offsetTop - over.clientHeight}px ${over.offsetLeft}px)`,
          }}
        >
          {props.backdrop(place)}
        </svg>
      )}
      {over && props.tool === "lasso" && (
        <svg
          style={{ ...frame, cursor: "crosshair", touchAction: "none" }}
          aria-hidden="true"
          onPointerDown={begin}
          onPointerMove={go}
          onPointerUp={end}
          onPointerCancel={() => setLasso([])}
        >
          <rect width="100%" height="100%" fill="transparent" />
          {lasso.length > 1 && (
            <path
              d={`M${lasso.map((p) => p.join(" ")).join("L")}Z`}
              fill={colour("accent")}
              fill-opacity="0.12"
              stroke={colour("accent")}
              stroke-width="1.5"
            />
          )}
        </svg>
      )}
      {near && !lasso.length && (
        <div class="hover" style={{ left: `${Math.min(near.left + 14, width - 140)}px`, top: `${near.top + 14}px` }}>
          {props.hover(near.index)}
        </div>
      )}
    </div>
  );
}

/** The range of values, with a margin. */
export function extent(values: number[]): [number, number] {
  let low = Infinity,
    high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  const gap = 0.06 * (high - low || 1);
  return [low - gap, high + gap];
}

/** The values of all that is drawn, along one axis. */
const valuesOf = ({ x, y, reach = [] }: ScatterProps, axis: 0 | 1): number[] => [
  ...(axis ? y : x),
  ...reach.map((p) => p[axis]),
];

function whole(u: uPlot, props: ScatterProps): void {
  u.batch(() => {
    for (const [scale, axis] of [
      ["x", 0],
      ["y", 1],
    ] as const) {
      const [min, max] = extent(valuesOf(props, axis));
      u.setScale(scale, { min, max });
    }
  });
}

function zoom(u: uPlot, factor: number, left: number, top: number): void {
  u.batch(() => {
    for (const [scale, place] of [
      ["x", left],
      ["y", top],
    ] as const) {
      const centre = u.posToVal(place, scale),
        { min, max } = u.scales[scale]!;
      u.setScale(scale, { min: centre - (centre - min!) * factor, max: centre + (max! - centre) * factor });
    }
  });
}
