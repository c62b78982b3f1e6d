// SPDX-License-Identifier: Apache-2.0
// Measurements as JSON lines, for scripts/paper.py.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "bench/synthetic/measure.h"

namespace xauto::bench {

/// The mean of ratios, as the paper has it: (a/b) and (b/a) of one set are inverse to each other, which the
/// arithmetic mean's are not. Values above 0; 0 of none.
[[nodiscard]] double geometric_mean(const std::vector<double>& values);

[[nodiscard]] std::string json_line(const Measured& m);
/// What json_line wrote; nullopt if it is not a whole line of that kind.
[[nodiscard]] std::optional<Measured> read_line(const std::string& line);

}  // namespace xauto::bench
