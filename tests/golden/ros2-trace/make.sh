#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Makes made/ by LTTng itself: lttng-tools, liblttng-ust-dev. As any user.
set -eu
cd "$(dirname "$0")"
work=$(mktemp -d)
export LTTNG_HOME="$work"
trap 'kill "$(cat "$work/pid")"; rm -rf "$work"' EXIT
cc -I. -o "$work/program" program.c -llttng-ust -ldl
lttng-sessiond --daemonize --no-kernel --pidfile="$work/pid"
lttng create made --output="$work/trace"
# Small buffers, which the flood at the end overruns.
lttng enable-channel --userspace --subbuf-size=8K --num-subbuf=2 c
lttng enable-event --userspace --channel=c 'ros2:*'
lttng add-context --userspace --channel=c --type=vpid --type=vtid
lttng start
"$work/program" flood
lttng stop
lttng destroy
rm -rf made
mkdir made
cp "$work"/trace/ust/uid/*/64-bit/metadata made/
for stream in "$work"/trace/ust/uid/*/64-bit/c_*; do
  [ -s "$stream" ] && cp "$stream" made/
done
chmod 644 made/*
ls -l made
