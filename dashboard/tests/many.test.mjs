/** A cohort of many shapes: 100 000, 20 000 in CI, or the number in SHAPES. What is measured is printed, and with GOALS=1 compared with the
    goals: other programs on the machine would decide otherwise. */
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { browse, open, SHORT, serve } from "./service.mjs";

const SHAPES = Number(process.env.SHAPES ?? (SHORT ? 20_000 : 100_000));
const GOALS = process.env.GOALS === "1";
let service, browser;

before(async () => {
  service = await serve();
  browser = await browse();
  const { call } = service;
  await call("POST", "/v1/cohorts", {
    name: "many",
    length_unit: "mm",
    correspondence: "landmarks",
    representation: { kind: "closed_curve", dimension: 2, control_points: 12, generator: { name: "trigonometric" } },
  });
  // Ellipses with two waves of their own, from a small generator of numbers that is the same everywhere.
  let state = 1;
  const random = () => (state = (state * 48271) % 2147483647) / 2147483647;
  for (let done = 0; done < SHAPES; done += 20_000) {
    const lines = Array.from({ length: Math.min(20_000, SHAPES - done) }, (_, k) => {
      const [a, b, c, size] = [
        1 + 0.4 * random(),
        0.3 * (random() - 0.5),
        0.2 * (random() + random() - 1),
        5 + 20 * random(),
      ];
      const points = Array.from({ length: 12 }, (_, i) => {
        const u = (i * Math.PI) / 6,
          r = size * (1 + b * Math.cos(3 * u) + c * Math.sin(2 * u));
        return [+(r * a * Math.cos(u)).toFixed(4), +(r * Math.sin(u)).toFixed(4)];
      });
      return JSON.stringify({
        external_id: `s${done + k}`,
        label: "abc"[Math.floor(3 * random())],
        labels: { site: ["zrh", "ber", "par", "lis"][Math.floor(4 * random())], age: Math.floor(20 + 60 * random()) },
        points,
      });
    });
    await call("POST", "/v1/cohorts/many/shapes?return=none", lines.join("\n"), {
      "content-type": "application/x-ndjson",
    });
  }
  await call(
    "POST",
    "/v1/dictionaries",
    {
      name: "many",
      cohort: "many",
      transformation: "similarity",
      method: { kind: "functional_pca", components: 4, centre: true },
    },
    { prefer: "wait=60" },
  );
});

after(async () => {
  await browser?.close();
  await service?.stop();
  service?.remove();
});

test(`${SHAPES} shapes: the cohort opens, and filters answer`, async () => {
  const page = await open(browser, service.address);
  await page.goto(`${service.address}/app/cohorts/many`);
  await page.getByText(`All ${SHAPES.toLocaleString("en-GB")} shapes`).waitFor();
  await page.locator(".sheet a").first().waitFor();
  // The first question reads the attributes of the cohort; later ones find them in memory.
  await page.goto(`${service.address}/app/cohorts`);
  const start = Date.now();
  await page.goto(`${service.address}/app/cohorts/many`);
  await page.locator(".sheet a").first().waitFor();
  console.log(`cohort page: ${Date.now() - start} ms`);
  await page.getByRole("checkbox", { name: /^zrh/ }).waitFor();
  const times = [];
  for (const name of ["zrh", "ber", "par"]) {
    times.push(
      await page.evaluate(async (wanted) => {
        const before = document.querySelector("strong[aria-live]").textContent;
        const box = [...document.querySelectorAll(".check")]
          .find((one) => one.textContent.startsWith(wanted))
          .querySelector("input");
        const begun = performance.now();
        box.click();
        while (document.querySelector("strong[aria-live]").textContent === before)
          await new Promise(requestAnimationFrame);
        return performance.now() - begun;
      }, name),
    );
  }
  console.log(`filters: ${times.map((ms) => ms.toFixed(0)).join(", ")} ms`);
  if (GOALS) assert.ok([...times].sort((a, b) => a - b)[1] <= 300, `median of ${times} ms, wanted 300`);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test(`${SHAPES} points: the scatter zooms at 30 frames a second or more`, async () => {
  const page = await open(browser, service.address);
  const start = Date.now();
  await page.goto(`${service.address}/app/dictionaries/many@1/scores?colour=labels.site`);
  await page.locator(".u-over").waitFor();
  console.log(`scatter: shown after ${((Date.now() - start) / 1000).toFixed(1)} s`);
  await page.waitForTimeout(1000);
  const rate = await page.evaluate(
    () =>
      new Promise((resolve) => {
        const plot = document.querySelector(".u-over"),
          box = plot.getBoundingClientRect();
        let frames = 0;
        const begun = performance.now();
        requestAnimationFrame(function step(now) {
          frames++;
          plot.dispatchEvent(
            new WheelEvent("wheel", {
              deltaY: frames % 40 < 20 ? -1 : 1,
              clientX: box.x + box.width / 2,
              clientY: box.y + box.height / 2,
              bubbles: true,
              cancelable: true,
            }),
          );
          if (now - begun < 3000) requestAnimationFrame(step);
          else resolve((1000 * frames) / (now - begun));
        });
      }),
  );
  console.log(`scatter: ${rate.toFixed(0)} frames/s`);
  if (GOALS) assert.ok(rate >= 30, `${rate} frames/s`);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});
