"""How long a contour waits for its assessment while the machine is busy; what an idle service takes; how soon it is
there.

    python benches/load/run.py --binary target/release/shapelex [--shapes 1000000] [--report load.json]

`POST /v1/dictionaries/{dictionary}/assess` of one contour, 200 times a second on connections that are kept, first
alone, then while a dictionary is learnt, then while also a cohort of a million shapes is streamed in. The moments of
the requests are fixed beforehand and latency counts from them, so a request that had to wait for the one before shows
it (no coordinated omission). Clients are processes of their own; the one that measures has priority (as far as the
system lets it), because it stands for another machine. Needs nothing beyond Python's library. On SQLite, or with
`--database-url` on PostgreSQL.
"""

import argparse
import asyncio
import json
import multiprocessing
import os
import platform
import signal
import subprocess
import tempfile
import time
from math import cos, pi, sin
from pathlib import Path
from random import Random

from service import ROOT, Service, prioritise, upload

RATE = 200
CONNECTIONS = 32
POINTS = 64
# Shapes whose text is written again and again, under other ids.
KINDS = 500
QUIET = 15
STARTS = 5
LIMITS = {"p99 of assess under load, ms": 10, "idle memory, MB": 33, "start to ready, ms": 300}


def contour(random):
    """Points on an oval with bumps of its own."""
    phase, bump, turn = random.uniform(0, 2 * pi), random.uniform(0.05, 0.4), random.uniform(0, 2 * pi)
    points = []
    for k in range(POINTS):
        t = 2 * pi * k / POINTS
        r = 10 * (1 + bump * cos(3 * t + phase) + 0.05 * sin(5 * t + 2 * phase))
        points.append([round(1.5 * r * cos(t + turn), 4), round(r * sin(t + turn), 4)])
    return points


def representation():
    return {"kind": "closed_curve", "dimension": 2, "control_points": POINTS, "generator": {"name": "cubic"}}


def prepare(service):
    """A cohort, a dictionary with a classifier, and the request that is sent."""
    random = Random(1)
    shapes = [{"external_id": str(k), "label": "ab"[k % 2], "points": contour(random)} for k in range(1000)]
    service.call("POST", "/v1/cohorts", {"name": "known", "representation": representation()})
    service.call("POST", "/v1/cohorts/known/shapes", {"shapes": shapes})
    body = {
        "name": "classes",
        "cohort": "known",
        "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 10, "centre": True},
        "classifier": {"kind": "discriminant", "attribute": "label", "repeats": 1},
    }
    finished(service, service.call("POST", "/v1/dictionaries", body)["id"])
    return json.dumps({"shapes": [{"points": contour(random)}]}).encode()


def finished(service, job):
    while (found := service.call("GET", f"/v1/jobs/{job}"))["status"] in ("queued", "running"):
        time.sleep(0.1)
    if found["status"] != "succeeded":
        raise SystemExit(json.dumps(found)[:1000])


def learn(service, stop, learnt):
    """Learns one dictionary after the other until told to stop; how many were begun."""
    prioritise(0)
    while not stop.is_set():
        learnt.value += 1
        body = {
            "name": f"long-{learnt.value}",
            "cohort": "known",
            "transformation": "similarity",
            "method": {
                "kind": "sparse",
                "atoms": 80,
                "lambda": 0.01,
                "max_epochs": 10000,
                "tolerance": 0.0,
                "seed": learnt.value,
            },
        }
        job = service.call("POST", "/v1/dictionaries", body)["id"]
        while (status := service.call("GET", f"/v1/jobs/{job}")["status"]) in ("queued", "running"):
            if stop.wait(0.2):
                service.call("POST", f"/v1/jobs/{job}/cancel")
                return
        if status != "succeeded":
            learnt.value = -1
            return


def write_lines(path, shapes):
    """The upload as a file, so that sending it costs hardly anything."""
    random = Random(2)
    kinds = [json.dumps(contour(random)) for _ in range(KINDS)]
    with path.open("w") as file:
        for first in range(0, shapes, KINDS):
            file.writelines(f'{{"external_id":"s{first + k}","points":{points}}}\n' for k, points in enumerate(kinds))


def stream(port, path, answer):
    """Sends the file as one request; seconds and what was answered."""
    prioritise(0)
    seconds, status, body = upload(port, "streamed", path)
    answer.put((seconds, status, body.get("added"), body.get("detail")))


