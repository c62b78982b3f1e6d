#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes the packages of a finished build and tries them: lintian, the ABI, and in a clean Debian 12 root install, build the template
# app, profile, solve, run, report, build the module by DKMS, purge. What `make package-check` does, and
# `make check` where --tried says no.
# usage: package-check.sh [BUILD_DIR]       Prints TAP and a last line "N passed, M failed, K skipped"; logs in BUILD_DIR/package/
#        package-check.sh --inputs           a hash of what makes the packages and tries them, but for what is compiled
#        package-check.sh --tried            status 0: it is that of tests/package/tried, with which all of it passed
# Everything is mounted in a mount namespace of its own, in memory: however this ends, nothing stays mounted.
set -uo pipefail
root=$(realpath "$(dirname "$0")/..")
cd "$root" || exit 2
. tests/package/tap.sh
inputs() {
  git ls-files -z -- debian packaging include kmod Kbuild LICENSE CMakeLists.txt cmake {lib,solver,tools}/CMakeLists.txt examples/template \
    examples/camera tools/python scripts/package-{abi,build,check,root}.sh tests/package ':!tests/package/tried' |
    xargs -0 sha256sum | sha256sum | cut -d ' ' -f 1
}
case ${1:-} in
  --inputs) inputs; exit ;;
  --tried) [ "$(inputs)" = "$(cat tests/package/tried 2>/dev/null)" ]; exit ;;
esac
if [ "${1:-}" != --inside ]; then
  build=$(realpath -m "${1:-build}")
  if [ "$(id -u)" -ne 0 ] || ! unshare --mount --pid --fork true 2>/dev/null; then
    # Said and counted, not failed: a container without these rights says nothing about the packages.
    echo "package-check: skipped: a clean root needs mount and PID namespaces: run it as root, in a container with CAP_SYS_ADMIN" >&2
    echo "0 passed, 0 failed, 1 skipped"
    exit 0
  fi
  mkdir -p "$build/package"
  log=$build/package/check.log
  # 20 minutes is for a machine with a slow mirror; on 2 cores, beside the integration scripts, it took 7 and 11.
  timeout -k 10 1200 unshare --mount --propagation private --pid --fork --kill-child --mount-proc \
    "$0" --inside "$build" </dev/null 2>&1 | tee "$log"
  total "$log" "${PIPESTATUS[0]}"
  exit
fi

{ # read whole before it runs: the file may be edited meanwhile
build=$2
debs=$build/package/debs
abi() { scripts/package-abi.sh "$build/package/abi"; }
abi_break() { tests/package/abi-break.sh "$build/package/abi"; }
# The way of those who take no packages: another prefix, found by CMake, the daemons found behind the link.
from_source() {
  local prefix=$build/package/prefix
  rm -rf "$prefix" "$build/package/template"
  cmake --install "$build" --prefix "$prefix"
  cmake -S examples/template -B "$build/package/template" -DCMAKE_PREFIX_PATH="$prefix" -DCMAKE_BUILD_TYPE=Debug
  cmake --build "$build/package/template"
  ldd "$build/package/template/template" | grep -F "$prefix"
  # What the packages bring, this way, too.
  for file in man/man1/xauto.1 man/man1/xauto-solve.1 bash-completion/completions/xauto doc/xauto/examples/template/main.cc doc/xauto/examples/xauto.json; do
    [ -s "$prefix/share/$file" ] || { echo "share/$file is not installed"; return 1; }
  done
  timeout 60 "$prefix/bin/xauto" profile --platform small --emulate --warmup 0 --repetitions 2 -- "$build/package/template/template"
  rm -rf "$prefix" "$build/package/template"
}

LIMIT_S=900 DPKG_DEB_COMPRESSOR_LEVEL=1 check "packages are made" scripts/package-build.sh "$build" "$debs" || { plan; exit 1; }
check "lintian finds no error" lintian --allow-root --fail-on error "$debs"/*.changes
check "installed from source below another prefix" from_source
check "the ABI is the committed one" abi
check "the ABI check is red on deliberate breaks" abi_break

# In memory if there is room: installing is faster by far, and a full disk is not our doing.
work=$build/package/root
rm -rf --one-file-system "$work" # of a run that was killed; nothing is mounted there in this namespace
mkdir -p "$work"
if [ "$(awk '/^MemAvailable/ { print int($2 / 1048576) }' /proc/meminfo)" -ge 4 ]; then
  mount -t tmpfs -o size=3500m,mode=755 xauto-package "$work"
fi
clean=$work/root
make_root() {
  local tar
  mkdir -p "$work/tmp" "$clean"
  tar=$(TMPDIR=$work/tmp scripts/package-root.sh)
  tar -xf "$tar" -C "$clean"
  cp /etc/resolv.conf /etc/hosts "$clean/etc/"
  echo force-unsafe-io >"$clean/etc/dpkg/dpkg.cfg.d/unsafe-io"
  mount -t proc proc "$clean/proc"
  mount -t sysfs -o ro sysfs "$clean/sys"
  mount -t bpf bpf "$clean/sys/fs/bpf" || true # without BPF in the kernel there is none, and the tools say so
  mount -t tmpfs -o mode=755 dev "$clean/dev"
  for node in null zero full random urandom tty; do
    : >"$clean/dev/$node"
    mount --bind "/dev/$node" "$clean/dev/$node"
  done
  mkdir -m 1777 "$clean/dev/shm"
  mount -t tmpfs -o mode=1777 shm "$clean/dev/shm"
  ln -s /proc/self/fd "$clean/dev/fd"
  mount -t tmpfs -o mode=1777 work "$clean/tmp"
  mkdir "$clean/tmp/debs"
  cp "$debs"/*.deb "$clean/tmp/debs"
  cp tests/package/*.sh "$clean/tmp"
}
check "a clean Debian 12 root" make_root || { plan; exit 1; }
plan
here_bad=$bad
env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive \
  chroot "$clean" bash /tmp/in-root.sh
status=$?
umount -R -l "$clean"/* 2>/dev/null
mountpoint -q "$work" || rm -rf --one-file-system "$work"
[ $status -eq 0 ] && [ "$here_bad" -eq 0 ]
exit
}
