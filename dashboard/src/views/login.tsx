/** The key of a service that asks for one. It stays in this tab. */
import { useState } from "preact/hooks";
import { get, Refusal, setKey } from "../api/client";
import { Fault, Field, Page } from "../parts/basic";
import { useAction } from "../hooks";
import { t } from "../strings";

export function Login({ onDone }: { onDone: () => void }) {
  const [key, set] = useState("");
  const { run, busy, error } = useAction(async () => {
    setKey(key.trim());
    try {
      await get("/v1/version", {});
      onDone();
    } catch (fault) {
      setKey(null);
      throw fault;
    }
  });
  const wrong = error instanceof Refusal && error.problem.status === 401;
  return (
    <Page title={t.login.title} lead={t.login.lead}>
      <form class="card" style={{ maxWidth: "520px" }} onSubmit={(event) => { event.preventDefault(); run(); }}>
        <input type="text" name="username" autocomplete="username" value="shapelex" hidden readOnly />
        <Field label={t.login.key}><input type="password" name="key" autocomplete="current-password" required spellcheck={false} placeholder="shk_…" value={key} onInput={(event) => set(event.currentTarget.value)} /></Field>
        {wrong ? <div class="note bad" role="alert"><strong>{t.login.wrong}</strong><p>{t.login.wrongHint}</p></div> : <Fault error={error} />}
        <div class="row"><button class="main" disabled={busy || !key.trim()}>{t.login.enter}</button></div>
        <p class="small quiet">{t.login.where}</p>
      </form>
    </Page>
  );
}
