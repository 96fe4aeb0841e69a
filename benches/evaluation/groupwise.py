"""Groupwise correspondence of surfaces without a template: 60 hippocampi, and two synthetic families.

    target/peers/bin/python benches/evaluation/groupwise.py --data FOLDER --program PROGRAM [--shapes 60] [--many 1024]
    [--out FOLDER]

Every mesh is fitted by the service with parameters of its own (14 × 14 control points), and with these turned at
random. Each set is stored in a cohort and brought into correspondence by `POST /v1/cohorts/{cohort}/correspond`; then
means and modes are those of a rigid Procrustes alignment where points correspond as given. Distances are those from the
points of one surface to another surface, in millimetres, weighted by area; shapes are left out one at a time. Prints
the tables of docs/evaluation.md.
"""

import argparse
import importlib.util
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent


def module(name, path):
    spec = importlib.util.spec_from_file_location(name, path)
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


hippocampi = module("hippocampi", HERE / "hippocampi.py")
surfaces = hippocampi.surfaces
RIGID, SIZE = hippocampi.RIGID, [14, 14]
REPRESENTATION = surfaces.surface("sphere", SIZE)
GRID = 48
MODES = (1, 2, 3, 5, 8, 12, 20, 30)
SAMPLES = 60


def store(service, name, shapes):
    service.cohort(name, REPRESENTATION, [{**shape, "external_id": f"shape-{k:04d}"} for k, shape in enumerate(shapes)])


