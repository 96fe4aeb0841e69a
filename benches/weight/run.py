"""Weight of the program: cost of its builds, size, idle memory, packages, lines of LLVM IR.

    python3 benches/weight/run.py [--before COMMIT] [--tests] [--ir] [--write] [--gate]

A build is cold and its own: every crate is compiled, in a folder of its own below `target/weight`, with the compiler
behind `rustc.py`, which notes the processor seconds and the peak memory of each crate. Seconds of machines differ, so
costs are also given in units: a unit is the processor seconds that `cc -O2` needs, in the same run, for the `sqlite3.c`
that the program brings.

`--before COMMIT` builds another commit as well and prints both; `--tests` adds the build of the tests; `--ir` counts
lines of LLVM IR of the crates of the workspace where `cargo-llvm-lines` is installed; `--write` puts the tables into
docs/weight.md and the figures into `figures.json` beside this file; `--gate` compares with `figures.json` and exits
with 1 where a figure is more than `TOLERANCE` above it. Needs nothing beyond Python's library, cargo, a C compiler and
`size` of binutils.
"""

import argparse
import json
import os
import re
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import defaultdict
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs" / "weight.md"
FIGURES = HERE / "figures.json"
# Units of one commit on one machine differ by some 3 % from run to run.
TOLERANCE = 0.10
GATED = ("release units", "binary MB", "idle MB", "packages")
# Least release figures that are worth a row.
SMALL_SECONDS = 4.0
# The program gives memory back to the system within this time after it has started.
SETTLED = 3.0
# Which of the allocator's pages of 2 MB become resident differs from start to start, by up to 3 MB.
STARTS = 5


def text(*command, folder=ROOT):
    return subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True).stdout


