// SPDX-License-Identifier: Apache-2.0
#include "model/policy.h"

#include <algorithm>
#include <map>
#include <numeric>

#include "base/index.h"
#include "model/components.h"
#include "model/contention.h"
#include "model/hosts.h"
#include "model/refusal.h"

namespace xauto {
namespace {

const char* const kHint =
    "solve again: `xauto solve --app app.json --platform ... --out policy.json`";

class Validation {
 public:
  Validation(const Policy& policy, const AppSpec& app, const Platform& platform,
             const Components& components)
      : policy_(policy), app_(app), platform_(platform), components_(components) {}

  /// Of a policy of priorities: on each XPU each once, and nothing is claimed.
  [[nodiscard]] Status priorities() const {
    std::map<std::pair<int, std::int64_t>, std::size_t> first;
    for (std::size_t i = 0; i < policy_.placements.size(); ++i) {
      XAUTO_TRY(on_an_xpu(i));
      const Placement& p = policy_.placements[i];
      if (!p.priority || !p.key_us.empty() || !p.hold_us.empty())
        return invalid(who(i) + "has keys, and others have priorities", place(i, "key_us"),
                       "give each XNode a priority, or each keys");
      if (!p.start_us.empty() || !p.finish_us.empty())
        return invalid(who(i) + "has predicted times and a priority: no time is known of it",
                       place(i, "start_us"));
      if (*p.priority < -kMaxTimeUs || *p.priority > kMaxTimeUs)
        return invalid(who(i) + "has priority " + std::to_string(*p.priority) + ", out of range",
                       place(i, "priority"));
      const auto [other, added] = first.try_emplace({p.xpu, *p.priority}, i);
      if (!added)
        return invalid(who(i) + "has priority " + std::to_string(*p.priority) + " on " +
                           platform_.xpus[at(p.xpu)].id + ", as '" +
                           app_.xnodes[other->second].name + "' has",
                       place(i, "priority"), "priorities are unique per XPU instance");
    }
    if (policy_.certified || !policy_.chains.empty())
      return invalid("priorities are not certified: nothing can be claimed of them", "/certified",
                     "say \"certified\": false, and leave \"chains\" out");
    return {};
  }

  [[nodiscard]] Status placements() const {
    for (std::size_t i = 0; i < policy_.placements.size(); ++i) {
      XAUTO_TRY(on_an_xpu(i));
      XAUTO_TRY(arrays(i));
      for (std::size_t j = 0; j < policy_.placements[i].key_us.size(); ++j) XAUTO_TRY(job(i, j));
      XAUTO_TRY(keys_do_not_fall(i));
    }
    return {};
  }

  /// A successor becomes ready by its predecessor's key plus the transfer, and then has to run.
  [[nodiscard]] Status edges() const {
    std::vector<std::int64_t> transfer = transfers_us(policy_, app_, platform_);
    std::vector<std::pair<int, int>> waits = app_.edges;
    waits.insert(waits.end(), policy_.order.begin(), policy_.order.end());
    transfer.resize(waits.size(), 0);
    for (std::size_t e = 0; e < waits.size(); ++e) {
      const auto [u, v] = waits[e];
      const auto &before = policy_.placements[at(u)].key_us,
                 &after = policy_.placements[at(v)].key_us;
      // Entries i of u and j of v are of one activation, now and then, iff they are congruent
      // modulo what the sizes have in common.
      const std::size_t common = std::gcd(before.size(), after.size());
      std::vector<std::int64_t> latest(common, 0);
      for (std::size_t i = 0; i < before.size(); ++i)
        latest[i % common] = std::max(latest[i % common], before[i]);
      for (std::size_t j = 0; j < after.size(); ++j) {
        const std::int64_t least = latest[j % common] + transfer[e] + wcet(at(v));
        if (after[j] < least)
          return invalid(who(at(v)) + "has key " + std::to_string(after[j]) + " us; after '" +
                             app_.xnodes[at(u)].name + "' (key " +
                             std::to_string(latest[j % common]) + " us) it ends at " +
                             std::to_string(least) + " us or later",
                         place(at(v), "key_us", j));
      }
    }
    return {};
  }

