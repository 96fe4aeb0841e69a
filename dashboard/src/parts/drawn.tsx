/** Drawings of the page as files: SVG for papers, PNG for slides; on white, whatever the colours of the page. */
import { useState } from "preact/hooks";
import { t } from "../strings";
import { Fault } from "./basic";
import { save } from "./save";

/** Pixels of a PNG for each of the drawing. */
const SCALE = 3;
const COPIED = [
  "fill",
  "fill-opacity",
  "stroke",
  "stroke-opacity",
  "stroke-dasharray",
  "opacity",
  "font-size",
  "font-weight",
  "text-anchor",
];
/** The colours of the dark scheme, as they are on paper. */
const LIGHT: Record<string, string> = {
  "--ink": "#181b20",
  "--quiet": "#565e6b",
  "--line": "#dfe3e8",
  "--accent": "#0b6b78",
  "--minus": "#4477aa",
  "--plus": "#cc3311",
  "--pale": "#9a9a9a",
  "--effect": "#880055",
  "--surface": "#ffffff",
};

/** An element as it is shown, with its style written into it and lines in its own units, as programs for drawings want them. */
export function serialised(svg: SVGSVGElement): string {
  const root = document.documentElement,
    names = Object.keys(LIGHT);
  const before = names.map((name) => root.style.getPropertyValue(name));
  for (const name of names) root.style.setProperty(name, LIGHT[name]!);
  const copy = svg.cloneNode(true) as SVGSVGElement;
  const own = [svg, ...svg.querySelectorAll<SVGElement>("*")],
    their = [copy, ...copy.querySelectorAll<SVGElement>("*")];
  own.forEach((one, at) => {
    const style = getComputedStyle(one),
      target = their[at]!;
    for (const name of COPIED) {
      const value = style.getPropertyValue(name);
      if (value && value !== "none" && value !== "normal") target.setAttribute(name, value);
      else if (value === "none" && (name === "fill" || name === "stroke")) target.setAttribute(name, value);
    }
    const matrix = one instanceof SVGGraphicsElement ? one.getScreenCTM() : null;
    const fixed = style.getPropertyValue("vector-effect") === "non-scaling-stroke";
    const scale = fixed && matrix ? Math.hypot(matrix.a, matrix.b) || 1 : 1;
    if (style.stroke !== "none")
      target.setAttribute("stroke-width", String(Number.parseFloat(style.strokeWidth) / scale));
    if (fixed && style.strokeDasharray !== "none")
      target.setAttribute(
        "stroke-dasharray",
        style.strokeDasharray
          .split(/[ ,]+/)
          .map((part) => Number.parseFloat(part) / scale)
          .join(" "),
      );
    target.removeAttribute("class");
    target.removeAttribute("style");
    target.removeAttribute("vector-effect");
    target.removeAttribute("tabindex");
  });
  names.forEach((name, at) =>
    before[at] ? root.style.setProperty(name, before[at]!) : root.style.removeProperty(name),
  );
  const frame = svg.getBoundingClientRect();
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  copy.setAttribute("width", String(Math.round(frame.width) || 640));
  copy.setAttribute("height", String(Math.round(frame.height) || 480));
  copy.setAttribute("font-family", "system-ui, sans-serif");
  return copy.outerHTML.replace(/&nbsp;/g, "&#160;");
}

/** An SVG as a picture of pixels, on white. */
async function pixels(svg: string): Promise<Blob> {
  const url = URL.createObjectURL(new Blob([svg], { type: "image/svg+xml" }));
  try {
    const image = new Image();
    image.src = url;
    await image.decode();
    const canvas = new OffscreenCanvas(image.width * SCALE, image.height * SCALE),
      context = canvas.getContext("2d")!;
    context.fillStyle = "#fff";
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    return await canvas.convertToBlob({ type: "image/png" });
  } finally {
    URL.revokeObjectURL(url);
  }
}

/** Buttons that save a drawing, made at the moment of saving. */
export function SaveDrawing({ name, of }: { name: string; of: () => string | undefined }) {
  const [error, setError] = useState<Error>();
  const keep = async (format: "svg" | "png") => {
    const svg = of();
    if (!svg) return;
    try {
      save(format === "svg" ? new Blob([svg], { type: "image/svg+xml" }) : await pixels(svg), `${name}.${format}`);
      setError(undefined);
    } catch (fault) {
      setError(fault as Error);
    }
  };
  return (
    <div class="downloads no-print">
      {(["svg", "png"] as const).map((format) => (
        <button
          key={format}
          class="plain small"
          onClick={() => void keep(format)}
          aria-label={`${t.act.download} ${name} ${format.toUpperCase()}`}
        >
          ↓ {format.toUpperCase()}
        </button>
      ))}
      <Fault error={error} />
    </div>
  );
}
