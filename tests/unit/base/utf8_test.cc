// SPDX-License-Identifier: Apache-2.0
#include "base/utf8.h"

#include <gtest/gtest.h>

namespace xauto {
namespace {

/// As RFC 3629 section 3 writes a code point.
std::string encoded(unsigned c) {
  const auto tail = [&](int shift) { return static_cast<char>(0x80 | ((c >> shift) & 0x3f)); };
  if (c < 0x80) return {static_cast<char>(c)};
  if (c < 0x800) return {static_cast<char>(0xc0 | (c >> 6)), tail(0)};
  if (c < 0x10000) return {static_cast<char>(0xe0 | (c >> 12)), tail(6), tail(0)};
  return {static_cast<char>(0xf0 | (c >> 18)), tail(12), tail(6), tail(0)};
}

TEST(Utf8, EveryCodePointIsKeptAndNoSurrogate) {
  for (unsigned c = 0; c < 0x120000; ++c) {
    const std::string text = encoded(c);
    const bool is_one = c <= 0x10ffff && (c < 0xd800 || c > 0xdfff);
    ASSERT_EQ(utf8_length(text), is_one ? text.size() : 0) << c;
    // Cut short it is none.
    if (text.size() > 1) {
      ASSERT_EQ(utf8_length(std::string_view(text).substr(0, text.size() - 1)), 0u) << c;
    }
  }
}

TEST(Utf8, WhatIsNoCharacterIsReplacedByteByByte) {
  EXPECT_EQ(valid_utf8("gr\xc3\xb6\xc3\x9f"
                       "e"),
            "gr\xc3\xb6\xc3\x9f"
            "e");
  EXPECT_EQ(valid_utf8("a\xc3"), "a?");
  EXPECT_EQ(valid_utf8("\xc0\x80z"), "??z");  // an overlong NUL
  EXPECT_EQ(valid_utf8("\xff\xfe"), "??");
  EXPECT_EQ(valid_utf8(""), "");
}

TEST(Utf8, WhatATerminalMightObeyIsShown) {
  EXPECT_EQ(for_terminal("two\nlines\tand gr\xc3\xb6\xc3\x9f"
                         "e"),
            "two\nlines\tand gr\xc3\xb6\xc3\x9f"
            "e");
  EXPECT_EQ(for_terminal("\x1b[2Jgone"), "\\x1b[2Jgone");
  EXPECT_EQ(for_terminal("a\rb\x7f"), "a\\x0db\\x7f");
  EXPECT_EQ(for_terminal("\xc2\x9b"
                         "2J"),
            "\\xc2\\x9b2J");  // CSI in one character
  EXPECT_EQ(for_terminal(std::string_view("\0\xff", 2)), "\\x00\\xff");
}

}  // namespace
}  // namespace xauto
