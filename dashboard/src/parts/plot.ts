/** Plots as SVG for files: axes, lines, bars and dots, as the ones on the screen, which are pixels. */

export interface PlotLine {
  label: string;
  values: (number | null)[];
  kind?: "line" | "bars" | "dots";
  colour: string;
}
export interface Plot {
  x: number[];
  lines: PlotLine[];
  xLabel: string;
  yLabel: string;
  xRange: [number, number];
  yRange: [number, number];
  xText: (value: number) => string;
  yText: (value: number) => string;
  mark?: { at: number; label: string };
  /** Whether the horizontal axis has whole numbers only. */
  whole?: boolean;
  /** What is drawn between the axes besides, in pixels of the frame. */
  inner?: (place: (x: number, y: number) => [number, number]) => string;
  legend?: [string, string][];
}

const WIDTH = 640,
  HEIGHT = 420,
  LEFT = 72,
  RIGHT = 18,
  TOP = 16,
  BOTTOM = 56;
const INK = "#181b20",
  QUIET = "#565e6b",
  LINE = "#dfe3e8";

const escaped = (text: string): string => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");

/** Round values within a range, about so many. */
export function ticks([low, high]: [number, number], whole = false, wanted = 6): number[] {
  const span = high - low || 1,
    rough = span / wanted,
    power = 10 ** Math.floor(Math.log10(rough));
  const found = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough) ?? rough;
  const step = whole ? Math.max(1, Math.round(found)) : found;
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, k) => (first + k) * step);
}

const text = (x: number, y: number, content: string, anchor = "middle", extra = "") =>
  `<text x="${x.toFixed(1)}" y="${y.toFixed(1)}" text-anchor="${anchor}" fill="${QUIET}" font-size="12"${extra}>${escaped(content)}</text>`;

function series({ x, xRange }: Plot, line: PlotLine, place: (x: number, y: number) => [number, number]): string {
  const known = x.flatMap((at, k) => (typeof line.values[k] === "number" ? [place(at, line.values[k]!)] : []));
  if (line.kind === "dots")
    return known
      .map(([px, py]) => `<circle cx="${px.toFixed(1)}" cy="${py.toFixed(1)}" r="3" fill="${line.colour}"/>`)
      .join("");
  if (line.kind === "bars") {
    const step = x.length > 1 ? Math.abs(place(x[1]!, 0)[0] - place(x[0]!, 0)[0]) : 60,
      [, base] = place(xRange[0], 0),
      width = Math.min(0.66 * step, 48);
    return known
      .map(([px, py]) => {
        const [top, height] = [Math.min(py, base), Math.abs(base - py)];
        return `<rect x="${(px - width / 2).toFixed(1)}" y="${top.toFixed(1)}" width="${width.toFixed(1)}" height="${height.toFixed(1)}" fill="${line.colour}"/>`;
      })
      .join("");
  }
  let pen = "M";
  const path = x
    .map((at, k) => {
      const value = line.values[k];
      if (typeof value !== "number") {
        pen = "M";
        return "";
      }
      const [px, py] = place(at, value),
        word = `${pen}${px.toFixed(1)} ${py.toFixed(1)}`;
      pen = "L";
      return word;
    })
    .join("");
  return `<path d="${path}" fill="none" stroke="${line.colour}" stroke-width="2"/>`;
}

function legendOf(legend: [string, string][]): { text: string; height: number } {
  let [x, row] = [LEFT, 0];
  const parts = legend.map(([name, colour]) => {
    const width = 30 + 6.6 * name.length;
    if (x + width > WIDTH - RIGHT && x > LEFT) [x, row] = [LEFT, row + 1];
    const y = HEIGHT + 12 + 20 * row;
    const part = `<rect x="${x}" y="${y - 9}" width="11" height="11" rx="2" fill="${colour}"/>${text(x + 17, y, name, "start")}`;
    x += width;
    return part;
  });
  return { text: parts.join(""), height: legend.length ? 24 + 20 * row : 0 };
}

export function plotSvg(plot: Plot): string {
  const { xRange, yRange, lines, mark } = plot;
  const [w, h] = [WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM];
  const place = (x: number, y: number): [number, number] => [
    LEFT + ((x - xRange[0]) / (xRange[1] - xRange[0] || 1)) * w,
    TOP + (1 - (y - yRange[0]) / (yRange[1] - yRange[0] || 1)) * h,
  ];
  const grid = [
    ...ticks(xRange, plot.whole).map((value) => {
      const [x] = place(value, 0);
      return `<path d="M${x.toFixed(1)} ${TOP}v${h + 5}" stroke="${LINE}"/>${text(x, TOP + h + 20, plot.xText(value))}`;
    }),
    ...ticks(yRange).map((value) => {
      const [, y] = place(0, value);
      return `<path d="M${LEFT - 5} ${y.toFixed(1)}h${w + 5}" stroke="${LINE}"/>${text(LEFT - 9, y + 4, plot.yText(value), "end")}`;
    }),
  ];
  const legend = legendOf(plot.legend ?? []);
  const marked = mark
    ? (() => {
        const [x] = place(mark.at, 0),
          right = x > LEFT + w / 2;
        return `<path d="M${x.toFixed(1)} ${TOP}v${h}" stroke="#cc3311" stroke-width="2.5"/>${text(x + (right ? -6 : 6), TOP + 12, mark.label, right ? "end" : "start", ' font-weight="600"')}`;
      })()
    : "";
  const height = HEIGHT + legend.height;
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${WIDTH}" height="${height}" viewBox="0 0 ${WIDTH} ${height}" font-family="system-ui, sans-serif">
<rect width="${WIDTH}" height="${height}" fill="#fff"/>${grid.join("")}
<clipPath id="frame"><rect x="${LEFT}" y="${TOP}" width="${w}" height="${h}"/></clipPath>
<g clip-path="url(#frame)">${lines.map((line) => series(plot, line, place)).join("")}${plot.inner?.(place) ?? ""}</g>${marked}
<path d="M${LEFT} ${TOP}v${h}h${w}" fill="none" stroke="${INK}"/>
${text(LEFT + w / 2, HEIGHT - 14, plot.xLabel)}${text(0, 0, plot.yLabel, "middle", ` transform="translate(18 ${TOP + h / 2}) rotate(-90)"`)}
${legend.text}</svg>`;
}
