#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# The tools end to end on real CPUs, in the VM: the Driving Case under sched_ext and under SCHED_FIFO, the fallback, tracing. KTAP.
count=0 failed=0 skipped=0
lacks= # what the kernel lacks for what follows
ok() { # NAME CONDITION...
  name=$1
  shift
  count=$((count + 1))
  if [ -n "$lacks" ]; then
    echo "ok $count $name # SKIP $lacks"
    skipped=$((skipped + 1))
  elif "$@"; then echo "ok $count $name"; else
    echo "not ok $count $name"
    failed=$((failed + 1))
  fi
}
has() { grep -q -- "$1" "$2"; }
state() { cat /sys/kernel/sched_ext/state; }
loaded() { # PID: waits until a run has loaded its scheduler, for 60 s
  for _ in $(seq 600); do
    [ "$(state)" != enabled ] || return 0
    kill -0 "$1" 2>/dev/null || break
    sleep 0.1
  done
  echo "# no scheduler was loaded"
}
here=$(realpath "$(dirname "$0")")
. "$here/container.sh"
dir=/tmp/tools
mkdir -p $dir && cd $dir || exit 1
echo "TAP version 13"
if [ ! -e /sys/kernel/sched_ext ]; then
  echo "1..0 # SKIP this kernel has no sched_ext"
  exit 4
fi
export XAUTO_VERIFIER_LOG=$dir/verifier.log
driving_cpu --app-json >app.json
# One CPU, the second: there the order of completion follows from the priorities alone.
echo '{"schema":"xauto.platform","version":1,"name":"one","xpus":[{"id":"cpu0","type":"cpu","preemptive":true,"preempt_us":0}]}' >one.json
xauto solve --app app.json --platform one.json --method heft --out policy.json >solve.log 2>&1 || cat solve.log
# The period leaves time between two activations; one that comes early on a machine that stalls waits, and is not lost.
# In lockstep the next one is released while a worker still tidies up at the priority of its
# last job, and then its first job of the next activation comes late.
inside= # of a container: the command before
drive() { # NAME CPU_SCHED ACTIVATIONS [OPTIONS]: the app's order in NAME.order, the report in NAME.json
  [ -z "$lacks" ] || return
  name=$1 sched=$2 activations=$3
  shift 3
  $inside taskset 2 xauto run --app app.json --platform one.json --policy policy.json --activations "$activations" --period 500ms --overload queue:16 \
    --cpu-sched "$sched" --out "$name.json" "$@" -- driving_cpu --order "$dir/$name.order" >"$name.out" 2>"$name.err"
}

drive ext ext 13
status=$?
ok "the Driving Case runs under sched_ext" [ $status -eq 0 ]
ok "... which says so, and in which mode" has "sched_ext, full mode" ext.err
ok "... and is gone afterwards" [ "$(state)" = disabled ]
ok "... with its maps" [ -z "$(ls /sys/fs/bpf/xauto 2>/dev/null)" ]
drive fifo fifo 13
ok "the Driving Case runs under SCHED_FIFO" [ $? -eq 0 ]
# In the first one, pages are touched for the first time, and a thread that waits for memory is overtaken.
tail -n +2 ext.order >ext.warm
tail -n +2 fifo.order >fifo.warm
ok "both complete all stages in the same order, in each of 12 activations after the first" cmp -s ext.warm fifo.warm
diff ext.warm fifo.warm | head -n 6 | sed 's/^/# /'
ok "... all 19 stages of each" [ "$(wc -w <ext.order)" -eq 260 ]
drive other other 13
cmp -s ext.order other.order && echo "# without priorities the order happened to be the same" || echo "# without priorities the order is another one"

# The loader dies in the middle.
drive killed ext 16 &
run=$!
loaded $run
sleep 3
kill -9 "$(pidof xauto-cpusched)"
wait $run
status=$?
ok "the loader killed: the app goes on to its end" [ $status -eq 0 ]
# Whatever ran or was waiting at that moment was for a while an ordinary thread: that activation may differ, and the one begun meanwhile.
usual=$(tail -n 1 ext.order | cut -d' ' -f2-)
differ=$(tail -n +2 killed.order | cut -d' ' -f2- | grep -vcxF "$usual")
ok "... in the same order under the fallback, but for two activations at most ($differ)" [ "$differ" -le 2 ]
ok "... and says so" has "the sched_ext scheduler ended: CPU XNodes went on under SCHED_FIFO" killed.json
ok "... with all activations" [ "$(wc -l <killed.order)" -eq 16 ]
ok "... and the kernel is back at its own scheduler" [ "$(state)" = disabled ]

