#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs the Debian packages of the named groups (scripts/packages.txt); does nothing, quickly, when they
# are there. Usage: scripts/setup.sh build [check] [bench] [pedestrians]
set -euo pipefail
cd "$(dirname "$0")/.."

wanted=()
for group in "$@"; do
  found=$(awk -v g="$group" '$1 == g { print $2 }' scripts/packages.txt)
  [ -n "$found" ] || { echo "setup: no group '$group' in scripts/packages.txt" >&2; exit 2; }
  mapfile -t -O "${#wanted[@]}" wanted <<<"$found"
done

missing=()
for package in "${wanted[@]}"; do
  state=$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null || true)
  [ "$state" = installed ] || missing+=("$package")
done
[ ${#missing[@]} -gt 0 ] || exit 0

command="apt-get install -y --no-install-recommends ${missing[*]}"
if [ "$(id -u)" -ne 0 ]; then
  echo "setup: these packages are missing; as root, run:" >&2
  echo "  $command" >&2
  exit 1
fi
echo "setup: installing ${missing[*]}"
export DEBIAN_FRONTEND=noninteractive
log=$(mktemp)
if ! { apt-get update && $command; } >"$log" 2>&1; then
  tail -n 20 "$log" >&2
  echo "setup: apt-get failed; the whole log is in $log" >&2
  exit 1
fi
rm -f "$log"
