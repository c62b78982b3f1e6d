// SPDX-License-Identifier: Apache-2.0
// What a run says of its claims, in words: kept, not claimed here, or exceeded, and who is to be asked why.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "session/run_report.h"

namespace xauto::cli {

/// Of several reasons: on one line, or on a line each.
enum class Layout : std::uint8_t { kLine, kList };

/// What took time away from the run, the most first, as far as that is as long as what is to be explained, or
/// longer than kEmulatorUs; where waiting is not watched, that. Of a run that broke nothing.
[[nodiscard]] std::vector<std::string> taken_from(const runtime::RunReport& report,
                                                  std::int64_t exceeded_by_us);

/// "kept, as far as it is watched", "not claimed here: ...". `taken`: as taken_from; without any a run that
/// exceeds its claims is our fault.
[[nodiscard]] std::string verdict(bool exceeded, const std::vector<std::string>& broken,
                                  const std::vector<std::string>& taken,
                                  Layout layout = Layout::kLine);

}  // namespace xauto::cli
