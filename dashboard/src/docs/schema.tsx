/** A schema as a tree. Parts are made when they are opened, so that a schema may contain itself. */

import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import { boundsOf, flat, resolve, type Schema, typeOf, valuesOf, variantName, variantsOf } from "./document";
import { inline } from "./text";

/** What is open at first: small objects are seen at once, large ones by their fields. */
const AT_ONCE = 1;

/** The schema whose fields or alternatives are below: of an array its entries, of a map its values. */
function inner(given: Schema | undefined): Schema | undefined {
  const { schema } = resolve(given);
  const next =
    schema.items ?? (typeof schema.additionalProperties === "object" ? schema.additionalProperties : undefined);
  if (next && !schema.properties) return inner(next);
  const whole = flat(schema);
  return whole.properties || variantsOf(schema) ? given : undefined;
}

export function Values({ of: schema }: { of: Schema }) {
  const values = valuesOf(schema);
  if (values.length === 0) return null;
  return (
    <p class="values">
      one of{" "}
      {values.map((value) => (
        <code key={String(value)}>{String(value)}</code>
      ))}
    </p>
  );
}

export const Required = () => <span class="tag warn">required</span>;

function Line({ name, given, required }: { name?: string; given: Schema; required?: boolean }) {
  const { schema, nullable } = resolve(given);
  const notes = [schema.format !== "binary" && schema.format, nullable && "or null", ...boundsOf(schema)].filter(
    Boolean,
  );
  return (
    <>
      {name !== undefined && <code class="field-name">{name}</code>} {required && <Required />}{" "}
      <span class="type">{typeOf(given)}</span>{" "}
      {notes.length > 0 && <span class="small quiet">{notes.join(", ")}</span>}
      {schema.default !== undefined && (
        <span class="small quiet">
          default <code>{JSON.stringify(schema.default)}</code>
        </span>
      )}
    </>
  );
}

/** An entry of a tree: its line, its description, and what is below. */
function Entry({ given, head, depth }: { given: Schema; head: ComponentChildren; depth: number }) {
  const [open, setOpen] = useState(depth < AT_ONCE);
  const { description } = resolve(given);
  const below = inner(given);
  const about = description && <p class="small">{inline(description)}</p>;
  return (
    <li>
      {below ? (
        <details open={open} onToggle={(event) => setOpen(event.currentTarget.open)}>
          <summary>{head}</summary>
          {open && (
            <>
              {about}
              <Parts given={below} depth={depth} />
            </>
          )}
        </details>
      ) : (
        <div class="leaf">{head}</div>
      )}
      {!(below && open) && about}
      <Values of={given} />
    </li>
  );
}

function Parts({ given, depth }: { given: Schema; depth: number }) {
  const { schema } = resolve(given);
  const whole = flat(schema);
  const variants = variantsOf(schema);
  const required = new Set(whole.required);
  const fields = Object.entries(whole.properties ?? {});
  // What must be given comes first.
  fields.sort(([one], [other]) => Number(required.has(other)) - Number(required.has(one)));
  return (
    <>
      {fields.length > 0 && (
        <ul class="tree">
          {fields.map(([name, field]) => (
            <Entry
              key={name}
              given={field}
              depth={depth + 1}
              head={<Line name={name} given={field} required={required.has(name)} />}
            />
          ))}
        </ul>
      )}
      {variants && <Variants all={variants} whole={schema} depth={depth} />}
    </>
  );
}

function Variants({ all, whole, depth }: { all: Schema[]; whole: Schema; depth: number }) {
  return (
    <>
      <p class="small quiet">One of {all.length}:</p>
      <ul class="tree">
        {all.map((variant, index) => {
          const [title, type] = [variantName(variant, whole), typeOf(variant)];
          const head = (
            <>
              <strong>{title}</strong> {title !== type && <span class="type">{type}</span>}
            </>
          );
          return <Entry key={index} given={variant} depth={depth + 1} head={head} />;
        })}
      </ul>
    </>
  );
}

export function SchemaTree({ schema }: { schema: Schema | undefined }) {
  const given = schema ?? {};
  return (
    <ul class="tree">
      <Entry given={given} depth={0} head={<Line given={given} />} />
    </ul>
  );
}
