# SPDX-License-Identifier: Apache-2.0
# Sourced by tools.sh: tracing with our tools and with bpftool, all at once on one run under sched_ext.
drive traced ext 0 & # until it is stopped
run=$!
loaded $run
xauto top --record trace.jsonl --count 0 --wait 30s >trace.txt 2>trace.err &
trace=$!
for _ in $(seq 600); do [ ! -e /sys/fs/bpf/xauto/*/pipe ] || break; sleep 0.1; done
maps=$(echo /sys/fs/bpf/xauto/*)
bpftool map event_pipe pinned "$maps/pipe" >pipe.txt 2>&1 &
pipe=$!
bpftool prog list >prog_list.txt
bpftool struct_ops list >struct_ops.txt
for map in policy table jobs hist; do # those that are looked at below
  bpftool map dump pinned "$maps/$map" >"dump_$map.txt" 2>&1 || echo "# no dump of $map"
done
xauto top --count 2 --interval 800ms >top.txt 2>top.err
kill -INT $pipe
sleep 1
kill -TERM $(pidof xauto) # the run, and the tracer with it; both end in order
wait $trace
status=$?
wait $run
[ $status -eq 0 ] || sed "s/^/# /" trace.err
ok "xauto top --record records a run" [ $status -eq 0 ]
ok "... and tells what it lost" sh -c 'grep -qE "^(complete|INCOMPLETE): " trace.txt'
ok "... with wake-ups, runs, preemptions, sleeps" sh -c 'for k in wakeup run preempt sleep; do grep -q "\"$k\"" trace.jsonl || exit 1; done'
ok "... by XNode" has "pr.predict" trace.txt
ok "xauto top shows each XNode and each XPU's load" sh -c 'grep -q "cpu0 .* %" top.txt && grep -q "tr.track" top.txt'
ok "bpftool map event_pipe prints events" has "CPU: " pipe.txt
ok "bpftool prog list shows the programs" sh -c 'grep -q struct_ops prog_list.txt && grep -q tracing prog_list.txt'
ok "bpftool struct_ops list shows the scheduler" has "sched_ext_ops" struct_ops.txt
ok "bpftool map dump shows the policy, a row for each of the 19 XNodes" \
  sh -c '[ "$(grep -c "\"xnode\": " dump_policy.txt)" = 19 ] && [ "$(grep -c "\"by\": \"priority\"" dump_policy.txt)" = 19 ]'
ok "... and the scheduler's table" has '"key": -19' dump_table.txt
ok "... what each thread goes by" has '"version": 1' dump_jobs.txt
ok "... and the histograms" has '"latency": ' dump_hist.txt
ok "nothing stays pinned" [ -z "$(ls /sys/fs/bpf/xauto 2>/dev/null)" ]
