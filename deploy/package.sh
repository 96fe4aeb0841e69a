#!/usr/bin/env bash
# Packages a program that is built: a wheel for Python, a package for Debian, licences and list of its components, checksums, a signature.
#
#   deploy/package.sh BINARY [OUT]    OUT: by default target/packages, made anew
#
# What a tool is missing for is skipped with a line. SIGNING_KEY: deploy/sign.sh.
set -euo pipefail

binary=$(realpath "${1:?usage: deploy/package.sh BINARY [OUT]}")
out=$(realpath -m "${2:-$(dirname "$0")/../target/packages}")
cd "$(dirname "$0")/.."
rm -rf "$out"
mkdir -p "$out"

metadata=$(mktemp)
trap 'rm -f "$metadata"' EXIT
cargo metadata --locked --format-version 1 --filter-platform "$(rustc -vV | sed -n 's/^host: //p')" >"$metadata"
python3 deploy/sbom.py "$metadata" --lock Cargo.lock --page-lock dashboard/package-lock.json --out "$out/sbom.cdx.json"
python3 deploy/licences.py "$metadata" --page dashboard/dist/assets/licences.txt --out "$out/licences.txt"
python3 deploy/wheel.py "$binary" --out "$out" --licences "$out/licences.txt" --sbom "$out/sbom.cdx.json"
if command -v dpkg-deb >/dev/null; then
    LICENCES=$out/licences.txt SBOM=$out/sbom.cdx.json deploy/debian.sh "$binary" "$out"
else
    echo "SKIPPED: the package for Debian, there is no dpkg-deb"
fi
deploy/sign.sh "$out"
