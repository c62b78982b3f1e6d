#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Packs an initramfs: busybox, our init, the tests and their libraries.
# usage: mk-initrd.sh OUT.cpio [ROOT=DIR] SRC[:DST] ...      a bare SRC lands in /bin; a folder is copied whole to DST
# The libraries that each ELF needs are added, of a folder's programs as well. With ROOT (a folder of another architecture, with its bin/busybox) they are not: what comes
# from there is linked statically.
set -euo pipefail
out=$(realpath -m "$1")
shift
here=$(dirname "$(realpath "$0")")
sysroot=
case ${1:-} in ROOT=*) sysroot=${1#ROOT=} && shift ;; esac
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
chmod 755 "$dir"
mkdir -p "$dir"/{bin,sbin,proc,sys,dev,tmp,etc,run,usr/bin,usr/sbin,root}
busybox=$sysroot/bin/busybox
[ -n "$sysroot" ] || busybox=$(command -v busybox)
install -m755 "$busybox" "$dir/bin/busybox"
ln -s busybox "$dir/bin/sh"
install -m755 "$here/../../tests/vm/init" "$dir/init"
printf 'root:x:0:0::/root:/bin/sh\nuser:x:1000:1000::/tmp:/bin/sh\n' >"$dir/etc/passwd"
printf 'root:x:0:\nuser:x:1000:\n' >"$dir/etc/group"

libraries() { # the libraries an ELF needs, as paths
  ldd "$1" 2>/dev/null | grep -oE '/[^ ]+\.so[^ ]*' | sort -u || true
}
add_libraries() {
  local lib
  for lib in $(libraries "$1"); do
    [ -e "$dir$lib" ] || install -D -m755 "$(realpath "$lib")" "$dir$lib"
  done
}

for item in "$@"; do
  src=${item%%:*} dst=${item#*:}
  [ "$dst" != "$item" ] || dst=/bin/$(basename "$src")
  if [ -d "$src" ]; then
    mkdir -p "$dir$dst"
    cp -rL "$src/." "$dir$dst/"
    [ -n "$sysroot" ] || for file in $(find "$src" -type f -perm -u+x); do add_libraries "$file"; done
  else
    install -D -m755 "$src" "$dir$dst"
    [ -n "$sysroot" ] || add_libraries "$src"
  fi
done
# Not compressed: an emulated CPU took 1.6 s of 5.8 to unpack it (one boot each).
(cd "$dir" && find . | cpio -o -H newc --quiet -R 0:0) >"$out"
