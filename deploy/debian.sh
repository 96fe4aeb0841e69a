#!/usr/bin/env bash
# Makes a Debian package of a program that is built: the program, the unit of systemd, its settings, man pages, completions, licences.
#
#   deploy/debian.sh BINARY [OUT]    OUT: the folder of the package, by default target/packages
#
# LICENCES and SBOM name the files of deploy/licences.py and deploy/sbom.py, which are added where they are given. The package asks for the C
# library whose symbols the program uses. The program runs on this machine, to write its man pages. The same inputs give the same bytes.
set -euo pipefail

binary=$(realpath "${1:?usage: deploy/debian.sh BINARY [OUT]}")
out=$(realpath -m "${2:-$(dirname "$0")/../target/packages}")
cd "$(dirname "$0")/.."
for tool in dpkg-deb gzip install python3 readelf; do
    command -v "$tool" >/dev/null || { echo "expected $tool, got none" >&2; exit 1; }
done
export SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-315532800}

said=$(python3 deploy/program.py "$binary")
told() { sed -n "s/^$1 //p" <<<"$said"; }
case "$(told machine)" in
x86_64) architecture=amd64 ;;
aarch64) architecture=arm64 ;;
esac
version=$(told version)

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
root=$work/shapelex
doc=$root/usr/share/doc/shapelex
umask 022
install -D -m 0755 "$binary" "$root/usr/bin/shapelex"
install -d -m 0755 "$root/lib/systemd/system"
sed 's|/usr/local/bin/|/usr/bin/|' deploy/systemd/shapelex.service >"$root/lib/systemd/system/shapelex.service"
install -D -m 0644 deploy/systemd/shapelex.toml "$root/etc/shapelex/shapelex.toml"

"$binary" man "$root/usr/share/man/man1" >/dev/null
find "$root/usr/share/man" -type f -exec gzip -9n {} +
install -d "$root/usr/share/bash-completion/completions" "$root/usr/share/zsh/vendor-completions"
"$binary" completions bash >"$root/usr/share/bash-completion/completions/shapelex"
"$binary" completions zsh >"$root/usr/share/zsh/vendor-completions/_shapelex"

install -d "$doc"
gzip -9nc CHANGELOG.md >"$doc/changelog.gz"
{
    printf 'Shapelex is licensed under Apache-2.0 or MIT, at your choice.\n\n'
    cat LICENSE-MIT
    printf '\nThe Apache License 2.0 is /usr/share/common-licenses/Apache-2.0. Components of the program: licences.txt.gz beside this file.\n'
} >"$doc/copyright"
[ -z "${LICENCES:-}" ] || gzip -9nc "$LICENCES" >"$doc/licences.txt.gz"
[ -z "${SBOM:-}" ] || install -m 0644 "$SBOM" "$doc/sbom.cdx.json"

install -d "$root/DEBIAN"
echo /etc/shapelex/shapelex.toml >"$root/DEBIAN/conffiles"
cat >"$root/DEBIAN/control" <<END
Package: shapelex
Version: $version
Architecture: $architecture
Maintainer: Shapelex <root@localhost>
Installed-Size: $(du -sk --exclude DEBIAN "$root" | cut -f 1)
Depends: libc6 (>= $(told glibc)), libgcc-s1
Recommends: ca-certificates
Section: science
Priority: optional
Description: Shape statistics as a service
 Programs post contours, curves, surfaces or landmarks over HTTP; the service
 returns alignments, mean shapes, components, tests and classes.
END
# The user owns the store. The service is not started by the installation: its settings and its first key come before.
cat >"$root/DEBIAN/postinst" <<'END'
#!/bin/sh
set -e
if [ "$1" = configure ]; then
    getent passwd shapelex >/dev/null || useradd --system --user-group --home-dir /var/lib/shapelex --shell /usr/sbin/nologin shapelex
    [ ! -d /run/systemd/system ] || systemctl daemon-reload
fi
END
cat >"$root/DEBIAN/prerm" <<'END'
#!/bin/sh
set -e
if [ "$1" = remove ] && [ -d /run/systemd/system ]; then
    systemctl disable --now shapelex
fi
END
# The store stays, whatever is removed: only its owner deletes it.
cat >"$root/DEBIAN/postrm" <<'END'
#!/bin/sh
set -e
[ ! -d /run/systemd/system ] || systemctl daemon-reload
END
chmod 0755 "$root/DEBIAN/postinst" "$root/DEBIAN/prerm" "$root/DEBIAN/postrm"
find "$root" -exec touch --no-dereference --date="@$SOURCE_DATE_EPOCH" {} +
mkdir -p "$out"
# xz would make it a third smaller, in many times the time.
dpkg-deb --root-owner-group -Zgzip --build "$root" "$out/shapelex_${version}_$architecture.deb" >/dev/null
echo "$out/shapelex_${version}_$architecture.deb: $(stat -c %s "$out/shapelex_${version}_$architecture.deb") bytes"
