/** Any request of the API, filled in, sent, and copied for a program. */
import { useEffect, useState } from "preact/hooks";
import { authorization, fill } from "../api/client";
import { useAction, useLoaded } from "../hooks";
import { Choice, Copy, Fault, Field, Loading, Page } from "../parts/basic";
import { useSetting } from "../router";
import { count, number, t } from "../strings";

interface Parameter {
  name: string;
  in: string;
  required?: boolean;
  description?: string;
  schema?: { enum?: string[] };
}
interface Operation {
  id: string;
  method: string;
  path: string;
  summary: string;
  tag: string;
  parameters: Parameter[];
  media: string[];
  example: string;
}
interface Document {
  paths: Record<
    string,
    Record<
      string,
      {
        operationId?: string;
        summary?: string;
        tags?: string[];
        parameters?: Parameter[];
        requestBody?: {
          content: Record<
            string,
            { example?: unknown; examples?: Record<string, { value: unknown }>; schema?: { $ref?: string } }
          >;
        };
      }
    >
  >;
  components: { schemas: Record<string, { example?: unknown }> };
}

function operationsOf(document: Document): Operation[] {
  return Object.entries(document.paths).flatMap(([path, methods]) =>
    Object.entries(methods)
      .filter(([method]) => ["get", "post", "put", "patch", "delete"].includes(method))
      .map(([method, one]) => {
        const content = one.requestBody?.content ?? {};
        const json = content["application/json"];
        const schema = json?.schema?.$ref?.split("/").pop();
        const example =
          json?.example ??
          Object.values(json?.examples ?? {})[0]?.value ??
          (schema ? document.components.schemas[schema]?.example : undefined);
        return {
          id: one.operationId ?? `${method} ${path}`,
          method: method.toUpperCase(),
          path,
          summary: one.summary ?? "",
          tag: one.tags?.[0] ?? "",
          parameters: one.parameters ?? [],
          media: Object.keys(content),
          example: json ? JSON.stringify(example ?? {}, null, 2) : "",
        };
      }),
  );
}

type Language = "curl" | "Python" | "R";

/** The request as a program would make it. The key is named, never written out. */
function program(
  language: Language,
  method: string,
  url: string,
  headers: Record<string, string>,
  body: string,
): string {
  const all = Object.entries(headers);
  const keyed = Object.keys(authorization()).length > 0;
  if (language === "curl") {
    const quote = (text: string) => `'${text.replaceAll("'", "'\\''")}'`;
    return [
      `curl -s -X ${method} ${quote(url)}`,
      ...(keyed ? [`-H "authorization: Bearer $SHAPELEX_KEY"`] : []),
      ...all.map(([name, value]) => `-H ${quote(`${name}: ${value}`)}`),
      ...(body ? [`-d ${quote(body)}`] : []),
    ].join(" \\\n  ");
  }
  if (language === "Python") {
    const pairs = [
      ...(keyed ? [`"authorization": "Bearer " + os.environ["SHAPELEX_KEY"]`] : []),
      ...all.map(([name, value]) => `${JSON.stringify(name)}: ${JSON.stringify(value)}`),
    ];
    return `${keyed ? "import os\n" : ""}import requests\n\nanswer = requests.request(\n    ${JSON.stringify(method)},\n    ${JSON.stringify(url)},\n    headers={${pairs.join(", ")}},${body ? `\n    data=r"""${body}""",` : ""}\n)\nanswer.raise_for_status()\nprint(answer.json())`;
  }
  const pairs = [
    ...(keyed ? [`authorization = paste("Bearer", Sys.getenv("SHAPELEX_KEY"))`] : []),
    ...all.filter(([name]) => name !== "content-type").map(([name, value]) => `\`${name}\` = ${JSON.stringify(value)}`),
  ];
  return `library(httr2)\n\nanswer <- request(${JSON.stringify(url)}) |>\n  req_method(${JSON.stringify(method)})${pairs.length ? ` |>\n  req_headers(${pairs.join(", ")})` : ""}${body ? ` |>\n  req_body_raw(r"---(${body})---", type = ${JSON.stringify(headers["content-type"] ?? "application/json")})` : ""} |>\n  req_perform() |>\n  resp_body_json()`;
}

