#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# In the guest: the deployed policy as bpftool shows it, and tracing without BTF, on kernels without sched_ext, too. XPUs are emulated. KTAP.
[ "${XAUTO_RUNTIME:-}" != none ] || { echo "TAP version 13"; echo "1..0 # SKIP the runtime is not built for this guest"; exit 4; }
cd /opt/xauto/bin || exit 1
[ -d /sys/fs/bpf ] || { echo "TAP version 13"; echo "1..0 # SKIP this kernel has no BPF"; exit 4; }
dir=$(mktemp -d)
count=0 failed=0
ok() { # NAME CONDITION...
	name=$1 count=$((count + 1))
	shift
	if "$@"; then echo "ok $count $name"; else echo "not ok $count $name"; failed=1; fi
}
rows() { # of the policy's file: name, XPU, key
	tr -d ' \n' <"$1" | sed 's/{"name"/\n&/g' | sed -n 's/^{"name":"\([^"]*\)","xpu":"\([^"]*\)","key_us":\[\([0-9]*\).*/\1 \2 key_us \3/p'
}
dumped() { # the same of what bpftool printed
	sed -n 's/.*"xnode": "\(.*\)",/\1/p; s/.*"xpu": "\(.*\)",/\1/p; s/.*"by": "\(.*\)",/\1/p; s/.*"value": \([-0-9]*\),/\1/p' "$1" | paste -d ' ' - - - -
}
recorded() { # PATTERN...: each is in some line
	[ $traced -eq 0 ] || return 1
	for pattern in "$@"; do grep -q -- "$pattern" "$dir/events.jsonl" || { echo "# no $pattern"; return 1; }; done
}
echo "TAP version 13"
./xauto solve --app /opt/xauto/driving.json --platform small --max-evaluations 1 --time-limit 20s --out "$dir/policy.json" >"$dir/solve.out" 2>&1 || cat "$dir/solve.out"
./xauto run --app /opt/xauto/driving.json --platform small --policy "$dir/policy.json" --emulate --activations 0 -- ./driving >"$dir/out" 2>&1 &
run=$!
tries=0
until bpftool map dump name xauto_policy >"$dir/dump" 2>&1 && [ -s "$dir/dump" ] || [ $tries -gt 600 ]; do sleep 0.1; tries=$((tries + 1)); done
pinned=$(echo /sys/fs/bpf/xauto/*/policy)
bpftool map dump pinned "$pinned" >"$dir/pinned" 2>&1
# The tracer, where it finds no BTF.
mkdir "$dir/empty"
[ ! -e /sys/kernel/btf ] || mount -o bind "$dir/empty" /sys/kernel/btf
tries=0 traced=1
while [ $traced -ne 0 ] && [ $tries -lt 100 ]; do # until the app has begun
	./xauto top --once --interval 3s --record "$dir/events.jsonl" >"$dir/top" 2>&1 && traced=0
	tries=$((tries + 1))
done
[ ! -e /sys/kernel/btf ] || umount /sys/kernel/btf
kill $run
wait $run
ok "the run ends in order" [ $? -eq 0 ]
rows "$dir/policy.json" >"$dir/wanted"
dumped "$dir/dump" >"$dir/shown"
ok "the policy has keys for CPUs, GPU and DLA" sh -c "grep -q ' gpu0 ' $dir/wanted && grep -q ' dla0 ' $dir/wanted && grep -q ' cpu. ' $dir/wanted"
ok "bpftool map dump name xauto_policy shows a row per XNode, with its XPU and its key, and no other" cmp -s "$dir/wanted" "$dir/shown"
diff "$dir/wanted" "$dir/shown" | head -n 6 | sed 's/^/# /'
ok "so does the pinned path" cmp -s "$dir/dump" "$dir/pinned"
ok "without BTF the tracer records wake-ups, runs, sleeps" recorded '"wakeup"' '"run"' '"sleep"'
ok "... of every XNode" recorded $(sed 's/^\([^ ]*\) .*/"run".*"\1"/' "$dir/wanted")
ok "it is gone with the run" [ -z "$(ls /sys/fs/bpf/xauto 2>/dev/null)" ]
[ $failed -eq 0 ] || head -n 5 "$dir/out" "$dir/dump" "$dir/top" | sed 's/^/# /'
echo "1..$count"
exit $failed
