#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs the Debian packages of the named groups (scripts/packages.txt); does nothing, quickly, when they
# are there. Usage: scripts/setup.sh build [check] [bench] [pedestrians] [kernel]
# A package written NAME/bookworm-backports comes from there, without adding that suite to the machine's sources.
set -euo pipefail
cd "$(dirname "$0")/.."

wanted=()
for group in "$@"; do
  found=$(awk -v g="$group" '$1 == g { print $2 }' scripts/packages.txt)
  [ -n "$found" ] || { echo "setup: no group '$group' in scripts/packages.txt" >&2; exit 2; }
  mapfile -t -O "${#wanted[@]}" wanted <<<"$found"
done

missing=() backports=()
for package in "${wanted[@]}"; do
  state=$(dpkg-query -W -f '${db:Status-Status} ${Version}' "${package%/*}" 2>/dev/null || true)
  case $package in
    */bookworm-backports) case $state in "installed "*~bpo12*) ;; *) backports+=("${package%/*}") ;; esac ;;
    *) case $state in "installed "*) ;; *) missing+=("$package") ;; esac ;;
  esac
done
[ $((${#missing[@]} + ${#backports[@]})) -gt 0 ] || exit 0

command="apt-get install -y --no-install-recommends ${missing[*]}"
if [ "$(id -u)" -ne 0 ]; then
  echo "setup: these packages are missing; as root, run:" >&2
  [ ${#missing[@]} -eq 0 ] || echo "  $command" >&2
  [ ${#backports[@]} -eq 0 ] || echo "  scripts/setup.sh $*      (installs ${backports[*]} from bookworm-backports)" >&2
  exit 1
fi
echo "setup: installing ${missing[*]} ${backports[*]}"
export DEBIAN_FRONTEND=noninteractive
log=$(mktemp)
from_backports() {
  [ ${#backports[@]} -gt 0 ] || return 0
  local dir
  dir=$(mktemp -d)
  scripts/vm/apt-view.sh "$dir" "$(dpkg --print-architecture)" bookworm bookworm-backports &&
    (cd "$dir" && APT_CONFIG=$dir/apt.conf apt-get download "${backports[@]/%//bookworm-backports}") &&
    apt-get install -y --no-install-recommends "$dir"/*.deb
  local status=$?
  rm -rf "$dir"
  return $status
}
if ! { apt-get update && { [ ${#missing[@]} -eq 0 ] || $command; } && from_backports; } >"$log" 2>&1; then
  tail -n 20 "$log" >&2
  echo "setup: apt-get failed; the whole log is in $log" >&2
  exit 1
fi
rm -f "$log"
