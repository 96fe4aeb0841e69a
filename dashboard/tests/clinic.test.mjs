/** From files to a figure and a report, as a clinician goes: with real data where it is beside the repository. */
import assert from "node:assert/strict";
import { existsSync, mkdirSync, mkdtempSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { after, before, test } from "node:test";
import { nifti } from "./files.mjs";
import { accessible, browse, key, open, ROOT, screen, serve, settled } from "./service.mjs";

const DATA = path.join(ROOT, "../shared/data");
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

const file = (name, text) => ({ name, mimeType: "text/plain", buffer: Buffer.from(text) });
const shapesOf = (cohort) =>
  service.call("GET", `/v1/cohorts/${cohort}/shapes?limit=1000&fields=external_id,label,labels`);
const saved = async (page, name) => {
  const [download] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name }).click()]);
  return readFileSync(await download.path());
};

/** Contours of two kinds, of which some begin elsewhere. */
const contour = (k, turn = 0) =>
  Array.from({ length: 40 }, (_, i) => {
    const u = (2 * Math.PI * (i + turn)) / 40;
    const r = 1 + 0.25 * Math.cos(2 * u) + (k % 2 ? 0.2 : -0.1) * Math.cos(3 * u) + 0.03 * Math.sin(k + 5 * u);
    return [r * Math.cos(u) * (2 + k / 9), r * Math.sin(u) * (2 + k / 9)];
  });
const table = (from, to) =>
  `id,x,y,closed\n${Array.from({ length: to - from }, (_, k) =>
    contour(from + k, 7 * k)
      .map((p) => `cell${from + k},${p.join(",")},true`)
      .join("\n"),
  ).join("\n")}\n`;

test("files dropped on Cohorts become a proposed cohort, which is seen before it is created and stored", async () => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts`);
  await settled(page);
  await accessible(page, "cohorts with a zone");
  await page
    .locator("input[type=file]")
    .setInputFiles([file("plate one.csv", table(0, 8)), file("b.csv", table(8, 12))]);
  await page.getByText("12 closed contours would be stored as: Closed contour").waitFor();
  await page.getByRole("img", { name: "cell0" }).waitFor();
  assert.equal(await page.locator(".thumb svg").count(), 10, "six of the first file, four of the second");
  await page.getByText(/Proposed control points: \d+\. They leave [\d.]+\s% of the size/).waitFor();
  await settled(page);
  await accessible(page, "proposal");
  await screen(page, "cohort-proposed", { fullPage: true });
  // Fewer control points where more error is allowed.
  const size = () => page.getByLabel("Control points").inputValue();
  const before = Number(await size());
  await page.getByLabel("Error that may be left").selectOption("0.05");
  await page.waitForFunction(
    (most) => Number([...document.querySelectorAll("input")].find((one) => /^\d+$/.test(one.value))?.value) < most,
    before,
  );
  await page.getByLabel("Label of all shapes").fill("untreated");
  await page.getByRole("button", { name: "Create and store" }).click();
  await page.getByText("12 added").waitFor();
  await page.getByText(/^Kept: /).waitFor();
  await accessible(page, "stored");
  await page.getByRole("link", { name: "Look at the cohort" }).click();
  await page.getByText("All 12 shapes").waitFor();
  const { items } = await shapesOf("plate-one");
  assert.ok(items.every((one) => one.label === "untreated" && one.labels.file));
  const { correspondence } = await service.call("GET", "/v1/cohorts/plate-one");
  assert.equal(correspondence, "cyclic", "the contours begin at different places");
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("a folder becomes a proposed cohort: its folders as well, without hidden files, by the numbers in names", async () => {
  const folder = mkdtempSync(path.join(tmpdir(), "shapelex-folder-"));
  mkdirSync(path.join(folder, "more"));
  for (const [name, from, to] of [
    ["plate 10.csv", 20, 23],
    ["plate 2.csv", 23, 25],
    ["more/plate 1.csv", 25, 26],
  ])
    writeFileSync(path.join(folder, name), table(from, to));
  writeFileSync(path.join(folder, ".DS_Store"), "of the system");
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts`);
  await settled(page);
  const [chooser] = await Promise.all([
    page.waitForEvent("filechooser"),
    page.getByRole("button", { name: "Choose a folder" }).click(),
  ]);
  await chooser.setFiles(folder);
  await page.getByText("6 closed contours would be stored as: Closed contour").waitFor();
  await page.getByText(/They leave [\d.]+\s% of the size/).waitFor();
  await page.getByLabel("Name of the cohort").fill("of-a-folder");
  await page.getByRole("button", { name: "Create and store" }).click();
  await page.getByText("6 added").waitFor();
  const { items } = await shapesOf("of-a-folder");
  assert.deepEqual(
    items.map((one) => [one.external_id, one.labels.file]),
    [["cell25", "plate 1"], ...["cell23", "cell24"].map((id) => [id, "plate 2"])].concat(
      ["cell20", "cell21", "cell22"].map((id) => [id, "plate 10"]),
    ),
  );
  assert.deepEqual(page.faults, []);
  await page.context().close();
  rmSync(folder, { recursive: true });
});

