#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# `make bench`: builds, runs the programs of bench/, and writes docs/results/README.md with tables, machine, date and runs. The paper's
# figures are those of `make paper`. Takes 8 minutes; with --quick (make bench QUICK=1) one, into build/bench/quick, to see that it works.
#   scripts/bench.sh [--quick] [--only NAME[,NAME]] [--out FOLDER]
set -euo pipefail
cd "$(dirname "$0")/.."
cmake --preset release >/dev/null
ninja -C build -j"${JOBS:-2}" all | tail -n 1
exec python3 scripts/bench-page.py --bin build "$@"
