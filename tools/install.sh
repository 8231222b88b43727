#!/bin/sh
# tools/install.sh GROUP...: installs the packages of these groups of packages.txt that are missing.
set -eu
cd "$(dirname "$0")/.."
groups=" $* "
missing=
while read -r group package _; do
    case $groups in *" $group "*) ;; *) continue ;; esac
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q '^install ok installed$' ||
        missing="$missing $package"
done <packages.txt
[ -n "$missing" ] || exit 0
echo "installing:$missing"
root=
if [ "$(id -u)" != 0 ]; then
    command -v sudo >/dev/null || { echo "tools/install.sh: not root and no sudo; install these by hand:$missing" >&2; exit 1; }
    root=sudo
fi

# shellcheck disable=SC2086
install() { $root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $missing </dev/null; }
# The package lists may be absent or old: fetch them, and go on with what is there should that fail.
$root apt-get update -q </dev/null || true
install
