"""DICOM structure sets, segmentations and NRRD against pydicom, shapely and pynrrd."""

import json
import pathlib
import shutil
import subprocess

import nrrd
import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    ExplicitVRBigEndian,
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
)
from shapely.geometry import Polygon

PACKAGES = ["pydicom==3.0.2", "shapely==2.2.0", "numpy==2.4.6", "pynrrd==1.1.3"]

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
STRUCTURE_SET = "1.2.840.10008.5.1.4.1.1.481.3"
FRAME = "1.2.826.0.1.3680043.8.498.1"
# A decimal string has 16 characters: a sign, a point and a zero leave 13 digits.
DECIMAL = 1e-13


def check(convert, data, folder):
    if data is not None:
        real = data / "formats-dicom-rtstruct"
        for path in sorted(real.glob("*.dcm")):
            yield from check_real(convert, path)
        yield from check_written(convert, real, folder)
    yield from check_encodings(convert, folder)
    yield from check_planes(convert, folder)
    yield from check_surfaces(convert, folder)
    yield from check_segmentations(folder)
    yield from check_nrrd(folder)


def regions(dataset):
    """Number, name, type, colour and contours (type and n × 3 points) of each region, by pydicom."""
    names = {roi.ROINumber: str(roi.ROIName) for roi in dataset.StructureSetROISequence}
    kinds = {
        o.ReferencedROINumber: o.get("RTROIInterpretedType") or None
        for o in dataset.get("RTROIObservationsSequence", [])
    }
    for roi in dataset.ROIContourSequence:
        number = roi.ReferencedROINumber
        contours = [
            (c.ContourGeometricType, numbers(c.ContourData).reshape(-1, 3)) for c in roi.get("ContourSequence", [])
        ]
        colour = roi.get("ROIDisplayColor")
        yield int(number), names[number], kinds.get(number), colour and [float(x) for x in colour], contours


def numbers(value):
    """Decimal strings; pydicom leaves those of the type UN as they are."""
    return np.array(value.decode().split("\\") if isinstance(value, bytes) else value, float)


def difference(records, dataset):
    """The first difference between records and what pydicom reads, or None."""
    wanted = {}
    for number, name, kind, colour, contours in regions(dataset):
        for k, (geometric, points) in enumerate(contours):
            # Closed contours do not repeat their first point.
            if geometric.startswith("CLOSED") and np.array_equal(points[0], points[-1]):
                points = points[:-1]
            wanted[number, k + 1] = name, kind, colour, geometric, points
    found = {(r["metadata"]["roi"]["number"], r["metadata"]["contour"]["number"]): r for r in records}
    if len(found) != len(records) or set(found) != set(wanted):
        return f"contours {sorted(found)} instead of {sorted(wanted)}"
    for key, (name, kind, colour, geometric, points) in wanted.items():
        record = found[key]
        roi = record["metadata"]["roi"]
        said = roi["name"], roi.get("type"), roi.get("colour"), record["metadata"]["contour"]["type"]
        if said != (name, kind, colour, geometric):
            return f"{said} instead of {(name, kind, colour, geometric)}"
        own = np.array(record["points"], float)
        if own.shape != points.shape or not np.array_equal(own, points):
            return f"other points of contour {key}"
    return None


