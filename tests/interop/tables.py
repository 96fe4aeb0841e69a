"""Tables and arrays: read and written, compared with pyarrow, pandas, Polars, DuckDB and NumPy.

Doubles go through none of these formats changed: all comparisons are exact.
"""

import json

import duckdb
import numpy
import pandas
import polars
import pyarrow
import pyarrow.feather
import pyarrow.parquet

PACKAGES = ["pyarrow==26.0.1", "pandas==3.1.1", "polars==2.1.0", "duckdb==2.0.1", "numpy==2.4.6"]


def shapes():
    """Records of all kinds, as lines."""
    random = numpy.random.default_rng(7)
    records = []
    for k in range(40):
        points = random.standard_normal((20 + k % 3, 2)).tolist()
        record = {
            "points": points,
            "closed": k % 4 != 0,
            "external_id": f"Größe {k}",
            "label": "ab"[k % 2],
            "weight": 0.5 + k,
        }
        record["labels"] = {"age": k / 3, "left": k % 2 == 0, "site": "zrh"}
        records.append(record)
    records.append({"points": [[1e-300, 0.1, 2.0], None, [3.0, 4.0, 1e99]], "external_id": "missing"})
    vertices, faces = random.standard_normal((5, 3)).tolist(), [[0, 1, 2], [0, 2, 3, 4]]
    field = {"on": "vertices", "width": 1, "values": random.standard_normal(5).tolist()}
    records.append({"vertices": vertices, "faces": faces, "fields": {"depth": field}, "external_id": "mesh"})
    return records


def flat(record):
    rows = record.get("points") or record["vertices"]
    width = next(len(row) for row in rows if row is not None)
    return [x for row in rows for x in (row or [None] * width)]


def same_list(ours, theirs):
    """Equal lists, None and NaN alike."""
    ours = numpy.array([numpy.nan if x is None else x for x in ours], float)
    theirs = numpy.array([numpy.nan if x is None else x for x in theirs], float)
    return bool(numpy.array_equal(ours, theirs, equal_nan=True))


def row_is(record, row):
    column = "points" if "points" in record else "vertices"
    return (
        row["external_id"] == record["external_id"]
        and same_list(flat(record), row[column])
        and (row.get("label") or None) == record.get("label")
        and (row.get("labels.age") is None) == ("labels" not in record)
    )


def compare_rows(name, records, rows):
    wrong = [k for k, (record, row) in enumerate(zip(records, rows)) if not row_is(record, row)]
    return name, len(rows) == len(records) and not wrong, f"{len(rows)} rows, wrong {wrong[:3]}"


def compare_records(name, expected, found):
    keys = ["points", "closed", "vertices", "faces", "external_id", "label", "weight", "labels"]
    wrong = [k for k, (a, b) in enumerate(zip(expected, found)) if any(a.get(key) != b.get(key) for key in keys)]
    return name, len(found) == len(expected) and not wrong, f"{len(found)} records, wrong {wrong[:3]}"


def written(convert, folder):
    """Our files, read by others, and by us."""
    records = shapes()
    source = folder / "shapes.ndjson"
    source.write_text("".join(json.dumps(record) + "\n" for record in records))
    parquet, stream = folder / "ours.parquet", folder / "ours.arrows"
    convert(source, "parquet", output=parquet)
    convert(source, "arrow", output=stream)
    table = pyarrow.parquet.read_table(parquet)
    yield compare_rows("Parquet, read by pyarrow", records, table.to_pylist())
    yield (
        "metadata of Parquet",
        table.schema.metadata.get(b"shapelex.schema") == b"shapes/1",
        str(table.schema.metadata),
    )
    frame = pandas.read_parquet(parquet)
    first = numpy.reshape(frame.points[0], (-1, frame.dimension[0]))
    yield "Parquet, read by pandas", first.tolist() == records[0]["points"], f"{frame.shape}"
    rows = polars.read_parquet(parquet).to_dicts()
    yield compare_rows("Parquet, read by Polars", records, rows)
    count = duckdb.sql(f"SELECT count(*), sum(len(points)) FROM '{parquet}'").fetchall()[0]
    expected = (len(records), sum(len(flat(record)) for record in records if "points" in record))
    yield "Parquet, read by DuckDB", tuple(map(int, count)) == expected, f"{count}"
    rows = pyarrow.ipc.open_stream(stream.read_bytes()).read_all().to_pylist()
    yield compare_rows("Arrow stream, read by pyarrow", records, rows)
    for path in [parquet, stream]:
        yield compare_records(f"{path.name} comes back", records, convert(path)[0])