async def ask(reader, writer, request):
    """One request on a connection that is kept; its status."""
    writer.write(request)
    head = await reader.readuntil(b"\r\n\r\n")
    length = next(line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:"))
    await reader.readexactly(int(length.split(b":")[1]))
    return int(head.split(b" ", 2)[1])


async def measure(port, body, until):
    """Latencies in ms from the intended moments, and the answers that were not 200."""
    request = (
        f"POST /v1/dictionaries/classes/assess HTTP/1.1\r\nhost: 127.0.0.1:{port}\r\n"
        f"content-type: application/json\r\ncontent-length: {len(body)}\r\n\r\n"
    ).encode() + body
    free = asyncio.Queue()
    for _ in range(CONNECTIONS):
        free.put_nowait(await asyncio.open_connection("127.0.0.1", port))
    latencies, bad, tasks = [], [], set()

    async def one(intended):
        reader, writer = await free.get()
        status = await ask(reader, writer, request)
        latencies.append(1e3 * (time.perf_counter() - intended))
        free.put_nowait((reader, writer))
        if status != 200:
            bad.append(status)

    begin, sent = time.perf_counter(), 0
    while not until(time.perf_counter() - begin):
        intended = begin + sent / RATE
        await asyncio.sleep(max(0.0, intended - time.perf_counter()))
        task = asyncio.create_task(one(intended))
        tasks.add(task)
        task.add_done_callback(tasks.discard)
        sent += 1
    await asyncio.gather(*tasks)
    return latencies, bad


def measured(port, body, until):
    """One phase, as numbers."""
    latencies, bad = asyncio.run(measure(port, body, until))
    latencies.sort()
    numbers = {f"p{q}": latencies[min(len(latencies) - 1, int(q / 100 * len(latencies)))] for q in (50, 90, 99)}
    return {"requests": len(latencies), "not 200": len(bad), "max": latencies[-1], **numbers}


def attack(service, folder, shapes):
    """Assessments alone, beside learning, and beside learning and a stream."""
    body, path = prepare(service), folder / "shapes.ndjson"
    write_lines(path, shapes)
    measured(service.port, body, lambda seconds: seconds > 2)
    phases = {"alone": measured(service.port, body, lambda seconds: seconds > QUIET)}
    stop, learnt = multiprocessing.Event(), multiprocessing.Value("i", 0)
    learner = multiprocessing.Process(target=learn, args=(service, stop, learnt))
    learner.start()
    while learnt.value == 0:
        time.sleep(0.05)
    phases["learning"] = measured(service.port, body, lambda seconds: seconds > QUIET)
    service.call("POST", "/v1/cohorts", {"name": "streamed", "representation": representation()})
    answer = multiprocessing.Queue()
    sender = multiprocessing.Process(target=stream, args=(service.port, path, answer))
    sender.start()
    phases["learning and streaming"] = measured(service.port, body, lambda _: not sender.is_alive())
    seconds, status, added, detail = answer.get(timeout=60)
    still = learner.is_alive()
    stop.set()
    learner.join()
    if (status, added, still, learnt.value > 0) != (201, shapes, True, True):
        raise SystemExit(f"the load was not what it should be: {status} {added} {detail}, learning: {still}")
    sent = {
        "shapes": shapes,
        "MB of NDJSON": path.stat().st_size / 1e6,
        "seconds": seconds,
        "dictionaries begun meanwhile": learnt.value,
    }
    return phases, sent


def run(arguments, folder):
    service = Service(str(Path(arguments.binary).resolve()), folder, arguments.database_url)
    report = {
        "program": subprocess.run([service.command[0], "--version"], capture_output=True, text=True).stdout.strip(),
        "machine": f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}",
        "start to ready of a new store, ms": service.start(),
    }
    time.sleep(5)
    report["idle memory, MB"] = service.megabytes()
    # What is started has the priority of who starts it: the service has been, or will be, without.
    report["client with priority"] = prioritise(-10)
    report["assess, ms"], report["stream"] = attack(service, folder, arguments.shapes)
    prioritise(0)
    report["p99 of assess under load, ms"] = report["assess, ms"]["learning and streaming"]["p99"]
    report["peak memory, MB"] = service.megabytes("VmHWM")
    service.stop()
    data = folder / "data"
    if data.is_dir():
        report["store, MB"] = sum(path.stat().st_size for path in data.iterdir()) / 1e6
    starts = []
    for k in range(STARTS):
        starts.append(service.start())
        # Every other start finds a store that was not closed.
        service.stop(signal.SIGKILL if k % 2 == 0 else signal.SIGTERM)
    report["starts to ready, ms"] = starts
    report["start to ready, ms"] = max(starts)
    report["over the limit"] = [what for what, limit in LIMITS.items() if report[what] > limit]
    return report


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", default=ROOT / "target" / "release" / "shapelex")
    parser.add_argument("--shapes", type=int, default=1_000_000)
    parser.add_argument("--database-url")
    parser.add_argument("--report", type=Path)
    arguments = parser.parse_args()
    if arguments.shapes % KINDS:
        parser.error(f"--shapes must be a multiple of {KINDS}")
    with tempfile.TemporaryDirectory(prefix="shapelex-load-") as folder:
        report = run(arguments, Path(folder))
    text = json.dumps(json.loads(json.dumps(report), parse_float=lambda number: round(float(number), 2)), indent=1)
    if arguments.report:
        arguments.report.write_text(text + "\n")
    print(text)
    raise SystemExit(1 if report["over the limit"] else 0)


if __name__ == "__main__":
    main()
