#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What `make check` does: style, the tests in a release build, the kernel side in booted VMs, the tests under ASan+UBSan and under
# TSan, and the Debian packages in a clean root where what makes them changed; what waits runs beside what computes. Each part
# runs by itself with `make style|unit|asan|tsan|fuzz|kernel-check|package-check|floor-check|jetpack-check`; `make check-fast` and `make check-full` do less and more.
# What failed is named again before the last line, which is the count over all parts.
set -uo pipefail
cd "$(dirname "$0")/.."
jobs=${JOBS:-2}
passed=0 failed=0 skipped=0
failures=$(mktemp) late=$(mktemp)
trap 'rm -f "$failures" "$late"' EXIT
started=$(date +%s)

failure() { failed=$((failed + 1)); echo "$1" >>"$failures"; }
# With the time since the start, and the CPU time of what has ended (in /proc in hundredths).
note() {
  local stat
  read -ra stat </proc/$$/stat
  echo "check: $* ($(($(date +%s) - started)) s, CPU $(((stat[15] + stat[16]) / 100)) s)"
}

# One check that is no ctest: counts as a test. Status 77: skipped, and it says why.
one() {
  local name=$1 log status
  shift
  log=$(mktemp)
  "$@" >"$log" 2>&1
  status=$?
  case $status in
    0) passed=$((passed + 1)) ;;
    77)
      skipped=$((skipped + 1))
      echo "check: skipped: $name: $(tail -n 1 "$log")"
      ;;
    *)
      failure "$name"
      echo "check: FAILED: $name"
      head -n 60 "$log"
      ;;
  esac
  rm -f "$log"
}

build() {
  local preset=$1 dir=$2
  shift 2
  note "build $preset"
  if ! { cmake --preset "$preset" && ninja -C "$dir" -j"$jobs" "$@"; } >"build-$preset.log" 2>&1; then
    grep -E 'error|warning|FAILED' -A 5 "build-$preset.log" | head -n 60
    echo "check: the $preset build failed; its log is build-$preset.log"
    failure "the $preset build"
    return 1
  fi
}

# ctest_shown DIR CTEST_ARGUMENT...: ctest, without what passed.
ctest_shown() {
  local dir=$1 report=$PWD/$1/junit.xml
  shift
  rm -f "$report"
  (cd "$dir" && ctest --output-on-failure --output-junit "$report" "$@") </dev/null | tee "$dir/ctest.log" |
    grep -vE '^ *(Start |[0-9]+/[0-9]+ Test .*Passed|Test +#[0-9]+: .*Passed)'
  return "${PIPESTATUS[0]}"
}
# ctest_counted DIR CTEST_ARGUMENT...: ctest, and what scripts/count-tests.py counts of it: of each test, or with `reports` set, of
# each test of gtest's reports. `again` says what is to run again: names, "|" between them.
ctest_counted() {
  local dir=$1 status passes bad skip
  shift
  ctest_shown "$dir" -j"${parallel:-$jobs}" "$@"
  status=$?
  { read -r passes bad skip again; sed "s|$| ($dir)|" >>"$failures"; } < <(scripts/count-tests.py "$dir" ${reports:+"$reports"})
  failed=$((failed + bad))
  if [ "$bad" -eq 0 ] && [ -z "$again" ] && { [ "$status" -ne 0 ] || [ "$passes" -eq 0 ]; }; then
    echo "check: ctest in $dir ended with status $status, $passes passed"
    failure "ctest in $dir"
  fi
  passed=$((passed + passes))
  skipped=$((skipped + skip))
}

# tests DIR CTEST_ARGUMENT...: each in a process of its own. Threads and processes run in real time, on machines that stand still
# for a quarter of a second: a test that fails is run once more, by `once_more`, and named. But for a sanitizer's report.
tests() {
  local reports='' again
  ctest_counted "$@" --timeout 300
  [ -z "$again" ] || echo "$1 $again" >>"$late"
}

# areas DIR CTEST_ARGUMENT...: unit tests, those of an area in one process (a process of its own per test cost as much CPU time as
# the tests). An area that fails is run again, each test by itself, and that counts; but for a sanitizer's report.
areas() {
  local reports=$PWD/$1/tests/areas again
  rm -rf "$reports"
  ctest_counted "$@" -L '^area$' --timeout 600
  [ -z "$again" ] || { note "each by itself: ${again//|/, }"; tests "$1" -L unit -R "^($again)\\."; }
}

