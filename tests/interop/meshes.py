"""Meshes: read and written, compared with trimesh, meshio, VTK and nibabel.

Areas, volumes and numbers of faces agree to 1e-6, coordinates and triangles exactly where both hold them in the same
precision.
"""

import itertools
import pathlib
import zipfile

import meshio
import nibabel
import numpy
import openpyxl
import trimesh
import vtk
from vtk.util.numpy_support import vtk_to_numpy

PACKAGES = ["trimesh==5.2.0", "meshio==5.3.5", "nibabel==5.4.2", "numpy==2.4.6", "vtk==9.7.2", "openpyxl==3.1.5"]
# Both sides sum areas and volumes in another order.
TOLERANCE = 1e-6
# Coordinates that went through single precision, 24 bits.
SINGLE = 2.0**-24
# Digits after the point that text of VTK XML (meshio) and of GIfTI (nibabel) has.
DIGITS = 1e-6


def fan(faces):
    """Triangles of polygons."""
    return [(face[0], face[k], face[k + 1]) for face in faces for k in range(1, len(face) - 1)]


def of(records):
    """All meshes of a file as one: vertices and triangles."""
    points, triangles, before = [], [], 0
    for record in records:
        points += record.get("vertices") or record["points"]
        triangles += [tuple(before + k for k in face) for face in fan(record.get("faces", []))]
        before = len(points)
    return numpy.array(points, float).reshape(-1, 3), numpy.array(triangles, int).reshape(-1, 3)


