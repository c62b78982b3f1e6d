// SPDX-License-Identifier: Apache-2.0
// What can be read of a recording that Recording refuses, or stops in: it reads on behind what is broken. Nothing is
// guessed: what a checksum contradicts is left out, and whatever is left out is told.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "record/recording.h"

namespace xauto::record {

/// Called for each message that can be read, in the order of the file. An error ends it all.
using Take =
    std::function<Status(const Topic&, std::int64_t timestamp_ns, std::span<const std::byte> data)>;

struct Salvaged {
  static constexpr std::size_t kMaxTold = 20;

  std::uint64_t messages = 0;         ///< that were taken
  std::uint64_t faults = 0;           ///< places where something was left out
  std::vector<std::string> left_out;  ///< the first kMaxTold: which file, where, why

  void leave_out(const std::string& path, const std::string& what);
};

/// `path`: as Recording::open has it. Errors: there is no such file or folder, or `take`'s. What is wrong with the
/// recording is no error.
[[nodiscard]] Result<Salvaged> salvage(const std::string& path, const Take& take);

/// Of one file.
[[nodiscard]] Status salvage_mcap(const std::string& path, const Take& take, Salvaged& out);
[[nodiscard]] Status salvage_sqlite(const std::string& path, const Take& take, Salvaged& out);

}  // namespace xauto::record
