// SPDX-License-Identifier: Apache-2.0
// Every tiny app on two hosts of a grid, with policies that `check` takes, played by every combination of messages that
// take no time or all that X leaves, clocks at their ends, releases at theirs, and long or short jobs. The player knows
// the rule and the clocks, in whole microseconds; it shares no code with solver and check.
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "model/json.h"
#include "solver/keys/check.h"

namespace xauto::solver::keys::tiny_hosts {
namespace {

constexpr int kX = 9, kPeriod = 36, kShort = 2, kLong = 5, kJitter = 3, kHorizon = 4 * kPeriod;

enum class Pair : std::uint8_t { kNone, kEdge, kSample };

/// What the grid has.
struct Tiny {
  std::vector<std::vector<Pair>> pairs;  ///< [u][v], u < v
  std::vector<int> host, wcet, component;
  bool preemptive = true;
  [[nodiscard]] int size() const { return static_cast<int>(host.size()); }
  [[nodiscard]] bool is(int u, int v, Pair pair) const {
    return u < v && pairs[static_cast<std::size_t>(u)][static_cast<std::size_t>(v)] == pair;
  }
  [[nodiscard]] int of(const std::vector<int>& list, int x) const {
    return list[static_cast<std::size_t>(x)];
  }
  [[nodiscard]] bool root(int x) const {
    for (int u = 0; u < x; ++u)
      if (is(u, x, Pair::kEdge)) return false;
    return true;
  }
  /// All but the first component are twice as fast: what is sampled is of another rate.
  [[nodiscard]] int period(int x) const { return of(component, x) == 0 ? kPeriod : kPeriod / 2; }
  [[nodiscard]] bool crosses(int u, int v) const {
    return of(host, u) != of(host, v) && (is(u, v, Pair::kEdge) || is(u, v, Pair::kSample));
  }
};

/// The k-th of all with `n` XNodes; false: it is none, or nothing crosses, or nothing leads to the last XNode.
bool make(int n, std::uint64_t k, Tiny& tiny) {
  const auto digit = [&](std::uint64_t base) {
    const std::uint64_t d = k % base;
    k /= base;
    return static_cast<int>(d);
  };
  const auto size = static_cast<std::size_t>(n);
  tiny = {};
  tiny.preemptive = digit(2) == 0;
  tiny.pairs.assign(size, std::vector<Pair>(size, Pair::kNone));
  for (int x = 0; x < n; ++x) {
    tiny.host.push_back(x == 0 ? 0 : digit(2));
    tiny.wcet.push_back(digit(2) == 0 ? kShort : kLong);
    tiny.component.push_back(x);
  }
  for (std::size_t u = 0; u < size; ++u)
    for (std::size_t v = u + 1; v < size; ++v) tiny.pairs[u][v] = static_cast<Pair>(digit(3));
  if (k != 0) return false;
  std::vector<int> reached{0};
  bool any = false;
  for (int round = 0; round < n; ++round)
    for (int u = 0; u < n; ++u)
      for (int v = u + 1; v < n; ++v) {
        any = any || tiny.crosses(u, v);
        if (tiny.is(u, v, Pair::kNone)) continue;
        if (std::ranges::count(reached, u) > 0 && std::ranges::count(reached, v) == 0)
          reached.push_back(v);
        if (!tiny.is(u, v, Pair::kEdge)) continue;
        int &a = tiny.component[static_cast<std::size_t>(u)],
            &b = tiny.component[static_cast<std::size_t>(v)];
        a = b = std::min(a, b);
      }
  for (int u = 0; u < n; ++u)  // who is fired with another one does not sample it
    for (int v = u + 1; v < n; ++v)
      if (tiny.is(u, v, Pair::kSample) && tiny.of(tiny.component, u) == tiny.of(tiny.component, v))
        return false;
  return any && std::ranges::count(reached, n - 1) > 0;
}

Platform platform_of(const Tiny& tiny, std::int64_t base_us) {
  Platform platform;
  platform.name = "two";
  platform.hosts = {{"g", 0}, {"h", 0}};
  platform.links = {{0, 1, base_us, 0}, {1, 0, base_us, 0}};
  for (int h = 0; h < 2; ++h) {
    platform.xpus.push_back({h == 0 ? "cpu0" : "cpu1", "cpu"});
    platform.xpus.back().host = h;
    platform.xpus.back().preemptive = tiny.preemptive;
  }
  return platform;
}

/// By its file, as anybody writes it.
Result<AppSpec> app_of(const Tiny& tiny) {
  std::string sources, xnodes, edges, samples;
  const auto add = [](std::string& list, const std::string& one) {
    list += (list.empty() ? "" : ", ") + one;
  };
  const auto name = [](int x) { return "x" + std::to_string(x); };
  for (int x = 0; x < tiny.size(); ++x) {
    const int c = tiny.of(tiny.component, x);
    if (c == x)
      add(sources, R"({"name": "s)" + std::to_string(c) + R"(", "period_us": )" +
                       std::to_string(tiny.period(x)) + R"(, "jitter_us": )" +
                       std::to_string(kJitter) + "}");
    add(xnodes, R"({"name": ")" + name(x) + R"(", "module": "m)" + std::to_string(x) + "\"" +
                    (tiny.root(x) ? R"(, "source": "s)" + std::to_string(c) + "\"" : "") +
                    R"(, "wcet_us": {"cpu": )" + std::to_string(tiny.of(tiny.wcet, x)) + "}}");
    for (int v = x + 1; v < tiny.size(); ++v) {
      const std::string pair = "[\"" + name(x) + "\", \"" + name(v) + "\"]";
      if (tiny.is(x, v, Pair::kEdge)) add(edges, pair);
      if (tiny.is(x, v, Pair::kSample)) add(samples, pair);
    }
  }
  return parse_app(R"({"schema": "xauto.app", "version": 3, "name": "tiny", "sources": [)" +
                       sources + R"(], "xnodes": [)" + xnodes + R"(], "edges": [)" + edges +
                       R"(], "samples": [)" + samples +
                       R"(], "chains": [{"name": "all", "from": "s0", "to": ")" +
                       name(tiny.size() - 1) + R"("}]})",
                   "tiny");
}

