// SPDX-License-Identifier: Apache-2.0
// What `xauto monitor` makes of counts: levels and texts of /diagnostics, Prometheus's text, and who is
// answered over HTTP. The text as a whole is read by second implementations in
// tests/integration/monitor_test.py.
#include <algorithm>
#include <cstring>
#include <string>

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include "base/clock.h"
#include "session/distribution.h"

#include "xauto/diagnostics.h"
#include "xauto/live.h"
#include "xauto/metrics.h"

namespace xauto::cli {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

runtime::Distribution results(std::uint64_t count) {
  runtime::Distribution us;
  for (std::uint64_t i = 0; i < count; ++i) us.add(40'125);
  return us;
}

/// A chain every 100 ms that claims 50 ms and has a deadline of 80 ms; its last result came `ago_ms` ago.
RunLook look(std::int64_t at_ns, std::int64_t ago_ms = 20) {
  RunLook look{"7-0", "car", "orin", "xauto", {}, {}};
  look.counts.at_ns = at_ns;
  FlowCounts chain;
  chain.name = "camera -> plan";
  chain.latency_us = results(static_cast<std::uint64_t>(at_ns / 100'000'000));
  chain.period_us = 100'000;
  chain.worst_case_us = chain.allowed_us = 50'000;
  chain.deadline_us = chain.limit_us = 80'000;
  chain.last_us = 40'125;
  chain.longest_us = 48'000;
  chain.last_ns = chain.in_time_ns = at_ns - ago_ms * 1'000'000;
  look.counts.chains.push_back(chain);
  claim_on(look.counts.account, runtime::Claimed::kOfRates);
  return look;
}

Diagnostic find(const std::vector<Diagnostic>& list, const std::string& name) {
  const auto at = std::find_if(list.begin(), list.end(),
                               [&](const Diagnostic& d) { return d.name == "xauto/car: " + name; });
  if (at == list.end()) throw std::runtime_error("no status " + name);
  return *at;
}

std::string value(const Diagnostic& d, const std::string& key) {
  for (const auto& [k, v] : d.values)
    if (k == key) return v;
  return "no such key";
}

Diagnostic chain_of(const RunLook& now, const RunLook* before) {
  return find(diagnostics_of(now, before), "chain camera -> plan");
}

TEST(Diagnostics, AChainInTimeHasAutowaresKeysAndTheCertificatesNumbers) {
  const RunLook before = look(10 * kSecond), now = look(11 * kSecond);
  const Diagnostic d = chain_of(now, &before);
  EXPECT_EQ(d.level, Level::kOk);
  EXPECT_EQ(d.message, "OK");
  EXPECT_EQ(value(d, "is_processing_time_ms_in_expected_range"), "True");
  EXPECT_EQ(value(d, "processing_time_ms"), "40.125");
  EXPECT_EQ(value(d, "is_consecutive_processing_delay_in_range"), "True");
  EXPECT_EQ(value(d, "consecutive_processing_delay_ms"), "0.000");
  EXPECT_EQ(value(d, "worst_case_ms"), "50.000");
  EXPECT_EQ(value(d, "slack_ms"), "2.000");
  EXPECT_EQ(value(d, "deadline_ms"), "80.000");
  EXPECT_EQ(value(d, "rate_hz"), "10.000");
  EXPECT_EQ(value(d, "claim"), "stands");
}

TEST(Diagnostics, OneThatIsLongerThanCertifiedIsAWarningAndBeyondItsDeadlineAnError) {
  const RunLook before = look(10 * kSecond);
  RunLook now = look(11 * kSecond);
  now.counts.chains[0].over_claim = 1;
  now.counts.chains[0].longest_us = 51'000;
  Diagnostic d = chain_of(now, &before);
  EXPECT_EQ(d.level, Level::kWarn);
  EXPECT_EQ(d.message, "1 results longer than the certified worst case of 50.000 ms");
  EXPECT_EQ(value(d, "is_processing_time_ms_in_expected_range"), "False");
  EXPECT_EQ(value(d, "slack_ms"), "-1.000");
  now.counts.chains[0].deadline_misses = 2;
  d = chain_of(now, &before);
  EXPECT_EQ(d.level, Level::kError);
  EXPECT_TRUE(d.message.starts_with("2 results later than the deadline of 80.000 ms"));
  // Without a result in between, the last one still is what it was.
  now.counts.chains[0].last_us = 80'001;
  d = chain_of(now, &now);
  EXPECT_EQ(d.level, Level::kOk);
  EXPECT_EQ(value(d, "is_processing_time_ms_in_expected_range"), "False");
  // What was told once is over.
  RunLook later = look(12 * kSecond);
  later.counts.chains[0].over_claim = 1;
  later.counts.chains[0].deadline_misses = 2;
  EXPECT_EQ(chain_of(later, &now).level, Level::kOk);
}

TEST(Diagnostics, ADelayThatGoesOnIsAnErrorAfterTwoPeriodsAndTheLimit) {
  const RunLook before = look(10 * kSecond);
  RunLook now = look(11 * kSecond);
  now.counts.chains[0].in_time_ns = now.counts.at_ns - 279'000'000;  // 2 * 100 + 80 ms are allowed
  Diagnostic d = chain_of(now, &before);
  EXPECT_EQ(d.level, Level::kOk);
  EXPECT_EQ(value(d, "consecutive_processing_delay_ms"), "279.000");
  now.counts.chains[0].in_time_ns -= 2'000'000;
  d = chain_of(now, &before);
  EXPECT_EQ(d.level, Level::kError);
  EXPECT_EQ(value(d, "is_consecutive_processing_delay_in_range"), "False");
  EXPECT_EQ(d.message, "no result in time for 281.000 ms");
}

TEST(Diagnostics, WhoIsSilentIsStale) {
  const RunLook before = look(10 * kSecond);
  EXPECT_EQ(chain_of(look(11 * kSecond, 279), &before).level, Level::kOk);
  const Diagnostic d = chain_of(look(11 * kSecond, 281), &before);
  EXPECT_EQ(d.level, Level::kStale);
  EXPECT_EQ(d.message, "no result for 281.000 ms");
  RunLook begins = look(11 * kSecond);
  begins.counts.chains[0].latency_us = {};
  begins.counts.chains[0].last_ns = begins.counts.chains[0].in_time_ns = 0;
  begins.counts.chains[0].last_us = begins.counts.chains[0].longest_us = -1;
  EXPECT_EQ(chain_of(begins, nullptr).level, Level::kStale);
  EXPECT_EQ(value(chain_of(begins, nullptr), "processing_time_ms"), "n/a");
}

/// Looked at more often than it releases, a chain without a limit is not silent at each look.
TEST(Diagnostics, WhoHasNoLimitIsSilentAfterTwoPeriodsAndItsLongest) {
  const auto without = [](std::int64_t ago_ms) {
    RunLook now = look(11 * kSecond, ago_ms);
    FlowCounts& chain = now.counts.chains[0];
    chain.worst_case_us = chain.allowed_us = chain.deadline_us = chain.limit_us = 0;
    return now;
  };
  const RunLook before = without(10);
  EXPECT_EQ(chain_of(without(247), &before).level, Level::kOk);  // 2 * 100 + 48 ms
  const Diagnostic d = chain_of(without(249), &before);
  EXPECT_EQ(d.level, Level::kStale);
  EXPECT_EQ(d.message, "no result for 249.000 ms");
  EXPECT_EQ(value(d, "claim"), "none of this; see the chains of app.json");
}

TEST(Diagnostics, WhereNothingIsClaimedThereIsNoThreshold) {
  const RunLook before = look(10 * kSecond);
  RunLook now = look(11 * kSecond);
  now.counts.account.add("lost_activation", 3, "3 activations were lost");
  now.counts.chains[0].over_claim = 5;
  Diagnostic d = chain_of(now, &before);  // the deadline still holds
  EXPECT_EQ(d.level, Level::kOk);
  EXPECT_EQ(d.message, "OK; the certified worst case is not claimed here");
  EXPECT_EQ(value(d, "worst_case_ms"), "n/a");
  EXPECT_EQ(value(d, "slack_ms"), "n/a");
  EXPECT_EQ(value(d, "claim"), "not claimed here: 3 activations were lost");
  EXPECT_EQ(value(d, "is_processing_time_ms_in_expected_range"), "True");
  const Diagnostic claims = find(diagnostics_of(now, &before), "worst cases");
  EXPECT_EQ(claims.level, Level::kWarn);
  EXPECT_EQ(value(claims, "stands"), "False");

  now.counts.chains[0].deadline_us = 0;
  now.counts.chains[0].limit_us = 50'000;  // what the run itself compares with
  now.counts.chains[0].in_time_ns = 1;
  d = chain_of(now, &before);
  EXPECT_EQ(d.level, Level::kOk);
  EXPECT_EQ(d.message, "there is nothing to hold results against");
  for (const char* key :
       {"is_processing_time_ms_in_expected_range", "is_consecutive_processing_delay_in_range",
        "consecutive_processing_delay_ms", "deadline_ms"})
    EXPECT_EQ(value(d, key), "n/a") << key;
}

TEST(Diagnostics, WorstCasesThatAreExceededThoughNothingWasBrokenAreAnError) {
  RunLook now = look(11 * kSecond);
  now.counts.account.change_exceeded = true;
  EXPECT_EQ(find(diagnostics_of(now, nullptr), "worst cases").level, Level::kError);
  now.counts.account.scope.clear();
  EXPECT_EQ(find(diagnostics_of(now, nullptr), "worst cases").level, Level::kOk);
}

TEST(Diagnostics, AChainWhoseEndIsOffIsNeitherLateNorStale) {
  RunLook before = look(10 * kSecond), now = look(20 * kSecond);  // silent for ten seconds
  const auto chain_of = [&] {
    return find(diagnostics_of(now, &before), "chain " + now.counts.chains[0].name);
  };
  now.counts.chains[0].latency_us = before.counts.chains[0].latency_us = results(7);
  now.counts.chains[0].last_ns = now.counts.chains[0].in_time_ns = 9 * kSecond;
  EXPECT_NE(chain_of().level, Level::kOk);
  now.counts.chains[0].off = 3;
  EXPECT_EQ(chain_of().level, Level::kOk);
  EXPECT_EQ(chain_of().message, "its end is off in this table");
  before.counts.chains[0].off = 3;
  EXPECT_NE(chain_of().level, Level::kOk) << "it was off, and is no longer";
  before.counts.modules = {{"fcd", 5, 0, 0, 0, 0}};
  now.counts.modules = {{"fcd", 5, 0, 0, 0, 4}};
  EXPECT_EQ(find(diagnostics_of(now, &before), "module fcd").message, "off in this table");
}

/// By tables of keys the run says so itself, and since when: from then on what comes back has its time.
TEST(Diagnostics, AChainThatATableDoesNotHaveIsNeitherLateNorStale) {
  RunLook before = look(10 * kSecond), now = look(20 * kSecond);
  const auto chain_of = [&] {
    return find(diagnostics_of(now, &before), "chain " + now.counts.chains[0].name);
  };
  FlowCounts& chain = now.counts.chains[0];
  chain.latency_us = before.counts.chains[0].latency_us = results(7);
  chain.last_ns = chain.in_time_ns = 9 * kSecond;
  chain.gone = true;
  chain.gone_or_back_ns = 10 * kSecond;
  EXPECT_EQ(chain_of().level, Level::kOk);
  EXPECT_EQ(chain_of().message, "a module on its way is off in this table");
  chain.gone = false;
  chain.gone_or_back_ns = 20 * kSecond - 1'000'000;
  EXPECT_EQ(chain_of().level, Level::kOk) << "it is back since a millisecond";
  chain.gone_or_back_ns = 11 * kSecond;
  EXPECT_NE(chain_of().level, Level::kOk) << "nine seconds, and nothing came";
}

TEST(Diagnostics, ModulesAndXpus) {
  RunLook before = look(10 * kSecond), now = look(11 * kSecond);
  before.counts.modules = {{"fcd", 5, 0, 1, 0}};
  now.counts.modules = {{"fcd", 15, 2, 1, 0}};
  before.counts.xpus = {{"gpu0", 1, 100'000'000}, {"dla0", 0, 0}};
  now.counts.xpus = {{"gpu0", 3, 350'000'000}, {"dla0", 0, 0}};
  XpuStatus gpu;
  gpu.xpu = "gpu0";
  gpu.workers = {
      {"fcd@gpu0", "running", "fcd.infer"}, {"b@gpu0", "suspended", "b1"}, {"c@gpu0", "idle", ""}};
  now.xpus = {gpu};
  const auto list = diagnostics_of(now, &before);
  EXPECT_EQ(find(list, "module fcd").level, Level::kWarn);
  EXPECT_EQ(find(list, "module fcd").message, "2 activations failed");
  const Diagnostic xpu = find(list, "XPU gpu0");
  EXPECT_EQ(xpu.level, Level::kOk);
  EXPECT_EQ(value(xpu, "busy_percent"), "25.0");
  EXPECT_EQ(value(xpu, "suspensions"), "3");
  EXPECT_EQ(value(xpu, "running"), "fcd.infer");
  EXPECT_EQ(value(xpu, "waiting"), "b1");
  EXPECT_EQ(find(list, "XPU dla0").level, Level::kStale);
  now.scheduling = "ros2";
  EXPECT_EQ(find(diagnostics_of(now, &before), "XPU dla0").level, Level::kOk);
  now.counts.modules[0].deaths = 1;
  EXPECT_EQ(find(diagnostics_of(now, &before), "module fcd").level, Level::kError);
  for (const Diagnostic& d : stale(list, "the run has ended")) {
    EXPECT_EQ(d.level, Level::kStale);
    EXPECT_EQ(d.message, "the run has ended");
  }
}

// ---- Prometheus ----------------------------------------------------------------------------------

bool has(const std::string& text, const std::string& line) {
  return text.starts_with(line + "\n") || text.find("\n" + line + "\n") != std::string::npos;
}

TEST(Metrics, BoundsAreEndsOfTheBoardsBucketsSoEachCountIsExact) {
  RunLook now = look(kSecond);
  FlowCounts& chain = now.counts.chains[0];
  chain.latency_us = {};
  // One result at each side of each bound.
  for (const std::int64_t bound : latency_bounds_us())
    for (const std::int64_t us : {bound - 1, bound}) chain.latency_us.add(us);
  const std::string text = metrics_text({now});
  const std::string bucket = "\nxauto_chain_latency_seconds_bucket{";
  std::vector<std::pair<double, int>> seen;
  for (auto at = text.find(bucket); at != std::string::npos; at = text.find(bucket, at + 1)) {
    const auto le = text.find("le=\"", at) + 4;
    seen.emplace_back(std::stod(text.substr(le)), std::stoi(text.substr(text.find("} ", le) + 2)));
  }
  const std::vector<std::int64_t> bounds = latency_bounds_us();
  ASSERT_EQ(seen.size(), bounds.size() + 1);
  for (std::size_t i = 0; i < bounds.size(); ++i) {
    EXPECT_DOUBLE_EQ(seen[i].first, static_cast<double>(bounds[i]) / 1e6);
    EXPECT_EQ(seen[i].second, 2 * static_cast<int>(i) + 1) << bounds[i];
  }
  EXPECT_EQ(seen.back().second, 2 * static_cast<int>(bounds.size()));
}

TEST(Metrics, NamesAreEscapedAndTimesAreSecondsToTheMicrosecond) {
  RunLook now = look(kSecond);
  now.counts.chains[0].name = "a\"b\\c\nd";
  now.counts.chains[0].longest_us = 50'001;
  const std::string text = metrics_text({now});
  const std::string labels = R"({app="car",run="7-0",chain="a\"b\\c\nd"})";
  EXPECT_TRUE(has(text, "xauto_chain_last_latency_seconds" + labels + " 0.040125")) << text;
  EXPECT_TRUE(has(text, "xauto_chain_worst_case_seconds" + labels + " 0.05"));
  EXPECT_TRUE(has(text, "xauto_chain_slack_seconds" + labels + " -0.000001"));
}

