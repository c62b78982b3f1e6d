// SPDX-License-Identifier: Apache-2.0
#include "solver/keys/hosts.h"

#include <algorithm>
#include <chrono>
#include <map>
#include <set>
#include <tuple>
#include <utility>

#include "base/index.h"
#include "model/contention.h"
#include "model/hosts.h"

namespace xauto::solver::keys {
namespace {

// Parts of the limit; chosen, not tuned.
constexpr double kForAnywhere = 0.25;   ///< all modules anywhere
constexpr double kForEachHosts = 0.03;  ///< to try hosts of modules
constexpr double kForHosts = 0.6;       ///< until then, with the part before
constexpr double kLeastTryS = 0.1;

/// [module] index into Platform::hosts, -1: any.
using Hosts = std::vector<int>;

struct Expanded {
  AppSpec app;
  Platform platform;
  Objectives wishes;
};

/// AppSpec and Platform with a type for each type on each host.
class Expanding {
 public:
  Expanding(const AppSpec& app, const Platform& platform, const Objectives& wishes,
            const std::vector<int>& module_of)
      : app_(app), platform_(platform), wishes_(wishes), module_of_(module_of) {}

  /// `crossings`: null: each message has its link alone.
  [[nodiscard]] Result<Expanded> on(const Hosts& hosts,
                                    const std::vector<Crossing>* crossings) const {
    Expanded world{at_longest(app_), platform_, wishes_};  // nobody counts who meets whom
    for (Xpu& xpu : world.platform.xpus) {
      xpu.preempt_us = in_fast_time(xpu.preempt_us, platform_.hosts[at(xpu.host)].rate_ppm);
      xpu.type = type_on(xpu.type, xpu.host);
    }
    for (ModuleSpec& module : world.app.modules) module.host.clear();
    drift(world.app);
    XAUTO_TRY(implementations(hosts, world.app));
    types_of_wishes(world.wishes);
    world.app.transfers.clear();
    for (std::size_t e = 0; e < app_.edges.size(); ++e) transfers(e, hosts, crossings, world.app);
    if (crossings == nullptr) return world;
    for (const auto& [u, v] : app_.samples)
      world.app.sample_us.push_back(crosses(u, hosts[at(module_of_[at(v)])], crossings));
    return world;
  }

 private:
  [[nodiscard]] std::string type_on(const std::string& type, int host) const {
    return type + "@" + platform_.hosts[at(host)].name;
  }

  [[nodiscard]] bool may_be(int xnode, int host, const Hosts& hosts) const {
    const int only = hosts[at(module_of_[at(xnode)])];
    return only < 0 || only == host;
  }

  [[nodiscard]] std::int64_t worst_rate() const {
    std::int64_t most = 0;
    for (const Host& host : platform_.hosts) most = std::max(most, host.rate_ppm);
    return most;
  }

  /// Any host may read any clock; that of "main" is its own.
  void drift(AppSpec& app) const {
    const std::int64_t most = worst_rate();
    if (most == 0) return;
    for (std::size_t c = 1; c < app.clocks.size(); ++c)
      app.clocks[c].ppm = in_fast_time(app.clocks[c].ppm + most, most);
  }

  [[nodiscard]] bool forbidden(const std::string& xnode, const std::string& type) const {
    const auto of_type = [&](const std::pair<std::string, std::string>& one) {
      return one.first == xnode && platform_.find(one.second) < 0;
    };
    return std::ranges::any_of(
               wishes_.pins, [&](const auto& one) { return of_type(one) && one.second != type; }) ||
           std::ranges::any_of(wishes_.forbids,
                               [&](const auto& one) { return of_type(one) && one.second == type; });
  }

