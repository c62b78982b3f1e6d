// SPDX-License-Identifier: Apache-2.0
// Names of a run's abstract sockets: PREFIX<pid>-<n>/<secret>/<name>. launch/sockets.h makes them; whoever looks for runs
// reads them in /proc/net/unix, where anybody may have put anything.
#pragma once

#include <optional>
#include <string>

#include <sys/types.h>

namespace xauto::runtime {

inline constexpr const char* kSocketPrefix = "xauto/";

struct RunAddress {
  std::string run;  ///< "<pid>-<n>"
  pid_t pid = 0;    ///< as the run calls itself: of its own PID namespace, or a lie
  std::string name;
};
/// nullopt: no run has such a name, or a terminal would obey it.
[[nodiscard]] std::optional<RunAddress> parse_address(const std::string& address);
/// All but the last part, which the sockets of one run share.
[[nodiscard]] std::string stem_of(const std::string& address);

}  // namespace xauto::runtime