def figures(points, triangles):
    """Area and volume."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = numpy.linalg.norm(numpy.cross(b - a, c - a), axis=1).sum() / 2
    return area, (a * numpy.cross(b, c)).sum() / 6


def close(a, b):
    return abs(a - b) <= TOLERANCE * max(abs(a), abs(b), 1e-12)


def compare_figures(name, records, points, triangles):
    """Our records with triangles of another reader, whose vertices may be split or merged."""
    ours = of(records)
    (area, volume), (area_there, volume_there) = figures(*ours), figures(points, triangles)
    scale = numpy.abs(points).max() ** 3 if len(points) else 0
    ok = len(ours[1]) == len(triangles) and close(area, area_there)
    # A volume may be near 0: relative to the box.
    ok = ok and (close(volume, volume_there) or abs(volume - volume_there) <= TOLERANCE * scale)
    return (
        name,
        bool(ok),
        f"{len(triangles)} triangles, area {area:.9g} and {area_there:.9g}, volume {volume:.9g} and {volume_there:.9g}",
    )


def compare_exactly(name, records, points, triangles, tolerance=0.0):
    """Vertices and triangles in their order."""
    ours = of(records)
    same = ours[0].shape == points.shape and ours[1].shape == triangles.shape
    error = numpy.abs(ours[0] - points).max() if same and len(points) else 0.0
    limit = tolerance * max(numpy.abs(points).max(), 1) if len(points) else 0
    ok = same and error <= limit and bool((ours[1] == triangles).all())
    return name, bool(ok), f"{len(points)} vertices, {len(triangles)} triangles, largest difference {error:.1g}"


def by_trimesh(path):
    found = trimesh.load(str(path), process=False, **({"skip_materials": True} if path.suffix == ".obj" else {}))
    meshes = list(found.geometry.values()) if isinstance(found, trimesh.Scene) else [found]
    before = numpy.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    points = numpy.concatenate([numpy.array(mesh.vertices) for mesh in meshes])
    return points, numpy.concatenate([numpy.array(mesh.faces) + k for mesh, k in zip(meshes, before)])


def by_meshio(path):
    mesh = meshio.read(path)
    triangles = [fan(block.data.tolist()) for block in mesh.cells if block.type in ("triangle", "quad", "polygon")]
    return numpy.array(mesh.points, float), numpy.array(list(itertools.chain(*triangles)), int).reshape(-1, 3)


def by_vtk(path):
    reader = vtk.vtkXMLPolyDataReader() if path.suffix == ".vtp" else vtk.vtkPolyDataReader()
    reader.SetFileName(str(path))
    # Strips as triangles, as we give them on.
    filter = vtk.vtkTriangleFilter()
    filter.SetInputConnection(reader.GetOutputPort())
    filter.PassVertsOff()
    filter.PassLinesOff()
    filter.Update()
    result = filter.GetOutput()
    points = vtk_to_numpy(result.GetPoints().GetData()).astype(float)
    return points, vtk_to_numpy(result.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(int)


def by_nibabel(path):
    image = nibabel.load(path)
    points, triangles = (
        image.get_arrays_from_intent(f"NIFTI_INTENT_{name}")[0].data for name in ("POINTSET", "TRIANGLE")
    )
    return points.astype(float), triangles.astype(int)


def real_files(convert, data):
    folder = data / "formats-meshes"
    for path in sorted(folder.iterdir()):
        suffix = path.suffix.lower()
        # Without faces.
        if suffix not in (".stl", ".ply", ".off", ".obj") or path.name == "points_ascii_with_lists.ply":
            continue
        records, _ = convert(path)
        yield compare_figures(path.name, records, *by_trimesh(path))
    for name in ("lapy_cubeTria.vtk", "scalismo_unit-sphere.vtk"):
        yield compare_exactly(name, convert(folder / name)[0], *by_vtk(folder / name), SINGLE)
    path = folder / "fsaverage5_white_left.gii.gz"
    yield compare_exactly(path.name, convert(path)[0], *by_nibabel(path))
    records, summary = convert(folder / "ascii.stl.zip")
    with zipfile.ZipFile(folder / "ascii.stl.zip") as archive, archive.open("fuji_obj.stl") as file:
        mesh = trimesh.load(file, file_type="stl", process=False)
    name, ok, detail = compare_figures("ascii.stl.zip", records, numpy.array(mesh.vertices), numpy.array(mesh.faces))
    yield name, ok and summary["dropped"][0]["names"] == ["__MACOSX/._fuji_obj.stl"], detail
    for path in sorted(data.glob("surfaces-*/**/*.ply")):
        yield compare_exactly(path.name, convert(path)[0], *by_trimesh(path))
    for path in sorted(data.glob("surfaces-spot/*.obj")):
        yield compare_figures(path.name, convert(path)[0], *by_trimesh(path))


def made_files(convert, folder):
    """Files of other programs, written on the spot."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=3.7)
    mesh.vertices += [0.1, -20.3, 1e-3]
    points, triangles = numpy.array(mesh.vertices), numpy.array(mesh.faces)
    for name, arguments in [
        ("a.ply", {}),
        ("text.ply", {"encoding": "ascii"}),
        ("a.off", {"digits": 17}),
        ("a.obj", {"digits": 17}),
        ("a.stl", {}),
        ("text.stl", {"file_type": "stl_ascii"}),
    ]:
        path = folder / f"trimesh-{name}"
        mesh.export(str(path), **arguments)
        yield compare_figures(path.name, convert(path)[0], points, triangles)
    values = numpy.linspace(0, 1, len(points))
    shape = meshio.Mesh(
        points,
        [("triangle", triangles)],
        point_data={"thickness": values},
        cell_data={"part": [numpy.arange(len(triangles))]},
    )
    for name, arguments in [
        ("text.vtk", {"file_format": "vtk", "binary": False}),
        ("binary.vtk", {"file_format": "vtk", "binary": True}),
        ("version4.vtk", {"file_format": "vtk42", "binary": True}),
        ("text.vtu", {"file_format": "vtu", "binary": False}),
        ("binary.vtu", {"file_format": "vtu", "binary": True, "compression": None}),
        ("zlib.vtu", {"file_format": "vtu", "binary": True, "compression": "zlib"}),
        ("binary.ply", {"file_format": "ply", "binary": True}),
        ("text.ply", {"file_format": "ply", "binary": False}),
    ]:
        path = folder / f"meshio-{name}"
        meshio.write(path, shape, **arguments)
        records, _ = convert(path)
        label, ok, detail = compare_exactly(
            path.name, records, points, triangles, DIGITS if name == "text.vtu" else 0.0
        )
        fields = records[0]["fields"]
        ok = ok and numpy.abs(numpy.array(fields["thickness"]["values"]) - values).max() <= (
            DIGITS if name == "text.vtu" else 0.0
        )
        if not name.endswith(".ply"):
            ok = ok and fields["part"]["values"] == list(range(len(triangles)))
        yield label, bool(ok), f"{detail}, fields {', '.join(sorted(fields))}"
    for encoding in ("GIFTI_ENCODING_ASCII", "GIFTI_ENCODING_B64BIN", "GIFTI_ENCODING_B64GZ"):
        arrays = [
            nibabel.gifti.GiftiDataArray(points.astype("f4"), intent="NIFTI_INTENT_POINTSET", encoding=encoding),
            nibabel.gifti.GiftiDataArray(triangles.astype("i4"), intent="NIFTI_INTENT_TRIANGLE", encoding=encoding),
            nibabel.gifti.GiftiDataArray(values.astype("f4"), intent="NIFTI_INTENT_SHAPE", encoding=encoding),
        ]
        for suffix in (".gii", ".gii.gz"):
            path = folder / f"nibabel-{encoding.lower()}{suffix}"
            nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), path)
            yield compare_exactly(
                path.name, convert(path)[0], *by_nibabel(path), SINGLE if encoding.endswith("ASCII") else 0.0
            )


