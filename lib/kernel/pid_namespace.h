// SPDX-License-Identifier: Apache-2.0
// The PID namespace of this process, as the kernel numbers it.
#pragma once

#include <cerrno>
#include <optional>

#include <sys/stat.h>

namespace xauto::kernel {

/// Linux: PROC_PID_INIT_INO, of the namespace that every other is in.
inline constexpr ino_t kFirstPidNamespace = 0xEFFFFFFC;

/// nullopt: /proc does not tell; errno says why. A kernel without CONFIG_PID_NS has one namespace, and no file for it.
[[nodiscard]] inline std::optional<ino_t> own_pid_namespace() {
  struct stat of {};
  if (stat("/proc/thread-self/ns/pid", &of) == 0) return of.st_ino;
  if (errno != ENOENT || stat("/proc/thread-self/comm", &of) != 0) return std::nullopt;
  return kFirstPidNamespace;
}

}  // namespace xauto::kernel
