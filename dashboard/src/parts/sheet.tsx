/** Contact sheets: outlines that the service draws, pictures of surfaces, and landmarks in space that the page projects. */
import { useMemo, useRef, useState } from "preact/hooks";
import { get, send } from "../api/client";
import { useLoaded } from "../hooks";
import { useSetting } from "../router";
import { linksOf, useLinks } from "../shape/links";
import type { Points } from "../shape/points";
import { nameOf } from "../shape/terms";
import { type Flat, projection, START } from "../shape/view";
import { number, t } from "../strings";
import { Choice, Download, Fault, Field, PICTURES, Picture } from "./basic";
import { SaveDrawing, serialised } from "./drawn";

/** The paths of a contact sheet, which the service draws, each a link to its shape. */
export function Sheet({
  cohort,
  filter,
  revision,
  total,
  names,
}: {
  cohort: string;
  filter: URLSearchParams;
  revision: number;
  total: number;
  names: string[];
}) {
  const [cursor, setCursor] = useSetting("cursor", "");
  const [scale, setScale] = useSetting("scale", "");
  const [order] = useSetting("order", "");
  const [largest, setLargest] = useState(1);
  const query = new URLSearchParams(filter);
  for (const [name, value] of [
    ["columns", "1"],
    ["size", "96"],
    ["limit", "90"],
    ["title", "false"],
    ["scale_bar", "false"],
    ["background", "none"],
    ["theme", "light"],
  ])
    query.append(name!, value!);
  if (cursor) query.set("cursor", cursor);
  if (order) query.set("order", order);
  const sheet = useLoaded(`${cohort} ${query} ${revision}`, async (signal) => {
    const response = await send("GET", `/v1/cohorts/${encodeURIComponent(cohort)}/sheet?${query}`, {
      headers: { accept: "image/svg+xml" },
      signal,
    });
    const next = /[?&]cursor=([^&>]*)/.exec(response.headers.get("link") ?? "")?.[1];
    const drawing = new DOMParser().parseFromString(await response.text(), "image/svg+xml");
    const cells = [...drawing.querySelectorAll("g, path")]
      .filter((one) => [...one.children].some((child) => child.tagName === "title"))
      .map((one) => ({
        id: [...one.children].find((child) => child.tagName === "title")!.textContent ?? "",
        paths: (one.tagName === "path" ? [one] : [...one.querySelectorAll("path")]).map(
          (path) => path.getAttribute("d") ?? "",
        ),
        // Landmarks: lines without length, whose round ends are dots of one size on the screen.
        dots: [...one.querySelectorAll("circle")]
          .map((dot) => `M${dot.getAttribute("cx")} ${dot.getAttribute("cy")}h0`)
          .join(""),
      }));
    return { cells, next: next ? decodeURIComponent(next) : "" };
  });
  return (
    <section class="card" aria-busy={sheet.loading}>
      <div class="row spread">
        <div class="row">
          <h2>{t.cohort.sheet}</h2>
          <Choice
            label={t.cohort.scale}
            value={scale}
            options={[
              ["", t.cohort.oneScale],
              ["own", t.cohort.ownScale],
            ]}
            onChange={setScale}
          />
          <Order names={names} />
        </div>
        <Download
          name={`${cohort}-sheet`}
          source={{
            path: `/v1/cohorts/${encodeURIComponent(cohort)}/sheet`,
            query: order ? new URLSearchParams([...filter, ["order", order]]) : filter,
            ownWidth: true,
          }}
          formats={PICTURES}
        />
      </div>
      <Fault error={sheet.error} />
      {sheet.data?.cells.length === 0 && total > 0 && <p class="quiet">{t.cohort.nothing}</p>}
      <div class="sheet">
        {sheet.data?.cells.map((cell) => (
          <a
            key={cell.id}
            href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(cell.id)}`}
            title={cell.id}
            aria-label={cell.id}
          >
            <Cell
              paths={cell.paths}
              dots={cell.dots}
              size={scale === "own" ? undefined : largest}
              onSize={(size) => setLargest((before) => Math.max(before, size))}
            />
          </a>
        ))}
      </div>
      <Pages cursor={cursor} next={sheet.data?.next} onNext={(next) => setCursor(next, false)} />
    </section>
  );
}

/** The order of the contact sheet, which is that of the table too. */
function Order({ names }: { names: string[] }) {
  const [order, setOrder] = useSetting("order", "");
  const choices = names.flatMap((name): [string, string][] => [
    [name, `${nameOf(name)} ↑`],
    [`-${name}`, `${nameOf(name)} ↓`],
  ]);
  return (
    <select aria-label={t.cohort.order} value={order} onChange={(event) => setOrder(event.currentTarget.value)}>
      <option value="">{t.cohort.asAdded}</option>
      {choices.map(([id, text]) => (
        <option key={id} value={id} selected={id === order}>
          {text}
        </option>
      ))}
    </select>
  );
}

/** The way to the pages before and after. */
export function Pages({
  cursor,
  next,
  onNext,
}: {
  cursor: string;
  next: string | null | undefined;
  onNext: (next: string) => void;
}) {
  if (!cursor && !next) return null;
  return (
    <div class="row">
      {cursor && <button onClick={() => history.back()}>{t.act.previous}</button>}
      {next && <button onClick={() => onNext(next)}>{t.act.next}</button>}
    </div>
  );
}

/** Surfaces are pictures of the service, twelve a page, with links below. */
export function SolidSheet({
  cohort,
  filter,
  revision,
  names,
}: {
  cohort: string;
  filter: URLSearchParams;
  revision: number;
  names: string[];
}) {
  const path = `/v1/cohorts/${encodeURIComponent(cohort)}`;
  const [cursor, setCursor] = useSetting("cursor", "");
  const [order] = useSetting("order", "");
  const page: [string, string][] = [...filter, ["limit", "12"]];
  if (order) page.push(["order", order]);
  if (cursor) page.push(["cursor", cursor]);
  const query = new URLSearchParams([...page, ["columns", "4"], ["size", "170"]]);
  const listed = useLoaded(`${cohort} ${query} ${revision}`, (signal) =>
    get("/v1/cohorts/{cohort}/shapes", {
      path: { cohort },
      query: new URLSearchParams([...page, ["fields", "id,external_id"]]),
      signal,
    }),
  );
  return (
    <section class="card">
      <div class="row">
        <h2>{t.cohort.sheet}</h2>
        <Order names={names} />
      </div>
      <Picture
        key={`${revision} ${cursor} ${order}`}
        source={{ path: `${path}/sheet`, query, ownWidth: true }}
        name={`${cohort}-sheet`}
        alt={t.cohort.sheet}
      />
      <Fault error={listed.error} />
      <div class="chips">
        {listed.data?.items.map((one) => (
          <a
            class="tag"
            key={one.id}
            href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(one.external_id ?? one.id ?? "")}`}
          >
            {one.external_id ?? one.id}
          </a>
        ))}
      </div>
      <Pages cursor={cursor} next={listed.data?.next} onNext={(next) => setCursor(next, false)} />
    </section>
  );
}

