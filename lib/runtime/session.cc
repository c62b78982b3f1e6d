// SPDX-License-Identifier: Apache-2.0
// JSON between two processes of one build: both ends are ours, but the answer's writer is a user's
// program that may have died in the middle, so it is read as carefully as a file.
#include "runtime/session.h"

#include <array>
#include <cstdlib>

#include <nlohmann/json.hpp>
#include <unistd.h>

#include "base/memory_file.h"
#include "model/json.h"

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
  json j = {{"version", kSessionVersion},
            {"mode", static_cast<int>(s.mode)},
            {"platform", xauto::to_json(s.platform)},
            {"scheduling", to_string(s.scheduling)},
            {"cpu_sched", static_cast<int>(s.cpu_sched)},
            {"cpu_run", s.cpu_run},
            {"cpu_scheduler_pid", s.cpu_scheduler_pid},
            {"cpu_partial", s.cpu_partial},
            {"emulated", s.emulated},
            {"emulator_modules", s.emulator_modules},
            {"coordinators", s.coordinators},
            {"activations", s.activations},
            {"lockstep", s.lockstep},
            {"period_us", s.period_us},
            {"input", s.input},
            {"record", s.record},
            {"warmup", s.warmup},
            {"repetitions", s.repetitions},
            {"margin_pct", s.margin_pct},
            {"answer_fd", s.answer_fd},
            {"trace_fd", s.trace_fd},
            {"trace_capacity", s.trace_capacity},
            {"overload", s.overload},
            {"processes", s.processes},
            {"hub", s.hub},
            {"hub_fd", s.hub_fd},
            {"queue_depth", s.queue_depth},
            {"keep", s.keep}};
  // The formats of lib/model travel as the texts that their own readers check.
  if (s.mode == Mode::kRun) {
    j["app"] = xauto::to_json(s.app);
    if (s.scheduling != Scheduling::kRos2)
      j["policy"] = xauto::to_json(s.policy, s.app, s.platform);
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
    s.cpu_scheduler_pid = j.at("cpu_scheduler_pid").get<int>();
    s.cpu_partial = j.at("cpu_partial").get<bool>();
    s.emulated = j.at("emulated").get<bool>();
    s.emulator_modules = j.at("emulator_modules").get<bool>();
    s.coordinators = j.at("coordinators").get<std::map<std::string, std::string>>();
    s.activations = j.at("activations").get<std::uint64_t>();
    s.lockstep = j.at("lockstep").get<bool>();
    s.period_us = j.at("period_us").get<std::int64_t>();
    s.input = j.at("input").get<std::string>();
    s.record = j.at("record").get<std::string>();
    s.warmup = j.at("warmup").get<std::uint64_t>();
    s.repetitions = j.at("repetitions").get<std::uint64_t>();
    s.margin_pct = j.at("margin_pct").get<std::int64_t>();
    s.answer_fd = j.at("answer_fd").get<int>();
    s.trace_fd = j.at("trace_fd").get<int>();
    s.trace_capacity = j.at("trace_capacity").get<std::uint64_t>();
    s.overload = j.at("overload").get<std::map<std::string, std::string>>();
    s.processes = j.at("processes").get<std::vector<std::vector<std::string>>>();
    s.hub = j.at("hub").get<std::string>();
    s.hub_fd = j.at("hub_fd").get<int>();
    s.queue_depth = j.at("queue_depth").get<std::uint32_t>();
    s.keep = j.at("keep").get<std::uint32_t>();
    if (s.mode == Mode::kRun) {
      XAUTO_ASSIGN(s.app, parse_app(j.at("app").get<std::string>(), "session"));
      if (s.scheduling != Scheduling::kRos2) {
        XAUTO_ASSIGN(s.policy,
                     parse_policy(j.at("policy").get<std::string>(), "session", s.app, s.platform));
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
                       {"latencies_us", m.latencies_us}});
  return json{{"complete", r.complete},
              {"note", r.note},
              {"releases", std::move(releases)},
              {"modules", std::move(modules)},
              {"lost_coordinators", r.lost_coordinators},
              {"died", r.died},
              {"deadline_misses", r.deadline_misses}}
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
    for (const json& m : j.at("modules"))
      r.modules.push_back({m.at("name").get<std::string>(), m.at("sink").get<bool>(),
                           m.at("activations").get<std::uint64_t>(),
                           m.at("failed").get<std::uint64_t>(),
                           m.at("dropped").get<std::uint64_t>(),
                           m.at("latencies_us").get<std::vector<std::int64_t>>()});
    r.lost_coordinators = j.at("lost_coordinators").get<std::vector<std::string>>();
    r.died = j.at("died").get<std::vector<std::string>>();
    r.deadline_misses = j.at("deadline_misses").get<std::uint64_t>();
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
