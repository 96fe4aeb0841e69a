"""Robust means, components and weights on real shapes, through the running service; writes the section of
docs/evaluation.md.

    python benches/evaluation/robust.py --data FOLDER [--binary PROGRAM] [--part gross|clean|damage|cost|picture]
    [--seed SEED] [NAME ...]

FOLDER holds the data sets (`curves-mosquito-wings/curves.ndjson` and so on); NAME chooses some of them. Nothing beyond
the standard library. Contours are resampled to 63 points by arc length and posted with the `trigonometric` generator,
whose Gram matrix is that of points (`I/N` for odd `N`), so that angles between modes are those of their control points.
Seeds are fixed.

gross   30 % of the shapes are wrong: another organ, mirrored, leaked, or a third of each. How far the mean moves
        (distance of means of unit norm, after the best rotation), and the angles of the first three modes, to those of
        the right shapes alone. The wrong shapes are drawn by SEED, 1 by default.
clean   no shape is wrong: what robustness costs. Shapes drawn from the normal distribution with the components of the
        set, 40 times: mean squared error of the mean and of the first mode, plain over robust. And the real set: by how
        much its weights are worth fewer shapes.
damage  10 % of the contour of every fifth shape is displaced: area under the curve of `1 - point_weights` for the
        damaged points.
cost    time of robust over plain requests.
picture damaged shapes with their weights, as SVG.
"""

import argparse
import json
import math
import tempfile
import time
from pathlib import Path
from random import Random

from run import ROOT, Service

POINTS = 63
SETS = ["mosquito-wings", "molars", "apodemus-mandibles", "trilobite-heads", "hearts", "north-sea-fish"]
KINDS = ["organ", "mirrored", "leaked", "mixed"]
REPRESENTATION = {
    "kind": "closed_curve",
    "dimension": 2,
    "control_points": POINTS,
    "generator": {"name": "trigonometric"},
}


def resampled(points, count=POINTS):
    """The contour at `count` points, equally spaced by arc length from its first point, counter-clockwise, as complex
    numbers."""
    ring = [complex(*p) for p in points]
    ring = [p for k, p in enumerate(ring) if p != ring[k - 1]]
    if sum((p.conjugate() * q).imag for p, q in zip(ring, ring[1:] + ring[:1])) < 0:
        ring = ring[:1] + ring[:0:-1]
    ring.append(ring[0])
    lengths = [0.0]
    for p, q in zip(ring, ring[1:]):
        lengths.append(lengths[-1] + abs(q - p))
    found, at = [], 0
    for k in range(count):
        wanted = lengths[-1] * k / count
        while lengths[at + 1] < wanted:
            at += 1
        part = (wanted - lengths[at]) / (lengths[at + 1] - lengths[at])
        found.append(ring[at] + part * (ring[at + 1] - ring[at]))
    return normal(found)


def normal(shape):
    centre = sum(shape) / len(shape)
    size = math.sqrt(sum(abs(p - centre) ** 2 for p in shape))
    return [(p - centre) / size for p in shape]


def read(folder, name):
    lines = (Path(folder) / f"curves-{name}" / "curves.ndjson").read_text().splitlines()
    return [resampled(json.loads(line)["points"]) for line in lines]


def mirrored(shape):
    turned = [complex(-p.real, p.imag) for p in shape]
    return turned[:1] + turned[:0:-1]


def bump(shape, random, part, low, high, inwards):
    """A stretch of the contour displaced along its normals: a half wave, as high as `low` to `high` mean radii. Also
    where."""
    n = len(shape)
    count, start = round(part * n), random.randrange(n)
    height = random.uniform(low, high) * sum(abs(p) for p in shape) / n
    if inwards and random.random() < 0.5:
        height = -height
    out, places = list(shape), []
    for i in range(count):
        k = (start + i) % n
        tangent = shape[(k + 1) % n] - shape[k - 1]
        out[k] += -1j * tangent / abs(tangent) * height * math.sin(math.pi * (i + 0.5) / count)
        places.append(k)
    return out, places


def wrong(kind, shapes, others, random):
    if kind == "organ":
        return random.choice(others)
    shape = random.choice(shapes)
    return mirrored(shape) if kind == "mirrored" else normal(bump(shape, random, 0.15, 1.0, 2.0, False)[0])


