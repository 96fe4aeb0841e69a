"""Surfaces of real anatomy through the running service; writes the tables of docs/surfaces-evaluation.md.

    python benches/surfaces/run.py --data FOLDER --program PROGRAM [--out FOLDER] [NAME ...]

FOLDER of `--data` holds the data sets (`surfaces-femora` and so on); NAME chooses experiments (cortex, hippocampi,
endocasts, femora, refined). Needs nothing beyond the standard library. Every figure is made by requests that a client
can repeat; seeds are fixed. Pictures are made of the data and stay under their licences: they go to the folder of
`--out` and nowhere else.
"""

import argparse
import cmath
import csv
import json
import math
import struct
import subprocess
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

PROCRUSTES = {"transformation": "similarity", "alignment": "procrustes"}
AFFINE = {"transformation": "affine"}
WAIT = [("prefer", "wait=60")]


class Refused(Exception):
    """What the service says of a request that it refuses."""


class Service:
    """The program on a free port with an empty folder."""

    def __init__(self, program, folder, out):
        command = [program, "serve", "--listen", "127.0.0.1:0", "--no-example", "--data-dir", folder]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.address = self.process.stdout.readline().split()[-1]
        self.out = out
        self.times = []

    def call(self, method, path, body=None, headers=(), raw=False):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, data, method=method)
        request.add_header("content-type", "application/json")
        for name, value in headers:
            request.add_header(name, value)
        start = time.perf_counter()
        try:
            with urllib.request.urlopen(request, timeout=3600) as answer:
                content = answer.read()
        except urllib.error.HTTPError as error:
            raise Refused(f"{method} {path}: {error.code} {error.read().decode()[:1000]}") from error
        self.times.append((f"{method} {path}", time.perf_counter() - start))
        return content if raw else json.loads(content or b"null")

    def spent(self, since):
        """Seconds of the requests after the first `since`: what the script computes itself does not count."""
        return sum(seconds for _, seconds in self.times[since:])

    def post(self, path, body, headers=()):
        return self.call("POST", path, body, headers)

    def picture(self, name, method, path, body=None):
        """Asks for a drawing; without a folder for it, it is asked for all the same."""
        path += ("&" if "?" in path else "?") + "format=svg"
        try:
            svg = self.call(method, path, body, raw=True)
        except Refused as refused:
            print(f"\nno picture {name}: {refused}")
            return
        if self.out:
            (self.out / f"{name}.svg").write_bytes(svg)

    def cohort(self, name, representation, shapes):
        self.post("/v1/cohorts", {"name": name, "representation": representation, "length_unit": "mm"})
        self.post(f"/v1/cohorts/{name}/shapes", {"shapes": shapes})

    def learn(self, name, cohort, settings, method, **further):
        body = {"name": name, "cohort": cohort, **settings, "method": method, **further}
        job = self.post("/v1/dictionaries", body)
        start = time.perf_counter()
        while job["status"] in ("queued", "running"):
            time.sleep(0.1)
            job = self.call("GET", f"/v1/jobs/{job['id']}")
        self.times.append((f"job of {name}", time.perf_counter() - start))
        if job["status"] != "succeeded":
            raise Refused(json.dumps(job)[:1000])
        return self.call("GET", f"/v1/dictionaries/{name}")


def surface(topology, control_points):
    return {"kind": "surface", "topology": topology, "control_points": control_points}


def table(*head):
    print("\n| " + " | ".join(head) + " |\n|" + "---|" * len(head))


def row(*cells):
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def spread(values, digits=4):
    """Median, smallest and largest."""
    ordered = sorted(values)
    return f"{ordered[len(ordered) // 2]:.{digits}f} ({ordered[0]:.{digits}f}–{ordered[-1]:.{digits}f})"


# Vectors and meshes.


def minus(a, b):
    return [x - y for x, y in zip(a, b)]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def unit(a):
    length = math.sqrt(dot(a, a))
    return [x / length for x in a]


