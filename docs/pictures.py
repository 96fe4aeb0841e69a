"""The pictures of the documentation, from a running service with the example cohort.

    python docs/pictures.py http://127.0.0.1:8080 docs/pictures

Writes `cells.svg`: thin cells with their mean, mode 1 at five steps, and cells that were treated against those that
were not, side by side; and `resolutions.svg`: a surface that is edited at three resolutions, from a sphere of 24 points
on; `regions-1.png` to `regions-3.png`: the same, where the finer resolutions are those of its face and of its eyes
only. Needs only Python. The atoms of `docs/inhomogeneous.md` are drawn by `docs/inhomogeneous.py`.
"""

import json
import math
import re
import sys
import urllib.error
import urllib.request
from pathlib import Path

GAP = 24


def ask(url, body=None, **headers):
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"content-type": "application/json", **headers})
    try:
        with urllib.request.urlopen(request) as answer:
            content = answer.read()
            return content if answer.headers.get_content_type() == "image/png" else content.decode()
    except urllib.error.HTTPError as error:
        sys.exit(f"{url}: {error.read().decode()}")


def beside(pictures):
    """SVG documents side by side, as one, each in the middle of the height."""
    sizes = [
        [int(size) for size in re.search(r'width="(\d+)" height="(\d+)"', picture).groups()] for picture in pictures
    ]
    height, x, parts = max(height for _, height in sizes), 0, []
    for picture, (width, own) in zip(pictures, sizes):
        placed = picture.replace(
            '<svg xmlns="http://www.w3.org/2000/svg"', f'<svg x="{x}" y="{(height - own) // 2}"', 1
        )
        parts.append(placed)
        x += width + GAP
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {x - GAP} {height}" width="{x - GAP}" height="{height}">'
    )
    return f"{head}\n{''.join(parts)}</svg>\n"


def edited(base, representation, rows, edits):
    """The surface with the control points nearest to some places moved away from its axis, or along it at the poles."""
    moves = {}
    for place, by in edits:
        nearest = min(range(len(rows)), key=lambda k: math.dist(rows[k], place))
        moves[nearest] = {"control_point": nearest, "by": by}
    body = {"representation": representation, "shape": {"control_points": rows}, "moves": list(moves.values())}
    return json.loads(ask(f"{base}/deform", body))["control_points"]


def head():
    """Spheres of 24 points, with the smallest of them that is round."""
    shifts = {"name": "interpolator", "family": "half_integer_shifts"}
    poles = [[[0, 0], [0, w], [0, -w]] for w in (2 * math.pi, math.pi)]
    representation = {
        "kind": "surface",
        "topology": "sphere",
        "control_points": [6, 4],
        "generators": [{**shifts, "domain_poles": list_} for list_ in poles],
    }
    sphere = {"representation": representation, "surfaces": [{"surface": {"name": "sphere", "radius": 1}}]}
    return representation, sphere


def drawn(base, look, representation, shape):
    body = {"representation": representation, "shapes": [shape], "grid": [36, 24]}
    return ask(f"{base}/evaluate?{look}&width=300&title=false&legend=false", body)


