/** Transformation classes: a list with one sentence and a picture each, made from the basis that the service states. */
import { get, type Schemas } from "../api/client";
import { useLoaded } from "../hooks";
import { path } from "../shape/points";
import { t } from "../strings";
import { Fault } from "./basic";

type Entry = Schemas["TransformationEntry"];

/** A shape without symmetry: a leaf with a notch. */
const LEAF: number[][] = Array.from({ length: 72 }, (_, k) => {
  const u = (2 * Math.PI * k) / 72;
  const r = 1 + 0.24 * Math.cos(2 * u + 0.5) + 0.16 * Math.cos(3 * u) - 0.14 * Math.sin(u);
  return [0.62 * r * Math.cos(u), 0.62 * r * Math.sin(u)];
});

/** Two members of a class beside the identity, or what is nearest to it. */
function members(entry: Entry): number[][][] {
  const basis = entry.planar_basis;
  if (!basis) return [turn(0.5), turn(-0.45)];
  if (!basis.length)
    return [
      [
        [1, 0],
        [0, 1],
      ],
      [
        [1, 0],
        [0, 1],
      ],
    ];
  const square = basis.map((b) => b.flat().reduce((total, value) => total + value * value, 0));
  const unit = basis.map((b, i) => (b[0]![0]! + b[1]![1]!) / square[i]!);
  const flips = unit.every((value) => Math.abs(value) < 1e-9);
  const at = (steps: number[]) =>
    basis.reduce(
      (total, b, i) =>
        total.map((row, r) =>
          row.map(
            (value, c) => value + ((flips ? (i === 0 ? 1 : 0) : unit[i]!) + steps[i % steps.length]!) * b[r]![c]!,
          ),
        ),
      [
        [0, 0],
        [0, 0],
      ],
    );
  return [at([-0.3, 0.34, -0.22, 0.12]), at([0.18, -0.36, 0.3, -0.3])];
}
const turn = (angle: number) => [
  [Math.cos(angle), -Math.sin(angle)],
  [Math.sin(angle), Math.cos(angle)],
];

export function ClassPicture({ entry }: { entry: Entry }) {
  const shift = entry.translation
    ? [
        [-0.28, 0.12],
        [0.3, -0.1],
      ]
    : [
        [0, 0],
        [0, 0],
      ];
  const moved = members(entry).map((a, k) =>
    LEAF.map((p) => [
      a[0]![0]! * p[0]! + a[0]![1]! * p[1]! + shift[k]![0]!,
      a[1]![0]! * p[0]! + a[1]![1]! * p[1]! + shift[k]![1]!,
    ]),
  );
  return (
    <svg viewBox="-1.5 -1.3 3 2.6" width="104" height="90" aria-hidden="true">
      <path class="line minus" d={path(moved[0]!, true)} />
      <path class="line plus" d={path(moved[1]!, true)} />
      <path class="line thick" d={path(LEAF, true)} />
    </svg>
  );
}

export const useClasses = (dimension: number) => {
  const loaded = useLoaded("transformations", (signal) => get("/v1/transformations", { signal }));
  return {
    ...loaded,
    data: loaded.data?.items.filter((one) => one.projection_dimensions.includes(dimension) || one.procrustes),
  };
};

export function Classes({
  dimension,
  value,
  onChange,
}: {
  dimension: number;
  value: string;
  onChange: (name: string) => void;
}) {
  const classes = useClasses(dimension);
  const chosen = classes.data?.find((one) => one.name === value);
  return (
    <div class="stack">
      <Fault error={classes.error} />
      <label class="field">
        <span>{t.mean.class}</span>
        <select value={value} onChange={(event) => onChange(event.currentTarget.value)}>
          {classes.data?.map((one) => (
            <option key={one.name} value={one.name} selected={one.name === value}>
              {t.classes[one.name]![0]}
            </option>
          ))}
        </select>
      </label>
      {chosen && (
        <div class="row" style={{ flexWrap: "nowrap" }}>
          <div>
            <ClassPicture entry={chosen} />
          </div>
          <p class="small quiet">{t.classes[chosen.name]![1]}</p>
        </div>
      )}
    </div>
  );
}

export const dimensionOf = (representation: Schemas["Representation"]): number =>
  "dimension" in representation && representation.dimension ? representation.dimension : 3;
