/** Keys, hooks, the audit trail and the trash of a tenant; settings of the service. */
import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import { get, pages, post, remove, type Schemas, setKey } from "../api/client";
import { type Loaded, useAction, useLoaded } from "../hooks";
import { announce, Copy, Download, Fault, Field, Loading, Page, Select } from "../parts/basic";
import { usePlace, useSetting } from "../router";
import { count, number, t, time } from "../strings";

const PARTS = ["keys", "hooks", "audit", "trash", "settings"] as const;

export function Administration() {
  const [part] = useSetting("part", "keys");
  usePlace();
  return (
    <Page title={t.menu.administration} lead={t.administration.lead}>
      <nav class="tabs" aria-label={t.menu.administration}>
        {PARTS.map((name) => (
          <a
            key={name}
            href={`/app/administration${name === "keys" ? "" : `?part=${name}`}`}
            aria-current={part === name ? "page" : undefined}
          >
            {t.administration.parts[name]}
          </a>
        ))}
      </nav>
      {part === "hooks" ? (
        <Hooks />
      ) : part === "audit" ? (
        <Audit />
      ) : part === "settings" ? (
        <Settings />
      ) : part === "trash" ? (
        <Trash />
      ) : (
        <Keys />
      )}
    </Page>
  );
}

function List<T>({
  list,
  empty,
  head,
  children,
}: {
  list: Loaded<T[]>;
  empty: string;
  head: string[];
  children: (one: T) => ComponentChildren;
}) {
  return (
    <>
      <Fault error={list.error} retry={list.reload} />
      <Loading on={list.loading && !list.data} />
      {list.data?.length === 0 && <p class="card empty">{empty}</p>}
      {list.data && list.data.length > 0 && (
        <div class="card scroll" tabIndex={0}>
          <table>
            <thead>
              <tr>
                {head.map((name) => (
                  <th scope="col" key={name}>
                    {name || <span class="hidden">{t.administration.actions}</span>}
                  </th>
                ))}
              </tr>
            </thead>
            <tbody>{list.data.map(children)}</tbody>
          </table>
        </div>
      )}
    </>
  );
}

function Secret({ secret }: { secret: string }) {
  return (
    <div class="note" role="status">
      <strong>{t.administration.secret}</strong>
      <div class="row" style={{ marginTop: "8px" }}>
        <code style={{ overflowWrap: "anywhere" }}>{secret}</code>
        <Copy text={secret} />
      </div>
    </div>
  );
}

function Keys() {
  const list = useLoaded("keys", (signal) =>
    pages((cursor) => get("/v1/keys", { query: { cursor, limit: 1000 }, signal })),
  );
  const [secret, setSecret] = useState("");
  const [role, setRole] = useState("reader");
  const isFirst = list.data?.length === 0;
  const create = useAction(async (form: FormData) => {
    const days = Number(form.get("days"));
    const issued = await post("/v1/keys", {
      body: {
        name: String(form.get("name")),
        role: isFirst ? "admin" : (role as Schemas["Role"]),
        ...(days ? { expires_in_days: days } : {}),
      },
    });
    // The first key closes the service: the page goes on with it.
    if (isFirst) setKey(issued.secret);
    setSecret(issued.secret);
    list.reload();
  });
  const revoke = useAction(async (key: string) => {
    await remove("/v1/keys/{key}", { path: { key } });
    announce({ text: t.administration.revoked });
    list.reload();
  });
  return (
    <>
      {isFirst && <p class="note warn">{t.administration.firstKey}</p>}
      <form
        class="card"
        onSubmit={(event) => {
          event.preventDefault();
          create.run(new FormData(event.currentTarget));
        }}
      >
        <h2>{t.administration.newKey}</h2>
        <div class="form">
          <Field label={t.words.name}>
            <input name="name" required maxLength={128} />
          </Field>
          <Select
            label={t.administration.role}
            value={isFirst ? "admin" : role}
            options={Object.entries(t.administration.roles).filter(([id]) => !isFirst || id === "admin")}
            onChange={setRole}
          />
          <Field label={t.administration.days}>
            <input name="days" type="number" min={1} max={3653} placeholder={t.administration.never} />
          </Field>
          <button class="main" disabled={create.busy}>
            {t.act.create}
          </button>
        </div>
        <Fault error={create.error} />
        {secret && <Secret secret={secret} />}
      </form>
      <Fault error={revoke.error} />
      <List
        list={list}
        empty={t.administration.noKeys}
        head={[
          t.words.name,
          t.administration.role,
          t.words.created,
          t.administration.expires,
          t.administration.used,
          "",
        ]}
      >
        {(key) => (
          <tr key={key.id}>
            <td>
              {key.name}
              <div class="small quiet mono">{key.id}</div>
            </td>
            <td>{t.administration.roles[key.role]}</td>
            <td class="nowrap">{time(key.created_at)}</td>
            <td class="nowrap">{key.expires_at ? time(key.expires_at) : t.administration.never}</td>
            <td class="nowrap">{time(key.last_used_at)}</td>
            <td>
              {key.revoked_at ? (
                <span class="tag bad">{t.administration.isRevoked}</span>
              ) : (
                <button class="bad" disabled={revoke.busy} onClick={() => revoke.run(key.id)}>
                  {t.administration.revoke}
                </button>
              )}
            </td>
          </tr>
        )}
      </List>
    </>
  );
}

