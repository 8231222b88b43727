#!/bin/sh
# tools/train_tubes.sh SHERF FOLDER: makes an animated person from nothing, not even the shipped model. It makes tube
# people, trains a small model on all except the last for about five minutes, makes an avatar of the last from one
# picture, renders it from all sides and walking, and scores it against the truth.
set -eu
sherf=$1
out=$2
seconds=${TRAIN_SECONDS:-300}
people=$out/people
body=$people/tubeman.safetensors
model=$out/run/model.safetensors
last=7
held_out=$(printf 'tube_%03d' $last)

step() { printf '\n== %s\n   %s\n' "$1" "$2"; }
run() {
    echo "\$ sherf $*"
    "$sherf" "$@"
}

rm -rf "$out"
mkdir -p "$out"
step "1. tube people" "8 of them in 6 poses, seen by 24 cameras"
run synth tube -o "$people" --people 8 --poses 6 --views 24 --size 256
step "2. training" "the preset small on people 0 to 6, for $seconds seconds"
run train --data "thuman:$people" --people "0-$((last - 1))" --body "$body" --preset small --size 128 --batch 1 \
    --seconds "$seconds" -o "$out/run"
step "3. avatar" "of $held_out, who was not in training, from one picture"
run avatar "thuman:$people#$held_out/0/12" --model "$model" --body "$body" -o "$out/avatar.safetensors"
step "4. turntable" "the avatar from all round"
run render "$out/avatar.safetensors" --body "$body" --orbit 72 --elevation 10 --size 256 \
    -o "$out/turntable.mp4" --strip "$out/turntable.png"
step "5. walking" "the avatar in poses it was never seen in"
tools/walk.sh 48 >"$out/walk.json"
run render "$out/avatar.safetensors" --body "$body" --poses "$out/walk.json" --orbit 1 --azimuth 30 --elevation 10 \
    --size 256 -o "$out/walk.mp4" --strip "$out/walk.png"
step "6. scores" "against the true pictures of $held_out"
run eval --data "thuman:$people" --people "$held_out" --model "$model" --body "$body" --observation 0:12 \
    --poses 0,1,2,3,4,5 --views 0:2:12 -o "$out/eval"
printf '\nmade: %s\n' "$out/turntable.mp4 $out/turntable.png $out/walk.mp4 $out/walk.png $out/eval/"
