"""Fetches a cohort from the service as `shapelex-engine ingest` reads it: cohort.json and shapes.ndjson.

    python3 fetch.py http://127.0.0.1:8080 femora FOLDER

The token of the service, if it wants one, is in the environment variable SHAPELEX_TOKEN.
"""

import json
import os
import pathlib
import sys
import urllib.parse
import urllib.request


def get(address):
    """Answer of the service. Python reads and writes doubles without a loss."""
    request = urllib.request.Request(address)
    if token := os.environ.get("SHAPELEX_TOKEN"):
        request.add_header("Authorization", f"Bearer {token}")
    with urllib.request.urlopen(request) as answer:
        return json.load(answer)


def fetch(service, cohort, folder):
    base = f"{service.rstrip('/')}/v1/cohorts/{urllib.parse.quote(cohort, safe='')}"
    before = get(base)
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "shapes.ndjson", "w", encoding="utf-8") as lines:
        cursor = ""
        while cursor is not None:
            page = get(f"{base}/shapes?limit=1000" + (f"&cursor={urllib.parse.quote(cursor)}" if cursor else ""))
            for shape in page["items"]:
                lines.write(json.dumps(shape) + "\n")
            cursor = page["next"]
    if get(base)["revision"] != before["revision"]:
        sys.exit("the cohort has changed while it was read: try again")
    (folder / "cohort.json").write_text(json.dumps(before), encoding="utf-8")


if __name__ == "__main__":
    fetch(sys.argv[1], sys.argv[2], pathlib.Path(sys.argv[3]))
