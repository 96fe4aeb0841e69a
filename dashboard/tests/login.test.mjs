/** Login on the page by an identity provider. */
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { provide } from "./provider.mjs";
import { accessible, browse, open, screen, serve } from "./service.mjs";

let provider, service, browser;

before(async () => {
  provider = await provide();
  service = await serve({ flags: [...provider.flags] });
  browser = await browse();
});

after(async () => {
  await browser?.close();
  await service?.stop();
  service?.remove();
  provider?.stop();
});

const visit = (expected = []) => open(browser, service.address, {}, ["401", ...expected], provider.issuer);
const button = (page) => page.getByRole("button", { name: `Log in with ${new URL(provider.issuer).host}` });

test("there and back again: the same view, no code or token in an address, a renewed token, a reload, the way out", async () => {
  const page = await visit();
  const places = [];
  page.on("framenavigated", (frame) => places.push(frame.url()));
  provider.state.expires = 3;
  await page.goto(`${service.address}/app/cohorts?order=-name`);
  await button(page).waitFor();
  await accessible(page, "login");
  await screen(page, "login-provider");
  await button(page).click();
  await page.getByRole("link", { name: "Alice" }).click();
  await page.waitForURL("**/app/cohorts?order=-name");
  await page.getByText("There are no cohorts yet.").waitFor();
  assert.equal(page.url(), `${service.address}/app/cohorts?order=-name`);
  assert.deepEqual(provider.state.grants, ["authorization_code"]);
  // Before the token ends, which it claims to do after three seconds, there is another one.
  provider.state.expires = 600;
  for (let tries = 0; provider.state.grants.length < 2 && tries < 60; tries++) await page.waitForTimeout(100);
  assert.deepEqual(provider.state.grants, ["authorization_code", "refresh_token"]);
  await page.reload();
  await page.getByText("There are no cohorts yet.").waitFor();
  const kept = await page.evaluate(() => ({ local: JSON.stringify(localStorage), cookies: document.cookie }));
  assert.ok(!kept.local.includes("eyJ") && kept.cookies === "", JSON.stringify(kept));
  assert.ok(
    places.every((place) => !place.includes("eyJ")),
    places.join(" "),
  );
  await page.getByRole("button", { name: "Log out" }).click();
  await button(page).waitFor();
  assert.equal(await page.evaluate(() => sessionStorage.length), 0);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("a token that is no longer accepted is renewed once, within the request", async () => {
  const page = await visit();
  await page.goto(`${service.address}/app/cohorts`);
  await button(page).click();
  await page.getByRole("link", { name: "Alice" }).click();
  await page.getByText("There are no cohorts yet.").waitFor();
  provider.state.grants.length = 0;
  await page.evaluate(() => sessionStorage.setItem("shapelex.key", "eyJ.broken.token"));
  await page.reload();
  await page.getByText("There are no cohorts yet.").waitFor();
  assert.deepEqual(provider.state.grants, ["refresh_token"]);
  assert.deepEqual(page.faults, []);
  await page.context().close();
});

test("refusals are told: by the provider, a state of another tab, no role, addresses elsewhere, a provider that is away", async () => {
  const page = await visit(["403", "400", "ERR_"]);
  await page.goto(`${service.address}/app/jobs`);
  await button(page).click();
  await page.getByRole("link", { name: "Nobody" }).click();
  await page.getByText("The identity provider refused the login").waitFor();
  await page.getByText("Nobody", { exact: true }).waitFor();
  await page.goto(`${service.address}/app/login?code=forged&state=forged`);
  await page.getByText("This login was not begun here").waitFor();
  assert.equal(new URL(page.url()).search, "");
  provider.state.roles = ["gardener"];
  await button(page).click();
  await page.getByRole("link", { name: "Alice" }).click();
  await page.getByText(/none of the roles/).waitFor();
  assert.equal(await page.evaluate(() => sessionStorage.length), 0);
  provider.state.roles = ["writer"];
  provider.state.elsewhere = true;
  await button(page).click();
  await page.getByText("The identity provider is not set up for this page").waitFor();
  provider.state.elsewhere = false;
  await page.route(`${provider.issuer}/**`, (route) => route.abort());
  await button(page).click();
  await page.getByText("The identity provider cannot be reached").waitFor();
  assert.deepEqual(page.faults, []);
  await page.context().close();
});
