/** Do groups differ, by how much, and where: permutation tests, in numbers, in a picture and in a sentence. */
import { useMemo, useState } from "preact/hooks";
import { post, type Schemas } from "../api/client";
import { settled } from "../api/jobs";
import { useLoaded } from "../hooks";
import { Download, Fault, type Key, Keys, Loading, Picture, Select, Warning } from "../parts/basic";
import { CATEGORIES, Chart, colour } from "../parts/chart";
import { Classes, dimensionOf } from "../parts/classes";
import { Figure } from "../parts/figure";
import { type Link, Scale, Solid } from "../parts/solid";
import { canWarp, type Form, Warp } from "../parts/warp";
import { usePlace, useSetting } from "../router";
import { filterBody, filterOf } from "../shape/filter";
import { DASHES, type Look, looksOf } from "../shape/groups";
import { evaluated, hasMesh, isClosed, isDots, type Points, upright } from "../shape/points";
import { nameOf } from "../shape/terms";
import { count, number, percent, probability, t, unit } from "../strings";
import { shown } from "../theme";
import { Chips, CohortPage, useAttributes } from "./cohort";

type Comparison = Schemas["Comparison"];
type Pair = Comparison["pairs"][number];
type Group = Comparison["groups"][number];

export function Compare({ cohort }: { cohort: string }) {
  return (
    <CohortPage cohort={cohort}>
      {(about, _, revision) => <Groups cohort={cohort} about={about} revision={revision} />}
    </CohortPage>
  );
}

export function Progress({ part }: { part: number | null }) {
  return part === null ? (
    <Loading on />
  ) : (
    <div class="card">
      <label class="stack tight">
        <span>{t.jobs.running}</span>
        <progress value={part} max={1} />
      </label>
    </div>
  );
}