  [[nodiscard]] Status order() const {
    std::vector<int> xpu_of;
    for (const Placement& p : policy_.placements) xpu_of.push_back(p.xpu);
    XAUTO_TRY(validate_order(policy_.order, xpu_of, app_));
    for (std::size_t k = 0; k < policy_.order.size(); ++k)
      if (const auto [u, v] = policy_.order[k];
          !released_together(components_, components_.of[at(u)], components_.of[at(v)]))
        return invalid("'" + app_.xnodes[at(u)].name + "' before '" + app_.xnodes[at(v)].name +
                           "': they are not released together, so no activations belong together",
                       "/order/" + std::to_string(k),
                       "order is between XNodes of one clock, one period and one offset");
    return {};
  }

  /// Those that the places ask for, and no other ones; not shorter than the links say.
  [[nodiscard]] Status crossings() const {
    XAUTO_ASSIGN(const std::vector<Crossing> needed, crossings_of(app_, platform_, policy_));
    for (std::size_t k = 0; k < policy_.crossings.size(); ++k) {
      const Crossing& c = policy_.crossings[k];
      const std::string where = "/crossings/" + std::to_string(k);
      if (k >= needed.size() || c.from != needed[k].from || c.host != needed[k].host)
        return invalid(
            "is no message that the places ask for, or not in the order of XNodes and hosts", where,
            kHint);
      if (c.x_us < needed[k].x_us || c.x_us > kMaxTimeUs)
        return invalid("is " + std::to_string(c.x_us) + " us; the link takes " +
                           std::to_string(needed[k].x_us) + " us or more",
                       where + "/x_us", kHint);
    }
    if (policy_.crossings.size() < needed.size())
      return invalid("lacks what '" + app_.xnodes[at(needed[policy_.crossings.size()].from)].name +
                         "' sends to host '" +
                         platform_.hosts[at(needed[policy_.crossings.size()].host)].name + "'",
                     "/crossings", kHint);
    return {};
  }

  [[nodiscard]] Status chains() const {
    if (!policy_.certified)
      return policy_.chains.empty()
                 ? Status()
                 : invalid("claims something, and it is not certified", "/chains", kHint);
    if (policy_.chains.size() != app_.chains.size())
      return invalid("has " + std::to_string(policy_.chains.size()) + " chains, the app has " +
                         std::to_string(app_.chains.size()),
                     "/chains");
    const auto is_time = [](std::int64_t us) { return us >= 0 && us <= kMaxTimeUs; };
    for (std::size_t k = 0; k < policy_.chains.size(); ++k) {
      const ChainClaim& claim = policy_.chains[k];
      if (claim.name != app_.chains[k].name)
        return invalid("is '" + claim.name + "', the app's is '" + app_.chains[k].name + "'",
                       "/chains/" + std::to_string(k) + "/name");
      if (!is_time(claim.worst_case_us) || !is_time(claim.lower_bound_us))
        return invalid("chain '" + claim.name + "' has a time out of range", "/chains");
      const bool urgent = app_.sources[at(app_.chains[k].from)].urgent.has_value();
      if (claim.urgent_worst_case_us.has_value() != urgent)
        return invalid("chain '" + claim.name +
                           (urgent ? "' has no urgent_worst_case_us, and its source may be urgent"
                                   : "' has urgent_worst_case_us, and its source is never urgent"),
                       "/chains/" + std::to_string(k), kHint);
      if (claim.urgent_worst_case_us && !is_time(*claim.urgent_worst_case_us))
        return invalid("chain '" + claim.name + "' has a time out of range", "/chains");
    }
    return {};
  }

