#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# An NVIDIA GPU of the RM driver (no Jetson) under XAuto. Parts, in this order; without names all of them:
#   costs   what suspending a context costs
#   app     three modules, each a context of its own: suspended, gated, by time slices, and killed
#   levels  the same with blocks and launches as short as a net's: by levels, and by others that order work or do not
#   nets    three nets of torchvision, likewise: needs python3 with torch and torchvision
#   driving the Driving Case at its rates, its nets as kernels as long as rates.json says; its DLAs are emulated
# Needs CUDA's nvcc, g++ and a release build of XAuto; root or a user who may open /dev/nvidia*. XSCHED is the folder
# of XSched's libraries. What is not there is said. JITTER_US: how late this machine's threads wake at most;
# LONG_S, SHORT_S: how long a run takes, XAuto's by levels and the others. REPETITIONS: of each XNode when it is profiled. BLOCK_US: how long
# blocks last, by levels.
# usage: run.sh OUT BUILD_DIR [PART...]        docs/results/nvidia.md has what it printed.
set -uo pipefail
cd "$(dirname "$0")/../.." || exit 1
mkdir -p "$1"
out=$(realpath "$1") build=$(realpath "$2") here=$PWD/bench/nvidia
shift 2
parts=" ${*:-costs app levels nets driving} "
watch=$build/bin/libxauto_watch.so
long=${LONG_S:-60} short=${SHORT_S:-20}
export PATH=$build/bin:$PATH KERNELS=$out/kernels.ptx NETS=$out/nets.txt
cuda=$(dirname "$(dirname "$(readlink -f "$(command -v nvcc)")")") || { echo "run.sh: no nvcc"; exit 1; }
asked() { [[ $parts == *" $1 "* ]]; }

# ---- what is built ------------------------------------------------------------------------------
nvcc -ptx -arch=compute_80 "$here/kernels.cu" -o "$KERNELS" || exit 1
flags=(-std=c++20 -O2 -Iinclude -Ilib "-I$cuda/include" "-L$cuda/lib64/stubs")
linked=("-L$build/lib" "-Wl,-rpath,$build/lib" "-Wl,--allow-shlib-undefined" -lxauto -lcuda -ldl)
torch=$(python3 -c 'import os, torch, torchvision; print(os.path.dirname(torch.__file__))' 2>/dev/null)
asked nets && [ -z "$torch" ] && echo "run.sh: no torch and torchvision here: no nets" && parts=${parts/ nets / }
asked costs && g++ "${flags[@]}" "$here/suspend.cc" lib/kernel/{rm_queues,queue_files,kfd_queues,i915_contexts}.cc \
  lib/base/pi_mutex.cc -o "$out/suspend" -lcuda -ldl -lpthread &
asked nets && g++ "${flags[@]}" "-I$torch/include" "-I$torch/include/torch/csrc/api/include" "$here/nets.cc" \
  -o "$out/nets" "-L$torch/lib" "-Wl,-rpath,$torch/lib" -Wl,--no-as-needed -ltorch -ltorch_cuda -ltorch_cpu \
  -lc10_cuda -lc10 "-L$cuda/lib64" "-Wl,-rpath,$cuda/lib64" -lcudart "${linked[@]}" &
asked nets && python3 "$here/nets.py" "$out" &
asked driving && g++ "${flags[@]}" "$here/driving.cc" -o "$out/driving" "${linked[@]}" &
g++ "${flags[@]}" "$here/app.cc" -o "$out/app" "${linked[@]}" || exit 1
wait
cd "$out" || exit 1

uname -sr
grep -h NVRM /proc/driver/nvidia/version
nvidia-smi --query-gpu=name,driver_version,gsp.mode.current,clocks.sm --format=csv,noheader
chrt -f 1 true 2>/dev/null || echo "run.sh: this machine refuses SCHED_FIFO: all threads are ordinary ones"

