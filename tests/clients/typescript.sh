#!/usr/bin/env bash
# Checks the client for TypeScript, clients/typescript: its generated files, its types, and its tests against the service that they start,
# in Node and in Chromium.
#
#   tests/clients/typescript.sh [PROGRAM]    PROGRAM: the service, by default shapelex in the folder of debug builds
#
# The packages are those of the dashboard. What cannot be had is skipped with a line that says so.
set -euo pipefail

skip() {
    echo "SKIPPED: the client for TypeScript, $1"
    exit 0
}

for tool in cmp cp dirname grep node npm rm sed tail; do
    command -v "$tool" >/dev/null || skip "there is no $tool"
done
root=$(cd "$(dirname "$0")/../.." && pwd)
program=${1:-${CARGO_TARGET_DIR:-$root/target}/debug/shapelex}
said=$("$root/dashboard/run.sh" install)
case "$said" in SKIPPED:*) skip "${said#*, }" ;; esac
"$root/clients/typescript/run.sh" check
[ -x "$program" ] || skip "the service is not built, $program"
program=$(cd "$(dirname "$program")" && pwd)/${program##*/}

# Settings of another service are not those of the tests.
unset SHAPELEX_SERVER SHAPELEX_KEY
code=0
told=$(SHAPELEX_BINARY=$program "$root/clients/typescript/run.sh" test 2>&1) || code=$?
# The closing lines of the runner would be counted beside that of this script.
count() { sed -n "s/^ℹ $1 //p" <<<"$told" | tail -1; }
grep -E '^ *(ℹ ready|ℹ one|ℹ all|﹣)' <<<"$told" | sed 's/^ *ℹ //; s/^ *﹣ \(.*\) ([0-9.]*ms) # /SKIPPED: the client for TypeScript, \1: /' || true
[ "$code" = 0 ] || sed 's/^ℹ /  /' <<<"$told"
echo "typescript-client: $(count pass) passed, $(count fail) failed"
exit "$code"
