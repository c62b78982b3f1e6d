// SPDX-License-Identifier: Apache-2.0
// What `xauto top` shows of a run: two looks at it, as JSON and as text.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "model/json_value.h"
#include "model/xpu_status.h"

#include "xauto/counts.h"
#include "xauto/kernel_record.h"
#include "xauto/live.h"

namespace xauto::cli {

/// What BPF saw until one moment.
struct KernelLook {
  std::int64_t at_ns = 0;
  std::vector<xauto_bpf_hist> hist;
  std::vector<xauto_bpf_cpu> cpus;
  std::map<std::uint32_t, std::uint64_t> busy_ns;  ///< XPU -> time that jobs held it
};
[[nodiscard]] KernelLook look_at(const Live& live);

/// All that is looked at, at one moment.
struct Look {
  Counts counts;
  std::vector<XpuStatus> xpus;       ///< of the coordinators that answered
  std::optional<KernelLook> kernel;  ///< none: `ShownRun::why_not`
};

struct ShownRun {
  std::string run;
  unsigned uid = 0;
  std::optional<Watched> watched;  ///< none: its coordinators answer alone, and `now` has no counts
  const Live* live = nullptr;      ///< null: nobody looks into the kernel
  const KernelRecord* record = nullptr;  ///< null: nothing is recorded
  std::string why_not;                   ///< there is no `live`
  Look before, now;
};

[[nodiscard]] Json json_of(const ShownRun& shown);
/// `workers`: what each of them does, else who runs and who waits per XPU. Lines of 80 columns.
[[nodiscard]] std::string text_of(const ShownRun& shown, bool workers);

}  // namespace xauto::cli
