"""Completion of shapes and the coverage of its bands on real shapes, through the running service; prints the section of
docs/evaluation.md.

    python benches/evaluation/partial.py --data FOLDER [--binary PROGRAM] [--folds 5] [--only complete|modes|speed]
    [NAME ...]

FOLDER holds the data sets (`curves-mosquito-wings/curves.ndjson` and so on); NAME chooses some of them. `modes` needs
numpy, the other parts nothing beyond the standard library. Closed contours are resampled to 63 points by arc length
from their first point (`trigonometric` generator), olive stones to 63 points of an open polyline; hands keep their 56
points, which correspond. Landmarks are as they are. At most 240 shapes of a set, evenly spread. Seeds are fixed.

complete  five folds of shapes, or of subjects where a set has them. Dictionaries of 20 components (fewer where there
          are fewer) are learnt from the others. Of each held-out shape, turned, moved and scaled at random, 20 % are
          hidden twice: an arc of curves, any of the landmarks. Root mean square error of the hidden part over the
          centroid size, times the root of the number of points; the same of the mean, posed by what is seen; coverage
          of the bands at 95 % before and after calibration; how many of these parts `assess` calls outliers. Pose and
          shape are found together; the start point is that of the source. Sets of fewer than 60 shapes, and olive
          stones, are divided into folds five times. Intervals cover 95 %, a subject is one case.
modes     a random 30 % of the shapes miss 20 % of their points, twice for each set: angles of the first three modes to
          those of the complete shapes; the same (medians of nine draws) where as many coordinates are left out as whole
          shapes, 6 % of them.
speed     requests of one shape of 100 control points and 20 modes, a fifth of it hidden elsewhere each time.
"""

import argparse
import csv
import http.client
import json
import math
import tempfile
import time
from pathlib import Path
from random import Random
from statistics import mean, median, quantiles

from run import ROOT, Service

POINTS = 63
MOST = 240
HIDDEN = 0.2
COMPONENTS = 20
TIMES = 2
# Divisions into folds: one division of 18 shapes has 36 hidden parts.
FEW, DIVISIONS, SCATTERED = 60, 5, ["olive-stones"]
INCOMPLETE, DRAWS, LEFT_OUT = 0.3, 2, 9
# Samples between two control points by which inner products of closed curves are summed.
FINE = 64
MODES = [
    "mosquito-wings",
    "hearts",
    "hands",
    "molars",
    "trilobite-heads",
    "mouse-molars",
    "landmarks-pupfish",
    "landmarks-plethodon",
    "landmarks-oak-leaves",
    "landmarks-brains-3d",
]
CLOSED = [
    "mosquito-wings",
    "hearts",
    "molars",
    "otoliths",
    "apodemus-mandibles",
    "trilobite-heads",
    "mouse-molars",
    "mouse-vertebrae",
    "north-sea-fish",
    "charred-grains",
    "osteosarcoma-cells",
    "mpeg7",
]
OPEN = ["hands", "olive-stones"]
CORRESPONDING = ["hands"]
LANDMARKS = [
    "ape-skulls",
    "digit3",
    "mosquito-wings",
    "oak-leaves",
    "passiflora-leaves",
    "plethodon",
    "pupfish",
    "pupfish-species",
    "rat-growth",
    "brains-3d",
    "macaque-skulls-3d",
    "nasal-bone-3d",
    "optic-nerve-3d",
    "primate-crania-3d",
]
TPS = {"dragonfly-wings": "forewing.tps", "trilobite-cephala": "cephala.tps"}
SUBJECTS = {"molars": "ind", "charred-grains": "grain", "optic-nerve-3d": "monkey"}


def resampled(points, closed, count=POINTS):
    """`count` points equally spaced by arc length."""
    line = [p for k, p in enumerate(points) if k == 0 or p != points[k - 1]]
    line = line + line[:1] if closed else line
    lengths = [0.0]
    for p, q in zip(line, line[1:]):
        lengths.append(lengths[-1] + math.dist(p, q))
    found, at = [], 0
    for k in range(count):
        wanted = lengths[-1] * k / (count if closed else count - 1)
        while at + 2 < len(lengths) and lengths[at + 1] < wanted:
            at += 1
        part = min((wanted - lengths[at]) / (lengths[at + 1] - lengths[at]), 1.0)
        found.append([a + part * (b - a) for a, b in zip(line[at], line[at + 1])])
    return found


