#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# clang-tidy, by .clang-tidy: three to eight seconds of CPU time a file. `make tidy` looks at all files, `style` at those that
# changed: since the branch left origin/main, or else with the last commit; and what is not committed.
# A merge may change hundreds: then it is the first of them.
# usage: check-tidy.sh [--all | FILE...]
set -euo pipefail
cd "$(dirname "$0")/.."
command -v clang-tidy >/dev/null || { echo "check-tidy: clang-tidy is missing; run scripts/setup.sh check" >&2; exit 1; }
most=6
# These include headers that a build generates; `--all` has them.
generated='^(lib/kernel/libbpf/|lib/story/|lib/import/onnx_net|tests/unit/import/onnx_test|lib/transport/cyclonedds/|tools/xauto/diagnostics_topic|tests/unit/messages/cyclone/|tests/unit/story/perfetto_test|tests/integration/apps/(dds|diagnostics)_peer)'
if [ "${1:-}" = --all ]; then
  mapfile -t files < <(scripts/sources.sh | grep '\.cc$')
elif [ $# -gt 0 ]; then
  files=("$@")
else
  base=$(git merge-base HEAD origin/main 2>/dev/null || true)
  if [ -z "$base" ] || [ "$base" = "$(git rev-parse HEAD)" ]; then base=$(git rev-parse -q --verify HEAD~1 || git rev-parse HEAD); fi
  mapfile -t files < <(comm -12 <(git diff --name-only --diff-filter=ACMR "$base" | sort) <(scripts/sources.sh | sort) |
    grep '\.cc$' | grep -vE "$generated" | head -n $most)
fi
[ ${#files[@]} -gt 0 ] || exit 0
# Each file's own command line: the other presets compile twelve at a time.
# Configured anew where it does not know a file yet.
for file in "${files[@]}"; do
  grep -qsF "/$file" build-debug/compile_commands.json && continue
  cmake --preset debug >/dev/null
  break
done
# Apps outside the tree, and what needs a library that is not here, have none.
known=()
for file in "${files[@]}"; do
  if grep -qF "/$file" build-debug/compile_commands.json; then known+=("$file"); else echo "check-tidy: $file is not built here" >&2; fi
done
[ ${#known[@]} -gt 0 ] || exit 0
printf '%s\n' "${known[@]}" | xargs -P "${JOBS:-2}" -n 1 clang-tidy --quiet -p build-debug 2>/dev/null
