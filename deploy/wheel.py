#!/usr/bin/env python3
"""Makes a wheel of a program that is built, so that `pip install` brings it: `shapelex-server`.

    deploy/wheel.py BINARY [--out target/packages] [--licences FILE] [--sbom FILE]

The tag of the platform is the oldest system that has what the program asks for: `manylinux_2_35_x86_64` where its
newest symbol of the C library is of version 2.35. Libraries beyond those that every such system has are refused. The
same inputs give the same bytes. Needs nothing beyond Python's library and readelf.
"""

import argparse
import base64
import hashlib
import re
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "deploy"))

import program  # noqa: E402

SOURCE = ROOT / "clients" / "python-server"
NAME, MODULE = "shapelex-server", "shapelex_server"
# What every system of a manylinux tag has (PEP 600, the list of auditwheel), as far as a program of Rust asks for it.
ALLOWED = re.compile(r"(libc|libm|libdl|librt|libpthread|libgcc_s|libutil|ld-linux-[\w-]+)\.so\.\d+")
# The oldest tag of this form.
OLDEST = (2, 17)
# Time of all files: the first that a zip can hold.
TIME = (1980, 1, 1, 0, 0, 0)
METADATA = """\
Metadata-Version: 2.4
Name: {name}
Version: {version}
Summary: The program of Shapelex, a service for statistics of shapes, for its Python client
License-Expression: Apache-2.0 OR MIT
License-File: LICENSE-APACHE
License-File: LICENSE-MIT
{further}Requires-Python: >=3.10
Description-Content-Type: text/markdown

{readme}"""


def tag(binary):
    """Tag of the platform; `Unfit` where there is none."""
    foreign = [name for name in program.libraries(binary) if not ALLOWED.fullmatch(name)]
    if foreign:
        raise program.Unfit(f"expected libraries that every system has, got {', '.join(foreign)}")
    major, minor = max(program.glibc(binary), OLDEST)
    return f"manylinux_{major}_{minor}_{program.machine(binary)}"


def files(binary, platform, licences, sbom):
    """Names, contents and rights of all files of the wheel but the record."""
    version = program.version()
    info = f"{MODULE}-{version}.dist-info"
    further = "License-File: THIRD-PARTY.txt\n" if licences else ""
    readme = (SOURCE / "README.md").read_text(encoding="utf-8")
    metadata = METADATA.format(name=NAME, version=version, further=further, readme=readme)
    wheel = f"Wheel-Version: 1.0\nGenerator: deploy/wheel.py\nRoot-Is-Purelib: false\nTag: py3-none-{platform}\n"
    yield f"{MODULE}/__init__.py", (SOURCE / "src" / MODULE / "__init__.py").read_bytes(), 0o644
    yield f"{MODULE}/py.typed", b"", 0o644
    yield f"{MODULE}-{version}.data/scripts/shapelex", binary.read_bytes(), 0o755
    for name in ("LICENSE-APACHE", "LICENSE-MIT"):
        yield f"{info}/licenses/{name}", (ROOT / name).read_bytes(), 0o644
    if licences:
        yield f"{info}/licenses/THIRD-PARTY.txt", licences.read_bytes(), 0o644
    if sbom:
        yield f"{info}/sboms/shapelex.cdx.json", sbom.read_bytes(), 0o644
    yield f"{info}/METADATA", metadata.encode(), 0o644
    yield f"{info}/WHEEL", wheel.encode(), 0o644


def digest(content):
    """A digest as records of wheels write it."""
    return base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()


def written(binary, out, licences, sbom):
    """Path of the wheel."""
    platform, version = tag(binary), program.version()
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{MODULE}-{version}-py3-none-{platform}.whl"
    record = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as wheel:
        for name, content, mode in files(binary, platform, licences, sbom):
            entry = zipfile.ZipInfo(name, TIME)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, (0o100000 | mode) << 16
            wheel.writestr(entry, content)
            record.append(f"{name},sha256={digest(content)},{len(content)}")
        name = f"{MODULE}-{version}.dist-info/RECORD"
        entry = zipfile.ZipInfo(name, TIME)
        entry.external_attr = 0o100644 << 16
        wheel.writestr(entry, "\n".join([*record, f"{name},,", ""]))
    return path


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("binary", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "target" / "packages")
    parser.add_argument("--licences", type=Path, help="texts of all components, of deploy/licences.py")
    parser.add_argument("--sbom", type=Path, help="list of all components, of deploy/sbom.py")
    arguments = parser.parse_args()
    try:
        path = written(arguments.binary, arguments.out, arguments.licences, arguments.sbom)
    except program.Unfit as reason:
        sys.exit(str(reason))
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
