"""Shapes with their names and attributes, as arrays; their form in transit is NPZ."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._reply import NPY, NPZ, expect, imported, plain

if TYPE_CHECKING:
    import pandas as pd

    Texts = Sequence[Any] | NDArray[Any] | pd.Series[Any]
    Columns = Mapping[str, Any] | Sequence[Mapping[str, Any]] | pd.DataFrame

Points = NDArray[np.float64]

# What a request that is answered from memory takes by default: `--max-shapes`, and `--max-body-bytes` of the lines that
# the service makes of a file, in which a number takes up to 20 bytes.
BATCH, BATCH_BYTES = 100_000, 24 << 20


@dataclass
class Shapes:
    """Shapes, one after the other, with what is known of each.

    Attributes
    ----------
    points : ndarray of shape (n, p, d), or list of n ndarrays of shape (p_k, d)
        Points of each shape, in the unit of the cohort. A point that is NaN in every coordinate is missing.
    ids, subjects, labels : list of str, optional
        External ids, subjects and class labels.
    weights : ndarray of shape (n,), optional
        Weights in means.
    attributes : list of dict, optional
        Attributes of each shape by name: texts, numbers or Booleans.
    closed : bool or ndarray of shape (n,), optional
        Whether curves are closed; of an array, 1 is closed, 0 open, -1 landmarks. None: as the cohort has them.
    """

    points: Points | list[Points]
    ids: list[str] | None = None
    subjects: list[str] | None = None
    labels: list[str] | None = None
    weights: NDArray[np.float64] | None = None
    attributes: list[dict[str, Any]] | None = None
    closed: bool | NDArray[Any] | None = None

    def __post_init__(self) -> None:
        for name in ("ids", "subjects", "labels", "weights", "attributes"):
            values = getattr(self, name)
            expect(
                values is None or len(values) == len(self.points),
                f"expected as many {name} as shapes ({len(self.points)}), got {0 if values is None else len(values)}",
            )

    def __len__(self) -> int:
        return len(self.points)

    def __iter__(self) -> Iterator[Points]:
        return iter(self.points)

    def __getitem__(self, chosen: int | slice | list[int] | NDArray[Any]) -> Points | Shapes:
        """The points of one shape by its place, or several shapes by a slice, places or a mask."""
        if isinstance(chosen, (int, np.integer)):
            return self.points[int(chosen)]
        places = np.arange(len(self))[chosen]
        points = self.points[places] if isinstance(self.points, np.ndarray) else [self.points[k] for k in places]

        def part(values: Any) -> Any:
            return None if values is None else [values[k] for k in places]

        return Shapes(
            points,
            part(self.ids),
            part(self.subjects),
            part(self.labels),
            None if self.weights is None else self.weights[places],
            part(self.attributes),
            self.closed[places] if isinstance(self.closed, np.ndarray) else self.closed,
        )

    def __repr__(self) -> str:
        counts = sorted({len(shape) for shape in self.points})
        size = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}" if counts else "no"
        return f"<Shapes: {len(self)} of {size} points>"

    @property
    def nbytes(self) -> int:
        """Bytes of all coordinates."""
        return sum(shape.nbytes for shape in self.points)

    def parts(self, most: int = BATCH_BYTES, count: int = BATCH) -> Iterator[Shapes]:
        """The shapes in parts of at most so many bytes of coordinates and so many shapes, and of one shape at least."""
        sizes = np.cumsum([shape.nbytes for shape in self.points])
        begin = 0
        while begin < len(self):
            before = sizes[begin - 1] if begin else 0
            end = max(int(np.searchsorted(sizes, before + most, side="right")), begin + 1)
            end = min(end, begin + count)
            yield self if end - begin == len(self) else cast(Shapes, self[begin:end])
            begin = end

    def frame(self) -> pd.DataFrame:
        """Ids, subjects, labels, weights and attributes as a frame of pandas, a row a shape."""
        pandas = imported("pandas", "a frame")
        known = {
            "external_id": self.ids,
            "subject": self.subjects,
            "label": self.labels,
            "weight": self.weights,
        }
        columns = {name: values for name, values in known.items() if values is not None}
        frame = pandas.DataFrame(columns, index=range(len(self)))
        more = pandas.DataFrame(self.attributes, index=range(len(self))) if self.attributes else pandas.DataFrame()
        return cast("pd.DataFrame", pandas.concat([frame, more], axis=1))

    def body(self) -> tuple[bytes, str, dict[str, object]]:
        """The shapes as the body of a request, its media type, and what the query says besides.

        NPY, which is read shape by shape, where nothing but an array is known; else NPZ.
        """
        known = (self.ids, self.subjects, self.labels, self.weights, self.attributes)
        single = self.closed is None or isinstance(self.closed, (bool, np.bool_))
        if not isinstance(self.points, np.ndarray) or not single or any(part is not None for part in known):
            return self.npz(), NPZ, {}
        file = io.BytesIO()
        np.save(file, np.ascontiguousarray(self.points, dtype=np.float64), allow_pickle=False)
        return file.getvalue(), NPY, {} if self.closed is None else {"closed": bool(self.closed)}

    def npz(self) -> bytes:
        """The shapes as a file of NPZ, as the service reads it."""
        arrays: dict[str, NDArray[Any]] = {}
        if isinstance(self.points, np.ndarray):
            arrays["points"] = np.ascontiguousarray(self.points, dtype=np.float64)
        else:
            arrays["points"] = np.concatenate(self.points, dtype=np.float64)
            arrays["offsets"] = np.cumsum([0, *map(len, self.points)])
        for name, texts in (("ids", self.ids), ("subjects", self.subjects), ("labels", self.labels)):
            if texts is not None:
                arrays[name] = np.array(["" if text is None else str(text) for text in texts], dtype=np.str_)
        if self.weights is not None:
            arrays["weights"] = np.asarray(self.weights, dtype=np.float64)
        if self.attributes is not None:
            arrays["attributes"] = np.array([json.dumps(row, default=plain) for row in self.attributes], dtype=np.str_)
        if self.closed is not None:
            arrays["closed"] = np.broadcast_to(np.asarray(self.closed, dtype=np.int8), len(self))
        file = io.BytesIO()
        np.savez(file, allow_pickle=False, **cast(Any, arrays))
        return file.getvalue()

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Shapes:
        """Shapes of the arrays of a file of NPZ that the service wrote."""
        points = arrays["points"]
        shapes: Points | list[Points] = points
        if "offsets" in arrays:
            shapes = np.split(points, arrays["offsets"][1:-1])

        def texts(name: str) -> list[str] | None:
            return [str(text) for text in arrays[name]] if name in arrays else None

        attributes = texts("attributes")
        return cls(
            shapes,
            texts("ids"),
            texts("subjects"),
            texts("labels"),
            arrays.get("weights"),
            None if attributes is None else [json.loads(text) if text else {} for text in attributes],
            arrays.get("closed"),
        )


def points_of(source: Any) -> Points | list[Points]:
    """Points of shapes given as arrays.

    Parameters
    ----------
    source : array of shape (n, p, d) or (p, d), or sequence of arrays of shape (p_k, d)
        Several shapes, one, or several with different numbers of points.
    """
    if isinstance(source, np.ndarray) and source.dtype != object:
        array = np.asarray(source, dtype=np.float64)
        expect(array.ndim in (2, 3), f"expected shapes × points × coordinates, got an array of {array.ndim} axes")
        return array if array.ndim == 3 else array[None]
    shapes = [np.asarray(shape, dtype=np.float64) for shape in source]
    expect(bool(shapes), "expected at least one shape, got none")
    if all(shape.ndim == 1 for shape in shapes):
        return points_of(np.stack(shapes))
    axes = {shape.ndim for shape in shapes}
    expect(axes == {2}, f"expected points × coordinates of each shape, got arrays of {sorted(axes)} axes")
    return np.stack(shapes) if len({shape.shape for shape in shapes}) == 1 else shapes


def rows_of(columns: Columns) -> list[dict[str, Any]]:
    """Attributes of each shape, of a frame, of columns by name, or of rows; missing values are left out."""
    if hasattr(columns, "to_dict") and hasattr(columns, "columns"):
        columns = cast("dict[str, Any]", columns.to_dict("list"))
    if isinstance(columns, Mapping):
        names = list(columns)
        rows = [dict(zip(names, row)) for row in zip(*columns.values())]
    else:
        rows = [dict(row) for row in columns]
    return [{name: value for name, value in row.items() if value is not None and value == value} for row in rows]


def as_shapes(
    source: Any,
    *,
    ids: Texts | None = None,
    subjects: Texts | None = None,
    labels: Texts | None = None,
    weights: ArrayLike | None = None,
    attributes: Columns | None = None,
    closed: bool | None = None,
) -> Shapes:
    """Shapes of arrays, or of `Shapes`, with what is given besides.

    Parameters
    ----------
    source : Shapes, array or sequence of arrays
        As in `Shapes`; one array of points × coordinates is one shape.
    ids, subjects, labels : sequence of str, optional
        One for each shape.
    weights : array_like of shape (n,), optional
        Weights in means.
    attributes : DataFrame, mapping of columns, or sequence of mappings, optional
        Attributes of the shapes.
    closed : bool, optional
        Whether curves are closed.
    """
    shapes = source if isinstance(source, Shapes) else Shapes(points_of(source))

    def texts(values: Texts | None, old: list[str] | None) -> list[str] | None:
        return old if values is None else [str(value) for value in values]

    return replace(
        shapes,
        ids=texts(ids, shapes.ids),
        subjects=texts(subjects, shapes.subjects),
        labels=texts(labels, shapes.labels),
        weights=shapes.weights if weights is None else np.asarray(weights, dtype=np.float64),
        attributes=shapes.attributes if attributes is None else rows_of(attributes),
        closed=shapes.closed if closed is None else closed,
    )
