"""Shapes from and to objects of other packages."""

import types

import numpy as np
import pytest

from shapelex import Outlines, ShapelexError, Shapes, convert

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]])


def test_polygons_of_shapely():
    shapely = pytest.importorskip("shapely")
    polygons = [
        shapely.Polygon(SQUARE),
        shapely.MultiPolygon([shapely.Polygon(SQUARE + 9), shapely.Polygon(SQUARE - 9)]),
    ]
    found = convert.from_shapely([*polygons, shapely.LineString(SQUARE)])
    assert len(found) == 4 and list(found.closed) == [1, 1, 1, 0]
    assert np.array_equal(found.points[0], SQUARE) and len(found.points[3]) == 4
    back = convert.to_shapely(found)
    assert back[0].area == 8 and back[3].geom_type == "LineString"
    ring = shapely.Polygon(SQUARE, [SQUARE / 4 + 0.5])
    with pytest.raises(ShapelexError, match="without holes"):
        convert.from_shapely(ring)
    with pytest.raises(ShapelexError, match="got a Point"):
        convert.from_shapely(shapely.Point(0, 0))


def test_layers_of_napari_have_rows_and_columns():
    layer = types.SimpleNamespace(data=[SQUARE, SQUARE], shape_type=["polygon", "path"], scale=np.array([2.0, 1.0]))
    found = convert.from_napari(layer)
    assert np.array_equal(found.points[0], SQUARE[:, ::-1] * [1, 2]) and list(found.closed) == [1, 0]
    assert np.array_equal(convert.to_napari(Shapes([SQUARE]))[0], SQUARE[:, ::-1])


def test_meshes_of_trimesh():
    trimesh = pytest.importorskip("trimesh")
    body = convert.from_trimesh(trimesh.creation.icosphere(subdivisions=1))
    assert body.startswith(b"ply")
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 24, endpoint=False), np.linspace(0, 2 * np.pi, 16, endpoint=False))
    points = np.stack([(3 + np.cos(v)) * np.cos(u), (3 + np.cos(v)) * np.sin(u), np.sin(v)], axis=-1).swapaxes(0, 1)
    mesh = convert.to_trimesh(Outlines(points[None], "surface", closed=(True, True)))
    assert mesh.is_watertight and mesh.volume == pytest.approx(6 * np.pi**2, rel=0.05)


def test_label_images_of_simpleitk():
    sitk = pytest.importorskip("SimpleITK", reason="SimpleITK is not installed")
    image = sitk.GetImageFromArray(np.pad(np.ones((6, 6), dtype=np.uint8), 3))
    image.SetSpacing((0.5, 0.5))
    assert convert.from_simpleitk(image).startswith(b"NRRD")
