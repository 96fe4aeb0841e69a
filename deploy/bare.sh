#!/usr/bin/env bash
# Proves that the two commands of the README are enough: on a bare Debian, made here, with what the README says and nothing else.
#
#   deploy/bare.sh             `make run` with the README's first request, then `make test`
#   deploy/bare.sh TARGET...   these targets of make instead, `run` likewise
#
# Needs root, debootstrap (installed by apt-get where it is missing) and the archive that this machine's apt uses; says that it is skipped
# where it cannot. The Rust toolchain is the one of this machine, or that in RUST; crates are fetched anew. Settings of apt and cargo,
# proxies and certificates of this machine are taken over. ROOT is the folder of the new system (target/bare/root), removed at the end
# unless KEEP=1. The commands run as an ordinary user. The log with the seconds of each step: target/bare/log.
set -euo pipefail
cd "$(dirname "$0")/.."

SELF=$PWD/deploy/bare.sh
PLACE=${CARGO_TARGET_DIR:-$PWD/target}/bare
ROOT=${ROOT:-$PLACE/root}
LOG=$PLACE/log
READY_SECONDS=5400
ADDRESS=http://127.0.0.1:8080
# Home of the user in the new system, and the checkout in it.
HOUSE=/srv/reader
CHECKOUT=$HOUSE/shapelex

skip() {
    echo "SKIPPED: the bare machine, $1"
    exit 0
}

say() { echo "$*" | tee -a "$LOG"; }

# Runs a step, a program; its seconds and its output go to the log.
step() {
    local name=$1 begin=$SECONDS code=0
    shift
    say "== $name"
    "$@" >>"$LOG" 2>&1 </dev/null || code=$?
    if [ "$code" != 0 ]; then
        tail -n 60 "$LOG"
        say "FAILED: $name, after $((SECONDS - begin)) s"
        exit 1
    fi
    say "$name: $((SECONDS - begin)) s"
}

# Address and name of the release from which this machine's apt takes its packages.
archive() {
    local release
    release=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")
    apt-get indextargets --format '$(REPO_URI) $(RELEASE)' 'Created-By: Packages' \
        | awk -v release="$release" '$2 == release && /^https?:/ { print; exit }'
}

debootstrap_here() {
    command -v debootstrap >/dev/null && return
    (apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq debootstrap) >>"$LOG" 2>&1
}

# What the README tells to install.
packages() { sed -n 's/^apt-get install \([a-z0-9+. -]*\).*/\1/p' README.md | head -1; }

# The first command of the README that asks the service.
first_request() { awk '/^curl / && !found { print; found = 1 }' README.md; }

# Lists of packages, settings of transport and credentials of this machine's apt, and how names are found.
take_over() {
    local found
    rm -rf "$ROOT/etc/apt/sources.list" "$ROOT/etc/apt/sources.list.d"
    for found in sources.list sources.list.d keyrings trusted.gpg.d auth.conf auth.conf.d; do
        [ ! -e "/etc/apt/$found" ] || cp -a "/etc/apt/$found" "$ROOT/etc/apt/"
    done
    apt-config dump | grep '^Acquire::' >"$ROOT/etc/apt/apt.conf.d/90machine" || true
    cp -L /etc/resolv.conf /etc/hosts "$ROOT/etc/"
    cp -L /etc/ssl/certs/ca-certificates.crt "$ROOT/etc/machine.crt" 2>/dev/null || true
    # Services that packages bring do not start here.
    printf '#!/bin/sh\nexit 101\n' >"$ROOT/usr/sbin/policy-rc.d"
    chmod +x "$ROOT/usr/sbin/policy-rc.d"
}

# The user, with cargo's settings of this machine, its certificates, and a clean clone.
furnish() {
    local cargo=${CARGO_HOME:-$HOME/.cargo} found
    inside root useradd --create-home --home-dir "$HOUSE" --shell /bin/bash reader
    mkdir -p "$ROOT$HOUSE/.cargo"
    # Where crates come from and how they are fetched; nothing of how they are compiled.
    for found in config.toml credentials.toml; do
        [ ! -e "$cargo/$found" ] \
            || awk '/^\[/ { on = /^\[+ *(source|registry|registries|http|net)/ } on' "$cargo/$found" >"$ROOT$HOUSE/.cargo/$found"
    done
    [ ! -e "$ROOT/etc/machine.crt" ] || mv "$ROOT/etc/machine.crt" "$ROOT/etc/ssl/certs/ca-certificates.crt"
    git clone --quiet --no-hardlinks "$PWD" "$ROOT$CHECKOUT"
    inside root chown -R reader: "$HOUSE"
}

# Variables of proxies, of certificates and of cargo's network.
carried() {
    env | grep -E '^((https?|no|all)_proxy|(HTTPS?|NO|ALL)_PROXY|SSL_CERT_(FILE|DIR)|CURL_CA_BUNDLE|CARGO_(HTTP|NET|REGISTRY|REGISTRIES|SOURCE)[A-Z_]*)=' || true
}

