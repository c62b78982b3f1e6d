#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds small kernels from Debian's source package into the cache, each once, on two cores; 3 GB while it builds.
# usage: build-kernel.sh [NAME]      Environment: JOBS. Prints the folder: release, vmlinuz.
#   6.12-scx    with sched_ext: the oldest that our scheduler supports. Debian's own 6.12 has it switched off. 12 minutes.
#   6.12-kasan  watches memory and locks (KASAN, lockdep), which no Debian kernel does, and can build modules (build, needs). 15 minutes.
set -euo pipefail
here=$(dirname "$(realpath "$0")")
name=${1:-6.12-scx}
case $name in
  6.12-scx) config=$here/scx.config wanted=(SCHED_CLASS_EXT DEBUG_INFO_BTF) ;;
  6.12-kasan) config=$here/kasan.config wanted=(KASAN_INLINE PROVE_LOCKING DEBUG_ATOMIC_SLEEP DEBUG_OBJECTS_WORK) ;;
  *) echo "build-kernel: no kernel '$name'; there are 6.12-scx and 6.12-kasan" >&2; exit 2 ;;
esac
cache=${XAUTO_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/xauto}
out=$cache/kernels/$name-amd64
is_there() { [ -s "$out/release" ] && cmp -s "$config" "$out/config"; }
if is_there; then
  echo "$out"
  exit 0
fi
[ "$(dpkg --print-architecture)" = amd64 ] || { echo "build-kernel: only on amd64" >&2; exit 2; }
missing=()
for tool in gcc-12 flex bison bc pahole make xz; do command -v "$tool" >/dev/null || missing+=("$tool"); done
[ ${#missing[@]} -eq 0 ] || { echo "build-kernel: missing ${missing[*]}; run scripts/setup.sh kernel-build" >&2; exit 1; }

mkdir -p "$cache/kernels"
exec 9>"$cache/kernels/.lock-$name-amd64"
flock 9
if is_there; then
  echo "$out"
  exit 0
fi
work=$out.part
rm -rf "$work" "$out"
mkdir -p "$work/debs" "$work/build"
trap 'rm -rf "$work"' EXIT

"$here/apt-view.sh" "$work/apt" amd64 bookworm-security >&2
(cd "$work/debs" && APT_CONFIG=$work/apt/apt.conf apt-get download -qq linux-source-6.12 >/dev/null && dpkg-deb -x linux-source-6.12_*.deb .)
tar -C "$work" -xf "$work"/debs/usr/src/linux-source-6.12.tar.xz
rm -rf "$work/debs" "$work/apt"
source=$work/linux-source-6.12
# ccache, where there is one: a second build after a change of the configuration is quick.
cc=gcc-12
! command -v ccache >/dev/null || cc="ccache gcc-12"
make=(make -C "$source" O="$work/build" "CC=$cc" "HOSTCC=$cc")
"${make[@]}" -s tinyconfig >&2
KCONFIG_CONFIG="$work/build/.config" "$source/scripts/kconfig/merge_config.sh" -m "$work/build/.config" "$config" >&2
"${make[@]}" -s olddefconfig >&2
for option in "${wanted[@]}"; do
  grep -q "^CONFIG_$option=y" "$work/build/.config" || { echo "build-kernel: the configuration lost $option" >&2; exit 1; }
done
nice -n 19 "${make[@]}" -s -j"${JOBS:-$(nproc)}" bzImage >&2
mkdir -p "$work/done"
cp "$work/build/arch/x86/boot/bzImage" "$work/done/vmlinuz"
if [ "$name" = 6.12-kasan ]; then
  # What modules are built against. Without Module.symvers of modules, of which there are none, modpost knows the kernel's own symbols.
  cp "$work/build/vmlinux.symvers" "$work/build/Module.symvers"
  "${make[@]}" -s modules_prepare >&2
  # shellcheck disable=SC2016 # make's variable, not ours
  "${make[@]}" -s run-command KBUILD_RUN_COMMAND='$(srctree)/scripts/package/install-extmod-build '"$work/done/build" >&2
  echo >"$work/done/needs"
fi
cp "$work/build/include/config/kernel.release" "$work/done/release"
cp "$config" "$work/done/config"
mv "$work/done" "$out"
echo "$out"
