#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# An NVIDIA GPU of the RM driver (no Jetson) under XAuto: what suspending costs, and an app of three modules on it.
# Needs CUDA's nvcc, g++ and a release build of XAuto; root or a user who may open /dev/nvidia*.
# usage: run.sh OUT [BUILD_DIR]        docs/results/nvidia.md has what it printed on an H100.
set -uo pipefail
cd "$(dirname "$0")/../.." || exit 1
mkdir -p "$1"
out=$(realpath "$1") build=$(realpath "${2:-build}") here=$PWD/bench/nvidia
watch=$build/bin/libxauto_watch.so
export PATH=$build/bin:$PATH KERNELS=$out/kernels.ptx
cuda=$(dirname "$(dirname "$(readlink -f "$(command -v nvcc)")")") || { echo "run.sh: no nvcc"; exit 1; }

nvcc -ptx -arch=compute_80 "$here/kernels.cu" -o "$KERNELS" || exit 1
flags=(-std=c++20 -O2 -Iinclude -Ilib "-I$cuda/include" "-L$cuda/lib64/stubs")
g++ "${flags[@]}" "$here/suspend.cc" lib/kernel/{rm_queues,queue_files,kfd_queues,i915_contexts}.cc lib/base/pi_mutex.cc \
  -o "$out/suspend" -lcuda -ldl -lpthread &
g++ "${flags[@]}" "$here/app.cc" -o "$out/app" "-L$build/lib" "-Wl,-rpath,$build/lib" -Wl,--allow-shlib-undefined -lxauto -lcuda || exit 1
wait

suspend() { LD_PRELOAD=$watch timeout -k 5 60 "$out/suspend" "$KERNELS" "$@"; }
uname -sr
grep -h NVRM /proc/driver/nvidia/version
nvidia-smi --query-gpu=name,driver_version,gsp.mode.current,clocks.sm --format=csv,noheader
suspend costs idle 1
for blocks in 1 264 1056; do suspend costs compute $blocks; done
suspend costs stream 1056
suspend costs poll 264
suspend beside
suspend lasting
suspend calls
suspend hang &
sleep 2
hung=$(pgrep -n -f 'suspend .* hang')
echo "beside a process that holds its own suspended:" && suspend once
kill -9 "$hung"
wait
echo "after it was killed:" && suspend once

# The app, planned with what suspending has cost in a run of it.
cd "$out" || exit 1
xauto doctor --platform-out here.json >doctor.txt
platform() { # FILE PREEMPT_US PREEMPTIVE [LEVELS]
  python3 - "$@" <<'P'
import json, sys
platform = json.load(open("here.json"))
gpu = next(x for x in platform["xpus"] if x["type"] == "gpu")
gpu["preempt_us"], gpu["preemptive"] = int(sys.argv[2]), sys.argv[3] == "yes"
gpu.pop("levels", None)
if len(sys.argv) > 4:
    gpu["levels"] = int(sys.argv[4])
platform["xpus"] = [gpu]
json.dump(platform, open(sys.argv[1], "w"))
P
}
run() { # NAME PLATFORM POLICY SECONDS FLAG...
  local name=$1 platform=$2 policy=$3 seconds=$4
  shift 4
  timeout -k 5 90 xauto run --app app.json --platform "$platform" --policy "$policy" --duration "${seconds}s" --name "$name" \
    --out "$name.report.json" "$@" -- ./app 2>"$name.err"
}
measured() { # NAME: app.json of its profile, and what the table above says of jitter and deadlines
  xauto profile --platform "$1.json" --repetitions 50 --out "$1.profile.json" --app-out profiled.json -- ./app || exit 1
  python3 - <<'P'
import json
app = json.load(open("profiled.json"))
for source in app["sources"]:
    source["jitter_us"] = 2000  # ordinary threads wake late; 280 us was the most with SCHED_OTHER on an idle machine
for chain, deadline_us in zip(app["chains"], (9000, 39000, 190000)):
    chain["deadline_us"] = deadline_us
json.dump(app, open("app.json", "w"))
P
}
plan() { xauto solve --app app.json --platform "$1.json" --time-limit 3s --out "$1.policy.json"; }
platform first.json 2000 yes
measured first
plan first >/dev/null
run first first.json first.policy.json 10 >first.txt
cost=$(python3 -c 'import json; p = json.load(open("first.report.json"))["runs"][0]["preemptions"][0]; print((p["suspend_us"] + p["resume_us"]) * 3 // 2)')
echo "planned with preempt_us $cost"
platform rm.json "$cost" yes
platform gate.json 0 no
plan rm
plan gate
run suspended rm.json rm.policy.json 30
run in-processes rm.json rm.policy.json 20 --isolate
run gate gate.json gate.policy.json 10
run timeshare rm.json rm.policy.json 10 --scheduling timeshare
run killed rm.json rm.policy.json 18 --isolate --restarts 100 &
sleep 5
for i in $(seq 8); do
  kill -9 "$(pgrep m: | sed -n "$((i % 3 + 1))p")"
  sleep "1.$((i * 37 % 10))"
done
kill -9 "$(pgrep xauto-coordinat | tail -n 1)"
wait
echo "left behind: $(($(pgrep -c m:) + $(pgrep -c xauto-coordinat)))"

# The same with blocks as short as a net's: suspended, by levels of one context, by hand, by the driver alone.
export BLOCK_US=50
run slices-short rm.json rm.policy.json 20 --scheduling timeshare
run suspended-short rm.json rm.policy.json 20
levels=$(python3 -c 'import json; print(next(x for x in json.load(open("here.json"))["xpus"] if x["type"] == "gpu").get("levels", 0))')
if [ "$levels" -lt 2 ]; then
  echo "run.sh: CUDA tells of no stream priorities here: nothing by levels"
else
  platform levels.json 0 yes "$levels" # what a job waits for blocks that run is in its WCET
  measured levels
  plan levels
  run levels levels.json levels.policy.json 60
  HAND_LEVELS=1 run by-hand levels.json levels.policy.json 20 --scheduling timeshare
fi
if command -v nvidia-cuda-mps-control >mps.txt && nvidia-cuda-mps-control -d >>mps.txt 2>&1; then
  run mps rm.json rm.policy.json 20 --scheduling timeshare --isolate
  echo quit | nvidia-cuda-mps-control >>mps.txt 2>&1
else
  echo "run.sh: MPS is not here, or does not start"
fi
python3 - *.report.json <<'P'
import json, sys
for path in sys.argv[1:]:
    run = json.load(open(path))["runs"][0]
    for chain in run["chains"]:
        print(json.dumps({"run": run["name"], "chain": chain["name"], "latency_us": chain["latency_us"],
                          "worst_case_us": chain.get("worst_case_us"), "results": chain["results"]}))
P