function Groups({ cohort, about, revision }: { cohort: string; about: Schemas["CohortOutput"]; revision: number }) {
  const { query } = usePlace();
  const filter = filterOf(query);
  const attributes = useAttributes(cohort, filter, revision);
  const candidates =
    attributes.data?.items.filter(
      (one) => /^(label$|labels\.)/.test(one.name) && one.distinct >= 2 && one.distinct <= 50 && one.missing === 0,
    ) ?? [];
  const [by, setBy] = useSetting("by", "");
  const [transformation, setTransformation] = useSetting("transformation", "similarity");
  const [permutations, setPermutations] = useSetting("permutations", "1000");
  const chosen = by || candidates.find((one) => one.name.startsWith("labels."))?.name || candidates[0]?.name || "";
  const [part, setPart] = useState<number | null>(null);
  const [cursor, setCursor] = useState<number | null>(null);
  const whole = useAttributes(cohort, new URLSearchParams(), revision);
  const looks = useMemo(
    () => looksOf(whole.data?.items.find((one) => one.name === chosen)?.values.map((one) => String(one.value)) ?? []),
    [whole.data, chosen],
  );
  const body: Schemas["CompareRequest"] = {
    cohort,
    by: chosen,
    filter: filterBody(filter),
    transformation: transformation as Schemas["ClassName"],
    permutations: Number(permutations),
  };
  const result = useLoaded(chosen ? JSON.stringify([body, revision]) : null, async (signal) =>
    settled<Comparison>(
      (await post("/v1/comparisons", { body, headers: { prefer: "wait=5" }, signal })) as Comparison,
      signal,
      (job) => setPart(job.progress),
    ),
  );
  const pair =
    result.data && [...result.data.pairs].sort((a, b) => (b.distance.value ?? 0) - (a.distance.value ?? 0))[0];
  return (
    <div class="aside right">
      <div class="stack" style={{ gap: "22px" }}>
        <Chips total={about.shape_count} shown={attributes.data?.shape_count} />
        {attributes.data && candidates.length === 0 && <p class="note warn">{t.compare.noGroups}</p>}
        <Fault error={result.error ?? attributes.error} retry={result.reload} />
        {result.loading && <Progress part={part} />}
        {result.data && pair && (
          <>
            <p class="card say">{sentence(result.data, chosen)}</p>
            {hasMesh(about.representation) ? (
              <div class="card">
                <Picture
                  source={{ method: "POST", path: "/v1/comparisons", body }}
                  name={`${cohort}-groups`}
                  alt={t.compare.alt(pair.first, pair.second)}
                  keys={keysOf(pair)}
                  caption={t.compare.caption(pair.first, pair.second)}
                />
              </div>
            ) : (
              <Averages
                result={result.data}
                pair={pair}
                about={about}
                transformation={transformation}
                looks={looks}
                body={body}
                cursor={cursor}
                onCursor={setCursor}
              />
            )}
            {canWarp(about.representation) && (
              <Warp
                key={chosen}
                about={about}
                forms={formsOf(result.data, pair)}
                superimpose={false}
                turn={upright(result.data.groups[0]!.average as Points, transformation)}
              />
            )}
            {hasMesh(about.representation) && (
              <section class="card">
                <h2>{t.compare.sideBySide}</h2>
                <Linked
                  pair={
                    [pair.first, pair.second].map(
                      (name) => result.data!.groups.find((group) => group.name === name)!,
                    ) as [Group, Group]
                  }
                  representation={about.representation}
                  unit={["rigid", "translation"].includes(transformation) ? (about.length_unit ?? "") : ""}
                />
                <p class="small quiet">
                  {t.compare.linked} {t.compare.coloured(pair.first, pair.second)}
                </p>
              </section>
            )}
            {about.representation.kind.endsWith("curve") && pair.effect.length > 2 && (
              <figure class="card">
                <h2>{t.compare.effect(pair.first, pair.second)}</h2>
                <Chart
                  x={pair.effect.map((one) => one.parameter as number)}
                  lines={[
                    { label: "p", values: pair.effect.map((one) => one.p ?? null), kind: "dots" },
                    { label: "0.05", values: pair.effect.map(() => 0.05), colour: "plus" },
                  ]}
                  xLabel={t.compare.along}
                  yLabel="p"
                  range={[0, 1]}
                  name={`${cohort}-p`}
                  onPlace={setCursor}
                  place={cursor}
                  describe={t.compare.effectAlt(
                    pair.effect.filter((one) => (one.p ?? 1) <= 0.05).length,
                    pair.effect.length,
                  )}
                />
                <figcaption>
                  {t.compare.effectHint(pair.effect.filter((one) => (one.p ?? 1) <= 0.05).length, pair.effect.length)}
                </figcaption>
              </figure>
            )}
            <Permutations result={result.data} pair={pair} />
            <section class="card scroll" tabIndex={0}>
              <h2>{t.compare.pairs}</h2>
              <table>
                <thead>
                  <tr>
                    <th scope="col">{t.compare.pair}</th>
                    <th scope="col" class="number">
                      {t.words.distance}
                    </th>
                    <th scope="col" class="number">
                      R²
                    </th>
                    <th scope="col" class="number">
                      F
                    </th>
                    <th scope="col" class="number">
                      p
                    </th>
                    <th scope="col" class="number">
                      {t.compare.holm}
                    </th>
                  </tr>
                </thead>
                <tbody>
                  {result.data.pairs.map((one) => (
                    <tr key={one.first + one.second}>
                      <th scope="row">
                        {one.first} – {one.second}
                      </th>
                      <td class="number">{number(one.distance.value)}</td>
                      <td class="number">{percent(one.r_squared)}</td>
                      <td class="number">{number(one.pseudo_f.value)}</td>
                      <td class="number">{probability(one.distance.test?.p)}</td>
                      <td class="number">{probability(one.distance.test?.p_holm)}</td>
                    </tr>
                  ))}
                </tbody>
                <tfoot>
                  <tr>
                    <th scope="row">{t.compare.overall}</th>
                    <td />
                    <td class="number">{percent(result.data.overall?.r_squared)}</td>
                    <td class="number">{number(result.data.overall?.pseudo_f.value)}</td>
                    <td class="number">{probability(result.data.overall?.pseudo_f.test?.p)}</td>
                    <td />
                  </tr>
                </tfoot>
              </table>
              <p class="small quiet">{t.compare.pairsHint(result.data.pairs[0]?.distance.test?.permutations ?? 0)}</p>
            </section>
            <section class="card scroll" tabIndex={0}>
              <h2>{t.compare.sizes}</h2>
              <table>
                <thead>
                  <tr>
                    <th scope="col">{t.compare.group}</th>
                    <th scope="col" class="number">
                      {t.words.shapes}
                    </th>
                    <th scope="col" class="number">
                      {t.compare.spread}
                    </th>
                    {result.data.groups[0]?.sizes.map((size) => (
                      <th scope="col" class="number" key={size.measure}>
                        {nameOf(`measures.${size.measure}`)}{" "}
                        {unit(size.measure, about.length_unit) && `(${unit(size.measure, about.length_unit)})`}
                      </th>
                    ))}
                  </tr>
                </thead>
                <tbody>
                  {result.data.groups.map((group) => (
                    <tr key={group.name}>
                      <th scope="row">{group.name}</th>
                      <td class="number">{count(group.shape_count)}</td>
                      <td class="number">{number(group.spread)}</td>
                      {group.sizes.map((size) => (
                        <td class="number" key={size.measure}>
                          {number(size.mean)} ± {number(size.deviation, 3)}
                        </td>
                      ))}
                    </tr>
                  ))}
                </tbody>
              </table>
              <p class="small quiet">{t.compare.sizesHint}</p>
            </section>
            {result.data.warnings.map((warning) => (
              <Warning text={warning} />
            ))}
          </>
        )}
      </div>
      <div class="card no-print">
        <h2>{t.compare.settings}</h2>
        <Select
          label={t.compare.by}
          value={chosen}
          options={candidates.map((one) => [one.name, nameOf(one.name)])}
          onChange={setBy}
        />
        <Select
          label={t.compare.permutations}
          value={permutations}
          options={["200", "1000", "10000"].map((value) => [value, count(Number(value))])}
          onChange={setPermutations}
        />
        <Classes dimension={dimensionOf(about.representation)} value={transformation} onChange={setTransformation} />
        <p class="small quiet">{t.compare.hint}</p>
      </div>
    </div>
  );
}

