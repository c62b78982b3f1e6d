// SPDX-License-Identifier: Apache-2.0
// How long an XPU has been busy, whoever's work it was: for the question what an XNode uses beside the
// XPU that it is said to run on. The emulator knows it exactly. Of drivers only what needs no rights
// and no profiler of the vendor's is asked:
//
//   CPU core   /proc/stat: a counter, in ticks of 10 ms
//   nvgpu      the GPU's file `load`: a mean, in 1/1000, of the last kLoadPeriods samples of the
//              driver's PMU. The numbers are of the driver's source, as of GPUs before Orin's; no
//              board has confirmed them. Its grain is a third of a millisecond.
//   nvdla      nothing: it shows whether the DLA has power, which it keeps for long after its work
//
// What nobody tells of is not guessed.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/platform.h"

namespace xauto::xpu {

inline constexpr std::int64_t kLoadPeriodNs = 16'700'000;  ///< between two samples of nvgpu's PMU
inline constexpr int kLoadPeriods = 17;                    ///< that `load` is the mean of

/// Threads: one.
class BusyMeter {
 public:
  virtual ~BusyMeter() = default;
  /// 0: busy_ns counts from some instant on; more: it is of the last so long; nullopt: nobody tells.
  [[nodiscard]] virtual std::optional<std::int64_t> looks_back_ns(int xpu) const = 0;
  /// Of an XPU that somebody tells of.
  [[nodiscard]] virtual Result<std::int64_t> busy_ns(int xpu) = 0;
};

/// The calling thread's emulator; of XPUs that it has.
[[nodiscard]] std::unique_ptr<BusyMeter> busy_on_emulator(const Platform& platform,
                                                          const std::vector<Presence>& presence);
/// `root` stands for /. `cores`: CPU instance i is the i-th of them.
[[nodiscard]] std::unique_ptr<BusyMeter> busy_by_drivers(const Platform& platform,
                                                         const std::string& root,
                                                         const std::vector<int>& cores);

}  // namespace xauto::xpu
