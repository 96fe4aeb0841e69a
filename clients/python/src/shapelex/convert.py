"""Shapes from and to objects of other packages; each package is needed only by its own functions."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ._reply import expect, imported
from ._shapes import Shapes
from .results import Outlines

Floats = NDArray[np.float64]


def points_list(shapes: Shapes | Outlines | Iterable[Any]) -> list[Floats]:
    """Points of each shape, of shape (p_k, d)."""
    rows = shapes.points if isinstance(shapes, (Shapes, Outlines)) else shapes
    return [np.asarray(shape, dtype=np.float64) for shape in rows]


def from_shapely(geometries: Any) -> Shapes:
    """Contours of shapely: outer rings of polygons, and lines.

    Parameters
    ----------
    geometries : geometry or sequence of geometries
        Polygons and lines; of several parts, each part is a shape.

    Raises
    ------
    ShapelexError
        For polygons with holes, which have several outlines, and for other geometries.
    """
    shapely = imported("shapely", "from_shapely")
    found: list[Floats] = []
    closed: list[int] = []
    for part in shapely.get_parts(np.atleast_1d(np.asarray(geometries, dtype=object))):
        polygon = part.geom_type == "Polygon"
        expect(polygon or part.geom_type in ("LineString", "LinearRing"), f"expected lines, got a {part.geom_type}")
        expect(not polygon or not len(part.interiors), "expected polygons without holes: give their rings one by one")
        rows = np.asarray((part.exterior if polygon else part).coords, dtype=np.float64)
        ring = polygon or part.geom_type == "LinearRing"
        found.append(rows[:-1] if ring else rows)
        closed.append(int(ring))
    return Shapes(found, closed=np.array(closed, dtype=np.int8))


def to_shapely(shapes: Shapes | Outlines | Iterable[Any], *, closed: bool = True) -> list[Any]:
    """Polygons of shapely, or lines where curves are open.

    Parameters
    ----------
    shapes : Shapes, Outlines or sequence of arrays of shape (p_k, 2)
        Contours.
    closed : bool
        Whether they are closed; what the shapes say of themselves goes first.
    """
    shapely = imported("shapely", "to_shapely")
    rows = points_list(shapes)
    if isinstance(shapes, Outlines):
        closed = shapes.kind == "closed_curve"
    said = shapes.closed if isinstance(shapes, Shapes) and shapes.closed is not None else closed
    flags = np.broadcast_to(np.asarray(said), len(rows))
    return [shapely.Polygon(row) if flag == 1 else shapely.LineString(row) for row, flag in zip(rows, flags)]


def from_napari(layer: Any) -> Shapes:
    """Contours of a layer of shapes of napari, whose points are rows and columns.

    Parameters
    ----------
    layer : napari.layers.Shapes, or sequence of arrays of shape (p_k, 2)
        Its vertices; the scale of the layer is applied.

    Returns
    -------
    Shapes
        With x to the right and y downwards, as in the picture; polygons, ellipses and rectangles are closed.
    """
    data = layer.data if hasattr(layer, "data") and hasattr(layer, "shape_type") else layer
    kinds = list(layer.shape_type) if hasattr(layer, "shape_type") else ["polygon"] * len(data)
    scale = np.asarray(getattr(layer, "scale", np.ones(2)), dtype=np.float64)[-2:]
    found = [(np.asarray(rows, dtype=np.float64)[:, -2:] * scale)[:, ::-1] for rows in data]
    closed = np.array([int(kind not in ("path", "line")) for kind in kinds], dtype=np.int8)
    return Shapes(found, closed=closed)


def to_napari(shapes: Shapes | Outlines | Iterable[Any]) -> list[Floats]:
    """Vertices for `viewer.add_shapes(…, shape_type="polygon")`: rows and columns of each contour.

    Parameters
    ----------
    shapes : Shapes, Outlines or sequence of arrays of shape (p_k, 2)
        Contours with x to the right and y downwards.
    """
    return [np.ascontiguousarray(row[:, ::-1]) for row in points_list(shapes)]


def from_trimesh(mesh: Any) -> bytes:
    """A mesh of trimesh as a file of PLY, as `Cohort.add` takes it.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Triangles.
    """
    imported("trimesh", "from_trimesh")
    return cast(bytes, mesh.export(file_type="ply"))


def to_trimesh(shown: Outlines, k: int = 0) -> Any:
    """A surface as a mesh of trimesh.

    Parameters
    ----------
    shown : Outlines
        Surfaces.
    k : int
        Which one.
    """
    trimesh = imported("trimesh", "to_trimesh")
    return trimesh.Trimesh(shown.points[k].reshape(-1, 3), shown.triangles(), process=True)


def from_simpleitk(image: Any) -> bytes:
    """A label image of SimpleITK as a file of NRRD, with its spacing, as `Cohort.add` takes it.

    Parameters
    ----------
    image : SimpleITK.Image
        Labels in the plane or in space; every component of a label is a shape.
    """
    sitk = imported("SimpleITK", "from_simpleitk")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "labels.nrrd"
        sitk.WriteImage(image, str(path))
        return path.read_bytes()


def to_simpleitk(content: bytes) -> Any:
    """An image of SimpleITK of an answer of NIfTI, such as that of `client.calls.segment(…, format="nii")`.

    Parameters
    ----------
    content : bytes
        Body of the answer: `Reply.content`.
    """
    sitk = imported("SimpleITK", "to_simpleitk")
    ending = ".nii.gz" if content[:2] == b"\x1f\x8b" else ".nii"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"image{ending}"
        path.write_bytes(content)
        return sitk.ReadImage(str(path))
