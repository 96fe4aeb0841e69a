#!/bin/sh
# Names what is missing before anything is built.
#
#   tests/needs.sh cargo cc …   ends with 1 where one of these tools is missing, with a line for each
#   tests/needs.sh --install    installs all that `make test-all` builds with: as root by apt-get, and by rustup
set -eu

# Whether a tool is here; a compiler without the headers of its library compiles nothing.
has() {
    case $1 in
    rustfmt) cargo fmt --version ;;
    clippy) cargo clippy --version ;;
    cc) command -v cc && echo '#include <stdlib.h>' | cc -x c -fsyntax-only - ;;
    c++) command -v c++ && echo '#include <cstdlib>' | c++ -x c++ -fsyntax-only - ;;
    *) command -v "$1" ;;
    esac >/dev/null 2>&1
}

# What a tool is for, and where it comes from.
origin() {
    case $1 in
    cargo) echo "the Rust compiler: https://rustup.rs" ;;
    rustfmt | clippy) echo "the format and the lints: rustup component add $1" ;;
    cc) echo "a C compiler with the headers of its library, for SQLite and the cryptography; Debian: gcc libc6-dev" ;;
    c++) echo "a C++ compiler, for the fuzz targets; Debian: g++" ;;
    make) echo "builds the allocator; Debian: make" ;;
    curl) echo "runs the commands of the README; Debian: curl" ;;
    *) echo "Debian: $1" ;;
    esac
}

install() {
    packages=
    has cc || packages="$packages gcc libc6-dev"
    has c++ || packages="$packages g++"
    has make || packages="$packages make"
    has curl || packages="$packages curl ca-certificates"
    if [ -n "$packages" ]; then
        if [ "$(id -u)" != 0 ] || ! has apt-get; then
            echo "expected$packages here, or apt-get and the rights of root to install them" >&2
            exit 1
        fi
        apt-get update -qq
        # shellcheck disable=SC2086  # one word for each package
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $packages
    fi
    has rustfmt || rustup component add rustfmt
    has clippy || rustup component add clippy
}

if [ "${1:-}" = --install ]; then
    install
    exit
fi
missing=0
for tool; do
    has "$tool" && continue
    missing=1
    echo "MISSING: $tool ($(origin "$tool"))" >&2
done
exit "$missing"
