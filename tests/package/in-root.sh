#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What a robotics engineer does with the packages, in a clean Debian 12 root (scripts/package-check.sh): install, link, profile, solve, run,
# report, build the module, remove. At the end the root must be what it was. Prints TAP.
set -uo pipefail
. /tmp/tap.sh
cd /tmp || exit 2
packages="libxauto1 libxauto-dev xauto-tools xauto-dkms python3-xauto"
triplet=$(dpkg-architecture -qDEB_HOST_MULTIARCH 2>/dev/null || gcc -dumpmachine)

# Everything that is there: names, kinds, modes, owners, contents of /etc. Left out: what dpkg, apt, ldconfig, depmod and man-db keep about
# whatever was installed, DKMS's own signing key, made with the first module that it builds, and this test's own folder.
listing() {
  find / -xdev \( -path /proc -o -path /sys -o -path /tmp -o -path /dev -o -path /var/lib/dpkg -o -path /var/lib/apt -o -path /var/cache \
    -o -path /var/log -o -path '/usr/lib/modules/*/modules.*' -o -path /etc/ld.so.cache -o -path '/var/lib/dkms/mok.*' -o -path /run/systemd -o -name '__pycache__' \) -prune \
    -o -printf '%p %y %m %U:%G %l\n' | sort
  find /etc -xdev -type f ! -name 'ld.so.cache' -exec sha256sum {} + | sort -k 2
  ls -AR /dev/shm /sys/fs/bpf
}
# As a person would type it, with the network, which nothing after it has.
install_all() {
  apt-get update -qq
  apt-get install -y --no-install-recommends "$@"
}
purge_all() {
  # shellcheck disable=SC2086
  apt-get purge -y $packages
  apt-get autoremove -y --purge
}
nothing_left() {
  listing >after
  diff before after
  dpkg -l >installed
  absent grep xauto installed
}

kernel() { basename "$(ls -d /usr/lib/modules/*/build | head -n 1 | xargs dirname)"; }
module_fits() {
  local ko
  dkms status -m xauto | grep -F "$(kernel)" | grep -F installed
  ko=$(find "/lib/modules/$(kernel)/updates/dkms" -name 'xauto.ko*')
  [ "$(modinfo -F vermagic "$ko" | cut -d ' ' -f 1)" = "$(kernel)" ]
  [ "$(modinfo -F name "$ko")" = xauto ]
  [ "$(find /lib/modules -name 'xauto*.ko*' | wc -l)" -eq 1 ] # no emulators, no other kernel
}
# The headers of one kernel under another one's name, as where `build` is a link to the running kernel's.
wrong_kernel() {
  rm -rf /tmp/wrong && cp -r "$(ls -d /usr/src/xauto-*)" /tmp/wrong
  refused "is for '$(kernel)', not for '9.9.9-other'" /tmp/wrong/build-for.sh 9.9.9-other "/lib/modules/$(kernel)/build"
  [ ! -e /tmp/wrong/kmod/xauto.ko ]
  refused 'is no kernel build tree: install the headers of 9.9.9-other' /tmp/wrong/build-for.sh 9.9.9-other /lib/modules/9.9.9-other/build
}

headers_alone() {
  local header failed=0
  for header in /usr/include/xauto/*.h; do
    case $header in */onnx.h | */opencl.h | */cuda.h | */cuda_graph.h | */tensorrt.h | */cudla.h | */vpi.h | */ros2.h) continue ;; esac # only beside a library that is the app's
    echo "#include <xauto/$(basename "$header")>" | g++ -std=c++20 -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Werror -fsyntax-only -x c++ - ||
      failed=1
  done
  return $failed
}
with_cmake() {
  cp -r /usr/share/doc/libxauto-dev/examples/template /tmp/template
  cmake -S /tmp/template -B /tmp/template/build -DCMAKE_BUILD_TYPE=Release
  cmake --build /tmp/template/build
  ldd /tmp/template/build/template | grep -E 'libxauto\.so\.1 => .*/libxauto\.so\.1 '
}
with_pkgconfig() {
  # shellcheck disable=SC2046
  g++ $(pkg-config --cflags xauto) /tmp/template/main.cc $(pkg-config --libs xauto) -o /tmp/by-pkgconfig
  ldd /tmp/by-pkgconfig | grep 'libxauto.so.1 =>'
  [ "$(pkg-config --modversion xauto)" = "$(xauto --version | grep -oE '[0-9.]+$')" ]
}
newer_wanted() {
  mkdir -p /tmp/newer
  printf 'cmake_minimum_required(VERSION 3.20)\nproject(n CXX)\nfind_package(xauto 0.99 REQUIRED)\n' >/tmp/newer/CMakeLists.txt
  refused 'compatible with|requested version' cmake -S /tmp/newer -B /tmp/newer/build
}

