# SPDX-License-Identifier: Apache-2.0
# The front door. Every target does its own set-up (as root; otherwise it says what to install).
#   make demo    the Driving Case on an emulated Orin under four policies: table, numbers, picture
#   make paper   section 6 of the paper, figure by figure, beside ours: build/paper/index.html
#   make check   everything that must pass
JOBS ?= $(shell nproc)
BUILD ?= build

all: build

build: setup
	@cmake --preset release >$(BUILD)-configure.log 2>&1 || { cat $(BUILD)-configure.log; exit 1; }
	@rm -f $(BUILD)-configure.log
	@ninja -C build -j$(JOBS)

demo:
	@scripts/setup.sh build
	@JOBS=$(JOBS) scripts/demo.sh

pedestrians:
	@scripts/setup.sh build pedestrians
	@JOBS=$(JOBS) scripts/pedestrians.sh

# Real nets over the same video: faces and lines by ONNX Runtime.
perception:
	@scripts/setup.sh build pedestrians
	@JOBS=$(JOBS) scripts/perception.sh

check:
	@scripts/setup.sh build check transport pedestrians kernel package
	@scripts/vm/fetch-source.sh >/dev/null
	@scripts/fetch-mcap-core.sh || true # its test is skipped then, and says so
	@scripts/fetch-onnx.sh || true # likewise, with the video
	@scripts/fetch-video.sh || true
	@JOBS=$(JOBS) scripts/check.sh check

# Less, for the inner loop, and more: every test in every build, every kernel, the largest worlds (hours).
check-fast:
	@scripts/setup.sh build check transport
	@JOBS=$(JOBS) scripts/check.sh fast

check-full:
	@scripts/setup.sh build check transport pedestrians kernel kernel-build kernel-arm64 package jetpack
	@scripts/fetch-video.sh
	@scripts/vm/fetch-source.sh >/dev/null
	@scripts/fetch-mcap-core.sh || true
	@scripts/fetch-onnx.sh || true
	@JOBS=$(JOBS) scripts/check.sh full

# Parts of check, each by itself.
style unit asan tsan fuzz:
	@scripts/setup.sh build check transport
	@JOBS=$(JOBS) scripts/check.sh $@

# The kernel side alone: xauto.ko and the emulator modules on several Debian kernels, in QEMU.
kernel-check:
	@scripts/setup.sh build check kernel
	@scripts/vm/fetch-source.sh >/dev/null
	@JOBS=$(JOBS) scripts/check.sh kernel

# Debian packages of the release build, in build/package/debs. For another machine: make packages ARCH=arm64; for a Jetson: ARCH=jetpack
ARCH ?=
packages:
	@scripts/setup.sh build kernel package
	@JOBS=$(JOBS) scripts/packages.sh $(ARCH)

# ... and whether they install, work and go away again in a clean Debian root.
package-check:
	@scripts/setup.sh build check kernel package
	@JOBS=$(JOBS) scripts/check.sh package

# The modules for the running kernel, or for KERNEL=/path/to/its/build/tree.
KERNEL ?= /lib/modules/$(shell uname -r)/build
modules:
	@$(MAKE) -C $(KERNEL) M=$(CURDIR) modules

bench:
	@scripts/setup.sh build bench transport
	@JOBS=$(JOBS) scripts/bench.sh $(if $(QUICK),--quick)

# Section 6 of the paper, its figures beside ours: build/paper/index.html. 20 minutes; QUICK=1: half a minute, to see that it
# works; paper-full: every DAG, long limits, hours.
paper paper-full:
	@scripts/setup.sh build
	@cmake --preset release >/dev/null
	@ninja -C build -j$(JOBS) xauto xauto-coordinator xauto-emud xauto-standin bench_paper bench_runtime bench_synthetic
	@python3 scripts/paper.py $(if $(QUICK),--quick,$(if $(filter paper-full,$@),--full))

# Whether the oldest tools that we promise (docs/dependencies.md) build it, and it works: in a Debian 11 root.
floor-check:
	@scripts/setup.sh build package
	@JOBS=$(JOBS) scripts/check.sh floor

# The packages for a Jetson: what they need, their programs emulated, and an arm64 machine with systemd and DKMS.
jetpack-check:
	@scripts/setup.sh build kernel package jetpack
	@JOBS=$(JOBS) scripts/check.sh jetpack

# The API's reference: build/docs/html/index.html.
docs:
	@scripts/setup.sh check
	@scripts/check-api-docs.sh
	@echo "build/docs/html/index.html"

format:
	@scripts/setup.sh check
	@scripts/sources.sh | xargs clang-format -i

# clang-tidy, by .clang-tidy: half an hour. After a build, since some headers are generated.
tidy:
	@scripts/setup.sh build check
	@cmake --preset debug >/dev/null && ninja -C build-debug -j$(JOBS)
	@JOBS=$(JOBS) scripts/check-tidy.sh --all

setup:
	@scripts/setup.sh build

clean:
	@rm -rf build build-debug build-asan build-tsan build-fuzz

.PHONY: all build demo pedestrians perception check check-fast check-full kernel-check packages package-check floor-check jetpack-check modules style unit asan tsan fuzz bench paper paper-full docs format tidy setup clean
