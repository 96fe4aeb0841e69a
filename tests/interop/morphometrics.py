"""Files of landmarks, tables, chain codes and Fourier coefficients, compared with ktch, pandas, numpy and json.

Coordinates agree to 1e-12 relative where another library computes them (products and square roots may round otherwise),
and exactly where numbers are only read.
"""

import json
import math
import re
import warnings
from pathlib import Path

PACKAGES = ["ktch==0.11.1", "pandas==3.1.1", "numpy==2.4.6"]

TABLES = (
    "ape-skulls brains-3d digit3 macaque-skulls-3d mosquito-wings nasal-bone-3d oak-leaves optic-nerve-3d "
    "passiflora-leaves plethodon "
    "primate-crania-3d pupfish pupfish-species rat-growth"
).split()


def rows(record):
    """Points of a record as an array, NaN for missing ones."""
    import numpy

    given = [row for row in record["points"] if row is not None]
    size = len(given[0]) if given else 2
    return numpy.array([row if row is not None else [math.nan] * size for row in record["points"]], float).reshape(
        -1, size
    )


def same(a, b, tolerance=0.0):
    """Whether arrays have one shape and the same numbers, NaN included."""
    import numpy

    a, b = numpy.asarray(a, float), numpy.asarray(b, float)
    scale = numpy.nanmax(numpy.abs(b), initial=1e-300)
    return a.shape == b.shape and bool(
        numpy.all((numpy.abs(a - b) <= tolerance * scale) | (numpy.isnan(a) & numpy.isnan(b)))
    )


def check(convert, data, folder):
    folder = Path(folder)
    data = None if data is None else Path(data)
    yield from tps(convert, data, folder)
    yield from chains(convert, folder)
    yield from fourier(convert, folder)
    yield from tables(convert, data, folder)
    yield from matrices(convert, folder)
    yield from markups(convert, folder)


def specimens(found):
    """Landmarks and curves of each specimen, from records."""
    result = []
    for record in found:
        if "closed" in record:
            result[-1][2].append(rows(record))
        else:
            result.append((record.get("external_id"), rows(record), []))
    return result


def is_as_ktch(found, expected):
    return len(found) == len(expected) and all(
        name == other.specimen_name
        and same(landmarks, other.landmarks)
        and len(curves) == len(other.curves or [])
        and all(same(a, b) for a, b in zip(curves, other.curves or []))
        for (name, landmarks, curves), other in zip(found, expected)
    )


def tps(convert, data, folder):
    import numpy
    from ktch.io import read_tps, write_tps

    def of_ktch(path):
        found = read_tps(path)
        return found if isinstance(found, list) else [found]

    leave = {"scale": "leave"}
    files = (
        "formats-tps/landmarks_triangle formats-tps/sample_curve_data landmarks-dragonfly-wings/forewing "
        "landmarks-trilobite-cephala/cephala"
    )
    for name in files.split() if data else []:
        path = data / f"{name}.tps"
        expected = of_ktch(path)
        found = specimens(convert(path, options=leave)[0])
        curves = sum(len(specimen[2]) for specimen in found)
        yield f"tps in: {name}", is_as_ktch(found, expected), f"{len(found)} specimens, {curves} curves"
        written = folder / "ours.tps"
        written.write_bytes(convert(path, "tps", options=leave)[0].replace(b"NA NA", b"nan nan"))
        yield f"tps out: {name}", is_as_ktch(found, of_ktch(written)), "read by ktch; NA written as nan for it"
    random = numpy.random.default_rng(1)
    for dimension in (2, 3):
        landmarks = random.normal(size=(5, 7, dimension)).round(6)
        curves = [[random.normal(size=(4, dimension)).round(6)] for _ in landmarks]
        path = folder / "theirs.tps"
        write_tps(path, landmarks, idx=[f"s {k}" for k in range(5)], scale=0.25, semilandmarks=curves)
        found = specimens(convert(path)[0])
        expected = [(f"s {k}", 0.25 * a, [0.25 * b[0]]) for k, (a, b) in enumerate(zip(landmarks, curves))]
        ok = len(found) == 5 and all(
            a[0] == b[0] and same(a[1], b[1]) and same(a[2], b[2]) for a, b in zip(found, expected)
        )
        yield f"tps in: of ktch in {dimension} dimensions, scaled", ok, "5 specimens with a curve"


