#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The Driving Case on an emulated Orin, in real time: one release after the other under four policies; then as a vehicle
# runs it, at three rates on two clocks, under three.
set -euo pipefail
cd "$(dirname "$0")/.."
build=${CONFIGURED:-build}
echo "demo: building"
[ -n "${CONFIGURED:-}" ] || cmake --preset release >/dev/null
ninja -C "$build" -j"${JOBS:-2}" xauto xauto-coordinator xauto-emud driving driving-steady
echo "demo: running the Driving Case under four policies, about a minute"
# Queues: a machine that stands still for a moment, as virtual ones do, loses no release by it.
"$build"/bin/xauto compare --app examples/driving/app.json --platform small --overload queue:8 \
  --activations "${ACTIVATIONS:-220}" --out "$build"/demo -- "$build"/bin/driving
echo
echo "demo: the same at the rates of its sensors: cameras 30 Hz, LiDAR 10 Hz on its own clock, control 50 Hz"
"$build"/bin/xauto compare --app examples/driving/steady.json --platform small --seconds "${SECONDS_STEADY:-3}" \
  --time-limit-s 2 --out "$build"/demo/steady -- "$build"/bin/driving-steady
echo
echo "Next: open $build/demo/timeline.html in a browser; README.md tells how to schedule an app of your own."
