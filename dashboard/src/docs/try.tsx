/** A request, filled in and sent from the page, and its answer. */
import { useEffect, useState } from "preact/hooks";
import { Field } from "../parts/fields";
import { save } from "../parts/save";
import { exampleOf, type Operation, type Parameter, pretty, resolve, sampleOf, typeOf, valuesOf } from "./document";
import { ask, curl, currentKey, type Filled, isBinary, isForm, partsOf, setKey, slot } from "./request";

/** How much of an answer is shown. */
const SHOWN_BYTES = 200_000;

interface Reply {
  status: number;
  statusText: string;
  headers: [string, string][];
  type: string;
  ms: number;
  blob: Blob;
  text?: string;
  picture?: string;
}

function prefilled(operation: Operation, type: string): Pick<Filled, "type" | "text" | "parts" | "files"> {
  const media = operation.body?.content[type];
  const parts = isForm(type) ? partsOf(operation, type).filter(([, schema]) => !isBinary(schema)) : [];
  return {
    type,
    text: media && !isForm(type) ? exampleOf(media, type) : "",
    parts: Object.fromEntries(parts.map(([name, schema]) => [name, pretty(sampleOf(schema))])),
    files: {},
  };
}

/** Media types in which a success may be answered. */
function accepted({ responses }: Operation): string[] {
  const good = Object.entries(responses).filter(([status]) => status.startsWith("2"));
  return [...new Set(good.flatMap(([, { content }]) => Object.keys(content ?? {})))];
}

const isText = (type: string): boolean => /^text\/|json|xml|csv/.test(type);

/** Reads what comes, and shows the beginning; streams of events never end by themselves. */
async function read(response: Response, start: number, then: (reply: Reply) => void): Promise<void> {
  const { status, statusText } = response;
  const type = response.headers.get("content-type") ?? "";
  const chunks: Uint8Array<ArrayBuffer>[] = [];
  const reply = async (whole: boolean): Promise<void> => {
    const blob = new Blob(chunks, { type });
    const ms = performance.now() - start;
    let text = isText(type) ? await blob.slice(0, SHOWN_BYTES).text() : undefined;
    if (text && whole && /[/+]json/.test(type) && blob.size <= SHOWN_BYTES) text = tidy(text);
    const picture = whole && type.startsWith("image/") ? URL.createObjectURL(blob) : undefined;
    then({ status, statusText, type, ms, blob, text, picture, headers: [...response.headers] });
  };
  const reader = response.body?.getReader();
  try {
    for (let part = await reader?.read(); part && !part.done; part = await reader!.read()) {
      chunks.push(part.value);
      if (type.startsWith("text/event-stream")) await reply(false);
    }
  } finally {
    await reply(true);
  }
}

function tidy(text: string): string {
  try {
    return pretty(JSON.parse(text));
  } catch {
    return text;
  }
}

