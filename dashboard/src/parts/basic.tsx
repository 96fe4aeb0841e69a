/** What every view is made of. */
import type { ComponentChildren } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { type Query, Refusal, Said, type Schemas, search, send, Unreachable } from "../api/client";
import { useSetting } from "../router";
import { count, readSentences, t, translated } from "../strings";
import { shown } from "../theme";
import { Choice, Field } from "./fields";
import { save } from "./save";

/** Head of a view; the heading takes the focus when one comes from another view, so that it is read out. */
export function Page({
  title,
  tag,
  crumbs,
  lead,
  actions,
  children,
}: {
  title: string;
  tag?: string;
  crumbs?: [string, string][];
  lead?: ComponentChildren;
  actions?: ComponentChildren;
  children: ComponentChildren;
}) {
  const heading = useRef<HTMLHeadingElement>(null);
  useEffect(() => {
    document.title = `${title} · Shapelex`;
  }, [title]);
  useEffect(() => {
    if (document.body.dataset.walked) heading.current?.focus({ preventScroll: true });
    document.body.dataset.walked = "yes";
  }, [location.pathname]);
  return (
    <div class="page">
      <header class="head">
        {crumbs && (
          <nav class="crumbs" aria-label={t.frame.crumbs}>
            {crumbs.map(([name, href]) => (
              <>
                <a href={href}>{name}</a>
                <span aria-hidden="true">/</span>
              </>
            ))}
          </nav>
        )}
        <div class="row spread">
          <div class="row">
            <h1 ref={heading} tabIndex={-1}>
              {title}
            </h1>
            {tag && <span class="tag">{tag}</span>}
          </div>
          {actions && <div class="row no-print">{actions}</div>}
        </div>
        {lead && <p class="lead">{lead}</p>}
      </header>
      {children}
    </div>
  );
}

export function Tabs({ label, tabs }: { label: string; tabs: [string, string][] }) {
  return (
    <nav class="tabs" aria-label={label}>
      {tabs.map(([name, href]) => (
        <a
          key={href}
          href={href}
          aria-current={
            decodeURIComponent(location.pathname) === decodeURIComponent(href.split("?")[0]!) ? "page" : undefined
          }
        >
          {name}
        </a>
      ))}
    </nav>
  );
}

/** Browsers name a connection that was lost while a part of the page was loaded in different words. */
const lostConnection = (error: Error): boolean =>
  error instanceof Unreachable || /fetch|network|load failed|connection|preload/i.test(error.message);

/** A refusal in the words of the service, with each fault at its place; a sentence of the page; a lost connection; a fault of the page. */
export function Fault({ error, retry }: { error: Error | undefined; retry?: () => void }) {
  if (!error) return null;
  const problem = error instanceof Refusal ? error.problem : undefined;
  const faults = problem?.errors ?? [];
  // The detail of the problem is that of its only fault.
  const repeated = faults.length === 1 && problem!.detail.includes(faults[0]!.detail);
  return (
    <div class="note bad" role="alert">
      <strong>
        {problem ? (
          (t.fault.titles[problem.code] ?? problem.title)
        ) : error instanceof Said ? (
          <Sentence text={error.message} ours />
        ) : lostConnection(error) ? (
          t.fault.connection
        ) : (
          t.fault.page
        )}
      </strong>
      {!(error instanceof Said) && (
        <p>
          {repeated && <Place fault={faults[0]!} />}
          {problem ? (
            <Sentence text={problem.detail} />
          ) : lostConnection(error) ? (
            t.fault.connectionHint
          ) : (
            error.message
          )}
        </p>
      )}
      {faults.length > 0 && !repeated && (
        <ul>
          {faults.slice(0, 20).map((fault) => (
            <li>
              <Place fault={fault} />
              <Sentence text={fault.detail} />
            </li>
          ))}
          {faults.length > 20 && <li>{t.fault.more(faults.length - 20)}</li>}
        </ul>
      )}
      {problem?.request_id && (
        <p class="small quiet">
          {t.fault.request} <code>{problem.request_id}</code>
        </p>
      )}
      {retry && (
        <button class="plain" onClick={retry}>
          {t.act.again}
        </button>
      )}
    </div>
  );
}

/** A sentence of the service: in the language of the page where its form is known, else marked as English, unless the page may have said it. */
export function Sentence({ text, ours }: { text: string; ours?: boolean }) {
  const [, update] = useState(0);
  useEffect(() => readSentences(() => update(1)), []);
  const own = translated(text);
  return own ? <span title={text}>{own}</span> : <span lang={ours ? undefined : "en"}>{text}</span>;
}

/** A warning of the service. */
export const Warning = ({ text }: { text: unknown }) => (
  <p class="note warn">
    <Sentence text={typeof text === "string" ? text : JSON.stringify(text)} />
  </p>
);

