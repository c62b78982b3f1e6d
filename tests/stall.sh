#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# tests/stall.sh STOP_MS EVERY_MS COMMAND...
#
# Runs a command on a machine that stalls, as a virtual one does whose host is busy: again and again the command and all
# that it starts stand still for up to STOP_MS, SCHED_FIFO threads included, EVERY_MS apart on average. No test of ours
# may depend on time: `tests/stall.sh 200 400 ctest --test-dir build -j2`.
#
# Needs root and a cgroup that can be frozen (v1 or v2). Nobody else on the machine is stopped.
set -euo pipefail

if [ $# -lt 3 ] || ! [[ "$1 $2" =~ ^[0-9]+\ [0-9]+$ ]] || [ "$1" -ge "$2" ]; then
  sed -n '3,9s/^# \{0,1\}//p' "$0" >&2
  exit 2
fi
if [ -d /sys/fs/cgroup/freezer ]; then
  group=/sys/fs/cgroup/freezer/stall-$$ switch=freezer.state stop=FROZEN go=THAWED
else
  group=/sys/fs/cgroup/stall-$$ switch=cgroup.freeze stop=1 go=0
fi
if ! mkdir "$group" 2>/dev/null || ! [ -w "$group/$switch" ]; then
  rmdir "$group" 2>/dev/null || true
  echo "tests/stall.sh: needs root, and a cgroup that can be frozen: $group/$switch" >&2
  exit 77
fi

python3 -c '
import random, sys, time
switch, stop, go, longest, every = sys.argv[1:4] + [int(word) / 1000 for word in sys.argv[4:]]
dice = random.Random(1)
def turn(to):
    with open(switch, "w") as file:
        file.write(to)
while True:
    still = longest * max(dice.random(), dice.random())  # long ones are the more frequent
    time.sleep((every - still) * 2 * dice.random())
    turn(stop)
    time.sleep(still)
    turn(go)' "$group/$switch" "$stop" "$go" "$1" "$2" &
stalls=$!
end() {
  kill "$stalls" 2>/dev/null || true
  wait "$stalls" 2>/dev/null || true
  echo "$go" >"$group/$switch"
  # What the command left behind goes to where it came from.
  until rmdir "$group" 2>/dev/null; do
    while read -r pid; do echo "$pid" >"${group%/*}/cgroup.procs" || true; done <"$group/cgroup.procs" 2>/dev/null
  done
}
trap end EXIT
trap 'exit 143' TERM INT
shift 2
(
  echo "$BASHPID" >"$group/cgroup.procs"
  exec "$@"
) &
wait $!
