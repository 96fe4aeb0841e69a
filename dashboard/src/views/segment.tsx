/** Objects of an image: a box, a contour that finds the edge, corrections by hand, and on; of a volume, slice by slice. */
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { Said, type Schemas } from "../api/client";
import {
  ACCEPT_IMAGES,
  depthOf,
  IMAGE_FORMATS,
  type Plane,
  shownOf,
  sliceOf,
  type Volume,
  volumeOf,
} from "../formats/image";
import { useAction } from "../hooks";
import { Choice, Fault, Field, Loading, Page, Select, save } from "../parts/basic";
import { Chart } from "../parts/chart";
import { Drop } from "../parts/drop";
import { navigate, useSetting } from "../router";
import { handedOverImage, handOver } from "../shape/handover";
import { largestObject } from "../shape/object";
import { evaluated, path } from "../shape/points";
import { asksPolarity, type Box, type Contour, curve, segmented } from "../shape/snake";
import { unitOf } from "../shape/units";
import { count, number, t } from "../strings";

export function Segment() {
  const [volume, setVolume] = useState<Volume>();
  const [plane, setPlane] = useState<Plane>(2);
  const [index, setIndex] = useState(0);
  const [url, setUrl] = useState("");
  const [opening, setOpening] = useState(false);
  const [box, setBox] = useState<Box>();
  const [drag, setDrag] = useState<{ kind: "box"; x: number; y: number } | { kind: "point"; index: number }>();
  const [found, setFound] = useState<Contour>();
  const [moved, setMoved] = useState(false);
  const [error, setError] = useState<Error>();
  const [term, setTerm] = useSetting("term", "contour");
  const [polarity, setPolarity] = useSetting("polarity", "bright");
  const [sigma, setSigma] = useSetting("sigma", "1");
  const [size, setSize] = useSetting("points", "16");
  const svg = useRef<SVGSVGElement>(null);
  const slice = useMemo(() => volume && sliceOf(volume, plane, index), [volume, plane, index]);
  const depth = volume ? depthOf(volume, plane) : 1;
  const [width, height] = slice ? [slice.size[0] * slice.spacing[0], slice.size[1] * slice.spacing[1]] : [1, 1];
  const [sx, sy] = slice?.spacing ?? [1, 1];
  useEffect(() => {
    if (!volume || !slice) return;
    let own: string | undefined,
      left = false;
    void shownOf(volume, slice).then((blob) => {
      if (left) return;
      own = URL.createObjectURL(blob);
      setUrl(own);
    });
    return () => {
      left = true;
      // The picture stays until the next one is there.
      if (own) setTimeout(URL.revokeObjectURL, 1000, own);
    };
  }, [slice]);
  const points = Number(size) || 16;
  const middle = (of: Volume, across: Plane) => {
    const {
      size: [w, h],
      spacing,
    } = sliceOf(of, across, 0);
    setBox({ x: 0.25 * w * spacing[0], y: 0.25 * h * spacing[1], w: 0.5 * w * spacing[0], h: 0.5 * h * spacing[1] });
  };
  const turn = (of: Volume, across: Plane) => {
    setPlane(across);
    setIndex(Math.floor(depthOf(of, across) / 2));
    setFound(undefined);
    middle(of, across);
  };
  const open = async ([file]: File[]) => {
    setOpening(true);
    try {
      const read = await volumeOf(file!);
      setVolume(read);
      turn(read, 2);
      const object = read.size[2] === 1 ? largestObject(sliceOf(read, 2, 0)) : null;
      if (object) {
        setBox(object.box);
        setPolarity(object.polarity);
      }
      setError(undefined);
    } catch {
      setError(new Said(t.segment.unreadable(file!.name)));
    }
    setOpening(false);
  };
  useEffect(() => {
    const file = handedOverImage();
    if (file) void open([file]);
  }, []);
  const run = useAction(async (resume: boolean) => {
    const start = resume && found ? { control: found.control } : { box: box! };
    setFound(await segmented(volume!, slice!, { term, polarity, sigma: Number(sigma) || 1, points }, start));
    setMoved(false);
  });
  const at = (event: PointerEvent): [number, number] => {
    const view = svg.current!.getBoundingClientRect();
    // The picture may be narrower than its element.
    const scale = Math.max(width / view.width, height / view.height);
    return [
      (event.clientX - view.left - view.width / 2) * scale + width / 2 - 0.5 * sx,
      (event.clientY - view.top - view.height / 2) * scale + height / 2 - 0.5 * sy,
    ];
  };
  const begin = (event: PointerEvent) => {
    svg.current!.setPointerCapture(event.pointerId);
    const [x, y] = at(event);
    const reach = width / 40;
    const near = found
      ? found.control.map((p, index) => ({ index, d: Math.hypot(p[0]! - x, p[1]! - y) })).sort((a, b) => a.d - b.d)[0]
      : undefined;
    if (near && near.d < reach) setDrag({ kind: "point", index: near.index });
    else {
      setFound(undefined);
      setBox({ x, y, w: 0, h: 0 });
      setDrag({ kind: "box", x, y });
    }
  };
  const place = (index: number, [x, y]: [number, number]) => {
    if (!found) return;
    const control = found.control.map((p, one) => (one === index ? [x, y] : p));
    setFound({ ...found, control });
    setMoved(true);
    return control;
  };
  const move = (event: PointerEvent) => {
    if (!drag) return;
    const [x, y] = at(event);
    if (drag.kind === "box")
      setBox({ x: Math.min(x, drag.x), y: Math.min(y, drag.y), w: Math.abs(x - drag.x), h: Math.abs(y - drag.y) });
    else place(drag.index, [x, y]);
  };
  const redraw = async (of: Contour, control: number[][]) => {
    const [outline] = await evaluated(curve(points), [control]);
    setFound({ ...of, control, outline: outline! });
  };
  const end = async () => {
    if (drag?.kind === "point" && found) await redraw(found, found.control);
    if (drag?.kind === "box" && box && (box.w < 3 * sx || box.h < 3 * sy)) setBox(undefined);
    setDrag(undefined);
  };
  const step = (event: KeyboardEvent, index: number) => {
    const by = (
      { ArrowLeft: [-sx, 0], ArrowRight: [sx, 0], ArrowUp: [0, -sy], ArrowDown: [0, sy] } as Record<
        string,
        [number, number]
      >
    )[event.key];
    if (!by || !found) return;
    event.preventDefault();
    const p = found.control[index]!;
    const control = place(index, [p[0]! + by[0], p[1]! + by[1]]);
    if (control) void redraw(found, control);
  };
  const setSide = (side: keyof Box, value: string) => {
    setFound(undefined);
    setBox({ ...(box ?? { x: 0, y: 0, w: 20 * sx, h: 20 * sy }), [side]: Number(value) });
  };
  const show = (to: number) => {
    setIndex(to);
    // The contour of one slice is the beginning on the next one.
    if (found) setMoved(true);
  };
  const shape = () =>
    [
      { external_id: depth > 1 ? `${volume!.name}-${index}` : volume!.name, points: found!.outline },
    ] as Schemas["ShapeInput"][];
  const radius = width / 170;
  return (
    <Page title={t.menu.segment} lead={t.segment.lead}>
      <Fault error={error} />
      <Loading on={opening} />
      {!volume && !opening && (
        <Drop
          title={t.segment.drop}
          hint={t.segment.formats(IMAGE_FORMATS)}
          accept={ACCEPT_IMAGES}
          onFiles={(files) => void open(files)}
        />
      )}
      {volume && slice && (
        <div class="aside right">
          <div class="stack" style={{ gap: "22px" }}>
            <figure class="card">
              <div class="slice">
                <svg
                  ref={svg}
                  viewBox={`${-0.5 * sx} ${-0.5 * sy} ${width} ${height}`}
                  style={{
                    width: `min(100%, ${((70 * width) / height).toFixed(1)}vh)`,
                    aspectRatio: `${width} / ${height}`,
                    margin: "0 auto",
                    touchAction: "none",
                    cursor: "crosshair",
                    background: "var(--sunken)",
                  }}
                  role="group"
                  aria-label={t.segment.alt(volume.name)}
                  onPointerDown={begin}
                  onPointerMove={move}
                  onPointerUp={() => void end()}
                >
                  {url && (
                    <image
                      href={url}
                      x={-0.5 * sx}
                      y={-0.5 * sy}
                      width={width}
                      height={height}
                      preserveAspectRatio="none"
                      style={{ imageRendering: "pixelated" }}
                    />
                  )}
                  {box && !found && (
                    <rect
                      x={box.x}
                      y={box.y}
                      width={box.w}
                      height={box.h}
                      fill="none"
                      stroke="#ffb000"
                      stroke-width="2"
                      vector-effect="non-scaling-stroke"
                    />
                  )}
                  {found && (
                    <path
                      class="contour"
                      d={path(
                        found.outline.map((p) => [p[0]!, -p[1]!]),
                        true,
                      )}
                      fill="none"
                      stroke="#00d0e4"
                      stroke-width="2.2"
                      stroke-dasharray={moved ? "7 4" : undefined}
                      vector-effect="non-scaling-stroke"
                    />
                  )}
                  {found?.control.map((p, index) => (
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
                  {slice.sides?.map((letter, side) => (
                    <text
                      key={letter}
                      class="side-letter"
                      font-size={height / 22}
                      text-anchor="middle"
                      dominant-baseline="central"
                      x={side === 0 ? width / 30 : side === 1 ? (width * 29) / 30 - sx : width / 2}
                      y={side === 2 ? height / 30 : side === 3 ? (height * 29) / 30 - sy : height / 2}
                    >
                      {letter}
                    </text>
                  ))}
                </svg>
              </div>
              {volume.size[2] > 1 && (
                <div class="form no-print">
                  <Select
                    label={t.segment.plane}
                    value={String(plane)}
                    options={([2, 1, 0] as Plane[]).map((one) => [
                      String(one),
                      (volume.anatomy ? t.segment.planes : t.segment.across)[one]!,
                    ])}
                    onChange={(value) => turn(volume, Number(value) as Plane)}
                  />
                  <label class="slider wide">
                    <span>{t.segment.slice}</span>
                    <input
                      type="range"
                      min={0}
                      max={depth - 1}
                      step={1}
                      value={index}
                      aria-valuetext={t.segment.sliceOf(index + 1, depth)}
                      onInput={(event) => show(Number(event.currentTarget.value))}
                    />
                    <output class="number">{t.segment.sliceOf(index + 1, depth)}</output>
                  </label>
                </div>
              )}
              <figcaption>
                {found ? t.segment.correct : t.segment.box} {t.segment.size(count(slice.size[0]), count(slice.size[1]))}
                {volume.hasLengths && ` ${t.segment.spacing(number(sx, 3), number(sy, 3))}`}
              </figcaption>
              <div class="row">
                <button
                  class="main"
                  disabled={run.busy || (!box && !found)}
                  onClick={() => run.run(Boolean(found && moved))}
                >
                  {found && moved ? t.segment.resume : t.segment.run}
                </button>
                {found && (
                  <>
                    <button
                      onClick={() => {
                        handOver({ shapes: shape(), unit: unitOf(volume) });
                        navigate("/app/assess");
                      }}
                    >
                      {t.segment.assess}
                    </button>
                    <button
                      onClick={() =>
                        save(
                          new Blob([JSON.stringify(shape()[0], null, 1)], { type: "application/json" }),
                          `${shape()[0]!.external_id}.json`,
                        )
                      }
                    >
                      ↓ JSON
                    </button>
                  </>
                )}
                {found && <button onClick={() => setFound(undefined)}>{t.segment.again}</button>}
                <button
                  onClick={() => {
                    setVolume(undefined);
                    setFound(undefined);
                    setUrl("");
                  }}
                >
                  {t.segment.other}
                </button>
              </div>
              <Loading on={run.busy} />
              <Fault error={run.error} />
            </figure>
            {found && found.history.length > 1 && (
              <figure class="card">
                <h2>{t.segment.history}</h2>
                <Chart
                  x={found.history.map((_, index) => index)}
                  lines={[{ label: t.segment.energy, values: found.history }]}
                  xLabel={t.segment.iteration}
                  yLabel={t.segment.energy}
                  describe={t.segment.history}
                />
              </figure>
            )}
          </div>
          <div class="stack" style={{ gap: "22px" }}>
            <div class="card">
              <h2>{t.compare.settings}</h2>
              <Select
                label={t.segment.term}
                value={term}
                options={Object.entries(t.segment.terms).map(([id, [name]]) => [id, name])}
                onChange={setTerm}
              />
              <p class="small quiet">{t.segment.terms[term as keyof typeof t.segment.terms]?.[1]}</p>
              {asksPolarity(term) && (
                <div class="stack tight">
                  <span class="legend">{t.segment.polarity}</span>
                  <Choice
                    label={t.segment.polarity}
                    value={polarity}
                    options={[
                      ["bright", t.segment.bright],
                      ["dark", t.segment.dark],
                    ]}
                    onChange={setPolarity}
                  />
                </div>
              )}
              <Field label={t.segment.sigma}>
                <input
                  type="number"
                  min={0.5}
                  max={20}
                  step={0.5}
                  value={sigma}
                  onInput={(event) => setSigma(event.currentTarget.value)}
                />
              </Field>
              <Field label={t.segment.points}>
                <input
                  type="number"
                  min={4}
                  max={128}
                  value={size}
                  onInput={(event) => {
                    setFound(undefined);
                    setSize(event.currentTarget.value);
                  }}
                />
              </Field>
              <fieldset class="stack tight">
                <legend>{t.segment.boxOf(volume.hasLengths ? "mm" : t.segment.pixels)}</legend>
                <div class="form" style={{ gridTemplateColumns: "1fr 1fr" }}>
                  {(["x", "y", "w", "h"] as const).map((side) => (
                    <Field key={side} label={t.segment.sides[side]}>
                      <input
                        type="number"
                        step="any"
                        value={box ? Math.round(10 * box[side]) / 10 : ""}
                        onChange={(event) => setSide(side, event.currentTarget.value)}
                      />
                    </Field>
                  ))}
                </div>
              </fieldset>
            </div>
            {found && (
              <div class="card">
                <h2>{t.segment.result}</h2>
                <p>{(t.segment.stops as Record<string, string>)[found.stop] ?? found.stop}</p>
                <dl class="facts">
                  <dt>{t.segment.iterations}</dt>
                  <dd>{found.iterations}</dd>
                  {Object.entries(found.energies).map(([name, value]) => (
                    <>
                      <dt>{name}</dt>
                      <dd>{number(typeof value === "number" ? value : (value as { value?: number }).value)}</dd>
                    </>
                  ))}
                </dl>
                {found.warnings.map((warning) => (
                  <p class="note warn">{typeof warning === "string" ? warning : JSON.stringify(warning)}</p>
                ))}
              </div>
            )}
          </div>
        </div>
      )}
    </Page>
  );
}