TEST(Metrics, AWorstCaseThatIsNotClaimedIsAbsent) {
  RunLook now = look(kSecond);
  EXPECT_TRUE(has(metrics_text({now}), "xauto_claim_stands{app=\"car\",run=\"7-0\"} 1"));
  now.counts.account.add("lost_activation", 1, "lost");
  std::string text = metrics_text({now});
  EXPECT_TRUE(has(text, "xauto_claim_stands{app=\"car\",run=\"7-0\"} 0"));
  EXPECT_EQ(text.find("worst_case_seconds"), std::string::npos);
  EXPECT_EQ(text.find("slack_seconds"), std::string::npos);
  EXPECT_NE(text.find("xauto_chain_deadline_seconds"), std::string::npos);
  now.counts.account.scope.clear();
  now.counts.chains[0].worst_case_us = 0;
  text = metrics_text({now});
  EXPECT_EQ(text.find("claim_stands"), std::string::npos);
  EXPECT_EQ(text.find("over_worst_case"), std::string::npos);
}

TEST(Metrics, ScenariosThatTheRunHasNotNamedYetAreAbsent) {
  RunLook now = look(kSecond);
  now.counts.scenario.emplace();
  now.counts.scenarios.resize(2);
  EXPECT_EQ(metrics_text({now}).find("xauto_scenario_active"), std::string::npos);
  now.counts.scenario->name = now.counts.scenarios[1].name = "GPU at half";
  const std::string text = metrics_text({now});
  const auto first = text.find("\nxauto_scenario_active{");
  ASSERT_NE(first, std::string::npos);
  EXPECT_EQ(text.find("\nxauto_scenario_active{", first + 1), std::string::npos);
}