def centroid(points):
    return [sum(axis) / len(points) for axis in zip(*points)]


def centred(points):
    middle = centroid(points)
    return [minus(point, middle) for point in points]


def volume(vertices, faces):
    return sum(dot(vertices[a], cross(vertices[b], vertices[c])) for a, b, c in faces) / 6


def area(vertices, faces):
    normal = lambda a, b, c: cross(minus(vertices[b], vertices[a]), minus(vertices[c], vertices[a]))
    return sum(math.sqrt(dot(n, n)) for n in (normal(*face) for face in faces)) / 2


def mesh(path):
    """Vertices and faces of a binary PLY file of float32 positions and int32 triangles."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    count = lambda name: int(head.split(b"element " + name + b" ")[1].split()[0])
    vertices = [list(point) for point in struct.iter_unpack("<3f", body[: 12 * count(b"vertex")])]
    start = 12 * count(b"vertex")
    faces = struct.iter_unpack("<B3i", body[start : start + 13 * count(b"face")])
    return {"vertices": vertices, "faces": [list(face[1:]) for face in faces]}


def meshes(folder):
    return {path.stem: mesh(path) for path in sorted(folder.glob("*.ply"))}


def measures(service, representation, fits):
    shapes = [{"control_points": fit["control_points"]} for fit in fits]
    return service.post("/v1/measure", {"representation": representation, "shapes": shapes})["results"]


def beyond(service, representation, fits, given):
    """How far each surface leaves the bounding box of its mesh, on a grid of four points a knot."""
    shapes = [{"control_points": fit["control_points"]} for fit in fits]
    grid = [4 * representation["control_points"][0], 4 * representation["control_points"][1] + 1]
    body = {"representation": representation, "shapes": shapes, "grid": grid}
    distances = []
    for evaluation, one in zip(service.post("/v1/evaluate", body)["evaluations"], given):
        rows = flat(evaluation["points"])
        box = [(min(axis), max(axis)) for axis in zip(*one["vertices"])]
        outside = lambda point: max(max(low - x, x - high) for x, (low, high) in zip(point, box))
        distances.append(max(0, max(map(outside, rows))))
    return distances


def flat(points):
    """The points of a grid, or of a list, one after the other."""
    return [point for column in points for point in column] if isinstance(points[0][0], list) else points


def fit(service, representation, given):
    return service.post("/v1/fit", {"representation": representation, "meshes": given})["results"]


# What is asked of every set.


def unit_norm(service, representation, shapes):
    """The same shapes about their mean position, with unit `L₂` norm."""
    body = {"representation": representation, "transformation": "translation"}
    body["shapes"] = [{"control_points": shape["control_points"]} for shape in shapes]
    aligned = service.post("/v1/align", body)["aligned"]
    scale = lambda shape: [[x / shape["size"] for x in point] for point in shape["control_points"]]
    return [{"control_points": scale(shape)} for shape in aligned]


ALIGNMENTS = {
    "affine, as posed": {**AFFINE, "frame": "training"},
    "affine, isotropic": {**AFFINE, "frame": "canonical"},
    "similarity": PROCRUSTES,
}


def first_surface(service, representation, shapes, settings):
    """Squared distances of aligned shapes from the first principal surface, all of unit norm, and its part of the
    whole."""
    body = {"representation": representation, **settings, "shapes": shapes}
    normed = unit_norm(service, representation, service.post("/v1/align", body)["aligned"])
    body = {"representation": representation, "transformation": "translation", "shapes": normed}
    components = service.post("/v1/pca", {**body, "components": 1, "centre": False, "aligned": False})["pca"]
    # all norms are one: the sign of a principal surface means nothing
    return [2 - 2 * abs(scores[0]) for scores in components["scores"]], components["explained"][0]


def explained(service, name, representation, shapes):
    """Schmitter's Table 5.1, with the affine class in both frames of its mean."""
    asked = lambda settings: first_surface(service, representation, shapes, settings)
    answers = {alignment: asked(settings) for alignment, settings in ALIGNMENTS.items()}
    classical = answers["similarity"][0]
    for alignment, (distances, part) in answers.items():
        nearer = sum(d < other for d, other in zip(distances, classical))
        cells = [spread(distances, 5), f"{sum(distances) / len(distances):.5f}", f"{100 * part:.3f} %"]
        row(name, alignment, *cells, f"{nearer} of {len(shapes)}")
    return answers


