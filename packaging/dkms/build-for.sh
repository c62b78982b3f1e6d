#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Builds xauto.ko for one kernel and fails unless the module says that it is for that kernel. DKMS calls it (dkms.conf).
# usage: build-for.sh RELEASE KERNEL_BUILD_TREE | build-for.sh --clean KERNEL_BUILD_TREE
# Nothing here asks which kernel is running: a module built for that one instead of the named one is a failure that shows at boot.
set -eu
release=$1 tree=$2
cd "$(dirname "$0")"

[ -f "$tree/Makefile" ] || {
  echo "build-for: $tree is no kernel build tree: install the headers of $release (Debian: linux-headers-$release; L4T: see docs/jetson.md)" >&2
  exit 1
}
if [ "$release" = --clean ]; then
  exec make -C "$tree" M="$PWD" XAUTO_EMULATORS=n clean
fi
[ -f "$tree/Module.symvers" ] || echo "build-for: $tree has no Module.symvers: where symbol versions are on, the module will not load" >&2

make -C "$tree" M="$PWD" XAUTO_EMULATORS=n modules

vermagic=$(modinfo -F vermagic kmod/xauto.ko)
if [ "${vermagic%% *}" != "$release" ]; then
  echo "build-for: xauto.ko is for '${vermagic%% *}', not for '$release': $tree is another kernel's build tree" >&2
  rm -f kmod/xauto.ko # DKMS must not find it
  exit 1
fi
echo "build-for: xauto.ko fits $release ($vermagic)"