def vtk_files(convert, folder):
    """Files of VTK in all its encodings, polygons and strips."""
    source = vtk.vtkSphereSource()
    source.SetThetaResolution(20)
    source.SetPhiResolution(11)
    source.SetCenter(1, 2, 3)
    source.Update()
    stripper = vtk.vtkStripper()
    stripper.SetInputConnection(source.GetOutputPort())
    stripper.Update()
    for kind, data in (("polygons", source.GetOutput()), ("strips", stripper.GetOutput())):
        for mode, zlib, wide, big in itertools.product(("ascii", "binary", "raw", "base64"), (0, 1), (0, 1), (0, 1)):
            writer = vtk.vtkXMLPolyDataWriter()
            getattr(
                writer,
                {"ascii": "SetDataModeToAscii", "binary": "SetDataModeToBinary"}.get(mode, "SetDataModeToAppended"),
            )()
            writer.SetEncodeAppendedData(mode == "base64")
            writer.SetCompressorTypeToZLib() if zlib else writer.SetCompressorTypeToNone()
            # Several blocks an array.
            writer.SetBlockSize(1024)
            writer.SetHeaderTypeToUInt64() if wide else writer.SetHeaderTypeToUInt32()
            writer.SetByteOrderToBigEndian() if big else writer.SetByteOrderToLittleEndian()
            yield compare_written(convert, writer, data, folder / f"vtk-{kind}-{mode}-{zlib}{wide}{big}.vtp")
        for version, binary in itertools.product((42, 51), (0, 1)):
            writer = vtk.vtkPolyDataWriter()
            writer.SetFileVersion(version)
            writer.SetFileTypeToBinary() if binary else writer.SetFileTypeToASCII()
            yield compare_written(convert, writer, data, folder / f"vtk-{kind}-{version}-{binary}.vtk")


def compare_written(convert, writer, data, path):
    writer.SetInputData(data)
    writer.SetFileName(str(path))
    writer.Write()
    records, _ = convert(path)
    # Text is read in single precision there.
    name, ok, detail = compare_exactly(path.name, records, *by_vtk(path), SINGLE)
    return name, ok and "normals" in records[0]["fields"], detail


