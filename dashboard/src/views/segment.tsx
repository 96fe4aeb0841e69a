/** Objects of an image: boxes, contours that find the edges, corrections by hand, and on; of a volume, slice by slice. */
import { useEffect, useMemo, useState } from "preact/hooks";
import { useMay } from "../api/caller";
import { Refusal, Said } from "../api/client";
import {
  ACCEPT_IMAGES,
  depthOf,
  IMAGE_FORMATS,
  type Plane,
  type Slice,
  shownOf,
  sliceOf,
  type Volume,
  volumeOf,
} from "../formats/image";
import { useAction } from "../hooks";
import { Across } from "../parts/across";
import { Choice, Fault, Field, Loading, Page, Select, save, Warning } from "../parts/basic";
import { Chart } from "../parts/chart";
import { Drop } from "../parts/drop";
import { type Item, SlicePicture } from "../parts/slice";
import { type Shaped, StoreShapes } from "../parts/store";
import { navigate, useSetting } from "../router";
import { handedOverImage, handOver } from "../shape/handover";
import { objectsOf } from "../shape/object";
import { evaluated } from "../shape/points";
import {
  asksPolarity,
  type Box,
  type Contour,
  curve,
  isLost,
  segmented,
  segmentedAll,
  type Wanted,
} from "../shape/snake";
import { unitOf } from "../shape/units";
import { count, number, t } from "../strings";

/** States that *undo* goes back to. */
const REMEMBERED = 50;
/** Part of a picture's values below which it is too dark to be seen as it is. */
const DARK = 0.4;

let last = 0;
const fresh = (box: Box, proposed = false): Item => ({ id: ++last, box, proposed });

/** A box in the middle of a slice. */
function middle({ size: [w, h], spacing: [sx, sy] }: Slice): Box {
  return { x: 0.25 * w * sx, y: 0.25 * h * sy, w: 0.5 * w * sx, h: 0.5 * h * sy };
}

/** Objects, of which one is chosen, with the way back. */
function useItems() {
  const [state, setState] = useState<{ items: Item[]; chosen: number }>({ items: [], chosen: 0 });
  const [past, setPast] = useState<{ items: Item[]; chosen: number }[]>([]);
  const put = (items: Item[], chosen = state.chosen) => {
    setPast((before) => [...before, state].slice(-REMEMBERED));
    setState({ items, chosen });
  };
  const own = state.items.find((item) => item.id === state.chosen);
  return {
    ...state,
    own,
    put,
    /** Changes the chosen object; `quiet` leaves no step to go back to, as a drag has many. */
    change: (change: Partial<Item>, quiet = false) => {
      const items = state.items.map((item) => (item.id === state.chosen ? { ...item, ...change } : item));
      if (quiet) setState({ ...state, items });
      else put(items);
    },
    choose: (chosen: number) => setState({ ...state, chosen }),
    begin: (items: Item[]) => {
      setPast([]);
      setState({ items, chosen: items[0]?.id ?? 0 });
    },
    undo: past.length
      ? () => {
          setState(past[past.length - 1]!);
          setPast(past.slice(0, -1));
        }
      : undefined,
  };
}

/** Brightness and contrast as the range of values from black to white; none is that of the picture. */
function useWindow(volume: Volume | undefined) {
  const [light, setLight] = useState(0);
  const [contrast, setContrast] = useState(0);
  useEffect(() => {
    setLight(0);
    setContrast(0);
  }, [volume]);
  const range = useMemo((): [number, number] | undefined => {
    if (!volume) return undefined;
    const [low, high] = volume.range,
      dark = volume.colours && high < DARK * 255;
    if (!light && !contrast && !dark) return undefined;
    const centre = (low + high) / 2 - 0.5 * light * (high - low),
      half = ((high - low) / 2) * 2 ** -contrast;
    return [centre - half, centre + half];
  }, [volume, light, contrast]);
  return { light, setLight, contrast, setContrast, range };
}