def timed(command, folder, environment=None):
    """Elapsed and processor seconds of a command and of all that it starts."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run(command, cwd=folder, env=environment, check=True, stdout=sys.stderr)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.monotonic() - start, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def unit(tree):
    """Processor seconds of the C compiler for SQLite, the least of two runs: other work on the machine makes them more.

    A compiler runs on each core, as in a build: where two of them share the parts of one, both are slower.
    """
    packages = json.loads(text("cargo", "metadata", "--locked", "--format-version", "1", folder=tree))["packages"]
    manifest = next(package["manifest_path"] for package in packages if package["name"] == "libsqlite3-sys")
    source = Path(manifest).parent / "sqlite3" / "sqlite3.c"
    cores = len(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as folder:
        compiler = f"cc -O2 -c '{source}' -o '{folder}'/$core.o"
        together = f"for core in $(seq {cores}); do {compiler} & done; wait"
        return min(timed(["sh", "-c", together], tree)[1] for _ in range(2)) / cores


def build(tree, target, arguments):
    """Cost of a cold build: elapsed and processor seconds, and a row (seconds, peak MB) for each crate."""
    shutil.rmtree(target, ignore_errors=True)
    log = target.with_suffix(".tsv")
    log.parent.mkdir(parents=True, exist_ok=True)
    log.write_text("")
    environment = dict(
        os.environ,
        RUSTC_WRAPPER=str(HERE / "rustc.py"),
        WEIGHT_LOG=str(log),
        CARGO_INCREMENTAL="0",
        CARGO_TARGET_DIR=str(target),
    )
    units = [unit(tree)]
    elapsed, seconds = timed(["cargo", *arguments, "--locked", "--quiet"], tree, environment)
    units.append(unit(tree))
    crates = defaultdict(lambda: [0.0, 0])
    lines = [line.split("\t") for line in log.read_text().splitlines()]
    for name, _, shape, cost, peak in lines:
        row = crates[name + (" (tests)" if shape == "test" else "")]
        row[0] += float(cost)
        row[1] = max(row[1], int(peak) / 1e3)
    # What is not the compiler: build scripts and their C code.
    crates["C code and build scripts"] = [max(seconds - sum(row[0] for row in crates.values()), 0.0), 0]
    return {"elapsed": elapsed, "seconds": seconds, "unit": min(units), "compiled": len(lines), "crates": dict(crates)}


def sections(program):
    """Bytes of the program by section, the large ones."""
    rows = [line.split() for line in text("size", "-A", str(program)).splitlines()]
    sizes = {row[0]: int(row[1]) for row in rows if len(row) == 3 and row[1].isdigit()}
    return {name: size for name, size in sizes.items() if size > 1e6}


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def resident(process):
    return int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{process.pid}/status").read_text())[1]) / 1e3


def idle(program):
    """Memory of the served program at rest with the example cohort, in MB, and its seconds to readiness: medians of
    starts."""
    starts = sorted(started(program) for _ in range(STARTS))
    return starts[STARTS // 2][0], sorted(ready for _, ready in starts)[STARTS // 2]


def started(program):
    """The same of one start."""
    with tempfile.TemporaryDirectory() as folder:
        port = free_port()
        start = time.monotonic()
        process = subprocess.Popen(
            [program, "serve", "--listen", f"127.0.0.1:{port}", "--data-dir", folder],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            while True:
                try:
                    urllib.request.urlopen(f"http://127.0.0.1:{port}/readyz", timeout=1)
                    break
                except OSError:
                    if process.poll() is not None or time.monotonic() - start > 60:
                        raise SystemExit("the program did not become ready") from None
                    time.sleep(0.01)
            ready = time.monotonic() - start
            time.sleep(SETTLED)
            return resident(process), ready
        finally:
            process.terminate()
            process.wait()


def packages(tree):
    lines = text("cargo", "tree", "--locked", "--edges", "normal,build", "--prefix", "none", "--no-dedupe", folder=tree)
    return len({tuple(line.split()[:2]) for line in lines.splitlines()})


def ir_lines(tree, target):
    """Lines of LLVM IR, instances and the largest functions of the crates of the workspace."""
    counts = {}
    if subprocess.run(["cargo", "llvm-lines", "--version"], capture_output=True).returncode:
        print("SKIPPED: lines of LLVM IR, there is no cargo-llvm-lines", file=sys.stderr)
        return counts
    environment = dict(os.environ, CARGO_TARGET_DIR=str(target), CARGO_INCREMENTAL="0")
    members = json.loads(text("cargo", "metadata", "--locked", "--no-deps", "--format-version", "1", folder=tree))[
        "packages"
    ]
    for member in members:
        command = ["cargo", "llvm-lines", "--release", "--locked", "--lib", "-p", member["name"]]
        done = subprocess.run(command, cwd=tree, env=environment, check=True, stdout=subprocess.PIPE, text=True)
        lines = done.stdout.splitlines()
        total = next(line.split() for line in lines if line.endswith("(TOTAL)"))
        counts[member["name"]] = {"lines": int(total[0]), "instances": int(total[1]), "top": lines[3:43]}
    return counts


def weigh(tree, name, arguments):
    """All figures of a checkout."""
    target = ROOT / "target" / "weight" / name
    release = build(tree, target, ["build", "--release"])
    program = target / "release" / "shapelex"
    memory, ready = idle(program)
    found = {
        "commit": text("git", "rev-parse", "--short=8", "HEAD", folder=tree).strip(),
        "release units": release["seconds"] / release["unit"],
        "release": release,
        "binary MB": program.stat().st_size / 1e6,
        "sections": sections(program),
        "idle MB": memory,
        "ready s": ready,
        "packages": packages(tree),
    }
    if arguments.ir:
        found["ir"] = ir_lines(tree, target)
    if arguments.tests:
        found["tests"] = build(tree, target.with_name(f"{name}-tests"), tests_of(tree))
    return found


def tests_of(tree):
    """The build of the tests, in the shape that `make test` of the checkout runs."""
    features = re.search(r"^FEATURES *= *(.+)$", (tree / "Makefile").read_text(), re.M)
    return [
        "test",
        *(features[1].split() if features else []),
        "--lib",
        "--test",
        "suite",
        "--test",
        "rates",
        "--no-run",
    ]


def signed(now, before):
    return "–" if not before else f"{100 * now / before:.0f} %"


def summary(rows):
    """One row a figure, one column a commit."""
    last, first = rows[-1], rows[0]
    lines = [
        "| figure | " + " | ".join(f"`{row['commit']}`" for row in rows) + " | now ÷ before |",
        "|---" * (len(rows) + 2) + "|",
    ]

    def add(name, value, form):
        values = [value(row) for row in rows]
        cells = [form.format(value) if value is not None else "–" for value in values]
        ratio = signed(values[-1], values[0]) if len(rows) > 1 and None not in values else "–"
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {ratio} |")

    add("unit, processor seconds of `sqlite3.c`", lambda row: row["release"]["unit"], "{:.2f}")
    add("cold release build, units", lambda row: row["release units"], "{:.1f}")
    add("… processor seconds", lambda row: row["release"]["seconds"], "{:.0f}")
    add("… elapsed seconds", lambda row: row["release"]["elapsed"], "{:.0f}")
    add("… calls of the compiler", lambda row: row["release"]["compiled"], "{}")
    if "tests" in last or "tests" in first:
        tests = lambda row: row.get("tests")  # noqa: E731
        add(
            "cold build of the tests, units",
            lambda row: tests(row) and tests(row)["seconds"] / tests(row)["unit"],
            "{:.1f}",
        )
        add("… elapsed seconds", lambda row: tests(row) and tests(row)["elapsed"], "{:.0f}")
    add("packages", lambda row: row["packages"], "{}")
    add("binary, MB", lambda row: row["binary MB"], "{:.1f}")
    for section in (
        ".text",
        ".rodata",
        ".eh_frame",
        ".data.rel.ro",
        ".rela.dyn",
        ".gcc_except_table",
        ".strtab",
        ".symtab",
    ):
        if any(section in row["sections"] for row in rows):
            add(f"… `{section}`, MB", lambda row, s=section: row["sections"].get(s, 0) / 1e6, "{:.1f}")
    add("idle memory, MB", lambda row: row["idle MB"], "{:.1f}")
    add("time to ready, s", lambda row: row["ready s"], "{:.2f}")
    for crate in sorted({name for row in rows for name in row.get("ir", {})}):
        add(
            f"lines of LLVM IR of `{crate}`, thousands",
            lambda row, c=crate: row.get("ir", {}).get(c, {}).get("lines", 0) / 1e3 or None,
            "{:.0f}",
        )
    return "\n".join(lines)


def crates_table(rows):
    """Crates that cost much in any commit, in units, with their part of the whole and their peak memory."""
    names = {name for row in rows for name, cost in row["release"]["crates"].items() if cost[0] >= SMALL_SECONDS}
    last = rows[-1]["release"]
    order = sorted(names, key=lambda name: -max(row["release"]["crates"].get(name, [0])[0] for row in rows))
    lines = [
        "| crate | " + " | ".join(f"`{row['commit']}`, units" for row in rows) + " | part of the build | peak MB |",
        "|---" * (len(rows) + 3) + "|",
    ]
    for name in order:
        cells = [
            f"{row['release']['crates'][name][0] / row['release']['unit']:.2f}"
            if name in row["release"]["crates"]
            else "–"
            for row in rows
        ]
        cost, peak = last["crates"].get(name, [0, 0])
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {100 * cost / last['seconds']:.1f} % | {peak:.0f} |")
    return "\n".join(lines)


def top_table(row):
    parts = []
    for crate, count in sorted(row.get("ir", {}).items()):
        if crate == "shapelex-server":
            parts.append("```text\n" + "\n".join(line[:150] for line in count["top"]) + "\n```")
    return "\n".join(parts)


def fill(page, mark, content):
    pattern = re.compile(f"(<!-- {mark} begins -->\n).*?(<!-- {mark} ends -->)", re.S)
    return pattern.sub(lambda found: found[1] + content + "\n" + found[2], page)


def gate(now):
    """Compares with the committed figures and returns the failures."""
    known = json.loads(FIGURES.read_text())
    failures = []
    print("| gate | now | committed | change |\n|---|---|---|---|")
    for name in GATED:
        change = now[name] / known[name] - 1
        print(f"| {name} | {now[name]:.1f} | {known[name]:.1f} | {100 * change:+.1f} % |")
        if change > TOLERANCE:
            failures.append(name)
    print(f"time to ready: {now['ready s']:.2f} s")
    return failures


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", help="another commit, built in the same run")
    for name in ("tests", "ir", "write", "gate"):
        parser.add_argument(f"--{name}", action="store_true")
    arguments = parser.parse_args()
    if missing := [tool for tool in ("cargo", "git") if not shutil.which(tool)]:
        print(f"SKIPPED: the weight of a cold build, there is no {' and no '.join(missing)}")
        return
    rows = []
    if arguments.before:
        tree = ROOT / "target" / "weight" / "tree"
        shutil.rmtree(tree, ignore_errors=True)
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(tree)], check=True)
        subprocess.run(["git", "checkout", "--quiet", arguments.before], cwd=tree, check=True)
        rows.append(weigh(tree, "before", arguments))
    rows.append(weigh(ROOT, "now", arguments))
    print(summary(rows), crates_table(rows), sep="\n\n")
    if arguments.write:
        page = PAGE.read_text()
        for mark, content in (
            ("summary", summary(rows)),
            ("crates", crates_table(rows)),
            ("functions", top_table(rows[-1])),
        ):
            page = fill(page, mark, content)
        PAGE.write_text(page)
        FIGURES.write_text(json.dumps({name: round(rows[-1][name], 2) for name in GATED}, indent=1) + "\n")
    if arguments.gate and (failures := gate(rows[-1])):
        raise SystemExit(f"more than {100 * TOLERANCE:.0f} % above benches/weight/figures.json: {', '.join(failures)}")


if __name__ == "__main__":
    main()
