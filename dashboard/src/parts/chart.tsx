/** Plots by uPlot, in the colours of the page. */
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { useEffect, useRef } from "preact/hooks";
import { useWidth } from "../hooks";
import { number } from "../strings";
import { shown } from "../theme";
import { SaveDrawing } from "./drawn";
import { plotSvg } from "./plot";

export const colour = (name: string): string =>
  getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const FONT = "12px system-ui, sans-serif";

export function axis(label: string, values?: (values: number[]) => string[]): uPlot.Axis {
  return {
    label,
    font: FONT,
    labelFont: FONT,
    labelSize: 22,
    size: 44,
    stroke: colour("quiet"),
    grid: { stroke: colour("line"), width: 1 },
    ticks: { stroke: colour("line"), width: 1, size: 5 },
    values: (_, splits) => (values ? values(splits) : splits.map((value) => number(value, 6))),
  };
}

export interface Line {
  label: string;
  values: (number | null)[];
  kind?: "line" | "bars" | "dots";
  colour?: string;
}

/** Lines or bars over numbers, with words for those who do not see it. */
export function Chart({
  x,
  lines,
  xLabel,
  yLabel,
  height = 220,
  describe,
  range,
  format,
  formatX,
  mark,
  name,
  onPlace,
  place,
}: {
  x: number[];
  lines: Line[];
  xLabel: string;
  yLabel: string;
  height?: number;
  describe: string;
  range?: [number | null, number | null];
  format?: (value: number) => string;
  formatX?: (value: number) => string;
  mark?: { at: number; label: string };
  /** Name of the file, if not that of the plot. */
  name?: string;
  /** The nearest place of the horizontal axis under the pointer, or none. */
  onPlace?: (index: number | null) => void;
  /** The place that is marked from elsewhere. */
  place?: number | null;
}) {
  const [ref, width] = useWidth<HTMLDivElement>();
  const plotted = useRef<uPlot | undefined>(undefined);
  const theme = shown();
  const key = JSON.stringify([
    x,
    lines.map((line) => [line.values, line.label, line.kind, line.colour]),
    theme,
    height,
    mark,
  ]);
  useEffect(() => {
    if (!ref.current || !width) return;
    const bars = lines.some((line) => line.kind === "bars"),
      step = x.length > 1 ? x[1]! - x[0]! : 1;
    const plot = new uPlot(
      {
        width,
        height,
        legend: { show: false },
        cursor: onPlace ? { y: false, points: { show: false }, drag: { x: false, y: false } } : { show: false },
        scales: {
          x: {
            time: false,
            range: bars
              ? (_, low, high) => [low - 0.6 * step, Math.max(high, mark?.at ?? high) + 0.6 * step]
              : undefined,
          },
          y: range ? { range: (_, low, high) => [range[0] ?? low, range[1] ?? high] } : {},
        },
        hooks: {
          draw: mark ? [(plot: uPlot) => line(plot, mark)] : [],
          setCursor: onPlace ? [(plot: uPlot) => onPlace(plot.cursor.idx ?? null)] : [],
        },
        axes: [
          {
            ...axis(xLabel, formatX && ((values) => values.map(formatX))),
            ...(x.every(Number.isInteger) ? { incrs: WHOLE } : {}),
          },
          { ...axis(yLabel, format && ((values) => values.map(format))), size: 58 },
        ],
        series: [
          {},
          ...lines.map((line): uPlot.Series => {
            const stroke = line.colour?.startsWith("#") ? line.colour : colour(line.colour ?? "accent");
            if (line.kind === "bars")
              return {
                label: line.label,
                stroke,
                fill: stroke,
                paths: uPlot.paths.bars!({ size: [0.66, 48], radius: 0.15 }),
                points: { show: false },
              };
            return {
              label: line.label,
              stroke: line.kind === "dots" ? "transparent" : stroke,
              width: 2,
              points: { show: line.kind === "dots" || x.length < 40, size: 6, fill: stroke, stroke },
            };
          }),
        ],
      },
      [x, ...lines.map((line) => line.values)] as uPlot.AlignedData,
      ref.current,
    );
    plotted.current = plot;
    return () => {
      plotted.current = undefined;
      plot.destroy();
    };
  }, [key, width]);
  useEffect(() => {
    const left = typeof place === "number" ? plotted.current?.valToPos(x[place] ?? 0, "x") : -10;
    if (onPlace) plotted.current?.setCursor({ left: left ?? -10, top: 1 }, false);
  }, [place]);
  const drawing = () => {
    const bars = lines.some((one) => one.kind === "bars"),
      step = x.length > 1 ? x[1]! - x[0]! : 1;
    const values = lines.flatMap((one) => one.values).filter((value): value is number => typeof value === "number");
    const [low, high] = [Math.min(...values, bars ? 0 : Infinity), Math.max(...values, bars ? 0 : -Infinity)];
    const gap = 0.05 * (high - low || 1);
    return plotSvg({
      x,
      lines: lines.map((one) => ({ ...one, colour: LIGHT[one.colour ?? "accent"] ?? one.colour! })),
      xLabel,
      yLabel,
      xRange: bars
        ? [Math.min(...x) - 0.6 * step, Math.max(...x, mark?.at ?? -Infinity) + 0.6 * step]
        : [Math.min(...x), Math.max(...x)],
      yRange: [range?.[0] ?? (bars && low === 0 ? 0 : low - gap), range?.[1] ?? high + gap],
      xText: formatX ?? ((value) => number(value, 6)),
      yText: format ?? ((value) => number(value, 6)),
      whole: x.every(Number.isInteger),
      mark,
      legend: lines.length > 1 ? lines.map((one) => [one.label, LIGHT[one.colour ?? "accent"] ?? one.colour!]) : [],
    });
  };
  return (
    <>
      <div ref={ref} class="chart" role="img" aria-label={describe} />
      <SaveDrawing name={name ?? fileName(yLabel, xLabel)} of={drawing} />
    </>
  );
}

