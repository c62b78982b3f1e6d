#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# In the guest: what a user is told of contexts that grow after `init`, and of contexts from before it. The whole runtime over the
# emulators: modules, workers, coordinator, xauto.ko.
# shellcheck disable=SC2317 # called through check
[ "${XAUTO_RUNTIME:-}" != none ] || { echo "TAP version 13"; echo "1..0 # SKIP the runtime is not built for this guest"; exit 4; }
cd /opt/xauto/bin || exit 1
app=/opt/xauto/contexts.json
status=0 number=0
check() { # NAME CONDITION...
	name=$1 number=$((number + 1))
	shift
	if "$@"; then echo "ok $number $name"; else echo "not ok $number $name"; status=1; fi
}
top_says() { ./xauto top --once --interval 50ms 2>&1 | tr -s "\n " " " >/tmp/top; grep -q "$1" /tmp/top; } # a line
top_is_silent() { top_says "worst cases" && ! grep -q "$1" /tmp/top; }
eventually() { # CONDITION...: within 20 s and more
	tries=100
	until "$@"; do
		tries=$((tries - 1))
		[ "$tries" -gt 0 ] || { sed 's/^/# /' /tmp/top; return 1; }
		sleep 0.2
	done
}
run() { # [before]: slow's first job is held until /tmp/go is there
	rm -f /tmp/go
	./xauto run --app "$app" --policy /tmp/policy.json --platform small --emulator-modules --activations 0 --overload queue:256 --json \
		-- ./contexts_app /tmp/go "$@" >/tmp/report 2>/tmp/errors &
	pid=$!
}
report_says() { # KINDS, each with its count: ends the run
	kill -TERM "$pid"
	wait "$pid"
	told=$(tr -d ' \n' </tmp/report | grep -oE '"([a-z]+_context|unclaimed_queue)","count":[0-9]+' | tr '\n' ' ')
	echo "$told" | grep -qE "^$1 $" && return 0
	sed 's/^/# /' /tmp/errors
	echo "# $told"
	return 1
}
echo "TAP version 13"
echo "1..7"
./xauto solve --app "$app" --platform small --max-evaluations 300 --threads 1 --out /tmp/policy.json >/dev/null || exit 1
run
check "a context whose stage has not run is not complete, says top" eventually top_says "1 contexts not complete"
touch /tmp/go
check "and nothing of it when each has run" eventually top_is_silent "not complete"
check "the report counts the suspensions from before" report_says '"partial_context","count":[1-9][0-9]*'
run before
check "a context from before init was given what was nobody's, says top" eventually top_says "1 contexts were made before"
touch /tmp/go
check "and it is complete when it has run" eventually top_is_silent "not complete"
check "the report says both" report_says '"partial_context","count":[1-9][0-9]* "assumed_context","count":1'
check "nothing is left suspended" sh -c '! grep -q enabled=0 /sys/kernel/debug/xauto_nvgpu_emu/state'
exit "$status"
