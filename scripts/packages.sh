#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What `make packages [ARCH=arm64|jetpack]` does. For this machine: the release build, packaged. For another: a cross-build in a Debian root
# that has its libraries, as Debian's own builders do it. jetpack: arm64, built in Debian 11 (its libc is as old as Ubuntu 20.04's), needs no
# library but libc and the compiler's. usage: packages.sh [ARCH]      environment: JOBS
set -euo pipefail
cd "$(dirname "$0")/.."
jobs=${JOBS:-2}
native=$(dpkg --print-architecture)
variant=${1:-$native}
arch=${variant/#jetpack/arm64}
targets="xauto_shared xauto_watch xauto xauto-coordinator xauto-emud xauto-cpusched xauto-system xauto-standin xauto_help"
case $arch in
  "$native" | arm64) ;;
  *) echo "packages: no packages for '$arch': there are $native, arm64 and jetpack" >&2; exit 2 ;;
esac
if [ "$variant" = jetpack ] && [ "$native" != amd64 ]; then
  echo "packages: those for JetPack are cross-built on amd64; this machine is $native" >&2
  exit 2
fi

# The host's tools are needed in any case: man pages are made of their help.
cmake --preset release >/dev/null
# shellcheck disable=SC2086
ninja -C build -j"$jobs" $targets
if [ "$variant" = "$native" ]; then
  exec scripts/package-build.sh build build/package/debs
fi

[ "$(id -u)" -eq 0 ] || { echo "packages: a cross-build needs root, for its Debian root" >&2; exit 1; }
if [ "${XAUTO_INSIDE:-}" != 1 ]; then
  # A mount namespace of its own: however this ends, nothing stays mounted.
  XAUTO_INSIDE=1 exec unshare --mount --propagation private --pid --fork --kill-child --mount-proc "$0" "$variant" </dev/null
fi
out=$PWD/build-$variant
mkdir -p "$out/work" "$out/ccache"
mount -t tmpfs -o size=8g,mode=755 xauto-packages "$out/work"
root=$out/work/root
mkdir -p "$root" "$out/work/tmp"
tar=$(TMPDIR=$out/work/tmp scripts/package-root.sh "$variant")
tar -xf "$tar" -C "$root"
triplet=$(dpkg-architecture -a"$arch" -qDEB_HOST_MULTIARCH 2>/dev/null)
printf '#!/bin/sh\nPKG_CONFIG_LIBDIR=/usr/lib/%s/pkgconfig:/usr/share/pkgconfig exec pkg-config "$@"\n' "$triplet" >"$root/usr/local/bin/pkg-config-$arch"
chmod 755 "$root/usr/local/bin/pkg-config-$arch"
ln -sf "/usr/local/bin/pkg-config-$arch" "$root/usr/bin/$triplet-pkg-config"
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
mkdir -p "$root/src" "$root/host" "$root/ccache"
mount --bind "$out/ccache" "$root/ccache"
git ls-files -z | tar --null --ignore-failed-read -T - -cf - | tar -xf - -C "$root/src"
cp -r build/package/help "$root/host"
kind=any profile=
if [ "$variant" = jetpack ]; then
  kind=binary profile=pkg.xauto.jetpack
  sed -i '1s/)/+jetpack)/' "$root/src/debian/changelog"
fi
if ! env -i PATH=/usr/lib/ccache:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 CCACHE_DIR=/ccache CCACHE_SLOPPINESS=pch_defines,time_macros XAUTO_HOST_HELP=/host/help \
  DEB_BUILD_PROFILES="$profile" \
  DEB_BUILD_OPTIONS="parallel=$jobs nocheck noautodbgsym" chroot "$root" \
  sh -c "cd /src && dpkg-buildpackage --build=$kind --host-arch=$arch -d -us -uc && ninja -C obj-deb driving driving-rates" >"$out/build.log" 2>&1; then
  tail -n 30 "$out/build.log" >&2
  echo "packages: the build for $arch failed; the whole log is $out/build.log" >&2
  exit 1
fi
# What was built runs there: emulated, it must find what this machine's solver finds.
cp examples/driving/app.json "$root/tmp/app.json"
found() { # APP TOOL...
  local app=$1
  shift
  "$@" solve --app "$app" --platform small --method heft --json | sed -n 's/.*"release_us": *\([0-9]*\).*/\1/p'
}
emulated=$(found /tmp/app.json chroot "$root" "qemu-${triplet%%-*}-static" /src/debian/xauto-tools/usr/libexec/xauto/xauto)
here=$(found examples/driving/app.json build/bin/xauto)
if [ -z "$here" ] || [ "$emulated" != "$here" ]; then
  echo "packages: the solver built for $arch finds ${emulated:-nothing} us, this machine's $here us" >&2
  exit 1
fi
echo "packages: the $arch solver, emulated, finds the Driving Case's HEFT latency: $emulated us"
rm -rf "$out/debs" "$out/apps"
mkdir -p "$out/debs" "$out/apps"
cp "$root"/src/obj-deb/bin/driving* "$out/apps" # to try them with
mv "$root"/*.deb "$root"/*.changes "$root"/*.buildinfo "$out/debs"
ls "$out"/debs/*.deb