 private:
  [[nodiscard]] std::string who(std::size_t i) const {
    return "XNode '" + app_.xnodes[i].name + "' ";
  }
  [[nodiscard]] static std::string place(std::size_t i, const char* key) {
    return "/xnodes/" + std::to_string(i) + "/" + key;
  }
  [[nodiscard]] static std::string place(std::size_t i, const char* key, std::size_t j) {
    return place(i, key) + "/" + std::to_string(j);
  }
  [[nodiscard]] const std::string& type(int i) const {
    return platform_.xpus[at(policy_.placements[at(i)].xpu)].type;
  }
  /// What a job has to have time for before its key: nothing where no key is a claim.
  [[nodiscard]] std::int64_t wcet(std::size_t i) const {
    return !policy_.certified ? 0 : counted_wcet_us(app_, platform_, policy_, i);
  }

  [[nodiscard]] Status on_an_xpu(std::size_t i) const {
    const Placement& p = policy_.placements[i];
    if (p.xpu < 0 || at(p.xpu) >= platform_.xpus.size())
      return invalid(who(i) + "is on no XPU of platform '" + platform_.name + "'", place(i, "xpu"));
    const Xpu& xpu = platform_.xpus[at(p.xpu)];
    if (!app_.xnodes[i].wcet_on(xpu.type))
      return invalid(
          who(i) + "is on " + xpu.id + " but has no implementation for '" + xpu.type + "'",
          place(i, "xpu"));
    return {};
  }

  [[nodiscard]] Status counted(std::size_t i) const {
    const Placement& p = policy_.placements[i];
    const XNodeSpec& x = app_.xnodes[i];
    const std::string& on = type(static_cast<int>(i));
    const bool stated = policy_.certified && !stated_loads(x, on).empty();
    if (p.wcet_us.has_value() != stated)
      return invalid(who(i) + (stated ? "does not say which WCET is counted, and states several"
                                      : "has a WCET here that nothing is claimed of"),
                     place(i, "wcet_us"), kHint);
    if (p.wcet_us && (*p.wcet_us < x.wcet_on(on).value_or(0) || *p.wcet_us > longest_wcet(x, on)))
      return invalid(who(i) + "counts " + std::to_string(*p.wcet_us) + " us; the app states " +
                         std::to_string(x.wcet_on(on).value_or(0)) + " to " +
                         std::to_string(longest_wcet(x, on)) + " us",
                     place(i, "wcet_us"), kHint);
    return {};
  }

  [[nodiscard]] Status arrays(std::size_t i) const {
    const Placement& p = policy_.placements[i];
    if (p.priority)
      return invalid(who(i) + "has a priority, and others have keys", place(i, "priority"),
                     "give each XNode a priority, or each keys");
    if (p.key_us.empty()) return invalid(who(i) + "has no key", place(i, "key_us"));
    XAUTO_TRY(counted(i));
    const Component& component = components_.components[at(components_.of[i])];
    const auto size = static_cast<std::int64_t>(p.key_us.size());
    if (size > 1 && (component.activations == 0 || component.activations % size != 0))
      return invalid(
          who(i) + "has " + std::to_string(size) + " keys; " +
              (component.activations == 0
                   ? "its clock's hyperperiod is beyond 64 bits, so one is possible"
                   : "possible is what divides its " + std::to_string(component.activations) +
                         " activations per hyperperiod"),
          place(i, "key_us"));
    const auto fits = [&](const std::vector<std::int64_t>& times) {
      return times.empty() || times.size() == p.key_us.size();
    };
    for (const auto& [key, times] :
         {std::pair("hold_us", &p.hold_us), {"start_us", &p.start_us}, {"finish_us", &p.finish_us}})
      if (!fits(*times))
        return invalid(who(i) + "has " + std::to_string(times->size()) + " times here and " +
                           std::to_string(size) + " keys",
                       place(i, key));
    if (p.start_us.size() != p.finish_us.size())
      return invalid(who(i) + "has start_us and finish_us, or neither", place(i, "start_us"));
    return {};
  }

