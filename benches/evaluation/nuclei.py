"""Segmentation of nuclei through the running service; writes the tables of docs/nuclei-evaluation.md.

    python benches/evaluation/nuclei.py --data FOLDER --binary PROGRAM [--write FILE]

FOLDER holds images-nuclei with images and labels. Nothing beyond the standard library is needed: images, labels and
shapes are read by the service. Initial shapes are ellipses in the bounding boxes of the labels, moved and stretched at
random with fixed seeds, as a detector would give them; nothing else of the labels is used before the overlap is
counted.
"""

import argparse
import csv
import http.client
import json
import subprocess
import tempfile
import time
from pathlib import Path
from random import Random
from statistics import mean, median

CURVE = {"kind": "closed_curve", "dimension": 2, "control_points": 12, "generator": {"name": "trigonometric"}}
# Contours with fewer cells have no 12 control points of their own.
LEAST_CELLS = 40
ENERGIES = {"contour": ("contour",), "local_contrast": ("local_contrast",), "both": ("contour", "local_contrast")}
BOUNDARY = "shapelex-nuclei"
LEARNT = 20


class Service:
    def __init__(self, binary, folder):
        log = folder / "log"
        command = [binary, "serve", "--listen", "127.0.0.1:0", "--data-dir", str(folder / "store"), "--no-example"]
        with log.open("wb") as out:
            self.process = subprocess.Popen(command, stdout=out, stderr=out)
        for _ in range(200):
            lines = [line for line in log.read_text().splitlines() if "listening" in line]
            if lines:
                self.address = lines[0].split("address=")[1].split()[0]
                return
            time.sleep(0.05)
        raise RuntimeError(f"the service does not start: {log.read_text()}")

    def send(self, method, path, body, media_type):
        connection = http.client.HTTPConnection(self.address, timeout=600)
        connection.request(method, path, body, {"content-type": media_type})
        answer = connection.getresponse()
        found = json.loads(answer.read())
        if answer.status >= 300:
            raise RuntimeError(f"{method} {path}: {answer.status} {json.dumps(found)[:400]}")
        return found

    def call(self, method, path, document=None):
        return self.send(method, path, json.dumps(document), "application/json")

    def form(self, path, parameters, **files):
        body = b""
        for name, content in {"parameters": json.dumps(parameters).encode(), **files}.items():
            kind = "application/json" if name == "parameters" else "image/png"
            body += (
                (
                    f'--{BOUNDARY}\r\ncontent-disposition: form-data; name="{name}"\r\ncontent-type: {kind}\r\n\r\n'
                ).encode()
                + content
                + b"\r\n"
            )
        body += f"--{BOUNDARY}--\r\n".encode()
        return self.send("POST", path, body, f"multipart/form-data; boundary={BOUNDARY}")


def box_of(points):
    return [[pick(p[c] for p in points) for c in (0, 1)] for pick in (min, max)]


def disturbed(box, part, draw):
    """A box whose centre and sides are off by up to a part of its sides."""
    lower, upper = box
    sides = [high - low for low, high in zip(lower, upper)]
    centre = [(low + high) / 2 + draw.uniform(-part, part) * side for low, high, side in zip(lower, upper, sides)]
    half = [side / 2 * (1 + draw.uniform(-part, part)) for side in sides]
    return {"lower": [c - h for c, h in zip(centre, half)], "upper": [c + h for c, h in zip(centre, half)]}


def components(service, labels):
    """The largest component of every label that is large enough and not cut off by the edge."""
    found = service.form("/v1/contours", {"least_cells": LEAST_CELLS, "coordinates": "index"}, image=labels)["results"]
    largest = {}
    for entry in found:
        if entry["edge_sides"] == 0 and entry["cells"] > largest.get(entry["label"], {"cells": 0})["cells"]:
            largest[entry["label"]] = entry
    return list(largest.values())


def segment(service, image, labels, found, part, seed, polarity, terms=("contour",), **further):
    draw = Random(seed)
    parameters = {
        "representation": CURVE,
        "coordinates": "index",
        "terms": [{"name": name, "polarity": polarity} for name in terms],
        "boxes": [disturbed(box_of(entry["points"]), part, draw) for entry in found],
        "truth_labels": [entry["label"] for entry in found],
        **further,
    }
    begun = time.perf_counter()
    results = service.form("/v1/segment", parameters, image=image, truth=labels)["results"]
    return results, time.perf_counter() - begun


TOLD = ("folded", "left_image", "collapsed", "left_object")


def is_failed(result):
    return result["stop"] in TOLD or result["overlap"]["jaccard"] < 0.5


def is_silent(result):
    """Whether a result is bad, and neither its end nor a warning says so."""
    return result["overlap"]["jaccard"] < 0.5 and result["stop"] not in TOLD and not result["warnings"]


