#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes the Debian packages from a finished build tree; compiles nothing twice. What `make packages` does; docs/packages.md.
# usage: package-build.sh BUILD_DIR OUT        OUT gets libxauto1, libxauto-dev, xauto-tools, xauto-dkms, python3-xauto (*.deb)
set -euo pipefail
build=$(realpath "$1") out=$(realpath -m "$2")
root=$(realpath "$(dirname "$0")/..")
for tool in dh dh_dkms dpkg-buildpackage; do
  command -v $tool >/dev/null || { echo "package-build: $tool is missing; run scripts/setup.sh package" >&2; exit 1; }
done
[ -e "$build/lib/libxauto.so.1" ] || { echo "package-build: $build holds no finished build" >&2; exit 1; }
version=$(sed -n 's/^project(xauto VERSION \([0-9.]*\).*/\1/p' "$root/CMakeLists.txt")
packaged=$(dpkg-parsechangelog -l "$root/debian/changelog" -S Version)
[ "$version" = "$packaged" ] ||
  { echo "package-build: CMakeLists.txt says version $version, debian/changelog $packaged" >&2; exit 1; }

# debhelper writes beside debian/, so it gets a copy of what it packages, not the working tree.
stage=$out/stage/xauto
rm -rf "$out"
mkdir -p "$stage"
cd "$root"
cp -r --parents debian packaging kmod Kbuild include/uapi examples/template examples/camera tools/python/notebooks LICENSE "$stage"
log=$out/build.log
# Debian's build dependencies are checked by CMake, which finds the libraries themselves: -d.
if ! (cd "$stage" && XAUTO_BUILD=$build DEB_BUILD_OPTIONS="parallel=${JOBS:-2} nocheck noautodbgsym" \
  dpkg-buildpackage --build=binary -d -nc -us -uc) >"$log" 2>&1; then
  tail -n 30 "$log" >&2
  echo "package-build: failed; the whole log is $log" >&2
  exit 1
fi
mv "$out"/stage/*.deb "$out"/stage/*.changes "$out"/stage/*.buildinfo "$out"
rm -rf "$out/stage"
ls "$out"/*.deb
