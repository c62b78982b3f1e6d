// SPDX-License-Identifier: Apache-2.0
#include "model/json_value.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "model/json.h"

namespace xauto {
namespace {

TEST(JsonValue, KeepsTheOrderInWhichItWasFilled) {
  Json value = {{"z", 1}, {"a", "text"}, {"list", Json::array({true, 2.5, Json()})}};
  value["b"]["c"].push_back({{"d", std::vector<std::string>{"x", "y"}}});
  value["z"] = -7;
  EXPECT_EQ(value.dump(),
            R"({"z":-7,"a":"text","list":[true,2.5,null],"b":{"c":[{"d":["x","y"]}]}})");
  EXPECT_EQ((Json{{"a", Json::array({1})}, {"b", Json::object()}}).dump(2),
            "{\n  \"a\": [\n    1\n  ],\n  \"b\": {}\n}");
  EXPECT_EQ(value.keys(), (std::vector<std::string>{"z", "a", "list", "b"}));
}

TEST(JsonValue, NumbersAreWholeOrNotAndNeverCut) {
  EXPECT_EQ(Json(std::numeric_limits<std::uint64_t>::max()).dump(), "18446744073709551615");
  EXPECT_EQ(Json(std::numeric_limits<std::int64_t>::min()).dump(), "-9223372036854775808");
  EXPECT_EQ(Json(2.0).dump(), "2.0");
  EXPECT_EQ(Json(0.1).dump(), "0.1");
  EXPECT_EQ(Json(std::nan("")).dump(), "null");
  EXPECT_EQ(Json(std::optional<double>(1.5)).dump(), "1.5");
  EXPECT_TRUE(Json(std::optional<double>()).is_null());
  const Json read = Json::parse(R"([7, 18446744073709551615, 2.5, "7", true, -1])").value();
  const auto at = [&](std::size_t i) { return read.elements().at(i); };
  EXPECT_EQ(at(0).integer(), 7);
  EXPECT_EQ(at(0).number(), 7.0);
  EXPECT_EQ(at(1).integer(), std::nullopt);
  EXPECT_EQ(at(1).number(), 18446744073709551615.0);
  EXPECT_EQ(at(2).integer(), std::nullopt);
  EXPECT_EQ(at(3).integer(), std::nullopt);
  EXPECT_EQ(at(4).integer(), std::nullopt);
  EXPECT_EQ(at(4).boolean(), true);
  EXPECT_EQ(at(5).integer(), -1);
}

TEST(JsonValue, ReadsWhatItWrites) {
  const std::string text =
      R"({"a":[{"b":[]},[[{}]],null],"c":{"d":-1.5e-09,"e":18446744073709551615},"f":"\"\u0001"})";
  EXPECT_EQ(Json::parse(text).value().dump(), text);
  EXPECT_EQ(Json::parse(R"({"a":1,"b":2,"a":3})").value().dump(), R"({"a":3,"b":2})");
}

TEST(JsonValue, WhatIsNotThereIsNull) {
  const Json value = {{"a", 1}};
  EXPECT_TRUE(value.at("b").at("c").is_null());
  EXPECT_EQ(value.at("a").text().value_or("?"), "?");
  EXPECT_TRUE(value.at("a").elements().empty());
  EXPECT_FALSE(value.has("b"));
  EXPECT_TRUE(value.has("a"));
}

TEST(JsonValue, WhatIsNoUtf8IsReplaced) {
  const Json value = {{"name",
                       "a\xff"
                       "b\xc3\xa4"}};
  EXPECT_EQ(value.dump(),
            "{\"name\":\"a\xef\xbf\xbd"
            "b\xc3\xa4\"}");
}

TEST(JsonValue, RefusesWhatIsNotJsonOrTooDeep) {
  for (const char* text : {"", "{", "[1,]", "{\"a\":}", "nul", "[1] 2", "\"\xff\""})
    EXPECT_FALSE(Json::parse(text).has_value()) << text;
  const auto nested = [](int depth) {
    return std::string(static_cast<std::size_t>(depth), '[') +
           std::string(static_cast<std::size_t>(depth), ']');
  };
  EXPECT_TRUE(Json::parse(nested(kMaxJsonDepth)).has_value());
  EXPECT_FALSE(Json::parse(nested(kMaxJsonDepth + 1)).has_value());
  EXPECT_FALSE(Json::parse(std::string(1'000'000, '[')).has_value());
}

}  // namespace
}  // namespace xauto
