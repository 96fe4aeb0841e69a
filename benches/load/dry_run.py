"""What learning a dictionary costs, beside what `dry_run` predicts: processor seconds of the service.

    python benches/load/dry_run.py --binary target/release/shapelex [--most 30000]

Cohorts of 64 control points, whose points correspond or whose start points are searched, learnt under three classes.
Every row is learnt until it has taken a second of processor time. Exits with 1 when a prediction is off by more than
`FACTOR`. Needs nothing beyond Python's library.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).parent))
from dashboard import REPRESENTATION, Table, shape  # noqa: E402
from service import Service, upload  # noqa: E402

FACTOR = 1.5
# Below this a request takes longer on its way than its prediction says; nobody waits for it.
LEAST = 0.1
ENOUGH = 1.0
COUNTS = [100, 1_000, 10_000, 30_000, 100_000]
COMPONENTS = {"kind": "functional_pca", "components": 12, "centre": True}
METHODS = [
    ("12 components", COMPONENTS),
    (
        "16 atoms, 3 nonzeros, 20 passes",
        {"kind": "sparse", "atoms": 16, "nonzeros": 3, "max_epochs": 20, "tolerance": 0},
    ),
]


def learn(table, body, number):
    """Predicted and measured processor seconds."""
    service = table.service
    predicted = service.call("POST", "/v1/dictionaries", body | {"name": f"d{number}", "dry_run": True})["estimate"][
        "seconds"
    ]
    spent, times, random = 0.0, 0, Random(number)
    while spent < ENOUGH and times < 20:
        # Another weight, so that the mean of the last time is not taken.
        service.call("PATCH", f"/v1/cohorts/{body['cohort']}/shapes/b{times}", {"weight": 1 + random.random()})
        _, cpu, _ = table.ask("POST", "/v1/dictionaries", body | {"name": f"d{number}-{times}"}, prefer="wait=600")
        spent, times = spent + cpu, times + 1
    return predicted, spent / times


def rows(table, cohort, shapes, number):
    for transformation in ["rigid", "similarity", "affine"]:
        for what, method in METHODS[: 2 if transformation == "similarity" and shapes <= 10_000 else 1]:
            number += 1
            predicted, measured = learn(
                table, {"cohort": cohort, "transformation": transformation, "method": method}, f"{cohort}-{number}"
            )
            ratio = predicted / measured
            print(
                f"| {cohort} | {shapes} | {transformation} | {what} | {predicted:.3f} | {measured:.3f} | {ratio:.2f} |",
                flush=True,
            )
            yield max(predicted, measured) < LEAST or 1 / FACTOR <= ratio <= FACTOR


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True)
    parser.add_argument("--most", type=int, default=30_000)
    arguments = parser.parse_args()
    print(
        "| cohort | shapes | class | method | predicted s | measured s | predicted / measured |\n"
        "|---|---|---|---|---|---|---|"
    )
    good = []
    with tempfile.TemporaryDirectory() as folder:
        service = Service(arguments.binary, Path(folder))
        service.start()
        try:
            for shapes in [count for count in COUNTS if count <= arguments.most]:
                random, lines = Random(5), Path(folder) / "lines"
                with lines.open("w") as file:
                    file.writelines(json.dumps(shape(random, number)) + "\n" for number in range(shapes))
                for correspondence in ["arc_length", "cyclic"]:
                    name = f"{correspondence}-{shapes}".replace("_", "-")
                    service.call(
                        "POST",
                        "/v1/cohorts",
                        {"name": name, "correspondence": correspondence, "representation": REPRESENTATION},
                    )
                    upload(service.port, name, lines)
                    good += rows(Table(service), name, shapes, 0)
        finally:
            service.stop()
    sys.exit(0 if all(good) else 1)


if __name__ == "__main__":
    main()
