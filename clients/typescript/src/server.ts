/** A service on this machine, for scripts and tests. Node only. */
import { type ChildProcess, spawn } from "node:child_process";
import { closeSync, existsSync, mkdtempSync, openSync, readFileSync, rmSync, statSync } from "node:fs";
import { tmpdir } from "node:os";
import { delimiter, dirname, join, resolve } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";
import { fileURLToPath } from "node:url";
import type { Client } from "./client.js";
import { ShapelexError } from "./errors.js";
import { type ClientOptions, createClient } from "./retry.js";

/** Milliseconds in which a service must be ready: a store of gigabytes is checked at the start. */
const PATIENCE = 60_000;
/** Milliseconds in which it must end. */
const FAREWELL = 20_000;
/** Milliseconds between two looks whether it is ready. */
const LOOK = 10;

/** No program was found, or it ended before it was ready: what it said last is in the text. */
export class NoServer extends ShapelexError {
  override name = "NoServer";
}

const isFile = (path: string): boolean => statSync(path, { throwIfNoEntry: false })?.isFile() ?? false;

/** A folder and all folders above it. */
function* upwards(folder: string): Generator<string> {
  for (let last = ""; folder !== last; folder = dirname(folder)) {
    yield folder;
    last = folder;
  }
}

/** The newest build in a `target` folder of the checkout that holds the working folder or this package. */
function findBuild(): string | undefined {
  for (const start of [process.cwd(), dirname(fileURLToPath(import.meta.url))])
    for (const folder of upwards(start)) {
      const target = process.env["CARGO_TARGET_DIR"] ?? join(folder, "target");
      const builds = ["release", "dist", "debug"].map((profile) => join(target, profile, "shapelex")).filter(isFile);
      if (builds.length && isFile(join(folder, "openapi/openapi.json")))
        return builds.sort((a, b) => statSync(b).mtimeMs - statSync(a).mtimeMs)[0];
    }
  return undefined;
}

/**
 * The program `shapelex`: the argument, `SHAPELEX_BINARY`, the search path, then the newest build of a checkout. What is named but does
 * not exist is an error, not a reason to look on.
 */
export function findProgram(program?: string): string | undefined {
  const named = program ?? (process.env["SHAPELEX_BINARY"] || undefined);
  if (named && !isFile(named)) throw new NoServer(`expected the program at ${named}, got no file there`);
  if (named) return resolve(named);
  const places = (process.env["PATH"] ?? "").split(delimiter).filter(Boolean);
  return places.map((place) => join(place, "shapelex")).find(isFile) ?? findBuild();
}

export interface ServerOptions {
  /** The program. Default: as `findProgram` finds it. */
  program?: string;
  /** Folder of the store. Default: a new one, which is removed in the end. */
  dataDir?: string;
  /** Whether an empty store gets the example cohort `example-cells` of 120 outlines. Default: false. */
  example?: boolean;
  /** Further options of `shapelex serve`, such as `"--threads=1"`. */
  options?: readonly string[];
}

/** The last lines of a log. */
function ending(log: string): string {
  const lines = readFileSync(log, "utf8")
    .split("\n")
    .filter((line) => line.trim());
  return lines.slice(-5).join(" / ") || "it said nothing";
}

/** Starts the program; settings of another service would be refused, or would change this one. */
function started(
  program: string,
  folder: string,
  log: string,
  { dataDir, example, options = [] }: ServerOptions,
): ChildProcess {
  const data = dataDir ?? join(folder, "data");
  const flags = [
    "serve",
    "--listen=127.0.0.1:0",
    `--data-dir=${data}`,
    "--log=warn",
    ...options,
    ...(example ? [] : ["--no-example"]),
  ];
  const env = Object.fromEntries(Object.entries(process.env).filter(([name]) => !name.startsWith("SHAPELEX_")));
  const file = openSync(log, "w");
  const child = spawn(program, flags, { stdio: ["ignore", "pipe", file], env });
  closeSync(file);
  return child;
}

/** The address that the program prints when it listens. */
function addressOf(child: ChildProcess, log: string): Promise<string> {
  return new Promise((resolve, reject) => {
    let said = "";
    const fail = (reason: string) => reject(new NoServer(`expected an address from ${child.spawnfile}, got ${reason}`));
    child.once("error", (error) => fail(error.message));
    child.once("close", () => fail(said.trim() || ending(log)));
    child.stdout!.setEncoding("utf8").on("data", (text: string) => {
      said += text;
      const found = / on (https?:\/\/\S+)\s/.exec(said);
      if (found) resolve(found[1]!);
    });
  });
}

const isReady = (url: string): Promise<boolean> =>
  fetch(`${url}/readyz`, { signal: AbortSignal.timeout(2000) }).then(
    ({ ok }) => ok,
    () => false,
  );

/**
 * A service on this machine that ends with its owner: at [`stop`], at the end of an `await using`, and when Node ends.
 *
 * [`Server.start`] makes one.
 */
export class Server {
  private readonly atExit = () => {
    this.child.kill("SIGKILL");
    this.clear();
  };

  private constructor(
    /** Its address. */
    readonly url: string,
    private readonly child: ChildProcess,
    private readonly folder: string,
  ) {
    // Node does not wait for it, and so ends it.
    child.unref();
    (child.stdout as unknown as { unref(): void }).unref();
    process.once("exit", this.atExit);
  }

  /** Starts a service on a free port, and waits until it is ready. Fails with [`NoServer`]. */
  static async start(options: ServerOptions = {}): Promise<Server> {
    const program = findProgram(options.program);
    if (!program)
      throw new NoServer(
        "expected the program shapelex as an option, in SHAPELEX_BINARY, on the search path or in the target folder of a checkout, " +
          "got none of them",
      );
    const folder = mkdtempSync(join(tmpdir(), "shapelex-"));
    const log = join(folder, "log");
    const child = started(program, folder, log, options);
    try {
      const server = new Server(await addressOf(child, log), child, folder);
      for (const end = performance.now() + PATIENCE; !(await isReady(server.url)); await sleep(LOOK))
        if (child.exitCode !== null || performance.now() > end)
          throw new NoServer(`expected ${server.url} to be ready within ${PATIENCE / 1000} s: ${ending(log)}`);
      return server;
    } catch (error) {
      child.kill("SIGKILL");
      rmSync(folder, { recursive: true, force: true });
      throw error;
    }
  }

  /** A client of this service. */
  client(options: Omit<ClientOptions, "url"> = {}): Client {
    return createClient({ ...options, url: this.url });
  }

  /** Process of the service. */
  get pid(): number | undefined {
    return this.child.pid;
  }

  /** Ends the service, and removes its store unless that has a folder from you. */
  async stop(): Promise<void> {
    process.removeListener("exit", this.atExit);
    if (this.child.exitCode === null && this.child.signalCode === null) {
      const ended = new Promise((resolve) => this.child.once("exit", resolve));
      this.child.ref();
      this.child.kill("SIGTERM");
      const patience = setTimeout(() => this.child.kill("SIGKILL"), FAREWELL);
      await ended;
      clearTimeout(patience);
    }
    this.clear();
  }

  [Symbol.asyncDispose](): Promise<void> {
    return this.stop();
  }

  private clear(): void {
    if (existsSync(this.folder)) rmSync(this.folder, { recursive: true, force: true });
  }
}