def contaminated(kind, shapes, others, seed):
    random = Random(seed)
    count = round(len(shapes) * 0.3 / 0.7)
    kinds = KINDS[:3] if kind == "mixed" else [kind]
    bad = [wrong(kinds[k % len(kinds)], shapes, others, random) for k in range(count)]
    return shapes + bad


def body(shapes, robust, correspondence, **more):
    points = [{"points": [[p.real, p.imag] for p in shape]} for shape in shapes]
    settings = {"representation": REPRESENTATION, "transformation": "similarity", "correspondence": correspondence}
    if correspondence == "cyclic":
        settings["direction"] = "either"
    if robust:
        settings["robust"] = True
    return {**settings, "shapes": points, **more}


def flat(rows):
    return [complex(*row) for row in rows]


def pca(service, shapes, robust, correspondence):
    answer = service.call(
        "POST", "/v1/pca", body(shapes, robust, correspondence, components=4, centre=True, aligned=False)
    )
    modes = [flat(shape["control_points"]) for shape in answer["pca"]["eigenshapes"]]
    return flat(answer["mean"]["control_points"]), modes, answer


def inner(a, b):
    return sum(p.conjugate() * q for p, q in zip(a, b))


def unit(a):
    size = math.sqrt(inner(a, a).real)
    return [p / size for p in a]


def compared(found, wanted):
    """Distance of the means, and angles between the modes in degrees, after the shift and rotation that match the means
    best."""
    mean, modes, _ = found
    goal, goals, _ = wanted
    goal, n = unit(goal), len(goal)
    shifts = range(n)
    best = max(shifts, key=lambda s: abs(inner(unit(mean[s:] + mean[:s]), goal)))
    product = inner(unit(mean[best:] + mean[:best]), goal)
    turn = product / abs(product)
    distance = math.sqrt(max(0.0, 2 - 2 * abs(product)))
    angles = []
    for mode, other in zip(modes[:3], goals[:3]):
        turned = unit([turn * p for p in mode[best:] + mode[:best]])
        angles.append(math.degrees(math.acos(min(1.0, abs(inner(turned, unit(other)).real)))))
    return distance, angles


