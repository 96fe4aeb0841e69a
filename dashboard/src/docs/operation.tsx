/** One operation: what it does, what it takes, what it answers. */
import { useState } from "preact/hooks";
import { Choice } from "../parts/fields";
import {
  type Answer,
  boundsOf,
  exampleOf,
  type Media,
  type Operation,
  type Parameter,
  resolve,
  typeOf,
} from "./document";
import { Required, SchemaTree, Values } from "./schema";
import { breakable, inline, Prose, splitDefault } from "./text";
import { Try } from "./try";

export const Method = ({ of }: { of: string }) => <span class={`method ${of.toLowerCase()}`}>{of}</span>;

export function Details({ operation }: { operation: Operation }) {
  const { id, method, path, tag, summary, description, parameters, body, role } = operation;
  return (
    <article class="page">
      <header class="head">
        <p class="crumbs">
          <a href="#">Reference</a>
          <span aria-hidden="true">/</span>
          <span>{tag}</span>
        </p>
        <h1 id="title" tabIndex={-1}>
          <Method of={method} /> <code>{breakable(path)}</code>
        </h1>
        <p class="lead">{inline(summary)}</p>
        <div class="row facts-line small quiet">
          <span>
            Operation{" "}
            <a href={`#${id}`}>
              <code>{id}</code>
            </a>
          </span>
          <span>Needs {role === "none" ? "no key" : `the role ${role}`}</span>
          <button class="plain" onClick={() => document.getElementById("try")?.focus()}>
            Try it ↓
          </button>
        </div>
      </header>
      {description && (
        <div class="stack">
          <Prose text={description} />
        </div>
      )}
      {parameters.length > 0 && <Parameters all={parameters} />}
      {body && <Body content={body.content} required={body.required} />}
      <Responses all={operation.responses} />
      <Try key={id} operation={operation} />
    </article>
  );
}

const PLACES = { path: 0, query: 1, header: 2 };

function Parameters({ all }: { all: Parameter[] }) {
  const weight = (one: Parameter) => PLACES[one.in] * 2 + (one.required ? 0 : 1);
  const sorted = [...all].sort((one, other) => weight(one) - weight(other));
  return (
    <section class="card">
      <h2>Parameters</h2>
      <table class="stacks">
        <thead>
          <tr>
            {["Name", "Where", "Type", "Default", "Description"].map((head) => (
              <th key={head} scope="col">
                {head}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {sorted.map((one) => (
            <Row key={`${one.in} ${one.name}`} parameter={one} />
          ))}
        </tbody>
      </table>
    </section>
  );
}

function Row({ parameter }: { parameter: Parameter }) {
  const { name, schema, required, description } = parameter;
  const [text, said] = splitDefault(description);
  return (
    <tr>
      <th scope="row">
        <code class="field-name">{name}</code>
        {required && <Required />}
      </th>
      <td>{parameter.in}</td>
      <td>
        <span class="type">{typeOf(schema)}</span>{" "}
        <span class="small quiet">{boundsOf(resolve(schema).schema).join(", ")}</span>
      </td>
      <td class={said ? "" : "none"}>{inline(said)}</td>
      <td>
        {inline(text)}
        <Values of={schema} />
      </td>
    </tr>
  );
}

/** Media types with the same schema together. */
function bySchema(content: Record<string, Media>): [string[], Media][] {
  const groups = new Map<string, [string[], Media]>();
  for (const [type, media] of Object.entries(content)) {
    const key = typeOf(media.schema);
    const group = groups.get(key);
    if (group) group[0].push(type);
    else groups.set(key, [[type], media]);
  }
  return [...groups.values()];
}

function Body({ content, required }: { content: Record<string, Media>; required?: boolean }) {
  const types = Object.keys(content);
  const [type, setType] = useState(types[0]!);
  const media = content[type] ?? content[types[0]!]!;
  const binary = resolve(media.schema).schema.format === "binary";
  return (
    <section class="card">
      <div class="row spread">
        <h2>Request body{required ? "" : " (optional)"}</h2>
        {types.length > 1 ? (
          <Choice label="Media type" value={type} options={types.map((one) => [one, one])} onChange={setType} />
        ) : (
          <code>{types[0]}</code>
        )}
      </div>
      <SchemaTree key={type} schema={media.schema} />
      {!binary && type !== "multipart/form-data" && (
        <details>
          <summary>Example</summary>
          <pre class="code" tabIndex={0}>
            {exampleOf(media, type)}
          </pre>
        </details>
      )}
    </section>
  );
}

const isRefusal = (status: string): boolean => status.startsWith("4") || status.startsWith("5");

function Responses({ all }: { all: Record<string, Answer> }) {
  const entries = Object.entries(all);
  const refusals = entries.filter(([status]) => isRefusal(status));
  const problem = refusals.map(([, { content }]) => content?.["application/problem+json"]).find(Boolean);
  return (
    <section class="card">
      <h2>Responses</h2>
      {entries
        .filter(([status]) => !isRefusal(status))
        .map(([status, answer]) => (
          <Good key={status} status={status} answer={answer} />
        ))}
      {refusals.length > 0 && (
        <>
          <h3>Refusals</h3>
          <dl class="refusals">
            {refusals.map(([status, answer]) => (
              <div key={status}>
                <dt>
                  <span class="tag bad">{status}</span>
                </dt>
                <dd>
                  {inline(answer.description)}
                  <Headers of={answer} />
                </dd>
              </div>
            ))}
          </dl>
          {problem && <Schemas content={{ "application/problem+json": problem }} open={false} />}
        </>
      )}
    </section>
  );
}

function Headers({ of: { headers } }: { of: Answer }) {
  if (!headers) return null;
  return (
    <p class="small quiet">
      Headers:{" "}
      {Object.entries(headers).map(([name, { description }], index) => (
        <span key={name}>
          {index > 0 && ", "}
          <code>{name}</code>
          {description && <> ({inline(description)})</>}
        </span>
      ))}
    </p>
  );
}

function Good({ status, answer }: { status: string; answer: Answer }) {
  return (
    <div class="stack tight">
      <p>
        <span class="tag good">{status}</span> {inline(answer.description)}
      </p>
      <Headers of={answer} />
      {answer.content && <Schemas content={answer.content} open={status !== "202"} />}
    </div>
  );
}

function Schemas({ content, open }: { content: Record<string, Media>; open: boolean }) {
  return (
    <>
      {bySchema(content).map(([types, media], index) => {
        const names = inline(types.map((type) => `\`${type}\``).join(" "));
        // What has no parts needs no tree.
        return resolve(media.schema).schema.type === "string" ? (
          <p key={index}>
            {names} <span class="type">{typeOf(media.schema)}</span>
          </p>
        ) : (
          <details key={index} open={open && index === 0}>
            <summary>{names}</summary>
            <SchemaTree schema={media.schema} />
          </details>
        );
      })}
    </>
  );
}
