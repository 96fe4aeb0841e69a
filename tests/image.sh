#!/usr/bin/env bash
# Builds the image by podman and runs it as docs/operations.md says: without rights, on a read-only root.
#
#   tests/image.sh [PROGRAM]    by default the newest of target/dist, target/release and target/debug
#
# No base is pulled, and nothing is compiled: the stages before the last one of docker/Dockerfile are replaced by folders that
# docker/image_root.sh and deploy/sbom.py make here, from a program that is built already. The last stage is built as it stands.
# Images and containers are kept in a temporary folder. The size is that of the image where the program is a release.
set -euo pipefail

# Bytes that the image may have, and what is in it beside the program.
MOST=60000000
MOST_BESIDE=10000000
READY_SECONDS=60

skip() {
    echo "SKIPPED: the image of the container, $1"
    exit 0
}

for tool in awk chmod curl cut dirname dpkg find grep id install ldd ls mkdir mktemp nsenter python3 realpath rm sed sleep sort stat tail; do
    command -v "$tool" >/dev/null || skip "there is no $tool"
done
cd "$(dirname "$0")/.."

newest() {
    (ls -t target/dist/shapelex target/release/shapelex "${CARGO_TARGET_DIR:-target}/debug/shapelex" 2>/dev/null || true) | sed -n 1p
}
program=${1:-$(newest)}
[ -x "$program" ] || skip "the program is not built yet"
# Another user begins anew as root of a namespace of its own, in which files of the user 65532 can be made.
if [ "$(id -u)" != 0 ]; then
    command -v podman >/dev/null || skip "there is no podman, and only root may install it (Debian: podman uidmap)"
    podman unshare true >/dev/null 2>&1 || skip "this user has no other users to give (/etc/subuid)"
    exec podman unshare bash tests/image.sh "$program"
fi
if ! command -v podman >/dev/null; then
    said=$(tests/debian.sh --no-install-recommends podman runc) || skip "there is no podman, and $said (Debian: podman runc)"
fi

work=$(mktemp -d)
finish() {
    podman_ rm --force --all >/dev/null 2>&1 || true
    rm -rf --one-file-system "$work"
}
# No systemd and no overlay is needed, and nothing of the machine's own images is touched.
podman_() {
    podman --root "$work/store" --runroot "$work/run" --storage-driver vfs --cgroup-manager cgroupfs "${runtime[@]}" "$@"
}
runtime=()
trap finish EXIT

passed=0
failed=0
# Counts a check: its name, then a command that must succeed.
check() {
    local name=$1
    shift
    if "$@" >"$work/said" 2>&1; then
        passed=$((passed + 1))
        echo "image: $name: ok"
    else
        failed=$((failed + 1))
        echo "FAIL: image: $name: $(tail -3 "$work/said")"
    fi
}

# The program as a release is built, without what debuggers read.
mkdir -p "$work/build" "$work/sbom"
install -m 0755 "$program" "$work/shapelex"
! command -v strip >/dev/null || strip "$work/shapelex"
sh docker/image_root.sh "$work/shapelex" "$work/build/image"
# deploy/lint.py checks the list of components; without cargo there is none here.
if ! { cargo metadata --locked --offline --format-version 1 >"$work/metadata.json" \
    && python3 deploy/sbom.py "$work/metadata.json" --lock Cargo.lock --page-lock dashboard/package-lock.json \
        --out "$work/sbom/sbom.cdx.json"; } >/dev/null 2>&1; then
    echo "SKIPPED: the list of components in the image, cargo does not find all crates"
    echo '{}' >"$work/sbom/sbom.cdx.json"
fi
awk '/^FROM scratch$/ { on = 1 } on' docker/Dockerfile >"$work/Dockerfile"

# As docker builds it: an image in the format of OCI has no health check.
podman_ build --quiet --format docker --isolation chroot --build-context "build=$work/build" --build-context "sbom=$work/sbom" \
    --tag localhost/shapelex --file "$work/Dockerfile" "$work/sbom" >"$work/log" 2>&1 || skip "podman builds none here: $(tail -1 "$work/log")"

# Rights and limits of the documentation; a container takes no higher limits than this process has.
LIMITS=(--read-only --tmpfs /tmp --cap-drop ALL --security-opt no-new-privileges --ulimit nofile=8192:8192 --ulimit nproc=512:512
    --network none --volume shapelex:/data)
