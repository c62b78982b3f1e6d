// SPDX-License-Identifier: Apache-2.0
#include "app/run_options.h"

#include <algorithm>

#include <xauto/result.h>

#include "model/json.h"
#include "model/json_value.h"
#include "session/changes.h"
#include "xpu/presence.h"

namespace xauto {
namespace {

/// JSON text instead of a file that has it.
bool is_text(const std::string& given) {
  const std::size_t first = given.find_first_not_of(" \t\r\n");
  return first != std::string::npos && given[first] == '{';
}

Error at(const char* setter, std::string what, std::string hint = {}) {
  return {ErrorCode::kInvalid, std::move(what), std::string("RunOptions::") + setter,
          std::move(hint)};
}

Status one_process(const Deployment& deployment, const AppSpec& app) {
  if (!deployment.processes(app).empty())
    return tl::unexpected<Error>(at("deployment",
                                    "it has modules in processes of their own, and App::run has "
                                    "but this one",
                                    "drop \"isolate\" and \"process\", or start the app with "
                                    "`xauto run`"));
  for (const XNodeSpec& xnode : app.xnodes)
    if (deployment.of(xnode.module).on_hang == OnHang::kRestart)
      return tl::unexpected<Error>(
          at("deployment", "on_hang of '" + xnode.module + "' would kill this process",
             "use \"log\" or \"drop\", or start the app with `xauto run`"));
  return {};
}

}  // namespace

/// Of `session` the app, the platform, what is emulated and the scheduling are known.
Status RunOptions::Data::take_policy(runtime::Session& session) const {
  const bool text = is_text(policy);
  const std::string where = text ? "RunOptions::policy" : policy;
  if (text ? says_tables(policy) : is_tables_file(policy)) {
    if (session.scheduling != runtime::Scheduling::kXAuto)
      return tl::unexpected<Error>(
          at("scheduling",
             "'" + scheduling + "' is of a run that nobody schedules, and tables are scheduled",
             "give RunOptions::policy a policy.json"));
    XAUTO_ASSIGN(Tables tables, text ? parse_tables(policy, where, session.app, session.platform)
                                     : load_tables(policy, session.app, session.platform));
    XAUTO_TRY(
        xpu::check_placements(session.app, session.platform, session.presence, tables, where));
    session.take_tables(std::move(tables));
    return {};
  }
  XAUTO_ASSIGN(Policy made, text ? parse_policy(policy, where, session.app, session.platform)
                                 : load_policy(policy, session.app, session.platform));
  session.take_policy(std::move(made));
  return xpu::check_placements(session.app, session.platform, session.presence, session.policy,
                               where);
}

Result<runtime::Session> RunOptions::Data::session() const {
  runtime::Session session;
  if (app.empty())
    return tl::unexpected<Error>(at("app", "is needed: app.json of `xauto profile`"));
  XAUTO_ASSIGN(session.app, is_text(app) ? parse_app(app, "RunOptions::app") : load_app(app));
  XAUTO_ASSIGN(session.platform, is_text(platform)
                                     ? parse_platform(platform, "RunOptions::platform")
                                     : load_platform(platform));
  XAUTO_TRY(validate_on(session.app, session.platform));
  xpu::EmulationFlags flags;
  flags.none = real;
  if (real && emulate) return tl::unexpected<Error>(at("real", "contradicts RunOptions::emulate"));
  if (emulate) flags.names = *emulate;
  flags.all = emulate && emulate->empty();
  const xpu::Hardware machine = xpu::Hardware::here();
  XAUTO_ASSIGN(session.presence, xpu::presence_of(session.platform, flags, &session.app, machine));
  const auto how = runtime::scheduling_from(scheduling);
  if (!how)
    return tl::unexpected<Error>(
        at("scheduling", "'" + scheduling + "' is not xauto, timeshare or ros2"));
  session.scheduling = *how;
  if (*how != runtime::Scheduling::kRos2) {
    if (policy.empty())
      return tl::unexpected<Error>(
          at("policy", "is needed unless the scheduling is ros2", "make one with `xauto solve`"));
    XAUTO_TRY(take_policy(session));
  }
  if (cpu_sched != "fifo" && cpu_sched != "other")
    return tl::unexpected<Error>(
        at("cpu_sched", "'" + cpu_sched + "' is not fifo or other",
           cpu_sched == "ext" ? "sched_ext is for apps that `xauto run` starts" : ""));
  session.cpu.sched = cpu_sched == "fifo" ? runtime::CpuSched::kFifo : runtime::CpuSched::kOther;
  session.deployment.app = session.app.name;
  if (!deployment.empty()) {
    XAUTO_ASSIGN(session.deployment,
                 is_text(deployment)
                     ? parse_deployment(deployment, "RunOptions::deployment", session.app)
                     : load_deployment(deployment, session.app));
    XAUTO_TRY(one_process(session.deployment, session.app));
  }
  if (!overload.empty()) {
    auto parsed = Overload::parse(overload);
    if (!parsed) return tl::unexpected<Error>(at("overload", parsed.error().what));
    session.deployment.defaults.overload = *parsed;
  }
  if (activations > runtime::kMaxActivations)
    return tl::unexpected<Error>(at("activations", std::to_string(activations) + " are too many"));
  constexpr std::chrono::hours kYear{24 * 365};
  if (duration.count() < 0 || duration > kYear)
    return tl::unexpected<Error>(at("duration", "possible are 0 to a year"));
  if (period.count() < 0 || period.count() > kMaxPeriodUs)
    return tl::unexpected<Error>(at("period", "possible are 0 to an hour"));
  session.releases.activations = activations;
  session.releases.duration_us = duration.count();
  session.releases.period_us = period.count();
  session.releases.lockstep = lockstep;
  session.releases.input = input;
  session.releases.record = record;
  return session;
}

RunOptions::RunOptions() : data_(std::make_unique<Data>()) {}
RunOptions::~RunOptions() = default;
RunOptions::RunOptions(const RunOptions& other) : data_(std::make_unique<Data>(*other.data_)) {}
RunOptions& RunOptions::operator=(const RunOptions& other) {
  *data_ = *other.data_;
  return *this;
}

#define XAUTO_SETTER(name, Type)             \
  RunOptions& RunOptions::name(Type value) { \
    data_->name = std::move(value);          \
    return *this;                            \
  }
XAUTO_SETTER(app, std::string)
XAUTO_SETTER(policy, std::string)
XAUTO_SETTER(platform, std::string)
XAUTO_SETTER(deployment, std::string)
XAUTO_SETTER(emulate, std::vector<std::string>)
XAUTO_SETTER(scheduling, std::string)
XAUTO_SETTER(cpu_sched, std::string)
XAUTO_SETTER(activations, std::uint64_t)
XAUTO_SETTER(duration, std::chrono::microseconds)
XAUTO_SETTER(period, std::chrono::microseconds)
XAUTO_SETTER(lockstep, bool)
XAUTO_SETTER(input, std::string)
XAUTO_SETTER(record, std::string)
XAUTO_SETTER(overload, std::string)
XAUTO_SETTER(programs, std::string)
#undef XAUTO_SETTER
RunOptions& RunOptions::real() {
  data_->real = true;
  return *this;
}

// ---- the report --------------------------------------------------------------------------------

namespace {

using std::chrono::microseconds;

const runtime::ModuleReport* find(const runtime::RunReport& report, const std::string& module) {
  const auto at = std::find_if(report.modules.begin(), report.modules.end(),
                               [&](const auto& m) { return m.name == module; });
  return at == report.modules.end() ? nullptr : &*at;
}

/// With several rates there are no releases: every sink's own latencies.
runtime::Distribution latencies_of(const runtime::RunReport& report) {
  runtime::Distribution all = report.latencies_us;
  if (report.several_rates)
    for (const runtime::ModuleReport& module : report.modules) all.merge(module.latencies_us);
  return all;
}

Json times(const runtime::Distribution& us) {
  return us.count() == 0 ? Json() : runtime::quantiles_json(us);
}

microseconds quantile(const runtime::RunReport& report, const std::string& module, double q) {
  const runtime::ModuleReport* found = find(report, module);
  return microseconds(found == nullptr ? 0 : found->latencies_us.quantile(q));
}

}  // namespace

RunReport::RunReport(std::shared_ptr<const Data> data) : data_(std::move(data)) {}
RunReport::RunReport(const RunReport&) = default;
RunReport& RunReport::operator=(const RunReport&) = default;
RunReport::~RunReport() = default;

bool RunReport::good() const {
  const runtime::RunReport& r = data_->report;
  return r.complete && r.lost_releases == 0 && r.lost_coordinators.empty() &&
         r.recording_error.empty() && !data_->emulator_died;
}
bool RunReport::complete() const {
  return data_->report.complete;
}
std::string RunReport::note() const {
  return data_->report.note;
}
std::uint64_t RunReport::releases() const {
  return data_->report.num_releases;
}
std::uint64_t RunReport::lost() const {
  return data_->report.lost_releases;
}
std::uint64_t RunReport::deadline_misses() const {
  return data_->report.deadline_misses;
}
microseconds RunReport::p50() const {
  return microseconds(latencies_of(data_->report).quantile(0.5));
}
microseconds RunReport::p99() const {
  return microseconds(latencies_of(data_->report).quantile(0.99));
}
microseconds RunReport::max() const {
  return microseconds(latencies_of(data_->report).max());
}
std::vector<std::string> RunReport::modules() const {
  std::vector<std::string> names;
  for (const runtime::ModuleReport& module : data_->report.modules) names.push_back(module.name);
  return names;
}
std::uint64_t RunReport::results(const std::string& module) const {
  const runtime::ModuleReport* found = find(data_->report, module);
  return found == nullptr ? 0 : found->activations;
}
std::uint64_t RunReport::lost(const std::string& module) const {
  const runtime::ModuleReport* found = find(data_->report, module);
  return found == nullptr ? 0 : found->failed + found->dropped;
}
microseconds RunReport::p50(const std::string& module) const {
  return quantile(data_->report, module, 0.5);
}
microseconds RunReport::p99(const std::string& module) const {
  return quantile(data_->report, module, 0.99);
}
microseconds RunReport::max(const std::string& module) const {
  return quantile(data_->report, module, 1);
}

std::string RunReport::json() const {
  const runtime::RunReport& r = data_->report;
  Json modules = Json::array(), chains = Json::array();
  for (const runtime::ModuleReport& m : r.modules)
    modules.push_back({{"name", m.name},
                       {"activations", m.activations},
                       {"failed", m.failed},
                       {"dropped", m.dropped},
                       {"off", m.off},
                       {"unended", m.unended},
                       {"latency_us", times(m.latencies_us)}});
  for (const runtime::ChainAccount& c : r.account.chains) chains.push_back(runtime::chain_json(c));
  Json json = {{"app", data_->app},
               {"good", good()},
               {"complete", r.complete},
               {"note", r.note},
               {"releases", r.num_releases},
               {"lost", r.lost_releases},
               {"deadline_misses", r.deadline_misses},
               {"latency_us", times(latencies_of(r))},
               {"modules", std::move(modules)},
               {"chains", std::move(chains)},
               {"claims", runtime::claims_json(r.account)}};
  if (!r.scenarios.empty()) runtime::add_changes(r, json);
  return json.dump();
}

}  // namespace xauto