export function Place({ fault }: { fault: Partial<Schemas["FaultDocument"]> }) {
  const { entry, item, tag, line, byte } = fault.place ?? {};
  const lines = fault.line ?? line;
  const words = [
    entry,
    lines ? t.fault.line(lines) : typeof fault.index === "number" ? t.fault.shape(fault.index + 1) : "",
    typeof item === "number" && t.fault.item(item),
    tag,
    typeof byte === "number" && t.fault.byte(count(byte)),
    fault.pointer,
  ].filter(Boolean);
  return words.length ? (
    <>
      <code>{words.join(" ")}</code>{" "}
    </>
  ) : null;
}

export const Loading = ({ on }: { on: boolean }) =>
  on ? (
    <div class="loading" role="status">
      <span class="hidden">{t.frame.loading}</span>
    </div>
  ) : null;

export function Select({
  label,
  value,
  options,
  onChange,
}: {
  label: string;
  value: string;
  options: [string, string][];
  onChange: (value: string) => void;
}) {
  return (
    <Field label={label}>
      <select value={value} onChange={(event) => onChange(event.currentTarget.value)}>
        {options.map(([id, name]) => (
          <option key={id} value={id} selected={id === value}>
            {name}
          </option>
        ))}
      </select>
    </Field>
  );
}

export { Choice, Field, save };

export interface Source {
  method?: "GET" | "POST";
  path: string;
  query?: Query;
  body?: object;
  /** A drawing whose width follows from other settings. */
  ownWidth?: boolean;
}

function ask(source: Source, extra: Record<string, string>, accept: string, signal?: AbortSignal): Promise<Response> {
  const query = new URLSearchParams(search(source.query));
  for (const [name, value] of Object.entries(extra)) query.set(name, value);
  const headers: Record<string, string> = { accept };
  if (source.body) headers["content-type"] = "application/json";
  return send(source.method ?? "GET", `${source.path}?${query}`, {
    headers,
    signal,
    body: source.body && JSON.stringify(source.body),
  });
}

export function Download({
  source,
  formats,
  name,
}: {
  source: Source;
  formats: [string, string, string][];
  name: string;
}) {
  const [error, setError] = useState<Error>();
  const fetchIt = async (format: string, accept: string, query: Record<string, string>) => {
    try {
      save(await (await ask(source, query, accept)).blob(), `${name}.${format}`);
      setError(undefined);
    } catch (fault) {
      setError(fault as Error);
    }
  };
  const fetchExcel = async () => {
    try {
      const [{ withCommas }, answer] = await Promise.all([
        import("../formats/csv"),
        ask(source, { format: "csv" }, "text/csv"),
      ]);
      save(new Blob([withCommas(await answer.text())], { type: "text/csv" }), `${name}.csv`);
      setError(undefined);
    } catch (fault) {
      setError(fault as Error);
    }
  };
  return (
    <div class="downloads">
      {formats.map(([label, format, accept]) => (
        <button
          class="plain small"
          onClick={() =>
            void fetchIt(format, accept, {
              format,
              ...(accept.startsWith("image/") ? { theme: "light", ...(source.ownWidth ? {} : { width: "1200" }) } : {}),
            })
          }
          aria-label={`${t.act.download} ${name} ${label}`}
        >
          ↓ {label}
        </button>
      ))}
      {t.act.excel && formats.some(([, format]) => format === "csv") && (
        <button class="plain small" onClick={() => void fetchExcel()} aria-label={`${t.act.download} ${name} Excel`}>
          ↓ {t.act.excel}
        </button>
      )}
      <Fault error={error} />
    </div>
  );
}

type Formats = [string, string, string][];
export const PICTURES: Formats = [
  ["SVG", "svg", "image/svg+xml"],
  ["PNG", "png", "image/png"],
];
/** A picture, and the numbers behind it. */
export const WITH_NUMBERS: Formats = [...PICTURES, ["JSON", "json", "application/json"]];

/** What a colour, or a range of colours, of a drawing means. */
export type Key = [string | string[], string];

export function Keys({ keys }: { keys: Key[] }) {
  return (
    <ul class="keys">
      {keys.map(([colours, text]) => (
        <li key={text}>
          <i
            class={typeof colours === "string" ? "" : "range"}
            style={{
              background: typeof colours === "string" ? colours : `linear-gradient(to right, ${colours.join(", ")})`,
            }}
          />
          {text}
        </li>
      ))}
    </ul>
  );
}

/** The few captions of shapes in drawings of the service that are words, in the language of the page. */
const inOurWords = (svg: string): string =>
  t.captions.reduce((text, [theirs, ours]) => text.replaceAll(theirs, ours), svg);

