#!/usr/bin/env bash
# Checks the package for R, `R CMD check` with its examples, its vignette and its tests, which ask a service that they start.
#
#   tests/clients/r.sh [PROGRAM]    PROGRAM: the service, by default shapelex in the folder of debug builds
#
# R comes from Debian where the rights are there; what cannot be had is skipped with a line that says so. Tables of geomorph are compared on
# the data beside the project.
set -euo pipefail

PACKAGES=(r-base-core r-cran-curl r-cran-jsonlite r-cran-knitr r-cran-markdown)

skip() {
    echo "SKIPPED: the package for R, $1"
    exit 0
}

for tool in dirname grep id ls mkdir rm sed tail; do
    command -v "$tool" >/dev/null || skip "there is no $tool"
done

# Whether R has what the package imports, and what builds its vignette.
has_packages() { command -v Rscript >/dev/null && Rscript -e 'for (name in commandArgs(TRUE)) loadNamespace(name)' "$@" >/dev/null 2>&1; }

if ! has_packages curl jsonlite knitr markdown; then
    "$(dirname "$0")/../debian.sh" --no-install-recommends "${PACKAGES[@]}" || echo "R is not complete here"
fi
has_packages curl jsonlite || skip "there is no R with curl and jsonlite (Debian: r-base-core r-cran-curl r-cran-jsonlite)"

root=$(cd "$(dirname "$0")/../.." && pwd)
target=${CARGO_TARGET_DIR:-$root/target}
program=${1:-$target/debug/shapelex}
work=$target/clients/r
rm -rf "$work"
mkdir -p "$work"
[ ! -d "$root/../shared/data" ] || export SHAPELEXR_DATA=$root/../shared/data
export SHAPELEXR_VECTORS=$root/tests/vectors
# Tests of a service that is started are not those of one that somebody runs.
unset SHAPELEXR_URL SHAPELEXR_KEY
[ ! -x "$program" ] || program=$(cd "$(dirname "$program")" && pwd)/${program##*/}
export SHAPELEXR_PROGRAM=$program
[ -x "$program" ] || echo "the service is not built, $program: what needs it is skipped"

vignettes=()
if ! has_packages knitr markdown; then
    echo "SKIPPED: the vignette of the package for R, there is no knitr or no markdown (Debian: r-cran-knitr r-cran-markdown)"
    vignettes=(--no-build-vignettes)
fi
cd "$work"
R CMD build "${vignettes[@]}" "$root/clients/r"
# Without LaTeX there is no manual; suggested packages that are missing were told above. What a check would ask a network is not asked.
code=0
_R_CHECK_FORCE_SUGGESTS_=false _R_CHECK_CRAN_INCOMING_=false \
    R CMD check --no-manual "${vignettes[@]/#--no-build-vignettes/--ignore-vignettes}" shapelexr_*.tar.gz || code=$?
for output in shapelexr.Rcheck/tests/*.Rout*; do
    grep -E '^(SKIPPED: |FAIL: |r-[a-z]+: [0-9]+ passed)' "$output" || true
done
status=$(sed -n 's/^Status: //p' shapelexr.Rcheck/00check.log)
if [ "$code" != 0 ] || grep -qE 'ERROR|WARNING' <<<"$status"; then
    echo "FAIL: R CMD check: $status"
    echo "r-check: 0 passed, 1 failed"
    exit 1
fi
echo "R CMD check: $status"
echo "r-check: 1 passed, 0 failed"
