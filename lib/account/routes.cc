// SPDX-License-Identifier: Apache-2.0
#include "account/routes.h"

#include <algorithm>

#include "processes/board.h"
#include "session/changes.h"

namespace xauto::runtime {
namespace {

/// [module] whether messages of `topic` reach it, directly or through others.
std::vector<char> reached(const Graph& graph, int topic) {
  std::vector<char> seen(graph.modules.size(), 0);
  std::vector<int> topics = {topic};
  while (!topics.empty()) {
    const Graph::Topic& at = graph.topics[static_cast<std::size_t>(topics.back())];
    topics.pop_back();
    for (const Graph::Subscriber& s : at.subscribers) {
      char& mark = seen[static_cast<std::size_t>(s.module)];
      if (mark != 0) continue;
      mark = 1;
      const std::vector<int>& outputs = graph.modules[static_cast<std::size_t>(s.module)].outputs;
      topics.insert(topics.end(), outputs.begin(), outputs.end());
    }
  }
  return seen;
}

/// Later than any deadline, and before a table without an end ends.
constexpr std::int64_t kForGood = INT64_MAX - 1;

}  // namespace

Result<Routes> Routes::make(const Graph& graph, const Grid& grid, const Deployment& deployment,
                            const AppSpec& app) {
  Routes routes;
  routes.single_rate_ = graph.single_rate;
  routes.ends_.resize(graph.nodes.size());
  if (grid.periodic) routes.take_chains(graph, grid, app);
  for (const ChainDeployment& chain : deployment.chains)
    XAUTO_TRY(routes.take_chain(graph, grid, chain));
  if (!grid.periodic && deployment.chains.empty())
    routes.take_all(graph, grid, app.deadline_us.value_or(0));
  return routes;
}

/// As far as there is room.
void Routes::add(const Graph& graph, const Grid& grid, ChainAccount counts, std::size_t source,
                 int node) {
  if (routes_.size() == kMaxChains) return;
  Route route;
  route.counts = std::move(counts);
  route.module = graph.nodes[static_cast<std::size_t>(node)].module;
  route.source = source;
  if (grid.periodic) {
    const int topic = graph.topic_of_source[source];
    const int component = graph.modules[static_cast<std::size_t>(route.module)].component;
    route.shift_ns = grid.sources[source].shift_ns;
    route.period_ns = grid.sources[source].period_ns();
    route.through_samples =
        std::none_of(graph.modules.begin(), graph.modules.end(), [&](const Graph::Module& m) {
          return m.component == component &&
                 std::find(m.inputs.begin(), m.inputs.end(), topic) != m.inputs.end();
        });
    route.hurries =
        grid.urgent_source[static_cast<std::size_t>(route.module)] == static_cast<int>(source);
  }
  routes_.push_back(std::move(route));
  ends_[static_cast<std::size_t>(node)].push_back(routes_.size() - 1);
}

/// Those of app.json.
void Routes::take_chains(const Graph& graph, const Grid& grid, const AppSpec& app) {
  for (const ChainSpec& chain : app.chains) {
    const std::string& from = app.sources[static_cast<std::size_t>(chain.from)].name;
    const std::string& to = app.xnodes[static_cast<std::size_t>(chain.to)].name;
    const auto node = std::ranges::find(graph.nodes, to, &Graph::Node::name);
    const auto source = std::ranges::find(graph.sources, from, &SourceSpec::name);
    add(graph, grid,
        {.name = chain.name, .from = from, .to = to, .deadline_us = chain.deadline_us.value_or(0)},
        static_cast<std::size_t>(source - graph.sources.begin()),
        static_cast<int>(node - graph.nodes.begin()));
  }
}

/// One of the deployment: from a sensor's topic to an XModule.
Status Routes::take_chain(const Graph& graph, const Grid& grid, const ChainDeployment& chain) {
  const std::string where = "chain '" + chain.name + "'";
  const auto topic = std::ranges::find_if(graph.topics, [&](const Graph::Topic& t) {
    return t.source >= 0 && t.spec.name == chain.from;
  });
  if (topic == graph.topics.end())
    return fail(ErrorCode::kInvalid, "'" + chain.from + "' is not the topic of a source", where);
  const auto module = std::ranges::find(graph.modules, chain.to, &Graph::Module::name);
  const auto m = static_cast<std::size_t>(module - graph.modules.begin());
  if (module == graph.modules.end() ||
      reached(graph, static_cast<int>(topic - graph.topics.begin()))[m] == 0)
    return fail(ErrorCode::kInvalid,
                "nothing of topic '" + chain.from + "' reaches XModule '" + chain.to + "'", where);
  add(graph, grid,
      {.name = chain.name,
       .from = chain.from,
       .to = chain.to,
       .deadline_us = chain.deadline_us.value_or(0),
       .max_age_us = chain.max_age_us.value_or(0)},
      static_cast<std::size_t>(topic->source), module->nodes.back());
  return {};
}

/// From every sensor to every sink that hears of it.
void Routes::take_all(const Graph& graph, const Grid& grid, std::int64_t deadline_us) {
  for (std::size_t t = 0; t < graph.topics.size(); ++t) {
    const Graph::Topic& topic = graph.topics[t];
    if (topic.source < 0) continue;
    const std::vector<char> reach = reached(graph, static_cast<int>(t));
    for (std::size_t m = 0; m < reach.size(); ++m) {
      const Graph::Module& to = graph.modules[m];
      if (reach[m] != 0 && to.sink)
        add(graph, grid,
            {.name = topic.spec.name + " -> " + to.name,
             .from = topic.spec.name,
             .to = to.name,
             .deadline_us = deadline_us},
            static_cast<std::size_t>(topic.source), to.nodes.back());
    }
  }
}

void Routes::end_here(const std::vector<char>& modules) {
  for (Route& route : routes_) route.here = modules[static_cast<std::size_t>(route.module)] != 0;
}

void Routes::show_on(Board& board, const Grid* grid) {
  board_ = &board;
  for (std::size_t i = 0; i < routes_.size(); ++i) {
    Route& route = routes_[i];
    route.line = &board.flow(i + 1);
    route.line->module = static_cast<std::uint32_t>(route.module);
    name_line(route.line->name, route.counts.name);
    route.line->deadline_us = route.counts.deadline_us;
    route.line->age_limit_us = route.counts.max_age_us;
    if (grid != nullptr && route.source < grid->sources.size())
      route.line->period_us = grid->sources[route.source].period_ns() / 1000;
  }
}

void Routes::show_claim(std::size_t chain, const Claim& claim) {
  Route& route = routes_[chain];
  route.counts.worst_case_us = claim.worst_case_us;
  route.counts.lower_bound_us = claim.lower_bound_us;
  route.counts.urgent_worst_case_us = claim.urgent_worst_case_us;
  route.urgent_allowed_us = claim.urgent_allowed_us;
  if (route.line == nullptr) return;
  route.line->worst_case_us = claim.worst_case_us;
  route.line->allowed_us = claim.allowed_us;
  route.line->lower_bound_us = claim.lower_bound_us;
  route.line->urgent_worst_case_us = claim.urgent_worst_case_us;
  route.line->urgent_allowed_us = route.urgent_allowed_us;
}

void Routes::claim(std::int64_t from_ns, std::vector<std::int64_t> claimed_us,
                   std::int64_t more_pct, std::optional<MetChange> change) {
  const Guard lock(*mutex_);
  while (!claims_.empty() && claims_.back().from_ns >= from_ns) claims_.pop_back();
  claims_.push_back({from_ns, std::move(claimed_us), more_pct, change});
  if (claims_.size() > kKeptClaims) claims_.pop_front();
}

/// A result of `chain` took `us`; what `claims` says is of a change.
void Routes::meet(const Claims& claims, std::size_t chain, std::int64_t us) {
  const MetChange& change = *claims.change;
  const std::int64_t claimed_us = claims.claimed_us[chain];
  auto at = met_.end();  // among the last ones: no two changes are under way
  while (at != met_.begin() && std::prev(at)->change >= change.number) --at;
  if (at == met_.end() || at->change != change.number)
    at = met_.insert(at, {change.number, chain, us, claimed_us});
  else if (nearer(us, claimed_us, at->us, at->claimed_us))
    *at = {change.number, chain, us, claimed_us};
  if (met_.size() > kKeptSwitches) met_.pop_front();
  if (board_ != nullptr)
    board_->header().spanned.take({change.from, change.to, static_cast<std::uint32_t>(chain + 1),
                                   us, claimed_us,
                                   claimed_us + claimed_us * claims.more_pct / 100});
}

void Routes::judge() {
  const Guard lock(*mutex_);
  for (const Ended& ended : ended_) judge(ended);
  ended_.clear();
}

void Routes::judge(const Ended& ended) {
  const auto claimed = std::find_if(claims_.rbegin(), claims_.rend(), [&](const Claims& claims) {
    return claims.from_ns <= ended.origin_ns;
  });
  if (claimed == claims_.rend()) return;
  const std::int64_t claimed_us = claimed->claimed_us[ended.chain];
  if (claimed_us <= 0) return;
  if (claimed->change) meet(*claimed, ended.chain, ended.us);
  if (ended.us <= claimed_us + claimed_us * claimed->more_pct / 100) return;
  Route& route = routes_[ended.chain];
  ChainAccount& counts = route.counts;
  ++counts.over_claim;
  if (ended.us - claimed_us > counts.over_us - counts.over_claimed_us) {
    counts.over_us = ended.us;
    counts.over_claimed_us = claimed_us;
  }
  if (route.line == nullptr) return;
  route.line->over_us.store(counts.over_us, std::memory_order_relaxed);
  route.line->over_claimed_us.store(counts.over_claimed_us, std::memory_order_relaxed);
  route.line->over.fetch_add(1);
}

std::vector<Routes::Met> Routes::met() const {
  const Guard lock(*mutex_);
  return {met_.begin(), met_.end()};
}

void Routes::have(std::int64_t from_ns, std::vector<char> chains) {
  const Guard lock(*mutex_);
  while (!haves_.empty() && haves_.back().from_ns >= from_ns) haves_.pop_back();
  haves_.push_back({from_ns, std::move(chains)});
  if (haves_.size() > kKeptClaims) haves_.pop_front();
  for (std::size_t i = 0; i < routes_.size(); ++i) {
    FlowLine* line = routes_[i].line;
    const std::uint32_t gone = haves_.back().chains[i] == 0 ? 1 : 0;
    if (line == nullptr || line->gone.load() == gone) continue;
    line->gone_or_back_ns.store(from_ns);
    line->gone.store(gone);
  }
}

/// Whether the release at `origin_ns` has a table without the chain, or one that has it was followed by
/// one without, and that by one with it again.
bool Routes::was_off(const Route& route, std::int64_t origin_ns, std::int64_t now_ns) const {
  const auto chain = static_cast<std::size_t>(&route - routes_.data());
  std::int64_t until_ns = INT64_MAX;
  for (auto have = haves_.rbegin(); have != haves_.rend(); ++have) {
    if (have->chains[chain] == 0) {
      if (origin_ns - route.shift_ns >= have->from_ns) return origin_ns - route.shift_ns < until_ns;
      if (now_ns >= until_ns) return true;
    }
    if (origin_ns - route.shift_ns >= have->from_ns) return false;
    until_ns = have->from_ns;
  }
  return false;
}

/// Of the release at `origin_ns`.
void Routes::count(Route& route, std::int64_t origin_ns, std::int64_t now_ns,
                   std::optional<std::int64_t>& missed_us) {
  if (was_off(route, origin_ns, now_ns)) return;
  ChainAccount& counts = route.counts;
  const std::int64_t latency_us = (now_ns - origin_ns) / 1000;
  const Ended ended{static_cast<std::size_t>(&route - routes_.data()), origin_ns, latency_us};
  if (!may_change_) {
    judge(ended);
  } else if (!claims_.empty()) {
    ended_.push_back(ended);
    if (ended_.size() > kMostEnded) {
      judge(ended_.front());
      ended_.pop_front();
    }
  }
  counts.latency_us.add(latency_us);
  counts.longest_us = std::max(counts.longest_us, latency_us);
  if (route.line != nullptr) route.line->add(latency_us, now_ns);
  if (counts.deadline_us == 0 || latency_us <= counts.deadline_us) return;
  ++counts.deadline_misses;
  if (route.line != nullptr) route.line->late.fetch_add(1, std::memory_order_relaxed);
  missed_us = std::max(missed_us.value_or(0), latency_us);
}

void Routes::released(std::size_t source, std::int64_t origin_ns) {
  const Guard lock(*mutex_);
  newest_ns_ = origin_ns;
  for (Route& route : routes_) {
    if (route.source != source || route.period_ns == 0 || !route.here) continue;
    route.unknown.push_back(origin_ns);
    if (route.unknown.size() <= kMostUnknown) continue;
    // Whoever tells of it now comes too late for any limit.
    if (waited_for(route, route.unknown.front(), origin_ns)) lose(route.counts);
    route.unknown.pop_front();
  }
}

/// How many of the unknown releases a result knows: that of `origin_ns`, and those before it. 0: nothing new.
std::size_t Routes::newly_known(const Route& route, std::int64_t origin_ns) {
  // By its place, not by its time: a source that does not keep its jitter may release nominally before
  // what it released before.
  const auto known = std::find(route.unknown.rbegin(), route.unknown.rend(), origin_ns);
  return static_cast<std::size_t>(route.unknown.rend() - known);
}

/// What the last result says becomes as old as it gets.
void Routes::grow_old(Route& route, std::int64_t now_ns, std::optional<std::int64_t>& missed_us) {
  if (route.last_origin_ns == 0 || was_off(route, route.last_origin_ns, now_ns)) return;
  ChainAccount& counts = route.counts;
  const std::int64_t age_us = (now_ns - route.last_origin_ns) / 1000;
  counts.age_us.add(age_us);
  if (route.line != nullptr)
    route.line->max_age_us.store(counts.age_us.max(), std::memory_order_relaxed);
  if (counts.max_age_us == 0 || age_us <= counts.max_age_us) return;
  ++counts.age_misses;
  if (route.line != nullptr) route.line->old.fetch_add(1, std::memory_order_relaxed);
  missed_us = std::max(missed_us.value_or(0), age_us);
}

std::optional<std::int64_t> Routes::published(int node, std::int64_t origin_ns,
                                              const detail::Origins* origins, std::int64_t now_ns,
                                              bool urgent) {
  std::optional<std::int64_t> missed_us;
  if (!end_at(node)) return missed_us;
  const Guard lock(*mutex_);
  for (const std::size_t index : ends_[static_cast<std::size_t>(node)]) {
    Route& route = routes_[index];
    // By app.json's grid `origin_ns` is the component's release, which is not this source's.
    if (route.period_ns > 0 && route.source >= detail::kMaxOrigins) continue;
    std::int64_t origin = origin_ns;
    if (origins != nullptr && route.source < origins->size()) origin = (*origins)[route.source];
    if (origin == 0) continue;  // nothing of this sensor is in it
    const auto result_of = [&](std::int64_t release_ns) {
      if (!lockstep_ || release_ns == newest_ns_) {
        count(route, release_ns, now_ns, missed_us);
      } else if (single_rate_ &&
                 release_ns !=
                     origin) {  // one that came after it had drained knows it: it was lost
        lose(route.counts);
      } else {
        ++route.counts.not_measured;
      }
    };
    if (route.period_ns == 0) {
      result_of(origin);
    } else {
      const std::size_t known = newly_known(route, origin);
      if (known == 0) continue;
      const auto end = route.unknown.begin() + static_cast<std::ptrdiff_t>(known);
      if (route.last_origin_ns == 0 && route.through_samples) {
        route.unknown.erase(route.unknown.begin(), end);
        route.last_origin_ns = origin;
        continue;
      }
      if (urgent && route.hurries) {
        const std::int64_t urgent_us = (now_ns - origin) / 1000;
        ChainAccount& counts = route.counts;
        counts.urgent_us.add(urgent_us);
        counts.longest_urgent_us = std::max(counts.longest_urgent_us, urgent_us);
        if (counts.urgent_worst_case_us > 0 && urgent_us > route.urgent_allowed_us)
          counts.urgent_exceeded = true;
        if (route.line != nullptr) route.line->add_urgent(urgent_us);
      }
      for (auto release = end; release != route.unknown.begin();) result_of(*--release);
      route.unknown.erase(route.unknown.begin(), end);
    }
    // In an app of one rate it is how long a release took; with several, for how long nobody released.
    const bool ages = !lockstep_ || (single_rate_ && route.period_ns == 0);
    if (ages) grow_old(route, now_ns, missed_us);
    route.last_origin_ns = origin;
    if (ages && route.line != nullptr)
      route.line->last_origin_ns.store(origin, std::memory_order_relaxed);
  }
  return missed_us;
}

/// A release has no result, and never will.
void Routes::lose(ChainAccount& counts) {
  ++counts.lost;
  counts.deadline_misses += counts.deadline_us > 0 ? 1 : 0;
}

/// Whether a release that no result knows should have had one.
bool Routes::waited_for(const Route& route, std::int64_t origin_ns, std::int64_t now_ns) const {
  if (lockstep_ && !single_rate_) return false;  // time between releases means nothing
  return (route.last_origin_ns != 0 || !route.through_samples) &&
         !was_off(route, origin_ns, now_ns);
}

/// Releases that no result knows, and that were older than `limit_ns` when it was over.
std::uint64_t Routes::unanswered(const Route& route, std::int64_t over_ns,
                                 std::int64_t limit_ns) const {
  return static_cast<std::uint64_t>(std::count_if(
      route.unknown.begin(), route.unknown.end(),
      [&](std::int64_t at) { return over_ns - at > limit_ns && waited_for(route, at, over_ns); }));
}

/// Adds what is left without a result at the end.
void Routes::lose_rest(const Route& route, const std::vector<std::uint64_t>& lost,
                       const Unended* unended, const std::vector<std::int64_t>& newest_ns,
                       ChainAccount& into) const {
  const auto module = static_cast<std::size_t>(route.module);
  const std::int64_t limit_ns = into.deadline_us * 1000;
  if (route.period_ns == 0) {  // by activations
    into.lost = lost[module] + (unended != nullptr ? unended->of_module[module] : 0);
    if (into.deadline_us == 0) return;
    if (single_rate_) into.deadline_misses += lost[module];
    if (unended == nullptr || route.source >= newest_ns.size() || newest_ns[route.source] == 0)
      return;
    if (unended->at_ns - newest_ns[route.source] > limit_ns)
      into.deadline_misses += unended->of_module[module];
    return;
  }
  // At several rates, and behind samples, nobody need know of what was released last: who would tell of it is not
  // released any more. A run that gave up has no such end.
  const std::int64_t newest_of_all_ns =
      newest_ns.empty() ? 0 : *std::ranges::max_element(newest_ns);
  const bool ends_early = route.through_samples || (unended == nullptr && !single_rate_);
  const std::int64_t over_ns = ends_early           ? newest_of_all_ns
                               : unended != nullptr ? unended->at_ns
                                                    : kForGood;
  const std::int64_t may_wait_ns =
      1000 * std::max({into.deadline_us, into.worst_case_us, into.longest_us});
  into.lost += unanswered(route, over_ns, ends_early ? may_wait_ns : 0);
  if (into.deadline_us > 0) into.deadline_misses += unanswered(route, over_ns, limit_ns);
}

std::vector<ChainAccount> Routes::report(const std::vector<std::uint64_t>& lost,
                                         const Unended* unended,
                                         const std::vector<std::int64_t>& newest_ns) const {
  std::vector<ChainAccount> result;
  const Guard lock(*mutex_);
  for (const Route& route : routes_) {
    result.push_back(route.counts);
    if (!route.here) continue;
    lose_rest(route, lost, unended, newest_ns, result.back());
  }
  return result;
}

}  // namespace xauto::runtime
