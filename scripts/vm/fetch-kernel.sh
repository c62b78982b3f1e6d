#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Fetches a Debian kernel with its build headers into the cache, unpacked and never installed.
# usage: fetch-kernel.sh NAME [ARCH]      NAME: 7.x (sid's newest), 6.12, 6.1, 5.10      ARCH: amd64 (default), arm64
# Prints the folder, which then holds
#   release    the kernel's release, as uname -r says it
#   vmlinuz    the image to boot
#   build      a tree to build modules against (make -C build M=...)
#   btf        a file with the kernel's .BTF section, for bpftool btf dump; missing where the headers have none
#   needs      variables that the module build must be given, one line
# The version is never written down here: sid and the security suites keep only the newest.
set -euo pipefail
name=$1 arch=${2:-amd64}
here=$(dirname "$(realpath "$0")")
cache=${XAUTO_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/xauto}
out=$cache/kernels/$name-$arch
if [ -s "$out/release" ]; then
  echo "$out"
  exit 0
fi

case $name in
  7.x) suites=sid meta=linux-headers-cloud-$arch newest=sid ;;
  6.12) suites=bookworm-security meta=linux-headers-6.12-cloud-$arch newest=bookworm-security ;;
  5.10) suites="bullseye bullseye-security" meta=linux-headers-cloud-$arch newest=bullseye-security ;; # L4T 35's version
  6.1) suites=bookworm-security meta=linux-headers-cloud-$arch newest=bookworm-security ;;
  *)
    echo "fetch-kernel: no kernel '$name'; there are 7.x, 6.12, 6.1 and 5.10" >&2
    exit 2
    ;;
esac

mkdir -p "$cache/kernels"
exec 9>"$cache/kernels/.lock-$name-$arch"
flock 9 # two checks at once must not fetch into one folder
if [ -s "$out/release" ]; then
  echo "$out"
  exit 0
fi
rm -rf "$out"
work=$out.part
rm -rf "$work"
mkdir -p "$work/debs" "$work/sys"
trap 'rm -rf "$work"' EXIT

# The kbuild tools run on this machine, so they are of its architecture; 7.x's need a newer glibc, which trixie has.
"$here/apt-view.sh" "$work/apt" "amd64 arm64" bookworm trixie $suites >&2
export APT_CONFIG=$work/apt/apt.conf
host=$(dpkg --print-architecture)

version=$(apt-cache madison "$meta:$arch" | awk -F'|' -v s="$newest/" 'index($3, s) { gsub(/ /, "", $2); print $2; exit }')
[ -n "$version" ] || { echo "fetch-kernel: $newest has no $meta:$arch" >&2; exit 1; }
headers=$(apt-cache show "$meta:$arch=$version" | grep '^Depends:' | grep -oE "linux-headers-[0-9][^ ,]*-cloud-$arch" | head -n 1)
release=${headers#linux-headers-}
base=${release%-cloud-"$arch"}

fetch() ( # package[:arch] ...: download and unpack; the archive's hash was checked by apt
  into=$1
  shift
  mkdir -p "$into" && cd "$work/debs"
  rm -f ./*.deb
  apt-get download -qq "$@" >/dev/null
  for deb in *.deb; do dpkg-deb -x "$deb" "$into"; done
)

have() { [ -n "$(apt-cache madison "$1" 2>/dev/null)" ]; }
common=linux-headers-$base-common
have "$common" || common=linux-headers-${base%%+*}-common
kbuild=linux-kbuild-$base
have "$kbuild:$host" || kbuild=linux-kbuild-$(echo "$base" | grep -oE '^[0-9]+\.[0-9]+')
if have "linux-binary-$release:$arch"; then
  image=linux-binary-$release # since 7.2: the kernel without its modules
else
  image=linux-image-$release
fi
echo "fetch-kernel: $release ($version) for $arch" >&2
fetch "$work/sys" "$headers:$arch" "$common" "$kbuild:$host" "$image:$arch"

sys=$out/sys # where it will lie: the wrappers below name it
vmlinuz=$(find "$work/sys" -name 'vmlinuz*' -type f | head -n 1)
[ -n "$vmlinuz" ] || { echo "fetch-kernel: $image holds no kernel image" >&2; exit 1; }
mv "$vmlinuz" "$work/vmlinuz"
rm -rf "$work/sys/lib/modules" "$work/sys/boot" "$work/sys/usr/share"

# The headers' Makefile names /usr/src absolutely; ours names the cache.
tree=usr/src/linux-headers-$release
common_dir=$(cd "$work/sys" && ls -d usr/src/linux-headers-*-common)
printf 'KBUILD_OUTPUT=%s\ninclude %s/Makefile\n' "$sys/$tree" "$sys/$common_dir" >"$work/sys/$tree/Makefile"
# Links to /usr/lib/linux-kbuild-* must stay below the cache as well.
find "$work/sys/usr/src" -type l | while read -r link; do
  target=$(readlink "$link")
  case $target in /usr/*) ln -sfn "$sys$target" "$link" ;; esac
done
ln -s "sys/$tree" "$work/build"
[ -e "$work/sys/$tree/vmlinux" ] && ln -s "sys/$tree/vmlinux" "$work/btf"

# Kbuild tools that need a newer C library than this machine's run under trixie's.
mapfile -t newer < <(
  find "$work/sys/usr/lib" -path '*linux-kbuild*' -type f -perm -u+x | while read -r tool; do
    head -c 4 "$tool" | grep -q ELF || continue
    case $tool in *powerpc* | *msb*) continue ;; esac
    ldd "$tool" 2>&1 | grep -q 'GLIBC_.* not found' && echo "$tool"
  done || true
)
if [ ${#newer[@]} -gt 0 ]; then
  fetch "$work/rt" "libc6:$host/trixie" "libelf1t64:$host/trixie" "zlib1g:$host/trixie" "libzstd1:$host/trixie" "libssl3t64:$host/trixie"
  case $host in amd64) loader=ld-linux-x86-64.so.2 triplet=x86_64-linux-gnu ;; *) loader=ld-linux-aarch64.so.1 triplet=aarch64-linux-gnu ;; esac
  rm -rf "$work/rt/usr/share"
  lib=$out/rt/usr/lib/$triplet
  for tool in "${newer[@]}"; do
    mv "$tool" "$tool.bin"
    final=$out${tool#"$work"}
    printf '#!/bin/sh\nexec %s/%s --library-path %s --argv0 "$0" %s.bin "$@"\n' "$lib" "$loader" "$lib" "$final" >"$tool"
    chmod +x "$tool"
  done
fi

# What a gcc 12 build needs against a tree that gcc 14 or 15 configured, found with each kernel. arm64's ftrace patches eight aligned bytes
# in front of each function; gcc 12 does not align cold functions (every __init one), and 7.2 then stops at a BUG when it loads the module. So
# our functions have no ftrace entry there; the trace events need none.
case $name-$arch in
  7.x-arm64) echo "CONFIG_CC_HAS_MIN_FUNCTION_ALIGNMENT= CONFIG_DEBUG_INFO_BTF_MODULES= KCFLAGS=-Wno-attributes CC_FLAGS_FTRACE=" ;;
  7.x-*) echo "CONFIG_CC_HAS_MIN_FUNCTION_ALIGNMENT= CONFIG_DEBUG_INFO_BTF_MODULES= KCFLAGS=-Wno-attributes" ;;
  *) echo "CONFIG_DEBUG_INFO_BTF_MODULES=" ;;
esac >"$work/needs"

rm -rf "$work/debs" "$work/apt"
echo "$release" >"$work/release"
mv "$work" "$out"
trap - EXIT
echo "$out"
