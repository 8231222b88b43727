#!/bin/sh
# tests/cli/installed.sh BUILD: tests an installation in a temporary folder as a new user would: compiles docs/example.c
# with pkg-config (C, C++, shared, static) and with find_package, runs it, and examines the exported names.
set -eu
build=$1
here=$(cd "$(dirname "$0")/../.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { echo "installed.sh: $*" >&2; exit 1; }

usr="$work/a prefix" # contains a space
cmake --install "$build" --prefix "$usr" >"$work/install.log"
lib=$(dirname "$(find "$usr" -name libsherf.a)")
for file in bin/sherf include/sherf/sherf.h share/man/man1/sherf.1 share/man/man1/sherf-render.1 \
    share/sherf/body.safetensors share/sherf/models/people.safetensors share/sherf/models/blazepose.safetensors \
    share/sherf/LICENSES.md share/bash-completion/completions/sherf share/zsh/site-functions/_sherf; do
    [ -s "$usr/$file" ] || fail "$file was not installed"
done
export PKG_CONFIG_PATH="$lib/pkgconfig"
version=$(pkg-config --modversion sherf)
[ "$("$usr/bin/sherf" --version)" = "sherf $version" ] || fail "the program and sherf.pc differ in version"

soname=$(readelf -d "$lib/libsherf.so" | sed -n 's/.*soname: \[\(.*\)\]/\1/p')
[ "$soname" = libsherf.so.0 ] && [ -e "$lib/$soname" ] || fail "libsherf.so has the soname '$soname'"

others=$(nm -D --defined-only "$lib/libsherf.so" | awk '$2 != "A" {print $3}' | grep -v '^sherf_' || true)
[ -z "$others" ] || fail "libsherf.so shows" $others
others=$(nm -g --defined-only "$lib/libsherf.a" | awk 'NF == 3 {print $3}' | grep -v '^sherf_' || true)
[ -z "$others" ] || fail "libsherf.a shows" $others

# pkg-config quotes the space, so its output must be evaluated.
eval "cc -std=c11 -Wall -Wextra -Werror '$here/docs/example.c' $(pkg-config --cflags --libs sherf) -o '$work/example'"
# Our static library with other projects' shared libraries: --static would ask for their static ones too.
eval "cc -std=c11 '$here/docs/example.c' $(pkg-config --cflags sherf) '$lib/libsherf.a' \
    $(pkg-config --libs $(pkg-config --print-requires-private sherf)) \
    $(sed -n 's/^Libs.private: //p' "$lib/pkgconfig/sherf.pc") \
    -o '$work/example-static'"
eval "c++ -std=c++20 -Wall -x c++ '$here/docs/example.c' -x none \
    $(pkg-config --cflags --libs sherf) -o '$work/example-cxx'"
# find_package: the installation is moved first, because nothing in it may name the original folder.
find_package() { # PREFIX VERSION
    cmake -S "$here/tests/cli/find_package" -B "$work/found" -D EXAMPLE="$here/docs/example.c" \
        -D CMAKE_PREFIX_PATH="$1" -D WANTED="$2" >"$work/cmake.log" 2>&1
}
mv "$usr" "$usr moved"
find_package "$usr moved" "$version" || fail "find_package(sherf $version) fails: $(cat "$work/cmake.log")"
cmake --build "$work/found" >"$work/cmake.log" 2>&1 || fail "$(cat "$work/cmake.log")"
[ "$(cat "$work/found/found")" = "$usr moved/bin/sherf
$usr moved/share/sherf" ] || fail "find_package says of program and assets:" "$(cat "$work/found/found")"
cp "$work/found/example-sherf" "$work/example-found"
cp "$work/found/example-static" "$work/example-found-static"
mv "$usr moved" "$usr"
rm -r "$work/found"
! find_package "$usr" 99 || fail "find_package(sherf 99) finds this version"

eval "cc -std=c11 '$here/tests/cli/make_model.c' $(pkg-config --cflags --libs sherf) -o '$work/make_model'"

export LD_LIBRARY_PATH="$lib"
"$work/make_model" "$work/model.safetensors"
"$usr/bin/sherf" synth tube -q -o "$work/people" --people 1 --poses 1 --views 4 --size 64
person=$(head -n 1 "$work/people/human_list.txt")
for example in example example-static example-cxx example-found example-found-static; do
    "$work/$example" "$work/people/tubeman.safetensors" "$work/model.safetensors" \
        "thuman:$work/people#$person/0/0" "$work/$example.png"
    [ -s "$work/$example.png" ] || fail "$example wrote no picture"
    cmp "$work/example.png" "$work/$example.png"
done
! "$work/example" "$work/none" b c d 2>"$work/error" || fail "a missing body was accepted"
grep -q "$work/none" "$work/error" || fail "the message does not name the file"
echo "installed, compiled, ran"
