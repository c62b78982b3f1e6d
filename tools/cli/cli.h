// SPDX-License-Identifier: Apache-2.0
// Command lines of all our programs. CLI11 stands behind this page: only cli.cc includes it, since
// each file that does takes seconds to compile.
//
//   cli::Program program("Emulates the XPUs of a platform.", "xauto-emud");
//   program.option("--platform", path, "small, large, or a platform.json").required();
//   if (const auto status = program.parse(argc, argv)) return *status;
//
// What is given is written into the variables, so they live until parse() has returned.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace xauto::cli {

/// One option, flag or word of a command line, as declared. A copy means the same one.
class Argument {
 public:
  explicit Argument(CLI::Option* option) : option_(option) {}
  Argument& required();
  Argument& shown();  ///< the variable's value is in the help, as the default
  Argument& shown_as(const std::string& text);
  Argument& excludes(const std::string& other);  ///< declared before this one
  Argument& needs(const std::string& other);     ///< likewise

  /// From `least` to `most`. T: int, unsigned, std::int64_t, std::uint64_t, double.
  template <class T>
  Argument& range(T least, T most);
  Argument& not_negative();
  Argument& positive();
  Argument& one_of(const std::vector<std::string>& words);

  Argument& separated_by(char sign);  ///< several values in one word
  Argument& values(int count);        ///< takes so many words
  Argument& value_may_miss(const std::string& kind);
  [[nodiscard]] bool given() const;

 private:
  CLI::Option* option_;
};

/// What a variable counts in that gets a duration.
enum class Unit { kMicroseconds, kMilliseconds, kSeconds };
inline constexpr double kYearS = 31'536'000;  ///< no wait is longer

/// What takes options: a program, or one of its verbs. A copy means the same one.
class Verb {
 public:
  explicit Verb(CLI::App* app) : app_(app) {}
  /// `name` without dashes: a word that stands alone. T: std::string, the numbers of
  /// Argument::range, or a vector of strings, ints, std::int64_t or doubles.
  template <class T>
  Argument option(const std::string& name, T& target, const std::string& help = {});
  /// A time with its unit behind, as in 250us, 10ms, 1.5s, 2min or 1h: every duration of every command line is written
  /// so. `target`, from `least` to `most`, is in `unit`; what it holds is the default, shown if above 0. T: double,
  /// int, unsigned, std::int64_t or a vector of the last.
  template <class T>
  Argument duration(const std::string& name, T& target, Unit unit, double least, double most,
                    const std::string& help);
  /// "--x" sets `target`; "!--no-x" clears it.
  Argument flag(const std::string& name, bool& target, const std::string& help);

  void footer(const std::string& text);  ///< below the help
  [[nodiscard]] bool has(const std::string& option) const;

 protected:
  CLI::App* app_;
};

class Program : public Verb {
 public:
  /// Without a name it is called what it was started as.
  explicit Program(const std::string& description, const std::string& name = {});
  ~Program();
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  void version(const std::string& text);  ///< --version
  /// Once there is a verb, one has to be chosen.
  Verb verb(const std::string& name, const std::string& description);
  [[nodiscard]] std::vector<Verb> verbs() const;
  [[nodiscard]] std::string chosen() const;  ///< after parse(): the verb's name

  /// Nothing: go on. Else the exit status: 0 after --help, 2 after bad usage, which has been said.
  [[nodiscard]] std::optional<int> parse(int argc, char** argv);

 private:
  std::unique_ptr<CLI::App> owned_;
};

}  // namespace xauto::cli
