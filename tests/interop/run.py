#!/usr/bin/env python3
"""Compares files that the program reads and writes with independent readers and writers of these formats.

    tests/interop/run.py [--program target/debug/shapelex] [AREA…]

Each module beside this one is an area. It names its packages, pinned, in `PACKAGES`, and has a function
`check(convert, data, folder)` that yields a name, whether it is right, and a detail for each comparison; a detail that
begins with `SKIPPED: ` says why there was none. They run in an environment with these packages (in `target/interop`;
the network is needed for it once). An area whose packages cannot be installed is skipped with a line that says so; a
comparison that is wrong, or an area that breaks off, ends in the exit code 1.
"""

import argparse
import importlib.util
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import traceback

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path.insert(0, str(HERE.parent))

from environment import Unavailable, created  # noqa: E402

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
DATA = ROOT.parent / "shared" / "data"
# Seconds for one file: the longest takes some seconds, on a busy machine a minute.
PATIENCE = 600


class Refused(Exception):
    """The program did not convert a file; the text says why."""


def converter(program):
    """The function by which modules convert files.

    `convert(path, format="ndjson", options=None, output=None, writing=None)` returns the list of records, parsed, for
    NDJSON without an output, else the bytes that were written; and what the program says of the file. `options` are
    those of reading, `writing` those of writing, with `series` as paths of images. It raises `Refused` where the
    program refuses. `convert.program` is its path.
    """

    def convert(path, format="ndjson", options=None, output=None, writing=None):
        command = [str(program), "convert", str(path), "--to", format, "--json"]
        writing = dict(writing or {})
        command += [part for image in writing.pop("series", []) for part in ("--series", str(image))]
        for flag, values in [("--option", options), ("--write", writing)]:
            for name, value in (values or {}).items():
                text = value if isinstance(value, str) else json.dumps(value)
                command += [flag, f"{name}={text}"]
        if output is not None:
            pathlib.Path(output).unlink(missing_ok=True)
            command += ["--output", str(output)]
        done = subprocess.run(command, capture_output=True, timeout=PATIENCE)
        said = done.stderr.decode("utf-8", "replace").strip()
        if done.returncode != 0:
            raise Refused(said)
        summary = json.loads(said.splitlines()[-1])
        if output is not None:
            return pathlib.Path(output).read_bytes(), summary
        if format == "ndjson":
            return [json.loads(line) for line in done.stdout.splitlines() if line.strip()], summary
        return done.stdout, summary

    convert.program = program
    return convert


def packages_of(path):
    """What a module lists in `PACKAGES`, read without running it: its packages may not be there yet."""
    import ast

    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and [getattr(name, "id", "") for name in node.targets] == ["PACKAGES"]:
            return ast.literal_eval(node.value)
    sys.exit(f"{path.name} has no PACKAGES")


def environment(folder, packages):
    """The Python of an environment with all packages, made anew if they have changed."""
    mark, text = folder / "installed.txt", "\n".join(packages)
    python = folder / "bin" / "python"
    if not (mark.exists() and mark.read_text() == text):
        created(folder, packages)
        mark.write_text(text)
    return python


def check_area(path, program):
    """Runs the comparisons of a module, in the environment that this process is in. Returns the number of wrong
    ones."""
    specification = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(specification)
    # A module may import its neighbours.
    sys.path.insert(0, str(HERE))
    wrong, count, skipped, begin = 0, 0, 0, time.monotonic()
    try:
        specification.loader.exec_module(module)
        with tempfile.TemporaryDirectory() as folder:
            data = DATA if DATA.is_dir() else None
            if data is None:
                print(f"SKIPPED: {path.stem}: the comparisons with real files, there is no {DATA.name}")
            for name, ok, detail in module.check(converter(program), data, pathlib.Path(folder)):
                if detail.startswith("SKIPPED: "):
                    skipped += 1
                    print(f"SKIPPED: {path.stem}: {name}, {detail.removeprefix('SKIPPED: ')}", flush=True)
                    continue
                count += 1
                wrong += not ok
                print(f"{'ok' if ok else 'WRONG'}: {path.stem}: {name}: {detail}", flush=True)
    except Exception:
        traceback.print_exc()
        print(f"WRONG: {path.stem}: it broke off")
        wrong += 1
    if count == skipped == 0:
        print(f"WRONG: {path.stem}: no comparison was made")
        wrong += 1
    print(f"interop: {path.stem}: {time.monotonic() - begin:.0f} s")
    print(f"{path.stem}: {max(count - wrong, 0)} passed, {wrong} failed", flush=True)
    return wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=pathlib.Path, default=TARGET / "debug" / "shapelex")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("areas", nargs="*", help="names of modules; default: all")
    arguments = parser.parse_args()
    program = arguments.program.resolve()
    modules = sorted(path for path in HERE.glob("*.py") if path.name != "run.py" and not path.name.startswith("_"))
    known = {path.stem: path for path in modules}
    for area in arguments.areas:
        if area not in known:
            sys.exit(f"expected one of the areas {', '.join(known)}, got {area}")
    chosen = [known[area] for area in arguments.areas] or modules
    if arguments.inside:
        sys.exit(1 if sum(check_area(path, program) for path in chosen) else 0)
    wrong = []
    for path in chosen:
        # Areas may pin a package differently.
        try:
            python = environment(TARGET / "interop" / path.stem, packages_of(path))
        except Unavailable as reason:
            print(f"SKIPPED: interop: {path.stem}, its packages cannot be installed: {reason}")
            continue
        command = [python, __file__, "--inside", "--program", program, path.stem]
        if subprocess.run(command).returncode != 0:
            wrong.append(path.stem)
    if wrong:
        sys.exit(f"interop: wrong: {', '.join(wrong)}")


if __name__ == "__main__":
    main()
