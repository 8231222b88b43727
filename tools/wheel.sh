#!/bin/sh
# tools/wheel.sh BUILD: makes the Python wheel of BUILD's library with the shipped assets,
# BUILD/wheel/sherf-VERSION-*.whl. It uses Debian's Python and fetches nothing. The wheel contains no other project's
# library; lib/needs.txt names their packages.
set -eu
cd "$(dirname "$0")/.."
build=$(cd "$1" && pwd)
library=$build/libsherf.so.0
[ -e "$library" ] || { echo "tools/wheel.sh: $library is not there; make program first" >&2; exit 1; }
stage=$build/wheel/stage
rm -rf "$stage"
mkdir -p "$stage/sherf/lib" "$stage/sherf/assets/models"
cp python/pyproject.toml python/setup.py "$stage"
cp python/sherf/*.py python/sherf/py.typed "$stage/sherf"
cp LICENSE "$stage"
strip -g -o "$stage/sherf/lib/libsherf.so.0" "$library"
cp assets/body.safetensors assets/LICENSES.md "$stage/sherf/assets"
cp assets/models/people.safetensors assets/models/blazepose.safetensors "$stage/sherf/assets/models"

tools/needs.sh "$library" >"$stage/sherf/lib/needs.txt"

rm -f "$build"/wheel/*.whl
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || echo 1700000000)} \
    /usr/bin/python3 -m pip --disable-pip-version-check wheel --quiet --no-index --no-deps --no-build-isolation \
    -w "$build/wheel" "$stage" >"$build/wheel/log" 2>&1 || { cat "$build/wheel/log" >&2; exit 1; }
rm -rf "$stage"
ls "$build"/wheel/*.whl
