"""Processor seconds of two builds of the service for the same requests, in turns.

    python3 benches/weight/service.py --before BINARY --now BINARY [--rounds 5] [--shapes 20000]

Each round starts both programs on empty folders, one after the other, and sends each the same requests: small
computations, uploads, means, a search, a dictionary, files, pictures. A row has the medians of the processor seconds of
the service, user and system, and the median of the ratios of the rounds. Answers of the two builds are compared by
digest; the last row is the peak of the memory in MB. Needs nothing beyond Python's library.
"""

import argparse
import hashlib
import http.client
import json
import math
import os
import random
import re
import statistics
import subprocess
import tempfile
from pathlib import Path

TICKS = os.sysconf("SC_CLK_TCK")
POINTS = 64
# Ids of stored things differ from run to run.
RANDOM = re.compile(rb"(coh|shp|dic|job)_[0-9a-zA-Z-]+")


class Service:
    """A running program with a connection to it."""

    def __init__(self, program, folder):
        command = [program, "serve", "--listen", "127.0.0.1:0", "--data-dir", folder, "--rate-per-second", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        address = next(word for line in self.process.stdout for word in line.split() if word.startswith("http://127"))
        port = int(address.rstrip("/.,").rsplit(":", 1)[1])
        self.connection = http.client.HTTPConnection("127.0.0.1", port, timeout=600)

    def seconds(self):
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / TICKS

    def peak(self):
        """Largest resident memory so far, in MB."""
        return int(re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{self.process.pid}/status").read_text())[1]) / 1e3

    def ask(self, method, path, body=None, kind="application/json", **headers):
        content = json.dumps(body).encode() if isinstance(body, dict) else body
        self.connection.request(method, path, content, {"content-type": kind, **headers})
        answer = self.connection.getresponse()
        text = answer.read()
        if answer.status >= 300:
            raise SystemExit(f"{method} {path}: {answer.status} {text[:400]}")
        return text

    def stop(self):
        self.connection.close()
        self.process.terminate()
        self.process.wait()


def contour(stream):
    """A closed contour of `POINTS` points: an ellipse with four random harmonics."""
    waves = [(k, stream.gauss(0, 0.3 / k), stream.uniform(0, 2 * math.pi)) for k in (2, 3, 4, 5)]
    points = []
    for i in range(POINTS):
        t = 2 * math.pi * i / POINTS
        radius = 10 * (1 + sum(a * math.cos(k * t + p) for k, a, p in waves))
        points.append([1.5 * radius * math.cos(t), radius * math.sin(t)])
    return points


CURVE = {"kind": "closed_curve", "dimension": 2, "control_points": POINTS, "generator": {"name": "cubic"}}


def tasks(shapes):
    """Names and functions of a service; each returns what must be the same of two builds."""
    stream = random.Random(1)
    contours = [contour(stream) for _ in range(shapes)]
    lines = "\n".join(
        json.dumps({"external_id": f"s{i}", "label": "ab"[i % 2], "points": p}) for i, p in enumerate(contours)
    ).encode()
    few = [{"points": p} for p in contours[:100]]
    project = {"representation": CURVE, "transformation": "similarity", "reference": few[0], "shapes": few[1:2]}
    batch = project | {"shapes": few[1:]}
    cohort = {"name": "c", "correspondence": "landmarks", "representation": CURVE}
    learn = {
        "name": "d",
        "cohort": "c",
        "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 12, "centre": True},
    }
    search = {"transformation": "similarity", "neighbours": 10, "shapes": few[:5]}
    score = {"shapes": few}

    def upload(service):
        service.ask("POST", "/v1/cohorts", cohort)
        service.ask("POST", "/v1/cohorts/c/shapes", lines, "application/x-ndjson")

    def posted(service):
        service.ask("POST", "/v1/cohorts", cohort | {"name": "p"})
        for start in range(0, min(shapes, 10000), 200):
            part = [{"external_id": f"p{start + i}", "points": p} for i, p in enumerate(contours[start : start + 200])]
            service.ask("POST", "/v1/cohorts/p/shapes", {"shapes": part})

    return {
        "4000 × project, one contour": lambda s: [s.ask("POST", "/v1/project", project) for _ in range(4000)][-1],
        "200 × project, 99 contours": lambda s: [s.ask("POST", "/v1/project", batch) for _ in range(200)][-1],
        f"upload of {shapes} contours as lines": upload,
        "upload of 10 000 contours in JSON, 200 each": posted,
        "10 means of a label, each computed": lambda s: [
            s.ask("GET", f"/v1/cohorts/c/mean?transformation={name}&label={label}")
            for name in ("similarity", "affine", "linear", "translation", "scaled_rotation")
            for label in "ab"
        ][-1],
        "30 × search, 5 contours": lambda s: [s.ask("POST", "/v1/cohorts/c/search", search) for _ in range(30)][-1],
        "dictionary of 12 components": lambda s: s.ask("POST", "/v1/dictionaries", learn, prefer="wait=60") and b"",
        "200 × score, 100 contours": lambda s: [s.ask("POST", "/v1/dictionaries/d/score", score) for _ in range(200)][
            -1
        ],
        "export as NDJSON": lambda s: s.ask("GET", "/v1/cohorts/c/export?format=ndjson") and b"",
        "export as Parquet": lambda s: s.ask("GET", "/v1/cohorts/c/export?format=parquet") and b"",
        "50 × mean as SVG": lambda s: [
            s.ask("GET", "/v1/cohorts/c/mean?transformation=similarity&format=svg") for _ in range(50)
        ][-1],
        "20 × mean as PNG": lambda s: [
            s.ask("GET", "/v1/cohorts/c/mean?transformation=similarity&format=png") for _ in range(20)
        ][-1],
    }


def measure(program, work):
    """Processor seconds of each task, and the digest of its answer."""
    with tempfile.TemporaryDirectory() as folder:
        service = Service(program, folder)
        found = {}
        try:
            for name, task in work.items():
                before = service.seconds()
                answer = RANDOM.sub(b"", task(service) or b"")
                found[name] = (service.seconds() - before, hashlib.sha256(answer).hexdigest())
            found["peak"] = service.peak()
        finally:
            service.stop()
        return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", required=True)
    parser.add_argument("--now", required=True)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--shapes", type=int, default=20000)
    arguments = parser.parse_args()
    work = tasks(arguments.shapes)
    rounds = []
    for turn in range(arguments.rounds):
        # Who comes first changes, since the first one of a pair may find a quieter or busier machine.
        order = ("before", "now") if turn % 2 == 0 else ("now", "before")
        found = {side: measure(getattr(arguments, side), work) for side in order}
        rounds.append(found)
    print("| requests | before, s | now, s | now ÷ before | answers |\n|---|---|---|---|---|")
    total = {"before": 0.0, "now": 0.0}
    for name in work:
        middle = {side: statistics.median(found[side][name][0] for found in rounds) for side in total}
        ratio = statistics.median(found["now"][name][0] / max(found["before"][name][0], 1 / TICKS) for found in rounds)
        same = all(found["now"][name][1] == found["before"][name][1] for found in rounds)
        for side in total:
            total[side] += middle[side]
        print(
            f"| {name} | {middle['before']:.2f} | {middle['now']:.2f} | {ratio:.2f} | "
            f"{'the same' if same else 'DIFFERENT'} |"
        )
    print(f"| all | {total['before']:.2f} | {total['now']:.2f} | {total['now'] / total['before']:.2f} | |")
    peaks = {side: statistics.median(found[side]["peak"] for found in rounds) for side in total}
    print(
        f"| peak of the memory, MB | {peaks['before']:.0f} | {peaks['now']:.0f} | "
        f"{peaks['now'] / peaks['before']:.2f} | |"
    )


if __name__ == "__main__":
    main()
