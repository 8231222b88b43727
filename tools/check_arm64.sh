#!/bin/sh
# tools/check_arm64.sh [TESTS]: builds for aarch64 with Debian's cross compiler and arm64 libraries, warnings as
# errors, and runs the tests whose names match TESTS (a regular expression; all of them take hours) under qemu-user.
# It runs in a Debian 12 that mmdebstrap makes from this machine's apt sources in build/arm64, which a second run
# reuses. As root.
set -eu
cd "$(dirname "$0")/.."
tests=${1:-^(base|tensor|io|motion|body|scene|sampling|nn)_}
root=build/arm64/root
release=$(sed -n 's/^VERSION_CODENAME=//p' /etc/os-release)
if [ ! -e "$root/installed" ]; then
    rm -rf build/arm64
    mkdir -p build/arm64
    mmdebstrap --variant=apt --architectures=amd64,arm64 --quiet --skip=cleanup/apt/lists "$release" "$root"
    libraries=$(sed -n 's/^[a-z]* \([^ ]*lib[^ ]*-dev\).*/\1:arm64/p' packages.txt |
        grep -v '^libc6-dev\|^libclang\|^libomp' | sort -u)
    # shellcheck disable=SC2086
    chroot "$root" env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends \
        gcc-aarch64-linux-gnu libc6-dev-arm64-cross cmake ninja-build pkg-config binutils make qemu-user-static \
        libgomp1:arm64 openmpi-bin:arm64 $libraries
    touch "$root/installed"
fi
rm -rf "$root/source"
mkdir -p "$root/source" "$root/build"
git ls-files -z | tar --null --no-recursion -cf - -T - | tar -xf - -C "$root/source"
[ ! -e assets/resnet50.safetensors ] || cp assets/resnet50.safetensors "$root/source/assets/"
cat >"$root/inside" <<'INSIDE'
set -eu
export PKG_CONFIG_LIBDIR=/usr/lib/aarch64-linux-gnu/pkgconfig:/usr/share/pkgconfig
emulator=/usr/bin/qemu-aarch64-static
cmake -G Ninja -S /source -B /build -DSHERF_WERROR=ON -DCMAKE_SYSTEM_NAME=Linux -DCMAKE_SYSTEM_PROCESSOR=aarch64 \
    -DCMAKE_C_COMPILER=aarch64-linux-gnu-gcc -DCMAKE_OBJCOPY=aarch64-linux-gnu-objcopy \
    -DCMAKE_LIBRARY_ARCHITECTURE=aarch64-linux-gnu -DCMAKE_FIND_ROOT_PATH=/usr/lib/aarch64-linux-gnu \
    -DCMAKE_CROSSCOMPILING_EMULATOR=$emulator
ninja -C /build
OMP_NUM_THREADS=1 ctest --test-dir /build -j "$(nproc)" --output-on-failure -R "$1"
INSIDE
unshare --mount sh -c "mount --bind /proc '$root/proc' && exec chroot '$root' sh /inside \"\$1\"" inside "$tests"
