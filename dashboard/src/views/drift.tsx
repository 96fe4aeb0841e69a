/** How shapes that came later differ from those that a dictionary was learnt from. */
import { get } from "../api/client";
import { useEvents, useLoaded } from "../hooks";
import { Fault, Loading, Picture, Select } from "../parts/basic";
import { useSetting } from "../router";
import { count, number, percent, t } from "../strings";
import { type About, DictionaryPage } from "./dictionary";

export function Drift({ dictionary }: { dictionary: string }) {
  return (
    <DictionaryPage dictionary={dictionary}>
      {(about) => <Changes about={about} dictionary={dictionary} />}
    </DictionaryPage>
  );
}

function Changes({ about, dictionary }: { about: About; dictionary: string }) {
  const [quantile, setQuantile] = useSetting("quantile", "0.99");
  const query = { quantile };
  const drift = useLoaded(`${about.id} ${quantile}`, (signal) =>
    get("/v1/dictionaries/{dictionary}/drift", { path: { dictionary }, query, signal }),
  );
  useEvents(["shapes_added"], drift.reload);
  const data = drift.data;
  return (
    <>
      <Fault error={drift.error} retry={drift.reload} />
      <Loading on={drift.loading} />
      {data && data.shape_count === 0 && (
        <div class="card empty">
          <p>{t.drift.none(data.since_revision)}</p>
        </div>
      )}
      {data && data.shape_count > 0 && (
        <div class="aside right">
          <div class="stack" style={{ gap: "22px" }}>
            <p class="card say">
              {t.drift.sentence(
                data.shape_count,
                data.outliers.count,
                percent(data.outliers.rate),
                percent(1 - data.outliers.quantile),
              )}
            </p>
            <div class="card">
              <Picture
                source={{ path: `/v1/dictionaries/${encodeURIComponent(dictionary)}/drift`, query }}
                name={`${about.name}-drift`}
                alt={t.drift.alt}
                caption={t.drift.caption}
              />
            </div>
            {data.scores && (
              <section class="card scroll" tabIndex={0}>
                <h2>{t.drift.scores}</h2>
                <table>
                  <thead>
                    <tr>
                      <th scope="col">{t.words.component}</th>
                      <th scope="col" class="number">
                        {t.drift.shift}
                      </th>
                      <th scope="col" class="number">
                        {t.drift.spread}
                      </th>
                    </tr>
                  </thead>
                  <tbody>
                    {data.scores.map((one) => (
                      <tr key={one.component}>
                        <th scope="row">{one.component}</th>
                        <td class="number">{number(one.shift, 3)} σ</td>
                        <td class="number">{number(one.spread, 3)}</td>
                      </tr>
                    ))}
                  </tbody>
                </table>
              </section>
            )}
          </div>
          <div class="stack" style={{ gap: "22px" }}>
            <div class="card">
              <Select
                label={t.drift.quantile}
                value={quantile}
                options={["0.9", "0.95", "0.99"].map((value) => [value, percent(Number(value), 0)])}
                onChange={setQuantile}
              />
              <dl class="facts">
                <dt>{t.drift.fresh}</dt>
                <dd>{count(data.shape_count)}</dd>
                <dt>{t.drift.outliers}</dt>
                <dd>{count(data.outliers.count)}</dd>
                {data.mean && (
                  <>
                    <dt>{t.drift.angle}</dt>
                    <dd>{number(data.mean.angle_deg, 3)}°</dd>
                    <dt>{t.drift.expected}</dt>
                    <dd>{number(data.mean.expected_deg, 3)}°</dd>
                  </>
                )}
              </dl>
            </div>
            {data.classes && (
              <section class="card scroll" tabIndex={0}>
                <h2>{t.drift.classes}</h2>
                <table>
                  <thead>
                    <tr>
                      <th scope="col">{t.report.class}</th>
                      <th scope="col" class="number">
                        {t.drift.training}
                      </th>
                      <th scope="col" class="number">
                        {t.drift.fresh}
                      </th>
                    </tr>
                  </thead>
                  <tbody>
                    {data.classes.map((one) => (
                      <tr key={one.label}>
                        <th scope="row">{one.label}</th>
                        <td class="number">{percent(one.training)}</td>
                        <td class="number">{percent(one.new)}</td>
                      </tr>
                    ))}
                  </tbody>
                </table>
              </section>
            )}
          </div>
        </div>
      )}
    </>
  );
}