export function Segment() {
  const [volume, setVolume] = useState<Volume>();
  const [plane, setPlane] = useState<Plane>(2);
  const [index, setIndex] = useState(0);
  const [url, setUrl] = useState("");
  const [opening, setOpening] = useState(false);
  const [error, setError] = useState<Error>();
  const [storing, setStoring] = useState(false);
  const objects = useItems();
  const writes = useMay("writer");
  const { items, own } = objects;
  const [term, setTerm] = useSetting("term", "contour");
  const [polarity, setPolarity] = useSetting("polarity", "bright");
  const [sigma, setSigma] = useSetting("sigma", "1");
  const [size, setSize] = useSetting("points", "16");
  const view = useWindow(volume);
  const slice = useMemo(() => volume && sliceOf(volume, plane, index), [volume, plane, index]);
  const depth = volume ? depthOf(volume, plane) : 1;
  const [sx, sy] = slice?.spacing ?? [1, 1];
  useEffect(() => {
    if (!volume || !slice) return;
    let address: string | undefined,
      left = false;
    void shownOf(volume, slice, view.range).then((blob) => {
      if (left) return;
      address = URL.createObjectURL(blob);
      setUrl(address);
    });
    return () => {
      left = true;
      // The picture stays until the next one is there.
      if (address) setTimeout(URL.revokeObjectURL, 1000, address);
    };
  }, [slice, view.range]);
  const points = Number(size) || 16;
  const wanted: Wanted = { term, polarity, sigma: Number(sigma) || 1, points };
  const turn = (of: Volume, across: Plane) => {
    setPlane(across);
    setIndex(Math.floor(depthOf(of, across) / 2));
    objects.begin([fresh(middle(sliceOf(of, across, 0)), true)]);
  };
  const open = async ([file]: File[]) => {
    setOpening(true);
    try {
      const read = await volumeOf(file!);
      setVolume(read);
      turn(read, 2);
      const object = read.size[2] === 1 ? objectsOf(sliceOf(read, 2, 0))[0] : undefined;
      if (object) {
        objects.begin([fresh(object.box, true)]);
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
  const placed = (item: Item, found: Contour, at = index): Item => ({
    ...item,
    found,
    moved: false,
    proposed: false,
    levels: [...(item.levels ?? []).filter(([level]) => level !== at), [at, found]],
  });
  const resumes = Boolean(own?.found && own.moved);
  /** Contours of all boxes without one; of the chosen object, when it goes on, that alone. */
  const run = useAction(async () => {
    if (resumes) {
      const found = await segmented(volume!, slice!, wanted, { control: own!.found!.control });
      objects.put(items.map((item) => (item.id === own!.id ? placed(item, found) : item)));
      return;
    }
    const waiting = items.filter((item) => !item.found);
    const all = await segmentedAll(volume!, slice!, wanted, { boxes: waiting.map((item) => item.box) });
    objects.put(items.map((item) => (item.found ? item : placed(item, all[waiting.indexOf(item)]!))));
  });
  /** Through the slices above or below, as far as the object is there. */
  const follow = useAction(async (way: 1 | -1) => {
    let item = own!;
    for (let at = index + way; at >= 0 && at < depth; at += way) {
      const next = sliceOf(volume!, plane, at);
      // Where the object ends, nothing of it may be left that a contour could find.
      const found = await segmented(volume!, next, wanted, { control: item.found!.control }).catch((error: Error) => {
        if (error instanceof Refusal) return null;
        throw error;
      });
      if (!found || isLost(found) || !isLike(item.found!, found)) break;
      item = placed(item, found, at);
      setIndex(at);
      objects.put(items.map((one) => (one.id === item.id ? item : one)));
    }
  });
  const redraw = async (item: Item, control: number[][]) => {
    const [outline] = await evaluated(curve(points), [control]);
    objects.put(
      items.map((one) =>
        one.id === item.id ? { ...one, moved: true, found: { ...item.found!, control, outline: outline! } } : one,
      ),
    );
  };
  const corrected = (at: number, place: [number, number]) =>
    own!.found!.control.map((p, k) => (k === at ? [...place] : p));
  const drawn = (box: Box) => {
    const kept = items.filter((item) => !(item.proposed && !item.found));
    const next = fresh(box);
    objects.put([...kept, next], next.id);
  };
  const setSide = (side: keyof Box, value: string) =>
    objects.change({ box: { ...own!.box, [side]: Number(value) }, found: undefined, proposed: false, levels: [] });
  const show = (to: number) => {
    setIndex(to);
    // The contour of one slice is the beginning on the next one.
    if (items.some((item) => item.found))
      objects.put(
        items.map((item) => {
          const level = item.levels?.find(([at]) => at === to)?.[1];
          return level ? { ...item, found: level, moved: false } : { ...item, moved: Boolean(item.found) };
        }),
      );
  };
  const shapesOf = (item: Item): Shaped[] => {
    const name = items.length > 1 ? `${volume!.name}/${items.indexOf(item) + 1}` : volume!.name;
    if (depth === 1) return item.found ? [{ external_id: name, points: item.found.outline }] : [];
    const levels = [...(item.levels ?? [])].sort((a, b) => a[0] - b[0]);
    return levels.map(([at, found]) => ({ external_id: `${name}-${at}`, points: found.outline }));
  };
  const good = items.filter((item) => item.found && !isLost(item.found));
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
              <SlicePicture
                key={`${volume.name} ${plane}`}
                name={volume.name}
                slice={slice}
                url={url}
                items={items}
                chosen={objects.chosen}
                onChoose={objects.choose}
                onBox={drawn}
                onPoint={(at, place) =>
                  objects.change({ moved: true, found: { ...own!.found!, control: corrected(at, place) } }, true)
                }
                onPointEnd={(at, place) => void redraw(own!, place ? corrected(at, place) : own!.found!.control)}
              />
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
              <Window view={view} />
              <figcaption>
                {own?.found ? t.segment.correct : t.segment.box}{" "}
                {t.segment.size(count(slice.size[0]), count(slice.size[1]))}
                {volume.hasLengths && ` ${t.segment.spacing(number(sx, 3), number(sy, 3))}`}
              </figcaption>
              <div class="row">
                <button
                  class="main"
                  disabled={run.busy || follow.busy || !(resumes || items.some((item) => !item.found))}
                  onClick={() => run.run()}
                >
                  {resumes ? t.segment.resume : t.segment.run}
                </button>
                {good.length > 0 && (
                  <>
                    {writes && (
                      <button class="main" onClick={() => setStoring(true)}>
                        {t.segment.store}
                      </button>
                    )}
                    <button
                      onClick={() => {
                        handOver({ shapes: (own?.found ? [own] : good).flatMap(shapeNow), unit: unitOf(volume) });
                        navigate("/app/assess");
                      }}
                    >
                      {t.segment.assess}
                    </button>
                  </>
                )}
                {own?.found && (
                  <button onClick={() => objects.change({ found: undefined, moved: false })}>{t.segment.again}</button>
                )}
                {objects.undo && <button onClick={objects.undo}>{t.act.undo}</button>}
                {good.length > 0 && (
                  <button
                    onClick={() =>
                      save(
                        new Blob([JSON.stringify({ shapes: good.flatMap(shapesOf) }, null, 1)], {
                          type: "application/json",
                        }),
                        `${volume.name}.json`,
                      )
                    }
                  >
                    ↓ JSON
                  </button>
                )}
                <button
                  onClick={() => {
                    setVolume(undefined);
                    objects.begin([]);
                    setUrl("");
                  }}
                >
                  {t.segment.other}
                </button>
              </div>
              {depth > 1 && own?.found && !isLost(own.found) && (
                <div class="row">
                  <button disabled={follow.busy} onClick={() => follow.run(1)}>
                    {t.segment.followUp}
                  </button>
                  <button disabled={follow.busy} onClick={() => follow.run(-1)}>
                    {t.segment.followDown}
                  </button>
                  <span class="small quiet">{t.segment.levels(own.levels?.length ?? 0)}</span>
                </div>
              )}
              <Loading on={run.busy || follow.busy} />
              <Fault error={run.error ?? follow.error} />
            </figure>
            {volume.size[2] > 1 && own && (
              <Across volume={volume} plane={plane} index={index} item={own} range={view.range} />
            )}
            {own?.found?.history.some((stage) => stage.length > 1) && <Course history={own.found.history} />}
          </div>
          <div class="stack" style={{ gap: "22px" }}>
            <Objects
              items={items}
              chosen={objects.chosen}
              onChoose={objects.choose}
              onRemove={(id) => {
                const rest = items.filter((item) => item.id !== id);
                objects.put(rest, rest[rest.length - 1]?.id ?? 0);
              }}
              onAdd={() => {
                const next = fresh(middle(slice));
                objects.put([...items, next], next.id);
              }}
              onPropose={() => {
                const found = objectsOf(slice).map(({ box }) =>
                  fresh({ x: box.x * sx, y: box.y * sy, w: box.w * sx, h: box.h * sy }),
                );
                if (found.length) objects.put([...items.filter((item) => item.found), ...found], found[0]!.id);
                else setError(new Said(t.assess.noObject));
              }}
            />
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
                    objects.put(items.map((item) => ({ ...item, found: undefined, moved: false, levels: [] })));
                    setSize(event.currentTarget.value);
                  }}
                />
              </Field>
              {own && (
                <fieldset class="stack tight">
                  <legend>{t.segment.boxOf(volume.hasLengths ? "mm" : t.segment.pixels)}</legend>
                  <div class="form" style={{ gridTemplateColumns: "1fr 1fr" }}>
                    {(["x", "y", "w", "h"] as const).map((side) => (
                      <Field key={side} label={t.segment.sides[side]}>
                        <input
                          type="number"
                          step="any"
                          value={Math.round(10 * own.box[side]) / 10}
                          onChange={(event) => setSide(side, event.currentTarget.value)}
                        />
                      </Field>
                    ))}
                  </div>
                </fieldset>
              )}
            </div>
            {own?.found && <Result found={own.found} />}
          </div>
        </div>
      )}
      {storing && volume && (
        <StoreShapes
          shapes={good.flatMap(shapesOf)}
          unit={unitOf(volume)}
          file={volume.name}
          points={points}
          onClose={() => setStoring(false)}
        />
      )}
    </Page>
  );

  /** The contour that is shown, as a shape: of a volume that of this slice. */
  function shapeNow(item: Item): Shaped[] {
    const name = items.length > 1 ? `${volume!.name}/${items.indexOf(item) + 1}` : volume!.name;
    return item.found ? [{ external_id: depth > 1 ? `${name}-${index}` : name, points: item.found.outline }] : [];
  }
}

