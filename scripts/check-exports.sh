#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# What libxauto exports is what debian/libxauto1.symbols names: a function that is gone breaks programs already built.
# usage: check-exports.sh [BUILD_DIR]
set -euo pipefail
export LC_ALL=C
cd "$(dirname "$0")/.."
exported=$(nm -D --defined-only "${1:-build}/lib/libxauto.so.1" | sed -nE 's/.* ([^@]+)@+XAUTO_1$/\1/p' | c++filt | sort -u)
named=$(sed -nE 's/^ (\(c\+\+\)")?(.*)@XAUTO_1"? .*/\2/p' debian/libxauto1.symbols | grep -vx XAUTO_1 | sort -u)
diff <(echo "$named") <(echo "$exported") && exit 0
echo "check-exports: < is in debian/libxauto1.symbols alone, > in the library alone; CONTRIBUTING.md, Versions, says what to do"
exit 1
