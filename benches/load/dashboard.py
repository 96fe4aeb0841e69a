"""What a dashboard asks of a cohort of 100 000 shapes: time, CPU of the service and bytes of every answer.

    python benches/load/dashboard.py --binary target/release/shapelex [--shapes 100000]

The cohort has 64 control points and six attributes a shape, start points are searched; a second one, whose points
correspond, takes the mean only. Every row is one request unless the row says "warm", which is the median of nine.
Prints the table of docs/performance.md. Needs nothing beyond Python's library.
"""

import argparse
import http.client
import json
import os
import statistics
import sys
import tempfile
import time
from math import cos, pi, sin
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).parent))
from service import Service, upload  # noqa: E402

TICK = os.sysconf("SC_CLK_TCK")
# Seconds after which memory that was freed counts as given back.
REST = 3
REPRESENTATION = {"kind": "closed_curve", "dimension": 2, "control_points": 64, "generator": {"name": "trigonometric"}}
TABLE = "external_id,label,labels.site,measures.area,d.score.1,d.score.2,d.t_squared,d.outlier"
ARROW = "application/vnd.apache.arrow.stream"


def contour(random):
    """48 points on a contour with bumps of its own."""
    phase, bump = random.uniform(0, 6), random.uniform(0.1, 0.3)
    angles = [2 * pi * k / 48 for k in range(48)]
    return [
        [round((1 + bump * cos(3 * t + phase)) * cos(t), 4), round((1.3 + bump * sin(2 * t + phase)) * sin(t), 4)]
        for t in angles
    ]


def shape(random, number):
    labels = {
        "site": f"s{number % 7}",
        "plate": f"P{number % 1000:03}",
        "dose": random.uniform(0, 5),
        "control": number % 2 == 0,
    }
    return {
        "external_id": f"b{number}",
        "label": random.choice("abc"),
        "subject": f"u{number // 4}",
        "labels": labels,
        "points": contour(random),
    }


