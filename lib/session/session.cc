// SPDX-License-Identifier: Apache-2.0
// JSON between two processes of one build: both ends are ours, but the answer's writer is a user's
// program that may have died in the middle, so it is read as carefully as a file.
#include "session/session.h"

#include <array>
#include <concepts>
#include <cstdlib>
#include <type_traits>

#include <unistd.h>

#include "base/memory_file.h"
#include "model/json.h"
#include "model/json_value.h"
#include "session/run_report.h"

namespace xauto::runtime {
namespace {

constexpr int kSessionVersion = 1;
constexpr std::array<const char*, 3> kSchedulingNames = {"xauto", "timeshare", "ros2"};
constexpr const char* kOneBuild = "the app and the xauto tool must be of one build";

// What travels has each field in one list, for both ways.
template <class T, class S>
concept Is = std::same_as<std::remove_const_t<T>, S>;

template <class Io, Is<ReleaseRecord> T>
void fields(Io io, T& x) {
  io("sequence", x.sequence, "origin_ns", x.origin_ns, "latency_us", x.latency_us);
}

template <class Io, Is<ModuleReport> T>
void fields(Io io, T& x) {
  io("name", x.name, "sink", x.sink, "activations", x.activations, "failed", x.failed, "dropped",
     x.dropped, "off", x.off, "skipped", x.skipped, "latencies_us", x.latencies_us, "unended",
     x.unended);
}

template <class Io, Is<XNodeReport> T>
void fields(Io io, T& x) {
  io("name", x.name, "budget_us", x.budget_us, "wcet_us", x.wcet_us, "hang_us", x.hang_us, "jobs",
     x.jobs, "overruns", x.overruns, "over_wcet", x.over_wcet, "hangs", x.hangs, "longest_us",
     x.longest_us, "over_us", x.over_us, "module", x.module, "unended", x.unended, "unended_us",
     x.unended_us);
}

template <class Io, Is<Assumption> T>
void fields(Io io, T& x) {
  io("kind", x.kind, "count", x.count, "words", x.words);
}

template <class Io, Is<TakenReport> T>
void fields(Io io, T& x) {
  io("what", x.what, "us", x.us);
}

template <class Io, Is<ChainAccount> T>
void fields(Io io, T& x) {
  io("name", x.name, "from", x.from, "to", x.to, "deadline_us", x.deadline_us, "max_age_us",
     x.max_age_us, "worst_case_us", x.worst_case_us, "lower_bound_us", x.lower_bound_us,
     "urgent_worst_case_us", x.urgent_worst_case_us, "latency_us", x.latency_us, "age_us", x.age_us,
     "urgent_us", x.urgent_us, "longest_us", x.longest_us, "longest_urgent_us", x.longest_urgent_us,
     "deadline_misses", x.deadline_misses, "age_misses", x.age_misses, "lost", x.lost,
     "not_measured", x.not_measured, "over_claim", x.over_claim, "over_us", x.over_us,
     "over_claimed_us", x.over_claimed_us, "urgent_exceeded", x.urgent_exceeded);
}

/// What only a run that goes on has does not travel.
template <class Io, Is<Account> T>
void fields(Io io, T& x) {
  io("scope", x.scope, "why_nothing", x.why_nothing, "chains", x.chains, "assumptions",
     x.assumptions, "taken", x.taken, "not_watched", x.not_watched);
}

template <class Io, Is<EarlyStartReport> T>
void fields(Io io, T& x) {
  io("on", x.on, "jobs", x.jobs, "sum_us", x.sum_us);
}

template <class Io, Is<PreemptionReport> T>
void fields(Io io, T& x) {
  io("xpu", x.xpu, "suspensions", x.suspensions, "suspend_us", x.suspend_us, "resume_us",
     x.resume_us, "preempt_us", x.preempt_us);
}

template <class Io, Is<ScenarioReport> T>
void fields(Io io, T& x) {
  io("name", x.name, "table", x.table, "releases", x.releases);
}

template <class Io, Is<SwitchReport> T>
void fields(Io io, T& x) {
  io("release", x.release, "from", x.from, "to", x.to, "table", x.table, "why", x.why, "detail",
     x.detail, "held_us", x.held_us, "spanned_us", x.spanned_us, "worst_case_us", x.worst_case_us,
     "chain", x.chain);
}

template <class Io, Is<CrossingReport> T>
void fields(Io io, T& x) {
  io("xnode", x.xnode, "from", x.from, "to", x.to, "x_us", x.x_us, "messages", x.messages,
     "longest_us", x.longest_us, "lost", x.lost, "late", x.late, "latest_us", x.latest_us, "twice",
     x.twice, "refused", x.refused, "other_runs", x.other_runs);
}

template <class Io, Is<RunReport> T>
void fields(Io io, T& x) {
  io("crossings", x.crossings, "complete", x.complete, "note", x.note, "releases", x.releases,
     "num_releases", x.num_releases, "lost_releases", x.lost_releases, "latencies_us",
     x.latencies_us, "modules", x.modules, "xnodes", x.xnodes, "account", x.account, "early_starts",
     x.early_starts, "preemptions", x.preemptions, "lost_coordinators", x.lost_coordinators, "died",
     x.died, "deadline_misses", x.deadline_misses, "scenarios", x.scenarios, "switches", x.switches,
     "num_switches", x.num_switches, "several_rates", x.several_rates, "recording_error",
     x.recording_error);
}

template <class Io, Is<Error> T>
void fields(Io io, T& x) {
  io("code", x.code, "what", x.what, "where", x.where, "hint", x.hint);
}

template <class Io, Is<ProfileRequest> T>
void fields(Io io, T& x) {
  io("warmup", x.warmup, "repetitions", x.repetitions, "margin_pct", x.margin_pct, "exec_limit_s",
     x.exec_limit_s, "stable_rounds", x.stable_rounds, "contended", x.contended, "audit", x.audit,
     "machine_root", x.machine_root);
}

template <class Io, Is<LoadRequest> T>
void fields(Io io, T& x) {
  io("xpu", x.xpu, "fd", x.fd, "cores", x.cores);
}

template <class Io, Is<ReleaseRequest> T>
void fields(Io io, T& x) {
  io("activations", x.activations, "duration_us", x.duration_us, "lockstep", x.lockstep, "phases",
     x.phases, "seed", x.seed, "period_us", x.period_us, "input", x.input, "input_rate",
     x.input_rate, "input_max_gap_us", x.input_max_gap_us, "record", x.record, "record_outputs",
     x.record_outputs);
}

template <class Io, Is<CpuPlan> T>
void fields(Io io, T& x) {
  io("sched", x.sched, "run", x.run, "first_xnode", x.first_xnode, "scheduler_pid", x.scheduler_pid,
     "partial", x.partial, "by_keys", x.by_keys, "regulated", x.regulated, "policy", x.policy);
}

/// All but `process`.
template <class Io, Is<ProcessPlan> T>
void fields(Io io, T& x) {
  io("modules", x.modules, "hub", x.hub, "hub_fd", x.hub_fd);
}

template <class Io, Is<HostPart> T>
void fields(Io io, T& x) {
  io("name", x.name, "run", x.run);
}

/// All but the formats of lib/model, which travel as the texts that their own readers check.
template <class Io, Is<Session> T>
void fields(Io io, T& x) {
  io("mode", x.mode, "scheduling", x.scheduling, "cpu", x.cpu, "presence", x.presence,
     "emulator_modules", x.emulator_modules, "coordinators", x.coordinators, "own_sockets",
     x.own_sockets, "releases", x.releases, "profile", x.profile, "load", x.load, "parts", x.parts,
     "host", x.host, "answer_fd", x.answer_fd, "trace_fd", x.trace_fd, "board_fd", x.board_fd,
     "trace_keep_s", x.trace_keep_s);
}

constexpr Mode last(Mode) {
  return Mode::kLoad;
}
constexpr Scheduling last(Scheduling) {
  return Scheduling::kRos2;
}
constexpr CpuSched last(CpuSched) {
  return CpuSched::kExt;
}
constexpr Presence last(Presence) {
  return Presence::kAbsent;
}
constexpr ErrorCode last(ErrorCode) {
  return ErrorCode::kInternal;
}

struct Nothing {
  void operator()(const auto&...) {}
};
template <class T>
concept HasFields = requires(T& x) {
  fields(Nothing{}, x);
};

using Names = std::map<std::string, std::string>;
Json encode(const Distribution& x);
Json encode(const Names& x);
template <class T>
Json encode(const std::vector<T>& x);
template <class T>
Json encode(const T& x);
bool decode(const Json& j, Distribution& x);
bool decode(const Json& j, Names& x);
template <class T>
bool decode(const Json& j, std::vector<T>& x);
template <class T>
bool decode(const Json& j, T& x);

struct Writer {
  Json& json;
  void operator()() {}
  template <class T, class... More>
  void operator()(const char* name, const T& x, const More&... more) {
    one(name, x);
    (*this)(more...);
  }

