#!/bin/sh
# tests/cli/dist.sh: tests that the source archive has the same bytes twice, whatever the time, time zone and umask,
# contains every file of the commit, and names no user as the owner. Exit status 77: there is no git checkout.
set -eu
here=$(cd "$(dirname "$0")/../.." && pwd)
cd "$here"
fail() { echo "dist.sh: $*" >&2; exit 1; }
command -v git >/dev/null && [ -e .git ] && git rev-parse HEAD >/dev/null 2>&1 ||
    { echo "skipped: there is no git checkout"; exit 77; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

(umask 0077 && TZ=Asia/Tokyo tools/dist.sh "$work/one" >"$work/log" 2>&1) || fail "$(cat "$work/log")"
sleep 1
(umask 0002 && TZ=UTC LC_ALL=C tools/dist.sh "$work/two" >"$work/log" 2>&1) || fail "$(cat "$work/log")"
archive=$(basename "$work"/one/sherf-*.tar.gz)
cmp "$work/one/$archive" "$work/two/$archive" || fail "two archives of one commit differ"
(cd "$work/two" && sha256sum --check --quiet "$archive.sha256") || fail "the sha256 is another file's"

name=${archive%.tar.gz}
tar -tvzf "$work/one/$archive" >"$work/list"
awk '$2 != "root/root"' "$work/list" | grep . && fail "files have an owner"
awk '{print $6}' "$work/list" | sed -n "s|^$name/\(.*[^/]\)$|\1|p" | sort >"$work/packed"
git ls-tree -r --name-only HEAD | sort >"$work/committed"
cmp "$work/packed" "$work/committed" || fail "the archive does not hold the files of the commit"
echo "the same bytes twice, $(wc -l <"$work/packed") files"
