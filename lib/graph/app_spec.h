// SPDX-License-Identifier: Apache-2.0
// What an App has been told, before it is checked. The headers of include/xauto/ fill it in by the
// functions that they declare in detail:: and that app_spec.cc has; they do not know these types.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <xauto/source.h>
#include <xauto/xmodule.h>

#include "base/pi_mutex.h"
#include "base/thread_safety.h"
#include "graph/inlet.h"
#include "model/app.h"
#include "model/message.h"
#include "model/period.h"

namespace xauto::detail {

struct ImplSpec {
  XPU xpu{"cpu"};
  Init init;
  Exec exec;
  std::string variant = {};  ///< "": the XNode's own
  int quality_pct = 100;     ///< of the XNode's own
  bool init_sees_state = false;
};

struct XNodeSpecErased {
  std::string name;
  std::vector<ImplSpec> impls;
  std::vector<ParameterHandle> parameters = {};
  std::vector<std::string> misuse;  ///< collected, reported when the App is checked
};

/// What one init has made.
struct Made {
  SchedHandle handle;
  std::shared_ptr<void> object = nullptr;  ///< null: the implementation owns nothing
};

struct OutputSpec {
  TopicSpec topic;
  Take take;
};

struct SampleSpec {
  TopicSpec topic;
  std::int64_t max_age_ns = 0;  ///< 0: any age
};

struct XModuleSpec {
  std::string name;
  std::function<std::shared_ptr<void>()> make_state;
  std::vector<std::shared_ptr<XNodeSpecErased>> nodes;
  std::vector<TopicSpec> inputs;
  std::vector<SampleSpec> samples;
  std::vector<OutputSpec> outputs;
  std::vector<ParameterHandle> parameters = {};  ///< without those that its XNodes declare
  int in_flight = 1;                             ///< activations that may be at once
  bool optional = false;                         ///< a table may have it off
  OnMiss on_miss;                                ///< may be empty
  UrgentIf urgent_if;                            ///< likewise
  /// XModule::every: its topic is the last of the inputs then known; nullopt: not called.
  std::optional<TopicSpec> timer;
  Period timer_period;
  std::vector<std::string> misuse;
};

struct SourceSpec {
  TopicSpec topic;
  Period period;  ///< not valid() where the program said one that cannot be
  Make make;      ///< empty: it is pushed
  std::shared_ptr<Inlet> inlet = nullptr;  ///< null: it is polled
  Judge urgent = nullptr;  ///< polled: whether a message's release is; empty: none is
};

/// App::deadline of one chain, App::clock of one source.
struct DeadlineSpec {
  TopicSpec from;
  std::optional<TopicSpec> to;  ///< nullopt: until `module` has ended
  std::shared_ptr<XModuleSpec> module = nullptr;
  std::int64_t limit_us = 0;
};
struct ClockOfSpec {
  TopicSpec source;
  ClockSpec clock;
};

struct ObserverSpec {
  TopicSpec topic;
  Observe callback;
};

/// What an app asks of its run while that goes on: App::request_mode, App::set_priority. Threads: any.
class Requests {
 public:
  /// As processes/mode.h's answer_request takes it, but for errors.
  using Ask = std::function<Status(const std::string& request)>;
  /// Null: no run goes on.
  void bind(Ask ask) {
    const Guard lock(mutex_);
    ask_ = std::move(ask);
  }
  /// `where`: who asks, for the error.
  [[nodiscard]] Status ask(const std::string& request, const char* where) {
    const Guard lock(mutex_);
    if (ask_) return ask_(request);
    return fail(ErrorCode::kUnavailable, "no run goes on", where);
  }

 private:
  PiMutex mutex_;
  Ask ask_ XAUTO_GUARDED_BY(mutex_);
};

struct AppSpecErased {
  std::string name;
  std::vector<std::shared_ptr<XModuleSpec>> modules;
  std::vector<SourceSpec> sources;
  std::vector<ObserverSpec> observers;
  std::vector<std::int64_t> deadlines_us = {};  ///< of every chain; more than one is a mistake
  std::vector<DeadlineSpec> deadlines = {};
  std::vector<ClockOfSpec> clocks = {};
  std::vector<std::function<void()>> on_start, on_stop, on_end;
  std::shared_ptr<Requests> requests = std::make_shared<Requests>();
};

/// Of a rate as the program says it; not valid() where it cannot be.
[[nodiscard]] Period period_of(Rate rate);
/// Behind XModule::every.
void fire_every(XModuleSpec& module, Period period);

/// What a module and its XNodes declare, each once, in the order of declaration.
[[nodiscard]] std::vector<ParameterHandle> parameters_of(const XModuleSpec& module);

/// Adds the sources that fire modules by the clock, and what topics carry of which a module said the name alone; once.
/// Before the app is looked at.
void complete(AppSpecErased& app);

/// Calls the app's own `callbacks` one after the other. Error: one threw.
[[nodiscard]] Status call(const std::vector<std::function<void()>>& callbacks, const char* which,
                          const std::string& app);

}  // namespace xauto::detail
