#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The kernel side's tests, each in a freshly booted VM: what `make kernel-check` does and `make check` includes.
# usage: kernel-check.sh [BUILD_DIR] [LANE ...]        lanes: see below; default: those of `make check`, or of `make check-full`
#   with XAUTO_FULL=1. VM_APPEND, VM_LIMIT_S: see run-vm.sh; each lane has them.
# Prints failures and a last line "N passed, M failed, K skipped"; the whole logs are in BUILD_DIR/vm/.
set -uo pipefail
cd "$(dirname "$0")/.."
build=${1:-build}
shift || true
lanes=("$@")
out=$build/vm
mkdir -p "$out/failed"
passed=0 failed=0 skipped=0
started=$(date +%s)
note() { echo "kernel-check: $* ($(($(date +%s) - started)) s)"; }

# The TAP streams of a log, counted; what a program planned and did not run counts as failed.
count() {
  local log=$1 counts
  counts=$(awk '
    /^TAP version/ { if (planned > run) lost += planned - run; planned = run = 0 }
    /^1\.\.[0-9]+/ { planned = substr($0, 4) + 0; if ($0 ~ /^1\.\.0 # SKIP/) skip++ }
    /^ok [0-9]+/ { run++; if ($0 ~ /# SKIP/) skip++; else good++ }
    /^not ok [0-9]+/ { run++; bad++ }
    /^Bail out!/ { lost++; planned = run }
    END { if (planned > run) lost += planned - run; print good + 0, bad + lost, skip + 0 }' "$log")
  read -r good bad skip <<<"$counts"
  passed=$((passed + good)) failed=$((failed + bad)) skipped=$((skipped + skip))
  [ "$bad" -eq 0 ] || { grep -E '^not ok|^Bail|^# Planned' "$log" | head -n 20; }
}

# selftests BIN [MAKE_ARGUMENT ...]: installed as the kernel does it; prints the item for the guest
selftests() {
  local bin=$1
  shift
  scripts/vm/install-kselftest.sh "$bin" "$out/kselftest" "$@" || return 1
  echo "$out/kselftest:/kselftest"
}

# in_vm NAME KERNEL_FOLDER RUN [ROOT=DIR] ITEM...: boots, runs, counts. RUN: the script in tests/vm/ that the guest executes.
in_vm() {
  local name=$1 kernel=$2 run=$3 status before=$failed root=()
  shift 3
  case ${1:-} in ROOT=*) root=("$1") && shift ;; esac
  scripts/vm/mk-initrd.sh "$out/$name.cpio" "${root[@]}" "tests/vm/$run:/tests/run" tests/vm/kselftest:/tests/kselftest "$@" || { failed=$((failed + 1)); return; }
  scripts/vm/run-vm.sh "$kernel" "$out/$name.cpio" "$out/$name.log"
  status=$?
  rm -f "$out/$name.cpio"
  count "$out/$name.log"
  case $status in
    0) ;;
    124) echo "kernel-check: $name took longer than ${VM_LIMIT_S:-300} s"; failed=$((failed + 1)) ;;
    125) echo "kernel-check: the guest of $name died without a verdict"; tail -n 15 "$out/$name.log"; failed=$((failed + 1)) ;;
    *) [ "$failed" -gt "$before" ] || { echo "kernel-check: $name ended with status $status"; failed=$((failed + 1)); } ;;
  esac
  note "$name: see $out/$name.log"
}

modules_of() { # KERNEL_FOLDER OUT: builds, prints the items for the guest
  scripts/vm/build-kmod.sh "$1" "$2" || return 1
  local module
  for module in xauto emu/xauto_nvgpu_emu emu/xauto_nvdla_emu; do
    echo "$2/kmod/$module.ko:/modules/$(basename "$module").ko"
  done
}

kmod_kernel() { # NAME [ARCH]: fetch-kernel.sh's, or the self-built one that watches memory and locks
  case $1 in
    kasan) scripts/vm/build-kernel.sh 6.12-kasan ;;
    *) scripts/vm/fetch-kernel.sh "$@" ;;
  esac
}

# What a kernel prints when it finds a fault in itself. The guest looks too, but its buffer ends, and it may not live to look.
reports='KASAN:|possible (recursive|circular|irq)|inconsistent lock state|suspicious RCU|sleeping function called|BUG[: ]|WARNING:'
reports+='|register non-static key|ODEBUG:|UBSAN:|blocked for more than'
no_reports() { # NAME
  grep -qE "$reports" "$out/$1.log" || return 0
  echo "kernel-check: the kernel of $1 reported:"
  grep -m 5 -E "$reports" "$out/$1.log"
  failed=$((failed + 1))
}

