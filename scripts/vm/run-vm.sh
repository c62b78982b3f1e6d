#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Boots a kernel with an initramfs in QEMU (no KVM needed) and returns the status that the tests inside ended with.
# usage: run-vm.sh KERNEL_FOLDER INITRD LOG [COMMAND]      COMMAND: what init runs, default /tests/run
# Environment: VM_LIMIT_S (300), VM_CPUS (2), VM_MEMORY (1G), VM_APPEND (more kernel parameters)
#   VM_MORE: more of QEMU's options, words without spaces
#   VM_ICOUNT=S: the guest's clock counts its instructions (2^S ns each) and jumps over idle time. What the guest measures then does not
#   depend on how busy this machine is. Its CPUs take turns, so races want the default instead.
#   VM_THREADS=single: the guest's CPUs take turns in one thread. QEMU 7.2 with a thread each can run code that the guest has patched a moment
#   ago (an "int3" oops, on a busy machine); loading a scheduler patches the kernel each time. So does its boot: a guest that died before its
#   init ran, where nothing of ours has run yet, is booted once more this way.
# Status: 0..123 the guest's own, 124 it took too long, 125 it died without a verdict.
# The verdict travels on the serial line, since neither architecture's Debian cloud kernel can set QEMU's exit status.
set -uo pipefail
kernel=$1 initrd=$2 log=$3 run=${4:-/tests/run}
# Two virtual CPUs are more reliable than four on a machine with two: what waits for a CPU that QEMU does not run looks like a stall.
clock=(-accel "tcg,thread=${VM_THREADS:-multi}")
[ -n "${VM_ICOUNT:-}" ] && clock=(-accel tcg,thread=single -icount "shift=$VM_ICOUNT,sleep=off")
common=("${clock[@]}" -smp "${VM_CPUS:-2}" -m "${VM_MEMORY:-1G}" -nodefaults -no-reboot -display none -serial stdio
  -monitor none ${VM_MORE:-} -kernel "$kernel/vmlinuz" -initrd "$initrd")
append="quiet slab_nomerge oops=panic panic=-1 panic_on_warn=${VM_PANIC_ON_WARN:-0} xauto.run=$run ${VM_APPEND:-}"
case $kernel in
  *-arm64) command=(qemu-system-aarch64 -M "virt,gic-version=3" -cpu "max,pauth-impdef=on" "${common[@]}" -append "console=ttyAMA0 $append") ;;
  # What `max` has beyond this is dear to emulate: loading a scheduler took 1.7 times as long (3 runs each in turns). SMAP and SMEP stay:
  # with them a module that touches user memory by mistake faults.
  *) command=(qemu-system-x86_64 -cpu qemu64,+smap,+smep "${common[@]}" -append "console=ttyS0 $append") ;;
esac
boot() {
  timeout -k 5 "${VM_LIMIT_S:-300}" "$@" </dev/null >"$log" 2>&1
  status=$?
  sed -i 's/\r//g' "$log"
}
boot "${command[@]}"
if [ "$status" -ne 124 ] && ! grep -q '^# .* CPUs, up' "$log"; then
  echo "run-vm: the guest died before its init ran: $(grep -m 1 -E 'Oops|BUG|panic' "$log"); once more, in one thread" >&2
  boot "${command[@]/thread=multi/thread=single}"
fi
[ "$status" -eq 124 ] && exit 124
verdict=$(sed -n 's/^XAUTO-VM-EXIT=\([0-9]*\)$/\1/p' "$log" | tail -n 1)
[ -n "$verdict" ] && exit "$verdict"
exit 125