def arrays(convert, folder):
    """Arrays of NumPy, both ways."""
    random = numpy.random.default_rng(3)
    points = random.standard_normal((6, 10, 3))
    for name, array in [
        ("float64", points),
        ("big endian", points.astype(">f8")),
        ("float32", points.astype("f4")),
        ("Fortran order", numpy.asfortranarray(points)),
        ("integers", (1000 * points).astype("i4")),
    ]:
        path = folder / f"{name}.npy"
        numpy.save(path, array)
        found = [record["points"] for record in convert(path)[0]]
        yield (
            f"NPY of NumPy, {name}",
            numpy.array_equal(numpy.array(found), array.astype(float)),
            f"{array.dtype} {array.shape}",
        )
    path = folder / "theirs.npz"
    numpy.savez_compressed(path, points=points, ids=numpy.array(list("abcdéf")), labels=numpy.array([1, 1, 1, 2, 2, 2]))
    found = convert(path)[0]
    ok = (
        numpy.array_equal([record["points"] for record in found], points)
        and found[4]["external_id"] == "é"
        and found[5]["label"] == "2"
    )
    yield "NPZ of NumPy", bool(ok), f"{len(found)} records"
    numpy.save(folder / "objects.npy", numpy.array([[{}]], dtype=object), allow_pickle=True)
    try:
        convert(folder / "objects.npy")
        yield "an array of objects is refused", False, "it was read"
    except Exception as refused:
        yield "an array of objects is refused", "Python objects" in str(refused), str(refused).strip()

    records = [record for record in shapes() if len(record.get("points", [[]])[0]) == 2]
    source = folder / "curves.ndjson"
    source.write_text("".join(json.dumps(record) + "\n" for record in records))
    convert(source, "npz", output=folder / "ours.npz")
    ours = numpy.load(folder / "ours.npz")
    split = numpy.split(ours["points"], ours["offsets"][1:-1])
    ok = all(numpy.array_equal(a, record["points"]) for a, record in zip(split, records)) and len(split) == len(records)
    yield (
        "our NPZ, read by NumPy",
        ok and ours["ids"].tolist() == [record["external_id"] for record in records],
        f"{ours.files}",
    )
    yield compare_records("our NPZ comes back", records, convert(folder / "ours.npz")[0])
    equal = records[0:40:3]
    source.write_text("".join(json.dumps(record) + "\n" for record in equal))
    convert(source, "npy", output=folder / "ours.npy")
    found = numpy.load(folder / "ours.npy")
    yield "our NPY, read by NumPy", numpy.array_equal(found, [record["points"] for record in equal]), f"{found.shape}"


def foreign(convert, folder):
    """Tables that others write."""
    random = numpy.random.default_rng(11)
    rows = [random.standard_normal(2 * (5 + k % 2)) for k in range(9)]
    frame = pandas.DataFrame(
        {
            "contour": rows,
            "external_id": [f"s{k}" for k in range(9)],
            "label": pandas.Categorical(list("xyzxyzxyz")),
            "area": range(9),
        }
    )
    table = pyarrow.Table.from_pandas(frame)
    options = {"columns": {"coordinates": ["contour"]}, "dimension": 2, "closed": True}
    nested = table.set_column(0, "contour", pyarrow.array([row.reshape(-1, 2).tolist() for row in rows]))
    files = {}
    for codec in ["none", "snappy", "gzip", "lz4"]:
        files[f"Parquet of pyarrow, {codec}"] = folder / f"{codec}.parquet"
        pyarrow.parquet.write_table(table, files[f"Parquet of pyarrow, {codec}"], compression=codec)
    files["Parquet of pyarrow, version 2"] = folder / "v2.parquet"
    pyarrow.parquet.write_table(nested, files["Parquet of pyarrow, version 2"], data_page_version="2.0")
    files["Parquet of Polars"] = folder / "polars.parquet"
    polars.from_arrow(table).write_parquet(files["Parquet of Polars"], compression="snappy")
    files["Parquet of DuckDB"] = folder / "duckdb.parquet"
    duckdb.execute(
        f"COPY (SELECT contour, external_id, label::VARCHAR AS label, area FROM frame) TO "
        f"'{folder / 'duckdb.parquet'}' (FORMAT parquet)"
    )
    for codec in ["uncompressed", "lz4"]:
        files[f"Feather, {codec}"] = folder / f"{codec}.feather"
        pyarrow.feather.write_feather(nested, files[f"Feather, {codec}"], compression=codec)
    for name, path in files.items():
        found, _ = convert(path, options=options)
        ok = len(found) == 9 and all(
            numpy.array_equal(record["points"], row.reshape(-1, 2))
            and record["label"] == "xyz"[k % 3]
            and record["external_id"] == f"s{k}"
            and record["labels"] == {"area": k}
            and record["closed"]
            for k, (record, row) in enumerate(zip(found, rows))
        )
        yield name, ok, f"{len(found)} records"
    path = folder / "zstd.parquet"
    pyarrow.parquet.write_table(table, path, compression="zstd")
    try:
        convert(path, options=options)
        yield "Zstandard is refused by name", False, "it was read"
    except Exception as refused:
        yield (
            "Zstandard is refused by name",
            "write the file with compression='snappy'" in str(refused),
            str(refused).strip(),
        )


def check(convert, data, folder):
    yield from written(convert, folder)
    yield from arrays(convert, folder)
    yield from foreign(convert, folder)
