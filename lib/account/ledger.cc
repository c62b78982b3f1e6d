// SPDX-License-Identifier: Apache-2.0
#include "account/ledger.h"

#include <algorithm>
#include <string>
#include <utility>

#include <fmt/format.h>
#include <uapi/xauto/event.h>

#include "base/clock.h"
#include "base/counter.h"
#include "base/futex.h"
#include "model/claims.h"

namespace xauto::runtime {
namespace {

/// No progress for so long: give up, say what hangs.
constexpr std::int64_t kStallNs = 10'000'000'000;
constexpr std::int64_t kQuietNs = 100'000'000;

}  // namespace

Ledger::Ledger(const Context& context, Routes routes, Role& role)
    : context_(context),
      routes_(std::move(routes)),
      role_(role),
      sinks_(sinks(context.graph)),
      num_sinks_(static_cast<int>(std::ranges::count(sinks_, 1))) {
  for (std::size_t m = 0; m < context.graph.modules.size(); ++m) {
    latencies_.push_back(std::make_unique<Latencies>());
    ends_releases_.push_back(sinks_[m]);
    asked_for_.push_back(is_sink(m) || routes_.end_at(context.graph.modules[m].nodes.back()) ? 1
                                                                                             : 0);
  }
  sink_next_.assign(context.graph.modules.size(), 0);
  released_.resize(context.graph.sources.size());
  unended_.assign(context.graph.modules.size(), 0);
  released_for_.assign(context.graph.modules.size(), 0);
  if (!role.leads()) return;
  const Session& session = context.session;
  std::vector<char> here;
  for (const int process : context.plan.process_of) here.push_back(process != Plan::kElsewhere);
  routes_.end_here(here);
  const bool paced = session.releases.input.empty() && !session.releases.lockstep;
  routes_.show_on(context.board, paced ? &context.grid : nullptr);
  if (session.releases.lockstep && !context.grid.one_at_a_time) routes_.in_lockstep();
  if (context.graph.single_rate) {
    FlowLine& whole = context.board.flow(0);
    if (paced && !context.grid.sources.empty())
      whole.period_us = context.grid.sources.front().period_ns() / 1000;
  }
  if (context.scheduled()) show_claims();
}

/// What the policy claims of each chain, before the run.
void Ledger::show_claims() {
  const Session& session = context_.session;
  if (session.tables) {
    // Which claim a release is held against is told as it comes (Routes::claim).
    const std::vector<std::int64_t> largest_us = largest_claims(*session.tables);
    for (std::size_t i = 0; i < std::min(routes_.size(), largest_us.size()); ++i)
      routes_.show_claim(i, {.worst_case_us = largest_us[i]});
    unproven_.assign(routes_.size(), 0);
    routes_.claims_may_change();
    routes_.claim(0, claimed_by(0), more_pct());
    tell_chains(0, 0);
  } else if (session.keys) {
    const std::vector<ChainClaim>& claims = session.keys->chains;
    std::vector<std::int64_t> worst_us(routes_.size(), 0);
    for (std::size_t i = 0; i < std::min(routes_.size(), claims.size()); ++i) {
      worst_us[i] = claims[i].worst_case_us;
      const std::int64_t more_us = worst_us[i] * more_pct() / 100,
                         urgent_us = claims[i].urgent_worst_case_us.value_or(0);
      routes_.show_claim(i, {worst_us[i], claims[i].lower_bound_us, worst_us[i] + more_us,
                             urgent_us, urgent_us + more_us});
    }
    routes_.claim(0, std::move(worst_us), more_pct());
  }
  context_.board.header().claimed.store(static_cast<std::uint32_t>(claimed()));
}

Claimed Ledger::claimed() const {
  const Session& session = context_.session;
  if (!context_.scheduled() || !(session.tables || session.keys)) return Claimed::kNothing;
  if (session.keys && !session.keys->certified) return Claimed::kUncertified;
  return context_.grid.one_at_a_time ? Claimed::kOneAtATime : Claimed::kOfRates;
}

/// What a chain may take beside its claim.
std::int64_t Ledger::more_pct() const {
  return context_.session.emulates() ? kEmulatorPct : 0;
}

/// [chain] what the scenario's table claims of a release under it, once all changes before it are proven.
std::vector<std::int64_t> Ledger::claimed_by(std::size_t scenario) const {
  std::vector<std::int64_t> claimed(routes_.size(), 0);
  const std::vector<std::int64_t>& worst_us =
      context_.session.tables->serves[scenario].chain_worst_us;
  for (std::size_t i = 0; i < std::min(claimed.size(), worst_us.size()); ++i)
    if (unproven_[i] == 0 && worst_us[i] != kNotThere) claimed[i] = worst_us[i];
  return claimed;
}

/// Which chains the scenario's table has, where some table lacks one.
void Ledger::tell_chains(std::int64_t from_ns, std::size_t scenario) {
  const Tables& tables = *context_.session.tables;
  if (std::ranges::all_of(tables.tables, [](const Table& t) { return t.loss.off.empty(); })) return;
  std::vector<char> there(routes_.size(), 1);
  const std::vector<std::int64_t>& worst_us = tables.serves[scenario].chain_worst_us;
  for (std::size_t i = 0; i < std::min(there.size(), worst_us.size()); ++i)
    there[i] = worst_us[i] == kNotThere ? 0 : 1;
  routes_.have(from_ns, std::move(there));
}

void Ledger::claim_change(std::int64_t from_ns, std::int64_t settled_ns, std::size_t scenario,
                          const std::vector<std::optional<std::int64_t>>* across_us,
                          const MetChange& met) {
  if (!role_.leads()) return;
  const Tables& tables = *context_.session.tables;
  std::vector<std::int64_t> across(routes_.size(), 0);
  for (std::size_t i = 0; i < across.size(); ++i) {
    if (across_us == nullptr || i >= across_us->size() || !(*across_us)[i])
      unproven_[i] = 1;  // nobody knows when its jobs are in time again
    else if (unproven_[i] == 0 && *(*across_us)[i] != kNotThere)
      across[i] = *(*across_us)[i];
  }
  // What was released so long before may still be under way when a job begins to be too long.
  const std::vector<std::int64_t> largest_us = largest_claims(tables);
  const auto longest_us = std::max_element(largest_us.begin(), largest_us.end());
  const std::int64_t before_us = longest_us == largest_us.end() ? 0 : *longest_us;
  routes_.claim(from_ns - (before_us + tables.notice_us) * 1000, std::move(across), more_pct(),
                met);
  routes_.claim(settled_ns, claimed_by(scenario), more_pct());
  tell_chains(from_ns, scenario);
}

void Ledger::open(std::uint64_t sequence, std::int64_t origin_ns) {
  context_.board.count_release();
  if (!context_.graph.single_rate || num_sinks_ == 0) return;
  const Guard lock(mutex_);
  if (sequence < num_released_) return;  // a source of another offset was there before
  num_released_ = sequence + 1;
  while (open_base_ + open_.size() <= sequence) open_.push_back({});
  if (sequence >= open_base_)
    open_[sequence - open_base_] = {origin_ns, origin_ns, num_sinks_, false};
  if (in_flight_.fetch_add(1) > 0 && context_.grid.one_at_a_time)
    context_.board.header().overlapping.fetch_add(1, std::memory_order_relaxed);
}

void Ledger::released(std::size_t source, std::uint64_t sequence, std::int64_t origin_ns) {
  Released& of = released_[source];
  of.next = std::max(of.next, sequence + 1);
  of.newest_ns = std::max(of.newest_ns, origin_ns);
  routes_.released(source, origin_ns);
}

void Ledger::done(int module, std::int64_t origin_ns, std::uint64_t sequence,
                  const detail::Origins* origins, bool urgent) {
  ModuleLine& counts = context_.board.module(module);
  add_alone(counts.activations);  // in order
  const bool tells = asked_for(module);
  if (!tells && context_.trace == nullptr) return;
  const std::int64_t now = now_ns();  // one instant for all accounts: the trace and the table agree
  if (context_.trace != nullptr)
    context_.trace->write_at(now, XAUTO_EV_DONE, sequence, XAUTO_EV_NONE,
                             static_cast<std::uint16_t>(module), XAUTO_EV_NONE);
  if (tells) through(module, sequence, origin_ns, origins, now, false, urgent);
}

void Ledger::passed(int node, std::int64_t origin_ns, std::uint64_t sequence,
                    const detail::Origins* origins, bool urgent) {
  if (!role_.leads()) return;  // its chains are counted where the accounts are: not yet
  if (const auto late_us = routes_.published(node, origin_ns, origins, now_ns(), urgent))
    missed(context_.graph.nodes[static_cast<std::size_t>(node)].module, sequence, *late_us);
}

void Ledger::dropped(int module, std::uint64_t sequence, std::uint32_t reason) {
  ModuleLine& counts = context_.board.module(module);
  (reason == XAUTO_DROP_FAILED    ? counts.failed
   : reason == XAUTO_DROP_OFF     ? counts.off
   : reason == XAUTO_DROP_SKIPPED ? counts.skipped
                                  : counts.dropped)
      .fetch_add(1, std::memory_order_relaxed);
  if (context_.trace != nullptr)
    context_.trace->write(XAUTO_EV_DROP, sequence, XAUTO_EV_NONE,
                          static_cast<std::uint16_t>(module), XAUTO_EV_NONE, reason);
  if (ends_releases_[static_cast<std::size_t>(module)] != 0)
    through(module, sequence,
            reason == XAUTO_DROP_OFF || reason == XAUTO_DROP_SKIPPED ? detail::kOffNs : 0, nullptr,
            now_ns(), true, false);
}

void Ledger::through(int module, std::uint64_t sequence, std::int64_t origin_ns,
                     const detail::Origins* origins, std::int64_t now, bool lost, bool urgent) {
  if (role_.tell(module, sequence, origin_ns, now, lost, origins, urgent)) return;
  if (!lost) {
    add_alone(latencies_[static_cast<std::size_t>(module)]->told);
    if (const auto late_us =
            routes_.published(context_.graph.modules[static_cast<std::size_t>(module)].nodes.back(),
                              origin_ns, origins, now, urgent);
        late_us)
      missed(module, sequence, *late_us);
  }
  if (ends_releases_[static_cast<std::size_t>(module)] == 0) return;
  if (!lost && context_.graph.modules[static_cast<std::size_t>(module)].sink) {
    Latencies& latencies = *latencies_[static_cast<std::size_t>(module)];
    const Guard lock(latencies.mutex);
    latencies.us.add((now - origin_ns) / 1000);
  }
  account(module, sequence, now, lost, lost && origin_ns == detail::kOffNs);
}

/// Into the trace, which so tells the tool.
void Ledger::missed(int module, std::uint64_t sequence, std::int64_t latency_us) {
  if (context_.trace == nullptr) return;
  context_.trace->write(
      XAUTO_EV_MISS, sequence, XAUTO_EV_NONE, static_cast<std::uint16_t>(module), XAUTO_EV_NONE,
      static_cast<std::uint32_t>(std::clamp<std::int64_t>(latency_us, 0, UINT32_MAX)));
}

/// A sink module settles its releases in order and each once; what it left out was lost with its
/// process, what comes twice was told by a process that died meanwhile.
void Ledger::account(int module, std::uint64_t sequence, std::int64_t now, bool lost, bool off) {
  if (!context_.graph.single_rate) return;
  std::uint32_t complete = 0;
  {
    const Guard lock(mutex_);
    std::uint64_t& next = sink_next_[static_cast<std::size_t>(module)];
    for (; next <= sequence && next < open_base_ + open_.size(); ++next) {
      Open& open = open_[next - open_base_];
      if (!off || next < sequence) open.last_ns = std::max(open.last_ns, now);
      open.lost |= (lost && !off) || next < sequence;
      open.ended |= !lost && next == sequence;
      if (--open.sinks_left > 0) continue;
      ++complete;
      ++num_releases_;
      if (!open.lost && !open.ended) continue;  // all its ends are off: it has no latency
      const std::int64_t latency_us = (open.last_ns - open.origin_ns) / 1000;
      releases_.push_back({next, open.origin_ns, open.lost ? -1 : latency_us});
      if (releases_.size() > kKeptReleases) releases_.pop_front();
      FlowLine& whole = context_.board.flow(0);
      if (open.lost) {
        ++lost_releases_;
        whole.lost.fetch_add(1, std::memory_order_relaxed);
      } else {
        latencies_us_.add(latency_us);
        whole.add(latency_us, now);
      }
    }
    for (; !open_.empty() && open_.front().sinks_left == 0; ++open_base_) open_.pop_front();
  }
  if (complete == 0) return;
  in_flight_.fetch_sub(complete);
  futex_wake_local(in_flight_, 1);
}

void Ledger::forget(int module) {
  const auto m = static_cast<std::size_t>(module);
  ModuleLine& counts = context_.board.module(module);
  counts.in_flight.store(0);
  for (const int n : context_.graph.modules[m].nodes) {
    XNodeLine& line = context_.board.xnode(static_cast<std::size_t>(n));
    const std::uint32_t unended = line.unended.load();  // they died with it, past their WCET
    line.over(unended, unended > 0 ? line.unended_ns.load() - line.unended_wcet_ns.load() : 0);
    line.unended.store(0);
    line.unended_ns.store(0);
  }
  // It may have died between counting a release and telling: nobody has that result.
  const std::uint64_t settled = counts.settled();
  const std::uint64_t done = counts.activations.load(), told = latencies_[m]->told.load();
  if (asked_for(module) && done > told) {
    counts.activations.store(told);
    counts.dropped.fetch_add(done - told);
  }
  if (ends_releases_[m] != 0 && context_.graph.single_rate && settled > 0)
    account(module, settled - 1, now_ns(), true, false);
}

/// Every module is through with every release. Those whose result nobody waits for, since another
/// input of the same release was lost, are so later than the sinks.
bool Ledger::settled() const {
  for (std::size_t m = 0; m < context_.graph.modules.size(); ++m)
    if (context_.board.module(static_cast<int>(m)).settled() < num_released_) return false;
  return true;
}

/// Several rates.
bool Ledger::wait_quiet() {
  std::int64_t since = now_ns();
  for (std::uint64_t before = context_.board.settled();;) {
    const std::int64_t due = now_ns() + kQuietNs;
    sleep_until_ns(due);
    const std::int64_t now = now_ns();
    const std::uint64_t settled = context_.board.settled();
    const bool quiet = settled == before && !context_.board.busy();
    // Who wakes up late was stopped, and all others with it: a message may be on its way still.
    if (quiet && now - due < kQuietNs / 10) return true;
    if (settled != before) since = now;
    if (now - since > kStallNs) return quiet;
    before = settled;
  }
}

bool Ledger::wait_drained(const std::function<bool()>& idle) {
  if (!context_.graph.single_rate) return wait_quiet();
  std::int64_t since = 0;  // when nothing had moved; nobody looks at the clock before that
  const auto stalled = [&] {
    const std::int64_t now = now_ns();
    if (since == 0) since = now;
    return now - since > kStallNs;
  };
  std::uint64_t settled_before = 0;
  for (;;) {
    const std::uint32_t left = in_flight_.load();
    if (left > 0) {
      futex_wait_local(in_flight_, left, kLookNs);
      if (in_flight_.load() != left)
        since = 0;
      else if (stalled())
        return false;
      continue;
    }
    if (settled()) break;
    if (const std::uint64_t sum = context_.board.settled(); sum != settled_before) {
      settled_before = sum;
      since = 0;
    } else if (stalled()) {
      return false;
    }
    sleep_until_ns(now_ns() + 20'000);
  }
  // A sink's process says that it is through beside its messages, which observers here get.
  while (!idle()) sleep_until_ns(now_ns() + 20'000);
  return true;
}

/// 0: its activations are not numbered as releases are.
std::uint64_t Ledger::released_for(std::size_t module) const {
  const Graph::Module& of = context_.graph.modules[module];
  std::uint64_t next = 0;
  for (std::size_t s = 0; of.numbered && s < released_.size(); ++s)
    for (const Graph::Subscriber& reader :
         context_.graph.topics[static_cast<std::size_t>(context_.graph.topic_of_source[s])]
             .subscribers)
      if (context_.graph.modules[static_cast<std::size_t>(reader.module)].component == of.component)
        next = std::max(next, released_[s].next);
  return next;
}

void Ledger::give_up(const std::vector<std::size_t>& waiting) {
  gave_up_ns_ = now_ns();
  for (std::size_t m = 0; m < unended_.size(); ++m) {
    const ModuleLine& counts = context_.board.module(static_cast<int>(m));
    released_for_[m] = released_for(m);
    unended_[m] = released_for_[m] > 0
                      ? released_for_[m] - std::min(released_for_[m], counts.settled())
                      : counts.in_flight.load() + waiting[m];
  }
}

std::string Ledger::what_did_not_end() const {
  std::string text;
  for (std::size_t m = 0; m < unended_.size(); ++m) {
    if (unended_[m] == 0) continue;
    const bool one = unended_[m] == 1;
    text += (text.empty() ? "" : ", ") + std::to_string(unended_[m]) +
            (released_for_[m] > 0 ? " of " + std::to_string(released_for_[m]) : "") +
            (one && released_for_[m] == 0 ? " activation" : " activations") + " of XModule '" +
            context_.graph.modules[m].name + "'";
  }
  return text.empty() ? "messages were under way for ten seconds" : text + " did not end";
}

/// What is claimed, and whether each of it can be held against something.
void Ledger::tell_claims(Account& into) const {
  claim_on(into, claimed());
  if (!into.claims()) return;
  if (!context_.session.platform.hosts.empty()) into.scope += kHostsScope;
  const Session& session = context_.session;
  const std::size_t claims =
      session.tables ? largest_claims(*session.tables).size() : session.keys->chains.size();
  std::uint64_t unmeasured = claims - std::min(claims, into.chains.size());
  if (unmeasured > 0)
    into.add("chain_not_measured", unmeasured,
             fmt::format("{} of {} chains are not measured", unmeasured, claims));
  unmeasured = 0;
  // In lockstep there are results without a time; that is told by what is not kept.
  for (std::size_t c = 0; c < into.chains.size(); ++c) {
    const ChainAccount& chain = into.chains[c];
    if (routes_.ends_here(c) && chain.worst_case_us > 0 && chain.results() == 0 &&
        chain.not_measured == 0)
      ++unmeasured;
  }
  if (unmeasured > 0)
    into.add("chain_without_result", unmeasured,
             fmt::format("{} of {} chains had no result", unmeasured, into.chains.size()));
}

void Ledger::report(const std::vector<std::vector<Limits>>& limits, RunReport& into) {
  routes_.judge();
  {
    const Guard lock(mutex_);
    into.releases.assign(releases_.begin(), releases_.end());
    into.num_releases = num_releases_;
    into.lost_releases = lost_releases_;
    into.latencies_us = latencies_us_;
    // A run that gave up: they have no result, and most no time left for one.
    for (const Open& open : open_) {
      if (gave_up_ns_ == 0 || open.sinks_left == 0) continue;
      ++into.num_releases;
      ++into.lost_releases;
    }
  }
  std::sort(into.releases.begin(), into.releases.end(),
            [](const ReleaseRecord& a, const ReleaseRecord& b) { return a.sequence < b.sequence; });
  std::vector<std::uint64_t> lost;  // [module]
  for (std::size_t m = 0; m < context_.graph.modules.size(); ++m) {
    const ModuleLine& counts = context_.board.module(static_cast<int>(m));
    ModuleReport module{context_.graph.modules[m].name,
                        context_.graph.modules[m].sink,
                        counts.activations,
                        counts.failed,
                        counts.dropped,
                        counts.off,
                        counts.skipped,
                        {},
                        unended_[m]};
    const Guard lock(latencies_[m]->mutex);
    module.latencies_us = latencies_[m]->us;
    into.modules.push_back(std::move(module));
    lost.push_back(counts.failed + counts.dropped);
  }
  const Routes::Unended unended{gave_up_ns_, unended_};
  std::vector<std::int64_t> newest_ns;
  for (const Released& source : released_) newest_ns.push_back(source.newest_ns);
  into.account.chains = routes_.report(lost, gave_up_ns_ > 0 ? &unended : nullptr, newest_ns);
  for (const ChainAccount& chain : into.account.chains)
    into.deadline_misses += chain.deadline_misses;
  tell_claims(into.account);
  for (std::size_t n = 0; n < context_.graph.nodes.size(); ++n) {
    // Of the first table that has it.
    const auto of = std::find_if(limits.begin(), limits.end(),
                                 [&](const std::vector<Limits>& l) { return l[n].any(); });
    if (of == limits.end()) continue;
    const Limits& limit = (*of)[n];
    const XNodeLine& line = context_.board.xnode(n);
    into.xnodes.push_back(
        {context_.graph.nodes[n].name, limit.budget_ns / 1000,
         context_.session.tables ? 0 : limit.wcet_ns / 1000, limit.hang_ns / 1000, line.jobs,
         line.overruns, line.over_wcet, line.hangs, line.longest_ns / 1000, line.over_ns / 1000,
         context_.graph.modules[static_cast<std::size_t>(context_.graph.nodes[n].module)].name,
         line.unended, line.unended_ns / 1000});
  }
  into.several_rates = !context_.graph.single_rate;
}

}  // namespace xauto::runtime
