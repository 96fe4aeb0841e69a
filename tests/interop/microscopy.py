"""GeoJSON, ImageJ ROI, WKT and COCO, compared with shapely, roifile and read-roi, both ways."""

import json
import math
from collections import Counter

import numpy
import roifile
import shapely
import shapely.geometry

PACKAGES = ["numpy==2.4.6", "roifile==2026.2.10", "read-roi==1.6.0", "shapely==2.2.0"]

KEEP = {"holes": "keep"}
# Coordinates and areas agree with those of other readers to this, relative.
TOLERANCE = 1e-6


def near(found, expected, scale=1.0):
    """Whether numbers agree, relative to the larger of their size and `scale`."""
    return abs(found - expected) <= TOLERANCE * max(abs(expected), scale)


def area(records):
    """Area of closed curves, holes negative."""
    total = 0.0
    for record in records:
        if record.get("closed"):
            x, y = numpy.array(record["points"])[:, :2].T
            x, y = x - x[0], y - y[0]
            part = abs(numpy.dot(x, numpy.roll(y, -1)) - numpy.dot(y, numpy.roll(x, -1))) / 2
            total -= part if record.get("ring", {}).get("hole") else -part
    return total


def length(records):
    """Length of curves, closed ones with their last edge."""
    total = 0.0
    for record in records:
        points = record["points"]
        pairs = list(zip(points, points[1:] + ([points[0]] if record.get("closed") else [])))
        total += sum(math.dist(a, b) for a, b in pairs) if "closed" in record else 0.0
    return total


def shapes():
    """Geometries of every kind, with holes, parts, large and small numbers."""
    box = [(0.25, 0), (9, 0), (9, 7), (0.25, 7)]
    hole = [(1, 1), (2, 1), (2, 3.5)]
    return {
        "polygon": shapely.geometry.Polygon(box),
        "holes": shapely.geometry.Polygon(box, [hole, [(4, 4), (5, 4), (5, 5)]]),
        "parts": shapely.geometry.MultiPolygon([(box, [hole]), ([(100, 100), (1e6, 100), (1e6, 1e5)], [])]),
        "line": shapely.geometry.LineString([(0, 0), (1e-7, 1), (3, 1 / 3)]),
        "lines": shapely.geometry.MultiLineString([[(0, 0), (1, 1)], [(2, 2), (3, 3), (4, 5)]]),
        "point": shapely.geometry.Point(1.5, -2),
        "points": shapely.geometry.MultiPoint([(1, 2), (3, 4)]),
        "space": shapely.geometry.LineString([(0, 0, 1), (1, 2, 3.125)]),
        "mixed": shapely.geometry.GeometryCollection(
            [shapely.geometry.Point(0, 0), shapely.geometry.Polygon(box, [hole])]
        ),
    }


def numbered(features):
    """Names of features: equal ones get numbers, in the order of the file."""
    seen = Counter()
    for feature in features:
        name = feature["properties"].get("name", feature["id"])
        seen[name] += 1
        yield name if seen[name] == 1 else f"{name}~{seen[name]}"


def check_qupath(convert, data, folder):
    """Real files: every feature has the area, length and properties that shapely and json find."""
    for path in sorted((data / "formats-qupath-geojson").glob("*.geojson")):
        records, summary = convert(path, options=KEEP)
        features = json.loads(path.read_text())["features"]
        by_name = {}
        for record in records:
            key = record["metadata"].get("id", record["external_id"].split("/")[0])
            by_name.setdefault(key, []).append(record)
        wrong = []
        for feature, name in zip(features, numbered(features)):
            geometry, own = shapely.geometry.shape(feature["geometry"]), by_name.get(feature["id"], [])
            properties = feature["properties"]
            label = (properties.get("classification") or {}).get("name")
            good = near(area(own), geometry.area) and near(length(own), geometry.length)
            good = good and len(own) == len(getattr(geometry, "geoms", [geometry]))
            good = good and all(record.get("label") == label for record in own)
            names = [name, *(f"{name}/{k}" for k in range(2, len(own) + 1))]
            good = good and [record["external_id"] for record in own] == names
            if not good:
                wrong.append(feature["id"])
        ok = not wrong and not summary["dropped"] and len(by_name) == len(features)
        yield f"{path.name}: areas, lengths, classes", ok, f"{len(features)} features, wrong: {wrong[:3]}"
        written = folder / f"again-{path.name}"
        convert(path, "geojson", KEEP, written)
        again = json.loads(written.read_text())["features"]
        for feature, name in zip(features, numbered(features)):
            if "name" in feature["properties"]:
                feature["properties"]["name"] = name
        same = [
            a["geometry"] == b["geometry"] and a["id"] == b["id"] and a["properties"] == b["properties"]
            for a, b in zip(features, again)
        ]
        yield f"{path.name}: written as it was", all(same) and len(again) == len(features), f"{sum(same)} features"


