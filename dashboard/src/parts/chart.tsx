/** Plots by uPlot, in the colours of the page. */
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { useEffect } from "preact/hooks";
import { useWidth } from "../hooks";
import { number } from "../strings";
import { shown } from "../theme";

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
}) {
  const [ref, width] = useWidth<HTMLDivElement>();
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
        cursor: { show: false },
        scales: {
          x: {
            time: false,
            range: bars
              ? (_, low, high) => [low - 0.6 * step, Math.max(high, mark?.at ?? high) + 0.6 * step]
              : undefined,
          },
          y: range ? { range: (_, low, high) => [range[0] ?? low, range[1] ?? high] } : {},
        },
        hooks: mark ? { draw: [(plot) => line(plot, mark)] } : {},
        axes: [
          axis(xLabel, formatX && ((values) => values.map(formatX))),
          { ...axis(yLabel, format && ((values) => values.map(format))), size: 58 },
        ],
        series: [
          {},
          ...lines.map((line): uPlot.Series => {
            const stroke = colour(line.colour ?? "accent");
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
    return () => plot.destroy();
  }, [key, width]);
  return <div ref={ref} class="chart" role="img" aria-label={describe} />;
}

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

/** Colours of categories (Okabe and Ito), told apart also by the colour-blind. */
export const CATEGORIES = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a63d2", "#7f7f7f"];
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
