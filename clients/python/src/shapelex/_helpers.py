"""Small parts of both halves of the client that send nothing."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from typing_extensions import Self

from ._reply import encoded, expect
from ._shapes import Shapes
from .results import Outlines

if TYPE_CHECKING:
    import pandas as pd

# Whether curves are closed, by kind.
CLOSED_KINDS = {"closed_curve": True, "open_curve": False}
# Directions of surfaces that are closed, by topology.
CLOSED = {
    "torus": (True, True),
    "cylinder": (True, False),
    "sphere": (True, False),
    "sharp_sphere": (True, False),
    "plane": (False, False),
}


class Progress:
    """A bar of tqdm for a job, in terminals and notebooks, or nothing where it is not installed.

    Parameters
    ----------
    title : str
        Kind of the job.
    shown : bool, optional
        Whether a bar is shown; None: where tqdm is installed.
    timeout : float, optional
        Seconds after which `within` refuses to wait on.
    """

    def __init__(self, title: str, shown: bool | None, timeout: float | None) -> None:
        self.end = None if timeout is None else time.monotonic() + timeout
        self.bar: Any = None
        if shown is False:
            return
        try:
            from tqdm.auto import tqdm
        except ImportError:
            expect(shown is None, "expected tqdm for a bar of progress, got no such package: pip install tqdm")
            return
        form = "{l_bar}{bar}| {elapsed}<{remaining}{postfix}"
        self.bar = tqdm(total=1.0, desc=title, bar_format=form, delay=0 if shown else 1.0, leave=bool(shown))

    def update(self, fraction: float, phase: str | None) -> None:
        """Shows how much is done, and what is being done."""
        if self.bar is not None:
            self.bar.set_postfix_str(phase or "", refresh=False)
            self.bar.update(max(fraction - self.bar.n, 0.0))

    def within(self, pause: float, id: str) -> float:
        """The pause, cut at the end of the patience.

        Raises
        ------
        TimeoutError
            When it is over.
        """
        if self.end is None:
            return pause
        left = self.end - time.monotonic()
        if left <= 0:
            raise TimeoutError(f"expected {id} to end in time, got a job that runs on")
        return min(pause, left)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.bar is not None:
            self.bar.close()


def is_path(source: object) -> bool:
    """Whether a source is the path of a file."""
    return isinstance(source, (str, os.PathLike))


def column_of(value: object) -> str:
    """An option of reading as the service takes it: numbers and Booleans as texts, lists with commas."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return ",".join(map(str, value))
    return encoded(value).decode() if isinstance(value, Mapping) else str(value)


def uploaded(source: Any, options: dict[str, Any]) -> tuple[bytes | Path, dict[str, Any]]:
    """The body of an upload of a file, and its options with its name."""
    options = {name: value if name == "labels" else column_of(value) for name, value in options.items()}
    if isinstance(source, bytes):
        return source, options
    path = Path(source)
    expect(path.is_file(), f"expected a file at {path}, got none")
    return path, {"name": path.name, **options}


def filtered(conditions: Mapping[str, Any]) -> dict[str, Any] | None:
    """A filter of a body; a single value of `has` is a list."""
    chosen = {name: value for name, value in conditions.items() if value is not None}
    if isinstance(chosen.get("has"), str):
        chosen["has"] = [chosen["has"]]
    return chosen or None


def representation_of(
    kind: str, count: int | None, dimension: int | None, generator: str | Mapping[str, Any], shapes: Shapes | None
) -> dict[str, Any]:
    """A representation of curves or landmarks."""
    expect(
        kind in ("closed_curve", "open_curve", "landmarks"),
        f"expected the kind closed_curve, open_curve or landmarks, or a representation, got {kind}",
    )
    first = None if shapes is None or not len(shapes) else shapes.points[0]
    found: dict[str, Any] = {"kind": kind, "dimension": dimension or (2 if first is None else first.shape[1])}
    if kind == "landmarks":
        expect(count is not None or first is not None, "expected a number of landmarks or shapes, got neither")
        return found | {"points": count or len(cast(Any, first))}
    found["intervals" if kind == "open_curve" else "control_points"] = count or 32
    return found | {"generator": {"name": generator} if isinstance(generator, str) else dict(generator)}


def method_of(
    name: str,
    cohort: str,
    components: int,
    transformation: str,
    method: Mapping[str, Any] | None,
    classifier: str | Mapping[str, Any] | None,
    further: Mapping[str, Any],
) -> dict[str, Any]:
    """The body of a request that learns a dictionary."""
    chosen = {"kind": "discriminant", "attribute": classifier} if isinstance(classifier, str) else classifier
    return {
        "name": name,
        "cohort": cohort,
        "transformation": transformation,
        "method": dict(method or {"kind": "functional_pca", "components": components}),
        **({"classifier": dict(chosen)} if chosen else {}),
        **further,
    }


def grid_of(representation: Mapping[str, Any], count: int) -> list[int]:
    """Numbers of points on a surface along its directions; open ones have both ends."""
    closed = CLOSED.get(str(representation.get("topology")), (False, False))
    return [count if round_ else count + 1 for round_ in closed]


def outlines_of(representation: Mapping[str, Any], answer: Any) -> Outlines:
    """Points of an answer of `POST /v1/evaluate`."""
    points = np.array([entry["points"] for entry in answer["evaluations"]], dtype=np.float64)
    faces = answer.get("faces")
    return Outlines(
        points,
        representation["kind"],
        None if faces is None else np.asarray(faces, dtype=np.int64),
        CLOSED.get(str(representation.get("topology")), (False, False)),
    )


def scores_of(frame: pd.DataFrame) -> pd.DataFrame:
    """A frame of scores whose lists are columns `score.1`, …."""
    import pandas

    values = np.array(frame.pop("scores").tolist(), dtype=np.float64)
    names = [f"score.{k + 1}" for k in range(values.shape[1])]
    columns = pandas.DataFrame(values, columns=pandas.Index(names), index=frame.index)
    joined: pd.DataFrame = pandas.concat([frame, columns], axis=1)
    return joined
