#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Pedestrians in a real video on this machine's own cores: profile, solve, run, compare with the golden tracks.
set -euo pipefail
cd "$(dirname "$0")/.."
out=build/pedestrians
platform=examples/pedestrians/platform.json
scripts/fetch-video.sh
echo "pedestrians: building"
cmake --preset release >/dev/null
ninja -C build -j"${JOBS:-2}" xauto xauto-coordinator pedestrians | tail -n 1
app=(build/bin/pedestrians "$out/vtest.avi" "$out")
echo "pedestrians: profile"
build/bin/xauto profile --real --platform $platform --repetitions 20 --out $out/profile.json \
  --app-out $out/app.json -- "${app[@]}"
echo "pedestrians: solve"
build/bin/xauto solve --app $out/app.json --platform $platform --time-limit 5s --out $out/policy.json
echo "pedestrians: run"
build/bin/xauto run --real --lockstep --activations 60 --app $out/app.json --platform $platform \
  --policy $out/policy.json --page $out/report.html -- "${app[@]}"
python3 examples/pedestrians/check.py $out/detections.json tests/golden/pedestrians.json
echo
echo "Look at $out/annotated.png (tracks and predicted paths) and $out/report.html (where the time went)."
