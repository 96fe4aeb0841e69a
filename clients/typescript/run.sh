#!/usr/bin/env bash
# The client for TypeScript. Its tools are the packages of the dashboard, which has one lock for both.
#
#   clients/typescript/run.sh build   from `src` to `dist`, what `npm install` of this folder gives programs
#   clients/typescript/run.sh check   whether the generated files are those of openapi/openapi.json, and types
#   clients/typescript/run.sh lint    format and lints of its sources and tests; `tidy` mends what can be mended
#   clients/typescript/run.sh test    builds and tests, on target/debug/shapelex or SHAPELEX_BINARY
set -euo pipefail

case "${1:-}" in build | check | lint | tidy | test) ;; *)
    sed -n '2,7s/^# \{0,1\}//p' "$0"
    exit 2
    ;;
esac
cd "$(dirname "$0")"
said=$(../../dashboard/run.sh install)
case "$said" in SKIPPED:*)
    echo "SKIPPED: the client for TypeScript (${1}), ${said#*, }"
    exit 0
    ;;
esac
tools=../../dashboard/node_modules/.bin
tsc=$tools/tsc

case "$1" in
build)
    rm -rf dist
    "$tsc"
    ;;
check)
    node generate.mjs --check
    "$tsc" --noEmit
    "$tsc" --project tests/tsconfig.json
    ;;
lint) "$tools/biome" check --error-on-warnings . ;;
tidy) "$tools/biome" check --write --error-on-warnings . ;;
test)
    rm -rf dist
    "$tsc"
    node --test --test-concurrency=1 --test-reporter=spec tests/*.test.mjs
    ;;
esac
