#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Fetches what the kernel's own checks need out of Debian's source package into the cache, once: checkpatch.pl, and the frame of the kernel's
# selftests. 139 MB come over the line, 0.6 MB stay.
# usage: fetch-source.sh        Prints the folder: scripts/ and tools/testing/selftests/, as in the kernel's tree.
set -euo pipefail
cache=${XAUTO_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/xauto}
out=$cache/linux-source
if [ ! -e "$out" ]; then
  mkdir -p "$cache"
  work=$(mktemp -d "$cache/linux-source.XXXXXX")
  trap 'rm -rf "$work"' EXIT
  "$(dirname "$0")/apt-view.sh" "$work/apt" "$(dpkg --print-architecture)" bookworm-security >&2
  (cd "$work" && APT_CONFIG=$work/apt/apt.conf apt-get download -qq linux-source-6.1 >/dev/null)
  mkdir "$work/tree"
  dpkg-deb --fsys-tarfile "$work"/linux-source-6.1_*.deb | tar -xO --wildcards './usr/src/linux-source-*.tar.xz' |
    tar -xJ -C "$work/tree" --strip-components=1 --no-wildcards-match-slash --wildcards '*/scripts/checkpatch.pl' '*/scripts/spelling.txt' \
      '*/scripts/const_structs.checkpatch' '*/scripts/subarch.include' '*/tools/testing/selftests/Makefile' '*/tools/testing/selftests/*.*' \
      '*/tools/testing/selftests/kselftest/*'
  mv "$work/tree" "$out" # last: its being there means that all is
fi
echo "$out"
