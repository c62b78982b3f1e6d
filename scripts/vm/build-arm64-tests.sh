#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The kernel side's test programs for an arm64 guest, cross-built and linked statically, so that the guest needs no libraries.
# usage: build-arm64-tests.sh OUT      OUT gets kmod_*_test and bin/busybox
# The linker's only warning would be that libnl's name look-ups, which nobody calls, need the C library's shared parts.
# What they link against (libnl, its headers) and busybox are Debian's arm64 packages, unpacked into the cache and never installed.
set -euo pipefail
out=$(realpath -m "$1")
here=$(dirname "$(realpath "$0")")
root=$(realpath "$here/../..")
cache=${XAUTO_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/xauto}
sysroot=$cache/arm64-root
compiler=aarch64-linux-gnu-g++-12
command -v "$compiler" >/dev/null || { echo "build-arm64-tests: $compiler is missing; run scripts/setup.sh kernel-arm64" >&2; exit 1; }

mkdir -p "$cache"
exec 9>"$cache/.lock-arm64-root"
flock 9
if [ ! -e "$sysroot/complete" ]; then
  work=$sysroot.part
  rm -rf "$work" "$sysroot"
  mkdir -p "$work/debs"
  trap 'rm -rf "$work"' EXIT
  "$here/apt-view.sh" "$work/apt" arm64 bookworm >&2
  (cd "$work/debs" && APT_CONFIG=$work/apt/apt.conf apt-get download -qq libnl-3-dev libnl-genl-3-dev busybox-static >/dev/null)
  for deb in "$work"/debs/*.deb; do dpkg-deb -x "$deb" "$work"; done
  rm -rf "$work/debs" "$work/apt" "$work/usr/share"
  touch "$work/complete"
  mv "$work" "$sysroot"
  trap - EXIT
fi
flock -u 9

mkdir -p "$out/include"
# Result<T>'s header has no architecture; the rest of /usr/include has, and must not be seen.
ln -sfn /usr/include/tl "$out/include/tl"
command=("$compiler" -std=c++20 -O2 -static -Wall -Wextra -Wno-missing-field-initializers -I"$root/include" -I"$root/lib" -I"$root" -isystem "$sysroot/usr/include/libnl3"
  -isystem "$out/include" -isystem "$("$here/fetch-source.sh")/tools/testing/selftests")
command -v ccache >/dev/null && command=(ccache "${command[@]}")

# Rebuilt when anything they are made of is newer; each object once, then each program.
newest=$(find "$root/include" "$root/lib/kernel" "$root/lib/emu" "$root/lib/base" "$root/tests/kselftest" "$here/build-arm64-tests.sh" -type f \
  -printf '%T@\n' | sort -n | tail -n 1)
stamp=$out/stamp
if [ "$(cat "$stamp" 2>/dev/null)" != "$newest" ]; then
  objects=()
  for source in lib/kernel/queue_control.cc lib/kernel/queue_files.cc lib/emu/driver_queue.cc; do
    object=$out/$(basename "$source" .cc).o
    "${command[@]}" -c "$root/$source" -o "$object"
    objects+=("$object")
  done
  for source in "$root"/tests/kselftest/kmod/*_test.cc; do
    name=$(basename "$source" .cc)
    [ "$name" != backend_test ] || continue # it needs half of lib/, which has no architecture
    "${command[@]}" -c "$source" -o "$out/$name.o"
    "${command[@]}" "$out/$name.o" "${objects[@]}" -L"$sysroot/lib/aarch64-linux-gnu" \
      -lnl-genl-3 -lnl-3 -Wl,--no-warnings \
      -o "$out/kmod_$name"
  done
  echo "$newest" >"$stamp"
fi
install -D "$sysroot/bin/busybox" "$out/bin/busybox"
