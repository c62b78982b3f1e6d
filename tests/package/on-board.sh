#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What is done with the packages on an arm64 machine that has systemd and a kernel's headers (scripts/jetpack-check.sh boots one): install, the
# module by DKMS for the kernel that runs, the unit, a run, purge. Beside it lie *.deb, driving, app.json, policy.json. Prints TAP.
# The machine is emulated, twenty times slower than a real one: nothing here is late, since nothing here is timed.
set -uo pipefail
cd "$(dirname "$0")" || exit 2
. ./tap.sh
here=$PWD
packages="libxauto1 libxauto-dev xauto-tools xauto-dkms python3-xauto"
LIMIT_S=900

listing() {
  find / -xdev \( -path "$here" -o -path /tmp -o -path /var/lib/dpkg -o -path /var/cache -o -path /var/log -o -path '/usr/lib/modules/*/modules.*' \
    -o -name __pycache__ -o -path /etc/ld.so.cache -o -path /var/lib/systemd \) -prune -o -printf '%p %y %m %U:%G %l\n' | sort
  ls -AR /dev/shm
}
install_all() {
  dpkg -i ./*.deb
  dpkg --audit | tee audit
  [ ! -s audit ]
}
module_loads() {
  dkms status -m xauto | grep -F "$(uname -r)" | grep -F installed
  modprobe xauto
  lsmod | grep -w ^xauto
  modinfo -F vermagic xauto | grep -F "$(uname -r) "
}
# The module is found; without Tegra's drivers it has nothing to suspend, and doctor says which are missing.
doctor() {
  xauto doctor | tee said
  grep -i 'xauto.ko' said
  absent grep -iE 'error while loading|Segmentation' said
}
use() {
  xauto check --app app.json --platform small --policy policy.json
  xauto run --app app.json --platform small --emulate --policy policy.json --activations 20 --lockstep --out report.json -- ./driving
  [ -s report.json ]
}
# As /usr/share/doc/xauto-tools/examples/camera.conf says, with another app.
unit_starts() {
  mkdir -p /etc/xauto /opt/driving
  cp driving app.json policy.json /opt/driving
  sed 's/camera/driving/g; s/^XAUTO_OPTIONS=.*/XAUTO_OPTIONS=--platform small --emulate --overload queue:64/' \
    /usr/share/doc/xauto-tools/examples/camera.conf >/etc/xauto/driving.conf
  systemctl start xauto@driving
  sleep 20
  systemctl is-active xauto@driving
  systemctl show -p NRestarts xauto@driving | tee said
  grep -Fx NRestarts=0 said
  pids=$(systemctl show -p MainPID --value xauto@driving)
  pids+=" $(pidof xauto-coordinator driving)"
  echo "processes: $pids"
  [ "$(wc -w <<<"$pids")" -eq 8 ] # a coordinator for each XPU of `small`
  # Without root, and with real-time priorities all the same.
  for pid in $pids; do
    echo "$pid: $(stat -c %u "/proc/$pid") $(cat "/proc/$pid/comm")"
    [ "$(stat -c %u "/proc/$pid")" -ne 0 ]
  done
  chrt -p "$(pidof -s xauto-coordinator)" | grep SCHED_FIFO
}
unit_stops() {
  systemctl stop xauto@driving
  journalctl -u xauto@driving --no-pager | tail -n 15
  [ "$(systemctl show -p Result --value xauto@driving)" = success ]
  absent pidof xauto-coordinator driving
}
purge_all() {
  rmmod xauto
  rm -r /etc/xauto /opt/driving
  # shellcheck disable=SC2086
  dpkg --purge $packages
}
nothing_left() {
  listing >after
  diff before after
}

listing >before
check "install" install_all || { plan; exit 1; }
check "the module that DKMS built is loaded" module_loads
check "doctor" doctor
check "check and run, emulated" use
check "the unit starts an app, without root" unit_starts
check "the unit is stopped, and the app drains" unit_stops
check "purge" purge_all
check "nothing is left behind" nothing_left
plan