def random_chain(random, steps):
    """A closed chain: random steps and their opposites in random order."""
    half = random.integers(0, 8, size=steps)
    codes = list(half) + list((half + 4) % 8)
    random.shuffle(codes)
    return codes


def chains(convert, folder):
    import numpy
    from ktch.io import read_chc, write_chc

    random = numpy.random.default_rng(2)
    codes = [numpy.array(random_chain(random, steps)) for steps in (3, 50, 1000)]
    path = folder / "theirs.chc"
    write_chc(
        path, codes, sample_names=["a", "b", "c"], xs=[0, 1.5, -100], ys=[0, 2, 3], area_per_pixels=[1.0, 0.0123, -1.0]
    )
    found, summary = convert(path)
    expected = read_chc(path)
    # A closed curve does not repeat its first point.
    ok = len(found) == 3 and all(
        a["closed"] and a["external_id"] == b.specimen_name and same(rows(a), b.to_numpy()[:-1], 1e-12)
        for a, b in zip(found, expected)
    )
    yield "chc in: of ktch", ok and not summary["warnings"], f"{sum(map(len, codes))} steps"
    written = folder / "ours.chc"
    written.write_bytes(convert(path, "chc")[0])
    with warnings.catch_warnings():
        # ktch warns of another number of pixels.
        warnings.simplefilter("error")
        again = read_chc(written)
    ok = all(
        same(a.chain_code, b.chain_code)
        and (a.x, a.y, a.area_per_pixel, a.area_pixels) == (b.x, b.y, b.area_per_pixel, b.area_pixels)
        for a, b in zip(again, expected)
    )
    yield "chc out: read by ktch", ok and len(again) == 3, "codes, places and areas"


def fourier(convert, folder):
    import numpy
    from ktch.harmonic import EllipticFourierAnalysis
    from ktch.io import read_nef, write_nef

    random = numpy.random.default_rng(3)
    angles = numpy.linspace(0, 2 * math.pi, 200, endpoint=False)
    outlines = []
    for _ in range(3):
        radius = 2 + sum(random.normal() / k**2 * numpy.cos(k * angles + random.normal()) for k in range(2, 9))
        outlines.append(numpy.stack([radius * numpy.cos(angles), radius * numpy.sin(angles)], axis=1))
    harmonics = 12
    analysis = EllipticFourierAnalysis(n_harmonics=harmonics, norm=False)
    flat = numpy.asarray(analysis.fit_transform(outlines))[:, : 4 * (harmonics + 1)]
    coefficients = flat.reshape(3, 4, harmonics + 1)[:, :, 1:].transpose(0, 2, 1)
    path = folder / "theirs.nef"
    write_nef(path, coefficients, sample_names=["a 1", "b", "c"], const_flags=(0, 0, 0, 0))
    expected = read_nef(path)
    found = convert(path)[0]
    four = [
        numpy.stack([numpy.array(r["fourier"][part]) for part in ("cosine", "sine")], axis=2).reshape(-1, 4)
        for r in found
    ]
    ok = len(found) == 3 and all(
        a["external_id"] == b.specimen_name and same(c, b.coeffs) for a, b, c in zip(found, expected, four)
    )
    yield "nef in: of ktch", ok, f"3 shapes of {harmonics} harmonics"
    # The meaning of the coefficients: the curve of ktch is ours.
    zero = flat.copy()
    zero[:, :: harmonics + 1] = 0
    theirs = numpy.asarray(analysis.inverse_transform(zero, t_num=64))
    theta = 2 * math.pi * numpy.outer(numpy.arange(1, 65) / 64, numpy.arange(1, harmonics + 1))
    ours = [
        numpy.cos(theta) @ numpy.array(r["fourier"]["cosine"]) + numpy.sin(theta) @ numpy.array(r["fourier"]["sine"])
        for r in found
    ]
    # Written with eight digits.
    ok = all(same(a, b, 1e-6) for a, b in zip(ours, theirs))
    yield "nef in: curve of ktch", ok, "64 points of each, to the eight digits of the file"
    written = folder / "ours.nef"
    written.write_bytes(convert(path, "nef")[0])
    again = read_nef(written)
    ok = all(a.specimen_name == b.specimen_name and same(a.coeffs, b.coeffs) for a, b in zip(again, expected))
    yield "nef out: read by ktch", ok and len(again) == 3, "names and coefficients"