# A second app while the first one runs: one scheduler, one rule.
drive first ext 24 &
run=$!
loaded $run
drive second ext 6 &
second=$!
fifo=0 seen=0
while kill -0 $second 2>/dev/null; do
  for app in $(pidof driving_cpu); do
    for task in /proc/$app/task/*; do
      [ "$(cut -d' ' -f41 "$task/stat" 2>/dev/null)" = 1 ] || continue
      # Execution threads: those above are real-time in any case.
      [ "$(cut -d' ' -f40 "$task/stat" 2>/dev/null)" -lt 45 ] && fifo=$((fifo + 1))
    done
    seen=$((seen + 1))
  done
  sleep 0.2
done
wait $second
ok "a second app runs beside the first under its scheduler, and says so" has "sched_ext, full mode, beside run" second.err
ok "... and that it is not alone" has "worst cases are those of an app that has them alone" second.err
ok "... nobody under SCHED_FIFO ($fifo threads, $seen looks)" [ "$fifo" -eq 0 -a "$seen" -gt 0 ]
ok "... all stages of it" [ "$(wc -w <second.order)" -eq 120 ]
# The rows are given back, so that a third finds them. It is in a container.
[ -e /proc/self/ns/pid ] || lacks="this kernel has no PID namespaces"
inside="contained $scx_caps ro shared" drive third ext 2
ok "... and a third one after it, in a container that shares /sys/fs/bpf" has "sched_ext, full mode, beside run" third.err
ok "... all stages of it" [ "$(wc -w <third.order)" -eq 40 ]
inside="contained $scx_caps,+sys_admin ro own" drive apart ext 1
ok "one that does not share it says so" has "no sched_ext: another sched_ext scheduler is loaded: 'xauto', of a run that is not seen here" apart.json
wait $run

# In containers that may less.
inside="contained $usual_caps ro own" drive docker ext 1
ok "a container with Docker's usual rights runs to its end" [ $? -eq 0 ]
ok "... and says in a line what it lacks" has "no sched_ext: mounting the BPF file system at /sys/fs/bpf: Operation not permitted; SCHED_FIFO instead" docker.json
inside="/usr/local/bin/unshare --user --map-root-user" drive rootless ext 1
ok "a rootless one, too" [ $? -eq 0 ]
ok "... and says so" has "no sched_ext: making the BPF maps: Operation not permitted" rootless.json
inside="contained $scx_caps ro shared" drive enough ext 2
ok "CAP_BPF, CAP_PERFMON, CAP_SYS_NICE and the host's /sys/fs/bpf are enough" has "sched_ext, full mode" enough.err
lacks=

# No BTF: an empty folder in its place.
mkdir -p empty && mount -o bind empty /sys/kernel/btf
drive nobtf ext 4
status=$?
umount /sys/kernel/btf
ok "without BTF the app runs to its end" [ $status -eq 0 ]
ok "... under SCHED_FIFO, and says so" has "no sched_ext: this kernel has no BTF" nobtf.json
ok "... with all activations" [ "$(wc -l <nobtf.order)" -eq 4 ]

# No privilege: somebody else than root.
chmod 1777 $dir
su user -s /bin/sh -c "cd $dir && taskset 2 xauto run --app app.json --platform one.json --policy policy.json --activations 4 \
  --period 500ms --overload queue:16 --cpu-sched ext --out plain.json -- driving_cpu --order $dir/plain.order" >plain.out 2>plain.err
status=$?
grep -h "no sched_ext\|SCHED_FIFO" plain.err | sed 's/^/# /'
ok "without privilege the app runs to its end" [ $status -eq 0 ]
ok "... as ordinary threads, and says why" sh -c 'grep -q "no sched_ext" plain.json && grep -q "SCHED_FIFO" plain.json'
ok "... and how to get more" has "CAP_SYS_NICE\|root" plain.err
ok "... with all activations" [ "$(wc -l <plain.order)" -eq 4 ]

# The same user with a real-time limit that is just enough for the 19 stages, below the four levels of XAuto's own.
limited() { # COMMAND
  (ulimit -r 24 && exec su user -s /bin/sh -c "cd $dir && $1")
}
priorities() { # PROGRAM: of its SCHED_FIFO threads, from stat, fields 40 and 41
  for pid in $(pidof "$1"); do cat /proc/"$pid"/task/*/stat 2>/dev/null; done | sed 's/.*) //' | awk '$39 == 1 { print $38 }' | sort -n
}
limited "xauto doctor" >doctor.out 2>&1
ok "what a limit leaves, xauto doctor says" has "SCHED_FIFO permitted up to 24" doctor.out
limited "taskset 2 xauto run --app app.json --platform one.json --policy policy.json --activations 7 --period 500ms --overload queue:16 --out limited.json \
  -- driving_cpu --order $dir/limited.order" >limited.out 2>limited.err &
run=$!
for _ in $(seq 300); do
  [ "$(priorities driving_cpu | wc -l)" -gt 12 ] && break
  sleep 0.1
done
priorities driving_cpu >limited.app
priorities xauto-coordinator >limited.coordinator
wait $run
status=$?
ok "under a limit the app runs to its end" [ $status -eq 0 ]
ok "... and says so" has "SCHED_FIFO is permitted up to 24, not 60: XNodes on CPUs use 2 to 20" limited.json
ok "... with the coordinator at the top" [ "$(cat limited.coordinator)" = 24 ]
ok "... the management threads below" [ "$(tail -n 1 limited.app)" = 23 ]
tail -n +2 limited.order >limited.warm
ok "... in the same order as without one" sh -c '[ "$(wc -l <limited.warm)" -eq 6 ] && head -n 6 fifo.warm | cmp -s - limited.warm'
head -n 6 fifo.warm | diff - limited.warm | head -n 6 | sed 's/^/# /'

. "$here/trace.sh"

# What the verifier said of everything that was loaded above: counts, and nothing else.
ok "the verifier's log tells of both objects" sh -c 'grep -q "^# xauto_scx on" verifier.log && grep -q "^# xauto_trace on" verifier.log'
ok "... and is clean" sh -c '[ -s verifier.log ] && ! grep -vE "^(# .*; libbpf: no warning|[a-z_]+:|(insns )?processed [0-9+]+( insns .*)?|verification time .*|stack depth .*)$" verifier.log'
awk '/^#/ { object = $2 " " $5 } /^[a-z_]+:$/ { program = $1 } /^processed/ { if (!seen[object program]++) print "# verifier: " object " " program " " $2 " instructions" }' \
  verifier.log

echo "1..$count"
echo "# pass:$((count - failed - skipped)) fail:$failed skip:$skipped"
[ $failed -eq 0 ]