# crun refuses the control groups of some machines.
for runtime_name in "" runc; do
    runtime=(${runtime_name:+--runtime "$runtime_name"})
    ! podman_ run --rm "${LIMITS[@]}" localhost/shapelex --version >"$work/version" 2>"$work/log" || break
done
[ -s "$work/version" ] || skip "podman runs none here: $(tail -1 "$work/log")"

said_user() { [ "$(podman_ image inspect --format '{{.Config.User}}' localhost/shapelex)" = 65532:65532 ]; }
size() { podman_ image inspect --format '{{.Size}}' localhost/shapelex; }
beside() { echo $(($(size) - $(stat -c %s "$work/shapelex"))); }
has_no_shell() { ! podman_ run --rm "${LIMITS[@]}" --entrypoint /bin/sh localhost/shapelex -c true; }
needs_a_key() { ! podman_ run --rm "${LIMITS[@]}" localhost/shapelex >"$work/log" 2>&1 && grep 'key' "$work/log"; }
creates_a_key() {
    podman_ run --rm "${LIMITS[@]}" localhost/shapelex key create --name first --role admin >"$work/key" || return
    key=$(grep -oE 'shk_[0-9a-f]+_[0-9a-f]+' "$work/key")
}
# A request from inside its network, with the address that the image listens on.
ask() {
    local path=$1
    shift
    nsenter --target "$pid" --net curl -sS --max-time 60 --fail -H "authorization: Bearer $key" "$@" "http://127.0.0.1:8080$path"
}
is_ready() {
    local begin=$SECONDS
    until ask /readyz; do
        [ "$((SECONDS - begin))" -lt "$READY_SECONDS" ] || { podman_ logs shapelex && return 1; }
        sleep 0.2
    done
}
# Of the example of the interface document.
mean() {
    python3 -c 'import json; print(json.dumps(json.load(open("openapi/openapi.json"))["components"]["schemas"]["StatisticsRequest"]["example"]))' \
        >"$work/request" && ask /v1/mean -H 'content-type: application/json' --data "@$work/request" >"$work/mean" && grep '"mean"' "$work/mean"
}
runs_as_user() { grep -qE '^Uid:\s65532\s65532\s65532\s65532$' "/proc/$pid/status" && grep -qE '^Gid:\s65532\s' "/proc/$pid/status"; }
has_no_rights() { grep -qE '^CapEff:\s0+$' "/proc/$pid/status" && grep -qE '^NoNewPrivs:\s1$' "/proc/$pid/status"; }
root_is_read_only() { awk '$5 == "/" { print $6 }' "/proc/$pid/mountinfo" | grep -qE '^ro(,|$)' && ! podman_ diff shapelex | grep -v ' /data$'; }
is_healthy() { podman_ healthcheck run shapelex; }
has_settings_of_the_allocator() { ! podman_ logs shapelex 2>&1 | grep 'settings of the allocator'; }
stops_in_order() {
    podman_ stop --time 40 shapelex && [ "$(podman_ inspect --format '{{.State.ExitCode}}' shapelex)" = 0 ]
}

check "the user of the image is no root" said_user
check "no shell" has_no_shell
check "it does not start without a key" needs_a_key
check "the first key" creates_a_key
podman_ run --detach --name shapelex "${LIMITS[@]}" localhost/shapelex >"$work/log" 2>&1 || { tail -3 "$work/log" && exit 1; }
pid=$(podman_ inspect --format '{{.State.Pid}}' shapelex)
check "/readyz" is_ready
check "a mean" mean
check "the health check" is_healthy
check "its processes have the user 65532" runs_as_user
check "they have no rights" has_no_rights
check "the root is read-only, and nothing is written to it" root_is_read_only
check "the settings of the allocator" has_settings_of_the_allocator
check "SIGTERM stops it in order" stops_in_order
check "$(beside) bytes beside the program, at most $MOST_BESIDE" [ "$(beside)" -le "$MOST_BESIDE" ]
case $program in
*/dist/* | */release/*) check "$(size) bytes, at most $MOST" [ "$(size)" -le "$MOST" ] ;;
*) echo "SKIPPED: the size of the image, $program is no release; this one has $(size) bytes" ;;
esac
echo "image: $passed passed, $failed failed"
[ "$failed" = 0 ]
