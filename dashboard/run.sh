#!/usr/bin/env bash
# The dashboard beside the service.
#
#   dashboard/run.sh install the packages that its lock names, which the client for TypeScript is built with too
#   dashboard/run.sh build   from `dashboard/src` to `dashboard/dist`, which is committed and becomes part of the program
#   dashboard/run.sh check   whether the committed files are those of a fresh build
#   dashboard/run.sh lint    format and lints of its sources and tests; `tidy` mends what can be mended
#   dashboard/run.sh test [NAME…]   the page in Chromium, all of dashboard/tests or the files of these names, on
#                            target/debug/shapelex, or SHAPELEX_BINARY; SCREENS=folder keeps pictures,
#                            GOALS=1 compares times with the goals, on an idle machine and a release build, DIST=1 takes the page
#                            from dashboard/dist instead of the program, which is built anew for each change of it otherwise
set -euo pipefail

skip() {
  echo "SKIPPED: the dashboard ($1), $2"
  exit 0
}

for tool in node npm cmp cp diff dirname mktemp rm sed tail; do
  command -v "$tool" >/dev/null || skip "$1" "there is no $tool"
done
cd "$(dirname "$0")"
# What is installed is what the lock says: anew only when it has changed.
if ! cmp -s package-lock.json node_modules/.lock; then
  said=$(npm ci --no-audit --no-fund 2>&1) || skip "$1" "its packages cannot be installed: $(tail -1 <<<"$said")"
  cp package-lock.json node_modules/.lock
fi

case "$1" in
install) ;;
build)
  npm run --silent build
  ;;
check)
  node ../clients/typescript/generate.mjs --check
  npx tsc --noEmit
  fresh=$(mktemp -d)
  trap 'rm -rf "$fresh"' EXIT
  npx vite build --logLevel warn --outDir "$fresh" --emptyOutDir
  diff -r dist "$fresh" >/dev/null || { echo "dashboard/dist is not what dashboard/src makes: run make dashboard" >&2; exit 1; }
  echo "dashboard/dist is what dashboard/src makes"
  ;;
lint)
  npx biome check --error-on-warnings .
  ;;
tidy)
  npx biome check --write --error-on-warnings .
  ;;
test)
  if ! command -v chromium >/dev/null; then
    said=$(../tests/debian.sh chromium) || skip test "there is no chromium, and $said"
  fi
  shift
  # Names of files, or all. A file that hangs fails.
  [ "$#" -gt 0 ] || set -- '*'
  # shellcheck disable=SC2086,SC2046  # one word for each file
  node --test --test-concurrency=1 --test-timeout=2400000 --test-reporter=spec $(printf 'tests/%s.test.mjs ' "$@")
  ;;
*)
  sed -n '2,10s/^# \{0,1\}//p' "$0"
  exit 2
  ;;
esac
