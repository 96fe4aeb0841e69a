"""Tables and plots of docs/performance.md from the report of a run.

target/peers/bin/python benches/peers/document.py [REPORT] [--write docs]
"""

import argparse
import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
STUDY = Path(__file__).with_name("study.json")
RESULTS = Path(__file__).with_name("results.json")
MARKED = re.compile(r"(<!-- (\w+) begins -->\n).*?(<!-- \2 ends -->)", re.DOTALL)


def seconds(value):
    """A time with three digits."""
    units = (("s", 1), ("ms", 1e-3), ("µs", 1e-6))
    unit, size = next((one for one in units if value >= one[1]), units[-1])
    return f"{value / size:.3g} {unit}"


def by_threads(times):
    return " / ".join(seconds(times[t]) if t in times else "–" for t in ("1", "2")) if times else "–"


def ratio(value):
    return "–" if value is None else f"{value:.2g}"


def percent(value):
    return "–" if value is None else f"{100 * value:.0f} %"


def badness(row):
    """Rows that lose to a peer come first, then those beside a bound alone, each by how much they lose."""
    return (0, row["ratio"]) if row["ratio"] is not None else (1, row["fraction"] or 0)


def table(report):
    """One line for each row, losses first."""
    study, old = json.loads(STUDY.read_text())["rows"], report.get("before", {})
    head = [
        "task",
        "1 / 2 threads",
        "peer, 1 / 2 threads",
        "peer ÷ ours",
        "`695ea30`: peer ÷ ours",
        "bound, part reached",
        "`695ea30`: part",
        "answers",
    ]
    if old:
        head.insert(2, "before")
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for row in sorted(report["rows"], key=badness):
        was = study.get(row["key"], {})
        won = ratio(row["ratio"])
        cells = [
            row["task"],
            by_threads(row["ours"]),
            f"{row['peer']} {by_threads(row['peers'])}" if row["peers"] else "–",
            f"**{won}**" if row["ratio"] is not None and row["ratio"] < 1 else won,
            ratio(was.get("ratio")),
            f"{percent(row['fraction'])} of {row['bound']}" if row["bound"] else "–",
            percent(was.get("fraction")),
            row["compared"] if row["agrees"] else f"DIFFERENT: {row['compared']}",
        ]
        if old:
            cells.insert(2, by_threads(old[row["key"]]["ours"]) if row["key"] in old else "–")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def machine(report):
    m = report["machine"]
    transforms = ", ".join(f"{n}: {ns:.0f}" for n, ns in m["complex transforms, ns"].items())
    return (
        f"{m['cores']} cores ({m['cpu']}), {m['memory, GiB']} GiB, Rust {m['rustc']}, commit `{m['commit']}`. "
        f"Load average before "
        f"the run, its own build included: {m['load before']:.1f}.\n\n| limit | measured in this run |\n|---|---|\n"
        f"| dgemm 1024, 1 / 2 threads | {m['dgemm, GF/s']['1']:.0f} / {m['dgemm, GF/s']['2']:.0f} GF/s |\n"
        f"| copy, 1 thread | {m['copy, GB/s']:.0f} GB/s |\n| inverse complex transforms of n numbers, ns | "
        f"{transforms} |\n"
        f"| sequential read of the store past the cache | {read_rate(report):.1f} GB/s |"
    )


def read_rate(report):
    last = report["plots"]["shapes"][-1]
    return last["store"] / last["direct read"] / 1e9


def exponents(x, y):
    """Local exponents of neighbouring points."""
    from math import log

    return [log(b / a) / log(v / u) for u, v, a, b in zip(x, x[1:], y, y[1:])]


def growth(report):
    """The rows of section 3 of the study: exponents between neighbouring points, the largest first."""
    plots, lines = report["plots"], ["| in | of | measured | exponents |", "|---|---|---|---|"]
    series = [
        ("shapes", "upload", "upload"),
        ("shapes", "mean, two passes", "stored mean, points correspond"),
        ("shapes", "cyclic mean", "stored mean, start points searched"),
        ("shapes", "search", "search"),
        ("control points", "landmarks", "mean and 20 modes of 1000 curves, points correspond"),
        ("control points", "cyclic", "the same, start points searched"),
        ("atoms", "lasso", "lasso, a signal"),
        ("atoms", "pursuit", "pursuit of 5, a signal"),
    ]
    names = {"shapes": "shapes", "control points": "points", "atoms": "atoms"}
    for where, what, text in series:
        points = [point for point in plots[where] if what in point]
        x, y = [point[names[where]] for point in points], [point[what] for point in points]
        measured = ", ".join(
            f"{a:.0e}: {seconds(b)}".replace("e+0", "e") if a >= 1e4 else f"{a}: {seconds(b)}" for a, b in zip(x, y)
        )
        lines.append(f"| {where} | {text} | {measured} | {', '.join(f'{e:.1f}' for e in exponents(x, y))} |")
    peaks = ", ".join(
        f"{p['shapes']:.0e}: {max(p['megabytes'].values()):.0f}".replace("e+0", "e") for p in plots["shapes"]
    )
    lines.append(f"| shapes | peak memory, MB | {peaks} | |")
    rates = ", ".join(f"{p['connections']}: {p['service project']['rate'] / 1e3:.1f}" for p in plots["clients"])
    refused = sum(p["service project"]["refused"] for p in plots["clients"])
    lines.append(f"| clients | `/v1/project`, thousand requests a second | {rates} | {refused} refused |")
    return "\n".join(lines)


