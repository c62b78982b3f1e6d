// SPDX-License-Identifier: Apache-2.0
// Which XPUs does an XNode use beside the one that it is said to run on? Layers that a DLA does not
// know fall back to the GPU, and nobody tells. So each repetition is a pair: how busy another XPU was
// while the XNode ran, and in as long a time right after, in which it did not.
//
// If the XNode does not use that XPU, then whatever else keeps it busy is as likely to fall into the one
// as into the other: the sign of a pair's difference is a fair coin, whatever that load is. Used is
// what takes more luck than kFalseAlarm allows all questions of one audit together, and is at least
// kLeastSharePct of the XNode's time: the sign test, with Bonferroni's correction.
//
// That holds for load that does not know of the XNode: one that begins whenever the XNode ends, or
// runs only beside it, looks like none or like the XNode's own.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "model/platform.h"
#include "model/profile.h"
#include "xpu/busy.h"

namespace xauto::runtime {

inline constexpr double kFalseAlarm = 1e-4;        ///< the chance of one, anywhere in an audit
inline constexpr std::int64_t kLeastSharePct = 1;  ///< less is nobody's fallback

/// One repetition, of one other XPU.
struct BusyPair {
  std::int64_t busy_ns = 0, idle_ns = 0;  ///< while the XNode ran; in as long a time without it
};

/// The chance that a fair coin falls heads so often or oftener.
[[nodiscard]] double chance_of_heads(std::size_t heads, std::size_t throws);

/// `questions`: how many of these the audit asks in all. `exec_ns`: mean time of the XNode.
[[nodiscard]] OtherXpu judge(const std::vector<BusyPair>& pairs, std::int64_t exec_ns,
                             std::size_t questions);
/// Fewer could not convince, whatever they show.
[[nodiscard]] std::size_t repetitions_needed(std::size_t questions);

/// Threads: one, that of the profiler.
class Audit {
 public:
  /// `cores`: those of this process, CPU instance i being the i-th.
  Audit(const Platform& platform, const std::vector<Presence>& presence,
        const std::string& machine_root, const std::vector<int>& cores);
  /// What can be asked of an XNode on `xpu`: the other XPUs whose busy time somebody tells.
  [[nodiscard]] std::vector<int> others(int xpu, bool emulated);

  /// Right before and right after an exec on `xpu`; returns what became of the others meanwhile.
  [[nodiscard]] Status begin(int xpu, bool emulated);
  [[nodiscard]] Result<std::map<int, BusyPair>> end();

 private:
  struct Number {
    std::int64_t busy_ns = 0, at_ns = 0;
  };
  using Readings = std::map<int, Number>;
  [[nodiscard]] Result<Readings> read();
  [[nodiscard]] xpu::BusyMeter& meter() const { return emulated_ ? *emulator_ : *drivers_; }

  OneThread thread_;
  const std::size_t num_xpus_;
  std::unique_ptr<xpu::BusyMeter> emulator_, drivers_;
  int xpu_ = -1;
  bool emulated_ = false;
  Readings before_;
  std::int64_t begun_ns_ = 0;
};

}  // namespace xauto::runtime
