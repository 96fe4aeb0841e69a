"""Files that are not what they say, each made from a small valid one: `GROUPS` has a function for each kind of lie.

A function takes the valid files by their formats and the variables of the case, and yields `Lie`s. Python's library
only.
"""

import gzip
import io
import json
import struct
import zipfile
from dataclasses import dataclass, replace

from seeds import LABELS, SPACE, Dicom, File, archive, gifti, nifti, nrrd, png, structure_set, tiff, vtp

REFUSED = (400, 413, 422)
# What may turn out to be a valid file all the same.
EITHER = (200, 201, *REFUSED)


@dataclass(frozen=True)
class Lie:
    """A file, and what is right to answer."""

    what: str
    file: File
    expect: tuple = REFUSED
    # Part of the place that a refusal must name: `line`, `byte`, `tag`, `item`, `entry`; `any` of them; nothing where
    # there is none.
    place: str | None = "any"
    # Whether the fault may be met when the answer of a translation has begun, which then breaks off.
    breaks: bool = False


def lie(what, name, data, **settings):
    return Lie(what, File(name, data.encode() if isinstance(data, str) else data), **settings)


# Formats that may end at any element, or of which the last bytes say nothing.
ENDLESS = {"off", "rtstruct", "png", "geojson", "coco", "mrk", "vtk", "vtp", "gifti"}
# Formats of which a beginning is faulty as a whole: directories elsewhere, a mark at the end of a header, a header
# without points.
PLACELESS = {"tiff", "nifti", "vtk"}