  Status implementations(const Hosts& hosts, AppSpec& app) const {
    for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
      XNodeSpec& x = app.xnodes[i];
      x.variants.clear();
      x.memory_kb.clear();
      x.real_on.clear();
      const auto wcets = std::exchange(x.wcet_us, {});
      const auto typical = std::exchange(x.typical_us, {});
      for (const Xpu& xpu : platform_.xpus) {
        const auto wcet = wcets.find(xpu.type);
        if (wcet == wcets.end() || !may_be(static_cast<int>(i), xpu.host, hosts) ||
            forbidden(x.name, xpu.type))
          continue;
        const std::int64_t ppm = platform_.hosts[at(xpu.host)].rate_ppm;
        x.wcet_us[type_on(xpu.type, xpu.host)] = in_fast_time(wcet->second, ppm);
        if (const auto usual = typical.find(xpu.type); usual != typical.end())
          x.typical_us[type_on(xpu.type, xpu.host)] = in_fast_time(usual->second, ppm);
      }
      if (x.wcet_us.empty())
        return fail(ErrorCode::kInfeasible,
                    "no XPU that it may use is on a host where its module may be",
                    "XNode '" + x.name + "'");
    }
    return {};
  }

  /// Those of types have become implementations.
  void types_of_wishes(Objectives& wishes) const {
    const auto of_type = [&](const std::pair<std::string, std::string>& one) {
      return platform_.find(one.second) < 0;
    };
    std::erase_if(wishes.pins, of_type);
    std::erase_if(wishes.forbids, of_type);
  }

  [[nodiscard]] static std::int64_t crosses(int u, int host, const std::vector<Crossing>* all) {
    for (const Crossing& c : *all)
      if (c.from == u && c.host == host) return c.x_us;
    return 0;
  }

  /// With the link alone; without a link nothing is known: hosts that need one are refused.
  [[nodiscard]] std::int64_t alone(int u, int from, int to) const {
    const HostLink* const link = platform_.link(from, to);
    if (link == nullptr) return 0;
    return link->base_us + on_link_us(app_.xnodes[at(u)].message_bytes, *link);
  }

  void transfers(std::size_t e, const Hosts& hosts, const std::vector<Crossing>* crossings,
                 AppSpec& app) const {
    const auto [u, v] = app_.edges[e];
    std::map<std::pair<std::string_view, std::string_view>, std::int64_t> own;
    for (const TransferSpec& t : app_.transfers)
      if (at(t.edge) == e) own[{t.from_type, t.to_type}] = t.transfer_us;
    std::set<std::pair<std::string, std::string>> done;
    for (const Xpu& from : platform_.xpus)
      for (const Xpu& to : platform_.xpus) {
        const std::string from_type = type_on(from.type, from.host),
                          to_type = type_on(to.type, to.host);
        if (!app.xnodes[at(u)].wcet_on(from_type) || !app.xnodes[at(v)].wcet_on(to_type) ||
            !done.insert({from_type, to_type}).second)
          continue;
        std::int64_t us = 0;
        if (const auto found = own.find({from.type, to.type}); found != own.end())
          us = in_fast_time(found->second, worst_rate());
        if (from.host != to.host)
          us += crossings == nullptr ? alone(u, from.host, to.host)
                                     : crosses(u, hosts[at(module_of_[at(v)])], crossings);
        if (us > 0) app.transfers.push_back({static_cast<int>(e), from_type, to_type, us});
      }
  }

  const AppSpec& app_;
  const Platform& platform_;
  const Objectives& wishes_;
  const std::vector<int>& module_of_;
};

class Spreading {
 public:
  Spreading(const AppSpec& app, const Platform& platform, const Options& options)
      : app_(app), platform_(platform), options_(options) {
    std::map<std::string_view, int> modules;
    for (std::size_t m = 0; m < app.modules.size(); ++m)
      modules.emplace(app.modules[m].name, static_cast<int>(m));
    for (const XNodeSpec& x : app.xnodes) module_of_.push_back(modules.at(x.module));
    for (const ModuleSpec& m : app.modules)
      pinned_.push_back(m.host.empty() ? -1 : platform.find_host(m.host));
  }

