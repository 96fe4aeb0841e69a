#!/usr/bin/env python3
"""Checks the Python client of clients/python: its types, its generated files, and its tests against the service.

    tests/clients/python.py [--program target/debug/shapelex]

Where Python packages cannot be had, or there is no program, this is skipped with a line that says so.
"""

import argparse
import os
import pathlib
import re
import shutil
import subprocess
import sys
import time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path.insert(0, str(HERE.parent))

import environment  # noqa: E402

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
CLIENT = ROOT / "clients" / "python"

# Seconds for all tests, on a busy machine with a service that is built for tests.
PATIENCE = 1800


def installed(folder):
    """Python of an environment with the client, as it stands in the checkout, and what its tests need."""
    wanted = f"{CLIENT} {sys.version}\n{(CLIENT / 'pyproject.toml').read_text(encoding='utf-8')}"
    mark = folder / "installed.txt"
    if not (mark.exists() and mark.read_text(encoding="utf-8") == wanted):
        environment.created(folder, ["--editable", f"{CLIENT}[test]"])
        mark.write_text(wanted, encoding="utf-8")
    return folder / "bin" / "python"


def checked(command, **options):
    """Output of a command, with its end shown where it fails."""
    done = subprocess.run(
        command, cwd=CLIENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=PATIENCE, **options
    )
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout[-20_000:]}")
    return done.stdout


def tested(python, program):
    """Numbers of tests passed and skipped; the reasons of those that were skipped are printed."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SHAPELEX_")}
    settings = {**kept, "SHAPELEX_BINARY": str(program), "MPLBACKEND": "agg", "PYTHONDONTWRITEBYTECODE": "1"}
    text = checked([python, "-m", "pytest", "-q", "-p", "no:cacheprovider"], env=settings)
    for line in re.findall(r"^SKIPPED \[\d+\] .*", text, re.MULTILINE):
        print(f"SKIPPED: a test of the Python client, {line.split('] ', 1)[1]}")
    return int(re.findall(r"(\d+) passed", text)[-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=pathlib.Path, default=TARGET / "debug" / "shapelex")
    program, begin = parser.parse_args().program.resolve(), time.monotonic()
    if not program.exists():
        print("SKIPPED: the tests of the Python client, the program is not built")
        return
    folder = TARGET / "clients" / "package"
    try:
        python = installed(folder)
    except environment.Unavailable as reason:
        shutil.rmtree(folder, ignore_errors=True)
        print(f"SKIPPED: the tests of the Python client, its packages cannot be installed: {reason}")
        return
    checked([python, "generate.py", "--check"])
    checked([python, "-m", "mypy", "--strict", "--cache-dir", folder / "mypy"])
    passed = tested(python, program)
    print(f"python-client: {time.monotonic() - begin:.0f} s")
    print(f"python-client: {passed} passed, 0 failed")


if __name__ == "__main__":
    main()
