/** The page with real data, where it is beside the repository: hippocampi, MPEG-7, salamanders, nuclei; and two tenants. */
import assert from "node:assert/strict";
import { existsSync, readdirSync, readFileSync } from "node:fs";
import path from "node:path";
import { after, before, test } from "node:test";
import { ply } from "./files.mjs";
import { accessible, browse, drop, key, open, ROOT, serve, settled, store } from "./service.mjs";

const DATA = path.join(ROOT, "../shared/data");
/** Pictures of data are for looking at, in the folder DATA_SCREENS: `docs/screens` has those that every machine can make. */
const screen = async (page, name, options = {}) => {
  if (process.env.DATA_SCREENS)
    await page.screenshot({ path: path.join(process.env.DATA_SCREENS, `${name}.png`), ...options });
};
const WAITED = { prefer: "wait=60" };
let service, browser;

before(async () => {
  service = await serve();
  browser = await browse();
});

after(async () => {
  await browser?.close();
  await service?.stop();
  service?.remove();
});

/** A test with a folder of data; without it the report says that it was skipped. */
function withData(folder, name, act) {
  const from = path.join(DATA, folder);
  test(name, { skip: existsSync(from) ? false : `${folder} is not here` }, () => act(from));
}

async function visit(page, address, name) {
  await page.goto(service.address + address);
  await settled(page);
  await accessible(page, name);
  assert.deepEqual(page.faults, [], name);
  await screen(page, name);
}

withData(
  "surfaces-hippocampus",
  "hippocampi: surfaces in space, groups with their effect, modes, one against its reconstruction",
  async (from) => {
    const representation = { kind: "surface", topology: "sphere", control_points: [8, 6] };
    const cases = readFileSync(path.join(from, "meshes.csv"), "utf8")
      .trim()
      .split("\n")
      .slice(1, 25)
      .map((line) => line.split(","));
    const fitted = await service.call("POST", "/v1/fit", {
      representation,
      meshes: cases.map(([name]) => ply(readFileSync(path.join(from, "meshes", `${name}.ply`)))),
    });
    const large = [...cases]
      .sort((a, b) => Number(b[3]) - Number(a[3]))
      .slice(0, 12)
      .map(([name]) => name);
    const shapes = fitted.results.flatMap((one, k) =>
      one.control_points
        ? [
            {
              external_id: cases[k][0],
              label: large.includes(cases[k][0]) ? "large" : "small",
              control_points: one.control_points,
            },
          ]
        : [],
    );
    assert.ok(shapes.length >= 20, `${shapes.length} of 24 were fitted`);
    await service.call("POST", "/v1/cohorts", {
      name: "hippocampi",
      length_unit: "mm",
      correspondence: "landmarks",
      representation,
    });
    await service.call("POST", "/v1/cohorts/hippocampi/shapes", { shapes });
    await service.call(
      "POST",
      "/v1/dictionaries",
      {
        name: "hippocampi",
        cohort: "hippocampi",
        transformation: "rigid",
        method: { kind: "functional_pca", components: 5, centre: true },
      },
      WAITED,
    );
    const page = await open(browser, service.address);
    await visit(page, "/app/cohorts/hippocampi", "hippocampi");
    await visit(
      page,
      "/app/cohorts/hippocampi/compare?by=label&transformation=rigid&permutations=200",
      "hippocampi-groups",
    );
    await page
      .locator(".scale")
      .getByText(/inwards \d/)
      .waitFor();
    const linked = page.locator(".stage").first();
    await linked.scrollIntoViewIfNeeded();
    await screen(page, "hippocampi-effect");
    await visit(page, "/app/dictionaries/hippocampi@1/modes?sigma=2", "hippocampi-modes");
    await visit(
      page,
      `/app/assess?dictionary=hippocampi@1&cohort=hippocampi&shape=${shapes[0].external_id}`,
      "hippocampi-assess",
    );
    await page.locator(".scale").getByText(/mm/).first().waitFor();
    await page.context().close();
    const night = await open(browser, service.address, { colorScheme: "dark", locale: "de-DE" });
    await night.goto(
      `${service.address}/app/cohorts/hippocampi/compare?by=label&transformation=rigid&permutations=200`,
    );
    await settled(night);
    await night
      .locator(".scale")
      .getByText(/innen \d/)
      .waitFor();
    await night.locator(".stage").first().scrollIntoViewIfNeeded();
    await screen(night, "hippocampi-effect-dark");
    assert.deepEqual(night.faults, []);
    await night.context().close();
  },
);

