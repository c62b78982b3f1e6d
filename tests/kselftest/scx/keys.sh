#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# A policy of keys on real CPUs: who ends first in a periodic set at 85 % load, against a simulation in another language. KTAP.
# usage: keys.sh SCHED SECONDS CPUS      SCHED: ext or fifo; needs xauto and periodic_cpu in PATH
sched=$1 seconds=$2 cpus=$3
here=$(realpath "$(dirname "$0")")
dir=$(mktemp -d)
count=0 failed=0
ok() { # NAME CONDITION...
  name=$1
  shift
  count=$((count + 1))
  if "$@"; then echo "ok $count $name"; else
    echo "not ok $count $name"
    failed=$((failed + 1))
  fi
}
echo "TAP version 13"
if [ "$sched" = ext ] && [ ! -e /sys/kernel/sched_ext ]; then
  echo "1..0 # SKIP this kernel has no sched_ext"
  exit 4
fi
periodic() { periodic_cpu --cpus "$cpus" "$@"; }
periodic --app-json >"$dir/app.json"
periodic --platform-json >"$dir/platform.json"
periodic --set >"$dir/set"
# The policy is written by hand; of what `solve` writes only the app's hash is wanted.
xauto solve --app "$dir/app.json" --platform "$dir/platform.json" --max-evaluations 1 --threads 1 --time-limit 60s --out "$dir/any.json" \
  >"$dir/solve.out" 2>&1
hash=$(sed -n 's/.*"app_hash": "\([0-9a-f]*\)".*/\1/p' "$dir/any.json")
[ -n "$hash" ] || sed 's/^/# /' "$dir/solve.out"
periodic --policy-json "$hash" >"$dir/policy.json"
xauto run --app "$dir/app.json" --platform "$dir/platform.json" --policy "$dir/policy.json" --real --cpu-sched "$sched" --duration "${seconds}s" \
  --overload queue:64 --out "$dir/report.json" -- periodic_cpu --cpus "$cpus" --log "$dir/log" >"$dir/out" 2>"$dir/err"
status=$?
ok "$sched: a periodic set runs by keys" [ $status -eq 0 ]
[ $status -eq 0 ] || sed 's/^/# /' "$dir/err"
case $sched in
  ext) who="sched_ext" ;;
  *) who="SCHED_FIFO, told by coordinators" ;;
esac
ok "... and the report says who keeps them" grep -q "\"real_cpus\": \"$who\"" "$dir/report.json"
ok "... and nothing that they are not kept" sh -c "[ -s $dir/report.json ] && ! grep -q 'nobody keeps keys' $dir/report.json"
awk -f "$here/keys.awk" "$dir/set" "$dir/log" >"$dir/result"
sed 's/^/# /' "$dir/result"
value() { sed -n "s/.*$1 \(-*[0-9]*\).*/\1/p" "$dir/result"; }
ok "... jobs end in the order that the simulation says, in each pair of which it is sure" \
  [ "$(value pairs)" -gt $((seconds * 100)) -a "$(value wrong)" -eq 0 ]
ok "... which priorities would not do" [ "$(value telling)" -gt $((seconds * 5)) ]
ok "... and none misses its key by more than the machine's own noise" [ "$(value beyond)" -eq 0 ]
[ -z "${KEEP:-}" ] || sed "s/^/# raw /" "$dir/log"
rm -rf "$dir"
echo "1..$count"
echo "# pass:$((count - failed)) fail:$failed skip:0"
[ $failed -eq 0 ]
