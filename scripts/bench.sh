#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The benchmarks: tables for people, JSON lines beside them in build/bench/. Takes its time; nothing of it is
# part of `make check`.
set -euo pipefail
cd "$(dirname "$0")/.."
cmake --preset release >/dev/null
ninja -C build -j"${JOBS:-2}" all | tail -n 1
mkdir -p build/bench
for program in build/bench/bench_*; do
  echo "bench: $(basename "$program")"
  "$program" ${BENCH_FLAGS:-}
done