def check_geojson(convert, folder):
    """Files of shapely's geometries, read, and ours read by shapely."""
    path, out = folder / "kinds.geojson", folder / "kinds-out.geojson"
    features = [
        {"properties": {"name": name}, "geometry": shapely.geometry.mapping(geometry), "type": "Feature"}
        for name, geometry in shapes().items()
    ]
    path.write_text(json.dumps({"features": features, "type": "FeatureCollection"}))
    convert(path, "geojson", KEEP, out)
    again = {
        feature["properties"]["name"]: shapely.geometry.shape(feature["geometry"])
        for feature in json.loads(out.read_text())["features"]
    }
    wrong = [name for name, geometry in shapes().items() if shapely.to_wkb(again[name]) != shapely.to_wkb(geometry)]
    yield "geojson: geometries of shapely come back bit by bit", not wrong, f"wrong: {wrong}"
    records, _ = convert(path, options=KEEP)
    total = sum(geometry.area for geometry in shapes().values())
    yield "geojson: areas", near(area(records), total), f"{area(records)} and {total}"


def check_wkt(convert, folder):
    """Lines of shapely, read, and ours read by shapely."""
    path, out = folder / "kinds.wkt", folder / "kinds-out.wkt"
    path.write_text("".join(f"{name}\t{shapely.to_wkt(geometry, -1)}\n" for name, geometry in shapes().items()))
    convert(path, "wkt", KEEP, out)
    lines = dict(line.split("\t") for line in out.read_text().splitlines())
    wrong = [
        name
        for name, geometry in shapes().items()
        if shapely.to_wkb(shapely.from_wkt(lines[name]))
        != shapely.to_wkb(shapely.from_wkt(shapely.to_wkt(geometry, -1)))
    ]
    yield "wkt: geometries of shapely come back bit by bit", not wrong, f"wrong: {wrong}"


def check_coco(convert, folder):
    """Instances made here and read, and ours with areas and bounds of shapely."""
    path, out = folder / "instances.json", folder / "out.coco.json"
    polygons = [[[0.5, 0, 4, 0, 4, 3]], [[0, 0, 4, 0, 4, 3], [10, 0, 14, 0, 14.5, 3]]]
    annotations = [
        {"id": k + 5, "image_id": 2, "category_id": k + 1, "segmentation": polygon, "iscrowd": 0}
        for k, polygon in enumerate(polygons)
    ]
    document = {
        "images": [{"id": 2, "file_name": "a.png", "width": 20, "height": 10}],
        "annotations": annotations,
        "categories": [{"id": 1, "name": "cell"}, {"id": 2, "name": "nucleus"}],
    }
    path.write_text(json.dumps(document))
    records, _ = convert(path)
    names = [(record["external_id"], record["label"]) for record in records]
    yield "coco: names and labels", names == [("5", "cell"), ("6", "nucleus"), ("6/2", "nucleus")], str(names)
    convert(path, "coco", None, out)
    again = json.loads(out.read_text())
    wrong = []
    for before, after in zip(annotations, again["annotations"]):
        rings = [shapely.geometry.Polygon(numpy.reshape(ring, (-1, 2))) for ring in after["segmentation"]]
        left, top, right, bottom = shapely.geometry.MultiPolygon(rings).bounds
        good = near(after["area"], sum(ring.area for ring in rings))
        good = good and after["bbox"] == [left, top, right - left, bottom - top]
        if not good or any(before[key] != after[key] for key in before):
            wrong.append(before["id"])
    ok = not wrong and again["images"] == document["images"] and again["categories"] == document["categories"]
    yield "coco: annotations come back with area and bounds", ok, f"wrong: {wrong}"


def ring_set(outlines):
    """Closed outlines as rounded points in a form that does not depend on their order or on a repeated end."""
    rings = []
    for outline in outlines:
        points = [tuple(round(float(x), 4) for x in point) for point in outline]
        while len(points) > 1 and points[0] == points[-1]:
            points.pop()
        rings.append(points)
    return sorted(rings)


