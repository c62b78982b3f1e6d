// SPDX-License-Identifier: Apache-2.0
// What a run's trace tells: jobs with their phases, activations, releases. Between the event record
// (lib/trace) and everything that draws or explains (run_trace.h, html_report.h). Pure.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/platform.h"
#include "model/tables.h"
#include "trace/trace.h"

namespace xauto::story {

enum class PhaseKind : std::uint8_t {
  kWaiting,    ///< ready, not on the XPU yet
  kRunning,    ///< on the XPU
  kSwitching,  ///< being taken off, or put back
  kSuspended,  ///< preempted
};
[[nodiscard]] const char* to_string(PhaseKind kind);

struct Phase {
  PhaseKind kind = PhaseKind::kWaiting;
  std::int64_t begin_ns = 0, end_ns = 0;
  std::vector<int> by;  ///< waiting, suspended: XNodes that ran on the XPU meanwhile, in order
};

/// One XNode's work for one activation.
struct JobStory {
  int xnode = -1, module = -1, xpu = -1;
  std::uint64_t sequence = 0;
  std::vector<Phase> phases;         ///< one after the other, at least one
  std::int64_t held_us = 0;          ///< of its waiting, from the first on: its policy held it
  std::int64_t without_core_us = 0;  ///< of a job on a real core: the kernel ran others there
  bool failed = false;
  bool complete = false;  ///< its FINISH is in the trace
  int activation = -1;    ///< index into Story::activations; -1: its beginning is not in the trace
  [[nodiscard]] std::int64_t begin_ns() const { return phases.front().begin_ns; }
  [[nodiscard]] std::int64_t end_ns() const { return phases.back().end_ns; }
};

enum class Fate : std::uint8_t { kDone, kDropped, kUnknown };

/// What an activation was made of.
struct Take {
  int source = -1, module = -1;  ///< who published it; one of the two
  std::int64_t origin_ns = 0;    ///< when the sensor released it
  bool urgent = false;           ///< it came so
  int from = -1;  ///< index into Story::releases (source) or activations (module); -1: unknown
};

/// What an activation has read of a topic that its module samples.
struct SampleRead {
  int source = -1, module = -1;  ///< who published it; one of the two
  std::int64_t read_ns = 0;
  std::int64_t number = -1;  ///< of the release or the activation; -1: there was nothing to read
  int from = -1;             ///< as Take's
};

/// One pass through a module's chain.
struct Activation {
  int module = -1;
  std::uint64_t sequence = 0;
  std::int64_t begin_ns = 0, end_ns = 0;
  Fate fate = Fate::kUnknown;  ///< unknown: its end is not in the trace
  std::uint32_t reason = 0;    ///< XAUTO_DROP_*
  /// Its release's table has the module off, or it was skipped as was told: nothing was lost.
  [[nodiscard]] bool left_out() const;
  std::vector<Take> takes = {};
  std::vector<SampleRead> samples = {};
  /// The nominal release that keys and holds count from; 0: unknown.
  std::int64_t released_ns = 0;
  int urgent_source = -1;  ///< that marked the release it is made of urgent; -1: none did
  /// The oldest of what it took, from which its latency counts; 0: unknown.
  [[nodiscard]] std::int64_t origin_ns() const;
};

/// One release of a source.
struct Release {
  std::uint64_t sequence = 0;  ///< each source counts its own
  std::int64_t begin_ns = 0;
  int source = -1;
  bool urgent = false;  ///< its source marked it so
};

/// A module of the run; index = `module` of the events.
struct ModuleInfo {
  std::string name;
  bool sink = false;
};

/// What went wrong: a deadline miss, a job past its hang limit, one that held up a more urgent one.
struct Incident {
  std::int64_t at_ns = 0, took_us = 0;
  int module = -1, xnode = -1;  ///< xnode: of the job, if it is about one
  std::uint64_t sequence = 0;
  int waits = -1;  ///< the more urgent XNode
};

/// With tables: another scenario counts from a release on.
struct SwitchStory {
  std::int64_t at_ns = 0;
  std::uint64_t release = 0;
  int scenario = 0, table = 0;
  Why why = Why::kStart;
  int xnode = -1;  ///< whose job was the reason; -1: none was
};

struct Story {
  std::vector<JobStory> jobs;           ///< by begin
  std::vector<Activation> activations;  ///< by begin; a dropped one that never began has no length
  std::vector<Release> releases;        ///< by begin
  std::size_t num_modules = 0;
  std::int64_t begin_ns = 0, end_ns = 0;
  std::uint64_t lost = 0;         ///< events that are not there, or that make no sense
  std::uint64_t overwritten = 0;  ///< events from before `begin_ns`, where the trace begins to hold
  std::vector<Incident> incidents;
  std::vector<SwitchStory> switches;
};

/// The trace may have been cut short anywhere, its writer killed at any point: what does not fit
/// the app is counted as lost, never followed. Errors: there is no event to tell of.
[[nodiscard]] Result<Story> story_of(const AppSpec& app, const Platform& platform,
                                     const std::vector<ModuleInfo>& modules,
                                     const trace::Recording& trace);

/// The modules of a run that goes on: which of them are sinks.
[[nodiscard]] std::vector<ModuleInfo> modules_of(const AppSpec& app,
                                                 const std::vector<std::string>& names);

[[nodiscard]] const char* drop_reason(std::uint32_t reason);

}  // namespace xauto::story