  Result<Answer> run() {
    XAUTO_ASSIGN(const Expanded anywhere, expanding_.on(pinned_, nullptr));
    Options first = limited(kForAnywhere, 0);
    first.wishes = anywhere.wishes;
    XAUTO_ASSIGN(const Answer loose, solve(anywhere.app, anywhere.platform, first));
    if (loose.outcome == Outcome::kUnsustainable) return loose;
    evaluations_ = loose.evaluations;
    if (options_.hint != nullptr) attempt(hosts_of_modules(*options_.hint));
    if (loose.outcome == Outcome::kPolicy) attempt(hosts_of_modules(loose.policy));
    for (std::size_t h = 0; h < platform_.hosts.size(); ++h) attempt(filled(static_cast<int>(h)));
    improve();
    if (!best_) {
      if (!refused_.what.empty()) return tl::unexpected<Error>(refused_);
      Answer none = loose;
      none.outcome = Outcome::kUnknown;
      none.policy = {};
      none.evaluations = evaluations_;
      return none;
    }
    finish();
    return with_bounds(loose);
  }

 private:
  [[nodiscard]] double spent() const {
    const double time =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - began_).count() /
        std::max(options_.time_limit_s, 1e-3);
    const double effort =
        options_.max_evaluations == 0
            ? 0
            : static_cast<double>(evaluations_) / static_cast<double>(options_.max_evaluations);
    return std::max(time, effort);
  }

  [[nodiscard]] bool stopped() const { return options_.stop != nullptr && options_.stop->load(); }

  [[nodiscard]] Options limited(double part, double least_s) const {
    Options some = options_;
    some.time_limit_s = std::max(least_s, options_.time_limit_s * part);
    if (options_.max_evaluations > 0)
      some.max_evaluations = std::max<std::int64_t>(
          1, static_cast<std::int64_t>(static_cast<double>(options_.max_evaluations) * part));
    some.spread = true;
    some.hint = nullptr;
    some.keep = Keep::kNothing;
    some.on_progress = nullptr;
    return some;
  }

  /// Where most of a module's work is; where it is pinned, there.
  [[nodiscard]] Hosts hosts_of_modules(const Policy& policy) const {
    std::vector<std::map<int, std::int64_t>> work(app_.modules.size());
    for (std::size_t i = 0; i < app_.xnodes.size(); ++i) {
      if (policy.placements[i].xpu < 0) continue;
      const Xpu& xpu = platform_.xpus[at(policy.placements[i].xpu)];
      work[at(module_of_[i])][xpu.host] += app_.xnodes[i].wcet_on(xpu.type).value_or(1);
    }
    Hosts hosts = pinned_;
    for (std::size_t m = 0; m < hosts.size(); ++m) {
      if (hosts[m] >= 0) continue;
      hosts[m] = 0;
      std::int64_t most = -1;
      for (const auto& [host, us] : work[m])
        if (us > most) {
          most = us;
          hosts[m] = host;
        }
    }
    return hosts;
  }

  [[nodiscard]] Hosts filled(int host) const {
    Hosts hosts = pinned_;
    std::ranges::replace(hosts, -1, host);
    return hosts;
  }

  [[nodiscard]] std::tuple<double, double, double> cost(const Answer& a) const {
    const double late = app_.has_deadlines() ? std::max(1.0, a.totals.largest) : 1.0;
    return options_.aim == Aim::kLargest ? std::tuple(late, a.totals.largest, a.totals.sum)
                                         : std::tuple(late, a.totals.sum, a.totals.largest);
  }

  /// With what crosses then. Keeps the best.
  bool attempt(const Hosts& hosts) {
    if (!tried_.insert(hosts).second) return false;
    return solve_with(hosts, limited(kForEachHosts, kLeastTryS));
  }

