#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Explores queue.pml, the model of xauto.ko's owners and queues, in several scenarios, every interleaving of each; and shows that it can
# fail: known mistakes, one at a time, must be refuted by the property that is there for them.
# usage: queue_test.sh [WORK_DIR] [deep]      deep: larger scenarios as well, tens of millions of states each
# Environment: ONLY, a pattern of the scenarios to run.
set -uo pipefail
model=$(realpath "$(dirname "$0")/queue.pml")
work=${1:-$(mktemp -d)}
mkdir -p "$work"
cd "$work" || exit 2
command -v spin >/dev/null || { echo "queue_test: spin is missing; run scripts/setup.sh check" >&2; exit 1; }
failed=0

# explore NAME DEFINE...: leaves pan's report in NAME/out
explore() {
  local name=$1
  shift
  rm -rf "$name"
  mkdir "$name"
  (
    cd "$name" || exit 2
    # -DSAFETY: assertions and end states; -DCOLLAPSE: exhaustive, with states stored compactly
    spin -a "$@" "$model" >spin.log 2>&1 &&
      gcc -O1 -w -DSAFETY -DCOLLAPSE -DNOFAIR -DMEMLIM=6000 -DVECTORSZ=2048 -o pan pan.c 2>gcc.log && ./pan -m2000000 >out 2>&1
  ) || { echo "not ok $name: spin, gcc or pan failed, see $work/$name"; failed=1; return 1; }
}

holds() { # NAME DEFINE...
  local name=$1
  [[ $name =~ ${ONLY:-} ]] || return
  explore "$@" || return
  # Cut short by depth or memory is no proof.
  if grep -q 'errors: 0' "$name/out" && ! grep -qE 'max search depth too small|Search not completed' "$name/out"; then
    echo "ok $name: $(awk '/states, stored/ { print $1 }' "$name/out") states"
    rm -rf "$name"
  else
    echo "not ok $name: $(grep -m1 '^pan:1:' "$name/out" || tail -n 1 "$name/out"); replay: cd $work/$name && ./pan -r"
    failed=1
  fi
}

refuted() { # NAME PROPERTY DEFINE...
  local name=$1 property=$2
  shift 2
  [[ $name =~ ${ONLY:-} ]] || return
  explore "$name" "$@" || return
  if grep '^pan:1: assertion violated' "$name/out" | grep -qF "$property"; then
    echo "ok $name: refuted after $(awk '/states, stored/ { print $1 }' "$name/out") states"
    rm -rf "$name"
  else
    echo "not ok $name: not refuted by '$property': $(grep -m1 -E '^pan:1:|errors:' "$name/out")"
    failed=1
  fi
}

no_refusals=(-DRESUME_REFUSALS=0 -DSUSPEND_REFUSALS=0)
holds target_dies -DHANDLERS=1 -DTARGET -DRESUME_REFUSALS=2
holds module_unloads -DHANDLERS=1 -DUNLOAD
holds two_owners -DBRIEF -DWATCHDOGS=0 -DSUSPEND_REFUSALS=0
holds port_used_again -DBRIEF -DWATCHDOGS=0 -DREUSE "${no_refusals[@]}"
holds owner_process_dies -DHANDLERS=1 -DDEATH -DWATCHDOGS=1 "${no_refusals[@]}"
holds caller_killed -DHANDLERS=1 -DKILLED "${no_refusals[@]}"
holds each_lock_a_step -DHANDLERS=1 -DFINE "${no_refusals[@]}"
refuted broken_no_orphan_reference 'q[i].ref>0' -DHANDLERS=1 -DBROKEN_NO_ORPHAN
refuted broken_votes_overwritten 'q[i].votes==' -DBRIEF -DWATCHDOGS=0 -DBROKEN_VOTES_OVERWRITTEN "${no_refusals[@]}"
refuted broken_port_is_owner 'own[o].sock==s' -DBRIEF -DREUSE -DBROKEN_PORT_IS_OWNER
refuted broken_sweeper_armed_late 'sweep_due' -DSOCKETS=1 -DBRIEF -DWATCHDOGS=0 -DBROKEN_SWEEP_ARMED_LATE -DSUSPEND_REFUSALS=0
refuted broken_old_and_young '!(own[o].promised)' -DHANDLERS=1 -DBROKEN_OLD_AND_YOUNG "${no_refusals[@]}"
if [ "${2:-}" = deep ]; then
  holds deep_two_owners -DSUSPEND_REFUSALS=0
  holds deep_two_owners_target -DBRIEF -DTARGET
  holds deep_two_owners_unload -DBRIEF -DUNLOAD
  holds deep_two_threads -DSOCKETS=1 -DDEATH
  holds deep_everything -DHANDLERS=1 -DQUEUES=2 -DTARGET -DUNLOAD -DRESUME_REFUSALS=2
fi
exit $failed
