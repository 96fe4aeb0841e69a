#!/usr/bin/env python3
"""Runs the notebooks with the Python client of the checkout on a service that each of them starts.

    tests/notebooks.py [--program target/debug/shapelex] [--write] [NOTEBOOK...]

SHAPELEX_DATA is the folder of the data that they name, by default ../shared/data beside the checkout; a notebook whose
data are not there is skipped with a line. What cells print must be what is committed, numbers within two per cent;
pictures must be there. `--write` commits what they print and draw to the files instead, without the outputs of cells
with the tag `unshared`, whose data may not be copied here.
"""

import argparse
import base64
import os
import pathlib
import re
import shutil
import sys
import time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path.insert(0, str(HERE))

import environment  # noqa: E402

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
FOLDER = TARGET / "notebooks"
PLACE = ROOT / "notebooks"
REQUIREMENTS = PLACE / "requirements.txt"
CLIENT = ROOT / "clients" / "python"
# Seconds for one cell, on a busy machine with a service that is built for tests.
PATIENCE = 900
# Bytes of one picture, and of all notebooks.
LARGEST_PICTURE, LARGEST = 60_000, 1_500_000
# Differences of numbers that are printed: those of other processors and other libraries.
RELATIVE, ABSOLUTE = 0.02, 0.011
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")

# How terminals are told colours.
COLOUR = re.compile("\x1b\\[[0-9;]*m")


def prepared():
    """Python of an environment with the client and the tools."""
    wanted = f"{CLIENT} {sys.version}\n{(CLIENT / 'pyproject.toml').read_text()}{REQUIREMENTS.read_text()}"
    mark = FOLDER / "installed.txt"
    if not (mark.exists() and mark.read_text() == wanted):
        environment.created(FOLDER, ["--editable", CLIENT, "-r", REQUIREMENTS])
        mark.write_text(wanted)
    return FOLDER / "bin" / "python"


def printed(output):
    """The text of an output; None of one that draws."""
    data = output.get("data", {})
    return None if "image/png" in data else output.get("text", data.get("text/plain", ""))


def pictures(outputs):
    return [base64.b64decode(one["data"]["image/png"]) for one in outputs if "image/png" in one.get("data", {})]


def same(found, expected):
    """Whether two texts say the same: the same words, and numbers that are near."""
    if NUMBER.sub("#", found).split() != NUMBER.sub("#", expected).split():
        return False
    pairs = zip(NUMBER.findall(found), NUMBER.findall(expected))
    return all(abs(float(a) - float(b)) <= ABSOLUTE + RELATIVE * abs(float(b)) for a, b in pairs)


def differences(cells, committed):
    """What cells print and draw that is not what is committed."""
    for number, (cell, before) in enumerate(zip(cells, committed)):
        if cell.cell_type != "code" or "unshared" in cell.metadata.get("tags", []):
            continue
        texts = ["".join(printed(one) or "" for one in side) for side in (cell.outputs, before.outputs)]
        if not same(*texts):
            yield f"cell {number} prints\n{texts[0]}\nand not\n{texts[1]}"
        if len(pictures(cell.outputs)) != len(pictures(before.outputs)):
            yield f"cell {number} draws {len(pictures(cell.outputs))} pictures and not {len(pictures(before.outputs))}"


def committable(path):
    """What must not be committed: large pictures, folders of a machine."""
    text = path.read_text(encoding="utf-8")
    for folder in {str(pathlib.Path.home()), str(ROOT), str(ROOT.parent), "/tmp/"}:
        if folder != "/" and folder in text:
            yield f"{path.name}: names the folder {folder}"
    import nbformat

    for number, cell in enumerate(nbformat.read(path, 4).cells):
        for picture in pictures(cell.get("outputs", [])):
            if len(picture) > LARGEST_PICTURE:
                yield f"{path.name}: the picture of cell {number} has {len(picture)} bytes"


