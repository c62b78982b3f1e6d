#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Fetches the kernel's checkpatch.pl out of Debian's source package into the cache, once: 139 MB come over the line, 0.3 MB stay.
# usage: fetch-checkpatch.sh        Prints the folder: checkpatch.pl and its word lists.
set -euo pipefail
cache=${XAUTO_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/xauto}
out=$cache/checkpatch
if [ ! -s "$out/checkpatch.pl" ]; then
  mkdir -p "$cache"
  work=$(mktemp -d "$cache/checkpatch.XXXXXX")
  trap 'rm -rf "$work"' EXIT
  "$(dirname "$0")/apt-view.sh" "$work/apt" "$(dpkg --print-architecture)" bookworm-security >&2
  (cd "$work" && APT_CONFIG=$work/apt/apt.conf apt-get download -qq linux-source-6.1 >/dev/null)
  dpkg-deb --fsys-tarfile "$work"/linux-source-6.1_*.deb | tar -xO --wildcards './usr/src/linux-source-*.tar.xz' |
    tar -xJ -C "$work" --strip-components=2 --wildcards '*/scripts/checkpatch.pl' '*/scripts/spelling.txt' '*/scripts/const_structs.checkpatch'
  mkdir -p "$out"
  mv "$work"/spelling.txt "$work"/const_structs.checkpatch "$out"
  mv "$work"/checkpatch.pl "$out" # last: its being there means that all is
fi
echo "$out"
