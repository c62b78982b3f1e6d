#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The API's reference by Doxygen, in build/docs/html or the folder given; fails on any warning, such as a public name without a word.
set -euo pipefail
cd "$(dirname "$0")/.."
out=${1:-build/docs}
mkdir -p "$out"
XAUTO_DOCS_OUT=$out doxygen docs/Doxyfile