  bool solve_with(const Hosts& hosts, Options some) {
    std::vector<int> host_of;
    for (const int module : module_of_) host_of.push_back(hosts[at(module)]);
    const auto refuse = [&](const Error& error) {
      refused_ = error;
      return false;
    };
    const auto crossings = crossings_of(app_, platform_, host_of);
    if (!crossings) return refuse(crossings.error());
    const auto world = expanding_.on(hosts, &*crossings);
    if (!world) return refuse(world.error());
    some.wishes = world->wishes;
    auto answer = solve(world->app, world->platform, some);
    if (!answer) return refuse(answer.error());
    evaluations_ += answer->evaluations;
    if (answer->outcome != Outcome::kPolicy) return false;
    if (best_ && cost(*answer) >= cost(*best_)) return false;
    best_ = std::move(*answer);
    best_->policy.crossings = *crossings;
    best_hosts_ = hosts;
    return true;
  }

  /// One module after the other to another host, as long as that is better.
  void improve() {
    if (!best_) return;
    const std::size_t modules = pinned_.size(), hosts = platform_.hosts.size();
    for (std::size_t k = 0, idle = 0; idle < modules * hosts && spent() < kForHosts && !stopped();
         ++k, ++idle) {
      const std::size_t m = k / hosts % modules;
      if (pinned_[m] >= 0) continue;
      Hosts next = best_hosts_;
      next[m] = static_cast<int>(k % hosts);
      if (attempt(next)) idle = 0;
    }
  }

  /// The rest of the limit for the hosts that were best.
  void finish() {
    const double left = 1 - spent();
    if (left <= 0 || stopped()) return;
    Options rest = limited(left, kLeastTryS);
    rest.on_progress = options_.on_progress;
    const Policy hint = best_->policy;
    rest.hint = &hint;
    solve_with(best_hosts_, std::move(rest));
  }

  /// No policy has less than with each link alone and modules in parts. Where all hosts are given, than on these.
  [[nodiscard]] Answer with_bounds(const Answer& loose) {
    Answer answer = std::move(*best_);
    answer.evaluations = evaluations_;
    answer.policy.app = app_.name;
    answer.policy.app_hash = app_.hash();
    answer.policy.platform = platform_.name;
    answer.policy.solve_us = std::chrono::duration_cast<std::chrono::microseconds>(
                                 std::chrono::steady_clock::now() - began_)
                                 .count();
    if (std::ranges::find(pinned_, -1) == pinned_.end()) return answer;
    answer.lower_bound_us = loose.lower_bound_us;
    answer.bounds = loose.bounds;
    for (std::size_t c = 0; c < answer.policy.chains.size(); ++c) {
      ChainClaim& claim = answer.policy.chains[c];
      claim.lower_bound_us = std::min(answer.lower_bound_us[c], claim.worst_case_us);
      claim.optimal = claim.lower_bound_us == claim.worst_case_us;
    }
    return answer;
  }

  const AppSpec& app_;
  const Platform& platform_;
  const Options& options_;
  const TimePoint began_ = std::chrono::steady_clock::now();
  std::vector<int> module_of_;  ///< [xnode] index into AppSpec::modules
  Hosts pinned_;
  Expanding expanding_{app_, platform_, options_.wishes, module_of_};
  std::set<Hosts> tried_;
  std::optional<Answer> best_;
  Hosts best_hosts_;
  Error refused_;
  std::int64_t evaluations_ = 0;
};

}  // namespace

Result<Answer> solve_on_hosts(const AppSpec& app, const Platform& platform,
                              const Options& options) {
  const std::string where = "platform '" + platform.name + "'";
  if (app.one_at_a_time)
    return fail(ErrorCode::kInvalid,
                "it has several hosts, and the sources of '" + app.name + "' have no rate", where,
                "give the sources rates: nobody would tell a host when the last release has ended");
  if (!options.beside.nobody())
    return fail(ErrorCode::kInvalid, "it has several hosts: no room is kept there for other apps",
                where, "plan without --reserve and --beside");
  XAUTO_TRY(validate(app));
  XAUTO_TRY(validate(platform));
  XAUTO_TRY(validate_pins(app, platform));
  return Spreading(app, platform, options).run();
}

}  // namespace xauto::solver::keys
