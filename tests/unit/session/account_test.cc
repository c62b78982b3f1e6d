// SPDX-License-Identifier: Apache-2.0
// What a run says of its claims; and whom a run that exceeds them is sent to: the authors only where nothing whatever
// explains it.
#include "session/account.h"

#include <gtest/gtest.h>

#include "model/json_value.h"

namespace xauto::runtime {
namespace {

constexpr const char* kReport = "please report this run";

/// Claims 100 ms of a chain whose worst result took so much longer.
Account exceeded_by(std::int64_t us) {
  Account account;
  claim_on(account, Claimed::kOfRates);
  ChainAccount& chain = account.chains.emplace_back();
  chain.name = "camera";
  chain.worst_case_us = 100'000;
  chain.latency_us.add(100'000 + us);
  if (us <= 0) return account;
  chain.over_claim = 1;
  chain.over_us = 100'000 + us;
  chain.over_claimed_us = 100'000;
  return account;
}

TEST(Account, AsksForAReportOnlyWhereNothingExplainsIt) {
  Account account = exceeded_by(30'000);
  const auto said = [&] { return account.verdict_words(); };
  EXPECT_EQ(account.verdict(), Verdict::kExceeded);
  EXPECT_NE(said().find(kReport), std::string::npos);
  account.taken = {{"little", 40}, {"the thread 'x' waited", 28'000}};
  EXPECT_EQ(said(), "exceeded; the app broke nothing that is watched, but: the thread 'x' waited");
  account.taken = {{"little", 40}};
  EXPECT_NE(said().find(kReport), std::string::npos) << "40 us do not explain 30 ms";
  account.chains = exceeded_by(30).chains;
  EXPECT_EQ(said().find(kReport), std::string::npos) << "they explain 30 us";
  account.chains = exceeded_by(30'000).chains;
  account.not_watched = "/proc is not there";
  EXPECT_EQ(said().find(kReport), std::string::npos);
  EXPECT_NE(said().find("is not watched here (/proc is not there)"), std::string::npos);
  account.not_watched.clear();
  account.goes_on = true;
  EXPECT_EQ(said().find(kReport), std::string::npos) << "what took time is not known yet";
}

TEST(Account, KeptIsKeptAndWhatIsBrokenGoesBeforeAll) {
  Account account = exceeded_by(0);
  EXPECT_EQ(account.verdict_words(), "kept, as far as it is watched");
  account.taken = {{"waited", 1'000'000}};
  account.add("lost_activation", 0, std::string());
  EXPECT_EQ(account.verdict_words(), "kept, as far as it is watched");
  account.add("wcet_overrun", 2, "a");
  EXPECT_EQ(account.verdict(), Verdict::kNotClaimed);
  EXPECT_EQ(account.verdict_words(), "not claimed here: a");
  EXPECT_EQ(account.words().find("worst cases of every release, once"), 0u);
  account.chains = exceeded_by(5'000).chains;
  account.add("hang", 1, "b");
  EXPECT_EQ(account.verdict_words(), "exceeded, and not claimed here: a; b");
  EXPECT_EQ(account.verdict_words(Layout::kList),
            "exceeded, and not claimed here:\n    - a\n    - b");
  EXPECT_NE(
      account.words().find("chain 'camera': 1 result longer than claimed, the worst 105.00 ms "
                           "of 100.00 ms"),
      std::string::npos);
}

TEST(Account, WhereNothingIsClaimedNothingIsBroken) {
  Account account = exceeded_by(5'000);
  account.scope.clear();
  account.add("lost_activation", 3, "3 activations were lost");
  EXPECT_EQ(account.verdict(), Verdict::kNothingClaimed);
  EXPECT_FALSE(account.exceeded());
  EXPECT_TRUE(account.broken().empty());
  EXPECT_EQ(account.count_of("lost_activation"), 3u);
  EXPECT_EQ(account.words(), "nothing is claimed of this run");
  claim_on(account, Claimed::kUncertified);
  EXPECT_NE(account.words().find("not certified"), std::string::npos);
}

TEST(Account, WhoKnowsMoreSpeaksFirst) {
  Account account = exceeded_by(0);
  account.add("release_off_grid", 0, "source 'camera' was 12 us off");
  account.add("release_off_grid", 7, "7 releases were off");
  EXPECT_EQ(account.broken(), std::vector<std::string>{"source 'camera' was 12 us off"});
  EXPECT_EQ(account.count_of("release_off_grid"), 7u);
}

TEST(Account, UrgentReleasesHaveAClaimOfTheirOwn) {
  Account account = exceeded_by(0);
  ChainAccount& chain = account.chains[0];
  chain.urgent_worst_case_us = 20'000;
  chain.longest_urgent_us = 26'000;
  EXPECT_FALSE(account.exceeded());
  chain.urgent_exceeded = true;
  account.taken = {{"waited", 5'900}};
  EXPECT_EQ(account.verdict(), Verdict::kExceeded);
  EXPECT_EQ(account.taken_from(), std::vector<std::string>{"waited"});
}

TEST(Account, JsonHasWhatWasNotKeptAndNoP99OfFew) {
  Account account = exceeded_by(5'000);
  account.add("lost_activation", 3, "3 activations were lost");
  account.add("hang", 0, std::string());
  const std::string claims = claims_json(account).dump();
  EXPECT_NE(claims.find(R"("verdict":"exceeded, not claimed")"), std::string::npos) << claims;
  EXPECT_NE(claims.find(R"("kind":"lost_activation")"), std::string::npos);
  EXPECT_EQ(claims.find("hang"), std::string::npos);
  const std::string few = chain_json(account.chains[0]).dump();
  EXPECT_NE(few.find(R"("p99":null)"), std::string::npos) << few;
  for (int i = 0; i < 100; ++i) {
    account.chains[0].latency_us.add(7);
    account.chains[0].age_us.add(7);
  }
  EXPECT_EQ(chain_json(account.chains[0]).dump().find(R"("p99":null)"), std::string::npos);
}

}  // namespace
}  // namespace xauto::runtime
