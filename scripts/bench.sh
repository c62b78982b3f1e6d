#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# `make bench`: builds, runs every program of bench/ and the Driving Case, and writes docs/results/README.md with tables, plots, machine,
# date and runs. Takes hours; with --quick (make bench QUICK=1) minutes, into build/bench/quick, to see that it works.
#   scripts/bench.sh [--quick] [--only NAME[,NAME]] [--out FOLDER]
set -euo pipefail
cd "$(dirname "$0")/.."
cmake --preset release >/dev/null
ninja -C build -j"${JOBS:-2}" all | tail -n 1
exec python3 scripts/bench-page.py --bin build "$@"
