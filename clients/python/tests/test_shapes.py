"""Shapes as arrays, and their form in transit."""

import io

import numpy as np
import pandas
import pytest

from shapelex import ShapelexError, Shapes
from shapelex._shapes import as_shapes, points_of, rows_of


def test_arrays_become_shapes():
    assert points_of(np.zeros((5, 4, 2))).shape == (5, 4, 2)
    assert points_of(np.zeros((4, 2))).shape == (1, 4, 2)
    assert points_of([[0, 0], [1, 0], [1, 1]]).shape == (1, 3, 2)
    mixed = points_of([np.zeros((4, 2)), np.zeros((5, 2))])
    assert isinstance(mixed, list) and [len(shape) for shape in mixed] == [4, 5]
    with pytest.raises(ShapelexError, match="shapes × points × coordinates, got an array of 1 axes"):
        points_of(np.zeros(4))
    with pytest.raises(ShapelexError, match="at least one shape"):
        points_of([])


def test_what_is_known_of_shapes_has_their_number():
    with pytest.raises(ShapelexError, match=r"expected as many ids as shapes \(2\), got 3"):
        as_shapes(np.zeros((2, 3, 2)), ids=["a", "b", "c"])


def test_npz_keeps_everything():
    frame = pandas.DataFrame({"age": [1.5, np.nan], "site": ["zrh", None], "healthy": [True, False]})
    points = [np.arange(6.0).reshape(3, 2), np.arange(8.0).reshape(4, 2)]
    shapes = as_shapes(points, ids=["a", "b"], labels=["x", "y"], weights=[1, 2], attributes=frame, closed=True)
    with np.load(io.BytesIO(shapes.npz()), allow_pickle=False) as file:
        found = Shapes.of_arrays({name: file[name] for name in file.files})
    assert [shape.tolist() for shape in found] == [shape.tolist() for shape in points]
    assert found.ids == ["a", "b"] and found.labels == ["x", "y"] and list(found.weights) == [1, 2]
    assert found.attributes == [{"age": 1.5, "site": "zrh", "healthy": True}, {"healthy": False}]
    assert list(found.closed) == [1, 1]
    assert list(found.frame()["site"].fillna("")) == ["zrh", ""]


def test_rows_of_columns_and_of_rows_agree():
    assert rows_of({"a": [1, 2], "b": ["x", None]}) == rows_of([{"a": 1, "b": "x"}, {"a": 2}])


def test_arrays_alone_are_sent_as_npy():
    plain = as_shapes(np.zeros((2, 4, 2)), closed=True)
    assert plain.body()[1:] == ("application/x-npy", {"closed": True})
    assert np.load(io.BytesIO(plain.body()[0])).shape == (2, 4, 2)
    assert as_shapes(plain, ids=["a", "b"]).body()[1:] == ("application/x-npz", {})
    assert as_shapes([np.zeros((4, 2)), np.zeros((5, 2))]).body()[1] == "application/x-npz"


def test_parts_are_of_a_size_and_miss_nothing():
    shapes = as_shapes([np.full((k, 2), float(k)) for k in range(3, 40)], ids=[str(k) for k in range(3, 40)])
    parts = list(shapes.parts(2000))
    assert len(parts) > 3 and all(part.nbytes <= 2000 or len(part) == 1 for part in parts)
    assert [name for part in parts for name in part.ids] == shapes.ids
    assert list(shapes.parts(10**9)) == [shapes]
    assert [len(part) for part in as_shapes(np.zeros((3, 4, 2))).parts(1)] == [1, 1, 1]
    assert [len(part) for part in as_shapes(np.zeros((7, 4, 2))).parts(count=3)] == [3, 3, 1]


def test_shapes_are_chosen_by_place_slice_and_mask():
    shapes = as_shapes(np.arange(24.0).reshape(3, 4, 2), ids=["a", "b", "c"])
    assert shapes[1].shape == (4, 2)
    assert shapes[1:].ids == ["b", "c"] and shapes[np.array([True, False, True])].ids == ["a", "c"]
