"""What requests cost: CPU seconds of the service, beside what it predicts before it starts.

    python benches/load/costs.py --binary target/release/shapelex [--only fit] [--report costs.json]

Every request of the table is sent until it has taken a third of a second of CPU (user and system time of the process,
from /proc), one after the other on an idle service; the prediction is the growth of
`shapelex_compute_predicted_microseconds_total` meanwhile. Requests that the service refuses with a predicted cost are
listed with it. Exits with 1 when a prediction of more than `LEAST` seconds is off by more than `FACTOR`. Needs nothing
beyond Python's library.
"""

import argparse
import http.client
import json
import os
import re
import struct
import sys
import tempfile
import zlib
from math import ceil, cos, pi, sin, sqrt
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).parent))
from service import Service  # noqa: E402

FACTOR = 3
# Below this the way of a request through the service is as long as its work.
LEAST = 0.005
ENOUGH = 0.33
# Requests whose work depends on where the shapes lie, not on their number; the tenant's account is corrected
# afterwards.
AFTERWARDS = {"measure zigzag 5x1024"}
TICK = os.sysconf("SC_CLK_TCK")


def blob(random, points, dimension=2, size=10.0):
    """Points on a closed contour with bumps of its own."""
    phase, bump, turn = random.uniform(0, 2 * pi), random.uniform(0.05, 0.3), random.uniform(0, 2 * pi)
    found = []
    for k in range(points):
        t = 2 * pi * k / points
        r = size * (1 + bump * cos(3 * t + phase) + 0.03 * sin(7 * t + 2 * phase))
        found.append(
            [round(1.5 * r * cos(t + turn), 5), round(r * sin(t + turn), 5), round(0.4 * r * sin(2 * t + phase), 5)][
                :dimension
            ]
        )
    return found


def sphere(random, u, v):
    """Points on a bumpy sphere, rows of `u` round the axis and `v` between the poles."""
    bump = random.uniform(0.02, 0.2)

    def at(i, j):
        theta, phi = pi * (j + 0.5) / v, 2 * pi * i / u
        r = 5 * (1 + bump * sin(3 * phi) * sin(theta))
        return [
            round(r * sin(theta) * cos(phi), 5),
            round(r * sin(theta) * sin(phi), 5),
            round(1.3 * r * cos(theta), 5),
        ]

    return [at(i, j) for i in range(u) for j in range(v)]


def curve(n, dimension=2, generator="cubic", kind="closed_curve"):
    return {"kind": kind, "dimension": dimension, "control_points": n, "generator": {"name": generator}}


def shapes(count, points, dimension=2, seed=1):
    random = Random(seed)
    return [{"points": blob(random, points, dimension)} for _ in range(count)]


def statistics(count, representation, transformation="similarity", **more):
    n, d = representation["control_points"], representation["dimension"]
    return {"representation": representation, "transformation": transformation, "shapes": shapes(count, n, d), **more}


def project(count, representation, transformation="similarity", **more):
    body = statistics(count, representation, transformation, **more)
    n, d = representation["control_points"], representation["dimension"]
    return body | {"reference": shapes(1, n, d, 2)[0]}


def opened(count, representation):
    n = representation["intervals"] + 1
    return {
        "representation": representation,
        "transformation": "similarity",
        "reference": shapes(1, n, 2, 2)[0],
        "shapes": shapes(count, n),
    }


def marked(count, points, dimension, transformation="similarity", **more):
    representation = {"kind": "landmarks", "dimension": dimension, "points": points}
    return {
        "representation": representation,
        "transformation": transformation,
        "shapes": shapes(count, points, dimension),
        **more,
    }


def short(count, n):
    """As many numbers as fit into a body."""
    random = Random(5)
    rows = [[[random.randrange(10), random.randrange(10)] for _ in range(n)] for _ in range(count)]
    return {"representation": curve(n), "shapes": [{"points": row} for row in rows]}


