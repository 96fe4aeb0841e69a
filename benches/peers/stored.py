"""Cohorts of the service from 10² shapes on: upload, means, searches, and the memory that they take.

Every size has a service and a folder of its own. The same measurements are rows of the table and points of the plots.
"""

import mmap
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import orjson
from data import cells, random_contours
from distances import NEAREST, search
from means import MODES, aligned, principal, same_optimum
from measure import Row, close, in_turn, timed

from service import Service, upload

POINTS = 32
BLOCK = 100_000
CURVES = {
    "kind": "closed_curve",
    "dimension": 2,
    "control_points": POINTS,
    "generator": {"name": "bspline", "degree": 1},
}
QUERIES = 20
# Shapes up to which the mean with searched start points is asked for: it takes a hundred rounds or more, and a request
# of ten times as many is stopped after two minutes.
SEARCHED = 100_000
# One request may compute for a long time here; the default refuses what is predicted to take more than 10 s.
FLAGS = ["--max-request-seconds", "3600"]
# Shapes up to which a model is computed in memory.
IN_MEMORY = 100_000


# --- cohorts of curves ------------------------------------------------------------------------------------------------


def growth(setting):
    """Measurements for every number of shapes."""
    found = []
    for exponent in range(2, setting.decades + 1):
        with tempfile.TemporaryDirectory(prefix="shapelex-peers-") as folder:
            found.append(measured(setting, 10**exponent, Path(folder)))
        print(
            {what: value for what, value in found[-1].items() if what != "cyclic answer"}, file=sys.stderr, flush=True
        )
    return found


def measured(setting, count, folder):
    """Seconds and megabytes of everything that is asked about one cohort."""
    lines, z = folder / "lines", contours(count)
    write(lines, z)
    service = Service(setting.binary, folder, flags=FLAGS)
    service.start()
    try:
        megabytes = {"start": service.megabytes()}
        seconds, _ = ingested(service, "given", lines, "landmarks")
        # All points, as they are stored.
        found = {"shapes": count, "bytes": count * POINTS * 16, "lines": lines.stat().st_size, "upload": seconds}
        megabytes["upload"] = service.megabytes("VmHWM")
        mean, found["mean, one pass"] = timed(lambda: service.call("GET", means("given", "canonical")))
        mean, found["mean, two passes"] = timed(lambda: service.call("GET", means("given", "training")))
        megabytes["means"] = service.megabytes("VmHWM")
        if count > IN_MEMORY:
            model, found["model"] = timed(lambda: fitted(service, "given"))
            found |= {"model objective": model["total"]["sum_of_squares"], "streamed": model["streamed"]}
            megabytes["model"] = service.megabytes("VmHWM")
        found["objective"] = mean["objective"]
        ingested(service, "cyclic", lines, "cyclic")
        body = {"shapes": [{"control_points": rows(z[:, 0])}], "neighbours": NEAREST}
        path = "/v1/cohorts/cyclic/search"
        answer, found["first search"] = timed(lambda: service.call("POST", path, body))
        found["search"] = min(timed(lambda: service.call("POST", path, body))[1] for _ in range(QUERIES))
        found["neighbours"] = [n["distance"] for n in answer["results"][0]["neighbours"]]
        megabytes["searches"] = service.megabytes("VmHWM")
        if count <= SEARCHED:
            mean, found["cyclic mean"] = timed(lambda: service.call("GET", means("cyclic", "training")))
            found |= {"rounds": mean["rounds"], "converged": mean["converged"], "cyclic answer": mean}
            megabytes["cyclic mean"] = service.megabytes("VmHWM")
        found["megabytes"] = megabytes
        service.stop()
        found["direct read"] = direct_read(folder / "data" / "shapelex.db")
        found["store"] = (folder / "data" / "shapelex.db").stat().st_size
    finally:
        service.process.kill()
    return found