/** The averages, those of the most distant pair first. */
function formsOf({ groups }: Comparison, pair: Pair): Form[] {
  const rank = (name: string) => (name === pair.first ? 0 : name === pair.second ? 1 : 2);
  return [...groups]
    .sort((a, b) => rank(a.name) - rank(b.name))
    .map(({ name, average }) => ({ id: name, name, points: average as Points }));
}

/** What the colours of surfaces mean. */
const keysOf = (pair: Pair): Key[] => [
  [
    [shown() === "dark" ? "#41434a" : "#dddddd", colour("effect")],
    t.compare.effectKey(pair.first, pair.second, number(longestOf(pair), 3), "surface"),
  ],
];
const longestOf = (pair: Pair): number => Math.max(...pair.effect.map((one) => one.length));

/** From no difference to the longest one. */
const SHADE: [number, number, number][] = [
  [221, 221, 221],
  [136, 0, 85],
];
const shade = (part: number): string =>
  `rgb(${[0, 1, 2].map((c) => Math.round(SHADE[0]![c]! + part * (SHADE[1]![c]! - SHADE[0]![c]!))).join(", ")})`;

/** The averages of all groups, each with its colour and dash, and where the most distant pair differs; places are linked with the plot. */
function Averages({
  result,
  pair,
  about,
  transformation,
  looks,
  body,
  cursor,
  onCursor,
}: {
  result: Comparison;
  pair: Pair;
  about: Schemas["CohortOutput"];
  transformation: string;
  looks: Map<string, Look>;
  body: object;
  cursor: number | null;
  onCursor: (index: number | null) => void;
}) {
  const { representation } = about;
  const dots = isDots(representation),
    closed = isClosed(representation);
  const drawn = useLoaded(JSON.stringify([body, result.cohort_revision]), (signal) =>
    evaluated(
      representation,
      result.groups.map((group) => group.average as Points),
      signal,
    ),
  );
  if (!drawn.data)
    return (
      <>
        <Fault error={drawn.error} />
        <Loading on={drawn.loading} />
      </>
    );
  const turn = upright(drawn.data[0]!, transformation);
  const effect = turn(pair.effect.map((one) => one.point as number[])),
    longest = longestOf(pair) || 1;
  const sets = result.groups.map((group, at) => ({
    name: `${group.name} (n = ${count(group.shape_count)})`,
    points: turn(drawn.data![at]!),
    closed,
    dots,
    ...(looks.get(group.name) ?? { colour: CATEGORIES[at % CATEGORIES.length]!, dash: DASHES[at % DASHES.length]! }),
  }));
  return (
    <figure class="card">
      <Figure
        sets={sets}
        name={`${about.name}-groups`}
        describe={t.compare.alt(pair.first, pair.second)}
        links={dots ? about.name : undefined}
        strip={
          dots
            ? undefined
            : {
                points: effect,
                colours: pair.effect.map((one) => shade(one.length / longest)),
                strong: pair.effect.map((one) => (one.p ?? 1) <= 0.05),
                closed,
              }
        }
        place0={dots ? undefined : effect}
        cursor={cursor === null ? null : (effect[cursor] ?? null)}
        onCursor={onCursor}
      />
      {!dots && (
        <Keys
          keys={[[[shade(0), shade(1)], t.compare.effectKey(pair.first, pair.second, number(longest, 3), "line")]]}
        />
      )}
      <figcaption>{t.compare.caption(pair.first, pair.second)}</figcaption>
      <Download
        name={`${about.name}-groups`}
        source={{ method: "POST", path: "/v1/comparisons", body }}
        formats={[["JSON", "json", "application/json"]]}
      />
    </figure>
  );
}

