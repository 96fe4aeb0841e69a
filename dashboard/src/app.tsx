/** The frame of the page, and which view has which address. */
import { Component, type ComponentChildren, type ComponentType } from "preact";
import { useEffect, useState } from "preact/hooks";
import { forgetCaller, onRole, useCaller, useMay } from "./api/caller";
import { hasKey, onUnauthenticated, setKey } from "./api/client";
import { hasSession, leave, onLeft, RETURN } from "./api/login";
import icon from "./icon.svg";
import { Announcements, announce, Choice, Empty, Fault, Loading, Page } from "./parts/basic";
import { chooseLanguage, type Language, useLanguage } from "./preferences";
import { match, usePlace } from "./router";
import { t } from "./strings";
import { chooseTheme, type Theme, useTheme } from "./theme";
import { Login } from "./views/login";
import { Start } from "./views/start";

// Views have the parameters of their paths, which the table of paths below knows.
// biome-ignore lint/suspicious/noExplicitAny: one type for all views
type View = ComponentType<any>;
type Module = Record<string, unknown>;

const loads: (() => Promise<Module>)[] = [];

/** Reads the views that were not shown yet, once there is nothing else to do: they are there when the connection is not. */
function readAhead(): void {
  const idle = window.requestIdleCallback ?? ((then: () => void) => setTimeout(then, 500));
  const next = loads.shift();
  if (next) idle(() => void next().then(readAhead, () => {}));
}

/** A view in a file of its own, which the browser reads when it is first needed. */
function later(load: () => Promise<Module>, name: string): View {
  let found: View | undefined;
  loads.push(load);
  return function Later(props) {
    const [, update] = useState(0);
    const [error, setError] = useState<Error>();
    useEffect(() => {
      if (!found)
        load().then((module) => {
          found = module[name] as View;
          update(1);
        }, setError);
    }, []);
    const Found = found;
    return Found ? (
      <Found {...props} />
    ) : (
      <div class="page">{error ? <Fault error={error} retry={() => location.reload()} /> : <Loading on />}</div>
    );
  };
}

const dictionary = () => import("./views/dictionary");
const VIEWS: [string, View][] = [
  ["/app/cohorts", later(() => import("./views/cohorts"), "Cohorts")],
  ["/app/cohorts/{cohort}", later(() => import("./views/cohort"), "Overview")],
  ["/app/cohorts/{cohort}/table", later(() => import("./views/table"), "ShapeTable")],
  ["/app/cohorts/{cohort}/shapes/{shape}", later(() => import("./views/shape"), "ShapeView")],
  ["/app/cohorts/{cohort}/mean", later(() => import("./views/mean"), "MeanView")],
  ["/app/cohorts/{cohort}/compare", later(() => import("./views/compare"), "Compare")],
  ["/app/cohorts/{cohort}/regression", later(() => import("./views/regression"), "Regression")],
  ["/app/cohorts/{cohort}/model", later(() => import("./views/linear"), "Linear")],
  ["/app/cohorts/{cohort}/upload", later(() => import("./views/upload"), "Upload")],
  ["/app/dictionaries", later(() => import("./views/dictionaries"), "Dictionaries")],
  ["/app/dictionaries/{dictionary}", later(dictionary, "Report")],
  ["/app/dictionaries/{dictionary}/modes", later(() => import("./views/modes"), "Modes")],
  ["/app/dictionaries/{dictionary}/scores", later(() => import("./views/scores"), "Scores")],
  ["/app/dictionaries/{dictionary}/atoms", later(dictionary, "Atoms")],
  ["/app/dictionaries/{dictionary}/drift", later(() => import("./views/drift"), "Drift")],
  ["/app/assess", later(() => import("./views/assess"), "Assess")],
  ["/app/segment", later(() => import("./views/segment"), "Segment")],
  ["/app/jobs", later(() => import("./views/jobs"), "Jobs")],
  ["/app/console", later(() => import("./views/console"), "Console")],
  ["/app/administration", later(() => import("./views/administration"), "Administration")],
];

/** An error of the page itself, which leaves the menu usable. */
class Guard extends Component<{ place: string; children: ComponentChildren }, { error?: Error; place?: string }> {
  static getDerivedStateFromError = (error: Error) => ({ error });
  override componentDidUpdate(before: { place: string }) {
    if (before.place !== this.props.place && this.state.error) this.setState({ error: undefined });
  }
  render() {
    return this.state.error ? (
      <div class="page">
        <Fault error={this.state.error} />
      </div>
    ) : (
      this.props.children
    );
  }
}

