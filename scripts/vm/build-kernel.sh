#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds a small 6.12 with sched_ext from Debian's source package into the cache: the oldest kernel that our scheduler supports, which no
# Debian kernel package offers (Debian's own 6.12 has sched_ext switched off). Takes 12 minutes on two cores, once; 3 GB while it builds.
# usage: build-kernel.sh        Environment: JOBS. Prints the folder: release, vmlinuz.
set -euo pipefail
here=$(dirname "$(realpath "$0")")
cache=${XAUTO_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/xauto}
out=$cache/kernels/6.12-scx-amd64
if [ -s "$out/release" ]; then
  echo "$out"
  exit 0
fi
[ "$(dpkg --print-architecture)" = amd64 ] || { echo "build-kernel: only on amd64" >&2; exit 2; }
missing=()
for tool in gcc-12 flex bison bc pahole make xz; do command -v "$tool" >/dev/null || missing+=("$tool"); done
[ ${#missing[@]} -eq 0 ] || { echo "build-kernel: missing ${missing[*]}; run scripts/setup.sh kernel-build" >&2; exit 1; }

mkdir -p "$cache/kernels"
exec 9>"$cache/kernels/.lock-6.12-scx-amd64"
flock 9
work=$out.part
rm -rf "$work" "$out"
mkdir -p "$work/debs" "$work/build"
trap 'rm -rf "$work"' EXIT

"$here/apt-view.sh" "$work/apt" amd64 bookworm-security >&2
(cd "$work/debs" && APT_CONFIG=$work/apt/apt.conf apt-get download -qq linux-source-6.12 >/dev/null && dpkg-deb -x linux-source-6.12_*.deb .)
tar -C "$work" -xf "$work"/debs/usr/src/linux-source-6.12.tar.xz
rm -rf "$work/debs" "$work/apt"
source=$work/linux-source-6.12
make=(make -C "$source" O="$work/build" CC=gcc-12 HOSTCC=gcc-12)
"${make[@]}" -s tinyconfig >&2
KCONFIG_CONFIG="$work/build/.config" "$source/scripts/kconfig/merge_config.sh" -m "$work/build/.config" "$here/scx.config" >&2
"${make[@]}" -s olddefconfig >&2
for wanted in SCHED_CLASS_EXT DEBUG_INFO_BTF; do
  grep -q "^CONFIG_$wanted=y" "$work/build/.config" || { echo "build-kernel: the configuration lost $wanted" >&2; exit 1; }
done
nice -n 19 "${make[@]}" -s -j"${JOBS:-$(nproc)}" bzImage >&2
mkdir -p "$work/done"
cp "$work/build/arch/x86/boot/bzImage" "$work/done/vmlinuz"
cp "$work/build/include/config/kernel.release" "$work/done/release"
mv "$work/done" "$out"
echo "$out"
