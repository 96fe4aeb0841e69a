"""The pictures of docs/segmentation.md, from a running service and phantoms that are drawn here.

    python docs/segmentation.py http://127.0.0.1:8080 docs/pictures

Writes `segmentation-starts.svg`, `segmentation-prior.svg` and `segmentation-sheets.svg`. Needs only Python; the figures
that the page names are printed.
"""

import json
import struct
import sys
import urllib.error
import urllib.request
import zlib
from math import atan2, cos, hypot, pi, sin, sqrt
from pathlib import Path
from random import Random

from pictures import beside

BOUNDARY = "shapelex-pictures"
LOOK = "format=svg&background=none&scale_bar=false&title=false&width=330"


def png(width, height, value, noise=10, seed=1):
    """A picture of grey values between 0 and 255."""
    random = Random(seed)
    grey = lambda x, y: min(255, max(0, round(value(x, y) + random.gauss(0, noise))))
    rows = b"".join(b"\0" + bytes(grey(x, y) for x in range(width)) for y in range(height))
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")


def nifti(side, value, noise=10, seed=1):
    """A cube of 8-bit values with cells of 1 mm."""
    random, head = Random(seed), bytearray(352)
    struct.pack_into("<i", head, 0, 348)
    struct.pack_into("<8h", head, 40, 3, side, side, side, 1, 1, 1, 1)
    struct.pack_into("<hh", head, 70, 2, 8)
    struct.pack_into("<8f", head, 76, 1, 1, 1, 1, 0, 0, 0, 0)
    struct.pack_into("<ff", head, 108, 352, 1)
    struct.pack_into("<h", head, 254, 1)
    for row in range(3):
        struct.pack_into("<4f", head, 280 + 16 * row, *[float(row == column) for column in range(4)])
    head[344:348] = b"n+1\0"
    grey = lambda x, y, z: min(255, max(0, round(value(x, y, z) + random.gauss(0, noise))))
    return bytes(head) + bytes(grey(x, y, z) for z in range(side) for y in range(side) for x in range(side))


def post(url, parameters, **files):
    """Sends a form; returns the body of the answer."""
    parts = [("parameters", json.dumps(parameters).encode()), *files.items()]
    head = '--%s\r\ncontent-disposition: form-data; name="%s"; filename="%s"\r\n\r\n'
    body = b"".join((head % (BOUNDARY, name, name)).encode() + part + b"\r\n" for name, part in parts)
    body += f"--{BOUNDARY}--\r\n".encode()
    headers = {"content-type": f"multipart/form-data; boundary={BOUNDARY}", "prefer": "wait=60"}
    try:
        with urllib.request.urlopen(urllib.request.Request(url, body, headers)) as answer:
            return answer.read()
    except urllib.error.HTTPError as error:
        sys.exit(f"{url}: {error.read().decode()}")


def curve(points):
    return {"kind": "closed_curve", "dimension": 2, "control_points": points, "generator": {"name": "trigonometric"}}


def told(name, answer):
    for result in json.loads(answer)["results"]:
        overlap = result.get("overlap", {}).get("jaccard")
        print(f"{name}: {result['stop']}, {result['iterations']} iterations, Jaccard {overlap}")


def starts(base):
    """One object from a box, at one blur and from coarse to fine."""

    def cell(x, y):
        angle = 1 + 0.28 * cos(3 * (0.4 + atan2(y - 62, x - 66)))
        return 180 if hypot(x - 66, y - 62) < 34 * angle else 50

    image, truth = png(128, 120, cell), png(128, 120, lambda x, y: float(cell(x, y) > 100), noise=0)
    body = {
        "representation": curve(12),
        "boxes": [{"lower": [42, 40], "upper": [84, 76]}],
        "terms": [{"name": "contour"}],
    }
    fine = body | {"stages": [{"sigma": 1}]}
    for name, parameters in [("starts, one blur of a cell", fine), ("starts, the usual stages", body)]:
        told(name, post(f"{base}/segment", parameters, image=image, truth=truth))
    return [post(f"{base}/segment?{LOOK}", parameters, image=image).decode() for parameters in (fine, body)]


def prior(base):
    """A rod that touches another one, without and with the attraction to rods."""

    def rod(x, y, centre, angle):
        u, v = x - centre[0], y - centre[1]
        along, across = u * cos(angle) + v * sin(angle), -u * sin(angle) + v * cos(angle)
        return hypot(max(0, abs(along) - 26), across) < 13

    ours = lambda x, y: rod(x, y, (56, 52), 0.35)
    image = png(128, 112, lambda x, y: 180 if ours(x, y) or rod(x, y, (92, 78), -0.9) else 50)
    truth = png(128, 112, lambda x, y: float(ours(x, y)), noise=0)
    reference = []
    for k in range(12):
        t = 2 * pi * k / 12
        reference.append([39 * cos(t) * (0.96 + 0.04 * cos(2 * t)), 14.5 * sin(t)])
    turned = [
        [56 + 0.85 * (x * cos(0.35) - y * sin(0.35)), 52 + 0.85 * (x * sin(0.35) + y * cos(0.35))] for x, y in reference
    ]
    body = {
        "representation": curve(12),
        "shapes": [{"control_points": turned}],
        "terms": [{"name": "contour"}],
        "stages": [{"sigma": 4}, {"sigma": 2}],
    }
    attracted = body | {
        "prior": {"reference": {"control_points": reference}, "transformation": "similarity", "weight": 30}
    }
    for name, parameters in [("prior, none", body), ("prior, similarity", attracted)]:
        told(name, post(f"{base}/segment", parameters, image=image, truth=truth))
    return [post(f"{base}/segment?{LOOK}", parameters, image=image).decode() for parameters in (body, attracted)]


def sheets(base):
    """What a dark shell encloses: in the image, and in the edge map of the shell."""
    side, centre = 64, (32, 31, 30)

    def head(x, y, z):
        d = sqrt(sum(((p - c) / s) ** 2 for p, c, s in zip((x, y, z), centre, (1.0, 0.85, 0.9))))
        return 150 if d < 19 else 40 if d < 22 else 190 if d < 26 else 15

    image = nifti(side, head)
    truth = nifti(side, lambda x, y, z: float(head(x, y, z) == 150), noise=0)
    surface = {
        "kind": "surface",
        "topology": "sphere",
        "control_points": [6, 6],
        "generators": [{"name": "trigonometric"}] * 2,
    }
    box = {"lower": [20, 20, 20], "upper": [42, 42, 40]}
    stages = [{"free": "affine", "sigma": 6}, {"sigma": 6}, {"sigma": 3}, {"sigma": 1.5}]
    body = {"representation": surface, "boxes": [box], "stages": stages}
    plain = body | {"terms": [{"name": "contour"}]}
    field = {"kind": "edge_map", "sigma": 2, "polarity": "dark", "centre": [31, 31, 30]}
    mapped = body | {"terms": [{"name": "contour", "polarity": "dark", "field": field}]}
    for name, parameters in [("sheets, the image", plain), ("sheets, the edge map", mapped)]:
        told(name, post(f"{base}/segment", parameters, image=image, truth=truth))
    return [post(f"{base}/segment?{LOOK}", parameters, image=image).decode() for parameters in (plain, mapped)]


def main():
    base, folder = sys.argv[1].rstrip("/") + "/v1", Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    for make in (starts, prior, sheets):
        (folder / f"segmentation-{make.__name__}.svg").write_text(beside(make(base)))


if __name__ == "__main__":
    main()