def regions(base, look):
    """A head: coarse control points, then a block of its face, then one around its eyes. Edits move what is in the
    region only."""
    representation, sphere = head()
    shape = json.loads(ask(f"{base}/idealised", sphere))["shapes"][0]
    stages = [
        (
            None,
            [
                ((0, 0, 1), (0, 0, 0.5)),
                ((0, 0, -1), (0, 0, -0.5)),
                ((-0.7, 0, 0.7), (-0.35, 0, 0.2)),
                ((0.7, 0, -0.7), (0.3, 0, 0)),
            ],
        ),
        (
            {"factor": 4, "region": {"u": [0.75, 1.25], "v": [0.1, 0.9]}},
            [
                ((1.2, 0, -0.1), (0.8, 0, -0.1)),
                ((1.2, 0, 0.25), (0.4, 0, 0)),
                ((1.2, 0.25, -0.1), (0.3, 0.1, 0)),
                ((1.2, -0.25, -0.1), (0.3, -0.1, 0)),
            ],
        ),
        (
            {"factor": 8, "region": {"u": [0.8, 1.2], "v": [0.2, 0.6]}},
            [((1, side * y, z), (0.25, 0, 0)) for side in (-1, 1) for y, z in ((0.3, 0.5), (0.4, 0.5), (0.35, 0.6))],
        ),
    ]
    pictures = []
    for index, (finer, edits) in enumerate(stages):
        if finer:
            body = {"representation": representation, "shapes": [shape], **finer}
            shape = json.loads(ask(f"{base}/refine", body))["shapes"][0]
        block = shape["blocks"][index - 1] if finer else None
        places = block["control_points"] if block else shape["control_points"]
        moves = {}
        for place, by in edits:
            nearest = min(range(len(places)), key=lambda k: math.dist(places[k], place))
            named = (
                {"control_point": block["indices"][nearest], "block": index - 1}
                if block
                else {"control_point": nearest}
            )
            moves[nearest] = {**named, "by": by}
        body = {"representation": representation, "shape": shape, "moves": list(moves.values())}
        edited_ = json.loads(ask(f"{base}/deform", body))
        shape = {key: edited_[key] for key in ("control_points", "blocks") if key in edited_}
        pictures.append(drawn(base, look.replace("format=svg", "format=png"), representation, shape))
    return pictures


def resolutions(base, look):
    """A head: stretched by its coarse control points, then with nose, ears and brows, then with eyes. Each step is the
    same surface on a grid that is twice as fine, exactly, and moves a few control points of it."""
    representation, sphere = head()
    rows = json.loads(ask(f"{base}/idealised", sphere))["shapes"][0]["control_points"]
    stages = [
        [
            ((0, 0, 1), (0, 0, 0.5)),
            ((0, 0, -1), (0, 0, -0.5)),
            ((-0.7, 0, 0.7), (-0.35, 0, 0.2)),
            ((0.7, 0, -0.7), (0.3, 0, 0)),
        ],
        [((1.1, 0, 0), (0.9, 0, -0.15)), ((0, 1.1, 0), (0, 0.7, 0.2)), ((0, -1.1, 0), (0, -0.7, 0.2))],
        [((1, y, 0.5), (0.3, 0, 0)) for y in (-0.35, 0.35)],
    ]
    pictures = []
    for index, edits in enumerate(stages):
        if index:
            body = {"representation": representation, "shapes": [{"control_points": rows}], "factor": 2}
            finer = json.loads(ask(f"{base}/refine", body))
            assert finer["exact"], finer
            representation, rows = finer["representation"], finer["shapes"][0]["control_points"]
        rows = edited(base, representation, rows, edits)
        pictures.append(drawn(base, look, representation, {"control_points": rows}))
    return beside(pictures)


def main():
    base, folder = sys.argv[1].rstrip("/") + "/v1", Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    look = "format=svg&background=none&scale_bar=false"
    dictionary = {
        "name": "pictures",
        "cohort": "example-cells",
        "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 4, "centre": True},
    }
    ask(f"{base}/dictionaries", dictionary, prefer="wait=60")
    treated = [
        {"name": name, "filter": {"labels": {"treatment": value}}}
        for name, value in [("control", "control"), ("treated (cytochalasin D)", "cytd")]
    ]
    groups = {"cohort": "example-cells", "groups": treated, "transformation": "similarity", "permutations": 999}
    pictures = [
        ask(f"{base}/cohorts/example-cells/mean?transformation=similarity&{look}&width=330"),
        ask(f"{base}/dictionaries/pictures/modes?component=1&{look}&width=520"),
        ask(f"{base}/comparisons?{look}&width=330", groups, prefer="wait=60"),
    ]
    (folder / "cells.svg").write_text(beside(pictures))
    (folder / "resolutions.svg").write_text(resolutions(base, look))
    for index, picture in enumerate(regions(base, look), 1):
        (folder / f"regions-{index}.png").write_bytes(picture)


if __name__ == "__main__":
    main()
