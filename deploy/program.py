#!/usr/bin/env python3
"""What a program asks of the system that runs it: architecture, libraries, newest symbols of the C library.

    deploy/program.py BINARY        prints them, a line each: `machine x86_64`, `glibc 2.35`, `libraries libc.so.6 …`

Read from the file by readelf (Debian: binutils); the program is not run.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Names of machines by their number in the header of ELF files.
MACHINES = {62: "x86_64", 183: "aarch64"}


class Unfit(Exception):
    """Why a file cannot be packaged."""


def machine(binary):
    """Name of the machine."""
    head = binary.read_bytes()[:20] if binary.is_file() else b""
    if head[:4] != b"\x7fELF":
        raise Unfit(f"expected a program of Linux at {binary}, got {'another file' if head else 'none'}")
    number = int.from_bytes(head[18:20], "little")
    if number not in MACHINES:
        raise Unfit(f"expected a program for {' or '.join(MACHINES.values())}, got machine {number}")
    return MACHINES[number]


def said(*options):
    """Output of readelf."""
    try:
        return subprocess.run(["readelf", "--wide", *options], check=True, capture_output=True, text=True).stdout
    except FileNotFoundError:
        raise Unfit("expected readelf (Debian: binutils), got none") from None


def glibc(binary):
    """Newest version of the C library whose symbols the program uses, as two numbers."""
    found = re.findall(r"\bGLIBC_(\d+)\.(\d+)", said("--version-info", binary))
    if not found:
        raise Unfit(f"expected a program that is linked with the C library of GNU, got another one: {binary}")
    return max((int(major), int(minor)) for major, minor in found)


def libraries(binary):
    """Names of the shared libraries that the program names."""
    return re.findall(r"\(NEEDED\).*\[(.+?)\]", said("--dynamic", binary))


def version():
    """Version of the workspace."""
    text = (ROOT / "Cargo.toml").read_text(encoding="utf-8")
    return re.search(r'(?m)^\[workspace\.package\][^\[]*?^version = "([^"]+)"', text).group(1)


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    binary = Path(sys.argv[1])
    try:
        print("machine", machine(binary))
        print("glibc", ".".join(map(str, glibc(binary))))
        print("libraries", *libraries(binary))
        print("version", version())
    except Unfit as reason:
        sys.exit(str(reason))


if __name__ == "__main__":
    main()
