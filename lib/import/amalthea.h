// SPDX-License-Identifier: Apache-2.0
// Models of Eclipse APP4MC (Amalthea), .amxmi. Elements and their meaning: the metamodel,
// plugins/org.eclipse.app4mc.amalthea.model/model/amalthea.xcore of the project; what was called otherwise before 1.0,
// files of 0.7.2 (the WATERS challenge of 2017). Whatever is not named here is passed over.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/imported.h"
#include "model/platform.h"

namespace xauto::import {

/// A value that varies, in ticks or picoseconds.
struct Deviation {
  double lowest = 0, usual = 0, highest = 0;
  bool bounded = true;  ///< else `highest` is three standard deviations from the mean
};

/// An item of an activity graph.
struct ActivityItem {
  enum class Kind : std::uint8_t { kTicks, kRunnable, kAccess, kTrigger, kWait, kSet, kSwitch };
  Kind kind = Kind::kTicks;
  std::string name;                                 ///< of the runnable, label or stimulus
  bool write = false;                               ///< of an access
  std::vector<std::string> events;                  ///< of kWait, kSet
  std::optional<Deviation> ticks;                   ///< where no other is said
  std::map<std::string, Deviation> ticks_on;        ///< by definition of a processing unit
  std::vector<std::vector<ActivityItem>> branches;  ///< of kSwitch, of which one is taken
};

struct AmaltheaTask {
  std::string name;
  std::vector<std::string> stimuli;
  std::vector<ActivityItem> items;
  std::vector<std::string> on;  ///< processing units that it is allocated to
};

struct AmaltheaStimulus {
  enum class Kind : std::uint8_t {
    kPeriodic,      ///< `least_ps` apart
    kSporadic,      ///< from `least_ps` to `most_ps` apart
    kInterProcess,  ///< triggered by a task
    kEvent,         ///< triggered by `events`
    kOther,
  };
  Kind kind = Kind::kOther;
  std::string name, type;  ///< "PeriodicStimulus"
  std::int64_t least_ps = 0, most_ps = 0, offset_ps = 0, jitter_ps = 0;
  std::vector<std::string> events;
};

/// A core, a GPU, an accelerator.
struct AmaltheaUnit {
  std::string name, definition;
  std::string type;         ///< of XPU: "cpu", "gpu", "dla", "accelerator"
  double ticks_per_us = 0;  ///< 0: the model does not say
};

struct AmaltheaEvent {
  std::string name, type, entity, runnable, process;
};

struct AmaltheaChain {
  std::string name;
  std::vector<std::string> events;  ///< in their order
};

struct AmaltheaLimit {
  std::string process, runnable, chain;  ///< one of them
  std::int64_t limit_ps = 0;
};

struct AmaltheaModel {
  std::vector<AmaltheaTask> tasks;
  std::map<std::string, std::vector<ActivityItem>> runnables;
  std::map<std::string, AmaltheaStimulus> stimuli;
  std::vector<AmaltheaUnit> units;
  std::map<std::string, AmaltheaEvent> events;
  std::vector<AmaltheaChain> chains;
  std::vector<AmaltheaLimit> limits;
  std::vector<std::string> notes;  ///< what was not understood, a line each
};

inline constexpr std::size_t kMaxAmaltheaFiles = 64, kMaxAmaltheaNotes = 20;
inline constexpr int kMaxCallDepth = 64;  ///< of runnables that call each other
inline constexpr std::size_t kMaxRunnablesCalled = 4'000'000;

/// Of one model, in one or more files. Errors: parse_xml(); no task.
[[nodiscard]] Result<AmaltheaModel> parse_amalthea(
    const std::vector<std::pair<std::string, std::string>>& names_and_texts);
/// A file, or all .amxmi files of a folder.
[[nodiscard]] Result<AmaltheaModel> read_amalthea(const std::string& path);
[[nodiscard]] bool is_amalthea(const std::string& path);  ///< by the names of the files

struct AmaltheaOptions {
  std::string name;             ///< of the app
  std::int64_t margin_pct = 0;  ///< WCET: the upper bound, and so much more
};

/// `lines`: for people, what was made of it and what was left out. Pure. Errors: no task that anything activates.
[[nodiscard]] Result<ImportedApp> amalthea_app(const AmaltheaModel& model,
                                               const AmaltheaOptions& options,
                                               std::vector<std::string>& lines);

/// Its processing units. What suspending costs is not in a model.
[[nodiscard]] Platform amalthea_platform(const AmaltheaModel& model, const std::string& name);

}  // namespace xauto::import