EXPLAINED = ("data", "aligned by", "d², median (smallest–largest)", "mean d²", "first principal surface", "nearer")


def modes(service, name, cohort, settings):
    """The first centred components of a cohort, and pictures of its mean and modes."""
    method = {"kind": "functional_pca", "components": 10, "centre": True}
    dictionary = service.learn(name, cohort, settings, method)
    query = "&".join(f"{key}={value}" for key, value in settings.items())
    service.picture(f"{name}-mean", "GET", f"/v1/cohorts/{cohort}/mean?{query}")
    for component in (1, 2):
        path = f"/v1/dictionaries/{name}/modes?component={component}&sigma=2"
        service.picture(f"{name}-mode-{component}", "GET", path)
    return dictionary


# The cortex.


def cortex(service, data):
    """The fsaverage5 left hemisphere with the spherical parameters that come with it."""
    folder = data / "surfaces-fsaverage5"
    directions = [unit(vertex) for vertex in mesh(folder / "left_sphere.ply")["vertices"]]
    head = ("surface", "control points", "residual, mm", "largest, mm", "folded")
    table(*head, "beyond the box, mm", "volume fit/mesh", "area fit/mesh", "seconds")
    for name in ("inflated", "white", "pial"):
        given = mesh(folder / f"left_{name}.ply")
        for size in ([24, 24], [36, 36], [44, 44]):
            representation, before = surface("sphere", size), len(service.times)
            cells = [name, f"{size[0]} × {size[1]}"]
            try:
                fits = fit(service, representation, [{**given, "sphere": directions}])
            except Refused as refused:
                row(*cells, str(refused)[-300:])
                continue
            seconds = service.spent(before)
            measured = measures(service, representation, fits)[0]
            cells += [f"{fits[0]['residual']:.2f}", f"{fits[0]['largest_residual']:.1f}", f"{fits[0]['folded']:.4f}"]
            cells.append(f"{beyond(service, representation, fits, [given])[0]:.1f}")
            cells.append(f"{measured['volume'] / volume(**given):.4f}")
            cells.append(f"{measured['area'] / area(**given):.4f}")
            row(*cells, f"{seconds:.2f}")
            body = {"representation": representation, "shapes": [{"control_points": fits[0]["control_points"]}]}
            service.picture(f"cortex-{name}-{size[0]}", "POST", "/v1/evaluate", body)


# Hippocampi.


def long_axis(vertices):
    """Principal axis of the vertices, towards growing y: the masks of the data have the anterior part there."""
    points, axis = centred(vertices), [0.0, 1.0, 0.0]
    for _ in range(100):
        axis = unit([sum(dot(point, axis) * point[i] for point in points) for i in range(3)])
    return axis


def ends(vertices):
    axis = long_axis(vertices)
    heights = [dot(vertex, axis) for vertex in vertices]
    return [heights.index(max(heights)), heights.index(min(heights))]


def turned(vertices, parameters):
    """The same longitudes counted from the side of z, which the mirror in x keeps, judged by the middle latitudes."""
    north = long_axis(vertices)
    prime = unit(minus([0.0, 0.0, 1.0], [north[2] * x for x in north]))
    east = cross(north, prime)
    offset = 0
    for point, (u, v) in zip(centred(vertices), parameters):
        if 0.25 < v < 0.75:
            offset += complex(dot(point, prime), dot(point, east)) * cmath.exp(-2j * math.pi * u)
    shift = cmath.phase(offset) / (2 * math.pi)
    return [[(u + shift) % 1, v] for u, v in parameters]


