#!/usr/bin/env python3
"""Derive the example cohort ``cells.ndjson`` from the geomstats 2.8.0 package.

    python3 derive.py SOURCE             write cells.ndjson beside this script
    python3 derive.py SOURCE --check     compare cells.ndjson with a fresh derivation

SOURCE is the geomstats 2.8.0 wheel or a folder it was unpacked to (an
installed package folder works as well).  Python 3.11 or later, standard
library only; nothing is downloaded.

Input
-----
``geomstats/datasets/data/cells/`` holds three text files:

* ``cells.txt``: 650 outlines separated by an empty line, one ``x y`` pair of
  integers a line (pixel coordinates; y is a negated image row);
* ``cell_lines.txt`` and ``treatments.txt``: one word a line, line i belonging
  to outline i.

The files are read as geomstats' own ``load_cells`` reads them.  Their SHA-256
sums are pinned below, so another version of the data is refused rather than
turned into a different cohort.

Rule
----
1. Clean: drop points equal to their predecessor, then last points equal to the
   first.
2. Usable outlines: an outline is usable when, in this order,
   a. it has at least 60 points;
   b. it does not equal an earlier outline of the source;
   c. at most one point in 50 lies on a pixel the outline has already visited
      (pixel boundaries revisit pixels along one-pixel-wide protrusions; many
      such points mean a trace that hardly is one closed curve);
   d. the outline resampled as in step 4 is a simple polygon that runs
      counter-clockwise: no edge touches or crosses another one except at the
      end point that neighbouring edges share (exact integer arithmetic on the
      rounded coordinates).
3. Choose: in each of the six cell line x treatment groups, let the n usable
   outlines be numbered 0 .. n-1 in source order; take those with the numbers
   floor((2k + 1) * n / 40) for k = 0 .. 19, the middles of 20 equal parts.
4. Resample: with the cumulative chord length s (the chord from the last point
   back to the first included, total L), take the 100 points at L * i / 100 for
   i = 0 .. 99 by linear interpolation.  Point 0 is the first source point.
   Coordinates are rounded to 3 decimals; position, scale, direction and
   starting point remain those of the source.

Output
------
One compact JSON object a line, in source order:

    {"external_id":"cell0007","label":"dlm8/control",
     "labels":{"cell_line":"dlm8","treatment":"control"},"points":[[x,y],...]}

(without the line break).  The number in ``external_id`` is the zero-based index
of the outline in ``cells.txt``.  The last point does not repeat the first.

Only additions, multiplications, divisions and square roots are used, in a fixed
order, all of which IEEE 754 rounds correctly: the bytes are the same on every
platform and on every run.

Exit status: 0 success; 1 ``--check`` found a difference; 2 the source or the
arguments cannot be used.
"""

import argparse
import hashlib
import json
import math
import sys
import zipfile
from pathlib import Path

DATA = "geomstats/datasets/data/cells"
SHA256 = {
    "cells.txt": "76d7ead0f619a93d9c6b026f6e1eada81b5fbc8f54c45f3a48c71babc2dc3918",
    "cell_lines.txt": "cfae6e57367ac429d969627ae3eb539b7e464b95e900360a194da779c5b43ffa",
    "treatments.txt": "3144c1415cc82f74844bfbb23bee70e1e9908ba49e754788c9c3f20b4e67b329",
}
GROUPS = [(line, treatment) for line in ("dlm8", "dunn") for treatment in ("control", "cytd", "jasp")]
PER_GROUP = 20
MIN_POINTS = 60
REVISIT_ONE_IN = 50
SAMPLES = 100
DECIMALS = 3


class SourceError(Exception):
    """The source is not the expected data."""


# --- reading ---------------------------------------------------------------