function Menu({ onLeave }: { onLeave?: () => void }) {
  const { path } = usePlace();
  const items: [string, string][] = [
    ["/", t.menu.start],
    ["/app/cohorts", t.menu.cohorts],
    ["/app/dictionaries", t.menu.dictionaries],
  ];
  const work: [string, string][] = [
    ["/app/assess", t.menu.assess],
    ["/app/segment", t.menu.segment],
  ];
  const administers = useMay("admin");
  const run: [string, string][] = [
    ["/app/jobs", t.menu.jobs],
    ["/app/console", t.menu.console],
    ...(administers ? ([["/app/administration", t.menu.administration]] as [string, string][]) : []),
  ];
  const entry = ([href, name]: [string, string]) => (
    <li key={href}>
      <a
        href={href}
        aria-current={(href === "/" ? path === "/" || path === "/app" : path.startsWith(href)) ? "page" : undefined}
      >
        {name}
      </a>
    </li>
  );
  return (
    <nav aria-label={t.frame.menu}>
      <ul class="menu">
        {items.map(entry)}
        <li class="group">{t.menu.single}</li>
        {work.map(entry)}
        <li class="group">{t.menu.service}</li>
        {run.map(entry)}
        <li>
          <a href="/docs" target="_blank" rel="noreferrer">
            {t.menu.reference} <span aria-hidden="true">↗</span>
          </a>
        </li>
        {hasKey() && (
          <li>
            <button
              class="plain"
              onClick={() => {
                leave();
                onLeave?.();
              }}
            >
              {hasSession() ? t.login.out : t.login.leave}
            </button>
          </li>
        )}
      </ul>
    </nav>
  );
}

/** Who is logged in, and in which tenant. */
function Who() {
  const caller = useCaller();
  if (!caller) return null;
  const role = t.administration.roles[caller.role];
  return (
    <p class="small who">
      {caller.open ? t.who.open : t.who.is(caller.name ?? "", role)}
      {caller.tenant && (
        <>
          <br />
          <span class="quiet">{t.who.tenant(caller.tenant)}</span>
        </>
      )}
    </p>
  );
}

export function App() {
  const { theme, shown } = useTheme();
  const language = useLanguage();
  const { path } = usePlace();
  const [open, setOpen] = useState(false);
  const [refused, setRefused] = useState(false);
  const [round, setRound] = useState(0);
  useEffect(() => void setTimeout(readAhead, 1500), []);
  useEffect(
    () =>
      onUnauthenticated(() => {
        setKey(null);
        setRefused(true);
      }),
    [],
  );
  useEffect(() => onRole((role) => announce({ text: t.who.refused(t.administration.roles[role]) })), []);
  useEffect(() => onLeft(() => setRefused(true)), []);
  useEffect(() => setOpen(false), [path]);
  let view: ComponentChildren = path === "/" || path === "/app" ? <Start /> : null;
  for (const [pattern, Found] of VIEWS) {
    const values = view ? null : match(pattern, path);
    if (values) view = <Found key={pattern} {...values} />;
  }
  view ??= (
    <Page title={t.frame.missing}>
      <Empty>
        <p>{t.frame.missingHint}</p>
        <a class="button" href="/">
          {t.menu.start}
        </a>
      </Empty>
    </Page>
  );
  if (refused || path === RETURN)
    view = (
      <Login
        onDone={() => {
          forgetCaller();
          setRefused(false);
          setRound(round + 1);
        }}
      />
    );
  return (
    <div class="frame" key={`${language} ${shown} ${round}`}>
      <a
        class="skip"
        href="#main"
        onClick={(event) => {
          event.preventDefault();
          document.getElementById("main")?.focus();
        }}
      >
        {t.frame.skip}
      </a>
      <header class={`side${open ? " open" : ""}`}>
        <div class="bar-top">
          <a class="brand" href="/">
            <img src={icon} alt="" />
            Shapelex
          </a>
          <button class="opener" aria-expanded={open} onClick={() => setOpen(!open)}>
            {t.frame.menu}
          </button>
        </div>
        <Menu onLeave={() => setRefused(true)} />
        <div class="foot">
          <Who />
          <Choice
            label={t.frame.language}
            value={language}
            options={[
              ["en", "English"],
              ["de", "Deutsch"],
            ]}
            onChange={(value) => chooseLanguage(value as Language)}
          />
          <Choice
            label={t.frame.theme}
            value={theme}
            options={[
              ["auto", t.frame.auto],
              ["light", t.frame.light],
              ["dark", t.frame.dark],
            ]}
            onChange={(value) => chooseTheme(value as Theme)}
          />
          <a class="small quiet" href="/assets/licences.txt" target="_blank" rel="noreferrer">
            {t.frame.licences}
          </a>
        </div>
      </header>
      <main id="main" tabIndex={-1}>
        <Guard place={path}>{view}</Guard>
      </main>
      <Announcements />
    </div>
  );
}