  /// Entry j by itself: it is released, held, and run for its WCET before its key.
  [[nodiscard]] Status job(std::size_t i, std::size_t j) const {
    const Placement& p = policy_.placements[i];
    const std::int64_t key = p.key_us[j], hold = p.hold_us.empty() ? 0 : p.hold_us[j];
    if (key < 1 || key > kMaxTimeUs)
      return invalid(who(i) + "has key " + std::to_string(key) + ", which is no time from 1 to " +
                         std::to_string(kMaxTimeUs) + " us",
                     place(i, "key_us", j));
    if (hold < 0 || hold > kMaxTimeUs)
      return invalid(who(i) + "is held for " + std::to_string(hold) + ", which is no time",
                     place(i, "hold_us", j));
    const Component& component = components_.components[at(components_.of[i])];
    std::int64_t ready = hold;
    for (const int s : app_.xnodes[i].sources) {
      const SourceSpec& source = app_.sources[at(s)];
      ready = std::max(ready, source.offset_us - component.offset_us + source.jitter_us);
    }
    if (key < ready + wcet(i))
      return invalid(who(i) + "has key " + std::to_string(key) + " us, is ready by " +
                         std::to_string(ready) + " us and takes " + std::to_string(wcet(i)) + " us",
                     place(i, "key_us", j));
    if (p.start_us.empty()) return {};
    const std::int64_t start = p.start_us[j], finish = p.finish_us[j];
    if (start < hold || finish < start || finish > key)
      return invalid(who(i) + "has start " + std::to_string(start) + " us and finish " +
                         std::to_string(finish) + " us, which are not between hold and key",
                     place(i, "finish_us", j));
    return {};
  }

  /// nT + d of activation n, from one to the next: then activations end in order.
  [[nodiscard]] Status keys_do_not_fall(std::size_t i) const {
    const std::vector<std::int64_t>& key = policy_.placements[i].key_us;
    const Period period = components_.components[at(components_.of[i])].period;
    for (std::size_t j = 0; j < key.size(); ++j) {
      const std::size_t next = (j + 1) % key.size();
      if (static_cast<__int128>(key[next] - key[j]) * period.den + period.num >= 0) continue;
      return invalid(who(i) + "has key " + std::to_string(key[next]) + " us a period (" +
                         period.text() + ") after key " + std::to_string(key[j]) +
                         " us: activations would end out of order",
                     place(i, "key_us", next));
    }
    return {};
  }

