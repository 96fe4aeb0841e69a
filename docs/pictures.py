"""The pictures of the documentation, from a running service with the example cohort.

    python docs/pictures.py http://127.0.0.1:8080 docs/pictures

Writes `cells.svg`: thin cells with their mean, mode 1 at five steps, and cells that were treated against those that were not,
side by side. Needs only Python. The atoms of `docs/inhomogeneous.md` are drawn by `docs/inhomogeneous.py`.
"""

import json
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
            return answer.read().decode()
    except urllib.error.HTTPError as error:
        sys.exit(f"{url}: {error.read().decode()}")


def beside(pictures):
    """SVG documents side by side, as one, each in the middle of the height."""
    sizes = [[int(size) for size in re.search(r'width="(\d+)" height="(\d+)"', picture).groups()] for picture in pictures]
    height, x, parts = max(height for _, height in sizes), 0, []
    for picture, (width, own) in zip(pictures, sizes):
        placed = picture.replace('<svg xmlns="http://www.w3.org/2000/svg"', f'<svg x="{x}" y="{(height - own) // 2}"', 1)
        parts.append(placed)
        x += width + GAP
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {x - GAP} {height}" width="{x - GAP}" height="{height}">'
    return f"{head}\n{''.join(parts)}</svg>\n"


def main():
    base, folder = sys.argv[1].rstrip("/") + "/v1", Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    look = "format=svg&background=none&scale_bar=false"
    dictionary = {"name": "pictures", "cohort": "example-cells", "transformation": "similarity",
                  "method": {"kind": "functional_pca", "components": 4, "centre": True}}
    ask(f"{base}/dictionaries", dictionary, prefer="wait=60")
    treated = [{"name": name, "filter": {"labels": {"treatment": value}}}
               for name, value in [("control", "control"), ("treated (cytochalasin D)", "cytd")]]
    groups = {"cohort": "example-cells", "groups": treated, "transformation": "similarity", "permutations": 999}
    pictures = [
        ask(f"{base}/cohorts/example-cells/mean?transformation=similarity&{look}&width=330"),
        ask(f"{base}/dictionaries/pictures/modes?component=1&{look}&width=520"),
        ask(f"{base}/comparisons?{look}&width=330", groups, prefer="wait=60"),
    ]
    (folder / "cells.svg").write_text(beside(pictures))


if __name__ == "__main__":
    main()
