#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Puts the second reader and writer of MCAP (npm's @mcap/core) into build/mcap-core, for tests/integration/mcap_core_test.py. It takes the node and
# npm that are there, whoever brought them (NodeSource's packages conflict with Debian's npm), and Debian's where there are none.
# npm checks each package against tests/integration/mcap/package-lock.json.
set -euo pipefail
cd "$(dirname "$0")/.."
lock=tests/integration/mcap/package-lock.json
out=build/mcap-core
cmp -s "$lock" "$out/package-lock.json" && [ -e "$out/whole" ] && exit 0
{ command -v node && command -v npm; } >/dev/null || scripts/setup.sh node
rm -rf "$out"
mkdir -p "$out"
cp tests/integration/mcap/package*.json "$out"
if ! npm ci --prefix "$out" --ignore-scripts --no-audit --no-fund --omit=dev >"$out/log" 2>&1; then
  tail -n 5 "$out/log" >&2
  echo "mcap-core: npm could not install @mcap/core" >&2
  exit 1
fi
touch "$out/whole"
