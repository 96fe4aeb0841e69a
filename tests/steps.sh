#!/usr/bin/env bash
# Runs the tests step by step, prints the seconds of each, and closes with a table and one line of tests passed, failed and skipped.
#
#   tests/steps.sh test    format, lints, examples, doc tests, unit tests and the suite on SQLite: `make test`
#   tests/steps.sh others  all that takes other programs, in two lanes side by side: `make test-others`
#
# FEATURES are those of the one shape in which all tests are built. CI shortens what has a length; BEGAN is when it began, in seconds
# since 1970, and bounds what other programs may take: what there is no time for is skipped, and says so. The output of each step is in
# target/tests; that of a failed step is printed as well.
set -euo pipefail
cd "$(dirname "$0")/.."

TARGET=${CARGO_TARGET_DIR:-target}
LOGS=$TARGET/tests/${1:-}
# Lines of the output of a failed step that are printed when it has failed, and again below the table.
SHOWN=200
REPEATED=15
# Seconds within which CI ends on a slow machine. `make test`, which comes last, takes about as long there as the build of the tests did.
WITHIN=2700
# Seconds that other programs have at least, however long the build took.
AT_LEAST=600
# Seconds before their end after which CI begins no step of theirs.
BEFORE_END=120
# Seconds after which CI begins no release build, which takes some 500 where rates and `make test` take 800.
RELEASE_WITHIN=1300
# Where other programs end in CI, in seconds since 1970; empty elsewhere.
ENDS=
# shellcheck disable=SC2206  # one word for each argument
SHAPE=(--locked ${FEATURES:-})
BUILT=(--lib --test suite)

# The tests of tests/stored.txt, on a temporary PostgreSQL. A name that has no test any more is a failure.
on_postgresql() {
    local names name missing=0
    mapfile -t names < <(grep -v '^#' tests/stored.txt)
    cargo test "${SHAPE[@]}" "${BUILT[@]}" -- --list >"$LOGS/names" || return
    for name in "${names[@]}"; do
        grep -qE "^$name.*: test$" "$LOGS/names" || { echo "tests/stored.txt: there is no test $name" && missing=1; }
    done
    [ "$missing" = 0 ] || return
    tests/with_postgres.sh cargo test "${SHAPE[@]}" "${BUILT[@]}" --no-fail-fast -- --show-output "${names[@]}"
}

# Counts of an output: tests passed, failed and skipped. A test of cargo that says SKIPPED counts as skipped, whatever it did beside.
counts() {
    awk '
        /^test result: / { passed += $4; failed += $6; skipped += $8 }
        /^---- .* stdout ----$/ { test = $2 }
        /^test result: / || /^failures:$/ { test = "" }
        /^SKIPPED: / { if (test == "") skipped++; else if (!(test in skips)) { skips[test]; skipped++; passed-- } }
        /^([a-z-]+: )?[0-9]+ passed, [0-9]+ failed/ { for (i = 2; i <= NF; i++) { if ($i ~ /^passed/) passed += $(i - 1); if ($i ~ /^failed/) failed += $(i - 1) } }
        /^ℹ pass [0-9]+$/ { passed += $3 }
        /^ℹ fail [0-9]+$/ { failed += $3 }
        /^ℹ skipped [0-9]+$/ { skipped += $3 }
        END { printf "%d\t%d\t%d\n", passed, failed, skipped }
    ' "$1"
}

# What failed, by an output: the failures that a runner of cargo or of Node lists, or the lines that say so, else the end; at most so many lines.
faults() {
    if grep -qE '^(FAIL|WRONG)' "$1"; then
        grep -E '^(FAIL|WRONG)' "$1" | head -n "$2"
    elif grep -qE '^(failures:|✖ failing tests:)$' "$1"; then
        awk -v most="$2" '/^(failures:|✖ failing tests:)$/ { on = 1 } on && most-- > 0 { print } /^test result: / { on = 0 }' "$1"
    else
        tail -n "$2" "$1"
    fi
}

