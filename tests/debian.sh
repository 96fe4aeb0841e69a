#!/bin/sh
# Installs packages of Debian. One caller at a time: steps that run side by side may want some at once, and apt-get refuses the second.
#
#   tests/debian.sh [OPTION…] PACKAGE…    ends with 1 where they cannot be had, with a line that says why
set -eu

[ "$(id -u)" = 0 ] || { echo "only root may install it"; exit 1; }
command -v apt-get >/dev/null || { echo "there is no apt-get"; exit 1; }
# Held until this ends. Where there is no flock, nothing but tests that run alone installs anything.
exec 9>"${TMPDIR:-/tmp}/shapelex-debian.lock"
! command -v flock >/dev/null || flock 9
export DEBIAN_FRONTEND=noninteractive
said=$( (apt-get update -qq && apt-get install -y -qq "$@") 2>&1 9>&-) || { echo "it cannot be installed: $(echo "$said" | tail -1)"; exit 1; }
