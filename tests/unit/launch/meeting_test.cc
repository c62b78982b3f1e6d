// SPDX-License-Identifier: Apache-2.0
// The table of the first host, in virtual time; and two parts over a real socket.
#include "launch/meeting.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "base/clock.h"

namespace xauto::launch {
namespace {

constexpr std::int64_t kS = 1'000'000'000, kTai = 1'000 * kS;

std::string is(const Json& message) {
  return message.at("is").text().value_or("");
}

/// Parts talk to it by hand.
struct Table {
  explicit Table(std::vector<std::string> hosts = {"front", "rear"},
                 std::int64_t most_apart_ns = INT64_MAX)
      : table({.own = {"front", "h", 37},
               .hosts = std::move(hosts),
               .fresh_run = 77,
               .limit_ns = 10 * kS,
               .most_apart_ns = most_apart_ns},
              at()) {}
  MeetingTable::Instant at() const { return {now, kTai + now}; }
  void keep(MeetingTable::Says said) {
    for (MeetingTable::Say& say : said) says.push_back(std::move(say));
  }
  /// What was said to this one, and not looked at yet.
  std::vector<std::string> to(int connection) {
    std::vector<std::string> words;
    for (const MeetingTable::Say& say : says)
      if (say.to == connection) words.push_back(is(say.what));
    std::erase_if(says, [&](const MeetingTable::Say& say) { return say.to == connection; });
    return words;
  }
  Json hello(const std::string& host, std::int64_t off_ns = 0) {
    return {{"is", "hello"},      {"host", host},           {"hash", "h"},
            {"tai_offset_s", 37}, {"clock_ns", kTai + now}, {"tai_ns", kTai + now + off_ns},
            {"run", 0},           {"start_tai_ns", 0}};
  }
  void come(int connection, const std::string& host) {
    keep(table.connected(connection, at()));
    keep(table.hear(connection, hello(host), at()));
  }
  void ready(int connection, bool met = true) {
    keep(table.hear(connection, {{"is", "ready"}, {"met", met}}, at()));
  }
  std::int64_t now = 0;
  std::vector<MeetingTable::Say> says = {};
  MeetingTable table;
};

using Words = std::vector<std::string>;

TEST(MeetingTable, ItStartsOnceAllAreReadyInWhateverOrder) {
  std::vector<int> order = {0, 1, 2};  // who is ready next; 0: we
  do {
    Table t({"front", "rear", "third"});
    t.come(1, "rear");
    EXPECT_EQ(t.to(1), (Words{"clock"}));
    EXPECT_EQ(t.table.run(), 0U);
    t.come(2, "third");
    EXPECT_EQ(t.table.run(), 77U);
    EXPECT_EQ(t.to(1), (Words{"welcome"}));
    EXPECT_EQ(t.to(2), (Words{"clock", "welcome"}));
    for (const int who : order) {
      EXPECT_EQ(t.table.start_tai_ns(), 0);
      ++t.now;
      if (who == 0)
        t.keep(t.table.own(PartStage::kReady, t.at()));
      else
        t.ready(who);
    }
    EXPECT_EQ(t.table.start_tai_ns(), kTai + t.now + kStartLeadNs);
    EXPECT_EQ(t.to(1), (Words{"start"}));
    EXPECT_EQ(t.to(2), (Words{"start"}));
  } while (std::ranges::next_permutation(order).found);
}

TEST(MeetingTable, WhoIsMissingIsNamedAndNothingWaitsForEver) {
  for (int far = 0; far < 3; ++far) {
    Table t({"front", "rear", "third"});
    t.come(1, "rear");
    if (far > 0) t.come(2, "third");
    t.keep(t.table.own(PartStage::kReady, t.at()));
    t.ready(1);
    if (far > 1) t.ready(2, false);
    for (; t.now < 9 * kS; t.now += kS) {
      t.keep(t.table.hear(1, {{"is", "alive"}}, t.at()));
      t.keep(t.table.hear(2, {{"is", "alive"}}, t.at()));
      t.keep(t.table.tick(t.at()));
      EXPECT_FALSE(t.table.error());
    }
    t.now = 10 * kS;
    t.keep(t.table.tick(t.at()));
    ASSERT_TRUE(t.table.error());
    const char* words[] = {"nobody came from host 'third'", "the app did not begin",
                           "DDS did not find"};
    EXPECT_NE(t.table.error()->what.find(words[far]), std::string::npos) << t.table.error()->what;
    EXPECT_NE(t.table.error()->what.find("'third'"), std::string::npos);
    EXPECT_EQ(t.to(1).back(), "refused");
  }
}

TEST(MeetingTable, WhoDoesNotBelongIsRefused) {
  const auto with = [](const char* key, Json value) {
    return [=](Json hello) {
      hello[key] = value;
      return hello;
    };
  };
  for (const auto& [change, why] : std::vector<std::pair<std::function<Json(Json)>, std::string>>{
           {with("host", "nobody"), "is no other host"},
           {with("host", "front"), "is no other host"},
           {with("hash", "g"), "has another app"},
           {with("hash", Json()), "has another app"},
           {with("tai_offset_s", 0), "another offset of TAI"},
           {with("clock_ns", 5), "did not say its time"},
           {with("tai_ns", Json("x")), "did not say its time"}}) {
    Table t;
    t.keep(t.table.connected(1, t.at()));
    t.keep(t.table.hear(1, change(t.hello("rear")), t.at()));
    const MeetingTable::Say& last = t.says.back();
    EXPECT_TRUE(last.close);
    EXPECT_NE(last.what.at("why").text().value_or("").find(why), std::string::npos)
        << last.what.dump();
    EXPECT_EQ(t.table.run(), 0U);
    EXPECT_FALSE(t.table.known(1));
  }
  Table t;
  t.come(1, "rear");
  t.come(2, "rear");
  EXPECT_EQ(t.to(2), (Words{"clock", "refused"}));
  EXPECT_EQ(t.table.run(), 77U);
}

/// It read its clock between our two looks, of which 4 ms apart: a distance is sure only beyond 2 ms.
TEST(MeetingTable, ClocksThatAreSurelyFurtherApartThanAnXAreRefused) {
  const std::int64_t ms = 1'000'000;
  for (const std::int64_t off : {-20 * ms, -13 * ms, -11 * ms, 0 * ms, 11 * ms, 13 * ms, 20 * ms}) {
    Table t({"front", "rear"}, 10 * ms);
    t.keep(t.table.connected(1, t.at()));
    const Json hello = t.hello("rear", 2 * ms + off);
    t.now += 4 * ms;
    t.keep(t.table.hear(1, hello, t.at()));
    EXPECT_EQ(t.to(1).back(), std::abs(off) > 12 * ms ? "refused" : "welcome") << off;
  }
}

TEST(MeetingTable, APartThatDiesIsNamedToAllAndJoinsAgain) {
  Table t({"front", "rear", "third"});
  t.come(1, "rear");
  t.come(2, "third");
  t.keep(t.table.own(PartStage::kReady, t.at()));
  t.ready(1);
  t.ready(2);
  const std::int64_t start = t.table.start_tai_ns();
  ASSERT_GT(start, 0);
  for (int times = 1; times <= 100; ++times) {
    (void)t.to(2);
    t.keep(t.table.gone(times == 1 ? 1 : 10 + times, t.at()));
    EXPECT_EQ(t.to(2), (Words{"gone"}));
    EXPECT_EQ(t.table.deaths().at("rear"), static_cast<std::uint64_t>(times));
    t.come(11 + times, "rear");
    ASSERT_EQ(is(t.says.back().what), "welcome");
    EXPECT_EQ(t.says.back().what.at("run").integer(), 77);
    EXPECT_EQ(t.says.back().what.at("start_tai_ns").integer(), start);
  }
}

TEST(MeetingTable, TheFirstPartJoinsTheRunThatGoesOn) {
  Table t({"front", "rear", "third"});
  t.keep(t.table.connected(1, t.at()));
  Json hello = t.hello("rear");
  hello["run"] = 5;
  hello["start_tai_ns"] = kTai - kS;
  t.keep(t.table.hear(1, hello, t.at()));
  EXPECT_EQ(t.table.run(), 5U);
  EXPECT_EQ(t.table.start_tai_ns(), kTai - kS);
  EXPECT_EQ(t.to(1), (Words{"clock", "welcome"}));
  t.keep(t.table.connected(2, t.at()));
  hello = t.hello("third");
  hello["run"] = 6;
  t.keep(t.table.hear(2, hello, t.at()));
  EXPECT_EQ(t.to(2), (Words{"clock", "refused"}));
}

TEST(MeetingTable, WhoIsSilentIsGone) {
  Table t;
  t.come(1, "rear");
  t.keep(t.table.connected(2, t.at()));
  t.now = kPartSilenceNs + 1;
  t.keep(t.table.tick(t.at()));
  EXPECT_FALSE(t.table.known(1));
  EXPECT_EQ(t.to(2).back(), "refused");
}

TEST(MeetingTable, ReportsAreWaitedForFromThoseThatAreThere) {
  Table t;
  t.come(1, "rear");
  EXPECT_TRUE(t.table.expects_reports());
  t.keep(t.table.hear(1, {{"is", "report"}, {"text", "r"}}, t.at()));
  EXPECT_EQ(t.to(1).back(), "thanks");
  EXPECT_FALSE(t.table.expects_reports());
  EXPECT_EQ(t.table.reports().at("rear"), "r");
  t.keep(t.table.gone(1, t.at()));
  EXPECT_TRUE(t.table.deaths().empty());
}

TEST(FrameReader, FramesComeInWhateverPieces) {
  std::vector<std::byte> bytes = frame_of({{"is", "a"}});
  const auto more = frame_of({{"is", "b"}});
  bytes.insert(bytes.end(), more.begin(), more.end());
  for (std::size_t step = 1; step <= bytes.size(); ++step) {
    FrameReader reader;
    Words words;
    for (std::size_t at = 0; at < bytes.size(); at += step) {
      reader.feed(std::span(bytes).subspan(at, std::min(step, bytes.size() - at)));
      while (const auto message = reader.next(100)) words.push_back(is(*message));
    }
    EXPECT_EQ(words, (Words{"a", "b"}));
    EXPECT_FALSE(reader.bad());
  }
  for (const char* text : {"[]", "{}", "{\"is\":1}", "x"}) {
    const std::string of = text;
    std::vector<std::byte> frame(4 + of.size());
    frame[0] = static_cast<std::byte>(of.size());
    std::ranges::transform(of, frame.begin() + 4, [](char c) { return static_cast<std::byte>(c); });
    FrameReader reader;
    reader.feed(frame);
    EXPECT_FALSE(reader.next(100));
    EXPECT_TRUE(reader.bad()) << text;
  }
  FrameReader reader;
  reader.feed(frame_of({{"is", "long"}}));
  EXPECT_FALSE(reader.next(5));
  EXPECT_TRUE(reader.bad());
}

MeetingRequest request(const std::string& host, const std::string& address) {
  return {.address = address,
          .set_up = {.own = {host, "h", kernel_tai_s()},
                     .hosts = {"front", "rear"},
                     .fresh_run = 9,
                     .limit_ns = 20 * kS}};
}

TEST(Meeting, TwoPartsAgreeOnOneStart) {
  const std::string address = "127.0.0.1:" + std::to_string(20'000 + getpid() % 10'000);
  Result<std::unique_ptr<Meeting>> rear;
  std::thread other([&] { rear = Meeting::begin(request("rear", address)); });
  auto front = Meeting::begin(request("front", address));
  other.join();
  ASSERT_TRUE(front) << front.error().to_string();
  ASSERT_TRUE(rear) << rear.error().to_string();
  EXPECT_EQ((*front)->run(), 9U);
  EXPECT_EQ((*rear)->run(), 9U);
  (*rear)->reached(PartStage::kReady);
  (*front)->reached(PartStage::kReady);
  const std::int64_t limit = now_ns() + 20 * kS;
  while (((*front)->start_ns() == 0 || (*rear)->start_ns() == 0) && now_ns() < limit)
    sleep_until_ns(now_ns() + 1'000'000);
  ASSERT_NE((*front)->start_ns(), 0);
  EXPECT_LT(std::abs((*front)->start_ns() - (*rear)->start_ns()),
            1'000'000);  // of one machine's clock
  (*rear)->end("{}", 20 * kS);
  (*front)->end("", 20 * kS);
  EXPECT_EQ((*front)->reports().at("rear"), "{}");
}

/// Set by 50 us and back: of no consequence to anybody.
TEST(ClockWatch, TheKernelTellsOfAStep) {
  ClockWatch watch;
  ASSERT_GE(watch.fd(), 0);
  EXPECT_FALSE(watch.step_ns());
  const auto set_by = [](std::int64_t by_ns) {
    const std::int64_t to = clock_ns(CLOCK_REALTIME) + by_ns;
    const timespec time{to / kS, to % kS};
    return clock_settime(CLOCK_REALTIME, &time) == 0;
  };
  if (!set_by(50'000)) GTEST_SKIP() << "only CAP_SYS_TIME may set the clock";
  const auto step = watch.step_ns();
  const auto again = watch.step_ns();
  ASSERT_TRUE(set_by(-50'000));
  ASSERT_TRUE(step);
  EXPECT_NEAR(static_cast<double>(*step), 50'000, 25'000);
  EXPECT_FALSE(again);
  EXPECT_TRUE(watch.step_ns());
}

TEST(Meeting, AnAddressThatIsNoneIsRefused) {
  for (const char* address : {"", "front", ":7400", "front:", "256.0.0.1:x"}) {
    const auto front = Meeting::begin(request("front", address));
    ASSERT_FALSE(front);
    EXPECT_EQ(front.error().code, ErrorCode::kInvalid) << address;
  }
}

}  // namespace
}  // namespace xauto::launch
