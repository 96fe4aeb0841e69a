"""Tables 4.1 and 4.2 of Schmitter's thesis: the mean of subspaces, functional PCA and the point distribution model on
one set, through the running service; prints the section of docs/evaluation.md.

    python benches/evaluation/models.py --data FOLDER [--binary PROGRAM] [NAME ...]

FOLDER holds the data sets (`curves-mosquito-wings/curves.ndjson` and so on); NAME chooses some of them. Nothing beyond
the standard library. The chromosomes of the thesis are not available: each set gives 20 shapes, evenly spaced in its
file, with 12 landmarks at equal arc lengths from the first point of the contour. The continuous models have these 12
control points (`cubic`), the point distribution model has the 12 landmarks (LR) or 50 points for each of them on the
same curve (HR, 600 points).

Table 4.1  normalised correlation of a representative shape with the shapes, each turned to fit best: mean of the
           subspaces, first uncentred component, Procrustes mean of 600 and of 12 points, the last one a polygon.
Table 4.2  squared relative error of the shapes from 4 components; and from the mean and 4 components.
"""

import argparse
import json
import math
import tempfile
from pathlib import Path
from statistics import mean, stdev

from robust import resampled
from run import ROOT, Service

SHAPES, LANDMARKS, FINE = 20, 12, 50
SETS = ["apodemus-mandibles", "mosquito-wings", "trilobite-heads", "hands"]
CURVE = {"kind": "closed_curve", "dimension": 2, "control_points": LANDMARKS, "generator": {"name": "cubic"}}
PRINT = {"mean": (0.980, 0.010), "component": (0.974, 0.013), "fine": (0.955, 0.001), "coarse": (0.844, 0.002)}


def read(folder, name):
    lines = open(Path(folder) / f"curves-{name}" / "curves.ndjson").read().splitlines()
    chosen = [json.loads(lines[k * len(lines) // SHAPES])["points"] for k in range(SHAPES)]
    return [[[p.real, p.imag] for p in resampled(points, LANDMARKS)] for points in chosen]


def complex_numbers(points):
    return [complex(*point) for point in points]


def samples(service, shapes, count=LANDMARKS * FINE):
    """The curves with these control points, at `count` parameters."""
    request = {"representation": CURVE, "shapes": [{"control_points": shape} for shape in shapes], "samples": count}
    return [found["points"] for found in service.call("POST", "/v1/evaluate", request)["evaluations"]]


def polygon(points):
    """A polygon at `FINE` points for each of its edges."""
    pairs = zip(points, points[1:] + points[:1])
    return [[a + (b - a) * k / FINE for a, b in zip(p, q)] for p, q in pairs for k in range(FINE)]


def correlation(model, shape):
    """Normalised correlation of two sampled curves about their means, after the best rotation and scaling."""
    model, shape = complex_numbers(model), complex_numbers(shape)
    a, b = ([p - sum(points) / len(points) for p in points] for points in (model, shape))
    size = lambda points: math.sqrt(sum(abs(p) ** 2 for p in points))
    return abs(sum(p.conjugate() * q for p, q in zip(a, b))) / (size(a) * size(b))


def pca(service, representation, shapes, centre, transformation="similarity", alignment="projection"):
    return service.call(
        "POST",
        "/v1/pca",
        {
            "representation": representation,
            "transformation": transformation,
            "alignment": alignment,
            "components": 4,
            "centre": centre,
            "aligned": False,
            "shapes": [{"points": shape} for shape in shapes],
        },
    )


def points(count):
    return {"kind": "landmarks", "dimension": 2, "points": count}


def spread(values, digits):
    return f"{mean(values):.{digits}f} ± {stdev(values):.{digits}f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True)
    parser.add_argument("--binary", default=str(ROOT / "target/release/shapelex"))
    parser.add_argument("names", nargs="*", default=[])
    options = parser.parse_args()
    correlations, errors = [], []
    with tempfile.TemporaryDirectory() as folder:
        service = Service(options.binary, folder)
        try:
            for name in options.names or SETS:
                shapes = read(options.data, name)
                curves = samples(service, shapes)
                uncentred = pca(service, CURVE, shapes, False)
                centred = pca(service, CURVE, shapes, True)
                affine = pca(service, CURVE, shapes, True, "affine")
                affine_plain = pca(service, CURVE, shapes, False, "affine")
                fine = pca(service, points(LANDMARKS * FINE), curves, True, alignment="procrustes")
                coarse = pca(service, points(LANDMARKS), shapes, True, alignment="procrustes")
                control_points = [
                    uncentred["mean"]["control_points"],
                    uncentred["pca"]["eigenshapes"][0]["control_points"],
                ]
                models = [
                    *samples(service, control_points),
                    fine["mean"]["control_points"],
                    polygon(coarse["mean"]["control_points"]),
                ]
                found = [[correlation(model, curve) for curve in curves] for model in models]
                correlations.append((name, found, uncentred["pca"]["explained"][0]))
                models = [uncentred, centred, affine_plain, affine, fine, coarse]
                errors.append((name, [[1000 * e for e in model["pca"]["reconstruction_errors"]] for model in models]))
        finally:
            service.process.terminate()
    print(
        "| set (20 shapes) | mean of the subspaces | first component | PDM, 600 points | PDM, 12 points | share "
        "of the first component |"
    )
    print("|---|---|---|---|---|---|")
    print("| *thesis: chromosomes* | " + " | ".join(f"*{m:.3f} ± {s:.3f}*" for m, s in PRINT.values()) + " | *0.96* |")
    for name, found, share in correlations:
        print(f"| {name} | {' | '.join(spread(values, 4) for values in found)} | {share:.3f} |")
    print()
    print(
        "| set, errors in thousandths | 4 components | mean and 4 components | 4 components, affine | mean and 4, "
        "affine "
        "| PDM (mean and 4), 600 points | PDM, 12 points |"
    )
    print("|---|---|---|---|---|---|---|")
    print("| *thesis: chromosomes* | *8* | – | – | – | *50* | – |")
    for name, found in errors:
        print(f"| {name} | {' | '.join(spread(values, 2) for values in found)} |")


main()