def check_regions(convert, data, folder):
    """Real regions: the points of roifile and read-roi, and ours read by roifile."""
    import read_roi

    for path in sorted((data / "formats-imagej-roi").glob("*.roi")):
        region = roifile.ImagejRoi.fromfile(path)
        records, summary = convert(path, options=KEEP)
        if region.roitype == roifile.ROI_TYPE.OVAL:
            # roifile takes 32 points; the ellipse itself is known.
            expected = math.pi * (region.right - region.left) * (region.bottom - region.top) / 4
            found = area(records)
            ok = 0 < expected - found < 0.01 * math.pi * max(region.right - region.left, region.bottom - region.top)
            yield f"{path.name}: area of the ellipse", ok, f"{found} and {expected}"
            continue
        if region.roitype == roifile.ROI_TYPE.RECT and not region.composite:
            # roifile begins at another corner and goes the other way round.
            corners = {(x, y) for x in (region.left, region.right) for y in (region.top, region.bottom)}
            ok = {tuple(point) for point in records[0]["points"]} == corners
            yield (
                f"{path.name}: corners",
                ok and near(area(records), shapely.geometry.Polygon(region.coordinates()).area),
                "",
            )
            continue
        expected = region.coordinates(multi=True)
        expected = expected if isinstance(expected, list) else [expected]
        found, wanted = ring_set(record["points"] for record in records), ring_set(expected)
        yield f"{path.name}: points of roifile", found == wanted, f"{len(found)} rings, {summary['dropped']}"
        beside = path.with_suffix(".json")
        known = read_roi.read_roi_file(str(path))[path.stem] if beside.exists() else {}
        if "paths" in known:
            ok = found == ring_set(known["paths"])
            yield f"{path.name}: paths of read-roi", ok, f"{len(known['paths'])} paths"
        elif "x" in known:
            ok = found == ring_set([zip(known["x"], known["y"])])
            yield f"{path.name}: points of read-roi", ok, f"{len(known['x'])} points"
        out = folder / path.name
        convert(path, "imagej-roi", KEEP, out)
        again = roifile.ImagejRoi.fromfile(out)
        read = again.coordinates(multi=True)
        ok = ring_set(read if isinstance(read, list) else [read]) == wanted and again.name == region.name
        yield f"{path.name}: ours, read by roifile", ok, f"{again.roitype.name} '{again.name}'"


def check_made_regions(convert, folder):
    """Regions that roifile writes, and others from GeoJSON read by roifile."""
    points = numpy.array([[1.25, 7], [300.5, 2], [80, 700.75]], dtype=numpy.float32)
    for name, type_, array in [
        ("polygon", roifile.ROI_TYPE.POLYGON, points),
        ("freeline", roifile.ROI_TYPE.FREELINE, points),
        ("point", roifile.ROI_TYPE.POINT, points[:2]),
        ("whole", roifile.ROI_TYPE.TRACED, points.astype(numpy.int32)),
    ]:
        path = folder / f"made-{name}.roi"
        region = roifile.ImagejRoi.frompoints(array, name=f"über {name}", c=0, z=1, t=2)
        region.roitype = type_
        region.stroke_color = b"\xff\x10\x20\x30"
        region.tofile(path)
        (record,), _ = convert(path, options=KEEP)
        metadata = record["metadata"]
        ok = record["points"] == array.tolist() and record["external_id"] == f"über {name}"
        ok = ok and [metadata[key] for key in ("channel", "slice", "frame")] == [1, 2, 3]
        ok = ok and metadata["type"] == type_.name.lower() and metadata["stroke_color"] == "#ff102030"
        yield f"{path.name}: as roifile wrote it", ok, json.dumps(metadata)
        out = folder / f"made-{name}-out.roi"
        convert(path, "imagej-roi", KEEP, out)
        again = roifile.ImagejRoi.fromfile(out)
        same = numpy.array_equal(again.coordinates()[: len(array)], array) and again.name == region.name
        same = same and (again.c_position, again.z_position, again.t_position) == (1, 2, 3)
        yield f"{path.name}: ours, read by roifile", same and again.stroke_color == region.stroke_color, again.name
    geometry = shapes()["holes"]
    feature = {"type": "Feature", "properties": {"name": "h"}, "geometry": shapely.geometry.mapping(geometry)}
    path, out = folder / "holes.geojson", folder / "holes.roi"
    path.write_text(json.dumps(feature))
    convert(path, "imagej-roi", KEEP, out)
    rings = roifile.ImagejRoi.fromfile(out).coordinates(multi=True)
    expected = [geometry.exterior.coords, *(ring.coords for ring in geometry.interiors)]
    yield "holes as a composite, read by roifile", ring_set(rings) == ring_set(expected), f"{len(rings)} rings"
    records, _ = convert(out, options=KEEP)
    holes = [record["ring"]["hole"] for record in records]
    yield "holes of the composite, read by us", holes == [False, True, True], str(holes)


def check_set(convert, folder):
    """A zip of regions, read by roifile."""
    path, out = folder / "kinds.geojson", folder / "kinds.roi.zip"
    names = [name for name in shapes() if name not in ("space", "mixed")]
    features = [
        {"type": "Feature", "properties": {"name": name}, "geometry": shapely.geometry.mapping(shapes()[name])}
        for name in names
    ]
    path.write_text(json.dumps(features))
    convert(path, "imagej-roi-set", KEEP, out)
    regions = roifile.roiread(out)
    found = [region.name for region in regions]
    rings = [len(region.coordinates(multi=True)) for region in regions]
    yield "zip: names and rings, read by roifile", found == names and rings == [1, 3, 3, 1, 2, 1, 1], f"{found} {rings}"


def check(convert, data, folder):
    """All comparisons."""
    if data is not None:
        yield from check_qupath(convert, data, folder)
        yield from check_regions(convert, data, folder)
    yield from check_geojson(convert, folder)
    yield from check_wkt(convert, folder)
    yield from check_coco(convert, folder)
    yield from check_made_regions(convert, folder)
    yield from check_set(convert, folder)
