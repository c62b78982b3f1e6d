#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# All tests of sched_ext and tracing, in the VM. KTAP of the programs first, then of the tools end to end.
# usage: run.sh KILLS TABLES LOADS
bad=0
chmod 755 /
scx_test || bad=1
scx_keys_test || bad=1
scx_lend_test || bad=1
scx_machine_test "" "$3" || bad=1
scx_life_test "" "$1" "$2" || bad=1
sh "$(dirname "$0")/tools.sh" || bad=1
dmesg | grep -E "BUG|WARNING|stall|lockup|Call Trace" | grep -v "runnable task stall" | sed 's/^/# dmesg: /'
exit $bad
