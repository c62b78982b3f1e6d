// SPDX-License-Identifier: Apache-2.0
// The only file that includes CLI11; tests/unit/model/layering_test.cc sees to that.
#include "cli/cli.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string_view>
#include <type_traits>

#include <CLI/CLI.hpp>

#include "base/nearest.h"

namespace xauto::cli {
namespace {

constexpr int kBadUsage = 2;

/// CLI11 reads "nan" and "inf" as numbers, and its ranges let the first one pass.
std::string no_number(const std::string& text) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  return end != text.c_str() && !std::isfinite(value) ? "'" + text + "' is no finite number" : "";
}

/// "--platfrm", or "-app", a word before "--" that begins as an option and is none of these. Empty: there is none.
std::string no_option(const std::vector<const CLI::App*>& of, int argc, char** argv) {
  for (int k = 1; k < argc && std::string_view(argv[k]) != "--"; ++k) {
    const std::string whole = argv[k], word = whole.substr(0, whole.find('='));
    const bool known = std::any_of(of.begin(), of.end(), [&](const CLI::App* app) {
      return app->get_option_no_throw(word) != nullptr;
    });
    char* end = nullptr;
    std::strtod(word.c_str(), &end);
    const bool option =
        word.starts_with('-') && word.size() > 2 && *end != '\0';  // "-nan" is a value
    if (option && !known) return word;
  }
  return {};
}

struct TimeUnit {
  const char* name;
  double us;
};
constexpr TimeUnit kTimeUnits[] = {{"us", 1}, {"ms", 1e3}, {"s", 1e6}, {"min", 6e7}, {"h", 3.6e9}};

constexpr double us_of(Unit unit) {
  return unit == Unit::kMicroseconds ? 1 : unit == Unit::kMilliseconds ? 1e3 : 1e6;
}

/// "1.5s": with the largest unit of which there is one.
std::string spelled(double us) {
  const TimeUnit* best = kTimeUnits;
  for (const TimeUnit& unit : kTimeUnits)
    if (us >= unit.us) best = &unit;
  char text[40];
  std::snprintf(text, sizeof text, "%g%s", us / best->us, best->name);
  return text;
}

/// `text` becomes a number of `unit`s. What is wrong; empty: nothing.
std::string read_duration(std::string& text, Unit unit, bool whole, double least, double most) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  const std::string behind = end;
  const auto* found = std::find_if(std::begin(kTimeUnits), std::end(kTimeUnits),
                                   [&](const TimeUnit& u) { return behind == u.name; });
  if (end == text.c_str() || !std::isfinite(value) ||
      (found == std::end(kTimeUnits) && !behind.empty()))
    return "'" + text + "' is no time such as 250us, 10ms, 1.5s, 2min or 1h";
  if (found == std::end(kTimeUnits))
    return "'" + text + "' has no unit: say " + text + "us, " + text + "ms, " + text + "s, " +
           text + "min or " + text + "h";
  const double units = value * found->us / us_of(unit);
  if (!(units >= least && units <= most))
    return "'" + text + "' is not from " + spelled(least * us_of(unit)) + " to " +
           spelled(most * us_of(unit));
  if (whole && std::abs(units - std::round(units)) > 1e-6)
    return "'" + text + "' is no multiple of " + spelled(us_of(unit));
  char number[40];
  std::snprintf(number, sizeof number, whole ? "%.0f" : "%.17g", units);
  text = number;
  return {};
}

}  // namespace

Argument& Argument::required() {
  option_->required();
  return *this;
}

Argument& Argument::shown() {
  option_->capture_default_str();
  return *this;
}

Argument& Argument::shown_as(const std::string& text) {
  option_->default_str(text);
  return *this;
}

Argument& Argument::excludes(const std::string& other) {
  option_->excludes(other);
  return *this;
}

Argument& Argument::needs(const std::string& other) {
  option_->needs(other);
  return *this;
}

template <class T>
Argument& Argument::range(T least, T most) {
  option_->check(CLI::Range(least, most));
  return *this;
}
template Argument& Argument::range(int, int);
template Argument& Argument::range(unsigned, unsigned);
template Argument& Argument::range(std::int64_t, std::int64_t);
template Argument& Argument::range(std::uint64_t, std::uint64_t);
template Argument& Argument::range(double, double);

Argument& Argument::not_negative() {
  option_->check(CLI::NonNegativeNumber);
  return *this;
}

Argument& Argument::positive() {
  option_->check(CLI::PositiveNumber);
  return *this;
}

Argument& Argument::one_of(const std::vector<std::string>& words) {
  option_->check(CLI::IsMember(words));
  return *this;
}

Argument& Argument::separated_by(char sign) {
  option_->delimiter(sign);
  return *this;
}

Argument& Argument::values(int count) {
  option_->expected(count);
  return *this;
}

