#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Whether every member that a lock guards is touched with the lock held (clang's -Wthread-safety, lib/base/thread_safety.h).
# Needs a configured build tree, for the generated headers. usage: check-thread-safety.sh [BUILD_DIR]
set -euo pipefail
cd "$(dirname "$0")/.."
build=${1:-build}
clang=$(command -v clang++-19 || command -v clang++) || { echo "check-thread-safety: clang is missing; run scripts/setup.sh check" >&2; exit 1; }
# Files that lock, and those whose headers declare what is locked.
git grep -l 'Guard lock(' -- 'lib/*.cc' |
  xargs -P "${JOBS:-2}" -n 1 "$clang" -std=c++20 -fsyntax-only -Wthread-safety -Werror=thread-safety \
    -Iinclude -Ilib -I. -isystem /usr/include/libnl3 -isystem "$build/bpf" -DXAUTO_VERSION_TEXT='""' -DXAUTO_PLUGIN_DIR='""' -DFMT_SHARED
