#!/bin/sh
# tools/needs.sh FILE: lists the Debian packages of the libraries with which FILE is linked, one per line.
set -eu
for name in $(readelf -d "$1" | sed -n 's/.*NEEDED.*\[\(.*\)\]/\1/p'); do
    file=$(/sbin/ldconfig -p |
        sed -n "s|^[[:space:]]*$name .*x86-64.* => ||p; s|^[[:space:]]*$name .* => ||p" | head -n 1)
    dpkg -S "$file" 2>/dev/null || dpkg -S "/usr$file"
done | cut -d : -f 1 | sort -u