# What is written down of a step: name, seconds, state, counts. A step is skipped when it says so at its end, and tested nothing.
note() {
    local name=$1 seconds=$2 code=$3 log=$4 passed failed skipped state=passed
    IFS=$'\t' read -r passed failed skipped < <(counts "$log")
    if [ "$code" != 0 ]; then
        state=FAILED
    elif [ "$((passed + failed))" = 0 ] && tail -1 "$log" | grep -q '^SKIPPED: '; then
        state=skipped
    fi
    printf '%s\t%s\t%s\t%s\t%s\t%s\n' "$name" "$seconds" "$state" "$passed" "$failed" "$skipped" >>"$TABLE"
    echo "== $name: $state, $seconds s"
    if [ "$state" = FAILED ]; then
        echo "-- the output of $name, in $log:"
        faults "$log" "$SHOWN"
        echo "-- end of $name"
    fi
}

# Sets when other programs end in CI, once the tests are built.
bound() {
    local now built
    [ -n "${BEGAN:-}" ] || return 0
    now=$(date +%s)
    built=$((now - BEGAN))
    ENDS=$((BEGAN + WITHIN - built))
    [ "$ENDS" -gt "$((now + AT_LEAST))" ] || ENDS=$((now + AT_LEAST))
}

# Whether an output says that a test failed, though its runner came to no summary.
has_fault() { grep -qE '^ *✖ |^test .* FAILED$|^(FAIL|WRONG)' "$1"; }

# Runs a command with its output in a file; in CI it ends where other programs end, which is no failure unless a test had failed.
in_time() {
    local log=$1 group clock code=0
    shift
    if [ -z "$ENDS" ]; then
        "$@" >"$log" 2>&1 </dev/null
        return
    fi
    # A group of processes of its own, so that all of them can be ended.
    set -m
    "$@" >"$log" 2>&1 </dev/null &
    group=$!
    { sleep "$((ENDS - $(date +%s)))" && touch "$log.cut" && kill -TERM -- "-$group" && sleep 10 && kill -KILL -- "-$group"; } 2>/dev/null >&2 &
    clock=$!
    set +m
    wait "$group" || code=$?
    kill -TERM -- "-$clock" 2>/dev/null || true
    wait "$clock" 2>/dev/null || true
    if [ -e "$log.cut" ]; then
        code=0
        ! has_fault "$log" || code=1
        echo "SKIPPED: the rest of a step that CI had no time for; make test-others runs it" >>"$log"
    fi
    return "$code"
}

# Runs one step: its name, then its command. Always ends with success: what failed stands in the table.
step() {
    local name=$1 log=$LOGS/$1.log begin=$SECONDS code=0
    shift
    echo "== $name"
    if [ -n "$ENDS" ] && [ "$(date +%s)" -gt "$((ENDS - BEFORE_END))" ]; then
        echo "SKIPPED: a step that CI had no time for; make test-others runs it" >"$log"
    else
        in_time "$log" "$@" || code=$?
    fi
    note "$name" "$((SECONDS - begin))" "$code" "$log"
}

# The last step, whose progress is shown: each program of tests, what fails, and the closing lines.
shown_step() {
    local name=$1 log=$LOGS/$1.log begin=$SECONDS code=0
    shift
    echo "== $name"
    "$@" 2>&1 </dev/null | tee "$log" | { grep --line-buffered -E '^ +Running |^test result: |^test .* FAILED$|^error' || true; } || code=$?
    note "$name" "$((SECONDS - begin))" "$code" "$log"
}

# Runs a step of Python where there is one.
python_step() {
    local name=$1
    shift
    if command -v python3 >/dev/null; then
        step "$name" python3 "$@"
    else
        step "$name" echo "SKIPPED: $name, there is no python3"
    fi
}

failed() { grep -qF $'\tFAILED\t' "$TABLE"; }
last_failed() { tail -1 "$TABLE" | grep -qF $'\tFAILED\t'; }

build() { cargo test "${SHAPE[@]}" "${BUILT[@]}" --no-run; }

