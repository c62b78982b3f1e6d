#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Lists our C++ sources, one a line: what `make format` formats and `make style` checks.
set -euo pipefail
cd "$(dirname "$0")/.."
git ls-files 'lib/*.cc' 'lib/*.h' 'solver/*.cc' 'solver/*.h' 'tools/*.cc' 'tools/*.h' 'include/xauto/*.h' \
  'examples/*.cc' 'examples/*.h' 'tests/*.cc' 'tests/*.h' 'bench/*.cc' 'bench/*.h'