def read_data_files(source):
    """Return the three data files as text, by name, after checking their sums."""
    raw = {}
    if source.is_dir():
        # The unpacked wheel, or the package folder inside it.
        for folder in (source / DATA, source / DATA.removeprefix("geomstats/")):
            if folder.is_dir():
                raw = {name: (folder / name).read_bytes() for name in SHA256 if (folder / name).is_file()}
                break
        else:
            raise SourceError(f"{source} holds no folder {DATA}")
    elif source.is_file():
        if not zipfile.is_zipfile(source):
            raise SourceError(f"{source} is neither a wheel nor a folder")
        with zipfile.ZipFile(source) as wheel:
            members = set(wheel.namelist())
            raw = {name: wheel.read(f"{DATA}/{name}") for name in SHA256 if f"{DATA}/{name}" in members}
    else:
        raise SourceError(f"{source} does not exist")

    for name, expected in SHA256.items():
        if name not in raw:
            raise SourceError(f"{source} lacks {DATA}/{name}")
        if hashlib.sha256(raw[name]).hexdigest() != expected:
            raise SourceError(f"{DATA}/{name} is not the file of geomstats 2.8.0")
    return {name: data.decode("ascii") for name, data in raw.items()}


def parse(files):
    """Return a list of (outline, cell line, treatment) in source order."""
    outlines = [
        [tuple(int(value) for value in row.split()) for row in block.split("\n")]
        for block in files["cells.txt"].split("\n\n")
    ]
    lines = files["cell_lines.txt"].split("\n")
    treatments = files["treatments.txt"].split("\n")
    if not len(outlines) == len(lines) == len(treatments):
        raise SourceError("the three data files differ in length")
    return list(zip(outlines, lines, treatments))


# --- geometry --------------------------------------------------------------


def clean(points):
    """Drop consecutive duplicates and repetitions of the first point at the end."""
    kept = []
    for point in points:
        if not kept or point != kept[-1]:
            kept.append(point)
    while len(kept) > 1 and kept[-1] == kept[0]:
        kept.pop()
    return kept


def doubled_area(points):
    """Twice the signed area of a polygon with integer coordinates."""
    return sum(ax * by - bx * ay for (ax, ay), (bx, by) in zip(points, points[1:] + points[:1]))


