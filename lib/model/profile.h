// SPDX-License-Identifier: Apache-2.0
// Profile: what the profiler measured, per XNode and XPU instance. File: profile.json.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"

namespace xauto {

/// Fewer samples have no p99: it would be their maximum.
inline constexpr std::int64_t kP99Samples = 100;

/// What was measured above twice the median at first, and never again in so many further samples:
/// the WCET is taken from those at most that big. Only of `profile --stable`; docs/formats.md has
/// the rule.
struct Outlier {
  std::int64_t count = 0;        ///< of such samples
  std::int64_t max_us = 0;       ///< of the others
  std::int64_t later_count = 0;  ///< samples after the last of them, all at most max_us
  bool operator==(const Outlier&) const = default;
};

/// How busy another XPU was while an XNode ran, and in as long a time in which it did not: means per
/// repetition. Only of `profile --audit`.
struct OtherXpu {
  std::int64_t busy_us = 0, idle_us = 0;
  bool used = false;  ///< busier beside the XNode than without it; profile/audit.h has the rule
  bool operator==(const OtherXpu&) const = default;
};

/// Summary of `count` execution times of one XNode on one XPU instance, warm-up left out.
struct Samples {
  std::int64_t count = 0;
  std::int64_t min_us = 0, p50_us = 0, p99_us = 0, max_us = 0;  ///< of all, outliers among them
  bool emulated = false;                                        ///< a stand-in's, on the emulator
  std::int64_t max_at = 0;  ///< which sample was the longest, from 1 on; 0: not known
  std::optional<Outlier> outlier = {};
  std::map<std::string, OtherXpu, std::less<>> others = {};  ///< those whose busy time is known
  /// By how much the process's resident memory grew in `init`: what a device has is not in it. Not of a
  /// stand-in, nor beside a load.
  std::optional<std::int64_t> memory_kb = {};

  /// Longer than twice the median: worth a look before it becomes a plan.
  [[nodiscard]] bool spread() const { return max_us > 2 * p50_us; }
  bool operator==(const Samples&) const = default;
};

/// What `samples`, in the order in which they were taken, amount to. `settled_after` > 0: those
/// above twice the median are outliers once so many have come after the last of them.
[[nodiscard]] Samples summarise(const std::vector<std::int64_t>& samples,
                                std::int64_t settled_after = 0);

using SamplesByXpu = std::map<std::string, Samples, std::less<>>;  ///< by XPU instance id

/// Of another implementation of an XNode; see XNodeProfile.
struct VariantProfile {
  std::string name;
  std::int64_t quality_pct = 100;  ///< as VariantSpec::quality_pct
  SamplesByXpu on = {};
  std::map<std::string, SamplesByXpu, std::less<>> beside = {};
  bool operator==(const VariantProfile&) const = default;
};

struct XNodeProfile {
  std::string name;
  std::string module;
  SamplesByXpu on;                        ///< alone
  std::vector<int> sources = {};          ///< as XNodeSpec::sources
  std::vector<std::string> missing = {};  ///< XPU instances where it was to be measured and was not
  /// Co-run class (the XPU type that a generator loads meanwhile, or kEveryType) -> XPU instance id -> samples. Only
  /// of `profile --contended`; on an XPU with levels its own type's also of the XNode above a less urgent one.
  std::map<std::string, SamplesByXpu, std::less<>> beside = {};
  std::vector<VariantProfile> variants = {};
  bool operator==(const XNodeProfile&) const = default;
};

/// What one file of the machine said while the profiler measured. It is read before and after each
/// pass, and about once a second in between.
struct Reading {
  enum class Of : std::uint8_t { kClock, kTemperature, kPowerMode, kGovernor } of = Of::kClock;
  std::string file;       ///< absolute path, as Condition::file
  std::string name = {};  ///< of a thermal zone: what it measures
  /// Of clocks and temperatures, in the file's own unit.
  std::int64_t first = 0, min = 0, max = 0, last = 0;
  std::vector<std::string> texts = {};  ///< of the others: each once, in the order of their coming

  [[nodiscard]] bool is_number() const { return of == Of::kClock || of == Of::kTemperature; }
  /// By how much a clock may be read lower and be the same: rates that are measured are not exact.
  [[nodiscard]] static std::int64_t jitter(std::int64_t clock);
  [[nodiscard]] static bool same_clock(std::int64_t a, std::int64_t b);
  /// A clock, a mode or a governor that was not one and the same all the time.
  [[nodiscard]] bool changed() const;
  bool operator==(const Reading&) const = default;
};
[[nodiscard]] const char* to_string(Reading::Of of);
inline constexpr std::int64_t kMaxReading = 1'000'000'000'000'000;  ///< Hz, say; exact in JSON
inline constexpr std::size_t kMaxReadings = 256, kMaxReadingTexts = 16;

/// Under what conditions the times hold. A profile taken under others must not be trusted silently.
struct ProfileConditions {
  std::string machine;    ///< uname nodename / CPU model
  std::string platform;   ///< Platform::name
  bool emulated = false;  ///< some of the XPUs, at least; the samples say which
  std::string input;      ///< recorded input that was replayed
  std::int64_t warmup = 0;
  std::int64_t repetitions = 0;
  std::string governor;                ///< cpufreq governor, empty if unknown
  std::vector<Reading> readings = {};  ///< by file
  /// Co-run class -> what loaded its XPUs; and of classes that were not measured, why not.
  std::map<std::string, std::string, std::less<>> beside = {}, not_beside = {};
  bool operator==(const ProfileConditions&) const = default;
};

/// How often at least the profiler looks how late a thread wakes that releases sensors: SourceSpec::jitter_us is twice
/// the most.
inline constexpr int kJitterWakeUps = 200;

struct Profile {
  std::string app;
  ProfileConditions conditions;
  std::int64_t margin_pct = 20;  ///< WCET = max * (1 + margin)
  std::vector<XNodeProfile> xnodes;
  std::vector<std::pair<int, int>> edges;              ///< as AppSpec::edges
  std::vector<std::pair<int, int>> sampled = {};       ///< as AppSpec::samples
  std::map<std::string, std::int64_t> in_flight = {};  ///< by module; of others it is 1
  std::vector<std::string> optional = {};              ///< modules; see ModuleSpec::optional
  std::vector<SourceSpec> sources = {};                ///< as AppSpec::sources
  ProgramAsks asks = {};
  std::string incomplete = {};  ///< why it ended early; empty: it did not
  bool operator==(const Profile&) const = default;
};

[[nodiscard]] Status validate(const Profile& profile);
/// Whether any policy is possible for such a graph, whatever its times: what meets has one rate and one clock, and what
/// a deadline is asked of has a way. Errors: kInvalid, in the words of a program.
[[nodiscard]] Status can_be_planned(const Profile& profile);

/// Which statistic of the samples becomes the WCET of app.json.
enum class WcetFrom { kMaxPlusMargin, kP99, kP50 };
/// What is the WCET of these samples: see WcetFrom. The maximum is that without outliers.
[[nodiscard]] std::int64_t statistic(const Samples& s, WcetFrom from, std::int64_t margin_pct);
/// The app.json that follows: per XPU type the worst statistic of all instances, and the longest median; per co-run class
/// what it is beside that (XNodeSpec::beside). Of variants the worst of all classes. `platform` gives each instance its
/// type. A p99 needs kP99Samples.
[[nodiscard]] Result<AppSpec> to_app(const Profile& profile, const Platform& platform,
                                     WcetFrom from);

}  // namespace xauto