def lean(notebook):
    """The notebook as it is committed: what cells print is joined, counts and unshared outputs are left out."""
    for number, cell in enumerate(code for code in notebook.cells if code.cell_type == "code"):
        cell.execution_count = number + 1
        cell.metadata.pop("execution", None)
        if "unshared" in cell.metadata.get("tags", []):
            cell.outputs = []
        for output in cell.outputs:
            output.metadata = {} if "metadata" in output else None
            if output.metadata is None:
                del output["metadata"]
            if "image/png" in output.get("data", {}):
                output.data.pop("text/plain", None)
            if "execution_count" in output:
                output.execution_count = number + 1
    notebook.metadata["language_info"] = {"name": "python"}
    return notebook


def executed(path):
    """The notebook with what it prints and draws, and as it is committed."""
    import nbclient
    import nbformat

    committed, notebook = nbformat.read(path, 4), nbformat.read(path, 4)
    nbclient.NotebookClient(
        notebook,
        timeout=PATIENCE,
        startup_timeout=PATIENCE,
        kernel_name="python3",
        extra_arguments=["--log-level=ERROR"],
        record_timing=False,
        resources={"metadata": {"path": PLACE}},
    ).execute()
    return notebook, committed


def missing(path, data):
    """Data of a notebook that are not there."""
    import nbformat

    return [name for name in nbformat.read(path, 4).metadata["shapelex"]["data"] if not (data / name).exists()]


def tried(path, data, write):
    """Faults of a notebook; None where it is skipped."""
    import nbclient.exceptions
    import nbformat

    if absent := missing(path, data):
        print(f"SKIPPED: {path.name}, there is no {absent[0]} in SHAPELEX_DATA or beside the checkout")
        return None
    begin = time.monotonic()
    try:
        notebook, committed = executed(path)
    except (nbclient.exceptions.CellExecutionError, nbclient.exceptions.CellTimeoutError) as error:
        return [f"{path.name}: {COLOUR.sub('', str(error))}"]
    print(f"{path.name}: {time.monotonic() - begin:.0f} s", flush=True)
    if not write:
        return [f"{path.name}: {fault}" for fault in differences(notebook.cells, committed.cells)]
    nbformat.write(lean(notebook), path)
    return []


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=pathlib.Path, default=TARGET / "debug" / "shapelex")
    parser.add_argument("--write", action="store_true", help="to commit what the notebooks print and draw")
    parser.add_argument("notebooks", nargs="*", type=pathlib.Path)
    arguments = parser.parse_args()
    program = arguments.program.resolve()
    if not program.exists():
        print("SKIPPED: the notebooks, the program is not built")
        return
    if pathlib.Path(sys.prefix) != FOLDER:
        try:
            python = prepared()
        except environment.Unavailable as reason:
            shutil.rmtree(FOLDER, ignore_errors=True)
            print(f"SKIPPED: the notebooks, their packages cannot be installed: {reason}")
            return
        os.execv(python, [str(python), __file__, *sys.argv[1:]])
    data = pathlib.Path(os.environ.get("SHAPELEX_DATA") or ROOT.parent / "shared" / "data").resolve()
    for name in [name for name in os.environ if name.startswith("SHAPELEX_")]:
        del os.environ[name]
    os.environ |= {"SHAPELEX_BINARY": str(program), "SHAPELEX_DATA": str(data), "PYTHONDONTWRITEBYTECODE": "1"}
    paths = [path.resolve() for path in arguments.notebooks] or sorted(PLACE.glob("*.ipynb"))
    passed, faults = 0, []
    for path in paths:
        found = tried(path, data, arguments.write)
        faults += found or []
        passed += found == []
    faults += [fault for path in paths for fault in committable(path)]
    size = sum(path.stat().st_size for path in PLACE.glob("*.ipynb"))
    faults += [f"the notebooks have {size} bytes, at most {LARGEST}"] if size > LARGEST else []
    for fault in faults:
        print(f"FAIL: {fault}")
    print(f"notebooks: {passed} passed, {len(faults)} failed")
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
