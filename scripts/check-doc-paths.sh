#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Documentation stays true only if somebody looks: every path in backquotes that starts with one of our
# folders, and every relative link, must exist.
set -euo pipefail
cd "$(dirname "$0")/.."
status=0
while read -r file; do
  folder=$(dirname "$file")
  while read -r path; do
    case $path in *'*'* | *'<'* | *…* | *'{'*) continue ;; esac
    [ -e "$path" ] || { echo "$file: \`$path\` does not exist"; status=1; }
  done < <(grep -oE '`(include|lib|solver|tools|tests|bench|examples|docs|scripts|kmod|bpf|cmake)/[^` ]+`' "$file" | tr -d '\`')
  while read -r link; do
    [ -e "$folder/$link" ] || { echo "$file: link to $link leads nowhere"; status=1; }
  done < <(grep -oE '\]\([^)#: ]+' "$file" | sed 's/^](//')
done < <(git ls-files '*.md')
exit $status
