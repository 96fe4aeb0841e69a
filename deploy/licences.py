#!/usr/bin/env python3
"""Collects the licence texts of what the program is made of, from the sources of the crates in the registry of cargo.

    cargo metadata --locked --format-version 1 > metadata.json
    deploy/licences.py metadata.json --page dashboard/dist/assets/licences.txt --out licences.txt

A crate is listed with its licence and the texts that its package holds; equal texts stand once. Where a package holds
none, that is said, and the standard texts of this project stand for it. `--page` has those of the packages in the page.
It ends with 1 when a crate without a text has a licence whose text is not here. Needs Python 3.11 and nothing beyond
its library.
"""

import argparse
import json
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "deploy"))

import sbom  # noqa: E402

# Files of a package that hold licences and notices, also of sources in C within it; code may have such names.
NAMES = re.compile(r"(licen[cs]e|copying|notice|unlicense|copyright)([-._].*)?$", re.IGNORECASE)
CODE = {".rs", ".py", ".c", ".h", ".json", ".toml", ".html", ".yml", ".sh"}
# Texts that stand for packages which hold none.
STANDARD = {"Apache-2.0": ROOT / "LICENSE-APACHE", "MIT": ROOT / "LICENSE-MIT"}
# Licences that ask for no text beside the program.
FREE = ("CC0-1.0", "0BSD", "Unlicense")
RULE = "=" * 78


def texts(package):
    """Licence files of a package: names and texts."""
    folder = Path(package["manifest_path"]).parent
    found = {path for path in folder.rglob("*") if NAMES.match(path.name) and path.suffix not in CODE}
    found |= {folder / package["license_file"]} if package.get("license_file") else set()
    found |= {path for path in folder.rglob("*") if path.parent.name.lower() in ("license", "licenses")}
    found = {path for path in found if path.is_file() and path.suffix not in CODE}
    return [(path.name, path.read_text(encoding="utf-8", errors="replace").strip()) for path in sorted(found)]


def collected(metadata):
    """Texts with the crates that have them, crates without any, and what is wrong."""
    packages = {package["id"]: package for package in metadata["packages"]}
    scopes, _ = sbom.reached(metadata)
    shared, bare, wrong = {}, [], []
    for crate in sorted(scopes, key=lambda crate: sbom.purl(packages[crate])):
        package = packages[crate]
        # Crates of the workspace have no source; what only builds others is no part of the program.
        if not package["source"] or scopes[crate] != "required":
            continue
        name = f"{package['name']} {package['version']} ({package['license']})"
        found = texts(package)
        for file, text in found:
            shared.setdefault((file, text), []).append(name)
        if not found:
            bare.append(f"{name}, by {', '.join(package['authors']) or package.get('repository') or 'its authors'}")
            if not any(licence in package["license"] for licence in (*STANDARD, *FREE)):
                wrong.append(f"{name}: its package holds no licence, and there is no text of it here")
    return shared, bare, wrong


def document(shared, bare, page):
    """All texts as one."""
    parts = ["Licences of the components of Shapelex, which itself is licensed under Apache-2.0 or MIT.", ""]
    if bare:
        parts += ["Packages that hold no text of their licence; the texts at the end stand for them:", ""]
        parts += [f"  {line}" for line in bare] + [""]
    for (file, text), names in sorted(shared.items(), key=lambda one: (one[1], one[0])):
        parts += [RULE, f"{file} of", *(f"  {name}" for name in names), RULE, "", text, ""]
    if page:
        parts += [RULE, "Packages of the page", RULE, "", page.strip(), ""]
    for licence, path in STANDARD.items():
        parts += [RULE, f"{licence}, the text of this project", RULE, "", path.read_text(encoding="utf-8").strip(), ""]
    return "\n".join(parts)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("metadata", type=Path)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    shared, bare, wrong = collected(json.loads(arguments.metadata.read_text(encoding="utf-8")))
    if wrong or not shared:
        sys.exit("\n".join(wrong or ["expected crates, got none"]))
    page = arguments.page.read_text(encoding="utf-8") if arguments.page else ""
    arguments.out.write_text(document(shared, bare, page), encoding="utf-8")
    crates = {name for names in shared.values() for name in names}
    print(f"{arguments.out}: {len(shared)} texts of {len(crates)} crates, {len(bare)} crates without one")


if __name__ == "__main__":
    main()
