// SPDX-License-Identifier: Apache-2.0
#include "processes/parameters.h"

#include <atomic>
#include <thread>

#include <gtest/gtest.h>

#include <xauto/xauto.h>

#include "base/memory_file.h"
#include "model/json_value.h"

namespace xauto::runtime {
namespace {

detail::ParameterHandle text(const char* name, const char* initial) {
  return detail::make_parameter(name, std::string(initial));
}

/// Two modules: "A" has count, gain, mode and twin, "B" has mode.
class Parameters : public ::testing::Test {
 protected:
  Parameters() {
    graph.modules.resize(2);
    graph.modules[0].name = "A";
    graph.modules[0].parameters = {detail::make_parameter("count", std::int64_t{3}, 0, 100),
                                   detail::make_parameter("gain", 0.5, -1.0, 1.0),
                                   text("mode", "day"), text("twin", "day")};
    graph.modules[1].name = "B";
    graph.modules[1].parameters = {text("mode", "day")};
    board = Board::local({1, 2, 0, 1, 5});
    for (int m = 0; m < 2; ++m)
      name_line(board->module(m).name, graph.modules[static_cast<std::size_t>(m)].name);
  }
  void post() { ASSERT_TRUE(post_parameters(*board, graph, deployment)); }
  std::string change(const std::string& request) {
    const std::string answer = change_parameters(request, board.get());
    const Status status = answer_error(answer);
    return status ? answer : status.error().to_string();
  }
  std::string set(const std::string& name, const std::string& value) {
    Json request = {{"module", "A"}};
    request["set"][name] = value;
    return change(request.dump());
  }

