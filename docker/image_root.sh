#!/bin/sh
# Puts together the root folder of the image: image_root.sh PROGRAM FOLDER
#
# The program, the shared libraries that it names, the root certificates, a user, empty /data and /tmp. Every file gets
# the time SOURCE_DATE_EPOCH, so that equal inputs give equal images.
set -eu

program=$1
root=$2
epoch=${SOURCE_DATE_EPOCH:-0}

mkdir -p "$root/usr/local/bin" "$root/etc/ssl/certs" "$root/var/lib/dpkg/status.d"
install -m 0555 "$program" "$root/usr/local/bin/$(basename "$program")"

# Libraries lie where the loader looks for them; the names of their packages stay readable for scanners.
ldd "$program" | grep -o '/[^ ]*' | sort -u | while read -r library; do
    install -D -m 0555 "$library" "$root$library"
    # A library may be listed under /lib or under the folder that /lib is a link to.
    owner=$(dpkg -S "$library" 2> /dev/null || dpkg -S "$(realpath "$library")")
    package=${owner%%:*}
    dpkg -s "$package" > "$root/var/lib/dpkg/status.d/$package"
done

install -m 0444 /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/ca-certificates.crt"
dpkg -s ca-certificates > "$root/var/lib/dpkg/status.d/ca-certificates"
echo 'shapelex:x:65532:65532::/data:/sbin/nologin' > "$root/etc/passwd"
echo 'shapelex:x:65532:' > "$root/etc/group"
echo 'hosts: files dns' > "$root/etc/nsswitch.conf"

install -d -m 0700 -o 65532 -g 65532 "$root/data"
install -d -m 1777 "$root/tmp"
find "$root" -exec touch --no-dereference --date="@$epoch" {} +