def gross(service, data, names, others, seed=1):
    rows = met_mean = met_modes = 0
    print(
        "| data | shapes | wrong | mean moves, plain | robust | modes 1–3, plain | robust | wrong ones kept | "
        "right ones rejected |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for correspondence in ["landmarks", "cyclic"]:
        for name in names:
            shapes = data[name]
            wanted = pca(service, shapes, False, correspondence)
            for kind in KINDS:
                all_shapes = contaminated(kind, shapes, others(name), seed)
                plain = compared(pca(service, all_shapes, False, correspondence), wanted)
                found = pca(service, all_shapes, True, correspondence)
                robust, weights = compared(found, wanted), found[2]["robust"]["weights"]
                kept = sum(weights[len(shapes) :])
                rejected = sum(weight == 0 for weight in weights[: len(shapes)])
                angles = [" ".join(f"{a:.1f}°" for a in result[1]) for result in (plain, robust)]
                print(
                    f"| {name}, {correspondence} | {len(all_shapes)} | {kind} | {plain[0]:.3f} | {robust[0]:.4f} "
                    f"| {angles[0]} | "
                    f"{angles[1]} | {kept:.1f} of {len(all_shapes) - len(shapes)} | {rejected} |",
                    flush=True,
                )
                rows, met_mean, met_modes = rows + 1, met_mean + (robust[0] < 0.05), met_modes + (max(robust[1]) < 5)
    print(
        f"\nSeed {seed}: the mean moves less than 0.05 in {met_mean} of {rows} rows, the modes less than 5° in "
        f"{met_modes}."
    )


def drawn(answer, random, count):
    """Shapes of the normal distribution with the mean and the components of an answer."""
    mean = flat(answer["pca"]["mean"]["control_points"])
    modes = [flat(shape["control_points"]) for shape in answer["pca"]["eigenshapes"]]
    shapes = len(answer["pca"]["scores"])
    deviations = [math.sqrt(value / (shapes - 1)) for value in answer["pca"]["eigenvalues"]]
    found = []
    for _ in range(count):
        shape = list(mean)
        for deviation, mode in zip(deviations, modes):
            score = random.gauss(0, deviation)
            shape = [p + score * q for p, q in zip(shape, mode)]
        found.append(shape)
    return found


def clean(service, data, names, _, draws=40):
    print(
        "| data | shapes | error of the mean, plain/robust | of mode 1 | least weight of the real set | worth of "
        "its weights | cyclic |"
    )
    print("|---|---|---|---|---|---|---|")
    for name in names:
        shapes = data[name]
        request = body(shapes, False, "landmarks", components=30, centre=True, aligned=False)
        answer = service.call("POST", "/v1/pca", request)
        truth = pca(service, drawn(answer, Random(7), 2000), False, "landmarks")
        errors = {False: [0.0, 0.0], True: [0.0, 0.0]}
        for draw in range(draws):
            sample = drawn(answer, Random(100 + draw), len(shapes))
            for robust in errors:
                distance, angles = compared(pca(service, sample, robust, "landmarks"), truth)
                errors[robust][0] += distance**2
                errors[robust][1] += math.sin(math.radians(angles[0])) ** 2
        real, cyclic = (pca(service, shapes, True, kind)[2]["robust"] for kind in ("landmarks", "cyclic"))
        ratios = [errors[False][i] / errors[True][i] for i in range(2)]
        print(
            f"| {name} | {len(shapes)} | {ratios[0]:.3f} | {ratios[1]:.3f} | {min(real['weights']):.2f} | "
            f"{real['effective_count'] / len(shapes):.3f} | {cyclic['effective_count'] / len(shapes):.3f} |",
            flush=True,
        )


def area_under_curve(positive, negative):
    """Probability that a positive value is above a negative one; ties count half."""
    both = sorted([(v, 1) for v in positive] + [(v, 0) for v in negative])
    ranks, k = 0.0, 0
    while k < len(both):
        end = k
        while end < len(both) and both[end][0] == both[k][0]:
            end += 1
        ranks += sum(flag for _, flag in both[k:end]) * (k + end + 1) / 2
        k = end
    n = len(positive)
    return (ranks - n * (n + 1) / 2) / (n * len(negative))


def damage(service, data, names, _):
    print(
        "| data | shapes | damaged | height of the damage, mean radii | area under the curve, within damaged "
        "shapes | all shapes |"
    )
    print("|---|---|---|---|---|---|")
    for name in names:
        for low, high in [(0.1, 0.2), (0.2, 0.4)]:
            random = Random(5)
            shapes, places = [], []
            for k, shape in enumerate(data[name]):
                shape, where = bump(shape, random, 0.1, low, high, True) if k % 5 == 0 else (shape, [])
                shapes.append(shape)
                places.append(set(where))
            answer = service.call("POST", "/v1/align", body(shapes, True, "landmarks"))
            inside, beside, elsewhere = [], [], []
            for where, aligned in zip(places, answer["aligned"]):
                for k, weight in enumerate(aligned["point_weights"]):
                    (inside if k in where else beside if where else elsewhere).append(1 - weight)
            within = area_under_curve(inside, beside)
            overall = area_under_curve(inside, beside + elsewhere)
            count = sum(bool(where) for where in places)
            print(f"| {name} | {len(shapes)} | {count} | {low}–{high} | {within:.4f} | {overall:.4f} |", flush=True)


def colour(weight):
    """From black (like the others) to red."""
    return f"rgb({round(225 * (1 - weight))},{round(40 * (1 - weight))},{round(40 * (1 - weight))})"


def picture(service, data, names, _):
    """Damaged shapes, rows of eight: the undamaged contour in grey behind, control points from black to red as their
    weights fall."""
    cells, side = [], 150
    for name in names:
        random = Random(5)
        shapes, places = [], []
        for k, shape in enumerate(data[name]):
            shape, where = bump(shape, random, 0.1, 0.2, 0.4, True) if k % 5 == 0 else (shape, [])
            shapes.append(shape)
            places.append(where)
        aligned = service.call("POST", "/v1/align", body(shapes, True, "landmarks"))["aligned"]
        chosen = [k for k, where in enumerate(places) if where][:7] + [
            next(k for k, where in enumerate(places) if not where)
        ]
        scale = 0.45 * side / max(abs(p) for p in shapes[0])
        for k in chosen:
            column, row = len(cells) % 8, len(cells) // 8
            at = lambda p: (side * (column + 0.5) + scale * p.real, side * (row + 0.5) - scale * p.imag)
            ring = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, data[name][k]))
            dots = ""
            for p, weight in zip(shapes[k], aligned[k]["point_weights"]):
                x, y = at(p)
                dots += (
                    f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{2.5 if weight > 0.5 else 3.5}" fill="{colour(weight)}"/>'
                )
            text = (
                f'<text x="{side * column + 4}" y="{side * row + 12}" font-size="11">{name[:8]} '
                f"{aligned[k]['weight']:.2f}</text>"
            )
            cells.append(f'<polygon points="{ring}" fill="none" stroke="#bbb" stroke-width="3"/>{dots}{text}')
    rows = (len(cells) + 7) // 8
    print(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{8 * side}" height="{rows * side}" font-family="sans-serif">'
        f'<rect width="100%" height="100%" fill="white"/>{"".join(cells)}</svg>'
    )