TEST(Metrics, WithoutARunThereIsStillAPage) {
  EXPECT_TRUE(has(metrics_text({}), "xauto_runs 0"));
}

/// "kind count" of what breaks the claim.
std::vector<std::string> breaking(const runtime::Account& account) {
  std::vector<std::string> kinds;
  for (const runtime::Assumption& one : account.assumptions)
    if (one.count > 0 && one.broken()) kinds.push_back(one.kind + " " + std::to_string(one.count));
  return kinds;
}

/// A run that claims something.
std::shared_ptr<runtime::Board> claiming(const runtime::BoardShape& shape) {
  const auto board = runtime::Board::local(shape);
  board->header().claimed = static_cast<std::uint32_t>(runtime::Claimed::kOfRates);
  return board;
}

/// As the report says it after the run. A budget is the deployment's wish: to pass it breaks no claim.
TEST(Counts, AJobPastItsWcetBreaksTheClaimOfOnePolicyAndABudgetDoesNot) {
  const auto board = claiming({.nodes = 2});
  runtime::XNodeLine& line = board->xnode(1);
  runtime::name_line(line.name, "m.x");
  line.jobs = 9;
  line.overruns = 4;
  ASSERT_TRUE(counts_of(*board).account.claims());
  EXPECT_TRUE(counts_of(*board).account.stands());
  line.over_wcet = 2;
  const runtime::Account account = counts_of(*board).account;
  EXPECT_EQ(account.broken(),
            std::vector<std::string>{"2 of 9 jobs outran their WCET, m.x by 0.000 ms"});
  EXPECT_EQ(breaking(account), std::vector<std::string>{"wcet_overrun 2"});
  EXPECT_EQ(account.count_of("budget_overrun"), 4u);
}