withData(
  "curves-mpeg7",
  "MPEG-7: 910 contours by upload, filters by class, a dictionary that tells classes apart",
  async (from) => {
    const lines = readFileSync(path.join(from, "curves.ndjson"), "utf8")
      .trim()
      .split("\n")
      .map((line) => {
        const { id, label, labels, points } = JSON.parse(line);
        return JSON.stringify({ external_id: id, label, labels, points });
      });
    await service.call("POST", "/v1/cohorts", {
      name: "mpeg7",
      correspondence: "cyclic",
      representation: { kind: "closed_curve", dimension: 2, control_points: 32, generator: { name: "trigonometric" } },
    });
    const page = await open(browser, service.address);
    await page.goto(`${service.address}/app/cohorts/mpeg7/upload`);
    await settled(page);
    await store(page, {
      name: "mpeg7.ndjson",
      mimeType: "application/x-ndjson",
      buffer: Buffer.from(lines.join("\n")),
    });
    await page.getByText(`${lines.length} added`).waitFor({ timeout: 120_000 });
    await visit(page, "/app/cohorts/mpeg7", "mpeg7");
    await page.getByText(`All ${lines.length} shapes`).waitFor();
    await visit(page, "/app/cohorts/mpeg7?label=heart&label=bone&label=key", "mpeg7-three");
    await page.getByText(`42 of ${lines.length} shapes`).waitFor();
    await service.call(
      "POST",
      "/v1/dictionaries",
      {
        name: "mpeg7-three",
        cohort: "mpeg7",
        filter: { label: ["heart", "bone", "key"] },
        transformation: "similarity",
        method: { kind: "functional_pca", components: 6, centre: true },
        classifier: { kind: "discriminant", attribute: "label" },
      },
      WAITED,
    );
    await visit(page, "/app/dictionaries/mpeg7-three@1/scores?morphospace=yes&colour=label", "mpeg7-scores");
    await visit(page, "/app/dictionaries/mpeg7-three@1", "mpeg7-report");
    await page.context().close();
  },
);

