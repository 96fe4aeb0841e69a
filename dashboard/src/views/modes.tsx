/** Sliders over modes of variation; shapes morph in the browser. */
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { useLoaded } from "../hooks";
import { Download, Fault, Loading, Picture } from "../parts/basic";
import { Figure } from "../parts/figure";
import { Solid } from "../parts/solid";
import { useSetting } from "../router";
import { deviationsOf, type Model, modelOf } from "../shape/model";
import { hasMesh, isClosed, isDots, type Points, sum } from "../shape/points";
import { number, percent, t } from "../strings";
import { type About, DictionaryPage } from "./dictionary";

const REACH = 3;

export function Modes({ dictionary }: { dictionary: string }) {
  return (
    <DictionaryPage dictionary={dictionary}>
      {(about) => <Sliders about={about} dictionary={dictionary} />}
    </DictionaryPage>
  );
}

function Sliders({ about, dictionary }: { about: About; dictionary: string }) {
  const shown = Math.min(about.atoms.length, 8);
  const [text, setText] = useSetting("sigma", "");
  const [values, setValues] = useState<number[]>(() =>
    Array.from({ length: shown }, (_, index) => Number(text.split(",")[index]) || 0),
  );
  const [playing, setPlaying] = useState(-1);
  const timer = useRef<ReturnType<typeof setTimeout>>(undefined);
  // The address follows when the hand rests: browsers refuse too many changes of it.
  useEffect(() => {
    clearTimeout(timer.current);
    if (playing < 0)
      timer.current = setTimeout(
        () =>
          setText(values.some(Boolean) ? values.map((value) => value.toFixed(1).replace(/\.0$/, "")).join(",") : ""),
        400,
      );
    return () => clearTimeout(timer.current);
  }, [values, playing]);
  useEffect(() => {
    if (playing < 0) return;
    const start = performance.now();
    let frame = requestAnimationFrame(function step(now) {
      const value = 2 * Math.sin((now - start) / 700);
      setValues((before) => before.map((old, index) => (index === playing ? value : old)));
      frame = requestAnimationFrame(step);
    });
    return () => cancelAnimationFrame(frame);
  }, [playing]);
  const set = (index: number, value: number) => {
    setPlaying(-1);
    setValues(values.map((old, at) => (at === index ? value : old)));
  };
  const path = `/v1/dictionaries/${encodeURIComponent(dictionary)}/modes`;
  // The weight 1 of a morph target stands for two standard deviations.
  const weights = useMemo(() => values.map((value) => value / 2), [values]);
  return (
    <div class="aside right">
      <div class="stack" style={{ gap: "22px" }}>
        <div class="card">
          {hasMesh(about.representation) ? (
            <>
              <Solid source={{ path }} weights={weights} describe={t.modes.alt} />
              <SolidFiles about={about} dictionary={dictionary} values={values} />
            </>
          ) : (
            <Morph about={about} dictionary={dictionary} values={values} />
          )}
        </div>
        <Strip path={path} about={about} values={values} />
      </div>
      <section class="card">
        <div class="row spread">
          <h2>{t.modes.sliders}</h2>
          <button
            class="plain"
            onClick={() => {
              setPlaying(-1);
              setValues(values.map(() => 0));
            }}
          >
            {t.modes.reset}
          </button>
        </div>
        <div class="sliders">
          {values.map((value, index) => (
            <div class="stack tight" key={index}>
              <label class="slider">
                <span>{t.modes.mode(index + 1)}</span>
                <input
                  type="range"
                  min={-REACH}
                  max={REACH}
                  step={0.05}
                  value={value}
                  aria-valuetext={`${number(value, 2)} σ`}
                  onInput={(event) => set(index, Number(event.currentTarget.value))}
                />
                <output class="number">{number(Math.round(value * 10) / 10, 2)} σ</output>
              </label>
              <div class="row spread small quiet">
                <span>{t.dictionary.share(percent(about.atoms[index]!.explained))}</span>
                <button
                  class="plain small"
                  aria-pressed={playing === index}
                  aria-label={`${playing === index ? t.modes.stop : t.modes.play}: ${t.modes.mode(index + 1)}`}
                  onClick={() => setPlaying(playing === index ? -1 : index)}
                >
                  {playing === index ? t.modes.stop : t.modes.play}
                </button>
              </div>
            </div>
          ))}
        </div>
        <p class="small quiet">{t.modes.hint}</p>
      </section>
    </div>
  );
}

/** The surface at the sliders as a file. */
function SolidFiles({ about, dictionary, values }: { about: About; dictionary: string; values: number[] }) {
  const deviations = useLoaded(about.id, (signal) => deviationsOf(about, dictionary, signal));
  if (!deviations.data) return <Fault error={deviations.error} />;
  const control_points = sum(
    (about.centre ?? about.mean.control_points) as Points,
    values.map((value, index) => [value * deviations.data![index]!, about.atoms[index]!.control_points as Points]),
  );
  return (
    <Download
      name={`${about.name}-shape`}
      source={{
        method: "POST",
        path: "/v1/evaluate",
        body: { representation: about.representation, shapes: [{ control_points }] },
      }}
      formats={[
        ["OBJ", "obj", "model/obj"],
        ["PLY", "ply", "application/ply"],
        ["STL", "stl", "model/stl"],
        ["glTF", "gltf", "model/gltf-binary"],
      ]}
    />
  );
}

function Strip({ path, about, values }: { path: string; about: About; values: number[] }) {
  const most = values.reduce((best, value, index) => (Math.abs(value) > Math.abs(values[best]!) ? index : best), 0) + 1;
  const [settled, setSettled] = useState(most);
  useEffect(() => {
    const timer = setTimeout(() => setSettled(most), 500);
    return () => clearTimeout(timer);
  }, [most]);
  return (
    <div class="card">
      <h2>{t.modes.one(settled)}</h2>
      <Picture
        source={{ path, query: { component: settled, sigma: 2 } }}
        name={`${about.name}-mode-${settled}`}
        alt={t.modes.one(settled)}
        caption={t.modes.stripCaption}
      />
    </div>
  );
}

function Morph({ about, dictionary, values }: { about: About; dictionary: string; values: number[] }) {
  const model = useLoaded(about.id, (signal) => modelOf(about, dictionary, signal));
  const fit = useMemo(() => model.data && extremes(model.data, values.length), [model.data]);
  if (!model.data || !fit)
    return (
      <>
        <Fault error={model.error} />
        <Loading on={model.loading} />
      </>
    );
  const closed = isClosed(about.representation),
    dots = isDots(about.representation);
  const shape = sum(
    model.data.mean,
    values.map((value, index) => [value * model.data!.deviations[index]!, model.data!.components[index]!]),
  );
  return (
    <figure>
      <Figure
        fit={fit}
        height={420}
        describe={t.modes.alt}
        name={`${about.name}-shape`}
        legend={false}
        links={dots ? (about.cohort_name ?? about.name) : undefined}
        sets={[
          { name: "mean", points: model.data.mean, closed, dots, pale: true, colour: "var(--pale)" },
          { name: "shape", points: shape, closed, dots, colour: "var(--accent)" },
        ]}
      />
      <figcaption>{t.modes.caption}</figcaption>
    </figure>
  );
}

/** The mean and the shapes at the ends of the sliders, which the frame holds. */
function extremes(model: Model, shown: number): Points[] {
  const sides = model.components
    .slice(0, shown)
    .flatMap((component, index) =>
      [-1, 1].map((side) => sum(model.mean, [[side * 2.5 * model.deviations[index]!, component]])),
    );
  return [model.mean, ...sides];
}
