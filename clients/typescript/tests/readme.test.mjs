/** The programs of the README and of docs/clients.md run as they stand, in a folder where the package is installed. */
import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { copyFileSync, mkdirSync, mkdtempSync, readFileSync, rmSync, symlinkSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { promisify } from "node:util";
import { findProgram, Server } from "../dist/server.js";

const PACKAGE = fileURLToPath(new URL("../", import.meta.url));
const PAGES = ["README.md", "../../docs/clients.md"].map((page) => readFileSync(join(PACKAGE, page), "utf8"));
const BLOCKS = [...PAGES.join("\n").matchAll(/```js\n(.*?)```/gs)].map(([, text]) => text);

let folder;
let server;
before(async () => {
  server = await Server.start({ example: true });
  folder = mkdtempSync(join(tmpdir(), "shapelex-readme-"));
  mkdirSync(join(folder, "node_modules"));
  symlinkSync(PACKAGE, join(folder, "node_modules/shapelex"));
  copyFileSync(join(PACKAGE, "../../examples/cells/cells.ndjson"), join(folder, "cells.ndjson"));
});
after(async () => {
  await server?.stop();
  if (folder) rmSync(folder, { recursive: true });
});

/** What a program prints; the service that `make run` starts is that of the test. */
async function printed(text) {
  const env = {
    ...process.env,
    SHAPELEX_BINARY: findProgram(),
    SHAPELEX_SERVER: server.url,
    NODE_TEST_CONTEXT: undefined,
  };
  const here = text.replace("createClient()", "createClient({ url: process.env.SHAPELEX_SERVER })");
  writeFileSync(join(folder, "program.mjs"), here);
  return (await promisify(execFile)(process.execPath, ["program.mjs"], { cwd: folder, env, timeout: 300_000 })).stdout;
}

const SAYS = [
  /^120 32 cell-modes$/m,
  /"?measures.area/,
  /added: 1,/,
  /succeeded atoms/,
  /^\S+ \/shapes\/0\/points 0 /m,
  /pass 1/,
  /^120 3 cells$/m,
  /pass 1/,
];

for (const [k, text] of BLOCKS.entries())
  test(`program ${k + 1}`, async () => assert.match(await printed(text), SAYS[k]));
