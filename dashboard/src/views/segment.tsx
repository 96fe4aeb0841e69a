/** Objects of an image: a box, a contour that finds the edge, corrections by hand, and on. */
import { useEffect, useRef, useState } from "preact/hooks";
import { postImage, type Schemas } from "../api/client";
import { Chart } from "../parts/chart";
import { Choice, Fault, Field, Loading, Page, Select, save } from "../parts/basic";
import { Drop } from "../parts/drop";
import { useAction } from "../hooks";
import { navigate, useSetting } from "../router";
import { evaluated, path, type Points } from "../shape/points";
import { handOver } from "../shape/handover";
import { count, number, t } from "../strings";

type Box = { x: number; y: number; w: number; h: number };
interface Found { control: Points; outline: Points; stop: string; iterations: number; energies: Record<string, unknown>; history: number[]; warnings: string[] }

/** Pictures of the browser become grey PNG, which the service reads: luma as it would make it. */
async function greyOf(file: File): Promise<{ blob: Blob; width: number; height: number }> {
  const bitmap = await createImageBitmap(file);
  const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
  canvas.getContext("2d")!.drawImage(bitmap, 0, 0);
  return { blob: await canvas.convertToBlob({ type: "image/png" }), width: bitmap.width, height: bitmap.height };
}

