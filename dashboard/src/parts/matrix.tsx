/** Every two groups of a model beside each other: distances above the diagonal, corrected p values below it. */
import type { Schemas } from "../api/client";
import { number, probability } from "../strings";
import { words } from "../strings/kept";

type Pairs = NonNullable<Schemas["ShapeModel"]["pairs"]>;

export function Matrix({ pairs, factor, permutations }: { pairs: Pairs; factor: string; permutations: string }) {
  const w = words();
  const names = pairs.groups.map((one) => one.name);
  const found = new Map(pairs.pairs.flatMap((one) => [[`${one.first} ${one.second}`, one] as const]));
  const between = (a: string, b: string) => found.get(`${a} ${b}`) ?? found.get(`${b} ${a}`);
  return (
    <section class="card scroll" tabIndex={0}>
      <h2>{w.matrix(factor)}</h2>
      <table class="matrix">
        <thead>
          <tr>
            <td />
            {names.map((name) => (
              <th scope="col" key={name}>
                {name}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {names.map((row, r) => (
            <tr key={row}>
              <th scope="row">{row}</th>
              {names.map((column, c) => {
                if (r === c)
                  return (
                    <td key={column} class="quiet">
                      –
                    </td>
                  );
                const one = between(row, column)?.distance;
                const p = one?.p_holm ?? one?.p;
                return (
                  <td key={column} title={w.ofPair(row, column)}>
                    {r < c ? (
                      number(one?.value, 3)
                    ) : typeof p === "number" && p <= 0.05 ? (
                      <strong>{probability(p)}</strong>
                    ) : (
                      probability(p)
                    )}
                  </td>
                );
              })}
            </tr>
          ))}
        </tbody>
      </table>
      <p class="small quiet">{w.matrixHint(permutations, pairs.null)}</p>
    </section>
  );
}
