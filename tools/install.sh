#!/bin/sh
# tools/install.sh GROUP...: installs the missing packages of these groups of packages.txt.
set -eu
cd "$(dirname "$0")/.."
groups=" $* "
wanted=
while read -r group package _; do
    case $groups in *" $group "*) wanted="$wanted $package" ;; esac
done <packages.txt
# shellcheck disable=SC2086
installed=" $(dpkg-query -W -f '${Package}=${Status} ' $wanted 2>/dev/null | tr '\n' ' ') "
missing=
for package in $wanted; do
    case $installed in *" $package=install ok installed "*) continue ;; esac
    # A program from another source is accepted: Node.js from elsewhere includes npm and conflicts with Debian's.
    command -v "$package" >/dev/null || missing="$missing $package"
done
[ -n "$missing" ] || exit 0
echo "installing:$missing"
root=
if [ "$(id -u)" != 0 ]; then
    command -v sudo >/dev/null ||
        { echo "tools/install.sh: not root and no sudo; install these by hand:$missing" >&2; exit 1; }
    root=sudo
fi
# The package lists may be missing or old: fetch them, and continue with the present ones if that fails.
$root apt-get update -q </dev/null || true
# shellcheck disable=SC2086
$root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $missing </dev/null
