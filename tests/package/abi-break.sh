#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Breaks the ABI on purpose, in a copy of the source, and expects scripts/package-abi.sh to go red and to name what broke; and
# changes what no program sees, and expects it to stay green. Compiled again are the files that a change is in, no others.
# usage: abi-break.sh ABI        ABI: what `package-abi.sh ABI` has left
set -euo pipefail
root=$(realpath "$(dirname "$0")/../..")
abi=$(realpath "$1") out=$(realpath "$1")/broken
. "$root/tests/package/tap.sh"

copy() {
  rm -rf "$out"
  mkdir -p "$out/abi"
  cp "$abi"/*.o "$out/abi"
  cp -r --parents include lib packaging/libxauto.map "$out"
}
# change FILE SED: one change to one file of the copy.
change() {
  sed -i -E "$2" "$out/$1"
  if cmp -s "$1" "$out/$1"; then
    echo "the change does not apply any more: $1: $2"
    return 1
  fi
}
cd "$root"

# A member is added to a value type; a function asks for more; another one is no longer exported.
copy
change include/xauto/xpu.h 's/^  std::uintptr_t value_ = 0;/& int priority_ = 0;/'
change lib/graph/app_spec.cc \
  's/^void add_input\(XModuleSpec& module, TopicHandle topic\)/void add_input(XModuleSpec\& module, TopicHandle topic, int)/'
change packaging/libxauto.map '/App::on_end/d'
compared() { "$root/scripts/package-abi.sh" "$out/abi" "$out" "$@"; }
refused 'programs built before break' compared lib/xpu/sched_handle.cc lib/graph/app_spec.cc
for named in SchedHandle add_input App::on_end; do
  grep -q "$named" "$out/abi/diff.txt" || { echo "red, but without naming $named"; exit 1; }
done
echo "red: three ways to break programs built before"

# One more field in every type that only the library knows: programs built before must not notice.
copy
hidden=(message.h:TopicSpec message.h:Envelope message.h:InputData message.h:MessageMemory app_spec.h:ImplSpec app_spec.h:XNodeSpecErased
  inlet.h:Inlet app_spec.h:OutputSpec app_spec.h:XModuleSpec app_spec.h:SourceSpec app_spec.h:ObserverSpec app_spec.h:AppSpecErased
  callbacks.h:SchedHandle::Callbacks)
for type in "${hidden[@]}"; do
  file=$(find "$out/lib" -name "${type%%:*}")
  before=$(md5sum "$file")
  sed -i -E "/^(struct|class) ${type#*:} \{$/,/^\};$/ s/^\};$/ int added_by_a_test = 0;\n};/" "$file"
  [ "$before" != "$(md5sum "$file")" ] || { echo "there is no ${type#*:} in $file any more"; exit 1; }
done
compared lib/xpu/sched_handle.cc lib/graph/app_spec.cc lib/graph/inlet.cc lib/model/message.cc
echo "green: a field is added to ${#hidden[@]} hidden types"
rm -rf "$out"
