#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A disk as near to a Jetson's with JetPack 5 as Debian has one: Debian 11 for arm64 (glibc 2.31, Linux 5.10), with systemd, DKMS and the
# kernel's headers. Made again when older than a week. usage: board-disk.sh         prints a folder with vmlinuz, initrd and disk.img
# When it boots, systemd unpacks the second disk (a tar file) to /root/test, runs the `run` in it, says XAUTO-VM-EXIT=STATUS, and ends.
# Root, for debootstrap. Its second half runs on the emulated board, as no arm64 program runs here.
set -euo pipefail
exec 3>&1 >&2 # stdout is for the answer; mke2fs writes there
here=$(dirname "$(realpath "$0")")
cache=${XAUTO_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/xauto}
for tool in debootstrap mke2fs qemu-system-aarch64 cpio; do
  command -v $tool >/dev/null || { echo "board-disk: $tool is missing; run scripts/setup.sh jetpack" >&2; exit 1; }
done
packages=systemd-sysv,udev,dbus,kmod,dkms,linux-headers-cloud-arm64
key=$(cat "$0" "$here/run-board.sh" | sha256sum | cut -c 1-12)
out=$cache/boards/bullseye-$key
mkdir -p "$cache/boards"
exec 9>"$cache/boards/.lock"
flock 9
if [ -n "$(find "$out" -maxdepth 0 -mtime -7 2>/dev/null)" ]; then
  echo "$out" >&3
  exit 0
fi
rm -rf "$cache"/boards/bullseye-*
work=$cache/boards/part
rm -rf "$work"
trap 'rm -rf "$work"' EXIT
mkdir -p "$work/tree" "$work/apt" "$work/start/bin" "$work/start/modules"
failed() {
  tail -n 15 "$1" >&2
  echo "board-disk: $2; the whole log is above" >&2
  exit 1
}
"$here/apt-view.sh" "$work/apt" arm64 bullseye >&2
mirror=$(awk '{ print $3; exit }' "$work/apt/sources.list")
debootstrap --foreign --arch=arm64 --variant=minbase --include=$packages bullseye "$work/tree" "$mirror" >"$work/log" 2>&1 ||
  failed "$work/log" "debootstrap failed"

# The emulated board would take a minute for the largest alone.
for deb in "$work"/tree/var/cache/apt/archives/*.deb; do
  rm -rf "$work/deb"
  dpkg-deb -R "$deb" "$work/deb"
  dpkg-deb -Znone -b "$work/deb" "$deb" >/dev/null
done
rm -rf "$work/deb"

# The kernel that the headers are for, but not as a package: it would want to make an initrd.
release=$(basename "$work"/tree/var/cache/apt/archives/linux-headers-*-cloud-arm64_*.deb | sed 's/^linux-headers-//; s/_.*//')
(cd "$work/apt" && APT_CONFIG=$work/apt/apt.conf apt-get download -qq "linux-image-$release" busybox-static >/dev/null)
for deb in "$work"/apt/*.deb; do dpkg-deb -x "$deb" "$work/image"; done
mv "$work/image/boot/vmlinuz-$release" "$work/vmlinuz"
mkdir -p "$work/tree/lib/modules"
cp -r "$work/image/lib/modules/$release" "$work/tree/lib/modules/"
rm -f "$work/tree/proc" && mkdir "$work/tree/proc" # debootstrap leaves a link to this machine's
ln -sfn "/usr/src/linux-headers-$release" "$work/tree/lib/modules/$release/build"
depmod -b "$work/tree" "$release"

# What starts it: the disk's driver, and the disk.
cp "$work/image/bin/busybox" "$work/start/bin/"
for module in virtio virtio_ring virtio_pci virtio_blk; do
  find "$work/image/lib/modules" -name "$module.ko" -exec cp {} "$work/start/modules" \;
done
cat >"$work/start/init" <<'INIT'
#!/bin/busybox sh
/bin/busybox mkdir -p /proc /dev /root
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t devtmpfs dev /dev
for module in virtio virtio_ring virtio_pci virtio_blk; do /bin/busybox insmod /modules/$module.ko; done
/bin/busybox mount -t ext4 /dev/vda /root || /bin/busybox poweroff -f
/bin/busybox mount --move /dev /root/dev
run=/sbin/init
for word in $(/bin/busybox cat /proc/cmdline); do case $word in board.init=*) run=${word#*=} ;; esac; done
/bin/busybox umount /proc
exec /bin/busybox switch_root /root $run
INIT
chmod 755 "$work/start/init" "$work/start/bin/busybox"
(cd "$work/start" && find . | cpio -o -H newc --quiet -R 0:0 | gzip -1) >"$work/initrd"

cat >"$work/tree/setup" <<'SETUP'
#!/bin/bash
export PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive HOME=/root LC_ALL=C
mount -t proc proc /proc
mount -t sysfs sysfs /sys
printf '%s\n' force-unsafe-io 'path-exclude=/usr/share/doc/*' 'path-exclude=/usr/share/man/*' 'path-exclude=/usr/share/locale/*' >/etc/dpkg/dpkg.cfg.d/board
/debootstrap/debootstrap --second-stage
status=$?
[ $status -eq 0 ] || tail -n 30 /debootstrap/debootstrap.log
rm /etc/dpkg/dpkg.cfg.d/board
echo force-unsafe-io >/etc/dpkg/dpkg.cfg.d/unsafe-io
rm -rf /setup /debootstrap /var/cache/apt/archives/*.deb
sync
mount -o remount,ro /
echo
echo "XAUTO-VM-EXIT=$status"
echo o >/proc/sysrq-trigger
sleep 60
SETUP
cat >"$work/tree/etc/systemd/system/board-test.service" <<'UNIT'
[Unit]
Description=what the second disk holds
After=multi-user.target
[Service]
Type=oneshot
StandardOutput=tty
StandardError=tty
TTYPath=/dev/console
Environment=HOME=/root LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive
ExecStart=/bin/bash -c 'mkdir -p /root/test && tar -xf /dev/vdb -C /root/test && cd /root/test && bash ./run; status=$?; echo; echo XAUTO-VM-EXIT=$status; sync; echo o >/proc/sysrq-trigger; sleep 60'
[Install]
WantedBy=graphical.target
UNIT
chmod 755 "$work/tree/setup"
mkdir -p "$work/tree/etc/systemd/system/graphical.target.wants"
ln -s ../board-test.service "$work/tree/etc/systemd/system/graphical.target.wants/"
ln -sfn /lib/systemd/system/graphical.target "$work/tree/etc/systemd/system/default.target"
for off in getty@tty1 serial-getty@ttyAMA0 apt-daily apt-daily-upgrade fstrim e2scrub_all; do
  ln -sfn /dev/null "$work/tree/etc/systemd/system/$off.service"
done
echo board >"$work/tree/etc/hostname"
: >"$work/tree/etc/fstab"
mke2fs -q -t ext4 -d "$work/tree" "$work/disk.img" 4G
rm -rf "$work/tree" "$work/image" "$work/start" "$work/apt"
VM_LIMIT_S=3600 "$here/run-board.sh" "$work" "$work/log" "" board.init=/setup || failed "$work/log" "the second half of debootstrap failed on the emulated board"
mv "$work" "$out"
trap - EXIT
echo "$out" >&3
