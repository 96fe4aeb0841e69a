"""Instructions of the main computations beside the committed counts, which a busy machine does not change.

    python3 benches/instructions/run.py [--write] [--only TEXT]

Each computation runs under callgrind once and twice: the difference is one run, without what prepares it. Valgrind
shows the program a processor with AVX2 and without AVX-512, so counts of machines with AVX2 agree. `counts.json` holds
the counts with the versions of compiler and valgrind; another compiler makes other code, and then differences are
printed and nothing fails. Exits with 1 where a count is more than `TOLERANCE` above the committed one. `--write`
replaces the counts.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from build import ROOT, benches  # noqa: E402

COUNTS = Path(__file__).with_name("counts.json")
# Two runs of one program agree to the last instruction. Other code of a crate may change what is inlined; what is worth
# a gate changes more than this.
TOLERANCE = 0.03


def count(program, name, times):
    command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", program, name, str(times)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{name}: {done.stderr[-2000:]}")
    return int(re.search(r"Collected : (\d+)", done.stderr)[1])


def version(*command):
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout.strip()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--only", default="", help="computations whose names contain this")
    arguments = parser.parse_args()
    if not shutil.which("valgrind"):
        print("SKIPPED: instruction counts, there is no valgrind")
        return
    program = benches("instructions")["instructions"]
    names = [name for name in version(program).splitlines() if arguments.only in name]
    counts = {name: count(program, name, 2) - count(program, name, 1) for name in names}
    tools = {"rustc": version("rustc", "--version"), "valgrind": version("valgrind", "--version")}
    known = json.loads(COUNTS.read_text()) if COUNTS.exists() else {"tools": {}, "counts": {}}
    print("| computation | instructions | committed | change |\n|---|---|---|---|")
    worse = []
    for name, found in sorted(counts.items()):
        before = known["counts"].get(name)
        change = found / before - 1 if before else None
        print(
            f"| {name} | {found:,} | {f'{before:,}' if before else '–'} | "
            f"{'–' if change is None else f'{100 * change:+.1f} %'} |"
        )
        if change is not None and change > TOLERANCE:
            worse.append(name)
    if arguments.write:
        COUNTS.write_text(
            json.dumps({"tools": tools, "counts": known["counts"] | counts}, indent=1, sort_keys=True) + "\n"
        )
    elif tools != known["tools"]:
        print(f"counted with {tools}, committed with {known['tools']}: differences are no defects")
    elif worse:
        raise SystemExit(f"more instructions than before: {', '.join(worse)}")


if __name__ == "__main__":
    main()
