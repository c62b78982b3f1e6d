#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Breaks the ABI on purpose, in a copy of the source, and expects scripts/package-abi.sh to go red and to name what broke; and
# changes what no program sees, and expects it to stay green.
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
broken "a function asks for more" lib/graph/app_spec.cc \
  's/^void add_input\(XModuleSpec& module, TopicHandle topic\)/void add_input(XModuleSpec\& module, TopicHandle topic, int)/' add_input
broken "a function is no longer exported" packaging/libxauto.map '/App::on_end/d' App::on_end

# One more field in every type that only the library knows: programs built before must not notice.
rm -rf "$out"
mkdir -p "$out"
cp -r --parents include lib packaging/libxauto.map "$out"
hidden=(message.h:TopicSpec message.h:Envelope message.h:InputData message.h:MessageMemory app_spec.h:ImplSpec app_spec.h:XNodeSpecErased
  inlet.h:Inlet app_spec.h:OutputSpec app_spec.h:XModuleSpec app_spec.h:SourceSpec app_spec.h:ObserverSpec app_spec.h:AppSpecErased
  callbacks.h:SchedHandle::Callbacks)
for type in "${hidden[@]}"; do
  file=$(find "$out/lib" -name "${type%%:*}")
  before=$(md5sum "$file")
  sed -i -E "/^(struct|class) ${type#*:} \{$/,/^\};$/ s/^\};$/ int added_by_a_test = 0;\n};/" "$file"
  [ "$before" != "$(md5sum "$file")" ] || { echo "there is no ${type#*:} in $file any more"; exit 1; }
done
"$root/scripts/package-abi.sh" "$out/abi" "$out"
echo "green: a field is added to ${#hidden[@]} hidden types"
rm -rf "$out"
