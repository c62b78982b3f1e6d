// SPDX-License-Identifier: Apache-2.0
#include "xauto/parts.h"

#include <algorithm>
#include <limits>
#include <random>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/utsname.h>

#include "base/fnv.h"
#include "base/log.h"
#include "model/hosts.h"
#include "model/json.h"
#include "session/notes.h"

namespace xauto::cli {
namespace {

/// Of those that are all waited for; one that is stopped waits for nobody's end.
constexpr std::int64_t kReportsNs = 30'000'000'000, kStoppedNs = 2'000'000'000;

Error not_with_part(const std::string& what, const std::string& why) {
  return {ErrorCode::kInvalid, "is not for one host's part of a run: " + why, what,
          "leave it out, or run the whole app on one machine, without --part"};
}

/// What all parts have to have in common. Messages are a machine's memory, or its Codec's.
std::string hash_of(const RunFlags& flags, const PolicyRun& run) {
  utsname machine{};
  (void)uname(&machine);
  Platform platform = flags.spec;  // each part has its own XPUs first
  std::ranges::sort(platform.xpus, {}, &Xpu::id);
  Fnv fnv;
  for (const std::string& part :
       {to_json(flags.app), to_json(platform), to_json(*run.keys, flags.app, flags.spec),
        std::string(XAUTO_VERSION), std::string(machine.machine),
        fmt::format("{} {}", flags.activations, flags.seconds)})
    fnv.add(part);
  return fnv.hex();
}

std::uint64_t any_number() {
  std::random_device device;
  return (std::uint64_t{device()} << 31U ^ device()) % (std::uint64_t{1} << 62U) + 1;
}

/// Hosts on which the policy has XNodes, in the platform's order.
std::vector<std::string> hosts_with_work(const RunFlags& flags, const Policy& policy) {
  std::vector<std::string> hosts;
  const std::vector<int> host_of = hosts_of(flags.app, flags.spec, policy);
  for (std::size_t h = 0; h < flags.spec.hosts.size(); ++h)
    if (std::ranges::find(host_of, static_cast<int>(h)) != host_of.end())
      hosts.push_back(flags.spec.hosts[h].name);
  return hosts;
}

/// Clocks that are further apart are so for all that crosses.
std::int64_t least_x_ns(const Policy& policy) {
  std::int64_t least_us = std::numeric_limits<std::int64_t>::max() / 1000;
  for (const Crossing& crossing : policy.crossings) least_us = std::min(least_us, crossing.x_us);
  return least_us * 1000;
}

/// A source's messages count as there, on every host, when they are released: each host makes its own.
void tell_shared_sources(const RunFlags& flags, const Policy& policy) {
  const std::vector<int> hosts = hosts_of(flags.app, flags.spec, policy);
  for (std::size_t s = 0; s < flags.app.sources.size(); ++s) {
    std::set<std::string> hear;
    for (std::size_t x = 0; x < flags.app.xnodes.size(); ++x)
      if (std::ranges::find(flags.app.xnodes[x].sources, static_cast<int>(s)) !=
          flags.app.xnodes[x].sources.end())
        hear.insert(flags.spec.hosts[static_cast<std::size_t>(hosts[x])].name);
    if (hear.size() > 1 && hear.contains(flags.part))
      log::warn(
          "source '{}' is heard on hosts {}: the program of each makes the messages of its own; "
          "pin the "
          "modules that hear it to one host if only one has the sensor",
          flags.app.sources[s].name, fmt::join(hear, ", "));
  }
}

void add_account(const runtime::Account& one, const std::string& host, runtime::Account& into) {
  for (const runtime::Assumption& of : one.assumptions) {
    auto at = std::ranges::find(into.assumptions, of.kind, &runtime::Assumption::kind);
    if (at == into.assumptions.end())
      at = into.assumptions.insert(into.assumptions.end(), {of.kind, 0, {}});
    at->count += of.count;
    for (const std::string& words : of.words) at->words.push_back("'" + host + "': " + words);
  }
  // A chain is measured where it ends.
  for (std::size_t c = 0; c < std::min(one.chains.size(), into.chains.size()); ++c)
    if (one.chains[c].results() + one.chains[c].lost >
        into.chains[c].results() + into.chains[c].lost)
      into.chains[c] = one.chains[c];
  for (runtime::TakenReport taken : one.taken) {
    taken.what = "'" + host + "': " + taken.what;
    into.taken.push_back(std::move(taken));
  }
}

}  // namespace

Status put_first(Platform& platform, const std::string& host) {
  const int at = platform.find_host(host);
  if (at < 0)
    return fail(ErrorCode::kInvalid, "platform '" + platform.name + "' has no host '" + host + "'",
                "--part",
                platform.hosts.empty()
                    ? "its platform.json says nothing of hosts (docs/several-machines.md)"
                    : "name one of its hosts");
  std::stable_partition(platform.xpus.begin(), platform.xpus.end(),
                        [at](const Xpu& xpu) { return xpu.host == at; });
  return {};
}

Result<std::vector<Presence>> presence_of_part(const RunFlags& flags) {
  Platform here = flags.spec;
  const int host = here.find_host(flags.part);
  std::erase_if(here.xpus, [host](const Xpu& xpu) { return xpu.host != host; });
  XAUTO_ASSIGN(std::vector<Presence> presence, flags.emulation.decide(here, &flags.app));
  presence.resize(flags.spec.xpus.size(), Presence::kAbsent);
  return presence;
}

Status check_part(const RunFlags& flags, const PolicyRun& run) {
  if (run.scheduling != runtime::Scheduling::kXAuto || !run.keys)
    return tl::unexpected(
        not_with_part("--policy", "a part goes by the keys of a policy of several hosts"));
  const std::vector<std::string> hosts = hosts_with_work(flags, *run.keys);
  if (std::ranges::find(hosts, flags.part) == hosts.end())
    return fail(ErrorCode::kInvalid,
                "has nothing to do: the policy has no XNode on host '" + flags.part + "'", "--part",
                fmt::format("run parts on {}", fmt::join(hosts, ", ")));
  if (flags.lockstep || flags.phases || !flags.input.empty() || flags.period_us > 0)
    return tl::unexpected(not_with_part("--lockstep, --phases, --input, --period",
                                        "all parts release by the app's own periods"));
  if (flags.app.one_at_a_time)
    return tl::unexpected(
        not_with_part("the app", "its sources have no rate, so no host knows when they release"));
  if (!flags.deployment.processes(flags.app).empty())
    return tl::unexpected(not_with_part("--isolate", "it is one process"));
  for (const XNodeSpec& xnode : flags.app.xnodes)
    if (flags.deployment.of(xnode.module).match_us)
      return tl::unexpected(
          not_with_part("match_us of '" + xnode.module + "'", "its inputs go by releases"));
  if (!flags.system.empty() && flags.system != "off")
    return tl::unexpected(not_with_part("--system", "it brings coordinators of its own"));
  return {};
}

Result<std::unique_ptr<launch::Meeting>> meet(const RunFlags& flags, const PolicyRun& run,
                                              const std::atomic<bool>* stop) {
  launch::MeetingRequest request;
  request.address = flags.meet;
  request.stop = stop;
  request.set_up.hosts = hosts_with_work(flags, *run.keys);
  request.set_up.own = {flags.part, hash_of(flags, run), launch::kernel_tai_s()};
  request.set_up.fresh_run = any_number();
  request.set_up.limit_ns = static_cast<std::int64_t>(flags.meet_limit_s * 1e9);
  request.set_up.most_apart_ns = least_x_ns(*run.keys);
  tell_shared_sources(flags, *run.keys);
  log::info("part '{}' meets the others at {}", flags.part, flags.meet);
  return launch::Meeting::begin(std::move(request));
}

void add_report(const runtime::RunReport& one, const std::string& host, runtime::RunReport& into) {
  into.complete = into.complete && one.complete;
  if (!one.note.empty()) runtime::add_note(into.note, "'" + host + "': " + one.note);
  for (std::size_t m = 0; m < std::min(one.modules.size(), into.modules.size()); ++m)
    if (one.modules[m].activations + one.modules[m].failed + one.modules[m].dropped >
        into.modules[m].activations + into.modules[m].failed + into.modules[m].dropped)
      into.modules[m] = one.modules[m];
  for (std::size_t x = 0; x < std::min(one.xnodes.size(), into.xnodes.size()); ++x)
    if (one.xnodes[x].jobs + one.xnodes[x].unended > into.xnodes[x].jobs + into.xnodes[x].unended)
      into.xnodes[x] = one.xnodes[x];
  into.crossings.insert(into.crossings.end(), one.crossings.begin(), one.crossings.end());
  into.preemptions.insert(into.preemptions.end(), one.preemptions.begin(), one.preemptions.end());
  into.lost_coordinators.insert(into.lost_coordinators.end(), one.lost_coordinators.begin(),
                                one.lost_coordinators.end());
  into.died.insert(into.died.end(), one.died.begin(), one.died.end());
  add_account(one.account, host, into.account);
  into.deadline_misses = 0;
  for (const runtime::ChainAccount& chain : into.account.chains)
    into.deadline_misses += chain.deadline_misses;
}

void join_reports(launch::Meeting& meeting, bool stopped, PolicyRun& run) {
  runtime::RunReport& report = run.report;
  run.tai_offset_ns = meeting.clock_offset_ns();
  meeting.tell_steps(report.account);
  meeting.end(runtime::to_json(report), stopped ? kStoppedNs : kReportsNs);
  std::vector<std::string> notes;
  meeting.report(report.account, notes);
  if (meeting.leads())
    for (const auto& [host, text] : meeting.reports()) {
      const auto one = runtime::parse_run_report(text);
      if (one)
        add_report(*one, host, report);
      else
        notes.push_back("the report of part '" + host + "' is unreadable");
    }
  for (const std::string& note : notes) runtime::add_note(report.note, note);
}

void note_one_machine(const RunFlags& flags, PolicyRun& run) {
  if (flags.spec.hosts.empty() || !run.keys) return;
  const std::size_t crossings = run.keys->crossings.size();
  run.report.account.add("one_machine", crossings, std::string());
  if (run.report.account.claims()) run.report.account.scope += ", on one machine, by one clock";
  run.outcome.notes.push_back(
      fmt::format("all {} hosts are this machine, by one clock: X of {} messages is assumed, and "
                  "not watched (--part)",
                  flags.spec.hosts.size(), crossings));
}

}  // namespace xauto::cli
