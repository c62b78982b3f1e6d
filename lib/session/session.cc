// SPDX-License-Identifier: Apache-2.0
// JSON between two processes of one build: both ends are ours, but the answer's writer is a user's
// program that may have died in the middle, so it is read as carefully as a file.
#include "session/session.h"

#include <array>
#include <cstdlib>
#include <stdexcept>

#include <nlohmann/json.hpp>
#include <unistd.h>

#include "base/memory_file.h"
#include "model/json.h"
#include "model/periodic.h"
#include "session/run_report.h"

namespace xauto::runtime {
namespace {

using nlohmann::json;
constexpr int kSessionVersion = 1;
constexpr std::array<const char*, 3> kSchedulingNames = {"xauto", "timeshare", "ros2"};

template <class Parse>
auto guarded(const char* what, Parse parse) -> decltype(parse()) {
  try {
    return parse();
  } catch (const std::exception& e) {
    return fail(ErrorCode::kInvalid, std::string("malformed ") + what + ": " + e.what(), {},
                "the app and the xauto tool must be of one build");
  }
}

json to_document(const Distribution& d) {
  json buckets = json::array();
  for (const auto& [bucket, count] : d.buckets()) buckets.push_back({bucket, count});
  return {
      {"values", d.exact()}, {"buckets", std::move(buckets)}, {"sum", d.sum()}, {"max", d.max()}};
}

/// Throws, as the library does, when it is none.
Distribution distribution_from(const json& j) {
  std::map<std::uint32_t, std::uint64_t> buckets;
  for (const json& pair : j.at("buckets"))
    buckets[pair.at(0).get<std::uint32_t>()] = pair.at(1).get<std::uint64_t>();
  Distribution d;
  if (!Distribution::restore(j.at("values").get<std::vector<std::int64_t>>(), buckets,
                             j.at("sum").get<std::int64_t>(), j.at("max").get<std::int64_t>(), d))
    throw std::runtime_error("impossible distribution");
  return d;
}

}  // namespace

const char* to_string(Scheduling scheduling) {
  return kSchedulingNames[static_cast<std::size_t>(scheduling)];
}

std::optional<Scheduling> scheduling_from(const std::string& name) {
  for (std::size_t i = 0; i < kSchedulingNames.size(); ++i)
    if (name == kSchedulingNames[i]) return static_cast<Scheduling>(i);
  return std::nullopt;
}

std::string to_json(const Session& s) {
  std::vector<int> presence;
  for (const Presence p : s.presence) presence.push_back(static_cast<int>(p));
  json j = {{"version", kSessionVersion},
            {"mode", static_cast<int>(s.mode)},
            {"platform", xauto::to_json(s.platform)},
            {"scheduling", to_string(s.scheduling)},
            {"cpu_sched", static_cast<int>(s.cpu_sched)},
            {"cpu_run", s.cpu_run},
            {"cpu_first_xnode", s.cpu_first_xnode},
            {"cpu_scheduler_pid", s.cpu_scheduler_pid},
            {"cpu_partial", s.cpu_partial},
            {"cpu_by_keys", s.cpu_by_keys},
            {"presence", presence},
            {"emulator_modules", s.emulator_modules},
            {"coordinators", s.coordinators},
            {"activations", s.activations},
            {"duration_us", s.duration_us},
            {"lockstep", s.lockstep},
            {"period_us", s.period_us},
            {"input", s.input},
            {"record", s.record},
            {"warmup", s.warmup},
            {"repetitions", s.repetitions},
            {"margin_pct", s.margin_pct},
            {"exec_limit_s", s.exec_limit_s},
            {"stable_rounds", s.stable_rounds},
            {"answer_fd", s.answer_fd},
            {"trace_fd", s.trace_fd},
            {"board_fd", s.board_fd},
            {"trace_keep_s", s.trace_keep_s},
            {"processes", s.processes},
            {"hub", s.hub},
            {"hub_fd", s.hub_fd}};
  if (s.mode != Mode::kRun && !s.deployment.app.empty())
    j["deployment"] = xauto::to_json(s.deployment);
  // The formats of lib/model travel as the texts that their own readers check.
  if (s.mode == Mode::kRun) {
    j["app"] = xauto::to_json(s.app);
    Deployment deployment = s.deployment;
    deployment.app = s.app.name;
    j["deployment"] = xauto::to_json(deployment);
    j["by_keys"] = s.keys.has_value();
    if (s.scheduling != Scheduling::kRos2)
      j["policy"] = s.keys ? xauto::to_json(*s.keys, s.app, s.platform)
                           : xauto::to_json(s.policy, s.app, s.platform);
  }
  return j.dump();
}

Result<Session> parse_session(const std::string& text) {
  return guarded("session", [&]() -> Result<Session> {
    const json j = json::parse(text);
    if (j.at("version").get<int>() != kSessionVersion)
      return fail(ErrorCode::kInvalid, "session of another version", {},
                  "the app and the xauto tool must be of one build");
    Session s;
    const int mode = j.at("mode").get<int>();
    if (mode < 0 || mode > 2) return fail(ErrorCode::kInvalid, "unknown session mode");
    s.mode = static_cast<Mode>(mode);
    XAUTO_ASSIGN(s.platform, parse_platform(j.at("platform").get<std::string>(), "session"));
    const auto scheduling = scheduling_from(j.at("scheduling").get<std::string>());
    if (!scheduling) return fail(ErrorCode::kInvalid, "unknown scheduling");
    s.scheduling = *scheduling;
    const int cpu_sched = j.at("cpu_sched").get<int>();
    if (cpu_sched < 0 || cpu_sched > 2) return fail(ErrorCode::kInvalid, "unknown cpu_sched");
    s.cpu_sched = static_cast<CpuSched>(cpu_sched);
    s.cpu_run = j.at("cpu_run").get<std::string>();
    s.cpu_first_xnode = j.at("cpu_first_xnode").get<std::uint32_t>();
    s.cpu_scheduler_pid = j.at("cpu_scheduler_pid").get<int>();
    s.cpu_partial = j.at("cpu_partial").get<bool>();
    s.cpu_by_keys = j.at("cpu_by_keys").get<bool>();
    for (const int p : j.at("presence").get<std::vector<int>>()) {
      if (p < 0 || p > static_cast<int>(Presence::kAbsent))
        return fail(ErrorCode::kInvalid, "unknown presence");
      s.presence.push_back(static_cast<Presence>(p));
    }
    if (!s.presence.empty() && s.presence.size() != s.platform.xpus.size())
      return fail(ErrorCode::kInvalid, "the session does not say of each XPU whether it is real");
    s.emulator_modules = j.at("emulator_modules").get<bool>();
    s.coordinators = j.at("coordinators").get<std::map<std::string, std::string>>();
    s.activations = j.at("activations").get<std::uint64_t>();
    s.duration_us = j.at("duration_us").get<std::int64_t>();
    s.lockstep = j.at("lockstep").get<bool>();
    s.period_us = j.at("period_us").get<std::int64_t>();
    s.input = j.at("input").get<std::string>();
    s.record = j.at("record").get<std::string>();
    s.warmup = j.at("warmup").get<std::uint64_t>();
    s.repetitions = j.at("repetitions").get<std::uint64_t>();
    s.margin_pct = j.at("margin_pct").get<std::int64_t>();
    s.exec_limit_s = j.at("exec_limit_s").get<std::int64_t>();
    s.stable_rounds = j.at("stable_rounds").get<std::uint64_t>();
    s.answer_fd = j.at("answer_fd").get<int>();
    s.trace_fd = j.at("trace_fd").get<int>();
    s.board_fd = j.at("board_fd").get<int>();
    s.trace_keep_s = j.at("trace_keep_s").get<double>();
    s.processes = j.at("processes").get<std::vector<std::vector<std::string>>>();
    s.hub = j.at("hub").get<std::string>();
    s.hub_fd = j.at("hub_fd").get<int>();
    if (s.mode != Mode::kRun && j.contains("deployment")) {
      XAUTO_ASSIGN(s.deployment,
                   parse_deployment(j.at("deployment").get<std::string>(), "session"));
    }
    if (s.mode == Mode::kRun) {
      XAUTO_ASSIGN(s.app, parse_app(j.at("app").get<std::string>(), "session"));
      XAUTO_ASSIGN(s.deployment,
                   parse_deployment(j.at("deployment").get<std::string>(), "session", s.app));
      if (s.scheduling != Scheduling::kRos2) {
        const auto said = j.at("policy").get<std::string>();
        if (j.at("by_keys").get<bool>()) {
          XAUTO_ASSIGN(s.keys, parse_key_policy(said, "session", s.app, s.platform));
          s.policy = assignment_of(*s.keys);
        } else {
          const AppSpec app = s.app.version == 2 ? as_version_1(s.app) : s.app;
          XAUTO_ASSIGN(s.policy, parse_policy(said, "session", app, s.platform));
        }
      }
    }
    return s;
  });
}

Result<std::optional<Session>> inherited_session() {
  const char* variable = std::getenv(kSessionVariable);
  if (variable == nullptr) return std::optional<Session>();
  char* end = nullptr;
  const long fd = std::strtol(variable, &end, 10);
  if (end == variable || *end != '\0' || fd < 3 || fd > 1'000'000)
    return fail(ErrorCode::kInvalid,
                std::string(kSessionVariable) + "='" + variable + "' is not a descriptor", {},
                "start the app with `xauto run` rather than by hand");
  XAUTO_ASSIGN(const std::string text, read_memory_file(static_cast<int>(fd)));
  XAUTO_ASSIGN(Session session, parse_session(text));
  if (const char* process = std::getenv(kProcessVariable); process != nullptr) {
    const long index = std::strtol(process, &end, 10);
    if (end == process || *end != '\0' || index < 0 ||
        index > static_cast<long>(session.processes.size()))
      return fail(ErrorCode::kInvalid, std::string(kProcessVariable) + "='" + process +
                                           "' is not a process of this app");
    session.process = static_cast<int>(index);
  }
  return std::optional<Session>(std::move(session));
}

std::string to_json(const RunReport& r) {
  json releases = json::array();
  for (const Release& x : r.releases) releases.push_back({x.sequence, x.origin_ns, x.latency_us});
  json modules = json::array();
  for (const ModuleReport& m : r.modules)
    modules.push_back({{"name", m.name},
                       {"sink", m.sink},
                       {"activations", m.activations},
                       {"failed", m.failed},
                       {"dropped", m.dropped},
                       {"latencies_us", to_document(m.latencies_us)}});
  json xnodes = json::array();
  for (const XNodeReport& x : r.xnodes)
    xnodes.push_back({{"name", x.name},
                      {"budget_us", x.budget_us},
                      {"hang_us", x.hang_us},
                      {"jobs", x.jobs},
                      {"overruns", x.overruns},
                      {"hangs", x.hangs},
                      {"longest_us", x.longest_us}});
  json routes = json::array();
  for (const RouteReport& x : r.routes) {
    routes.push_back({{"name", x.name},
                      {"from", x.from},
                      {"to", x.to},
                      {"deadline_misses", x.deadline_misses},
                      {"lost", x.lost},
                      {"age_misses", x.age_misses},
                      {"latency_us", to_document(x.latency_us)},
                      {"age_us", to_document(x.age_us)}});
    if (x.deadline_us) routes.back()["deadline_us"] = *x.deadline_us;
    if (x.max_age_us) routes.back()["max_age_us"] = *x.max_age_us;
    if (x.urgent_us.count() > 0) routes.back()["urgent_us"] = to_document(x.urgent_us);
  }
  const ContextReport& c = r.contexts;
  return json{{"complete", r.complete},
              {"note", r.note},
              {"releases", std::move(releases)},
              {"num_releases", r.num_releases},
              {"lost_releases", r.lost_releases},
              {"latencies_us", to_document(r.latencies_us)},
              {"modules", std::move(modules)},
              {"xnodes", std::move(xnodes)},
              {"routes", std::move(routes)},
              {"contexts", {c.partial, c.unclaimed, c.assumed, c.shared, c.gated, c.held_up}},
              {"lost_coordinators", r.lost_coordinators},
              {"died", r.died},
              {"deadline_misses", r.deadline_misses},
              {"overlapping_releases", r.overlapping_releases},
              {"unkept", r.unkept},
              {"broken", r.broken},
              {"several_rates", r.several_rates},
              {"recording_error", r.recording_error}}
      .dump();
}

Result<RunReport> parse_run_report(const std::string& text) {
  return guarded("answer of the app", [&]() -> Result<RunReport> {
    const json j = json::parse(text);
    if (const auto error = j.find("error"); error != j.end()) {
      const int code = error->at("code").get<int>();
      if (code < 0 || code > static_cast<int>(ErrorCode::kInternal))
        return fail(ErrorCode::kInvalid, "the app answered with an unknown error");
      return fail(static_cast<ErrorCode>(code), error->at("what").get<std::string>(),
                  error->at("where").get<std::string>(), error->at("hint").get<std::string>());
    }
    RunReport r;
    r.complete = j.at("complete").get<bool>();
    r.note = j.at("note").get<std::string>();
    for (const json& x : j.at("releases"))
      r.releases.push_back(
          {x.at(0).get<std::uint64_t>(), x.at(1).get<std::int64_t>(), x.at(2).get<std::int64_t>()});
    r.num_releases = j.at("num_releases").get<std::uint64_t>();
    r.lost_releases = j.at("lost_releases").get<std::uint64_t>();
    r.latencies_us = distribution_from(j.at("latencies_us"));
    for (const json& m : j.at("modules"))
      r.modules.push_back(
          {m.at("name").get<std::string>(), m.at("sink").get<bool>(),
           m.at("activations").get<std::uint64_t>(), m.at("failed").get<std::uint64_t>(),
           m.at("dropped").get<std::uint64_t>(), distribution_from(m.at("latencies_us"))});
    for (const json& x : j.at("xnodes"))
      r.xnodes.push_back({x.at("name").get<std::string>(), x.at("budget_us").get<std::int64_t>(),
                          x.at("hang_us").get<std::int64_t>(), x.at("jobs").get<std::uint64_t>(),
                          x.at("overruns").get<std::uint64_t>(), x.at("hangs").get<std::uint64_t>(),
                          x.at("longest_us").get<std::int64_t>()});
    for (const json& x : j.at("routes")) {
      RouteReport route;
      route.name = x.at("name").get<std::string>();
      route.from = x.at("from").get<std::string>();
      route.to = x.at("to").get<std::string>();
      if (const auto d = x.find("deadline_us"); d != x.end())
        route.deadline_us = d->get<std::int64_t>();
      if (const auto a = x.find("max_age_us"); a != x.end())
        route.max_age_us = a->get<std::int64_t>();
      route.deadline_misses = x.at("deadline_misses").get<std::uint64_t>();
      route.lost = x.at("lost").get<std::uint64_t>();
      route.age_misses = x.at("age_misses").get<std::uint64_t>();
      route.latency_us = distribution_from(x.at("latency_us"));
      route.age_us = distribution_from(x.at("age_us"));
      if (const auto u = x.find("urgent_us"); u != x.end()) route.urgent_us = distribution_from(*u);
      r.routes.push_back(std::move(route));
    }
    const auto contexts = j.at("contexts").get<std::array<std::uint32_t, 6>>();
    r.contexts = {contexts[0], contexts[1], contexts[2], contexts[3], contexts[4], contexts[5]};
    r.lost_coordinators = j.at("lost_coordinators").get<std::vector<std::string>>();
    r.died = j.at("died").get<std::vector<std::string>>();
    r.deadline_misses = j.at("deadline_misses").get<std::uint64_t>();
    r.overlapping_releases = j.at("overlapping_releases").get<std::uint64_t>();
    r.unkept = j.at("unkept").get<std::vector<std::string>>();
    r.broken = j.at("broken").get<std::vector<std::string>>();
    r.several_rates = j.at("several_rates").get<bool>();
    r.recording_error = j.at("recording_error").get<std::string>();
    return r;
  });
}

std::string error_to_json(const Error& error) {
  return json{{"error",
               {{"code", static_cast<int>(error.code)},
                {"what", error.what},
                {"where", error.where},
                {"hint", error.hint}}}}
      .dump(-1, ' ', false, json::error_handler_t::replace);
}

}  // namespace xauto::runtime
