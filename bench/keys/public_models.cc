// SPDX-License-Identifier: Apache-2.0
// Two automotive models that others have published. Facts are theirs, the generator is ours.
//
// engine: S. Kramer, D. Ziegenbein, A. Hamann, "Real World Automotive Benchmarks For Free", WATERS
//   2015: periods and the shares of runnables that have them; least, average and greatest average
//   execution time by period; by how much the WCET is longer; how many runnables of how many rates
//   a chain of cause and effect has. What the paper does not say: the distribution between least
//   and greatest is a power of a uniform number with the right mean; 12 runnables are one XNode;
//   WCETs are scaled to a load, as those of the other cases are, since the paper's are of another
//   processor; rates stay whole milliseconds, and what follows the crankshaft is left out.
// waters: the WATERS Industrial Challenge 2019 (Bosch), from code that others have generated from its
//   Amalthea model: tasks, periods, greatest ticks on A57, Denver and GPU, and which task reads what
//   another has written. A task waits for its work on the GPU. What that code does not say: a tick
//   is 1/2000 us on the CPUs and 1/1500 us on the GPU (7.9 ms for sfm, 116 ms for detection, as in
//   papers on the challenge); a preemption of the GPU costs what it costs in our built-in platforms;
//   copies take no time; there are no deadlines.
#include <algorithm>
#include <array>
#include <map>

#include "base/check.h"
#include "model/periodic.h"
#include "solver/random.h"

#include "bench/keys/generate.h"

namespace xauto::bench {
namespace {

struct RateOfEngine {
  std::int64_t period_us;
  int share;                              ///< percent of the runnables
  std::int64_t least, average, greatest;  ///< average execution time, in 10 ns
  int factor_least, factor_most;          ///< WCET / average execution time, in hundredths
};
constexpr RateOfEngine kEngine[] = {
    {1'000, 3, 34, 500, 3011, 130, 2911},     {2'000, 2, 32, 420, 4069, 154, 1904},
    {5'000, 2, 36, 1104, 8338, 113, 1844},    {10'000, 25, 21, 1009, 30987, 106, 3003},
    {20'000, 25, 25, 874, 29142, 106, 1561},  {50'000, 3, 29, 1756, 9298, 113, 776},
    {100'000, 20, 21, 1053, 42043, 102, 888}, {200'000, 1, 22, 256, 2195, 103, 490},
    {1'000'000, 4, 37, 43, 46, 184, 475},
};
constexpr int kRunnables = 12;  ///< in an XNode: about 1000 in all
constexpr std::size_t kMostChains = 30;

class Dice {
 public:
  explicit Dice(std::uint64_t seed) : random_(seed) {}
  std::int64_t between(std::int64_t low, std::int64_t high) {
    return low +
           static_cast<std::int64_t>(random_.below(static_cast<std::uint64_t>(high - low + 1)));
  }
  /// The index of a weight; the weights sum to 100.
  template <std::size_t N>
  int weighted(const std::array<int, N>& weights) {
    std::int64_t at = between(1, 100);
    int pick = 0;
    for (const int weight : weights) {
      if ((at -= weight) <= 0) return pick;
      ++pick;
    }
    return pick - 1;
  }