def goals(report):
    """The goals of the study beside what was measured."""
    rows, clients = {row["key"]: row for row in report["rows"]}, report["plots"]["clients"]
    at = {point["connections"]: point for point in clients}
    least = lambda key: min(rows[key]["ours"].values())
    worst = lambda kind: min(row["ratio"] for row in report["rows"] if row["key"].startswith(kind))
    echoes = max(at[n]["service project"]["p50"] / at[n]["echo project"]["p50"] for n in (8, 64))
    refused = sum(p["service project"]["refused"] for p in clients if p["connections"] < 256)
    times = lambda value: f"{value:.2f} ×"
    peak = report["plots"]["shapes"][-1]["megabytes"]["searches"]
    found = [
        ("an upload: 60 % of the slower of parsing and storing", rows["ingest"]["fraction"], 0.6, percent),
        ("components of 10⁵ × 256: at most 0.20 s", least("components"), -0.20, seconds),
        ("650 cells, start points searched: at most 45 ms", least("cyclic mean"), -0.045, seconds),
        ("650 stored cells, start points searched: at most 120 ms", least("stored cells"), -0.120, seconds),
        ("stored mean of 10⁵ curves, start points searched: at most 2.5 s", least("stored cyclic mean"), -2.5, seconds),
        ("10 nearest of 10⁶ stored curves: at most 150 ms", least("search of 1e6"), -0.150, seconds),
        ("1300² distances, one thread: at most 0.30 s", rows["distances"]["ours"]["1"], -0.30, seconds),
        ("1300² distances, two threads: at most 0.17 s", rows["distances"]["ours"]["2"], -0.17, seconds),
        ("lasso: 1.2 times as fast as SPAMS everywhere", worst("lasso"), 1.2, times),
        ("pursuit: 1.2 times as fast as SPAMS everywhere", worst("pursuit"), 1.2, times),
        ("learning: as fast as SPAMS to each of its objectives", worst("learning"), 1.0, times),
        ("`/v1/project` on one connection: median at most 70 µs", at[1]["service project"]["p50"], -70e-6, seconds),
        ("`/v1/project` on 8 and 64 connections: median at most three times that of an echo", echoes, -3.0, times),
        ("`/v1/project` below 256 connections: none refused", refused, 0, str),
        (
            "stored mean: 60 % of the rate of reads past the cache",
            rows["stored mean, one pass"]["fraction"],
            0.6,
            percent,
        ),
        (
            "peak memory after searches of 10⁶: at most 267 MB, as at `695ea30`",
            peak,
            -267,
            lambda value: f"{value:.0f} MB",
        ),
        *(
            (f"two threads: 1.7 times one, {text}", rows[key]["ours"]["1"] / rows[key]["ours"]["2"], 1.7, times)
            for text, key in (
                ("components", "components"),
                ("650 cells", "cyclic mean"),
                ("distances", "distances"),
                ("Procrustes", "procrustes"),
                ("a search of 10⁶", "nearest of 1e6"),
            )
        ),
    ]
    # A negative goal is the most that is allowed.
    met = lambda value, goal: value <= -goal if goal <= 0 else value >= goal
    lines = [
        f"| {text} | {show(value)} | {'met' if met(value, goal) else '**missed**'} |"
        for text, value, goal, show in found
    ]
    return "\n".join(["| goal | measured | |", "|---|---|---|", *sorted(lines, key=lambda line: "missed" not in line)])


def write(report, docs):
    """Puts tables between their marks, and makes the pictures."""
    import plots

    RESULTS.write_text(json.dumps(report, indent=1) + "\n")
    parts = {"machine": machine(report), "peers": table(report), "growth": growth(report), "goals": goals(report)}
    page = docs / "performance.md"
    page.write_text(MARKED.sub(lambda found: f"{found[1]}{parts[found[2]]}\n{found[3]}", page.read_text()))
    plots.draw(report, docs / "pictures")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("report", nargs="?", type=Path, default=RESULTS)
    parser.add_argument("--write", type=Path)
    arguments = parser.parse_args()
    report = json.loads(arguments.report.read_text())
    print(table(report))
    if arguments.write:
        write(report, arguments.write)


if __name__ == "__main__":
    main()