# ---- what suspending costs ----------------------------------------------------------------------
suspend() { LD_PRELOAD=$watch timeout -k 5 60 "$out/suspend" "$KERNELS" "$@"; }
costs() {
  suspend costs idle 1
  for blocks in 1 264 1056; do suspend costs compute $blocks; done
  suspend costs stream 1056
  suspend costs poll 264
  suspend beside
  suspend lasting
  suspend calls
  suspend hang &
  sleep 2
  local hung
  hung=$(pgrep -n -f 'suspend .* hang')
  echo "beside a process that holds its own suspended:" && suspend once
  kill -9 "$hung"
  wait
  echo "after it was killed:" && suspend once
}
asked costs && costs

# ---- runs ---------------------------------------------------------------------------------------
xauto doctor --platform-out here.json >doctor.txt
platform() { # NAME PREEMPT_US PREEMPTIVE [LEVELS]
  python3 - "$@" <<'P'
import json, os, sys
platform = json.load(open("here.json"))
gpu = next(x for x in platform["xpus"] if x["type"] == "gpu")
gpu["preempt_us"], gpu["preemptive"] = int(sys.argv[2]), sys.argv[3] == "yes"
gpu.pop("levels", None)
if len(sys.argv) > 4:
    gpu["levels"] = int(sys.argv[4])
others = []
if os.environ.get("APP") == "driving": # the machine's cores, and DLAs as on an Orin
    others += [x for x in platform["xpus"] if x["type"] == "cpu"]
    others += [{"id": f"dla{i}", "type": "dla", "preemptive": True, "preempt_us": 132, "timeslice_us": 1000} for i in (0, 1)]
platform["xpus"] = [gpu, *others]
json.dump(platform, open(sys.argv[1] + ".json", "w"))
P
}
app=app as=app # the program, and what its runs are called by
emulated=()    # flags
run() { # NAME PLATFORM SECONDS FLAG...: with the policy of that platform
  local name=$as-$1 platform=$2 seconds=$3
  shift 3
  TIMEFORMAT='%U %S'
  { time timeout -k 5 $((seconds + 60)) xauto run --app "$app-$platform.json" --platform "$platform.json" \
    --policy "$app-$platform.policy.json" --duration "${seconds}s" --name "$name" --out "$name.report.json" \
    "${emulated[@]}" "$@" \
    -- "./$app" >"$name.txt" 2>"$name.err"; } 2>"$name.cpu" ||
    { echo "run.sh: $name ended with $?:"; tail -n 3 "$name.err"; return 1; }
}
profile() { # PLATFORM DEADLINE_MS...: WCETs, and what the tables say of jitter and deadlines
  local platform=$1
  shift
  xauto profile --platform "$platform.json" --repetitions "${REPETITIONS:-100}" --out "$as-$platform.profile.json" \
    --app-out profiled.json "${emulated[@]}" -- "./$app" || exit 1
  python3 - "$app-$platform.json" "$@" <<'P'
import json, os, sys
app = json.load(open("profiled.json"))
for source in app["sources"]:
    source["jitter_us"] = int(os.environ.get("JITTER_US", "1000"))
if len(sys.argv) > 2: # else as the program says
    for chain, deadline_ms in zip(app["chains"], sys.argv[2:], strict=True):
        chain["deadline_us"] = 1000 * int(deadline_ms)
json.dump(app, open(sys.argv[1], "w"))
P
}
plan() { xauto solve --app "$app-$1.json" --platform "$1.json" --time-limit "${SOLVE_S:-3}s" --out "$app-$1.policy.json"; }
cost_of() { # RUN: half as much again as suspending has cost in it
  python3 - "$1.report.json" <<'P'
import json, sys
cost = next(x for x in json.load(open(sys.argv[1]))["runs"][0]["preemptions"] if x["xpu"].startswith("gpu"))
print((cost["suspend_us"] + cost["resume_us"]) * 3 // 2)
P
}
suspended() { # DEADLINE_MS...: rm.json and its plan, with what suspending has cost in a run
  platform first 2000 yes
  profile first "$@"
  plan first >first.txt
  run first first 10 || return 1
  local cost
  cost=$(cost_of "$as-first")
  echo "planned with preempt_us $cost"
  platform rm "$cost" yes
  cp "$app-first.json" "$app-rm.json"
  plan rm
}
killed() {
  run killed rm 18 --isolate --restarts 100 &
  sleep 5
  for i in $(seq 8); do
    kill -9 "$(pgrep m: | sed -n "$((i % 3 + 1))p")"
    sleep "1.$((i * 37 % 10))"
  done
  kill -9 "$(pgrep xauto-coordinat | tail -n 1)"
  wait
  echo "left behind: $(($(pgrep -c m:) + $(pgrep -c xauto-coordinat)))"
}
contexts() {
  suspended 9 39 190
  platform gate 0 no
  cp app-first.json app-gate.json
  plan gate
  run suspended rm 30
  run in-processes rm "$short" --isolate
  run gate gate 10
  run slices rm 10 --scheduling timeshare
  killed
}
asked app && JITTER_US=2000 contexts

levels=$(python3 -c 'import json; print(next(x for x in json.load(open("here.json"))["xpus"] if x["type"] == "gpu").get("levels", 0))')
by_levels() { # DEADLINE_MS...
  platform levels 0 yes "$levels" # what a job waits for blocks that run is in its WCET
  profile levels "$@"
  plan levels
  run levels levels "$long"
  ORDER=hand run by-hand levels "$short" --scheduling timeshare
  ORDER=nobody run by-nobody levels "$short" --scheduling timeshare
}
others() {
  run suspended rm "$short"
  run slices rm "$short" --scheduling timeshare
  if command -v nvidia-cuda-mps-control >mps.txt && nvidia-cuda-mps-control -d >>mps.txt 2>&1; then
    run mps rm "$short" --scheduling timeshare --isolate
    echo quit | nvidia-cuda-mps-control >>mps.txt 2>&1
  else
    echo "run.sh: MPS is not here, or does not start"
  fi
}
by_xsched() {
  [ -e "${XSCHED:-}/libhalcuda.so" ] || { echo "run.sh: no XSCHED, a folder with libhalcuda.so: no XSched"; return; }
  XSCHED_CUDA_LIB=$(ldconfig -p | sed -n 's/.*libcuda\.so\.1.*x86-64.* => //p' | head -n 1)
  export XSCHED_CUDA_LIB
  for launches in 2 8; do
    ORDER=xsched XSCHED_LAUNCHES=$launches LD_LIBRARY_PATH=$XSCHED:${LD_LIBRARY_PATH:-} \
      run "xsched-$launches" levels "$short" --scheduling timeshare
  done
}
if [ "$levels" -lt 2 ]; then
  echo "run.sh: CUDA tells of no stream priorities here: nothing by levels"
else
  export BLOCK_US=${BLOCK_US:-50}
  as=short
  if asked levels; then
    by_levels 9 39 190
    suspended 9 39 190
    others
    # XSched takes whole launches back only: so the same in launches of half a millisecond.
    as=pieces
    export LAUNCH_US=500
    by_levels 9 39 190
    by_xsched
  fi
  app=nets as=nets
  asked nets && by_levels 9 39 190
  if asked driving; then
    app=driving as=driving emulated=(--emulate dla)
    unset LAUNCH_US
    export APP=$app DRIVING_TIMES=worst SOLVE_S=${SOLVE_S:-20}
    by_levels
    suspended && run suspended rm "$short"
    run slices first "$short" --scheduling timeshare
  fi
fi

python3 - ./*.report.json <<'P'
import json, sys
for path in sys.argv[1:]:
    run = json.load(open(path))["runs"][0]
    name = run["name"]
    try:
        cpu_s = sum(map(float, open(name + ".cpu").read().split()[-2:]))
    except (OSError, ValueError):
        cpu_s = None
    for chain in run["chains"]:
        print(json.dumps({"run": name, "chain": chain["name"], "latency_us": chain["latency_us"],
                          "worst_case_us": chain.get("worst_case_us"), "results": chain["results"], "cpu_s": cpu_s}))
P
