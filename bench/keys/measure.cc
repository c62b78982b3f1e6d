// SPDX-License-Identifier: Apache-2.0
#include "bench/keys/measure.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <malloc.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/clock.h"
#include "base/index.h"
#include "model/components.h"
#include "model/json.h"
#include "model/json_value.h"
#include "solver/keys/check.h"
#include "solver/keys/solve.h"

#include "bench/keys/annealer.h"

namespace xauto::bench {
namespace {

namespace keys = solver::keys;

/// More jobs a hyperperiod are "no H" to all who plan.
constexpr std::int64_t kMostToTell = 1'000'000;

/// What the solver's process says at its end.
std::string solve_in_words(const RatedCase& made, const Asked& asked) {
  keys::Options options;
  options.aim = made.app.has_deadlines() ? asked.aim : keys::Aim::kSum;
  options.time_limit_s = asked.time_limit_s;
  options.threads = asked.threads;
  options.seed = asked.seed;
  const double began = 1e-9 * static_cast<double>(now_ns());
  const auto answer = keys::solve(made.app, made.platform, options);
  const double took_s = 1e-9 * static_cast<double>(now_ns()) - began;
  Json said = Json::object();
  said["solve_s"] = took_s;
  if (!answer) {
    said["error"] = answer.error().to_string();
    return said.dump();
  }
  said["first_ms"] = answer->first_answer_ms;
  said["evaluations"] = answer->evaluations;
  said["largest_bound"] = answer->bounds.largest;
  said["sum_bound"] = answer->bounds.sum;
  said["outcome"] = answer->outcome == keys::Outcome::kPolicy          ? "policy"
                    : answer->outcome == keys::Outcome::kUnsustainable ? "overload"
                                                                       : "unknown";
  if (answer->outcome == keys::Outcome::kPolicy)
    said["policy"] = to_json(answer->policy, made.app, made.platform);
  return said.dump();
}

struct Child {
  std::string said;
  double cpu_s = 0, memory_mib = 0;
};

double seconds_of(const timeval& time) {
  return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_usec) / 1e6;
}

/// In a process of its own: its peak memory and CPU time are the solver's alone.
Result<Child> solve_apart(const RatedCase& made, const Asked& asked) {
  const auto broken = [](const char* what) {
    return fail(ErrorCode::kUnavailable, std::strerror(errno), what);
  };
  malloc_trim(0);  // what we had counts as the child's
  int pipe_ends[2];
  if (pipe(pipe_ends) != 0) return broken("pipe");
  const pid_t pid = fork();
  if (pid < 0) return broken("fork");
  if (pid == 0) {
    close(pipe_ends[0]);
    const std::string said = solve_in_words(made, asked);
    std::size_t written = 0;
    while (written < said.size()) {
      const ssize_t n = write(pipe_ends[1], said.data() + written, said.size() - written);
      if (n <= 0) _exit(1);
      written += static_cast<std::size_t>(n);
    }
    _exit(0);
  }
  close(pipe_ends[1]);
  Child child;
  char buffer[65536];
  for (ssize_t n = 0; (n = read(pipe_ends[0], buffer, sizeof buffer)) > 0;)
    child.said.append(buffer, static_cast<std::size_t>(n));
  close(pipe_ends[0]);
  int status = 0;
  rusage used{};
  if (wait4(pid, &status, 0, &used) != pid) return broken("wait4");
  if (status != 0)
    return fail(ErrorCode::kInternal, "its process ended with status " + std::to_string(status),
                "solver of " + made.name);
  child.cpu_s = seconds_of(used.ru_utime) + seconds_of(used.ru_stime);
  child.memory_mib = static_cast<double>(used.ru_maxrss) / 1024;
  return child;
}

/// Largest of seen / claimed.
double ratio_of(const Observed& seen, const Policy& ours) {
  double most = 0;
  for (std::size_t c = 0; c < ours.chains.size(); ++c)
    most = std::max(most, seen.longest_us[c] / static_cast<double>(ours.chains[c].worst_case_us));
  return most;
}

bool misses(const AppSpec& app, const std::vector<double>& chain_us) {
  for (std::size_t c = 0; c < app.chains.size(); ++c)
    if (app.chains[c].deadline_us && chain_us[c] > static_cast<double>(*app.chains[c].deadline_us))
      return true;
  return false;
}

Status play_rivals(const RatedCase& made, const Asked& asked, const Policy& ours, Measured& m) {
  XAUTO_ASSIGN(const Observed own, observe(made.app, made.platform, ours, asked.plays));
  m.ours_ratio = ratio_of(own, ours);
  m.late = own.late;
  XAUTO_ASSIGN(const std::vector<Rival> list, rivals(made.app, made.platform, ours));
  for (const Rival& rival : list) {
    XAUTO_ASSIGN(const Observed seen, observe(made.app, made.platform, ours, rival, asked.plays));
    Beside row{rival.name, rival.load, seen.backlog, ratio_of(seen, ours)};
    row.breaks = row.backlog || row.ratio > 1;
    row.misses = row.backlog || misses(made.app, seen.longest_us);
    m.beside.push_back(std::move(row));
  }
  return {};
}

}  // namespace

