"""The programs of the README run as they stand."""

import pathlib
import re
import shutil

import pytest

HERE = pathlib.Path(__file__).resolve().parent
CELLS = HERE.parent.parent.parent / "examples" / "cells" / "cells.ndjson"
BLOCKS = re.findall(r"```python\n(.*?)```", (HERE.parent / "README.md").read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture(scope="module")
def names(shapelex_server, tmp_path_factory):
    """What the nine lines leave behind, in a folder with the example file."""
    folder, found = tmp_path_factory.mktemp("readme"), {}
    shutil.copy(CELLS, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(compile(BLOCKS[0], "README.md", "exec"), found)
        yield found
        found["client"].close()


def test_the_first_program_has_nine_lines():
    assert len(BLOCKS[0].strip().splitlines()) == 9


def test_the_nine_lines(names):
    assert len(names["contours"]) == 120 and names["mean"].n_shapes == 120
    assert pathlib.Path("modes.png").read_bytes().startswith(b"\x89PNG")
    assert len(names["groups"].pairs) == 3
    scores = names["scores"]
    assert len(scores) == 120 and list(scores.columns[:3]) == ["external_id", "label", "labels.treatment"]
    assert scores["score.10"].notna().all()


@pytest.mark.parametrize("block", BLOCKS[1:], ids=lambda block: block.splitlines()[0][:40])
def test_the_other_programs(names, block):
    exec(compile(block, "README.md", "exec"), names)
