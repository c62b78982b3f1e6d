#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Whether XAuto builds and works with the oldest tools that it promises: Debian 11's GCC 10, CMake 3.18, json 3.9, fmt 7.1, spdlog 1.8,
# protobuf 3.12, glibc 2.31. Each is older than Ubuntu 22.04's (JetPack 6). Without BPF: its tools are newer anywhere.
# usage: floor-check.sh [OUT]     OUT: default build/floor. Prints TAP and a last line "N passed, M failed, K skipped"
set -uo pipefail
export root
root=$(realpath "$(dirname "$0")/..")
cd "$root" || exit 2
. tests/package/tap.sh
if [ "${1:-}" != --inside ]; then
  out=$(realpath -m "${1:-build/floor}")
  if [ "$(id -u)" -ne 0 ] || ! unshare --mount --pid --fork true 2>/dev/null; then
    echo "floor-check: skipped: another root needs mount and PID namespaces: run it as root, in a container with CAP_SYS_ADMIN" >&2
    echo "0 passed, 0 failed, 1 skipped"
    exit 0
  fi
  mkdir -p "$out"
  timeout -k 10 3600 unshare --mount --propagation private --pid --fork --kill-child --mount-proc \
    "$0" --inside "$out" </dev/null 2>&1 | tee "$out/check.log"
  total "$out/check.log" "${PIPESTATUS[0]}"
  exit
fi

{ # read whole before it runs: the file may be edited meanwhile
out=$2
floor=$out/root
within() { chroot "$floor" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 CCACHE_DIR=/build/ccache "$@"; }
make_root() {
  rm -rf --one-file-system "$floor"
  mkdir -p "$floor" "$out/build"
  tar -xf "$(scripts/package-root.sh floor)" -C "$floor"
  mkdir -p "$floor/source" "$floor/build"
  mount --bind "$root" "$floor/source"
  mount -o remount,ro,bind "$floor/source"
  mount --bind "$out/build" "$floor/build"
  mount -t proc proc "$floor/proc"
  mount -t sysfs sysfs "$floor/sys"
  mount --rbind /dev "$floor/dev"
}
configure() {
  within cmake -G Ninja -S /source -B /build -DCMAKE_BUILD_TYPE=Release -DCMAKE_UNITY_BUILD=ON -DCMAKE_UNITY_BUILD_BATCH_SIZE=40 \
    -DXAUTO_BPF=OFF -DXAUTO_PEDESTRIANS=OFF -DCMAKE_CXX_COMPILER_LAUNCHER="env;CCACHE_SLOPPINESS=pch_defines,time_macros;CCACHE_DEPEND=1;ccache"
}
compile() { within ninja -C /build -j"${JOBS:-2}"; }
units() { within env -C /build ctest -j"${JOBS:-2}" -L 'unit|fuzz' -LE long --timeout 300 --repeat until-pass:2 --output-on-failure; }
demo() {
  within env CONFIGURED=/build JOBS="${JOBS:-2}" bash /source/scripts/demo.sh
  [ -s "$out/build/demo/report.html" ] && [ -s "$out/build/demo/rates/report.html" ]
}

check "a Debian 11 root" make_root || { plan; exit 1; }
LIMIT_S=1800
check "configures" configure || { plan; exit 1; }
check "builds" compile || { plan; exit 1; }
check "unit tests" units
check "make demo" demo
plan
status=$?
umount -R -l "$floor"/{dev,sys,proc,build,source}
rm -rf --one-file-system "$floor"
exit $status
}