Policy policy_of(const Tiny& tiny, const AppSpec& app, const std::vector<int>& keys, int x_us) {
  Policy policy;
  policy.app = app.name;
  policy.app_hash = app.hash();
  policy.platform = "two";
  policy.method = "hand";
  for (int x = 0; x < tiny.size(); ++x) {
    policy.placements.push_back({tiny.of(tiny.host, x), {tiny.of(keys, x)}});
    for (int v = x + 1; v < tiny.size(); ++v)
      if (tiny.crosses(x, v) && (policy.crossings.empty() || policy.crossings.back().from != x))
        policy.crossings.push_back({x, 1 - tiny.of(tiny.host, x), x_us});
  }
  policy.chains = {{"all", 100'000}};
  return policy;
}

/// What `check` makes of it: the chain's worst case; -1: it refuses.
std::int64_t derived(const Tiny& tiny, const AppSpec& app, const std::vector<int>& keys, int x_us) {
  const auto report = check(app, platform_of(tiny, x_us), policy_of(tiny, app, keys, x_us));
  return report ? report->chains.at(0).derived_us : -1;
}

/// Keys of which none can be less, from those of a plan in the order of the XNodes; empty: there are none.
std::vector<int> tight_keys(const Tiny& tiny, const AppSpec& app, bool backwards) {
  std::vector<int> keys(static_cast<std::size_t>(tiny.size()), 0);
  std::array<int, 2> busy{0, 0};
  for (int x = 0; x < tiny.size(); ++x) {
    int from = std::max(kJitter, busy[static_cast<std::size_t>(tiny.of(tiny.host, x))]);
    for (int u = 0; u < x; ++u)
      if (tiny.is(u, x, Pair::kEdge))
        from = std::max(from, tiny.of(keys, u) + (tiny.crosses(u, x) ? kX : 0));
    busy[static_cast<std::size_t>(tiny.of(tiny.host, x))] = keys[static_cast<std::size_t>(x)] =
        from + tiny.of(tiny.wcet, x) + (tiny.preemptive ? 0 : kLong);
  }
  if (derived(tiny, app, keys, kX) < 0) return {};
  for (int i = 0; i < tiny.size(); ++i) {
    const auto x = static_cast<std::size_t>(backwards ? tiny.size() - 1 - i : i);
    do --keys[x];
    while (derived(tiny, app, keys, kX) >= 0);
    ++keys[x];
  }
  return keys;
}

/// What may happen: bits.
struct Chance {
  std::uint32_t slow = 0;     ///< per crossing and activation: its message takes all that X leaves
  std::uint32_t shorter = 0;  ///< per XNode
  std::uint32_t late = 0;     ///< per XNode: its source's releases have all of their jitter
  int off = 0;                ///< by so much h's clock is ahead of g's
  bool later_first = false;   ///< of two with one key
};

/// What the chances are of.
struct World {
  int x_us = kX;  ///< links and clocks take so long together
  bool early =
      false;  ///< messages go on as they come, also before their release by the reader's clock
};

class Player {
 public:
  Player(const Tiny& tiny, const std::vector<int>& keys, const World& world)
      : tiny_(tiny), keys_(keys), x_us_(world.x_us), early_(world.early) {
    for (int x = 0; x < tiny.size(); ++x)
      for (int n = 0; n < 2 * kPeriod / tiny.period(x); ++n) jobs_.push_back({x, n});
    for (std::size_t j = 0; j < jobs_.size(); ++j) {
      Job& job = jobs_[j];
      job.before = find(job.x, job.n - 1);
      bool sent = false;
      for (int v = 0; v < tiny.size(); ++v) {
        if (tiny.is(v, job.x, Pair::kEdge)) job.from.push_back(find(v, job.n));
        if (tiny.is(v, job.x, Pair::kSample)) job.samples.push_back(v);
        sent = sent || tiny.crosses(job.x, v);
      }
      if (sent) job.bit = bits_++;
    }
  }
  [[nodiscard]] int bits() const { return bits_; }

  struct Worst {
    int late = -1000, chain = -1;
  };
  Worst play(const Chance& chance) {
    for (Job& job : jobs_) {
      job.left = (chance.shorter >> job.x & 1U) != 0 ? 1 : tiny_.of(tiny_.wcet, job.x);
      job.end = job.began = kNever;
      job.knows = tiny_.of(tiny_.component, job.x) == 0 && tiny_.root(job.x) ? job.n : -1;
    }
    std::array<Job*, 2> on{};
    std::size_t open = jobs_.size();
    for (int now = -2 * kX; open > 0 && now < kHorizon; ++now)
      for (int h = 0; h < 2; ++h) {
        Job*& runs = on[static_cast<std::size_t>(h)];
        if (runs == nullptr || tiny_.preemptive) runs = first(h, now, chance);
        if (runs == nullptr) continue;
        if (runs->began == kNever) begin(*runs, now, chance);
        if (--runs->left > 0) continue;
        runs->end = now + 1;
        runs = nullptr;
        --open;
      }
    return worst(chance);
  }

 private:
  static constexpr int kNever = 1 << 20;
  struct Job {
    int x = 0, n = 0;
    int before = -1, bit = -1;
    std::vector<int> from = {}, samples = {};
    int left = 0, began = 0, end = 0, knows = -1;
  };
  [[nodiscard]] int find(int x, int n) const {
    for (std::size_t j = 0; j < jobs_.size(); ++j)
      if (jobs_[j].x == x && jobs_[j].n == n) return static_cast<int>(j);
    return -1;
  }
  [[nodiscard]] const Job& job(int j) const { return jobs_[static_cast<std::size_t>(j)]; }
  [[nodiscard]] int host(const Job& job) const { return tiny_.of(tiny_.host, job.x); }
  /// What host h's clock reads at real instant `now`.
  [[nodiscard]] static int reads(int h, int now, const Chance& chance) {
    return h == 1 ? now + chance.off : now;
  }
  [[nodiscard]] int nominal(const Job& job) const { return job.n * tiny_.period(job.x); }
  /// When what `from` sends is on host h.
  [[nodiscard]] int there(const Job& from, int h, const Chance& chance) const {
    if (from.end == kNever || host(from) == h) return from.end;
    const int ahead = h == 1 ? chance.off : -chance.off;
    return from.end + ((chance.slow >> from.bit & 1U) != 0 ? x_us_ - ahead : 0);
  }
  [[nodiscard]] bool ready(const Job& job, int now, const Chance& chance) const {
    const int h = host(job);
    if (job.before >= 0 && this->job(job.before).end > now) return false;
    if (tiny_.root(job.x) &&
        reads(h, now, chance) < nominal(job) + ((chance.late >> job.x & 1U) != 0 ? kJitter : 0))
      return false;
    return std::ranges::all_of(job.from, [&](int u) {
      const Job& from = this->job(u);
      return there(from, h, chance) <= now &&
             (early_ || host(from) == h || reads(h, now, chance) >= nominal(job));
    });
  }
  [[nodiscard]] Job* first(int h, int now, const Chance& chance) {
    Job* best = nullptr;
    for (Job& job : jobs_) {
      if (host(job) != h || job.end != kNever || !ready(job, now, chance)) continue;
      const int key = nominal(job) + tiny_.of(keys_, job.x);
      const int least = best == nullptr ? kNever : nominal(*best) + tiny_.of(keys_, best->x);
      if (key < least || (key == least && chance.later_first)) best = &job;
    }
    return best;
  }
  /// What it hears, and what it reads as it starts.
  void begin(Job& job, int now, const Chance& chance) {
    job.began = now;
    for (const int u : job.from) job.knows = std::max(job.knows, this->job(u).knows);
    for (const int u : job.samples) {
      const Job* newest = nullptr;
      for (const Job& sent : jobs_)
        if (sent.x == u && there(sent, host(job), chance) <= now) newest = &sent;
      if (newest != nullptr) job.knows = std::max(job.knows, newest->knows);
    }
  }
  [[nodiscard]] Worst worst(const Chance& chance) const {
    Worst worst;
    int next = 0;  // release whose first result is looked for
    for (const Job& job : jobs_) {
      const int end = job.end == kNever ? kNever : reads(host(job), job.end, chance);
      worst.late = std::max(worst.late, end - nominal(job) - tiny_.of(keys_, job.x));
      if (job.x != tiny_.size() - 1) continue;
      for (; next <= job.knows; ++next) worst.chain = std::max(worst.chain, end - next * kPeriod);
    }
    return worst;
  }

  const Tiny& tiny_;
  const std::vector<int>& keys_;
  const int x_us_;
  const bool early_;
  std::vector<Job> jobs_;
  int bits_ = 0;
};

struct TinyTally {
  std::uint64_t apps = 0, policies = 0, plays = 0, late = 0, longer = 0;
};

/// All chances of one policy.
void play_all(const Tiny& tiny, const std::vector<int>& keys, const World& world,
              std::int64_t claimed_us, TinyTally& tally) {
  Player player(tiny, keys, world);
  std::uint32_t longs = 0, roots = 0;
  for (int x = 0; x < tiny.size(); ++x) {
    longs |= tiny.of(tiny.wcet, x) > 1 ? 1U << x : 0;
    roots |= tiny.root(x) ? 1U << x : 0;
  }
  ++tally.policies;
  for (std::uint32_t slow = 0; slow < 1U << player.bits(); ++slow)
    for (const int off : {-world.x_us, 0, world.x_us})
      // All subsets of these sets of bits.
      for (std::uint32_t shorter = longs;; shorter = (shorter - 1) & longs) {
        for (std::uint32_t late = roots;; late = (late - 1) & roots) {
          const Player::Worst worst =
              player.play({slow, shorter, late, off, ((slow ^ shorter ^ late) & 1U) != 0});
          ++tally.plays;
          tally.late += worst.late > 0 ? 1 : 0;
          tally.longer += worst.chain > claimed_us ? 1 : 0;
          if (late == 0) break;
        }
        if (shorter == 0) break;
      }
}

/// Every `stride`-th app of the grid with `n` XNodes.
template <class Use>
void for_all(int n, std::uint64_t stride, const Use& use) {
  std::uint64_t all = 2;  // preemptive or not
  for (int x = 0; x < n; ++x) all *= x == 0 ? 2 : 4;
  for (int pair = 0; pair < n * (n - 1) / 2; ++pair) all *= 3;
  Tiny tiny;
  for (std::uint64_t k = stride / 2; k < all; k += stride) {
    if (!make(n, k, tiny)) continue;
    const auto app = app_of(tiny);
    ASSERT_TRUE(app) << app.error().to_string();
    use(tiny, *app);
  }
}

void report(const char* what, const TinyTally& tally) {
  std::printf("%s: %lu apps, %lu policies, %lu plays, %lu late, %lu chains longer\n", what,
              tally.apps, tally.policies, tally.plays, tally.late, tally.longer);
}

/// All apps of two XNodes; of three and four each so many-th, with XAUTO_SYSTEMS=1 all of three.
TEST(KeysHostsTiny, WhatTheCheckTakesIsNeverLateAndNoChainIsLonger) {
  const bool all = std::getenv("XAUTO_SYSTEMS") != nullptr;
  TinyTally tally;
  for (const auto& [n, stride] : {std::pair(2, 1), {3, all ? 1 : 7}, {4, all ? 2003 : 40'009}})
    for_all(n, static_cast<std::uint64_t>(stride), [&](const Tiny& tiny, const AppSpec& app) {
      ++tally.apps;
      for (const bool backwards : {false, true}) {
        const std::vector<int> keys = tight_keys(tiny, app, backwards);
        if (!keys.empty()) play_all(tiny, keys, {}, derived(tiny, app, keys, kX), tally);
      }
    });
  report("X is kept", tally);
  EXPECT_GT(tally.policies, tally.apps);
  EXPECT_EQ(tally.late, 0U);
  EXPECT_EQ(tally.longer, 0U);
}

/// Messages take 10 where the policy has 9.
TEST(KeysHostsTiny, AnXThatIsATenthTooSmallIsFound) {
  TinyTally tally;
  for_all(2, 1, [&](const Tiny& tiny, const AppSpec& app) {
    ++tally.apps;
    const std::vector<int> keys = tight_keys(tiny, app, false);
    if (!keys.empty()) play_all(tiny, keys, {.x_us = kX + 1}, derived(tiny, app, keys, kX), tally);
  });
  report("X is 0.9 of what it takes", tally);
  EXPECT_GT(tally.late, 0U);
  EXPECT_GT(tally.longer, 0U);
}

/// A claim that takes a sample from another host to be there at once.
TEST(KeysHostsTiny, ASampleThatCrossesInNoTimeIsFound) {
  TinyTally tally;
  for_all(3, 1, [&](const Tiny& tiny, const AppSpec& app) {
    if (!tiny.is(0, 2, Pair::kSample) || !tiny.crosses(0, 2) || tiny.crosses(0, 1) ||
        tiny.crosses(1, 2))
      return;
    ++tally.apps;
    const std::vector<int> keys = tight_keys(tiny, app, true);
    if (keys.empty()) return;
    const std::int64_t claimed_us = derived(tiny, app, keys, 0);
    ASSERT_GE(claimed_us, 0);
    play_all(tiny, keys, {}, claimed_us, tally);
  });
  report("samples cross in no time", tally);
  EXPECT_EQ(tally.late, 0U);  // it fires nobody
  EXPECT_GT(tally.longer, 0U);
}

/// A job that a message fires before its release, by its own clock, samples what is older than its earliest start says.
TEST(KeysHostsTiny, AMessageThatGoesOnBeforeItsReleaseIsFound) {
  TinyTally tally;
  for_all(3, 7, [&](const Tiny& tiny, const AppSpec& app) {
    ++tally.apps;
    const std::vector<int> keys = tight_keys(tiny, app, false);
    if (!keys.empty()) play_all(tiny, keys, {.early = true}, derived(tiny, app, keys, kX), tally);
  });
  report("messages go on before their release", tally);
  EXPECT_GT(tally.longer, 0U);
}

}  // namespace
}  // namespace xauto::solver::keys::tiny_hosts
