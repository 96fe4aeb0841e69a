#!/usr/bin/env python3
"""Measures the client beside bare requests of the same run.

    python clients/python/rates.py [--program target/release/shapelex] [--shapes 100000]

Ten thousand contours of a hundred points are posted as bodies that are ready before the clock starts (lines of JSON,
NPY, NPZ, Arrow), by httpx, and as an array by the client, which makes its body while the clock runs; each into a new
cohort, in turns, best of three. Then the scores of many shapes are read as a frame. The first reading encodes them.
"""

import argparse
import io
import json
import time
import uuid

import httpx
import numpy as np
import pyarrow as pa

from shapelex import Server
from shapelex._reply import ARROW, NDJSON, NPY, NPZ
from shapelex._shapes import as_shapes

COUNT, POINTS, ROUNDS = 10_000, 100, 3


def contours(count, points=POINTS):
    """Ellipses with waves, of shape (count, points, 2), drawn from a seed."""
    random = np.random.default_rng(0)
    angle = 2 * np.pi * np.arange(points) / points
    waves = random.normal(scale=0.05, size=(count, 4, 1))
    radius = 1 + sum(waves[:, k] * np.cos((k + 2) * angle + k) for k in range(4))
    return np.stack([2 * radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def bodies(points, ids):
    """Bodies of the same shapes: media type and bytes of each form."""
    lines = "".join(
        json.dumps({"external_id": name, "points": shape.tolist()}) + "\n" for name, shape in zip(ids, points)
    )
    npy = io.BytesIO()
    np.save(npy, points)
    flat = pa.array(points.reshape(len(points), -1).tolist(), type=pa.list_(pa.float64()))
    columns = {"external_id": ids, "points": flat, "dimension": [2] * len(points), "closed": [True] * len(points)}
    arrow, table = io.BytesIO(), pa.table(columns)
    with pa.ipc.new_stream(arrow, table.schema) as writer:
        writer.write_table(table)
    npz = as_shapes(points, ids=ids, closed=True).npz()
    return {
        "lines of JSON": (NDJSON, lines.encode()),
        "NPY": (NPY, npy.getvalue()),
        "NPZ": (NPZ, npz),
        "Arrow": (ARROW, arrow.getvalue()),
    }


def new_cohort(client):
    return client.create_cohort(f"c-{uuid.uuid4().hex}", control_points=32, correspondence="arc_length")


def raw(client, http, media_type, body):
    """Seconds of a bare request."""
    cohort = new_cohort(client)
    options = {"return": "none"} | ({"closed": "true"} if media_type == NPY else {})
    begin = time.perf_counter()
    url = f"{client.url}/v1/cohorts/{cohort.name}/shapes"
    reply = http.post(url, params=options, content=body, headers={"content-type": media_type})
    seconds = time.perf_counter() - begin
    assert reply.status_code == 201 and reply.json()["added"] == COUNT, reply.text
    return seconds


def by_client(client, points, ids):
    """Seconds of the client, with ids or without."""
    cohort = new_cohort(client)
    begin = time.perf_counter()
    added = cohort.add(points, ids=ids)
    seconds = time.perf_counter() - begin
    assert added.added == COUNT
    return seconds


def uploads(client):
    """Prints the rates of uploads."""
    points, ids = contours(COUNT), [f"s{k}" for k in range(COUNT)]
    sent, best = bodies(points, ids), {}
    with httpx.Client(timeout=None, trust_env=False) as http:
        for _ in range(ROUNDS):
            for name, (media_type, body) in sent.items():
                best[name] = min(best.get(name, np.inf), raw(client, http, media_type, body))
            for name, given in (("client", None), ("client, with ids", ids)):
                best[name] = min(best.get(name, np.inf), by_client(client, points, given))
    # NPY has no ids, and nothing is looked up for them.
    bare, named = best["NPY"], min(best[name] for name in ("lines of JSON", "NPZ", "Arrow"))
    for name, seconds in best.items():
        fastest, kind = (bare, "without ids") if name in ("NPY", "client") else (named, "with ids")
        print(f"{name:>16}: {COUNT / seconds:9.0f} shapes/s, {fastest / seconds:5.0%} of the fastest bare body {kind}")


def scores(client, count):
    """Prints the seconds in which scores become a frame."""
    cohort = new_cohort(client)
    cohort.add(contours(count, 40), ids=[f"s{k}" for k in range(count)])
    dictionary = cohort.learn("rates", components=10)
    for reading in ("first", "second", "third"):
        begin = time.perf_counter()
        frame = dictionary.scores()
        print(f"{reading} reading of {len(frame)} scores as a frame: {time.perf_counter() - begin:.2f} s")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program")
    parser.add_argument("--shapes", type=int, default=100_000)
    arguments = parser.parse_args()
    with Server.start(arguments.program) as server, server.client() as client:
        uploads(client)
        scores(client, arguments.shapes)


if __name__ == "__main__":
    main()
