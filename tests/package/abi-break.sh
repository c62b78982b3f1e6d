#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Breaks the ABI on purpose, in a copy of the source, and expects scripts/package-abi.sh to go red and to name what broke.
# usage: abi-break.sh OUT
set -euo pipefail
root=$(realpath "$(dirname "$0")/../..")
out=$(realpath -m "$1")/broken
. "$root/tests/package/tap.sh"

# broken NAME FILE SED PATTERN: one change to one file of a fresh copy.
broken() {
  local name=$1 file=$2 change=$3 pattern=$4
  rm -rf "$out"
  mkdir -p "$out"
  cp -r --parents include lib packaging/libxauto.map "$out"
  sed -i -E "$change" "$out/$file"
  if cmp -s "$file" "$out/$file"; then
    echo "$name: the change does not apply any more: $file"
    return 1
  fi
  refused 'programs built before break' "$root/scripts/package-abi.sh" "$out/abi" "$out"
  grep -qE "$pattern" "$out/abi/diff.txt" || { echo "$name: red, but without naming $pattern"; return 1; }
  echo "red: $name"
}
cd "$root"
broken "a member is added to a value type" include/xauto/xpu.h 's/^  std::uintptr_t value_ = 0;/& int priority_ = 0;/' SchedHandle
broken "a member is inserted into a struct behind a pointer" include/xauto/xmodule.h \
  's/^  std::vector<TopicSpec> inputs;/std::string label; &/' XModuleSpec
broken "a function is no longer exported" packaging/libxauto.map '/App::on_end/d' App::on_end
rm -rf "$out"
