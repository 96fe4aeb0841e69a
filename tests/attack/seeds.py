"""Small valid files of every format that the service reads: three points or a triangle each, so that a cohort of three
landmarks takes them.

Formats that the service writes are written by itself (`POST /v1/convert`), the others here. Python's library only.
"""

import base64
import gzip
import io
import json
import struct
import zipfile
import zlib
from dataclasses import dataclass

TRIANGLE = [[0.25, 0.5], [4.0, 0.75], [4.5, 1.125]]
SPACE = [[x, y, 2.0] for x, y in TRIANGLE]
LINES = {
    "plane": {"external_id": "one", "points": TRIANGLE},
    "space": {"external_id": "one", "points": SPACE},
    "curve": {"external_id": "one", "label": "a", "points": TRIANGLE, "closed": True},
    "chain": {"external_id": "one", "points": [[0, 0], [1, 0], [1, 1], [0, 1]], "closed": True},
    "mesh": {"external_id": "one", "vertices": SPACE, "faces": [[0, 1, 2]]},
    "fourier": {"external_id": "one", "fourier": {"constant": [1, 2], "cosine": [[1, 0.5]], "sine": [[0.25, 2]]}},
}
# What of them is written in each format.
WRITTEN = {
    **dict.fromkeys(["ndjson", "tps", "nts", "morphologika", "csv", "npy", "npz", "parquet", "arrow"], "plane"),
    **dict.fromkeys(["geojson", "imagej-roi", "imagej-roi-set", "wkt", "coco"], "curve"),
    **dict.fromkeys(["fcsv", "mrk", "particles"], "space"),
    **dict.fromkeys(["obj", "ply", "stl", "vtk"], "mesh"),
    "chc": "chain",
    "nef": "fourier",
}
ENDINGS = {"imagej-roi": "roi", "imagej-roi-set": "roi.zip", "mrk": "mrk.json", "coco": "coco.json", "arrow": "arrows"}
# What of them a cohort of three landmarks does not take: other numbers of points, coefficients.
OTHER = ("chc", "nef")
# Formats in which a part of a file may be a whole one: lines, and words that may be shorter.
TEXT = {"ndjson", "tps", "nts", "morphologika", "csv", "wkt", "fcsv", "particles", "obj", "chc", "nef"}


@dataclass(frozen=True)
class File:
    """Bytes with a name, by which their format is known."""

    name: str
    data: bytes
    # Whether a cohort of three landmarks in the plane takes its shapes.
    fits: bool = True
    # Text in which every line may be the last one, or whose words may be shorter: a part of it may be a whole file too.
    text: bool = False


def written(service):
    """Files that the service writes, by the ids of their formats."""
    for to, kind in WRITTEN.items():
        line = json.dumps(LINES[kind]).encode() + b"\n"
        answer = service.send(
            "POST", f"/v1/convert?name=a.ndjson&to={to}", line, {"content-type": "application/octet-stream"}
        )
        if answer.status != 200:
            raise RuntimeError(f"no seed of {to}: {answer.status} {answer.body[:300]}")
        yield to, File(f"a.{ENDINGS.get(to, to)}", answer.body, to not in OTHER, to in TEXT)


def all_seeds(service):
    """Files of all formats by their ids."""
    found = dict(written(service))
    vertices = b"\n".join(b" ".join(str(x).encode() for x in row) for row in SPACE)
    found["off"] = File("a.off", b"OFF\n3 1 0\n" + vertices + b"\n3 0 1 2\n", text=True)
    found["vtp"] = File("a.vtp", vtp())
    found["gifti"] = File("a.gii", gifti())
    found["rtstruct"] = File("a.dcm", structure_set())
    found["zip"] = File("a.zip", archive([("one.tps", found["tps"].data)]))
    found["gzip"] = File("a.geojson.gz", gzip.compress(found["geojson"].data, mtime=0))
    found["png"] = File("a.png", png(5, 4, LABELS), False)
    found["tiff"] = File("a.tif", tiff(5, 4, LABELS), False)
    found["nifti"] = File("a.nii", nifti((5, 4, 2), LABELS + bytes(20)), False)
    found["nrrd"] = File("a.nrrd", nrrd("5 4", LABELS), False)
    return found


# Rows of five cells: one label of six, as smaller ones are left out by default.
LABELS = bytes([0, 0, 0, 0, 0, 0, 1, 1, 1, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 0])