def cut(seeds, offsets):
    """Every format, cut off at offsets spread over the file."""
    for kind, file in seeds.items():
        size = len(file.data)
        for at in sorted({k * size // (offsets + 1) for k in range(1, offsets + 1)} | {1, size - 1}):
            part = replace(file, data=file.data[:at])
            # Where a file ends at a line, or before bytes that only fill it up, nothing is missing: less text is
            # another file, of other shapes or of none. Too few bytes to tell the format by have no place.
            expect = EITHER if kind in ENDLESS or file.text else REFUSED
            is_placed = at > 1 and kind not in PLACELESS and not file.text
            yield Lie(f"{kind} of {at} of {size} bytes", part, expect, "any" if is_placed else None)


def changed(seeds, offsets):
    """Every binary format with numbers that are as large as they can be, or have another sign, at offsets spread over
    the file."""
    for kind, file in seeds.items():
        if file.text:
            continue
        size = len(file.data)
        for at in sorted({k * size // offsets for k in range(offsets)}):
            for word in (b"\xff\xff\xff\x7f", b"\x7f\xff\xff\xff", b"\xff\xff\xff\xff"):
                data = file.data[:at] + word[: size - at] + file.data[at + 4 :]
                yield Lie(f"{kind} with {word.hex()} at {at}", replace(file, data=data), EITHER, None)


def order(seeds):
    """Numbers in the other order of bytes than the file says: what can be seen is refused, the rest is other
    numbers."""
    swap = lambda kind, old, new, **settings: Lie(
        kind, replace(seeds[kind], data=seeds[kind].data.replace(old, new, 1)), **settings
    )
    # Doubles read backwards are other doubles: nearly zero, or too large.
    yield swap("ply", b"binary_little_endian", b"binary_big_endian")
    yield swap("npy", b"'<f8'", b"'>f8'", expect=EITHER)
    yield lie(
        "stl", "a.stl", bytes(80) + struct.pack(">I", 1) + struct.pack(">12f", *[0.0] * 3, *sum(SPACE, [])) + b"\0\0"
    )
    yield lie(
        "vtk",
        "a.vtk",
        b"# vtk DataFile Version 3.0\na\nBINARY\nDATASET POLYDATA\nPOINTS 3 double\n"
        + struct.pack("<9d", *sum(SPACE, []))
        + b"\nPOLYGONS 1 4\n"
        + struct.pack("<4i", 3, 0, 1, 2),
    )
    yield lie("vtp", "a.vtp", vtp(order="BigEndian"))
    yield lie("gifti", "a.gii", gifti(order="BigEndian"))
    yield lie("rtstruct", "a.dcm", structure_set(syntax="1.2.840.10008.1.2.2"))
    yield lie("rtstruct, swapped", "a.dcm", structure_set(order=">"))
    yield lie("tiff", "a.tif", tiff(5, 4, LABELS, "<", mark=b"MM"), place=None)
    backwards = bytearray(nifti((5, 4, 2), LABELS + bytes(20)))
    backwards[:4] = backwards[3::-1]
    yield lie("nifti", "a.nii", bytes(backwards), place=None)
    roi = seeds["imagej-roi"].data
    yield lie("imagej-roi", "a.roi", roi[:4] + b"".join(roi[k : k + 2][::-1] for k in range(4, len(roi), 2)))


def counts(seeds):
    """More than there is, and more than fits."""
    many = 4_000_000_000
    for number in (5, many):
        yield lie(f"obj face of vertex {number}", "a.obj", f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {number}\n", place="line")
        head = (
            f"ply\nformat ascii 1.0\nelement vertex {number}\nproperty double x\nproperty double y\nproperty "
            f"double z\nend_header\n0 0 0\n"
        )
        yield lie(f"ply of {number} vertices", "a.ply", head)
        yield lie(f"binary ply of {number} vertices", "a.ply", head.replace("ascii", "binary_little_endian"))
        yield lie(
            f"stl of {number} faces",
            "a.stl",
            seeds["stl"].data[:80] + struct.pack("<I", number) + seeds["stl"].data[84:],
        )
        yield lie(f"off of {number} vertices", "a.off", f"OFF\n{number} 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
        yield lie(f"off of {number} faces", "a.off", f"OFF\n3 {number} 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
        yield lie(
            f"vtk of {number} points",
            "a.vtk",
            f"# vtk DataFile Version 3.0\na\nASCII\nDATASET POLYDATA\nPOINTS {number} double\n0 0 0\n",
        )
        yield lie(f"vtp of {number} points", "a.vtp", vtp(number))
        yield lie(f"gifti of {number} rows", "a.gii", gifti(number))
        yield lie(f"tps of {number} landmarks", "a.tps", f"LM={number}\n1 2\n3 4\nID=a\n")
        yield lie(f"tps of {number} curves", "a.tps", f"LM=1\n1 2\nCURVES={number}\nPOINTS=1\n1 2\n")
        yield lie(f"nts of {number} rows", "a.nts", f"1 {number} 4 0 DIM=2\n1 2 3 4\n")
        yield lie(
            f"morphologika of {number} individuals",
            "a.morphologika",
            f"[individuals]\n{number}\n[landmarks]\n2\n[dimensions]\n2\n[rawpoints]\n1 2\n3 4\n",
        )
        yield lie(f"npy of {number} shapes", "a.npy", npy((number, 3, 2), bytes(48)))
        yield lie(f"rtstruct of {number} points", "a.dcm", structure_set(count=number), place="tag")
        yield lie(f"nrrd of {number} columns", "a.nrrd", nrrd(f"{number} 5", LABELS), place=None)
    yield lie("npy of negative shapes", "a.npy", npy((-3, 3, 2), bytes(48)))
    yield lie("npy of a product that overflows", "a.npy", npy((1 << 31, 1 << 31, 4), bytes(48)))
    yield lie("png of 2³¹ columns", "a.png", png((1 << 31) - 1, (1 << 31) - 1, LABELS), place=None)
    yield lie("tiff of 2³¹ columns", "a.tif", tiff((1 << 31) - 1, (1 << 31) - 1, LABELS), place=None)
    yield lie("nifti of 32767³ cells", "a.nii", nifti((32767, 32767, 32767), LABELS), place=None)
    contour = Dicom().element(0x30060050, "DS", "1\\2\\3", 0xFFF0)
    yield lie("rtstruct with a long element", "a.dcm", Dicom().file(contour))
    for tail in (12, 20):
        data = bytearray(seeds["zip"].data)
        data[-tail : -tail + 2] = b"\xff\xff"
        yield lie(f"zip with another directory ({tail})", "a.zip", bytes(data), place=None)
    roi = bytearray(seeds["imagej-roi"].data)
    roi[16:18] = b"\xff\xff"
    yield lie("imagej-roi of 65535 points", "a.roi", bytes(roi))


def npy(shape, data, kind="<f8"):
    """An array of NumPy; shapes as they are claimed."""
    head = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape!r}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode() + data


def cycles(seeds):
    """What refers to itself, or to what is elsewhere."""
    yield lie("tiff whose next page is its first one", "a.tif", tiff(5, 4, LABELS, next_at=8 + len(LABELS)), place=None)
    entities = '<!DOCTYPE a [<!ENTITY a "&b;&b;"><!ENTITY b "&a;&a;">]>'
    inside = '<DataArray type="Float32" NumberOfComponents="3" format="ascii">&a;</DataArray>'
    yield lie(
        "vtp with entities of each other",
        "a.vtp",
        vtp(data=inside).replace(b"<VTKFile", entities.encode() + b"<VTKFile"),
    )
    laughs = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12))
    yield lie(
        "gifti with entities of entities",
        "a.gii",
        gifti(further=f'<!DOCTYPE a [<!ENTITY a0 "1">{laughs}]>').replace(b"<Data>", b"<Data>&a11;"),
    )
    yield lie(
        "gifti with a file as entity",
        "a.gii",
        gifti(further='<!DOCTYPE a [<!ENTITY f SYSTEM "file:///etc/passwd">]>').replace(b"<Data>", b"<Data>&f;"),
    )
    yield lie("nrrd whose numbers are another file", "a.nhdr", nrrd("4 4", b"", "data file: /etc/passwd\n"), place=None)
    yield lie(
        "gifti whose numbers are another file",
        "a.gii",
        gifti().replace(b"Base64Binary", b'ExternalFileBinary" ExternalFileName="/etc/passwd'),
    )
    yield lie(
        "coco whose picture has itself as annotation",
        "a.coco.json",
        json.dumps(
            {
                "images": [{"id": 1}],
                "categories": [],
                "annotations": [
                    {"id": 1, "image_id": 1, "category_id": 1, "segmentation": {"counts": "self", "size": [4, 4]}}
                ],
            }
        ),
    )
    yield lie(
        "mrk whose points are those of another file",
        "a.mrk.json",
        json.dumps(
            {
                "@schema": "markups-schema-v1.0.3.json#",
                "markups": [
                    {"type": "ClosedCurve", "coordinateSystem": "LPS", "controlPoints": {"$ref": "#/markups/0"}}
                ],
            }
        ),
    )


def nests(seeds, depth):
    """Lists, objects and elements inside of each other."""
    ring = lambda text: '{"type":"Feature","properties":{},"geometry":' + text + "}"
    yield lie(
        "geojson coordinates", "a.geojson", ring('{"type":"Polygon","coordinates":' + "[" * depth + "]" * depth + "}")
    )
    inner = '{"type":"GeometryCollection","geometries":['
    yield lie("geojson collections", "a.geojson", ring(inner * depth + "]}" * depth))
    yield lie(
        "geojson properties",
        "a.geojson",
        '{"type":"Feature","geometry":null,"properties":{"a":' + "[" * depth + "]" * depth + "}}",
        expect=EITHER,
    )
    yield lie(
        "geojson before its features",
        "a.geojson",
        '{"a":' + "[" * depth + "]" * depth + ',"type":"FeatureCollection","features":[]}',
        expect=EITHER,
    )
    yield lie("coco", "a.coco.json", '{"images":[],"annotations":' + "[" * depth + "]" * depth + "}")
    yield lie(
        "mrk", "a.mrk.json", '{"@schema":"markups-schema-v1.0.3.json#","markups":' + "[" * depth + "]" * depth + "}"
    )
    yield lie("ndjson", "a.ndjson", '{"points":' + "[" * depth + "]" * depth + "}\n", place="line")
    yield lie("wkt", "a.wkt", "GEOMETRYCOLLECTION(" * depth + ")" * depth)
    yield lie("vtp", "a.vtp", b"<VTKFile>" + b"<PolyData>" * depth + b"</PolyData>" * depth + b"</VTKFile>")
    yield lie("gifti", "a.gii", b"<GIFTI>" + b"<MetaData>" * depth + b"</MetaData>" * depth + b"</GIFTI>")
    e, data = Dicom(), b""
    for _ in range(min(depth, 2000)):
        data = e.sequence(0x30060020, [data])
    yield lie("rtstruct", "a.dcm", e.file(e.element(0x00080016, "UI", "1.2.840.10008.5.1.4.1.1.481.3") + data))
    open_ended = struct.pack("<HH2sHI", 0x3006, 0x20, b"SQ", 0, 0xFFFFFFFF) + struct.pack(
        "<HHI", 0xFFFE, 0xE000, 0xFFFFFFFF
    )
    yield lie(
        "rtstruct without lengths",
        "a.dcm",
        e.file(e.element(0x00080016, "UI", "1.2.840.10008.5.1.4.1.1.481.3") + open_ended * depth),
    )


def encodings(seeds):
    """Bytes that are no UTF-8 where text should be."""
    for kind, file in seeds.items():
        if not file.text and kind not in ("geojson", "coco", "mrk", "vtp", "gifti", "off"):
            continue
        middle = len(file.data) // 2
        for name, bad in [
            ("a byte of Latin-1", b"\xe9"),
            ("half a character", b"\xe2\x82"),
            ("a long form of /", b"\xc0\xaf"),
            ("a surrogate", b"\xed\xa0\x80"),
        ]:
            data = file.data[:middle] + bad + file.data[middle:]
            yield Lie(f"{kind} with {name}", replace(file, data=data))
        yield Lie(f"{kind} as UTF-16", replace(file, data=file.data.decode().encode("utf-16")))
    yield lie(
        "rtstruct in a character set of its own",
        "a.dcm",
        structure_set().replace(b"Heart ", b"H\xff\xfe\xc0t "),
        expect=EITHER,
    )


def frames(seeds):
    """Structure sets whose coordinates are of nothing."""
    yield lie("without frame of reference", "a.dcm", structure_set(frame=None), place="tag")
    yield lie("with an empty one", "a.dcm", structure_set(frame=" "), place="tag")
    yield lie("with a type of contours that is none", "a.dcm", structure_set(kind="SPHERE"), place="tag")
    yield lie("of another class", "a.dcm", structure_set().replace(b"481.3", b"481.5"), place="tag")


def overflows(seeds):
    """Coordinates that no shape has."""
    for x in ("1e308", "-1e308", "1e400", "inf", "nan"):
        json_x = {"inf": "Infinity", "nan": "NaN"}.get(x, x)
        number = float(x)
        yield lie(f"ndjson {x}", "a.ndjson", f'{{"points":[[0,0],[1,{json_x}],[2,1]]}}\n', place="line")
        yield lie(
            f"geojson {x}",
            "a.geojson",
            f'{{"type":"Feature","properties":{{}},"geometry":{{"type":"Polygon","coordinates":[[[0,0],[1,{json_x}],[2,1],[0,0]]]}}}}',
        )
        yield lie(
            f"coco {x}",
            "a.coco.json",
            f'{{"images":[{{"id":1}}],"categories":[],"annotations":[{{"id":1,"image_id":1,"segmentation":[[0,0,1,{json_x},2,1]]}}]}}',
        )
        yield lie(f"mrk {x}", "a.mrk.json", seeds["mrk"].data.replace(b"0.75", json_x.encode()))
        yield lie(f"wkt {x}", "a.wkt", f"POLYGON((0 0, 1 {x}, 2 1, 0 0))")
        yield lie(f"obj {x}", "a.obj", f"v 0 0 0\nv 1 {x} 0\nv 0 1 0\nf 1 2 3\n")
        yield lie(
            f"ply {x}",
            "a.ply",
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\n"
            "end_header\n"
            f"0 {x} 0\n",
        )
        yield lie(
            f"binary ply {x}", "a.ply", seeds["ply"].data.replace(struct.pack("<d", 0.75), struct.pack("<d", number))
        )
        yield lie(f"off {x}", "a.off", f"OFF\n3 1 0\n0 {x} 0\n1 0 0\n0 1 0\n3 0 1 2\n")
        yield lie(
            f"vtk {x}",
            "a.vtk",
            f"# vtk DataFile Version 3.0\na\nASCII\nDATASET POLYDATA\nPOINTS 1 double\n0 {x} 0\nVERTICES 1 2\n1 0\n",
        )
        yield lie(
            f"vtp {x}",
            "a.vtp",
            vtp(
                data=f'<DataArray type="Float64" NumberOfComponents="3" format="ascii">0 0 0 1 {x} 0 0 1 0</DataArray>'
            ),
        )
        yield lie(f"tps {x}", "a.tps", f"LM=3\n0 0\n1 {x}\n2 1\nID=a\n", place="line")
        yield lie(f"nts {x}", "a.nts", f"1 1 6 0 DIM=2\n0 0 1 {x} 2 1\n")
        yield lie(f"csv {x}", "a.csv", f"id,x1,y1,x2,y2,x3,y3\na,0,0,1,{x},2,1\n")
        yield lie(f"particles {x}", "a.particles", f"0 0 0\n1 {x} 0\n2 1 0\n")
        yield lie(f"fcsv {x}", "a.fcsv", seeds["fcsv"].data.replace(b"0.75", x.encode()))
        yield lie(f"nef {x}", "a.nef", f"a\n1 {x} 1 1\n")
        yield lie(f"npy {x}", "a.npy", npy((1, 3, 2), struct.pack("<6d", 0, 0, 1, number, 2, 1)))
        yield lie(f"rtstruct {x}", "a.dcm", structure_set(points=[["0", x, "0"], [1, 0, 0], [0, 1, 0]]), place="tag")
        if abs(number) < 1e308:
            continue
        yield lie(f"gifti {x}", "a.gii", gifti(points=[[0.0, float("inf"), 0.0]] + SPACE[1:]))
        yield lie(
            f"stl {x}",
            "a.stl",
            bytes(80)
            + struct.pack("<I", 1)
            + struct.pack("<12f", 0, 0, 0, 0, float("inf"), 0, 1, 0, 0, 0, 1, 0)
            + b"\0\0",
        )


def bombs(seeds, size):
    """Little that becomes much."""
    spaces = lambda file: replace(file, name=file.name + ".gz", data=packed(b" ", size, file.data))
    for kind in ("ndjson", "geojson", "obj", "tps", "csv", "wkt", "coco", "gifti", "npy", "nrrd"):
        yield Lie(f"spaces before {kind} in gzip", spaces(seeds[kind]), EITHER, None)
    yield lie("zeros in gzip", "a.stl.gz", packed(b"\0", size), place=None)
    yield lie("gzip in gzip", "a.ndjson.gz", gzip.compress(packed(b"\0", size), mtime=0), place=None)
    yield lie("spaces in a zip", "a.zip", archive([("a.geojson", b" " * size)]), place="entry")
    yield lie(
        "zeros in an array",
        "a.npz",
        archive([("points.npy", npy((size // 48, 3, 2), bytes(size // 48 * 48)))]),
        expect=EITHER,
        place=None,
    )
    yield lie(
        "one array many times", "a.npz", archive([(f"a{k}.npy", npy((1000, 3, 2), bytes(48_000))) for k in range(2000)])
    )
    yield lie("two regions of one name", "a.roi.zip", twins("a.roi", seeds["imagej-roi"].data), place=None)
    yield lie("many empty files", "a.zip", archive([(f"{k}", b"") for k in range(60_000)]), place=None)
    yield lie(
        "many files of one place",
        "a.zip",
        overlapping(seeds["tps"].data + b"\n" * 60_000, 500),
        expect=EITHER,
        place=None,
    )
    yield lie("a picture of zeros", "a.png", png(30_000, 30_000, bytes(size // 4)[: 30_000 * 30]), place=None)
    yield lie("a wide picture of zeros", "a.png", png(1 << 20, 1 << 10, bytes(size)), place=None)
    yield lie(
        "a volume of zeros", "a.nii.gz", gzip.compress(nifti((2000, 2000, 2000), bytes(size)), mtime=0), place=None
    )


def masses(seeds, size):
    """Small parts that take far more memory than their bytes."""
    small = lambda part, end: part * (size // len(part)) + end
    objects = small('{"a":0},', "0")
    feature = lambda properties, geometry: f'{{"type":"Feature","properties":{properties},"geometry":{geometry}}}'
    point = '{"type":"Point","coordinates":[0,0]}'
    yield lie("a property of small objects", "a.geojson", feature(f'{{"a":[{objects}]}}', point))
    yield lie(
        "a collection of nothing",
        "a.geojson",
        feature("{}", f'{{"type":"GeometryCollection","geometries":[{small("{},", "{}")}]}}'),
    )
    rings = ",".join(["[[[0,0],[1,0],[1,1],[0,0]]]"] * 400)
    yield lie(
        "rings with long properties",
        "a.geojson",
        feature(json.dumps({"a": "x" * (size >> 5)}), f'{{"type":"MultiPolygon","coordinates":[{rings}]}}'),
        expect=EITHER,
        breaks=True,
    )
    yield lie("an image of small objects", "a.coco.json", f'{{"images":[{{"id":1,"a":[{objects}]}}],"annotations":[]}}')
    yield lie(
        "empty points",
        "a.mrk.json",
        f'{{"markups":[{{"type":"Curve","controlPoints":[{small("{},", "{}")}]}}]}}',
        place=None,
    )
    yield lie("subjects of one value", "a.swproj", f'{{"data":[{objects[:-1]}{{}}]}}', place=None)
    yield lie("rows of one cell", "a.xlsx", workbook(small("<row><c><v>1</v></c></row>", "")), place=None)
    yield lie(
        "shapes of two bytes",
        "a.npz",
        archive([("points.npy", npy((size // 2, 1, 2), bytes(size), "|u1"))]),
        expect=EITHER,
        place=None,
    )
    yield lie("empty items", "a.dcm", Dicom().file(Dicom().sequence(0x30060039, [b""] * (size // 8))), expect=EITHER)
    yield lie(
        "points of a collection",
        "a.wkt",
        f"GEOMETRYCOLLECTION({small('POINT(0 0),', 'POINT(0 0)')})",
        expect=EITHER,
        place=None,
    )


def workbook(rows):
    """A workbook whose first sheet has these rows."""
    schema = "http://schemas.openxmlformats.org"
    document = f"{schema}/officeDocument/2006/relationships"
    target = lambda kind, path: (
        f'<Relationships xmlns="{schema}/package/2006/relationships"><Relationship Id="r" '
        f'Type="{document}/{kind}" Target="{path}"/></Relationships>'
    )
    sheet = f"{schema}/spreadsheetml/2006/main"
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{schema}/package/2006/content-types"/>',
        "_rels/.rels": target("officeDocument", "xl/workbook.xml"),
        "xl/_rels/workbook.xml.rels": target("worksheet", "worksheets/sheet1.xml"),
        "xl/workbook.xml": f'<workbook xmlns="{sheet}" xmlns:r="{document}"><sheets><sheet name="data" '
        f'sheetId="1" r:id="r"/></sheets></workbook>',
        "xl/worksheets/sheet1.xml": f'<worksheet xmlns="{sheet}"><sheetData>{rows}</sheetData></worksheet>',
    }
    return archive([(name, content.encode()) for name, content in parts.items()])


def packed(byte, size, after=b""):
    """Many bytes, compressed."""
    out = io.BytesIO()
    with gzip.GzipFile(fileobj=out, mode="wb", mtime=0) as packer:
        for _ in range(size >> 20):
            packer.write(byte * (1 << 20))
        packer.write(after)
    return out.getvalue()


def overlapping(content, count):
    """An archive whose directory names one compressed file again and again."""
    one = archive([("0000.tps", content)])
    end = one.rindex(b"PK\x05\x06")
    begin = struct.unpack("<I", one[end + 16 : end + 20])[0]
    entry = one[begin:end]
    entries = b"".join(entry.replace(b"0000.tps", f"{k:04}.tps".encode()) for k in range(count))
    tail = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, count, count, len(entries), begin, 0)
    return one[:begin] + entries + tail


def twins(name, content):
    """An archive with two files of one name."""
    other = f"{name[:-1]}_"
    return archive([(name, content), (other, content)]).replace(other.encode(), name.encode())


def names(seeds):
    """Names that lead out of an archive, or that are those of others."""
    content = seeds["tps"].data
    for name in (
        "../a.tps",
        "/etc/a.tps",
        "a/../../b.tps",
        "C:\\a.tps",
        "a\\..\\..\\b.tps",
        "//host/a.tps",
        "\\\\host\\a.tps",
    ):
        yield lie(f"zip of {name}", "a.zip", archive([("fine.tps", content), (name, content)]), place="entry")
    # The library ends names at a zero: it is put in afterwards.
    yield lie(
        "zip of a name with a zero",
        "a.zip",
        archive([("aX.tps", content)]).replace(b"aX.tps", b"a\0.tps"),
        place="entry",
    )
    link = zipfile.ZipInfo("link.tps")
    link.external_attr = 0o120777 << 16
    yield lie("zip of a link", "a.zip", archive([(link, b"/etc/passwd")]))
    yield lie("zip of two files with one name", "a.zip", twins("a.tps", content), place=None)
    yield lie("npz of ../a.npy", "a.npz", archive([("../a.npy", seeds["npy"].data)]))
    yield lie("roi set of ../a.roi", "a.roi.zip", archive([("../a.roi", seeds["imagej-roi"].data)]))


def archives(seeds, depth):
    """Archives in archives."""
    inner = seeds["zip"].data
    yield lie("zip in zip", "a.zip", archive([("a.zip", inner)]), place="entry")
    yield lie("zip with another ending in zip", "a.zip", archive([("a.dat", inner)]), place="entry")
    yield lie("zip in gzip in zip", "a.zip", archive([("a.zip.gz", gzip.compress(inner, mtime=0))]), place="entry")
    deep = inner
    for k in range(depth):
        deep = archive([(f"{k}.zip", deep)])
    yield lie(f"{depth} zips in each other", "a.zip", deep, place="entry")
    for _ in range(depth):
        deep = gzip.compress(deep, mtime=0)
    yield lie(f"{depth} gzips around it", "a.zip.gz", deep, place=None)
    yield lie("a wrong sum in zip", "a.zip", wrong_sum(seeds), place="entry")


def wrong_sum(seeds):
    """An archive whose file is not that of its sum."""
    data = bytearray(archive([("one.tps", seeds["tps"].data)], zipfile.ZIP_STORED))
    at = data.index(b"4.5")
    data[at] = ord("7")
    return bytes(data)


GROUPS = {
    function.__name__: function
    for function in (
        cut,
        changed,
        order,
        counts,
        cycles,
        nests,
        encodings,
        frames,
        overflows,
        bombs,
        masses,
        names,
        archives,
    )
}