/** What chance alone would give, and what was found: of all groups, or of the most distant pair. */
function Permutations({ result, pair }: { result: Comparison; pair: Pair }) {
  const whole = result.overall?.histogram ? result.overall : pair;
  const histogram = whole.histogram;
  if (!histogram || !(histogram.upper > 0)) return null;
  const name = whole === pair ? `${pair.first} – ${pair.second}` : t.compare.overall;
  const all = histogram.counts.reduce((sum, one) => sum + one, 0),
    step = histogram.upper / histogram.counts.length;
  const most = Math.max(...histogram.counts),
    test = whole === pair ? pair.pseudo_f.test : result.overall!.pseudo_f.test;
  const sentence = t.compare.chance(percent(whole.r_squared), count(test?.exceeding ?? 0), count(all));
  return (
    <figure class="card">
      <h2>{t.compare.permuted(name)}</h2>
      <Chart
        x={histogram.counts.map((_, bin) => (bin + 0.5) * step)}
        lines={[
          { label: t.compare.relabellings, values: histogram.counts.map((one: number) => one || null), kind: "bars" },
        ]}
        mark={{ at: whole.r_squared, label: t.compare.observed }}
        xLabel={t.compare.explained}
        yLabel={t.compare.relabellings}
        range={[0, most * 1.12]}
        describe={sentence}
        formatX={(value) => percent(value)}
      />
      <Keys
        keys={[
          [colour("accent"), t.compare.relabellings],
          [colour("plus"), `${t.compare.observed}: ${percent(whole.r_squared)}`],
        ]}
      />
      <figcaption>{sentence}</figcaption>
    </figure>
  );
}

/** The averages of two groups, turned together, coloured by where the second one lies outside or inside of the first. */
function Linked({
  pair,
  representation,
  unit,
}: {
  pair: [Group, Group];
  representation: Schemas["Representation"];
  unit: string;
}) {
  const [link] = useState<Link>(() => new Set());
  const [most, setMost] = useState(0);
  const [first, second] = pair.map((group) => ({
    method: "POST" as const,
    path: "/v1/evaluate",
    body: { representation, shapes: [{ control_points: group.average }] },
  }));
  return (
    <>
      <div class="columns" style={{ gridTemplateColumns: "repeat(auto-fit, minmax(min(100%, 220px), 1fr))" }}>
        {pair.map((group, at) => (
          <Solid
            key={group.name}
            link={link}
            height={300}
            describe={group.name}
            caption={`${group.name} (n = ${count(group.shape_count)})`}
            onMost={setMost}
            source={at ? second! : first!}
            against={at ? { source: first!, sign: -1 } : { source: second!, sign: 1 }}
          />
        ))}
      </div>
      {most > 0 && <Scale most={most} unit={unit} ends={[t.solid.inwards, t.solid.outwards]} />}
    </>
  );
}

/** The outcome in plain words. */
function sentence(result: Comparison, by: string): string {
  const name = nameOf(by);
  const p = result.overall?.pseudo_f.test?.p ?? result.pairs[0]?.distance.test?.p;
  const r = result.overall?.r_squared ?? result.pairs[0]?.r_squared ?? 0;
  if (p === null || p === undefined) return t.compare.untested(name);
  const clear = result.pairs.filter((one) => (one.distance.test?.p_holm ?? 1) <= 0.05);
  const head = p <= 0.05 ? t.compare.differ(name, probability(p), percent(r)) : t.compare.same(name, probability(p));
  if (result.pairs.length < 2) return head;
  return `${head} ${clear.length ? t.compare.clear(clear.map((one) => `${one.first} – ${one.second}`).join(", ")) : t.compare.noneClear}`;
}