def orientation(a, b, c):
    """Positive when a, b, c turn left; zero when they lie on a line."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def segments_meet(a, b, c, d):
    """Whether the closed segments ab and cd have a point in common."""
    if (
        max(a[0], b[0]) < min(c[0], d[0])
        or max(c[0], d[0]) < min(a[0], b[0])
        or max(a[1], b[1]) < min(c[1], d[1])
        or max(c[1], d[1]) < min(a[1], b[1])
    ):
        return False
    # The bounding boxes meet, so the segments do when each one's end points
    # are not strictly on one side of the other.
    abc, abd = orientation(a, b, c), orientation(a, b, d)
    if (abc > 0 and abd > 0) or (abc < 0 and abd < 0):
        return False
    cda, cdb = orientation(c, d, a), orientation(c, d, b)
    return not ((cda > 0 and cdb > 0) or (cda < 0 and cdb < 0))


def is_simple(points):
    """Whether a closed polygon with integer coordinates is simple (exact)."""
    n = len(points)
    if n < 3 or len(set(points)) != n:
        return False
    # Neighbouring edges share one end point; they must not fold back.
    for i in range(n):
        a, b, c = points[i - 1], points[i], points[(i + 1) % n]
        if orientation(a, b, c) == 0:
            forward = (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1])
            if forward < 0:
                return False
    # All other pairs must be apart.  Edges sorted by their left end: the scan
    # stops at the first edge that begins right of the current one's right end.
    edges = sorted((min(points[i][0], points[(i + 1) % n][0]), i) for i in range(n))
    for position, (_, i) in enumerate(edges):
        a, b = points[i], points[(i + 1) % n]
        right = max(a[0], b[0])
        for left, j in edges[position + 1 :]:
            if left > right:
                break
            if (j - i) % n in (1, n - 1):
                continue
            if segments_meet(a, b, points[j], points[(j + 1) % n]):
                return False
    return True


def resample(points):
    """Return SAMPLES points equally spaced by arc length on the closed polygon."""
    ring = points + points[:1]
    lengths = [0.0]
    for (ax, ay), (bx, by) in zip(ring, ring[1:]):
        chord = math.sqrt((bx - ax) * (bx - ax) + (by - ay) * (by - ay))
        lengths.append(lengths[-1] + chord)
    total = lengths[-1]

    result = []
    segment = 0
    for i in range(SAMPLES):
        target = total * i / SAMPLES
        while lengths[segment + 1] <= target:
            segment += 1
        (ax, ay), (bx, by) = ring[segment], ring[segment + 1]
        t = (target - lengths[segment]) / (lengths[segment + 1] - lengths[segment])
        x, y = ax + t * (bx - ax), ay + t * (by - ay)
        # Adding 0.0 turns a negative zero into zero.
        result.append((round(x, DECIMALS) + 0.0, round(y, DECIMALS) + 0.0))
    return result


def in_thousandths(points):
    """Rounded coordinates as exact integers, for the exact tests."""
    scale = 10**DECIMALS
    return [(round(x * scale), round(y * scale)) for x, y in points]


# --- derivation ------------------------------------------------------------


def derive(source):
    """Return (bytes of cells.ndjson, report lines)."""
    cells = parse(read_data_files(source))
    in_group = dict.fromkeys(GROUPS, 0)
    usable = {group: [] for group in GROUPS}
    dropped = {"short": 0, "repeated": 0, "revisiting": 0, "not simple": 0}
    seen = set()

    for index, (outline, line, treatment) in enumerate(cells):
        group = (line, treatment)
        if group not in usable:
            raise SourceError(f"outline {index} has the unknown group {group}")
        in_group[group] += 1
        points = clean(outline)
        key = tuple(points)
        first_time = key not in seen
        seen.add(key)
        if len(points) < MIN_POINTS:
            dropped["short"] += 1
            continue
        if not first_time:
            dropped["repeated"] += 1
            continue
        revisits = len(points) - len(set(points))
        if revisits * REVISIT_ONE_IN > len(points):
            dropped["revisiting"] += 1
            continue
        sampled = resample(points)
        exact = in_thousandths(sampled)
        if not is_simple(exact) or doubled_area(exact) <= 0:
            dropped["not simple"] += 1
            continue
        usable[group].append((index, sampled))

    chosen = []
    report = []
    for group in GROUPS:
        line, treatment = group
        n = len(usable[group])
        if n < PER_GROUP:
            raise SourceError(f"only {n} usable outlines in {line}/{treatment}")
        for k in range(PER_GROUP):
            index, sampled = usable[group][(2 * k + 1) * n // (2 * PER_GROUP)]
            chosen.append((index, line, treatment, sampled))
        report.append(f"{line}/{treatment}: {in_group[group]} in the source, {n} usable, {PER_GROUP} taken")
    chosen.sort(key=lambda item: item[0])
    report.append("left out: " + ", ".join(f"{count} {reason}" for reason, count in dropped.items()))

    rows = []
    for index, line, treatment, sampled in chosen:
        row = {
            "external_id": f"cell{index:04d}",
            "label": f"{line}/{treatment}",
            "labels": {"cell_line": line, "treatment": treatment},
            "points": sampled,
        }
        rows.append(json.dumps(row, separators=(",", ":"), allow_nan=False) + "\n")
    return "".join(rows).encode("ascii"), report


def main():
    parser = argparse.ArgumentParser(description="Derive cells.ndjson from the geomstats 2.8.0 package.")
    parser.add_argument("source", type=Path, help="the geomstats 2.8.0 wheel or its unpacked folder")
    parser.add_argument(
        "--check",
        action="store_true",
        help="write nothing; exit with 1 when the existing file differs",
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path(__file__).resolve().parent / "cells.ndjson",
        help="the file to write or check (default: cells.ndjson beside this script)",
    )
    arguments = parser.parse_args()

    try:
        data, report = derive(arguments.source)
    except (SourceError, OSError, zipfile.BadZipFile) as error:
        print(f"derive.py: {error}", file=sys.stderr)
        return 2
    digest = hashlib.sha256(data).hexdigest()
    count = data.count(b"\n")

    if arguments.check:
        try:
            existing = arguments.output.read_bytes()
        except FileNotFoundError:
            print(f"{arguments.output} does not exist", file=sys.stderr)
            return 1
        except OSError as error:
            print(f"derive.py: {error}", file=sys.stderr)
            return 2
        if existing != data:
            print(f"{arguments.output} differs from the derivation", file=sys.stderr)
            return 1
        print(f"{arguments.output.name} is as derived: {count} outlines, sha256 {digest}")
        return 0

    try:
        arguments.output.write_bytes(data)
    except OSError as error:
        print(f"derive.py: {error}", file=sys.stderr)
        return 2
    for text in report:
        print(text)
    print(f"{arguments.output.name}: {count} outlines, {len(data)} bytes, sha256 {digest}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