/**
 * A drawing of the service, in the colours of the page, with its caption and its files. Legends of the service are in English: here
 * they are left out, and `keys` are in the language of the page.
 */
export function Picture({
  source,
  alt,
  caption,
  name,
  width = 760,
  keys,
  formats = source.ownWidth ? PICTURES : WITH_NUMBERS,
}: {
  source: Source;
  alt: string;
  caption?: ComponentChildren;
  name: string;
  width?: number;
  keys?: Key[];
  formats?: Formats;
}) {
  const [state, setState] = useState<{ url?: string; error?: Error }>({});
  const theme = shown();
  const key = JSON.stringify([source, search(source.query), theme, width]);
  useEffect(() => {
    const abort = new AbortController();
    let url: string | undefined;
    ask(
      source,
      {
        format: "svg",
        theme,
        background: "none",
        title: "false",
        ...(source.ownWidth ? {} : { width: String(width), legend: "false" }),
      },
      "image/svg+xml",
      abort.signal,
    )
      .then((response) => response.text())
      .then((svg) => {
        if (abort.signal.aborted) return;
        url = URL.createObjectURL(new Blob([inOurWords(svg)], { type: "image/svg+xml" }));
        setState({ url });
      })
      .catch((error: Error) => !abort.signal.aborted && setState({ error }));
    return () => {
      abort.abort();
      if (url) URL.revokeObjectURL(url);
    };
  }, [key]);
  return (
    <figure class={`picture${state.url || state.error ? "" : " wait"}`} aria-busy={!state.url && !state.error}>
      {state.error ? <Fault error={state.error} /> : state.url ? <img src={state.url} alt={alt} /> : <Loading on />}
      {keys && state.url && <Keys keys={keys} />}
      {caption && <figcaption>{caption}</figcaption>}
      {state.url && (
        <div class="no-print">
          <Download source={source} formats={formats} name={name} />
        </div>
      )}
    </figure>
  );
}

/** A question that stops everything else; the native dialog keeps the focus within. */
export function Dialog({
  title,
  children,
  onClose,
}: {
  title: string;
  children: ComponentChildren;
  onClose: () => void;
}) {
  const ref = useRef<HTMLDialogElement>(null);
  useEffect(() => {
    ref.current?.showModal();
  }, []);
  return (
    <dialog ref={ref} onClose={onClose} aria-label={title}>
      <div class="stack">
        <h2>{title}</h2>
        {children}
      </div>
    </dialog>
  );
}

type Note = { text: string; undo?: () => Promise<void> };
let show: (note: Note) => void = () => {};
/** Says what was done, with a way back where there is one. */
export const announce = (note: Note): void => show(note);

export function Announcements() {
  const [note, setNote] = useState<Note>();
  const timer = useRef<ReturnType<typeof setTimeout>>(undefined);
  show = (next) => {
    setNote(next);
    clearTimeout(timer.current);
    timer.current = setTimeout(() => setNote(undefined), next.undo ? 20_000 : 6000);
  };
  const back = async () => {
    try {
      await note!.undo!();
      show({ text: t.act.undone });
    } catch (error) {
      show({ text: (error as Error).message });
    }
  };
  return (
    <div role="status" aria-live="polite">
      {note && (
        <div class="toast">
          <span>{note.text}</span>
          {note.undo && <button onClick={() => void back()}>{t.act.undo}</button>}
          <button onClick={() => setNote(undefined)} aria-label={t.act.close}>
            ✕
          </button>
        </div>
      )}
    </div>
  );
}

export function Empty({ children }: { children: ComponentChildren }) {
  return <div class="card empty">{children}</div>;
}

export function Copy({ text }: { text: string }) {
  const [done, setDone] = useState(false);
  const copy = () =>
    void navigator.clipboard.writeText(text).then(() => {
      setDone(true);
      setTimeout(() => setDone(false), 2000);
    });
  return <button onClick={copy}>{done ? t.act.copied : t.act.copy}</button>;
}

/** Sorting, filters and pages of a list of shapes, in the address. */
export function SortHead({ name, label, numeric }: { name: string; label: string; numeric?: boolean }) {
  const [order, setOrder] = useSetting("order", "");
  const next = order === name ? `-${name}` : order === `-${name}` ? "" : name;
  const direction = order === name ? "ascending" : order === `-${name}` ? "descending" : "none";
  return (
    <th class={numeric ? "number" : ""} aria-sort={direction} scope="col">
      <button onClick={() => setOrder(next)}>
        {label}{" "}
        <span aria-hidden="true">{direction === "ascending" ? "↑" : direction === "descending" ? "↓" : ""}</span>
      </button>
    </th>
  );
}
