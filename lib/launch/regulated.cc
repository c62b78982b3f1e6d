// SPDX-License-Identifier: Apache-2.0
#include "launch/regulated.h"

#include <charconv>
#include <sstream>

#include <pwd.h>
#include <unistd.h>

#include "coord/core_thread.h"

namespace xauto::launch {
namespace {

constexpr std::int64_t kNsPerUs = 1000, kMaxPreemptUs = 1'000'000;
/// From when a budget is spent to when the core is taken: the coordinator's wake-up, and its calls.
constexpr std::int64_t kCutNs = 100'000;

}  // namespace

Result<Trust> Trust::parse(const std::string& text) {
  if (text == "all") return Trust{};
  Trust trust{.all = false, .nobody = text == "nobody", .users = {}};
  if (trust.nobody) return trust;
  std::istringstream names(text);
  for (std::string name; std::getline(names, name, ',');) {
    uid_t uid = 0;
    const char* const end = name.data() + name.size();
    if (const auto [stopped, error] = std::from_chars(name.data(), end, uid);
        error != std::errc() || stopped != end || name.empty()) {
      const passwd* const user = getpwnam(name.c_str());
      if (user == nullptr)
        return fail(ErrorCode::kInvalid, "there is no user '" + name + "'", "--trust",
                    "all, nobody, or names with commas between them");
      uid = user->pw_uid;
    }
    trust.users.insert(uid);
  }
  return trust;
}

bool Trust::trusts(uid_t uid) const {
  return all || (!nobody && (!is_stranger(uid) || users.contains(uid)));
}

bool is_stranger(uid_t uid) {
  return uid != 0 && uid != geteuid();
}

Result<Demand> demand_of_tasks(const Join& join, const std::vector<LeaseTask>& tasks) {
  Demand demand{.ticks_per_us = kNsPerUs, .xpus = {}};
  for (std::uint32_t i = 0; i < join.num_xpus; ++i) {
    const JoinXpu& xpu = join.xpus[i];
    if (coord::core_number(xpu.hardware) < 0 ||
        xpu.discipline != static_cast<std::uint32_t>(Discipline::kPreemptive))
      return fail(ErrorCode::kInvalid,
                  "a run that is not trusted may share cores alone: this cannot be taken from it",
                  xpu.hardware);
    if (xpu.preempt_us < 0 || xpu.preempt_us > kMaxPreemptUs)
      return fail(ErrorCode::kInvalid, "preempts at a cost that cannot be", xpu.hardware);
    DemandOnXpu& on = demand.xpus.emplace_back();
    on.xpu.id = xpu.hardware;
    on.xpu.preemptive = true;
    on.xpu.preempt_us = xpu.preempt_us;
  }
  std::set<std::uint32_t> xnodes;
  for (const LeaseTask& one : tasks) {
    const coord::SporadicTask& task = one.task;
    if (one.xpu >= join.num_xpus || task.xnode >= join.num_xnodes || !task.makes_sense() ||
        !xnodes.insert(task.xnode).second)
      return fail(ErrorCode::kInvalid, "says of an XNode what cannot be",
                  "XNode " + std::to_string(task.xnode),
                  "its window has to hold its WCET, which is 500 ms at most");
    demand.xpus[one.xpu].sequences.push_back({.period = task.period_ns,
                                              .jobs = {{.release = 0,
                                                        .ready = task.longest_ns - task.window_ns,
                                                        .start = 0,
                                                        .key = task.longest_ns,
                                                        .work = task.budget_ns + kCutNs,
                                                        .charged = true}}});
  }
  XAUTO_TRY(validate(demand));
  return demand;
}

void charge_all(Demand& demand, const std::set<std::string>& hardware) {
  for (DemandOnXpu& on : demand.xpus) {
    if (!hardware.contains(on.xpu.id)) continue;
    for (DemandSequence& sequence : on.sequences)
      for (DemandJob& job : sequence.jobs) {
        if (!job.charged) job.work += on.xpu.preempt_us * demand.ticks_per_us;
        job.charged = true;
      }
  }
}

RunProcess::RunProcess(int socket, pid_t pid)
    : pid_(pid), fd_(coord::process_behind(socket, pid)) {}

bool RunProcess::lives() const {
  return coord::lives(fd_.get());
}

void RunProcess::lower() const {
  if (lives()) coord::take_cores(pid_);
}

}  // namespace xauto::launch
