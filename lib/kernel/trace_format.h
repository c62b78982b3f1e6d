// SPDX-License-Identifier: Apache-2.0
// Where a tracepoint's record has what: the kernel's /sys/kernel/tracing/events/GROUP/NAME/format.
#pragma once

#include <cstdint>
#include <string>

#include <xauto/result.h>

namespace xauto::kernel {

struct TraceField {
  std::uint32_t at = 0;  ///< bytes from the record's begin; the first eight are BPF's
  std::uint32_t size = 0;
};

/// Of the text of a `format` file. kInvalid: it has no such field of its own, or one that lies outside of any record.
[[nodiscard]] Result<TraceField> trace_field(const std::string& format, const std::string& name);

/// The text of EVENT, "sched/sched_switch"; mounts tracefs where it is not yet. `root`: "" for this machine, or a folder
/// that stands for / in tests.
[[nodiscard]] Result<std::string> trace_format(const std::string& event,
                                               const std::string& root = "");

}  // namespace xauto::kernel
