"""A GeoJSON file of cells of a wanted size, as QuPath writes it: `large_geojson.py BYTES FILE`.

The same size gives the same file. Every cell is a polygon of 24 to 48 points with an id, a class, twelve measurements
and, every second one, a nucleus. Coordinates have two decimals. All but the id repeats after 4000 cells, which makes
writing fast.
"""

import json
import math
import sys

CLASSES = ["Tumor", "Stroma", "Immune cells", "Necrosis"]
MEASUREMENTS = [
    f"{part}: {name}"
    for part in ("Nucleus", "Cell")
    for name in ("Area µm^2", "Perimeter µm", "Circularity", "Max caliper", "Eosin OD mean", "Haematoxylin OD mean")
]

# Number of cells that differ by more than their id.
DISTINCT = 4000


def ring(centre, radius, count, phase):
    """A closed polygon around a centre, whose radius varies with the angle."""
    points = []
    for k in range(count):
        angle = 2 * math.pi * k / count
        r = radius * (1 + 0.2 * math.sin(3 * angle + phase))
        points.append([round(centre[0] + r * math.cos(angle), 2), round(centre[1] + r * math.sin(angle), 2)])
    return [*points, points[0]]


def feature(number):
    """The cell of a number below `DISTINCT`, before and behind its id."""
    mixed = number * 2654435761 % 2**32
    count = 24 + mixed % 25
    centre = (number % 1000 * 40 + 20.5, number // 1000 * 40 + 20.25)
    members = {
        "type": "Feature",
        "id": "|",
        "geometry": {"type": "Polygon", "coordinates": [ring(centre, 15, count, mixed % 7)]},
    }
    if number % 2:
        members["nucleusGeometry"] = {"type": "Polygon", "coordinates": [ring(centre, 6, count // 2, mixed % 5)]}
    members["properties"] = {
        "objectType": "cell",
        "classification": {"name": CLASSES[mixed % 4], "color": [200, mixed % 256, 0]},
        "measurements": {name: round((mixed % (997 + k)) * 0.37, 4) for k, name in enumerate(MEASUREMENTS)},
    }
    return json.dumps(members, ensure_ascii=False, separators=(",", ":")).encode().split(b"|")


def main():
    """Writes features until the size is reached."""
    size, path = int(float(sys.argv[1])), sys.argv[2]
    cells = [feature(number) for number in range(DISTINCT)]
    with open(path, "wb") as file:
        file.write(b'{"type":"FeatureCollection","features":[')
        number, comma = 0, b"\n"
        while file.tell() < size:
            before, behind = cells[number % DISTINCT]
            file.write(comma + before + b"%08x-0000-4000-8000-%012x" % (number % 2**32, number) + behind)
            number, comma = number + 1, b",\n"
        file.write(b"\n]}\n")
        print(f"{number} features, {file.tell()} bytes")


if __name__ == "__main__":
    main()