# What failed, one after the other, when nothing else of the check runs any more: this counts.
once_more() {
  local dir names bad reports='' again parallel=1
  while read -r dir names; do
    note "once more, alone: ${names//|/, }"
    ctest_counted "$dir" -R "^(${names//./\\.})\$" --timeout 300
    mapfile -t bad < <(tr '|' '\n' <<<"$again" | sed '/^$/d' | sort)
    failed=$((failed + ${#bad[@]}))
    [ ${#bad[@]} -eq 0 ] || printf "%s ($dir)\n" "${bad[@]}" >>"$failures"
    tr '|' '\n' <<<"$names" | sort | comm -23 - <(printf '%s\n' "${bad[@]}") |
      sed 's/^/check: /; s/$/ failed, and passed when it was run again/'
  done <"$late"
}

style() {
  note "style"
  one "clang-format" bash -c 'scripts/sources.sh | xargs clang-format --dry-run -Werror'
  one "codespell" bash -c 'git ls-files | grep -vE "\.(db3|json|png|svg)$|^LICENSES/|corpus/" | xargs codespell -L te,ot,nd,inout,dout,fo,ans,ser,fpr,thre,hist,tha,lod,renderd,tre,siz,parm,rcd,lastr'
  one "SPDX lines" scripts/check-spdx.sh
  one "the kernel side's style" scripts/check-kernel-style.sh
  one "paths named in the docs exist" scripts/check-doc-paths.sh
  one "Markdown lines of at most 120 columns" scripts/check-doc-lines.py
  one "functions of at most 80 lines" scripts/check-function-length.py
  one "the API is documented (doxygen)" scripts/check-api-docs.sh
  one "clang-tidy, of what changed" scripts/check-tidy.sh
}
# What runs where, each test once if it can: unit tests under ASan+UBSan, those that need speed (label `heavy`: the explorer of the
# protocol, the solver's) in the release build, with the integration scripts; those with threads under TSan as well (two that
# take long there have none). CONTRIBUTING.md says what is left to `full`; so are three of UBSan's checks, which stand before each
# access to memory: a quarter of what that build cost.
release=(xauto xauto-coordinator xauto-emud xauto-cpusched xauto-system xauto-standin driving camera integration_programs xauto_shared xauto_watch xauto_help heavy_tests test_solver)
threaded='base|trace|coord|transport|processes|runtime'
unit() { build ci build "${release[@]}" && { heavy; integration build -LE long; }; }
# They mostly wait: a quarter of their time is work.
integration() { local dir=$1 parallel=$((3 * jobs)); shift; tests "$dir" -L integration "$@"; }
asan_build() { build asan build-asan unit_tests fuzzers; }
fuzzers() { note "fuzzers"; tests build-asan -L fuzz; }
asan_tests() { note "tests, ASan+UBSan"; areas build-asan; }
asan() { asan_build && asan_tests && fuzzers; }
tsan_build() {
  local targets
  IFS='|' read -ra targets <<<"$threaded"
  build tsan build-tsan "${targets[@]/#/test_}"
}
tsan_tests() { note "tests, TSan"; areas build-tsan -R "^area\.($threaded)\$"; }
tsan() { tsan_build && tsan_tests; }
heavy() { note "heavy tests, release"; tests build -L heavy; }
# A VM takes one core most of the time: beside it go tests, one by one until the last VM has ended. What has most to compute comes last.
beside_the_vms() {
  local parallel=$jobs
  ! kill -0 "$side" 2>/dev/null || parallel=1
  "$@"
}
kernel_and_sanitizers() {
  kernel_build || { asan; tsan; heavy; return; }
  beside "the kernel side" scripts/kernel-check.sh build
  renice -n 10 -p $$ >/dev/null # a guest that waits for its core sees a stall
  # `builds` has made them, in a process of its own: this only finds that out.
  tsan_build && beside_the_vms tsan_tests
  asan_build && { beside_the_vms fuzzers; beside_the_vms asan_tests; }
  heavy # a VM that still runs goes before them
  note "the rest of the VMs"
  joined
}
# For the inner loop: every unit test in the release build, but for the heavy ones.
fast() {
  one "clang-format" bash -c 'scripts/sources.sh | xargs clang-format --dry-run -Werror'
  build ci build unit_tests && { note "unit tests, release"; areas build; }
}
# What takes long: every test in every build, each file compiled alone, every kernel, the explorer's largest worlds.
full() {
  export XAUTO_FULL=1
  threaded+='|emu|profile|launch|ros2'
  style
  build debug build-debug
  one "what \`make\` builds where only the group build is installed" \
    bash -c 'cmake --preset release -B build-bare -DXAUTO_BPF=OFF -DXAUTO_PEDESTRIANS=OFF && ninja -C build-bare'
  build ci build && { note "tests, release"; tests build -LE 'integration|area'; integration build; }
  one "attacks on policies of keys" build/tests/attack_keys --policies 40 --solved 10 # 10^8 jobs
  counted "signals to living runs" tests/attack/signals.py build/bin --signals 2000
  counted "packets to living runs" tests/attack/packets.py build/bin --seconds 1800
  build asan-all build-asan && { note "tests, ASan+UBSan"; tests build-asan -L 'unit|fuzz'; integration build-asan; }
  tests build-asan -L heavy -R 'BruteForce|Simulate|Objectives|TheAttack|LeastLoss|KeysHandover|KeysDrift|KeysChains|KeyTables|Stretches' # two minutes
  tsan
  kernel
  package
  floor
  jetpack
}
# A script whose last line is "N passed, M failed, K skipped".
counted() {
  local name=$1 counts log named
  shift
  log=$(mktemp) named=$(wc -l <"$failures")
  "$@" | tee "$log"
  counts=$(tail -n 1 "$log")
  grep -E '^(check: failed: |not ok |kernel-check: .* failed, try 2)' "$log" | sed "s|^check: failed: ||; s|^not ok|$name: &|" >>"$failures"
  rm -f "$log"
  if [[ $counts =~ ^([0-9]+)\ passed,\ ([0-9]+)\ failed,\ ([0-9]+)\ skipped ]]; then
    passed=$((passed + BASH_REMATCH[1]))
    failed=$((failed + BASH_REMATCH[2]))
    [ "${BASH_REMATCH[2]}" -eq 0 ] || [ "$named" -lt "$(wc -l <"$failures")" ] || echo "$name" >>"$failures"
    skipped=$((skipped + BASH_REMATCH[3]))
  else
    echo "check: $name gave no count"
    failure "$name: no count"
  fi
}
# beside NAME SCRIPT ARGUMENT...: starts a script whose last line is a count. `joined` waits for it, shows what it said, counts it.
beside() {
  side_name=$1 side_log=$(mktemp)
  shift
  "$@" >"$side_log" 2>&1 &
  side=$!
}
joined() {
  wait "$side"
  counted "$side_name" cat "$side_log"
  rm -f "$side_log"
}
# Programs and modules in VMs; scripts/kernel-check.sh counts them.
kernel_build() {
  build ci build "${release[@]}" kmod_tests scx_tests || return
  note "kernel side, in VMs"
}
kernel() { kernel_build && counted "the kernel side" scripts/kernel-check.sh build; }
# Style beside the compiler; the sanitizers' builds, which compute, beside the integration scripts, which mostly wait: they have what
# those leave. So have the packages, where they are to be tried.
release_and_builds() {
  local built=1
  note "style, beside the build"
  beside "style" scripts/check.sh style
  build ci build "${release[@]}" kmod_tests scx_tests && built=0
  joined
  [ $built -eq 0 ] || return
  note "integration, beside the builds for the sanitizers"
  beside "the builds" chrt --idle 0 scripts/check.sh builds
  integration build -LE long
  joined
}
builds() {
  asan_build
  tsan_build
  one "what libxauto exports" scripts/check-exports.sh build
  scripts/package-check.sh --tried || try_packages
}
floor() {
  note "the oldest tools, in a Debian 11 root"
  counted "the oldest tools" scripts/floor-check.sh
}
jetpack() {
  build ci build xauto || return
  note "the packages for JetPack, on an emulated arm64 machine"
  counted "the packages for JetPack" scripts/jetpack-check.sh
}
# The Debian packages, made of the release build and tried in a clean root; scripts/package-check.sh counts.
try_packages() {
  note "packages, in a clean Debian root"
  counted "the packages" scripts/package-check.sh build
}
# What makes them is noted where all passed: until it is something else, `check` need not try them.
package() {
  local before=$failed:$skipped
  build ci build "${release[@]}" || return
  try_packages
  [ "$failed:$skipped" != "$before" ] || scripts/package-check.sh --inputs >tests/package/tried
}
fuzz() { asan_build && fuzzers; }

case ${1:-check} in
  check)
    release_and_builds
    kernel_and_sanitizers
    ;;
  style | builds | unit | asan | tsan | fuzz | kernel | package | fast | full | floor | jetpack) "$1" ;;
  *)
    echo "usage: scripts/check.sh [check|fast|full|style|unit|asan|tsan|fuzz|kernel|package|floor]" >&2
    exit 2
    ;;
esac
once_more
note "done"
sort -u "$failures" | sed 's/^/check: failed: /'
echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" -eq 0 ] && [ "$passed" -gt 0 ]