run_examples() {
    cargo build "${SHAPE[@]}" --examples || return
    local example passed=0
    for example in examples/*.rs; do
        echo "$example"
        "$TARGET/debug/examples/$(basename "$example" .rs)" || return
        passed=$((passed + 1))
    done
    echo "$passed passed, 0 failed"
}

# Each family of formats alone, as programs that need no other one build the crate; where CI has little time they are compiled only.
families() {
    local family names
    [ "$LENGTH" = long ] || echo "SKIPPED: the tests of each family of formats alone, which are compiled only where CI is set"
    echo "the front without families of formats"
    cargo check --locked -p shapelex --no-default-features --lib || return
    names=$(sed -n 's/^default = \[\(.*\)\]$/\1/p' crates/shapelex-formats/Cargo.toml | tr -d '",')
    for family in $names; do
        echo "the family $family"
        if [ "$LENGTH" = short ]; then
            cargo check --locked -p shapelex-formats --no-default-features --features "$family" --lib --test suite || return
        else
            cargo test --locked -p shapelex-formats --no-default-features --features "$family" --lib --test suite || return
        fi
    done
}

# A limit of benches/weight/limits.txt: its name, then the number.
limit() { awk -v name="$1" '$1 == name { print $2 }' benches/weight/limits.txt; }

# Fails when a figure is above its limit: name, figure.
within() {
    echo "$1: $2, at most $(limit "$1")"
    [ "$2" -le "$(limit "$1")" ]
}

# Packages that a build of the program compiles, and lines of LLVM IR of each crate before optimisation.
weight() {
    local crate lines built code=0
    within packages "$(cargo tree --locked --edges normal,build --prefix none --no-dedupe | awk '{ print $1, $2 }' | sort -u | wc -l)" || code=1
    echo "$((1 - code)) passed, $code failed"
    if ! cargo llvm-lines --version >/dev/null 2>&1; then
        echo "SKIPPED: lines of LLVM IR, there is no cargo-llvm-lines"
        return "$code"
    fi
    # The cold build of CI has the dependencies already.
    built=$TARGET/weight/now
    [ -d "$built" ] || built=$TARGET
    for crate in $(awk '/^shapelex/ { print $1 }' benches/weight/limits.txt); do
        lines=$(CARGO_TARGET_DIR=$built cargo llvm-lines --locked --release --lib -p "$crate" 2>/dev/null | awk '/\(TOTAL\)/ { print $1 }')
        within "$crate" "$lines" || code=1
    done
    return "$code"
}

# What one build serves.
test_steps() {
    step examples run_examples
    step weight weight
    step documentation-tests cargo test "${SHAPE[@]}" --doc
    shown_step suite cargo test "${SHAPE[@]}" "${BUILT[@]}" --no-fail-fast -- --show-output
}

# What compiles, and what holds the lock of cargo. `fuzz` is a separate workspace, and compiles without nightly; with the profile of this
# one it uses what was checked before.
compiling_lane() {
    step postgresql on_postgresql
    step lints cargo clippy "${SHAPE[@]}" --all-targets -- -D warnings
    step otel cargo check --locked --all-features --lib --bins
    step rustdoc env RUSTDOCFLAGS="-D warnings" cargo doc "${SHAPE[@]}" --no-deps --document-private-items --quiet
    sed -n '/^\[profile.dev/,/^$/p' Cargo.toml >"$LOGS/profile.toml"
    step fuzz cargo check --locked --manifest-path fuzz/Cargo.toml --config "$LOGS/profile.toml" --target-dir "$TARGET"
    step families families
    step engine make --no-print-directory test-engine-if-built
    asking_lane
}

# Steps that send requests to the program that is built, and need no cargo: short ones, then by what they are worth, as CI may not reach the
# last. Each lane takes the next one that the other has not begun.
ASKING=(spelling scripts deploy contract page-files page-clinic page-walk attacks python-client clients page-others documentation
    client-typescript interop client-r image notebooks packages)

asked() {
    case $1 in
    spelling | scripts) step "$1" make --no-print-directory "${1/spelling/spell}" ;;
    deploy) python_step deploy deploy/lint.py ;;
    contract) python_step contract tests/contract/run.py "$LENGTH" ;;
    page-files) step page-files dashboard/run.sh check ;;
    page-clinic) step page-clinic dashboard/run.sh test clinic ;;
    page-walk) step page-walk dashboard/run.sh test walk ;;
    page-others) step page-others dashboard/run.sh test data login many reference ;;
    attacks) python_step attacks tests/attack/run.py small --binary "$TARGET/debug/shapelex" ;;
    python-client) python_step python-client tests/clients/python.py ;;
    clients) python_step clients tests/clients/run.py ;;
    interop) python_step interop tests/interop/run.py ;;
    documentation) python_step documentation tests/documentation.py ;;
    client-typescript) step client-typescript tests/clients/typescript.sh "$TARGET/debug/shapelex" ;;
    # Minutes of analyses by the client, and of installations, which CI leaves out.
    notebooks) [ "$LENGTH" = short ] || python_step notebooks tests/notebooks.py ;;
    packages) [ "$LENGTH" = short ] || python_step packages tests/packages.py ;;
    image) step image tests/image.sh ;;
    client-r) step client-r tests/clients/r.sh "$TARGET/debug/shapelex" ;;
    esac
}

asking_lane() {
    local name
    for name in "${ASKING[@]}"; do
        ! mkdir "$LOGS/begun/$name" 2>/dev/null || asked "$name"
    done
}

# Prefixes the lines of a lane, so that both can be told apart.
lane() {
    local mark=$1
    shift
    "$@" 2>&1 | sed -u "s/^/$mark| /"
}

# Two lanes, and then what other work on the machine would disturb. What runs in the background does not hear Ctrl-C by itself.
lanes() {
    local first second
    trap 'trap - INT; kill -TERM 0' INT
    bound
    rm -rf "$LOGS/begun"
    mkdir "$LOGS/begun"
    lane a compiling_lane &
    first=$!
    lane b asking_lane &
    second=$!
    # A lane that breaks off is a separate failure: its other steps are missing from the table.
    wait "$first" || step lane-a false
    wait "$second" || step lane-b false
    ENDS=
    step rates cargo test "${SHAPE[@]}" --test rates
    # A cold release build takes minutes, which only CI spends, where it has them: the tests of newcomers come last, and must not be cut.
    if [ "$LENGTH" = short ]; then
        if [ "$(($(date +%s) - ${BEGAN:-$(date +%s)}))" -lt "$RELEASE_WITHIN" ]; then
            python_step release-weight benches/weight/run.py --gate
        else
            step release-weight echo "SKIPPED: a cold release build, more than $((RELEASE_WITHIN / 60)) minutes have passed"
        fi
    fi
}

# What was not tested in a step and why: lines of our own, and those of the runner of Node.
reasons() {
    sed -nE "s/^SKIPPED: /skipped in $1: /p; s/^﹣ (.*) \([0-9.]+ms\) # /skipped in $1: \1: /p" "$LOGS/$1.log" | sort | uniq -c \
        | sed -E 's/^ *1 //; s/^ *([0-9]+) (.*)/\2 (\1 times)/'
}

# The table, the reasons of what was skipped, and one line of all tests.
summary() {
    local name
    echo
    awk -F '\t' '
        BEGIN { printf "%-22s %8s  %-8s %7s %7s %7s\n", "step", "seconds", "state", "passed", "failed", "skipped" }
        {
            printf "%-22s %8d  %-8s %7d %7d %7d\n", $1, $2, $3, $4, $5, $6
            passed += $4; failed += $5; skipped += $6
            if ($3 == "FAILED" && $5 == 0) failed++
        }
        END { total = passed " passed, " failed " failed, " skipped " skipped"; print total > TOTAL }
    ' TOTAL="$LOGS/total" "$TABLE"
    echo
    while IFS=$'\t' read -r name _; do
        reasons "$name"
    done <"$TABLE"
    # What failed comes last: who reads the end of a long output reads the reason.
    while IFS=$'\t' read -r name _ state _; do
        if [ "$state" = FAILED ] && [ -e "$LOGS/$name.log" ]; then
            faults "$LOGS/$name.log" "$REPEATED" | cut -c -300 | sed "s/^/failed in $name: /"
        fi
    done <"$TABLE"
    echo "in $((SECONDS / 60)) min $((SECONDS % 60)) s:"
    cat "$LOGS/total"
}

# The runner's own closing lines of the last step.
closing() {
    [ ! -e "$LOGS/suite.log" ] || grep -E '^ +Running |^test result: ' "$LOGS/suite.log" | tail -40
}

mkdir -p "$LOGS"
rm -f "$LOGS"/*.log "$LOGS"/*.cut
TABLE=$LOGS/steps.tsv
: >"$TABLE"
LENGTH=$([ -n "${CI:-}" ] && echo short || echo long)
case "${1:-}" in
test)
    # The lints need a build of their own, without code.
    step format cargo fmt --all --check
    last_failed || step lints cargo clippy "${SHAPE[@]}" "${BUILT[@]}" --bins --examples -- -D warnings
    step build build
    last_failed || test_steps
    ;;
others)
    step format cargo fmt --all --check
    step build build
    last_failed || lanes
    ;;
*)
    sed -n '2,/^set/s/^# \{0,1\}//p' "$0"
    exit 2
    ;;
esac
summary
closing
! failed
