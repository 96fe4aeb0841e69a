/** What this is, what there is, and a first walk through it. */
import { useMay } from "../api/caller";
import { get, pages, post } from "../api/client";
import { useAction, useEvents, useLoaded } from "../hooks";
import { announce, Empty, Fault, Loading, Page, Picture } from "../parts/basic";
import { navigate } from "../router";
import { count, t } from "../strings";

const EXAMPLE = "example-cells";
const TOUR = "example-cells-tour";

export function Start() {
  const loaded = useLoaded("start", async (signal) => {
    const [cohorts, dictionaries, jobs, version] = await Promise.all([
      pages((cursor) => get("/v1/cohorts", { query: { cursor, limit: 1000 }, signal })),
      pages((cursor) => get("/v1/dictionaries", { query: { cursor, limit: 1000 }, signal })),
      get("/v1/jobs", { query: { status: "running" }, signal }),
      get("/v1/version", { signal }),
    ]);
    return { cohorts, dictionaries, running: jobs.items.length, version };
  });
  useEvents(
    [
      "cohort_created",
      "cohort_deleted",
      "shapes_added",
      "dictionary_added",
      "job_queued",
      "job_succeeded",
      "job_failed",
      "job_cancelled",
    ],
    loaded.reload,
  );
  const learn = useAction(async (to: string) => {
    const name = loaded.data?.dictionaries.find((one) => one.name === TOUR)?.name;
    if (!name) {
      await post("/v1/dictionaries", {
        headers: { prefer: "wait=60" },
        body: {
          name: TOUR,
          cohort: EXAMPLE,
          transformation: "similarity",
          method: { kind: "functional_pca", components: 10, centre: true },
          classifier: { kind: "discriminant", attribute: "labels.treatment" },
        },
      });
      announce({ text: t.learn.done(TOUR) });
    }
    navigate(to);
  });
  const data = loaded.data;
  const writes = useMay("writer");
  const example = data?.cohorts.find((one) => one.name === EXAMPLE);
  return (
    <Page title={t.start.title} lead={t.start.lead}>
      <Loading on={loaded.loading && !data} />
      <Fault error={loaded.error} retry={loaded.reload} />
      {data && (
        <dl class="figures card" style={{ display: "flex" }}>
          <div>
            <dt>{t.start.cohorts}</dt>
            <dd>{count(data.cohorts.length)}</dd>
          </div>
          <div>
            <dt>{t.start.shapes}</dt>
            <dd>{count(data.cohorts.reduce((total, one) => total + one.shape_count, 0))}</dd>
          </div>
          <div>
            <dt>{t.start.dictionaries}</dt>
            <dd>{count(data.dictionaries.length)}</dd>
          </div>
          <div>
            <dt>{t.start.running}</dt>
            <dd>{count(data.running)}</dd>
          </div>
          <div>
            <dt>{t.start.version}</dt>
            <dd>{data.version.version}</dd>
          </div>
        </dl>
      )}
      {data && !example && data.cohorts.length === 0 && (
        <Empty>
          <p>{t.start.empty}</p>
          {writes && (
            <a class="button main" href="/app/cohorts">
              {t.propose.drop}
            </a>
          )}
        </Empty>
      )}
      {example && (
        <section class="aside right">
          <div class="card">
            <h2>{t.start.example}</h2>
            <Picture
              name="mean"
              alt={t.mean.alt(EXAMPLE)}
              width={620}
              source={{ path: `/v1/cohorts/${EXAMPLE}/mean`, query: { transformation: "similarity" } }}
              caption={t.start.exampleCaption(example.shape_count)}
            />
          </div>
          <div class="card">
            <h2>{t.start.tour}</h2>
            <ol class="tour stack">
              {t.start.steps.map(([title, text], index) => {
                const links = [
                  `/app/cohorts/${EXAMPLE}`,
                  `/app/cohorts/${EXAMPLE}/mean`,
                  `/app/dictionaries/${TOUR}/modes`,
                  `/app/assess?dictionary=${TOUR}&cohort=${EXAMPLE}&shape=cell0004`,
                  `/app/cohorts/${EXAMPLE}/compare?by=labels.treatment`,
                ];
                return (
                  <li key={title}>
                    <a
                      href={links[index]}
                      onClick={
                        index === 2 || index === 3
                          ? (event) => {
                              event.preventDefault();
                              learn.run(links[index]!);
                            }
                          : undefined
                      }
                    >
                      {title}
                    </a>
                    {learn.busy && index === 2 && <span class="tag live">{t.learn.busy}</span>}
                    <p class="small quiet">{text}</p>
                  </li>
                );
              })}
            </ol>
            <Fault error={learn.error} />
          </div>
        </section>
      )}
      {data && data.cohorts.length > 0 && (
        <section class="columns">
          {(
            [
              ["/app/cohorts", t.menu.cohorts, t.start.toCohorts],
              ["/app/assess", t.menu.assess, t.start.toAssess],
              ["/app/segment", t.menu.segment, t.start.toSegment],
            ] as const
          ).map(([href, title, text]) => (
            <a class="card" href={href} key={href}>
              <h2>{title}</h2>
              <p class="quiet">{text}</p>
            </a>
          ))}
        </section>
      )}
    </Page>
  );
}