export function Try({ operation }: { operation: Operation }) {
  const types = Object.keys(operation.body?.content ?? {});
  const [filled, setFilled] = useState<Filled>(() => ({
    values: standards(operation),
    accept: "",
    ...prefilled(operation, types[0] ?? ""),
  }));
  const [key, showKey] = useState(currentKey);
  const [reply, setReply] = useState<Reply>();
  const [fault, setFault] = useState("");
  const [running, setRunning] = useState<AbortController>();
  const answers = accepted(operation);
  useEffect(() => () => running?.abort(), [running]);
  useEffect(
    () => () => {
      if (reply?.picture) URL.revokeObjectURL(reply.picture);
    },
    [reply],
  );
  const change = (part: Partial<Filled>) => setFilled((before) => ({ ...before, ...part }));
  const send = async () => {
    const abort = new AbortController();
    setRunning(abort);
    setFault("");
    setReply(undefined);
    try {
      const start = performance.now();
      await read(await ask(operation, filled, abort.signal), start, setReply);
    } catch (error) {
      if (!abort.signal.aborted) setFault((error as Error).message);
    }
    setRunning(undefined);
  };
  return (
    <section class="card try" aria-labelledby="try">
      <h2 id="try" tabIndex={-1}>
        Try it
      </h2>
      <form
        class="stack"
        onSubmit={(event) => {
          event.preventDefault();
          void send();
        }}
      >
        <Values operation={operation} filled={filled} change={change} />
        {operation.body && <BodyFields operation={operation} types={types} filled={filled} change={change} />}
        <div class="form">
          {answers.length > 1 && (
            <Field label="Answer as">
              <Select
                value={filled.accept}
                options={answers}
                first="the default"
                onChange={(accept) => change({ accept })}
              />
            </Field>
          )}
          {operation.role !== "none" && (
            <Field label="Key (kept until the page is left)">
              <input
                type="password"
                autocomplete="off"
                placeholder="shk_…"
                value={key}
                onInput={({ currentTarget: { value } }) => {
                  setKey(value);
                  showKey(value);
                }}
              />
            </Field>
          )}
        </div>
        <div class="row">
          <button class={operation.method === "DELETE" ? "bad" : "main"} disabled={running !== undefined}>
            Send
          </button>
          {running && (
            <button type="button" onClick={() => running.abort()}>
              Stop
            </button>
          )}
        </div>
      </form>
      <Command text={curl(operation, filled, key.trim() !== "")} />
      <div aria-live="polite">
        {fault && (
          <p class="note bad" role="alert">
            {fault}
          </p>
        )}
        {reply && <Shown reply={reply} id={operation.id} />}
      </div>
    </section>
  );
}

interface Part {
  operation: Operation;
  filled: Filled;
  change: (part: Partial<Filled>) => void;
}

/** What a required parameter is at first: the example of the document, or its first value. */
function standards({ parameters }: Operation): Record<string, string> {
  const required = parameters.filter((one) => one.required);
  return Object.fromEntries(required.map((one) => [slot(one), String(one.example ?? valuesOf(one.schema)[0] ?? "")]));
}

function Values({ operation: { parameters }, filled, change }: Part) {
  const field = (one: Parameter) => (
    <Value
      key={slot(one)}
      parameter={one}
      value={filled.values[slot(one)] ?? ""}
      onChange={(value) => change({ values: { ...filled.values, [slot(one)]: value } })}
    />
  );
  const optional = parameters.filter((one) => !one.required);
  const few = optional.length <= 3;
  const shown = parameters.filter((one) => one.required || few);
  return (
    <>
      {shown.length > 0 && <div class="form">{shown.map(field)}</div>}
      {!few && (
        <details>
          <summary>{optional.length} optional parameters</summary>
          <div class="form">{optional.map(field)}</div>
        </details>
      )}
    </>
  );
}

function Select({
  value,
  options,
  first,
  onChange,
}: {
  value: string;
  options: string[];
  first?: string;
  onChange: (value: string) => void;
}) {
  return (
    <select value={value} onChange={(event) => onChange(event.currentTarget.value)}>
      {first && <option value="">{first}</option>}
      {options.map((one) => (
        <option key={one}>{one}</option>
      ))}
    </select>
  );
}

function Value({
  parameter,
  value,
  onChange,
}: {
  parameter: Parameter;
  value: string;
  onChange: (value: string) => void;
}) {
  const { name, schema, required, style, example } = parameter;
  const found = resolve(schema).schema;
  const isList = [found.type].flat().includes("array");
  const options = found.type === "boolean" ? ["true", "false"] : isList ? [] : valuesOf(schema).map(String);
  const shown = typeof example === "object" ? "" : String(example ?? "");
  const hint =
    style === "deepObject" ? "name=value&name.gte=1" : shown || (isList ? "separated by commas" : typeOf(schema));
  return (
    <Field label={parameter.in === "header" ? `${name} (header)` : name}>
      {options.length > 0 ? (
        <Select value={value} options={options} first={required ? undefined : "–"} onChange={onChange} />
      ) : (
        <input
          value={value}
          required={required}
          placeholder={hint}
          spellcheck={false}
          onInput={(event) => onChange(event.currentTarget.value)}
        />
      )}
    </Field>
  );
}