/** A shape in the middle of its cell: `size` units of the sheet wide, or as large as fits. */
function Cell({
  paths,
  dots,
  size,
  onSize,
}: {
  paths: string[];
  dots: string;
  size: number | undefined;
  onSize: (size: number) => void;
}) {
  const [bounds, setBounds] = useState<DOMRect>();
  const measure = (group: SVGGElement | null) => {
    if (!group || bounds) return;
    const found = group.getBBox();
    setBounds(found);
    onSize(Math.max(found.width, found.height));
  };
  const side = 1.04 * (size ?? (bounds ? Math.max(bounds.width, bounds.height) : 640));
  const view = bounds
    ? `${bounds.x + bounds.width / 2 - side / 2} ${bounds.y + bounds.height / 2 - side / 2} ${side} ${side}`
    : "0 0 640 640";
  return (
    <svg viewBox={view} aria-hidden="true">
      <g ref={measure}>
        {paths.map((d) => (
          <path class="line" d={d} />
        ))}
        {dots && <path class="line dots" d={dots} />}
      </g>
    </svg>
  );
}

/** Landmarks in space, all seen from one side: what is near is large and strong. */
export function SpatialSheet({
  cohort,
  filter,
  revision,
  names,
}: {
  cohort: string;
  filter: URLSearchParams;
  revision: number;
  names: string[];
}) {
  const [cursor, setCursor] = useSetting("cursor", "");
  const [scale, setScale] = useSetting("scale", "");
  const [order] = useSetting("order", "");
  const [numbers, setNumbers] = useState(false);
  const [yaw, setYaw] = useState(START[0]);
  const [text, setText] = useLinks(cohort);
  const sheet = useRef<HTMLDivElement>(null);
  const query = new URLSearchParams([...filter, ["fields", "id,external_id,control_points"], ["limit", "60"]]);
  if (cursor) query.set("cursor", cursor);
  if (order) query.set("order", order);
  const listed = useLoaded(`${cohort} ${query} ${revision}`, (signal) =>
    get("/v1/cohorts/{cohort}/shapes", { path: { cohort }, query, signal }),
  );
  const cells = useMemo(
    () =>
      (listed.data?.items ?? []).map((one) => ({
        id: one.external_id ?? one.id ?? "",
        ...centred(one.control_points as Points),
      })),
    [listed.data],
  );
  const largest = Math.max(...cells.map((one) => one.radius), 1e-9);
  return (
    <section class="card" aria-busy={listed.loading}>
      <div class="row">
        <h2>{t.cohort.sheet}</h2>
        <Choice
          label={t.cohort.scale}
          value={scale}
          options={[
            ["", t.cohort.oneScale],
            ["own", t.cohort.ownScale],
          ]}
          onChange={setScale}
        />
        <Order names={names} />
      </div>
      <Fault error={listed.error} />
      {listed.data?.items.length === 0 && <p class="quiet">{t.cohort.nothing}</p>}
      <div class={`sheet${numbers ? " large" : ""}`} ref={sheet}>
        {cells.map(({ id, points, radius }) => (
          <a key={id} href={`/app/cohorts/${encodeURIComponent(cohort)}/shapes/${encodeURIComponent(id)}`} title={id}>
            <span class="hidden">{id}</span>
            <Seen
              points={points}
              radius={scale === "own" ? radius : largest}
              turn={[yaw, START[1]]}
              numbers={numbers}
              links={text}
            />
          </a>
        ))}
      </div>
      <div class="form no-print">
        <label class="slider wide">
          <span>{t.cohort.turn}</span>
          <input
            type="range"
            min={-Math.PI}
            max={Math.PI}
            step={Math.PI / 36}
            value={yaw}
            aria-valuetext={`${number(Math.round((yaw * 180) / Math.PI), 3)}°`}
            onInput={(event) => setYaw(Number(event.currentTarget.value))}
          />
          <output class="number">{number(Math.round((yaw * 180) / Math.PI), 3)}°</output>
        </label>
        <label class="check">
          <input type="checkbox" checked={numbers} onChange={(event) => setNumbers(event.currentTarget.checked)} />
          <span>{t.figure.numbers}</span>
        </label>
        <Field label={t.figure.links}>
          <input
            value={text}
            placeholder="1-2-3, 4-5"
            spellcheck={false}
            onInput={(event) => setText(event.currentTarget.value)}
          />
        </Field>
      </div>
      <p class="small quiet">{t.cohort.depth}</p>
      <SaveDrawing
        name={`${cohort}-sheet`}
        of={() =>
          joined(
            [...sheet.current!.querySelectorAll("svg")].map(serialised),
            cells.map(({ id }) => id),
          )
        }
      />
      <Pages cursor={cursor} next={listed.data?.next} onNext={(next) => setCursor(next, false)} />
    </section>
  );
}