test("groups by hand: of a selection, a filter and a table of attributes, each undone; names are searched", async () => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts/plate-one/table`);
  await settled(page);
  for (const name of ["cell1", "cell3"])
    await page.getByRole("checkbox", { name: `Choose ${name}`, exact: true }).check();
  await page.getByText("2 chosen").waitFor();
  await page.getByLabel("Attribute", { exact: true }).fill("dose");
  await page.getByLabel("Value", { exact: true }).fill("2.5");
  await page.getByRole("button", { name: "Apply" }).click();
  await page.getByText("2 shapes were changed.").waitFor();
  await settled(page);
  await accessible(page, "labelled table");
  const dose = async () =>
    (await shapesOf("plate-one")).items.filter((one) => one.labels.dose === 2.5).map((one) => one.external_id);
  assert.deepEqual(await dose(), ["cell1", "cell3"]);
  await page.getByRole("button", { name: "Undo" }).click();
  await page.getByText("Undone.").waitFor();
  assert.deepEqual(await dose(), []);
  // All that pass a filter, on the contact sheet.
  await page.goto(`${service.address}/app/cohorts/plate-one?labels.file=b&order=-external_id`);
  await page.getByText("4 of 12 shapes").waitFor();
  await page.getByText("Label these shapes").click();
  await page.getByLabel("Value", { exact: true }).fill("treated");
  await page.getByRole("button", { name: "Apply" }).click();
  await page.getByText("4 shapes were changed.").waitFor();
  const labels = async () => (await shapesOf("plate-one")).items.filter((one) => one.label === "treated").length;
  assert.equal(await labels(), 4);
  // A table of attributes by id.
  await page.goto(`${service.address}/app/cohorts/plate-one/upload`);
  await settled(page);
  await page
    .locator("input[type=file]")
    .setInputFiles(file("patients.csv", "id;subject;age\ncell0;p1;41,5\ncell2;p2;52\nnobody;p3;60\n"));
  await page.getByText("2 shapes would be changed, 0 are so already.").waitFor();
  await page.getByText("1 row names no shape").waitFor();
  await accessible(page, "attributes");
  await page.getByRole("button", { name: "Store attributes" }).click();
  await page.getByText("2 shapes were changed.").waitFor();
  const ages = async () => (await shapesOf("plate-one")).items.map((one) => one.labels.age).filter(Boolean);
  assert.deepEqual(await ages(), [41.5, 52]);
  await page.getByRole("button", { name: "Undo" }).click();
  await page.getByText("Undone.").waitFor();
  assert.deepEqual(await ages(), []);
  // Names.
  await page.goto(`${service.address}/app/cohorts/plate-one`);
  await page.getByRole("searchbox", { name: "Find a shape by name" }).fill("LL1");
  await page.getByText("3 found").waitFor();
  await accessible(page, "found");
  await page.getByRole("link", { name: "Show these 3" }).click();
  await page.getByText("3 of 12 shapes").waitFor();
  await page.getByRole("searchbox", { name: "Find a shape by name" }).fill("cell7");
  await page.getByText("1 found").waitFor();
  await page.keyboard.press("Enter");
  await page.waitForURL("**/shapes/cell7");
  const next = page.getByRole("link", { name: /^(Next|Previous): / }).first();
  const other = (await next.getAttribute("aria-label")).split(": ")[1];
  await next.click();
  await page.waitForURL(`**/shapes/${other}`);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("labels of all files at once; a photograph is refused with a way on; whole numbers have a bar each", async () => {
  const page = await open(browser, service.address, {}, ["422"]);
  await page.goto(`${service.address}/app/cohorts/plate-one/upload`);
  await settled(page);
  await page.getByText("For all of these files: label, subject, attributes").click();
  await page.getByLabel("Label of all shapes").fill("late");
  await page.getByLabel("Label of all shapes").press("Tab");
  await page.getByLabel("Attribute", { exact: true }).first().fill("site");
  await page.getByLabel("Its value").first().fill("zrh");
  await page.getByLabel("Its value").first().press("Tab");
  await page.locator("input[type=file]").setInputFiles([file("c.csv", table(20, 22)), file("d.csv", table(22, 23))]);
  await page.getByRole("button", { name: "Store all 2 files" }).click();
  await page.getByText("1 added").waitFor();
  const { items } = await shapesOf("plate-one");
  assert.deepEqual(
    items.filter((one) => one.labels.site === "zrh").map((one) => [one.external_id, one.label, one.labels.file]),
    [
      ["cell20", "late", "c"],
      ["cell21", "late", "c"],
      ["cell22", "late", "d"],
    ],
  );
  await page.locator("input[type=file]").setInputFiles({
    name: "photo.png",
    mimeType: "image/png",
    buffer: await photograph(page),
  });
  await page.getByRole("button", { name: "Find objects in it" }).click();
  await page.getByText("160 × 120 pixels.").waitFor();
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

/** A noisy picture with three bright objects, as PNG. */
const OBJECTS = [
  [40, 35, 20, 14],
  [110, 40, 16, 22],
  [75, 92, 26, 12],
];
function photograph(page) {
  return page
    .evaluate((objects) => {
      const canvas = new OffscreenCanvas(160, 120),
        context = canvas.getContext("2d");
      const image = context.createImageData(160, 120);
      for (let y = 0; y < 120; y++)
        for (let x = 0; x < 160; x++) {
          const inside = objects.some(([cx, cy, a, b]) => ((x - cx) / a) ** 2 + ((y - cy) / b) ** 2 < 1);
          const noise = (((x * 7 + y * 13) * 37 + x * y) % 23) - 11;
          const value = (inside ? 70 : 22) + noise / 2;
          image.data.set([value, value, value, 255], 4 * (y * 160 + x));
        }
      context.putImageData(image, 0, 0);
      return canvas
        .convertToBlob()
        .then((blob) => blob.arrayBuffer())
        .then((buffer) => [...new Uint8Array(buffer)]);
    }, OBJECTS)
    .then((bytes) => Buffer.from(bytes));
}

test("all objects of a picture at once: brightness, zoom, a list with undo, stored in a cohort", async () => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/segment`);
  await settled(page);
  await page
    .locator("input[type=file]")
    .setInputFiles({ name: "cells.png", mimeType: "image/png", buffer: await photograph(page) });
  await page.getByText("160 × 120 pixels.").waitFor();
  await page.getByRole("button", { name: "Propose all objects" }).click();
  await page.getByRole("button", { name: "Object 3", exact: true }).waitFor();
  await page.getByRole("button", { name: "Find the contour" }).click();
  await page.locator("path.contour").nth(2).waitFor();
  assert.equal(await page.locator("path.contour").count(), 3);
  await settled(page);
  const boxes = await page.evaluate(() =>
    [...document.querySelectorAll("path.contour")].map((one) => {
      const { x, y, width, height } = one.getBBox();
      return [x + width / 2, y + height / 2, width / 2, height / 2];
    }),
  );
  for (const wanted of OBJECTS) {
    const near = boxes.find((one) => Math.hypot(one[0] - wanted[0], one[1] - wanted[1]) < 4);
    assert.ok(near, `an object at ${wanted}: ${JSON.stringify(boxes)}`);
    [2, 3].forEach((side) => assert.ok(Math.abs(near[side] - wanted[side]) < 3, `${near} for ${wanted}`));
  }
  // No keys of the API are on the page.
  assert.equal(await page.getByText("spacing", { exact: true }).count(), 0);
  await page.getByText("Uneven points").waitFor();
  await accessible(page, "objects");
  await screen(page, "segment-objects");
  // Zoom and brightness.
  const svg = page.locator("figure svg[role=group]");
  const whole = await svg.getAttribute("viewBox");
  await page.getByRole("button", { name: "Closer" }).click();
  assert.notEqual(await svg.getAttribute("viewBox"), whole);
  await svg.focus();
  const zoomed = await svg.getAttribute("viewBox");
  await page.keyboard.press("ArrowRight");
  assert.notEqual(await svg.getAttribute("viewBox"), zoomed);
  await page.getByRole("button", { name: "Whole picture" }).click();
  assert.equal(await svg.getAttribute("viewBox"), whole);
  const picture = () => page.locator("figure svg[role=group] image").getAttribute("href");
  const dark = await picture();
  await page.getByRole("slider", { name: "Brightness" }).focus();
  for (let k = 0; k < 5; k++) await page.keyboard.press("ArrowRight");
  await page.waitForFunction(
    (old) => document.querySelector("figure svg[role=group] image").getAttribute("href") !== old,
    dark,
  );
  // One is removed and brought back.
  await page.getByRole("button", { name: "Remove object 2" }).click();
  assert.equal(await page.locator("path.contour").count(), 2);
  await page.getByRole("button", { name: "Undo" }).click();
  assert.equal(await page.locator("path.contour").count(), 3);
  await page.getByRole("button", { name: "Store in a cohort" }).click();
  const dialog = page.getByRole("dialog");
  await dialog.getByRole("combobox").selectOption("+");
  await dialog.getByLabel("Name of the cohort").fill("from-picture");
  await dialog.getByLabel("Label of all shapes").fill("nucleus");
  await accessible(page, "store objects");
  await dialog.getByRole("button", { name: "Store", exact: true }).click();
  await page.getByText("3 stored in from-picture.").waitFor();
  const { items } = await shapesOf("from-picture");
  assert.deepEqual(
    items.map((one) => [one.external_id, one.label, one.labels.file]),
    [1, 2, 3].map((k) => [`cells/${k}`, "nucleus", "cells"]),
  );
  await page.locator(".toast").getByRole("button", { name: "Undo" }).click();
  await page.getByText("Undone.").waitFor();
  assert.equal((await service.call("GET", "/v1/cohorts/from-picture")).shape_count, 0);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("a box beside every object: the contour that is lost is red", async () => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/segment`);
  await settled(page);
  await page
    .locator("input[type=file]")
    .setInputFiles({ name: "cells.png", mimeType: "image/png", buffer: await photograph(page) });
  await page.getByText("160 × 120 pixels.").waitFor();
  await page.route("**/v1/segment", async (route) => {
    const response = await route.fetch();
    const answer = await response.json();
    answer.results[0].stop = "left_object";
    await route.fulfill({ response, json: answer });
  });
  await page.getByRole("button", { name: "Find the contour" }).click();
  await page.locator("path.contour.lost").waitFor();
  await page.locator(".note.bad", { hasText: "The contour left its object" }).waitFor();
  await page.locator(".tag.bad", { hasText: "lost" }).waitFor();
  assert.equal(await page.getByRole("button", { name: "Store in a cohort" }).count(), 0, "what is lost is not stored");
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("a volume is followed through its slices, and its contours are seen in the other planes", async () => {
  const page = await open(browser, service.address, {}, ["422"]);
  await page.goto(`${service.address}/app/segment`);
  await settled(page);
  const inside = (i, j, k) => ((i - 22) / 12) ** 2 + ((j - 20) / 9) ** 2 + ((k - 11) / 6) ** 2 < 1;
  await page.locator("input[type=file]").setInputFiles({
    name: "body.nii",
    mimeType: "application/octet-stream",
    buffer: nifti([44, 40, 24], [1, 1, 2], (i, j, k) => (inside(i, j, k) ? 200 : 40)),
  });
  await page.getByText("13 of 24").waitFor();
  await page.getByRole("button", { name: "Find the contour" }).click();
  await page.locator("path.contour").waitFor();
  await page.getByRole("button", { name: "Follow to lower slices" }).click();
  await page.getByText(/Contours on [4-9] slices\./).waitFor();
  await settled(page);
  const lines = await page.locator("svg.cut").first().locator("line").count();
  assert.ok(lines >= 4, `${lines} slices are cut`);
  const lengths = await page
    .locator("svg.cut")
    .first()
    .locator("line")
    .evaluateAll((all) => all.map((one) => Math.abs(one.x2.baseVal.value - one.x1.baseVal.value)));
  assert.ok(Math.max(...lengths) > 18 && Math.max(...lengths) < 28, `${lengths} mm`);
  await accessible(page, "planes");
  await screen(page, "segment-planes");
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("pictures for papers: groups with dashes, a cursor that links, hulls, every plot as SVG and PNG", async () => {
  await service.call(
    "POST",
    "/v1/dictionaries",
    {
      name: "figures",
      cohort: "example-cells",
      transformation: "similarity",
      method: { kind: "functional_pca", components: 6, centre: true },
    },
    WAITED,
  );
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts/example-cells/compare?by=labels.treatment&permutations=200`);
  await page.locator(".drawing svg.shape").waitFor();
  await settled(page);
  const strokes = await page
    .locator(".drawing .keys path")
    .evaluateAll((all) => all.map((one) => [one.getAttribute("stroke"), one.getAttribute("stroke-dasharray") ?? ""]));
  assert.deepEqual(
    strokes.map(([colour]) => colour),
    ["#0072b2", "#d55e00", "#009e73"],
    "the colours of the scatter",
  );
  assert.equal(new Set(strokes.map(([, dash]) => dash)).size, 3, "told apart without colours");
  // The pointer over the plot marks the place in the drawing.
  const plot = page.locator("figure", { hasText: "Place along the contour" }).locator(".u-over");
  await page.locator("figure", { hasText: "at most 0.05" }).last().scrollIntoViewIfNeeded();
  const over = page.locator(".u-over").first();
  const frame = await over.boundingBox();
  await page.mouse.move(frame.x + 0.4 * frame.width, frame.y + 0.5 * frame.height);
  await page.mouse.move(frame.x + 0.5 * frame.width, frame.y + 0.5 * frame.height);
  await page.locator(".drawing circle.cursor").waitFor();
  assert.ok((await plot.count()) >= 0);
  const drawing = (await saved(page, "Download example-cells-groups SVG")).toString();
  for (const text of ["<svg", 'stroke="#d55e00"', "stroke-dasharray", "control"])
    assert.ok(drawing.includes(text), text);
  assert.equal((await saved(page, "Download example-cells-groups PNG")).subarray(1, 4).toString(), "PNG");
  assert.match((await saved(page, "Download example-cells-p SVG")).toString(), /Place along the contour/);
  await page.goto(
    `${service.address}/app/dictionaries/figures@1/scores?morphospace=yes&colour=labels.treatment&around=ellipse`,
  );
  await page.locator("svg.backdrop path[stroke='#d55e00']").waitFor();
  await settled(page);
  // The first range holds the ellipses, in the file too.
  const cut = await page.evaluate(() => {
    const frame = document.querySelector(".u-over").getBoundingClientRect();
    return [...document.querySelectorAll("svg.backdrop path[fill-opacity]")]
      .map((one) => one.getBoundingClientRect())
      .filter(
        (box) => box.left < frame.left || box.right > frame.right || box.top < frame.top || box.bottom > frame.bottom,
      ).length;
  });
  assert.equal(cut, 0, "no ellipse is cut off");
  await accessible(page, "ellipses");
  await screen(page, "scores-ellipses");
  const scatter = (await saved(page, "Download figures-scores SVG")).toString();
  assert.equal(scatter.match(/<circle/g).length, 120, "every shape is in the file");
  assert.equal(scatter.match(/fill-opacity="0.07"/g).length, 3, "an ellipse for each group");
  assert.equal(scatter.match(/stroke="#9a9a9a"/g).length, 25, "shapes in the plane");
  await page.getByLabel("Around each group").selectOption("hull");
  await page.waitForURL(/around=hull/);
  await page.goto(`${service.address}/app/dictionaries/figures@1/modes?sigma=2`);
  await settled(page);
  assert.match((await saved(page, "Download figures-shape SVG")).toString(), /^<svg/);
  await page.goto(`${service.address}/app/cohorts/example-cells/regression`);
  await settled(page);
  await page.locator(".chart .u-over, .chart canvas").first().waitFor();
  const regression = (await saved(page, "Download example-cells-regression-scores SVG")).toString();
  assert.ok(regression.includes("Line of least squares"));
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