def in_correspondence(service, given, size):
    """Fits with poles at the ends and longitudes from one side."""
    representation = surface("sphere", size)
    with_poles = [{**one, "poles": ends(one["vertices"])} for one in given]
    first = fit(service, representation, with_poles)
    again = [{**one, "parameters": turned(one["vertices"], fitted["parameters"])} for one, fitted in zip(given, first)]
    return representation, fit(service, representation, again)


def anterior(data):
    """Recorded voxels: the part of a hippocampus that is anterior."""
    with open(data / "volumes-hippocampus-mri" / "cases.csv", newline="") as file:
        counts = {
            row["case"]: (int(row["voxels_anterior"]), int(row["voxels_posterior"])) for row in csv.DictReader(file)
        }
    return {case: front / (front + back) for case, (front, back) in counts.items()}


def hippocampi(service, data):
    """60 meshes without correspondence."""
    given = meshes(data / "surfaces-hippocampus" / "meshes")
    gaps(service, list(given.values()))
    head = ("control points", "residual/∛volume", "largest/∛volume", "folded")
    table(*head, "volume fit/mesh", "beyond the box, mm", "seconds")
    for size in ([10, 8], [16, 12], [14, 14]):
        representation, fits = hippocampi_fit(service, list(given.values()), size)
    share = anterior(data)
    middle = sorted(share[case] for case in given)[len(given) // 2]
    shapes = [
        {
            "external_id": case,
            "label": "large head" if share[case] > middle else "small head",
            "labels": {"anterior": share[case]},
            "control_points": fitted["control_points"],
        }
        for case, fitted in zip(given, fits)
    ]
    service.cohort("hippocampi", representation, shapes)
    service.picture("hippocampus-first", "GET", f"/v1/cohorts/hippocampi/shapes/{shapes[0]['external_id']}")
    variation(service, "hippocampi")
    bare = [{"control_points": fitted["control_points"]} for fitted in fits]
    sides(service, list(given.values()))
    anterior_share(service)
    table(*EXPLAINED)
    explained(service, "hippocampi", representation, bare)


def gaps(service, given):
    """Ever more control points on 1202 vertices, poles chosen by the service: none may run away in between."""
    table("control points", "residual, mm", "folded", "beyond the box, mm", "refused")
    for count in (14, 16, 18, 20):
        representation, fits, fitted = surface("sphere", [count, count]), [], []
        for one in given:
            try:
                fits += fit(service, representation, [one])
                fitted.append(one)
            except Refused as refused:
                print(str(refused)[-300:])
        outside = beyond(service, representation, fits, fitted)
        cells = [spread((f[field] for f in fits), 3) for field in ("residual", "folded")]
        row(f"{count} × {count}", *cells, spread(outside), len(given) - len(fits))


def hippocampi_fit(service, given, size):
    volumes, before = [volume(**one) for one in given], len(service.times)
    representation, fits = in_correspondence(service, given, size)
    seconds = service.spent(before)
    cells = fit_cells(service, representation, fits, volumes)
    outside = spread(beyond(service, representation, fits, given), 2)
    row(f"{size[0]} × {size[1]}", *cells, outside, f"{seconds:.1f}")
    return representation, fits


def fit_cells(service, representation, fits, volumes):
    """Residuals in parts of the size of the mesh, and the volume."""
    lengths = [v ** (1 / 3) for v in volumes]
    measured = measures(service, representation, fits)
    cells = [
        spread(f[field] / length for f, length in zip(fits, lengths)) for field in ("residual", "largest_residual")
    ]
    cells.append(spread(f["folded"] for f in fits))
    return cells + [spread(m["volume"] / v for m, v in zip(measured, volumes))]


def variation(service, cohort):
    table(f"{cohort}: variance about the mean", "1", "2", "3", "4", "5", "of 10", "seconds")
    for name, settings in (("affine", AFFINE), ("similarity", PROCRUSTES)):
        start = time.perf_counter()
        parts = [atom["explained"] for atom in modes(service, f"{cohort}-{name}", cohort, settings)["atoms"]]
        seconds = time.perf_counter() - start
        row(name, *(f"{100 * part:.1f} %" for part in parts[:5]), f"{100 * sum(parts):.1f} %", f"{seconds:.1f}")


def turned_over(given):
    """The mirror image in x, normals still outside."""
    return {"vertices": [[-x, y, z] for x, y, z in given["vertices"]], "faces": [face[::-1] for face in given["faces"]]}


def sides(service, given):
    """Whether the set holds mirror images of one another, and whether half a set that was turned over is told apart."""
    half = [turned_over(one) if k % 2 else one for k, one in enumerate(given)]
    table("meshes", "mirror", "reflected", "reversed", "mean d² of pairs", "seconds")
    for name, chosen in (("as given", given), ("every other one turned over", half)):
        representation, fits = in_correspondence(service, chosen, [14, 14])
        shapes = [{"control_points": fitted["control_points"]} for fitted in fits]
        for mirror in ("forbid", "allow"):
            before = len(service.times)
            body = {"representation": representation, **PROCRUSTES, "shapes": shapes, "mirror": mirror}
            aligned = service.post("/v1/align", body)["aligned"]
            lines = service.post("/v1/distances", body, WAIT)["distances"]
            squared = [lines[i][j] ** 2 for i in range(len(lines)) for j in range(i)]
            flags = [sum(shape[flag] for shape in aligned) for flag in ("reflected", "reversed")]
            row(name, mirror, *flags, f"{sum(squared) / len(squared):.5f}", f"{service.spent(before):.2f}")


def anterior_share(service):
    """Shape against the recorded part of the volume that is anterior, size removed."""
    body = {"cohort": "hippocampi", **PROCRUSTES, "permutations": 9999, "seed": 1}
    pair = service.post("/v1/comparisons", {**body, "by": "label"}, WAIT)["pairs"][0]
    comparison_table(pair)
    service.picture("hippocampi-comparison", "POST", "/v1/comparisons", {**body, "by": "label"})
    table("regression on", "R²", "pseudo-F", "p")
    for attribute in ("labels.anterior", "log_centroid_size"):
        answer = service.post("/v1/regressions", {**body, "attribute": attribute}, WAIT)
        row(attribute, f"{answer['r_squared']:.4f}", f"{answer['pseudo_f']:.2f}", f"{answer['test']['p']:.4f}")
    service.picture("hippocampi-regression", "POST", "/v1/regressions", {**body, "attribute": "labels.anterior"})


def comparison_table(pair):
    table("groups", "statistic", "value", "p")
    groups = f"{pair['first']} / {pair['second']}"
    for name in ("distance", "pseudo_f", "hotelling"):
        row(groups, name, f"{pair[name]['value']:.4f}", f"{pair[name]['test']['p']:.4f}")
    row(groups, "R²", f"{pair['r_squared']:.4f}", "")
    clearest = min(pair["effect"], key=lambda point: point["p"])
    place = ", ".join(f"{place:.2f}" for place in clearest["surface_parameters"])
    row(groups, "smallest p on the surface", f"at ({place})", f"{clearest['p']:.4f}")
    for size in pair["sizes"]:
        row(groups, size["measure"], "", f"{size['test']['p']:.4f}")


# Endocasts.

GIBBONS = "HAGILIS HKLO HLAR HMUE HPIL HOOHOO NOMCON NOMLEU SYMP".split()
RINGS = 6


def boundary(faces):
    """The one loop of edges that have a triangle on one side only, in the order of its own edges."""
    edges = {(a, b) for face in faces for a, b in zip(face, face[1:] + face[:1])}
    following = {a: b for a, b in edges if (b, a) not in edges}
    start = min(following)
    loop = [start]
    while following[loop[-1]] != start:
        loop.append(following[loop[-1]])
    return loop


def capped(given, loop):
    """The mesh closed by rings that shrink to the middle of the loop: one fan is too coarse for even parameters."""
    vertices, faces = list(given["vertices"]), list(given["faces"])
    rim, middle = [vertices[i] for i in loop], centroid([vertices[i] for i in loop])
    outer = loop
    for ring in range(1, RINGS):
        part = ring / RINGS
        inner = range(len(vertices), len(vertices) + len(loop))
        vertices += [[(1 - part) * x + part * m for x, m in zip(point, middle)] for point in rim]
        for i in range(len(loop)):
            j = (i + 1) % len(loop)
            faces += [[outer[j], outer[i], inner[i]], [outer[j], inner[i], inner[j]]]
        outer = inner
    vertices.append(middle)
    faces += [[outer[(i + 1) % len(loop)], outer[i], len(vertices) - 1] for i in range(len(loop))]
    # the data have vertices without a triangle, which the service refuses
    used = sorted({i for face in faces for i in face})
    place = {i: k for k, i in enumerate(used)}
    return {"vertices": [vertices[i] for i in used], "faces": [[place[i] for i in face] for face in faces]}


def average(service, given):
    """The Procrustes mean of meshes whose vertices correspond."""
    count = len(given[0]["vertices"])
    representation = {"kind": "landmarks", "dimension": 3, "points": count}
    shapes = [{"points": one["vertices"]} for one in given]
    body = {"representation": representation, **PROCRUSTES, "shapes": shapes}
    return {"vertices": service.post("/v1/mean", body)["mean"]["control_points"], "faces": given[0]["faces"]}


def endocasts(service, data):
    """19 taxa whose vertices correspond: one parameterisation for all."""
    given = meshes(data / "surfaces-primate-endocasts")
    loop = boundary(next(iter(given.values()))["faces"])
    closed = {name: capped(one, loop) for name, one in given.items()}
    head = ("control points", "residual/∛volume", "largest/∛volume", "folded", "volume fit/mesh")
    table(*head, "beyond the box, mm", "seconds for 19")
    template = average(service, list(closed.values()))
    for size in ([8, 8], [16, 16], [12, 12]):
        representation, fits = endocasts_fit(service, template, list(closed.values()), size)
    label = lambda name: "gibbons" if name in GIBBONS else "hominids"
    shapes = [
        {"external_id": name, "label": label(name), "control_points": fitted["control_points"]}
        for name, fitted in zip(closed, fits)
    ]
    service.cohort("endocasts", representation, shapes)
    for name in ("HSAP", "AAFR", "HLAR"):
        service.picture(f"endocast-{name}", "GET", f"/v1/cohorts/endocasts/shapes/{name}")
    variation(service, "endocasts")
    for name in ("gibbons", "hominids"):
        path = f"/v1/cohorts/endocasts/mean?transformation=similarity&alignment=procrustes&label={name}"
        service.picture(f"endocasts-mean-{name}", "GET", path)
    validated(service)
    body = {"cohort": "endocasts", **PROCRUSTES, "by": "label", "permutations": 9999, "seed": 1}
    comparison_table(service.post("/v1/comparisons", body, WAIT)["pairs"][0])
    service.picture("endocasts-comparison", "POST", "/v1/comparisons", body)
    table(*EXPLAINED)
    bare = [{"control_points": fitted["control_points"]} for fitted in fits]
    explained(service, "endocasts", representation, bare)


def endocasts_fit(service, template, closed, size):
    template = {**template, "poles": ends_along(template["vertices"], 0)}
    representation, before = surface("sphere", size), len(service.times)
    parameters = fit(service, representation, [template])[0]["parameters"]
    fits = fit(service, representation, [{**one, "parameters": parameters} for one in closed])
    seconds = service.spent(before)
    cells = fit_cells(service, representation, fits, [volume(**one) for one in closed])
    outside = spread(beyond(service, representation, fits, closed), 2)
    row(f"{size[0]} × {size[1]}", *cells, outside, f"{seconds:.2f}")
    return representation, fits


def ends_along(vertices, axis):
    places = [vertex[axis] for vertex in vertices]
    return [places.index(max(places)), places.index(min(places))]


FOLDS = 9


def validated(service):
    """As many parts as the smaller class has shapes: every part has one of each class, or two."""
    table("class removed", "classifier", "accuracy", "95 %", "balanced", "seconds")
    method = {"kind": "functional_pca", "components": 5, "centre": True}
    for removed, settings in (("similarity", PROCRUSTES), ("affine", AFFINE)):
        for kind in ("mean_space", "nearest_neighbours", "discriminant"):
            start = time.perf_counter()
            name = f"taxa-{removed}-{kind}"
            classifier = {"kind": kind, "folds": FOLDS, "repeats": 3}
            dictionary = service.learn(name, "endocasts", settings, method, classifier=classifier)
            seconds = time.perf_counter() - start
            validation = dictionary["classifier"]["validation"]
            accuracy, balanced = validation["accuracy"], validation["balanced_accuracy"]["value"]
            interval = f"{accuracy['low']:.3f}–{accuracy['high']:.3f}"
            row(removed, kind, f"{accuracy['value']:.3f}", interval, f"{balanced:.3f}", f"{seconds:.1f}")


# Femora.


def tube(path):
    """The outer surface as a grid: round the shaft, then along it."""
    grid = {}
    with open(path, newline="") as file:
        for point in csv.DictReader(file):
            if point["surface"] == "periosteal":
                place = int(point["point"]), int(point["section"])
                grid[place] = [float(point[axis]) for axis in "xyz"]
    around, along = (1 + max(place[axis] for place in grid) for axis in (0, 1))
    return [[grid[k, l] for l in range(along)] for k in range(around)]


def tube_volume(points):
    """What the polygons enclose, by the trapezoidal rule along the shaft."""

    def section(l):
        ring = [column[l] for column in points]
        return sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(ring, ring[1:] + ring[:1])) / 2

    heights = [point[2] for point in points[0]]
    steps = zip(heights, heights[1:], range(len(heights)))
    return sum((b - a) * (section(l) + section(l + 1)) / 2 for a, b, l in steps)


