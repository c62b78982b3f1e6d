# SPDX-License-Identifier: Apache-2.0
# Sourced: runs a command in a container, as Docker and podman make one. Needs unshare and setpriv of util-linux.
# What XAuto uses of root: bpf and perfmon load programs, sys_nice is for SCHED_FIFO, sys_admin mounts /sys/fs/bpf where it is not shared.
usual_caps=-all,+chown,+dac_override,+fowner,+fsetid,+kill,+setgid,+setuid,+setpcap,+net_bind_service,+net_raw,+sys_chroot,+mknod,+audit_write,+setfcap
scx_caps=$usual_caps,+bpf,+perfmon,+sys_nice
contained() { # CAPABILITIES, /sys: ro or rw, /sys/fs/bpf: own or shared, COMMAND...
  # The cgroup that is its root has no process of its own, so that it may limit those below.
  mkdir -p /sys/fs/cgroup/box/app
  echo +cpu >/sys/fs/cgroup/cgroup.subtree_control
  echo -cpu >/sys/fs/cgroup/box/cgroup.subtree_control # of the container before
  sh -c 'echo 0 >/sys/fs/cgroup/box/cgroup.procs && exec /usr/local/bin/unshare --cgroup sh -c "
    echo 0 >/sys/fs/cgroup/box/app/cgroup.procs && exec \"\$@\"" - "$@"' - \
    /usr/local/bin/unshare --pid --fork --kill-child --mount --uts --ipc --net sh -c '
    caps=$1 sys=$2 bpf=$3
    shift 3
    mkdir -p /tmp/host_bpf && mount -o bind /sys/fs/bpf /tmp/host_bpf
    mount -t proc proc /proc
    mount -t sysfs -o "$sys" sys /sys
    mount -t cgroup2 cgroup /sys/fs/cgroup
    [ "$bpf" = own ] || mount -o bind /tmp/host_bpf /sys/fs/bpf
    umount /tmp/host_bpf
    exec /usr/local/bin/setpriv --bounding-set "$caps" --inh-caps=-all "$@"' - "$@"
}
