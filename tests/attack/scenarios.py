"""Cases that take more than one request: several clients, a stop, a damaged file.

Each function is a case of cases/*.json by its name, gets the variables of the case, and answers with its figures
(`says` is what the report prints) and what is wrong. `attack` starts services on copies of a furnished store.
"""

import json
import os
import re
import shutil
import socket
import sqlite3
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import hostile
from recipe import Recipe, points
from seeds import all_seeds

from service import KILL_BEYOND, MIB, Service, Skipped, exchange, head, known_flags, percentile, send_and_leave

HERE = Path(__file__).resolve().parent
JSON = {"content-type": "application/json"}
GZIP = {"content-encoding": "gzip"}
# Clients that wait for nothing longer than this are hung.
PATIENCE = 150

CURVE = {"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "cubic"}}
ENDLESS = {
    "representation": CURVE,
    "shapes": [{"points": {"$points": {"kind": "collapsed", "at": 1000}}}],
    "reference": {"points": {"$points": {"kind": "spike", "at": 1000, "by": -1000}}},
}
TINY_EVALUATE = {"representation": CURVE, "samples": 8, "shapes": [{"points": {"$points": {"kind": "circle"}}}]}
TINY_PROJECT = {
    "representation": CURVE,
    "transformation": "similarity",
    "shapes": [{"points": {"$points": {"kind": "circle"}}}],
    "reference": {"points": {"$points": {"kind": "circle", "seed": 2}}},
}
TRIANGLE = {"shapes": [{"points": [[0, 0], [4, 0], [4, 1]]}]}
ANSWERED = (200, 201, 202)


def recipe(node, gzip=False, pad=0):
    """The bytes of a recipe."""
    return Recipe().body({"body": node, "gzip": gzip, "pad": pad})[0]


@contextmanager
def started(attack, flags=(), tenants=False, **settings):
    """A service of its own, and with tenants a cohort of each: headers of keys by name."""
    service = attack.fresh(flags, **settings)
    try:
        keys = {}
        if tenants:
            keys = {name: service.key(name, "writer", name) for name in ("a", "b")} | {
                "admin": service.key("admin", "admin")
            }
        service.start()
        for name in ("a", "b") if tenants else ():
            landmarks = {"kind": "landmarks", "dimension": 2, "points": 3}
            service.post("/v1/cohorts", {"name": "own", "representation": landmarks}, keys[name])
        yield service, keys
    finally:
        service.remove()


# Bytes of a page of the embedded database.
PAGE = 4096

# Time for a service to notice that what was wrong is over: a full trail is tried again every second.
RECOVERY = 10


def ready_within(service, seconds):
    end = time.monotonic() + seconds
    while service.ready() != 204:
        if time.monotonic() > end:
            return False
        time.sleep(0.2)
    return True


def aftermath(service, wrong):
    """What every scenario asks in the end."""
    if service.ended():
        wrong.append(f"the process ended with {service.process.returncode}")
    elif not ready_within(service, RECOVERY):
        wrong.append(f"is not ready {RECOVERY} s afterwards")
    wrong.extend(f"in the log: {line[:200]}" for line in service.faults())
    return wrong


def together(tasks):
    """Runs functions at once; their results in order."""
    results = [None] * len(tasks)

    def run(k):
        results[k] = tasks[k]()

    threads = [threading.Thread(target=run, args=(k,), daemon=True) for k in range(len(tasks))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(2 * PATIENCE)
    return results


# C1


def measures_hold_no_lane(attack, count, leave, pad, seconds):
    """Clients that leave their endless measures behind; then what another tenant asks."""
    with started(attack, tenants=True) as (service, keys):
        body = recipe(ENDLESS, gzip=pad > 0, pad=pad)
        headers = {**JSON, **keys["a"], **(GZIP if pad else {})}
        together([lambda: send_and_leave(service.address, "POST", "/v1/measure", body, headers, leave)] * count)
        wrong, slowest = [], 0.0
        asked = [("/v1/cohorts/own/shapes", TRIANGLE), ("/v1/evaluate", TINY_EVALUATE), ("/v1/project", TINY_PROJECT)]
        for path, node in asked:
            answer = service.send("POST", path, recipe(node), {**JSON, **keys["b"]}, timeout=seconds)
            slowest = max(slowest, answer.seconds)
            if answer.status not in ANSWERED:
                wrong.append(
                    f"{path} of another tenant: {answer.status} after {answer.seconds:.1f} s {answer.error or ''}"
                )
        if not service.quiet(1.0):
            wrong.append("the work goes on after the clients have gone")
        return {"bytes": len(body), "says": f"others answered, slowest {slowest:.2f} s"}, aftermath(service, wrong)


def stored_tiny_curves(attack, shapes, seconds):
    """Curves whose squares underflow, stored, then compared and regressed."""
    with started(attack) as (service, _):
        service.post("/v1/cohorts", {"name": "tiny", "representation": CURVE})
        rows = [{"label": "ab"[k % 2], "points": points("circle", 8, scale=1e-158, seed=k)} for k in range(shapes)]
        stored = service.send(
            "POST", "/v1/cohorts/tiny/shapes", json.dumps({"shapes": rows}).encode(), JSON, timeout=seconds
        )
        wrong, says = [], [f"stored: {stored.status}"]
        asked = {
            "/v1/comparisons": {"cohort": "tiny", "by": "label", "permutations": 19},
            "/v1/regressions": {"cohort": "tiny", "attribute": "log_centroid_size", "permutations": 19},
        }
        for path, body in asked.items():
            headers = {**JSON, "prefer": f"wait={seconds}"}
            answer = service.send("POST", path, json.dumps(body).encode(), headers, timeout=seconds + 5)
            says.append(f"{path}: {answer.status}")
            if answer.status is None or answer.status >= 500 or answer.seconds > seconds:
                wrong.append(f"{path}: {answer.status} after {answer.seconds:.1f} s {answer.error or ''}")
            if answer.status == 202 and job_status(service, answer.json()["id"], seconds) in ("queued", "running"):
                wrong.append(f"{path}: its job has not ended after {seconds} s")
        if not service.quiet(1.0):
            wrong.append("the work goes on")
        return {"says": ", ".join(says)}, aftermath(service, wrong)


def job_status(service, job, seconds, headers=None):
    """How a job has ended, or how it stands after some seconds."""
    end = time.monotonic() + seconds
    while True:
        found = (service.send("GET", f"/v1/jobs/{job}", headers=headers or {}, timeout=20).json() or {}).get("status")
        if found not in ("queued", "running", None) or time.monotonic() > end:
            return found
        time.sleep(0.1)


# C2 and the quota


def bodies_at_once(attack, item, n, count, mb):
    """Compressed lists of tiny elements, all at once."""
    body = recipe({"shapes": [{"$repeat": item, "times": n}]}, gzip=True)
    with started(attack) as (service, _):
        with service.watched(KILL_BEYOND[attack.bounds]) as watch:
            send = lambda: service.send("POST", "/v1/project", body, {**JSON, **GZIP}, timeout=PATIENCE).status
            statuses = together([send] * count)
        wrong = [f"answered {status}" for status in set(statuses) - {400, 413, 422, 503}]
        if watch.above_idle > mb * 1e6:
            wrong.append(f"took {watch.above_idle / 1e6:.0f} MB, expected at most {mb}")
        return {"bytes": len(body), "says": f"{watch.cpu:.1f} CPU s, {watch.above_idle / 1e6:.0f} MB"}, aftermath(
            service, wrong
        )


def quota_flag(attack, megabytes):
    """The flag of the memory quota."""
    if "--max-memory" not in known_flags(str(attack.binary)):
        raise RuntimeError("the program has no --max-memory")
    return f"--max-memory={int(megabytes * 1e6)}"


def memory_quota(attack, max_memory_mb, count, n):
    """Good bodies, more than fit: refused by the service, not by the kernel."""
    rows = {"$repeat": {"points": [[0, 0], [4, 0], [4, 1]]}, "times": n // 25}
    node = {
        "representation": {"kind": "landmarks", "dimension": 2, "points": 3},
        "transformation": "similarity",
        "reference": {"points": [[0, 0], [3, 0], [4, 2]]},
        "shapes": [rows],
    }
    body = recipe(node, gzip=True)
    with started(attack, [quota_flag(attack, max_memory_mb)]) as (service, _):
        with service.watched(KILL_BEYOND[attack.bounds]) as watch:
            send = lambda: service.send("POST", "/v1/project", body, {**JSON, **GZIP}, timeout=PATIENCE).status
            statuses = together([send] * count)
        wrong = [f"answered {status}" for status in set(statuses) - {200, 413, 422, 503}]
        if watch.peak > max_memory_mb * 1e6:
            wrong.append(f"{watch.peak / 1e6:.0f} MB in memory, the quota is {max_memory_mb}")
        says = f"peak {watch.peak / 1e6:.0f} MB, {statuses.count(200)} of {count} answered"
        return {"bytes": len(body), "says": says}, aftermath(service, wrong)


# H1


def big_answer(samples):
    """A request of a few kilobytes whose answer is large."""
    curve = {"kind": "closed_curve", "dimension": 3, "control_points": 256, "generator": {"name": "cubic"}}
    shape = {"points": {"$points": {"kind": "circle", "count": 256, "dimension": 3}}}
    return recipe({"representation": curve, "samples": samples, "derivatives": 2, "frames": True, "shapes": [shape]})


def lazy_reader(address, path, body, headers):
    """A connection with a request whose answer is not read."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.settimeout(30)
    connection.connect(address)
    connection.sendall(head(address, "POST", path, len(body), headers) + body)
    return connection


def settled(service, most=40):
    """Waits until nothing is computed any more: everything that can be ready is ready."""
    end, quiet = time.monotonic() + most, 0
    while quiet < 3 and time.monotonic() < end and not service.ended():
        quiet = quiet + 1 if service.quiet(0.5, 0.1) else 0


def lazy_readers(service, count, body):
    """Many of them until all answers are ready; the statuses of small requests meanwhile."""
    connections, statuses = [], []
    try:
        for _ in range(count):
            connections.append(lazy_reader(service.address, "/v1/evaluate", body, JSON))
        for _ in range(10):
            statuses.append(service.send("POST", "/v1/project", recipe(TINY_PROJECT), JSON, timeout=PATIENCE).status)
            time.sleep(0.1)
        settled(service)
        statuses.append(service.send("POST", "/v1/project", recipe(TINY_PROJECT), JSON, timeout=PATIENCE).status)
    except OSError:
        pass
    finally:
        for connection in connections:
            connection.close()
    return statuses


def readers_that_do_not_read(attack, count, samples, mb):
    """What the answers of those take who do not read them."""
    body = big_answer(samples)
    with started(attack) as (service, _):
        with service.watched(KILL_BEYOND[attack.bounds]) as watch:
            statuses = lazy_readers(service, count, body)
        wrong = [f"a small request meanwhile: {status}" for status in set(statuses) - {200}]
        if watch.above_idle > mb * 1e6:
            wrong.append(f"took {watch.above_idle / 1e6:.0f} MB, expected at most {mb}")
        return {"bytes": count * len(body), "says": f"{watch.above_idle / 1e6:.0f} MB"}, aftermath(service, wrong)


def answers_within_a_limit(attack, count, samples, limit_mb, max_memory_mb):
    """The same where the kernel refuses more: the process must not end."""
    body = big_answer(samples)
    flags = [f"--max-memory={int(max_memory_mb * 1e6)}"]
    with started(attack, flags, max_bytes=limit_mb * MIB) as (service, _):
        with service.watched() as watch:
            lazy_readers(service, count, body)
        return {"bytes": count * len(body), "says": f"lives, {watch.above_idle / 1e6:.0f} MB"}, aftermath(service, [])


def http2_frame(kind, flags, stream, payload):
    """One frame: length, type, flags, stream, payload."""
    return struct.pack(">I", len(payload))[1:] + bytes([kind, flags]) + struct.pack(">I", stream) + payload


def http2_head(address, path, length):
    """The fields of a request as literals without an index and without Huffman codes."""
    fields = [
        (":method", "POST"),
        (":scheme", "http"),
        (":authority", f"{address[0]}:{address[1]}"),
        (":path", path),
        ("content-type", "application/json"),
        ("content-length", str(length)),
    ]
    return b"".join(b"\0" + bytes([len(n)]) + n.encode() + bytes([len(v)]) + v.encode() for n, v in fields)


# What a client may send on a connection before the service says that it has taken some of it.
HTTP2_WINDOW = 65535
HEADERS, GOAWAY = 1, 7


def http2_frames(connection, seconds):
    """Kinds of the frames that come within some seconds."""
    connection.settimeout(seconds)
    try:
        with connection.makefile("rb") as frames:
            while len(start := frames.read(9)) == 9:
                frames.read(int.from_bytes(start[:3], "big"))
                yield start[3]
    except TimeoutError:
        return


def window_of_zero(attack, streams, samples, mb):
    """HTTP/2 with a window of zero: answers can never be sent."""
    body = recipe(
        {
            "representation": CURVE,
            "samples": samples,
            "derivatives": 2,
            "frames": True,
            "shapes": [{"$repeat": {"points": {"$points": {"kind": "circle"}}}, "times": 2}],
        }
    )
    if streams * len(body) > HTTP2_WINDOW:
        raise RuntimeError(f"{streams} bodies of {len(body)} bytes are more than a connection takes at once")
    with started(attack) as (service, _):
        with service.watched(KILL_BEYOND[attack.bounds]) as watch:
            with socket.create_connection(service.address, timeout=30) as connection:
                # SETTINGS_INITIAL_WINDOW_SIZE = 0, and as many streams as the service lets open.
                settings = struct.pack(">HI", 4, 0)
                connection.sendall(
                    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + http2_frame(4, 0, 0, settings) + http2_frame(4, 1, 0, b"")
                )
                for k in range(streams):
                    stream = 2 * k + 1
                    fields = http2_head(service.address, "/v1/evaluate", len(body))
                    connection.sendall(http2_frame(1, 4, stream, fields) + http2_frame(0, 1, stream, body))
                time.sleep(1)
                settled(service)
                kinds = list(http2_frames(connection, 1))
        begun = kinds.count(HEADERS)
        wrong = ["the service ended the connection"] if GOAWAY in kinds else []
        if begun != streams:
            wrong.append(f"{begun} of {streams} answers begin")
        if watch.above_idle > mb * 1e6:
            wrong.append(f"took {watch.above_idle / 1e6:.0f} MB, expected at most {mb}")
        return {
            "bytes": streams * len(body),
            "says": f"{watch.above_idle / 1e6:.0f} MB, {begun} answers begin",
        }, aftermath(service, wrong)


# H2


def heavy_request(kind, n):
    """Path and body of work of seconds."""
    curve = {"kind": "closed_curve", "dimension": 3, "control_points": n, "generator": {"name": "cubic"}}
    walk = lambda seed: {"points": {"$points": {"kind": "walk", "count": n, "dimension": 3, "seed": seed}}}
    if kind in ("measure", "padded measure"):
        # Spaces made it heavy when weight was by bytes.
        pad = 0 if kind == "measure" else 600 << 10
        return "/v1/measure", recipe(
            {"representation": curve, "shapes": [walk(1)], "reference": walk(2)}, gzip=pad > 0, pad=pad
        )
    if kind == "fit":
        cloud = {"points": {"$points": {"kind": "sphere", "count": 8 * n, "dimension": 3}}}
        blob = {"kind": "subdivision", "scheme": "loop", "level": 3, "connectivity": "octahedron/2"}
        return "/v1/fit", recipe({"representation": blob, "turns": 200, "shapes": [cloud]})
    shapes = [{"$repeat": walk(1), "times": 150, "vary": True}]
    if kind == "align":
        landmarks = {"kind": "landmarks", "dimension": 3, "points": n}
        body = {
            "representation": landmarks,
            "transformation": "similarity",
            "alignment": "procrustes",
            "shapes": shapes,
        }
        return "/v1/align", recipe(body, gzip=True)
    return "/v1/pca", recipe(
        {"representation": curve, "transformation": "affine", "components": 50, "shapes": shapes}, gzip=True
    )


def heavy_headers(kind, key):
    """Those of such a request."""
    return {**JSON, **key, **(GZIP if kind in ("align", "pca", "padded measure") else {})}


def heavy_beside_tiny(attack, kind, heavy, n, seconds, p99_ms):
    """One tenant keeps heavy requests going; another asks for little."""
    path, body = heavy_request(kind, n)
    with started(attack, tenants=True) as (service, keys):
        over, statuses = threading.Event(), []

        def keep_going():
            while not over.is_set():
                answer = exchange(service.address, "POST", path, body, heavy_headers(kind, keys["a"]), PATIENCE)
                statuses.append(answer.status)
                # Who was refused tries again when it was told to, or the attack is one of refusals.
                over.wait(0.05 if answer.status == 503 else 0)

        for _ in range(heavy):
            threading.Thread(target=keep_going, daemon=True).start()
        time.sleep(1)
        found = run_probe(service, seconds, 0.02, keys["b"])
        over.set()
        p50, p99 = (percentile(found["latencies"], q) for q in (50, 99))
        wrong = [f"{count} tiny requests: {status}" for status, count in found["statuses"].items() if status != "200"]
        if p99 > p99_ms:
            wrong.append(f"p99 {p99:.0f} ms, expected at most {p99_ms}")
        tiny = f"{len(found['latencies'])} tiny: p50 {p50:.1f}, p99 {p99:.1f} ms, statuses {found['statuses']}"
        says = f"{tiny}; {statuses.count(200)} heavy done, {statuses.count(503)} refused"
        wrong.extend(f"in the log: {line[:200]}" for line in service.faults())
        return {"bytes": len(body), "says": says}, wrong


def run_probe(service, seconds, interval, key):
    """The probe as a process of its own."""
    command = [
        sys.executable,
        HERE / "probe.py",
        *map(str, service.address),
        str(seconds),
        str(interval),
        key.get("authorization", ""),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=seconds + PATIENCE)
    return json.loads(done.stdout)


def light_measures_beside_tiny(attack, count, n, seconds):
    """Measures that were in the light lane by their bytes, left by their clients."""
    path, body = heavy_request("measure", n)
    with started(attack, tenants=True) as (service, keys):
        together(
            [lambda: send_and_leave(service.address, "POST", path, body, heavy_headers("measure", keys["a"]), 1)]
            * count
        )
        answer = service.send("POST", "/v1/evaluate", recipe(TINY_EVALUATE), {**JSON, **keys["b"]}, timeout=seconds)
        wrong = [] if answer.status == 200 else [f"evaluate: {answer.status} after {answer.seconds:.1f} s"]
        return {"bytes": len(body), "says": f"evaluate took {answer.seconds:.2f} s"}, aftermath(service, wrong)


def slow_files_beside_files(attack, count, seconds):
    """Files of one tenant that arrive for ever; those of another are read meanwhile."""
    line = b'{"points": [[0, 0], [4, 0], [4, 1]]}\n'
    kind = {"content-type": "application/octet-stream"}
    path = "/v1/inspect?format=ndjson"
    with started(attack, tenants=True) as (service, keys):
        opening = head(service.address, "POST", path, 1 << 24, {**kind, **keys["a"]})
        slow = [socket.create_connection(service.address, timeout=30) for _ in range(count)]
        try:
            for connection in slow:
                connection.sendall(opening + line * 500)
            time.sleep(1)
            statuses, took, end = {}, [], time.monotonic() + seconds
            while time.monotonic() < end:
                answer = service.send("POST", path, line * 10, {**kind, **keys["b"]}, timeout=PATIENCE)
                statuses[answer.status] = statuses.get(answer.status, 0) + 1
                took.append(answer.seconds)
        finally:
            for connection in slow:
                connection.close()
        wrong = [
            f"{number} files of the other tenant: {status}" for status, number in statuses.items() if status != 200
        ]
        says = (
            f"{len(took)} files beside {count} slow ones: p99 {1000 * percentile(took, 99):.0f} ms, statuses {statuses}"
        )
        return {"bytes": count * 500 * len(line), "says": says}, aftermath(service, wrong)


def work_ends_with_its_client(attack, kind, n, leave, settle):
    """What is computed after the client has gone."""
    path, body = heavy_request(kind, n)
    with started(attack) as (service, _):
        send_and_leave(service.address, "POST", path, body, heavy_headers(kind, {}), leave)
        before = service.cpu()
        time.sleep(settle)
        spent = service.cpu() - before
        quiet = service.quiet(1.0, 0.2)
        wrong = [] if quiet else [f"still computes {settle} s after the client has gone"]
        return {"bytes": len(body), "says": f"{spent:.1f} CPU s after it left"}, aftermath(service, wrong)


def work_ends_with_its_time(attack, kind, n, compute_seconds, settle):
    """A request whose time is over is answered, and its work ends."""
    path, body = heavy_request(kind, n)
    with started(attack, [f"--compute-seconds={compute_seconds}"]) as (service, _):
        answer = service.send("POST", path, body, heavy_headers(kind, {}), timeout=PATIENCE)
        wrong = []
        if answer.status not in (200, 422, 503):
            wrong.append(f"answered {answer.status} {answer.error or ''}")
        # One second for the answer itself, and on a machine that others use too one for the request to be read.
        if answer.seconds > compute_seconds + 2:
            wrong.append(f"answered after {answer.seconds:.1f} s, its time was {compute_seconds} s")
        time.sleep(settle)
        if not service.quiet(1.0, 0.2):
            wrong.append(f"still computes {settle} s after the answer")
        return {"bytes": len(body), "says": f"{answer.status} after {answer.seconds:.1f} s"}, aftermath(service, wrong)


# H3


def sparse_learning(name, atoms, epochs, seed=0):
    """A request for a job whose length is chosen."""
    method = {"kind": "sparse", "atoms": atoms, "lambda": 0.01, "max_epochs": epochs, "tolerance": 0, "seed": seed}
    return json.dumps({"name": name, "cohort": "curves", "transformation": "similarity", "method": method}).encode()


def curves_cohort(service, shapes, key, at_once=500):
    """A cohort of curves, none like the other."""
    curve = {**CURVE, "control_points": 64}
    service.post("/v1/cohorts", {"name": "curves", "representation": curve}, key)
    for first in range(0, shapes, at_once):
        rows = [{"points": points("circle", 64, seed=k)} for k in range(first, min(shapes, first + at_once))]
        service.post("/v1/cohorts/curves/shapes", {"shapes": rows}, key)


def jobs_beside_a_job(attack, jobs, shapes, atoms, seconds):
    """One tenant's queue of heavy jobs, then a small one of another tenant."""
    with started(attack, tenants=True) as (service, keys):
        curves_cohort(service, shapes, keys["a"])
        curves_cohort(service, 50, keys["b"])
        statuses = {}
        for k in range(jobs):
            body = sparse_learning(f"heavy-{k}", atoms, 10000, k)
            status = service.send("POST", "/v1/dictionaries", body, {**JSON, **keys["a"]}).status
            statuses[status] = statuses.get(status, 0) + 1
        small = {
            "name": "small",
            "cohort": "curves",
            "transformation": "similarity",
            "method": {"kind": "functional_pca", "components": 2},
        }
        begin = time.monotonic()
        answer = service.send("POST", "/v1/dictionaries", json.dumps(small).encode(), {**JSON, **keys["b"]})
        wrong = [f"a heavy job: {status}" for status in statuses if status not in (202, 422, 429, 503)]
        ended = job_status(service, answer.json()["id"], seconds, keys["b"]) if answer.status == 202 else answer.status
        if ended not in ("succeeded", 201):
            wrong.append(f"the job of another tenant: {ended} after {time.monotonic() - begin:.0f} s")
        return {"says": f"{ended} after {time.monotonic() - begin:.1f} s; heavy: {statuses}"}, aftermath(service, wrong)


def endless_learning(attack, shapes, atoms, epochs, max_job_seconds):
    """A job that is predicted to run for hours is refused, with the prediction."""
    with started(attack, [f"--max-job-seconds={max_job_seconds}"] if max_job_seconds else []) as (service, _):
        curves_cohort(service, shapes, {})
        answer = service.send("POST", "/v1/dictionaries", sparse_learning("endless", atoms, epochs), JSON)
        wrong = []
        if answer.status != 422 or b"seconds" not in answer.body and b" s" not in answer.body:
            wrong.append(f"answered {answer.status}, expected 422 with the predicted seconds: {answer.body[:160]}")
        return {"says": f"{answer.status} {(answer.json() or {}).get('detail', '')[:120]}"}, aftermath(service, wrong)


# H4


def refusals_are_counted(attack, seconds, clients, most_entries, most_bytes, path="/v1/cohorts"):
    """Requests with a key that nobody has: what they leave behind."""
    import http.client

    with started(attack, tenants=True) as (service, keys):
        wait_until_closed(service)
        before, over = stored_bytes(service), time.monotonic() + seconds

        def refused():
            count, connection = {}, http.client.HTTPConnection(*service.address, timeout=PATIENCE)
            while time.monotonic() < over:
                connection.request("GET", path, headers={"authorization": "Bearer nobody"})
                answer = connection.getresponse()
                answer.read()
                count[answer.status] = count.get(answer.status, 0) + 1
            return count

        counts = together([refused] * clients)
        time.sleep(1)
        total = {
            status: sum(count.get(status, 0) for count in counts) for status in {s for count in counts for s in count}
        }
        written = stored_bytes(service) - before
        entries = trail(service)
        # A route that does not exist may be said to be missing before anybody is asked for a key.
        wrong = [f"answered {status}" for status in set(total) - {401, 404, 429}]
        if len(entries) > most_entries:
            wrong.append(f"{len(entries)} entries in the audit trail, expected at most {most_entries}")
        if not entries:
            wrong.append("no entry tells of the refusals")
        if written > most_bytes:
            wrong.append(f"{written} bytes written, expected at most {most_bytes}")
        says = f"{sum(total.values()) / seconds:.0f} a second, {len(entries)} entries, {written} B in all"
        return {"says": says}, aftermath(service, wrong)


def wait_until_closed(service):
    """Whether a service asks for keys is looked at every two seconds."""
    while service.send("GET", "/v1/cohorts").status != 401:
        time.sleep(0.1)


def stored_bytes(service):
    """Bytes of the store and the log."""
    files = [path for path in (service.folder / "data").rglob("*") if path.is_file()] + [service.log]
    return sum(path.stat().st_size for path in files if path.exists())


def trail(service):
    """Statuses of all entries that are refusals, of all tenants and of none: as the store has them."""
    with sqlite3.connect(f"file:{service.folder}/data/shapelex.db?mode=ro", uri=True, timeout=10) as store:
        return [status for (status,) in store.execute("SELECT status FROM audit WHERE status IN (401, 404, 429)")]


def emptied(database):
    """Bytes of a database once its log is emptied into it: every transaction in the log ends with the number of pages
    then."""
    size, log = database.stat().st_size, Path(f"{database}-wal").read_bytes()
    for frame in range(32, len(log), 24 + PAGE):
        if log[frame + 8 : frame + 16] != log[16:24]:
            # What follows is of an earlier use of the log.
            break
        size = max(size, int.from_bytes(log[frame + 4 : frame + 8], "big") * PAGE)
    return size


def reads_on_a_full_disk(attack, reads, room):
    """No file can grow by more than `room`: reads go on, a write is refused, the process lives, and is ready when there
    is room."""
    largest = max(path.stat().st_size for path in attack.open_store.iterdir())
    with started(attack, file_bytes=largest + room) as (service, _):
        statuses, slowest = {}, 0.0
        for _ in range(reads):
            answer = service.send("GET", "/v1/cohorts", timeout=PATIENCE)
            statuses[answer.status] = statuses.get(answer.status, 0) + 1
            slowest = max(slowest, answer.seconds)
            if answer.status != 200 or service.ended():
                break
        shapes = [{"points": points("random", 3, seed=k)} for k in range(20000)]
        write = service.send(
            "POST", "/v1/cohorts/attacked/shapes", json.dumps({"shapes": shapes}).encode(), JSON, timeout=PATIENCE
        )
        after = service.send("GET", "/v1/cohorts", timeout=PATIENCE)
        wrong = [f"{count} reads: {status}" for status, count in statuses.items() if status != 200]
        if write.status not in (503, 507):
            wrong.append(f"a write that does not fit: {write.status} {write.error or ''}")
        if after.status != 200:
            wrong.append(f"a read after the refused write: {after.status} after {after.seconds:.1f} s")
        if slowest > 5:
            wrong.append(f"a read took {slowest:.1f} s")
        # While the database can grow enough, its log can be emptied into it. The trail of the reads may have filled
        # both.
        left = service.file_bytes - emptied(service.folder / "data" / "shapelex.db")
        if left >= PAGE and not service.ended() and not ready_within(service, RECOVERY):
            wrong.append(f"is not ready with {left} bytes left for the database")
        service.lift_file_bound()
        says = f"reads {statuses}, write {write.status}, then read {after.status}, {left} bytes left beside the log"
        return {"says": says}, aftermath(service, wrong)


# M1, M3, M6, M7


def metadata_bound(attack, taken, refused):
    """What fits is taken, what does not is refused with its place."""
    with started(attack) as (service, _):
        statuses = []
        for size in (taken, refused):
            shape = {"points": [[0, 0], [4, 0], [4, 1]], "metadata": {"text": "a" * size}}
            statuses.append(
                service.send("POST", "/v1/cohorts/attacked/shapes", json.dumps({"shapes": [shape]}).encode(), JSON)
            )
        wrong = [] if statuses[0].status == 201 else [f"{taken} bytes: {statuses[0].status}"]
        if statuses[1].status != 422 or b"/shapes/0/metadata" not in statuses[1].body:
            wrong.append(f"{refused} bytes: {statuses[1].status} {statuses[1].body[:120]}")
        return {"says": f"{taken} B: {statuses[0].status}, {refused} B: {statuses[1].status}"}, aftermath(
            service, wrong
        )


def store_is_private(attack):
    """Nobody else reads the folder, whatever the mask of the one who starts."""
    mask = os.umask(0o022)
    try:
        service = Service(attack.binary, ["--no-example"]).start()
    finally:
        os.umask(mask)
    try:
        mode = (service.folder / "data").stat().st_mode & 0o777
        wrong = [] if mode & 0o077 == 0 else [f"the folder has the mode {mode:o}, expected 700"]
        return {"says": f"mode {mode:o}"}, aftermath(service, wrong)
    finally:
        service.remove()


SHIM = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>
int clock_gettime(clockid_t clock, struct timespec *time) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(clock, time);
    if (clock == CLOCK_REALTIME && getenv("ATTACK_SECONDS")) time->tv_sec += atol(getenv("ATTACK_SECONDS"));
    return result;
}
"""


def clock_shim(folder):
    """A library that moves the wall clock of a process."""
    compiler = shutil.which("cc")
    if not compiler:
        raise Skipped("no C compiler for the library that moves the clock")
    (folder / "clock.c").write_text(SHIM)
    done = subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-o", folder / "clock.so", folder / "clock.c", "-ldl"],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise Skipped(f"the library that moves the clock does not build: {done.stderr[:100]}")
    return str(folder / "clock.so")


def kept(service):
    """What lies in the trash, and entries of the audit trail."""
    return tuple(
        len(service.send("GET", path).json()["items"]) for path in ("/v1/trash?limit=1000", "/v1/audit?limit=1000")
    )


def clock_ahead(attack, days):
    """One start with a wrong clock: what was in the trash and in the trail is there afterwards."""
    with started(attack) as (service, _):
        service.send("DELETE", "/v1/cohorts/attacked")
        before = kept(service)
        if not all(before):
            raise RuntimeError(f"expected something in the trash and in the trail, got {before}")
        service.stop()
        environment = dict(service.environment)
        service.environment |= {"LD_PRELOAD": clock_shim(service.folder), "ATTACK_SECONDS": str(86400 * days)}
        try:
            service.start()
            # What is too old is looked for at the start.
            time.sleep(3)
            says = "starts"
        except RuntimeError as error:
            says = f"refuses to start: {str(error)[-120:]}"
        service.stop()
        wrong = [f"in the log: {line[:200]}" for line in service.faults()]
        service.environment = environment
        service.start()
        after = kept(service)
        if after[0] < before[0] or after[1] < before[1]:
            wrong.append(
                f"of {before[0]} in the trash and {before[1]} entries of the trail {after[0]} and {after[1]} are left"
            )
        return {"says": f"{says}; {after[0]} of {before[0]} in the trash"}, aftermath(service, wrong)


def filled_store(service, shapes=3000, at_once=500):
    """Uploads that are acknowledged; the number of shapes that are stored then."""
    before = shape_count(service)
    for first in range(0, shapes, at_once):
        rows = [{"points": points("random", 3, seed=k)} for k in range(first, first + at_once)]
        service.post("/v1/cohorts/attacked/shapes", {"shapes": rows})
    count = shape_count(service)
    if count != before + shapes:
        raise RuntimeError(f"the cohort has {count} shapes, expected {before} and {shapes}")
    return count


def shape_count(service):
    """Shapes of the cohort, or nothing when it is not there."""
    answer = service.send("GET", "/v1/cohorts/attacked")
    return answer.json()["shape_count"] if answer.status == 200 else None


def stop_checkpoints(attack):
    """After an orderly stop the store is one file."""
    with started(attack) as (service, _):
        count = filled_store(service)
        service.stop()
        wal = list((service.folder / "data").glob("*-wal"))
        left = sum(path.stat().st_size for path in wal)
        wrong = [] if left == 0 else [f"{left} bytes are left in the WAL"]
        for path in wal:
            path.unlink()
        service.start()
        if shape_count(service) != count:
            wrong.append(f"{shape_count(service)} shapes after the start, {count} before the stop")
        return {"says": f"{left} B in the WAL, {shape_count(service)} of {count} shapes without it"}, aftermath(
            service, wrong
        )


def damaged_wal(attack, damage):
    """A store that has lost what was acknowledged does not start as if nothing were."""
    with started(attack) as (service, _):
        count = filled_store(service)
        service.kill()
        for path in (service.folder / "data").glob("*-wal"):
            if damage == "missing":
                path.unlink()
            else:
                os.truncate(path, path.stat().st_size // 2)
        for path in (service.folder / "data").glob("*-shm"):
            path.unlink()
        try:
            service.start()
        except RuntimeError as error:
            return {"says": f"refuses to start: {str(error)[-150:].strip()}"}, []
        found = shape_count(service)
        wrong = [] if found == count else [f"starts with {found} of {count} acknowledged shapes, without a word"]
        return {"says": f"starts with {found} of {count} shapes"}, aftermath(service, wrong)


# Low


def ready_while_stopping(attack):
    """Between the signal and the end the service says that it stops."""
    with started(attack) as (service, _):
        with socket.create_connection(service.address, timeout=30) as upload:
            headers = {"content-type": "application/x-ndjson"}
            first = head(service.address, "POST", "/v1/cohorts/attacked/shapes", 1 << 20, headers)
            upload.sendall(first + b'{"points": [[0, 0], [4, 0], [4, 1]]}\n')
            time.sleep(0.5)
            service.process.terminate()
            statuses, end = [], time.monotonic() + 3
            while time.monotonic() < end and not service.ended() and 503 not in statuses:
                statuses.append(service.ready(timeout=2))
                time.sleep(0.05)
        wrong = [] if 503 in statuses else [f"/readyz answered {sorted(set(map(str, statuses)))}, expected 503"]
        code = service.stop()
        if code != 0:
            wrong.append(f"ended with {code}")
        return {"says": f"{', '.join(sorted(set(map(str, statuses))))}"}, wrong


def second_process(attack):
    """Without its lock file the store is still that of one process."""
    with started(attack) as (service, _):
        for path in (service.folder / "data").glob("*.lock"):
            path.unlink()
        second = Service(attack.binary, ["--no-example"], folder=service.folder)
        try:
            second.start()
            wrong = ["a second process runs on the same store"]
        except RuntimeError:
            wrong = []
        finally:
            second.kill()
        return {"says": "runs" if wrong else "refused"}, aftermath(service, wrong)


def references_resolve(attack):
    """Every `$ref` of the interface document names something."""
    service = attack.shared()
    document = service.send("GET", "/openapi.json").json()
    missing = sorted(reference for reference in references(document) if not resolves(document, reference))
    return {"says": f"{len(missing)} missing"}, [f"{reference} is missing" for reference in missing]


def references(node):
    """All of a document."""
    if isinstance(node, dict):
        own = {node["$ref"]} if isinstance(node.get("$ref"), str) else set()
        return own.union(*map(references, node.values())) if node else own
    return set().union(*map(references, node)) if isinstance(node, list) and node else set()


def resolves(document, reference):
    """Whether a reference of the form `#/a/b` leads to something."""
    for part in reference.removeprefix("#/").split("/"):
        document = document.get(part.replace("~1", "/").replace("~0", "~")) if isinstance(document, dict) else None
    return document is not None


# Files of other programs


# What a file is sent to.
READERS = {
    "inspect": "/v1/inspect?name={name}",
    "convert": "/v1/convert?to=ndjson&name={name}",
    "upload": "/v1/cohorts/attacked/shapes?plane=xy&prefix={prefix}-&name={name}",
}
FILE = {"content-type": "application/octet-stream"}
# Faults of a group that are told: the others are likely to be the same.
TOLD = 20


def hostile_files(attack, group, mb, **settings):
    """Files that are not what they say, to everything that reads files: refused with a place, in bounded memory."""
    with started(attack) as (service, _):
        seeds = all_seeds(service)
        sent = list(enumerate(hostile.GROUPS[group](seeds, **settings)))
        wrong = [fault for kind, file in seeds.items() for fault in valid_file_faults(service, kind, file)]
        with service.watched(KILL_BEYOND[attack.bounds]) as watch:
            for number, lie in sent:
                if service.ended():
                    break
                wrong += hostile_file_faults(service, lie, f"h{number}")
        if watch.above_idle > mb * 1e6:
            wrong.append(f"took {watch.above_idle / 1e6:.0f} MB, expected at most {mb}")
        most = max(len(lie.file.data) for _, lie in sent)
        says = f"{len(sent)} files, {watch.cpu:.1f} CPU s, {watch.above_idle / 1e6:.0f} MB, {len(wrong)} wrong"
        return {"bytes": most, "says": says}, aftermath(service, wrong[:TOLD])


def file_answers(service, file, prefix):
    """What everything that reads files answers to one."""
    for reader, path in READERS.items():
        yield (
            reader,
            service.send("POST", path.format(name=file.name, prefix=prefix), file.data, FILE, timeout=PATIENCE),
        )


def valid_file_faults(service, kind, file):
    """A valid file is taken: else a refusal of what is made of it would say nothing."""
    for reader, answer in file_answers(service, file, f"valid-{kind}"):
        if answer.status not in ANSWERED and (file.fits or reader != "upload"):
            yield (
                f"{reader} of a valid {kind}: {answer.status} "
                f"{answer.error or answer.body[:200].decode(errors='replace')}"
            )


def hostile_file_faults(service, lie, prefix):
    """What is wrong with the answers to a file."""
    for reader, answer in file_answers(service, lie.file, prefix):
        if lie.breaks and reader == "convert" and "IncompleteRead" in (answer.error or ""):
            continue
        text, problem = answer.body.decode(errors="replace"), answer.json()
        said = f"{reader} of {lie.what}: {answer.status} {answer.error or text[:300]}"
        if answer.status not in lie.expect:
            yield f"{said}, expected one of {lie.expect}"
        elif answer.status in ANSWERED:
            if re.search(r"[:\[,]\s*-?(NaN|inf)", text):
                yield f"{said}, expected numbers"
        elif not isinstance(problem, dict) or answer.headers.get("content-type") != "application/problem+json":
            yield f"{said}, expected a problem document"
        elif lie.place and not named_place(problem, lie.place):
            yield f"{said}, expected a place ({lie.place})"


def named_place(problem, part):
    """Whether a problem names this part of a place, or any."""
    places = [fault.get("place") or {} for fault in problem.get("errors", [])]
    return any(place and (part == "any" or part in place) for place in places)
