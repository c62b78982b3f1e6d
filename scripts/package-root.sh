#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes a clean Debian root as a tar file in the cache, and prints its path. Made again when older than a week.
# usage: package-root.sh            to try packages in: a developer's tools (compiler, CMake, DKMS, a kernel's headers), and nothing of
#                                   XAuto or of what it depends on
#        package-root.sh floor      Debian 11 with the oldest of what XAuto is built with; see floor-check.sh
#        package-root.sh jetpack    Debian 11 with a cross-compiler for arm64, and the same for arm64; see packages.sh
#        package-root.sh ARCH       to build packages for ARCH in: cross-compiler, XAuto's build dependencies of that architecture, and an
#                                   emulator to try them
# environment: TMPDIR, better on a tmpfs: dpkg waits for the disk after every file
set -euo pipefail
here=$(dirname "$(realpath "$0")")
cache=${XAUTO_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/xauto}
native=$(dpkg --print-architecture)
target=${1:-}
release=bookworm suites="bookworm bookworm-security"
# Headers only, and Debian 11 has none: bookworm's.
cli11=(--customize-hook="cp -r --parents /usr/include/CLI /usr/share/cmake/CLI11 /usr/share/doc/libcli11-dev \"\$1\"")
command -v mmdebstrap >/dev/null || { echo "package-root: mmdebstrap is missing; run scripts/setup.sh package" >&2; exit 1; }

if [ -z "$target" ]; then
  name=bookworm-$native
  # bash-completion, man-db: what reads our files; systemd, udev: every Debian has them, and they check the unit.
  packages="g++ cmake make pkg-config bash-completion systemd udev man-db dkms linux-headers-cloud-$native"
  options=()
elif [ "$target" = floor ]; then
  target="" release=bullseye suites=bullseye
  name=floor-$native
  packages="g++ cmake ninja-build ccache pkg-config python3 nlohmann-json3-dev libfmt-dev libspdlog-dev libeigen3-dev liblpsolve55-dev
    libsuitesparse-dev protobuf-compiler libprotobuf-dev libexpected-dev libgtest-dev libgmock-dev libnl-genl-3-dev libsqlite3-dev zlib1g-dev libzstd-dev
    liblz4-dev"
  options=("${cli11[@]}")
elif [ "$target" = jetpack ]; then
  target=arm64 release=bullseye suites=bullseye
  name=jetpack-$native
  packages="crossbuild-essential-arm64 qemu-user-static debhelper dkms cmake ninja-build ccache pkg-config python3 protobuf-compiler libexpected-dev
    nlohmann-json3-dev libeigen3-dev"
  for library in libfmt-dev libspdlog-dev libsqlite3-dev zlib1g-dev libzstd-dev liblz4-dev liblpsolve55-dev libsuitesparse-dev \
    libnl-genl-3-dev libprotobuf-dev; do
    packages+=" $library:arm64"
  done
  options=("--architectures=$native,arm64" "${cli11[@]}")
else
  name=cross-$target
  suites+=" bookworm-backports"
  packages="crossbuild-essential-$target qemu-user-static debhelper dh-dkms cmake ninja-build ccache pkg-config python3 protobuf-compiler clang-19
    libexpected-dev nlohmann-json3-dev libcli11-dev libeigen3-dev"
  for library in libfmt-dev libspdlog-dev libsqlite3-dev zlib1g-dev libzstd-dev liblz4-dev liblpsolve55-dev libsuitesparse-dev \
    libnl-genl-3-dev libprotobuf-dev libelf-dev; do
    packages+=" $library:$target"
  done
  options=("--architectures=$native,$target"
    --customize-hook="chroot \"\$1\" apt-get install -y -t bookworm-backports libbpf-dev:$target bpftool")
fi
packages=$(echo ca-certificates $packages | tr ' ' ,)

key=$(echo "$packages $(cat "$0")" | sha256sum | cut -c 1-12)
tar=$cache/roots/$name-$key.tar
mkdir -p "$cache/roots"
exec 9>"$cache/roots/.lock-$name"
flock 9
if [ -n "$(find "$tar" -type f -mtime -7 2>/dev/null)" ]; then
  echo "$tar"
  exit 0
fi
rm -f "$cache/roots/$name"-*.tar # older ones
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# The mirrors, and what apt needs to know of them, as on this machine.
# shellcheck disable=SC2086
"$here/vm/apt-view.sh" "$work/view" "$native${target:+ $target}" $suites >&2
options+=(--aptopt='APT::Install-Recommends "false"')
for file in /etc/apt/apt.conf.d/99*; do [ -e "$file" ] && options+=("--aptopt=$file"); done
part=${tar%.tar}.part.tar
if ! mmdebstrap --variant=minbase --mode=root --include="$packages" "${options[@]}" $release "$part" "$work/view/sources.list" \
  >"$work/log" 2>&1; then
  tail -n 15 "$work/log" >&2
  echo "package-root: no Debian root; is the mirror in /etc/apt reachable?" >&2
  rm -f "$part"
  exit 1
fi
mv "$part" "$tar"
echo "$tar"