/** Whether the contour of the next slice can be that of the same object: it is about as large, and lies over it. */
function isLike(before: Contour, after: Contour): boolean {
  const extent = ({ outline }: Contour) =>
    [0, 1].map((axis) => {
      const values = outline.map((p) => p[axis]!);
      return [Math.min(...values), Math.max(...values)] as const;
    });
  const [a, b] = [extent(before), extent(after)];
  const sizes = [a, b].map(([x, y]) => (x![1] - x![0]) * (y![1] - y![0])) as [number, number];
  const ratio = sizes[1] / (sizes[0] || 1);
  const apart = a.some(([low, high], axis) => b[axis]![0] > high || b[axis]![1] < low);
  return !apart && ratio > 0.15 && ratio < 4;
}

function Window({ view }: { view: ReturnType<typeof useWindow> }) {
  const slider = (label: string, value: number, set: (value: number) => void) => (
    <label class="slider wide">
      <span>{label}</span>
      <input
        type="range"
        min={-3}
        max={3}
        step={0.1}
        value={value}
        onInput={(event) => set(Number(event.currentTarget.value))}
      />
      <output class="number">{number(value, 2)}</output>
    </label>
  );
  return (
    <div class="form no-print">
      {slider(t.segment.brightness, view.light, view.setLight)}
      {slider(t.segment.contrast, view.contrast, view.setContrast)}
    </div>
  );
}

