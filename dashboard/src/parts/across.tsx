/** The other two planes of a volume through the middle of an object, with its contours cut by them. */
import { useEffect, useState } from "preact/hooks";
import { type Plane, shownOf, sliceOf, type Volume } from "../formats/image";
import { cutBy, sliceThrough } from "../shape/planes";
import { t } from "../strings";
import { CONTOUR, type Item } from "./slice";

function middleOf({ found, box }: Item): [number, number] {
  if (!found) return [box.x + box.w / 2, box.y + box.h / 2];
  const n = found.outline.length;
  return [0, 1].map((axis) => found.outline.reduce((sum, p) => sum + p[axis]!, 0) / n) as [number, number];
}

export function Across({
  volume,
  plane,
  index,
  item,
  range,
}: {
  volume: Volume;
  plane: Plane;
  index: number;
  item: Item;
  range: [number, number] | undefined;
}) {
  const others = ([2, 1, 0] as Plane[]).filter((one) => one !== plane);
  return (
    <section class="card">
      <h2>{t.segment.across3}</h2>
      <div class="columns" style={{ gridTemplateColumns: "1fr 1fr" }}>
        {others.map((other) => (
          <Cut key={other} volume={volume} plane={plane} index={index} other={other} item={item} range={range} />
        ))}
      </div>
      <p class="small quiet">{t.segment.acrossHint}</p>
    </section>
  );
}

function Cut({
  volume,
  plane,
  index,
  other,
  item,
  range,
}: {
  volume: Volume;
  plane: Plane;
  index: number;
  other: Plane;
  item: Item;
  range: [number, number] | undefined;
}) {
  const at = sliceThrough(volume, plane, middleOf(item), other);
  const slice = sliceOf(volume, other, at);
  const [url, setUrl] = useState("");
  useEffect(() => {
    let own: string | undefined,
      left = false;
    void shownOf(volume, slice, range).then((blob) => {
      if (left) return;
      own = URL.createObjectURL(blob);
      setUrl(own);
    });
    return () => {
      left = true;
      if (own) setTimeout(URL.revokeObjectURL, 1000, own);
    };
  }, [volume, other, at, range?.join()]);
  const [sx, sy] = slice.spacing,
    [width, height] = [slice.size[0] * sx, slice.size[1] * sy];
  const levels = [
    ...(item.levels ?? []).filter(([level]) => level !== index),
    ...(item.found ? [[index, item.found] as [number, typeof item.found]] : []),
  ].map(([level, { outline }]): [number, number[][]] => [level, outline]);
  const name = (volume.anatomy ? t.segment.planes : t.segment.across)[other]!;
  return (
    <figure>
      <svg
        class="cut"
        viewBox={`${-0.5 * sx} ${-0.5 * sy} ${width} ${height}`}
        style={{ width: "100%", background: "var(--sunken)" }}
        role="img"
        aria-label={t.segment.cutAlt(name)}
      >
        {url && (
          <image href={url} x={-0.5 * sx} y={-0.5 * sy} width={width} height={height} preserveAspectRatio="none" />
        )}
        {cutBy(volume, plane, levels, other, at).map(([ax, ay, bx, by], key) => (
          <g key={key}>
            <line
              x1={ax}
              y1={ay}
              x2={bx}
              y2={by}
              stroke={CONTOUR}
              stroke-opacity="0.45"
              stroke-width="1"
              vector-effect="non-scaling-stroke"
            />
            {[
              [ax, ay],
              [bx, by],
            ].map(([x, y]) => (
              <circle cx={x} cy={y} r={Math.max(width, height) / 110} fill={CONTOUR} />
            ))}
          </g>
        ))}
      </svg>
      <figcaption>{name}</figcaption>
    </figure>
  );
}