export function Console() {
  const document = useLoaded("document", async (signal) =>
    operationsOf((await (await fetch("/openapi.json", { signal })).json()) as Document),
  );
  const [id, setId] = useSetting("operation", "cohort_mean");
  const [language, setLanguage] = useSetting("as", "curl");
  const chosen = document.data?.find((one) => one.id === id) ?? document.data?.[0];
  const [values, setValues] = useState<Record<string, string>>({});
  const [body, setBody] = useState("");
  const [answer, setAnswer] = useState<{
    status: number;
    type: string;
    text: string;
    size: number;
    ms: number;
    picture?: string;
  }>();
  useEffect(() => {
    setValues(
      Object.fromEntries(
        (chosen?.parameters ?? [])
          .filter((one) => one.required)
          .map((one) => [
            one.name,
            one.name === "cohort" ? "example-cells" : one.name === "transformation" ? "similarity" : "",
          ]),
      ),
    );
    setBody(chosen?.example ?? "");
    setAnswer(undefined);
  }, [chosen?.id]);
  useEffect(
    () => () => {
      if (answer?.picture) URL.revokeObjectURL(answer.picture);
    },
    [answer],
  );
  const query = new URLSearchParams(
    (chosen?.parameters ?? [])
      .filter((one) => one.in === "query" && values[one.name])
      .map((one) => [one.name, values[one.name]!]),
  );
  const url = chosen ? fill(chosen.path, values) + (query.size ? `?${query}` : "") : "";
  const headers: Record<string, string> = {
    ...(body && chosen?.example ? { "content-type": "application/json" } : {}),
    ...Object.fromEntries(
      (chosen?.parameters ?? [])
        .filter((one) => one.in === "header" && values[one.name])
        .map((one) => [one.name, values[one.name]!]),
    ),
  };
  const send = useAction(async () => {
    const start = performance.now();
    const response = await fetch(url, {
      method: chosen!.method,
      headers: { ...headers, ...authorization() },
      body: chosen!.example ? body : undefined,
      credentials: "omit",
      signal: AbortSignal.timeout(60_000),
    });
    const type = response.headers.get("content-type") ?? "";
    const blob = await response.blob();
    const picture = type.startsWith("image/") ? URL.createObjectURL(blob) : undefined;
    const text = picture ? "" : await blob.slice(0, 200_000).text();
    setAnswer({
      status: response.status,
      type,
      size: blob.size,
      ms: performance.now() - start,
      picture,
      text: type.includes("json") && blob.size < 200_000 ? pretty(text) : text,
    });
  });
  const tags = [...new Set(document.data?.map((one) => one.tag))];
  const sendable = chosen && (chosen.media.length === 0 || chosen.media.includes("application/json"));
  return (
    <Page
      title={t.menu.console}
      lead={
        <>
          {t.console.lead}{" "}
          <a href={`/docs#${id}`} target="_blank" rel="noreferrer">
            {t.menu.reference}
          </a>
        </>
      }
    >
      <Fault error={document.error} retry={document.reload} />
      <Loading on={document.loading} />
      {chosen && (
        <div class="columns">
          <form
            class="card"
            onSubmit={(event) => {
              event.preventDefault();
              send.run();
            }}
          >
            <Field label={t.console.operation}>
              <select value={chosen.id} onChange={(event) => setId(event.currentTarget.value, false)}>
                {tags.map((tag) => (
                  <optgroup key={tag} label={tag}>
                    {document
                      .data!.filter((one) => one.tag === tag)
                      .map((one) => (
                        <option key={one.id} value={one.id} selected={one.id === chosen.id}>
                          {one.method} {one.path}
                        </option>
                      ))}
                  </optgroup>
                ))}
              </select>
            </Field>
            <p class="quiet">{chosen.summary}</p>
            {chosen.parameters
              .filter((one) => one.required)
              .map((one) => (
                <Value
                  key={one.name}
                  parameter={one}
                  value={values[one.name] ?? ""}
                  onInput={(value) => setValues({ ...values, [one.name]: value })}
                />
              ))}
            {chosen.parameters.some((one) => !one.required) && (
              <details>
                <summary>{t.console.optional(chosen.parameters.filter((one) => !one.required).length)}</summary>
                <div class="stack">
                  {chosen.parameters
                    .filter((one) => !one.required)
                    .map((one) => (
                      <Value
                        key={one.name}
                        parameter={one}
                        value={values[one.name] ?? ""}
                        onInput={(value) => setValues({ ...values, [one.name]: value })}
                      />
                    ))}
                </div>
              </details>
            )}
            {chosen.example && (
              <Field label={t.console.body}>
                <textarea
                  rows={Math.min(18, body.split("\n").length + 1)}
                  spellcheck={false}
                  value={body}
                  onInput={(event) => setBody(event.currentTarget.value)}
                />
              </Field>
            )}
            {!sendable && <p class="note">{t.console.files}</p>}
            <Fault error={send.error} />
            {sendable && (
              <div class="row">
                <button class={chosen.method === "DELETE" ? "bad" : "main"} disabled={send.busy}>
                  {t.console.send}
                </button>
              </div>
            )}
          </form>
          <div class="stack" style={{ gap: "22px" }}>
            <section class="card">
              <div class="row spread">
                <h2>{t.console.copy}</h2>
                <Copy
                  text={program(
                    language as Language,
                    chosen.method,
                    location.origin + url,
                    headers,
                    chosen.example ? body : "",
                  )}
                />
              </div>
              <Choice
                label={t.console.copy}
                value={language}
                options={[
                  ["curl", "curl"],
                  ["Python", "Python"],
                  ["R", "R"],
                ]}
                onChange={setLanguage}
              />
              <pre class="code" tabIndex={0}>
                {program(
                  language as Language,
                  chosen.method,
                  location.origin + url,
                  headers,
                  chosen.example ? body : "",
                )}
              </pre>
            </section>
            {answer && (
              <section class="card" aria-live="polite">
                <div class="row spread">
                  <h2>{t.console.answer}</h2>
                  <span class={`tag ${answer.status < 300 ? "good" : "bad"}`}>{answer.status}</span>
                </div>
                <p class="small quiet">
                  {answer.type || "–"}, {count(answer.size)} B, {number(answer.ms, 3)} ms
                </p>
                {answer.picture ? (
                  <img src={answer.picture} alt={t.console.answer} style={{ maxWidth: "100%" }} />
                ) : (
                  <pre class="code" tabIndex={0}>
                    {answer.text}
                  </pre>
                )}
              </section>
            )}
          </div>
        </div>
      )}
    </Page>
  );
}

function Value({
  parameter,
  value,
  onInput,
}: {
  parameter: Parameter;
  value: string;
  onInput: (value: string) => void;
}) {
  const label = parameter.name + (parameter.in === "query" || parameter.in === "path" ? "" : ` (${parameter.in})`);
  return (
    <div class="stack tight">
      <Field label={label}>
        <input value={value} required={parameter.required} onInput={(event) => onInput(event.currentTarget.value)} />
      </Field>
      {parameter.description && <span class="small quiet">{parameter.description.split("\n")[0]}</span>}
    </div>
  );
}

function pretty(text: string): string {
  try {
    // Long arrays of numbers stay on one line.
    return JSON.stringify(JSON.parse(text), null, 2).replace(
      /\[\s+(-?[\d.e+-]+),\s+(-?[\d.e+-]+)(?:,\s+(-?[\d.e+-]+))?\s+\]/g,
      (_, a: string, b: string, c?: string) => `[${[a, b, c].filter(Boolean).join(", ")}]`,
    );
  } catch {
    return text;
  }
}
