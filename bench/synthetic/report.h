// SPDX-License-Identifier: Apache-2.0
// Measurements as a table for people, JSON lines for machines, and SVG plots in the shape of the
// paper's.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "bench/synthetic/measure.h"

namespace xauto::bench {

[[nodiscard]] double mean(const std::vector<double>& values);
[[nodiscard]] double median(std::vector<double> values);

/// One column of the tables: a number per DAG.
struct Column {
  std::string title;
  std::function<double(const Measured&)> value;
};

/// Per platform: a row per group and one over all, means; beside the paper's figures.
[[nodiscard]] std::string table(const std::vector<Measured>& all);
[[nodiscard]] std::string json_line(const Measured& m);
/// What json_line wrote; nullopt if it is not a whole line of that kind.
[[nodiscard]] std::optional<Measured> read_line(const std::string& line);
/// The ROS 2 model with ideal sharing, per group: ours with the 95 % confidence interval of the
/// mean, the calibration's (../shared/facts/solver.md), and what the proven bounds leave possible.
[[nodiscard]] std::string calibration(const std::vector<Measured>& all);
/// Share proven, solving time and first answer per group.
[[nodiscard]] std::string speed(const std::vector<Measured>& all);
/// Speed-up of XAuto per group, over the ROS 2 model and HEFT, with what the bound leaves possible.
[[nodiscard]] std::string speedup_svg(const std::vector<Measured>& all,
                                      const std::string& platform);
/// What is lost without scheduling and without assignment, per group.
[[nodiscard]] std::string ablation_svg(const std::vector<Measured>& all,
                                       const std::string& platform);

}  // namespace xauto::bench