/** The objects as a list: their state, choice, and removal. */
function Objects({
  items,
  chosen,
  onChoose,
  onRemove,
  onAdd,
  onPropose,
}: {
  items: Item[];
  chosen: number;
  onChoose: (id: number) => void;
  onRemove: (id: number) => void;
  onAdd: () => void;
  onPropose: () => void;
}) {
  return (
    <section class="card">
      <h2>{t.segment.objects}</h2>
      <ul class="objects">
        {items.map((item, at) => (
          <li key={item.id}>
            <button class="plain" aria-pressed={item.id === chosen} onClick={() => onChoose(item.id)}>
              {t.segment.object(at + 1)}
            </button>
            <span class={`tag ${!item.found ? "" : isLost(item.found) ? "bad" : "good"}`}>
              {!item.found ? t.segment.boxed : isLost(item.found) ? t.segment.lost : t.segment.found}
            </span>
            <button class="plain" onClick={() => onRemove(item.id)} aria-label={t.segment.drop1(at + 1)}>
              ✕
            </button>
          </li>
        ))}
      </ul>
      <div class="row">
        <button onClick={onAdd}>{t.segment.add}</button>
        <button onClick={onPropose}>{t.segment.propose}</button>
      </div>
    </section>
  );
}

function Result({ found }: { found: Contour }) {
  const names = t.segment.energies;
  return (
    <div class="card">
      <h2>{t.segment.result}</h2>
      <p class={isLost(found) ? "note bad" : ""}>
        {(t.segment.stops as Record<string, string>)[found.stop] ?? t.segment.stops.limit}
      </p>
      <dl class="facts">
        <dt>{t.segment.iterations}</dt>
        <dd>{count(found.iterations)}</dd>
        {found.energies.map(
          ([name, value]) =>
            names[name] && (
              <>
                <dt>{names[name]}</dt>
                <dd>{number(value, 3)}</dd>
              </>
            ),
        )}
      </dl>
      {found.warnings.map((warning) => (
        <Warning key={warning} text={warning} />
      ))}
    </div>
  );
}

/** The energy after each step, one line for each stage: stages have scales of their own. */
function Course({ history }: { history: number[][] }) {
  const steps = history.flat();
  let before = 0;
  const lines = history.map((stage, at) => {
    const from = before;
    before += stage.length;
    return {
      label: t.segment.stage(at + 1),
      values: steps.map((_, k) => (k >= from && k < from + stage.length ? stage[k - from]! : null)),
      colour: ["accent", "plus", "minus"][at % 3]!,
    };
  });
  return (
    <figure class="card">
      <h2>{t.segment.history}</h2>
      <Chart
        x={steps.map((_, k) => k)}
        lines={lines}
        xLabel={t.segment.iteration}
        yLabel={t.segment.energy}
        describe={t.segment.history}
      />
      <figcaption>{t.segment.historyHint}</figcaption>
    </figure>
  );
}
