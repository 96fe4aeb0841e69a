/** The reference of the interface, made of `/openapi.json` alone. The fragment of the address is the operation that is shown. */
import "../style.css";
import "./docs.css";
import { render } from "preact";
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import icon from "../icon.svg";
import { Choice } from "../parts/fields";
import { chooseTheme, type Theme, useTheme } from "../theme";
import { type Document, type Operation, operationsOf } from "./document";
import { Details, Method } from "./operation";
import { breakable, inline, Prose } from "./text";

/** Asked for before anything is drawn. */
const asked = fetch("/openapi.json", { credentials: "omit" }).then(async (response) => {
  if (!response.ok) throw new Error(`/openapi.json: ${response.status}`);
  return (await response.json()) as Document;
});

/** The operation in the address. Links of former versions were `#/tag/operation`. */
const chosen = (): string => location.hash.slice(1).split("/").pop()!;

function usePlace(): string {
  const [place, setPlace] = useState(chosen);
  useEffect(() => {
    const listener = () => setPlace(chosen());
    window.addEventListener("hashchange", listener);
    return () => window.removeEventListener("hashchange", listener);
  }, []);
  return place;
}

interface Group {
  name: string;
  description?: string;
  operations: Operation[];
}

function grouped(source: Document, operations: Operation[]): Group[] {
  const described = new Map(source.tags?.map(({ name, description }) => [name, description]));
  const names = new Set([...described.keys(), ...operations.map(({ tag }) => tag)]);
  return [...names].map((name) => ({
    name,
    description: described.get(name),
    operations: operations.filter(({ tag }) => tag === name),
  }));
}

/** The operations that have every word. */
function matching(groups: Group[], search: string): Group[] {
  const words = search.toLowerCase().split(/\s+/).filter(Boolean);
  const has = ({ text }: Operation) => words.every((word) => text.includes(word));
  return groups
    .map((group) => ({ ...group, operations: group.operations.filter(has) }))
    .filter(({ operations }) => operations.length);
}