def check_real(convert, path):
    dataset = pydicom.dcmread(path, force=True)
    if dataset.Modality != "RTSTRUCT":
        try:
            convert(path)
            yield path.name, False, "an image is read as a structure set"
        except Exception as refusal:
            yield path.name, dataset.Modality in str(refusal), f"refused: {refusal}"
        return
    records, summary = convert(path, options={"holes": "keep"})
    wrong = difference(records, dataset)
    yield path.name, wrong is None, wrong or f"{len(records)} contours as by pydicom"
    text = json.dumps([records, summary])
    # Regions may have the names of other things: values of persons and places only. Unique identifiers lead back to the
    # archive, and are attributes of the shapes.
    for name in ["PatientName", "PatientID", "InstitutionName", "OperatorsName"]:
        value = str(dataset.get(name, ""))
        yield f"{path.name} {name}", not value or f'"{value}"' not in text, "is not given on"
    plane, _ = convert(path, options={"contours": "plane", "holes": "keep"})
    worst = 0.0
    for record in plane:
        number, k = record["metadata"]["roi"]["number"], record["metadata"]["contour"]["number"]
        points = next(c for n, _, _, _, c in regions(dataset) if n == number)[k - 1][1]
        x, y = np.array(record["points"]).T
        area = abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
        reference = Polygon(points[:, :2]).area
        worst = max(worst, abs(area - reference) / reference)
    yield f"{path.name} areas", worst < 1e-9, f"of {len(plane)} plane curves, by shapely: {worst:.1e}"


def header(path):
    """What a structure set has to know of an image, by pydicom."""
    image = pydicom.dcmread(path, stop_before_pixels=True)
    text = lambda name: str(image.get(name) or "")
    return {
        "class": text("SOPClassUID"),
        "instance": text("SOPInstanceUID"),
        "series": text("SeriesInstanceUID"),
        "frame_of_reference": text("FrameOfReferenceUID"),
        "position": [float(x) for x in image.ImagePositionPatient],
        "orientation": [float(x) for x in image.ImageOrientationPatient],
        "study": {
            "instance": text("StudyInstanceUID"),
            "id": text("StudyID"),
            "date": text("StudyDate"),
            "time": text("StudyTime"),
            "accession_number": text("AccessionNumber"),
            "referring_physician": text("ReferringPhysicianName"),
        },
        "patient": {
            "name": text("PatientName"),
            "id": text("PatientID"),
            "birth_date": text("PatientBirthDate"),
            "sex": text("PatientSex"),
        },
    }


def check_written(convert, real, folder):
    images_of_series = [real / f"phantom_ct_{k}.dcm" for k in (1, 2)]
    series = [header(path) for path in images_of_series]
    writing = {"series": images_of_series, "created": "2026-11-26T03:00:00"}
    source = real / "mim_phantom_rtstruct.dcm"
    output = folder / "written.dcm"
    content, _ = convert(source, "rtstruct", {"holes": "keep"}, output, writing=writing)
    again, _ = convert(source, "rtstruct", {"holes": "keep"}, folder / "again.dcm", writing=writing)
    yield "written twice", content == again, f"{len(content)} bytes, the same"
    dataset = pydicom.dcmread(output)
    original = pydicom.dcmread(source)
    images = {image["instance"] for image in series}
    referred = [c for roi in dataset.ROIContourSequence for c in roi.ContourSequence if "ContourImageSequence" in c]
    right = (
        dataset.StudyInstanceUID == series[0]["study"]["instance"]
        and dataset.FrameOfReferenceUID == series[0]["frame_of_reference"]
        and all(c.ContourImageSequence[0].ReferencedSOPInstanceUID in images for c in referred)
        and len(referred) == 8
    )
    yield "references of what is written", right, f"{len(referred)} contours refer to images of the series"
    wanted, found = list(regions(original)), list(regions(dataset))
    right = [r[:4] for r in wanted] == [r[:4] for r in found]
    worst = max(np.abs(a[1] - b[1]).max() for r, s in zip(wanted, found) for a, b in zip(r[4], s[4]))
    yield "round trip", right and worst == 0, f"largest difference {worst}"
    uneven = folder / "uneven.ndjson"
    points = np.random.default_rng(1).normal(scale=100, size=(50, 2)).tolist()
    record = {"points": [[x, y, 60.0] for x, y in points], "closed": True, "label": "Größe"}
    uneven.write_text(json.dumps(record) + "\n")
    convert(uneven, "rtstruct", None, folder / "uneven.dcm", writing=writing)
    dataset = pydicom.dcmread(folder / "uneven.dcm")
    own = np.array(dataset.ROIContourSequence[0].ContourSequence[0].ContourData, float).reshape(-1, 3)
    worst = np.abs(own[:, :2] - points).max() / 100
    yield "numbers of 16 characters", worst < DECIMAL, f"largest relative difference {worst:.1e}"
    yield "names", dataset.StructureSetROISequence[0].ROIName == "Größe", "with umlauts"
    for name in ["written.dcm", "uneven.dcm"]:
        if shutil.which("dciodvfy") is None:
            yield f"dciodvfy {name}", True, "SKIPPED: dciodvfy is not installed"
            continue
        done = subprocess.run(["dciodvfy", folder / name], capture_output=True, text=True)
        errors = [line for line in (done.stdout + done.stderr).splitlines() if line.startswith("Error")]
        yield f"dciodvfy {name}", not errors, "; ".join(errors[:3]) or "no errors"


