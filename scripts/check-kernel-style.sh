#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The kernel side's style: what is static has our prefix, since a stack trace shows nothing else of where it is from; and the kernel's
# checkpatch.pl has nothing to say. Status 77, as skipped: that script is not here (scripts/vm/fetch-source.sh fetches it).
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD bad=0

names=$(git ls-files -co --exclude-standard 'kmod/*.[ch]' | xargs perl -ne '
  my $name;
  if (/^static\s+(?:DEFINE|DECLARE)_\w+\((\w+)/ || /^static\s[^=;(]*?(\w+)(?:\[[^\]]*\])?\s*(?:__ro_after_init\s*)?[=;]/ || /^static\s[^=(]*?(\w+)\(/) {
    $name = $1;
    print "$ARGV:$.: $name\n" unless $name =~ /^xauto_/ || ($ARGV =~ m{/emu/} && $name =~ /^(gpu|dla)_/);
  }
  close ARGV if eof;')
if [ -n "$names" ]; then
  printf 'static without a prefix (xauto_; in kmod/emu/ also gpu_ and dla_):\n%s\n' "$names"
  bad=1
fi

checkpatch=${XAUTO_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/xauto}/linux-source/scripts/checkpatch.pl
if [ ! -e "$checkpatch" ]; then
  [ $bad -eq 0 ] || exit 1
  echo "no checkpatch.pl here: run scripts/vm/fetch-source.sh"
  exit 77
fi
elsewhere=$(mktemp -d) # it leaves a file of names where it runs
trap 'rm -rf "$elsewhere"' EXIT
# What is left out: the module also builds outside the kernel's tree, for many versions of it; clang-format ends lines with "(", and trace
# events are aligned by their fields. A BPF program has no kernel header: its types, its rodata knobs and its barriers are its own.
outside=LINUX_VERSION_CODE,CONSTANT_COMPARISON,OPEN_ENDED_LINE,PARENTHESIS_ALIGNMENT,MACRO_ARG_REUSE,BIT_MACRO
bpf=VOLATILE,FUNCTION_ARGUMENTS,NEW_TYPEDEFS,GLOBAL_INITIALISERS,CAMELCASE,LINE_SPACING,PREFER_DEFINED_ATTRIBUTE_MACRO
patch() { # LENGTH IGNORED FILES...: FILES are git's patterns
  local length=$1 ignored=$2 files
  shift 2
  mapfile -t files < <(git ls-files -co --exclude-standard "$@" | sed "s|^|$root/|")
  (cd "$elsewhere" && perl "$checkpatch" --no-tree --strict --terse --show-types --max-line-length="$length" --ignore "$ignored" \
    -f "${files[@]}" >said 2>errors) && return
  sed "s|^$root/||; /^$/d" "$elsewhere/said"
  [ -s "$elsewhere/said" ] || cat "$elsewhere/errors"
  bad=1
}
patch 100 "$outside" 'kmod/*.[ch]' 'include/uapi/xauto/*.h' ':!include/uapi/xauto/bpf.h'
patch 110 "$outside,SPACING" 'tests/kselftest/*.c' # FIXTURE_DATA(name) *self
patch 120 "$bpf" 'bpf/*.[ch]' include/uapi/xauto/bpf.h
exit $bad