Argument& Argument::value_may_miss(const std::string& kind) {
  option_->expected(0, 1)->type_name(kind);
  return *this;
}

bool Argument::given() const {
  return option_->count() > 0;
}

template <class T>
Argument Verb::option(const std::string& name, T& target, const std::string& help) {
  CLI::Option* option = app_->add_option(name, target, help);
  if constexpr (std::is_same_v<T, double> || std::is_same_v<T, std::vector<double>>)
    option->check(no_number, "");
  return Argument(option);
}
template Argument Verb::option(const std::string&, std::string&, const std::string&);
template Argument Verb::option(const std::string&, int&, const std::string&);
template Argument Verb::option(const std::string&, unsigned&, const std::string&);
template Argument Verb::option(const std::string&, std::int64_t&, const std::string&);
template Argument Verb::option(const std::string&, std::uint64_t&, const std::string&);
template Argument Verb::option(const std::string&, double&, const std::string&);
template Argument Verb::option(const std::string&, std::vector<std::string>&, const std::string&);
template Argument Verb::option(const std::string&, std::vector<int>&, const std::string&);
template Argument Verb::option(const std::string&, std::vector<std::int64_t>&, const std::string&);
template Argument Verb::option(const std::string&, std::vector<double>&, const std::string&);

template <class T>
Argument Verb::duration(const std::string& name, T& target, Unit unit, double least, double most,
                        const std::string& help) {
  constexpr bool whole = !std::is_same_v<T, double>;
  CLI::Option* option = app_->add_option(name, target, help)->type_name("TIME");
  option->transform(CLI::Validator(
      [=](std::string& text) { return read_duration(text, unit, whole, least, most); }, "", ""));
  if constexpr (std::is_arithmetic_v<T>) {
    if (target > 0) option->default_str(spelled(static_cast<double>(target) * us_of(unit)));
  } else {
    std::string words;
    for (const auto one : target)
      words += (words.empty() ? "" : " ") + spelled(static_cast<double>(one) * us_of(unit));
    option->default_str(words);
  }
  return Argument(option);
}
template Argument Verb::duration(const std::string&, double&, Unit, double, double,
                                 const std::string&);
template Argument Verb::duration(const std::string&, int&, Unit, double, double,
                                 const std::string&);
template Argument Verb::duration(const std::string&, unsigned&, Unit, double, double,
                                 const std::string&);
template Argument Verb::duration(const std::string&, std::int64_t&, Unit, double, double,
                                 const std::string&);
template Argument Verb::duration(const std::string&, std::vector<std::int64_t>&, Unit, double,
                                 double, const std::string&);

Argument Verb::flag(const std::string& name, bool& target, const std::string& help) {
  return Argument(app_->add_flag(name, target, help));
}

void Verb::footer(const std::string& text) {
  app_->footer(text);
}

bool Verb::has(const std::string& option) const {
  return app_->get_option_no_throw(option) != nullptr;
}

Program::Program(const std::string& description, const std::string& name)
    : Verb(nullptr), owned_(std::make_unique<CLI::App>(description, name)) {
  app_ = owned_.get();
}

Program::~Program() = default;

void Program::version(const std::string& text) {
  app_->set_version_flag("--version", text);
}

Verb Program::verb(const std::string& name, const std::string& description) {
  app_->require_subcommand(1);
  return Verb(app_->add_subcommand(name, description));
}

std::vector<Verb> Program::verbs() const {
  std::vector<Verb> verbs;
  for (CLI::App* sub : app_->get_subcommands({})) verbs.emplace_back(sub);
  return verbs;
}

std::string Program::chosen() const {
  const std::vector<CLI::App*> verbs = app_->get_subcommands();
  return verbs.empty() ? std::string() : verbs.front()->get_name();
}

std::optional<int> Program::parse(int argc, char** argv) {
  try {
    app_->parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    if (e.get_exit_code() == 0) return app_->exit(e);
    // The parser would first ask for what is required, which the wrong word was perhaps meant to be.
    std::vector<const CLI::App*> of{app_};
    for (const CLI::App* verb : app_->get_subcommands({}))
      if (argc > 1 && verb->get_name() == argv[1]) of.push_back(verb);
    const std::string word = no_option(of, argc, argv);
    if (word.empty()) {
      app_->exit(e);
      return kBadUsage;
    }
    std::vector<std::string> names;
    for (const CLI::App* app : of)
      for (const CLI::Option* option : app->get_options())
        for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
    const bool one_dash = word[1] != '-';
    const std::string meant = nearest((one_dash ? "-" : "") + word, names);
    std::fprintf(stderr, "%s is no option%s%s\nRun with --help for more information.\n",
                 word.c_str(), of.size() > 1 ? (" of " + of.back()->get_name()).c_str() : "",
                 meant.empty() ? "" : ("; did you mean " + meant + "?").c_str());
    return kBadUsage;
  }
  return std::nullopt;
}

}  // namespace xauto::cli