def normal(points):
    """Centroid at the origin, centroid size one."""
    d = len(points[0])
    centre = [mean(p[c] for p in points) for c in range(d)]
    size = math.sqrt(sum((p[c] - centre[c]) ** 2 for p in points for c in range(d)))
    return [[(p[c] - centre[c]) / size for c in range(d)] for p in points]


def some(shapes):
    """At most MOST of them, evenly spread."""
    return shapes if len(shapes) <= MOST else [shapes[k * len(shapes) // MOST] for k in range(MOST)]


def contours(folder, name):
    closed, shapes = name in CLOSED, []
    for k, text in enumerate(open(Path(folder) / f"curves-{name}" / "curves.ndjson")):
        given = json.loads(text)
        points = given["points"]
        if closed and sum(p[0] * q[1] - q[0] * p[1] for p, q in zip(points, points[1:] + points[:1])) < 0:
            points = points[:1] + points[:0:-1]
        subject = str(given["labels"][SUBJECTS[name]]) if name in SUBJECTS else str(k)
        shapes.append((normal(points if name in CORRESPONDING else resampled(points, closed)), subject))
    return some(shapes)


def configurations(folder, name):
    shapes = []
    with open(Path(folder) / f"landmarks-{name}" / "landmarks.csv", newline="") as file:
        for k, row in enumerate(csv.DictReader(file)):
            count = sum(1 for key in row if key[0] == "x" and key[1:].isdigit())
            axes = "xyz" if "z1" in row else "xy"
            points = [[float(row[f"{axis}{i}"]) for axis in axes] for i in range(1, count + 1)]
            if all(math.isfinite(x) for p in points for x in p):
                shapes.append((normal(points), row[SUBJECTS[name]] if name in SUBJECTS else str(k)))
    return some(shapes)


def tps(folder, name):
    """Landmarks of the commonest number, without curves."""
    shapes, lines = [], iter(open(Path(folder) / f"landmarks-{name}" / TPS[name]))
    for text in lines:
        if text.upper().startswith("LM="):
            points = [[float(x) for x in next(lines).split()[:2]] for _ in range(int(text.split("=")[1]))]
            if all(math.isfinite(x) for p in points for x in p):
                shapes.append(points)
    counts = [len(points) for points in shapes]
    count = max(set(counts), key=counts.count)
    return some([(normal(points), str(k)) for k, points in enumerate(shapes) if len(points) == count])


def moved(points, random):
    """Turned, scaled and moved at random."""
    d = len(points[0])
    for a in range(d):
        for b in range(a + 1, d):
            t = random.uniform(0, 2 * math.pi)
            s, c = math.sin(t), math.cos(t)
            points = [
                [c * p[a] - s * p[b] if k == a else s * p[a] + c * p[b] if k == b else p[k] for k in range(d)]
                for p in points
            ]
    size, shift = random.uniform(0.5, 20), [random.uniform(-50, 50) for _ in range(d)]
    return [[size * x + t for x, t in zip(p, shift)] for p in points], size


def hidden_part(count, is_arc, closed, random):
    number = max(1, round(HIDDEN * count))
    if not is_arc:
        return set(random.sample(range(count), number))
    begin = random.randrange(count if closed else count - number + 1)
    return {(begin + i) % count for i in range(number)}


def distance(away, covariance):
    """`√(δᵀ C⁻¹ δ)` by elimination."""
    d = len(away)
    rows = [[*covariance[i], away[i]] for i in range(d)]
    for i in range(d):
        for j in range(i + 1, d):
            factor = rows[j][i] / rows[i][i]
            rows[j] = [x - factor * y for x, y in zip(rows[j], rows[i])]
    solved = [0.0] * d
    for i in reversed(range(d)):
        solved[i] = (rows[i][d] - sum(rows[i][j] * solved[j] for j in range(i + 1, d))) / rows[i][i]
    return math.sqrt(max(sum(a * b for a, b in zip(away, solved)), 0.0))


def folds_of(shapes, count, random):
    subjects = sorted({subject for _, subject in shapes})
    random.shuffle(subjects)
    fold = {subject: k % count for k, subject in enumerate(subjects)}
    return [[k for k, (_, subject) in enumerate(shapes) if fold[subject] == f] for f in range(count)]


def by_subject(values):
    """Mean of (subject, value) in percent, and its 95 % interval with a subject as one case."""
    own = {}
    for subject, value in values:
        own.setdefault(subject, []).append(value)
    found, count = mean(value for _, value in values), len(own)
    # Sums of what each subject adds to the mean: subjects with more parts count more.
    share = [sum(value - found for value in one) / len(values) for one in own.values()]
    half = 1.96 * math.sqrt(sum(x * x for x in share) * count / max(count - 1, 1))
    return f"{100 * found:.1f} % ({100 * max(found - half, 0):.1f}–{100 * min(found + half, 1):.1f})"


class Errors:
    def __init__(self):
        self.mean, self.found, self.points, self.whole, self.raw, self.alarms = [], [], [], [], [], {}

    def add(self, subject, truth, size, hidden, completed, posed, answer):
        scale = math.sqrt(len(truth)) / size
        rms = lambda shape: scale * math.sqrt(mean(math.dist(truth[i], shape[i]) ** 2 for i in hidden))
        self.found.append(rms(completed["bands"]["points"]))
        self.mean.append(rms(posed["control_points"]))
        bands, f, g = completed["bands"], answer["pointwise_factor"], answer["simultaneous_factor"]
        far = [distance([a - b for a, b in zip(truth[i], bands["points"][i])], bands["covariances"][i]) for i in hidden]
        self.points.append(mean(x <= f for x in far))
        self.whole.append((subject, max(far) <= g))
        self.raw.append(mean(x <= self.normal for x in far))


def complete_fold(service, own, shapes, test, representation, is_arc, closed, random, errors):
    train = [shape for k, shape in enumerate(shapes) if k not in set(test)]
    service.cohort(
        own, representation, "landmarks", [{"points": points, "subject": subject} for points, subject in train]
    )
    service.finished(
        service.call(
            "POST",
            "/v1/dictionaries",
            {
                "name": own,
                "cohort": own,
                "transformation": "similarity",
                "alignment": "procrustes",
                "method": {"kind": "functional_pca", "components": COMPONENTS, "centre": True},
            },
        )
    )
    truths, partial = [], []
    for k in test:
        for _ in range(TIMES):
            points, size = moved(shapes[k][0], random)
            hidden = hidden_part(len(points), is_arc, closed, random)
            truths.append((shapes[k][1], points, size, sorted(hidden)))
            partial.append([None if i in hidden else p for i, p in enumerate(points)])
    path, parts = f"/v1/dictionaries/{own}/complete", [{"control_points": part} for part in partial]
    answer = service.call("POST", path, {"shapes": parts})
    # A measurement that says nothing leaves the mean, posed by the seen points.
    posed = service.call(
        "POST",
        path,
        {
            "calibrated": False,
            "shapes": [{**part, "deviation": 1e4 * size} for part, (_, _, size, _) in zip(parts, truths)],
        },
    )
    errors.normal = service.call("POST", path, {"calibrated": False, "shapes": parts[:1]})["pointwise_factor"]
    for truth, completed, by_mean in zip(truths, answer["results"], posed["results"]):
        errors.add(*truth, completed, by_mean, answer)
    for quantile in (0.95, 0.99):
        found = service.call("POST", f"/v1/dictionaries/{own}/assess", {"quantile": quantile, "shapes": parts})[
            "results"
        ]
        alarms = [(subject, one["novelty"]["is_outlier"]) for (subject, *_), one in zip(truths, found)]
        errors.alarms.setdefault(quantile, []).extend(alarms)


def complete_set(service, name, shapes, representation, is_arc, closed, count_of_folds):
    random, errors = Random(11), Errors()
    divisions = DIVISIONS if len(shapes) < FEW or name in SCATTERED else 1
    for division in range(divisions):
        for f, test in enumerate(folds_of(shapes, count_of_folds, random)):
            complete_fold(
                service, f"{name}-{division}-{f}", shapes, test, representation, is_arc, closed, random, errors
            )
    ratio = mean(errors.mean) / mean(errors.found)
    covered = [100 * mean(x) for x in (errors.raw, errors.points)]
    print(
        f"| {name} | {len(shapes)} | {mean(errors.mean):.4f} | {mean(errors.found):.4f} | {ratio:.2f} | "
        f"{covered[0]:.1f} % | {covered[1]:.1f} % "
        f"| {by_subject(errors.whole)} | {by_subject(errors.alarms[0.95])}, "
        f"{100 * mean(x for _, x in errors.alarms[0.99]):.1f} % |",
        flush=True,
    )


def sets(folder, names):
    """Every set that is wanted: its name, shapes and representation, whether arcs are hidden, and whether its curves
    are closed."""
    for name in filter(lambda name: name in names, CLOSED):
        curve = {
            "kind": "closed_curve",
            "dimension": 2,
            "control_points": POINTS,
            "generator": {"name": "trigonometric"},
        }
        yield name, contours(folder, name), curve, True, True
    for name in filter(lambda name: name in names, OPEN):
        shapes = contours(folder, name)
        line = {
            "kind": "open_curve",
            "dimension": 2,
            "intervals": len(shapes[0][0]) - 1,
            "generator": {"name": "bspline", "degree": 1},
        }
        yield name, shapes, line, True, False
    for name in filter(lambda name: f"landmarks-{name}" in names, [*LANDMARKS, *TPS]):
        shapes = tps(folder, name) if name in TPS else configurations(folder, name)
        points = shapes[0][0]
        representation = {"kind": "landmarks", "dimension": len(points[0]), "points": len(points)}
        yield f"landmarks-{name}", shapes, representation, False, False


def complete(service, folder, names, folds):
    print(
        "| set | shapes | hidden part, posed mean | completed | ratio | normal bands cover | pointwise | "
        "simultaneous, interval "
        "| false alarms of `assess` at 5 %, 1 % |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for one in sets(folder, names or [*CLOSED, *OPEN, *(f"landmarks-{name}" for name in [*LANDMARKS, *TPS])]):
        complete_set(service, *one, folds)


def gram(service, representation):
    """The inner products of the generators, up to a factor."""
    import numpy

    count = representation.get("control_points") or representation.get("points") or representation["intervals"] + 1
    if representation["kind"] == "open_curve":
        # Hat functions.
        metric = 4 * numpy.eye(count) + numpy.eye(count, k=1) + numpy.eye(count, k=-1)
        metric[0, 0] = metric[-1, -1] = 2
        return metric
    if representation["kind"] == "landmarks":
        return numpy.eye(count)
    impulse = [[float(k == 0), 0.0] for k in range(count)]
    answer = service.call(
        "POST",
        "/v1/evaluate",
        {"representation": representation, "shapes": [{"control_points": impulse}], "samples": FINE * count},
    )
    values = numpy.array(answer["evaluations"][0]["points"])[:, 0]
    products = [values @ numpy.roll(values, FINE * k) for k in range(count)]
    return numpy.array([numpy.roll(products, k) for k in range(count)])


def components(service, representation, shapes):
    """Modes and mean as arrays, whitened, with the number of rounds and whether the last one changed nothing."""
    import numpy

    # A pose is 4 numbers in the plane and 7 in space.
    numbers = len(shapes[0]) * representation["dimension"]
    most = numbers - (5 if representation["dimension"] == 2 else 8)
    body = {
        "representation": representation,
        "transformation": "similarity",
        "alignment": "procrustes",
        "components": min(COMPONENTS, len(shapes) - 2, most),
        "shapes": [{"control_points": shape} for shape in shapes],
    }
    answer = service.call("POST", "/v1/pca/incomplete", body)
    modes = numpy.array([one["control_points"] for one in answer["pca"]["eigenshapes"]])
    metric = gram(service, representation)
    root = numpy.linalg.cholesky(metric).T
    modes = numpy.einsum("ij,mjc->mic", root, modes)
    modes /= numpy.linalg.norm(modes[0])
    product = numpy.einsum("mic,nic->mn", modes, modes)
    assert abs(product - numpy.eye(len(modes))).max() < 1e-6, "modes are orthonormal in this metric"
    return (
        modes,
        root @ numpy.array(answer["pca"]["mean"]["control_points"]),
        answer["completion_rounds"],
        answer["completion_converged"],
    )


def mode_angles(found, wanted):
    """Angles of the first three modes in degrees, after the rotation that brings one mean onto the other."""
    import numpy

    (modes, middle, *_), (goals, goal, *_) = found, wanted
    u, _, vt = numpy.linalg.svd(middle.T @ goal)
    u[:, -1] *= numpy.sign(numpy.linalg.det(u @ vt))
    turn = u @ vt
    return [
        math.degrees(math.acos(min(1.0, abs(float(((mode @ turn) * other).sum())))))
        for mode, other in zip(modes[:3], goals[:3])
    ]


def modes(service, folder, names, folds):
    print("| set | shapes, incomplete | rounds | angles | 6 % of the shapes left out |")
    print("|---|---|---|---|---|")
    for name, given, representation, is_arc, closed in sets(folder, names or MODES):
        shapes, random = [points for points, _ in given], Random(17)
        wanted = components(service, representation, shapes)
        draws = []
        for _ in range(LEFT_OUT):
            kept = sorted(random.sample(range(len(shapes)), round((1 - INCOMPLETE * HIDDEN) * len(shapes))))
            draws.append(mode_angles(components(service, representation, [shapes[k] for k in kept]), wanted))
        without = ", ".join(f"{median(column):.1f}" for column in zip(*draws)) + "°"
        for draw in range(DRAWS):
            partial, count = [], 0
            for points in shapes:
                hidden = hidden_part(len(points), is_arc, closed, random) if random.random() < INCOMPLETE else set()
                count += bool(hidden)
                partial.append([None if i in hidden else p for i, p in enumerate(points)])
            found = components(service, representation, partial)
            angles = ", ".join(f"{angle:.1f}" for angle in mode_angles(found, wanted))
            print(
                f"| {name if draw == 0 else ''} | {len(shapes)}, {count} | "
                f"{found[2]}{'' if found[3] else chr(92) + '*'} | {angles}° "
                f"| {without if draw == 0 else ''} |",
                flush=True,
            )


def speed(service, folder, names, folds):
    shapes = []
    for text in open(Path(folder) / "curves-mosquito-wings" / "curves.ndjson"):
        shapes.append({"points": normal(resampled(json.loads(text)["points"], True, 100))})
    curve = {"kind": "closed_curve", "dimension": 2, "control_points": 100, "generator": {"name": "cubic"}}
    service.cohort("speed", curve, "landmarks", shapes)
    service.finished(
        service.call(
            "POST",
            "/v1/dictionaries",
            {
                "name": "speed",
                "cohort": "speed",
                "transformation": "similarity",
                "method": {"kind": "functional_pca", "components": 20, "centre": True},
            },
        )
    )
    host = service.address.split("//")[1]
    connection, times = http.client.HTTPConnection(host), []
    for k in range(401):
        points = shapes[k % len(shapes)]["points"]
        part = [{"at": i / 100, "point": p} for i, p in enumerate(points) if (i - 7 * k) % 100 >= 20]
        body = json.dumps({"shapes": [{"points": part}]})
        begin = time.perf_counter()
        connection.request("POST", "/v1/dictionaries/speed/complete", body, {"content-type": "application/json"})
        answer = connection.getresponse()
        answer.read()
        assert answer.status == 200, answer.status
        times.append(1000 * (time.perf_counter() - begin))
    print(
        f"first request, with calibration: {times[0]:.0f} ms; then p50 {median(times[1:]):.2f} ms, p95 "
        f"{quantiles(times[1:], n=20)[18]:.2f} ms"
    )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", required=True)
    parser.add_argument("--binary", default=ROOT / "target/release/shapelex")
    parser.add_argument("--folds", type=int, default=5)
    parser.add_argument("--only", choices=["complete", "modes", "speed"])
    parser.add_argument("names", nargs="*")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        service = Service(arguments.binary, folder)
        try:
            for part in [complete, modes, speed]:
                if arguments.only in (None, part.__name__):
                    part(service, arguments.data, arguments.names, arguments.folds)
                    print()
        finally:
            service.process.terminate()


if __name__ == "__main__":
    main()