 private:
  solver::Random random_;
};

/// With u^k the mean is 1 / (k + 1) of the way. In 2^-20, so that it is the same everywhere.
std::int64_t average_time(const RateOfEngine& rate, Dice& dice) {
  const std::int64_t width = rate.greatest - rate.least, middle = rate.average - rate.least;
  const std::int64_t k = std::max<std::int64_t>(1, (width + middle / 2) / middle - 1);
  const std::int64_t u = dice.between(0, 1 << 20);
  std::int64_t power = 1 << 20;
  for (std::int64_t i = 0; i < k; ++i) power = power * u >> 20;
  return rate.least + (width * power >> 20);
}

std::int64_t wcet_us(const RateOfEngine& rate, Dice& dice) {
  std::int64_t sum = 0;  // in 0.1 ns
  for (int k = 0; k < kRunnables; ++k)
    sum += average_time(rate, dice) * dice.between(rate.factor_least, rate.factor_most);
  return std::max<std::int64_t>(1, (sum + 9'999) / 10'000);
}

/// To the load, as scale() of the other kinds.
void scale(AppSpec& app, const Platform& platform, int load_pct) {
  const std::int64_t now = load_ppm(app, platform);
  for (XNodeSpec& x : app.xnodes)
    for (auto& [type, us] : x.wcet_us)
      us = std::max<std::int64_t>(1, us * (load_pct * 10'000ll) / now);
}

}  // namespace

RatedCase engine_case(std::uint64_t seed, int load_pct) {
  Dice dice(seed * 7919 + 2015);
  RatedCase made;
  made.name = "engine-" + std::to_string(seed);
  made.kind = Kind::kPublic;
  made.seed = seed;
  made.load_pct = load_pct;
  made.platform = Platform::builtin("small").value();
  AppSpec& app = made.app;
  app.name = made.name;
  struct Group {
    int first, last, source;
    std::int64_t period_us;
  };
  std::vector<Group> groups;
  for (const RateOfEngine& rate : kEngine)
    for (int left = rate.share; left > 0;) {  // as many XNodes as the rate has percent
      // 2 to 5 runnables of one rate are in a chain: 30, 40, 20, 10 % of the chains.
      const int length = std::min(left, 2 + dice.weighted(std::array{30, 40, 20, 10}));
      left -= length;
      const std::string module = "m" + std::to_string(groups.size());
      const int source = static_cast<int>(app.sources.size());
      app.sources.push_back({"s" + std::to_string(source), {rate.period_us}});
      const int first = static_cast<int>(app.xnodes.size());
      for (int k = 0; k < length; ++k) {
        XNodeSpec x{module + "." + std::to_string(k), module, {{"cpu", wcet_us(rate, dice)}}};
        if (k == 0) x.sources = {source};
        if (k > 0) app.edges.emplace_back(first + k - 1, first + k);
        app.xnodes.push_back(std::move(x));
      }
      groups.push_back({first, first + length - 1, source, rate.period_us});
    }
  // One, two or three rates are in a chain: 70, 20, 10 % (from memory of the paper; all other figures
  // were looked up). What is read is never read back.
  std::vector<std::size_t> order(groups.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  for (std::size_t i = order.size(); i > 1; --i)
    std::swap(order[i - 1],
              order[static_cast<std::size_t>(dice.between(0, static_cast<std::int64_t>(i) - 1))]);
  for (std::size_t i = 0; i < order.size() && app.chains.size() < kMostChains; ++i) {
    const Group* at = &groups[order[i]];
    const int source = at->source;
    int more = dice.weighted(std::array{70, 20, 10});
    for (std::size_t j = i + 1; j < order.size() && more > 0; ++j) {
      const Group& next = groups[order[j]];
      if (next.period_us == at->period_us) continue;
      const std::pair sample{at->last, next.first};
      if (std::find(app.samples.begin(), app.samples.end(), sample) == app.samples.end())
        app.samples.push_back(sample);
      at = &next;
      --more;
    }
    app.chains.push_back({"chain" + std::to_string(app.chains.size()), source, at->last});
  }
  complete_modules(app);
  scale(app, made.platform, load_pct);
  const Status valid = validate(app);
  XAUTO_CHECK(valid.has_value());
  return made;
}

RatedCase waters_2019() {
  RatedCase made;
  made.name = "waters-2019";
  made.kind = Kind::kPublic;
  made.platform.name = "tx2";
  for (int k = 0; k < 2; ++k)
    made.platform.xpus.push_back({"denver" + std::to_string(k), "denver"});
  for (int k = 0; k < 4; ++k) made.platform.xpus.push_back({"a57" + std::to_string(k), "a57"});
  made.platform.xpus.push_back({"gpu0", "gpu", true, 275});
  AppSpec& app = made.app;
  app.name = made.name;
  // Ticks at most; 0: not there.
  const auto add = [&](const char* module, const char* name, std::int64_t period_ms,
                       std::int64_t a57, std::int64_t denver, std::int64_t gpu) {
    XNodeSpec x{std::string(module) + (name[0] != 0 ? "." : "") + name, module, {}};
    if (a57 > 0) x.wcet_us["a57"] = (a57 + 1999) / 2000;
    if (denver > 0) x.wcet_us["denver"] = (denver + 1999) / 2000;
    if (gpu > 0) x.wcet_us["gpu"] = (gpu + 1499) / 1500;
    const int index = static_cast<int>(app.xnodes.size());
    if (period_ms > 0) {
      x.sources = {static_cast<int>(app.sources.size())};
      app.sources.push_back({std::string(module) + "_timer", {period_ms * 1000}});
    } else {
      app.edges.emplace_back(index - 1, index);
    }
    app.xnodes.push_back(std::move(x));
    return index;
  };
  const int dasm = add("dasm", "", 5, 3'719'990, 2'599'996, 0);
  const int can = add("can", "", 10, 1'199'360, 1'199'744, 0);
  const int ekf = add("ekf", "", 15, 9'519'340, 8'858'959, 0);
  const int planner = add("planner", "", 15, 26'483'822, 24'873'529, 0);
  const int lidar = add("lidar", "", 33, 27'320'000, 21'736'000, 0);
  add("sfm", "pre", 33, 7'459'318, 6'355'142, 0);
  add("sfm", "infer", 0, 59'003'000, 55'623'380, 11'850'000);
  const int sfm = add("sfm", "post", 0, 8'347'392, 7'064'516, 0);
  add("lane", "pre", 66, 7'951'921, 7'051'367, 0);
  add("lane", "infer", 0, 102'089'120, 84'475'648, 41'000'000);
  const int lane = add("lane", "post", 0, 8'513'680, 8'199'496, 0);
  add("os", "", 100, 100'000'000, 100'000'000, 0);
  add("detection", "pre", 200, 7'379'120, 6'354'526, 0);
  add("detection", "infer", 0, 0, 0, 174'000'000);
  const int detection = add("detection", "post", 0, 2'045'000, 1'821'000, 0);
  const int localise = add("localization", "pre", 400, 17'878'720, 16'431'488, 0);
  add("localization", "infer", 0, 774'839'355, 589'615'742, 186'000'000);
  const int localised = add("localization", "post", 0, 17'399'985, 12'599'994, 0);
  app.samples = {{lidar, localise}, {can, localise},      {can, ekf},       {localised, ekf},
                 {can, planner},    {ekf, planner},       {lidar, planner}, {sfm, planner},
                 {lane, planner},   {detection, planner}, {planner, dasm}};
  for (std::size_t s = 0; s < app.sources.size(); ++s)
    if (const std::string& name = app.sources[s].name; name != "os_timer" && name != "dasm_timer")
      app.chains.push_back(
          {name.substr(0, name.find('_')) + " to dasm", static_cast<int>(s), dasm});
  complete_modules(app);
  made.load_pct = static_cast<int>(load_ppm(app, made.platform) / 10'000);
  const Status valid = validate(app);
  XAUTO_CHECK(valid.has_value());
  return made;
}

}  // namespace xauto::bench