def structure_set(path, rois, syntax=ExplicitVRLittleEndian, charset="ISO_IR 192"):
    """A structure set by pydicom. `rois`: name and contours (type and points)."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = STRUCTURE_SET
    meta.MediaStorageSOPInstanceUID = "1.2.3"
    meta.TransferSyntaxUID = syntax
    dataset = FileDataset(str(path), {}, b"\0" * 128, meta, syntax.is_implicit_VR, syntax.is_little_endian)
    dataset.SpecificCharacterSet = charset
    dataset.SOPClassUID, dataset.SOPInstanceUID, dataset.Modality = STRUCTURE_SET, "1.2.3", "RTSTRUCT"
    dataset.StructureSetROISequence, dataset.ROIContourSequence = Sequence(), Sequence()
    for number, (name, contours) in enumerate(rois, 1):
        roi = Dataset()
        roi.ROINumber, roi.ROIName, roi.ReferencedFrameOfReferenceUID = number, name, FRAME
        dataset.StructureSetROISequence.append(roi)
        lines = Dataset()
        lines.ReferencedROINumber, lines.ContourSequence = number, Sequence()
        for kind, points in contours:
            contour = Dataset()
            contour.ContourGeometricType, contour.NumberOfContourPoints = kind, len(points)
            contour.ContourData = [f"{x:.10g}" for x in np.ravel(points)]
            lines.ContourSequence.append(contour)
        dataset.ROIContourSequence.append(lines)
    dataset.save_as(path, enforce_file_format=True)
    return pydicom.dcmread(path)


def circle(radius, centre, z, count):
    angle = np.arange(count) / count * 2 * np.pi
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    return np.stack([x, y, np.full(count, z)], axis=1)


def check_encodings(convert, folder):
    rois = [
        ("Größe", [("CLOSED_PLANAR", circle(30, (5, 7), 2.5, 100)), ("CLOSED_PLANAR", circle(5, (5, 7), 2.5, 40))]),
        ("path", [("OPEN_NONPLANAR", circle(3, (0, 0), 1, 9) * [1, 1, 0] + [[0, 0, k] for k in range(9)])]),
        ("point", [("POINT", [[1.5, -2, 3]])]),
        # More than 64 kB, which explicit types have no length for: pydicom writes the type UN.
        ("long", [("CLOSED_PLANAR", circle(123.456, (0, 0), 9, 3000))]),
    ]
    for syntax in [ImplicitVRLittleEndian, ExplicitVRLittleEndian, ExplicitVRBigEndian, DeflatedExplicitVRLittleEndian]:
        path = folder / f"{syntax.keyword}.dcm"
        dataset = structure_set(path, rois, syntax)
        records, _ = convert(path, options={"holes": "keep"})
        wrong = difference(records, dataset)
        hole = [r["external_id"] for r in records if r.get("ring", {}).get("hole")]
        yield syntax.name, wrong is None and hole == ["Größe 2"], wrong or "as by pydicom"


def check_planes(convert, folder):
    turn, _ = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))
    flat = circle(20, (3, 4), 0, 60) * [1, 0.5, 1]
    contours = [("CLOSED_PLANAR", (flat + [0, 0, 2.0 * k]) @ turn.T) for k in range(4)]
    structure_set(folder / "oblique.dcm", [("a", contours)])
    records, _ = convert(folder / "oblique.dcm", options={"contours": "plane"})
    area = Polygon(flat[:, :2]).area
    areas = [Polygon(record["points"]).area for record in records]
    worst = max(abs(a / area - 1) for a in areas)
    yield "oblique planes", len(records) == 4 and worst < 1e-8, f"areas by shapely: {worst:.1e}"
    worst = 0.0
    for record, (_, points) in zip(records, contours):
        plane = record["metadata"]["plane"]
        u, v, normal = (np.array(plane[name]) for name in ("u", "v", "normal"))
        back = np.array(record["points"]) @ np.stack([u, v]) + plane["offset"] * normal
        worst = max(worst, np.abs(back - points).max())
    yield "positions of oblique planes", worst < 1e-7, f"largest difference {worst:.1e} mm"


def volume(record):
    """Volume by the divergence theorem, and whether each edge has its opposite."""
    vertices, faces = np.array(record["vertices"]), np.array(record["faces"])
    edges = {(int(f[k]), int(f[(k + 1) % 3])) for f in faces for k in range(3)}
    closed = len(edges) == 3 * len(faces) and all((b, a) in edges for a, b in edges)
    return np.linalg.det(vertices[faces]).sum() / 6, closed


def check_surfaces(convert, folder):
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    contours = [("CLOSED_PLANAR", square * s + [10, 20, z]) for s, z in [(4, 0), (4, 3), (2, 6), (3, 6.5)]]
    structure_set(folder / "stack.dcm", [("a", contours)])
    [record], _ = convert(folder / "stack.dcm", options={"contours": "stack"})
    found, closed = volume(record)
    frustum = lambda a, b, h: h * (4 * a * a + 4 * a * b + 4 * b * b) / 3
    wanted = 64 * 3 + frustum(4, 2, 3) + frustum(2, 3, 0.5)
    yield "a stack of squares", closed and abs(found / wanted - 1) < 1e-9, f"volume {found} for {wanted}"
    contours = [("CLOSED_PLANAR", circle(np.sqrt(100 - z * z), (z, 0), z, 50 + int(z * 7) % 90)) for z in range(-9, 10)]
    structure_set(folder / "ball.dcm", [("a", contours)])
    [record], _ = convert(folder / "ball.dcm", options={"contours": "stack"})
    found, closed = volume(record)
    radii = [np.sqrt(100 - z * z) for z in range(-9, 10)]
    wanted = sum(np.pi * (a * a + a * b + b * b) / 3 for a, b in zip(radii, radii[1:]))
    yield "a sheared ball", closed and abs(found / wanted - 1) < 5e-3, f"volume {found:.1f}, by frustums {wanted:.1f}"


def labels(path):
    command = ["cargo", "run", "--quiet", "--package", "shapelex-formats", "--example", "labels", "--", str(path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    return json.loads(done.stdout) if done.returncode == 0 else done.stderr.strip()


def same(found, values, affine):
    """`values`: an array indexed by x, y, z."""
    if isinstance(found, str):
        return False, found
    own = np.array(found["values"]).reshape(found["size"], order="F")
    right = own.shape == values.shape and np.array_equal(own, values)
    worst = np.abs(np.array(found["affine"]) - affine).max()
    return bool(right and worst < 1e-9), f"{own.size} cells, positions differ by {worst:.1e} mm"


def check_segmentations(folder):
    random = np.random.default_rng(3)
    for syntax in [ImplicitVRLittleEndian, ExplicitVRLittleEndian]:
        for kind in ["BINARY", "LABELMAP"]:
            volume = random.integers(0, 3, size=(4, 5, 7))
            path = folder / f"{kind}.dcm"
            segmentation(path, kind, volume, syntax)
            affine = [[0, 0.5, 0, 10], [0.25, 0, 0, 20], [0, 0, -2, 30]]
            found = labels(path)
            ok, detail = same(found, volume.transpose(2, 1, 0), affine)
            named = isinstance(found, dict) and found["names"] == {"1": "Liver", "2": "Milz ö"}
            yield f"{kind} {syntax.name}", ok and named, detail


def segmentation(path, kind, volume, syntax):
    """A segmentation of slices, rows and columns by pydicom. Rows run along y, columns along x."""
    meta = FileMetaDataset()
    meta.TransferSyntaxUID = syntax
    meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.66." + ("4" if kind == "BINARY" else "7")
    meta.MediaStorageSOPInstanceUID = "1.2.3"
    dataset = FileDataset(str(path), {}, b"\0" * 128, meta, syntax.is_implicit_VR, syntax.is_little_endian)
    dataset.SOPClassUID, dataset.SOPInstanceUID, dataset.Modality = meta.MediaStorageSOPClassUID, "1.2.3", "SEG"
    dataset.SpecificCharacterSet = "ISO_IR 192"
    dataset.SegmentationType = kind
    dataset.Rows, dataset.Columns = volume.shape[1:]
    dataset.BitsAllocated = 1 if kind == "BINARY" else 8
    dataset.SegmentSequence = Sequence()
    for number, name in [(1, "Liver"), (2, "Milz ö")]:
        segment = Dataset()
        segment.SegmentNumber, segment.SegmentLabel = number, name
        dataset.SegmentSequence.append(segment)
    shared, orientation, measures = Dataset(), Dataset(), Dataset()
    orientation.ImageOrientationPatient = [0, 1, 0, 1, 0, 0]
    measures.PixelSpacing, measures.SpacingBetweenSlices = [0.5, 0.25], 2
    shared.PlaneOrientationSequence, shared.PixelMeasuresSequence = Sequence([orientation]), Sequence([measures])
    dataset.SharedFunctionalGroupsSequence = Sequence([shared])
    dataset.PerFrameFunctionalGroupsSequence, frames = Sequence(), []
    for segment in [1, 2] if kind == "BINARY" else [0]:
        for k, slice in enumerate(volume):
            frame, position, identification = Dataset(), Dataset(), Dataset()
            position.ImagePositionPatient = [10, 20, 30 - 2 * k]
            identification.ReferencedSegmentNumber = segment
            frame.PlanePositionSequence = Sequence([position])
            frame.SegmentIdentificationSequence = Sequence([identification])
            dataset.PerFrameFunctionalGroupsSequence.append(frame)
            frames.append(slice == segment if kind == "BINARY" else slice)
    dataset.NumberOfFrames = len(frames)
    flat = np.concatenate([frame.ravel() for frame in frames]).astype(np.uint8)
    content = np.packbits(flat, bitorder="little").tobytes() if kind == "BINARY" else flat.tobytes()
    dataset.PixelData = content + b"\0" * (len(content) % 2)
    dataset["PixelData"].VR = "OB"
    dataset.save_as(path, enforce_file_format=True)


def check_nrrd(folder):
    random = np.random.default_rng(5)
    for encoding in ["raw", "gzip", "ascii"]:
        for kind in [np.uint8, np.int16, np.uint32, np.float32]:
            volume = random.integers(0, 120, size=(4, 3, 5)).astype(kind)
            directions = random.normal(size=(3, 3))
            head = {
                "encoding": encoding,
                "space": "left-posterior-superior",
                "space directions": directions,
                "space origin": [1.5, -2, 3],
                "kinds": ["domain"] * 3,
            }
            path = folder / f"{encoding}-{volume.dtype}.nrrd"
            nrrd.write(str(path), volume, head)
            affine = np.column_stack([directions.T, [1.5, -2, 3]])
            ok, detail = same(labels(path), volume, affine)
            yield path.name, ok, detail