export function Segment() {
  const [image, setImage] = useState<{ blob: Blob; url: string; width: number; height: number; name: string }>();
  const [box, setBox] = useState<Box>();
  const [drag, setDrag] = useState<{ kind: "box"; x: number; y: number } | { kind: "point"; index: number }>();
  const [found, setFound] = useState<Found>();
  const [moved, setMoved] = useState(false);
  const [error, setError] = useState<Error>();
  const [term, setTerm] = useSetting("term", "contour");
  const [polarity, setPolarity] = useSetting("polarity", "bright");
  const [sigma, setSigma] = useSetting("sigma", "1");
  const [size, setSize] = useSetting("points", "16");
  const svg = useRef<SVGSVGElement>(null);
  useEffect(() => () => { if (image) URL.revokeObjectURL(image.url); }, [image]);
  const representation = { kind: "closed_curve", dimension: 2, control_points: Number(size) || 16, generator: { name: "trigonometric" } } as Schemas["Representation"];
  const open = async ([file]: File[]) => {
    try {
      const { blob, width, height } = await greyOf(file!);
      setImage({ blob, url: URL.createObjectURL(blob), width, height, name: file!.name.replace(/\.[^.]*$/, "") });
      setBox({ x: 0.25 * width, y: 0.25 * height, w: 0.5 * width, h: 0.5 * height });
      setFound(undefined);
      setError(undefined);
    } catch {
      setError(new Error(t.segment.unreadable(file!.name)));
    }
  };
  const run = useAction(async (resume: boolean) => {
    const start = resume && found ? { shapes: [{ control_points: found.control }] } : { boxes: [{ lower: [box!.x, box!.y], upper: [box!.x + box!.w, box!.y + box!.h] }] };
    const s = Number(sigma) || 1;
    const stages = resume ? [{ free: "all", sigma: s }] : [{ free: "affine", sigma: 2 * s }, { free: "all", sigma: 2 * s }, { free: "all", sigma: s }];
    const parameters = { representation, coordinates: "index", history: true, stages, terms: [term === "contour" ? { name: "contour", polarity } : { name: term, polarity }, { name: "spacing", weight: 0.1 }], ...start };
    const answer = await postImage<Schemas["SegmentAnswer"]>("/v1/segment", parameters, image!.blob);
    const one = answer.results[0]!;
    const control = one.control_points as Points;
    const [outline] = await evaluated(representation, [control]);
    const stagesDone = one.stages as { history?: number[] | null }[];
    setFound({ control, outline: outline!, stop: one.stop, iterations: one.iterations, energies: one.energies, warnings: one.warnings, history: stagesDone.flatMap((stage) => stage.history ?? []) });
    setMoved(false);
  });
  const at = (event: PointerEvent): [number, number] => {
    const view = svg.current!.getBoundingClientRect();
    return [((event.clientX - view.left) / view.width) * image!.width - 0.5, ((event.clientY - view.top) / view.height) * image!.height - 0.5];
  };
  const begin = (event: PointerEvent) => {
    svg.current!.setPointerCapture(event.pointerId);
    const [x, y] = at(event);
    const reach = image!.width / 40;
    const near = found ? found.control.map((p, index) => ({ index, d: Math.hypot(p[0]! - x, p[1]! - y) })).sort((a, b) => a.d - b.d)[0] : undefined;
    if (near && near.d < reach) setDrag({ kind: "point", index: near.index });
    else {
      setFound(undefined);
      setBox({ x, y, w: 0, h: 0 });
      setDrag({ kind: "box", x, y });
    }
  };
  const move = (event: PointerEvent) => {
    if (!drag) return;
    const [x, y] = at(event);
    if (drag.kind === "box") setBox({ x: Math.min(x, drag.x), y: Math.min(y, drag.y), w: Math.abs(x - drag.x), h: Math.abs(y - drag.y) });
    else if (found) {
      setFound({ ...found, control: found.control.map((p, index) => (index === drag.index ? [x, y] : p)) });
      setMoved(true);
    }
  };
  const end = async () => {
    if (drag?.kind === "point" && found) {
      const [outline] = await evaluated(representation, [found.control]);
      setFound({ ...found, outline: outline! });
    }
    if (drag?.kind === "box" && box && (box.w < 3 || box.h < 3)) setBox(undefined);
    setDrag(undefined);
  };
  const number_of = (value: string) => Math.round(Number(value));
  const setSide = (side: keyof Box, value: string) => {
    setFound(undefined);
    setBox({ ...(box ?? { x: 0, y: 0, w: 20, h: 20 }), [side]: number_of(value) });
  };
  const shape = () => [{ external_id: image!.name, points: found!.outline }] as Schemas["ShapeInput"][];
  return (
    <Page title={t.menu.segment} lead={t.segment.lead}>
      <Fault error={error} />
      {!image && <Drop title={t.segment.drop} hint={t.segment.formats} accept="image/png,image/jpeg,image/webp" onFiles={(files) => void open(files)} />}
      {image && (
        <div class="aside right">
          <div class="stack" style={{ gap: "22px" }}>
            <figure class="card">
              <svg ref={svg} viewBox={`-0.5 -0.5 ${image.width} ${image.height}`} style={{ width: "100%", maxHeight: "70vh", touchAction: "none", cursor: "crosshair", background: "var(--sunken)" }} role="img" aria-label={t.segment.alt(image.name)} onPointerDown={begin} onPointerMove={move} onPointerUp={() => void end()}>
                <image href={image.url} x={-0.5} y={-0.5} width={image.width} height={image.height} style={{ imageRendering: "pixelated" }} />
                {box && !found && <rect x={box.x} y={box.y} width={box.w} height={box.h} fill="none" stroke="#ffb000" stroke-width="2" vector-effect="non-scaling-stroke" />}
                {found && <path d={path(found.outline.map((p) => [p[0]!, -p[1]!]), true)} fill="none" stroke="#00d0e4" stroke-width="2.2" vector-effect="non-scaling-stroke" />}
                {found?.control.map((p) => <circle cx={p[0]} cy={p[1]} r={image.width / 170} fill="#fff" stroke="#00828f" stroke-width="1.5" vector-effect="non-scaling-stroke" />)}
              </svg>
              <figcaption>{found ? t.segment.correct : t.segment.box} {t.segment.size(count(image.width), count(image.height))}</figcaption>
              <div class="row">
                <button class="main" disabled={run.busy || (!box && !found)} onClick={() => run.run(Boolean(found && moved))}>{found && moved ? t.segment.resume : t.segment.run}</button>
                {found && <><button onClick={() => { handOver(shape()); navigate("/app/assess"); }}>{t.segment.assess}</button><button onClick={() => save(new Blob([JSON.stringify(shape()[0], null, 1)], { type: "application/json" }), `${image.name}.json`)}>↓ JSON</button></>}
                <button onClick={() => { setImage(undefined); setFound(undefined); }}>{t.segment.other}</button>
              </div>
              <Loading on={run.busy} />
              <Fault error={run.error} />
            </figure>
            {found && found.history.length > 1 && (
              <figure class="card"><h2>{t.segment.history}</h2><Chart x={found.history.map((_, index) => index)} lines={[{ label: t.segment.energy, values: found.history }]} xLabel={t.segment.iteration} yLabel={t.segment.energy} describe={t.segment.history} /></figure>
            )}
          </div>
          <div class="stack" style={{ gap: "22px" }}>
            <div class="card">
              <h2>{t.compare.settings}</h2>
              <Select label={t.segment.term} value={term} options={Object.entries(t.segment.terms).map(([id, [name]]) => [id, name])} onChange={setTerm} />
              <p class="small quiet">{t.segment.terms[term as keyof typeof t.segment.terms]?.[1]}</p>
              <div class="stack tight"><span class="legend">{t.segment.polarity}</span><Choice label={t.segment.polarity} value={polarity} options={[["bright", t.segment.bright], ["dark", t.segment.dark]]} onChange={setPolarity} /></div>
              <Field label={t.segment.sigma}><input type="number" min={0.5} max={20} step={0.5} value={sigma} onInput={(event) => setSigma(event.currentTarget.value)} /></Field>
              <Field label={t.segment.points}><input type="number" min={4} max={128} value={size} onInput={(event) => { setFound(undefined); setSize(event.currentTarget.value); }} /></Field>
              <fieldset class="stack tight"><legend>{t.segment.boxOf}</legend><div class="form" style={{ gridTemplateColumns: "1fr 1fr" }}>
                {(["x", "y", "w", "h"] as const).map((side) => <Field key={side} label={t.segment.sides[side]}><input type="number" value={box ? Math.round(box[side]) : ""} onChange={(event) => setSide(side, event.currentTarget.value)} /></Field>)}
              </div></fieldset>
            </div>
            {found && (
              <div class="card">
                <h2>{t.segment.result}</h2>
                <p>{(t.segment.stops as Record<string, string>)[found.stop] ?? found.stop}</p>
                <dl class="facts"><dt>{t.segment.iterations}</dt><dd>{found.iterations}</dd>{Object.entries(found.energies).map(([name, value]) => <><dt>{name}</dt><dd>{number(typeof value === "number" ? value : (value as { value?: number }).value)}</dd></>)}</dl>
                {found.warnings.map((warning) => <p class="note warn">{typeof warning === "string" ? warning : JSON.stringify(warning)}</p>)}
              </div>
            )}
          </div>
        </div>
      )}
    </Page>
  );
}
