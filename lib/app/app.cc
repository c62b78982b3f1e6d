// SPDX-License-Identifier: Apache-2.0
// The public App.
#include <algorithm>
#include <atomic>
#include <thread>

#include <xauto/app.h>

#include "base/pi_mutex.h"
#include "base/thread.h"
#include "emu/client.h"
#include "graph/deployed.h"
#include "graph/graph.h"
#include "launch/keeper.h"
#include "model/json_value.h"
#include "session/notes.h"
#include "session/session.h"

#include "app/engine_run.h"
#include "app/program.h"
#include "app/run_options.h"

namespace xauto {

struct App::Data {
  detail::AppSpecErased spec;

  PiMutex mutex;
  enum class Run : std::uint8_t {
    kNone,
    kGoesOn,
    kStuck
  } state XAUTO_GUARDED_BY(mutex) = Run::kNone;
  std::atomic<bool> stop{false};  ///< the run that goes on

  Result<RunReport> run(const RunOptions& options, const std::shared_ptr<Data>& self);
};

App::App(std::string name) : data_(std::make_shared<Data>()) {
  data_->spec.name = std::move(name);
}
App::~App() = default;

// By value: programs that were built before call them so.
// NOLINTBEGIN(performance-unnecessary-value-param)
void App::add_module_spec(std::shared_ptr<detail::XModuleSpec> spec) {
  data_->spec.modules.push_back(std::move(spec));
}
void App::add_source_spec(detail::TopicHandle topic, std::chrono::microseconds period,
                          detail::Make make) {
  data_->spec.sources.push_back({*topic, {period.count()}, std::move(make)});
}
void App::set_source_rate(Rate rate) {
  data_->spec.sources.back().period = detail::period_of(rate);
}
void App::mark_source_spec(detail::Judge urgent) {
  data_->spec.sources.back().urgent = std::move(urgent);
}
void App::add_deadline(detail::TopicHandle from, detail::TopicHandle to,
                       std::shared_ptr<detail::XModuleSpec> module,
                       std::chrono::microseconds limit) {
  data_->spec.deadlines.push_back(
      {*from, to ? std::optional(*to) : std::nullopt, std::move(module), limit.count()});
}
void App::set_clock(detail::TopicHandle source, std::string name, int ppm) {
  data_->spec.clocks.push_back({*source, {std::move(name), ppm}});
}
std::shared_ptr<detail::Inlet> App::add_inlet(detail::TopicHandle topic,
                                              std::chrono::microseconds distance) {
  auto inlet = std::make_shared<detail::Inlet>(
      topic->name, std::min<std::int64_t>(distance.count(), kMaxPeriodUs) * 1000);
  data_->spec.sources.push_back({*topic, {distance.count()}, nullptr, inlet});
  return inlet;
}
void App::add_observer_spec(detail::TopicHandle topic, detail::Observe observe) {
  data_->spec.observers.push_back({*topic, std::move(observe)});
}
// NOLINTEND(performance-unnecessary-value-param)
App& App::deadline(std::chrono::microseconds limit) {
  data_->spec.deadlines_us.push_back(limit.count());
  return *this;
}
App& App::on_start(std::function<void()> callback) {
  data_->spec.on_start.push_back(std::move(callback));
  return *this;
}
App& App::on_stop(std::function<void()> callback) {
  data_->spec.on_stop.push_back(std::move(callback));
  return *this;
}
App& App::on_end(std::function<void()> callback) {
  data_->spec.on_end.push_back(std::move(callback));
  return *this;
}

Status App::request_mode(const std::string& name) {
  return data_->spec.requests->ask(Json{{"mode", name}}.dump(), "App::request_mode");
}

Status App::set_priority(const std::string& xnode, std::int64_t priority) {
  return data_->spec.requests->ask(Json{{"xnode", xnode}, {"priority", priority}}.dump(),
                                   "App::set_priority");
}

Status App::set_key(const std::string& xnode, std::chrono::microseconds key) {
  return data_->spec.requests->ask(Json{{"xnode", xnode}, {"key_us", key.count()}}.dump(),
                                   "App::set_key");
}

Status App::as_planned(const std::string& xnode) {
  return data_->spec.requests->ask(Json{{"xnode", xnode}}.dump(), "App::as_planned");
}

Status App::check() const {
  detail::complete(data_->spec);
  XAUTO_TRY(runtime::Graph::build(data_->spec));
  return {};
}

Result<RunReport> App::run(const RunOptions& options) {
  {
    const Guard lock(data_->mutex);
    const std::string where = "app '" + data_->spec.name + "'";
    if (data_->state == Data::Run::kGoesOn)
      return fail(ErrorCode::kUnavailable, "it runs already", where, "two runs need two Apps");
    if (data_->state == Data::Run::kStuck)
      return fail(ErrorCode::kUnavailable, "an exec of its last run never returned", where,
                  "only the end of this process ends its thread");
    data_->state = Data::Run::kGoesOn;
    data_->stop = false;
  }
  Result<RunReport> report = data_->run(options, data_);
  const Guard lock(data_->mutex);
  if (data_->state == Data::Run::kGoesOn) data_->state = Data::Run::kNone;
  return report;
}

void App::stop() {
  data_->stop = true;  // a run that begins later begins with false
}

int App::main(int, char** argv) {
  detail::complete(data_->spec);
  return app::program(data_->spec, argv);
}

Result<RunReport> App::Data::run(const RunOptions& options, const std::shared_ptr<Data>& self) {
  detail::complete(spec);
  XAUTO_ASSIGN(runtime::Session session, options.data_->session());
  const bool renamed = detail::renames(session.deployment);
  detail::AppSpecErased deployed;
  if (renamed) {
    XAUTO_ASSIGN(deployed, detail::deployed(spec, session.deployment));
  }
  XAUTO_TRY(runtime::Graph::build(renamed ? deployed : spec));
  XAUTO_ASSIGN(const std::string programs, launch::find_programs(options.data_->programs));
  bool emulator_died = false;
  XAUTO_ASSIGN(const auto keeper, launch::Keeper::start(session, programs, [&] {
                 emulator_died = true;
                 stop = true;
               }));
  // What contexts find, of this run's threads: other runs of this process have other emulators.
  auto site = std::make_shared<emu::Site>();
  site->address = keeper->emulator();
  for (std::size_t x = 0; x < session.platform.xpus.size(); ++x)
    if (session.presence_of(static_cast<int>(x)) == Presence::kReal)
      site->real.insert(session.platform.xpus[x].id);
  site->cpu_pool = session.scheduling == runtime::Scheduling::kRos2;

  struct Held {
    std::shared_ptr<Data> app;
    runtime::Session session;
    detail::AppSpecErased deployed;
  };
  const auto held = std::make_shared<Held>(Held{self, std::move(session), std::move(deployed)});
  // On a thread of its own, whose name, emulator and priority are nobody else's.
  app::Ran ran;
  XAUTO_ASSIGN(std::thread runs, start_thread([&] {
                 emu::set_this_threads_site(site);
                 ran = app::run_engine(renamed ? held->deployed : spec, held->session, stop, held);
               }));
  runs.join();
  if (ran.stuck) {
    const Guard lock(mutex);
    state = Run::kStuck;
  }
  std::string died;
  for (const std::string& note : keeper->stop()) runtime::add_note(died, note);
  if (!ran.report) {
    Error error = std::move(ran.report).error();
    if (!died.empty()) error.what += "; " + died;
    return tl::unexpected<Error>(std::move(error));
  }
  auto data = std::make_shared<RunReport::Data>();
  data->report = *std::move(ran.report);
  const std::vector<std::string> daemons = keeper->who_died();
  data->report.account.add("daemon_death", daemons.size(), daemons);
  data->app = spec.name;
  data->emulator_died = emulator_died;
  if (!died.empty()) runtime::add_note(data->report.note, died);
  return RunReport(std::move(data));
}

}  // namespace xauto