def femora(service, data):
    """14 shafts whose points correspond."""
    paths = sorted((data / "surfaces-femora").glob("fem_*.csv"), key=lambda path: int(path.stem[4:]))
    bones = {path.stem: tube(path) for path in paths}
    volumes = [tube_volume(points) for points in bones.values()]
    table("control points", "residual, mm", "largest, mm", "volume fit/polygons", "seconds for 14")
    for size in ([16, 10], [32, 20], [48, 30]):
        representation, before = surface("cylinder", size), len(service.times)
        body = {"representation": representation, "shapes": [{"points": points} for points in bones.values()]}
        fits = service.post("/v1/fit", body)["results"]
        seconds = service.spent(before)
        measured = measures(service, representation, fits)
        cells = [spread((f[field] for f in fits), 3) for field in ("residual", "largest_residual")]
        cells.append(spread(m["volume"] / v for m, v in zip(measured, volumes)))
        row(f"{size[0]} × {size[1]}", *cells, f"{seconds:.2f}")
        if size == [32, 20]:
            chosen = representation, fits
    representation, fits = chosen
    bare = [{"control_points": fitted["control_points"]} for fitted in fits]
    service.cohort("femora", representation, [{"external_id": n, **shape} for n, shape in zip(bones, bare)])
    service.picture("femur-first", "GET", f"/v1/cohorts/femora/shapes/{next(iter(bones))}")
    variation(service, "femora")
    table(*EXPLAINED)
    answers = explained(service, "femora", representation, bare)
    table("bone", *(f"d², {name}" for name in answers))
    for i, bone in enumerate(bones):
        row(bone, *(f"{distances[i]:.5f}" for distances, _ in answers.values()))