def tables(convert, data, folder):
    import numpy
    import pandas

    def wide(path):
        frame = pandas.read_csv(path)
        columns = [column for column in frame.columns if re.fullmatch(r"[xyz]\d+", column)]
        size = 3 if any(column[0] == "z" for column in columns) else 2
        return frame, frame[columns].to_numpy(float).reshape(len(frame), -1, size)

    for name in TABLES if data else []:
        path = data / f"landmarks-{name}" / "landmarks.csv"
        frame, points = wide(path)
        found = convert(path)[0]
        ok = same([rows(record) for record in found], points)
        ok &= [record["external_id"] for record in found] == [str(value) for value in frame["id"]]
        yield f"csv in: {name}", ok, "{} shapes of {} points in {} dimensions".format(*points.shape)
        written = folder / "ours.csv"
        written.write_bytes(convert(path, "csv")[0])
        other, again = wide(written)
        attributes = [c for c in frame.columns if c != "id" and not re.fullmatch(r"[xyz]\d+", c)]
        ok = same(again, points) and all(
            (frame[c].astype(str) == other[c].astype(str)).all() or same(frame[c], other[c]) for c in attributes
        )
        yield f"csv out: {name}", ok, f"points and {len(attributes)} attributes, read by pandas"
    random = numpy.random.default_rng(4)
    points = random.normal(size=(4, 6, 3))
    names = [f"{axis}{k}" for k in range(6) for axis in "xyz"]
    frame = pandas.DataFrame(points.reshape(4, -1), columns=names, index=pandas.Index(list("abcd"), name="specimen"))
    frame.loc["b", ["x2", "y2", "z2"]] = math.nan
    points[1, 2] = math.nan
    frame.to_csv(folder / "wide.csv")
    found = convert(folder / "wide.csv")[0]
    ok = same([rows(r) for r in found], points) and [r["external_id"] for r in found] == list("abcd")
    yield "csv in: of pandas, wide", ok, "a missing point"
    index = pandas.MultiIndex.from_product([list("abcd"), range(6)], names=["specimen_id", "coord_id"])
    pandas.DataFrame(points.reshape(-1, 3), columns=list("xyz"), index=index).to_csv(
        folder / "long.tsv", sep="\t", na_rep="NA"
    )
    found = convert(folder / "long.tsv")[0]
    ok = same([rows(r) for r in found], points) and [r["external_id"] for r in found] == list("abcd")
    yield "csv in: of pandas, long with tabs", ok, "a missing point"


