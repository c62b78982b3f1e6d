#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The Driving Case on an emulated Orin, in real time: one release after the other under four policies; then as a vehicle
# runs it, at three rates on two clocks, under three; then on a GPU that throttles, under one policy and under tables.
set -euo pipefail
cd "$(dirname "$0")/.."
build=${CONFIGURED:-build}
echo "demo: building"
# Where nothing is built yet, in little time. `make` then builds all of it again, to run fast.
quick=OFF
if [ ! -e "$build/CMakeCache.txt" ] || grep -qs '^XAUTO_QUICK:BOOL=ON' "$build/CMakeCache.txt"; then quick=ON; fi
[ -n "${CONFIGURED:-}" ] || cmake --preset release -D XAUTO_QUICK=$quick >/dev/null
ninja -C "$build" -j"${JOBS:-2}" xauto xauto-coordinator xauto-emud driving driving-rates
echo "demo: running the Driving Case under four policies, about a minute"
# Queues: a machine that stands still for a moment, as virtual ones do, loses no release by it.
"$build"/bin/xauto compare --app examples/driving/app.json --platform small --overload queue:8 \
  --activations "${ACTIVATIONS:-220}" --out "$build"/demo -- "$build"/bin/driving
echo
echo "demo: the same at the rates of its sensors: cameras 30 Hz, LiDAR 10 Hz on its own clock, control 50 Hz"
# The LiDAR's motor is off by as much as it may be: in 20 s its phase goes through all of its period.
"$build"/bin/xauto compare --app examples/driving/rates.json --platform small --duration "${SECONDS_RATES:-20}s" --phases \
  --time-limit 5s --out "$build"/demo/rates -- "$build"/bin/driving-rates
echo
echo "demo: the GPU at half of its clock after a second: one policy, then a policy for each scenario (docs/modes.md)"
tables=$build/demo/tables
mkdir -p "$tables"
driving=(--app examples/driving/app.json --platform small)
"$build"/bin/xauto solve "${driving[@]}" --time-limit 2s --threads 1 --out "$tables"/one.json >/dev/null
"$build"/bin/xauto solve "${driving[@]}" --scenarios examples/driving/scenarios.json --tables 2 --time-limit 3s --threads 1 \
  --out "$tables"/two.json >"$tables"/solve.log
# Releases that do not meet, as the tables' worst cases have it.
for policy in one two; do
  "$build"/bin/xauto run "${driving[@]}" --emulate --emulate-script examples/driving/throttle.json --overload queue:8 \
    --policy "$tables"/$policy.json --period 66ms --activations $((${ACTIVATIONS:-220} * 6 / 10)) --out "$tables"/$policy-report.json \
    --trace-out "$tables"/$policy.pftrace -- "$build"/bin/driving >"$tables"/$policy.log 2>&1 ||
    { cat "$tables"/$policy.log; exit 1; }
done
python3 scripts/demo-tables.py "$tables"/one-report.json "$tables"/two-report.json
echo
echo "Next: open $build/demo/rates/report.html in a browser; README.md tells how to schedule an app of your own."