/** Pixels of a shape in a file, and shapes side by side. */
const [SIZE, COLUMNS] = [150, 8];

/** Drawings beside each other with their names, as one. */
function joined(drawings: string[], names: string[]): string {
  const rows = Math.ceil(drawings.length / COLUMNS),
    tall = SIZE + 16;
  const cells = drawings.map((svg, at) => {
    const [x, y] = [(at % COLUMNS) * SIZE, Math.floor(at / COLUMNS) * tall];
    const own = svg
      .replace(/ width="\d+"/, ` width="${SIZE}"`)
      .replace(/ height="\d+"/, ` height="${SIZE}"`)
      .replace("<svg", `<svg x="${x}" y="${y}"`);
    const name = names[at]!.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
    return `${own}<text x="${x + SIZE / 2}" y="${y + SIZE + 8}" font-size="11" text-anchor="middle" fill="#181b20">${name}</text>`;
  });
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${COLUMNS * SIZE}" height="${rows * tall}" font-family="system-ui, sans-serif">${cells.join("")}</svg>`;
}

/** Points about their mean, and the radius of the ball around it that holds them, however they are turned. */
function centred(points: Points): { points: Points; radius: number } {
  const mean = [0, 1, 2].map((axis) => points.reduce((sum, p) => sum + p[axis]!, 0) / Math.max(points.length, 1));
  const moved = points.map((p) => p.map((x, axis) => x - mean[axis]!));
  return { points: moved, radius: Math.max(...moved.map((p) => Math.hypot(...p)), 1e-9) };
}

/** One of them: far points first, so that near ones lie over them. */
function Seen({
  points,
  radius,
  turn,
  numbers,
  links,
}: {
  points: Points;
  radius: number;
  turn: Flat;
  numbers: boolean;
  links: string;
}) {
  const { flat, near } = projection(turn);
  const places = points.map((p, at) => {
    const [x, y] = flat(p);
    return { at, x: (100 * x) / radius, y: (100 * y) / radius, near: (1 + near(p) / radius) / 2 };
  });
  const shade = (part: number) => 0.3 + 0.7 * part;
  return (
    <svg viewBox="-112 -112 224 224" aria-hidden="true">
      {linksOf(links, points.length).map(([from, to]) => {
        const [a, b] = [places[from]!, places[to]!];
        return (
          <path
            key={`${from} ${to}`}
            class="line"
            d={`M${a.x} ${a.y}L${b.x} ${b.y}`}
            stroke-opacity={shade((a.near + b.near) / 2)}
          />
        );
      })}
      {[...places]
        .sort((a, b) => a.near - b.near)
        .map(({ at, x, y, near: part }) => (
          <g key={at}>
            <circle class="dot" cx={x} cy={y} r={3.5 + 6 * part} fill-opacity={shade(part)} />
            {numbers && (
              <text class="dot" x={x + 10} y={y - 7} font-size="17" fill-opacity={Math.max(shade(part), 0.75)}>
                {at + 1}
              </text>
            )}
          </g>
        ))}
    </svg>
  );
}