/** Whether all ellipses of a drawing lie within its frame. */
async function within(drawing) {
  const [all, cut] = await drawing.evaluate((svg) => {
    const frame = svg.getBoundingClientRect(),
      ellipses = [...svg.querySelectorAll("ellipse")];
    const outside = ellipses.filter((one) => {
      const { a, b, c, d, e, f } = one.getScreenCTM();
      // The boxes that the browser gives are those of turned boxes, which are larger.
      const [w, h] = [
        Math.hypot(a * one.rx.baseVal.value, c * one.ry.baseVal.value),
        Math.hypot(b * one.rx.baseVal.value, d * one.ry.baseVal.value),
      ];
      return e - w < frame.left - 1 || e + w > frame.right + 1 || f - h < frame.top - 1 || f + h > frame.bottom + 1;
    });
    return [ellipses.length, outside.length];
  });
  assert.ok(all > 0, "a band is drawn");
  assert.equal(cut, 0, `${cut} of ${all} ellipses are cut off`);
}

test("a report is printed with its colours, the file and a remark; a hidden part is completed", async () => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/assess?dictionary=figures@1`);
  await settled(page);
  const { items } = await service.call("GET", "/v1/cohorts/example-cells/shapes?limit=3");
  await page.locator("input[type=file]").setInputFiles({
    name: "patient-42.json",
    mimeType: "application/json",
    buffer: Buffer.from(JSON.stringify({ control_points: items[2].control_points })),
  });
  await page.getByText("File: patient-42.json").waitFor();
  await page.getByLabel(/^Remark/).fill("left knee, second visit");
  await settled(page);
  await page.emulateMedia({ media: "print" });
  assert.ok(await page.getByText("left knee, second visit").isVisible());
  assert.ok(!(await page.getByText("If a part is hidden or broken").isVisible()));
  const colour = await page.evaluate(() => getComputedStyle(document.querySelector("article")).printColorAdjust);
  assert.equal(colour, "exact");
  const pdf = (await page.pdf({ preferCSSPageSize: true })).toString("latin1");
  assert.equal(pdf.match(/\/Type\s*\/Page\b/g)?.length, 1, "pages of the report");
  await page.emulateMedia({ media: "screen" });
  await page.getByRole("button", { name: "Mark a part" }).click();
  await page.getByRole("slider", { name: "to", exact: true }).focus();
  for (let k = 0; k < 40; k++) await page.keyboard.press("ArrowRight");
  await page.getByRole("button", { name: "Complete it" }).click();
  await page.getByText(/The hidden part lies within [\d.,]+.* of the drawn one at 95\s%/).waitFor();
  await accessible(page, "completed");
  await within(page.locator("figure", { hasText: "completed by the model" }).locator("svg.shape"));
  await page.locator("section", { hasText: "If a part is hidden" }).last().scrollIntoViewIfNeeded();
  await screen(page, "assess-completed");
  // A wide band too: almost nothing is seen, and nothing is cut off.
  await page.getByRole("slider", { name: "to", exact: true }).focus();
  for (let k = 0; k < 106; k++) await page.keyboard.press("ArrowRight");
  const answered = page.waitForResponse(/\/complete/);
  await page.getByRole("button", { name: "Complete it" }).click();
  await answered;
  await settled(page);
  await within(page.locator("figure", { hasText: "completed by the model" }).locator("svg.shape"));
  await screen(page, "assess-completed-wide");
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("a mean that shapes unlike the majority do not spoil: which count less, and where", async () => {
  const page = await open(browser, service.address);
  await service.call("POST", "/v1/cohorts", {
    name: "broken",
    correspondence: "arc_length",
    representation: { kind: "closed_curve", dimension: 2, control_points: 24, generator: { name: "cubic" } },
  });
  const shapes = Array.from({ length: 12 }, (_, k) => ({ external_id: `s${k}`, points: contour(2 * k) }));
  shapes[5].points = shapes[5].points.map(([x, y], i) => (i > 4 && i < 12 ? [3 * x, 3 * y] : [x, y]));
  await service.call("POST", "/v1/cohorts/broken/shapes", { shapes });
  await page.goto(`${service.address}/app/cohorts/broken/mean`);
  await settled(page);
  await page.getByLabel("Shapes unlike the majority count less").check();
  await page.getByRole("heading", { name: "Which shapes count less" }).waitFor();
  await page.getByRole("img", { name: "s5, red where it is unlike the others" }).waitFor();
  await page.getByText(/(^|, )1 (is left out|counts less)/).waitFor();
  await settled(page);
  await accessible(page, "robust");
  await screen(page, "mean-robust", { fullPage: true });
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("columns of models: unusual shapes as a column, a filter and an order", async () => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts/example-cells/table`);
  await settled(page);
  await page.getByText("Columns", { exact: true }).click();
  await page.getByRole("checkbox", { name: "Unusual (figures@1)" }).check();
  await page.getByRole("checkbox", { name: "Relative error (figures@1)" }).check();
  await page.getByRole("button", { name: "Relative error (figures@1)" }).click();
  await page.getByRole("button", { name: "Relative error (figures@1)" }).click();
  await page.waitForURL(/order=-figures/);
  await settled(page);
  const errors = await page
    .locator("tbody tr td:last-child")
    .evaluateAll((cells) => cells.map((cell) => Number(cell.textContent)));
  assert.equal(errors.length, 50);
  assert.ok(
    errors.every((value, k) => k === 0 || value <= errors[k - 1]),
    errors.join(),
  );
  await accessible(page, "columns");
  await page.getByLabel("Only unusual shapes").check();
  await settled(page);
  const rows = await page.locator("tbody tr").count();
  assert.ok(rows < 20, `${rows} unusual of 120`);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("a linear model: terms by choice, its table, predicted shapes", async () => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts/example-cells/model?permutations=199`);
  await page.getByRole("heading", { name: "Table of the terms" }).waitFor();
  await settled(page);
  const rows = () => page.locator("tbody tr th").allTextContents();
  const before = await rows();
  assert.equal(before.length, 2, before.join());
  await page.getByLabel("and on their combinations").check();
  await page.waitForFunction(() => document.querySelectorAll("tbody tr").length === 3);
  await settled(page);
  const answer = await service.call("POST", "/v1/models", {
    cohort: "example-cells",
    formula: new URL(page.url()).searchParams.get("formula"),
    permutations: 199,
    missing: "skip",
  });
  const shown = await page.locator("tbody tr").nth(2).locator("td").allTextContents();
  assert.equal(Number(shown[0]), answer.terms[2].df);
  assert.ok(Math.abs(Number(shown[4]) - answer.terms[2].f) < 0.01, `${shown[4]} for ${answer.terms[2].f}`);
  await page.locator(".drawing svg.shape path").first().waitFor();
  await accessible(page, "linear model");
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

/** A cohort of landmarks in the plane: two factors, of which one combination has no shape, and a number. */
async function gap() {
  const shapes = Array.from({ length: 30 }, (_, k) => {
    const [a, b] = [k % 2 ? "x" : "y", k % 3 ? "u" : k % 2 ? "v" : "u"];
    const age = 20 + ((7 * k) % 31);
    return {
      external_id: `g${k}`,
      labels: { a, b, age },
      points: [
        [0, 0],
        [4 + 0.3 * Math.sin(k) + (a === "x" ? 0.5 : 0), 0.2],
        [4, 3 + 0.4 * Math.cos(k) + 0.04 * age],
        [2, 4 + 0.2 * Math.sin(3 * k) + (b === "v" ? 0.6 : 0)],
        [0.3 * Math.cos(2 * k), 3],
      ],
    };
  });
  await service.call("POST", "/v1/cohorts", {
    name: "gap",
    length_unit: "mm",
    correspondence: "landmarks",
    representation: { kind: "landmarks", dimension: 2, points: 5 },
  });
  await service.call("POST", "/v1/cohorts/gap/shapes", { shapes });
}

test("a kept model: sliders and choices predict, one request at a time; bands; what cannot be said is told", async () => {
  await gap();
  const page = await open(browser, service.address, {}, ["422"]);
  const model = `${service.address}/app/cohorts/gap/model?permutations=199&formula=`;
  await page.goto(`${model}${encodeURIComponent("~ a + b + age")}&pairs=labels.a`);
  await page.getByRole("heading", { name: "Pairs of a" }).waitFor();
  assert.equal(await page.locator("table.matrix td").count(), 1 + 4, "two groups beside each other");
  await page.getByText("permutations of what the model ~ b + age leaves").waitFor();
  await page.goto(model + encodeURIComponent("~ a * b + age"));
  await page.getByRole("button", { name: "Keep this model" }).click();
  const slider = page.getByLabel("age", { exact: false }).and(page.locator("input[type=range]"));
  await slider.waitFor();
  await settled(page);
  const job = new URL(page.url()).searchParams.get("kept");
  assert.ok(job, "the kept model is in the address");
  const kept = page.locator("section", { has: page.getByRole("heading", { name: "Predict from this model" }) });
  const predicted = page.locator("figure.drawing", { has: page.getByRole("img", { name: /^The shape predicted at/ }) });
  const place = () => predicted.locator("svg.shape circle").last().getAttribute("cy");
  // One request at a time, and the last wish is what is drawn.
  let [now, most, all] = [0, 0, 0];
  await page.route("**/v1/models/*/predictions?*", async (route) => {
    [now, all] = [now + 1, all + 1];
    most = Math.max(most, now);
    await new Promise((resolve) => setTimeout(resolve, 120));
    now--;
    await route.continue();
  });
  const before = await place();
  await slider.evaluate(async (input) => {
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
    for (let step = 0; step <= 20; step++) {
      set.call(input, String(Number(input.min) + (step / 20) * (input.max - input.min)));
      input.dispatchEvent(new Event("input", { bubbles: true }));
      await new Promise((resolve) => setTimeout(resolve, 30));
    }
  });
  await page.waitForFunction(() => /"age":50/.test(new URL(location.href).searchParams.get("at") ?? ""));
  const answer = await service.call("GET", `/v1/models/${job}/predictions?at.a=x&at.b=u&at.age=50`);
  await page.waitForTimeout(400);
  assert.equal(most, 1, "one request at a time");
  assert.ok(all < 15, `${all} requests for 21 places of the slider`);
  assert.notEqual(await place(), before, "the shape moves");
  assert.ok(answer.predictions[0].shape, "the service predicts it too");
  await page.unroute("**/v1/models/*/predictions?*");
  assert.equal(await page.locator("svg.shape .band").count(), 0);
  await kept.getByLabel("Bands").selectOption("0.95");
  await page.locator("svg.shape .band ellipse").first().waitFor();
  await page.getByText("the band holds all places of the mean shape at these values together").waitFor();
  await accessible(page, "kept model");
  // No shape is of y and v.
  await kept.locator("select").nth(0).selectOption("y");
  await kept.locator("select").nth(1).selectOption("v");
  await page.getByText("none of them has this combination").waitFor();
  await kept.locator("select").nth(1).selectOption("u");
  await page.getByText("none of them has this combination").waitFor({ state: "detached" });
  // The keyboard moves a slider as well.
  await slider.focus();
  const said = await slider.getAttribute("aria-valuetext");
  await page.keyboard.press("ArrowLeft");
  assert.notEqual(await slider.getAttribute("aria-valuetext"), said);
  // An address holds the values, those outside of the data too.
  const address = new URL(page.url());
  address.searchParams.set("at", JSON.stringify({ a: "x", b: "v", age: 70 }));
  await page.goto(address.href);
  await page.getByText("Outside of the data").waitFor();
  address.searchParams.set("kept", "missing");
  await page.goto(address.href);
  await page.getByText("This model is no longer kept").waitFor();
  // Along curves a band is one area.
  await page.goto(`${service.address}/app/cohorts/example-cells/model?permutations=199&bands=0.95`);
  await page.getByRole("button", { name: "Keep this model" }).click();
  await page.locator("svg.shape .band path").nth(100).waitFor();
  await settled(page);
  await kept.evaluate((section) => section.scrollIntoView());
  await accessible(page, "kept model of curves");
  await screen(page, "model-kept");
  // With few draws there is no band of all places together: each place has the ellipse of its intervals, which is said.
  await page.goto(`${service.address}/app/cohorts/example-cells/model?permutations=49&bands=0.95`);
  await page.getByRole("button", { name: "Keep this model" }).click();
  await page.getByText("For all places together the model has no draws").waitFor();
  const shapes = await page
    .locator("svg.shape .band ellipse")
    .evaluateAll((all) => all.map((one) => one.rx.baseVal.value / one.ry.baseVal.value));
  assert.ok(Math.max(...shapes) > 1.1, "as wide in each direction as the interval there");
  await within(page.locator("svg.shape", { has: page.locator(".band") }));
  await kept.evaluate((section) => section.scrollIntoView());
  await screen(page, "model-kept-few");
  assert.deepEqual(
    page.faults.filter((one) => !/40[04]|422/.test(one)),
    [],
  );
  await page.context().close();
});

test("who may what: a reader sees no button of a writer, and who is logged in; one login for all tabs", async () => {
  const own = await serve();
  const secret = await key(own.folder, "--role", "reader");
  await new Promise((resolve) => setTimeout(resolve, 2500));
  const page = await open(browser, own.address, {}, ["401"]);
  // As the service tells it: see docs/dashboard.md.
  await page.context().route("**/v1/version", async (route) => {
    const response = await route.fetch();
    if (!response.ok()) return route.fulfill({ response });
    const answer = await response.json();
    return route.fulfill({
      response,
      json: { ...answer, caller: { role: "reader", tenant: "north", name: "ward 3" } },
    });
  });
  await page.goto(`${own.address}/app/cohorts/example-cells`);
  await page.getByLabel("Key", { exact: true }).fill(secret);
  await page.getByRole("button", { name: "Continue" }).click();
  await page.getByText("All 120 shapes").waitFor();
  await page.getByText("ward 3 · Reader").waitFor();
  await page.getByText("Tenant north").waitFor();
  for (const name of ["Edit", "Delete", "Learn a model", "Label these shapes"])
    assert.equal(await page.getByText(name, { exact: true }).count(), 0, name);
  assert.equal(await page.getByRole("link", { name: "Upload" }).count(), 0);
  assert.equal(await page.getByRole("link", { name: "Administration" }).count(), 0);
  await accessible(page, "reader");
  // Readers compute.
  await page.getByRole("link", { name: "Groups" }).click();
  await page.getByText("Shapes differ by").waitFor();
  // Another tab of the session.
  const second = await page.context().newPage();
  await second.goto(`${own.address}/app/cohorts/example-cells`);
  await second.getByText("All 120 shapes").waitFor();
  await page.getByRole("button", { name: "Forget the key" }).click();
  await second.getByText("This service needs a key").waitFor();
  assert.deepEqual(page.faults, []);
  await page.context().close();
  await own.stop();
  own.remove();
});

test("German: refusals by their type, decimal commas in and out", async () => {
  const page = await open(browser, service.address, { locale: "de-DE" }, ["404"]);
  await page.goto(`${service.address}/app/cohorts/missing`);
  await page.getByText("Nicht gefunden").waitFor();
  assert.equal(await page.locator("nav.tabs a").count(), 0, "a cohort that is not there has no views");
  // Warnings too, with their numbers.
  await page.goto(
    `${service.address}/app/cohorts/gap/model?permutations=199&formula=${encodeURIComponent("~ a * b + age")}`,
  );
  await page.getByText("Spalten, die von anderen abhängen, sind ausgelassen: ay:bv.").waitFor();
  await page.getByText(/streuen \d,\d\d-mal so stark um das Modell/).waitFor();
  await page.goto(`${service.address}/app/cohorts/plate-one/table`);
  await settled(page);
  await page.getByText("Diese Formen kennzeichnen").click();
  await page.getByLabel("Merkmal", { exact: true }).fill("dosis");
  await page.getByLabel("Wert", { exact: true }).fill("1,25");
  await page.getByRole("button", { name: "Anwenden" }).click();
  await page.getByText("15 Formen wurden geändert.").waitFor();
  assert.ok((await shapesOf("plate-one")).items.every((one) => one.labels.dosis === 1.25));
  await page.getByRole("columnheader", { name: "dosis" }).waitFor();
  await settled(page);
  const text = (await saved(page, "Herunterladen plate-one Excel")).toString();
  assert.match(text, /^\uFEFFid;external_id;/);
  assert.match(text, /;1,25[;\r]/);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

withData("surfaces-hippocampus", "meshes keep their names and are made to correspond by default", async (from) => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts`);
  await settled(page);
  const names = readdirSync(path.join(from, "meshes")).sort().slice(0, 6);
  await page.locator("input[type=file]").setInputFiles(names.map((name) => path.join(from, "meshes", name)));
  await page.getByText("6 meshes would be stored as: Surface (sphere)").waitFor({ timeout: 240_000 });
  await page.locator(".thumb svg").first().waitFor();
  assert.ok(await page.getByLabel(/^Make the surfaces correspond afterwards/).isChecked());
  await accessible(page, "meshes proposed");
  await page.getByLabel("Name of the cohort").fill("hippocampi");
  await page.getByLabel("Control points").fill("8 × 6");
  await page.getByRole("button", { name: "Create and store" }).click();
  await page.getByRole("heading", { name: "The surfaces correspond" }).waitFor({ timeout: 240_000 });
  const { items } = await shapesOf("hippocampi");
  assert.deepEqual(
    items.map((one) => one.labels.file),
    names.map((name) => name.replace(".ply", "")),
  );
  assert.ok(items.every((one) => one.external_id));
  await page.getByRole("link", { name: "Look at hippocampi-corresponding" }).click();
  await page.getByText("All 6 shapes").waitFor();
  // Those that do not correspond say so in plain words.
  page.faults.length = 0;
  await page.goto(`${service.address}/app/cohorts/hippocampi/mean?transformation=rigid`);
  await page.getByText("The points of these surfaces do not correspond").waitFor();
  await accessible(page, "seams");
  await page.context().close();
});

