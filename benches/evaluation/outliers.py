"""Planted gross errors: how many a dictionary calls outliers, and how many other shapes.

    python benches/evaluation/outliers.py [--binary target/release/shapelex] [--cohorts 20] [--shapes 400] [--points 64]
    [--components 20]

Needs numpy. Contours about one outline, with smooth waves and measurement noise; some have a gross error of their own:
a lobe (a half wave on a seventh of the contour, half a radius high or more), two points in each other's place (an
eighth of the contour apart or more), or noise of ten deviations of a radius. They stand first, last, spread at equal
distances, or at random places. Percentages at `quantile` 0.99: of the planted ones that are found, least of all cohorts
too; of 2000 new contours without errors that are called outliers, with least and most of the cohorts; cohorts without
errors are the first row. The last column compares the flags of the same cohort in four orders.
"""

import argparse
import math
import tempfile

import numpy
from run import ROOT, Service

RATES = [0.005, 0.02, 0.05, 0.1]
NEW = 2000


def contours(random, count, points):
    t = 2 * math.pi * numpy.arange(points) / points
    k = numpy.arange(2, 14)
    size = 0.12 / (k - 1.0) ** 1.3
    waves = random.standard_normal((2, count, len(k))) * size
    radius = 1 + 0.2 * numpy.cos(2 * t) + 0.15 * numpy.cos(3 * t + 0.4)
    radius = radius + waves[0] @ numpy.cos(numpy.outer(k, t)) + waves[1] @ numpy.sin(numpy.outer(k, t))
    noise = random.standard_normal((2, count, points)) * 0.004
    deviation = math.sqrt((size**2).sum())
    return radius * numpy.exp(1j * t) + noise[0] + 1j * noise[1], deviation


def spoilt(contour, kind, random, deviation):
    contour, n = contour.copy(), len(contour)
    if kind == "lobe":
        stretch, first, height = round(n / 7), random.integers(n), random.uniform(0.5, 1)
        for i in range(stretch):
            k = (first + i) % n
            contour[k] += height * math.sin(math.pi * (i + 0.5) / stretch) * numpy.exp(2j * math.pi * k / n)
    elif kind == "swap":
        i = random.integers(n)
        j = (i + random.integers(n // 8, n - n // 8 + 1)) % n
        contour[[i, j]] = contour[[j, i]]
    else:
        contour += 10 * deviation * (random.standard_normal(n) + 1j * random.standard_normal(n))
    return contour


def places(where, count, wrong, random):
    if where == "first":
        return numpy.arange(wrong)
    if where == "last":
        return numpy.arange(count - wrong, count)
    if where == "spread":
        return numpy.arange(wrong) * (count // max(wrong, 1))
    return random.choice(count, wrong, replace=False)


def posted(shapes):
    return [{"points": [[p.real, p.imag] for p in shape.tolist()]} for shape in shapes]


class Study:
    def __init__(self, service, arguments):
        self.service, self.arguments, self.number = service, arguments, 0

    def flags(self, shapes, *others):
        """Which of the shapes that a dictionary is learnt from, and of others, it calls outliers."""
        self.number += 1
        name = f"planted-{self.number}"
        points = self.arguments.points
        self.service.cohort(name, {"kind": "landmarks", "dimension": 2, "points": points}, "landmarks", posted(shapes))
        method = {"kind": "functional_pca", "components": self.arguments.components, "centre": True}
        body = {"name": name, "cohort": name, "transformation": "similarity", "method": method}
        self.service.finished(self.service.call("POST", "/v1/dictionaries", body))
        return [self.scored(name, part) for part in (shapes, *others)]

    def scored(self, name, shapes):
        flags = []
        for first in range(0, len(shapes), 1000):
            body = {"shapes": posted(shapes[first : first + 1000]), "quantile": 0.99}
            answer = self.service.call("POST", f"/v1/dictionaries/{name}/score", body)
            flags += [result["novelty"]["is_outlier"] for result in answer["results"]]
        return numpy.array(flags)

    def cohort(self, kind, rate, seed):
        random = numpy.random.default_rng(seed)
        shapes, deviation = contours(random, self.arguments.shapes, self.arguments.points)
        wrong = round(rate * len(shapes))
        where = ["first", "last", "spread", "random"][seed % 4]
        at = places(where, len(shapes), wrong, random)
        for k in at:
            shapes[k] = spoilt(shapes[k], kind, random, deviation)
        return shapes, at, contours(random, NEW, self.arguments.points)[0]

    def row(self, kind, rate):
        found, alarms = [], []
        for seed in range(self.arguments.cohorts):
            shapes, at, new = self.cohort(kind, rate, seed)
            flags, others = self.flags(shapes, new)
            alarms.append(100 * others.mean())
            found.append(100 * flags[at].mean() if len(at) else math.nan)
        told = f"{numpy.mean(found):.1f} | {min(found):.1f}" if rate else "– | –"
        print(
            f"| {kind if rate else 'none'} | {100 * rate:g} % | {told} | {numpy.mean(alarms):.2f} | "
            f"{min(alarms):.2f}–{max(alarms):.2f} |",
            flush=True,
        )

    def orders(self):
        """The flags of a cohort with 1 % of errors in four orders."""
        shapes, at, _ = self.cohort("noise", 0.01, 3)
        count = len(shapes)
        behind = numpy.setdiff1d(numpy.arange(count), at)
        every = numpy.empty(count, int)
        step = count // len(at)
        every[numpy.arange(len(at)) * step] = at
        every[numpy.setdiff1d(numpy.arange(count), numpy.arange(len(at)) * step)] = behind
        told = []
        for order in [numpy.arange(count), numpy.arange(count)[::-1], numpy.concatenate([at, behind]), every]:
            flags = numpy.zeros(count, bool)
            flags[order] = self.flags(shapes[order])[0]
            told.append(flags)
        same = all((flags == told[0]).all() for flags in told)
        print(
            f"\nFour orders of {count} contours, {len(at)} with noise: {told[0][at].sum()} found, flags "
            f"{'the same' if same else 'differ'}."
        )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", default=ROOT / "target/release/shapelex")
    parser.add_argument("--cohorts", type=int, default=20)
    parser.add_argument("--shapes", type=int, default=400)
    parser.add_argument("--points", type=int, default=64)
    parser.add_argument("--components", type=int, default=20)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        service = Service(arguments.binary, folder)
        try:
            study = Study(service, arguments)
            print(
                f"{arguments.shapes} contours of {arguments.points} points, {arguments.components} components, "
                f"{arguments.cohorts} cohorts\n"
            )
            print("| gross error | planted | found, % | least | false alarms, % | least–most |")
            print("|---|---|---|---|---|---|")
            study.row("lobe", 0)
            for kind in ["lobe", "swap", "noise"]:
                for rate in RATES:
                    study.row(kind, rate)
            study.orders()
        finally:
            service.process.terminate()


if __name__ == "__main__":
    main()
