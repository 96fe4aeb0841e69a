#!/usr/bin/env bash
# Runs a command with a PostgreSQL of its own, whose address is in SHAPELEX_TEST_DATABASE_URL; skips it, saying so, where
# there is none and none can be installed. The database lives in a temporary folder, without a promise for power cuts.
set -euo pipefail

find_programs() { ls -d /usr/lib/postgresql/*/bin 2>/dev/null | sort -V | tail -1; }

programs=$(find_programs)
if [ -z "$programs" ] && [ "$(id -u)" = 0 ]; then
    (apt-get update -qq && apt-get install -y -qq postgresql) >/dev/null 2>&1 || true
    programs=$(find_programs)
fi
if [ -z "$programs" ]; then
    echo "SKIPPED: the tests on PostgreSQL, which is not installed here: $*"
    exit 0
fi

folder=$(mktemp -d)
# The server refuses to run as root.
as_owner=()
if [ "$(id -u)" = 0 ]; then
    chown postgres "$folder"
    as_owner=(runuser -u postgres --)
fi
stop() {
    (cd / && "${as_owner[@]}" "$programs/pg_ctl" -D "$folder/data" -m immediate stop >/dev/null 2>&1) || true
    rm -rf "$folder"
}
trap stop EXIT

port=$((20000 + RANDOM % 20000))
settings="-c listen_addresses=127.0.0.1 -c port=$port -c unix_socket_directories=$folder -c fsync=off"
settings="$settings -c synchronous_commit=off -c full_page_writes=off -c max_connections=400"
(
    cd /
    "${as_owner[@]}" "$programs/initdb" -D "$folder/data" -U postgres -A trust --no-sync >/dev/null
    "${as_owner[@]}" "$programs/pg_ctl" -D "$folder/data" -w -l "$folder/log" -o "$settings" start >/dev/null
) || {
    echo "the PostgreSQL of the tests does not start:" >&2
    cat "$folder/log" >&2 || true
    exit 1
}
export SHAPELEX_TEST_DATABASE_URL="postgres://postgres@127.0.0.1:$port/postgres"
"$@"
