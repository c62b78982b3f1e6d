#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Every source file names its licence in one of its first three lines: GPL-2.0 in kmod/, bpf/, their tests in C and
# include/uapi/, Apache-2.0 elsewhere.
set -euo pipefail
cd "$(dirname "$0")/.."
status=0
while read -r file; do
  case $file in
    kmod/* | bpf/* | tests/vm/*.bpf.c | tests/kselftest/*.c | include/uapi/* | Kbuild) licence=GPL-2.0 ;;
    *) licence=Apache-2.0 ;;
  esac
  if ! head -n 3 "$file" | grep -q "SPDX-License-Identifier: $licence"; then
    echo "$file: no 'SPDX-License-Identifier: $licence' in its first three lines"
    status=1
  fi
done < <(git ls-files '*.c' '*.cc' '*.h' '*.sh' '*.py' '*.cl' '*.js' '*.css' '*.cmake' '*CMakeLists.txt' Makefile Kbuild '.ci/*' \
  'scripts/hooks/*' .clang-tidy .editorconfig)
exit $status