function Hooks() {
  const list = useLoaded("hooks", (signal) =>
    pages((cursor) => get("/v1/hooks", { query: { cursor, limit: 1000 }, signal })),
  );
  const [secret, setSecret] = useState("");
  const create = useAction(async (form: FormData) => {
    const made = await post("/v1/hooks", {
      body: {
        url: String(form.get("url")),
        description: String(form.get("description") ?? ""),
      } as Schemas["HookRequest"],
    });
    setSecret(made.secret);
    list.reload();
  });
  const act = useAction(async (what: "pause" | "resume" | "delete", hook: string) => {
    if (what === "delete") await remove("/v1/hooks/{hook}", { path: { hook } });
    else if (what === "pause") await post("/v1/hooks/{hook}/pause", { path: { hook } });
    else await post("/v1/hooks/{hook}/resume", { path: { hook } });
    list.reload();
  });
  return (
    <>
      <form
        class="card"
        onSubmit={(event) => {
          event.preventDefault();
          create.run(new FormData(event.currentTarget));
        }}
      >
        <h2>{t.administration.newHook}</h2>
        <div class="form">
          <Field label={t.administration.address}>
            <input name="url" type="url" required placeholder="https://pipeline.example/shapes" />
          </Field>
          <Field label={t.words.description}>
            <input name="description" />
          </Field>
          <button class="main" disabled={create.busy}>
            {t.act.create}
          </button>
        </div>
        <Fault error={create.error} />
        {secret && <Secret secret={secret} />}
      </form>
      <Fault error={act.error} />
      <List
        list={list}
        empty={t.administration.noHooks}
        head={[t.administration.address, t.jobs.status, t.administration.position, t.words.created, ""]}
      >
        {(hook) => (
          <tr key={hook.id}>
            <td>
              {hook.url}
              <div class="small quiet">{hook.description}</div>
              {hook.reason && (
                <div class="small" style={{ color: "var(--bad)" }}>
                  {hook.reason}
                </div>
              )}
            </td>
            <td>
              <span class={`tag ${hook.status === "active" ? "good" : hook.status === "failed" ? "bad" : "warn"}`}>
                {t.administration.states[hook.status]}
              </span>
            </td>
            <td class="number">{hook.position}</td>
            <td class="nowrap">{time(hook.created_at)}</td>
            <td>
              <div class="row" style={{ flexWrap: "nowrap" }}>
                {hook.status === "active" ? (
                  <button onClick={() => act.run("pause", hook.id)}>{t.administration.pause}</button>
                ) : (
                  <button onClick={() => act.run("resume", hook.id)}>{t.administration.resume}</button>
                )}
                <button class="bad" onClick={() => act.run("delete", hook.id)}>
                  {t.act.remove}
                </button>
              </div>
            </td>
          </tr>
        )}
      </List>
    </>
  );
}

function Audit() {
  const [status, setStatus] = useSetting("outcome", "");
  // Entries come oldest first; the newest page is what one looks for.
  const list = useLoaded(`audit ${status}`, async (signal) => {
    const since = new Date(Date.now() - 24 * 3600 * 1000).toISOString();
    const all = await pages(
      (cursor) => get("/v1/audit", { query: { cursor, since, status, limit: 1000 }, signal }),
      5000,
    );
    return all.reverse().slice(0, 200);
  });
  return (
    <>
      <div class="row spread">
        <div style={{ minWidth: "220px" }}>
          <Select
            label={t.jobs.status}
            value={status}
            options={[
              ["", t.jobs.all],
              ["401", "401"],
              ["403", "403"],
              ["404", "404"],
              ["422", "422"],
            ]}
            onChange={setStatus}
          />
        </div>
        <Download
          name="audit"
          source={{ path: "/v1/audit", query: { status } }}
          formats={[["NDJSON", "ndjson", "application/x-ndjson"]]}
        />
      </div>
      <p class="small quiet">{t.administration.auditHint}</p>
      <List
        list={list}
        empty={t.administration.noAudit}
        head={[t.administration.at, t.administration.request, t.administration.key, t.jobs.status]}
      >
        {(entry) => (
          <tr key={entry.sequence}>
            <td class="nowrap">{time(entry.at)}</td>
            <td>
              <code>
                {entry.method} {entry.route ?? "–"}
              </code>
            </td>
            <td class="mono">{entry.key ?? "–"}</td>
            <td>
              <span class={`tag ${(entry.status ?? 0) < 400 ? "good" : "bad"}`}>{entry.status ?? "–"}</span>
            </td>
          </tr>
        )}
      </List>
    </>
  );
}