def zigzag(count, n):
    """Teeth that nearly touch."""
    half = n // 2
    teeth = [[k, (k % 2) * 100] for k in range(half)] + [[half - k, (k % 2) * 100 + 0.4] for k in range(n - half)]
    return {
        "representation": curve(n, 2, "bspline") | {"generator": {"name": "bspline", "degree": 1}},
        "shapes": [{"points": teeth}] * count,
    }


def measure(count, n, dimension=2, reference=False, generator="cubic"):
    body = {"representation": curve(n, dimension, generator), "shapes": shapes(count, n, dimension)}
    return body | ({"reference": shapes(1, n, dimension, 2)[0]} if reference else {})


def torus_points(random, u, v):
    bump = random.uniform(0.02, 0.2)

    def at(i, j):
        a, b = 2 * pi * i / u, 2 * pi * j / v
        r = 1 + bump * cos(3 * a)
        return [round((4 + r * cos(b)) * cos(a), 5), round((4 + r * cos(b)) * sin(a), 5), round(r * sin(b), 5)]

    return [at(i, j) for i in range(u) for j in range(v)]


def torus(u, v, generator="cubic"):
    return {"kind": "surface", "topology": "torus", "control_points": [u, v], "generators": [{"name": generator}] * 2}


def torus_shapes(count, u, v, seed=1):
    random = Random(seed)
    return [{"control_points": torus_points(random, u, v)} for _ in range(count)]


def mesh(u, v):
    """A closed mesh of a bumpy sphere."""
    points = sphere(Random(1), u, v)
    north, south = len(points), len(points) + 1
    points += [[0, 0, 6.5], [0, 0, -6.5]]
    faces = []
    for i in range(u):
        k = (i + 1) % u
        faces.append([north, i * v, k * v])
        faces.append([south, k * v + v - 1, i * v + v - 1])
        for j in range(v - 1):
            a, b, c, d = i * v + j, i * v + j + 1, k * v + j + 1, k * v + j
            faces += [[a, b, c], [a, c, d]]
    return {"vertices": points, "faces": faces}


def sphere_surface(u, v):
    return {
        "kind": "surface",
        "topology": "sphere",
        "control_points": [u, v],
        "generators": [{"name": "trigonometric"}] * 2,
    }


def sphere_grid(u, v):
    """Points on a sphere with its poles at both ends of every row."""

    def at(i, j):
        theta, phi = pi * j / v, 2 * pi * i / u
        return [5 * sin(theta) * cos(phi), 5 * sin(theta) * sin(phi), 6.5 * cos(theta)]

    return [[at(i, j) for j in range(v + 1)] for i in range(u)]


def blob_mesh(level=2, split=1):
    return {
        "kind": "subdivision",
        "scheme": "loop",
        "connectivity": f"icosahedron/{split}" if split else "icosahedron",
        "level": level,
    }


def subdivision_shapes(count, split):
    random = Random(3)
    rows = 10 * 4**split + 2
    return [{"control_points": [[random.gauss(0, 1) for _ in range(3)] for _ in range(rows)]} for _ in range(count)]


BOUNDARY = "shapelex-costs"


def form(parameters, image):
    """The bytes of a form with an image."""
    parts = [
        ("parameters", "application/json", json.dumps(parameters).encode()),
        ("image", "application/octet-stream", image),
    ]
    head = '--%s\r\ncontent-disposition: form-data; name="%s"; filename="%s"\r\ncontent-type: %s\r\n\r\n'
    return (
        b"".join((head % (BOUNDARY, name, name, kind)).encode() + body + b"\r\n" for name, kind, body in parts)
        + f"--{BOUNDARY}--\r\n".encode()
    )


def png(side, values):
    """A square picture of 8-bit grey values."""
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = b"".join(b"\0" + bytes(values[y * side : (y + 1) * side]) for y in range(side))
    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 1)) + chunk(b"IEND", b"")