# kmod NAME [ARCH]: xauto.ko and the emulators, on one of fetch-kernel.sh's kernels, or on "kasan".
kmod() {
  local kernel items program programs=$build/bin tests append=""
  note "xauto.ko on Linux $1 ${2:-amd64}"
  kernel=$(kmod_kernel "$@") || { failed=$((failed + 1)); return; }
  mapfile -t items < <(modules_of "$kernel" "$out/kmod-$1-${2:-amd64}")
  [ ${#items[@]} -gt 0 ] || { failed=$((failed + 1)); return; }
  if [ "${2:-amd64}" = arm64 ]; then
    programs=$out/arm64-tests
    scripts/vm/build-arm64-tests.sh "$programs" || { failed=$((failed + 1)); return; }
    items=("ROOT=$programs" "${items[@]}") append=" XAUTO_RUNTIME=none"
    tests=$(selftests "$programs" ARCH=arm64 CC=aarch64-linux-gnu-gcc-12 USERLDFLAGS=-static)
  else
    tests=$(selftests "$programs")
  fi || { failed=$((failed + 1)); return; }
  if [ "${2:-amd64}" = amd64 ]; then
    for program in xauto xauto-coordinator xauto-system xauto-emud contexts_app driving; do items+=("$build/bin/$program:/opt/xauto/bin/$program"); done
    items+=(tests/kselftest/kmod/contexts.json:/opt/xauto/contexts.json examples/driving/app.json:/opt/xauto/driving.json)
    items+=("$(command -v bpftool || echo /usr/sbin/bpftool)")
  fi
  items+=("$tests")
  # What the kernel does not know on its command line, init gets as its environment.
  [ -z "${XAUTO_FULL:-}" ] || append="XAUTO_FUZZ=20000 XAUTO_UNLOADS=20 XAUTO_KILLS=1000"
  # lockdep's reports are warnings; "quiet" hides those.
  [ "$1" != kasan ] || append+=" XAUTO_ATTACK=100000 loglevel=5 log_buf_len=4M"
  append+=" ${VM_APPEND:-}" # of the same name the last counts
  # Alone it takes 130 s; beside a compiler twice that.
  VM_APPEND=$append VM_LIMIT_S=${VM_LIMIT_S:-600} in_vm "kmod-$1-${2:-amd64}" "$kernel" run-kmod "${items[@]}"
  no_reports "kmod-$1-${2:-amd64}"
}

# kasan: the kmod lane where memory and locks are watched; then bugs on purpose, each of which must be reported, or the lane is blind.
kasan() {
  local patch name kernel items
  VM_MEMORY=2G VM_LIMIT_S=${VM_LIMIT_S:-2400} kmod kasan
  kernel=$(kmod_kernel kasan) || return
  for patch in tests/vm/plants/*.patch; do
    name=$(basename "$patch" .patch)
    mapfile -t items < <(PLANT=$patch modules_of "$kernel" "$out/plant-$name")
    [ ${#items[@]} -gt 0 ] || { failed=$((failed + 1)); continue; }
    items+=("$out/kselftest:/kselftest") # the lane's
    scripts/vm/mk-initrd.sh "$out/plant-$name.cpio" tests/vm/run-plant:/tests/run "${items[@]}"
    # How the guest ends is not asked: it is broken.
    VM_MEMORY=2G VM_APPEND="loglevel=5" scripts/vm/run-vm.sh "$kernel" "$out/plant-$name.cpio" "$out/plant-$name.log"
    rm -f "$out/plant-$name.cpio"
    if grep -qE "$(sed -n 's/^# reported: //p' "$patch")" "$out/plant-$name.log"; then
      passed=$((passed + 1))
    else
      echo "kernel-check: nothing reported the planted $name; see $out/plant-$name.log"
      failed=$((failed + 1))
    fi
    note "planted $name"
  done
}

scx_kernel() { # NAME: fetch-kernel.sh's 7.x, or the self-built 6.12
  case $1 in
    6.12) scripts/vm/build-kernel.sh 6.12-scx ;;
    *) scripts/vm/fetch-kernel.sh "$1" ;;
  esac
}

# scx NAME: the sched_ext scheduler and the tracer, in the guest's own virtual time: a stall of this machine is none of the guest's.
# At 4 ns an instruction: its spinners last for seconds of that time, and each instruction of theirs is emulated.
scx() {
  local kernel items=() program append=""
  note "sched_ext and tracing on Linux $1"
  kernel=$(scx_kernel "$1") || { failed=$((failed + 1)); return; }
  for program in driving_cpu periodic_cpu xauto xauto-coordinator xauto-emud xauto-cpusched; do items+=("$build/bin/$program"); done
  items+=("$(command -v bpftool || echo /usr/sbin/bpftool)" "$(selftests "$build/bin")")
  for program in unshare setpriv; do items+=("$(command -v $program):/usr/local/bin/$program"); done
  [ -z "${XAUTO_FULL:-}" ] || append="XAUTO_FULL=1 xauto.kills=200 xauto.tables=10000 xauto.loads=8"
  VM_APPEND="$append ${VM_APPEND:-}" VM_ICOUNT=2 VM_LIMIT_S=${VM_LIMIT_S:-900} in_vm "scx-$1" "$kernel" run-scx "${items[@]}"
}

# at-once NAME: of that, what needs CPUs that run at the same time.
at_once() {
  local kernel items=()
  note "sched_ext on CPUs that run at once, on Linux $1"
  kernel=$(scx_kernel "$1") || { failed=$((failed + 1)); return; }
  items=("$build/bin/xauto-cpusched" "$(selftests "$build/bin")")
  VM_APPEND="xauto.at-once ${VM_APPEND:-}" VM_THREADS=single in_vm "at-once-$1" "$kernel" run-scx "${items[@]}"
}

# machine NAME: what takes four CPUs in two clusters, and containers. In the guest's own virtual time.
machine() {
  local kernel items=() program
  note "sched_ext on four CPUs in two clusters, in a container, too, on Linux $1"
  kernel=$(scx_kernel "$1") || { failed=$((failed + 1)); return; }
  items=("$build/bin/xauto-cpusched" "$(selftests "$build/bin")")
  for program in unshare setpriv; do items+=("$(command -v $program):/usr/local/bin/$program"); done
  VM_CPUS=4,sockets=2,cores=2 VM_ICOUNT=1 VM_APPEND="${XAUTO_FULL:+xauto.full} ${VM_APPEND:-}" VM_LIMIT_S=${VM_LIMIT_S:-900} \
    in_vm "machine-$1" "$kernel" run-machine "${items[@]}"
}

# keys NAME: a policy of keys under sched_ext, in the guest's own virtual time. On one CPU: emulated ones take turns, milliseconds each.
keys() {
  local kernel items=() program
  note "keys under sched_ext on Linux $1"
  kernel=$(scx_kernel "$1") || { failed=$((failed + 1)); return; }
  for program in periodic_cpu xauto xauto-coordinator xauto-emud xauto-cpusched; do items+=("$build/bin/$program"); done
  items+=("$(selftests "$build/bin")")
  VM_APPEND="${XAUTO_FULL:+xauto.seconds=190} ${VM_APPEND:-}" VM_ICOUNT=1 VM_CPUS=1 VM_LIMIT_S=${VM_LIMIT_S:-${XAUTO_FULL:+5400}} \
    in_vm "keys-$1" "$kernel" run-keys "${items[@]}"
  grep '^# jobs' "$out/keys-$1.log"
}

# together NAME: two apps on one core under the machine's coordinator, in the guest's own virtual time; then one of them overruns, comes and
# goes, and is killed.
together() {
  local kernel items=() program each
  note "two apps on one core on Linux $1"
  kernel=$(scx_kernel "$1") || { failed=$((failed + 1)); return; }
  for program in xauto xauto-system xauto-coordinator xauto-emud loadapp; do items+=("$build/bin/$program"); done
  # Their plan is made anew: a policy is of one build's certificate.
  "$build/bin/xauto" solve --app tests/vm/together/steady.json --out "$out/steady.policy.json" --app tests/vm/together/wild.json \
    --out "$out/wild.policy.json" --platform tests/vm/together/platform.json --time-limit 1s --reserve 20 >"$out/together.solve" ||
    { failed=$((failed + 1)); return; }
  for each in steady wild platform; do items+=("tests/vm/together/$each.json:/together/$each.json"); done
  for each in steady wild; do items+=("$out/$each.policy.json:/together/$each.policy.json"); done
  VM_APPEND="${XAUTO_FULL:+xauto.seconds=1000 xauto.joins=1000 xauto.kills=300} ${VM_APPEND:-}" VM_ICOUNT=1 VM_CPUS=1 VM_LIMIT_S=${VM_LIMIT_S:-${XAUTO_FULL:+7200}} \
    in_vm "together-$1" "$kernel" run-together "${items[@]}"
  grep -E '^# (all|nobody|joins|kills)[,:]' "$out/together-$1.log"
}

# hosts NAME: an app over two hosts in one guest that keeps time.
hosts() {
  local kernel items=() program
  note "an app over two hosts on Linux $1"
  kernel=$(scx_kernel "$1") || { failed=$((failed + 1)); return; }
  for program in xauto xauto-coordinator xauto-emud testapp; do items+=("$build/bin/$program"); done
  items+=("$build/lib/xauto/cyclonedds.so:/lib/xauto/cyclonedds.so" "$(command -v unshare):/usr/local/bin/unshare" "$(command -v chrt)")
  "$build/bin/xauto" solve --app tests/vm/hosts/app.json --platform tests/vm/hosts/platform.json --max-evaluations 200 \
    --out "$out/hosts.policy.json" >"$out/hosts.solve" || { failed=$((failed + 1)); return; }
  items+=(tests/vm/hosts/app.json:/hosts/app.json tests/vm/hosts/platform.json:/hosts/platform.json "$out/hosts.policy.json:/hosts/policy.json")
  VM_APPEND="${XAUTO_FULL:+xauto.releases=100000} ${VM_APPEND:-}" VM_ICOUNT=1 VM_CPUS=1 VM_LIMIT_S=${VM_LIMIT_S:-${XAUTO_FULL:+7200}} \
    in_vm "hosts-$1" "$kernel" run-hosts "${items[@]}"
  grep -E '^# (kept|load|step):' "$out/hosts-$1.log"
}

# parts NAME: an app over two guests on one wire, each with its own clock, which drifts, is stepped, and whose CPU is taken.
parts() {
  local kernel nic items=() program wire=$out/parts.sock rear
  note "an app over two guests on Linux $1"
  kernel=$(scx_kernel "$1") && mapfile -t nic < <(scripts/vm/fetch-nic.sh "$1") && [ ${#nic[@]} -eq 3 ] ||
    { failed=$((failed + 1)); return; }
  cc -O2 -static -o "$out/guest_clock" tests/vm/parts/guest_clock.c || { failed=$((failed + 1)); return; }
  "$build/bin/xauto" solve --app tests/vm/parts/app.json --platform tests/vm/parts/platform.json --max-evaluations 200 \
    --out "$out/parts.policy.json" >"$out/parts.solve" || { failed=$((failed + 1)); return; }
  for program in xauto xauto-coordinator xauto-emud testapp; do items+=("$build/bin/$program"); done
  for program in app platform; do items+=("tests/vm/parts/$program.json:/parts/$program.json"); done
  for program in "${nic[@]}"; do items+=("$program:/modules/$(basename "$program")"); done
  items+=("$out/guest_clock" "$out/parts.policy.json:/parts/policy.json" "$build/lib/xauto/cyclonedds.so:/lib/xauto/cyclonedds.so")
  rm -f "$wire"
  export VM_CPUS=1 VM_LIMIT_S=${VM_LIMIT_S:-600}
  scripts/vm/mk-initrd.sh "$out/parts-rear.cpio" tests/vm/run-parts:/tests/run "${items[@]}" || { failed=$((failed + 1)); return; }
  (
    while [ ! -S "$wire" ]; do sleep 0.2; done
    VM_MORE="-netdev stream,id=n,server=off,addr.type=unix,addr.path=$wire -device virtio-net-pci,netdev=n,mac=52:54:00:00:00:02" \
      VM_APPEND="xauto.part=rear ${VM_APPEND:-}" scripts/vm/run-vm.sh "$kernel" "$out/parts-rear.cpio" "$out/parts-rear.log"
  ) &
  rear=$!
  VM_MORE="-netdev stream,id=n,server=on,addr.type=unix,addr.path=$wire -device virtio-net-pci,netdev=n,mac=52:54:00:00:00:01" \
    VM_APPEND="xauto.part=front ${VM_APPEND:-}" in_vm "parts-$1" "$kernel" run-parts "${items[@]}"
  kill $rear 2>/dev/null
  wait $rear 2>/dev/null
  rm -f "$wire" "$out/parts-rear.cpio"
}

# The Driving Case over the emulator modules, in the guest's own virtual time.
driving() {
  local kernel items program
  note "the Driving Case through xauto.ko"
  kernel=$(scripts/vm/fetch-kernel.sh 7.x) || { failed=$((failed + 1)); return; }
  mapfile -t items < <(modules_of "$kernel" "$out/kmod-7.x-amd64")
  for program in xauto xauto-coordinator xauto-emud driving; do items+=("$build/bin/$program:/opt/xauto/bin/$program"); done
  VM_ICOUNT=1 in_vm driving "$kernel" run-driving examples/driving/app.json:/opt/xauto/app.json "${items[@]}"
  grep -A 8 '^# driving on' "$out/driving.log"
}

# trace-cmd, perf, bpftrace and bpftool on xauto.ko's events; their packages are the group `trace`. No part of make check.
consumers() {
  local kernel items program tool
  note "who reads xauto.ko's trace events"
  for tool in trace-cmd perf bpftrace bpftool clang-19; do
    PATH=$PATH:/usr/sbin command -v "$tool" >/dev/null ||
      { echo "kernel-check: $tool is missing; run scripts/setup.sh kernel trace" >&2; failed=$((failed + 1)); return; }
  done
  kernel=$(scripts/vm/fetch-kernel.sh 7.x) || { failed=$((failed + 1)); return; }
  mapfile -t items < <(modules_of "$kernel" "$out/kmod-7.x-amd64")
  [ ${#items[@]} -gt 0 ] || { failed=$((failed + 1)); return; }
  clang-19 -g -O2 -target bpf -mcpu=v3 -I"/usr/include/$(uname -m)-linux-gnu" -c tests/vm/consumers.bpf.c -o "$out/consumers.bpf.o" ||
    { failed=$((failed + 1)); return; }
  items+=("$out/consumers.bpf.o:/tests/consumers.bpf.o")
  for program in xauto xauto-coordinator xauto-emud driving; do items+=("$build/bin/$program:/opt/xauto/bin/$program"); done
  for tool in trace-cmd perf bpftrace bpftool; do items+=("$(PATH=$PATH:/usr/sbin command -v "$tool")"); done
  VM_ICOUNT=1 VM_MEMORY=3G VM_LIMIT_S=${VM_LIMIT_S:-600} \
    in_vm consumers "$kernel" run-consumers examples/driving/app.json:/opt/xauto/app.json "${items[@]}"
}

{ # read whole before it runs: the file may be edited meanwhile
if [ ${#lanes[@]} -eq 0 ]; then
  lanes=(kmod-7.x at-once-7.x scx-7.x machine-7.x keys-7.x together-7.x)
  [ -z "${XAUTO_FULL:-}" ] || lanes=(kmod-7.x kmod-6.12 kmod-6.1 kmod-5.10 kmod-6.12-arm64 kmod-kasan driving scx-7.x scx-6.12 at-once-7.x at-once-6.12 machine-7.x keys-7.x keys-6.12 together-7.x parts-7.x hosts-7.x)
fi
if [ ${#lanes[@]} -gt 1 ]; then
  # A guest's clocks go on while this machine stalls, so a lane that fails is run once more, and named; a fault fails twice.
  # One after the other: two emulated machines on two cores stall each other. In `make check` those whose time is this machine's come first.
  for lane in "${lanes[@]}"; do
    for try in 1 2; do
      "$0" "$build" "$lane" >"$out/$lane.out" 2>&1 && break
      echo "kernel-check: $lane failed, try $try of 2:"
      grep -E '^not ok|^Bail|^kernel-check' "$out/$lane.out" | head -n 8 | sed 's/^/  /'
      cp "$out"/"$lane"*.log "$out/failed/" 2>/dev/null
    done
    head -n -1 "$out/$lane.out"
    if [[ $(tail -n 1 "$out/$lane.out") =~ ^([0-9]+)\ passed,\ ([0-9]+)\ failed,\ ([0-9]+)\ skipped ]]; then
      passed=$((passed + BASH_REMATCH[1])) failed=$((failed + BASH_REMATCH[2])) skipped=$((skipped + BASH_REMATCH[3]))
    else
      echo "kernel-check: $lane gave no count" && failed=$((failed + 1))
    fi
  done
else
  lane=${lanes[0]}
  case $lane in
    driving | consumers) "$lane" ;;
    scx-*) scx "${lane#scx-}" ;;
    at-once-*) at_once "${lane#at-once-}" ;;
    machine-*) machine "${lane#machine-}" ;;
    keys-*) keys "${lane#keys-}" ;;
    together-*) together "${lane#together-}" ;;
    hosts-*) hosts "${lane#hosts-}" ;;
    parts-*) parts "${lane#parts-}" ;;
    kmod-kasan) kasan ;;
    kmod-*-arm64) lane=${lane#kmod-} && kmod "${lane%-arm64}" arm64 ;;
    kmod-*) kmod "${lane#kmod-}" ;;
    *)
      echo "kernel-check: no lane '$lane'" >&2
      exit 2
      ;;
  esac
fi
echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" -eq 0 ] && [ "$passed" -gt 0 ]
  exit
}
