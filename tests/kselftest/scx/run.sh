#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# The tests of sched_ext and tracing, in the VM, but for those that need CPUs that run at once (run-scx). KTAP of the programs first, then of the tools end to end.
# usage: run.sh KILLS TABLES LOADS
bad=0
chmod 755 /
scx_test turns || bad=1
scx_keys_test turns || bad=1
scx_lend_test turns || bad=1
scx_machine_test turns "$3" || bad=1
scx_life_test turns "$1" "$2" || bad=1
sh "$(dirname "$0")/tools.sh" || bad=1
dmesg | grep -E "BUG|WARNING|stall|lockup|Call Trace" | grep -v "runnable task stall" | sed 's/^/# dmesg: /'
exit $bad
