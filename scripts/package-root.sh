#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes a clean Debian 12 root with a developer's tools (compiler, CMake, DKMS, a kernel's headers) and nothing of XAuto or of what
# it depends on, as a tar file in the cache; prints its path. Made again when older than a week.
# usage: package-root.sh        environment: TMPDIR, better on a tmpfs: dpkg waits for the disk after every file
set -euo pipefail
here=$(dirname "$(realpath "$0")")
cache=${XAUTO_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/xauto}
arch=$(dpkg --print-architecture)
# bash-completion, man-db: what reads our files; systemd, udev: every Debian has them, and they check the unit.
packages=ca-certificates,g++,cmake,make,pkg-config,bash-completion,systemd,udev,man-db,dkms,linux-headers-cloud-$arch
command -v mmdebstrap >/dev/null || { echo "package-root: mmdebstrap is missing; run scripts/setup.sh package" >&2; exit 1; }

key=$(echo "$packages $(cat "$0")" | sha256sum | cut -c 1-12)
tar=$cache/roots/bookworm-$arch-$key.tar
mkdir -p "$cache/roots"
exec 9>"$cache/roots/.lock"
flock 9
if [ -n "$(find "$tar" -mtime -7 2>/dev/null)" ]; then
  echo "$tar"
  exit 0
fi
rm -f "$cache"/roots/bookworm-"$arch"-*.tar # older ones
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# The mirrors, and what apt needs to know of them, as on this machine.
"$here/vm/apt-view.sh" "$work/view" "$arch" bookworm bookworm-security >&2
options=(--aptopt='APT::Install-Recommends "false"')
for file in /etc/apt/apt.conf.d/99*; do [ -e "$file" ] && options+=("--aptopt=$file"); done
if ! mmdebstrap --variant=minbase --mode=root --include="$packages" "${options[@]}" bookworm "${tar%.tar}.part.tar" "$work/view/sources.list" \
  >"$work/log" 2>&1; then
  tail -n 15 "$work/log" >&2
  echo "package-root: no Debian root; is the mirror in /etc/apt reachable?" >&2
  rm -f "${tar%.tar}.part.tar"
  exit 1
fi
mv "${tar%.tar}.part.tar" "$tar"
echo "$tar"
