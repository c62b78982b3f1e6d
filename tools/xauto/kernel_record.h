// SPDX-License-Identifier: Apache-2.0
// What the kernel does with the threads of a run's XNodes, event by event, for a file. docs/tracing.md.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/json_value.h"

#include "xauto/live.h"

namespace xauto::cli {

/// Threads: one.
class KernelRecord {
 public:
  explicit KernelRecord(Live& live) : live_(live) {}
  /// Takes what has come; waits at most `timeout_ms` for the first of it. Returns how much that was.
  [[nodiscard]] Result<std::size_t> read(int timeout_ms);

  /// "INCOMPLETE: ..." or "complete: ...", of all until now.
  [[nodiscard]] std::string losses_line() const;
  [[nodiscard]] Json json() const;
  /// A Perfetto trace where `path` is FILE.pftrace, else a JSON object per line.
  [[nodiscard]] std::string file(const std::string& path) const;

 private:
  Live& live_;
  std::vector<xauto_bpf_event> events_;
  std::uint64_t not_kept_ = 0;
};

}  // namespace xauto::cli
