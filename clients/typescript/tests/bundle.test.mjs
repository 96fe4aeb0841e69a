/** What a bundler takes of the package. */
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { test } from "node:test";
import { fileURLToPath } from "node:url";

const { buildSync } = createRequire(new URL("../../../dashboard/package.json", import.meta.url))("esbuild");
const PACKAGE = new URL("../package.json", import.meta.url);

/** The script of a program. */
function bundled(contents) {
  const stdin = { contents, resolveDir: fileURLToPath(new URL("../dist/", import.meta.url)) };
  const { outputFiles } = buildSync({
    stdin,
    bundle: true,
    minify: true,
    format: "esm",
    write: false,
    logLevel: "silent",
  });
  return outputFiles[0].text;
}

test("a program gets what it uses", (context) => {
  const one = bundled(
    'import { createClient, findVersion } from "./index.js"; findVersion(createClient()).then(console.log);',
  );
  context.diagnostic(`one operation: ${one.length} bytes`);
  assert.ok(one.includes("/v1/version") && !one.includes("/v1/mean") && !one.includes("last-event-id"));
  assert.ok(one.length < 6000, String(one.length));
  const whole = bundled('import * as shapelex from "./index.js"; console.log(shapelex);');
  context.diagnostic(`all operations: ${whole.length} bytes`);
  assert.ok(whole.includes("/v1/mean") && whole.length > 2 * one.length);
});

test("nothing but Node is needed, and the index needs no Node", () => {
  const { dependencies, peerDependencies, sideEffects, exports } = JSON.parse(readFileSync(PACKAGE, "utf8"));
  assert.deepEqual([dependencies, peerDependencies, sideEffects], [undefined, undefined, false]);
  for (const { types, default: code } of Object.values(exports))
    for (const file of [types, code]) assert.ok(readFileSync(new URL(file, PACKAGE), "utf8").length > 0);
  assert.throws(() => bundled('import "node:fs";'));
});