# Runs a command in the new system, as root or as the user in the checkout, with none but these variables.
inside() {
    local user=$1 home=/root folder=/ variables
    shift
    if [ "$user" != root ]; then
        home=$HOUSE
        folder=$CHECKOUT
    fi
    mapfile -t variables < <(carried)
    env -i "${variables[@]}" HOME="$home" USER="$user" LANG=C.UTF-8 DEBIAN_FRONTEND=noninteractive \
        PATH=/opt/rust/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
        chroot --userspec="$user:$user" "$ROOT" /bin/sh -c 'cd "$0" && exec "$@"' "$folder" "$@"
}

# `make run` as a reader does it: until it answers, then the first request, then Ctrl-C.
run_it() {
    local begin=$SECONDS request
    request=$(first_request)
    # A group of processes of its own, which Ctrl-C reaches as a whole.
    set -m
    inside reader make run &
    service=$!
    set +m
    trap 'kill -KILL -- "-$service" 2>/dev/null || true' EXIT
    until inside reader curl -sf -o /dev/null "$ADDRESS/readyz"; do
        kill -0 "$service" 2>/dev/null || return 1
        [ "$((SECONDS - begin))" -lt "$READY_SECONDS" ] || return 1
        sleep 1
    done
    echo "BARE: ready after $((SECONDS - begin)) s"
    inside reader sh -c "set -e; curl() { command curl -q -sSf \"\$@\"; }; $request" >"$PLACE/answer"
    echo "BARE: the first request of the README is answered with $(wc -c <"$PLACE/answer") bytes, $((SECONDS - begin)) s after make run"
    kill -INT -- "-$service"
    wait "$service" || true
    [ -s "$PLACE/answer" ]
    ! inside reader curl -s -o /dev/null "$ADDRESS/readyz"
}

# What is measured beside seconds.
figures() {
    local program=$ROOT$CHECKOUT/target/release/shapelex
    [ ! -e "$program" ] || say "the program has $(stat -c %s "$program") bytes"
    [ ! -d "$ROOT$CHECKOUT/target" ] || say "target has $(du -sm "$ROOT$CHECKOUT/target" | cut -f 1) MB"
}

# All that happens while folders of this machine are bound into the new system.
within() {
    mount --rbind /dev "$ROOT/dev"
    mount -t proc proc "$ROOT/proc"
    mkdir -p "$ROOT/opt/rust"
    mount --bind "$RUST" "$ROOT/opt/rust"
    mount -o remount,bind,ro "$ROOT/opt/rust"
    local wanted target
    read -ra wanted <<<"$(packages)"
    [ "${#wanted[@]}" -gt 0 ] || { say "FAILED: the README names no packages"; exit 1; }
    step "lists of packages" "$SELF" --do inside root apt-get update -qq
    step "packages of the README (${wanted[*]})" "$SELF" --do inside root apt-get install -y -qq "${wanted[@]}"
    step "checkout" "$SELF" --do furnish
    for target; do
        if [ "$target" = run ]; then
            step "make run" "$SELF" --do run_it
            sed -n 's/^BARE: //p' "$LOG"
        else
            step "make $target" "$SELF" --do inside reader make "$target"
        fi
    done
    figures
    grep -hE '^(skipped in|[0-9]+ passed)' "$LOG" || true
}

# A function of this file as a program of its own, which ends at its first failure.
if [ "${1:-}" = --do ]; then
    shift
    "$@"
    exit
fi
[ "$#" -gt 0 ] || set -- run test
[ "$(id -u)" = 0 ] || skip "which only root can make"
command -v apt-get >/dev/null || skip "there is no apt-get"
unshare --mount --pid --fork true 2>/dev/null || skip "folders cannot be bound and processes not parted here"
mkdir -p "$PLACE"
: >"$LOG"
debootstrap_here || skip "there is no debootstrap, and it cannot be installed: $(tail -1 "$LOG")"
RUST=${RUST:-$(rustc --print sysroot 2>/dev/null || true)}
export RUST ROOT
[ -x "$RUST/bin/cargo" ] || skip "there is no Rust toolchain to take; RUST names the folder of one"
command -v git >/dev/null || skip "there is no git to clone the checkout"
read -r uri release < <(archive) || skip "apt has no archive for this release"
! curl -s -o /dev/null "$ADDRESS/readyz" || skip "something listens on $ADDRESS already"
say "commit $(git rev-parse HEAD), $(date -u +%FT%TZ), $(nproc) processors, $("$RUST/bin/rustc" --version)"
rm -rf --one-file-system "$ROOT"
begin=$SECONDS
debootstrap --variant=minbase "$release" "$ROOT" "$uri" >>"$LOG" 2>&1 || skip "debootstrap makes none: $(tail -1 "$LOG")"
say "debootstrap $release: $((SECONDS - begin)) s"
step "settings of this machine" "$SELF" --do take_over
code=0
unshare --mount --propagation private --pid --fork --kill-child "$SELF" --do within "$@" || code=$?
[ -n "${KEEP:-}" ] || rm -rf --one-file-system "$ROOT"
echo "the log: $LOG"
exit "$code"
