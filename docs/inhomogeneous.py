"""The experiment of `docs/inhomogeneous.md`, against a running service.

    python docs/inhomogeneous.py http://127.0.0.1:8080 curves.ndjson FOLDER

`curves.ndjson`: the MPEG-7 contours, one JSON object per line with `label` and `points`. Prints the tables and writes
the pictures of the atoms into FOLDER. Needs only Python.
"""

import json
import math
import statistics
import sys
import urllib.request
from pathlib import Path

CLASSES = ["bone", "bottle", "fork", "heart", "key"]
TRAINED, TESTED = 10, 4
# With an odd number of control points the trigonometric generator is orthonormal: products of curves are those of
# points.
REPRESENTATION = {"kind": "closed_curve", "dimension": 2, "control_points": 101, "generator": {"name": "trigonometric"}}
METHODS = {
    "D5": {"kind": "sparse", "atoms": 5, "lambda": 0.01},
    "D10": {"kind": "sparse", "atoms": 10, "lambda": 0.01},
    "D10, five": {"kind": "sparse", "atoms": 10, "nonzeros": 5},
    "D5, moved": {"kind": "sparse", "atoms": 5, "nonzeros": 1, "codes": "invariant"},
    "D10, moved": {"kind": "sparse", "atoms": 10, "nonzeros": 2, "codes": "invariant"},
    "fPCA 5": {"kind": "functional_pca", "components": 5},
    "fPCA 10": {"kind": "functional_pca", "components": 10},
}


def call(method, url, body=None, **headers):
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"content-type": "application/json", **headers}, method=method)
    try:
        with urllib.request.urlopen(request) as answer:
            return answer.read()
    except urllib.error.HTTPError as error:
        sys.exit(f"{method} {url}: {error.read().decode()}")


def post(url, body, **headers):
    return json.loads(call("POST", url, body, **headers))


def complex_points(rows):
    """A curve about its mean position, of unit norm."""
    z = [complex(*row) for row in rows]
    centre = sum(z) / len(z)
    size = math.sqrt(sum(abs(p - centre) ** 2 for p in z))
    return [(p - centre) / size for p in z]


def correlation(shape, atom):
    """Cosine of a shape and an atom up to similarity, over all start points."""
    n = len(shape)
    return max(abs(sum(shape[(k + s) % n].conjugate() * atom[k] for k in range(n))) for s in range(n))


def table(title, names, rows, decimals):
    print(f"\n{title}\n\n| shape | " + " | ".join(names) + " |\n|---|" + "---|" * len(names))
    for label in CLASSES:
        of_class = [values for row_label, values in rows if row_label == label]
        for number, values in enumerate(of_class, 1):
            print(f"| {label} {number} | " + " | ".join(f"{value:.{decimals}f}" for value in values) + " |")
        means = [statistics.mean(column) for column in zip(*of_class)]
        spreads = [statistics.stdev(column) for column in zip(*of_class)]
        print(f"| **{label} mean** | " + " | ".join(f"**{value:.{decimals}f}**" for value in means) + " |")
        print(f"| {label} std | " + " | ".join(f"{value:.{decimals}f}" for value in spreads) + " |")
    means = [statistics.mean(column) for column in zip(*(values for _, values in rows))]
    print("| **all, mean** | " + " | ".join(f"**{value:.{decimals}f}**" for value in means) + " |")


def main():
    base, data, folder = sys.argv[1].rstrip("/") + "/v1", Path(sys.argv[2]), Path(sys.argv[3])
    folder.mkdir(parents=True, exist_ok=True)
    contours = {label: [] for label in CLASSES}
    for line in data.read_text().splitlines():
        contour = json.loads(line)
        if contour["label"] in contours:
            contours[contour["label"]].append(contour["points"])
    parts = {"training": slice(0, TRAINED), "testing": slice(TRAINED, TRAINED + TESTED)}
    for name, part in parts.items():
        post(
            f"{base}/cohorts",
            {"name": name, "correspondence": "cyclic", "direction": "either", "representation": REPRESENTATION},
        )
        shapes = [
            {"external_id": f"{label}-{i}", "label": label, "points": points}
            for label in CLASSES
            for i, points in enumerate(contours[label][part])
        ]
        post(f"{base}/cohorts/{name}/shapes", {"shapes": shapes})
    ids = [f"{label}-{i}" for label in CLASSES for i in range(TESTED)]
    asked = {"cohort": "testing", "ids": ids}
    correlations, errors, numbers = [], [], []
    for name, method in METHODS.items():
        key = name.replace(",", "").replace(" ", "-")
        dictionary = post(
            f"{base}/dictionaries",
            {"name": key, "cohort": "training", "transformation": "similarity", "method": method},
            prefer="wait=60",
        )
        atoms = [complex_points(atom["control_points"]) for atom in dictionary["atoms"]]
        stored = [json.loads(call("GET", f"{base}/cohorts/testing/shapes/{urllib.request.quote(i)}")) for i in ids]
        shapes = [complex_points(shape["control_points"]) for shape in stored]
        correlations.append([max(correlation(shape, atom) for atom in atoms) for shape in shapes])
        url = f"{base}/dictionaries/{key}"
        errors.append(
            [shape["relative_error"] for shape in post(f"{url}/reconstruct", {**asked, "pose": "model"})["results"]]
        )
        codes = post(f"{url}/encode", asked)["results"]
        numbers.append(statistics.mean(code["parameters"] for code in codes))
        (folder / f"{key}.svg").write_bytes(call("GET", f"{url}/atoms?format=svg"))
    labels = [label for label in CLASSES for _ in range(TESTED)]
    table(
        "Correlation of the best atom with each test shape (as Table 4.3)",
        list(METHODS),
        list(zip(labels, zip(*correlations))),
        3,
    )
    table("Reconstruction error of each test shape (as Table 4.4)", list(METHODS), list(zip(labels, zip(*errors))), 4)
    print("\nReal numbers in a code, mean: " + ", ".join(f"{n} {v:.1f}" for n, v in zip(METHODS, numbers)))


if __name__ == "__main__":
    main()