def own_files(convert, folder):
    """Files that we write, read by other programs and by us."""
    source = folder / "trimesh-a.ply"
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=3.7)
    mesh.export(str(source))
    before, _ = convert(source)
    points, triangles = of(before)
    readers = {
        "obj": [by_trimesh],
        "ply": [by_trimesh, by_meshio],
        "stl": [by_trimesh],
        "vtk": [by_vtk],
        "gltf": [by_trimesh],
    }
    for format, encoding in [
        ("obj", None),
        ("ply", "binary"),
        ("ply", "text"),
        ("stl", "binary"),
        ("stl", "text"),
        ("vtk", "binary"),
        ("vtk", "text"),
        ("gltf", None),
    ]:
        path = folder / f"own-{encoding}.{'glb' if format == 'gltf' else format}"
        convert(source, format, output=path, writing={"encoding": encoding} if encoding else None)
        for reader in readers[format]:
            there = reader(path)
            label = f"written {path.name} by {reader.__name__[3:]}"
            if format == "stl":
                # One vertex a corner there.
                yield compare_figures(label, before, *there)
            else:
                yield compare_exactly(
                    label,
                    [{"vertices": there[0].tolist(), "faces": there[1].tolist()}],
                    points,
                    triangles,
                    SINGLE if format == "gltf" else 0.0,
                )
        if format in ("obj", "ply", "vtk"):
            again, _ = convert(path)
            same = all(again[0][key] == before[0][key] for key in ("vertices", "faces"))
            yield f"{path.name} comes back", same, f"{len(points)} vertices"


def archives(convert, folder):
    path = folder / "files.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("trimesh-text.stl", "trimesh-a.ply", "trimesh-a.off"):
            archive.write(folder / name, f"b/{name}")
    records, summary = convert(path)
    names = [record["external_id"] for record in records]
    ok = names == ["trimesh-text", "trimesh-a", "trimesh-a~2"] and summary["properties"]["files"] == 3
    yield "an archive", ok, ", ".join(names)
    points = numpy.random.default_rng(3).normal(size=(40, 3))
    path = folder / "a.particles"
    numpy.savetxt(path, points, fmt="%.17g")
    records, _ = convert(path)
    yield "particles", records[0]["points"] == points.tolist(), "40 points"
    again, _ = convert(path, "particles", output=pathlib.Path(folder / "b.particles"))
    yield "particles come back", (numpy.loadtxt(folder / "b.particles") == points).all().item(), f"{len(again)} bytes"


def projects(convert, folder):
    """A study of ShapeWorks, whose table openpyxl writes."""
    study = folder / "study"
    (study / "particles").mkdir(parents=True)
    points = numpy.random.default_rng(5).normal(size=(5, 20, 3))
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.title = "optimize"
    sheet.append(["key", "value"])
    sheet = book.create_sheet("data")
    sheet.append(["name", "local_particles_1", "group_sex", "age", "fixed"])
    order = [3, 0, 4, 1, 2]
    for k in order:
        name = f"particles/s{k}_local.particles"
        numpy.savetxt(study / name, points[k], fmt="%.17g")
        sheet.append([f"s{k}", "./" + name, "fm"[k % 2], 50 + k / 4, k == 4])
    book.save(study / "study.xlsx")
    records, summary = convert(study / "study.xlsx")
    said = [(r["external_id"], r["label"], r["labels"]["age"], r["labels"]["fixed"]) for r in records]
    right = said == [(f"s{k}", "fm"[k % 2], 50 + k / 4, k == 4) for k in order]
    right = right and all(r["points"] == points[k].tolist() for r, k in zip(records, order))
    yield "a workbook of openpyxl names its files", right, f"{summary['properties']['files']} files"


def check(convert, data, folder):
    if data is not None:
        yield from real_files(convert, data)
    yield from made_files(convert, folder)
    yield from vtk_files(convert, folder)
    yield from own_files(convert, folder)
    yield from archives(convert, folder)
    yield from projects(convert, folder)
