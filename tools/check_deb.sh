#!/bin/sh
# tools/check_deb.sh [FOLDER]: checks the packages in FOLDER (build/deb, made by `make deb`). lintian finds no error. In
# a bare Debian 12, which mmdebstrap makes from this machine's apt sources, they install, work (debian/tests/smoke) and
# are removed without leaving anything. Run it as root, or as a user for whom mmdebstrap's unshare mode works.
set -eu
cd "$(dirname "$0")/.."
folder=$(cd "${1:-build/deb}" && pwd)
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
if ! ls "$folder"/sherf_*.deb >/dev/null 2>&1; then
    echo "tools/check_deb.sh: no packages in $folder; make deb first" >&2
    exit 1
fi

# packages.txt and debian/control must agree on the build's packages.
for package in $(sed -n 's/^build \([^ ]*\).*/\1/p' packages.txt); do
    case $package in gcc | libc6-dev | make | binutils | openmpi-bin) continue ;; esac # build-essential, or only to run
    sed -n '/^Build-Depends/,/^$/p' debian/control | grep -q "[ ]$package,$" ||
        { echo "tools/check_deb.sh: $package of packages.txt is not in debian/control" >&2; exit 1; }
done

allow=
[ "$(id -u)" != 0 ] || allow=--allow-root
# shellcheck disable=SC2086
lintian $allow --fail-on error "$folder"/*.changes

mkdir "$root/packages" "$root/source"
cp "$folder"/*.deb "$root/packages"
cp -r assets/demo "$root/source"
cp docs/example.c debian/tests/smoke "$root/source"
cat >"$root/inside" <<'INSIDE'
set -eu
export DEBIAN_FRONTEND=noninteractive
apt-get install -y -q --no-install-recommends /packages/*.deb gcc libc6-dev pkg-config
cd /source
mkdir -p assets docs
mv demo assets/
mv example.c docs/
sh ./smoke
apt-get purge -y -q sherf libsherf0 libsherf-dev sherf-assets
left=$(find / -xdev -path /proc -prune -o -path /packages -prune -o -name '*sherf*' -print |
    grep -v '^/var/log/' || true)
[ -z "$left" ] || { echo "left behind: $left" >&2; exit 1; }
! command -v sherf
echo "removed, nothing is left"
INSIDE
release=$(sed -n 's/^VERSION_CODENAME=//p' /etc/os-release)
# shellcheck disable=SC2016
mmdebstrap --variant=apt --quiet --skip=cleanup/apt/lists \
    --customize-hook="copy-in $root/packages $root/source /" \
    --customize-hook="copy-in $root/inside /" \
    --customize-hook='chroot "$1" sh /inside' "$release" /dev/null