withData("landmarks-plethodon", "salamanders: a table of landmarks by upload, two species compared", async (from) => {
  await service.call("POST", "/v1/cohorts", {
    name: "plethodon",
    correspondence: "landmarks",
    representation: { kind: "landmarks", dimension: 2, points: 12 },
  });
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts/plethodon/upload`);
  await settled(page);
  await store(page, path.join(from, "landmarks.csv"));
  await page.getByText("40 added").waitFor();
  await visit(page, "/app/cohorts/plethodon", "plethodon");
  await visit(page, "/app/cohorts/plethodon/compare?by=labels.species", "plethodon-groups");
  await page.getByText("Shapes differ by species").waitFor();
  await page.getByText("What chance alone would give: Jord – Teyah").waitFor();
  await visit(page, "/app/cohorts/plethodon/regression", "plethodon-regression");
  await page.context().close();
});

withData("images-nuclei", "nuclei: a micrograph and its mask are assessed", async (from) => {
  const page = await open(browser, service.address);
  await service.call(
    "POST",
    "/v1/dictionaries",
    {
      name: "cells",
      cohort: "example-cells",
      transformation: "similarity",
      method: { kind: "functional_pca", components: 8, centre: true },
    },
    WAITED,
  );
  await page.goto(`${service.address}/app/assess?dictionary=cells@1`);
  await settled(page);
  const name = readdirSync(path.join(from, "labels")).sort()[0];
  await page.locator("input[type=file]").setInputFiles(path.join(from, "labels", name));
  await page.getByRole("heading", { name: "Where it deviates" }).waitFor();
  assert.ok(await page.getByRole("radio", { name: /^mask/ }).isChecked());
  await settled(page);
  await screen(page, "nuclei-mask", { fullPage: true });
  await page
    .locator("input[type=file]")
    .setInputFiles(path.join(from, "images", readdirSync(path.join(from, "images")).sort()[0]));
  await page.getByRole("img", { name: /with the contour that was found/ }).waitFor();
  assert.ok(await page.getByRole("radio", { name: /^picture/ }).isChecked());
  await settled(page);
  await screen(page, "nuclei-picture", { fullPage: true });
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

withData("volumes-hippocampus-mri", "a magnetic resonance volume is looked at in three orientations", async (from) => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/segment`);
  await settled(page);
  await page
    .locator("input[type=file]")
    .setInputFiles(path.join(from, "images", readdirSync(path.join(from, "images")).sort()[0]));
  for (const name of ["Axial", "Coronal", "Sagittal"]) {
    await page.getByLabel("Orientation").selectOption(name);
    await settled(page);
    await page.waitForTimeout(200);
    await screen(page, `mri-${name.toLowerCase()}`);
  }
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

/** A cohort and its page of uploads. */
async function uploads(name, representation) {
  await service.call("POST", "/v1/cohorts", {
    name,
    correspondence: representation.kind === "closed_curve" ? "arc_length" : "landmarks",
    representation,
  });
  const page = await open(browser, service.address, {}, ["422"]);
  await page.goto(`${service.address}/app/cohorts/${name}/upload`);
  await settled(page);
  return page;
}

const CONTOURS = { kind: "closed_curve", dimension: 2, control_points: 16, generator: { name: "cubic" } };

withData("formats-qupath-geojson", "annotations of QuPath, and their first half", async (from) => {
  const page = await uploads("qupath", CONTOURS);
  const file = path.join(from, "TD_01_verysmall_mIF.geojson"),
    bytes = readFileSync(file);
  let card = await drop(page, file);
  // Six polygons; three points, which are landmarks.
  for (const text of ["GeoJSON", "6 · in the plane", "3 · in the plane", "class_1 (3), class_2 (3)"])
    await card.getByText(text).first().waitFor();
  await screen(page, "file-qupath");
  await card.getByRole("button", { name: "Store", exact: true }).click();
  await card.getByText("6 added, 3 left out").waitFor();
  card = await drop(page, {
    name: "half.geojson",
    mimeType: "application/geo+json",
    buffer: bytes.subarray(0, bytes.length / 2),
  });
  await card.getByText("Cannot be read").waitFor();
  await card
    .locator("code", { hasText: /line \d+|byte \d+/ })
    .first()
    .waitFor();
  await screen(page, "file-broken");
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

withData("formats-tps", "landmarks of tpsDig", async (from) => {
  const page = await uploads("triangles", { kind: "landmarks", dimension: 2, points: 3 });
  const file = path.join(from, "landmarks_triangle.tps"),
    all = readFileSync(file, "utf8").match(/^LM=3/gm).length;
  const card = await store(page, file);
  await card.getByText(`${all} added`).waitFor();
  assert.equal((await service.call("GET", "/v1/cohorts/triangles")).shape_count, all);
  await page.context().close();
});

withData("formats-meshes", "a mesh becomes a surface", async (from) => {
  const page = await uploads("meshes", { kind: "surface", topology: "sphere", control_points: [8, 6] });
  const card = await drop(page, path.join(from, "ico4.obj"));
  await card.getByText(/1 · in space · 642 points · 1,280 faces/).waitFor();
  await screen(page, "file-mesh");
  await card.getByRole("button", { name: "Store", exact: true }).click();
  await card.getByText("1 added").waitFor();
  await page.context().close();
});

withData("formats-dicom-rtstruct", "contours of a structure set, in the plane of their slices", async (from) => {
  const page = await uploads("regions", CONTOURS);
  const card = await drop(page, path.join(from, "mim_phantom_rtstruct.dcm"));
  await card.getByText("12 · in space").waitFor();
  await card.getByText("DICOM RT Structure Set").first().waitFor();
  await screen(page, "file-rtstruct", { fullPage: true });
  await card.getByLabel(/^Plane/).selectOption("xy");
  await card.getByRole("button", { name: "Store", exact: true }).click();
  await card.getByText("12 added").waitFor();
  await screen(page, "file-rtstruct-stored", { fullPage: true });
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("two tenants: one name, two cohorts; what one adds, the other does not hear of", async () => {
  const own = await serve();
  const keys = [];
  for (const tenant of ["north", "south"]) keys.push(await key(own.folder, "--role", "writer", "--tenant", tenant));
  await new Promise((resolve) => setTimeout(resolve, 2500));
  const call = (secret, method, route, body) => own.call(method, route, body, { authorization: `Bearer ${secret}` });
  const triangle = (id, x) => ({
    external_id: id,
    points: [
      [0, 0],
      [x, 0],
      [1, 3],
    ],
  });
  for (const [at, secret] of keys.entries()) {
    await call(secret, "POST", "/v1/cohorts", {
      name: "shared-name",
      correspondence: "landmarks",
      representation: { kind: "landmarks", dimension: 2, points: 3 },
    });
    await call(secret, "POST", "/v1/cohorts/shared-name/shapes", {
      shapes: Array.from({ length: 3 + at }, (_, k) => triangle(`${at ? "south" : "north"}${k}`, 4 + k)),
    });
  }
  const pages = [];
  for (const secret of keys) {
    const page = await open(browser, own.address, {}, ["401", "404"]);
    await page.goto(`${own.address}/app/cohorts/shared-name`);
    await page.getByLabel("Key", { exact: true }).fill(secret);
    await page.getByRole("button", { name: "Continue" }).click();
    pages.push(page);
  }
  await pages[0].getByText("All 3 shapes").waitFor();
  await pages[1].getByText("All 4 shapes").waitFor();
  await call(keys[1], "POST", "/v1/cohorts/shared-name/shapes", { shapes: [triangle("late", 9)] });
  await pages[1].getByText("All 5 shapes").waitFor();
  await pages[0].waitForTimeout(500);
  await pages[0].getByText("All 3 shapes").waitFor();
  await pages[0].goto(`${own.address}/app/cohorts/shared-name/shapes/south0`);
  await pages[0]
    .getByText(/not found/)
    .first()
    .waitFor();
  for (const page of pages) {
    assert.deepEqual(page.faults, []);
    await page.context().close();
  }
  await own.stop();
  own.remove();
});
