#!/bin/sh
# tools/demo.sh SHERF FOLDER: the demo. A photo (assets/demo/photo.jpg, a made person of MakeHuman's CC0 parts in a made
# place, docs/people.md) becomes an avatar that turns, walks and takes poses. A second photo adds its back. Another made
# person, who has true pictures from other sides, is scored against them. The shipped model saw neither person.
set -eu
sherf=$1
out=$2
photo=assets/demo/photo.jpg

step() { printf '\n== %s\n   %s\n' "$1" "$2"; }
run() {
    echo "\$ sherf $*"
    "$sherf" "$@"
}

rm -rf "$out"
mkdir -p "$out"
cp "$photo" "$out/photo.jpg"
step "1. avatar" "of the person in $out/photo.jpg: found, cut out, a body fitted ($out/overlay.png), encoded"
run avatar "$out/photo.jpg" -o "$out/avatar.safetensors" --overlay "$out/overlay.png"
step "2. turntable" "the avatar from all round"
run render "$out/avatar.safetensors" --orbit 36 --elevation 8 --size 320 --background 0.93,0.93,0.93 --fps 12 \
    -o "$out/turntable.mp4" --strip "$out/turntable.png"
step "3. both sides" "a photo of the back as well ($out/photo-back.jpg): what one does not show the other does"
cp assets/demo/photo-back.jpg "$out/photo-back.jpg"
run avatar "$out/photo.jpg" "$out/photo-back.jpg" -o "$out/both.safetensors"
run render "$out/both.safetensors" --orbit 36 --elevation 8 --size 320 --background 0.93,0.93,0.93 --fps 12 \
    -o "$out/both.mp4" --strip "$out/both.png"
step "4. walk" "in poses that no picture showed"
tools/walk.sh 24 >"$out/walk.json"
run render "$out/avatar.safetensors" --poses "$out/walk.json" --orbit 1 --azimuth 35 --elevation 8 --size 320 \
    --background 0.93,0.93,0.93 --fps 12 -o "$out/walk.mp4" --strip "$out/walk.png"
step "5. poses" "arms up, akimbo, sitting, a lunge: from two sides"
run render "$out/avatar.safetensors" --poses assets/demo/poses.json --every --orbit 2 --azimuth 25 --elevation 8 \
    --size 320 --background 0.93,0.93,0.93 -o "$out/poses" --strip "$out/poses.png"
step "6. scores" \
    "another person from one picture, against true pictures from other sides, beside what no network would get"
run eval --data thuman:assets/demo --people person_900006 --observation 0:2 --poses 0,1 --views 0,1,3 --size 256 \
    --baselines -o "$out/eval"
printf '\nmade: %s\n' "$out/overlay.png $out/turntable.mp4 $out/turntable.png $out/both.mp4 \
$out/both.png $out/walk.mp4 $out/walk.png $out/poses.png $out/poses/ $out/eval/"
