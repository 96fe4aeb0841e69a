"""Elastic distances of the MPEG-7 silhouettes, through the running service; writes the table of docs/elastic.md.

    python benches/evaluation/elastic.py --data FOLDER [--binary PROGRAM] [--effort fast|normal|thorough ...]

FOLDER holds `curves-mpeg7/curves.ndjson`: 910 outlines, 14 of each of 65 classes. Nothing beyond the standard library.
Contours are resampled to 100 points by arc length and joined by lines (`bspline` of degree 1), with mirror
images.

Prints, for each effort and for the exact Procrustes distance of all start points: the share of outlines whose nearest
other one is of their class, and the bull's-eye score, the share of the class among the 28 nearest ones, itself
counted; both for the sum of the two distances, each over its median, with weights of the Procrustes one. Seconds are
those of the processor that the service spent, per pair, and those on the clock. The matrix must be symmetric, bit for
bit.
"""

import argparse
import os
import statistics
import struct
import tempfile
import time
from collections import Counter
from pathlib import Path

from run import ROOT, Service, curves

POINTS = 100
WEIGHTS = [0.25, 0.5, 1.0]


def processor_seconds(process):
    """Seconds of all threads of a process."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def matrix(service, body):
    """The matrix of distances by rows, with seconds of the processor and on the clock."""
    used, start = processor_seconds(service.process), time.perf_counter()
    answer = service.call("POST", "/v1/distances?format=npy", body, [("prefer", "wait=1")], raw=True)
    if not answer.startswith(b"\x93NUMPY"):
        [job, *_] = service.call("GET", "/v1/jobs")["items"]
        job = service.finished(job)
        used, start = processor_seconds(service.process) - used, time.perf_counter() - start
        answer = service.call("GET", f"/v1/jobs/{job['id']}/output?format=npy", raw=True)
    else:
        used, start = processor_seconds(service.process) - used, time.perf_counter() - start
    head = 10 + struct.unpack("<H", answer[8:10])[0]
    numbers = struct.unpack(f"<{(len(answer) - head) // 8}d", answer[head:])
    count = round(len(numbers) ** 0.5)
    return [list(numbers[i * count : (i + 1) * count]) for i in range(count)], used, start


def scores(rows, labels):
    """Shares of right nearest neighbours and of the class among the nearest ones."""
    sizes = Counter(labels)
    right = found = 0
    for i, row in enumerate(rows):
        order = sorted(range(len(row)), key=lambda j: (row[j], j != i))
        right += labels[order[1]] == labels[i]
        nearest = order[: 2 * sizes[labels[i]]]
        found += sum(labels[j] == labels[i] for j in nearest) / sizes[labels[i]]
    return right / len(rows), found / len(rows)


def median(rows):
    return statistics.median(value for i, row in enumerate(rows) for value in row[i + 1 :])


def line(*cells):
    print("| " + " | ".join(cells) + " |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", required=True)
    parser.add_argument("--binary", default=str(ROOT / "target/release/shapelex"))
    parser.add_argument("--effort", nargs="*", default=["fast", "normal"])
    asked = parser.parse_args()
    shapes = curves(asked.data, "curves-mpeg7")
    labels, pairs = [shape["label"] for shape in shapes], len(shapes) * (len(shapes) - 1) / 2
    with tempfile.TemporaryDirectory() as folder:
        service = Service(asked.binary, folder)
        try:
            generator = {"name": "bspline", "degree": 1}
            representation = {
                "kind": "closed_curve",
                "dimension": 2,
                "control_points": POINTS,
                "generator": generator,
            }
            service.cohort("mpeg7", representation, "cyclic", shapes)
            line("distance", "1-NN", "bull's-eye", "ms of processor a pair", "s on the clock")
            line(*["---"] * 5)
            body = {"cohort": "mpeg7", "mirror": "allow"}
            rigid, used, clock = matrix(service, {**body, "transformation": "similarity"})
            shares = [f"{share:.3f}" for share in scores(rigid, labels)]
            line("Procrustes, all starts", *shares, f"{used / pairs * 1e3:.3f}", f"{clock:.1f}")
            for effort in asked.effort:
                rows, used, clock = matrix(service, {**body, "correspondence": "elastic", "effort": effort})
                assert all(rows[i][j] == rows[j][i] for i in range(len(rows)) for j in range(i)), "not symmetric"
                shares = [f"{share:.3f}" for share in scores(rows, labels)]
                line(f"elastic, {effort}", *shares, f"{used / pairs * 1e3:.3f}", f"{clock:.1f}")
                own, other = median(rows), median(rigid)
                for weight in WEIGHTS:
                    both = [
                        [a / own + weight * b / other for a, b in zip(*pair, strict=True)]
                        for pair in zip(rows, rigid, strict=True)
                    ]
                    shares = [f"{share:.3f}" for share in scores(both, labels)]
                    line(f"elastic, {effort}, + {weight:g} Procrustes", *shares, "", "")
        finally:
            service.process.terminate()


if __name__ == "__main__":
    main()