function Trash() {
  const list = useLoaded("trash", (signal) =>
    pages((cursor) => get("/v1/trash", { query: { cursor, limit: 1000 }, signal })),
  );
  const act = useAction(async (what: "restore" | "remove", id: string) => {
    if (what === "restore") await post("/v1/trash/{id}/restore", { path: { id } });
    else await remove("/v1/trash/{id}", { path: { id } });
    announce({ text: what === "restore" ? t.administration.restored : t.administration.gone });
    list.reload();
  });
  return (
    <>
      <Fault error={act.error} />
      <List
        list={list}
        empty={t.administration.noTrash}
        head={[t.words.name, t.words.kind, t.administration.deleted, ""]}
      >
        {(one) => (
          <tr key={one.id}>
            <td>
              {one.name}
              {one.version ? `@${one.version}` : ""}
            </td>
            <td>{t.administration.kinds[one.kind]}</td>
            <td class="nowrap">{time(one.deleted_at)}</td>
            <td>
              <div class="row">
                <button onClick={() => act.run("restore", one.id)}>{t.administration.restore}</button>
                <button class="bad" onClick={() => act.run("remove", one.id)}>
                  {t.administration.forever}
                </button>
              </div>
            </td>
          </tr>
        )}
      </List>
    </>
  );
}

const UNITS = ["B", "KiB", "MiB", "GiB", "TiB"];

/** A value of a limit in its unit: whole powers of 1024, minutes and hours where they are shorter. */
function limitOf({ value, unit }: { value?: number | null; unit: string }): string {
  if (value === null || value === undefined) return t.administration.noLimit;
  if (unit === "bytes") {
    const power = Math.min(Math.floor(Math.log2(Math.max(value, 1)) / 10), UNITS.length - 1);
    return `${number(value / 1024 ** power, 3)}\u00a0${UNITS[power]}`;
  }
  if (unit === "seconds")
    return value >= 3600 && value % 3600 === 0
      ? `${count(value / 3600)} h`
      : value >= 120 && value % 60 === 0
        ? `${count(value / 60)} min`
        : `${count(value)}\u00a0s`;
  return count(value);
}

/** What the service was started with; it is changed by flags, variables or a file, and a restart. */
function Settings() {
  const loaded = useLoaded("settings", async (signal) => {
    const [settings, version] = await Promise.all([get("/v1/settings", { signal }), get("/v1/version", { signal })]);
    return { settings, version };
  });
  const data = loaded.data;
  if (!data)
    return (
      <>
        <Fault error={loaded.error} retry={loaded.reload} />
        <Loading on={loaded.loading} />
      </>
    );
  const { access, limits } = data.settings,
    { version } = data;
  const yes = (value: boolean) => (value ? t.words.yes : t.words.no);
  return (
    <>
      <p class="quiet">{t.administration.settingsHint}</p>
      <div class="columns">
        <section class="card">
          <h2>{t.report.program}</h2>
          <dl class="facts">
            <dt>{t.words.version}</dt>
            <dd>{version.version}</dd>
            <dt>{t.administration.commit}</dt>
            <dd>
              <code>{version.commit?.slice(0, 12) ?? "–"}</code>
            </dd>
            <dt>{t.administration.compiler}</dt>
            <dd>{version.rustc}</dd>
            <dt>{t.administration.features}</dt>
            <dd>{version.features.join(", ") || "–"}</dd>
            <dt>{t.administration.database}</dt>
            <dd>
              {version.database.engine}, {t.administration.schema(version.database.schema_version)}
            </dd>
          </dl>
        </section>
        <section class="card">
          <h2>{t.administration.access}</h2>
          <dl class="facts">
            <dt>{t.administration.open}</dt>
            <dd>{yes(access.open)}</dd>
            <dt>{t.administration.provider}</dt>
            <dd>{access.token_issuer ?? "–"}</dd>
            <dt>{t.administration.pageLogin}</dt>
            <dd>{yes(access.page_login)}</dd>
            <dt>{t.administration.origins}</dt>
            <dd>{access.allowed_origins.join(", ") || "–"}</dd>
            <dt>{t.administration.metrics}</dt>
            <dd>{yes(access.metrics_open)}</dd>
          </dl>
        </section>
      </div>
      <section class="card scroll" tabIndex={0}>
        <h2>{t.administration.limits}</h2>
        <table>
          <thead>
            <tr>
              <th scope="col">{t.administration.limit}</th>
              <th scope="col" class="number">
                {t.administration.value}
              </th>
              <th scope="col">{t.administration.setting}</th>
            </tr>
          </thead>
          <tbody>
            {limits.map((one) => (
              <tr key={one.name}>
                <th scope="row">{t.administration.limitNames[one.name] ?? one.name}</th>
                <td class="number nowrap">{limitOf(one)}</td>
                <td>
                  <code>--{one.name.replaceAll("_", "-")}</code>
                </td>
              </tr>
            ))}
          </tbody>
        </table>
      </section>
    </>
  );
}