function Text({
  label,
  value,
  onInput,
  disabled,
}: {
  label: string;
  value: string;
  onInput: (value: string) => void;
  disabled?: boolean;
}) {
  const rows = Math.min(22, value.split("\n").length + 1);
  return (
    <Field label={label}>
      <textarea
        rows={rows}
        spellcheck={false}
        wrap="off"
        value={value}
        disabled={disabled}
        onInput={(event) => onInput(event.currentTarget.value)}
      />
    </Field>
  );
}

function Files({
  label,
  onChange,
  required,
}: {
  label: string;
  onChange: (file: File | undefined) => void;
  required?: boolean;
}) {
  return (
    <Field label={label}>
      <input type="file" required={required} onChange={(event) => onChange(event.currentTarget.files?.[0])} />
    </Field>
  );
}

function BodyFields({ operation, types, filled, change }: Part & { types: string[] }) {
  const { type, text, parts, files } = filled;
  const file = (name: string) => (chosen: File | undefined) => change({ files: { ...files, [name]: chosen } });
  const required = resolve(operation.body!.content[type]?.schema).schema.required ?? [];
  return (
    <>
      {types.length > 1 && (
        <Field label="Body as">
          <Select value={type} options={types} onChange={(next) => change(prefilled(operation, next))} />
        </Field>
      )}
      {!isForm(type) && (
        <Text label="Body" value={text} disabled={Boolean(files[""])} onInput={(value) => change({ text: value })} />
      )}
      {!isForm(type) && type !== "application/json" && <Files key={type} label="or a file" onChange={file("")} />}
      {isForm(type) &&
        partsOf(operation, type).map(([name, schema]) =>
          isBinary(schema) ? (
            <Files key={name} label={name} required={required.includes(name)} onChange={file(name)} />
          ) : (
            <Text
              key={name}
              label={name}
              value={parts[name] ?? ""}
              onInput={(value) => change({ parts: { ...parts, [name]: value } })}
            />
          ),
        )}
    </>
  );
}

function Command({ text }: { text: string }) {
  const [done, setDone] = useState(false);
  const copy = async () => {
    await navigator.clipboard.writeText(text);
    setDone(true);
    setTimeout(() => setDone(false), 2000);
  };
  return (
    <div class="stack tight">
      <div class="row spread">
        <h3>The same by curl</h3>
        <button class="plain" onClick={() => void copy()}>
          {done ? "Copied" : "Copy"}
        </button>
      </div>
      <pre class="code short" tabIndex={0}>
        {text}
      </pre>
    </div>
  );
}

function Shown({ reply, id }: { reply: Reply; id: string }) {
  const { status, statusText, headers, type, ms, blob, text, picture } = reply;
  const size = blob.size.toLocaleString("en");
  return (
    <div class="stack tight answer">
      <div class="row spread">
        <div class="row">
          <h3>Answer</h3>
          <span class={`tag ${status < 400 ? "good" : "bad"}`}>
            {status} {statusText}
          </span>
          <span class="small quiet">
            {size} bytes, {ms.toFixed(0)} ms
          </span>
        </div>
        {blob.size > 0 && (
          <button class="plain" onClick={() => save(blob, id)}>
            Save
          </button>
        )}
      </div>
      <details>
        <summary class="small">{headers.length} headers</summary>
        <dl class="facts">
          {headers.map(([name, value]) => (
            <>
              <dt>{name}</dt>
              <dd>
                <code>{value}</code>
              </dd>
            </>
          ))}
        </dl>
      </details>
      {picture && <img src={picture} alt="What was answered" />}
      {!picture && text && (
        <pre class="code" tabIndex={0}>
          {text}
        </pre>
      )}
      {text !== undefined && blob.size > SHOWN_BYTES && (
        <p class="small quiet">
          The first {SHOWN_BYTES / 1000} kB of {size} bytes.
        </p>
      )}
      {text === undefined && !picture && blob.size > 0 && <p class="small quiet">{type}: not shown.</p>}
    </div>
  );
}