 private:
  template <class T>
  void one(const char* name, const T& x) {
    json[name] = encode(x);
  }
  template <class T>
  void one(const char* name, const std::optional<T>& x) {
    if (x) json[name] = encode(*x);
  }
};
struct Reader {
  const Json& json;
  const char*& bad;  ///< the first field that is not what it should be
  void operator()() {}
  template <class T, class... More>
  void operator()(const char* name, T& x, More&... more) {
    one(name, x);
    (*this)(more...);
  }

 private:
  template <class T>
  void one(const char* name, T& x) {
    const Json* found = json.find(name);
    if ((found == nullptr || !decode(*found, x)) && bad == nullptr) bad = name;
  }
  template <class T>
  void one(const char* name, std::optional<T>& x) {
    if (json.has(name)) one(name, x.emplace());
  }
};

Json encode(const Distribution& x) {
  std::vector<std::uint32_t> buckets;
  std::vector<std::uint64_t> counts;
  if (x.exact().empty())
    for (const auto& [bucket, count] : x.buckets()) {
      buckets.push_back(bucket);
      counts.push_back(count);
    }
  return {{"values", x.exact()},
          {"buckets", buckets},
          {"counts", counts},
          {"sum", x.sum()},
          {"max", x.max()}};
}
bool decode(const Json& j, Distribution& x) {
  std::vector<std::int64_t> values;
  std::vector<std::uint32_t> buckets;
  std::vector<std::uint64_t> counts;
  std::int64_t sum = 0, max = 0;
  if (!decode(j.at("values"), values) || !decode(j.at("buckets"), buckets) ||
      !decode(j.at("counts"), counts) || !decode(j.at("sum"), sum) || !decode(j.at("max"), max) ||
      buckets.size() != counts.size())
    return false;
  std::map<std::uint32_t, std::uint64_t> many;
  for (std::size_t i = 0; i < buckets.size(); ++i) many[buckets[i]] = counts[i];
  return Distribution::restore(std::move(values), many, sum, max, x);
}

template <class T>
Json encode(const std::vector<T>& x) {
  Json j = Json::array();
  for (const T& element : x) j.push_back(encode(element));
  return j;
}
template <class T>
bool decode(const Json& j, std::vector<T>& x) {
  if (!j.is_array()) return false;
  x.clear();
  x.reserve(j.elements().size());
  for (const Json& element : j.elements())
    if (!decode(element, x.emplace_back())) return false;
  return true;
}

Json encode(const Names& x) {
  Json j = Json::object();
  for (const auto& [key, value] : x) j[key] = value;
  return j;
}
bool decode(const Json& j, Names& x) {
  if (!j.is_object()) return false;
  for (std::size_t i = 0; i < j.keys().size(); ++i)
    if (!decode(j.elements()[i], x[j.keys()[i]])) return false;
  return true;
}

template <class T>
Json encode(const T& x) {
  if constexpr (HasFields<const T>) {
    Json j = Json::object();
    fields(Writer{j}, x);
    return j;
  } else if constexpr (std::is_enum_v<T>) {
    return static_cast<int>(x);
  } else {
    return x;
  }
}
template <class T>
bool decode(const Json& j, T& x) {
  if constexpr (HasFields<T>) {
    if (!j.is_object()) return false;
    const char* bad = nullptr;
    fields(Reader{j, bad}, x);
    return bad == nullptr;
  } else if constexpr (std::is_same_v<T, std::string>) {
    std::optional<std::string> text = j.text();
    if (text) x = std::move(*text);
    return text.has_value();
  } else if constexpr (std::is_same_v<T, bool>) {
    x = j.boolean().value_or(false);
    return j.boolean().has_value();
  } else if constexpr (std::is_floating_point_v<T>) {
    x = j.number().value_or(0);
    return j.number().has_value();
  } else {
    const std::optional<std::int64_t> number = j.integer();
    if constexpr (std::is_enum_v<T>) {
      if (!number || *number < 0 || *number > static_cast<std::int64_t>(last(T{}))) return false;
    } else if (!number || !std::in_range<T>(*number)) {
      return false;
    }
    x = static_cast<T>(*number);
    return true;
  }
}

tl::unexpected<Error> malformed(const std::string& what) {
  return fail(ErrorCode::kInvalid, "malformed " + what, {}, kOneBuild);
}

template <class T>
Result<T> read(const Json& j, const char* what) {
  T x;
  const char* bad = nullptr;
  fields(Reader{j, bad}, x);
  if (bad != nullptr) return malformed(std::string(what) + ": " + bad);
  return x;
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

void Session::take_policy(Policy made) {
  policy = assignment_of(made);
  keys.reset();
  if (!made.by_priority()) keys = std::move(made);
}

void Session::take_tables(Tables all) {
  by_table.clear();
  for (std::size_t t = 0; t < all.tables.size(); ++t)
    by_table.push_back(whole_policy(all, t, app, platform));
  const auto first = static_cast<std::size_t>(all.serves.front().table);
  policy = by_table[first];
  keys = keys_under(all, first, app, platform, {});
  tables = std::move(all);
}

std::vector<std::pair<std::uint32_t, std::uint32_t>> Session::order_on(int xpu) const {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> order;
  for (std::size_t t = 0; t < num_tables(); ++t)
    for (const auto& [u, v] : of_table(t).order)
      if (of_table(t).placements[static_cast<std::size_t>(v)].xpu == xpu)
        order.emplace_back(task(t, static_cast<std::uint32_t>(u)),
                           task(t, static_cast<std::uint32_t>(v)));
  return order;
}

Result<std::string> to_json(const Session& s) {
  for (const std::string& path : {s.releases.input, s.releases.record, s.profile.machine_root})
    if (Json::parse(Json(path).dump())->text() != path)
      return fail(ErrorCode::kInvalid, "a path that is not UTF-8", path,
                  "give the file another name");
  Json j = encode(s);
  j["version"] = kSessionVersion;
  j["platform"] = xauto::to_json(s.platform);
  if (s.mode != Mode::kRun && !s.deployment.app.empty())
    j["deployment"] = xauto::to_json(s.deployment);
  if (s.mode == Mode::kRun) {
    j["app"] = xauto::to_json(s.app);
    Deployment deployment = s.deployment;
    deployment.app = s.app.name;
    j["deployment"] = xauto::to_json(deployment);
    if (s.tables)
      j["tables"] = xauto::to_json(*s.tables, s.app, s.platform);
    else if (s.scheduling != Scheduling::kRos2)
      j["policy"] =
          xauto::to_json(s.keys ? *s.keys : by_priorities(s.policy, s.app), s.app, s.platform);
  }
  return j.dump();
}

Result<Session> parse_session(const std::string& text) {
  const std::optional<Json> j = Json::parse(text);
  if (!j) return malformed("session");
  if (j->at("version").integer() != kSessionVersion)
    return fail(ErrorCode::kInvalid, "session of another version", {}, kOneBuild);
  XAUTO_ASSIGN(Session s, read<Session>(*j, "session"));
  const auto member = [&](const char* name) { return j->at(name).text().value_or(""); };
  XAUTO_ASSIGN(s.platform, parse_platform(member("platform"), "session"));
  if (!s.presence.empty() && s.presence.size() != s.platform.xpus.size())
    return fail(ErrorCode::kInvalid, "the session does not say of each XPU whether it is real");
  if (s.mode == Mode::kLoad &&
      (s.load.xpu < 0 || s.load.xpu >= static_cast<int>(s.platform.xpus.size()) ||
       s.load.cores.empty()))
    return malformed("session: load");
  if (s.mode != Mode::kRun) {
    if (!j->has("deployment")) return s;
    XAUTO_ASSIGN(s.deployment, parse_deployment(member("deployment"), "session"));
    return s;
  }
  XAUTO_ASSIGN(s.app, parse_app(member("app"), "session"));
  XAUTO_ASSIGN(s.deployment, parse_deployment(member("deployment"), "session", s.app));
  if (s.scheduling == Scheduling::kRos2) return s;
  if (j->has("tables")) {
    XAUTO_ASSIGN(Tables tables, parse_tables(member("tables"), "session", s.app, s.platform));
    s.take_tables(std::move(tables));
    return s;
  }
  XAUTO_ASSIGN(Policy policy, parse_policy(member("policy"), "session", s.app, s.platform));
  s.take_policy(std::move(policy));
  if (s.host.there() && (!s.keys || s.platform.find_host(s.host.name) < 0))
    return malformed("session: host");
  return s;
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
        index > static_cast<long>(session.parts.modules.size()))
      return fail(ErrorCode::kInvalid, std::string(kProcessVariable) + "='" + process +
                                           "' is not a process of this app");
    session.parts.process = static_cast<int>(index);
  }
  return std::optional<Session>(std::move(session));
}

std::string to_json(const RunReport& r) {
  return encode(r).dump();
}

Result<RunReport> parse_run_report(const std::string& text) {
  const std::optional<Json> j = Json::parse(text);
  if (!j) return malformed("answer of the app");
  if (const Json* error = j->find("error"); error != nullptr) {
    XAUTO_ASSIGN(Error said, read<Error>(*error, "answer of the app"));
    return tl::unexpected(std::move(said));
  }
  return read<RunReport>(*j, "answer of the app");
}

std::string error_to_json(const Error& error) {
  Json j = Json::object();
  j["error"] = encode(error);
  return j.dump();
}

}  // namespace xauto::runtime
