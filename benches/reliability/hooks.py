"""Kills the service again and again while it delivers to hooks, and looks for deliveries that were lost or out of
order.

    python benches/reliability/hooks.py --binary target/release/shapelex --engine sqlite --kills 200
    python benches/reliability/hooks.py --binary target/release/shapelex --engine postgres --kills 200

One replica on SQLite, or two on a PostgreSQL of their own. Uploads go on without pause; replicas get SIGKILL at random
moments and are started again. Three hooks deliver to a receiver of this process, which refuses some deliveries, is
silent now and then, and answers others late. In the end every change must have been confirmed at least once by every
hook that wants it, first confirmations must be in order, every attempt must be signed and keep its id. Needs Python
3.11 and nothing beyond its library; the seed fixes the kills, not their interleaving.
"""

import argparse
import base64
import hashlib
import hmac
import http.client
import json
import tempfile
import threading
import time
from collections import defaultdict
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from random import Random

from machines import Postgres, Replica, free_port

REPRESENTATION = {"kind": "landmarks", "dimension": 2, "points": 3}


class Receiver:
    """Keeps what arrives by the path of the hook, and answers as it likes."""

    def __init__(self, random):
        self.arrived, self.random, self.is_calm, self.lock = defaultdict(list), random, False, threading.Lock()
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self):
                body = self.rfile.read(int(self.headers["content-length"]))
                receiver.take(self, body)

            def log_message(self, *_):
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, *_):
                """The sender was killed."""

        self.server = Server(("127.0.0.1", free_port()), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def take(self, request, body):
        with self.lock:
            draw = 1.0 if self.is_calm else self.random.random()
        if draw < 0.02:
            # Nothing is answered: the connection ends.
            status = None
        elif draw < 0.05:
            status = 503
        else:
            status = 204
        if 0.05 <= draw < 0.15:
            time.sleep(0.05)
        head = {name: request.headers[f"webhook-{name}"] for name in ("id", "timestamp", "signature")}
        with self.lock:
            self.arrived[request.path].append((head, body, status))
        if status is None:
            request.close_connection = True
            return
        try:
            request.send_response(status)
            request.send_header("content-length", "0")
            request.end_headers()
        except OSError:
            pass  # killed meanwhile: not known to be confirmed


def ask(replicas, method, path, body=None):
    """An answer of any replica, however often they are killed."""
    while True:
        for replica in replicas:
            connection = http.client.HTTPConnection("127.0.0.1", replica.port, timeout=20)
            try:
                text = None if body is None else json.dumps(body)
                connection.request(method, path, text, {"content-type": "application/json"})
                answer = connection.getresponse()
                text = answer.read()
                if answer.status < 300:
                    return json.loads(text) if text else None
                if answer.status not in (409, 503):
                    raise SystemExit(f"{method} {path}: {answer.status} {text[:300]}")
                if answer.status == 409:
                    return None  # done by a request whose answer was lost
            except (OSError, http.client.HTTPException):
                pass
            finally:
                connection.close()
        time.sleep(0.02)


def upload(replicas, stop, counts):
    """Shapes without pause; a repeated request adds nothing."""
    number = 0
    while not stop.is_set():
        shape = {"external_id": f"s{number}", "points": [[0, 0], [2 + number % 97, 0], [0, 1 + number % 89]]}
        ask(replicas, "POST", f"/v1/cohorts/c{number % 2}/shapes", {"shapes": [shape]})
        number += 1
        counts["uploads"] = number
        time.sleep(0.01)


def verify(secret, head, body):
    key = base64.b64decode(secret.removeprefix("whsec_"))
    signed = f"{head['id']}.{head['timestamp']}.".encode() + body
    wanted = "v1," + base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    return hmac.compare_digest(wanted, head["signature"])


def judge(hook, wanted, arrived):
    """What is wrong with the deliveries of a hook."""
    found, first, ids = [], [], {}
    for head, body, status in arrived:
        change = json.loads(body)["data"]
        if not verify(hook["secret"], head, body):
            found.append(f"change {change['sequence']}: wrong signature")
        if ids.setdefault(change["sequence"], head["id"]) != head["id"]:
            found.append(f"change {change['sequence']}: another id")
        if status == 204 and change["sequence"] not in first:
            first.append(change["sequence"])
    lost = sorted(set(wanted) - set(first))
    if lost:
        found.append(f"lost: {lost[:20]}")
    if set(first) - set(wanted):
        found.append(f"not wanted: {sorted(set(first) - set(wanted))[:20]}")
    if first != sorted(first):
        found.append("out of order")
    return found


def changes(replicas):
    """All changes of the feed."""
    found, last = [], 0
    while True:
        page = ask(replicas, "GET", f"/v1/changes?since={last}&limit=1000")
        found += page["items"]
        last = page["next"]
        if page["done"]:
            return found


def run(arguments, folder):
    random = Random(arguments.seed)
    database = Postgres(folder) if arguments.engine == "postgres" else None
    settings = {"SHAPELEX_ALLOW_PRIVATE_HOOKS": "true"} | ({"DATABASE_URL": database.url} if database else {})
    replicas = [Replica(arguments.binary, folder, k, settings) for k in range(2 if database else 1)]
    for replica in replicas:
        replica.start()
        replica.wait()
    receiver = Receiver(Random(arguments.seed + 1))
    cohorts = [
        ask(replicas, "POST", "/v1/cohorts", {"name": f"c{k}", "representation": REPRESENTATION})["id"] for k in (0, 1)
    ]
    filters = {"/all": {}, "/added": {"kinds": ["shapes_added"]}, "/one": {"cohort": "c1"}}
    base = f"http://127.0.0.1:{receiver.server.server_port}"
    hooks = {path: ask(replicas, "POST", "/v1/hooks", {"url": base + path, **only}) for path, only in filters.items()}
    stop, counts = threading.Event(), {"uploads": 0}
    writer = threading.Thread(target=upload, args=(replicas, stop, counts))
    writer.start()
    for _ in range(arguments.kills):
        time.sleep(random.uniform(0.05, 1.2))
        victim = random.choice(replicas)
        victim.kill()
        time.sleep(random.uniform(0, 0.2))
        victim.start()
        victim.wait()
    stop.set()
    writer.join()
    receiver.is_calm = True
    feed = changes(replicas)
    last = feed[-1]["sequence"]
    wanted = {
        "/all": [c["sequence"] for c in feed if c["sequence"] > 2],
        "/added": [c["sequence"] for c in feed if c["kind"] == "shapes_added"],
        "/one": [c["sequence"] for c in feed if c["cohort"] == cohorts[1] and c["sequence"] > 2],
    }
    end = time.monotonic() + 900
    for path, hook in hooks.items():
        while (now := ask(replicas, "GET", f"/v1/hooks/{hook['id']}"))["position"] < last:
            if time.monotonic() > end or now["status"] != "active":
                raise SystemExit(f"{path} does not reach the end: {now}")
            if now["attempts"] > 3:
                ask(replicas, "POST", f"/v1/hooks/{hook['id']}/resume")
            time.sleep(0.2)
    violations = []
    with receiver.lock:
        for path, hook in hooks.items():
            violations += [f"{path}: {what}" for what in judge(hook, wanted[path], receiver.arrived[path])]
        deliveries = sum(len(arrived) for arrived in receiver.arrived.values())
        confirmed = sum(status == 204 for arrived in receiver.arrived.values() for _, _, status in arrived)
    due = sum(map(len, wanted.values()))
    for replica in replicas:
        replica.stop()
    if database:
        database.stop()
    print(
        f"{arguments.engine}: {arguments.kills} kills, {counts['uploads']} uploads, {due} deliveries due, "
        f"{deliveries} attempts, "
        f"{confirmed - due} repetitions, {len(violations)} violations"
    )
    print(*violations, sep="\n")
    return not violations


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True)
    parser.add_argument("--engine", choices=["sqlite", "postgres"], default="sqlite")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        raise SystemExit(not run(arguments, folder))


if __name__ == "__main__":
    main()