def archive(entries, method=zipfile.ZIP_DEFLATED):
    """A zip archive; entries are names, or `ZipInfo`s, with contents."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as packed:
        for name, content in entries:
            packed.writestr(name, content)
    return out.getvalue()


def png(width, height, pixels, bits=8):
    """A grey picture; its pixels are compressed as they are given, with a filter byte a row."""
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = b"".join(b"\0" + pixels[k : k + width] for k in range(0, len(pixels), width)) if width < 1 << 16 else pixels
    head = struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def tiff(width, height, pixels, order="<", next_at=0, mark=None):
    """A grey picture of one page, behind which the next one is said to be at `next_at`."""
    entries = [
        (256, width),
        (257, height),
        (258, 8),
        (259, 1),
        (262, 1),
        (273, 8),
        (277, 1),
        (278, height),
        (279, len(pixels)),
    ]
    head = (mark or {"<": b"II", ">": b"MM"}[order]) + struct.pack(order + "HI", 42, 8 + len(pixels))
    table = b"".join(struct.pack(order + "HHII", tag, 4, 1, value) for tag, value in entries)
    return head + pixels + struct.pack(order + "H", len(entries)) + table + struct.pack(order + "I", next_at)


def nifti(size, values, order="<"):
    """A volume of bytes with an orientation."""
    head = bytearray(348)
    struct.pack_into(order + "i", head, 0, 348)
    struct.pack_into(order + "8h", head, 40, 3, *size, 1, 1, 1, 1)
    struct.pack_into(order + "2h", head, 70, 2, 8)
    struct.pack_into(order + "8f", head, 76, 1, 1, 1, 1, 0, 0, 0, 0)
    struct.pack_into(order + "3f", head, 108, 352, 1, 0)
    struct.pack_into(order + "2h", head, 252, 0, 1)
    head[123] = 2
    for k in range(3):
        struct.pack_into(order + "f", head, 280 + 20 * k, 1)
    head[344:348] = b"n+1\0"
    return bytes(head) + bytes(4) + values


def nrrd(sizes, values, further=""):
    """A header of text, and numbers."""
    return (
        f"NRRD0004\ntype: uchar\ndimension: {len(sizes.split())}\nsizes: {sizes}\nencoding: raw\n{further}\n".encode()
        + values
    )


def numbers(values, kind="f"):
    """Little-endian numbers."""
    return struct.pack(f"<{len(values)}{kind}", *values)


def vtp(points=3, order="LittleEndian", data=None):
    """A triangle in XML of VTK."""

    def array(values, kind, word, name):
        raw = numbers(values, kind)
        text = base64.b64encode(struct.pack("<I", len(raw)) + raw).decode()
        return (
            f'<DataArray type="{word}" Name="{name}" NumberOfComponents="{3 if name == "p" else 1}" '
            f'format="binary">{text}</DataArray>'
        )

    cells = array([0, 1, 2], "q", "Int64", "connectivity") + array([3], "q", "Int64", "offsets")
    return (
        f'<VTKFile type="PolyData" version="1.0" byte_order="{order}" header_type="UInt32"><PolyData>'
        f'<Piece NumberOfPoints="{points}" '
        f'NumberOfPolys="1"><Points>{data or array(sum(SPACE, []), "f", "Float32", "p")}</Points>'
        f"<Polys>{cells}</Polys></Piece></PolyData></VTKFile>"
    ).encode()


def gifti(rows=3, order="LittleEndian", further="", points=SPACE):
    """A triangle in GIfTI."""

    def array(intent, kind, count, raw):
        return (
            f'<DataArray Intent="NIFTI_INTENT_{intent}" DataType="NIFTI_TYPE_{kind}" '
            f'ArrayIndexingOrder="RowMajorOrder" Dimensionality="2" '
            f'Dim0="{count}" Dim1="3" Encoding="Base64Binary" '
            f'Endian="{order}"><Data>{base64.b64encode(raw).decode()}</Data></DataArray>'
        )

    return (
        f'<?xml version="1.0"?>{further}<GIFTI Version="1.0" NumberOfDataArrays="2">'
        + array("POINTSET", "FLOAT32", rows, numbers(sum(points, [])))
        + array("TRIANGLE", "INT32", 1, numbers([0, 1, 2], "i"))
        + "</GIFTI>"
    ).encode()


class Dicom:
    """Elements of DICOM with explicit types, of one byte order."""

    LONG = {"OB", "OW", "SQ", "UN", "UT"}

    def __init__(self, order="<"):
        self.order = order

    def element(self, tag, kind, value, length=None):
        """An element; `length` is what it claims."""
        raw = value if isinstance(value, bytes) else value.encode()
        raw += (b"\0" if kind in ("UI", "OB") else b" ") * (len(raw) % 2)
        head = struct.pack(self.order + "HH", tag >> 16, tag & 0xFFFF) + kind.encode()
        length = len(raw) if length is None else length
        return (
            head
            + struct.pack(
                self.order + ("HI" if kind in self.LONG else "H"), *([0, length] if kind in self.LONG else [length])
            )
            + raw
        )

    def sequence(self, tag, items):
        """A sequence of data sets."""
        item = lambda data: struct.pack(self.order + "HHI", 0xFFFE, 0xE000, len(data)) + data
        return self.element(tag, "SQ", b"".join(map(item, items)))

    def file(self, data, syntax="1.2.840.10008.1.2.1"):
        """A file with a preamble."""
        plain = Dicom()
        meta = (
            plain.element(0x00020002, "UI", STRUCTURES)
            + plain.element(0x00020003, "UI", "1.2.3")
            + plain.element(0x00020010, "UI", syntax)
        )
        return bytes(128) + b"DICM" + plain.element(0x00020000, "UL", struct.pack("<I", len(meta))) + meta + data


STRUCTURES = "1.2.840.10008.5.1.4.1.1.481.3"


def structure_set(
    frame="1.2.3.4", points=SPACE, count=None, order="<", syntax="1.2.840.10008.1.2.1", kind="CLOSED_PLANAR"
):
    """A region with one contour; `count` is the number of points that it claims."""
    e = Dicom(order)
    text = "\\".join(x if isinstance(x, str) else f"{x:g}" for row in points for x in row)
    contour = (
        e.element(0x30060042, "CS", kind)
        + e.element(0x30060046, "IS", str(len(points) if count is None else count))
        + e.element(0x30060050, "DS", text)
    )
    region = (
        e.element(0x30060022, "IS", "1")
        + (e.element(0x30060024, "UI", frame) if frame else b"")
        + e.element(0x30060026, "LO", "Heart")
    )
    data = (
        e.element(0x00080016, "UI", STRUCTURES)
        + e.element(0x00080018, "UI", "1.2.3")
        + e.sequence(0x30060020, [region])
    )
    data += e.sequence(0x30060039, [e.sequence(0x30060040, [contour]) + e.element(0x30060084, "IS", "1")])
    return e.file(data, syntax)
