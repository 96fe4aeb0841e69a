/**
 * The warnings that the service can say and the kinds of contents that it leaves out of files, as its sources have them,
 * and which of them the page says in German. No browser is needed.
 */
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import path from "node:path";
import { test } from "node:test";
import { transformSync } from "esbuild";
import { ROOT } from "./service.mjs";

const source = readFileSync(path.join(ROOT, "dashboard/src/strings/sentences.de.ts"), "utf8");
const { code } = transformSync(source, { loader: "ts", format: "esm" });
const { KINDS, SENTENCES } = await import(`data:text/javascript,${encodeURIComponent(code)}`);

/** Sources of the service, without those of tests and of programs beside it. */
function sources(folder) {
  return readdirSync(folder, { withFileTypes: true }).flatMap((one) => {
    const name = path.join(folder, one.name);
    if (one.isDirectory()) return /^(tests|benches|examples|cli)$/.test(one.name) ? [] : sources(name);
    return one.name.endsWith(".rs") && one.name !== "tests.rs" ? [name] : [];
  });
}

/** Where warnings are made: functions that are named so, what is pushed onto a list of them, and constants. */
const PLACES = [
  /^( *)(?:pub(?:\([^)]*\))? )?(?:async )?fn \w*(?:warning|caveat|minority|stay|meshes|left|without_sizes|few_exchanges|scatter_text|of_parameters|usual)\w*\s*[(<]/gm,
  /(?:warnings?|notes?)\b[\s\S]{0,12}\.(?:push|extend|insert|splice)\(/g,
  /let warning =/g,
  /const \w*(?:UNCENTRED|LEVELS_OF|IN_SAMPLE|OPEN_ENDS|CROSSES)\w*:/g,
];

/** The texts in a piece of a source: literals, with lines that go on joined. */
const literals = (text) =>
  [...text.matchAll(/"((?:[^"\\]|\\[\s\S])*)"/g)].map(([, inner]) =>
    inner.replace(/\\\n\s*/g, "").replaceAll('\\"', '"'),
  );

/** The piece that begins at a place: to the end of the function, or of the statement. */
function piece(text, at, indent) {
  const end = indent === undefined ? text.indexOf(";\n", at) : text.indexOf(`\n${indent}}`, at);
  return text.slice(at, end < 0 ? at + 600 : end);
}

