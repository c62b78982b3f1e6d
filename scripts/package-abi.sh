#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Compares libxauto's ABI (its symbols, and the layout of the types in include/xauto/ that they use) with the committed reference,
# packaging/abi/libxauto.so.1.ARCH.abi. Red on a change that breaks programs already built; CONTRIBUTING.md says what to do then.
# usage: package-abi.sh OUT                         compares; OUT gets what was compared
#        package-abi.sh OUT SOURCE_TREE FILE...     ... with FILEs of another tree; OUT holds the objects of the others
#        package-abi.sh --update                    writes the reference anew
set -euo pipefail
root=$(realpath "$(dirname "$0")/..")
update=
if [ "${1:-}" = --update ]; then
  update=1
  set -- "$(mktemp -d)"
fi
out=$(realpath -m "$1") source=$(realpath "${2:-$root}")
reference=$root/packaging/abi/libxauto.so.1.$(dpkg --print-architecture).abi
for tool in abidw abidiff; do
  command -v $tool >/dev/null || { echo "package-abi: $tool is missing; run scripts/setup.sh package" >&2; exit 1; }
done
mkdir -p "$out"

# The release build has no debug information, and the types are in it: so the API's files once more, with nothing behind them.
compiler=(g++)
command -v ccache >/dev/null && compiler=(ccache g++)
files=(lib/app/app.cc lib/app/run_options.cc lib/app/testing.cc lib/graph/app_spec.cc lib/graph/inlet.cc lib/model/message.cc
  lib/model/parameter.cc lib/xpu/sched_handle.cc lib/xpu/levels.cc lib/transport/buffer.cc lib/emu/client.cc)
compiled=("${files[@]}")
[ $# -le 2 ] || compiled=("${@:3}")
object() { echo "$out/$(basename "$1" .cc).o"; }
objects=() # what is compiled now stands first: of a type that two files define differently, abidw takes the first
for file in "${compiled[@]}"; do
  (cd "$source" && "${compiler[@]}" -std=c++20 -g -O0 -fPIC -Iinclude -Ilib -I. -c "$file" -o "$(object "$file")") &
  objects+=("$(object "$file")")
done
for _ in "${objects[@]}"; do wait -n; done
for file in "${files[@]}"; do
  [[ " ${compiled[*]} " == *" $file "* ]] || objects+=("$(object "$file")")
done
g++ -shared -Wl,-soname,libxauto.so.1 -Wl,--version-script="$source/packaging/libxauto.map" "${objects[@]}" -o "$out/libxauto.so.1"
abidw --headers-dir "$source/include/xauto" --drop-private-types --exported-interfaces-only --no-comp-dir-path --no-corpus-path \
  --no-show-locs --type-id-style hash --out-file "$out/libxauto.abi" "$out/libxauto.so.1"
if [ -n "$update" ]; then
  install -D -m 644 "$out/libxauto.abi" "$reference"
  rm -r "$out"
  exit 0
fi
if [ ! -e "$reference" ]; then
  echo "there is no reference for this architecture: $(basename "$reference")"
  exit 77
fi
status=0
abidiff --no-corpus-path "$reference" "$out/libxauto.abi" >"$out/diff.txt" 2>&1 || status=$?
[ $status -eq 0 ] && exit 0
head -n 60 "$out/diff.txt"
if abidiff --no-corpus-path --no-added-syms "$reference" "$out/libxauto.abi" >/dev/null 2>&1; then
  echo "package-abi: only additions: write the reference anew with scripts/package-abi.sh --update (CONTRIBUTING.md, Versions)"
else
  echo "package-abi: programs built before break: a new soname, or leave the ABI as it was (CONTRIBUTING.md, Versions)"
fi
exit 1