use() {
  cd /tmp/template
  timeout 60 xauto profile --platform small --emulate --repetitions 10 --out profile.json --app-out app.json -- build/template
  timeout 60 xauto solve --app app.json --platform small --out policy.json
  timeout 60 xauto check --app app.json --platform small --policy policy.json
  # Which XPU is best is not asked: a machine that stands still for 12 ms while the GPU is measured makes it a CPU.
  grep -A 2 '"name": *"detect.infer"' policy.json | grep -E '(cpu|gpu)[0-9]'
  timeout 60 xauto run --app app.json --platform small --emulate --policy policy.json --activations 40 --lockstep --trace-out run.pftrace \
    --out report.json -- build/template 2>&1 | tee said
  grep -F 'template: 40 frames tracked' said
  timeout 60 xauto report run.pftrace --out report.html
  grep -q 'detect.infer' report.html
  python3 -c 'import xauto; assert len(xauto.jobs("run.pftrace")) >= 40 and xauto.chains(xauto.load("report.json"))'
  # A program that is started by itself finds the tool in the PATH.
  refused 'app' timeout 60 build/template
  absent grep xauto /proc/net/unix
  [ -z "$(ls -A /dev/shm)" ]
}
# As xauto@.service runs it: without root, until it is told to stop, which is a good end.
without_root() {
  cd /tmp/template
  timeout --preserve-status -s TERM 3 setpriv --reuid 65534 --regid 65534 --clear-groups xauto run --app app.json --platform small --emulate \
    --policy policy.json --overload queue:64 --activations 0 -- build/template 2>&1 | tee said
  grep -E 'template: [1-9][0-9]* frames tracked' said
  grep -F 'stopped by the user' said
}
dependencies_there() {
  local program
  for program in /usr/libexec/xauto/* "/usr/lib/$triplet/libxauto.so.1"; do
    ldd "$program" >needs
    absent grep 'not found' needs
  done
  [ "$(ls /usr/libexec/xauto | wc -l)" -eq 7 ] # programs, and the library that is preloaded
}
# Whoever has no right to real-time priorities is told of a file; the example has the lines that it wants.
limit_told() {
  prlimit --rtprio=0 setpriv --reuid 65534 --regid 65534 --clear-groups xauto doctor | tee said
  grep -F /etc/security/limits.d/xauto.conf said
  grep -vE '^(#|@xauto - (rtprio 60|memlock unlimited)$)' /usr/share/doc/xauto-tools/examples/limits.conf >others || true
  [ ! -s others ]
  grep -Fx '@xauto - rtprio 60' /usr/share/doc/xauto-tools/examples/limits.conf
}
pages() {
  local verb
  export MANWIDTH=80
  for verb in $(xauto --help | awk '/^Subcommands:/ { on = 1; next } /^$/ { on = 0 } on { print $1 }'); do
    says 'EXIT STATUS' man "xauto-$verb"
  done
  says /etc/xauto/NAME.conf man xauto
}
completion() {
  bash -ec '
    . /usr/share/bash-completion/bash_completion
    _completion_loader xauto || true
    complete -p xauto
    COMP_WORDS=(xauto so) COMP_CWORD=1
    _xauto
    [ "${COMPREPLY[*]}" = solve ]'
}
unit() {
  mkdir -p /etc/xauto
  cp /usr/share/doc/xauto-tools/examples/camera.conf /etc/xauto/
  systemd-analyze verify --man=no xauto@camera.service
  systemd-analyze verify --man=no xauto-system.socket xauto-system.service
  rm -r /etc/xauto
  systemd-tmpfiles --create xauto-tools.conf
  if mountpoint -q /sys/fs/bpf; then [ -d /sys/fs/bpf/xauto ]; fi
}

listing >before
LIMIT_S=600
check "install" install_all /tmp/debs/*.deb || { plan; exit 1; }
check "the module was built for the kernel whose headers are there, and for no other" module_fits
check "a module for another kernel than asked for is a failed build" wrong_kernel
check "all that the programs need came along" dependencies_there
check "each installed header compiles alone" headers_alone
check "the template app builds with find_package(xauto)" with_cmake
check "the template app builds with pkg-config" with_pkgconfig
check "find_package() refuses a version that is not there" newer_wanted
check "profile, solve, check, run, report; no socket and no shared memory is left" unshare --net bash -eo pipefail -c use
check "runs without root until it is told to stop" without_root
check "a user is told how to get real-time priorities" limit_told
check "a man page for each verb" pages
check "bash completes verbs" completion
check "the systemd unit and tmpfiles are valid" unit
check "purge" purge_all
check "nothing is left behind" nothing_left
plan
