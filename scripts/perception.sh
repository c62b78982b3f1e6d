#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Real nets over a real video on this machine's own cores: what each variant costs and sees, compared with the runtime's own package
# for node; then one policy and two, while another process burns core 1.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$PWD/build/perception
platform=examples/perception/platform.json
frames=${FRAMES:-40}
scripts/fetch-video.sh
scripts/fetch-onnx.sh
echo "perception: building"
cmake --preset release >/dev/null
ninja -C build -j"${JOBS:-2}" xauto xauto-coordinator perception | tail -n 1
rm -rf "$out"
mkdir -p "$out"
app=(build/bin/perception build/pedestrians/vtest.avi build/onnx/nets)

burner=
stop_burner() {
  [ -z "$burner" ] || { kill "$burner" && wait "$burner"; } 2>/dev/null || true
  burner=
}
trap stop_burner EXIT
start_burner() {
  python3 -c 'import os
os.sched_setaffinity(0, {1})
while True: pass' &
  burner=$!
}
profile() { # NAME REPETITIONS FACES LINES
  mkdir -p "$out/$1"
  build/bin/xauto profile --real --platform $platform --repetitions "$2" --out "$out/$1/profile.json" --app-out "$out/$1/app.json" \
    --margin-pct 50 -- "${app[@]}" "$out/$1" "$3" "$4" >"$out/$1/profile.txt" 2>"$out/$1/log" || { cat "$out/$1/log" >&2; exit 1; }
}

echo "perception: variants (profile, 26 frames, and the same frames by ONNX Runtime in node)"
variant() { # KIND NAME FACES LINES
  local folder=$out/$1-$2
  profile "$1-$2" 10 "$3" "$4"
  build/bin/xauto solve --app "$folder/app.json" --platform $platform --time-limit 2s --out "$folder/policy.json" >/dev/null
  build/bin/xauto run --real --lockstep --activations 26 --app "$folder/app.json" --platform $platform --policy "$folder/policy.json" \
    -- "${app[@]}" "$folder" "$3" "$4" >"$folder/run.txt" 2>"$folder/log" || { cat "$folder/log" >&2; exit 1; }
  node examples/perception/check.js build/onnx "$folder"
}
for net in 128 256; do variant faces $net $net tiny-320; done
for net in tiny-320 tiny-512 large-320 large-512; do variant lines $net 256 $net; done
python3 examples/perception/report.py variants "$out"

echo "perception: profile of 256 and tiny-320, alone and beside a process that burns core 1; solve"
place=$out/core1
profile free 30 256 tiny-320
start_burner
profile taken 30 256 tiny-320
stop_burner
cp "$out/free/profile.json" "$out/free.json"
cp "$out/taken/profile.json" "$out/taken.json"
cp "$out/free/app.json" "$out/app.json"
build/bin/xauto profile --merge "$out/free.json" "$out/taken.json" --margin-pct 50 --out "$out/scenarios.json" >/dev/null
python3 examples/perception/report.py scenarios "$out/scenarios.json" "$place"
build/bin/xauto solve --app "$out/app.json" --platform $platform --time-limit 3s --out "$out/static.json" >/dev/null
build/bin/xauto solve --app "$out/app.json" --platform $platform --time-limit 3s --scenarios "$out/scenarios.json" --tables 2 \
  --out "$out/tables.json"
for policy in static tables; do
  build/bin/xauto check --app "$out/app.json" --platform $platform --policy "$out/$policy.json" | tail -n 1
done

echo "perception: $frames frames at 2 Hz under each, core 1 burning; by SCHED_FIFO, and as a user without that right"
echo taken >"$place"
start_burner
runs=()
for sched in fifo other; do
  for policy in static tables; do
    runs+=("$sched-$policy")
    # Frames may be lost: that is what is measured.
    build/bin/xauto run --real --cpu-sched $sched --activations "$frames" --app "$out/app.json" --platform $platform \
      --policy "$out/$policy.json" --out "$out/$sched-$policy.json" --page "$out/$sched-$policy.html" -- "${app[@]}" "$out" 256 tiny-320 \
      >"$out/$sched-$policy.txt" 2>"$out/$sched-$policy.log" || [ -s "$out/$sched-$policy.json" ] || { cat "$out/$sched-$policy.log" >&2; exit 1; }
  done
done
stop_burner
python3 examples/perception/report.py runs "$out" "${runs[@]}"
echo
echo "Look at build/perception/frame-25.png (lines, faces, tracks) and build/perception/fifo-tables.html (where the time went)."