SCHEMES = {
    "BLOB, λ = π/2": {"scheme": "blob", "lambda": math.pi / 2},
    "BLOB, λ = 1.5i": {"scheme": "blob", "lambda_imaginary": 1.5},
    "Loop": {"scheme": "loop"},
    "butterfly": {"scheme": "butterfly"},
}


def refined(service, data):
    """Subdivision surfaces with 66 and 258 control vertices and 4098 vertices at their level, on the 60 hippocampi."""
    given = meshes(data / "surfaces-hippocampus" / "meshes")
    bodies = list(given.values())
    volumes = [volume(**one) for one in bodies]
    table(
        "control vertices",
        "scheme",
        "residual/∛volume",
        "volume fit/mesh",
        "Jaccard",
        "Dice",
        "Hausdorff 95 %, mm",
        "seconds",
    )
    for splits, level in ((2, 3), (3, 2)):
        for name, scheme in SCHEMES.items():
            representation = {"kind": "subdivision", **scheme, "level": level, "connectivity": f"octahedron/{splits}"}
            before = len(service.times)
            fits = fit(service, representation, bodies)
            seconds = service.spent(before)
            measured = measures(service, representation, fits)
            overlaps = overlapping(service, representation, fits, bodies)
            row(
                4 ** (splits + 1) + 2,
                name,
                spread(f["residual"] / v ** (1 / 3) for f, v in zip(fits, volumes)),
                spread(m["volume"] / v for m, v in zip(measured, volumes)),
                *(spread(o[field] for o in overlaps) for field in ("jaccard", "dice", "hausdorff_95")),
                f"{seconds:.1f}",
            )
            if name == "Loop" and splits == 3:
                shapes = [{"external_id": n, "control_points": f["control_points"]} for n, f in zip(given, fits)]
                service.cohort("refined", representation, shapes)
    first = next(iter(given))
    service.picture("hippocampus-refined", "GET", f"/v1/cohorts/refined/shapes/{first}")
    variation(service, "refined")
    mean = "/v1/cohorts/refined/mean?transformation=similarity&alignment=procrustes"
    service.picture("hippocampi-refined-mean", "GET", mean)
    service.picture("hippocampi-refined-mode", "GET", "/v1/dictionaries/refined-similarity/modes?component=1&sigma=2")


