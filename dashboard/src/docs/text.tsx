/** Words of the document: paragraphs, and code between backticks. */
import type { ComponentChildren } from "preact";

export function inline(text: string): ComponentChildren[] {
  return text.split("`").map((part, index) => (index % 2 ? <code key={index}>{part}</code> : part));
}

export function Prose({ text }: { text: string | undefined }) {
  if (!text) return null;
  return (
    <>
      {text
        .trim()
        .split(/\n\s*\n/)
        .map((part, index) => (
          <p key={index} class="prose">
            {inline(part)}
          </p>
        ))}
    </>
  );
}

/** A path that may be broken after each of its parts. */
export const breakable = (path: string): ComponentChildren[] =>
  path.split(/(?<=\/)/).map((part) => (
    <>
      {part}
      <wbr />
    </>
  ));

/** A description without the short default that it ends with, and that default. */
export function splitDefault(text = ""): [string, string] {
  const [, before, value] = /^(.*?)\s*\bDefault:\s+(.{1,30}?)\.?\s*$/s.exec(text) ?? [];
  return value === undefined ? [text, ""] : [before!, value];
}