TEST(Counts, WhatIsLostBetweenHostsIsCountedByLink) {
  const auto board = claiming({.flows = 2, .crossings = 2});
  const char* const from[] = {"rear", "front"};
  for (std::uint32_t c = 0; c < 2; ++c) {
    runtime::CrossingLine& line = board->crossing(c);
    runtime::name_line(line.xnode, "m.x" + std::to_string(c));
    runtime::name_line(line.from, from[c]);
    runtime::name_line(line.to, "third");
    line.x_us = 900;
    line.messages = 8;
  }
  EXPECT_TRUE(counts_of(*board).account.stands());
  board->crossing(0).lost = 3;
  board->crossing(0).late = 2;
  board->crossing(0).latest_ns = 1'500'000;
  const Counts counts = counts_of(*board);
  EXPECT_EQ(
      counts.account.broken(),
      std::vector<std::string>{"3 of 11 messages of XNode 'm.x0' were not here, from 'rear' to "
                               "'third', by their key + X = 0.900 ms: 2 came later, by up to "
                               "1.500 ms, 1 never came"});
  ASSERT_EQ(counts.crossings.size(), 2u);  // by link
  EXPECT_EQ(counts.crossings[0].xnode, "m.x1");
  EXPECT_EQ(counts.crossings[1].lost, 3u);
  RunLook now{"7-0", "car", "orin", "xauto", counts, {}, "third"}, before = now;
  before.counts.crossings[1].lost = 1;
  const auto said = diagnostics_of(now, &before);
  const auto at =
      std::ranges::find(said, "xauto/car@third: m.x0 from rear to third", &Diagnostic::name);
  ASSERT_NE(at, said.end());
  EXPECT_EQ(at->level, Level::kWarn);
  EXPECT_EQ(at->message, "2 messages were not here by their key + X");
  const std::string metrics = metrics_text({now}, {});
  EXPECT_NE(
      metrics.find(
          R"(xauto_crossing_lost_total{app="car",run="7-0",xnode="m.x0",from="rear",to="third"} 3)"),
      std::string::npos)
      << metrics;
}

