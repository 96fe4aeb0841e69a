#!/usr/bin/env bash
# Runs a command with a PostgreSQL of its own, whose address is in SHAPELEX_TEST_DATABASE_URL; skips it, saying so, where
# there is none and none can be installed. The database lives in a temporary folder, without a promise for power cuts.
set -euo pipefail

skip() {
    echo "SKIPPED: the tests on PostgreSQL, $1"
    exit 0
}

for tool in chown cat dirname id ls mktemp readlink rm sort tail; do
    command -v "$tool" >/dev/null || skip "there is no $tool"
done

# The folder of initdb and pg_ctl: that of the newest version where Debian keeps them, else that of the path. Nothing is found, and
# that is no failure, where there is none.
find_programs() {
    local found
    found=$( (ls /usr/lib/postgresql/*/bin/initdb 2>/dev/null || true) | sort -V | tail -1)
    found=${found%/initdb}
    if [ -z "$found" ] && command -v initdb >/dev/null && command -v pg_ctl >/dev/null; then
        found=$(dirname "$(readlink -f "$(command -v initdb)")")
    fi
    echo "$found"
}

programs=$(find_programs)
if [ -z "$programs" ]; then
    said=$("$(dirname "$0")/debian.sh" postgresql) || skip "which is not installed, and $said (Debian: postgresql)"
    programs=$(find_programs)
    [ -n "$programs" ] || skip "of which no initdb is found after its installation"
fi

folder=$(mktemp -d)
# The server refuses to run as root.
as_owner=()
if [ "$(id -u)" = 0 ]; then
    id postgres >/dev/null 2>&1 || skip "there is no user postgres, and it does not run as root"
    command -v runuser >/dev/null || skip "there is no runuser, and it does not run as root"
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
