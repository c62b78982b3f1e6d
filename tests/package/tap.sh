# SPDX-License-Identifier: Apache-2.0
# TAP for the package tests, sourced: `check NAME COMMAND...` runs the command with a time limit (LIMIT_S, default 300) and prints
# "ok N - NAME" or "not ok N - NAME" and what it said; status 77 is a skip with its reason in the last line. `plan` says how many there were.
checks=0 bad=0
set -a # variables and functions reach the shells that `check` starts
check() {
  local name=$1 log status started=$SECONDS
  shift
  checks=$((checks + 1))
  log=$(mktemp)
  # In a shell of its own, where `set -e` holds inside functions whatever called us.
  timeout -k 5 "${LIMIT_S:-300}" bash -euo pipefail -c '"$@"' "$name" "$@" >"$log" 2>&1
  status=$?
  if [ $status -eq 0 ]; then
    echo "ok $checks - $name ($((SECONDS - started)) s)"
  elif [ $status -eq 77 ]; then
    echo "ok $checks - $name # SKIP $(tail -n 1 "$log")"
    status=0
  else
    bad=$((bad + 1))
    echo "not ok $checks - $name (status $status after $((SECONDS - started)) s)"
    { head -n 8 "$log"; echo ...; tail -n 25 "$log"; } | sed 's/^/#   /'
  fi
  rm -f "$log"
  return $status
}
# A command that must find nothing (`! grep` does not stop a shell under -e).
absent() {
  if "$@"; then
    echo "that should not be there: $*"
    return 1
  fi
}
# A command that must succeed and say something: says PATTERN COMMAND... (a `grep -q` in a pipe may kill what it reads from).
says() {
  local pattern=$1 text
  shift
  text=$("$@") || return
  grep -qE "$pattern" <<<"$text" || { echo "does not say '$pattern': $*"; tail -n 10 <<<"$text"; return 1; }
}
# A command that must fail, and say why: refused PATTERN COMMAND...
refused() {
  local pattern=$1 text status=0
  shift
  text=$("$@" 2>&1) || status=$?
  [ $status -ne 0 ] || { echo "did not fail: $*"; echo "$text" | tail -n 5; return 1; }
  grep -qE "$pattern" <<<"$text" || { echo "failed ($status) without saying '$pattern':"; tail -n 10 <<<"$text"; return 1; }
}
plan() {
  echo "1..$checks"
  [ $bad -eq 0 ]
}
# total LOG STATUS: "N passed, M failed, K skipped" of a log of such lines; fewer than were planned is a failure.
total() {
  awk -v status="$2" '
    /^1\.\.[0-9]+/ { planned += substr($0, 4) }
    /^ok [0-9]+/ { run++; if ($0 ~ /# SKIP/) skip++; else good++ }
    /^not ok [0-9]+/ { run++; bad++ }
    END {
      if (planned != run || !run) { bad++; print "# " run + 0 " checks ran, " planned + 0 " were planned" }
      else if (status != 0 && !bad) bad++
      printf "%d passed, %d failed, %d skipped\n", good, bad, skip
      exit bad > 0
    }' "$1"
}