  Graph graph;
  Deployment deployment;
  std::shared_ptr<Board> board;
};

TEST_F(Parameters, OfTheDeploymentAndAsDeclared) {
  deployment.modules["A"].parameters = {{"count", std::int64_t{7}}, {"mode", std::string("dusk")}};
  EXPECT_EQ(posted_parameters(*board).error().code, ErrorCode::kUnavailable);
  post();
  ParameterReader reader(*board, graph, 0);
  EXPECT_EQ(reader.version(), 0u);
  reader.look();
  EXPECT_EQ(reader.version(), 1u);
  EXPECT_EQ(reader.now()[0].bits, 7u);
  EXPECT_EQ(reader.now()[2].text, "dusk");
  EXPECT_EQ(reader.now()[3].text, "day");
  const auto posted = posted_parameters(*board);
  ASSERT_TRUE(posted);
  ASSERT_EQ(posted->size(), 5u);
  EXPECT_EQ((*posted)[0].value, ParameterValue(std::int64_t{7}));
  EXPECT_EQ((*posted)[0].spec.initial, ParameterValue(std::int64_t{3}));
  EXPECT_EQ((*posted)[1].spec.range(), "-1 to 1");
  EXPECT_EQ((*posted)[4].module, "B");
}

TEST_F(Parameters, WhatADeploymentSaysOfAParameterThatIsNotThereIsRefused) {
  deployment.modules["A"].parameters = {{"cuont", std::int64_t{7}}};
  EXPECT_EQ(post_parameters(*board, graph, deployment).error().to_string(),
            "deployment.json: XModule 'A' has no parameter 'cuont'\n"
            "  hint: it has count, gain, mode, twin");
  deployment.modules["A"].parameters = {{"gain", 1.5}};
  EXPECT_EQ(post_parameters(*board, graph, deployment).error().to_string(),
            "deployment.json: parameter 'gain' of XModule 'A': '1.5' is out of range\n"
            "  hint: possible is -1 to 1");
  deployment.modules.clear();
  deployment.modules["C"].parameters = {{"gain", 1.5}};
  EXPECT_FALSE(post_parameters(*board, graph, deployment));
}

TEST_F(Parameters, AChangeIsSeenByItsModuleAlone) {
  post();
  ParameterReader a(*board, graph, 0), b(*board, graph, 1);
  a.look();
  b.look();
  EXPECT_EQ(change(R"({"module": "A", "set": {"mode": "night", "count": "9"}})"),
            R"({"was":{"mode":"day","count":"3"}})");
  EXPECT_EQ(a.now()[2].text, "day") << "not before it looks";
  a.look();
  b.look();
  EXPECT_EQ(a.now()[0].bits, 9u);
  EXPECT_EQ(a.now()[2].text, "night");
  EXPECT_EQ(a.now()[3].text, "day");
  EXPECT_EQ(b.now()[0].text, "day");
  EXPECT_EQ(b.version(), 1u);
  EXPECT_EQ(set("mode", "n"), R"({"was":{"mode":"night"}})");
  a.look();
  EXPECT_EQ(a.now()[2].text, "n");
  EXPECT_EQ(a.now()[0].bits, 9u) << "what does not change stays, in both copies";
  EXPECT_EQ(changed_parameters(*board),
            "parameters were changed during the run, which may not be the values that WCETs were "
            "measured with: "
            "A count (1 times, now 9), A mode (2 times, now n)");
}

TEST_F(Parameters, WhatIsWrongIsSaidAndNothingIsSet) {
  EXPECT_EQ(change(R"({"module": "A", "set": {"count": "9"}})"), "the app has not started yet");
  EXPECT_EQ(answer_error(change_parameters(R"({"module": "A", "set": {"count": "9"}})", nullptr))
                .error()
                .code,
            ErrorCode::kUnavailable);
  post();
  EXPECT_EQ(set("count", "101"),
            "parameter 'count' of XModule 'A': '101' is out of range\n"
            "  hint: possible is 0 to 100");
  EXPECT_EQ(change(R"({"module": "A", "set": {"mode": "night", "count": "x"}})").substr(0, 35),
            "parameter 'count' of XModule 'A': i");
  EXPECT_NE(set("cuont", "1").find("has no parameter 'cuont'"), std::string::npos);
  EXPECT_NE(change(R"({"module": "C", "set": {"count": "1"}})").find("no XModule 'C'"),
            std::string::npos);
  for (const char* request :
       {"", "[]", "{}", "{\"module\": \"A\"}", "\xff", "null", R"({"module": "A", "set": {}})",
        R"({"module": "A", "set": []})", R"({"module": 1, "set": {"count": "1"}})",
        R"({"module": "A", "set": {"count": 1}})"})
    EXPECT_EQ(change(request).substr(0, 24), "the request is malformed") << request;
  EXPECT_EQ(changed_parameters(*board), "");
  ParameterReader reader(*board, graph, 0);
  reader.look();
  EXPECT_EQ(reader.version(), 1u);
}

/// The app may write into its memory what it likes: whoever looks at it is none the worse.
TEST_F(Parameters, WhatTheAppScribblesIsHarmless) {
  post();
  for (std::uint32_t p = 0; p < 5; ++p) {
    ParameterLine& line = board->parameter(p);
    std::fill(std::begin(line.name), std::end(line.name), 'x');
    line.module = p % 2 == 0 ? 0 : 0xffffffff;
    line.type = 0xfffffff3 + p;
    std::fill(std::begin(line.initial), std::end(line.initial), ~std::uint64_t{0});
    for (auto& half : line.value)
      for (auto& word : half) word.store(~std::uint64_t{0});
  }
  board->module(0).parameters.store(~std::uint64_t{0});
  EXPECT_TRUE(posted_parameters(*board));
  (void)change_parameters(
      R"({"module": "A", "set": {")" + std::string(kBoardNameBytes - 1, 'x') + R"(": "1"}})",
      board.get());
  (void)changed_parameters(*board);
  ParameterReader reader(*board, graph, 0);
  reader.look();
  EXPECT_LE(reader.now()[2].text.size(), kMaxParameterText);
}

/// One writes "x" so and so often into both texts; a reader never sees two that differ, nor a text
/// that nobody wrote, nor one older than what it saw.
TEST_F(Parameters, WhoReadsWhileTheyChangeSeesWhatBelongsTogether) {
  post();
  std::atomic<bool> over{false};
  std::thread writer([&] {
    for (std::size_t i = 1; i <= 4'000; ++i) {
      const std::string value(i % (kMaxParameterText + 1), static_cast<char>('a' + i % 26));
      Json request = {{"module", "A"}};
      request["set"] = {{"mode", value}, {"twin", value}};
      (void)change_parameters(request.dump(), board.get());
    }
    over.store(true);
  });
  ParameterReader reader(*board, graph, 0);
  std::uint64_t seen = 0;
  while (!over.load()) {
    reader.look();
    const std::string& value = reader.now()[2].text;
    ASSERT_EQ(value, reader.now()[3].text);
    ASSERT_EQ(value.find_first_not_of(value.empty() || reader.version() == 1 ? "day"
                                                                             : value.substr(0, 1)),
              std::string::npos);
    ASSERT_GE(reader.version(), seen);
    seen = reader.version();
  }
  writer.join();
  reader.look();
  EXPECT_EQ(reader.version(), 4'001u);
}

/// A change that its writer has not ended (it was interrupted, or died) is not seen at all.
TEST_F(Parameters, AHalfWrittenChangeIsNotSeen) {
  post();
  ParameterReader reader(*board, graph, 0);
  reader.look();
  for (std::uint32_t p = 0; p < 4; ++p)
    for (auto& word : board->parameter(p).value[0]) word.store(0x6161616161616161);
  reader.look();
  EXPECT_EQ(reader.now()[2].text, "day");
  EXPECT_EQ(reader.now()[0].bits, 3u);
  ParameterReader later(*board, graph, 0);
  later.look();
  EXPECT_EQ(later.now()[2].text, "day");
}

}  // namespace
}  // namespace xauto::runtime
