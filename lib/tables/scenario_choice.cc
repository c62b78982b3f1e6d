// SPDX-License-Identifier: Apache-2.0
#include "tables/scenario_choice.h"

#include <algorithm>
#include <utility>

namespace xauto::runtime {
namespace {

constexpr std::int64_t kLongestDwells = 64;  ///< what trials that fail grow the dwell to

}  // namespace

ScenarioChoice::ScenarioChoice(const AppSpec& app, const Platform& platform, const Tables& tables,
                               const Allow& allow, const ChoiceOptions& options)
    : options_(options),
      order_(std::make_shared<const ScenarioOrder>(app, tables)),
      dwell_ns_(options.dwell_ns) {
  const std::vector<std::string> types = platform.types();
  const auto type_of = [&](const std::string& type) {
    return static_cast<int>(std::find(types.begin(), types.end(), type) - types.begin());
  };
  for (std::size_t s = 0; s < tables.scenarios.size(); ++s) {
    table_.push_back(tables.serves[s].table);
    auto& rows = allowed_ns_.emplace_back();
    for (const XNodeSpec& xnode : app_under(app, tables.scenarios[s]).xnodes) {
      auto& row = rows.emplace_back();
      for (int variant = -1; variant < static_cast<int>(xnode.variants.size()); ++variant)
        for (const std::string& type : types) {
          const auto wcet = wcet_of(xnode, variant, type);
          row.push_back(wcet ? allow(type, *wcet) : 0);
        }
    }
  }
  gone_.assign(platform.xpus.size(), 0);
  for (const Scenario& scenario : tables.scenarios) {
    auto& row = lost_.emplace_back(platform.xpus.size(), 0);
    for (std::size_t x = 0; x < platform.xpus.size(); ++x)
      row[x] = std::count(scenario.lost.begin(), scenario.lost.end(), platform.xpus[x].id) > 0;
  }
  const int forms = static_cast<int>(types.size());
  for (const Table& table : tables.tables) {
    auto& xpu = xpu_.emplace_back();
    auto& row = form_.emplace_back();
    for (std::size_t x = 0; x < table.keys.placements.size(); ++x) {
      xpu.push_back(table.xpu(x));
      row.push_back(table.xpu(x) < 0
                        ? -1
                        : (table.loss.variant_of(x) + 1) * forms +
                              type_of(platform.xpus[static_cast<std::size_t>(table.xpu(x))].type));
    }
  }
  for (const auto& row : allowed_ns_.front()) recent_ns_.emplace_back(row.size(), 0);
  older_ns_ = recent_ns_;
  now_.table = table_.front();
}

void ScenarioChoice::ask(int scenario) {
  if (scenario >= static_cast<int>(table_.size())) scenario = -1;
  if (scenario != asked_) std::fill(gone_.begin(), gone_.end(), 0);  // who asks knows
  asked_anew_ = asked_anew_ || scenario != asked_;
  asked_ = scenario;
}

void ScenarioChoice::expect(int scenario) {
  expected_ = scenario < static_cast<int>(table_.size()) ? scenario : -1;
}

void ScenarioChoice::saw(int table, std::size_t xnode, std::int64_t ns) {
  // What a table has off had its job before: of the table before, of which all had ended.
  const int xpu = xpu_[static_cast<std::size_t>(table)][xnode];
  if (xpu < 0 || gone_[static_cast<std::size_t>(xpu)] != 0) return;
  const int form = form_[static_cast<std::size_t>(table)][xnode];
  std::int64_t& longest = recent_ns_[xnode][static_cast<std::size_t>(form)];
  longest = std::max(longest, ns);
}

void ScenarioChoice::hung(int table, std::size_t xnode) {
  const int xpu = xpu_[static_cast<std::size_t>(table)][xnode];
  if (xpu < 0) return;
  const auto at = static_cast<std::size_t>(xpu);
  if (std::exchange(gone_[at], char{1}) != 0) return;
  if (order_->least([&](std::size_t s) { return does_without_gone(s); }) < 0) {
    gone_[at] = 0;  // no scenario is for that: see the hang limit
    return;
  }
  hung_ = {static_cast<int>(xnode), xpu};
  // What jobs took there is no evidence of a clock.
  const std::vector<int>& where = xpu_[static_cast<std::size_t>(table)];
  for (std::size_t x = 0; x < where.size(); ++x) {
    if (where[x] != xpu) continue;
    const auto form = static_cast<std::size_t>(form_[static_cast<std::size_t>(table)][x]);
    recent_ns_[x][form] = older_ns_[x][form] = 0;
  }
}

bool ScenarioChoice::does_without_gone(std::size_t scenario) const {
  for (std::size_t x = 0; x < gone_.size(); ++x)
    if (gone_[x] != 0 && lost_[scenario][x] == 0) return false;
  return true;
}

bool ScenarioChoice::on_floor(std::size_t scenario) const {
  return does_without_gone(scenario) &&
         (asked_ < 0 || order_->covers(scenario, static_cast<std::size_t>(asked_))) &&
         (expected_ < 0 || order_->covers(scenario, static_cast<std::size_t>(expected_)));
}

/// `f`(what was seen, by how much it is longer than the scenario allows, as a factor).
template <class F>
void ScenarioChoice::each_seen(std::size_t scenario, F f) const {
  for (std::size_t x = 0; x < recent_ns_.size(); ++x)
    for (std::size_t t = 0; t < recent_ns_[x].size(); ++t) {
      const Evidence seen{x, static_cast<int>(t), std::max(recent_ns_[x][t], older_ns_[x][t])};
      if (seen.ns > 0)
        f(seen, static_cast<double>(seen.ns) / static_cast<double>(allowed(scenario, seen)));
    }
}

ScenarioChoice::Passed ScenarioChoice::passed(std::size_t scenario) const {
  Passed passed;
  each_seen(scenario, [&](const Evidence& seen, double factor) {
    passed.excess += std::max(0.0, factor - 1);
    if (factor <= passed.factor) return;
    passed.factor = factor;
    passed.worst = seen;
  });
  return passed;
}

std::vector<Passing> ScenarioChoice::passing(int scenario) const {
  const auto of = static_cast<std::size_t>(scenario);
  std::vector<Passing> all;
  double most = 1;
  each_seen(of, [&](const Evidence& seen, double factor) {
    const int xnode = static_cast<int>(seen.xnode);
    const bool another = all.empty() || all.back().xnode != xnode;
    if (factor <= (another ? 1 : most)) return;
    if (another) all.emplace_back();
    all.back() = {xnode, seen.ns, allowed(of, seen)};
    most = factor;
  });
  return all;
}

bool ScenarioChoice::fits(std::size_t scenario, std::int64_t margin_pct) const {
  return passed(scenario).factor <= static_cast<double>(100 - margin_pct) / 100;
}

void ScenarioChoice::put(int scenario, Why why, std::int64_t now_ns) {
  // A trial that failed: the next one comes later. One that held for long: all is as it was.
  if ((why == Why::kOverrun || why == Why::kOutside) && now_.why == Why::kBack) {
    const bool soon = now_ns - since_ns_ < 4 * dwell_ns_;
    dwell_ns_ =
        soon ? std::min(2 * dwell_ns_, kLongestDwells * options_.dwell_ns) : options_.dwell_ns;
  }
  now_ = {scenario, 0, why};
  now_.table = table_[static_cast<std::size_t>(scenario)];
  since_ns_ = now_ns;
}

/// Evidence counts for a dwell at least, and for two at most.
void ScenarioChoice::age(std::int64_t now_ns) {
  if (!begun_) span_since_ns_ = since_ns_ = now_ns;
  begun_ = true;
  if (now_ns - span_since_ns_ < dwell_ns_) return;
  const bool long_ago = now_ns - span_since_ns_ >= 2 * dwell_ns_;
  std::swap(older_ns_, recent_ns_);
  for (auto& row : recent_ns_) std::fill(row.begin(), row.end(), 0);
  if (long_ago)
    for (auto& row : older_ns_) std::fill(row.begin(), row.end(), 0);
  span_since_ns_ = now_ns;
}

/// The least one that covers the floor and fits the evidence; -1: there is none.
int ScenarioChoice::next_scenario() const {
  const auto current = static_cast<std::size_t>(now_.scenario);
  const auto may = [&](std::size_t s) { return on_floor(s) && fits(s, 0); };
  // What held before still holds, as far as anybody knows. Where nothing covers that as well, and where
  // it was a guess, what was seen decides.
  if (now_.why != Why::kOutside)
    if (const int next =
            order_->least([&](std::size_t s) { return may(s) && order_->covers(s, current); });
        next >= 0)
      return next;
  return order_->least(may);
}

/// The one that covers most, by what jobs pass it, all of them added up: one job that a stall made longer
/// must not hide that a whole XPU is slow. Where none covers both what the machine says and what people
/// ask for, they give way: the machine is as it is, and jobs may fit that.
int ScenarioChoice::last_resort() const {
  const auto of_machine = [&](std::size_t s) {
    return expected_ < 0 || order_->covers(s, static_cast<std::size_t>(expected_));
  };
  const bool floor = order_->least([&](std::size_t s) { return on_floor(s); }) >= 0;
  if (!floor)
    if (const int fit = order_->least([&](std::size_t s) { return of_machine(s) && fits(s, 0); });
        fit >= 0)
      return fit;
  return order_->most([&](std::size_t s) { return floor ? on_floor(s) : of_machine(s); },
                      [&](std::size_t s) { return passed(s).excess; });
}

/// The job by which what was seen passes the scenario `judged`.
void ScenarioChoice::blame(const Evidence& seen, int judged) {
  now_.xnode = static_cast<int>(seen.xnode);
  now_.saw_ns = seen.ns;
  now_.allowed_ns = allowed(static_cast<std::size_t>(judged), seen);
}

void ScenarioChoice::lose(int scenario, std::int64_t now_ns) {
  put(scenario, Why::kLost, now_ns);
  const Hung hung = std::exchange(hung_, {});
  now_.xnode = hung.xnode;
  now_.xpu = hung.xpu;
}

bool ScenarioChoice::holds() const {
  const auto current = static_cast<std::size_t>(now_.scenario);
  return on_floor(current) && fits(current, 0);
}

Choice ScenarioChoice::foresee(std::int64_t now_ns) const {
  ScenarioChoice next = *this;
  next.decide(now_ns);
  return next.now();
}

bool ScenarioChoice::decide(std::int64_t now_ns) {
  const int before = now_.scenario;
  const auto current = static_cast<std::size_t>(before);
  const bool anew = std::exchange(asked_anew_, false);
  const Passed by = passed(current);
  const bool fitted = by.factor <= 1;
  if (fitted && on_floor(current)) {
    if (hung_.xpu >= 0)
      lose(before, now_ns);  // and it was left already
    else if (now_.why == Why::kOutside)
      put(before, Why::kBack, now_ns);  // it was a guess, and holds
    if (anew || now_ns - since_ns_ >= dwell_ns_) {
      const int lower = order_->least([&](std::size_t s) {
        return on_floor(s) && order_->less(s, current) && fits(s, options_.margin_pct);
      });
      if (lower >= 0) put(lower, anew ? Why::kAsked : Why::kBack, now_ns);
    }
  } else if (const int next = next_scenario(); next >= 0) {
    if (hung_.xpu >= 0) {
      lose(next, now_ns);
    } else {
      put(next, !fitted ? Why::kOverrun : anew ? Why::kAsked : Why::kMachine, now_ns);
      if (!fitted) blame(by.worst, before);
    }
  } else {
    const int most = last_resort();
    if (now_.why != Why::kOutside || most != before) put(most, Why::kOutside, now_ns);
    if (const Passed still = passed(static_cast<std::size_t>(most)); still.factor > 1)
      blame(still.worst, most);
  }
  age(now_ns);
  return now_.scenario != before;
}

}  // namespace xauto::runtime