def matrices(convert, folder):
    import numpy

    random = numpy.random.default_rng(5)
    points = random.normal(size=(4, 5, 3))
    points[2, 1] = math.nan
    names = list("abcd")
    path = folder / "theirs.nts"
    with path.open("w") as file:
        file.write('" of numpy\n1 4L 15 1 -999 DIM=3\n' + " ".join(names) + "\n")
        numpy.savetxt(file, numpy.nan_to_num(points, nan=-999).reshape(4, -1), fmt="%.17g")
    found = convert(path)[0]
    ok = same([rows(r) for r in found], points) and [r["external_id"] for r in found] == names
    yield "nts in: of numpy", ok, "4 shapes, a missing point"
    written = folder / "ours.nts"
    written.write_bytes(convert(path, "nts")[0])
    again = numpy.loadtxt(written, skiprows=5)
    head = written.read_text().splitlines()[:5]
    ok = same(numpy.where(again == 9999, math.nan, again).reshape(points.shape), points)
    yield "nts out: read by numpy", ok and head == ["1 4L 15 1 9999 DIM=3", *names], head[0]
    written = folder / "ours.morphologika"
    written.write_bytes(convert(path, "morphologika")[0])
    lines = [line for line in written.read_text().splitlines() if not line.startswith("'")]
    at = lines.index("[rawpoints]")
    again = numpy.loadtxt(lines[at + 1 : at + 21])
    ok = same(numpy.where(again == 9999, math.nan, again).reshape(points.shape), points)
    ok &= lines[:6] == ["[individuals]", "4", "[landmarks]", "5", "[dimensions]", "3"]
    yield "morphologika out: read by numpy", ok, "4 shapes, a missing point"
    found = convert(written)[0]
    ok = same([rows(r) for r in found], points) and [r["external_id"] for r in found] == names
    yield "morphologika in: what was written", ok, "names and points"


def markups(convert, folder):
    import numpy

    random = numpy.random.default_rng(6)
    points = random.normal(size=(6, 3))
    kinds = ["Fiducial", "Curve", "ClosedCurve"]
    file = {
        "@schema": "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json#",
        "markups": [
            {
                "type": kind,
                "name": kind,
                "coordinateSystem": "RAS",
                "coordinateUnits": "mm",
                "controlPoints": [
                    {"id": str(k), "label": f"p{k}", "position": list(row), "positionStatus": "defined"}
                    for k, row in enumerate(points)
                ],
            }
            for kind in kinds
        ],
    }
    path = folder / "theirs.mrk.json"
    path.write_text(json.dumps(file, indent=4))
    found = convert(path)[0]
    ok = [r.get("closed") for r in found] == [None, False, True] and all(same(rows(r), points) for r in found)
    ok &= all(r["metadata"]["coordinate_system"] == "RAS" for r in found)
    yield "mrk in: of json", ok, "points, a curve, a closed curve"
    again = json.loads(convert(path, "mrk")[0])["markups"]
    ok = [m["type"] for m in again] == kinds and all(
        m["coordinateSystem"] == "RAS"
        and [p["label"] for p in m["controlPoints"]] == [f"p{k}" for k in range(6)]
        and same([p["position"] for p in m["controlPoints"]], points)
        for m in again
    )
    yield "mrk out: read by json", ok, "types, labels and positions"
    file["markups"] = file["markups"][:1]
    path.write_text(json.dumps(file))
    written = folder / "ours.fcsv"
    written.write_bytes(convert(path, "fcsv")[0])
    again = numpy.loadtxt(written, delimiter=",", usecols=(1, 2, 3))
    head = written.read_text().splitlines()[1]
    yield "fcsv out: read by numpy", same(again, points) and head == "# CoordinateSystem = RAS", head
    yield "fcsv in: what was written", same(rows(convert(written)[0][0]), points), "6 points"
    landmarks = [{"id": f"p{k}", "coordinates": list(row)} for k, row in enumerate(points)]
    path = folder / "theirs.json"
    path.write_text(json.dumps(landmarks))
    table = folder / "landmarks.csv"
    table.write_text(
        "# six points\n" + "".join(f"p{k},{x!r},{y!r},{z!r}\n" for k, (x, y, z) in enumerate(points.tolist()))
    )
    for name, file in [("json", path), ("csv", table)]:
        found = convert(file)[0][0]
        ok = same(rows(found), points) and found["metadata"]["landmark_names"] == [f"p{k}" for k in range(6)]
        yield f"scalismo in: of {name}", ok, "names and positions"
