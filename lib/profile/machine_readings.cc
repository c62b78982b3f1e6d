// SPDX-License-Identifier: Apache-2.0
#include "profile/machine_readings.h"

#include <algorithm>

#include "base/short_file.h"

namespace xauto::runtime {
namespace {

using Of = Reading::Of;

struct Pattern {
  Of of;
  const char* files;
};

/// devfreq and cpufreq are the kernel's. Memory and DLA clocks of a Jetson belong to its BPMP firmware
/// and show in debugfs, to root; the power mode is what nvpmodel has set last.
constexpr Pattern kPatterns[] = {
    {Of::kClock, "/sys/class/devfreq/*/cur_freq"},
    {Of::kGovernor, "/sys/class/devfreq/*/governor"},
    {Of::kClock, "/sys/devices/system/cpu/cpufreq/policy*/scaling_cur_freq"},
    {Of::kGovernor, "/sys/devices/system/cpu/cpufreq/policy*/scaling_governor"},
    {Of::kClock, "/sys/kernel/debug/bpmp/debug/clk/emc/rate"},
    {Of::kClock, "/sys/kernel/debug/clk/dla*_core/clk_rate"},
    {Of::kTemperature, "/sys/class/thermal/thermal_zone*/temp"},
    {Of::kPowerMode, "/var/lib/nvpmodel/status"},
};

/// May stand in a profile, and be compared with a condition's `equals`.
bool is_line(const std::string& text) {
  return !text.empty() && text.size() < kMaxShortFile &&
         std::all_of(text.begin(), text.end(), [](char c) { return c >= ' ' && c <= '~'; });
}

}  // namespace

MachineReadings::MachineReadings(const std::string& root) {
  for (const Pattern& pattern : kPatterns)
    for (const std::string& path : files_below(root, pattern.files)) {
      Reading reading{pattern.of, path.substr(root.size())};
      if (!is_line(reading.file) || files_.size() == kMaxReadings) continue;
      if (pattern.of == Of::kTemperature) {
        const auto zone = read_short_file(path.substr(0, path.rfind('/')) + "/type");
        if (zone && is_line(*zone)) reading.name = *zone;
      }
      files_.push_back({path, std::move(reading)});
    }
  std::sort(files_.begin(), files_.end(),
            [](const Watched& a, const Watched& b) { return a.reading.file < b.reading.file; });
}

void MachineReadings::look() {
  thread_.check();
  for (Watched& watched : files_) {
    Reading& r = watched.reading;
    const auto text = read_short_file(watched.path);
    if (!text || !is_line(*text)) continue;
    if (!r.is_number()) {
      watched.read = true;
      if (std::find(r.texts.begin(), r.texts.end(), *text) == r.texts.end() &&
          r.texts.size() < kMaxReadingTexts)
        r.texts.push_back(*text);
      continue;
    }
    const auto value = whole_number(*text);
    if (!value || *value < -kMaxReading || *value > kMaxReading) continue;
    if (!watched.read) r.first = r.min = r.max = *value;
    watched.read = true;
    r.min = std::min(r.min, *value);
    r.max = std::max(r.max, *value);
    r.last = *value;
  }
}

std::vector<Reading> MachineReadings::taken() const {
  thread_.check();
  std::vector<Reading> readings;
  for (const Watched& watched : files_)
    if (watched.read) readings.push_back(watched.reading);
  return readings;
}

}  // namespace xauto::runtime
