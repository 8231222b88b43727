#!/bin/sh
# tools/check_calls.sh FOLDER: checks that no source file calls a file that calls it, directly or through others. It
# reads the object files below FOLDER (build/CMakeFiles/sherf_objects.dir). A table of functions counts as calls of
# them.
set -eu
objects=$(cd "$1" && pwd)
cd "$(dirname "$0")/.."
found=$(cd "$objects" && find src -name '*.c.o' 2>/dev/null) || true
names=$(for object in $found; do
    if [ -f "${object%.o}" ]; then echo "$object"; fi # not the object of a deleted source
done | (cd "$objects" && xargs -r nm -A -P))
if [ -z "$names" ]; then
    echo "tools/check_calls.sh: no object files below $1" >&2
    exit 1
fi
circle=$(echo "$names" | awk '
$3 ~ /^[TDBRCVW]$/ { home[$2] = $1 }
$3 ~ /^[Uvw]$/ { use[++uses] = $1 " " $2 }
END {
    for (i = 1; i <= uses; i++) {
        split(use[i], part, " ")
        if (part[2] in home && home[part[2]] != part[1]) print part[1], home[part[2]]
    }
}' | tsort 2>&1 >/dev/null | awk '
/contains a loop/ { loops++; next }
loops == 1 { sub(/^tsort: /, ""); sub(/\.o:?$/, ""); print }') || true
if [ -n "$circle" ]; then
    printf 'files that call each other in a circle:\n%s\n' "$circle" >&2
    exit 1
fi
echo "calls: no circle of files"
