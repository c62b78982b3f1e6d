// SPDX-License-Identifier: Apache-2.0
#include "model/parameter.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <optional>

#include "base/number.h"

namespace xauto {
namespace {

constexpr const char* kTypeNames[] = {"bool", "integer", "number", "text"};

/// Control characters of ASCII, which no terminal should be sent.
bool has_control(std::string_view text) {
  return std::any_of(text.begin(), text.end(), [](char c) {
    return static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) == 0x7f;
  });
}

std::string wrong_text(const std::string& text) {
  if (text.size() > kMaxParameterText)
    return "has " + std::to_string(text.size()) + " bytes, at most " +
           std::to_string(kMaxParameterText) + " are possible";
  return has_control(text) ? "contains a control character" : "";
}

std::optional<std::int64_t> integer_of(std::string_view text) {
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

}  // namespace

const char* to_string(ParameterType type) {
  return kTypeNames[static_cast<std::size_t>(type)];
}

std::string to_text(const ParameterValue& value) {
  switch (type_of(value)) {
    case ParameterType::kBoolean:
      return std::get<bool>(value) ? "true" : "false";
    case ParameterType::kInteger:
      return std::to_string(std::get<std::int64_t>(value));
    case ParameterType::kReal:
      return text_of(std::get<double>(value));
    case ParameterType::kText:
      break;
  }
  return std::get<std::string>(value);
}

std::uint64_t bits_of(const ParameterValue& value) {
  switch (type_of(value)) {
    case ParameterType::kBoolean:
      return std::get<bool>(value) ? 1 : 0;
    case ParameterType::kInteger:
      return static_cast<std::uint64_t>(std::get<std::int64_t>(value));
    case ParameterType::kReal:
      return bits_of_real(std::get<double>(value));
    case ParameterType::kText:
      break;
  }
  return 0;
}

ParameterValue from_bits(ParameterType type, std::uint64_t bits) {
  switch (type) {
    case ParameterType::kBoolean:
      return bits != 0;
    case ParameterType::kInteger:
      return static_cast<std::int64_t>(bits);
    case ParameterType::kReal:
      return real_of_bits(bits);
    case ParameterType::kText:
      break;
  }
  return std::string();
}

namespace detail {

std::string ParameterSpec::range() const {
  const auto all = [&](auto number) {
    using T = decltype(number);
    return std::get<T>(least) == std::numeric_limits<T>::lowest() &&
           std::get<T>(most) == std::numeric_limits<T>::max();
  };
  if (type() == ParameterType::kInteger ? all(std::int64_t{})
                                        : type() != ParameterType::kReal || all(double{}))
    return {};
  return to_text(least) + " to " + to_text(most);
}

Result<ParameterValue> ParameterSpec::take(const ParameterValue& value) const {
  ParameterValue taken = value;
  if (type() == ParameterType::kReal && type_of(value) == ParameterType::kInteger)
    taken = static_cast<double>(std::get<std::int64_t>(value));
  if (taken.index() != initial.index())
    return fail(ErrorCode::kInvalid, std::string("is ") + to_string(type()) + ", given is " +
                                         to_string(type_of(value)) + " '" + to_text(value) + "'");
  const auto inside = [&](auto number) {  // false of what is not a number, too
    return number >= std::get<decltype(number)>(least) &&
           number <= std::get<decltype(number)>(most);
  };
  if (type() == ParameterType::kInteger
          ? !inside(std::get<std::int64_t>(taken))
          : type() == ParameterType::kReal && !inside(std::get<double>(taken)))
    return fail(ErrorCode::kInvalid, "'" + to_text(value) + "' is out of range", {},
                "possible is " + to_text(least) + " to " + to_text(most));
  if (type() == ParameterType::kText)
    if (const std::string wrong = wrong_text(std::get<std::string>(taken)); !wrong.empty())
      return fail(ErrorCode::kInvalid, wrong);
  return taken;
}

Result<ParameterValue> ParameterSpec::take_text(std::string_view text) const {
  const auto refused = [&](const char* wanted) {
    const bool printable = text.size() <= kMaxParameterText && !has_control(text);
    return fail(ErrorCode::kInvalid,
                std::string("is ") + to_string(type()) +
                    (printable ? ", not '" + std::string(text) + "'" : ", not this text"),
                {}, wanted);
  };
  switch (type()) {
    case ParameterType::kBoolean:
      if (text != "true" && text != "false") return refused("say true or false");
      return take(text == "true");
    case ParameterType::kInteger: {
      const auto number = integer_of(text);
      if (!number) return refused("say a whole number, as 12");
      return take(*number);
    }
    case ParameterType::kReal: {
      const auto number = real_of(text);
      if (!number || !std::isfinite(*number)) return refused("say a number, as 0.5");
      return take(*number);
    }
    case ParameterType::kText:
      break;
  }
  return take(std::string(text));
}

std::string ParameterSpec::misuse() const {
  const std::string who = "parameter '" + name + "'";
  if (name.empty() || name.size() > kMaxParameterName || has_control(name) ||
      name.find('=') != std::string::npos)
    return who + " needs a name of 1 to " + std::to_string(kMaxParameterName) +
           " bytes without control characters and '='";
  if (const auto taken = take(initial); !taken)
    return who + ": its default " + taken.error().what +
           (taken.error().hint.empty() ? "" : "; " + taken.error().hint);
  if (type() == ParameterType::kReal &&
      !(std::isfinite(std::get<double>(least)) && std::isfinite(std::get<double>(most))))
    return who + ": its range is not finite";
  return {};
}

ParameterNow::ParameterNow(const ParameterSpec& of) : spec(&of) {
  if (of.type() == ParameterType::kText) text.reserve(kMaxParameterText);
  set(of.initial);
}

void ParameterNow::set(const ParameterValue& value) {
  bits = bits_of(value);
  if (type_of(value) == ParameterType::kText) text = std::get<std::string>(value);
}

std::vector<ParameterNow> initial_of(const std::vector<ParameterHandle>& parameters) {
  std::vector<ParameterNow> now;
  now.reserve(parameters.size());
  for (const ParameterHandle& parameter : parameters) now.emplace_back(*parameter);
  return now;
}

ParameterHandle make_parameter(std::string name, bool initial) {
  return std::make_shared<const ParameterSpec>(ParameterSpec{std::move(name), initial});
}
ParameterHandle make_parameter(std::string name, std::int64_t initial, std::int64_t least,
                               std::int64_t most) {
  return std::make_shared<const ParameterSpec>(
      ParameterSpec{std::move(name), initial, least, most});
}
ParameterHandle make_parameter(std::string name, double initial, double least, double most) {
  return std::make_shared<const ParameterSpec>(
      ParameterSpec{std::move(name), initial, least, most});
}
ParameterHandle make_parameter(std::string name, std::string initial) {
  return std::make_shared<const ParameterSpec>(ParameterSpec{std::move(name), std::move(initial)});
}
const std::string& name_of(const ParameterSpec& parameter) {
  return parameter.name;
}

}  // namespace detail
}  // namespace xauto
