#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes the packages for JetPack (arm64; scripts/packages.sh) and tries them: what they need; their programs under QEMU's user emulation beside
# nothing but Debian 11's libc and libstdc++; and on an emulated arm64 machine with systemd and DKMS. Ubuntu itself is not at hand: Debian
# 11 has the same glibc and libstdc++ as Ubuntu 20.04 (JetPack 5), and older ones than JetPack 6 and 7.
# usage: jetpack-check.sh       Prints TAP and a last line "N passed, M failed, K skipped"
set -uo pipefail
root=$(realpath "$(dirname "$0")/..")
cd "$root" || exit 2
. tests/package/tap.sh
if [ "${1:-}" != --inside ]; then
  if [ "$(id -u)" -ne 0 ] || ! unshare --mount --pid --fork true 2>/dev/null; then
    echo "jetpack-check: skipped: another root needs mount and PID namespaces: run it as root, in a container with CAP_SYS_ADMIN" >&2
    echo "0 passed, 0 failed, 1 skipped"
    exit 0
  fi
  mkdir -p build-jetpack
  "$0" --inside </dev/null 2>&1 | tee build-jetpack/check.log
  total build-jetpack/check.log "${PIPESTATUS[0]}"
  exit
fi

{ # read whole before it runs: the file may be edited meanwhile
out=$root/build-jetpack
tree=$out/tree
tool=$tree/usr/libexec/xauto/xauto

# A tree of three packages of Debian's and of ours. An arm64 program does not start here by itself: each is behind a script that starts the
# emulator, so that programs find and start each other as they do on a board.
unpack() {
  local tar deb program
  rm -rf "$tree"
  mkdir -p "$tree"
  tar=$(scripts/package-root.sh jetpack)
  tar -xOf "$tar" ./var/lib/dpkg/info/{libc6,libstdc++6,libgcc-s1}:arm64.list | grep -E '^/(usr/)?lib/.*\.so' | sed 's/^/./' >"$out/tree.list"
  tar -xf "$tar" -C "$tree" -T <(grep -vE 'gdb|gconv|audit' "$out/tree.list")
  for deb in "$out"/debs/*_arm64.deb; do dpkg-deb -x "$deb" "$tree"; done
  mkdir -p "$tree/apps"
  cp "$out"/apps/driving* "$tree/apps"
  for program in "$tree"/usr/libexec/xauto/xauto* "$tree"/apps/*; do emulate "$program"; done
}
emulate() {
  mv "$1" "$1.arm64"
  printf '#!/bin/sh\nexec qemu-aarch64-static -L %s %s.arm64 "$@"\n' "$tree" "$1" >"$1"
  chmod 755 "$1"
}
programs() { find "$tree/usr" -type f \( -path '*/libexec/xauto/*' -o -name 'libxauto.so.*' \) ! -path '*/lib/aarch64-linux-gnu/libc*' -exec sh -c 'head -c 4 "$1" | grep -q ELF' sh {} \; -print; }
# Ubuntu 20.04: glibc 2.31, libstdc++ of GCC 10.
needs() {
  local program
  programs >"$out/programs"
  [ "$(wc -l <"$out/programs")" -eq 8 ] # library, six programs, what is preloaded
  while read -r program; do
    readelf -h "$program" | grep -q AArch64
    readelf -d "$program" | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p' >"$out/needed"
    absent grep -vE '^(libc\.so\.6|libm\.so\.6|libdl\.so\.2|libpthread\.so\.0|librt\.so\.1|libstdc\+\+\.so\.6|libgcc_s\.so\.1|ld-linux-aarch64\.so\.1)$' "$out/needed"
  done <"$out/programs"
  xargs readelf -V <"$out/programs" | grep -oE '(GLIBC|GLIBCXX|CXXABI)_[0-9.]+' | sort -u -V >"$out/versions"
  newest() { grep "^$1_" "$out/versions" | tail -n 1 | sed 's/.*_//'; }
  for pair in GLIBC:2.31 GLIBCXX:3.4.28 CXXABI:1.3.12; do
    echo "$pair: $(newest "${pair%:*}")"
    [ "$(printf '%s\n' "$(newest "${pair%:*}")" "${pair#*:}" | sort -V | tail -n 1)" = "${pair#*:}" ]
  done
}
depends() {
  local deb name version
  for deb in "$out"/debs/*.deb; do
    dpkg-deb -f "$deb" Pre-Depends Depends | sed 's/^[^:]*: //' | tr ',' '\n' | sed 's/^ *//' | while read -r name version; do
      case $name in
        libc6) limit=2.31-0ubuntu9 ;;
        libstdc++6) limit=10.3.0-1ubuntu1~20.04 ;;
        libgcc-s1) limit=10.3.0-1ubuntu1~20.04 ;;
        dkms) limit=2.8.1-5ubuntu1 ;;
        python3:any) limit=3.8.2-0ubuntu2 ;;
        libxauto1) continue ;;
        *) echo "$(basename "$deb") needs $name"; exit 1 ;;
      esac
      version=$(grep -oE '[0-9][^)]*' <<<"$version" || echo 0)
      echo "$(basename "$deb"): $name $version, there is $limit"
      dpkg --compare-versions "$version" le "$limit"
    done
  done
  python3 -c 'import ast, sys; [ast.parse(open(f).read(), f, feature_version=(3, 8)) for f in sys.argv[1:]]' tools/python/xauto/*.py
}
doctor() {
  "$tool" doctor | tee "$out/said"
  absent grep -iE 'error while loading|not found \(required' "$out/said"
}
# HEFT is the same everywhere. For several rates the search ends by the clock: each checks what the other has found.
solve() {
  local driving=examples/driving there here
  there=$("$tool" solve --app $driving/app.json --platform small --method heft --out "$out/app.policy.json" --json | figures)
  here=$(build/bin/xauto solve --app $driving/app.json --platform small --method heft --json | figures)
  [ -n "$here" ] && [ "$there" = "$here" ] || { echo "emulated $there, here $here"; exit 1; }
  "$tool" check --app $driving/app.json --platform small --policy "$out/app.policy.json"
  "$tool" solve --app $driving/rates.json --platform small --time-limit 3s --out "$out/there.json"
  build/bin/xauto solve --app $driving/rates.json --platform small --time-limit 1s --out "$out/here.json"
  "$tool" check --app $driving/rates.json --platform small --policy "$out/here.json"
  build/bin/xauto check --app $driving/rates.json --platform small --policy "$out/there.json"
}
figures() { grep -oE '"(release|worst_case|lower_bound)_us": *[0-9]+' | tr -d ' ' | tr '\n' ' '; }
demo() {
  "$tool" compare --app examples/driving/app.json --platform small --overload queue:8 --activations 20 --out "$out/demo" -- "$tree/apps/driving"
  [ -s "$out/demo/report.html" ]
  "$tool" compare --app examples/driving/rates.json --platform small --duration 2s --time-limit 2s --out "$out/demo/rates" -- "$tree/apps/driving-rates"
  [ -s "$out/demo/rates/report.html" ]
}
# As on a board, with a compiler as old as we promise and no header but ours.
template() {
  local cross=$out/cross app=$tree/apps/template
  rm -rf "$cross"
  mkdir -p "$cross"
  tar -xf "$(scripts/package-root.sh jetpack)" -C "$cross"
  for deb in "$out"/debs/*_arm64.deb; do dpkg-deb -x "$deb" "$cross"; done
  rm -r "$cross/usr/include/tl"
  cp -r examples/template "$cross/template"
  chroot "$cross" cmake -S /template -B /template/build -DCMAKE_SYSTEM_NAME=Linux -DCMAKE_CXX_COMPILER=aarch64-linux-gnu-g++ -DCMAKE_BUILD_TYPE=Release
  chroot "$cross" cmake --build /template/build
  chroot "$cross" env PKG_CONFIG_LIBDIR=/usr/lib/aarch64-linux-gnu/pkgconfig \
    sh -c 'aarch64-linux-gnu-g++ $(pkg-config --cflags xauto) /template/main.cc $(pkg-config --libs xauto) -o /template/by-pkgconfig'
  cp "$cross/template/build/template" "$app"
  emulate "$app"
  cd "$out"
  "$tool" profile --platform small --emulate --repetitions 3 --app-out template.json -- "$app"
  "$tool" solve --app template.json --platform small --out template.policy.json
  "$tool" run --app template.json --platform small --emulate --policy template.policy.json --activations 20 --lockstep -- "$app" 2>&1 | tee said
  grep -F 'template: 20 frames tracked' said
  rm -rf "$cross"
}
boot() {
  local disk
  disk=$(scripts/vm/board-disk.sh)
  rm -rf "$out/second" && mkdir "$out/second"
  cp "$out"/debs/*.deb "$out/apps/driving" tests/package/tap.sh "$out/second"
  cp examples/driving/app.json "$out/second/app.json"
  cp "$out/app.policy.json" "$out/second/policy.json"
  cp tests/package/on-board.sh "$out/second/run"
  tar -C "$out/second" -cf "$out/second.tar" .
  VM_LIMIT_S=2400 scripts/vm/run-board.sh "$disk" "$out/board.log" "$out/second.tar"
}

LIMIT_S=1500
check "packages are made" scripts/packages.sh jetpack || { plan; exit 1; }
LIMIT_S=300
check "unpacked beside libc and libstdc++ alone" unpack || { plan; exit 1; }
check "its programs need libc, libm and the compiler's libraries, as old as Ubuntu 20.04's" needs
check "its packages depend on what Ubuntu 20.04 has" depends
check "emulated: doctor" doctor
check "emulated: solve finds what this machine's does; each checks the other's policy" solve
check "emulated: the Driving Case under each policy, both demos" demo
check "the template app is built with find_package and with pkg-config, and runs emulated" template
plan
here_bad=$bad
boot
grep -E '^(ok|not ok) [0-9]|^1\.\.|^#' "$out/board.log" || { echo "not ok 1 - the board boots"; tail -n 20 "$out/board.log" | sed 's/^/#   /'; echo "1..1"; exit 1; }
grep -qE '^not ok' "$out/board.log" && exit 1
[ "$here_bad" -eq 0 ]
exit
}
