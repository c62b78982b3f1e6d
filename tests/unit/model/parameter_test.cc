// SPDX-License-Identifier: Apache-2.0
#include "model/parameter.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace xauto {
namespace {

using detail::ParameterSpec;

std::string refusal(const ParameterSpec& spec, std::string_view text) {
  const auto taken = spec.take_text(text);
  return taken ? "" : taken.error().what + "|" + taken.error().hint;
}

const ParameterSpec kOn{"on", false};
const ParameterSpec kCount{"count", std::int64_t{3}, std::int64_t{-5}, std::int64_t{100}};
const ParameterSpec kGain{"gain", 0.5, -1.0, 1.0};
const ParameterSpec kMode{"mode", std::string("day")};

TEST(Parameter, TextIsReadAsItsTypeSays) {
  EXPECT_EQ(kOn.take_text("true").value(), ParameterValue(true));
  EXPECT_EQ(kCount.take_text("-5").value(), ParameterValue(std::int64_t{-5}));
  EXPECT_EQ(kGain.take_text("1e-1").value(), ParameterValue(0.1));
  EXPECT_EQ(kGain.take_text("1").value(), ParameterValue(1.0));
  EXPECT_EQ(kMode.take_text("1").value(), ParameterValue(std::string("1")));
  EXPECT_EQ(kMode.take_text("").value(), ParameterValue(std::string()));
}

TEST(Parameter, WhatItCannotBeIsRefused) {
  EXPECT_EQ(refusal(kOn, "1"), "is bool, not '1'|say true or false");
  EXPECT_EQ(refusal(kCount, "1.0"), "is integer, not '1.0'|say a whole number, as 12");
  EXPECT_EQ(refusal(kCount, " 1"), "is integer, not ' 1'|say a whole number, as 12");
  EXPECT_EQ(refusal(kCount, "99999999999999999999"),
            "is integer, not '99999999999999999999'|say a whole number, as 12");
  EXPECT_EQ(refusal(kCount, "101"), "'101' is out of range|possible is -5 to 100");
  for (const char* text : {"nan", "inf", "-inf", "1e999", "0x1", "", "0.5 "})
    EXPECT_NE(refusal(kGain, text), "") << text;
  EXPECT_EQ(refusal(kGain, "-1.5"), "'-1.5' is out of range|possible is -1 to 1");
  EXPECT_EQ(refusal(kGain, "a\x1b[2J"), "is number, not this text|say a number, as 0.5");
  EXPECT_EQ(refusal(kMode, std::string(248, 'x')), "");
  EXPECT_EQ(refusal(kMode, std::string(249, 'x')), "has 249 bytes, at most 248 are possible|");
  EXPECT_EQ(refusal(kMode, std::string_view("a\0b", 3)), "contains a control character|");
}

TEST(Parameter, OfAFileAnIntegerIsANumberAndNotTheOtherWayRound) {
  EXPECT_EQ(kGain.take(std::int64_t{1}).value(), ParameterValue(1.0));
  EXPECT_EQ(kCount.take(1.0).error().what, "is integer, given is number '1'");
  EXPECT_EQ(kOn.take(std::int64_t{1}).error().what, "is bool, given is integer '1'");
  EXPECT_FALSE(kGain.take(std::nan("")));
}

TEST(Parameter, TextsAndBitsMeanTheValue) {
  for (const ParameterValue& value :
       {ParameterValue(true), ParameterValue(std::int64_t{INT64_MIN}), ParameterValue(0.1),
        ParameterValue(-std::numeric_limits<double>::max())}) {
    EXPECT_EQ(from_bits(type_of(value), bits_of(value)), value);
    const double all = std::numeric_limits<double>::max();
    const ParameterSpec spec =
        type_of(value) == ParameterType::kReal ? ParameterSpec{"x", value, -all, all}
        : type_of(value) == ParameterType::kInteger
            ? ParameterSpec{"x", value, std::int64_t{INT64_MIN}, std::int64_t{INT64_MAX}}
            : ParameterSpec{"x", value};
    EXPECT_EQ(spec.take_text(to_text(value)).value(), value);
    EXPECT_EQ(spec.range(), "");
  }
  EXPECT_EQ(kCount.range(), "-5 to 100");
}

TEST(Parameter, DeclarationsAreChecked) {
  for (const ParameterSpec& good : {kOn, kCount, kGain, kMode}) EXPECT_EQ(good.misuse(), "");
  for (const char* name : {"", "a=b", "a\n"}) {
    const ParameterSpec spec{name, true};
    EXPECT_NE(spec.misuse().find("needs a name"), std::string::npos) << name;
  }
  EXPECT_NE((ParameterSpec{std::string(101, 'x'), true}).misuse(), "");
  EXPECT_EQ((ParameterSpec{"x", std::int64_t{5}, std::int64_t{0}, std::int64_t{4}}).misuse(),
            "parameter 'x': its default '5' is out of range; possible is 0 to 4");
  EXPECT_NE((ParameterSpec{"x", 0.5, 1.0, 0.0}).misuse(), "");
  EXPECT_NE((ParameterSpec{"x", std::nan(""), 0.0, 1.0}).misuse(), "");
  EXPECT_EQ((ParameterSpec{"x", 0.5, -std::numeric_limits<double>::infinity(), 1.0}).misuse(),
            "parameter 'x': its range is not finite");
  EXPECT_NE((ParameterSpec{"x", std::string(249, 'x')}).misuse(), "");
}

}  // namespace
}  // namespace xauto
