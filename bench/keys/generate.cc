// SPDX-License-Identifier: Apache-2.0
#include "bench/keys/generate.h"

#include <algorithm>
#include <array>
#include <map>
#include <numeric>

#include "base/check.h"
#include "base/index.h"
#include "model/components.h"
#include "model/periodic.h"
#include "solver/random.h"

namespace xauto::bench {
namespace {

constexpr std::int64_t kMillion = 1'000'000;

struct Rate {
  Period period;
  int weight;  ///< how often it is drawn
};

Period hz(const char* rate) {
  return Period::of_rate(rate).value();
}

std::vector<Rate> rates_of(Kind kind) {
  switch (kind) {
    case Kind::kLong:
      return {{{33'333}, 3}, {{16'667}, 2}, {{100'003}, 2},
              {{50'021}, 2}, {{19'997}, 2}, {{66'683}, 1}};
    case Kind::kAutomotive:  // shares as Kramer, Ziegenbein, Hamann (WATERS 2015) found them
      return {{{1'000}, 3},  {{2'000}, 2},    {{5'000}, 2},   {{10'000}, 25},  {{20'000}, 25},
              {{50'000}, 3}, {{100'000}, 20}, {{200'000}, 1}, {{1'000'000}, 4}};
    default:
      return {{hz("30"), 4},  {hz("10"), 3}, {hz("50"), 2}, {hz("20"), 2},
              {hz("100"), 1}, {hz("15"), 1}, {hz("25"), 1}};
  }
}

class Generator {
 public:
  Generator(Kind kind, std::uint64_t seed, int load_pct)
      : kind_(kind),
        random_(seed * 1000003 + static_cast<std::uint64_t>(kind)),
        rates_(rates_of(kind)) {
    made_.name = std::string(to_string(kind)) + "-" + std::to_string(seed);
    made_.kind = kind;
    made_.seed = seed;
    made_.load_pct = load_pct;
  }

  RatedCase make() {
    made_.app.name = made_.name;
    choose_platform();
    choose_clocks();
    const int parts = component_count();
    int left = static_cast<int>(between(kind_ == Kind::kAutomotive ? 40 : 10, 60));
    left = std::max(left, 3 * parts);
    for (int part = 0; part < parts; ++part) {
      const bool fastest = kind_ == Kind::kAutomotive && part == 0;
      const std::int64_t most = fastest ? 4 : 2 * left / (parts - part);
      const int size = part + 1 == parts ? left
                                         : std::clamp(static_cast<int>(between(2, most)), 2,
                                                      left - 2 * (parts - part - 1));
      add_component(part, size);
      left -= size;
    }
    complete_modules(app());
    add_samples();
    return finished();
  }

  RatedCase make(const std::string& name, const std::vector<Share>& shares) {
    made_.name = made_.app.name = name;
    made_.platform = Platform::builtin("large").value();
    std::vector<int> firsts;  // of each component
    int part = 0;
    for (const Share& share : shares)
      for (int left = share.xnodes; left > 0; ++part) {
        const int size = std::min(left, static_cast<int>(between(10, 25)));
        left -= size;
        firsts.push_back(static_cast<int>(app().xnodes.size()));
        rates_ = {{share.period, 1}};
        add_component(part, size);
      }
    complete_modules(app());
    // Pairs far apart in the list have different rates.
    for (std::size_t k = 0; k < firsts.size() / 2; ++k)
      app().samples.emplace_back(firsts[k + firsts.size() / 2] - 1, firsts[k]);
    return finished();
  }

 private:
  RatedCase finished() {
    scale();
    choose_flights();
    choose_chains();
    const Status valid = validate(app());
    XAUTO_CHECK(valid.has_value());
    return std::move(made_);
  }
  AppSpec& app() { return made_.app; }
  [[nodiscard]] std::int64_t between(std::int64_t low, std::int64_t high) {
    return low +
           static_cast<std::int64_t>(random_.below(static_cast<std::uint64_t>(high - low + 1)));
  }
  bool chance(int percent) { return between(1, 100) <= percent; }
  [[nodiscard]] bool is(std::initializer_list<Kind> kinds) const {
    return std::find(kinds.begin(), kinds.end(), kind_) != kinds.end();
  }

  void choose_platform() {
    made_.platform = Platform::builtin(chance(50) ? "small" : "large").value();
    if (kind_ == Kind::kAutomotive) made_.platform = Platform::builtin("small").value();
    if (chance(30)) {  // a DLA that nobody suspends, as real ones are
      made_.platform.name += "-gated";
      for (Xpu& xpu : made_.platform.xpus)
        if (xpu.type == "dla") xpu.preemptive = false, xpu.preempt_us = 0;
    }
  }

  void choose_clocks() {
    const bool several =
        is({Kind::kClocks, Kind::kMixed}) || (kind_ == Kind::kOverload && chance(50));
    if (!several) return;
    app().clocks.push_back({"lidar", chance(50) ? 100 : 20});
    if (chance(30)) app().clocks.push_back({"radar", 50});
  }

  int component_count() {
    switch (kind_) {
      case Kind::kPipelined:
        return 1;
      case Kind::kAutomotive:
        return static_cast<int>(between(6, 9));
      default:
        return static_cast<int>(between(2, 5));
    }
  }

  /// Neighbours differ, where there are several components; the fastest and the slowest rate of
  /// control units are always there.
  Period draw_period(int part) {
    if (kind_ == Kind::kAutomotive && part < 2)
      return part == 0 ? rates_.front().period : rates_.back().period;
    int sum = 0;
    for (const Rate& rate : rates_) sum += rate.weight;
    for (;;) {
      std::int64_t at = between(1, sum);
      std::size_t pick = 0;
      while ((at -= rates_[pick].weight) > 0) ++pick;
      const Period period = rates_[pick].period;
      if (kind_ == Kind::kAutomotive && pick == 0) continue;  // one component of 1 ms is enough
      if (rates_.size() > 1 && !app().sources.empty() && app().sources.back().period == period)
        continue;
      return period;
    }
  }

  /// One to three sources of one clock and one period.
  std::vector<int> add_sources(int part) {
    const Period period = draw_period(part);
    // The first component is the main clock's, the second another's where there is one.
    const int clock =
        part == 0 ? 0 : std::min<int>(part, static_cast<int>(app().clocks.size()) - 1);
    std::vector<int> sources;
    for (std::int64_t k = between(1, kind_ == Kind::kAutomotive ? 1 : 3); k > 0; --k) {
      SourceSpec source{"s" + std::to_string(app().sources.size()), period};
      source.clock = clock;
      const std::int64_t us = period.floor_us();
      if (chance(40)) source.offset_us = between(0, us / 2);
      if (chance(kind_ == Kind::kMixed ? 80 : 40)) source.jitter_us = between(0, us / 20);
      sources.push_back(static_cast<int>(app().sources.size()));
      app().sources.push_back(std::move(source));
    }
    return sources;
  }

  /// Modules in a row: each begins at a source, or behind the last XNodes of earlier ones.
  void add_component(int part, int size) {
    const std::vector<int> sources = add_sources(part);
    std::vector<int> lasts;
    for (int m = 0; size > 0; ++m) {
      const std::string module = "c" + std::to_string(part) + "m" + std::to_string(m);
      const int length = static_cast<int>(std::min<std::int64_t>(size, between(1, 4)));
      size -= length;
      const int first = static_cast<int>(app().xnodes.size());
      for (int k = 0; k < length; ++k) {
        const int x = static_cast<int>(app().xnodes.size());
        app().xnodes.push_back({module + "." + std::to_string(k), module, draw_wcets(k, length)});
        if (k > 0) app().edges.emplace_back(x - 1, x);
      }
      if (lasts.empty() || (sources.size() > static_cast<std::size_t>(m) && chance(70))) {
        app().xnodes[at(first)].sources = {sources[static_cast<std::size_t>(m) % sources.size()]};
      } else {
        const std::size_t joined =
            static_cast<std::size_t>(between(1, std::min<int>(3, static_cast<int>(lasts.size()))));
        for (std::size_t j = 0; j < joined; ++j) {
          const std::size_t pick = static_cast<std::size_t>(
              between(static_cast<std::int64_t>(j), static_cast<std::int64_t>(lasts.size()) - 1));
          std::swap(lasts[j], lasts[pick]);
          app().edges.emplace_back(lasts[j], first);
          if (chance(15)) add_transfer();
        }
      }
      lasts.push_back(static_cast<int>(app().xnodes.size()) - 1);
    }
  }

  std::map<std::string, std::int64_t, std::less<>> draw_wcets(int place, int length) {
    // Log-uniform over a factor of 16, before everything is scaled.
    const std::int64_t cpu = (std::int64_t{1000} << between(0, 3)) * between(100, 200) / 100;
    if (kind_ == Kind::kAutomotive) return {{"cpu", cpu}};
    const bool inference = length > 1 ? place == 1 : chance(30);
    if (!inference) {
      if (chance(85)) return {{"cpu", cpu}};
      return {{"cpu", cpu}, {"gpu", cpu * between(30, 80) / 100}};
    }
    const std::int64_t gpu = cpu * between(100, 200) / 100;
    if (chance(20)) return {{"gpu", gpu}};
    const std::int64_t dla = gpu * between(140, 250) / 100;
    if (chance(15)) return {{"cpu", gpu * between(300, 600) / 100}, {"dla", dla}, {"gpu", gpu}};
    return {{"dla", dla}, {"gpu", gpu}};
  }

  /// Of the last edge: between memories, in one direction or both.
  void add_transfer() {
    const auto [u, v] = app().edges.back();
    const int edge = static_cast<int>(app().edges.size()) - 1;
    for (const auto& [from, us] : app().xnodes[at(u)].wcet_us)
      for (const auto& [to, other] : app().xnodes[at(v)].wcet_us)
        if (from != to) app().transfers.push_back({edge, from, to, between(50, 400)});
  }

  void add_samples() {
    const Components found = find_components(app()).value();
    const int parts = static_cast<int>(found.components.size());
    const auto draw = [&](int part) {
      const std::vector<int>& xnodes = found.components[at(part)].xnodes;
      return xnodes[static_cast<std::size_t>(
          between(0, static_cast<std::int64_t>(xnodes.size()) - 1))];
    };
    std::set<std::pair<int, int>> seen;
    for (int part = 1; part < parts; ++part)
      for (std::int64_t k = between(1, 3); k > 0; --k) {
        int from = static_cast<int>(between(0, part - 1)), to = part;
        // Feedback now and then.
        if (is({Kind::kMixed, Kind::kRates}) && chance(15)) std::swap(from, to);
        const std::pair<int, int> sample{draw(from), draw(to)};
        if (seen.insert(sample).second) app().samples.push_back(sample);
      }
  }

  /// WCETs to the load that was asked for. No XNode takes more than most of its period on its
  /// fastest type: it could not keep up by itself.
  void scale() {
    const std::int64_t now = load_ppm(app(), made_.platform), target = made_.load_pct * 10'000ll;
    const Components found = find_components(app()).value();
    for (std::size_t i = 0; i < app().xnodes.size(); ++i) {
      auto& wcets = app().xnodes[i].wcet_us;
      const std::int64_t most = found.components[at(found.of[i])].period.floor_us() * 7 / 10;
      std::int64_t least = INT64_MAX;
      for (auto& [type, us] : wcets) {
        us = std::max<std::int64_t>(1, us * target / now);
        least = std::min(least, us);
      }
      if (least > most && kind_ != Kind::kOverload)
        for (auto& [type, us] : wcets) us = std::max<std::int64_t>(1, us * most / least);
    }
  }

  /// Enough activations in flight for the module's span on its fastest types, and one more where
  /// pipelining is what the case is about.
  void choose_flights() {
    const Components found = find_components(app()).value();
    for (ModuleSpec& module : app().modules) {
      std::int64_t span = 0, period = 1;
      for (std::size_t i = 0; i < app().xnodes.size(); ++i) {
        if (app().xnodes[i].module != module.name) continue;
        std::int64_t least = INT64_MAX;
        for (const auto& [type, us] : app().xnodes[i].wcet_us) least = std::min(least, us);
        span += least;
        period = found.components[at(found.of[i])].period.floor_us();
      }
      module.max_in_flight = span / period + (span * 10 > period * 7 ? 2 : 1);
      if (is({Kind::kPipelined, Kind::kMixed}) && chance(50)) ++module.max_in_flight;
      module.optional = chance(10);
    }
    keep_what_others_wait_for();
  }

  void keep_what_others_wait_for() {
    std::map<std::string, ModuleSpec*> module;
    for (ModuleSpec& m : app().modules) module[m.name] = &m;
    for (bool again = true; again;) {
      again = false;
      for (const auto& [u, v] : app().edges) {
        ModuleSpec& from = *module.at(app().xnodes[at(u)].module);
        if (!from.optional || module.at(app().xnodes[at(v)].module)->optional) continue;
        from.optional = false;
        again = true;
      }
    }
  }

  /// Up to eight of all that there are, those between components first. Half of the cases have
  /// deadlines: a period of both ends, and the work of the whole, times 1 to 2.
  void choose_chains() {
    std::vector<ChainSpec> all = default_chains(app());
    const Components found = find_components(app()).value();
    for (std::size_t i = all.size(); i > 1; --i)
      std::swap(all[i - 1],
                all[static_cast<std::size_t>(between(0, static_cast<std::int64_t>(i) - 1))]);
    const auto crosses = [&](const ChainSpec& chain) {
      const std::vector<int>& heard = found.components[at(found.of[at(chain.to)])].sources;
      return std::find(heard.begin(), heard.end(), chain.from) == heard.end();
    };
    std::stable_partition(all.begin(), all.end(), crosses);
    all.resize(std::min<std::size_t>(all.size(), 8));
    std::sort(all.begin(), all.end(), [](const ChainSpec& a, const ChainSpec& b) {
      return std::pair(a.from, a.to) < std::pair(b.from, b.to);
    });
    const bool deadlines = chance(50);
    for (ChainSpec& chain : all) {
      const Component& to = found.components[at(found.of[at(chain.to)])];
      const std::int64_t base = app().sources[at(chain.from)].period.floor_us() +
                                (crosses(chain) ? 2 : 1) * to.period.floor_us() +
                                critical(chain.to);
      if (deadlines)
        chain.deadline_us = base * between(100, 200) / 100;
      else if (chance(30))
        chain.weight = between(1, 5);
    }
    app().chains = std::move(all);
  }

  /// The longest path of least WCETs that ends with an XNode.
  [[nodiscard]] std::int64_t critical(int last) {
    const auto pred = app().predecessors();
    std::vector<std::int64_t> end(app().xnodes.size(), 0);
    for (const int x : app().topological_order()) {
      std::int64_t least = INT64_MAX;
      for (const auto& [type, us] : app().xnodes[at(x)].wcet_us) least = std::min(least, us);
      for (const int p : pred[at(x)]) end[at(x)] = std::max(end[at(x)], end[at(p)]);
      end[at(x)] += least;
    }
    return end[at(last)];
  }

  Kind kind_;
  solver::Random random_;
  std::vector<Rate> rates_;
  RatedCase made_;
};

}  // namespace

const char* to_string(Kind kind) {
  static constexpr std::array<const char*, 9> kNames = {
      "rates", "pipelined", "clocks", "long", "automotive", "mixed", "overload", "public", "scale"};
  return kNames[static_cast<std::size_t>(kind)];
}

RatedCase make_case(Kind kind, std::uint64_t seed, int load_pct) {
  return Generator(kind, seed, load_pct).make();
}

std::vector<RatedCase> standard_set(std::uint64_t first) {
  std::vector<RatedCase> set;
  const auto add = [&](Kind kind, int count, int least, int step) {
    for (int k = 0; k < count; ++k)
      set.push_back(make_case(kind, first + static_cast<std::uint64_t>(k), least + k % 6 * step));
  };
  add(Kind::kRates, 10, 40, 10);
  add(Kind::kPipelined, 10, 40, 10);
  add(Kind::kClocks, 10, 40, 10);
  add(Kind::kLong, 6, 40, 10);
  add(Kind::kAutomotive, 4, 40, 10);
  add(Kind::kMixed, 8, 40, 10);
  add(Kind::kOverload, 4, 105, 15);
  set.push_back(engine_case(1, 50));
  set.push_back(engine_case(2, 75));
  set.push_back(waters_2019());
  return set;
}

RatedCase scale_case(const std::string& name, const std::vector<Share>& shares, int load_pct) {
  Generator generator(Kind::kScale, 1, load_pct);
  return generator.make(name, shares);
}

std::vector<RatedCase> scale_set() {
  const std::vector<Share> many = {
      {{1'000'000}, 74}, {{40'000}, 296}, {{25'000}, 250}, {{20'000}, 200}, {{8'000}, 180}};
  return {
      scale_case("n300",
                 {{hz("10"), 60}, {hz("20"), 60}, {hz("30"), 60}, {hz("50"), 60}, {hz("100"), 60}},
                 60),
      scale_case("n1000", many, 60),
      scale_case("n1000-over", many, 120),
  };
}

std::int64_t load_ppm(const AppSpec& app, const Platform& platform) {
  constexpr std::int64_t kGrid = 64;
  const Components found = find_components(app).value();
  const std::vector<std::string> types = platform.types();
  XAUTO_CHECK(types.size() <= 3);
  // [xnode][type] share of all instances of the type, in millionths; -1: it cannot run there.
  std::vector<std::array<std::int64_t, 3>> share;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const Period period = found.components[at(found.of[i])].period;
    auto& row = share.emplace_back(std::array<std::int64_t, 3>{-1, -1, -1});
    for (std::size_t t = 0; t < types.size(); ++t)
      if (const auto wcet = app.xnodes[i].wcet_on(types[t]))
        row[t] = static_cast<std::int64_t>(
            static_cast<__int128>(*wcet) * kMillion * period.den /
            (static_cast<__int128>(period.num) *
             static_cast<std::int64_t>(platform.instances_of(types[t]).size())));
  }
  std::int64_t best = 0;
  std::array<std::int64_t, 3> w{};
  for (w[0] = 0; w[0] <= kGrid; ++w[0])
    for (w[1] = 0; w[0] + w[1] <= kGrid; ++w[1]) {
      w[2] = kGrid - w[0] - w[1];
      if (types.size() < 3 && w[2] > 0) continue;
      if (types.size() < 2 && w[1] > 0) continue;
      std::int64_t sum = 0;
      for (const auto& row : share) {
        std::int64_t least = INT64_MAX;
        for (std::size_t t = 0; t < types.size(); ++t)
          if (row[t] >= 0) least = std::min(least, w[t] * row[t]);
        sum += least == INT64_MAX ? 0 : least;
      }
      best = std::max(best, sum / kGrid);
    }
  return best;
}

}  // namespace xauto::bench
