/** The key of a service that asks for one, or a login by its identity provider. Both stay in this tab. */
import { useEffect, useState } from "preact/hooks";
import { get, Refusal, setKey } from "../api/client";
import { begin, findProvider, finish, forget, hasArrived, hostOf, LoginError } from "../api/login";
import { useAction, useLoaded } from "../hooks";
import { Fault, Field, Loading, Page } from "../parts/basic";
import { navigate } from "../router";
import { t } from "../strings";

/** Asks for something that everyone may see who is let in. */
async function check(): Promise<void> {
  try {
    await get("/v1/version", {});
  } catch (fault) {
    forget();
    setKey(null);
    throw fault;
  }
}

export function Login({ onDone }: { onDone: () => void }) {
  const [key, set] = useState("");
  const provider = useLoaded("provider", findProvider);
  const byKey = useAction(async () => {
    forget();
    setKey(key.trim());
    await check();
    onDone();
  });
  const leave = useAction(async () => begin(provider.data!));
  const back = useAction(async () => {
    const to = await finish();
    await check();
    navigate(to, true);
    onDone();
  });
  useEffect(() => {
    if (hasArrived()) back.run();
  }, []);
  if (back.busy || (provider.loading && !provider.data))
    return (
      <Page title={t.login.byProvider}>
        <Loading on />
      </Page>
    );
  const wrong = byKey.error instanceof Refusal && byKey.error.problem.status === 401;
  const known = provider.data;
  return (
    <Page title={known ? t.login.byProvider : t.login.title} lead={known ? t.login.leadProvider : t.login.lead}>
      {known && (
        <div class="card" style={{ maxWidth: "520px" }}>
          <Failure error={back.error ?? leave.error} />
          <div class="row">
            <button
              class="main"
              disabled={leave.busy}
              onClick={() => {
                back.clear();
                leave.run();
              }}
            >
              {t.login.with(hostOf(known.issuer))}
            </button>
          </div>
        </div>
      )}
      <form
        class="card"
        style={{ maxWidth: "520px" }}
        onSubmit={(event) => {
          event.preventDefault();
          byKey.run();
        }}
      >
        {known && <h2>{t.login.orKey}</h2>}
        <input type="text" name="username" autocomplete="username" value="shapelex" hidden readOnly />
        <Field label={t.login.key}>
          <input
            type="password"
            name="key"
            autocomplete="current-password"
            required
            spellcheck={false}
            placeholder="shk_…"
            value={key}
            onInput={(event) => set(event.currentTarget.value)}
          />
        </Field>
        {wrong ? (
          <div class="note bad" role="alert">
            <strong>{t.login.wrong}</strong>
            <p>{t.login.wrongHint}</p>
          </div>
        ) : (
          <Fault error={byKey.error} />
        )}
        <div class="row">
          <button class={known ? "" : "main"} disabled={byKey.busy || !key.trim()}>
            {t.login.enter}
          </button>
        </div>
        <p class="small quiet">{t.login.where}</p>
      </form>
    </Page>
  );
}

function Failure({ error }: { error: Error | undefined }) {
  if (!(error instanceof LoginError)) return <Fault error={error} />;
  const [title, hint] = t.login.failures[error.reason];
  return (
    <div class="note bad" role="alert">
      <strong>{title}</strong>
      <p>{hint(error.about)}</p>
    </div>
  );
}