withData("landmarks-nasal-bone-3d", "landmarks in space turn, with numbers and lines", async (from) => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts`);
  await settled(page);
  await page.locator("input[type=file]").setInputFiles(path.join(from, "landmarks.csv"));
  await page.getByText("56 landmark sets would be stored as: Landmarks, 10 × 3.").waitFor();
  await page.getByLabel("Name of the cohort").fill("noses");
  await page.getByRole("button", { name: "Create and store" }).click();
  await page.getByText("56 added").waitFor();
  await page.goto(`${service.address}/app/cohorts/noses/compare?by=labels.population&permutations=200`);
  const drawing = page.locator(".drawing svg.shape");
  await drawing.waitFor();
  await settled(page);
  await page.getByLabel("Numbers").check();
  await page.getByLabel("Lines between landmarks").fill("1-2-3, 2-4, 5-6");
  assert.equal(await page.locator(".drawing svg.shape text").count(), 10);
  assert.equal(await page.locator(".drawing svg.shape g path").count(), 2 * 4, "four lines in each of two averages");
  const before = await page.locator(".drawing svg.shape circle").first().getAttribute("cx");
  await drawing.focus();
  await page.keyboard.press("ArrowRight");
  assert.notEqual(await page.locator(".drawing svg.shape circle").first().getAttribute("cx"), before, "it turns");
  await accessible(page, "landmarks in space");
  // The grid is a drawing of the service; arrows turn.
  await page.goto(`${service.address}/app/cohorts/noses/compare?by=labels.population&permutations=200&warp=grid`);
  await page.getByRole("img", { name: /^The deformation of/ }).waitFor();
  await accessible(page, "a grid in space");
  await page.getByLabel("Arrows").check();
  await page.locator(".drawing svg.shape .arrow").first().waitFor();
  // All of them from one side, near points large and dark.
  await page.goto(`${service.address}/app/cohorts/noses`);
  await page.locator(".sheet svg").nth(55).waitFor();
  const radii = await page
    .locator(".sheet a")
    .first()
    .locator("circle")
    .evaluateAll((all) => all.map((one) => Number(one.getAttribute("r"))));
  assert.equal(radii.length, 10);
  assert.ok(Math.max(...radii) > 1.3 * Math.min(...radii), "a cue of depth");
  const one = page.locator(".sheet circle").first();
  const seen = await one.getAttribute("cx");
  await page.getByLabel("Seen from").focus();
  await page.keyboard.press("ArrowRight");
  assert.notEqual(await one.getAttribute("cx"), seen, "all turn together");
  assert.equal(await page.locator(".sheet text").count(), 0);
  await page.getByLabel("Numbers").check();
  assert.equal(await page.locator(".sheet text").count(), 560);
  assert.equal(await page.locator(".sheet path").count(), 4 * 56, "the lines of the cohort");
  await accessible(page, "a sheet in space");
  const file = (await saved(page, "Download noses-sheet SVG")).toString();
  assert.equal(file.match(/<circle/g).length, 560);
  await page.getByRole("heading", { name: "Contact sheet" }).evaluate((one) => one.scrollIntoView());
  await screen(page, "sheet-space");
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("a deformation grid between two groups, and from the mean to a shape: numbers, arrows, folds, files", async () => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts/gap/compare?by=labels.a&permutations=200`);
  await page.getByRole("button", { name: "Draw the grid" }).click();
  const figure = page.locator("figure.drawing", { has: page.getByRole("img", { name: /^The deformation of/ }) });
  await figure.locator(".net path").first().waitFor();
  await settled(page);
  const nodes = await figure.locator(".net path").first().getAttribute("d");
  await page.getByLabel("Magnified").focus();
  for (let step = 0; step < 6; step++) await page.keyboard.press("ArrowRight");
  await page.getByText("Changes are shown 4 times as large").waitFor();
  await page.waitForFunction((old) => document.querySelector(".net path")?.getAttribute("d") !== old, nodes);
  await figure.getByLabel("Numbers").check();
  assert.equal(await figure.locator("svg.shape text").count(), 5);
  assert.match((await saved(page, "Download gap-warp SVG")).toString(), /^<svg[\s\S]*<path/);
  assert.equal((await saved(page, "Download gap-warp PNG")).subarray(1, 4).toString(), "PNG");
  await figure.getByLabel("Lines between landmarks").fill("1-2-3-4-5-1");
  await accessible(page, "deformation");
  await page.getByRole("heading", { name: "Deformation" }).evaluate((one) => one.scrollIntoView());
  await screen(page, "warp");
  await page.getByLabel("Arrows").check();
  await figure.locator(".arrow").first().waitFor();
  await page.getByRole("button", { name: "Swap" }).click();
  await settled(page);
  await page.getByLabel("Both shapes").check();
  await figure.locator("svg.shape circle").nth(9).waitFor();
  assert.equal(await figure.locator(".arrow").count(), 0);
  // From the mean to a shape; a shape far away folds the grid.
  await page.goto(`${service.address}/app/cohorts/gap/shapes/g3?warp=grid`);
  await figure.locator(".net path").first().waitFor();
  await page.getByText("g3 was moved, turned and scaled onto the other shape first.").waitFor();
  await service.call("POST", "/v1/cohorts/gap/shapes", {
    shapes: [
      {
        external_id: "folded",
        points: [
          [0, 0],
          [4, 0],
          [1, 0.5],
          [2, 4],
          [3, 3],
        ],
      },
    ],
  });
  await page.goto(`${service.address}/app/cohorts/gap/shapes/folded?warp=grid`);
  await page.getByText(/The grid folds over itself at \d+ of \d+ nodes/).waitFor();
  await figure.locator(".net circle").first().waitFor();
  // Curves in the plane have one too, also where start points are searched: those that fit the mean are taken.
  await service.call("POST", "/v1/cohorts", {
    name: "starts",
    correspondence: "cyclic",
    representation: { kind: "closed_curve", dimension: 2, control_points: 24, generator: { name: "cubic" } },
  });
  await service.call("POST", "/v1/cohorts/starts/shapes", {
    shapes: Array.from({ length: 8 }, (_, k) => {
      const points = contour(2 * k);
      return { external_id: `c${k}`, points: [...points.slice(5 * k), ...points.slice(0, 5 * k)] };
    }),
  });
  await page.goto(`${service.address}/app/cohorts/starts/shapes/c3?warp=grid`);
  await figure.locator(".net path").first().waitFor();
  await settled(page);
  assert.equal(await figure.locator(".net circle").count(), 0, "no folds: the points correspond");
  await screen(page, "warp-cyclic", { fullPage: true });
  await page.goto(
    `${service.address}/app/cohorts/example-cells/compare?by=labels.treatment&warp=grid&permutations=200`,
  );
  await figure.locator(".net path").first().waitFor();
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

withData("images-nuclei", "several masks at once: every nucleus is stored under the name of its file", async (from) => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts`);
  await settled(page);
  const names = readdirSync(path.join(from, "labels")).sort().slice(0, 4);
  await page.locator("input[type=file]").setInputFiles(names.map((name) => path.join(from, "labels", name)));
  await page.getByText(/\d+ closed contours would be stored/).waitFor();
  await page.getByRole("button", { name: "Create and store" }).waitFor();
  await settled(page);
  await page.getByLabel("Name of the cohort").fill("nuclei");
  await page.getByRole("button", { name: "Create and store" }).click();
  await page.getByText(/^\d+ added$/).waitFor({ timeout: 120_000 });
  const { items } = await service.call("GET", "/v1/cohorts/nuclei/attributes?values=40");
  const files = items.find((one) => one.name === "labels.file");
  assert.equal(files.distinct, 4);
  assert.equal(files.missing, 0);
  await page.goto(`${service.address}/app/cohorts/nuclei/compare?by=labels.file&permutations=200`);
  await page
    .getByText(/by File/)
    .first()
    .waitFor();
  assert.deepEqual(page.faults, []);
  await page.context().close();
});