def spent(service):
    """Processor seconds of the service so far, all threads."""
    fields = Path(f"/proc/{service.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def correspond(service, cohort, name, **options):
    """The result of the job, its seconds by the clock and of the processor, and the control points of the new
    cohort."""
    start, before = time.perf_counter(), spent(service)
    job = service.post(f"/v1/cohorts/{cohort}/correspond", {"name": name, **options})
    while job["status"] in ("queued", "running"):
        time.sleep(0.1)
        job = service.call("GET", f"/v1/jobs/{job['id']}")
    if job["status"] != "succeeded":
        raise surfaces.Refused(str(job)[:2000])
    seconds = time.perf_counter() - start, spent(service) - before
    shapes, cursor = [], ""
    while cursor is not None:
        page = service.call("GET", f"/v1/cohorts/{name}/shapes?limit=100{cursor}")
        shapes += page["items"]
        cursor = f"&cursor={page['next']}" if page.get("next") else None
    return job["result"], seconds, [{"control_points": shape["control_points"]} for shape in shapes]


def aligned(service, shapes):
    body = {"representation": REPRESENTATION, **RIGID, "correspondence": "landmarks", "shapes": shapes}
    answer = service.post("/v1/align", body)
    volume = surfaces.measures(service, REPRESENTATION, [answer["mean"]])[0]["volume"]
    points = np.array([one["control_points"] for one in answer["aligned"]])
    centred = (points - points.mean(axis=0)).reshape(len(shapes), -1)
    _, singular, modes = np.linalg.svd(centred, full_matrices=False)
    return {
        "points": points,
        "volume": volume,
        "explained": singular**2 / (singular**2).sum(),
        "modes": modes,
        "singular": singular,
    }


def bending(service, found):
    """What the variance of each mode takes from the volume of the mean, over the mean of volumes. The volume is a cubic
    form of the control points, so that its mean over the shapes is V(mean) + Σ_k ½ λ_k d²V[ξ_k, ξ_k] and a sixth of the
    mean of d³V; each summand is the even part of V along a mode, exactly."""
    points, mean = found["points"], found["points"].mean(axis=0)
    count = len(points)
    steps = found["singular"][: count - 1, None] / np.sqrt(count) * found["modes"][: count - 1]
    shapes = [mean + sign * step.reshape(-1, 3) for step in steps for sign in (1, -1)]
    volumes = lambda shapes: np.array(
        [
            one["volume"]
            for one in surfaces.measures(
                service, REPRESENTATION, [{"control_points": shape.tolist()} for shape in shapes]
            )
        ]
    )
    own, (middle,) = volumes(points).mean(), volumes([mean])
    even = volumes(shapes).reshape(-1, 2).mean(axis=1) - middle
    sizes = np.cbrt(volumes(points))
    return {
        "deficit": 1 - middle / own,
        "modes": even / own,
        "rest": 1 - (middle + even.sum()) / own,
        "size": 1 - sizes.mean() ** 3 / own,
    }


def evaluation(service):
    """Matrix from control points to points on a grid of parameters."""
    rows = SIZE[0] * (SIZE[1] - 1) + 6
    unit = np.zeros((-(-rows // 3), rows, 3))
    for j in range(rows):
        unit[j // 3, j, j % 3] = 1
    shapes = [{"control_points": one.tolist()} for one in unit]
    body = {"representation": REPRESENTATION, "shapes": shapes, "grid": [GRID, GRID + 1]}
    values = [np.array(one["points"]).reshape(-1, 3) for one in service.post("/v1/evaluate", body)["evaluations"]]
    return np.concatenate(values, axis=1)[:, :rows]


def tangents(points):
    grid = points.reshape(GRID, GRID + 1, 3)
    along_u = np.roll(grid, -1, axis=0) - np.roll(grid, 1, axis=0)
    along_v = np.gradient(grid, axis=1)
    normal = np.cross(along_u, along_v).reshape(-1, 3)
    area = np.linalg.norm(normal, axis=1)
    return normal / np.maximum(area, 1e-12)[:, None], area / area.sum()


def to_surface(points, target):
    """Mean distance of points from a surface: from the tangent planes of its nearest points."""
    normals, _ = tangents(target)
    _, weights = tangents(points)
    squares = (points**2).sum(1)[:, None] - 2 * points @ target.T + (target**2).sum(1)[None]
    nearest = squares.argmin(axis=1)
    direct = np.sqrt(np.maximum(squares[np.arange(len(points)), nearest], 0))
    plane = np.abs(((points - target[nearest]) * normals[nearest]).sum(1))
    return float((weights * np.where(normals[nearest].any(axis=1), plane, direct)).sum())


def quality(points, matrix, random):
    """Generalisation and specificity in millimetres for each number of modes."""
    count = len(points)
    flat = points.reshape(count, -1)
    on_grid = np.einsum("gn,knc->kgc", matrix, points)
    general, specific = [], []
    kept = [m for m in MODES if m < count - 1]
    sums = np.zeros(len(kept))
    for k in range(count):
        rest = np.delete(flat, k, axis=0)
        mean = rest.mean(axis=0)
        modes = np.linalg.svd(rest - mean, full_matrices=False)[2]
        for i, m in enumerate(kept):
            rebuilt = mean + modes[:m].T @ (modes[:m] @ (flat[k] - mean))
            sums[i] += to_surface(matrix @ rebuilt.reshape(-1, 3), on_grid[k])
    general = sums / count
    mean = flat.mean(axis=0)
    _, singular, modes = np.linalg.svd(flat - mean, full_matrices=False)
    for m in kept:
        total = 0.0
        for _ in range(SAMPLES):
            scores = random.normal(size=m) * singular[:m] / np.sqrt(count - 1)
            drawn = mean + scores @ modes[:m]
            near = np.argsort(((flat - drawn) ** 2).sum(axis=1))[:4]
            total += min(to_surface(matrix @ drawn.reshape(-1, 3), on_grid[k]) for k in near)
        specific.append(total / SAMPLES)
    return kept, general, specific


def angles(found, reference):
    """Angles of the first modes after the rotation that brings one mean onto the other."""
    a, b = [one["points"].mean(axis=0) for one in (reference, found)]
    u, _, vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    modes = [(mode.reshape(-1, 3) @ turn).ravel() for mode in found["modes"][:3]]
    return [hippocampi.angle(mode, other) for mode, other in zip(modes, reference["modes"])]


def real(service, given):
    random = np.random.default_rng(7)
    start = time.perf_counter()
    alone = surfaces.fit(service, REPRESENTATION, given)
    fitting = time.perf_counter() - start
    again = [
        {**one, "parameters": hippocampi.turned(fit["parameters"], hippocampi.rotation(random))}
        for one, fit in zip(given, alone)
    ]
    turned = surfaces.fit(service, REPRESENTATION, again)
    volumes = np.mean([one["volume"] for one in surfaces.measures(service, REPRESENTATION, alone)])
    only = lambda fits: [{"control_points": fit["control_points"]} for fit in fits]
    sets = {"alone": only(alone), "turned": only(turned), "backwards": only(turned)[::-1]}
    matrix, reference, results = evaluation(service), None, {}
    surfaces.table(
        "parameters",
        "degree",
        "volume of the mean − mean of the volumes",
        "modes 1, 2, 3",
        "angles to the modes of `alone`",
        "largest residual",
        "largest fold",
        "least Jacobian",
        "entropy",
        "seconds, of the processor",
    )
    for degree in (0, 2, 4, 6):
        reference = None
        for name, shapes in sets.items():
            cohort = f"{name}-{degree}"
            store(service, cohort, shapes)
            answer, seconds, stored = correspond(service, cohort, f"{cohort}-corresponding", degree=degree)
            found = aligned(service, stored if name != "backwards" else stored[::-1])
            reference = reference or found
            results[name, degree] = found
            each = answer["shapes"]
            surfaces.row(
                name,
                degree,
                f"{100 * (found['volume'] / volumes - 1):+.2f} %",
                ", ".join(f"{100 * part:.0f} %" for part in found["explained"][:3]),
                ", ".join(f"{a:.1f}°" for a in angles(found, reference)),
                f"{100 * max(one['relative_residual'] for one in each):.2f} %",
                f"{100 * max(one['folded'] for one in each):.2f} %",
                f"{min(one['least_jacobian'] for one in each):.2f}",
                f"{answer['entropy'][0]:.1f} → {answer['entropy'][1]:.1f}",
                f"{seconds[0]:.1f}, {seconds[1]:.1f}",
            )
    print()
    surfaces.table(
        "degree",
        "mean of the own volumes − volume of the mean",
        "modes 1, 2, 3, 4, 5",
        "6 to 20",
        "all further",
        "third order",
        "of which size",
    )
    for degree in (0, 2, 4, 6):
        parts = bending(service, results["alone", degree])
        percent = lambda part: f"{100 * part:.2f} %"
        modes = parts["modes"]
        surfaces.row(
            degree,
            percent(parts["deficit"]),
            ", ".join(percent(part) for part in modes[:5]),
            percent(modes[5:20].sum()),
            percent(modes[20:].sum()),
            percent(parts["rest"]),
            percent(parts["size"]),
        )
    print(f"\n{len(given)} meshes fitted in {fitting:.1f} s\n")
    surfaces.table("shapes", "measure, mm", *(f"{m} modes" for m in MODES if m < len(given) - 1))
    cases = {
        "alone": aligned(service, sets["alone"])["points"],
        "rotated (degree 0)": results["alone", 0]["points"],
        "corresponding (degree 4)": results["alone", 4]["points"],
    }
    for name, points in cases.items():
        _, general, specific = quality(points, matrix, np.random.default_rng(3))
        surfaces.row(name, "generalisation", *(f"{value:.3f}" for value in general))
        surfaces.row(name, "specificity", *(f"{value:.3f}" for value in specific))
    store(service, "start", sets["alone"])
    for cohort in ("start", "alone-0-corresponding", "alone-4-corresponding"):
        method = {"kind": "functional_pca", "components": 20, "centre": True}
        service.learn(f"modes-{cohort}", cohort, {"transformation": "rigid", "alignment": "procrustes"}, method)
        for component in (1, 2):
            service.picture(
                f"{cohort}-mode-{component}",
                "GET",
                f"/v1/dictionaries/modes-{cohort}/modes?component={component}&sigma=2",
            )
    new = sets["turned"][:10]
    times, before = [], spent(service)
    for shape in new:
        start = time.perf_counter()
        service.post("/v1/dictionaries/modes-alone-4-corresponding/correspond", {"shapes": [shape]})
        times.append(time.perf_counter() - start)
    before = 1000 * (spent(service) - before) / len(new)
    start = time.perf_counter()
    surfaces.fit(service, REPRESENTATION, given[:1])
    print(
        f"\na new surface against a dictionary: {1000 * np.median(times):.0f} ms (largest {1000 * max(times):.0f} "
        f"ms), {before:.0f} ms of the processor; "
        f"fit of its mesh {1000 * (time.perf_counter() - start):.0f} ms"
    )
    return sets["alone"]


def directions():
    u, v = np.meshgrid(
        2 * np.pi * np.arange(SIZE[0]) / SIZE[0], np.pi * np.arange(SIZE[1] + 1) / SIZE[1], indexing="ij"
    )
    return np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1)


def ellipsoid(t, x):
    """An ellipsoid whose long half-axis is the one parameter."""
    return x * np.array([10.0, 14.0, 20.0 + 10.0 * t])


def box_bump(t, x):
    """A rounded box with a bump of one size that moves along its long edge."""
    box = np.array([30.0, 14.0, 10.0])
    radius = (np.abs(x) ** 6).sum(axis=-1, keepdims=True) ** (-1 / 6)
    point = radius * x * box
    place = np.array([-15.0 + 30.0 * t, 0.0, 10.0])
    near = np.exp(-(((point - place)[..., :2] ** 2).sum(axis=-1, keepdims=True)) / (2 * 7.0**2)) * (point[..., 2:] > 0)
    return point + 12.0 * near * np.array([0.0, 0.0, 1.0])


def families(service, count):
    random = np.random.default_rng(11)
    surfaces.table(
        "family",
        "parameters",
        "mode 1 before",
        "rotated",
        "degree 4",
        "degree 6, 8 rounds",
        "largest residual",
        "largest fold",
        "seconds, of the processor",
    )
    for name, shape in (("ellipsoids", ellipsoid), ("box-bump", box_bump)):
        for turned in (False, True):
            shapes = []
            for k in range(count):
                x = directions() @ (hippocampi.rotation(random) if turned else np.eye(3))
                shapes.append({"points": shape(k / (count - 1), x).tolist()})
            label = f"{name}-{'turned' if turned else 'given'}"
            store(service, label, shapes)
            body = {"representation": REPRESENTATION, "shapes": shapes}
            fitted = [
                {"control_points": one["control_points"]}
                for one in service.post("/v1/align", {**body, **RIGID, "correspondence": "landmarks"})["aligned"]
            ]
            before = aligned(service, fitted)["explained"][0]
            _, _, rotated = correspond(service, label, f"{label}-0", degree=0)
            found = [
                correspond(service, label, f"{label}-{degree}", degree=degree, rounds=rounds)
                for degree, rounds in ((4, 4), (6, 8))
            ]
            explained = [f"{100 * aligned(service, stored)['explained'][0]:.1f} %" for _, _, stored in found]
            answer, seconds, _ = found[1]
            surfaces.row(
                name,
                "turned" if turned else "given",
                f"{100 * before:.1f} %",
                f"{100 * aligned(service, rotated)['explained'][0]:.1f} %",
                *explained,
                f"{100 * max(one['relative_residual'] for one in answer['shapes']):.1f} %",
                f"{100 * max(one['folded'] for one in answer['shapes']):.2f} %",
                f"{seconds[0]:.1f}, {seconds[1]:.1f}",
            )


def many(service, shapes, count):
    """As many surfaces as asked for, blends of two hippocampi each, with parameters as given."""
    random = np.random.default_rng(5)
    points = aligned(service, shapes)["points"]
    drawn = []
    for _ in range(count):
        i, j = random.integers(len(points), size=2)
        share = random.uniform()
        drawn.append({"control_points": (share * points[i] + (1 - share) * points[j]).tolist()})
    store(service, "many", drawn)
    _, seconds, _ = correspond(service, "many", "many-corresponding", degree=4)
    print(
        f"\n{count} surfaces: {seconds[0]:.1f} s, {seconds[1]:.1f} s of the processor, "
        f"{1000 * seconds[1] / count:.0f} ms each"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--program", required=True)
    parser.add_argument("--shapes", type=int, default=60)
    parser.add_argument("--many", type=int, default=1024, help="0 leaves it out")
    parser.add_argument("--out", type=Path, help="folder of pictures")
    arguments = parser.parse_args()
    given = list(surfaces.meshes(arguments.data / "surfaces-hippocampus" / "meshes").values())[: arguments.shapes]
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        service = surfaces.Service(arguments.program, folder, arguments.out)
        try:
            shapes = real(service, given)
            families(service, 20)
            if arguments.many:
                many(service, shapes, arguments.many)
        finally:
            service.process.terminate()


if __name__ == "__main__":
    sys.exit(main())
