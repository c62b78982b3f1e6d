// SPDX-License-Identifier: Apache-2.0
#include "session/session.h"

#include <gtest/gtest.h>

#include "model/periodic.h"
#include "session/run_report.h"

namespace xauto::runtime {
namespace {

Session at_rest() {
  Session session;
  session.app.name = "two";
  session.app.clocks = {{"main", 0}, {"other", 50}};
  session.app.sources = {{"s", {100'000, 3}, 2'000, 10}, {"t", {10'000}, 0, 0, 1}};
  session.app.xnodes = {{"a", "A", {{"cpu", 100}}, {0}}, {"b", "B", {{"cpu", 200}}, {1}}};
  session.app.modules = {{"A"}, {"B"}};
  session.app.samples = {{0, 1}};
  session.app.chains = {{"c", 0, 1}};
  session.platform = {"one", {{"cpu0", "cpu"}}};
  return session;
}

TEST(Session, PrioritiesTravelAsPriorities) {
  Session session = at_rest();
  Policy policy{"two", session.app.hash(), "one", "test", {{0, {}}, {0, {}}}};
  policy.certified = false;
  policy.placements[0].priority = 2;
  policy.placements[1].priority = 1;
  session.take_policy(policy);
  EXPECT_FALSE(session.keys);
  const auto read = parse_session(*to_json(session));
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_FALSE(read->keys);
  EXPECT_EQ(read->policy, session.policy);
  EXPECT_EQ(read->policy.placements[0].priority, 2);
  EXPECT_EQ(read->app, session.app);
  session.policy.placements[1].priority = 2;  // as the other one's
  EXPECT_FALSE(parse_session(*to_json(session)));
}

TEST(Session, KeysTravelAsKeys) {
  Session session = at_rest();
  session.take_policy(Policy{"two",
                             session.app.hash(),
                             "one",
                             "test",
                             {{0, {5'000}}, {0, {300}}},
                             {{"c", 50'000, 300}},
                             0});
  ASSERT_TRUE(session.keys);
  EXPECT_GT(session.policy.placements[1].priority, session.policy.placements[0].priority)
      << "its key is the smaller one";
  const auto read = parse_session(*to_json(session));
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(read->keys, session.keys);
  EXPECT_EQ(read->policy, session.policy);
}

Session full() {
  Session session = at_rest();
  session.mode = Mode::kProfile;
  session.scheduling = Scheduling::kTimeshare;
  session.cpu.sched = CpuSched::kExt;
  session.cpu.run = "run";
  session.cpu.first_xnode = 7;
  session.cpu.partial = true;
  session.presence = {Presence::kEither};
  session.coordinators = {{"cpu0", "socket"}};
  session.releases.activations = 5;
  session.releases.duration_us = std::int64_t{1} << 40;
  session.releases.record = "a \"b\".db3";
  session.parts.hub_fd = -1;
  session.profile.contended = session.profile.audit = true;
  session.profile.machine_root = "/host";
  session.load.xpu = 0;
  session.load.cores = {0, 3};
  session.trace_keep_s = 0.25;
  session.parts.modules = {{"A"}, {}, {"B", "C"}};
  return session;
}

TEST(Session, EachFieldTravels) {
  const Session session = full();
  const auto read = parse_session(*to_json(session));
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(*to_json(*read), *to_json(session));
  EXPECT_EQ(read->presence, session.presence);
  EXPECT_EQ(read->coordinators, session.coordinators);
  EXPECT_EQ(read->parts.modules, session.parts.modules);
  EXPECT_EQ(read->releases.duration_us, session.releases.duration_us);
  EXPECT_EQ(read->releases.record, session.releases.record);
  EXPECT_EQ(read->cpu.sched, CpuSched::kExt);
  EXPECT_TRUE(read->profile.contended && read->profile.audit);
  EXPECT_EQ(read->profile.machine_root, "/host");
  EXPECT_EQ(read->load.cores, session.load.cores);
}

TEST(Session, ALoadIsOfAnXpuAndOnCores) {
  Session session = full();
  session.mode = Mode::kLoad;
  EXPECT_TRUE(parse_session(*to_json(session)));
  session.load.xpu = static_cast<int>(session.platform.xpus.size());
  EXPECT_FALSE(parse_session(*to_json(session)));
  session.load.xpu = -1;
  EXPECT_FALSE(parse_session(*to_json(session)));
  session.load.xpu = 0;
  session.load.cores = {};
  EXPECT_FALSE(parse_session(*to_json(session)));
}

TEST(Session, APathThatJsonWouldChangeIsRefused) {
  Session session = full();
  session.releases.record = "/tmp/\xff";
  const auto text = to_json(session);
  ASSERT_FALSE(text);
  EXPECT_EQ(text.error().where, session.releases.record);
}

/// `text` with the value of one member, a number or a word, changed.
/// `field`: "b", or "a.b", whose name is nowhere else.
std::string with(std::string text, const std::string& field, const std::string& value) {
  const std::string name = field.substr(field.find('.') + 1);
  const std::size_t begin = text.find("\"" + name + "\":") + name.size() + 3;
  return text.replace(begin, text.find_first_of(",}", begin) - begin, value);
}

TEST(Session, WhatIsNotAsWrittenIsNamed) {
  const std::string text = *to_json(full());
  for (const auto& [field, value] :
       std::vector<std::pair<std::string, std::string>>{{"mode", "4"},
                                                        {"mode", "-1"},
                                                        {"scheduling", "3"},
                                                        {"cpu.sched", "3"},
                                                        {"cpu.first_xnode", "4294967296"},
                                                        {"cpu.first_xnode", "-1"},
                                                        {"cpu.scheduler_pid", "2147483648"},
                                                        {"cpu.partial", "1"},
                                                        {"releases.lockstep", "null"},
                                                        {"releases.activations", "-1"},
                                                        {"releases.activations", "1.5"},
                                                        {"trace_keep_s", "\"1\""},
                                                        {"parts.hub", "1"},
                                                        {"parts.hub_fd", "{}"}}) {
    const auto read = parse_session(with(text, field, value));
    ASSERT_FALSE(read) << field << " " << value;
    EXPECT_EQ(read.error().what, "malformed session: " + field.substr(0, field.find('.'))) << value;
  }
  EXPECT_FALSE(parse_session(with(text, "version", "2")));
  EXPECT_FALSE(parse_session("{}"));
  EXPECT_FALSE(parse_session("[" + text + "]"));
  EXPECT_FALSE(parse_session(text.substr(0, text.size() - 1)));
}

TEST(RunReport, EachFieldTravels) {
  RunReport report;
  report.complete = true;
  report.note = "two\nlines";
  report.releases = {{1, 2, 3}, {4, 5, -1}};
  report.num_releases = 2;
  for (std::int64_t i = 0; i < 70'000; ++i) report.latencies_us.add(i);
  report.modules = {{"m", true, 1, 2, 3, 4, 6, report.latencies_us, 5}};
  report.account.taken = {{"a child", 7}};
  report.account.not_watched = "no /proc";
  report.xnodes = {{"m.x", 10, 20, 3, 2, 1, 30, 0, 0, 0, "m", 6, 7}};
  claim_on(report.account, Claimed::kOneAtATime);
  report.account.chains.resize(2);
  report.account.chains[0].deadline_us = 40;
  report.account.chains[1].max_age_us = 50;
  report.account.chains[1].urgent_us.add(6);
  report.account.add("set_up", 2, std::vector<std::string>{"one", "two"});
  report.died = {"m", "m"};
  report.several_rates = true;
  const auto read = parse_run_report(to_json(report));
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(to_json(*read), to_json(report));
  EXPECT_EQ(read->latencies_us.quantile(0.9), report.latencies_us.quantile(0.9));
  EXPECT_EQ(read->account.words(), report.account.words());
  EXPECT_EQ(read->account.verdict(), Verdict::kNotClaimed);
  EXPECT_EQ(read->died, report.died);
  // A distribution that cannot be, inside of a module.
  const std::string text = to_json(report);
  EXPECT_EQ(parse_run_report(with(text, "max", "true")).error().what,
            "malformed answer of the app: latencies_us");
}

TEST(RunReport, AnErrorTravels) {
  const Error error = {ErrorCode::kTimeout, "what \xff", "where", "hint"};
  const auto read = parse_run_report(error_to_json(error));
  ASSERT_FALSE(read);
  EXPECT_EQ(read.error().code, ErrorCode::kTimeout);
  EXPECT_EQ(read.error().what, "what \xef\xbf\xbd");  // what is no UTF-8 is replaced
  EXPECT_EQ(read.error().hint, "hint");
  EXPECT_EQ(parse_run_report(with(error_to_json(error), "code", "99")).error().what,
            "malformed answer of the app: code");
}

}  // namespace
}  // namespace xauto::runtime