# Cells of the overlap, a fifth of the voxels from which the meshes were made.
SPACING = 0.2


def overlapping(service, representation, fits, bodies):
    """Fits at their level against the meshes."""
    found = []
    for fitted, body in zip(fits, bodies):
        shape = {"control_points": fitted["control_points"]}
        answer = service.post("/v1/evaluate", {"representation": representation, "shapes": [shape]})
        first = {"vertices": answer["evaluations"][0]["points"], "faces": answer["faces"]}
        found.append(service.post("/v1/overlap", {"first": first, "second": body, "spacing": SPACING}))
    return found


EXPERIMENTS = {
    "cortex": cortex,
    "hippocampi": hippocampi,
    "endocasts": endocasts,
    "femora": femora,
    "refined": refined,
}


def slowest(times):
    table("slowest requests", "seconds")
    for name, seconds in sorted(times, key=lambda entry: -entry[1])[:8]:
        row(f"`{name}`", f"{seconds:.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--program", required=True)
    parser.add_argument("--out", type=Path)
    parser.add_argument("names", nargs="*")
    options = parser.parse_args()
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
    for name in options.names or EXPERIMENTS:
        with tempfile.TemporaryDirectory() as folder:
            service = Service(options.program, folder, options.out)
            try:
                print(f"\n## {name}")
                EXPERIMENTS[name](service, options.data)
                slowest(service.times)
            finally:
                service.process.kill()


if __name__ == "__main__":
    main()
