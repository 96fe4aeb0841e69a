#!/usr/bin/env bash
# Writes the checksums of all files of a folder, SHA256SUMS, and signs them.
#
#   deploy/sign.sh FOLDER
#
# SIGNING_KEY: a file with a private key of Ed25519 (PEM, signed by openssl), a file with a secret key of minisign, or a key of gpg by its
# id. Without it the checksums are not signed, and a line says so. How each signature is checked is printed.
set -euo pipefail

folder=${1:?usage: deploy/sign.sh FOLDER}
key=${SIGNING_KEY:-}
[ ! -f "$key" ] || key=$(realpath "$key")
cd "$folder"
sums=$(mktemp)
rm -f SHA256SUMS SHA256SUMS.*
find . -maxdepth 1 -type f ! -name 'SHA256SUMS*' -printf '%P\n' | LC_ALL=C sort | xargs -d "\n" sha256sum >"$sums"
mv "$sums" SHA256SUMS
chmod 0644 SHA256SUMS
echo "$PWD/SHA256SUMS: $(wc -l <SHA256SUMS) files; to check: sha256sum --check SHA256SUMS"

if [ -z "$key" ]; then
    echo "SKIPPED: the signature, SIGNING_KEY names no key"
elif [ -f "$key" ] && grep -q 'BEGIN PRIVATE KEY' "$key"; then
    openssl pkeyutl -sign -rawin -inkey "$key" -in SHA256SUMS -out SHA256SUMS.sig
    openssl pkey -in "$key" -pubout -out SHA256SUMS.pub
    openssl pkeyutl -verify -rawin -pubin -inkey SHA256SUMS.pub -in SHA256SUMS -sigfile SHA256SUMS.sig >/dev/null
    echo "signed; to check: openssl pkeyutl -verify -rawin -pubin -inkey KEY -in SHA256SUMS -sigfile SHA256SUMS.sig"
elif [ -f "$key" ] && head -1 "$key" | grep -q '^untrusted comment:'; then
    minisign -S -s "$key" -m SHA256SUMS </dev/null
    echo "signed; to check: minisign -V -p KEY -m SHA256SUMS"
else
    gpg --batch --yes --local-user "$key" --armor --detach-sign --output SHA256SUMS.asc SHA256SUMS
    gpg --batch --verify SHA256SUMS.asc SHA256SUMS 2>/dev/null
    echo "signed; to check: gpg --verify SHA256SUMS.asc SHA256SUMS"
fi