def timed(action, repeats=5):
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        action()
        times.append(time.perf_counter() - begin)
    return sorted(times)[len(times) // 2]


def cost(service, data, _, __):
    print("| request | plain | robust | ratio |")
    print("|---|---|---|---|")
    random = Random(3)
    answer = service.call(
        "POST", "/v1/pca", body(data["mosquito-wings"], False, "landmarks", components=30, centre=True, aligned=False)
    )
    shapes = drawn(answer, random, 1000)
    for path, correspondence in [
        ("mean", "landmarks"),
        ("mean", "cyclic"),
        ("align", "landmarks"),
        ("pca", "landmarks"),
    ]:
        bodies = [json.dumps(body(shapes, robust, correspondence)).encode() for robust in (False, True)]
        times = [timed(lambda b=b: service.call("POST", f"/v1/{path}", b, raw=True)) for b in bodies]
        row = f"`POST /v1/{path}`, 1 000 shapes of {POINTS} points, {correspondence}"
        print(f"| {row} | {times[0]:.3f} s | {times[1]:.3f} s | {times[1] / times[0]:.2f} |", flush=True)
    body_of = {"name": "robust-cost", "representation": REPRESENTATION}
    service.call("POST", "/v1/cohorts", body_of)
    points = [{"points": [[p.real, p.imag] for p in shape]} for shape in drawn(answer, random, 20000)]
    service.call("POST", "/v1/cohorts/robust-cost/shapes", {"shapes": points})
    for transformation in ["similarity", "affine"]:
        query = f"/v1/cohorts/robust-cost/mean?transformation={transformation}"
        times = []
        for robust in ("", "&robust=true"):
            found = []
            for k in range(3):
                # Every mean is kept for its revision; another filter is another mean of the same shapes.
                service.call("PATCH", "/v1/cohorts/robust-cost", {"description": f"{transformation}{robust}{k}"})
                found.append(timed(lambda r=robust: service.call("GET", query + r, raw=True), 1))
            times.append(sorted(found)[1])
        row = f"`GET …/mean`, 20 000 stored shapes, {transformation}"
        print(f"| {row} | {times[0]:.3f} s | {times[1]:.3f} s | {times[1] / times[0]:.2f} |", flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*")
    parser.add_argument("--data", required=True)
    parser.add_argument("--binary", default=ROOT / "target/release/shapelex")
    parser.add_argument("--part", choices=["gross", "clean", "damage", "cost", "picture"])
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    data = {name: read(arguments.data, name) for name in SETS}

    def others(name):
        return data["hearts" if name == "molars" else "molars"]

    with tempfile.TemporaryDirectory() as folder:
        service = Service(arguments.binary, folder)
        try:
            for part in [gross, clean, damage, cost, picture]:
                if arguments.part == part.__name__ or arguments.part is None and part is not picture:
                    more = {"seed": arguments.seed} if part is gross else {}
                    part(service, data, arguments.names or SETS, others, **more)
                    print()
        finally:
            service.process.terminate()


if __name__ == "__main__":
    main()