TEST(Counts, ReleasesThatMetBreakTheClaimsOfOneAtATime) {
  const auto board = claiming({.nodes = 1, .flows = 2});
  EXPECT_TRUE(counts_of(*board).account.stands());
  board->count_release();
  board->count_release();
  board->header().overlapping = 1;  // counted where app.json has no rates
  EXPECT_EQ(counts_of(*board).account.broken(),
            std::vector<std::string>{"1 of 2 releases came while an earlier one was in flight"});
}

TEST(Counts, AJobThatNoScenarioCoversBreaksTheClaimOfTables) {
  const auto board = claiming({.nodes = 1, .flows = 2, .scenarios = 1});
  board->xnode(0).jobs = 9;
  runtime::name_line(board->xnode(0).name, "m.x");
  ASSERT_TRUE(counts_of(*board).account.claims());
  EXPECT_TRUE(counts_of(*board).account.stands());
  board->xnode(0).over(2, 500'000);
  EXPECT_EQ(
      counts_of(*board).account.broken(),
      std::vector<std::string>{"2 of 9 jobs outran the WCET of their scenario, m.x by 0.500 ms"});
}

TEST(Counts, WhatMetAChangeIsShownBesideItsWorstCase) {
  const auto board = claiming({.flows = 2, .scenarios = 2});
  runtime::name_line(board->scenario(0).name, "fast");
  runtime::name_line(board->scenario(1).name, "slow");
  runtime::name_line(board->flow(1).name, "lane");
  EXPECT_FALSE(counts_of(*board).spanned);
  EXPECT_EQ(spanned_text(counts_of(*board)), "");
  EXPECT_EQ(spanned_json(counts_of(*board)).dump(), "null");
  board->header().spanned.take({0, 1, 1, 31'000, 60'000, 61'200});
  const Counts counts = counts_of(*board);
  EXPECT_FALSE(counts.account.exceeded());
  EXPECT_EQ(scenario_json(counts).at("spanned").dump(), spanned_json(counts).dump());
  EXPECT_EQ(spanned_json(counts).dump(),
            R"({"from":"fast","to":"slow","us":31000,"worst_case_us":60000,"chain":"lane"})");
  EXPECT_NE(scenario_text(counts).find(
                "of what met a change the nearest to its worst case, a result of 'lane', took "
                "31.00 ms of 60.00 ms ('fast' to 'slow')"),
            std::string::npos)
      << scenario_text(counts);
  board->header().spanned.take({1, 0, 1, 61'300, 60'000, 61'200});
  EXPECT_TRUE(counts_of(*board).account.exceeded());
  EXPECT_EQ(
      spanned_text(counts_of(*board)),
      "  of what met a change the nearest to its worst case, a result of 'lane', took 61.30 ms "
      "of *60.00 ms ('slow' to 'fast')\n");
  board->header().spanned.take({7, 0, 1, 99'000, 60'000, 61'200});  // whatever the app wrote there
  EXPECT_FALSE(counts_of(*board).spanned);
}

TEST(Counts, WhatHasNotEndedBreaksTheClaim) {
  const auto board = claiming({.nodes = 1});
  runtime::XNodeLine& line = board->xnode(0);
  runtime::name_line(line.name, "m.x");
  runtime::name_line(line.module, "m");
  line.unended = 1;
  line.unended_ns = 9'123'456'789;
  line.unended_wcet_ns = 18'602'000;
  line.hangs = 2;
  const runtime::Account account = counts_of(*board).account;
  EXPECT_FALSE(account.stands());
  EXPECT_EQ(
      account.broken(),
      (std::vector<std::string>{"XNode 'm.x' of XModule 'm' has run for 9123.46 ms and has not "
                                "ended; its WCET is 18.60 ms",
                                "2 jobs of XNode 'm.x' of XModule 'm' ran past their hang limit"}));
  EXPECT_EQ(breaking(account), (std::vector<std::string>{"wcet_overrun 1", "hang 2"}));
}

TEST(Counts, WhatIsNotSuspendedOrNotResumedBreaksTheClaim) {
  const auto board = claiming({.nodes = 1, .xpus = 2});
  runtime::name_line(board->xpu(1).name, "gpu0");
  runtime::XNodeLine& line = board->xnode(0);
  runtime::name_line(line.name, "m.x");
  EXPECT_TRUE(counts_of(*board).account.stands());
  line.failed_on = 1;
  line.failed_suspends = 25;
  line.failed_resumes = 1;
  const runtime::Account account = counts_of(*board).account;
  EXPECT_EQ(account.broken(),
            (std::vector<std::string>{
                "preemption failed 25 times on gpu0: the work of XNode 'm.x' was not suspended",
                "preemption failed 1 time on gpu0: the work of XNode 'm.x' was not resumed"}));
  EXPECT_EQ(breaking(account),
            (std::vector<std::string>{"failed_suspension 25", "failed_resumption 1"}));
  line.failed_on = 7;  // whatever another program wrote there
  EXPECT_EQ(counts_of(*board).account.broken().size(), 2u);
}

/// There its XPU counts as lost, and they say what is claimed then.
TEST(Counts, AHangByTablesBreaksNothingByItself) {
  const auto board = claiming({.nodes = 1, .flows = 2, .scenarios = 1});
  board->xnode(0).hangs = 1;
  EXPECT_TRUE(counts_of(*board).account.stands());
}

TEST(Counts, ADaemonThatDiedIsADeathAlsoIfItWasStartedAgain) {
  const auto board = claiming({.modules = 1});
  board->module(0).deaths = 1;
  board->header().daemon_deaths = 2;
  const runtime::Account account = counts_of(*board).account;
  EXPECT_EQ(account.broken(),
            (std::vector<std::string>{"processes of the run died",
                                      "coordinators of the run, or its emulator, died"}));
  EXPECT_EQ(breaking(account), (std::vector<std::string>{"process_death 1", "daemon_death 2"}));
}

/// Nobody looks there: no number, instead of 0.
TEST(Counts, WhereNothingIsClaimedWcetsAreNotCounted) {
  const auto board = runtime::Board::local({.nodes = 1});
  for (const runtime::Assumption& one : counts_of(*board).account.assumptions)
    EXPECT_NE(one.kind, "wcet_overrun");
}

}  // namespace
}  // namespace xauto::cli
