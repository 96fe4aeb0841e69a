"""NDJSON, the format of the service itself, against json of the standard library: numbers come back with all their
digits."""

import json
import random
import struct

PACKAGES = []


def check(convert, data, folder):
    generator = random.Random(7)

    def number():
        """Any finite double within the range of coordinates."""
        while True:
            value = struct.unpack("<d", generator.randbytes(8))[0]
            if abs(value) <= 1e100:
                return value

    lines = [
        {
            "points": [[number(), number()] for _ in range(40)],
            "closed": bool(k % 2),
            "external_id": f"s{k}",
            "label": 'ä"\n',
        }
        for k in range(50)
    ]
    path = folder / "lines.ndjson"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    records, summary = convert(path)
    same = [{name: record[name] for name in line} == line for record, line in zip(records, lines)]
    yield "numbers", all(same) and len(records) == len(lines), f"{sum(same)} of {len(lines)} lines are the same"
    yield "summary", summary["records"] == len(lines), f"{summary['records']} records"
    output = folder / "again.ndjson"
    written, _ = convert(path, output=output)
    again, _ = convert(output, output=folder / "third.ndjson")
    yield "round trip", written == again, f"{len(written)} and {len(again)} bytes"
