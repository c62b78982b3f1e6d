// SPDX-License-Identifier: Apache-2.0
// Where the coordinator of an XPU is: at an abstract socket of the run's own, or behind the machine's socket
// (launch/system_service.h), which hands the connection on to the coordinator that all runs share. As text, since
// sessions carry it.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "coord/protocol.h"
#include "model/json_value.h"

namespace xauto::coord {

/// The right of one run to be scheduled by the machine's coordinators.
struct Lease {
  std::uint32_t number = 0;
  std::uint64_t secret = 0;  ///< who does not know it does not get in
  /// XNodes of the run's app are first_xnode + 0 .. num_xnodes - 1 to the coordinators.
  std::uint32_t first_xnode = 0, num_xnodes = 0;
  bool operator==(const Lease&) const = default;
};

struct Door {
  std::string path;  ///< the machine's socket; "" of an abstract one
  std::string name;  ///< of the hardware, "core3"; of an abstract one the socket's
  Lease lease;

  [[nodiscard]] bool shared() const { return !path.empty(); }
  [[nodiscard]] std::string to_text() const;
  bool operator==(const Door&) const = default;
};
/// What begins with '/' is behind the machine's socket. kInvalid: not as to_text() writes it.
[[nodiscard]] Result<Door> parse_door(const std::string& text);

/// Connects; behind the machine's socket it also says Attach, whose refusal comes in place of the coordinator's
/// answer.
[[nodiscard]] Result<UniqueFd> open_door(const Door& door);

/// Who is there, as the machine's service says (launch/system_lease.h). kTimeout: it did not answer within 2 s.
[[nodiscard]] Result<Json> ask_machine(const std::string& path);
/// Of what it says, that which a run has to know of the others.
struct Neighbours {
  /// Processes of all runs that have joined, and its coordinators, as they are called where it runs.
  std::vector<pid_t> processes;
  /// By hardware, where work of others is suspended: how often it was not (launch/foreign_work.h).
  std::map<std::string, std::int64_t> not_kept_off;
};
[[nodiscard]] Neighbours neighbours(const Json& machine);

/// The run's own number of an XNode that the coordinator calls `there`; none: it is another run's.
[[nodiscard]] inline std::optional<std::uint32_t> own_xnode(const Door& door, std::uint32_t there) {
  if (!door.shared()) return there;
  if (there < door.lease.first_xnode || there - door.lease.first_xnode >= door.lease.num_xnodes)
    return std::nullopt;
  return there - door.lease.first_xnode;
}

}  // namespace xauto::coord
