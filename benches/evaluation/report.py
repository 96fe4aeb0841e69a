"""Report cards of dictionaries of real shapes, and their cost, through the running service; prints the section of
docs/evaluation.md.

    python benches/evaluation/report.py --data FOLDER [--binary PROGRAM] [--only cards|cost]

FOLDER holds the data sets (`curves-mosquito-wings/curves.ndjson` and so on). Contours are resampled to 63 points by arc
length, of unit centroid size. Nothing beyond the standard library.

cards  for each set: explained variance, generalisation, specificity and stability of its modes.
cost   1 000 shapes of 128 points, drawn from the components of a set: time from request to result, processor time, peak
       memory of the service, and the prediction of the job.
"""

import argparse
import tempfile
import time
from pathlib import Path
from random import Random

from robust import REPRESENTATION, SETS, body, drawn, read
from run import ROOT, Service

COMPONENTS = {"kind": "functional_pca", "components": 20, "centre": True}


def stored(service, name, representation, shapes):
    service.cohort(name, representation, "landmarks", shapes)
    service.finished(
        service.call(
            "POST",
            "/v1/dictionaries",
            {"name": name, "cohort": name, "transformation": "similarity", "method": COMPONENTS},
        )
    )


def report(service, name, request):
    answer = service.call("POST", f"/v1/dictionaries/{name}/report", request)
    return service.finished(answer)["result"] if "status" in answer else answer


def between(interval, factor=1, digits=1):
    return (
        f"{factor * interval['value']:.{digits}f} "
        f"({factor * interval['low']:.{digits}f}–{factor * interval['high']:.{digits}f})"
    )


def cards(service, folder):
    print(
        "| set | shapes | modes for 95 % | generalisation, 0, 5, 10, 20 modes, thousandths of the centroid size | "
        "specificity, 5, 10, 20 modes "
        "| median angle of modes 1, 2, 3 when resampled | span of 3 |"
    )
    print("|---|---|---|---|---|---|---|")
    for name in SETS:
        shapes = read(folder, name)
        # Of centroid size one: root mean square distances are thousandths of it, times the root of the number of
        # points.
        size = 1000 * len(shapes[0]) ** 0.5
        stored(service, name, REPRESENTATION, [{"points": [[p.real, p.imag] for p in shape]} for shape in shapes])
        found = report(service, name, {})
        modes = found["modes"]
        enough = next((mode["component"] for mode in modes if mode["compactness"]["value"] >= 0.95), "more than 20")
        general = [found["mean_only"], modes[4], modes[9], modes[-1]]
        angles = ", ".join(f"{mode['angle_deg']['median']:.1f}°" for mode in modes[:3])
        print(
            f"| {name} | {found['shape_count']} | {enough} | "
            f"{', '.join(between(m['generalisation'], size) for m in general)} "
            f"| {', '.join(between(m['specificity'], size) for m in general[1:])} | {angles} | "
            f"{modes[2]['span_angle_deg']['median']:.1f}° |",
            flush=True,
        )


def processor(service):
    fields = Path(f"/proc/{service.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100


def peak(service):
    status = Path(f"/proc/{service.process.pid}/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1]) / 1024


def cost(service, folder):
    shapes = read(folder, "mosquito-wings")
    answer = service.call(
        "POST", "/v1/pca", body(shapes, False, "landmarks", components=30, centre=True, aligned=False)
    )
    random = Random(5)
    thousand = drawn(answer, random, 1000)
    noisy = lambda p: [p.real + random.gauss(0, 2e-3), p.imag + random.gauss(0, 2e-3)]
    # Between two of 63 points their mean: 128 points, with noise, so that all directions vary.
    finer = lambda shape: (
        [noisy(p) for k, q in enumerate(shape) for p in (q, (q + shape[(k + 1) % len(shape)]) / 2)]
        + [noisy(shape[0]), noisy(shape[1])]
    )
    representation = {**REPRESENTATION, "control_points": 128}
    stored(service, "thousand", representation, [{"points": finer(shape)} for shape in thousand])
    print("| report of 1 000 shapes of 128 points | from request to result | processor | peak memory of the service |")
    print("|---|---|---|---|")
    measurements = [{"name": "width", "measure": {"kind": "width", "along": [0.0, 0.5]}, "values": []}]
    for text, request in [
        ("20 modes", {}),
        ("20 modes, a measurement", {"measurements": measurements}),
        ("20 modes, 1 000 resamples", {"resamples": 1000}),
    ]:
        begin, busy = time.perf_counter(), processor(service)
        report(service, "thousand", request)
        print(
            f"| {text} | {time.perf_counter() - begin:.1f} s | {processor(service) - busy:.1f} s | "
            f"{peak(service):.0f} MB |",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", required=True)
    parser.add_argument("--binary", default=ROOT / "target/release/shapelex")
    parser.add_argument("--only", choices=["cards", "cost"])
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        service = Service(arguments.binary, folder)
        try:
            for part in [cards, cost]:
                if arguments.only in (None, part.__name__):
                    part(service, arguments.data)
                    print()
        finally:
            service.process.terminate()


if __name__ == "__main__":
    main()