/** Steps of axes of whole numbers. */
const WHOLE = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 100_000, 1_000_000];

/** Colours of the light scheme, for files. */
const LIGHT: Record<string, string> = {
  ink: "#181b20",
  accent: "#0b6b78",
  plus: "#cc3311",
  minus: "#4477aa",
  effect: "#880055",
  pale: "#9a9a9a",
};

const fileName = (...words: string[]): string =>
  words
    .join("-")
    .normalize("NFKD")
    .replace(/[^\w]+/g, "-")
    .replace(/^-+|-+$/g, "")
    .toLowerCase();

/** A line at one place of the horizontal axis, with its name. */
function line(plot: uPlot, { at, label }: { at: number; label: string }): void {
  const { ctx, bbox } = plot,
    x = plot.valToPos(at, "x", true),
    ratio = devicePixelRatio;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = colour("plus");
  ctx.lineWidth = 2.5 * ratio;
  ctx.beginPath();
  ctx.moveTo(x, bbox.top);
  ctx.lineTo(x, bbox.top + bbox.height);
  ctx.stroke();
  ctx.font = `600 ${12 * ratio}px system-ui, sans-serif`;
  const right = x > bbox.left + bbox.width / 2;
  ctx.textAlign = right ? "right" : "left";
  ctx.fillText(label, x + (right ? -6 : 6) * ratio, bbox.top + 12 * ratio);
  ctx.restore();
}

/** A histogram small enough to stand beside a filter. */
export function Spark({ counts, label }: { counts: number[]; label: string }) {
  const most = Math.max(...counts, 1);
  return (
    <svg class="spark" viewBox={`0 0 ${counts.length} 20`} preserveAspectRatio="none" role="img" aria-label={label}>
      {counts.map((value, index) => (
        <rect x={index + 0.08} width={0.84} y={20 - (20 * value) / most} height={(20 * value) / most} />
      ))}
    </svg>
  );
}

export { CATEGORIES } from "./colours";

const RAMP: [number, number, number][] = [
  [68, 1, 84],
  [59, 82, 139],
  [33, 145, 140],
  [94, 201, 98],
  [253, 231, 37],
];

export function ramp(part: number): string {
  const place = Math.min(Math.max(part, 0), 1) * (RAMP.length - 1);
  const index = Math.min(Math.floor(place), RAMP.length - 2),
    rest = place - index;
  const [r, g, b] = [0, 1, 2].map((c) => Math.round(RAMP[index]![c]! * (1 - rest) + RAMP[index + 1]![c]! * rest));
  return `rgb(${r}, ${g}, ${b})`;
}
