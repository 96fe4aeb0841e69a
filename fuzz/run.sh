#!/usr/bin/env bash
# Fuzzes one target for some seconds, then keeps of its corpus what is needed for what it reaches.
#   fuzz/run.sh TARGET SECONDS
# The first input that fails stays in fuzz/artifacts; the others are in the way of no one at `nice`.
set -euo pipefail
cd "$(dirname "$0")"
target=$1 seconds=$2 corpus=corpus/$1
nice -n 19 cargo fuzz run -s none "$target" "$corpus" -- \
    -max_total_time="$seconds" -max_len=8192 -timeout=300 -dict=words.dict -print_final_stats=1 -verbosity=1
small=$(mktemp -d)
nice -n 19 cargo fuzz run -s none "$target" "$small" "$corpus" -- -merge=1 -max_len=8192 -timeout=300
rm -r "$corpus" && mv "$small" "$corpus"