class Table:
    """Rows, printed as they are measured."""

    def __init__(self, service):
        self.service = service
        self.connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=900)

    def ask(self, method, path, body=None, **headers):
        headers = {name.replace("_", "-"): value for name, value in headers.items()} | {
            "content-type": "application/json"
        }
        cpu, begin = self.cpu(), time.perf_counter()
        self.connection.request(method, path, None if body is None else json.dumps(body), headers)
        answer = self.connection.getresponse()
        text, status = answer.read(), answer.status
        # On a loaded machine a study outlasts the longest wait of a request.
        while status == 202:
            self.connection.request("GET", f"/v1/jobs/{json.loads(text)['id']}", None, {"prefer": "wait=300"})
            answer = self.connection.getresponse()
            text = answer.read()
            state = json.loads(text).get("status")
            status = {"succeeded": 200, "queued": 202, "running": 202}.get(state, 500)
        seconds, cpu = time.perf_counter() - begin, self.cpu() - cpu
        if status >= 400:
            raise SystemExit(f"{method} {path}: expected a complete answer, got {status} {text[:1000]}")
        return seconds, cpu, len(text)

    def cpu(self):
        """Seconds of CPU of the service so far, in ticks of the kernel."""
        fields = Path(f"/proc/{self.service.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / TICK

    def row(self, what, method, path, body=None, times=1, **headers):
        found = [self.ask(method, path, body, **headers) for _ in range(times)]
        seconds = statistics.median(one[0] for one in found)
        cpu = sum(one[1] for one in found) / times
        print(f"| {what} | {1e3 * seconds:.4g} ms | {1e3 * cpu:.4g} ms | {found[-1][2] / 1e3:.4g} kB |", flush=True)


def fill(service, folder, shapes):
    random, lines = Random(5), folder / "lines"
    with lines.open("w") as file:
        file.writelines(json.dumps(shape(random, number)) + "\n" for number in range(shapes))
    for name, correspondence in [("big", "cyclic"), ("fixed", "arc_length")]:
        service.call(
            "POST", "/v1/cohorts", {"name": name, "correspondence": correspondence, "representation": REPRESENTATION}
        )
        seconds, status, _ = upload(service.port, name, lines)
        print(
            f"| {shapes} shapes taken in ({correspondence}), {status} | {seconds:.3g} s | – | "
            f"{lines.stat().st_size / 1e6:.3g} MB sent |"
        )


def one_more(service, cohort, number):
    service.call("POST", f"/v1/cohorts/{cohort}/shapes", {"shapes": [shape(Random(number), 10_000_000 + number)]})


def studies(service, table):
    """Of the shapes that were there from the start: a test takes at most 100 000."""
    for number in range(1, 5):
        service.call("DELETE", f"/v1/cohorts/big/shapes/b{10_000_000 + number}")
    study = {"cohort": "big", "permutations": 99}
    memory = [service.megabytes()]
    table.row(
        "compare three groups, 99 permutations", "POST", "/v1/comparisons", study | {"by": "label"}, prefer="wait=300"
    )
    time.sleep(REST)
    memory.append(service.megabytes())
    table.row(
        "allometry, 99 permutations",
        "POST",
        "/v1/regressions",
        study | {"attribute": "log_centroid_size"},
        prefer="wait=300",
    )
    time.sleep(REST)
    memory.append(service.megabytes())
    print(
        f"| memory before, after the comparison and after both | – | – | "
        f"{', '.join(f'{one:.0f}' for one in memory)} MB |"
    )


def measure(service, table):
    table.row("list of cohorts, warm", "GET", "/v1/cohorts", times=9)
    rows = "/v1/cohorts/big/shapes?limit="
    table.row(
        "first 100 rows without control points, warm", "GET", f"{rows}100&fields=external_id,label,labels", times=9
    )
    table.row("first 100 rows, warm", "GET", f"{rows}100", times=9)
    table.row("1000 rows, warm", "GET", f"{rows}1000", times=9)
    table.row("rare attribute, warm", "GET", f"{rows}100&labels.plate=P099", times=9)
    for name, text in [("big", "start points searched"), ("fixed", "points correspond")]:
        mean = f"/v1/cohorts/{name}/mean?transformation=similarity"
        table.row(f"mean, {text}, cold", "GET", mean)
        table.row("the same, cached", "GET", mean, times=9)
        one_more(service, name, 1)
        table.row("the same, one shape later", "GET", mean)
        table.row("the same, filtered", "GET", f"{mean}&labels.site=s1&labels.site=s2&labels.site=s3&labels.site=s4")
        one_more(service, name, 2)
        table.row("the same, one shape later, `stale=true`", "GET", f"{mean}&stale=true")
        table.ask("GET", mean)  # The renewal in the background ends before the next row.
    table.row(
        "the mean of the searched start points from the last placements",
        "GET",
        "/v1/cohorts/big/mean?transformation=similarity&start=last",
    )
    one_more(service, "big", 3)
    table.row("the same, one shape later", "GET", "/v1/cohorts/big/mean?transformation=similarity&start=last")
    table.row("mean as picture", "GET", "/v1/cohorts/big/mean?transformation=similarity&format=svg")
    table.row("the same, the mean cached", "GET", "/v1/cohorts/big/mean?transformation=similarity&format=svg", times=9)
    method = {"kind": "functional_pca", "components": 12, "centre": True}
    table.row(
        "learn 12 components",
        "POST",
        "/v1/dictionaries",
        {"name": "d", "cohort": "big", "transformation": "similarity", "method": method},
        prefer="wait=300",
    )
    attributes = "/v1/cohorts/big/attributes?values=100&bins=32"
    table.row("values and counts, histograms: attributes, first", "GET", attributes)
    table.row("the same, warm", "GET", attributes, times=9)
    table.row("the same of one label, warm", "GET", f"{attributes}&label=a", times=9)
    one_more(service, "big", 4)
    table.row("the same, one shape later", "GET", attributes)
    cells = f"/v1/cohorts/big/table?columns={TABLE}"
    table.row("scores for a scatter: table of eight columns, Arrow, first", "GET", cells, accept=ARROW)
    table.row("the same, warm", "GET", cells, accept=ARROW, times=3)
    table.row("slider: one mode, warm", "GET", "/v1/dictionaries/d/modes?component=2&sigma=1", times=9)
    table.row(
        "100 thumbnails: one sheet", "GET", "/v1/cohorts/big/sheet?columns=10&size=96&limit=100&format=svg", times=3
    )
    table.row("12 nearest, first", "POST", "/v1/cohorts/big/search", {"ids": ["b17"], "neighbours": 12})
    table.row("12 nearest, warm", "POST", "/v1/cohorts/big/search", {"ids": ["b18"], "neighbours": 12}, times=9)
    table.row("assess one, warm", "POST", "/v1/dictionaries/d/assess", {"cohort": "big", "ids": ["b19"]}, times=9)
    table.row("drift", "GET", "/v1/dictionaries/d/drift")
    table.row("list of jobs, warm", "GET", "/v1/jobs", times=9)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True)
    parser.add_argument("--shapes", type=int, default=100_000)
    arguments = parser.parse_args()
    print(
        "load before:",
        Path("/proc/loadavg").read_text().strip(),
        "\n\n| what | wall | CPU | bytes |\n|---|---|---|---|",
    )
    with tempfile.TemporaryDirectory() as folder:
        service = Service(arguments.binary, Path(folder))
        service.start()
        try:
            fill(service, Path(folder), arguments.shapes)
            table = Table(service)
            measure(service, table)
            studies(service, table)
        finally:
            service.stop()
    print("load after:", Path("/proc/loadavg").read_text().strip())


if __name__ == "__main__":
    main()
