/** A service that answers as a test says, and keeps what it was asked. */
import { createServer } from "node:http";

const bodyOf = async (request) => {
  const parts = [];
  for await (const part of request) parts.push(part);
  return Buffer.concat(parts).toString();
};

/** `answers` are `[status, headers, body]` in turn, the last one again and again; null hangs up. */
export async function fake(...answers) {
  const asked = [];
  const server = createServer(async (request, response) => {
    const answer = answers[Math.min(asked.length, answers.length - 1)];
    asked.push({ method: request.method, url: request.url, headers: request.headers, body: await bodyOf(request) });
    if (!answer) return request.socket.destroy();
    const [status, headers = {}, body = ""] = answer;
    response.writeHead(status, headers).end(body);
  }).listen(0, "127.0.0.1");
  await new Promise((resolve) => server.once("listening", resolve));
  const stop = () => {
    server.closeAllConnections();
    return new Promise((resolve) => server.close(resolve));
  };
  return { url: `http://127.0.0.1:${server.address().port}`, asked, stop };
}

export const JSON_TYPE = { "content-type": "application/json" };
export const json = (value, status = 200, headers = {}) => [
  status,
  { ...JSON_TYPE, ...headers },
  JSON.stringify(value),
];

export const problem = (status, code, headers = {}, errors = []) => [
  status,
  { "content-type": "application/problem+json", ...headers },
  JSON.stringify({ type: `urn:shapelex:problem:${code}`, title: code, status, code, detail: `${code}.`, errors }),
];
