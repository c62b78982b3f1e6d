#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Fetches the network driver of QEMU's virtio-net for a kernel of fetch-kernel.sh, whose image has none, into its folder.
# usage: fetch-nic.sh [NAME]      NAME: 7.x. Prints the three modules, in the order in which they are loaded.
set -euo pipefail
kernel=$("$(dirname "$0")/fetch-kernel.sh" "${1:-7.x}")
release=$(<"$kernel/release")
out=$kernel/nic
modules=(net/core/failover drivers/net/net_failover drivers/net/virtio_net)
if [ ! -e "$out/virtio_net.ko" ]; then
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
  "$(dirname "$0")/apt-view.sh" "$work/apt" amd64 bookworm sid >&2
  (cd "$work" && APT_CONFIG=$work/apt/apt.conf apt-get download -qq "linux-modules-$release" >/dev/null) ||
    { echo "fetch-nic: sid has no linux-modules-$release any more; remove $kernel, and fetch again" >&2; exit 1; }
  dpkg-deb -x "$work"/linux-modules-*.deb "$work/sys"
  mkdir -p "$out"
  for module in "${modules[@]}"; do
    xz -dc "$work/sys/usr/lib/modules/$release/kernel/$module.ko.xz" >"$work/$(basename "$module").ko"
    mv "$work/$(basename "$module").ko" "$out/"
  done
fi
for module in "${modules[@]}"; do echo "$out/$(basename "$module").ko"; done
