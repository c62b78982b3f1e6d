// SPDX-License-Identifier: Apache-2.0
#include "solver/least_loss.h"

#include <gtest/gtest.h>

#include "problem_random.h"

namespace xauto::solver {
namespace {

/// Some XNodes with variants, some modules optional; those that wait for an optional one are, too.
AppSpec random_app(test::Dice& dice) {
  AppSpec app;
  app.name = "random";
  const int modules = dice.roll(2, 6);
  for (int m = 0; m < modules; ++m) {
    const std::string module = "m" + std::to_string(m);
    for (int k = dice.roll(1, 2); k > 0; --k) {
      XNodeSpec x{module + "." + std::to_string(k), module, {{"cpu", dice.roll(100, 200)}}};
      if (dice.roll(0, 1) == 0) x.wcet_us["gpu"] = dice.roll(50, 150);
      for (int v = dice.roll(0, 2); v > 0; --v)
        x.variants.push_back(
            {"v" + std::to_string(v), dice.roll(1, 100), {{"cpu", dice.roll(10, 150)}}});
      app.xnodes.push_back(std::move(x));
    }
  }
  std::vector<char> optional(static_cast<std::size_t>(modules));
  for (char& one : optional) one = dice.roll(0, 1) == 0;
  for (int to = 1; to < modules; ++to) {
    if (dice.roll(0, 2) == 0) continue;
    const int from = dice.roll(0, to - 1);
    const auto first = [&](int m) { return app.find("m" + std::to_string(m) + ".1"); };
    app.edges.emplace_back(first(from), first(to));
    if (optional[static_cast<std::size_t>(from)] != 0) optional[static_cast<std::size_t>(to)] = 1;
  }
  optional[0] = 0;
  for (int m = 0; m < modules; ++m)
    if (optional[static_cast<std::size_t>(m)] != 0)
      app.modules.push_back({"m" + std::to_string(m), 1, true});
  return app;
}

/// Every loss that validate() accepts, one after the other; its own arithmetic of what each costs.
void for_each_loss(const AppSpec& app, const std::function<void(const Loss&, std::int64_t)>& use) {
  const std::size_t modules = app.modules.size();
  for (std::size_t off = 0; off < std::size_t{1} << modules; ++off) {
    Loss loss;
    for (std::size_t m = 0; m < modules; ++m)
      if ((off >> m & 1) != 0) loss.off.push_back(app.modules[m].name);
    loss.variant.assign(app.xnodes.size(), -1);
    for (;;) {
      if (validate(loss, app, "")) {
        std::int64_t pct = 100 * static_cast<std::int64_t>(loss.off.size());
        bool twice = false;
        for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
          if (loss.variant[i] < 0) continue;
          twice = twice || loss.is_off(app.xnodes[i].module);
          pct +=
              100 - app.xnodes[i].variants[static_cast<std::size_t>(loss.variant[i])].quality_pct;
        }
        if (!twice) use(loss, pct);
      }
      std::size_t i = 0;
      for (; i < app.xnodes.size(); ++i) {
        if (++loss.variant[i] < static_cast<int>(app.xnodes[i].variants.size())) break;
        loss.variant[i] = -1;
      }
      if (i == app.xnodes.size()) break;
    }
  }
}

/// The longest it may take on one CPU, each XNode at the fastest that its quality or less has: more
/// loss never hurts.
std::int64_t work(const AppSpec& app, const Loss& loss) {
  std::int64_t sum = 0;
  for (std::size_t i = 0; i < app.xnodes.size(); ++i) {
    const XNodeSpec& x = app.xnodes[i];
    if (loss.is_off(x.module)) continue;
    const int chosen = loss.variant_of(i);
    const std::int64_t quality =
        chosen < 0 ? 101 : x.variants[static_cast<std::size_t>(chosen)].quality_pct;
    std::int64_t us = x.wcet_us.at("cpu");
    for (const VariantSpec& v : x.variants)
      if (v.quality_pct >= quality) us = std::min(us, v.wcet_us.at("cpu"));
    sum += us;
  }
  return sum;
}

TEST(LeastLoss, IsTheLeastOfAllThatSuffice) {
  Platform platform;
  platform.xpus = {{"cpu0", "cpu"}};
  int with_loss = 0, without = 0, hopeless = 0;
  for (std::uint64_t seed = 1; seed <= 300; ++seed) {
    test::Dice dice(seed);
    const AppSpec app = random_app(dice);
    if (!validate_losses(app)) continue;
    std::int64_t most = 0, least = INT64_MAX;
    for_each_loss(app, [&](const Loss& loss, std::int64_t) {
      most = std::max(most, work(app, loss));
      least = std::min(least, work(app, loss));
    });
    const std::int64_t limit = dice.roll(static_cast<int>(least) - 20, static_cast<int>(most) + 20);
    std::int64_t expected = -1;
    for_each_loss(app, [&](const Loss& loss, std::int64_t pct) {
      if (work(app, loss) <= limit && (expected < 0 || pct < expected)) expected = pct;
    });
    const LeastLoss found =
        least_loss(app, platform, [&](const Loss& loss) { return work(app, loss) <= limit; });
    EXPECT_TRUE(validate(found.loss, app, "")) << seed;
    EXPECT_EQ(found.suffices, expected >= 0) << seed;
    if (!found.suffices) {
      ++hopeless;
      continue;
    }
    EXPECT_TRUE(found.least) << seed;
    EXPECT_LE(work(app, found.loss), limit) << seed;
    EXPECT_EQ(loss_pct(found.loss, app), expected) << seed;
    ++(expected > 0 ? with_loss : without);
  }
  EXPECT_GT(with_loss, 50);
  EXPECT_GT(without, 10);
  EXPECT_GT(hopeless, 5);
}

TEST(LeastLoss, WhatIsOverSaysThatNothingIsShown) {
  Platform platform;
  platform.xpus = {{"cpu0", "cpu"}};
  AppSpec app;
  app.name = "a";
  app.xnodes = {{"a", "a", {{"cpu", 100}}}, {"b", "b", {{"cpu", 100}}}};
  for (XNodeSpec& x : app.xnodes) x.variants = {{"small", 50, {{"cpu", 10}}}};
  std::atomic<bool> stop{false};
  const LeastLoss found = least_loss(app, platform,
                                     [&](const Loss& loss) {
                                       stop = true;
                                       return work(app, loss) <= 120;
                                     },
                                     {TimePoint::max(), &stop});
  EXPECT_TRUE(found.suffices);
  EXPECT_FALSE(found.least);
  EXPECT_LE(work(app, found.loss), 120);
}

}  // namespace
}  // namespace xauto::solver