def contours(count):
    """As many contours in blocks: block `b` has the seed `b + 1`."""
    blocks = [
        random_contours(min(BLOCK, count - first), POINTS, 1 + first // BLOCK) for first in range(0, count, BLOCK)
    ]
    return np.concatenate(blocks, axis=1)


def whitened(z):
    """Rows whose sums of products are the integrals over the polygons: the Gram matrix is the circulant of (1, 4,
    1)/6."""
    gram = (2 + np.cos(2 * np.pi * np.arange(len(z)) / len(z))) / 3
    z = np.ascontiguousarray(np.fft.ifft(np.fft.fft(z, axis=0) * np.sqrt(gram)[:, None], axis=0).T)
    return z / np.linalg.norm(z, axis=1)[:, None]


def rows(z):
    return np.stack([z.real, z.imag], axis=1).tolist()


def write(path, z):
    """One curve a line. Points would be resampled where start points are searched; these are kept as they are."""
    with open(path, "wb") as file:
        for k, shape in enumerate(np.stack([z.real, z.imag], axis=-1).transpose(1, 0, 2)):
            points = orjson.dumps(np.ascontiguousarray(shape), option=orjson.OPT_SERIALIZE_NUMPY)
            file.write(b'{"external_id":"s%d","label":"c%d","control_points":%b}\n' % (k, k % 3, points))


def ingested(service, name, lines, correspondence, representation=CURVES):
    """Uploads a file to a new cohort; seconds and what was answered."""
    cohort = {"name": name, "representation": representation, "correspondence": correspondence}
    service.call("POST", "/v1/cohorts", cohort)
    seconds, status, body = upload(service.port, name, lines)
    if status != 201:
        raise SystemExit(f"upload to {name}: {status} {body}")
    return seconds, body


def fitted(service, cohort):
    """The table of a model without permutations, whose mean is that of the stored mean in one pass."""
    job = service.call("POST", "/v1/models", {"cohort": cohort, "formula": "~ label", "permutations": 0})
    if "terms" in job:
        return job
    while job["status"] in ("queued", "running"):
        time.sleep(0.002)
        job = service.call("GET", f"/v1/jobs/{job['id']}")
    return job["result"]


def means(cohort, frame):
    return f"/v1/cohorts/{cohort}/mean?transformation=similarity&frame={frame}"


def direct_read(path):
    """Seconds in which the file is read past the cache, in pieces of 4 MiB."""
    piece = mmap.mmap(-1, 4 << 20)
    file = os.open(path, os.O_RDONLY | os.O_DIRECT)
    try:
        start = time.perf_counter()
        while os.readv(file, [piece]) == len(piece):
            pass
        return time.perf_counter() - start
    finally:
        os.close(file)


# --- rows of the table ------------------------------------------------------------------------------------------------


def rows_of(ours, setting, sizes):
    """Rows of the largest cohorts."""
    yield ingest(ours, setting)
    yield from stored_means(sizes)
    yield from searches(ours, sizes)
    yield cells_stored(ours, setting)
    yield components_stored(setting)


def ingest(ours, setting, points=50):
    """Lines into the store, beside one thread that parses them and one that stores the same shapes by plain
    statements."""
    count = 10_000 if setting.quick else 100_000
    lines = Path(ours.file("lines"))
    ours.run("lines", lines, points, 0, count)
    representation = CURVES | {"control_points": points}

    def own():
        with tempfile.TemporaryDirectory(prefix="shapelex-peers-") as folder:
            service = Service(setting.binary, Path(folder), flags=FLAGS)
            service.start()
            try:
                seconds, body = ingested(service, "lines", lines, "landmarks", representation)
                stored = service.call("GET", "/v1/cohorts/lines")["shape_count"]
            finally:
                service.process.kill()
            return (body["added"], stored), seconds

    def bound(command):
        answer = ours.run(command, lines, threads=1)
        return answer, min(answer["seconds"])

    def peer():
        with open(lines, "rb") as file:
            return timed(lambda: sum(len(orjson.loads(line)["points"]) for line in file))

    least, answers = in_turn(
        {"own": own, "parse": lambda: bound("parse"), "store": lambda: bound("store"), "orjson": peer}, setting.rounds
    )
    slower = max("parse", "store", key=least.get)
    return Row(
        "ingest",
        f"{count} lines of {points} points into SQLite ({lines.stat().st_size / 1e6:.0f} MB)",
        {"2": least["own"]},
        bound=f"one thread that only {slower}s ({count / least['parse']:.0f} parsed, {count / least['store']:.0f} "
        f"stored a "
        f"second; orjson parses {count / least['orjson']:.0f})",
        bounds={"2": least[slower]},
        compared=f"{answers['own'][1]} of {count} shapes stored",
        agrees=answers["own"] == (count, count),
    )


def stored_means(sizes):
    last = sizes[-1]
    objective = aligned(whitened(contours(last["shapes"])), False, 1)[1]
    for what in ("one pass", "two passes"):
        compared, agrees = close([last["objective"]], [objective], 1e-9, "objective")
        seconds = last["direct read"] * last["bytes"] / last["store"] * (2 if what == "two passes" else 1)
        yield Row(
            f"stored mean, {what}",
            f"stored mean of {last['shapes']:.0e} curves × {POINTS}, {what}",
            {"2": last[f"mean, {what}"]},
            bound="the points read past the cache, as often",
            bounds={"2": seconds},
            compared=compared,
            agrees=agrees,
        )
    if "model" in last:
        # Of shapes of unit size, squared cosines to the mean are the objective; squared sines the total, but for the
        # place of the mean in the tangent space.
        total = last["shapes"] - last["objective"]
        compared, agrees = close([last["model objective"]], [total], 1e-3, "total sum of squares")
        yield Row(
            "stored model",
            f"model of {last['shapes']:.0e} curves × {POINTS} with a factor, beyond the mean that it begins with",
            {"2": last["model"] - last["mean, one pass"]},
            bound="the stored mean, one pass",
            bounds={"2": last["mean, one pass"]},
            compared=compared,
            agrees=agrees and last["streamed"],
        )
    large = [size for size in sizes if "cyclic mean" in size][-1]
    x = whitened(contours(large["shapes"]))
    reference, seconds = timed(lambda: aligned(x, True, 2))
    compared, agrees = answer_agrees(x, large["cyclic answer"], reference)
    yield Row(
        "stored cyclic mean",
        f"stored mean of {large['shapes']:.0e} curves × {POINTS}, start points searched",
        {"2": large["cyclic mean"]},
        "numpy, scipy, in memory",
        {"2": seconds},
        compared=compared,
        agrees=agrees and large["converged"],
    )


def answer_agrees(x, answer, reference):
    """What is compared of a mean with searched start points, and whether it agrees."""
    mean = np.array(answer["mean"]["control_points"]) @ [1, 1j]
    return same_optimum(x, whitened(mean[:, None])[0], answer, (reference[1], None, reference[2]))[:2]


def searches(ours, sizes):
    for size in sizes:
        if size["shapes"] < 10_000:
            continue
        spectra = np.fft.fft(whitened(contours(size["shapes"])), axis=1)
        found = [timed(lambda: search(spectra, 2)) for _ in range(3)]
        compared, agrees = close(np.square(size["neighbours"]), np.square(found[0][0][1]), 1e-12, "squared distances")
        yield Row(
            f"search of {size['shapes']:.0e}".replace("e+0", "e"),
            f"search over HTTP, {NEAREST} nearest of {size['shapes']:.0e} curves × {POINTS} (first "
            f"{size['first search']:.2g} s)",
            {"2": size["search"]},
            "numpy, transforms in memory",
            {"2": min(seconds for _, seconds in found)},
            "one complex transform for each curve",
            {"2": size["shapes"] * ours.transforms(POINTS)},
            compared,
            agrees,
        )


def cells_stored(ours, setting, points=200):
    """The first mean of a stored cohort of cells."""
    count = 200 if setting.quick else 650
    z = cells(setting.data, count, points)
    x = whitened(z)

    def own():
        with tempfile.TemporaryDirectory(prefix="shapelex-peers-") as folder:
            path = Path(folder)
            write(path / "lines", z)
            service = Service(setting.binary, path, flags=FLAGS)
            service.start()
            try:
                ingested(service, "cells", path / "lines", "cyclic", CURVES | {"control_points": points})
                return timed(lambda: service.call("GET", means("cells", "training")))
            finally:
                service.process.kill()

    sides = {"own": own, "peer": lambda: timed(lambda: aligned(x, True, 2))}
    least, answers = in_turn(sides, setting.rounds)
    compared, agrees = answer_agrees(x, answers["own"], answers["peer"])
    return Row(
        "stored cells",
        f"stored mean of {count} cells × {points}, start points searched, first request",
        {"2": least["own"]},
        "numpy, scipy, in memory",
        {"2": least["peer"]},
        compared=compared,
        agrees=agrees,
    )


def components_stored(setting, points=50):
    """Mean, pose, 20 components and all scores of a stored cohort, as a dictionary."""
    count = 10_000 if setting.quick else 100_000
    z = random_contours(count, points, 9)
    body = {
        "name": "components",
        "cohort": "curves",
        "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": MODES, "centre": True},
    }
    with tempfile.TemporaryDirectory(prefix="shapelex-peers-") as folder:
        path = Path(folder)
        write(path / "lines", z)
        service = Service(setting.binary, path, flags=FLAGS)
        service.start()
        try:
            ingested(service, "curves", path / "lines", "landmarks", CURVES | {"control_points": points})
            seconds, found = np.inf, None
            for k in range(setting.rounds):
                start = time.perf_counter()
                job = service.call("POST", "/v1/dictionaries", body | {"name": f"components{k}"})
                while job.get("status") in ("queued", "running"):
                    time.sleep(0.002)
                    job = service.call("GET", f"/v1/jobs/{job['id']}")
                seconds = min(seconds, time.perf_counter() - start)
            found = service.call("GET", "/v1/dictionaries/components0")
        finally:
            service.process.kill()

    def peer():
        shapes, *_ = aligned(z, False, 2)
        x = np.concatenate([shapes.real, shapes.imag], axis=1)
        return principal(x)[0] / (len(x) * np.sum(x.var(axis=0)))

    z = whitened(z)
    explained, reference = min((timed(peer) for _ in range(setting.rounds)), key=lambda pair: pair[1])
    compared, agrees = close([atom["explained"] for atom in found["atoms"]], explained, 1e-7, "explained fractions")
    return Row(
        "stored components",
        f"dictionary of {MODES} components of {count} stored curves × {points}",
        {"2": seconds},
        "numpy, in memory",
        {"2": reference},
        compared=compared,
        agrees=agrees,
    )