  const Policy& policy_;
  const AppSpec& app_;
  const Platform& platform_;
  const Components& components_;
};

}  // namespace

Status validate(const Policy& policy, const AppSpec& app, const Platform& platform) {
  if (policy.app != app.name)
    return invalid("is for app '" + policy.app + "', this is '" + app.name + "'", "/app", kHint);
  if (policy.app_hash != app.hash())
    return invalid("is '" + policy.app_hash + "', the app's is '" + app.hash() +
                       "': the policy was made for another version of the app",
                   "/app_hash", kHint);
  if (policy.placements.size() != app.xnodes.size())
    return invalid("places " + std::to_string(policy.placements.size()) + " XNodes, the app has " +
                       std::to_string(app.xnodes.size()),
                   "/xnodes");
  XAUTO_ASSIGN(const Components components, find_components(app));
  const Validation validation(policy, app, platform, components);
  XAUTO_TRY(policy.by_priority() ? validation.priorities() : validation.placements());
  XAUTO_TRY(validation.order());
  XAUTO_TRY(validation.crossings());
  if (!policy.by_priority()) {
    XAUTO_TRY(validation.edges());
    XAUTO_TRY(validation.chains());
  }
  if (policy.solve_us < 0)
    return invalid(std::to_string(policy.solve_us) + " is no time", "/solve_us");
  return {};
}

std::vector<std::int64_t> worst_cases(const Policy& policy) {
  std::vector<std::int64_t> us;
  for (const ChainClaim& claim : policy.chains) us.push_back(claim.worst_case_us);
  return us;
}

bool misses_a_deadline(const Policy& policy, const AppSpec& app) {
  for (std::size_t c = 0; c < policy.chains.size(); ++c)
    if (app.chains[c].deadline_us && policy.chains[c].worst_case_us > *app.chains[c].deadline_us)
      return true;
  return false;
}

std::vector<std::int64_t> transfers_us(const Policy& policy, const AppSpec& app,
                                       const Platform& platform) {
  const auto type = [&](int i) -> const std::string& {
    return platform.xpus[at(policy.placements[at(i)].xpu)].type;
  };
  std::vector<std::int64_t> transfer(app.edges.size(), 0);
  for (const TransferSpec& t : app.transfers) {
    const auto [u, v] = app.edges[at(t.edge)];
    if (t.from_type == type(u) && t.to_type == type(v)) transfer[at(t.edge)] = t.transfer_us;
  }
  if (policy.crossings.empty()) return transfer;
  for (std::size_t e = 0; e < app.edges.size(); ++e) {
    const auto [u, v] = app.edges[e];
    const int to = platform.xpus[at(policy.placements[at(v)].xpu)].host;
    for (const Crossing& c : policy.crossings)
      if (c.from == u && c.host == to) transfer[e] += c.x_us;
  }
  return transfer;
}

PriorityPlan assignment_of(const Policy& keys) {
  PriorityPlan policy;
  policy.app = keys.app;
  policy.app_hash = keys.app_hash;
  policy.platform = keys.platform;
  policy.method = keys.method;
  policy.order = keys.order;
  policy.solve_us = keys.solve_us;
  std::vector<std::size_t> by_key(keys.placements.size());
  std::iota(by_key.begin(), by_key.end(), std::size_t{0});
  policy.placements.resize(keys.placements.size());
  if (keys.by_priority()) {
    for (std::size_t i = 0; i < keys.placements.size(); ++i)
      policy.placements[i] = {keys.placements[i].xpu, keys.placements[i].priority.value_or(0)};
    return policy;
  }
  std::stable_sort(by_key.begin(), by_key.end(), [&](std::size_t a, std::size_t b) {
    return keys.placements[a].key_us.front() > keys.placements[b].key_us.front();
  });
  for (std::size_t rank = 0; rank < by_key.size(); ++rank) {
    PriorityPlacement& placement = policy.placements[by_key[rank]];
    placement.xpu = keys.placements[by_key[rank]].xpu;
    placement.priority = static_cast<std::int64_t>(rank) + 1;
  }
  return policy;
}

Policy held_in_place_of_order(Policy policy, const std::function<bool(int xpu)>& of) {
  std::erase_if(policy.order, [&](const std::pair<int, int>& pair) {
    const Placement& u = policy.placements[at(pair.first)];
    Placement& v = policy.placements[at(pair.second)];
    if (!of(v.xpu)) return false;
    // Sizes divide the activations of a hyperperiod, so what they come round in does, too.
    const std::size_t size = std::lcm(u.key_us.size(), v.key_us.size());
    std::vector<std::int64_t> keys(size), held(size);
    for (std::size_t j = 0; j < size; ++j) {
      keys[j] = v.key_us[j % v.key_us.size()];
      const std::int64_t before = v.hold_us.empty() ? 0 : v.hold_us[j % v.hold_us.size()];
      held[j] = std::max(before, u.key_us[j % u.key_us.size()]);
    }
    v.key_us = std::move(keys);
    v.hold_us = std::move(held);
    v.start_us.clear();  // was predicted without the hold
    v.finish_us.clear();
    return true;
  });
  return policy;
}

Policy by_priorities(const PriorityPlan& plan, const AppSpec& app) {
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.platform = plan.platform;
  policy.method = plan.method;
  policy.order = plan.order;
  policy.solve_us = plan.solve_us;
  policy.certified = false;
  for (const PriorityPlacement& placed : plan.placements) {
    policy.placements.push_back({placed.xpu, {}});
    policy.placements.back().priority = placed.priority;
  }
  return policy;
}

}  // namespace xauto