Result<Measured> measure(const RatedCase& made, const Asked& asked) {
  const AppSpec& app = made.app;
  XAUTO_ASSIGN(const Child child, solve_apart(made, asked));
  const Json said = Json::parse(child.said).value_or(Json());
  if (said.has("error") || !said.has("outcome"))
    return fail(ErrorCode::kInternal, said.at("error").text().value_or("it said nothing"),
                "solver of " + made.name);
  const auto asked_of = [&](const keys::Totals& totals) {
    const bool largest = app.has_deadlines() && asked.aim == keys::Aim::kLargest;
    return largest ? totals.largest : totals.sum;
  };
  Measured m;
  m.outcome = said.at("outcome").text().value_or("");
  m.solve_s = said.at("solve_s").number().value_or(0);
  m.first_ms = m.outcome == "policy" ? said.at("first_ms").number().value_or(0) : 1000 * m.solve_s;
  m.evaluations = said.at("evaluations").integer().value_or(0);
  m.cpu_s = child.cpu_s;
  m.memory_mib = child.memory_mib;
  const Components found = find_components(app).value();
  if (std::all_of(found.domains.begin(), found.domains.end(),
                  [](const Domain& d) { return d.jobs > 0 && d.jobs < kMostToTell; }))
    for (const Domain& domain : found.domains) m.jobs += domain.jobs;
  const double annealer_s = asked.annealer_s < 0 ? asked.time_limit_s : asked.annealer_s;
  if (annealer_s > 0 && m.outcome != "overload") {
    const Annealed other = anneal(app, made.platform, annealer_s, asked.seed);
    if (other.policy) m.annealed = asked_of(keys::totals_of(app, worst_cases(*other.policy)));
    m.annealer_first_ms = other.first_ms;
    m.annealer_evaluations = other.evaluations;
  }
  if (m.outcome != "policy") return m;
  XAUTO_ASSIGN(const Policy ours,
               parse_policy(said.at("policy").text().value_or(""), made.name, app, made.platform));
  m.totals = keys::totals_of(app, worst_cases(ours));
  m.bounds = {said.at("largest_bound").number().value_or(0),
              said.at("sum_bound").number().value_or(0)};
  m.objective = asked_of(m.totals);
  m.bound = asked_of(m.bounds);
  std::vector<double> claimed;
  for (const ChainClaim& claim : ours.chains)
    claimed.push_back(static_cast<double>(claim.worst_case_us));
  m.misses = misses(app, claimed);
  const double began = 1e-9 * static_cast<double>(now_ns());
  XAUTO_TRY(keys::check(app, made.platform, ours));
  m.check_ms = 1000 * (1e-9 * static_cast<double>(now_ns()) - began);
  if (asked.rivals) XAUTO_TRY(play_rivals(made, asked, ours, m));
  return m;
}

}  // namespace xauto::bench
