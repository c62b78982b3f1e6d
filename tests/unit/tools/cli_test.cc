// SPDX-License-Identifier: Apache-2.0
// The command line's facade: what is written where, what is refused with which words and status.
#include "cli/cli.h"

#include <gtest/gtest.h>

namespace xauto::cli {
namespace {

struct Given {
  std::string app, method = "auto", names;
  std::vector<std::string> policies;
  std::vector<double> pair;
  double keep_s = 30;
  std::int64_t period_us = 0;
  std::vector<std::int64_t> times_us = {5'000, 95'000};
  int threads = 2;
  bool fork_join = true;
};

struct Outcome {
  std::optional<int> status;
  std::string chosen, out, err;
  bool names_given = false;
  Given given;
};

Outcome parse(std::vector<std::string> words) {
  Outcome outcome;
  Given& g = outcome.given;
  Program program("Tests the facade.", "tool");
  program.version("1.2");
  Verb solve = program.verb("solve", "Solve it.");
  (void)program.verb("check", "Check it.");
  solve.footer("Example: tool solve");
  solve.option("--app", g.app, "app.json").required();
  solve.option("--method", g.method, "how").one_of({"auto", "heft"}).shown();
  const Argument names = solve.option("--names", g.names, "which").value_may_miss("XPU,...");
  solve.option("--policies", g.policies, "which").separated_by(',').excludes("--method");
  solve.option("--pair", g.pair, "least and most").values(2);
  solve.duration("--keep", g.keep_s, Unit::kSeconds, 0.5, 1e3, "so long");
  solve.duration("--period", g.period_us, Unit::kMicroseconds, 1, 3.6e9, "how often");
  solve.duration("--times", g.times_us, Unit::kMicroseconds, 1, 1e9, "from, to").values(2);
  solve.option("--threads", g.threads, "threads").range(1, 64).needs("--app");
  solve.flag("!--no-fork-join", g.fork_join, "without");
  std::vector<char*> argv{words[0].data()};
  for (std::size_t i = 1; i < words.size(); ++i) argv.push_back(words[i].data());
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  outcome.status = program.parse(static_cast<int>(argv.size()), argv.data());
  outcome.out = testing::internal::GetCapturedStdout();
  outcome.err = testing::internal::GetCapturedStderr();
  outcome.chosen = program.chosen();
  outcome.names_given = names.given();
  EXPECT_TRUE(solve.has("--app"));
  EXPECT_FALSE(solve.has("--platform"));
  return outcome;
}

TEST(CommandLine, WritesWhatIsGivenIntoTheVariables) {
  const Outcome o = parse({"tool", "solve", "--app", "a.json", "--names", "--policies", "x,y",
                           "--pair", "1", "2.5", "--keep", "2min", "--period", "66.7ms", "--times",
                           "250us", "0.5s", "--no-fork-join"});
  ASSERT_EQ(o.status, std::nullopt) << o.err;
  EXPECT_EQ(o.chosen, "solve");
  EXPECT_EQ(o.given.app, "a.json");
  EXPECT_TRUE(o.names_given);
  EXPECT_EQ(o.given.names, "");
  EXPECT_EQ(o.given.policies, (std::vector<std::string>{"x", "y"}));
  EXPECT_EQ(o.given.pair, (std::vector<double>{1, 2.5}));
  EXPECT_EQ(o.given.keep_s, 120);
  EXPECT_EQ(o.given.period_us, 66'700);
  EXPECT_EQ(o.given.times_us, (std::vector<std::int64_t>{250, 500'000}));
  EXPECT_FALSE(o.given.fork_join);
}

TEST(CommandLine, LeavesDefaultsAlone) {
  const Outcome o = parse({"tool", "solve", "--app", "a.json"});
  ASSERT_EQ(o.status, std::nullopt) << o.err;
  EXPECT_FALSE(o.names_given);
  EXPECT_EQ(o.given.method, "auto");
  EXPECT_TRUE(o.given.fork_join);
}

TEST(CommandLine, RefusesWithStatus2AndSaysWhat) {
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases = {
      {{"solve"}, "--app is required"},
      {{"solve", "--app", "a", "--method", "x"}, "x not in {auto,heft}"},
      {{"solve", "--app", "a", "--method", "heft", "--policies", "x"}, "excludes --policies"},
      {{"solve", "--app", "a", "--threads", "65"}, "Value 65 not in range 1 to 64"},
      {{"solve", "--app", "a", "--keep", "1ms"}, "'1ms' is not from 500ms to 16.6667min"},
      {{"solve", "--app", "a", "--keep", "10"}, "'10' has no unit: say 10us, 10ms, 10s"},
      {{"solve", "--app", "a", "--keep", "10 sec"}, "'10 sec' is no time such as 250us"},
      {{"solve", "--app", "a", "--keep", "nan"}, "'nan' is no time such as"},
      {{"solve", "--app", "a", "--keep", "s"}, "'s' is no time such as"},
      {{"solve", "--app", "a", "--period", "2.5us"}, "'2.5us' is no multiple of 1us"},
      {{"solve", "--app", "a", "--times", "1ms", "2"}, "'2' has no unit"},
      {{"solve", "--app", "a", "--pair", "1"}, "--pair"},
      {{}, "subcommand is required"}};
  for (const auto& [words, said] : cases) {
    std::vector<std::string> all{"tool"};
    all.insert(all.end(), words.begin(), words.end());
    const Outcome o = parse(all);
    EXPECT_EQ(o.status, 2) << said;
    EXPECT_NE(o.err.find(said), std::string::npos) << o.err;
    EXPECT_EQ(o.out, "");
  }
}

TEST(CommandLine, AWrongOptionIsNamedBeforeWhatIsMissing) {
  const auto said = [](std::vector<std::string> words) {
    const Outcome o = parse(std::move(words));
    EXPECT_EQ(o.status, 2);
    return o.err.substr(0, o.err.find('\n'));
  };
  EXPECT_EQ(said({"tool", "solve", "--ap", "a.json"}),
            "--ap is no option of solve; did you mean --app?");
  EXPECT_EQ(said({"tool", "solve", "--app", "a.json", "--theads=3"}),
            "--theads is no option of solve; did you mean --threads?");
  EXPECT_EQ(said({"tool", "solve", "--quick"}), "--quick is no option of solve");
  EXPECT_EQ(said({"tool", "--versoin"}), "--versoin is no option; did you mean --version?");
  EXPECT_EQ(said({"tool", "solve", "--", "--ap"}), "--app is required") << "the program's own";
}

TEST(CommandLine, HelpAndVersionAreAskedForAndStatus0) {
  const Outcome help = parse({"tool", "solve", "--help"});
  EXPECT_EQ(help.status, 0);
  for (const char* said :
       {"Solve it.", "REQUIRED", "{auto,heft}=auto", "=30s", "=5ms 95ms", "Example: tool"})
    EXPECT_NE(help.out.find(said), std::string::npos) << help.out;
  const Outcome version = parse({"tool", "--version"});
  EXPECT_EQ(version.status, 0);
  EXPECT_EQ(version.out, "1.2\n");
}

}  // namespace
}  // namespace xauto::cli
