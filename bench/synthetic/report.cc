// SPDX-License-Identifier: Apache-2.0
#include "bench/synthetic/report.h"

#include <cmath>

#include <fmt/format.h>

#include "model/json_value.h"

namespace xauto::bench {

double geometric_mean(const std::vector<double>& values) {
  if (values.empty()) return 0;
  double logarithms = 0;
  for (const double value : values) logarithms += std::log(value);
  return std::exp(logarithms / static_cast<double>(values.size()));
}

std::optional<Measured> read_line(const std::string& line) {
  const Json j = Json::parse(line).value_or(Json());
  Measured m;
  const auto take = [&](const char* key, auto& into) {
    using T = std::remove_reference_t<decltype(into)>;
    const auto found = [&] {
      if constexpr (std::is_same_v<T, std::string>)
        return j.at(key).text();
      else if constexpr (std::is_same_v<T, bool>)
        return j.at(key).boolean();
      else if constexpr (std::is_same_v<T, double>)
        return j.at(key).number();
      else
        return j.at(key).integer();
    }();
    if (found) into = static_cast<T>(*found);
    return found.has_value();
  };
  const bool whole =
      take("platform", m.platform) && take("nodes", m.nodes) && take("seed", m.seed) &&
      take("ros2_ideal_us", m.ros2_ideal) && take("ros2_slices_us", m.ros2_slices) &&
      take("heft_us", m.heft) && take("xauto_us", m.xauto) && take("bound_us", m.bound) &&
      take("certified_us", m.certified) && take("unscheduled_ideal_us", m.unscheduled_ideal) &&
      take("unscheduled_slices_us", m.unscheduled_slices) && take("unassigned_us", m.unassigned) &&
      take("optimal", m.optimal) && take("first_us", m.first) && take("first_ms", m.first_ms) &&
      take("solve_s", m.solve_s) && take("evaluations_per_s", m.evaluations_per_s);
  (void)take("emulated_us", m.emulated);  // lines of before have none
  if (!whole || m.xauto <= 0 || m.bound <= 0) return std::nullopt;
  return m;
}

std::string json_line(const Measured& m) {
  return fmt::format(
      "{{\"platform\":\"{}\",\"nodes\":{},\"seed\":{},\"ros2_ideal_us\":{},\"ros2_slices_us\":{},"
      "\"heft_us\":{},"
      "\"xauto_us\":{},\"emulated_us\":{},\"bound_us\":{},\"certified_us\":{},\"unscheduled_ideal_"
      "us\":{},"
      "\"unscheduled_slices_us\":{},"
      "\"unassigned_us\":{},\"optimal\":{},\"first_us\":{},\"first_ms\":{:.3f},\"solve_s\":{:.4f},"
      "\"evaluations_per_s\":{:.0f}}}\n",
      m.platform, m.nodes, m.seed, m.ros2_ideal, m.ros2_slices, m.heft, m.xauto, m.emulated,
      m.bound, m.certified, m.unscheduled_ideal, m.unscheduled_slices, m.unassigned, m.optimal,
      m.first, m.first_ms, m.solve_s, m.evaluations_per_s);
}

}  // namespace xauto::bench
