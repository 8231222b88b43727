#!/bin/sh
# tools/dist.sh [FOLDER]: writes the last commit as FOLDER/sherf-VERSION.tar.gz (FOLDER: ./build/dist), with its sha256
# beside it. The same commit gives the same bytes: times are the commit's, owners are root, the order is git's.
set -eu
cd "$(dirname "$0")/.."
folder=${1:-build/dist}
git rev-parse --quiet --verify 'HEAD^{commit}' >/dev/null 2>&1 && [ -e .git ] ||
    { echo "tools/dist.sh: this is no git checkout, and only a commit gives the same bytes every time" >&2; exit 1; }
version=$(sed -n 's/^project(sherf VERSION \([0-9.]*\) .*/\1/p' CMakeLists.txt)
[ -n "$version" ] || { echo "tools/dist.sh: CMakeLists.txt names no version" >&2; exit 1; }
changed=$(git status --porcelain | wc -l)
[ "$changed" = 0 ] || echo "tools/dist.sh: changes in $changed files are not committed and not in the archive" >&2
name=sherf-$version
mkdir -p "$folder"
part=$folder/.$name.part
trap 'rm -f "$part" "$part.gz"' EXIT
git -c tar.umask=0022 -c core.autocrlf=false archive --format=tar --prefix="$name/" -o "$part" HEAD
gzip -n "$part"
mv "$part.gz" "$folder/$name.tar.gz"
(cd "$folder" && sha256sum "$name.tar.gz" >"$name.tar.gz.sha256")
echo "$folder/$name.tar.gz: $(cut -c 1-64 "$folder/$name.tar.gz.sha256")"
