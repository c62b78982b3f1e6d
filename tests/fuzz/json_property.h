// SPDX-License-Identifier: Apache-2.0
// What must hold for any text given to a JSON reader: it is refused with a short message that names
// the file, or what was read is written and read again unchanged.
#pragma once

#include <cstdio>
#include <cstdlib>
#include <string_view>

#include <xauto/result.h>

namespace xauto::fuzz {

inline constexpr std::string_view kOrigin = "fuzz.json";

inline void require(bool holds, const char* what) {
  if (holds) return;
  std::fprintf(stderr, "property violated: %s\n", what);
  std::abort();
}

template <class T, class Write, class Read>
void check_read(const Result<T>& value, Write write, Read read) {
  if (!value) {
    const Error& error = value.error();
    require(error.code == ErrorCode::kInvalid, "malformed input is kInvalid");
    require(error.where.starts_with(kOrigin), "the message names the file");
    require(!error.what.empty(), "the message names the cause");
    require(error.to_string().size() < 4096, "the message is short");
    return;
  }
  const std::string text = write(*value);
  const Result<T> again = read(text);
  require(again.has_value(), "what we write can be read");
  require(*again == *value, "what we write is what was read");
  require(write(*again) == text, "writing is stable");
}

}  // namespace xauto::fuzz
