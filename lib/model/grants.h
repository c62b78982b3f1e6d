// SPDX-License-Identifier: Apache-2.0
// Grants: who may use which SCHED_FIFO priorities, by the administrator's word. File: grants.json,
// read by the one program that has the right to raise a limit (tools/grant/), so it is trusted by
// its owner and mode, not by its contents. Threads: pure but for `load_grants`.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include <sys/types.h>

#include <xauto/result.h>

#include "model/keys.h"

namespace xauto {

/// SCHED_FIFO priorities, both ends included; {0, 0}: none.
struct FifoRange {
  int lowest = 0, highest = 0;
  [[nodiscard]] bool empty() const { return highest <= 0; }
  bool operator==(const FifoRange&) const = default;
};
/// No run uses more; what is above is the machine's own.
inline constexpr int kMaxGrantedFifo = 70;
inline constexpr std::size_t kMaxGrants = 256;
inline constexpr std::size_t kMaxGrantsBytes = 64 * 1024;

struct Grant {
  enum class To : std::uint8_t { kUser, kGroup, kCgroup };
  To to = To::kUser;
  std::string name;  ///< of a user or group, or its number; a cgroup v2's path and all below it
  FifoRange range;
  bool operator==(const Grant&) const = default;
  /// For people: "user alice".
  [[nodiscard]] std::string to_string() const;
};

/// Whom a grant may be for.
struct Identity {
  struct Id {
    unsigned number = 0;
    std::string name;  ///< empty: it has none
  };
  Id user;
  std::vector<Id> groups;  ///< all of them
  std::string cgroup;      ///< path in the cgroup v2 hierarchy; empty: there is none
};

struct Grants {
  std::vector<Grant> grants;
  bool operator==(const Grants&) const = default;
  /// The one with the highest priority, among equals the one that reaches lowest; null: none.
  [[nodiscard]] const Grant* find(const Identity& identity) const;
};

/// Unlike in our other files, an unknown key is an error: a misspelt one would change who may what.
[[nodiscard]] Result<Grants> parse_grants(std::string_view text, std::string_view origin,
                                          Keys* keys = nullptr);
[[nodiscard]] std::string to_json(const Grants& grants);
/// Refused unless file and folder belong to `owner` and nobody else can write them.
[[nodiscard]] Result<Grants> load_grants(const std::string& path, uid_t owner = 0);

/// The cgroup v2 path in the text of /proc/PID/cgroup; empty: there is none.
[[nodiscard]] std::string cgroup_of(std::string_view proc_cgroup);

}  // namespace xauto