function Search({
  value,
  onInput,
  count,
  first,
}: {
  value: string;
  onInput: (value: string) => void;
  count: number;
  first?: string;
}) {
  const field = useRef<HTMLInputElement>(null);
  useEffect(() => {
    const listener = (event: KeyboardEvent) => {
      const typing = (event.target as Element).matches("input, textarea, select");
      if (event.key !== "/" || typing || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      field.current?.focus();
    };
    document.addEventListener("keydown", listener);
    return () => document.removeEventListener("keydown", listener);
  }, []);
  const onKeyDown = (event: KeyboardEvent) => {
    if (event.key === "Escape") onInput("");
    if (event.key === "Enter" && first) location.hash = first;
  };
  return (
    <div class="search">
      <input
        ref={field}
        type="search"
        aria-label="Search operations"
        placeholder="Search: path, name, field  ( / )"
        value={value}
        onInput={(event) => onInput(event.currentTarget.value)}
        onKeyDown={onKeyDown}
      />
      <p class="small quiet" role="status">
        {count} {count === 1 ? "operation" : "operations"}
      </p>
    </div>
  );
}

/** In the menu with the present place, elsewhere with summaries. */
function Links({ of: operations, place }: { of: Operation[]; place?: string }) {
  return (
    <ul class="links">
      {operations.map(({ id, method, path, summary }) => (
        <li key={id}>
          <a href={`#${id}`} title={summary.replaceAll("`", "")} aria-current={id === place ? "page" : undefined}>
            <Method of={method} /> <code>{breakable(path)}</code>
          </a>
          {place === undefined && <span class="small quiet">{inline(summary)}</span>}
        </li>
      ))}
    </ul>
  );
}

function Operations({ groups, place }: { groups: Group[]; place: string }) {
  return (
    <nav class="operations" aria-label="Operations">
      {groups.map(({ name, operations }) => (
        <section key={name}>
          <h2>{name}</h2>
          <Links of={operations} place={place} />
        </section>
      ))}
    </nav>
  );
}

function Overview({ source, groups }: { source: Document; groups: Group[] }) {
  const { info, components } = source;
  return (
    <div class="page">
      <header class="head">
        <div class="row">
          <h1 id="title" tabIndex={-1}>
            {info.title} API
          </h1>
          <span class="tag">{info.version}</span>
        </div>
        <p class="lead">{inline(info.description ?? "")}</p>
        <Prose text={components.securitySchemes?.bearer?.description} />
      </header>
      {groups.map(({ name, description, operations }) => (
        <section key={name} class="card" aria-label={name}>
          <div>
            <h2>{name}</h2>
            {description && <p class="quiet">{inline(description)}</p>}
          </div>
          <Links of={operations} />
        </section>
      ))}
    </div>
  );
}

function useDocument(): { source?: Document; groups: Group[]; fault?: Error } {
  const [state, setState] = useState<{ source?: Document; fault?: Error }>({});
  useEffect(
    () =>
      void asked.then(
        (source) => setState({ source }),
        (fault: Error) => setState({ fault }),
      ),
    [],
  );
  const { source } = state;
  const groups = useMemo(() => (source ? grouped(source, operationsOf(source)) : []), [source]);
  return { ...state, groups };
}

/** Says where one is: in the title, by the focus, and in the address without the tag of former links. */
function useArrival(place: string, operation: Operation | undefined): void {
  const moved = useRef(false);
  useEffect(() => {
    document.title = `${operation ? `${operation.method} ${operation.path}` : "API reference"} · Shapelex`;
    if (operation && location.hash !== `#${place}`) history.replaceState(null, "", `#${place}`);
    if (operation) document.querySelector(".operations [aria-current]")?.scrollIntoView({ block: "nearest" });
    if (moved.current) {
      window.scrollTo(0, 0);
      document.getElementById("title")?.focus({ preventScroll: true });
    }
    moved.current ||= operation !== undefined || place === "";
  }, [place, operation]);
}

function Foot() {
  const { theme } = useTheme();
  return (
    <div class="foot">
      <Choice
        label="Colours"
        value={theme}
        options={[
          ["auto", "Auto"],
          ["light", "Light"],
          ["dark", "Dark"],
        ]}
        onChange={(value) => chooseTheme(value as Theme)}
      />
      <p class="row small">
        <a href="/">Dashboard</a>
        <a href="/openapi.json">openapi.json</a>
      </p>
    </div>
  );
}

function Reference() {
  const place = usePlace();
  const { source, groups, fault } = useDocument();
  const [search, setSearch] = useState("");
  const [open, setOpen] = useState(false);
  const found = useMemo(() => matching(groups, search), [groups, search]);
  const operation = groups.flatMap(({ operations }) => operations).find(({ id }) => id === place);
  useArrival(place, operation);
  useEffect(() => setOpen(false), [place]);
  return (
    <div class="frame reference">
      <a
        class="skip"
        href="#title"
        onClick={(event) => {
          event.preventDefault();
          document.getElementById("title")?.focus();
        }}
      >
        Skip to the content
      </a>
      <header class={`side${open ? " open" : ""}`}>
        <div class="bar-top">
          <a class="brand" href="#">
            <img src={icon} alt="" />
            Shapelex API
          </a>
          <button class="opener" aria-expanded={open} onClick={() => setOpen(!open)}>
            Operations
          </button>
        </div>
        <div class="menu">
          <Search
            value={search}
            onInput={setSearch}
            count={found.reduce((sum, { operations }) => sum + operations.length, 0)}
            first={found[0]?.operations[0]?.id}
          />
          <Operations groups={found} place={place} />
        </div>
        <Foot />
      </header>
      <main id="main">
        {fault && (
          <p class="note bad" role="alert">
            The document cannot be read: {fault.message}
          </p>
        )}
        {!source && !fault && <div class="loading" role="status" aria-label="Loading" />}
        {source && operation && <Details key={operation.id} operation={operation} />}
        {source && !operation && place && (
          <p class="note bad" role="alert">
            No operation <code>{place}</code>.
          </p>
        )}
        {source && !operation && <Overview source={source} groups={groups} />}
      </main>
    </div>
  );
}

render(<Reference />, document.getElementById("app")!);
