#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Boots the disk that board-disk.sh made. usage: run-board.sh FOLDER LOG TAR [KERNEL_PARAMETER...]
#   TAR: what the second disk holds; the first then stays as it was. Empty: what is written to the first stays.
# Environment: VM_LIMIT_S (900). Status: as run-vm.sh.
set -uo pipefail
folder=$1 log=$2 tar=$3
shift 3
drives=(-drive "file=$folder/disk.img,format=raw,if=none,id=first,cache=unsafe,snapshot=$([ -n "$tar" ] && echo on || echo off)"
  -device virtio-blk-pci,drive=first)
[ -z "$tar" ] || drives+=(-drive "file=$tar,format=raw,if=none,id=second,readonly=on" -device virtio-blk-pci,drive=second)
timeout -k 5 "${VM_LIMIT_S:-900}" qemu-system-aarch64 -M virt,gic-version=3 -cpu cortex-a72 -accel tcg,thread=multi -smp 2 -m 2G -nodefaults -no-reboot \
  -display none -serial stdio -monitor none -kernel "$folder/vmlinuz" -initrd "$folder/initrd" "${drives[@]}" \
  -append "console=ttyAMA0 quiet panic=-1 systemd.show_status=no $*" </dev/null >"$log" 2>&1
status=$?
sed -i 's/\r//g' "$log"
[ "$status" -eq 124 ] && exit 124
verdict=$(sed -n 's/^XAUTO-VM-EXIT=\([0-9]*\)$/\1/p' "$log" | tail -n 1)
[ -n "$verdict" ] && exit "$verdict"
exit 125
