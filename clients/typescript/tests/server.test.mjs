/** A service that is started for tests. */
import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { existsSync, mkdtempSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { promisify } from "node:util";
import { findCohort, findVersion, listCohorts } from "../dist/index.js";
import { findProgram, NoServer, Server } from "../dist/server.js";

const isAlive = (pid) => {
  try {
    return process.kill(pid, 0);
  } catch {
    return false;
  }
};

test("ready when it has started, within two seconds on an idle machine, and gone after its end", async (context) => {
  const times = [];
  for (let turn = 0; turn < 3; turn++) {
    const began = performance.now();
    const server = await Server.start();
    times.push(performance.now() - began);
    assert.equal((await listCohorts(server.client())).items.length, 0);
    const { pid } = server;
    await Promise.all([server.stop(), server.stop()]);
    assert.ok(!isAlive(pid));
    await assert.rejects(findVersion(server.client({ tries: 1 })), { name: "Unreachable" });
  }
  context.diagnostic(`ready after ${times.map((time) => time.toFixed(0)).join(", ")} ms`);
  if (process.env.GOALS === "1") assert.ok(Math.max(...times) < 2000, String(times));
});

test("the example cohort, a folder that is kept, further options", async () => {
  const folder = mkdtempSync(join(tmpdir(), "shapelex-kept-"));
  try {
    const server = await Server.start({ example: true, dataDir: join(folder, "data"), options: ["--threads=1"] });
    const { shape_count } = await findCohort(server.client(), { path: { cohort: "example-cells" } });
    await server.stop();
    assert.equal(shape_count, 120);
    assert.ok(readdirSync(join(folder, "data")).length > 0);
  } finally {
    rmSync(folder, { recursive: true });
  }
});

test("a program that is missing, or does not start, is told", async () => {
  const missing = "expected the program at /nowhere/shapelex, got no file there";
  await assert.rejects(Server.start({ program: "/nowhere/shapelex" }), { name: "NoServer", message: missing });
  const refused = Server.start({ options: ["--treads=1"] });
  await assert.rejects(refused, (error) => error instanceof NoServer && error.message.includes("--treads"));
  assert.ok(existsSync(findProgram()));
});

test("Node that ends without a stop leaves no service and no folder behind", async () => {
  const folder = mkdtempSync(join(tmpdir(), "shapelex-child-"));
  try {
    const script = join(folder, "script.mjs");
    const module = new URL("../dist/server.js", import.meta.url);
    writeFileSync(script, `import { Server } from "${module}"; console.log((await Server.start()).pid);`);
    const env = { ...process.env, TMPDIR: folder };
    const { stdout } = await promisify(execFile)(process.execPath, [script], { env });
    assert.ok(Number(stdout) > 0, stdout);
    for (let looks = 0; isAlive(Number(stdout)) && looks < 100; looks++)
      await new Promise((resolve) => setTimeout(resolve, 20));
    assert.ok(!isAlive(Number(stdout)));
    assert.deepEqual(readdirSync(folder), ["script.mjs"]);
  } finally {
    rmSync(folder, { recursive: true, force: true });
  }
});