def nifti(side, values):
    """A cube of 8-bit values with cells of 1 mm."""
    head = bytearray(352)
    struct.pack_into("<i", head, 0, 348)
    struct.pack_into("<8h", head, 40, 3, side, side, side, 1, 1, 1, 1)
    struct.pack_into("<hh", head, 70, 2, 8)
    struct.pack_into("<8f", head, 76, 1, 1, 1, 1, 0, 0, 0, 0)
    struct.pack_into("<ff", head, 108, 352, 1)
    struct.pack_into("<h", head, 254, 1)
    for row in range(3):
        struct.pack_into("<4f", head, 280 + 16 * row, *[float(row == column) for column in range(4)])
    head[344:348] = b"n+1\0"
    return bytes(head) + bytes(values)


def discs(side, count):
    """A noisy picture of bright ellipses, and a box in each."""
    random, across = Random(7), ceil(sqrt(count))
    step = side / across
    radius = 0.3 * step
    values = bytearray(random.randrange(40, 60) for _ in range(side * side))
    boxes = []
    for i in range(count):
        cx, cy = (i % across + 0.5) * step, (i // across + 0.5) * step
        boxes.append({"lower": [cx - 0.8 * radius, cy - 0.7 * radius], "upper": [cx + 0.9 * radius, cy + 0.6 * radius]})
        for y in range(int(cy - radius), int(cy + radius) + 1):
            for x in range(int(cx - radius), int(cx + radius) + 1):
                if ((x - cx) / radius) ** 2 + ((y - cy) / (0.8 * radius)) ** 2 < 1:
                    values[y * side + x] = random.randrange(190, 210)
    return png(side, values), boxes


def ellipsoid(side):
    """A noisy volume with a bright ellipsoid, and a box in it."""
    random, c, r = Random(8), side / 2, 0.3 * side
    inside = lambda x, y, z: ((x - c) / r) ** 2 + ((y - c) / (0.9 * r)) ** 2 + ((z - c) / (0.8 * r)) ** 2 < 1
    value = lambda x, y, z: (190 if inside(x, y, z) else 40) + random.randrange(20)
    values = [value(x, y, z) for z in range(side) for y in range(side) for x in range(side)]
    return nifti(side, values), [
        {"lower": [c - 0.8 * r, c - 0.8 * r, c - 0.6 * r], "upper": [c + 0.7 * r, c + 0.8 * r, c + 0.7 * r]}
    ]


def segmentations():
    """Objects of pictures and volumes, by terms, methods and representations."""
    terms = lambda *names: {
        "terms": [{"name": name} | ({"theta": 0.6} if name == "threshold" else {}) for name in names]
    }
    trigonometric = lambda n: curve(n, 2, "trigonometric")
    octahedron = lambda split, level: {
        "kind": "subdivision",
        "scheme": "loop",
        "connectivity": f"octahedron/{split}",
        "level": level,
    }
    surface = lambda n, topology="sphere": sphere_surface(n, n) | {"topology": topology}
    contour, wide = terms("contour"), {"stages": [{"free": "affine", "sigma": 8}, {"sigma": 4}, {"sigma": 1}]}
    small, middle, many, large = discs(128, 1), discs(512, 1), discs(512, 25), discs(1024, 4)
    for name, image, representation, more in [
        ("curve in 128", small, trigonometric(12), contour),
        ("curve in 512", middle, trigonometric(12), contour),
        ("curve in 512 threshold", middle, trigonometric(12), terms("threshold")),
        ("curve in 512 local contrast", middle, trigonometric(12), terms("local_contrast")),
        ("curve in 512 two classes", middle, trigonometric(12), terms("two_class")),
        ("curve in 512 wide blurs", middle, trigonometric(12), contour | wide),
        ("curve in 512 newton", middle, trigonometric(12), contour | {"method": "newton"}),
        ("curve in 128 coordinates", small, trigonometric(12), contour | {"method": "coordinates"}),
        ("25 curves of 12 in 512", many, trigonometric(12), contour),
        ("25 curves of 40 in 512", many, trigonometric(40), contour),
        ("4 curves of 200 in 1024", large, trigonometric(200), contour),
        ("4 curves in 1024 by two terms", large, trigonometric(12), terms("contour", "local_contrast")),
    ]:
        yield name, image, representation, more
    small, large = ellipsoid(48), ellipsoid(96)
    for name, image, representation, more in [
        ("sphere in 48", small, surface(6), contour),
        ("sphere in 96", large, surface(6), contour),
        ("sphere of 9 in 96 threshold", large, surface(9), terms("threshold")),
        ("cylinder in 48", small, surface(6, "cylinder"), contour),
        ("octahedron/1 at 3 in 48", small, octahedron(1, 3), contour),
        ("octahedron/2 at 3 in 96", large, octahedron(2, 3), contour),
        ("octahedron/2 at 4 in 48", small, octahedron(2, 4), contour),
    ]:
        yield name, image, representation, more


def shell(side):
    """A noisy volume with a bright spherical shell of two cells, and a box around it."""
    random, c, r = Random(9), side / 2, 0.3 * side
    radius = lambda x, y, z: sqrt((x - c) ** 2 + (y - c) ** 2 + (z - c) ** 2)
    value = lambda x, y, z: (190 if abs(radius(x, y, z) - r) < 1 else 40) + random.randrange(20)
    values = [value(x, y, z) for z in range(side) for y in range(side) for x in range(side)]
    return nifti(side, values), [{"lower": [c - 0.8 * r] * 3, "upper": [c + 0.7 * r] * 3}]


def detections():
    """Sheets of volumes, as answers and as fields of a term."""
    for side in (48, 96):
        image, boxes = shell(side)
        for sigma in (1, 3) if side == 96 else (2,):
            for field in ("response", "surface"):
                yield (
                    f"sheets {field} of {side} at {sigma}",
                    "sheets",
                    form({"field": field, "sigma": sigma, "coordinates": "index"}, image),
                )
        for kind in ("sheets", "edge_map"):
            term = {"name": "contour", "polarity": "dark", "field": {"kind": kind, "sigma": 2}}
            body = {"representation": sphere_surface(6, 6), "boxes": boxes, "terms": [term], "coordinates": "index"}
            yield f"segment sphere in {kind} of {side}", "segment", form(body, image)


def priors():
    """Shapes whose prior is evaluated."""
    for count, n, correspondence in [
        (1, 12, "landmarks"),
        (200, 64, "landmarks"),
        (20, 512, "landmarks"),
        (100, 64, "cyclic"),
    ]:
        body = {"representation": curve(n), "transformation": "similarity", "correspondence": correspondence}
        yield (
            f"prior {count}x{n} {correspondence}",
            "prior",
            body | {"reference": shapes(1, n, 2, 2)[0], "shapes": shapes(count, n)},
        )
    surface = {"representation": torus(16, 12), "transformation": "affine"}
    yield (
        "prior torus 20x(16,12)",
        "prior",
        surface | {"reference": torus_shapes(1, 16, 12, 9)[0], "shapes": torus_shapes(20, 16, 12)},
    )
    mesh_shapes = subdivision_shapes(11, 2)
    body = {
        "representation": blob_mesh(3, 2),
        "transformation": "affine",
        "reference": mesh_shapes[10],
        "shapes": mesh_shapes[:10],
    }
    yield "prior loop 10x162", "prior", body


def table():
    """Name, route, body; small to large of every kind."""
    for name, (image, boxes), representation, more in segmentations():
        yield (
            f"segment {name}",
            "segment",
            form({"representation": representation, "boxes": boxes, "coordinates": "index"} | more, image),
        )
    yield from detections()
    yield from priors()
    yield "project tiny", "project", project(1, curve(6))
    for count, n in [(20, 64), (400, 64), (50, 1024), (400, 2048)]:
        yield f"project {count}x{n}", "project", project(count, curve(n))
    yield "project 3d affine 200x512", "project", project(200, curve(512, 3), "affine")
    yield "project trigonometric 100x512", "project", project(100, curve(512, 2, "trigonometric"))
    yield (
        "project open bspline 100x512",
        "project",
        opened(
            100, {"kind": "open_curve", "dimension": 2, "intervals": 511, "generator": {"name": "bspline", "degree": 3}}
        ),
    )
    yield (
        "project torus 20x(24,16)",
        "project",
        {
            "representation": torus(24, 16),
            "transformation": "affine",
            "reference": torus_shapes(1, 24, 16, 9)[0],
            "shapes": torus_shapes(20, 24, 16),
        },
    )
    for name in ("align", "pca"):
        for count, n in [(2, 6), (20, 64), (400, 64), (2000, 64), (50, 1024), (400, 2048)]:
            yield f"{name} {count}x{n}", name, statistics(count, curve(n))
        yield f"{name} affine 400x512", name, statistics(400, curve(512), "affine")
        yield f"{name} landmarks procrustes 400x256x3", name, marked(400, 256, 3, alignment="procrustes")
    yield "align procrustes 400x2048x3", "align", marked(400, 2048, 3, alignment="procrustes")
    yield "align short numbers 1500x1024", "align", short(1500, 1024) | {"transformation": "similarity"}
    yield "align affine short numbers 3000x1024", "align", short(3000, 1024) | {"transformation": "affine"}
    yield "pca short numbers 1000x512", "pca", short(1000, 512) | {"transformation": "similarity", "components": 100}
    yield "align procrustes 400x1024x2", "align", statistics(400, curve(1024, 2), alignment="procrustes")
    for count, n in [(10, 64), (200, 64), (1000, 128), (100, 1024)]:
        yield f"mean cyclic {count}x{n}", "mean", statistics(count, curve(n), correspondence="cyclic")
    yield (
        "mean cyclic mirror either 200x256",
        "mean",
        statistics(200, curve(256), "affine", correspondence="cyclic", mirror="allow", direction="either"),
    )
    yield "mean arc length 500x128", "mean", statistics(500, curve(128), correspondence="arc_length")
    for count, n in [(1, 64), (100, 64), (1, 2048), (50, 2048)]:
        yield f"measure {count}x{n}", "measure", measure(count, n)
    yield "measure trigonometric 5x512", "measure", measure(5, 512, 2, False, "trigonometric")
    yield "measure 3d 20x1024", "measure", measure(20, 1024, 3)
    yield "measure zigzag 5x1024", "measure", zigzag(5, 1024)
    for count, n, d in [(1, 6, 2), (1, 64, 2), (20, 64, 2), (1, 512, 2), (1, 512, 3), (1, 2048, 2)]:
        yield f"measure reference {count}x{n}x{d}", "measure", measure(count, n, d, True)
    yield "measure reference trigonometric 1x256", "measure", measure(1, 256, 2, True, "trigonometric")
    yield "measure torus 4x(16,12)", "measure", {"representation": torus(16, 12), "shapes": torus_shapes(4, 16, 12)}
    yield "measure torus 2x(40,40)", "measure", {"representation": torus(40, 40), "shapes": torus_shapes(2, 40, 40)}
    yield (
        "measure sphere trigonometric 2x(30,30)",
        "measure",
        {"representation": sphere_surface(30, 30), "shapes": [{"points": sphere_grid(30, 30)}] * 2},
    )
    yield (
        "measure torus reference 2x(16,12)",
        "measure",
        {
            "representation": torus(16, 12),
            "shapes": torus_shapes(2, 16, 12),
            "reference": torus_shapes(1, 16, 12, 4)[0],
        },
    )
    yield (
        "measure subdivision 10 level 3",
        "measure",
        {"representation": blob_mesh(3), "shapes": subdivision_shapes(10, 1)},
    )
    for count, n, samples in [(1, 64, 100), (100, 64, 1000), (1, 64, 100000), (10, 2048, 10000)]:
        yield (
            f"evaluate {count}x{n} at {samples}",
            "evaluate",
            {"representation": curve(n), "shapes": shapes(count, n), "samples": samples},
        )
    yield (
        "evaluate 2 derivatives and frames 1x64 at 100000",
        "evaluate",
        {"representation": curve(64), "shapes": shapes(1, 64), "samples": 100000, "derivatives": 2, "frames": True},
    )
    yield (
        "evaluate trigonometric 2x512 at 10000",
        "evaluate",
        {"representation": curve(512, 2, "trigonometric"), "shapes": shapes(2, 512), "samples": 10000},
    )
    yield (
        "evaluate torus 4x(16,12) at (100,100)",
        "evaluate",
        {"representation": torus(16, 12), "shapes": torus_shapes(4, 16, 12), "grid": [100, 100], "frames": True},
    )
    yield (
        "evaluate subdivision 10 level 3",
        "evaluate",
        {"representation": blob_mesh(3), "shapes": subdivision_shapes(10, 1)},
    )
    yield "resample 20x1000 to 200", "resample", {"count": 200, "shapes": shapes(20, 1000)}
    yield "resample 4x20000 to 100000", "resample", {"count": 100000, "start": "canonical", "shapes": shapes(4, 20000)}
    for count, points, n in [(1, 12, 6), (1, 1000, 64), (50, 1000, 64), (10, 5000, 1024), (2, 20000, 2048)]:
        yield f"fit {count}x{points} to {n}", "fit", {"representation": curve(n), "shapes": shapes(count, points)}
    yield (
        "fit 4x2000 to a tolerance",
        "fit",
        {
            "representation": {
                "kind": "closed_curve",
                "dimension": 2,
                "tolerance": 0.001,
                "generator": {"name": "cubic"},
            },
            "shapes": shapes(4, 2000),
        },
    )
    yield (
        "fit trigonometric 4x2000 to 256",
        "fit",
        {"representation": curve(256, 2, "trigonometric"), "shapes": shapes(4, 2000)},
    )
    yield "fit sphere mesh 20x20 to (8,8)", "fit", {"representation": sphere_surface(8, 8), "meshes": [mesh(20, 20)]}
    yield "fit sphere mesh 60x60 to (8,8)", "fit", {"representation": sphere_surface(8, 8), "meshes": [mesh(60, 60)]}
    yield (
        "fit sphere mesh 150x150 to (8,8)",
        "fit",
        {"representation": sphere_surface(8, 8), "meshes": [mesh(150, 150)]},
    )
    yield (
        "fit sphere mesh 60x60 to (40,40)",
        "fit",
        {"representation": sphere_surface(40, 40), "meshes": [mesh(60, 60)]},
    )
    yield (
        "fit sphere mesh 60x60 to (20,20)",
        "fit",
        {"representation": sphere_surface(20, 20), "meshes": [mesh(60, 60)]},
    )
    yield (
        "fit torus grid (40,30) to (16,12)",
        "fit",
        {
            "representation": torus(16, 12),
            "shapes": [{"points": [torus_points(Random(1), 40, 30)[i * 30 : (i + 1) * 30] for i in range(40)]}],
        },
    )
    yield (
        "fit loop 1000 points",
        "fit",
        {"representation": blob_mesh(2), "turns": 20, "shapes": [{"points": sphere(Random(1), 40, 25)}]},
    )
    yield (
        "fit loop 20000 points",
        "fit",
        {"representation": blob_mesh(2), "turns": 20, "shapes": [{"points": sphere(Random(1), 200, 100)}]},
    )
    yield (
        "fit loop 20000 points 200 turns",
        "fit",
        {"representation": blob_mesh(2), "turns": 200, "shapes": [{"points": sphere(Random(1), 200, 100)}]},
    )
    yield (
        "fit loop 162 rows, 4000 points",
        "fit",
        {"representation": blob_mesh(2, 2), "turns": 20, "shapes": [{"points": sphere(Random(1), 80, 50)}]},
    )
    yield (
        "fit loop 642 rows, 4000 points",
        "fit",
        {"representation": blob_mesh(2, 3), "turns": 5, "shapes": [{"points": sphere(Random(1), 80, 50)}]},
    )
    yield (
        "fit loop level 4, 4000 points",
        "fit",
        {"representation": blob_mesh(4, 1), "turns": 20, "shapes": [{"points": sphere(Random(1), 80, 50)}]},
    )
    yield "fit loop mesh 60x60", "fit", {"representation": blob_mesh(2, 1), "turns": 20, "meshes": [mesh(60, 60)]}
    for count, n, factor in [(1, 6, 2), (100, 64, 4), (10, 1024, 2)]:
        yield (
            f"refine {count}x{n} by {factor}",
            "refine",
            {
                "representation": curve(n, 2, "bspline") | {"generator": {"name": "bspline", "degree": 3}},
                "factor": factor,
                "shapes": shapes(count, n),
            },
        )
    yield (
        "refine 100x64 by 16 in a region",
        "refine",
        {
            "representation": curve(64, 2, "bspline") | {"generator": {"name": "bspline", "degree": 3}},
            "factor": 16,
            "region": {"u": [0.2, 0.8]},
            "shapes": shapes(100, 64),
        },
    )
    yield (
        "refine torus 2x(16,12) by 3",
        "refine",
        {"representation": torus(16, 12), "factor": 3, "shapes": torus_shapes(2, 16, 12)},
    )
    yield (
        "idealised ellipse",
        "idealised",
        {
            "representation": curve(5, 2, "trigonometric"),
            "curves": [{"curve": {"name": "ellipse", "semi_axes": [2, 1]}, "centre": [3, 1], "angle": 0.5}],
        },
    )
    for n, steps in [(6, 11), (64, 1000), (2048, 900)]:
        yield (
            f"morph {n} in {steps}",
            "morph",
            {
                "representation": curve(n),
                "from": shapes(1, n)[0],
                "to": shapes(1, n, 2, 2)[0],
                "path": "sphere",
                "steps": steps,
            },
        )
        yield (
            f"morph {n} in {steps} svg",
            "morph?format=svg",
            {
                "representation": curve(n),
                "from": shapes(1, n)[0],
                "to": shapes(1, n, 2, 2)[0],
                "path": "sphere",
                "steps": steps,
            },
        )
    for n, handles in [(6, 2), (256, 20), (2048, 400)]:
        yield (
            f"deform {n} by {handles}",
            "deform",
            {
                "representation": curve(n),
                "shape": shapes(1, n)[0],
                "handles": [{"parameters": [k / handles], "position": [k, 3]} for k in range(handles)],
            },
        )
    yield (
        "deform torus (24,16) by 100",
        "deform",
        {
            "representation": torus(24, 16),
            "shape": torus_shapes(1, 24, 16)[0],
            "handles": [{"parameters": [k / 100, (7 * k % 100) / 100], "position": [k, 3, 1]} for k in range(100)],
        },
    )
    for level in (2, 5, 6):
        yield (
            f"subdivide octahedron to {level}",
            "subdivide",
            {"scheme": "blob", "lambda": 1.5, "level": level, "start": "octahedron"},
        )
        yield (
            f"subdivide icosahedron loop limit to {level}",
            "subdivide",
            {"scheme": "loop", "level": level, "start": "icosahedron", "limit": True},
        )
        yield (
            f"subdivide icosahedron normal_based to {level}",
            "subdivide",
            {"scheme": "normal_based", "level": level, "start": "icosahedron"},
        )
    square = lambda x: {"contour": [[x, x], [x + 4, x], [x + 4, x + 4], [x, x + 4]]}
    box = lambda start: {
        "size": [128] * 3,
        "spacing": [1, 1, 1],
        "first": [0, 0, 0],
        "runs": [start, 1000000, 1097152 - start],
    }
    for spacing in (0.5, 0.05, 0.004):
        yield f"overlap squares at {spacing}", "overlap", {"first": square(0), "second": square(1), "spacing": spacing}
    yield "overlap meshes 20x20", "overlap", {"first": mesh(20, 20), "second": mesh(18, 18)}
    yield "overlap masks 128^3", "overlap", {"first": {"mask": box(0)}, "second": {"mask": box(500000)}}
    for count, n in [(3, 6), (200, 64), (1500, 64), (200, 2048)]:
        yield f"distances {count}x{n}", "distances", statistics(count, curve(n))
    yield "distances landmarks 2000x8", "distances", marked(2000, 8, 2, "translation")
    yield "distances cyclic 100x64", "distances", statistics(100, curve(64), correspondence="cyclic")
    for count in (1, 50):
        yield (
            f"search {count} of {SEARCHED}x32",
            "cohorts/searched/search",
            {"shapes": shapes(count, 32, 2, 9), "transformation": "similarity", "neighbours": 12},
        )


SEARCHED = 20_000


def furnish(meter):
    """The cohort that is searched; the first search of a table reads it into the cache."""
    cohort = {"name": "searched", "representation": curve(32), "correspondence": "cyclic"}
    sent = [meter.send("cohorts", json.dumps(cohort))]
    sent += [
        meter.send("cohorts/searched/shapes", json.dumps({"shapes": shapes(1000, 32, 2, 100 + seed)}))
        for seed in range(SEARCHED // 1000)
    ]
    if refused := [answer for status, answer in sent if status != 201]:
        raise SystemExit(f"the cohort cannot be stored: {refused[0][:300]}")


class Meter:
    """Requests to a service, and the CPU time that they take."""

    def __init__(self, service):
        self.service = service
        self.connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=600)

    def cpu(self):
        fields = Path(f"/proc/{self.service.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / TICK

    def predicted(self):
        self.connection.request("GET", "/metrics")
        text = self.connection.getresponse().read().decode()
        return 1e-6 * sum(
            float(value)
            for value in re.findall(r"^shapelex_compute_predicted_microseconds_total\{.*\} (\S+)$", text, re.M)
        )

    def send(self, route, body):
        kind = f"multipart/form-data; boundary={BOUNDARY}" if isinstance(body, bytes) else "application/json"
        self.connection.request("POST", f"/v1/{route}", body, {"content-type": kind})
        answer = self.connection.getresponse()
        return answer.status, answer.read()

    def measure(self, route, body):
        """Status, CPU seconds and predicted seconds of one request."""
        text = body if isinstance(body, bytes) else json.dumps(body)
        status, answer = self.send(route, text)
        if status != 200:
            return status, None, None, answer[:300].decode()
        begin, expected, count = self.cpu(), self.predicted(), 0
        while count == 0 or (self.cpu() - begin < ENOUGH and count < 200):
            self.send(route, text)
            count += 1
        return status, (self.cpu() - begin) / count, (self.predicted() - expected) / count, f"{len(text)} B"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", required=True)
    parser.add_argument("--only", default="")
    parser.add_argument("--report")
    options = parser.parse_args()
    rows, wrong = [], 0
    with tempfile.TemporaryDirectory() as folder:
        service = Service(options.binary, Path(folder), None)
        service.start()
        meter = Meter(service)
        furnish(meter)
        for name, route, body in table():
            if options.only not in name:
                continue
            status, cpu, predicted, note = meter.measure(route, body)
            ratio = predicted / cpu if cpu and predicted else None
            bad = (
                ratio is not None
                and max(cpu, predicted) > LEAST
                and not 1 / FACTOR <= ratio <= FACTOR
                and name not in AFTERWARDS
            )
            wrong += bad
            number = lambda value: "-" if value is None else f"{value:.4f}"
            print(
                f"{name:48} {status} {number(cpu):>9} {number(predicted):>9} {number(ratio):>8} "
                f"{'OFF' if bad else '   '} {note}",
                flush=True,
            )
            rows.append({"request": name, "status": status, "cpu_seconds": cpu, "predicted_seconds": predicted})
        service.stop()
    if options.report:
        Path(options.report).write_text(json.dumps(rows, indent=1))
    raise SystemExit(1 if wrong else 0)


if __name__ == "__main__":
    main()
