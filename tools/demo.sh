#!/bin/sh
# tools/demo.sh SHERF FOLDER: one picture of a person the shipped model never saw (assets/demo, a made one of
# MakeHuman's CC0 parts, docs/people.md) becomes an avatar that is turned, walked and posed, and is scored against
# true pictures.
set -eu
sherf=$1
out=$2
data=thuman:assets/demo
person=person_900006
export OMP_WAIT_POLICY=passive

step() { printf '\n== %s\n   %s\n' "$1" "$2"; }
run() {
    echo "\$ sherf $*"
    "$sherf" "$@"
}

rm -rf "$out"
mkdir -p "$out"
cp "assets/demo/$person/view02/000000.png" "$out/observation.png"
step "1. avatar" "of $person, from the one picture $out/observation.png"
run avatar "$data#$person/0/2" -o "$out/avatar.safetensors"
step "2. turntable" "the avatar from all round"
run render "$out/avatar.safetensors" --orbit 72 --elevation 8 --size 320 -o "$out/turntable.mp4" --strip "$out/turntable.png"
step "3. walk" "in poses that no picture showed"
tools/walk.sh 48 >"$out/walk.json"
run render "$out/avatar.safetensors" --poses "$out/walk.json" --orbit 1 --azimuth 35 --elevation 8 --size 320 \
    -o "$out/walk.mp4" --strip "$out/walk.png"
step "4. poses" "arms up, akimbo, sitting, a lunge: from two sides"
run render "$out/avatar.safetensors" --poses assets/demo/poses.json --every --orbit 2 --azimuth 25 --elevation 8 --size 320 \
    -o "$out/poses" --strip "$out/poses.png"
step "5. scores" "against the true pictures of $person, beside what no network would get"
run eval --data "$data" --people "$person" --observation 0:2 --poses 0,1,2 --views 0,1,2,3 --size 256 --yardsticks \
    -o "$out/eval"
printf '\nmade: %s\n' "$out/turntable.mp4 $out/turntable.png $out/walk.mp4 $out/walk.png $out/poses.png $out/poses/ $out/eval/"
