"""Lists what the program is made of: an SBOM in CycloneDX 1.6 (JSON), from the metadata of cargo and the lock file of
the page.

    cargo metadata --locked --format-version 1 > metadata.json
    python3 deploy/sbom.py metadata.json --lock Cargo.lock --page-lock dashboard/package-lock.json --out sbom.cdx.json

The crates that the program is linked with or built by, for the features that are on by default, and the npm packages
that are in the page; those of tests, benchmarks and the build of the page are left out. The same inputs give the same
bytes: there is no time and no random number in it. It ends with 1 when a crate or package has no checksum, no licence,
or is missing in the lock file. Needs Python 3.11 and nothing beyond its library.
"""

import argparse
import base64
import json
import sys
import tomllib
import uuid
from pathlib import Path

# What a crate that is only needed to build another one is called, and what one that is in the program.
SCOPES = {"build": "excluded", None: "required"}
# Makes the serial number a function of the content.
NAMESPACE = uuid.UUID("5e9c2c7e-2a43-5d0b-9f27-6b1c1e0f8a11")


def reached(metadata):
    """Ids of the crates that the program needs, with their scope, and what each depends on."""
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    root, scopes, edges = metadata["resolve"]["root"], {}, {}
    waiting = [(root, "required")]
    while waiting:
        crate, scope = waiting.pop()
        if scopes.get(crate) in (scope, "required"):
            continue
        scopes[crate] = scope
        edges[crate] = set()
        for needed in nodes[crate]["deps"]:
            kinds = {kind["kind"] for kind in needed["dep_kinds"]} - {"dev"}
            if kinds:
                edges[crate].add(needed["pkg"])
                own = "required" if scope == "required" and None in kinds else "excluded"
                waiting.append((needed["pkg"], own))
    return scopes, edges


def purl(package):
    return f"pkg:cargo/{package['name']}@{package['version']}"


def component(package, scope, checksum):
    found = {
        "type": "library",
        "bom-ref": purl(package),
        "name": package["name"],
        "version": package["version"],
        "scope": scope,
        "purl": purl(package),
        "licenses": [{"expression": package["license"].replace("/", " OR ")}],
    }
    if checksum:
        found["hashes"] = [{"alg": "SHA-256", "content": checksum}]
    if package.get("repository"):
        found["externalReferences"] = [{"type": "vcs", "url": package["repository"]}]
    return found


def npm_purl(name, version):
    return f"pkg:npm/{name.replace('@', '%40')}@{version}"


def page_packages(lock):
    """The packages that are in the page, as components; what each depends on; what the page itself needs; what is
    wrong."""
    packages = {
        path.removeprefix("node_modules/"): found
        for path, found in lock["packages"].items()
        if path and not found.get("dev")
    }
    components, edges, wrong = [], [], []
    for name, found in sorted(packages.items()):
        ref = npm_purl(name, found["version"])
        algorithm, _, digest = found.get("integrity", "").partition("-")
        if algorithm != "sha512" or not found.get("license"):
            wrong.append(f"{ref} has no checksum (sha512) or no licence")
            continue
        components.append(
            {
                "type": "library",
                "bom-ref": ref,
                "name": name,
                "version": found["version"],
                "scope": "required",
                "purl": ref,
                "licenses": [{"expression": found["license"]}],
                "hashes": [{"alg": "SHA-512", "content": base64.b64decode(digest).hex()}],
            }
        )
        needed = [npm_purl(other, packages[other]["version"]) for other in sorted(found.get("dependencies", {}))]
        edges.append({"ref": ref, "dependsOn": needed})
    direct = [
        npm_purl(name, packages[name]["version"]) for name in sorted(lock["packages"][""].get("dependencies", {}))
    ]
    return components, edges, direct, wrong


def document(metadata, lock, page_lock):
    """The SBOM, and what is wrong with it."""
    packages = {package["id"]: package for package in metadata["packages"]}
    checksums = {(crate["name"], crate["version"]): crate.get("checksum") for crate in lock["package"]}
    scopes, edges = reached(metadata)
    root = metadata["resolve"]["root"]
    components, wrong = [], []
    for crate in sorted(scopes.keys() - {root}, key=lambda crate: purl(packages[crate])):
        package = packages[crate]
        checksum = checksums.get((package["name"], package["version"]))
        # The workspace's own crates have no source: they are what is described.
        if not checksum and package["source"]:
            wrong.append(f"{purl(package)} has no checksum in the lock file")
        elif not package["license"]:
            wrong.append(f"{purl(package)} has no licence")
        else:
            components.append(component(package, scopes[crate], checksum))
    program = packages[root]
    own = {
        "type": "application",
        "bom-ref": purl(program),
        "name": program["name"],
        "version": program["version"],
        "purl": purl(program),
        "licenses": [{"expression": program["license"]}],
    }
    dependencies = [
        {"ref": purl(packages[crate]), "dependsOn": sorted(purl(packages[other]) for other in edges[crate])}
        for crate in sorted(edges, key=lambda crate: purl(packages[crate]))
    ]
    shipped, edges_of_page, direct, faults = page_packages(page_lock) if page_lock else ([], [], [], [])
    wrong += faults
    components += shipped
    for one in dependencies:
        if one["ref"] == own["bom-ref"]:
            one["dependsOn"] += direct
    dependencies += edges_of_page
    found = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": own},
        "components": components,
        "dependencies": dependencies,
    }
    found["serialNumber"] = f"urn:uuid:{uuid.uuid5(NAMESPACE, json.dumps(found, sort_keys=True))}"
    return found, wrong


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("metadata", type=Path)
    parser.add_argument("--lock", type=Path, required=True)
    parser.add_argument("--page-lock", type=Path, help="of a program with a page")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    found, wrong = document(
        json.loads(arguments.metadata.read_text()),
        tomllib.loads(arguments.lock.read_text()),
        json.loads(arguments.page_lock.read_text()) if arguments.page_lock else None,
    )
    if wrong or not found["components"]:
        print("\n".join(wrong or ["no crates"]), file=sys.stderr)
        raise SystemExit(1)
    arguments.out.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")
    print(f"{arguments.out}: {len(found['components'])} crates and packages")


if __name__ == "__main__":
    main()
