#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What tracing costs, on the emulated Driving Case: pairs of runs, one traced and one not, in turn; and the kernel's own account of the time
# spent in the tracing programs. As root. usage: overhead.sh [BUILD_DIR] [PAIRS] [ACTIVATIONS]
set -euo pipefail
cd "$(dirname "$0")/../.."
bin=${1:-build}/bin pairs=${2:-5} activations=${3:-100}
dir=$(mktemp -d)
before=$(sysctl -n kernel.bpf_stats_enabled)
trap 'sysctl -q kernel.bpf_stats_enabled="$before"; rm -rf "$dir"' EXIT
bpftool=$(command -v bpftool || echo /usr/sbin/bpftool)
"$bin/xauto" solve --app examples/driving/app.json --platform small --method heft --out "$dir/policy.json" >/dev/null
drive() {
  "$bin/xauto" run --app examples/driving/app.json --platform small --policy "$dir/policy.json" --activations "$activations" --json \
    -- "$bin/driving" >"$dir/$1.json" 2>/dev/null
}
for ((i = 1; i <= pairs; i++)); do
  sysctl -q kernel.bpf_stats_enabled=0
  drive "plain-$i"
  sysctl -q kernel.bpf_stats_enabled=1
  drive "traced-$i" &
  run=$!
  "$bin/xauto" top --wait 10s --json --count 0 --record "$dir/trace-$i.jsonl" >/dev/null 2>&1 &
  trace=$!
  sleep 1
  stats() { "$bpftool" -j prog list | python3 -c '
import json, sys
own = [p for p in json.load(sys.stdin) if p.get("type") == "tracing" and p.get("name", "").startswith("xauto_")]
print(sum(p.get("run_time_ns", 0) for p in own), sum(p.get("run_cnt", 0) for p in own))'; }
  read -r ns0 n0 <<<"$(stats)"
  t0=$(date +%s%N)
  sleep 3
  read -r ns1 n1 <<<"$(stats)"
  t1=$(date +%s%N)
  echo "$((ns1 - ns0)) $((n1 - n0)) $((t1 - t0))" >"$dir/stats-$i"
  wait $run $trace
done
python3 - "$dir" "$pairs" "$(nproc)" <<'PY'
import json, statistics, sys
dir, pairs, cpus = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
def median_latency(name):
    runs = json.load(open(f"{dir}/{name}.json"))["runs"]
    return runs[0]["p50_us"]
ratio = [median_latency(f"traced-{i}") / median_latency(f"plain-{i}") - 1 for i in range(1, pairs + 1)]
share, each = [], []
for i in range(1, pairs + 1):
    ns, count, wall = map(int, open(f"{dir}/stats-{i}").read().split())
    share.append(ns / (wall * cpus))
    each.append(ns / max(count, 1))
lost = sum(json.loads(open(f"{dir}/trace-{i}.jsonl").readline())["lost_events"] for i in range(1, pairs + 1))
print(f"median end-to-end latency, traced against not, {pairs} pairs: median {100 * statistics.median(ratio):+.2f} %"
      f" (from {100 * min(ratio):+.2f} to {100 * max(ratio):+.2f} %)")
print(f"time in the tracing programs: {100 * statistics.median(share):.3f} % of the CPUs, {statistics.median(each):.0f} ns per call;"
      f" {lost} events lost")
PY
