/** A small identity provider for tests: discovery, a page to log in on, the code flow with PKCE, refresh tokens that work once. */
import { createHash, createSign, generateKeyPairSync, randomBytes } from "node:crypto";
import { createServer } from "node:http";

export const CLIENT = "shapelex-page";
export const AUDIENCE = "shapelex";

const base64 = (value) => Buffer.from(typeof value === "string" ? value : JSON.stringify(value)).toString("base64url");

export async function provide() {
  const { privateKey, publicKey } = generateKeyPairSync("rsa", { modulusLength: 2048 });
  const codes = new Map(),
    refreshes = new Set();
  /** What tests look at and change: roles of the next token, seconds that it claims to live, exchanges made. */
  const state = { roles: ["writer"], expires: 600, grants: [], elsewhere: false };
  let issuer;
  const token = (lives) => {
    const now = Math.floor(Date.now() / 1000);
    const parts = `${base64({ alg: "RS256", kid: "test", typ: "at+jwt" })}.${base64({ iss: issuer, aud: AUDIENCE, sub: "alice", iat: now, exp: now + lives, roles: state.roles })}`;
    return `${parts}.${createSign("RSA-SHA256").update(parts).sign(privateKey, "base64url")}`;
  };
  const grant = (form) => {
    state.grants.push(form.get("grant_type"));
    if (form.get("client_id") !== CLIENT) return null;
    if (form.get("grant_type") === "refresh_token") return refreshes.delete(form.get("refresh_token"));
    const asked = codes.get(form.get("code"));
    codes.delete(form.get("code"));
    return (
      asked &&
      asked.redirect_uri === form.get("redirect_uri") &&
      asked.code_challenge ===
        createHash("sha256")
          .update(form.get("code_verifier") ?? "")
          .digest("base64url")
    );
  };
  const server = createServer(async (request, response) => {
    const url = new URL(request.url, issuer);
    const json = (status, value) =>
      response
        .writeHead(status, {
          "content-type": "application/json",
          "access-control-allow-origin": "*",
          "cache-control": "no-store",
        })
        .end(JSON.stringify(value));
    if (url.pathname === "/.well-known/openid-configuration") {
      const base = state.elsewhere ? "https://elsewhere.example" : issuer;
      return json(200, {
        issuer,
        jwks_uri: `${issuer}/jwks`,
        authorization_endpoint: `${issuer}/authorize`,
        token_endpoint: `${base}/token`,
      });
    }
    if (url.pathname === "/jwks")
      return json(200, { keys: [{ ...publicKey.export({ format: "jwk" }), kid: "test", use: "sig", alg: "RS256" }] });
    if (url.pathname === "/authorize") {
      const asked = Object.fromEntries(url.searchParams);
      const code = randomBytes(16).toString("hex");
      if (asked.response_type !== "code" || asked.client_id !== CLIENT || asked.code_challenge_method !== "S256")
        return json(400, { error: "invalid_request" });
      codes.set(code, asked);
      const to = (query) =>
        `${asked.redirect_uri}?${new URLSearchParams({ ...query, state: asked.state })}`.replaceAll("&", "&amp;");
      response.writeHead(200, { "content-type": "text/html" });
      return response.end(
        `<!doctype html><html lang="en"><title>Provider</title><link rel="icon" href="data:,"><h1>Who are you?</h1><a href="${to({ code })}">Alice</a> <a href="${to({ error: "access_denied", error_description: "Nobody" })}">Nobody</a>`,
      );
    }
    if (url.pathname === "/token" && request.method === "POST") {
      let text = "";
      for await (const part of request) text += part;
      if (!grant(new URLSearchParams(text)))
        return json(400, { error: "invalid_grant", error_description: "This code is not good." });
      const refresh = randomBytes(16).toString("hex");
      refreshes.add(refresh);
      return json(200, {
        access_token: token(600),
        token_type: "Bearer",
        expires_in: state.expires,
        refresh_token: refresh,
      });
    }
    return json(404, {});
  }).listen(0, "127.0.0.1");
  await new Promise((resolve) => server.once("listening", resolve));
  issuer = `http://127.0.0.1:${server.address().port}`;
  const flags = ["--oidc-issuer", issuer, "--oidc-audience", AUDIENCE, "--oidc-client-id", CLIENT];
  return {
    issuer,
    state,
    flags,
    stop: () => {
      server.closeAllConnections();
      server.close();
    },
  };
}
