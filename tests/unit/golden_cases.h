// SPDX-License-Identifier: Apache-2.0
// The malformed inputs under tests/golden/errors/<format>/ and the message each must give:
// <case>.json (or .sql, .bin) beside <case>.expected. tests/golden/errors/README.md.
#pragma once

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <xauto/result.h>

namespace xauto::test {

inline std::filesystem::path golden() {
  return std::filesystem::path(XAUTO_SOURCE_DIR) / "tests/golden";
}

inline std::string slurp(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  EXPECT_TRUE(in.good()) << path;
  return {std::istreambuf_iterator<char>(in), {}};
}

/// Files of tests/golden/errors/<format>, without the expectations, by name.
inline std::vector<std::filesystem::path> malformed(const std::string& format) {
  std::vector<std::filesystem::path> cases;
  for (const auto& entry : std::filesystem::directory_iterator(golden() / "errors" / format))
    if (entry.path().extension() != ".expected") cases.push_back(entry.path());
  std::sort(cases.begin(), cases.end());
  return cases;
}

/// Compares with <case>.expected; XAUTO_UPDATE_GOLDEN=1 writes it instead (read the diff
/// afterwards).
inline void expect_message(const std::filesystem::path& input, const Error& error) {
  std::filesystem::path expected = input;
  expected.replace_extension(".expected");
  const std::string text = error.to_string() + "\n";
  if (std::getenv("XAUTO_UPDATE_GOLDEN") != nullptr) {
    std::ofstream(expected, std::ios::binary) << text;
    return;
  }
  EXPECT_EQ(slurp(expected), text) << input;
  EXPECT_TRUE(error.code == ErrorCode::kInvalid)
      << input << ": the tools exit with 2 for kInvalid only";
}

}  // namespace xauto::test
