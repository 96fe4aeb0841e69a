"""How long a tenant waits for a small answer while another one keeps heavy requests going.

    python benches/load/tenants.py --binary target/release/shapelex [--heavy 64] [--seconds 20] [--report tenants.json]

Tenant A keeps `--heavy` requests in flight: measures with a reference, Procrustes alignments and fits, each some
seconds of CPU; what is answered 503 is sent again after half a second. Meanwhile tenant B projects a contour of six
points 100 times a second. The moments of these requests are fixed beforehand and latency counts from them (no
coordinated omission). Exits with 1 when B has a p99 of more than `GOAL` ms, or any answer that is not 200. Needs
nothing beyond Python's library.
"""

import argparse
import asyncio
import json
import multiprocessing
import subprocess
import tempfile
import time
from pathlib import Path
from random import Random

from costs import blob_mesh, curve, marked, measure, project, sphere

from service import ROOT, Service, prioritise

GOAL = 20
RATE = 100
CONNECTIONS = 16
PAUSE = 0.5


def heavy():
    """The requests of tenant A."""
    return [
        ("measure", measure(1, 1000, 2, True)),
        ("align", marked(100, 1024, 3, alignment="procrustes")),
        ("fit", {"representation": blob_mesh(2), "turns": 150, "shapes": [{"points": sphere(Random(1), 160, 100)}]}),
    ]


def request(port, route, body, key):
    text = json.dumps(body).encode()
    head = (
        f"POST /v1/{route} HTTP/1.1\r\nhost: 127.0.0.1:{port}\r\nauthorization: Bearer {key}\r\n"
        f"content-type: application/json\r\ncontent-length: {len(text)}\r\n\r\n"
    )
    return head.encode() + text


async def ask(connection, text):
    """One request on a connection that is kept; its status."""
    reader, writer = connection
    writer.write(text)
    head = await reader.readuntil(b"\r\n\r\n")
    for line in head.lower().split(b"\r\n"):
        if line.startswith(b"content-length:"):
            await reader.readexactly(int(line.split(b":")[1]))
        if line.startswith(b"transfer-encoding: chunked"):
            while size := int((await reader.readline()).strip(), 16):
                await reader.readexactly(size + 2)
            await reader.readline()
    return int(head.split(b" ", 2)[1])


def attack(port, key, count, stop, answers):
    """Keeps so many heavy requests going until told to stop; counts the answers."""
    prioritise(5)
    texts = [request(port, route, body, key) for route, body in heavy()]
    found = {}

    async def one(k):
        connection = await asyncio.open_connection("127.0.0.1", port, limit=1 << 22)
        while not stop.is_set():
            route = heavy_names[k % len(texts)]
            status = await ask(connection, texts[k % len(texts)])
            found[f"{route} {status}"] = found.get(f"{route} {status}", 0) + 1
            if status != 200:
                await asyncio.sleep(PAUSE)

    async def all_of_them():
        tasks = [asyncio.create_task(one(k)) for k in range(count)]
        while not stop.is_set():
            await asyncio.sleep(0.05)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    heavy_names = [route for route, _ in heavy()]
    asyncio.run(all_of_them())
    answers.put(found)


async def project_on(port, key, seconds):
    """Latencies in ms from the intended moments, and statuses."""
    text = request(port, "project", project(1, curve(6)), key)
    free = asyncio.Queue()
    for _ in range(CONNECTIONS):
        free.put_nowait(await asyncio.open_connection("127.0.0.1", port))
    latencies, statuses, tasks = [], {}, []

    async def one(intended):
        connection = await free.get()
        status = await ask(connection, text)
        latencies.append(1e3 * (time.perf_counter() - intended))
        statuses[status] = statuses.get(status, 0) + 1
        free.put_nowait(connection)

    begin = time.perf_counter()
    for sent in range(int(seconds * RATE)):
        intended = begin + sent / RATE
        await asyncio.sleep(max(0.0, intended - time.perf_counter()))
        tasks.append(asyncio.create_task(one(intended)))
    await asyncio.gather(*tasks)
    return latencies, statuses


def measured(port, key, seconds):
    latencies, statuses = asyncio.run(project_on(port, key, seconds))
    latencies.sort()
    at = lambda q: round(latencies[min(len(latencies) - 1, int(q * len(latencies)))], 2)
    return {
        "requests": len(latencies),
        "statuses": statuses,
        "p50": at(0.5),
        "p99": at(0.99),
        "max": round(latencies[-1], 2),
    }


def key_of(binary, tenant, folder):
    command = [
        binary,
        "key",
        "create",
        "--name",
        tenant,
        "--role",
        "reader",
        "--tenant",
        tenant,
        "--data-dir",
        str(folder),
    ]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return next(word for word in text.split() if word.startswith("shk_"))


def run(options, folder):
    binary = str(Path(options.binary).resolve())
    keys = {tenant: key_of(binary, tenant, folder / "data") for tenant in ("a", "b")}
    service = Service(binary, folder, None)
    service.start()
    prioritise(-10)
    report = {"alone, ms": measured(service.port, keys["b"], options.seconds / 2)}
    stop, answers = multiprocessing.Event(), multiprocessing.Queue()
    attacker = multiprocessing.Process(target=attack, args=(service.port, keys["a"], options.heavy, stop, answers))
    attacker.start()
    time.sleep(3)
    report["beside heavy requests, ms"] = measured(service.port, keys["b"], options.seconds)
    stop.set()
    report["heavy answers"] = answers.get(timeout=600)
    attacker.join(60)
    service.stop()
    return report


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", default=ROOT / "target" / "release" / "shapelex")
    parser.add_argument("--heavy", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--report", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="shapelex-load-") as folder:
        report = run(options, Path(folder))
    print(json.dumps(report, indent=1))
    if options.report:
        options.report.write_text(json.dumps(report, indent=1) + "\n")
    found = report["beside heavy requests, ms"]
    raise SystemExit(0 if found["p99"] <= GOAL and set(found["statuses"]) == {200} else 1)


if __name__ == "__main__":
    main()
