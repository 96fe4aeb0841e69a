"""Shapelex beside its peers and the limits of the machine: one table, losses first.

    make bench                                        prepares target/peers and runs this
    target/peers/bin/python benches/peers/run.py [--data FOLDER] [--quick] [--only means,codes] [--write docs]

FOLDER holds `curves-osteosarcoma-cells` and `curves-mpeg7`, each with a `curves.ndjson` of contours; without it, the
example cells and random contours take their places. Answers are compared before a row counts: rows whose answers differ
say so, and the exit status is 1. Figures go to target/peers/report.json; `--write docs` also makes the tables and plots
of docs/performance.md from it, and needs a whole run. `--before BINARY` takes the rows of the service once more with
another program.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import codes
import distances
import document
import growth
import latency
import means
import measure
import numpy as np
import stored
import studies
import subdivision
from build import ROOT
from measure import Ours, in_turn, timed
from threadpoolctl import threadpool_limits

KERNELS = {"means": means, "distances": distances, "studies": studies, "subdivision": subdivision, "codes": codes}
AREAS = [*KERNELS, "stored", "latency", "growth"]
REPORT = ROOT / "target" / "peers" / "report.json"


@dataclass
class Setting:
    """How much is measured, and the rate of dense products, in operations a second, by threads."""

    data: Path | None
    quick: bool
    rounds: int
    repeats: int
    decades: int
    binary: str
    dgemm: dict


def dgemm():
    """Multiplications and additions a second of products of 1024 × 1024 matrices, by threads."""
    a = np.random.default_rng(0).standard_normal((1024, 1024))

    def product(threads):
        with threadpool_limits(threads):
            return timed(lambda: a @ a)

    least, _ = in_turn({str(t): lambda t=t: product(t) for t in measure.THREADS}, 9)
    return {threads: 2 * 1024**3 / seconds for threads, seconds in least.items()}


def copy_rate():
    """Bytes read and written a second by copies of 256 MB on one thread."""
    a = np.ones(1 << 25)
    b = np.empty_like(a)
    return 2 * a.nbytes / min(timed(lambda: np.copyto(b, a))[1] for _ in range(5))


def machine(setting, ours):
    cpu = next(
        line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line
    )
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True
    ).stdout.strip()
    return {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "memory, GiB": round(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30),
        "system": f"{platform.system()} {platform.machine()}",
        "commit": commit,
        "load before": os.getloadavg()[0],
        "rustc": subprocess.run(["rustc", "--version"], cwd=ROOT, capture_output=True, text=True).stdout.split()[1],
        "dgemm, GF/s": {t: rate / 1e9 for t, rate in setting.dgemm.items()},
        "copy, GB/s": copy_rate() / 1e9,
        "complex transforms, ns": {str(n): 1e9 * ours.transforms(n) for n in (32, 64, 100, 128, 200, 256)},
    }


def measured(setting, ours, areas, save=lambda rows, plots: None):
    """Rows of the chosen areas, and what the plots need; saved after every area."""
    rows, plots = [], {}

    def keep(found):
        for row in found:
            rows.append(row)
            print(f"{row.key}: {row.compared}{'' if row.agrees else ' DIFFERENT'}", file=sys.stderr, flush=True)
        save(rows, plots)

    for name, area in KERNELS.items():
        if name in areas:
            keep(area.rows(ours, setting))
    if "latency" in areas:
        plots["clients"] = latency.growth(ours, setting)
        keep(latency.rows_of(plots["clients"]))
    if "growth" in areas:
        plots["control points"] = growth.control_points(ours, setting)
        plots["atoms"] = growth.atoms(ours, setting)
    if "stored" in areas:
        plots["shapes"] = stored.growth(setting)
        keep(stored.rows_of(ours, setting, plots["shapes"]))
    return rows, plots


def before(setting, ours, program):
    """The rows of the service with another program."""
    old = Setting(**vars(setting) | {"binary": program})
    rows, _ = measured(old, ours, ["latency", "stored"])
    return {row.key: row.record() for row in rows}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument(
        "--quick", action="store_true", help="small inputs: whether everything works, no figures to quote"
    )
    parser.add_argument("--only", type=lambda text: text.split(","), default=AREAS)
    parser.add_argument("--rounds", type=int, default=3, help="how often the sides take turns")
    parser.add_argument("--decades", type=int, help="cohorts of up to 10 to this power of shapes; 6, with --quick 4")
    parser.add_argument("--binary", help="a build of the service; made unless given")
    parser.add_argument("--before", help="another build of the program, for the rows of the service")
    parser.add_argument("--write", type=Path, help="folder of documents whose performance.md and pictures are made")
    arguments = parser.parse_args()
    if unknown := set(arguments.only) - set(AREAS):
        parser.error(f"--only: expected some of {', '.join(AREAS)}, got {', '.join(unknown)}")
    quick = arguments.quick
    if arguments.write and (quick or arguments.only != AREAS):
        parser.error("--write: expected a whole run")
    ours = Ours()
    binary = arguments.binary or ours.service
    setting = Setting(
        arguments.data,
        quick,
        arguments.rounds,
        2 if quick else 5,
        arguments.decades or (4 if quick else 6),
        binary,
        dgemm(),
    )
    report = {"machine": machine(setting, ours)}

    def save(rows, plots):
        report.update(rows=[row.record() for row in rows], plots=plots)
        REPORT.parent.mkdir(parents=True, exist_ok=True)
        REPORT.write_text(json.dumps(report, indent=1) + "\n")

    rows, plots = measured(setting, ours, arguments.only, save)
    if arguments.before:
        report["before"] = before(setting, ours, arguments.before)
    save(rows, plots)
    print(document.table(report))
    different = [row.key for row in rows if not row.agrees]
    if arguments.write:
        document.write(report, arguments.write)
    raise SystemExit(f"other answers than the peers: {', '.join(different)}" if different else 0)


if __name__ == "__main__":
    main()
