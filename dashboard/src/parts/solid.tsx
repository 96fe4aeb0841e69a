/** Surfaces that can be turned around. three.js is read when the first one is shown. */
import { useEffect, useRef, useState } from "preact/hooks";
import { search, send } from "../api/client";
import { useWidth } from "../hooks";
import { number, t } from "../strings";
import { shown } from "../theme";
import { Fault, Loading, type Source } from "./basic";
import type { Place, Stage } from "./stage";

/** Scenes that turn together: each tells the others where its camera is. */
export type Link = Set<(place: Place, from: object) => void>;

/** Another surface of the same mesh, by whose difference the vertices are coloured: to it (1), or from it (−1). */
export interface Against {
  source: Source;
  sign: 1 | -1;
}

/** What the colours of differences mean; `most` is the length of the longest one. */
export function Scale({ most, unit, ends }: { most: number; unit: string; ends: [string, string] }) {
  const length = `${number(most, 2)}${unit && `\u00a0${unit}`}`;
  return (
    <p class="scale">
      <span>
        {ends[0]} {length}
      </span>
      <i />
      <span>
        {ends[1]} {length}
      </span>
    </p>
  );
}

function meshOf(source: Source, signal: AbortSignal): Promise<ArrayBuffer> {
  const query = new URLSearchParams(search(source.query));
  query.set("format", "gltf");
  const headers: Record<string, string> = { accept: "model/gltf-binary" };
  if (source.body) headers["content-type"] = "application/json";
  return send(source.method ?? "GET", `${source.path}?${query}`, {
    headers,
    signal,
    body: source.body && JSON.stringify(source.body),
  }).then((response) => response.arrayBuffer());
}

export function Solid({
  source,
  describe,
  weights,
  height = 440,
  link,
  caption,
  against,
  onMost,
}: {
  source: Source;
  describe: string;
  weights?: number[];
  height?: number;
  link?: Link;
  caption?: string;
  against?: Against;
  onMost?: (most: number) => void;
}) {
  const [ref, width] = useWidth<HTMLDivElement>();
  const stage = useRef<Stage | undefined>(undefined);
  const seen = useRef<Place | undefined>(undefined);
  const [state, setState] = useState<{ ready?: boolean; error?: Error }>({});
  const theme = shown();
  const key = JSON.stringify([source, search(source.query), against]);
  useEffect(() => {
    if (!ref.current || !width) return;
    const abort = new AbortController();
    const element = ref.current;
    Promise.all([import("./stage"), meshOf(source, abort.signal), against && meshOf(against.source, abort.signal)])
      .then(async ([{ createStage }, mesh, other]) => {
        if (abort.signal.aborted) return;
        // The camera finds its place before there is a stage to name.
        let own: Stage | undefined;
        const turned = (place: Place) => {
          if (!own) return;
          seen.current = place;
          link?.forEach((tell) => tell(place, own!));
        };
        own = await createStage(
          element,
          mesh,
          width,
          height,
          theme === "dark",
          turned,
          other && { mesh: other, sign: against!.sign },
        );
        // Another surface is seen from where the one before was.
        if (seen.current) own.follow(seen.current);
        stage.current = own;
        onMost?.(own.most);
        if (weights) stage.current.morph(weights);
        setState({ ready: true });
      })
      .catch((error: Error) => !abort.signal.aborted && setState({ error }));
    return () => {
      abort.abort();
      stage.current?.dispose();
      stage.current = undefined;
    };
  }, [key, theme, width > 0]);
  useEffect(() => {
    if (!link) return;
    const follow = (place: Place, from: object) => {
      if (from !== stage.current) stage.current?.follow(place);
    };
    link.add(follow);
    return () => void link.delete(follow);
  }, [link]);
  useEffect(() => stage.current?.resize(width, height), [width, height]);
  useEffect(() => {
    if (weights) stage.current?.morph(weights);
  }, [weights]);
  return (
    <figure>
      <Fault error={state.error} />
      {!state.ready && !state.error && <Loading on />}
      <div
        ref={ref}
        class="stage"
        style={{ height: `${height}px` }}
        tabIndex={0}
        role="img"
        aria-label={`${describe}. ${t.solid.turn}`}
        onKeyDown={(event) => {
          const step = { ArrowLeft: [-0.2, 0], ArrowRight: [0.2, 0], ArrowUp: [0, -0.2], ArrowDown: [0, 0.2] }[
            event.key
          ];
          if (!step) return;
          event.preventDefault();
          stage.current?.turn(step[0]!, step[1]!);
        }}
      />
      <figcaption>{caption ?? t.solid.turn}</figcaption>
    </figure>
  );
}
