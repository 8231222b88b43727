#!/bin/sh
# tools/deb.sh [FOLDER]: makes Debian packages of the last commit, source and binary, in FOLDER (build/deb): sherf,
# libsherf0, libsherf-dev and sherf-assets, as a Release build of the archive that `make dist` writes.
# tools/check_deb.sh tests them.
set -eu
cd "$(dirname "$0")/.."
folder=${1:-build/deb}
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
tools/dist.sh "$folder/dist"
version=$(sed -n 's/^project(sherf VERSION \([0-9.]*\) .*/\1/p' CMakeLists.txt)
case $(sed -n '1s/^sherf (\(.*\)) .*/\1/p' debian/changelog) in
"$version"-*) ;;
*)
    echo "tools/deb.sh: the first entry of debian/changelog is not of version $version of CMakeLists.txt" >&2
    exit 1
    ;;
esac
rm -rf "$folder/sherf-$version" "$folder"/*.deb "$folder"/sherf_*
mv "$folder/dist/sherf-$version.tar.gz" "$folder/sherf_$version.orig.tar.gz"
rm -r "$folder/dist"
tar -C "$folder" -xf "$folder/sherf_$version.orig.tar.gz"
(cd "$folder/sherf-$version" && dpkg-buildpackage -us -uc) >"$folder/log" 2>&1 || {
    tail -n 40 "$folder/log" >&2
    echo "tools/deb.sh: the build failed, all of it is in $folder/log" >&2
    exit 1
}
rm -rf "$folder/sherf-$version"
ls "$folder"/*.deb
