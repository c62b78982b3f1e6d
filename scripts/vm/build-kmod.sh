#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds the kernel modules against a kernel that fetch-kernel.sh unpacked.
# usage: build-kmod.sh KERNEL_FOLDER OUT [VAR=VALUE ...]       OUT gets a copy of the sources and the .ko files
# Environment: PLANT, a patch for that copy: a bug on purpose.
# Warnings are errors: a module that warns is not shipped. So are files of xauto.ko that call each other in a circle.
set -euo pipefail
kernel=$(realpath "$1") out=$(realpath -m "$2")
shift 2
root=$(realpath "$(dirname "$0")/../..")
nm=nm
case $kernel in
  *-arm64) nm=aarch64-linux-gnu-nm cross=(ARCH=arm64 CROSS_COMPILE=aarch64-linux-gnu- CC=aarch64-linux-gnu-gcc-12) ;;
  *) cross=(CC=gcc-12) ;;
esac
mkdir -p "$out"
# The objects of one kernel must not be taken for another's, so each has its own copy of the sources.
rm -rf "$out/kmod" "$out/include"
cp -r "$root/Kbuild" "$root/kmod" "$out"
mkdir -p "$out/include"
cp -r "$root/include/uapi" "$out/include/"
[ -z "${PLANT:-}" ] || patch -s -p1 -d "$out" <"$PLANT"
read -r -a needs <"$kernel/needs"
log=$out/build.log
if ! make -C "$kernel/build" M="$out" "${cross[@]}" "${needs[@]}" W=1 "$@" modules >"$log" 2>&1; then
  { grep -E -i 'error|warning|undefined|not found' -A 4 "$log" || tail -n 8 "$log"; } | head -n 40 >&2
  echo "build-kmod: failed against $(cat "$kernel/release"); the log is $log" >&2
  exit 1
fi
if grep -E '(^|/)kmod/.*warning:|WARNING: modpost' "$log" >&2; then
  echo "build-kmod: warnings against $(cat "$kernel/release"); the log is $log" >&2
  exit 1
fi
# "user definer" for each name that one file takes from another; tsort refuses a circle and says who is in it.
arrows='
  { sub(/:.*/, "", $1) }
  NF == 2 || $2 == "U" { used[$1 " " $NF]; next }
  $2 ~ /[A-Z]/ { of[$3] = $1 }
  END { for (use in used) { split(use, u, " "); if (u[2] in of && !seen[u[1], of[u[2]]]++) print u[1], of[u[2]] } }'
# shellcheck disable=SC2046 # the objects' names are words
if ! (cd "$out/kmod" && "$nm" -A $(sed -n 's/^xauto-y := //p' Kbuild)) | awk "$arrows" | tsort >"$out/layers" 2>"$out/circle"; then
  echo "build-kmod: files of xauto.ko call each other in a circle:" >&2
  cat "$out/circle" >&2
  exit 1
fi