def rows_of(service, data, images, part, energy):
    by_kind = {}
    for row in images:
        image = (data / "images" / f"{row['image']}.png").read_bytes()
        labels = (data / "labels" / f"{row['image']}.png").read_bytes()
        found = components(service, labels)
        if not found:
            continue
        polarity = "bright" if row["modality"] == "fluorescence" else "dark"
        results, seconds = segment(service, image, labels, found, part, 7, polarity, ENERGIES[energy])
        by_kind.setdefault(row["modality"], []).append((results, seconds))
    for kind, runs in sorted(by_kind.items()):
        results = [result for found, _ in runs for result in found]
        overlaps = [result["overlap"]["jaccard"] for result in results]
        failed, silent = sum(map(is_failed, results)), sum(map(is_silent, results))
        yield [
            energy,
            kind,
            len(runs),
            len(results),
            f"{mean(overlaps):.3f}",
            f"{median(overlaps):.3f}",
            failed,
            silent,
            f"{1000 * sum(seconds for _, seconds in runs) / len(results):.0f} ms",
        ]


def chain(service, data, images):
    """Masks → contours → cohort → dictionary → segmentation of other images with its mean as prior → assessment."""
    fluorescent = [row for row in images if row["modality"] == "fluorescence"]
    files = lambda row: [(data / kind / f"{row['image']}.png").read_bytes() for kind in ("images", "labels")]
    service.call("POST", "/v1/cohorts", {"name": "nuclei", "representation": CURVE, "correspondence": "cyclic"})
    posted, used = [], 0
    for row in fluorescent:
        for entry in components(service, files(row)[1]):
            posted.append({"points": entry["points"], "external_id": f"{row['image']}-{entry['label']}"})
        used += 1
        if len(posted) >= LEARNT:
            break
    posted = posted[:LEARNT]
    service.call("POST", "/v1/cohorts/nuclei/shapes", {"shapes": posted})
    learn = {
        "name": "nuclei",
        "cohort": "nuclei",
        "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 5},
    }
    connection = http.client.HTTPConnection(service.address, timeout=600)
    connection.request(
        "POST", "/v1/dictionaries", json.dumps(learn), {"content-type": "application/json", "prefer": "wait=60"}
    )
    answer = connection.getresponse()
    learnt = json.loads(answer.read())
    if answer.status != 201:
        raise RuntimeError(f"POST /v1/dictionaries: {answer.status} {json.dumps(learnt)[:400]}")
    reference = {
        "control_points": service.call("GET", "/v1/cohorts/nuclei/mean?transformation=similarity")["mean"][
            "control_points"
        ]
    }
    outcome = {}
    for row in fluorescent[used : used + 6]:
        image, labels = files(row)
        found = components(service, labels)
        for weight in (0, 1, 10):
            prior = (
                {"prior": {"reference": reference, "transformation": "similarity", "weight": weight}} if weight else {}
            )
            results, _ = segment(service, image, labels, found, 0.15, 11, "bright", **prior)
            outcome.setdefault(weight, []).extend(results)
    rows = []
    for weight, results in outcome.items():
        shapes = [{"control_points": result["control_points"]} for result in results]
        assessed = service.call("POST", "/v1/dictionaries/nuclei/assess", {"shapes": shapes})["results"]
        outliers = sum(entry["novelty"]["is_outlier"] for entry in assessed)
        overlaps = [result["overlap"]["jaccard"] for result in results]
        rows.append(
            [
                weight,
                len(results),
                f"{mean(overlaps):.3f}",
                f"{min(overlaps):.3f}",
                sum(map(is_failed, results)),
                outliers,
            ]
        )
    return len(posted), rows


def table(head, rows):
    lines = ["| " + " | ".join(map(str, line)) + " |" for line in [head, ["---"] * len(head), *rows]]
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--binary", required=True)
    parser.add_argument("--write", type=Path, help="the document whose tables are replaced")
    arguments = parser.parse_args()
    data = arguments.data / "images-nuclei"
    images = list(csv.DictReader((data / "images.csv").open()))
    with tempfile.TemporaryDirectory(prefix="shapelex-nuclei-") as folder:
        service = Service(arguments.binary, Path(folder))
        try:
            head = ["terms", "images", "number", "nuclei", "mean Jaccard", "median", "failed", "silent", "a nucleus"]
            found = []
            for part in (0.1, 0.25):
                for energy in ENERGIES:
                    found += [[f"± {part:.0%}", *row] for row in rows_of(service, data, images, part, energy)]
            tables = {"nuclei": table(["initial boxes", *head], found)}
            learnt, rows = chain(service, data, images)
            tables["chain"] = table(
                ["weight of the prior", "nuclei", "mean Jaccard", "least", "failed", "called outliers"], rows
            )
        finally:
            service.process.kill()
    for name, text in tables.items():
        print(f"{name}\n{text}\n")
    if arguments.write:
        document = arguments.write.read_text()
        for name, text in tables.items():
            begin, end = f"<!-- {name} begins -->", f"<!-- {name} ends -->"
            head, rest = document.split(begin)
            document = head + begin + "\n" + text + "\n" + end + rest.split(end)[1]
        arguments.write.write_text(document)


if __name__ == "__main__":
    main()
