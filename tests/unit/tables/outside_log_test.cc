// SPDX-License-Identifier: Apache-2.0
// What is said of what is outside of every scenario, and what is only counted.
#include "tables/outside_log.h"

#include <gtest/gtest.h>

namespace xauto::runtime {
namespace {

using Kind = OutsideLog::Kind;
using Lines = std::vector<std::string>;

OutsideLog::What what(Kind kind, const std::string& name, const std::string& words = "") {
  return {kind, name, [=] { return name + words; }};
}
const OutsideLog::What kJobOnGpu = what(Kind::kJob, "on_gpu"),
                       kJobOnDla = what(Kind::kJob, "on_dla"),
                       kClockFile = what(Kind::kFile, "/clock");

TEST(OutsideLog, EachIsSaidWhenItComesAndAgainWhenItComesAnew) {
  OutsideLog log;
  EXPECT_EQ(log.look(0, {kJobOnGpu}).say, Lines{"on_gpu"});
  EXPECT_EQ(log.look(1, {kJobOnGpu}).say, Lines{}) << "it goes on";
  EXPECT_EQ(log.look(2, {kJobOnGpu, kJobOnDla}).say, Lines{"on_dla"}) << "another one beside it";
  EXPECT_EQ(log.look(3, {kJobOnDla, kClockFile}).say, Lines{"/clock"});
  EXPECT_EQ(log.look(4, {}).say, Lines{});
  const OutsideLog::News news = log.look(5, {kClockFile, what(Kind::kJob, "on_gpu", " again")});
  EXPECT_EQ(news.say, (Lines{"/clock", "on_gpu again"}));
  EXPECT_EQ(news.jobs, 1u);
  EXPECT_EQ(news.files, 1u);
  EXPECT_EQ(log.all(Kind::kJob), (Lines{"on_dla", "on_gpu, 2 times"}));
  EXPECT_EQ(log.all(Kind::kFile), Lines{"/clock, 2 times"});
}

TEST(OutsideLog, WhatFluttersFillsNoLogAndIsCounted) {
  OutsideLog log;
  std::size_t said = 0, counted = 0;
  Lines last;
  const auto flutter = [&](std::int64_t from_ns) {
    for (int k = 0; k < 1000; ++k) {
      const OutsideLog::News news = log.look(from_ns + k, {kClockFile});
      said += news.say.size();
      counted += news.files;
      if (!news.say.empty()) last = news.say;
      (void)log.look(from_ns + k, {});
    }
  };
  flutter(0);
  EXPECT_EQ(said, 1u + OutsideLog::kAgain);
  EXPECT_EQ(counted, 1000u);
  EXPECT_EQ(last, Lines{"/clock (what comes again is only counted for 60 s)"});
  EXPECT_EQ(log.look(1000, {kJobOnDla}).say, Lines{"on_dla"}) << "what is new is said all the same";
  flutter(OutsideLog::kAgainNs);
  EXPECT_EQ(said, 1u + 2 * OutsideLog::kAgain);
  EXPECT_EQ(log.all(Kind::kFile), Lines{"/clock, 2000 times"});
}

}  // namespace
}  // namespace xauto::runtime