function warnings() {
  const found = new Map();
  for (const folder of ["src", "crates"])
    for (const file of sources(path.join(ROOT, folder))) {
      // Statements and places of SQL have the same words.
      if (/shapelex-store|drawing|src\/audit|src\/wire\/summary/.test(file)) continue;
      const whole = readFileSync(file, "utf8").split(/#\[cfg\(test\)\]\s*mod \w+ \{/)[0];
      const text = whole.replace(/^\s*\/\/.*$/gm, "");
      for (const form of PLACES)
        for (const match of text.matchAll(form))
          for (const one of literals(piece(text, match.index, match[1])))
            if (one.split(" ").length > 3 && !/^expected /.test(one) && !found.has(one))
              found.set(one, path.relative(ROOT, file));
    }
  return found;
}

/** What stands in places whose words are few. */
const WORDS = {
  fault: "folded",
  way: "clockwise",
  what: "holes",
  ratio: "1.25 times as much as",
  more: "above",
  less: "below",
  size: "it has no cell of its initial shape",
};

/** A sentence with something in its places. */
const filled = (text) =>
  text
    .replace(/\{(\w+)\}/g, (place, name) => WORDS[name] ?? place)
    .replace(/\{[^{}]*:\.?\d?e\}/g, "1.5e-3")
    .replace(/\{[^{}]*:\.[1-9]\d*\}/g, "1.25")
    .replace(/\{[^{}]*\}/g, "7");

/** Parts of sentences, and words that no answer to the page has. */
const PARTS = [
  "times as much as",
  "the smaller group scatters more",
  "the larger group scatters more",
  "Hotelling's test assumes",
  "groups of equal size bear",
  "with groups of unequal size",
  "the points are almost equally far",
  "slices have several contours",
  "contours of type CLOSED_PLANAR",
  "contours run along a channel",
  "make label images of them",
  "it has {ratio",
  "it does not contain the centre",
  "it has no cell",
  "shapes stand in the cohort",
  "{}: {follows}",
  "new contours",
  "the first one of the cohort",
  "the mean of the dictionary",
  "of {} contours",
  "shapes: the mean ±",
  "and are compared",
  "labels without a column",
  "curves written as landmarks",
  "{against} {who} run",
];

const known = (sentence) => SENTENCES.findIndex(([form]) => form.test(sentence));

test("warnings of the service are known to the page: those that are not are listed", () => {
  const all = [...warnings()].filter(([text]) => !PARTS.some((part) => text.startsWith(part) || text.includes(part)));
  const unknown = all.filter(([text]) => known(filled(text)) < 0);
  console.log(`${all.length} warnings in the sources, ${all.length - unknown.length} of them in German`);
  for (const [text, file] of unknown) console.log(`not in German: ${file}: ${text}`);
  assert.ok(all.length > 80, `the sources have only ${all.length}: are they where this test looks?`);
  assert.ok(unknown.length <= 0.1 * all.length, `${unknown.length} of ${all.length} are not in German`);
});

/** Kinds that only files which are written leave out; the page does not show these. */
const WRITTEN = [
  "centres",
  "curves written as landmarks",
  "digits of points beside the lattice of pixels",
  "classes, as not all shapes have one that fits",
  "fields that the format has no place for",
  "labels that would begin a section",
  "labels without a column",
  "meshes without faces, written as points",
  "metadata",
  "missing points",
  "names",
  "names, as not all shapes have one",
  "places among the rings of an object",
  "shapes cut off at a number of harmonics",
  "spaces in names and labels, written as _",
  "label",
  "labels",
  "subject",
  "weight",
  "ring",
];

/** Kinds of contents that readers leave out: what they count by `drop`, or by a name given before. */
function kinds() {
  const found = new Map();
  const add = (text, file) => text && !WRITTEN.includes(text) && found.set(text, path.relative(ROOT, file));
  for (const folder of ["src", "crates/shapelex-formats/src"])
    for (const file of sources(path.join(ROOT, folder))) {
      if (/(write|encode|npy_file|table\/rows)\.rs$/.test(file)) continue;
      const text = readFileSync(file, "utf8")
        .split(/#\[cfg\(test\)\]\s*mod \w+ \{/)[0]
        .replace(/^\s*\/\/.*$/gm, "");
      for (const match of text.matchAll(/\.(?:drop|drop_many|lose)\(\s*(?:"([^"]*)"|&?(\w+))/g)) {
        const [, literal, name] = match;
        if (literal !== undefined) add(literal, file);
        else if (/^[A-Z]/.test(name)) {
          const [, of] = new RegExp(`const ${name}: &str = "([^"]*)"`).exec(text) ?? [];
          add(of, file);
        } else {
          const before = text.slice(0, match.index);
          const from = Math.max(before.lastIndexOf(`let ${name} =`), before.lastIndexOf(`for (${name}, `));
          if (from >= 0) literals(before.slice(from)).forEach((one) => add(one, file));
        }
      }
      for (const [, of] of text.matchAll(/const BROKEN: &str = "([^"]*)"/g)) add(of, file);
    }
  return found;
}

test("kinds of contents that are left out of files are known to the page", () => {
  const all = [...kinds()];
  assert.ok(all.length > 90, `the sources have only ${all.length}: are they where this test looks?`);
  const unknown = all.filter(([text]) => known(filled(text)) < 0);
  assert.deepEqual(unknown, [], "kinds that are not in German");
  const gone = Object.keys(KINDS).filter((what) => !all.some(([text]) => text === what));
  assert.deepEqual(gone, [], "kinds that no source has any longer");
});

test("numbers and names of a sentence are kept, once each", () => {
  for (const [form, own] of SENTENCES) {
    const groups = new RegExp(`${form.source}|`).exec("").length - 1;
    const used = [...own.matchAll(/\$~?(\d)/g)].map(([, at]) => Number(at));
    assert.ok(
      used.every((at) => at <= groups),
      `${form}: ${own}`,
    );
    assert.equal(new Set(used).size, used.length, own);
  }
});
